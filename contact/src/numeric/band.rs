//! Cholesky factors of symmetric positive definite band matrices, lower half, row by row.

/// Right sides that are solved together: the factor is read once for all of them.
pub(crate) const SIDES_AT_ONCE: usize = 8;

/// The lower band of a matrix, then of its factor.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    size: usize,
    half: usize,
    /// Row i holds columns i - half to i; entries left of column 0 stay 0.
    rows: Vec<f64>,
}

impl Band {
    pub(crate) fn new(size: usize, half: usize) -> Self {
        Self { size, half, rows: vec![0.0; size * (half + 1)] }
    }

    /// Number of stored entries.
    pub(crate) fn entries(&self) -> usize {
        self.rows.len()
    }

    /// Adds to an entry and, by symmetry, to its mirror image.
    pub(crate) fn add(&mut self, row: usize, column: usize, value: f64) {
        if column <= row {
            self.rows[row * (self.half + 1) + self.half + column - row] += value;
        }
    }

    /// Factors in place; whether the matrix was positive definite.
    pub(crate) fn factor(&mut self) -> bool {
        let (n, w) = (self.size, self.half + 1);
        for i in 0..n {
            let first = i.saturating_sub(self.half);
            let (above, rest) = self.rows.split_at_mut(i * w);
            let row = &mut rest[..w];
            for j in first..i {
                // Columns that both rows hold: from `first` (row j holds at least those).
                let start = first.max(j.saturating_sub(self.half));
                let other = &above[j * w..][..w];
                let a = &row[self.half + start - i..self.half + j - i];
                let b = &other[self.half + start - j..self.half];
                let known: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                let place = self.half + j - i;
                row[place] = (row[place] - known) * other[self.half];
            }
            let square: f64 = row[..self.half].iter().map(|v| v * v).sum();
            let rest = row[self.half] - square;
            if rest.is_nan() || rest <= 0.0 {
                return false;
            }
            // The diagonal stores its inverse, so that solving multiplies.
            row[self.half] = 1.0 / rest.sqrt();
        }
        true
    }

    /// Solves in place after [`Self::factor`].
    pub(crate) fn solve(&self, side: &mut [f64]) {
        let (n, w) = (self.size, self.half + 1);
        for i in 0..n {
            let first = i.saturating_sub(self.half);
            let row = &self.rows[i * w..][..w];
            let a = &row[self.half + first - i..self.half];
            let known: f64 = a.iter().zip(&side[first..i]).map(|(a, b)| a * b).sum();
            side[i] = (side[i] - known) * row[self.half];
        }
        for i in (0..n).rev() {
            let first = i.saturating_sub(self.half);
            let row = &self.rows[i * w..][..w];
            let value = side[i] * row[self.half];
            side[i] = value;
            let a = &row[self.half + first - i..self.half];
            for (s, a) in side[first..i].iter_mut().zip(a) {
                *s -= a * value;
            }
        }
    }

    /// [`Self::solve`] for several right sides, each with the same bits as alone.
    pub(crate) fn solve_many(&self, side: &mut [[f64; SIDES_AT_ONCE]]) {
        let (n, w) = (self.size, self.half + 1);
        for i in 0..n {
            let first = i.saturating_sub(self.half);
            let row = &self.rows[i * w..][..w];
            let mut known = [0.0; SIDES_AT_ONCE];
            for (a, s) in row[self.half + first - i..self.half].iter().zip(&side[first..i]) {
                known.iter_mut().zip(s).for_each(|(known, s)| *known += a * s);
            }
            for (s, known) in side[i].iter_mut().zip(known) {
                *s = (*s - known) * row[self.half];
            }
        }
        for i in (0..n).rev() {
            let first = i.saturating_sub(self.half);
            let row = &self.rows[i * w..][..w];
            let value = side[i].map(|s| s * row[self.half]);
            side[i] = value;
            let a = &row[self.half + first - i..self.half];
            for (s, a) in side[first..i].iter_mut().zip(a) {
                s.iter_mut().zip(value).for_each(|(s, value)| *s -= a * value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_band_is_solved_and_an_indefinite_one_refused() {
        let n = 30;
        let entry = |i: usize, j: usize| match i.abs_diff(j) {
            0 => 5.0 + i as f64,
            d @ 1..=4 => 1.0 / d as f64 - 0.3,
            _ => 0.0,
        };
        let mut band = Band::new(n, 4);
        for i in 0..n {
            for j in 0..n {
                if entry(i, j) != 0.0 {
                    band.add(i, j, entry(i, j));
                }
            }
        }
        let x: Vec<f64> = (0..n).map(|i| libm::sin(i as f64)).collect();
        let row = |i: usize| (0..n).map(|j| entry(i, j) * x[j]).sum::<f64>();
        let mut side: Vec<f64> = (0..n).map(row).collect();
        assert!(band.factor());
        let mut lanes: Vec<[f64; SIDES_AT_ONCE]> =
            side.iter().map(|s| core::array::from_fn(|index| s * (1.0 + index as f64))).collect();
        band.solve_many(&mut lanes);
        for index in 0..SIDES_AT_ONCE {
            let mut alone: Vec<f64> = side.iter().map(|s| s * (1.0 + index as f64)).collect();
            band.solve(&mut alone);
            assert!(alone.iter().zip(&lanes).all(|(a, b)| a.to_bits() == b[index].to_bits()));
        }
        band.solve(&mut side);
        assert!(side.iter().zip(&x).all(|(a, b)| (a - b).abs() < 1e-14));
        let mut bad = Band::new(2, 1);
        bad.add(0, 0, 1.0);
        bad.add(1, 1, -1.0);
        assert!(!bad.factor());
    }
}
