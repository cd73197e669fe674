//! The clock of a board or of its bus, by which the machine may be paced: the board says how much
//! later than their place in its own cycle the jobs reach it, and the releases follow its clock.
//!
//! A half of this trait moves nothing by itself. Whoever reads it decides on the releases, and
//! writes the decision down, so that a run can be repeated without the board.

use crate::error::Error;
use crate::reading::Reading;
use crate::time::Nanos;

/// The half of a board that has a clock of its own.
pub trait BoardClock: Send {
    /// A cycle of the board, on the board's own clock; positive; constant. Jobs that are to keep
    /// their place in it are a whole number of such cycles apart.
    fn cycle(&self) -> Nanos;

    /// The longest that a call waits for the device or the kernel, beside its own processor time:
    /// the analysis of the schedule counts it as part of the job; constant.
    fn longest_wait(&self) -> Nanos {
        Nanos::ZERO
    }

    /// The phase of the job that was released at `release`, measured by the board's clock when the
    /// job reached it: how much later than its place in the board's cycle that was, negative when
    /// it was earlier. It lies between minus and plus half of [`BoardClock::cycle`]; what is
    /// farther away is nearer to the place of another cycle.
    ///
    /// A second call with the same `release` gives the same reading.
    ///
    /// # Errors
    /// [`Transient`](crate::ErrorKind::Transient): the clock could not be read this time.
    /// [`Stale`](crate::ErrorKind::Stale): the board has fallen silent.
    /// [`Lost`](crate::ErrorKind::Lost): the board is gone.
    fn sample(&mut self, release: Nanos) -> Result<Reading<Nanos>, Error>;
}

/// The phase of an instant on a board's clock: its distance from the nearest multiple of `cycle`,
/// positive after it. Instants are whole nanoseconds of any origin; a `cycle` that is not positive
/// has no phase, and gives 0.
#[must_use]
pub fn phase_in_cycle(instant_ns: u64, cycle: Nanos) -> Nanos {
    let Some(cycle_ns) = u64::try_from(cycle.0).ok().filter(|cycle_ns| *cycle_ns > 0) else {
        return Nanos::ZERO;
    };
    let after = (instant_ns % cycle_ns).cast_signed();
    if after > cycle.0 / 2 { Nanos(after - cycle.0) } else { Nanos(after) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_phase_is_the_distance_from_the_nearest_place() {
        let cycle = Nanos(1_000);
        for (instant, phase) in [(0, 0), (499, 499), (500, 500), (501, -499), (2_999, -1)] {
            assert_eq!(phase_in_cycle(instant, cycle), Nanos(phase), "{instant}");
        }
        assert_eq!(phase_in_cycle(u64::MAX, cycle), Nanos(-385));
        for none in [0, -5, i64::MIN] {
            assert_eq!(phase_in_cycle(7, Nanos(none)), Nanos::ZERO);
        }
        assert_eq!(phase_in_cycle(u64::MAX, Nanos::MAX).0, 1);
    }
}
