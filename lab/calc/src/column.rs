//! A column of a Jacobian: derivatives of features with respect to one motion, with their errors.

/// Error of a derivative over its difference to the derivative on half as many places. At first
/// order, which an edge between places or a corner leaves, the factor is 1; 2 belongs to order 0.6.
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

    /// What another column, of half as many places, differs by is an error as well; without one
    /// none is known.
    pub(super) fn or_coarser(mut self, other: Option<&Column>) -> Self {
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

    /// The values, with what a second way of computing them differs by.
    pub(super) fn beside(values: Vec<Option<f64>>, other: &[Option<f64>]) -> Self {
        let errors = values.iter().zip(other).map(|(a, b)| Some(((*a)? - (*b)?).abs()));
        Self { errors: errors.collect(), values }
    }
}
