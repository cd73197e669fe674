//! The reasons why the contact on a row of slices has no solution.

use super::super::{Prescribed, Refusal, Why};

/// Why a row has no solution.
#[derive(Clone, Copy, Debug)]
pub(super) enum SolveFailure {
    /// The contact lies beyond the row's tables.
    BeyondTable,
    /// The contact fills a row that is not the whole pin; the last penetration at the origin, in
    /// thicknesses.
    RowFilled(f64),
    /// The contact did not converge; the remaining part of the penetration.
    Unconverged(f64),
    /// The linear system of the slices is not positive definite.
    Indefinite,
}

impl SolveFailure {
    /// The refusal that tells the caller what was asked for in vain.
    pub(super) fn refusal(self, prescribed: Prescribed) -> Refusal {
        match self {
            Self::BeyondTable | Self::RowFilled(_) => {
                Refusal::new(prescribed.place(), Why::BeyondTable)
            }
            Self::Unconverged(left) => Refusal::new("length_mm", Why::Unconverged(left)),
            Self::Indefinite => Refusal::new(prescribed.place(), Why::Indefinite),
        }
    }
}
