//! Makes a failing plan as small as it gets: takes faults out as long as the run still breaks the
//! same rule, then shortens those that are left.

use taktil_hal::Nanos;
use taktil_hal::fault::{Fault, FaultPlan};

use crate::case::Case;
use crate::run::run;

/// Runs that a plan may cost.
const RUNS_MAX: usize = 60;
/// Durations below this are not halved.
const DURATION_MIN: Nanos = Nanos::from_micros(2_500);

/// The smallest plan found that breaks the rule `rule`, and how many runs it took.
#[must_use]
pub fn shrink(case: &Case, rule: &str) -> (FaultPlan, usize) {
    shrink_by(case.plan.clone(), &mut |plan| {
        let outcome = run(&case.with_plan(plan.clone()));
        outcome.is_ok_and(|outcome| outcome.violations.iter().any(|one| one.rule == rule))
    })
}

/// The same for any judgement of a plan.
fn shrink_by(plan: FaultPlan, fails: &mut dyn FnMut(&FaultPlan) -> bool) -> (FaultPlan, usize) {
    let mut faults = plan.faults().to_vec();
    let mut runs = 0;
    let mut attempt = |faults: &[Fault]| {
        runs += 1;
        runs <= RUNS_MAX && fails(&FaultPlan::new(faults.to_vec()))
    };
    let mut index = 0;
    while index < faults.len() {
        let mut fewer = faults.clone();
        fewer.remove(index);
        if attempt(&fewer) {
            faults = fewer;
        } else {
            index += 1;
        }
    }
    for index in 0..faults.len() {
        loop {
            let duration = faults[index].duration;
            let half =
                if duration == Nanos::MAX { Nanos::from_secs(2) } else { Nanos(duration.0 / 2) };
            if half < DURATION_MIN {
                break;
            }
            let mut shorter = faults.clone();
            shorter[index].duration = half;
            if !attempt(&shorter) {
                break;
            }
            faults = shorter;
        }
    }
    (FaultPlan::new(faults), runs.min(RUNS_MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_hal::fault::FaultKind;

    #[test]
    fn the_one_fault_that_matters_is_left_and_short() {
        let texts = [
            "kind=frozen target=encoders.1 at=1 for=2",
            "kind=jump target=encoders.2 at=1 for=1 value=500",
            "kind=dead target=digital_in.2 at=2 for=1",
        ];
        let plan = FaultPlan::new(texts.map(|text| text.parse().unwrap()).to_vec());
        let jump = |fault: &Fault| {
            fault.kind == FaultKind::Jump && fault.duration >= Nanos::from_millis(100)
        };
        let (least, runs) = shrink_by(plan, &mut |plan| plan.faults().iter().any(jump));
        assert_eq!(least.faults().len(), 1);
        assert!(jump(&least.faults()[0]) && least.faults()[0].duration < Nanos::from_millis(200));
        assert!(runs < RUNS_MAX);
    }
}
