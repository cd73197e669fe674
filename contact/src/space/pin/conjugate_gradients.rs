//! Solves for the pressure of a row's slices at given widths by conjugate gradients, preconditioned
//! by each slice's own system.

use super::coupling::ModeSums;
use super::failure::SolveFailure;
use super::row::SliceRow;
use super::state::ContactState;
use crate::numeric::cholesky::{factor, solve};
use core::f64::consts::PI;

/// Most iterations of one solution.
const ITERATIONS_MAX: usize = 200;
/// The residual is measured by the work of at most this many slices as deep as the deepest.
const MEASURED_SLICES_MAX: f64 = 4.0;
/// Relative difference of width up to which a slice's preconditioner block is used again.
const BLOCK_WIDTH_TOLERANCE: f64 = 0.02;

/// Memory of the iterations, slice after slice.
#[derive(Clone, Debug)]
pub(super) struct ConjugateGradients {
    residual: Vec<f64>,
    preconditioned: Vec<f64>,
    direction: Vec<f64>,
    /// The system's matrix times the direction.
    image: Vec<f64>,
    /// Each slice's own system, factored.
    blocks: Vec<f64>,
    /// Half-widths that the blocks were factored for; 0 where there is none.
    block_widths: Vec<f64>,
}

impl ConjugateGradients {
    /// Memory for so many slices of so many cosines; allocates.
    pub(super) fn new(slices: usize, cosines: usize) -> Self {
        let zeros = |count: usize| vec![0.0; slices * count];
        Self {
            residual: zeros(cosines),
            preconditioned: zeros(cosines),
            direction: zeros(cosines),
            image: zeros(cosines),
            blocks: zeros(cosines * cosines),
            block_widths: zeros(1),
        }
    }

    /// Forgets the blocks.
    pub(super) fn clear(&mut self) {
        self.block_widths.fill(0.0);
    }

    /// Factors each slice's own system at about its present width.
    fn update_blocks(&mut self, row: &SliceRow, state: &ContactState) -> Result<(), SolveFailure> {
        let (layout, n) = (state.layout, state.layout.cosines);
        for j in 0..state.active.len() {
            let off = (self.block_widths[j] - state.widths[j]).abs();
            if !state.active[j] || off <= BLOCK_WIDTH_TOLERANCE * state.widths[j] {
                continue;
            }
            self.block_widths[j] = 0.0;
            let table = &state.rows[j * layout.len()..(j + 1) * layout.len()];
            let per = state.transform_len;
            let transform = &state.transforms[j * per..(j + 1) * per];
            let block = &mut self.blocks[j * n * n..(j + 1) * n * n];
            for k in 0..n {
                for l in 0..=k {
                    block[k * n + l] = table[layout.matrix(k, l)];
                }
            }
            row.coupling.add_block(transform, block);
            if !factor(block, n) {
                return Err(SolveFailure::Indefinite);
            }
            self.block_widths[j] = state.widths[j];
        }
        Ok(())
    }

    /// Writes the image of the direction, or of the pressure, under the system's matrix on the
    /// slices that touch.
    fn apply(
        &mut self,
        row: &SliceRow,
        state: &ContactState,
        sums: &mut ModeSums,
        of_direction: bool,
    ) {
        let (layout, n) = (state.layout, state.layout.cosines);
        let input = if of_direction { &self.direction } else { &state.a };
        self.image.fill(0.0);
        let touches = |touches: &bool| *touches;
        let from = state.active.iter().position(touches).unwrap_or(0);
        let to = state.active.iter().rposition(touches).map_or(from, |last| last + 1);
        let (span, per) = (from * n..to * n, state.transform_len);
        let transforms = &state.transforms[from * per..to * per];
        row.coupling.apply(sums, transforms, &input[span.clone()], &mut self.image[span]);
        for j in 0..state.active.len() {
            let out = &mut self.image[j * n..(j + 1) * n];
            if !state.active[j] {
                out.fill(0.0);
                continue;
            }
            let table = &state.rows[j * layout.len()..(j + 1) * layout.len()];
            let own = &input[j * n..(j + 1) * n];
            for k in 0..n {
                out[k] += table[layout.matrix(k, k)] * own[k];
                for l in 0..k {
                    let entry = table[layout.matrix(k, l)];
                    out[k] += entry * own[l];
                    out[l] += entry * own[k];
                }
            }
        }
    }

    /// Writes the residual of the pressure; the scale of its work.
    fn update_residual(&mut self, state: &ContactState) -> f64 {
        let (layout, n) = (state.layout, state.layout.cosines);
        let (mut size, mut most) = (0.0, 0.0_f64);
        for j in 0..state.active.len() {
            let span = j * n..(j + 1) * n;
            if !state.active[j] {
                self.residual[span].fill(0.0);
                continue;
            }
            let table = &state.rows[j * layout.len()..(j + 1) * layout.len()];
            for k in 0..n {
                let given = if k == 0 { PI * state.given[j] } else { 0.0 };
                self.residual[j * n + k] = given - table[layout.shape(k)] - self.image[j * n + k];
            }
            let own = (PI * state.given[j]) * state.a[j * n];
            size += own;
            most = most.max(own.abs());
        }
        // A long pin's own work would hide the error of its end.
        size.abs().min(MEASURED_SLICES_MAX * most)
    }

    /// Solves for the pressure at the present widths; the remaining error in parts of the
    /// pressure's work, 0 within the tolerance.
    ///
    /// # Errors
    /// A system that is not positive definite.
    pub(super) fn solve(
        &mut self,
        row: &SliceRow,
        state: &mut ContactState,
        sums: &mut ModeSums,
        tolerance: f64,
    ) -> Result<f64, SolveFailure> {
        self.update_blocks(row, state)?;
        self.apply(row, state, sums, false);
        let size = self.update_residual(state);
        let limit = tolerance * tolerance * size;
        let mut before = self.precondition(state);
        self.direction.copy_from_slice(&self.preconditioned);
        for _ in 0..ITERATIONS_MAX {
            if before <= limit {
                break;
            }
            self.apply(row, state, sums, true);
            let curvature: f64 = self.direction.iter().zip(&self.image).map(|(a, b)| a * b).sum();
            if curvature.is_nan() {
                return Err(SolveFailure::Indefinite);
            }
            if curvature <= 0.0 {
                break;
            }
            let length = before / curvature;
            for (a, d) in state.a.iter_mut().zip(&self.direction) {
                *a += length * d;
            }
            for (r, i) in self.residual.iter_mut().zip(&self.image) {
                *r -= length * i;
            }
            let after = self.precondition(state);
            let factor = after / before;
            for (d, z) in self.direction.iter_mut().zip(&self.preconditioned) {
                *d = z + factor * *d;
            }
            before = after;
        }
        // Where nothing presses, the error is that of rounding.
        Ok(if before <= limit { 0.0 } else { (before / size).sqrt() })
    }

    /// Solves each slice's own system for the residual; the square of the residual in that norm.
    fn precondition(&mut self, state: &ContactState) -> f64 {
        let n = state.layout.cosines;
        self.preconditioned.copy_from_slice(&self.residual);
        for j in 0..state.active.len() {
            if state.active[j] {
                let block = &self.blocks[j * n * n..(j + 1) * n * n];
                solve(block, n, &mut self.preconditioned[j * n..(j + 1) * n]);
            }
        }
        self.preconditioned.iter().zip(&self.residual).map(|(a, b)| a * b).sum()
    }
}
