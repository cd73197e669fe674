//! Joint speeds from a twist of the tool by damped least squares, with the choice of the damping
//! near singularities and the limitation of the speeds.
//!
//! Nakamura and Hanafusa (1986), Wampler (1986); damping that grows as a singularity comes near:
//! Chiaverini, Siciliano and Egeland (1994).

use crate::spatial::{Joints, Matrix6};
use nalgebra::Vector6;

/// The joint speeds `qd` (rad/s) that minimise `|J qd - x|^2 + lambda^2 |qd|^2`, that is `qd = J^T
/// (J J^T + lambda^2 I)^-1 x` with equal weights of all rows. `jacobian` is J with rows vx vy vz wx
/// wy wz, `twist` is x = `[v; w]` (m/s, rad/s) in the frame of the Jacobian, `lambda` has the mixed
/// units of the Jacobian and its sign does not matter.
///
/// The 12 by 6 system `[J; lambda I]` is solved by Householder reflections, which unlike the normal
/// equations do not square the condition number. `None` where that matrix is singular (lambda = 0
/// at a singularity) or a number is not finite.
#[must_use]
pub fn damped_least_squares(
    jacobian: &Matrix6,
    twist: &Vector6<f64>,
    lambda: f64,
) -> Option<Joints> {
    // Columns of the stacked matrix are the rows of `a`.
    let mut a = [[0.0; 12]; 6];
    let mut b = [0.0; 12];
    for (column, stacked) in a.iter_mut().enumerate() {
        for (row, value) in stacked.iter_mut().take(6).enumerate() {
            *value = jacobian[(row, column)];
        }
        stacked[6 + column] = lambda;
    }
    b[..6].copy_from_slice(twist.as_slice());
    let largest = jacobian.amax().max(lambda.abs());
    let mut diagonal = [0.0; 6];
    for (k, pivot) in diagonal.iter_mut().enumerate() {
        *pivot = apply_householder_reflection(&mut a, &mut b, k);
        if pivot.is_nan() || pivot.abs() <= 1e-15 * largest {
            return None;
        }
    }
    let mut qd = Joints::zeros();
    for k in (0..6).rev() {
        let mut sum = b[k];
        for j in k + 1..6 {
            sum -= a[j][k] * qd[j];
        }
        qd[k] = sum / diagonal[k];
    }
    qd.iter().all(|x| x.is_finite()).then_some(qd)
}

/// Applies the Householder reflection that zeroes column `k` of the stacked matrix below its
/// diagonal to all later columns and to the right-hand side `b`. Columns are stored as rows of `a`.
/// Returns the new diagonal element.
fn apply_householder_reflection(a: &mut [[f64; 12]; 6], b: &mut [f64; 12], k: usize) -> f64 {
    let norm = a[k][k..].iter().map(|x| x * x).sum::<f64>().sqrt();
    if norm == 0.0 {
        return 0.0;
    }
    // The sign that avoids cancellation in `v[k]`.
    let alpha = if a[k][k] > 0.0 { -norm } else { norm };
    let mut v = [0.0; 12];
    v[k..].copy_from_slice(&a[k][k..]);
    v[k] -= alpha;
    let scale = 1.0 / (norm * (norm + a[k][k].abs()));
    let apply = |target: &mut [f64; 12]| {
        let along = scale * (k..12).map(|i| v[i] * target[i]).sum::<f64>();
        for i in k..12 {
            target[i] -= along * v[i];
        }
    };
    for column in a.iter_mut().skip(k + 1) {
        apply(column);
    }
    apply(b);
    alpha
}

/// The squared damping factor lambda^2 near a singularity (Chiaverini, Siciliano and Egeland 1994):
/// `lambda_max^2 (1 - (distance/threshold)^2)` where `distance`, a scaled distance from the
/// singularity or the smallest singular value, is below `threshold`, and 0 elsewhere. NaN counts as
/// distance 0. A threshold that is not positive means no damping.
#[must_use]
pub fn damping_squared(distance: f64, threshold: f64, lambda_max: f64) -> f64 {
    let ratio = if distance.is_nan() { 0.0 } else { distance.abs() / threshold };
    if threshold.is_nan() || threshold <= 0.0 || ratio >= 1.0 {
        return 0.0;
    }
    lambda_max * lambda_max * (1.0 - ratio * ratio)
}

/// The joint speeds `qd` times one common factor, so that no joint is faster than `limit` (both
/// rad/s) and the direction of the motion is kept, and that factor in `[0, 1]`. For a vector that
/// is not finite both are 0.
#[must_use]
pub fn scale_to_speed_limits(qd: &Joints, limit: &Joints) -> (Joints, f64) {
    if !qd.iter().all(|x| x.is_finite()) {
        return (Joints::zeros(), 0.0);
    }
    let mut factor: f64 = 1.0;
    for i in 0..6 {
        if qd[i].abs() * factor > limit[i] {
            factor = limit[i] / qd[i].abs();
        }
    }
    (qd * factor, factor)
}

/// Most iterations of the singular value decomposition; a Jacobian needs about ten.
const SVD_ITERATIONS_MAX: usize = 200;

/// Singular values of a Jacobian, largest first (mixed units of m and rad). All are NaN where a
/// number is not finite or so large that the iteration does not converge.
#[must_use]
pub fn singular_values(jacobian: &Matrix6) -> [f64; 6] {
    if !jacobian.iter().all(|x| x.is_finite()) {
        return [f64::NAN; 6];
    }
    let svd = jacobian.try_svd(false, false, 5.0 * f64::EPSILON, SVD_ITERATIONS_MAX);
    svd.map_or([f64::NAN; 6], |svd| svd.singular_values.into())
}
