//! Frames, rotations, twists and wrenches, and the conversions between `glam` and `nalgebra`, which
//! no other module makes. Rotations are matrices or rotation vectors, never triples of angles.
//!
//! Spatial vectors are stacked `[linear; angular]`: a twist is (velocity in m/s, angular velocity
//! in rad/s), a wrench is (force in N, moment in N m). Both belong to a point and to axes, which
//! the documentation of each function names.

use glam::{DMat3, DQuat, DVec3};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3, Vector6};

/// One number for each of `N` joints (rad, rad/s, rad/s^2, N m; m and N for prismatic joints), the
/// joint nearest to the base first.
pub type JointVector<const N: usize> = SVector<f64, N>;
/// `N` by `N` numbers, one row and one column for each joint: a mass matrix (kg m^2) or the matrix
/// of a transmission.
pub type JointMatrix<const N: usize> = SMatrix<f64, N, N>;
/// A Jacobian: rows vx vy vz wx wy wz, one column for each joint.
pub type Jacobian<const N: usize> = SMatrix<f64, 6, N>;
/// A [`JointVector`] of six joints.
pub type Joints = nalgebra::Vector6<f64>;
/// Six by six numbers: a Jacobian (rows vx vy vz wx wy wz) or a mass matrix (kg m^2) of six joints.
pub type Matrix6 = nalgebra::Matrix6<f64>;

/// Sines and cosines of six joint angles. Kinematics and dynamics at one configuration share them,
/// so that they are computed once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SinCos {
    /// Sines.
    pub s: [f64; 6],
    /// Cosines.
    pub c: [f64; 6],
}

impl SinCos {
    /// The sines and cosines of the joint angles `q` (rad).
    #[must_use]
    pub fn new(q: &Joints) -> SinCos {
        let (mut s, mut c) = ([0.0; 6], [0.0; 6]);
        for i in 0..6 {
            (s[i], c[i]) = libm::sincos(q[i]);
        }
        SinCos { s, c }
    }

    /// The sines and cosines of the same angles plus `increment` (rad), by the addition theorem and
    /// short series. The error is below 4e-16, at a fifth of the cost of [`SinCos::new`]. `None`
    /// where an increment is larger than [`SinCos::INCREMENT_MAX_RAD`] or NaN.
    #[must_use]
    pub fn incremented(&self, increment: &Joints) -> Option<SinCos> {
        let is_small = increment.iter().all(|angle| angle.abs() <= SinCos::INCREMENT_MAX_RAD);
        is_small.then(|| {
            let mut next = *self;
            for i in 0..6 {
                let (angle, square) = (increment[i], increment[i] * increment[i]);
                // The terms of the series that are left out are below 1e-18.
                let sine = angle * (1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0)));
                let versine = square * (0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0)));
                next.s[i] = self.s[i] + (self.c[i] * sine - self.s[i] * versine);
                next.c[i] = self.c[i] - (self.s[i] * sine + self.c[i] * versine);
            }
            next
        })
    }

    /// Largest increment that [`SinCos::incremented`] takes (rad).
    pub const INCREMENT_MAX_RAD: f64 = 0.01;
}

/// The pose of an inner frame in an outer one: `x_outer = rotation * x_inner + translation` (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Columns are the inner axes n, o, a in the outer frame.
    pub rotation: DMat3,
    /// Origin of the inner frame in the outer one (m).
    pub translation: DVec3,
}

impl Default for Pose {
    fn default() -> Pose {
        Pose::IDENTITY
    }
}

impl Pose {
    /// The pose of a frame in itself.
    pub const IDENTITY: Pose = Pose { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };

    /// The pose with these axes and this origin (m).
    #[must_use]
    pub const fn new(rotation: DMat3, translation: DVec3) -> Pose {
        Pose { rotation, translation }
    }

    /// The pose with the rotation matrix `r`, listed row by row (`r11 r12 r13 r21 ..`), and the
    /// origin `p` (m).
    #[must_use]
    pub const fn from_rows(r: &[f64; 9], p: &[f64; 3]) -> Pose {
        let rotation = DMat3::from_cols(
            DVec3::new(r[0], r[3], r[6]),
            DVec3::new(r[1], r[4], r[7]),
            DVec3::new(r[2], r[5], r[8]),
        );
        Pose { rotation, translation: DVec3::new(p[0], p[1], p[2]) }
    }

    /// The elements of the rotation matrix, row by row.
    #[must_use]
    pub fn rotation_rows(&self) -> [f64; 9] {
        let (n, o, a) = (self.rotation.x_axis, self.rotation.y_axis, self.rotation.z_axis);
        [n.x, o.x, a.x, n.y, o.y, a.y, n.z, o.z, a.z]
    }

    /// The rotation as a unit quaternion w, x, y, z with w >= 0.
    #[must_use]
    pub fn quaternion_wxyz(&self) -> [f64; 4] {
        let q = DQuat::from_mat3(&self.rotation);
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        [sign * q.w, sign * q.x, sign * q.y, sign * q.z]
    }

    /// The product `self * inner`: the pose in the outer frame of a frame whose pose in the inner
    /// frame is `inner`.
    #[must_use]
    pub fn compose(&self, inner: &Pose) -> Pose {
        Pose {
            rotation: self.rotation * inner.rotation,
            translation: self.rotation * inner.translation + self.translation,
        }
    }

    /// The pose of the outer frame in the inner one. The rotation must be orthonormal.
    #[must_use]
    pub fn inverse(&self) -> Pose {
        let rotation = self.rotation.transpose();
        Pose { rotation, translation: -(rotation * self.translation) }
    }

    /// The coordinates in the outer frame of the point `point` of the inner frame (m).
    #[must_use]
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// Whether all twelve numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation.is_finite()
    }
}

/// The rotation by `angle_rad` about x.
#[must_use]
pub fn rotation_x(angle_rad: f64) -> DMat3 {
    let (s, c) = libm::sincos(angle_rad);
    DMat3::from_cols(DVec3::X, DVec3::new(0.0, c, s), DVec3::new(0.0, -s, c))
}

/// The rotation by `angle_rad` about y.
#[must_use]
pub fn rotation_y(angle_rad: f64) -> DMat3 {
    let (s, c) = libm::sincos(angle_rad);
    DMat3::from_cols(DVec3::new(c, 0.0, -s), DVec3::Y, DVec3::new(s, 0.0, c))
}

/// The rotation by `angle_rad` about z.
#[must_use]
pub fn rotation_z(angle_rad: f64) -> DMat3 {
    let (s, c) = libm::sincos(angle_rad);
    DMat3::from_cols(DVec3::new(c, s, 0.0), DVec3::new(-s, c, 0.0), DVec3::Z)
}

/// The rotation about `axis` (unit length) by `angle_rad`, by Rodrigues' formula.
#[must_use]
pub fn rotation_about(axis: DVec3, angle_rad: f64) -> DMat3 {
    let (s, c) = libm::sincos(angle_rad);
    let v = axis * (1.0 - c);
    DMat3::from_cols(
        v.x * axis + DVec3::new(c, s * axis.z, -s * axis.y),
        v.y * axis + DVec3::new(-s * axis.z, c, s * axis.x),
        v.z * axis + DVec3::new(s * axis.y, -s * axis.x, c),
    )
}

/// The rotation vector (axis times angle in `[0, pi]`, rad) of the rotation from `from` to `to`, in
/// the axes of `from`: the matrix logarithm of `from^T to`.
#[must_use]
pub fn rotation_vector(from: &DMat3, to: &DMat3) -> DVec3 {
    let q = DQuat::from_mat3(&(from.transpose() * *to));
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let v = DVec3::new(q.x, q.y, q.z) * sign;
    let sine = v.length();
    if sine == 0.0 {
        return DVec3::ZERO;
    }
    v * (2.0 * libm::atan2(sine, q.w * sign) / sine)
}

/// The rotation matrix of a rotation vector (rad): the matrix exponential of its cross product
/// matrix.
#[must_use]
pub fn rotation_from_vector(vector: DVec3) -> DMat3 {
    let angle = vector.length();
    if angle == 0.0 { DMat3::IDENTITY } else { rotation_about(vector / angle, angle) }
}

/// The angle in `[-pi, pi)` that differs from `angle_rad` by whole turns (rad). An angle that
/// already lies there is returned unchanged. NaN and infinities give NaN.
#[must_use]
pub fn wrap_angle(angle_rad: f64) -> f64 {
    use core::f64::consts::{PI, TAU};
    if (-PI..PI).contains(&angle_rad) {
        return angle_rad;
    }
    let turned = if (-3.0 * PI..3.0 * PI).contains(&angle_rad) {
        if angle_rad < 0.0 { angle_rad + TAU } else { angle_rad - TAU }
    } else {
        libm::remainder(angle_rad, TAU)
    };
    if turned >= PI { turned - TAU } else { turned.clamp(-PI, PI) }
}

/// A vector of `glam` as one of `nalgebra`.
#[must_use]
pub fn to_nalgebra_vector(v: DVec3) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

/// A vector of `nalgebra` as one of `glam`.
#[must_use]
pub fn to_glam_vector(v: &Vector3<f64>) -> DVec3 {
    DVec3::new(v.x, v.y, v.z)
}

/// A matrix of `glam` as one of `nalgebra`.
#[must_use]
pub fn to_nalgebra_matrix(m: &DMat3) -> Matrix3<f64> {
    Matrix3::from_columns(&[
        to_nalgebra_vector(m.x_axis),
        to_nalgebra_vector(m.y_axis),
        to_nalgebra_vector(m.z_axis),
    ])
}

/// A matrix of `nalgebra` as one of `glam`.
#[must_use]
pub fn to_glam_matrix(m: &Matrix3<f64>) -> DMat3 {
    DMat3::from_cols_array(&[m.m11, m.m21, m.m31, m.m12, m.m22, m.m32, m.m13, m.m23, m.m33])
}

/// The twist or wrench `[linear; angular]` of its two halves.
#[must_use]
pub fn spatial_vector(linear: DVec3, angular: DVec3) -> Vector6<f64> {
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

/// The linear and the angular half of a twist or wrench.
#[must_use]
pub fn linear_and_angular(v: &Vector6<f64>) -> (DVec3, DVec3) {
    (DVec3::new(v[0], v[1], v[2]), DVec3::new(v[3], v[4], v[5]))
}

/// The twist or wrench `v`, given in the axes of an inner frame, in the axes of the outer frame,
/// where `rotation` is that of the inner frame in the outer one. The point to which it belongs
/// stays.
#[must_use]
pub fn rotate_spatial_vector(rotation: &DMat3, v: &Vector6<f64>) -> Vector6<f64> {
    let (linear, angular) = linear_and_angular(v);
    spatial_vector(*rotation * linear, *rotation * angular)
}

/// The wrench about the point that lies `shift` (m) from the point of `wrench`, in the same axes:
/// the moment becomes `m - shift x f`.
#[must_use]
pub fn wrench_at_point(wrench: &Vector6<f64>, shift: DVec3) -> Vector6<f64> {
    let (force, moment) = linear_and_angular(wrench);
    spatial_vector(force, moment - shift.cross(force))
}

/// The twist of the point that lies `shift` (m) from the point of `twist`, on the same body and in
/// the same axes: the velocity becomes `v + w x shift`.
#[must_use]
pub fn twist_at_point(twist: &Vector6<f64>, shift: DVec3) -> Vector6<f64> {
    let (linear, angular) = linear_and_angular(twist);
    spatial_vector(linear + angular.cross(shift), angular)
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::{PI, TAU};

    #[test]
    fn incremented_sines_are_those_of_the_incremented_angles() {
        let near = SinCos::INCREMENT_MAX_RAD;
        for i in 0..1000 {
            let q = Joints::from_fn(|j, _| 0.013 * f64::from(i) - 6.0 + 0.7 * j as f64);
            let by = Joints::new(near, -near, 1e-3, -1e-5, 1e-9, 0.0);
            let (found, exact) =
                (SinCos::new(&q).incremented(&by).unwrap(), SinCos::new(&(q + by)));
            for j in 0..6 {
                // The sum of the angles is itself rounded.
                let fair = 4e-16 + f64::EPSILON * q[j].abs();
                assert!((found.s[j] - exact.s[j]).abs() < fair, "{i} {j}");
                assert!((found.c[j] - exact.c[j]).abs() < fair, "{i} {j}");
            }
        }
        for far in [1.1 * near, f64::NAN, f64::INFINITY] {
            let by = Joints::new(0.0, 0.0, far, 0.0, 0.0, 0.0);
            assert_eq!(SinCos::new(&Joints::zeros()).incremented(&by), None);
        }
    }

    #[test]
    fn a_pose_and_its_inverse_cancel() {
        let pose = Pose::new(
            rotation_z(0.3) * rotation_y(-1.1) * rotation_x(2.0),
            DVec3::new(0.1, -2.0, 3.0),
        );
        let back = pose.compose(&pose.inverse());
        assert!(back.translation.length() < 1e-15);
        assert!(back.rotation.abs_diff_eq(DMat3::IDENTITY, 1e-15));
        let p = DVec3::new(1.0, 2.0, 3.0);
        assert!((pose.inverse().apply(pose.apply(p)) - p).length() < 1e-14);
        let rows = pose.rotation_rows();
        assert_eq!(Pose::from_rows(&rows, &pose.translation.to_array()), pose);
        assert!((rows[1] - pose.rotation.y_axis.x).abs() < f64::EPSILON);
    }

    #[test]
    fn quaternions_have_a_positive_scalar_and_the_right_axis() {
        let q = Pose::new(rotation_z(-3.0), DVec3::ZERO).quaternion_wxyz();
        assert!((q[0] - libm::cos(1.5)).abs() < 1e-15 && (q[3] + libm::sin(1.5)).abs() < 1e-15);
        let about = rotation_about(DVec3::new(0.6, 0.0, 0.8), 1.25);
        let q = Pose::new(about, DVec3::ZERO).quaternion_wxyz();
        assert!((q[1] - 0.6 * libm::sin(0.625)).abs() < 1e-15);
    }

    #[test]
    fn angles_wrap_into_the_half_open_turn() {
        assert!(wrap_angle(PI) == -PI && wrap_angle(-PI) == -PI);
        assert!((wrap_angle(1.0 + TAU) - 1.0).abs() < 1e-15);
        assert!((wrap_angle(-1.0 - 5.0 * TAU) + 1.0).abs() < 1e-14);
        for big in [1e6, -1e9, 1e300, 7.0 * PI, -3.0 * PI, 3.0 * PI] {
            assert!((-PI..PI).contains(&wrap_angle(big)), "{big}");
        }
        assert!(wrap_angle(f64::NAN).is_nan() && wrap_angle(f64::INFINITY).is_nan());
    }

    #[test]
    fn power_does_not_depend_on_the_point() {
        let twist = spatial_vector(DVec3::new(0.1, -0.2, 0.3), DVec3::new(1.0, 2.0, -0.5));
        let wrench = spatial_vector(DVec3::new(4.0, 5.0, 6.0), DVec3::new(-0.1, 0.7, 0.2));
        let shift = DVec3::new(0.3, -0.1, 0.9);
        let moved = twist_at_point(&twist, shift).dot(&wrench_at_point(&wrench, shift));
        assert!((moved - twist.dot(&wrench)).abs() < 1e-14);
        let r = rotation_x(0.7);
        assert!(
            (rotate_spatial_vector(&r, &twist).dot(&rotate_spatial_vector(&r, &wrench))
                - twist.dot(&wrench))
            .abs()
                < 1e-14
        );
        assert_eq!(to_glam_matrix(&to_nalgebra_matrix(&r)), r);
        assert_eq!(to_glam_vector(&to_nalgebra_vector(shift)), shift);
    }
}
