//! Lagrange interpolation on a uniform grid with four and with six points. Callers stay inside
//! their tables: places outside are extrapolated.

/// Weights of the cubic through the values at -1, 0, 1, 2.
#[inline]
pub(crate) fn cubic(s: f64) -> [f64; 4] {
    let (a, b, c) = (s + 1.0, s - 1.0, s - 2.0);
    [-s * b * c / 6.0, a * b * c / 2.0, -a * s * c / 2.0, a * s * b / 6.0]
}

/// The function at `place` >= 0 grid spacings from 0; `values` are those at -2, -1, 0, 1 ...
/// spacings, at least six.
pub(crate) fn six_point(values: &[f64], place: f64) -> f64 {
    let cell = (place as usize).min(values.len() - 6);
    let x = place - cell as f64;
    let v = &values[cell..cell + 6];
    let (d0, d1, d2, d3, d4, d5) = (x + 2.0, x + 1.0, x, x - 1.0, x - 2.0, x - 3.0);
    let (low, high) = (d0 * d1 * d2, d3 * d4 * d5);
    let left = d1 * d2 * v[0] / -120.0 + d0 * d2 * v[1] / 24.0 - d0 * d1 * v[2] / 12.0;
    let right = d4 * d5 * v[3] / 12.0 - d3 * d5 * v[4] / 24.0 + d3 * d4 * v[5] / 120.0;
    high * left + low * right
}

/// Lagrange's weights of the six neighbours of a place, for any table on the same grid.
#[derive(Clone, Copy)]
pub(crate) struct Stencil {
    cell: usize,
    weights: [f64; 6],
}

impl Stencil {
    /// At `place` grid spacings from 0, in tables of `len` values as [`six_point`] has them. Places
    /// from -2 on are between the first values, as the ones up to `len - 3` are between the last.
    #[inline]
    pub(crate) fn new(len: usize, place: f64) -> Self {
        const OUTER_WEIGHT: f64 = 1.0 / 120.0;
        const NEXT_WEIGHT: f64 = 1.0 / 24.0;
        const INNER_WEIGHT: f64 = 1.0 / 12.0;
        let cell = (place as usize).min(len - 6);
        let x = place - cell as f64;
        let (d0, d1, d2, d3, d4, d5) = (x + 2.0, x + 1.0, x, x - 1.0, x - 2.0, x - 3.0);
        let (low, high) = (d0 * d1 * d2, d3 * d4 * d5);
        let weights = [
            -OUTER_WEIGHT * high * (d1 * d2),
            NEXT_WEIGHT * high * (d0 * d2),
            -INNER_WEIGHT * high * (d0 * d1),
            INNER_WEIGHT * low * (d4 * d5),
            -NEXT_WEIGHT * low * (d3 * d5),
            OUTER_WEIGHT * low * (d3 * d4),
        ];
        Self { cell, weights }
    }

    /// The first of the six neighbours in a table.
    pub(crate) fn first(&self) -> usize {
        self.cell
    }

    /// The weights of the six neighbours.
    pub(crate) fn weights(&self) -> [f64; 6] {
        self.weights
    }

    /// The function of a table at that place.
    #[inline]
    pub(crate) fn of(&self, values: &[f64]) -> f64 {
        let near = values[self.cell..self.cell + 6].iter();
        near.zip(&self.weights).map(|(value, weight)| value * weight).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quintics_are_exact_and_grid_points_are_kept() {
        let quintic = |x: f64| 1.0 - x * (0.5 - x * (0.25 + x * (0.1 - x * (0.03 - 0.002 * x))));
        let values: Vec<f64> = (0..12).map(|i| quintic(f64::from(i) - 2.0)).collect();
        for place in [0.0, 0.3, 1.0, 2.7, 5.5, 6.99] {
            assert!((six_point(&values, place) - quintic(place)).abs() < 1e-13, "{place}");
            let at = Stencil::new(values.len(), place);
            assert!((at.of(&values) - quintic(place)).abs() < 1e-13, "{place}");
        }
        assert_eq!(six_point(&values, 3.0), values[5]);
    }
}
