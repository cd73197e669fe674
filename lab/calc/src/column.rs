//! A column of a Jacobian: derivatives of features with respect to one motion, with their errors.

/// Ratio of the error of a derivative to its difference from the derivative on half as many points.
/// At first order, which an edge between two points or a corner leaves, the ratio is 1; a ratio of
/// 2 covers an order of convergence down to 0.6.
const COARSER_ERROR_FACTOR: f64 = 2.0;

/// Derivatives of all features with respect to one motion, and their errors.
#[derive(Default)]
pub(super) struct Column {
    pub(super) values: Vec<Option<f64>>,
    pub(super) errors: Vec<Option<f64>>,
}

impl Column {
    pub(super) fn undefined(count: usize) -> Self {
        Self { values: vec![None; count], errors: vec![None; count] }
    }

    /// Adds to the errors the difference from another column on half as many points. Without such a
    /// column no error is known.
    pub(super) fn with_coarser(mut self, other: Option<&Column>) -> Self {
        for (i, error) in self.errors.iter_mut().enumerate() {
            let pair = other.and_then(|other| other.values[i]).zip(self.values[i]);
            *error = error
                .zip(pair)
                .map(|(error, (a, b))| error.max(COARSER_ERROR_FACTOR * (a - b).abs()));
        }
        self
    }

    pub(super) fn exact(values: Vec<Option<f64>>) -> Self {
        let errors = values.iter().map(|value| value.map(|_| 0.0)).collect();
        Self { values, errors }
    }

    /// The values, with their difference from a second computation as the error.
    pub(super) fn with_comparison(values: Vec<Option<f64>>, other: &[Option<f64>]) -> Self {
        let errors = values.iter().zip(other).map(|(a, b)| Some(((*a)? - (*b)?).abs()));
        Self { errors: errors.collect(), values }
    }
}
