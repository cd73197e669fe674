//! Direct solution of the slices' whole linear system, for contacts of few unknowns: there a
//! Cholesky factor costs less than conjugate gradients, and it also gives the rate of the force by
//! the penetration. A bar's slices all have one width, so the factor holds as long as the same
//! slices touch. A system that is not positive definite is left to conjugate gradients.

use super::cosine_sums::sized;
use super::row::SliceRow;
use super::state::ContactState;
use crate::numeric::cholesky::solve;
use crate::numeric::wide::wide;
use core::f64::consts::PI;

/// Most unknowns of the system while widths are searched for: for slices of free width, and for
/// slices of fixed width.
const UNKNOWNS_MAX: [usize; 2] = [54, 96];
/// Right sides: the prescribed penetrations, and a penetration of 1 everywhere.
const RIGHT_SIDES: usize = 2;
/// Most cosines of a slice whose width is searched for; `COSINES_MAX` holds for a width that is
/// read from a table.
const SEARCH_COSINES_MAX: usize = 8;
const COSINES_MAX: usize = 14;

/// Memory of the factored system.
#[derive(Clone, Debug)]
pub(super) struct DenseSystem {
    /// Most unknowns while widths are searched for, and most for which there is memory.
    pub(super) most: usize,
    pub(super) room: usize,
    /// The slices in contact, counted from the end on which a contact on an end stands.
    active: Vec<usize>,
    /// Lower triangle, row by row, and the right sides as rows below it.
    matrix: Vec<f64>,
    column: Vec<f64>,
    /// Unknowns of the factor in `matrix`; the rows of its triangle lie so far apart.
    stride: usize,
    /// The slices of the factor in `matrix`.
    factored: Vec<usize>,
    /// The pressure, and what a unit of penetration adds to it.
    pressure: Vec<f64>,
    rise: Vec<f64>,
}

impl DenseSystem {
    /// Memory for slices of so many cosines, of free or fixed width, with room for at least the
    /// given number of unknowns; allocates.
    pub(super) fn new(slices: usize, cosines: usize, is_free: bool, room: usize) -> Self {
        let up_to = |most: usize| if is_free && cosines > most { 0 } else { slices * cosines };
        let [searched, fits] = [SEARCH_COSINES_MAX, COSINES_MAX].map(up_to);
        let most = UNKNOWNS_MAX[usize::from(!is_free)].min(searched);
        let room = room.min(fits).max(most);
        Self {
            most,
            room,
            active: Vec::with_capacity(slices),
            matrix: vec![0.0; room * (room + RIGHT_SIDES)],
            column: vec![0.0; room + RIGHT_SIDES],
            stride: 0,
            factored: Vec::with_capacity(slices),
            pressure: vec![0.0; room],
            rise: vec![0.0; room],
        }
    }

    /// Computes the pressure of the first `size` unknowns, and its rate by the penetration, from
    /// the factor and the right sides.
    fn substitute(&mut self, size: usize) {
        let stride = self.stride;
        let (triangle, sides) = self.matrix.split_at(stride * stride);
        for (found, side) in [&mut self.pressure, &mut self.rise].into_iter().zip([0, stride]) {
            found[..size].copy_from_slice(&sides[side..side + size]);
            back(triangle, size, stride, found);
        }
    }
}

/// Force of a contact at fixed widths.
#[derive(Clone, Copy, Debug)]
pub(super) struct Carried {
    /// Force in units of the kernels.
    pub(super) force: f64,
    /// Its rate by the penetration of all slices.
    pub(super) rate: f64,
}

impl DenseSystem {
    /// Solves for the pressure at the present widths. Absent when there are more than `most`
    /// unknowns or the system is not positive definite.
    pub(super) fn solve(
        &mut self,
        row: &SliceRow,
        state: &mut ContactState,
        most: usize,
    ) -> Option<Carried> {
        let n = state.layout.cosines;
        self.active.clear();
        self.active.extend((0..row.along.len()).rev().filter(|j| state.active[*j]));
        let size = n * self.active.len();
        if size > most || size == 0 {
            return None;
        }
        if row.strips.is_free() || self.active != self.factored {
            self.factored.clear();
            self.assemble(row, state, size);
            if !eliminate(&mut self.matrix, size, &mut self.column) {
                return None;
            }
            self.stride = size;
            self.substitute(size);
            self.factored.extend_from_slice(&self.active);
        } else {
            // The widths of a bar are fixed, so the factor of the same slices holds.
            let layout = state.layout;
            for (p, &j) in self.active.iter().enumerate() {
                let table = &state.rows[j * layout.len()..(j + 1) * layout.len()];
                for k in 0..n {
                    let given = if k == 0 { PI * state.given[j] } else { 0.0 };
                    self.pressure[p * n + k] = given - table[layout.shape(k)];
                }
            }
            solve(&self.matrix[..size * size], size, &mut self.pressure[..size]);
        }
        Some(self.copy_pressure(row, state))
    }

    /// The result of [`DenseSystem::solve`] where only slices far from the last one have left the
    /// contact since, and the widths of the others are unchanged: the factor of the rest is part
    /// of the known factor. Absent where other slices have left.
    pub(super) fn solve_shortened(
        &mut self,
        row: &SliceRow,
        state: &mut ContactState,
    ) -> Option<Carried> {
        let n = state.layout.cosines;
        let still = self.active.iter().take_while(|j| state.active[**j]).count();
        let (_, gone) = self.active.split_at(still);
        if still == 0 || self.stride == 0 || gone.iter().any(|j| state.active[*j]) {
            return None;
        }
        gone.iter().for_each(|j| state.a[j * n..(j + 1) * n].fill(0.0));
        self.active.truncate(still);
        self.substitute(still * n);
        Some(self.copy_pressure(row, state))
    }

    /// Copies the pressure into the contact's state.
    fn copy_pressure(&self, row: &SliceRow, state: &mut ContactState) -> Carried {
        let n = state.layout.cosines;
        let (mut force, mut rate) = (0.0, 0.0);
        for (p, &j) in self.active.iter().enumerate() {
            let found = &self.pressure[p * n..(p + 1) * n];
            state.a[j * n..(j + 1) * n].copy_from_slice(found);
            force += PI * row.h * found[0];
            rate += PI * row.h * self.rise[p * n];
        }
        Carried { force, rate }
    }

    /// Writes the system of the slices that touch, and its right sides.
    fn assemble(&mut self, row: &SliceRow, state: &ContactState, size: usize) {
        let (layout, n, per) = (state.layout, state.layout.cosines, state.transform_len);
        let transform = |slice: usize| &state.transforms[slice * per..(slice + 1) * per];
        for (p, &j) in self.active.iter().enumerate() {
            let table = &state.rows[j * layout.len()..(j + 1) * layout.len()];
            for (q, &i) in self.active[..=p].iter().enumerate() {
                let mut found = [0.0; COSINES_MAX * COSINES_MAX];
                let block = if row.pair_blocks.is_empty() {
                    let [one, other] = [transform(j), transform(i)];
                    pair(row.coupling.weights_of(i - j), one, other, n, &mut found);
                    &found[..]
                } else {
                    row.pair_blocks.get((i - j) * n * n..).unwrap_or(&[])
                };
                for k in 0..n {
                    let at = (p * n + k) * size + q * n;
                    for l in 0..n {
                        self.matrix[at + l] = block.get(k * n + l).copied().unwrap_or(0.0);
                        if p == q {
                            self.matrix[at + l] += table[layout.matrix(k.max(l), k.min(l))];
                        }
                    }
                }
            }
            for k in 0..n {
                let (given, one) = if k == 0 { (PI * state.given[j], PI) } else { (0.0, 0.0) };
                self.matrix[size * size + p * n + k] = given - table[layout.shape(k)];
                self.matrix[(size + 1) * size + p * n + k] = one;
            }
        }
    }

    /// Changes the penetration of the solved contact at its present widths.
    pub(super) fn shift_penetration(&self, state: &mut ContactState, shift: f64) {
        let n = state.layout.cosines;
        for given in &mut state.given {
            *given += shift;
        }
        for (p, &j) in self.active.iter().enumerate() {
            for k in 0..n {
                state.a[j * n + k] += shift * self.rise[p * n + k];
            }
        }
    }
}

wide! {
    /// Cholesky's factor in place, column after column, and the sides below it carried through;
    /// false when the matrix is not positive definite.
    fn eliminate(matrix: &mut [f64], size: usize, column: &mut [f64]) -> bool = eliminate_narrow;

    /// Back substitution with the first `size` rows of a lower triangle, which lie `stride` apart.
    fn back(triangle: &[f64], size: usize, stride: usize, side: &mut [f64]) = back_narrow;

    /// Writes the coupling block of two slices, from the weights of the modes and the slices'
    /// transforms of `n` cosines.
    fn pair(
        weights: &[f64],
        one: &[f64],
        other: &[f64],
        n: usize,
        block: &mut [f64; COSINES_MAX * COSINES_MAX],
    ) = pair_narrow;
}

#[inline(always)]
fn eliminate_narrow(matrix: &mut [f64], size: usize, column: &mut [f64]) -> bool {
    for j in 0..size {
        let pivot = matrix[j * size + j];
        if pivot.is_nan() || pivot <= 0.0 {
            return false;
        }
        let root = pivot.sqrt();
        matrix[j * size + j] = root;
        for i in j + 1..size + RIGHT_SIDES {
            let value = matrix[i * size + j] / root;
            matrix[i * size + j] = value;
            column[i] = value;
        }
        for i in j + 1..size + RIGHT_SIDES {
            let (own, end) = (column[i], (i + 1).min(size));
            let row = &mut matrix[i * size + j + 1..i * size + end];
            for (entry, other) in row.iter_mut().zip(&column[j + 1..end]) {
                *entry -= own * other;
            }
        }
    }
    true
}

#[inline(always)]
fn back_narrow(triangle: &[f64], size: usize, stride: usize, side: &mut [f64]) {
    for i in (0..size).rev() {
        let row = &triangle[i * stride..=i * stride + i];
        let known = side[i] / row[i];
        side[i] = known;
        for (value, entry) in side[..i].iter_mut().zip(row) {
            *value -= known * entry;
        }
    }
}

#[inline(always)]
fn pair_narrow(
    weights: &[f64],
    one: &[f64],
    other: &[f64],
    n: usize,
    block: &mut [f64; COSINES_MAX * COSINES_MAX],
) {
    sized!(n, pair_sized(weights, one, other, block), ());
}

#[inline(always)]
fn pair_sized<const N: usize>(
    weights: &[f64],
    one: &[f64],
    other: &[f64],
    block: &mut [f64; COSINES_MAX * COSINES_MAX],
) {
    let mut sums = [[0.0; N]; N];
    let ((one, _), (other, _)) = (one.as_chunks::<N>(), other.as_chunks::<N>());
    for ((weight, one), other) in weights.iter().zip(one).zip(other) {
        for (row, value) in sums.iter_mut().zip(one) {
            let felt = weight * value;
            for (sum, other) in row.iter_mut().zip(other) {
                *sum += felt * other;
            }
        }
    }
    for (to, row) in block.chunks_exact_mut(N).zip(&sums) {
        to.copy_from_slice(row);
    }
}

#[cfg(test)]
mod tests {
    use super::super::cosine_sums::tests::numbers;
    use super::*;

    /// Compares coupling blocks, factor and solution of a system in wide and in narrow registers.
    #[test]
    fn systems_are_solved_alike_in_wide_and_narrow_registers() {
        const WAVE_COUNT: usize = 37;
        for n in 3..=COSINES_MAX {
            let [one, other] = [0.3, 2.0].map(|from| numbers(WAVE_COUNT * n, from));
            let weights = numbers(WAVE_COUNT, 5.0);
            let [mut wide, mut narrow] = [[0.0; COSINES_MAX * COSINES_MAX]; 2];
            pair(&weights, &one, &other, n, &mut wide);
            pair_narrow(&weights, &one, &other, n, &mut narrow);
            assert_eq!(wide, narrow);
            let exact: f64 =
                (0..WAVE_COUNT).map(|m| weights[m] * one[m * n + 1] * other[m * n]).sum();
            assert!((wide[n] - exact).abs() < 1e-14, "{n}: {} {exact}", wide[n]);

            let size = 5 * n;
            let mut matrix = numbers(size * (size + RIGHT_SIDES), 1.0);
            (0..size).for_each(|i| matrix[i * size + i] = 20.0);
            let (mut other, mut column) = (matrix.clone(), vec![0.0; size + RIGHT_SIDES]);
            assert!(eliminate(&mut matrix, size, &mut column));
            assert!(eliminate_narrow(&mut other, size, &mut column));
            assert_eq!(matrix, other);
            let (triangle, sides) = matrix.split_at(size * size);
            let [mut wide, mut narrow] = [sides[..size].to_vec(), sides[..size].to_vec()];
            back(triangle, size, size, &mut wide);
            back_narrow(triangle, size, size, &mut narrow);
            assert_eq!(wide, narrow);
        }
    }
}
