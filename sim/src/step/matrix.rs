//! A symmetric positive definite system of one equation for each unknown speed, factorised in place
//! by Cholesky without allocation. A matrix that is not positive definite gives numbers that are
//! not finite.

/// Unknown speeds of the pin.
pub(super) const PIN_UNKNOWN_COUNT: usize = 6;

/// A symmetric matrix of which the lower triangle counts, for `J` unknown speeds of the finger and
/// six of the pin, `U` in all.
#[derive(Clone, Copy, Debug)]
pub(super) struct SpeedMatrix<const J: usize, const U: usize>([[f64; U]; U]);

impl<const J: usize, const U: usize> SpeedMatrix<J, U> {
    pub(super) fn identity() -> SpeedMatrix<J, U> {
        const { assert!(U == J + PIN_UNKNOWN_COUNT, "the unknowns are finger's and pin's") };
        let mut m = [[0.0; U]; U];
        for (i, row) in m.iter_mut().enumerate() {
            row[i] = 1.0;
        }
        SpeedMatrix(m)
    }

    pub(super) fn set(&mut self, i: usize, j: usize, value: f64) {
        self.0[i][j] = value;
    }

    pub(super) fn add(&mut self, i: usize, j: usize, value: f64) {
        self.0[i][j] += value;
    }

    /// Adds `weight` times the outer product of a row with itself.
    pub(super) fn add_outer(&mut self, weight: f64, row: &[f64; U]) {
        // Blocks of fixed size, which include entries above the diagonal, let the compiler
        // vectorise.
        for i in 0..J {
            let part = weight * row[i];
            for (entry, other) in self.0[i][..J].iter_mut().zip(&row[..J]) {
                *entry += part * other;
            }
        }
        for i in J..U {
            let part = weight * row[i];
            for (entry, other) in self.0[i].iter_mut().zip(row) {
                *entry += part * other;
            }
        }
    }

    /// Does the same as [`SpeedMatrix::add_outer`] for a row whose part of the finger is 0.
    pub(super) fn add_outer_of_pin(&mut self, weight: f64, row: &[f64; U]) {
        for i in J..U {
            let part = weight * row[i];
            for (entry, other) in self.0[i][J..].iter_mut().zip(&row[J..]) {
                *entry += part * other;
            }
        }
    }

    /// Cholesky's factors.
    pub(super) fn factorise(mut self) -> Factors<U> {
        let (m, mut inverse) = (&mut self.0, [0.0; U]);
        for j in 0..U {
            let (above, rest) = m.split_at_mut(j);
            let row = &mut rest[0];
            for (k, upper) in above.iter().enumerate() {
                let mut sum = row[k];
                for l in 0..k {
                    sum -= row[l] * upper[l];
                }
                row[k] = sum * inverse[k];
            }
            let mut square = row[j];
            for entry in &row[..j] {
                square -= entry * entry;
            }
            inverse[j] = 1.0 / square.sqrt();
        }
        Factors { lower: self.0, inverse }
    }
}

/// Cholesky's factors: the lower triangle without its diagonal, and the diagonal's inverse.
#[derive(Clone, Copy, Debug)]
pub(super) struct Factors<const U: usize> {
    lower: [[f64; U]; U],
    inverse: [f64; U],
}

impl<const U: usize> Factors<U> {
    /// The solution of `self x = b`.
    pub(super) fn solve(&self, b: &[f64; U]) -> [f64; U] {
        let mut x = *b;
        for j in 0..U {
            let mut sum = x[j];
            for (entry, known) in self.lower[j][..j].iter().zip(&x) {
                sum -= entry * known;
            }
            x[j] = sum * self.inverse[j];
        }
        for j in (0..U).rev() {
            x[j] *= self.inverse[j];
            let (open, known) = x.split_at_mut(j);
            for (sum, entry) in open.iter_mut().zip(&self.lower[j]) {
                *sum -= entry * known[0];
            }
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_solve_the_system() {
        solve_a_system::<6, 12>();
        solve_a_system::<7, 13>();
    }

    fn solve_a_system<const J: usize, const U: usize>() {
        let mut m = SpeedMatrix::<J, U>::identity();
        for k in 0..20_usize {
            let row = core::array::from_fn(|i| ((7 * i + 13 * k + i * k) % 11) as f64 - 5.0);
            m.add_outer(0.5 + k as f64, &row);
        }
        m.add(3, 2, 0.25);
        let wanted: [f64; U] = core::array::from_fn(|i| i as f64 - 4.5);
        let at = |i: usize, j: usize| if i >= j { m.0[i][j] } else { m.0[j][i] };
        let b = core::array::from_fn(|i| (0..U).map(|j| at(i, j) * wanted[j]).sum());
        let x = m.factorise().solve(&b);
        assert!(x.iter().zip(&wanted).all(|(x, w)| (x - w).abs() < 1e-9), "{x:?}");
        let mut broken = SpeedMatrix::<J, U>::identity();
        broken.set(4, 4, -1.0);
        assert!(broken.factorise().solve(&wanted).iter().any(|x| x.is_nan()));
    }
}
