//! Tables of contacts that are solved when a pin is made.

pub(super) mod end;
pub(super) mod end_correction;
pub(super) mod full_length;
pub(super) mod levinson;
pub(super) mod light_load;

use super::row::SliceRow;
use super::state::ContactState;
use end_correction::{CorrectionForce, EndCorrection, correction_force};
use full_length::FullLengthTable;
use levinson::LevinsonTable;

/// The tables of one row.
#[derive(Clone, Debug, Default)]
pub(super) struct ContactTables {
    /// All contacts of a bar.
    pub(super) levinson: Option<LevinsonTable>,
    /// Contacts of a cylinder on a good part of its length.
    pub(super) full_length: Option<FullLengthTable>,
    /// Correction of the pressure at an end.
    pub(super) end_correction: Option<EndCorrection>,
}

impl ContactTables {
    /// Force and moment of the row's end correction; 0 where it has none.
    pub(super) fn correction_force(&self, row: &SliceRow, state: &ContactState) -> CorrectionForce {
        correction_force(self.end_correction.as_ref(), row, state)
    }
}
