//! The time that the timers inside ethercrab see. It is the time of the bus that a thread polls,
//! counted since the bus was opened: while a bus is set up it moves on with the port, in a lane it
//! stands still, because the lane's own wait ends an exchange. Nothing is woken: whoever polls
//! looks at the time again.

use core::cell::Cell;
use core::task::Waker;

use taktil_hal::Nanos;

thread_local! {
    /// Microseconds since the bus that this thread polls was opened.
    static ELAPSED_MICROS: Cell<u64> = const { Cell::new(0) };
}

/// Sets the time for the polls of this thread that follow.
pub(crate) fn set(elapsed: Nanos) {
    ELAPSED_MICROS.set((elapsed.0.max(0) / 1_000).cast_unsigned());
}

/// The same time in nanoseconds, from which the clocks of a segment are set.
pub(crate) fn nanos() -> u64 {
    ELAPSED_MICROS.get() * 1_000
}

struct PolledTime;

impl embassy_time_driver::Driver for PolledTime {
    fn now(&self) -> u64 {
        ELAPSED_MICROS.get()
    }

    fn schedule_wake(&self, _at: u64, _waker: &Waker) {}
}

embassy_time_driver::time_driver_impl!(static POLLED_TIME: PolledTime = PolledTime);

/// Ticks are microseconds.
const _: () = assert!(embassy_time_driver::TICK_HZ == 1_000_000);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_sees_the_time_of_its_own_bus() {
        set(Nanos::from_millis(3));
        let other = std::thread::spawn(|| (embassy_time_driver::now(), nanos())).join();
        assert_eq!(other.ok(), Some((0, 0)));
        assert_eq!((embassy_time_driver::now(), nanos()), (3_000, 3_000_000));
        set(Nanos(-1));
        assert_eq!(nanos(), 0);
    }
}
