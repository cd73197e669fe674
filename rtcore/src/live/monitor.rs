//! Detects lanes that stand still, for the other lanes and for the carrying thread. Each thread
//! measures the others by its own progress and by the clock, whichever is less, so that a thread
//! that was stalled together with the watched lane raises no alarm. A slow lane cannot be
//! distinguished from a dead one except by a limit.

use taktil_hal::Nanos;

/// A lane that is watched.
#[derive(Clone, Copy, Debug)]
struct WatchedLane {
    limit: Nanos,
    /// Progress of the lane when it was seen to change last.
    mark: u64,
    /// Observations since then.
    looks: i64,
    /// When it was seen to change last.
    since: Nanos,
}

/// Largest number of observations that is counted: times the longest period it still fits an `i64`
/// of nanoseconds.
const OBSERVATIONS_MAX: i64 = 1 << 28;

/// What one thread knows of the progress of the lanes.
#[derive(Clone, Debug)]
pub(super) struct ProgressMonitor {
    /// Own progress that one observation stands for.
    step: Nanos,
    others: Vec<Option<WatchedLane>>,
}

impl ProgressMonitor {
    /// Watches the lanes that have a limit; each observation stands for `step` of own progress.
    pub(super) fn new(step: Nanos, limits: impl Iterator<Item = Option<Nanos>>) -> ProgressMonitor {
        let watched = |limit| WatchedLane { limit, mark: 0, looks: 0, since: Nanos::ZERO };
        ProgressMonitor { step, others: limits.map(|limit| limit.map(watched)).collect() }
    }

    /// Takes in the progress of every lane at `now`, `None` for a lane that need not make any, and
    /// returns the lanes that have stood still for longer than their limit, one bit each.
    pub(super) fn silent_lanes(
        &mut self,
        now: Nanos,
        progress: impl Fn(usize) -> Option<u64>,
    ) -> u32 {
        let mut silent = 0;
        for (index, other) in self.others.iter_mut().enumerate() {
            let Some(other) = other else { continue };
            match progress(index) {
                Some(mark) if mark == other.mark && other.looks > 0 => {
                    other.looks = (other.looks + 1).min(OBSERVATIONS_MAX);
                    let own = self.step * (other.looks - 1);
                    if own.min(now - other.since) >= other.limit {
                        silent |= 1u32.checked_shl(index as u32).unwrap_or(0);
                    }
                }
                mark => {
                    other.mark = mark.unwrap_or(other.mark);
                    other.looks = i64::from(mark.is_some());
                    other.since = now;
                }
            }
        }
        silent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: i64) -> Nanos {
        Nanos::from_millis(ms)
    }

    /// Watches one other lane, which may stand still for 50 ms, once in 5 ms.
    fn monitor() -> ProgressMonitor {
        ProgressMonitor::new(ms(5), [None, Some(ms(50))].into_iter())
    }

    #[test]
    fn a_lane_that_stands_still_is_seen_at_its_limit_and_again_alive() {
        let mut monitor = monitor();
        let silent: Vec<u32> =
            (0..14).map(|job| monitor.silent_lanes(ms(5 * job), |_| Some(7))).collect();
        assert_eq!(silent[..10], [0; 10]);
        assert_eq!(silent[10..], [2; 4], "from 50 ms after the first look");
        assert_eq!(monitor.silent_lanes(ms(70), |_| Some(8)), 0);
    }

    #[test]
    fn a_stall_of_all_lanes_is_not_the_silence_of_one() {
        let mut monitor = monitor();
        monitor.silent_lanes(ms(0), |_| Some(1));
        assert_eq!(monitor.silent_lanes(ms(60_000), |_| Some(1)), 0, "one own job in a minute");
        assert_eq!(monitor.silent_lanes(ms(60_005), |_| Some(2)), 0);
        // The jobs of a stall caught up back to back are progress, but no time.
        for _ in 0..1000 {
            assert_eq!(monitor.silent_lanes(ms(60_010), |_| Some(2)), 0);
        }
    }

    #[test]
    fn ended_and_progressing_lanes_are_not_silent() {
        let mut monitor = monitor();
        for job in 0..100 {
            assert_eq!(monitor.silent_lanes(ms(5 * job), |_| None), 0);
        }
        for job in 100..200 {
            assert_eq!(
                monitor.silent_lanes(ms(5 * job), |_| Some(job as u64 / 9)),
                0,
                "every 45 ms"
            );
        }
        assert_eq!(monitor.silent_lanes(Nanos::MAX, |_| Some(u64::MAX)), 0);
    }
}
