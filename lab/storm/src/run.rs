//! Runs one case: the production code assembled as for a run in virtual time, the storm's operator,
//! the faults of the plan, the checkers beside it.

use std::panic::{AssertUnwindSafe, catch_unwind};

use taktil_hal::Nanos;
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::run_virtual;
use taktil_machine::source::Located;
use taktil_record::digest::Digest;
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{Machine, guard};

use crate::case::Case;
use crate::check::{ArmLimits, Judge, PathPoint, Violation};
use crate::evidence::Evidence;
use crate::operator::StormOperator;

/// What a case came to.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Its seed.
    pub seed: u64,
    /// One number over all records: equal for equal cases, in any build.
    pub digest: String,
    /// The rules that were broken.
    pub violations: Vec<Violation>,
    /// Modes, states and first faults in order.
    pub path: Vec<PathPoint>,
    /// Simulated time.
    pub length: Nanos,
}

/// Hands each record to two observers.
struct Both<'a, A: ?Sized, B: ?Sized>(&'a mut A, &'a mut B);

impl<A: Observer + ?Sized, B: Observer + ?Sized> Observer for Both<'_, A, B> {
    fn record(&mut self, record: &Record<'_>) {
        self.0.record(record);
        self.1.record(record);
    }
}

/// Sees nothing.
struct NoObserver;

impl Observer for NoObserver {
    fn record(&mut self, _: &Record<'_>) {}
}

/// Runs a case.
///
/// # Errors
/// A machine that cannot be built with the case's faults, located.
pub fn run(case: &Case) -> Result<Outcome, Located> {
    let mut machine = machine(case)?;
    Ok(run_machine(case, &mut machine, &mut NoObserver))
}

/// The machine of a case, with its operator and its faults.
///
/// # Errors
/// One that cannot be built with these faults, located.
pub(crate) fn machine(case: &Case) -> Result<Machine, Located> {
    let (seed, touch) = (case.seed, case.has_touch());
    let (plan, calm_from) = (&case.plan, case.calm_from);
    Assembly::new(&case.scene)
        .with_seed(seed)
        .with_faults(plan)
        .with_operator(Box::new(move |ports| {
            Ok(Box::new(StormOperator::new(seed, plan, calm_from, touch, ports)))
        }))
        .build()
}

/// Runs the machine of a case before its checkers and before an observer, who changes nothing.
pub(crate) fn run_machine(
    case: &Case,
    machine: &mut Machine,
    observer: &mut dyn Observer,
) -> Outcome {
    let actuate = case.scene.machine.actuate.as_ref();
    let limits = actuate.and_then(|actuate| actuate.torque_limit_nm.as_deref());
    let arm = ArmLimits::new(limits)
        .at_home(&case.scene.start_deg, case.has_touch())
        .jogged_at(case.scene.machine.jog.as_ref().map(|jog| jog.speed));
    let judge = Judge::new(case, arm);
    let mut evidence = Evidence::new(machine.catalog(), judge);
    let mut digest = Digest::new(machine.catalog());
    let mut beside = Both(&mut digest, observer);
    let mut both = Both(&mut evidence, &mut beside);
    // A panic outside the tasks is a finding like any other.
    let ran = catch_unwind(AssertUnwindSafe(|| run_virtual(machine, case.until, &mut both)));
    evidence.finish();
    let judge = &mut evidence.witness;
    judge.finish();
    match ran {
        Ok(Ok(())) => {}
        Ok(Err(error)) => {
            judge.findings.report("the machine starts", Nanos::ZERO, || error.to_string());
        }
        Err(_) => judge.findings.report("nothing panics", case.until, String::new),
    }
    let heap_calls: u64 = machine.figures().map(|(_, figures)| figures.allocations).sum();
    if guard::installed() && heap_calls > 0 && !judge.has_panicked() {
        judge
            .findings
            .report("no job allocates", case.until, || format!("{heap_calls} heap calls"));
    }
    Outcome {
        seed: case.seed,
        digest: digest.hex(),
        violations: judge.findings.violations.clone(),
        path: core::mem::take(&mut judge.path),
        length: case.until,
    }
}
