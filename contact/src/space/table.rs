//! Interpolates even functions on a uniform grid through six points. A function is 0 beyond the end
//! of its table; a caller that knows its asymptote has to add it.

use crate::numeric::interpolation::six_point;

/// An even function sampled at 0, 1/density, 2/density ...
#[derive(Clone, Debug)]
pub(crate) struct Even {
    /// Values at -2, -1, 0, 1 ... grid spacings.
    values: Vec<f64>,
    density: f64,
    end: f64,
}

impl Even {
    /// `values` at 0, 1, 2 ... spacings of 1/`density`; at least 8 of them.
    pub(crate) fn new(values: &[f64], density: f64) -> Self {
        let mut mirrored = vec![values[2], values[1]];
        mirrored.extend_from_slice(values);
        Self { values: mirrored, density, end: (values.len() - 4) as f64 / density }
    }

    /// Refills a table in place with the values of another function on the same grid.
    pub(crate) fn refill(&mut self, count: usize, density: f64, of: impl Fn(usize) -> f64) {
        self.values.resize(count + 2, 0.0);
        for i in 0..count {
            self.values[i + 2] = of(i);
        }
        self.mirror();
        self.density = density;
        self.end = (count - 4) as f64 / density;
    }

    /// A table with room for `count` values that holds zeros.
    pub(crate) fn with_room(count: usize) -> Self {
        Self { values: vec![0.0; count + 2], density: 1.0, end: 0.0 }
    }

    /// The value at grid point `i` inside the table.
    pub(crate) fn sample(&self, i: usize) -> f64 {
        self.values[i + 2]
    }

    /// Number of the last grid point.
    pub(crate) fn last(&self) -> usize {
        self.values.len() - 3
    }

    /// Grid points in a unit of the argument.
    pub(crate) fn density(&self) -> f64 {
        self.density
    }

    /// Sets the value at grid point `i`; [`Even::mirror`] has to follow.
    pub(crate) fn set(&mut self, i: usize, value: f64) {
        self.values[i + 2] = value;
    }

    /// Makes the table even again after [`Even::set`].
    pub(crate) fn mirror(&mut self) {
        self.values[1] = self.values[3];
        self.values[0] = self.values[4];
    }

    /// Argument at which the table ends; from there on [`Even::at`] returns 0.
    pub(crate) fn end(&self) -> f64 {
        self.end
    }

    /// The function at `x` >= 0; 0 beyond the end and for NaN.
    #[inline]
    pub(crate) fn at(&self, x: f64) -> f64 {
        if x < self.end { six_point(&self.values, x * self.density) } else { 0.0 }
    }
}

/// An even function as a cubic between each grid point and the next: less accurate than six points,
/// but three times as fast. It ends where its table does.
#[derive(Clone, Debug)]
pub(crate) struct Pieces {
    /// Coefficients of the powers of the distance from the grid point, in spacings.
    cubics: Vec<[f64; 4]>,
    density: f64,
    end: f64,
}

impl Pieces {
    /// With room for tables of `count` values.
    pub(crate) fn with_room(count: usize) -> Self {
        Self { cubics: vec![[0.0; 4]; count], density: 1.0, end: 0.0 }
    }

    /// The function of a table.
    pub(crate) fn refill(&mut self, table: &Even) {
        (self.density, self.end) = (table.density, table.end);
        self.cubics.clear();
        // The values at -1, 0, 1 and 2 spacings of each point.
        self.cubics.extend(table.values[1..].windows(4).map(|near| {
            let [before, here, next, after] = near else { return [0.0; 4] };
            let rise = next - here;
            let bend = 0.5 * (before + next) - here;
            let third = (after - before - 3.0 * rise) * (1.0 / 6.0);
            [*here, rise - bend - third, bend, third]
        }));
    }

    /// The function at `x` >= 0; 0 beyond the end and for NaN.
    #[inline]
    pub(crate) fn at(&self, x: f64) -> f64 {
        if x.is_nan() || x >= self.end {
            return 0.0;
        }
        let place = x * self.density;
        let cell = place as u32;
        let Some([a, b, c, d]) = self.cubics.get(cell as usize) else { return 0.0 };
        let part = place - f64::from(cell);
        a + part * (b + part * (c + part * d))
    }
}

#[cfg(test)]
mod tests {
    use super::{Even, Pieces};

    /// The error falls with the fourth power of the spacing, up to the end of the table.
    #[test]
    fn pieces_follow_their_table() {
        let mut off = [0.0_f64; 2];
        for (off, density) in off.iter_mut().zip([8.0, 16.0]) {
            let values: Vec<f64> = (0..64).map(|i| libm::cos(f64::from(i) / density)).collect();
            let table = Even::new(&values, density);
            let mut pieces = Pieces::with_room(64);
            pieces.refill(&table);
            let end = table.end();
            let places = (0..999).map(|i| f64::from(i) * 0.001 * end);
            *off = places.map(|x| (pieces.at(x) - libm::cos(x)).abs()).fold(0.0, f64::max);
            for x in [end, 2.0 * end, f64::INFINITY, f64::NAN] {
                assert_eq!([pieces.at(x), table.at(x)], [0.0; 2], "{x}");
            }
        }
        assert!(off[0] < 1e-5 && off[0] > 14.0 * off[1] && off[0] < 18.0 * off[1], "{off:?}");
    }
}
