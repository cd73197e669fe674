//! The run's clock: the kernel's monotonic time, counted from an instant that stands apart from the
//! kernel's tick.

use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_nanosleep};
use taktil_hal::{Clock, Nanos};

use super::monotonic;

/// The kernel's monotonic clock, counted from a chosen instant.
#[derive(Clone, Copy, Debug)]
pub struct MonotonicClock {
    origin: Nanos,
}

/// Epochs stand [`EPOCH_AFTER_TICK`] after whole multiples of this: of the kernel's tick at 50,
/// 100, 250 and 1000 Hz alike. The tick stands on whole multiples of its period too, so a lane's
/// phase also says how its releases stand to the tick, and every start finds them standing alike.
const EPOCH_GRAIN: Nanos = Nanos::from_millis(20);

/// The epoch stands this long after a tick, whose interrupt takes 5 to 20 us. Lanes whose phase is
/// a multiple of 0.1 or of 0.25 ms and whose period is one of 0.5 ms then keep 50 us at least from
/// every tick: releases on it are late by its work, and one that spins towards its release is
/// interrupted there.
pub const EPOCH_AFTER_TICK: Nanos = Nanos::from_micros(150);

impl MonotonicClock {
    /// The kernel's monotonic time itself.
    #[must_use]
    pub fn since_boot() -> MonotonicClock {
        MonotonicClock { origin: Nanos::ZERO }
    }

    /// When this clock shows zero, on the kernel's monotonic clock.
    #[must_use]
    pub fn origin(&self) -> Nanos {
        self.origin
    }

    /// A clock that shows zero at `lead` from now or up to 20 ms later, [`EPOCH_AFTER_TICK`] after
    /// a whole multiple of 20 ms of the kernel's monotonic time.
    #[must_use]
    pub fn starting_in(lead: Nanos) -> MonotonicClock {
        let earliest = monotonic() + lead;
        let past = (earliest - EPOCH_AFTER_TICK).0.rem_euclid(EPOCH_GRAIN.0);
        let wait = if past == 0 { 0 } else { EPOCH_GRAIN.0 - past };
        MonotonicClock { origin: earliest + Nanos(wait) }
    }
}

impl Clock for MonotonicClock {
    fn now(&self) -> Nanos {
        monotonic() - self.origin
    }

    fn sleep_until(&self, instant: Nanos) {
        let at = instant + self.origin;
        let at = TimeSpec::new(at.0.div_euclid(1_000_000_000), at.0.rem_euclid(1_000_000_000));
        // A signal may end the sleep early: sleep again towards the same absolute instant.
        while clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &at)
            == Err(nix::errno::Errno::EINTR)
        {}
    }
}
