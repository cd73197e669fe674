//! How the world keeps up with a clock: in steps, with a bounded backlog, and with an account of
//! how late it was.

use std::fmt;

use taktil_hal::Nanos;

/// From one step of the world to the next, while no board has anything to do.
pub(crate) const STEP_TIME: Nanos = Nanos::from_micros(500);
/// Most of a backlog that is made up before the boards are served again.
const CATCH_UP_TIME: Nanos = Nanos::from_millis(10);
/// Longest backlog: what goes beyond is left out, and the world's time stands still meanwhile.
const BACKLOG_MAX: Nanos = Nanos::from_millis(100);
/// Steps that were done later than this are counted.
const LATE_TIME: Nanos = Nanos::from_millis(1);

/// How late the steps of the world were done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lateness {
    /// Steps that were done.
    pub steps: u64,
    /// Those that were done more than 1 ms after their instant.
    pub late_steps: u64,
    /// The longest time from a step's instant to its end.
    pub latest: Nanos,
    /// Time that was left out, because the backlog had grown too long.
    pub left_out: Nanos,
    /// How often that happened.
    pub pauses: u64,
}

impl fmt::Display for Lateness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} steps, {} of them more than 1 ms late, the latest {:.2} ms; left out {:.3} s in {} \
             pauses",
            self.steps,
            self.late_steps,
            self.latest.as_micros_f64() / 1e3,
            self.left_out.as_secs_f64(),
            self.pauses
        )
    }
}

/// The world's time by a clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    start: Nanos,
    pub(crate) lateness: Lateness,
}

impl Pace {
    /// The world's time is 0 at `start`.
    pub(crate) fn new(start: Nanos) -> Pace {
        Pace { start, lateness: Lateness::default() }
    }

    fn world_time(&self, clock: Nanos) -> Nanos {
        clock - self.start - self.lateness.left_out
    }

    /// How far the world, which stands at `world`, moves on at `clock`.
    pub(crate) fn target(&mut self, clock: Nanos, world: Nanos) -> Nanos {
        let backlog = self.world_time(clock) - world;
        if backlog > BACKLOG_MAX {
            self.lateness.left_out += backlog - BACKLOG_MAX;
            self.lateness.pauses += 1;
        }
        world + backlog.clamp(Nanos::ZERO, CATCH_UP_TIME)
    }

    /// The step whose instant was `planned` ended at `clock`.
    pub(crate) fn record(&mut self, clock: Nanos, planned: Nanos) {
        let late = self.world_time(clock) - planned;
        self.lateness.steps += 1;
        self.lateness.late_steps += u64::from(late > LATE_TIME);
        self.lateness.latest = self.lateness.latest.max(late);
    }

    /// How long until the world's time is `instant`.
    pub(crate) fn until(&self, clock: Nanos, instant: Nanos) -> Nanos {
        Nanos(instant.0.saturating_sub(self.world_time(clock).0)).max(Nanos::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_backlog_is_made_up_in_parts() {
        let mut pace = Pace::new(Nanos(7));
        let clock = Nanos(7) + Nanos::from_millis(35);
        let (mut world, mut parts) = (Nanos::ZERO, 0);
        while world < Nanos::from_millis(35) {
            world = pace.target(clock, world);
            parts += 1;
        }
        assert_eq!((world, parts), (Nanos::from_millis(35), 4));
        assert_eq!(pace.lateness.left_out, Nanos::ZERO);
    }

    #[test]
    fn what_goes_beyond_the_longest_backlog_is_left_out_and_told() {
        let mut pace = Pace::new(Nanos::ZERO);
        let clock = Nanos::from_secs(2);
        assert_eq!(pace.target(clock, Nanos::ZERO), CATCH_UP_TIME);
        assert_eq!(pace.lateness.left_out, clock - BACKLOG_MAX);
        assert_eq!(pace.lateness.pauses, 1);
        let mut world = CATCH_UP_TIME;
        while pace.target(clock, world) > world {
            world = pace.target(clock, world);
        }
        assert_eq!(pace.until(clock, world + Nanos(5)), Nanos(5));
        assert_eq!(world, BACKLOG_MAX);
        assert_eq!(pace.lateness.pauses, 1);
    }

    #[test]
    fn a_step_counts_as_late_by_its_end() {
        let mut pace = Pace::new(Nanos::ZERO);
        pace.record(Nanos::from_micros(900), Nanos::from_micros(500));
        pace.record(Nanos::from_micros(3_000), Nanos::from_micros(1_000));
        let seen = pace.lateness;
        assert_eq!((seen.steps, seen.late_steps), (2, 1));
        assert_eq!(seen.latest, Nanos::from_micros(2_000));
    }
}
