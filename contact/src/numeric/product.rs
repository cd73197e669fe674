//! Scalar products in two orders of summation. Results are compared bit by bit, so neither order
//! can replace the other: long rows of the contact solvers are summed in eight partial sums that
//! fit wide registers, short rows and those of the finite elements from the first term to the last.

/// Partial sums of [`dot`].
const PARTIAL_SUMS: usize = 8;

/// Scalar product, from eight terms on in eight partial sums.
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let plain = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    if a.len() < PARTIAL_SUMS {
        return plain(a, b);
    }
    let ((a, rest_a), (b, rest_b)) = (a.as_chunks::<PARTIAL_SUMS>(), b.as_chunks::<PARTIAL_SUMS>());
    let mut sums = [0.0; PARTIAL_SUMS];
    for (a, b) in a.iter().zip(b) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f64>() + plain(rest_a, rest_b)
}

/// Scalar product of the first D terms, summed from the first to the last.
pub(crate) fn dot_in_order<const D: usize>(a: &[f64], b: &[f64; D]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
