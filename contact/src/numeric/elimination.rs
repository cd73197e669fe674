//! Dense linear systems by Gaussian elimination with row pivots. A pivot of exactly 0 makes every
//! component of the solution NaN or infinite; callers check the solution.

use super::wide::wide;

/// A square matrix that is factored in place, in storage that is kept from one system to the next;
/// factoring uses wide registers.
#[derive(Clone, Debug, Default)]
pub(crate) struct LuMatrix {
    size: usize,
    entries: Vec<f64>,
    rows: Vec<usize>,
}

impl LuMatrix {
    /// Room for matrices up to `capacity` square.
    pub(crate) fn with_capacity(capacity: usize) -> Self {
        let entries = Vec::with_capacity(capacity * capacity);
        Self { size: 0, entries, rows: Vec::with_capacity(capacity) }
    }

    /// Starts a matrix of zeros; allocates only beyond the capacity.
    pub(crate) fn reset(&mut self, size: usize) {
        self.size = size;
        self.entries.clear();
        self.entries.resize(size * size, 0.0);
    }

    /// One row, to be filled.
    pub(crate) fn row_mut(&mut self, row: usize) -> &mut [f64] {
        &mut self.entries[row * self.size..][..self.size]
    }

    /// Factors in place.
    pub(crate) fn factor(&mut self) {
        self.rows.clear();
        eliminate(self.size, &mut self.entries, &mut self.rows);
    }

    /// Solves for one right side in place, after [`Self::factor`].
    pub(crate) fn solve(&self, side: &mut [f64]) {
        let n = self.size;
        for (pivot, &row) in self.rows.iter().enumerate() {
            side.swap(pivot, row);
        }
        for row in 1..n {
            let (known, rest) = side.split_at_mut(row);
            let factors = &self.entries[row * n..][..row];
            rest[0] -= factors.iter().zip(known.iter()).map(|(f, k)| f * k).sum::<f64>();
        }
        for row in (0..n).rev() {
            let (first, known) = side.split_at_mut(row + 1);
            let factors = &self.entries[row * n + row..][..n - row];
            let sum: f64 = factors[1..].iter().zip(known.iter()).map(|(f, k)| f * k).sum();
            first[row] = (first[row] - sum) / factors[0];
        }
    }
}

wide! {
    /// Turns a square matrix of `n` rows into its factors and appends the row of each pivot.
    fn eliminate(n: usize, entries: &mut [f64], rows: &mut Vec<usize>) = eliminate_in_place;
}

#[inline(always)]
fn eliminate_in_place(n: usize, entries: &mut [f64], rows: &mut Vec<usize>) {
    for pivot in 0..n {
        let mut largest = pivot;
        for row in pivot + 1..n {
            if entries[row * n + pivot].abs() > entries[largest * n + pivot].abs() {
                largest = row;
            }
        }
        rows.push(largest);
        if largest != pivot {
            let (above, below) = entries.split_at_mut(largest * n);
            above[pivot * n..][..n].swap_with_slice(&mut below[..n]);
        }
        let (above, below) = entries.split_at_mut((pivot + 1) * n);
        let source = &above[pivot * n..];
        let over = 1.0 / source[pivot];
        for row in below.chunks_exact_mut(n) {
            let factor = row[pivot] * over;
            row[pivot] = factor;
            for (entry, known) in row[pivot + 1..].iter_mut().zip(&source[pivot + 1..]) {
                *entry -= factor * known;
            }
        }
    }
}

/// A dense square matrix that is consumed by solving for several right sides at once. It divides by
/// each pivot, whereas [`LuMatrix`] multiplies by the pivot's inverse. The last bits differ, and
/// the tables of the line contact are pinned to the bits of this one.
pub(crate) struct EliminationMatrix {
    size: usize,
    entries: Vec<f64>,
}

impl EliminationMatrix {
    pub(crate) fn new(size: usize) -> Self {
        Self { size, entries: vec![0.0; size * size] }
    }

    pub(crate) fn set(&mut self, row: usize, column: usize, value: f64) {
        self.entries[row * self.size + column] = value;
    }

    pub(crate) fn get(&self, row: usize, column: usize) -> f64 {
        self.entries[row * self.size + column]
    }

    /// Solves for several right sides in place by elimination with row pivots.
    pub(crate) fn solve(mut self, sides: &mut [Vec<f64>]) {
        for pivot in 0..self.size {
            self.exchange(pivot, sides);
            let (above, below) = self.entries.split_at_mut((pivot + 1) * self.size);
            let source = &above[pivot * self.size..];
            for (offset, row) in below.chunks_exact_mut(self.size).enumerate() {
                let factor = row[pivot] / source[pivot];
                for (entry, known) in row[pivot + 1..].iter_mut().zip(&source[pivot + 1..]) {
                    *entry -= factor * known;
                }
                for side in sides.iter_mut() {
                    side[pivot + 1 + offset] -= factor * side[pivot];
                }
            }
        }
        for side in sides.iter_mut() {
            for row in (0..self.size).rev() {
                let known: f64 =
                    (row + 1..self.size).map(|column| self.get(row, column) * side[column]).sum();
                side[row] = (side[row] - known) / self.get(row, row);
            }
        }
    }

    fn exchange(&mut self, pivot: usize, sides: &mut [Vec<f64>]) {
        let mut largest = pivot;
        for row in pivot + 1..self.size {
            if self.get(row, pivot).abs() > self.get(largest, pivot).abs() {
                largest = row;
            }
        }
        if largest == pivot {
            return;
        }
        for column in pivot..self.size {
            self.entries.swap(pivot * self.size + column, largest * self.size + column);
        }
        for side in sides {
            side.swap(pivot, largest);
        }
    }
}

/// Inverse and determinant of a small matrix by Gauss-Jordan elimination; `None` where the
/// determinant is not above 0.
pub(crate) fn inverse_and_determinant<const D: usize>(
    mut m: [[f64; D]; D],
) -> Option<([[f64; D]; D], f64)> {
    let mut out = [[0.0; D]; D];
    (0..D).for_each(|i| out[i][i] = 1.0);
    let mut determinant = 1.0;
    for pivot in 0..D {
        let size = |row: &usize| m[*row][pivot].abs();
        let best = (pivot..D).max_by(|a, b| size(a).total_cmp(&size(b)))?;
        if best != pivot {
            m.swap(best, pivot);
            out.swap(best, pivot);
            determinant = -determinant;
        }
        let value = m[pivot][pivot];
        determinant *= value;
        for column in 0..D {
            m[pivot][column] /= value;
            out[pivot][column] /= value;
        }
        for row in (0..D).filter(|row| *row != pivot) {
            let factor = m[row][pivot];
            for column in 0..D {
                m[row][column] -= factor * m[pivot][column];
                out[row][column] -= factor * out[pivot][column];
            }
        }
    }
    (determinant > 0.0).then_some((out, determinant))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_system_that_needs_pivots_is_solved() {
        let a = [[0.0, 2.0, -1.0], [1.0, 0.0, 3.0], [4.0, -5.0, 0.0]];
        let x = [1.5, -2.0, 0.25];
        let mut dense = LuMatrix::with_capacity(3);
        dense.reset(3);
        for (i, row) in a.iter().enumerate() {
            dense.row_mut(i).copy_from_slice(row);
        }
        let mut side: Vec<f64> =
            a.iter().map(|row| row.iter().zip(&x).map(|(a, x)| a * x).sum()).collect();
        dense.factor();
        dense.solve(&mut side);
        assert!(side.iter().zip(&x).all(|(s, x)| (s - x).abs() < 1e-14));
    }

    #[test]
    fn systems_are_factored_alike_in_wide_and_narrow_registers() {
        for n in [1, 2, 5, 12, 31] {
            let entry = |at: usize| libm::sin(0.3 + 1.7 * at as f64);
            let mut wide: Vec<f64> = (0..n * n).map(entry).collect();
            let (mut narrow, mut rows) = (wide.clone(), [vec![], vec![]]);
            eliminate(n, &mut wide, &mut rows[0]);
            eliminate_in_place(n, &mut narrow, &mut rows[1]);
            assert!(wide == narrow && rows[0] == rows[1], "{n}");
        }
    }
}
