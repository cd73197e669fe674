//! The construction of a chain from descriptions of its joints. It is refused, with the number of
//! the joint, where a length or mass is not finite or implausibly large, an axis has no direction,
//! a rotation is not orthonormal, or limits are reversed.

use core::fmt;

use super::spherical_wrist::SphericalWrist;
use super::{Chain, JointKind, Limits, Link, MAX_JOINTS};
use crate::rigid_body::{Body, GRAVITY_M_S2};
use crate::spatial::{JointVector, Pose, rotation_x, rotation_z};
use glam::{DMat3, DVec3};

/// Largest length of an arm (m); also the largest angle of a row (rad) and the largest gravity
/// (m/s^2).
const LENGTH_MAX_M: f64 = 1e3;
/// Largest mass, inertia, limit, speed, acceleration or effort, in its own SI unit.
const VALUE_MAX: f64 = 1e9;
/// Largest difference of an element of `R^T R` from that of the identity, for the rotation R of a
/// frame (1); also of an inertia from symmetry (kg m^2). Callers make rotations orthonormal to
/// rounding.
const ORTHONORMALITY_TOLERANCE: f64 = 1e-9;
/// An angle within this of a multiple of a quarter turn is taken as that multiple (rad), because
/// the cosine of pi/2 in `f64` is not zero but that of the arm is.
const QUARTER_TURN_TOLERANCE_RAD: f64 = 1e-12;

/// The description of one joint and of the link that it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSpec {
    /// Pose of the frame of the joint at value zero in the frame of the joint before it, or in the
    /// base frame for the first joint.
    pub origin: Pose,
    /// Axis in the frame of the joint, of any length but zero.
    pub axis: DVec3,
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// The link, in the frame of the joint, which moves with it.
    pub body: Body,
    /// Lower limit (rad or m).
    pub q_min: f64,
    /// Upper limit (rad or m).
    pub q_max: f64,
    /// Largest speed (rad/s or m/s).
    pub speed_max: f64,
    /// Largest acceleration for planning (rad/s^2 or m/s^2).
    pub acceleration_max: f64,
    /// Largest torque (N m) or force (N).
    pub effort_max: f64,
    /// Reflected inertia of the drive at the joint (kg m^2 or kg).
    pub reflected_inertia: f64,
}

impl Default for JointSpec {
    /// A revolute joint about z without mass, with limits of one turn in either direction, 1 rad/s,
    /// 1 rad/s^2 and 1 N m.
    fn default() -> JointSpec {
        JointSpec {
            origin: Pose::IDENTITY,
            axis: DVec3::Z,
            kind: JointKind::Revolute,
            body: Body { mass_kg: 0.0, com_m: DVec3::ZERO, inertia_kg_m2: DMat3::ZERO },
            q_min: -core::f64::consts::TAU,
            q_max: core::f64::consts::TAU,
            speed_max: 1.0,
            acceleration_max: 1.0,
            effort_max: 1.0,
            reflected_inertia: 0.0,
        }
    }
}

/// A row of standard (distal) Denavit-Hartenberg parameters, `Rz(theta) Tz(d) Tx(a) Rx(alpha)`, for
/// a joint that rotates by theta. The body of `spec` is in the distal frame, after the whole row;
/// the origin and the axis of `spec` are ignored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DhRow {
    /// Length along x (m).
    pub a_m: f64,
    /// Offset along z (m).
    pub d_m: f64,
    /// Twist about x (rad); within 1e-12 of a quarter turn it is that quarter turn.
    pub alpha_rad: f64,
    /// Offset that is added to the value of the joint (rad).
    pub theta_rad: f64,
    /// Limits and link.
    pub spec: JointSpec,
}

/// The reason why a chain cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChainError {
    /// Index of the joint, 0 the first. The number of joints stands for the tool or for the whole
    /// chain.
    pub joint: usize,
    /// The violated condition.
    pub what: &'static str,
}

impl fmt::Display for ChainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "joint {}: {}", self.joint + 1, self.what)
    }
}

impl std::error::Error for ChainError {}

impl<const N: usize> Chain<N> {
    /// A chain of joints, the one nearest to the base first, and the pose of the tool in the frame
    /// of the last joint. Gravity is 9.81 m/s^2 along -z of the base.
    ///
    /// # Errors
    /// [`ChainError`].
    pub fn new(joints: &[JointSpec; N], tool: &Pose) -> Result<Chain<N>, ChainError> {
        if N == 0 || N > MAX_JOINTS {
            return Err(ChainError { joint: N, what: "a chain has 1 to 9 joints" });
        }
        for (joint, spec) in joints.iter().enumerate() {
            spec.check().map_err(|what| ChainError { joint, what })?;
        }
        check_rigid(tool).map_err(|what| ChainError { joint: N, what })?;
        let mut links = [Link {
            origin: Pose::IDENTITY,
            kind: JointKind::Revolute,
            body: JointSpec::default().body,
        }; N];
        // The rotation by which the z axis of the frame before was aligned with the axis of its
        // joint.
        let mut aligned = DMat3::IDENTITY;
        let mut length = tool.translation.length();
        for (link, spec) in links.iter_mut().zip(joints) {
            let align = rotation_from_z_to(spec.axis.normalize());
            let mount = Pose::new(aligned.transpose(), DVec3::ZERO).compose(&spec.origin);
            link.origin = mount.compose(&Pose::new(align, DVec3::ZERO));
            link.kind = spec.kind;
            link.body = spec.body.expressed_in(&Pose::new(align.transpose(), DVec3::ZERO));
            length += spec.origin.translation.length();
            aligned = align;
        }
        let column = |of: fn(&JointSpec) -> f64| JointVector::<N>::from_fn(|i, _| of(&joints[i]));
        let mut chain = Chain {
            links,
            tool: Pose::new(aligned.transpose(), DVec3::ZERO).compose(tool),
            base_acceleration: DVec3::new(0.0, 0.0, GRAVITY_M_S2),
            base_m: DVec3::ZERO,
            limits: Limits {
                q_min: column(|j| j.q_min),
                q_max: column(|j| j.q_max),
                speed_max: column(|j| j.speed_max),
                acceleration_max: column(|j| j.acceleration_max),
                effort_max: column(|j| j.effort_max),
            },
            reflected_inertia: column(|j| j.reflected_inertia),
            #[expect(clippy::cast_precision_loss, reason = "at most nine")]
            mean_link_m: (length / N as f64).max(1e-3),
            wrist: None,
        };
        chain.wrist = SphericalWrist::from_chain(&chain);
        Ok(chain)
    }

    /// A chain of Denavit-Hartenberg rows and the pose of the tool in the frame after the last row.
    ///
    /// # Errors
    /// [`ChainError`].
    pub fn from_dh(rows: &[DhRow; N], tool: &Pose) -> Result<Chain<N>, ChainError> {
        let mut joints = [JointSpec::default(); N];
        let mut before = Pose::IDENTITY;
        for (joint, row) in rows.iter().enumerate() {
            for number in [row.a_m, row.d_m, row.alpha_rad, row.theta_rad] {
                if number.is_nan() || number.abs() > LENGTH_MAX_M {
                    let what = "a row needs finite lengths and angles below 1000";
                    return Err(ChainError { joint, what });
                }
            }
            let rotated = Pose::new(exact_quarter_turn(rotation_z, row.theta_rad), DVec3::ZERO);
            let distal = Pose::new(
                exact_quarter_turn(rotation_x, row.alpha_rad),
                DVec3::new(row.a_m, 0.0, row.d_m),
            );
            joints[joint] = JointSpec {
                origin: before.compose(&rotated),
                axis: DVec3::Z,
                body: row.spec.body.expressed_in(&distal),
                ..row.spec
            };
            before = distal;
        }
        Chain::new(&joints, &before.compose(tool))
    }

    /// The same chain on another place of the ground: moved to `base_m` (m) and turned by `yaw_rad`
    /// about the vertical. Poses are then those in the frame in which it stands. A place that is
    /// not finite or farther than 1000 m changes nothing.
    #[must_use]
    pub fn standing_at(mut self, base_m: DVec3, yaw_rad: f64) -> Chain<N> {
        if is_length_bounded(base_m) && yaw_rad.abs() <= LENGTH_MAX_M && N > 0 {
            let place = Pose::new(exact_quarter_turn(rotation_z, yaw_rad), base_m);
            self.links[0].origin = place.compose(&self.links[0].origin);
            self.base_m = base_m;
            self.wrist = SphericalWrist::from_chain(&self);
        }
        self
    }

    /// The same chain with the acceleration of free fall `gravity_m_s2` (m/s^2, base frame), for an
    /// arm on a wall or a ceiling. A vector that is not finite, or longer than 1000 m/s^2, changes
    /// nothing.
    #[must_use]
    pub fn with_gravity(mut self, gravity_m_s2: DVec3) -> Chain<N> {
        if gravity_m_s2.is_finite() && gravity_m_s2.length() <= LENGTH_MAX_M {
            self.base_acceleration = -gravity_m_s2;
        }
        self
    }
}

impl JointSpec {
    fn check(&self) -> Result<(), &'static str> {
        check_rigid(&self.origin)?;
        if !self.axis.is_finite() || !(1e-6..=1e6).contains(&self.axis.length()) {
            return Err("the axis needs a direction");
        }
        let body = &self.body;
        let mass = (0.0..=VALUE_MAX).contains(&body.mass_kg);
        let com = is_length_bounded(body.com_m);
        let inertia = body.inertia_kg_m2.to_cols_array().iter().all(|x| x.abs() <= VALUE_MAX);
        if !(mass && com && inertia) {
            return Err(
                "mass, centre of mass and inertia have to be finite, the mass not negative",
            );
        }
        let i = &body.inertia_kg_m2;
        if (*i - i.transpose()).to_cols_array().iter().any(|x| x.abs() > ORTHONORMALITY_TOLERANCE) {
            return Err("the inertia has to be symmetric");
        }
        let range = self.q_min.abs() <= VALUE_MAX && self.q_max.abs() <= VALUE_MAX;
        if !(range && self.q_min < self.q_max) {
            return Err("the lower limit has to be below the upper, both finite");
        }
        let most = [self.speed_max, self.acceleration_max, self.effort_max];
        if !most.iter().all(|x| *x > 0.0 && *x <= VALUE_MAX) {
            return Err("speed, acceleration and effort have to be positive and finite");
        }
        if !(0.0..=VALUE_MAX).contains(&self.reflected_inertia) {
            return Err("the inertia of the drive has to be finite and not negative");
        }
        Ok(())
    }
}

/// Checks that the rotation of a pose is orthonormal and its translation plausible.
fn check_rigid(pose: &Pose) -> Result<(), &'static str> {
    let r = &pose.rotation;
    let is_orthonormal =
        (r.transpose() * *r).abs_diff_eq(DMat3::IDENTITY, ORTHONORMALITY_TOLERANCE);
    if !(is_orthonormal && r.determinant() > 0.0) {
        return Err("the rotation of a frame has to be orthonormal, determinant +1");
    }
    if is_length_bounded(pose.translation) { Ok(()) } else { Err("lengths end at 1 km") }
}

/// Whether every coordinate of `v` (m) is plausible for an arm; NaN is not.
fn is_length_bounded(v: DVec3) -> bool {
    v.to_array().iter().all(|x| x.abs() <= LENGTH_MAX_M)
}

/// The rotation by `angle` (rad), with elements of exactly 0 and 1 where the angle is a multiple of
/// a quarter turn to rounding.
fn exact_quarter_turn(rotation: fn(f64) -> DMat3, angle: f64) -> DMat3 {
    use core::f64::consts::FRAC_PI_2;
    let quarters = (angle / FRAC_PI_2).round();
    let rotated = rotation(angle);
    if (angle - quarters * FRAC_PI_2).abs() > QUARTER_TURN_TOLERANCE_RAD {
        return rotated;
    }
    DMat3::from_cols(rotated.x_axis.round(), rotated.y_axis.round(), rotated.z_axis.round())
}

/// A rotation that takes z to the unit vector `axis`; the identity for z itself.
fn rotation_from_z_to(axis: DVec3) -> DMat3 {
    if axis == DVec3::Z {
        return DMat3::IDENTITY;
    }
    // The coordinate axis with the smallest component along `axis` determines x and y.
    let a = axis.abs();
    let aside = if a.x <= a.y && a.x <= a.z {
        DVec3::X
    } else if a.y <= a.z {
        DVec3::Y
    } else {
        DVec3::Z
    };
    let x = aside.cross(axis).normalize();
    DMat3::from_cols(x, axis.cross(x), axis)
}
