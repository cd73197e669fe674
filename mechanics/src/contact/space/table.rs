//! Even functions on a uniform grid, read by six-point interpolation. It refuses nothing: beyond
//! its end a function reads 0, and callers put what is left there themselves.

use super::super::interpolation::six_point;

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

    /// Sets the value at grid point `i`; [`Even::mirror`] has to follow.
    pub(crate) fn set(&mut self, i: usize, value: f64) {
        self.values[i + 2] = value;
    }

    /// Makes the table even again after [`Even::set`].
    pub(crate) fn mirror(&mut self) {
        self.values[1] = self.values[3];
        self.values[0] = self.values[4];
    }

    /// Where the table ends; from there on [`Even::at`] answers 0.
    pub(crate) fn end(&self) -> f64 {
        self.end
    }

    /// The function at `x` >= 0; 0 beyond the end and for NaN.
    pub(crate) fn at(&self, x: f64) -> f64 {
        if x < self.end { six_point(&self.values, x * self.density) } else { 0.0 }
    }
}
