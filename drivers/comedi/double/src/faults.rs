//! Says which faults of a plan the double executes, and how: loss is a conversion that times out,
//! truncation a list that ends early, silence a busy board.

use taktil_hal::Invalid;
use taktil_hal::fault::{FaultKind, FaultPlan};

/// The kinds of faults that befall a board without a wire.
pub const EXECUTED_FAULTS: [FaultKind; 6] = [
    FaultKind::Loss,
    FaultKind::Truncation,
    FaultKind::Silence,
    FaultKind::Unplugged,
    FaultKind::Restart,
    FaultKind::Frozen,
];

/// Checks that the double can execute what a plan holds for the board of this name.
///
/// # Errors
/// The first fault that it cannot.
pub fn check_plan(plan: &FaultPlan, name: &str) -> Result<(), Invalid> {
    let ours = |target: &str| target.is_empty() || target == name;
    for fault in plan.faults() {
        if ours(&fault.target) && !EXECUTED_FAULTS.contains(&fault.kind) {
            let what = format!("`{}` has no meaning without a wire", fault.kind.name());
            let known = EXECUTED_FAULTS.map(FaultKind::name).join(", ");
            return Err(Invalid::new("kind", what, format!("it is one of: {known}")));
        }
    }
    Ok(())
}
