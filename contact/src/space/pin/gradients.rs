//! Pressures of a row's slices at given widths by conjugate gradients, steered by each slice's own
//! system.
//!
//! It refuses slices whose own system is not positive definite.

use super::row::Row;
use super::work::Trouble;
use crate::numeric::cholesky::{factor, solve};
use core::f64::consts::PI;

/// Most iterations of conjugate gradients in one step.
const GRADIENTS_MAX: usize = 200;
/// Slices, as deep as the deepest, whose work the residual is measured by at most.
const LOCAL: f64 = 4.0;
/// Part of a width by which a block that steers gradients may be of another one.
const ALIKE: f64 = 0.02;

impl Row {
    /// Each slice's own system at about its present width, which steers the gradients.
    fn block(&mut self) -> Result<(), Trouble> {
        let work = &mut self.work;
        let (places, n) = (work.places, work.places.cosines);
        for j in 0..work.active.len() {
            let off = (work.blocked[j] - work.widths[j]).abs();
            if !work.active[j] || off <= ALIKE * work.widths[j] {
                continue;
            }
            work.blocked[j] = 0.0;
            let row = &work.rows[j * places.len()..(j + 1) * places.len()];
            let transform = &work.transforms[j * work.transform..(j + 1) * work.transform];
            let block = &mut work.blocks[j * n * n..(j + 1) * n * n];
            for k in 0..n {
                for l in 0..=k {
                    block[k * n + l] = row[places.matrix(k, l)];
                }
            }
            self.coupling.add_block(transform, block);
            if !factor(block, n) {
                return Err(Trouble::Indefinite);
            }
            work.blocked[j] = work.widths[j];
        }
        Ok(())
    }

    /// out = the exact layer's matrix times input, on the active slices.
    fn apply(&mut self, of_direction: bool) {
        let work = &mut self.work;
        let (places, n) = (work.places, work.places.cosines);
        let input = if of_direction { &work.direction } else { &work.a };
        work.image.fill(0.0);
        let touches = |touches: &bool| *touches;
        let from = work.active.iter().position(touches).unwrap_or(0);
        let to = work.active.iter().rposition(touches).map_or(from, |last| last + 1);
        let (span, per) = (from * n..to * n, work.transform);
        let transforms = &work.transforms[from * per..to * per];
        self.coupling.act(transforms, &input[span.clone()], &mut work.image[span]);
        for j in 0..work.active.len() {
            let out = &mut work.image[j * n..(j + 1) * n];
            if !work.active[j] {
                out.fill(0.0);
                continue;
            }
            let row = &work.rows[j * places.len()..(j + 1) * places.len()];
            let own = &input[j * n..(j + 1) * n];
            for k in 0..n {
                out[k] += row[places.matrix(k, k)] * own[k];
                for l in 0..k {
                    let entry = row[places.matrix(k, l)];
                    out[k] += entry * own[l];
                    out[l] += entry * own[k];
                }
            }
        }
    }

    /// Preconditioned conjugate gradients for the pressure at the present widths; what is left, in
    /// parts of the pressure's work.
    pub(super) fn gradients(&mut self, tolerance: f64) -> Result<f64, Trouble> {
        self.block()?;
        let (places, n) = (self.work.places, self.work.places.cosines);
        self.apply(false);
        let work = &mut self.work;
        let (mut size, mut most) = (0.0, 0.0_f64);
        for j in 0..work.active.len() {
            let span = j * n..(j + 1) * n;
            if !work.active[j] {
                work.residual[span].fill(0.0);
                continue;
            }
            let row = &work.rows[j * places.len()..(j + 1) * places.len()];
            for k in 0..n {
                let given = if k == 0 { PI * work.given[j] } else { 0.0 };
                work.residual[j * n + k] = given - row[places.shape(k)] - work.image[j * n + k];
            }
            let own = (PI * work.given[j]) * work.a[j * n];
            size += own;
            most = most.max(own.abs());
        }
        // An end of a long pin is not lost in the rest of it.
        let size = size.abs().min(LOCAL * most);
        let limit = tolerance * tolerance * size;
        let mut before = self.cure();
        self.work.direction.copy_from_slice(&self.work.cured);
        for _ in 0..GRADIENTS_MAX {
            if before <= limit {
                break;
            }
            self.apply(true);
            let work = &mut self.work;
            let curvature: f64 = work.direction.iter().zip(&work.image).map(|(a, b)| a * b).sum();
            if curvature.is_nan() {
                return Err(Trouble::Indefinite);
            }
            if curvature <= 0.0 {
                break;
            }
            let length = before / curvature;
            for (a, d) in work.a.iter_mut().zip(&work.direction) {
                *a += length * d;
            }
            for (r, i) in work.residual.iter_mut().zip(&work.image) {
                *r -= length * i;
            }
            let after = self.cure();
            let factor = after / before;
            let work = &mut self.work;
            for (d, z) in work.direction.iter_mut().zip(&work.cured) {
                *d = z + factor * *d;
            }
            before = after;
        }
        // As good as rounding lets it be when there is nothing to press.
        Ok(if before <= limit { 0.0 } else { (before / size).sqrt() })
    }

    /// Solves each slice alone for the residual; the residual's size in that norm.
    fn cure(&mut self) -> f64 {
        let work = &mut self.work;
        let n = work.places.cosines;
        work.cured.copy_from_slice(&work.residual);
        for j in 0..work.active.len() {
            if work.active[j] {
                let block = &work.blocks[j * n * n..(j + 1) * n * n];
                solve(block, n, &mut work.cured[j * n..(j + 1) * n]);
            }
        }
        work.cured.iter().zip(&work.residual).map(|(a, b)| a * b).sum()
    }
}
