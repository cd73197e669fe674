//! Solution of small symmetric positive definite systems, such as those of a mass matrix.

use crate::spatial::{JointMatrix, JointVector};

/// Solves `m x = b` for a symmetric positive definite matrix `m` by Cholesky factorisation, in
/// place: the lower triangle of `m` becomes the factor and `b` the solution. Only the lower
/// triangle of `m` is read. The solution is NaN where `m` is not positive definite.
pub(crate) fn solve_positive_definite<const N: usize>(
    m: &mut JointMatrix<N>,
    b: &mut JointVector<N>,
) {
    for j in 0..N {
        let mut d = m[(j, j)];
        for k in 0..j {
            d -= m[(j, k)] * m[(j, k)];
        }
        // The square root of a negative number makes the NaN that the caller is promised.
        let root = d.sqrt();
        m[(j, j)] = root;
        for i in j + 1..N {
            let mut sum = m[(i, j)];
            for k in 0..j {
                sum -= m[(i, k)] * m[(j, k)];
            }
            m[(i, j)] = sum / root;
        }
    }
    for i in 0..N {
        for k in 0..i {
            b[i] -= m[(i, k)] * b[k];
        }
        b[i] /= m[(i, i)];
    }
    for i in (0..N).rev() {
        for k in i + 1..N {
            b[i] -= m[(k, i)] * b[k];
        }
        b[i] /= m[(i, i)];
    }
}
