//! A row of slices with the contact on it: geometry, state, the memory of the solvers, and tables.

use super::super::super::Invalid;
use super::free_boundary::{NonlinearSolver, StepLimits};
use super::linear::LinearSolver;
use super::pose::PinState;
use super::row::{RowPlan, SliceRow};
use super::state::ContactState;
use super::tables::ContactTables;
use super::tables::levinson::LevinsonTable;
use core::f64::consts::PI;

/// Length in thicknesses below which the slices of a row act on each other so much that their
/// contacts take more and smaller steps.
const SHORT_ROW_LENGTH: f64 = 6.0;
/// Factor of the number of steps of a short row.
const SHORT_ROW_STEPS: usize = 3;
/// Part of a row that a contact may fill.
pub(super) const ROW_FILL_MAX: f64 = 0.92;
/// Part of a row below which a contact moves to a shorter row.
pub(super) const ROW_FILL_MIN: f64 = 0.45;

/// A row of slices with the contact on it.
#[derive(Clone, Debug)]
pub(super) struct RowContact {
    pub(super) row: SliceRow,
    pub(super) state: ContactState,
    pub(super) linear: LinearSolver,
    pub(super) nonlinear: NonlinearSolver,
    pub(super) tables: ContactTables,
}

impl RowContact {
    /// A row without contact, and the table of a bar where it has one; allocates.
    ///
    /// # Errors
    /// What [`SliceRow::new`] refuses.
    pub(super) fn new(plan: RowPlan<'_>) -> Result<Self, Invalid> {
        let row = SliceRow::new(plan)?;
        let (slices, is_free) = (row.along.len(), row.strips.is_free());
        let resolution = row.resolution;
        let has_table = resolution.bar.is_some() && !is_free;
        let levinson = has_table
            .then(|| LevinsonTable::new(&row.strips, &row.pair_blocks, &row.along))
            .flatten();
        let state = ContactState::new(slices, &row.strips, row.coupling.transform_len());
        let is_short = row.length < SHORT_ROW_LENGTH;
        let steps = if is_short { SHORT_ROW_STEPS * resolution.steps } else { resolution.steps };
        let limits = StepLimits { tolerance: resolution.tolerance, steps };
        let mut nonlinear = NonlinearSolver::new(slices, limits);
        if resolution.has_slice_relaxation && is_free {
            nonlinear.enable_slice_relaxation();
        }
        if is_short {
            nonlinear.enable_relaxation();
        }
        let linear = LinearSolver::new(&row, row.dense_unknowns);
        let tables = ContactTables { levinson, ..ContactTables::default() };
        Ok(Self { row, state, linear, nonlinear, tables })
    }

    /// Lifts off and forgets the contact.
    pub(super) fn release(&mut self) {
        self.state.clear();
        self.nonlinear.stiffness = 0.0;
        self.linear.gradients.clear();
    }

    /// Whether the contact fills a row that is not the whole pin.
    pub(super) fn is_full(&self) -> bool {
        self.row.is_partial && self.state.active[0]
    }

    /// The state of the contact at a penetration (thicknesses) of the origin, which the next one
    /// may start from.
    pub(super) fn pin_state(&mut self, penetration: f64, residual: f64, steps: usize) -> PinState {
        let (row, contact) = (&self.row, &mut self.state);
        let (t, n) = (row.layer.thickness_mm, contact.layout.cosines);
        let scale = row.modulus_mpa() * t * t;
        let penetration_mm = penetration * t;
        let mut state = PinState { penetration_mm, residual, steps, ..PinState::default() };
        for (j, v) in row.along.iter().enumerate() {
            if contact.active[j] {
                let force = PI * contact.a[j * n] * row.h * scale;
                state.force_n += force;
                state.moment_n_mm += force * v * t;
                state.half_width_mm = state.half_width_mm.max(contact.widths[j] * t);
                state.length_mm += row.h * t;
            }
        }
        let correction = self.tables.correction_force(row, contact);
        state.force_n += correction.force * scale;
        state.moment_n_mm += correction.moment * scale * t;
        contact.is_warm = state.force_n > 0.0;
        state
    }
}

/// Index of the shortest row that holds a contact of a length; rows become shorter.
pub(super) fn shortest_row_for(rows: &[RowContact], contact_length: f64) -> usize {
    let holds = |contact: &&RowContact| contact_length < ROW_FILL_MAX * contact.row.length;
    rows.iter().take_while(holds).count().saturating_sub(1)
}
