//! Computes the base's normal stress from its reactions, and the compliances of the surface for the
//! contact solver in the plane. The functions allocate.

use super::layer::{Elements, Response};
use super::right_sides::RightSides;
use crate::Invalid;
use crate::numeric::band::SIDES_AT_ONCE;
use crate::plane::compliance::{CELLS_MAX, SurfaceCompliance};

impl<const D: usize> Elements<D> {
    /// Normal stress at the base's nodes in MPa, column by column. With order 1 it is each reaction
    /// over the length or area that its node represents, which keeps every force and moment and
    /// converges at second order. With order 2, whose nodes represent unequal parts, it is the
    /// smooth stress whose integrals with the hat functions of the corners are those of the
    /// reactions. The edges of the mesh have to be straight at the base.
    #[must_use]
    pub fn base_szz_mpa(&self, response: &Response<D>) -> Vec<f64> {
        let mesh = self.mesh();
        let mut out: Vec<f64> = response.reactions.iter().map(|r| -r[D - 1]).collect();
        if mesh.order == 1 {
            out.iter_mut().zip(mesh.base_weights()).for_each(|(force, share)| *force /= share);
            return out;
        }
        let mut stride = out.len();
        for axis in 0..D - 1 {
            let x = mesh.line_mm(axis);
            stride /= x.len();
            let mut line = vec![0.0; x.len()];
            for first in 0..out.len() / x.len() {
                // The lines along this axis start at every place of the other one.
                let start = first / stride * stride * x.len() + first % stride;
                for (i, value) in line.iter_mut().enumerate() {
                    *value = out[start + i * stride];
                }
                recover_nodal_values(&x, mesh.rollers[axis], &mut line);
                for (i, value) in line.iter().enumerate() {
                    out[start + i * stride] = *value;
                }
            }
        }
        out
    }
}

/// From the integrals of a smooth function with the shape functions of order 2 along a line to its
/// values at the nodes. A parabola through three corners stands for the function under the hat of
/// the middle one; it is mirrored at rollers, and under the half hat at a free end a straight line.
fn recover_nodal_values(x: &[f64], rollers: [bool; 2], line: &mut [f64]) {
    let count = x.len() / 2 + 1;
    let at = |corner: usize| x[2 * corner];
    // Rows of the tridiagonal system: before, here, after, right side.
    let mut rows = vec![[0.0; 4]; count];
    for (k, row) in rows.iter_mut().enumerate() {
        let middle = |k: usize| 0.5 * line.get(k).copied().unwrap_or(0.0);
        let left = if k == 0 { 0.0 } else { middle(2 * k - 1) };
        let hat = line[2 * k] + left + middle(2 * k + 1);
        let before = if k > 0 { at(k) - at(k - 1) } else { at(1) - at(0) };
        let after = if k + 1 < count { at(k + 1) - at(k) } else { before };
        let end = [k == 0, k + 1 == count];
        let mirrored = end.iter().zip(rollers).any(|(end, roller)| *end && roller);
        if (end[0] || end[1]) && !mirrored {
            let near = before / 6.0;
            *row = [if end[0] { 0.0 } else { near }, 2.0 * near, near, hat];
            if end[1] {
                row[2] = 0.0;
            }
            continue;
        }
        // Moments of the hat about its corner, and the parabola's two derivatives there.
        let m0 = 0.5 * (before + after);
        let m1 = (after * after - before * before) / 6.0;
        let m2 = (after * after * after + before * before * before) / 24.0;
        let both = before + after;
        let low = -m1 * after / (before * both) + 2.0 * m2 / (before * both);
        let high = m1 * before / (after * both) + 2.0 * m2 / (after * both);
        *row = [low, m0 - low - high, high, hat];
        if mirrored {
            // At an end on rollers half of the hat function lies beyond the mesh.
            let (one, sum) = (0.5 * row[1], 0.5 * (low + high));
            *row = if end[0] { [0.0, one, sum, hat] } else { [sum, one, 0.0, hat] };
        }
    }
    for k in 1..count {
        let [_, pivot, above, side] = rows[k - 1];
        let factor = rows[k][0] / pivot;
        rows[k][1] -= factor * above;
        rows[k][3] -= factor * side;
    }
    for k in (0..count).rev() {
        let next = if k + 1 < count { rows[k][2] * line[2 * k + 2] } else { 0.0 };
        line[2 * k] = (rows[k][3] - next) / rows[k][1];
    }
    for k in 0..count - 1 {
        // A cubic through four corners; near an end through those that exist.
        let from = if k == 0 { 0 } else { k - 1 };
        let to = (k + 2).min(count - 1);
        let place = x[2 * k + 1];
        let part = |i: usize| {
            let others = (from..=to).filter(|j| *j != i);
            others.fold(line[2 * i], |value, j| value * (place - at(j)) / (at(i) - at(j)))
        };
        line[2 * k + 1] = (from..=to).map(part).sum();
    }
}

impl Elements<2> {
    /// The compliances of the surface's nodes, for the contact solver.
    ///
    /// # Errors
    /// More nodes than [`CELLS_MAX`].
    pub fn compliance(&self) -> Result<SurfaceCompliance, Invalid> {
        let n = self.mesh().columns();
        if n > CELLS_MAX {
            let what = format!("{n} nodes on the surface");
            let remedy = "give at most 1000: 999 elements of order 1 along, 499 of order 2";
            return Err(Invalid::new("mesh", what, remedy));
        }
        let top = self.mesh().counts()[1] - 1;
        let zeros = || vec![0.0; n * n];
        let mut compliance = SurfaceCompliance {
            x_mm: self.mesh().row_mm(top),
            width_mm: self.mesh().widths_mm(top),
            down_per_p: zeros(),
            down_per_q: zeros(),
            along_per_p: zeros(),
            along_per_q: zeros(),
        };
        let mut right_sides = RightSides::new(self);
        let unit: Vec<(usize, [f64; 2])> =
            (0..n).flat_map(|j| [(j, [0.0, -1.0]), (j, [1.0, 0.0])]).collect();
        for some in unit.chunks(SIDES_AT_ONCE) {
            right_sides.solve(self, some);
            for (side_index, (j, force)) in some.iter().enumerate() {
                let [down, along] = if force[0] == 0.0 {
                    [&mut compliance.down_per_p, &mut compliance.along_per_p]
                } else {
                    [&mut compliance.down_per_q, &mut compliance.along_per_q]
                };
                for i in 0..n {
                    let [x, z] = right_sides.at(self, i, side_index);
                    (down[i * n + j], along[i * n + j]) = (-z, x);
                }
            }
        }
        Ok(compliance)
    }
}
