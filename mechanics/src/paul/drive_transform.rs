//! Paul's drive transform between two orientations (Paul 1981, chapter 5): the rotation by two
//! angles in which the approach axis takes the shortest way. Translations are straight lines and
//! not part of it.

use core::f64::consts::{FRAC_PI_2, PI};

use glam::{DMat3, DVec3};

use crate::spatial::{rotation_y, rotation_z, wrap_angle};

/// Below this angle theta the rotation of the approach axis has no direction psi (rad).
const THETA_MIN_RAD: f64 = 1e-9;

/// Paul's drive transform: the approach axis rotates by `theta` about the axis (-sin psi, cos psi,
/// 0) of the first frame, then the hand by `phi` about the approach axis. These are the Euler
/// angles z-y-z (psi, theta, phi - psi). All angles are in rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct DriveTransform {
    pub(super) psi: f64,
    pub(super) theta: f64,
    pub(super) phi: f64,
}

impl DriveTransform {
    /// The drive transform from the orientation `from` to the orientation `to`.
    pub(super) fn between(from: &DMat3, to: &DMat3) -> DriveTransform {
        let relative = from.transpose() * *to;
        let (nx, ny, nz) = (relative.z_axis.x, relative.z_axis.y, relative.z_axis.z);
        let psi = libm::atan2(ny, nx);
        let theta = libm::atan2(libm::hypot(nx, ny), nz);
        let (sin_psi, cos_psi) = libm::sincos(psi);
        let (sin_theta, cos_theta) = libm::sincos(theta);
        let versine = 1.0 - cos_theta;
        // The y axis of the frame after the rotation by theta alone, from which phi is measured.
        let y_axis = DVec3::new(
            -sin_psi * cos_psi * versine,
            cos_psi * cos_psi * versine + cos_theta,
            -sin_psi * sin_theta,
        );
        let phi = libm::atan2(y_axis.dot(relative.x_axis), y_axis.dot(relative.y_axis));
        DriveTransform { psi, theta, phi }
    }

    /// The rotation matrix of the drive transform.
    pub(super) fn rotation(&self) -> DMat3 {
        rotation_z(self.psi) * rotation_y(self.theta) * rotation_z(self.phi - self.psi)
    }

    /// The angular velocity (rad/s) in the axes of the first frame, at the rates `rate` of the
    /// three angles (rad/s).
    pub(super) fn angular_velocity(&self, rate: &DriveTransform) -> DVec3 {
        let about_psi = rotation_z(self.psi);
        DVec3::Z * rate.psi
            + about_psi.y_axis * rate.theta
            + (about_psi * rotation_y(self.theta)).z_axis * (rate.phi - rate.psi)
    }

    /// Whether theta is too small for the direction psi to be defined.
    fn has_no_direction(&self) -> bool {
        self.theta.abs() < THETA_MIN_RAD
    }
}

/// Aligns the directions psi of the drive transforms before and after a corner, so that psi changes
/// by at most a quarter turn: where the wrapped difference is larger, `before` is replaced by the
/// same rotation with psi half a turn further and theta negative. Returns psi at the start of the
/// transition and its change (rad). `None` stands for a rest, which takes the direction of the
/// other side.
pub(super) fn align_directions(
    before: Option<&mut DriveTransform>,
    after: Option<&DriveTransform>,
) -> (f64, f64) {
    match (before, after) {
        (Some(before), Some(after)) => {
            if before.has_no_direction() {
                return (after.psi, 0.0);
            }
            if after.has_no_direction() {
                return (before.psi, 0.0);
            }
            let mut sweep = wrap_angle(after.psi - before.psi);
            if sweep.abs() > FRAC_PI_2 {
                before.psi += PI;
                before.theta = -before.theta;
                sweep = wrap_angle(after.psi - before.psi);
            }
            (before.psi, sweep)
        }
        (Some(drive), None) => (drive.psi, 0.0),
        (None, Some(drive)) => (drive.psi, 0.0),
        (None, None) => (0.0, 0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spatial::{rotation_from_vector, rotation_vector, rotation_x};

    fn near(a: &DMat3, b: &DMat3, tolerance: f64) -> bool {
        a.abs_diff_eq(*b, tolerance)
    }

    fn some_rotations() -> Vec<DMat3> {
        let mut list = vec![DMat3::IDENTITY, rotation_x(PI), rotation_y(PI), rotation_z(PI)];
        for n in 0..200 {
            let n = f64::from(n);
            list.push(rotation_z(1.7 * n) * rotation_y(0.9 * n) * rotation_x(2.3 * n));
        }
        list.extend([1e-12, 1e-9, 1e-7].map(rotation_x));
        list.extend([1e-12, 1e-7].map(|off| rotation_y(PI - off)));
        list
    }

    #[test]
    fn a_drive_and_a_vector_lead_from_one_to_the_other() {
        let from = rotation_z(0.4) * rotation_x(-1.0);
        for to in some_rotations() {
            let drive = DriveTransform::between(&from, &to);
            assert!(near(&(from * drive.rotation()), &to, 4e-15), "{drive:?}");
            let vector = rotation_vector(&from, &to);
            assert!(near(&(from * rotation_from_vector(vector)), &to, 4e-15), "{vector:?}");
            assert!(vector.length() <= PI + 1e-15);
        }
    }

    #[test]
    fn angular_velocity_is_the_rate_of_the_rotation() {
        let (at, rate) = (
            DriveTransform { psi: 0.7, theta: -1.2, phi: 2.0 },
            DriveTransform { psi: 0.3, theta: 0.5, phi: -0.9 },
        );
        let step = 1e-5;
        let after = |s: f64| DriveTransform {
            psi: at.psi + rate.psi * s,
            theta: at.theta + rate.theta * s,
            phi: at.phi + rate.phi * s,
        };
        let (a, b) = (after(-step).rotation(), after(step).rotation());
        // In the axes of the first frame: dR R^T = skew(w).
        let skew = (b - a) * at.rotation().transpose() * (0.5 / step);
        let seen = DVec3::new(skew.y_axis.z, skew.z_axis.x, skew.x_axis.y);
        assert!((seen - at.angular_velocity(&rate)).length() < 1e-9);
    }

    #[test]
    fn directions_are_wrapped_before_and_after_they_are_tested() {
        let drive = |psi: f64| DriveTransform { psi, theta: 0.4, phi: 0.0 };
        // 3.1 and -3.1 are 0.08 apart, not 6.2: no reversal.
        let mut before = drive(3.1);
        let (_, sweep) = align_directions(Some(&mut before), Some(&drive(-3.1)));
        assert!((sweep - (2.0 * PI - 6.2)).abs() < 1e-14 && before == drive(3.1));
        // Opposite directions: the drive before turns round.
        let mut before = drive(0.0);
        let (psi, sweep) = align_directions(Some(&mut before), Some(&drive(3.0)));
        assert!((psi - PI).abs() < 1e-15 && (sweep - (3.0 - PI)).abs() < 1e-15);
        assert!((before.theta + 0.4).abs() < 1e-15);
        // No turn on one side: the other's direction.
        let mut still = DriveTransform { psi: 1.0, theta: 1e-10, phi: 0.2 };
        assert_eq!(align_directions(Some(&mut still), Some(&drive(2.0))), (2.0, 0.0));
        assert_eq!(align_directions(Some(&mut drive(2.0)), Some(&still)), (2.0, 0.0));
        assert_eq!(align_directions(None, Some(&drive(2.0))), (2.0, 0.0));
    }
}
