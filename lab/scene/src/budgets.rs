//! Compares the time of each task with its declared budget, and suggests a budget. In a run whose
//! timing is not representative the suggestion follows a percentile, because there the longest step
//! contains stalls of the host.

use taktil_record::summary::TaskSummary;
use taktil_rtcore::{Figures, TaskFigures};

use super::statistics::percentiles_us;

/// Number of steps from which on the 99.9th percentile does not depend on a single stall of the
/// host.
const STEPS_FOR_P99_9: u64 = 10_000;

/// The tasks of a lane; an empty list when they were not timed.
pub(super) fn task_summaries(lane: &Figures, representative: bool) -> Vec<TaskSummary> {
    lane.tasks.iter().map(|task| task_summary(task, representative)).collect()
}

fn task_summary(task: &TaskFigures, representative: bool) -> TaskSummary {
    let (basis_ns, from) = if representative {
        (task.execution_ns.max(), "max x 1.5")
    } else if task.execution_ns.len() < STEPS_FOR_P99_9 {
        (task.execution_ns.value_at_quantile(0.99), "p99 x 1.5")
    } else {
        (task.execution_ns.value_at_quantile(0.999), "p99.9 x 1.5")
    };
    let measured = !task.execution_ns.is_empty();
    TaskSummary {
        name: task.name.clone(),
        budget_us: task.budget.map(|budget| budget.0 / 1000),
        exec_us: percentiles_us(&task.execution_ns),
        suggested_us: measured.then(|| suggested_us(basis_ns)),
        suggested_from: from.to_owned(),
    }
}

/// One and a half times the duration, rounded up to whole microseconds.
fn suggested_us(ns: u64) -> u64 {
    ns.saturating_mul(3).div_ceil(2000).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suggestions_are_rounded_up_and_never_nothing() {
        assert_eq!(suggested_us(0), 1);
        assert_eq!(suggested_us(10_000), 15);
        assert_eq!(suggested_us(10_001), 16);
        assert_eq!(suggested_us(u64::MAX), u64::MAX.div_ceil(2000));
    }
}
