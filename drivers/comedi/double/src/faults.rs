//! Says which faults of a plan the double executes, and how: loss is a conversion that times out,
//! truncation a list that ends early, silence a busy board.

use taktil_hal::fault::FaultKind;

/// The kinds of faults that befall a board without a wire.
pub const EXECUTED_FAULTS: [FaultKind; 6] = [
    FaultKind::Loss,
    FaultKind::Truncation,
    FaultKind::Silence,
    FaultKind::Unplugged,
    FaultKind::Restart,
    FaultKind::Frozen,
];
