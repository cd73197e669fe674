//! Memory of the linear solvers, which find the pressure at given widths: a dense factor for
//! contacts of few unknowns, conjugate gradients for others.

use super::conjugate_gradients::ConjugateGradients;
use super::coupling::ModeSums;
use super::dense::DenseSystem;
use super::row::SliceRow;

/// Memory of the linear solvers of one row.
#[derive(Clone, Debug)]
pub(super) struct LinearSolver {
    pub(super) dense: DenseSystem,
    pub(super) gradients: ConjugateGradients,
    /// Memory of the coupling's convolution.
    pub(super) sums: ModeSums,
}

impl LinearSolver {
    /// Memory for a row, with room for a dense system of so many unknowns at least; allocates.
    pub(super) fn new(row: &SliceRow, unknowns: usize) -> Self {
        let (slices, n) = (row.along.len(), row.strips.layout.cosines);
        Self {
            dense: DenseSystem::new(slices, n, row.strips.is_free(), unknowns),
            gradients: ConjugateGradients::new(slices, n),
            sums: row.coupling.sums(slices),
        }
    }
}
