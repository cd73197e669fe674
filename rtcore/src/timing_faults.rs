//! How late the jobs of each lane begin, and how long they take, as a simulated host or the faults
//! of a plan say.

use taktil_hal::Nanos;
use taktil_hal::fault::{Fault, FaultKind};

/// When a job begins after its release, and how long it takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JobTiming {
    /// From its release to its begin; never negative.
    pub late: Nanos,
    /// From its begin to its end; never negative.
    pub took: Nanos,
}

/// A simulated host, on whose clock the jobs of a run in virtual time begin late and take long.
pub trait VirtualHost {
    /// How the job of lane number `lane` that is released at `release` is timed.
    fn timing(&mut self, lane: usize, release: Nanos) -> JobTiming;

    /// A job begins at `instant` of the host's clock: its release in logical time, what the pace by
    /// the clock of a board adds to it ([`crate::Builder::pace_from`]), and its lateness. Boards
    /// that are simulated beside the machine are moved to this instant here.
    fn begin(&mut self, instant: Nanos);
}

/// The faults of the timing of each lane.
#[derive(Clone, Debug, Default)]
pub(crate) struct TimingFaults {
    pub(crate) lanes: Vec<Vec<Fault>>,
}

/// Seconds as a span of time.
fn span(seconds: f64) -> Nanos {
    Nanos((seconds * 1e9) as i64)
}

impl TimingFaults {
    /// How the job of lane number `lane` released at `release` is timed.
    pub(crate) fn timing(&self, lane: usize, release: Nanos) -> JobTiming {
        let mut timing = JobTiming::default();
        for fault in self.lanes.get(lane).into_iter().flatten() {
            match fault.kind {
                FaultKind::Silence if fault.is_under_way(release) => {
                    timing.late = timing.late.max(fault.end() - release);
                }
                FaultKind::ClockGap => {
                    let end = fault.at + span(fault.value);
                    if fault.at <= release && release < end {
                        timing.late = timing.late.max(end - release);
                    }
                }
                FaultKind::Lateness if fault.is_under_way(release) => {
                    timing.late = timing.late.max(span(fault.value));
                }
                FaultKind::Overrun if fault.is_under_way(release) => {
                    timing.took = timing.took.max(span(fault.value));
                }
                _ => {}
            }
        }
        timing
    }

    /// Whether there is none.
    pub(crate) fn is_empty(&self) -> bool {
        self.lanes.iter().all(Vec::is_empty)
    }
}

/// A plan of faults as a host: a lane that it does not name is never late.
impl VirtualHost for TimingFaults {
    fn timing(&mut self, lane: usize, release: Nanos) -> JobTiming {
        TimingFaults::timing(self, lane, release)
    }

    fn begin(&mut self, _instant: Nanos) {}
}
