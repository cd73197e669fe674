//! Least squares: motion from counts, and torque constant and friction from motion and codes.

use nalgebra::{Matrix3, Vector3};

/// Cycles on each side of an instant from whose counts speed and acceleration are taken.
pub(crate) const HALF_WINDOW: usize = 16;

/// Position, speed and acceleration at the middle of a window of `values` at these times (s), by a
/// parabola of least squares; zeros for a window without length.
pub(crate) fn parabola(times_s: &[f64], values: &[f64]) -> [f64; 3] {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    let (Some(first), Some(last)) = (times_s.first(), times_s.last()) else { return [0.0; 3] };
    let (middle, half) = (0.5 * (first + last), 0.5 * (last - first));
    for (time_s, value) in times_s.iter().zip(values) {
        let t = (time_s - middle) / half;
        let row = Vector3::new(1.0, t, t * t);
        normal += row * row.transpose();
        right += row * *value;
    }
    let solved = normal.cholesky().map(|factor| factor.solve(&right)).unwrap_or_default();
    let scale = 1.0 / half;
    [solved[0], solved[1] * scale, 2.0 * solved[2] * scale * scale]
}

/// What drives a joint at one instant: the code in the joint's direction, the torque that the
/// motion takes (N m), and the speed (rad/s).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row {
    pub(crate) code: f64,
    pub(crate) torque_nm: f64,
    pub(crate) speed_rad_s: f64,
}

/// The torque of a joint for one code, and its friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TorqueFit {
    pub(crate) nm_per_code: f64,
    pub(crate) coulomb_nm: f64,
    pub(crate) viscous_nms_rad: f64,
    /// Root mean square of what is left (N m).
    pub(crate) residual_nm: f64,
    /// How much of the codes' variance the torque of the motion explains by itself.
    pub(crate) share_of_motion: f64,
}

/// `code = torque / k + coulomb / k sign(speed) + viscous / k speed`, solved for the three.
pub(crate) fn torque_fit(rows: &[Row]) -> Option<TorqueFit> {
    let (mut normal, mut right) = (Matrix3::<f64>::zeros(), Vector3::zeros());
    for row in rows {
        let terms = Vector3::new(row.torque_nm, row.speed_rad_s.signum(), row.speed_rad_s);
        normal += terms * terms.transpose();
        right += terms * row.code;
    }
    // Each column is divided by its size, so that the factor does not depend on units.
    let size = Vector3::from_fn(|i, _| libm::sqrt(normal[(i, i)]).max(f64::MIN_POSITIVE));
    let scaled = Matrix3::from_fn(|i, j| normal[(i, j)] / (size[i] * size[j]));
    let factor = scaled.cholesky()?;
    let solved = factor.solve(&right.component_div(&size)).component_div(&size);
    let [per_torque, coulomb, viscous] = [solved[0], solved[1], solved[2]];
    let mut squares = 0.0;
    for row in rows {
        let fitted = per_torque * row.torque_nm
            + coulomb * row.speed_rad_s.signum()
            + viscous * row.speed_rad_s;
        squares += (row.code - fitted) * (row.code - fitted);
    }
    let all: f64 = rows.iter().map(|row| row.code * row.code).sum();
    let nm_per_code = 1.0 / per_torque;
    Some(TorqueFit {
        nm_per_code,
        coulomb_nm: coulomb * nm_per_code,
        viscous_nms_rad: viscous * nm_per_code,
        residual_nm: libm::sqrt(squares / rows.len().max(1) as f64) * nm_per_code.abs(),
        share_of_motion: per_torque * per_torque * normal[(0, 0)] / all,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_found_exactly() {
        let even: Vec<f64> = (0..=2 * HALF_WINDOW).map(|i| 0.0025 * i as f64).collect();
        // Cycles that began late now and then.
        let uneven: Vec<f64> =
            even.iter().enumerate().map(|(i, t)| t + 7e-4 * f64::from(i % 3 == 1)).collect();
        for times in [even, uneven] {
            let middle = 0.5 * (times[0] + times[2 * HALF_WINDOW]);
            let value = |t: &f64| 1.5 - 0.3 * (t - middle) + 2.0 * (t - middle) * (t - middle);
            let values: Vec<f64> = times.iter().map(value).collect();
            let found = parabola(&times, &values);
            for (found, due) in found.into_iter().zip([1.5, -0.3, 4.0]) {
                assert!((found - due).abs() < 1e-9, "{found} {due}");
            }
        }
        assert_eq!(parabola(&[], &[]), [0.0; 3]);
    }

    #[test]
    fn torque_and_friction_are_found_and_nothing_is_made_up_of_nothing() {
        let row = |i: i32| {
            let x = 0.1 * f64::from(i);
            let (torque_nm, speed_rad_s) = (libm::sin(1.3 * x), libm::cos(x));
            let code = (torque_nm + 0.6 * speed_rad_s.signum() + 0.2 * speed_rad_s) / 0.004;
            Row { code, torque_nm, speed_rad_s }
        };
        let rows: Vec<Row> = (0..300).map(row).collect();
        let fit = torque_fit(&rows).unwrap();
        assert!((fit.nm_per_code - 0.004).abs() < 1e-9);
        assert!((fit.coulomb_nm - 0.6).abs() < 1e-9 && (fit.viscous_nms_rad - 0.2).abs() < 1e-9);
        assert_eq!(torque_fit(&[]), None);
    }
}
