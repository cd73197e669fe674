//! Counters and histograms of a lane and its tasks. Every histogram is allocated before the first
//! job.

use hdrhistogram::Histogram;
use taktil_hal::Nanos;

use crate::fault::FaultSet;
use crate::misses::Misses;
use crate::release::GuardFigures;

/// Counters and histograms of one lane.
#[derive(Clone, Debug)]
pub struct Figures {
    /// Jobs that were run.
    pub jobs: u64,
    /// Jobs left out because the lane was more than a period late.
    pub skipped: u64,
    /// Actual start minus release, ns. In virtual time all zero.
    pub lateness_ns: Histogram<u64>,
    /// Start to end of a job on the clock, ns.
    pub execution_ns: Histogram<u64>,
    /// Jobs that ended after their deadline, by cause.
    pub misses: Misses,
    /// Misses at which the bucket was full: where the world does not wait, each stops the machine.
    pub storms: u64,
    /// Heap calls inside jobs; meaningful when `guard::installed`.
    pub allocations: u64,
    /// Page faults of the lane's thread during jobs.
    pub page_faults: u64,
    /// Records lost because the observer was slow.
    pub records_dropped: u64,
    /// Values lost because the reading lane made no progress.
    pub values_dropped: u64,
    /// Every fault that a task of this lane raised.
    pub faults: FaultSet,
    /// From waking to going to sleep again, without what the guard spun, ns: jobs and executor.
    pub awake_ns: Histogram<u64>,
    /// As `awake_ns`, of the cycles in which the kernel was asked for the evidence of misses.
    pub evidence_ns: Histogram<u64>,
    /// How late sleeps ended, ns: with a guard that is not how late jobs began.
    pub wake_ns: Histogram<u64>,
    /// What the guard did; absent without one.
    pub guard: Option<GuardFigures>,
    /// Task by task in order; empty when the lane declares no budgets and nobody asked.
    pub tasks: Vec<TaskFigures>,
}

/// Histogram of one task.
#[derive(Clone, Debug)]
pub struct TaskFigures {
    /// Its name.
    pub name: String,
    /// What it declared.
    pub budget: Option<Nanos>,
    /// From the end of the task before to its own end on the clock, ns: also what preempted it.
    pub execution_ns: Histogram<u64>,
}

impl TaskFigures {
    pub(crate) fn new(name: &str, budget: Option<Nanos>) -> TaskFigures {
        TaskFigures { name: name.to_owned(), budget, execution_ns: histogram() }
    }
}

/// A histogram from 1 ns to [`HISTOGRAM_MAX_NS`] at two digits: 3 968 counters, allocated here and
/// never again.
fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, HISTOGRAM_MAX_NS, 2).expect("constant bounds are valid")
}

/// Ten times the longest period (ns). What takes longer is counted as this.
const HISTOGRAM_MAX_NS: u64 = 100_000_000_000;

impl Figures {
    pub(crate) fn new() -> Figures {
        Figures {
            jobs: 0,
            skipped: 0,
            lateness_ns: histogram(),
            execution_ns: histogram(),
            misses: Misses::default(),
            storms: 0,
            allocations: 0,
            page_faults: 0,
            records_dropped: 0,
            values_dropped: 0,
            faults: FaultSet::NONE,
            awake_ns: histogram(),
            evidence_ns: histogram(),
            wake_ns: histogram(),
            guard: None,
            tasks: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::PERIOD_MAX;

    #[test]
    fn what_a_legal_lane_may_take_is_counted_as_it_is() {
        let mut figures = Figures::new();
        for span in [400_000_000, PERIOD_MAX.0.unsigned_abs(), HISTOGRAM_MAX_NS] {
            figures.execution_ns.saturating_record(span);
            let most = figures.execution_ns.max() as f64 / span as f64;
            assert!((1.0..1.01).contains(&most), "{span} ns is counted as {most} of it");
        }
        figures.execution_ns.saturating_record(u64::MAX);
        assert!(figures.execution_ns.max() < 2 * HISTOGRAM_MAX_NS);
    }
}
