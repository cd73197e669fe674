//! The slices' whole system, factored: for contacts of few unknowns, where a factor costs less than
//! conjugate gradients and tells how the force follows the penetration. A bar's slices are all of
//! one width, so the factor stays as long as the same slices touch. It refuses nothing: a system
//! that is not positive is left to the gradients.

use super::cosines::sized;
use super::row::Row;
use crate::numeric::cholesky::solve;
use crate::numeric::wide::wide;
use core::f64::consts::PI;

/// Most unknowns where the width is free, where it is fixed.
const UNKNOWNS: [usize; 2] = [54, 96];
/// Right sides: the penetrations given, and one of 1 everywhere.
const SIDES: usize = 2;
/// Most cosines of a slice whose width is searched for, and of one whose width is read.
const SEARCHED: usize = 8;
const COSINES: usize = 14;

/// Memory of the factored system.
#[derive(Clone, Debug)]
pub(crate) struct Dense {
    /// Most unknowns while widths are searched for, and most that there is room for.
    pub(super) most: usize,
    pub(super) room: usize,
    /// The slices that touch, from the end that contacts on an end stand on.
    active: Vec<usize>,
    /// Lower triangle, row by row, and the right sides as rows below it.
    matrix: Vec<f64>,
    column: Vec<f64>,
    /// Unknowns of the factor in `matrix`; the rows of its triangle lie so far apart.
    stride: usize,
    /// The slices of the factor in `matrix`, while it may be used again.
    kept: Vec<usize>,
    /// The pressure, and what a unit of penetration adds to it.
    pressure: Vec<f64>,
    rise: Vec<f64>,
}

impl Dense {
    /// For so many slices of so many cosines, of free width or not, with room for so many unknowns.
    pub(crate) fn new(slices: usize, cosines: usize, (free, room): (bool, usize)) -> Self {
        let up_to = |most: usize| if free && cosines > most { 0 } else { slices * cosines };
        let [searched, fits] = [SEARCHED, COSINES].map(up_to);
        let most = UNKNOWNS[usize::from(!free)].min(searched);
        let room = room.min(fits).max(most);
        Self {
            most,
            room,
            active: Vec::with_capacity(slices),
            matrix: vec![0.0; room * (room + SIDES)],
            column: vec![0.0; room + SIDES],
            stride: 0,
            kept: Vec::with_capacity(slices),
            pressure: vec![0.0; room],
            rise: vec![0.0; room],
        }
    }

    /// The pressure of the first unknowns, and its rise, from the factor and its sides.
    fn substitute(&mut self, size: usize) {
        let stride = self.stride;
        let (triangle, sides) = self.matrix.split_at(stride * stride);
        for (found, side) in [&mut self.pressure, &mut self.rise].into_iter().zip([0, stride]) {
            found[..size].copy_from_slice(&sides[side..side + size]);
            back(triangle, (size, stride), found);
        }
    }
}

impl Row {
    /// Solves for the pressure at the present widths; force in units of the kernels and its rate by
    /// penetration. Absent when there are more than `most` unknowns or the system is not positive.
    pub(super) fn direct(&mut self, most: usize) -> Option<(f64, f64)> {
        let n = self.work.places.cosines;
        let dense = &mut self.work.dense;
        dense.active.clear();
        dense.active.extend((0..self.along.len()).rev().filter(|j| self.work.active[*j]));
        let size = n * dense.active.len();
        if size > most || size == 0 {
            return None;
        }
        if self.strips.is_free() || dense.active != dense.kept {
            dense.kept.clear();
            self.assemble(size);
            let dense = &mut self.work.dense;
            if !eliminate(&mut dense.matrix, size, &mut dense.column) {
                return None;
            }
            dense.stride = size;
            dense.substitute(size);
            dense.kept.extend_from_slice(&dense.active);
        } else {
            let (places, dense) = (self.work.places, &mut self.work.dense);
            for (p, &j) in dense.active.iter().enumerate() {
                let row = &self.work.rows[j * places.len()..(j + 1) * places.len()];
                for k in 0..n {
                    let given = if k == 0 { PI * self.work.given[j] } else { 0.0 };
                    dense.pressure[p * n + k] = given - row[places.shape(k)];
                }
            }
            solve(&dense.matrix[..size * size], size, &mut dense.pressure[..size]);
        }
        Some(self.taken_over())
    }

    /// What [`Row::direct`] would find where only slices away from the last one have been let go
    /// since, their widths as they were: the factor of the rest is in its factor. Absent where
    /// others have.
    pub(super) fn shortened(&mut self) -> Option<(f64, f64)> {
        let work = &mut self.work;
        let (n, dense) = (work.places.cosines, &mut work.dense);
        let still = dense.active.iter().take_while(|j| work.active[**j]).count();
        let (_, gone) = dense.active.split_at(still);
        if still == 0 || dense.stride == 0 || gone.iter().any(|j| work.active[*j]) {
            return None;
        }
        gone.iter().for_each(|j| work.a[j * n..(j + 1) * n].fill(0.0));
        dense.active.truncate(still);
        dense.substitute(still * n);
        Some(self.taken_over())
    }

    /// Takes the pressure over from its system; its force in units of the kernels, and its rate.
    fn taken_over(&mut self) -> (f64, f64) {
        let work = &mut self.work;
        let n = work.places.cosines;
        let (mut force, mut rate) = (0.0, 0.0);
        for (p, &j) in work.dense.active.iter().enumerate() {
            let found = &work.dense.pressure[p * n..(p + 1) * n];
            work.a[j * n..(j + 1) * n].copy_from_slice(found);
            force += PI * self.h * found[0];
            rate += PI * self.h * work.dense.rise[p * n];
        }
        (force, rate)
    }

    /// Writes the system of the slices that touch, and its right sides.
    fn assemble(&mut self, size: usize) {
        let Self { coupling, work, between, .. } = self;
        let (places, n, per) = (work.places, work.places.cosines, work.transform);
        let dense = &mut work.dense;
        let of = |slice: usize| &work.transforms[slice * per..(slice + 1) * per];
        for (p, &j) in dense.active.iter().enumerate() {
            let row = &work.rows[j * places.len()..(j + 1) * places.len()];
            for (q, &i) in dense.active[..=p].iter().enumerate() {
                let mut found = [0.0; COSINES * COSINES];
                let block = if between.is_empty() {
                    pair(coupling.weights_of(i - j), (of(j), of(i), n), &mut found);
                    &found[..]
                } else {
                    between.get((i - j) * n * n..).unwrap_or(&[])
                };
                for k in 0..n {
                    let at = (p * n + k) * size + q * n;
                    for l in 0..n {
                        dense.matrix[at + l] = block.get(k * n + l).copied().unwrap_or(0.0);
                        if p == q {
                            dense.matrix[at + l] += row[places.matrix(k.max(l), k.min(l))];
                        }
                    }
                }
            }
            for k in 0..n {
                let (given, one) = if k == 0 { (PI * work.given[j], PI) } else { (0.0, 0.0) };
                dense.matrix[size * size + p * n + k] = given - row[places.shape(k)];
                dense.matrix[(size + 1) * size + p * n + k] = one;
            }
        }
    }

    /// Presses the contact of [`Row::direct`] deeper at its present widths.
    pub(super) fn sink(&mut self, shift: f64) {
        let work = &mut self.work;
        let n = work.places.cosines;
        for given in &mut work.given {
            *given += shift;
        }
        for (p, &j) in work.dense.active.iter().enumerate() {
            for k in 0..n {
                work.a[j * n + k] += shift * work.dense.rise[p * n + k];
            }
        }
    }
}

wide! {
    /// Cholesky's factor in place, column after column, and the sides below it carried through;
    /// false when the matrix is not positive definite.
    fn eliminate(matrix: &mut [f64], size: usize, column: &mut [f64]) -> bool = eliminated;

    /// Back substitution with the first rows of a lower triangle, so far apart.
    fn back(triangle: &[f64], rows: (usize, usize), side: &mut [f64]) = substituted;

    /// What two slices do to each other by such weights, from their transforms of `n` cosines.
    fn pair(
        weights: &[f64],
        transforms: (&[f64], &[f64], usize),
        block: &mut [f64; COSINES * COSINES],
    ) = paired;
}

#[inline(always)]
fn eliminated(matrix: &mut [f64], size: usize, column: &mut [f64]) -> bool {
    for j in 0..size {
        let pivot = matrix[j * size + j];
        if pivot.is_nan() || pivot <= 0.0 {
            return false;
        }
        let root = pivot.sqrt();
        matrix[j * size + j] = root;
        for i in j + 1..size + SIDES {
            let value = matrix[i * size + j] / root;
            matrix[i * size + j] = value;
            column[i] = value;
        }
        for i in j + 1..size + SIDES {
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
fn substituted(triangle: &[f64], (size, stride): (usize, usize), side: &mut [f64]) {
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
fn paired(
    weights: &[f64],
    (one, other, n): (&[f64], &[f64], usize),
    block: &mut [f64; COSINES * COSINES],
) {
    sized!(n, sum(weights, (one, other), block), ());
}

#[inline(always)]
fn sum<const N: usize>(
    weights: &[f64],
    (one, other): (&[f64], &[f64]),
    block: &mut [f64; COSINES * COSINES],
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
    use super::super::cosines::tests::numbers;
    use super::*;

    /// What two slices do to each other, a system's factor and its solution.
    #[test]
    fn systems_are_solved_alike_in_wide_and_narrow_registers() {
        const WAVES: usize = 37;
        for n in 3..=COSINES {
            let [one, other] = [0.3, 2.0].map(|from| numbers(WAVES * n, from));
            let weights = numbers(WAVES, 5.0);
            let [mut wide, mut narrow] = [[0.0; COSINES * COSINES]; 2];
            pair(&weights, (&one, &other, n), &mut wide);
            paired(&weights, (&one, &other, n), &mut narrow);
            assert_eq!(wide, narrow);
            let exact: f64 = (0..WAVES).map(|m| weights[m] * one[m * n + 1] * other[m * n]).sum();
            assert!((wide[n] - exact).abs() < 1e-14, "{n}: {} {exact}", wide[n]);

            let size = 5 * n;
            let mut matrix = numbers(size * (size + SIDES), 1.0);
            (0..size).for_each(|i| matrix[i * size + i] = 20.0);
            let (mut other, mut column) = (matrix.clone(), vec![0.0; size + SIDES]);
            assert!(eliminate(&mut matrix, size, &mut column));
            assert!(eliminated(&mut other, size, &mut column));
            assert_eq!(matrix, other);
            let (triangle, sides) = matrix.split_at(size * size);
            let [mut wide, mut narrow] = [sides[..size].to_vec(), sides[..size].to_vec()];
            back(triangle, (size, size), &mut wide);
            substituted(triangle, (size, size), &mut narrow);
            assert_eq!(wide, narrow);
        }
    }
}
