//! From descriptions of joints to a chain. Refuses, with the joint's number, what no arm can be:
//! lengths and masses that are not finite or beyond sense, axes without direction, mounts that are
//! not turned rigidly, limits that are reversed.

use core::fmt;

use super::spherical_wrist::SphericalWrist;
use super::{Chain, Limits, Link, MAX_JOINTS};
use crate::rigid_body::{Body, GRAVITY_M_S2};
use crate::spatial::{JointVector, Pose, rotation_x, rotation_z};
use glam::{DMat3, DVec3};

/// No length of an arm is larger (m).
const LENGTH_MAX_M: f64 = 1e3;
/// No mass, inertia, limit, speed or effort is larger (kg, kg m^2, rad, ...).
const VALUE_MAX: f64 = 1e9;
/// How far a mount's rotation may be from orthonormal: it is made exact to rounding by the caller.
const ORTHONORMALITY_TOLERANCE: f64 = 1e-9;
/// Angles nearer than this to a quarter turn are that quarter turn (rad): the cosine of a rounded
/// half pi is not nought, but the arm's is.
const QUARTER_TURN_TOLERANCE_RAD: f64 = 1e-12;

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// About its axis; its value is an angle (rad).
    Revolute,
    /// Along its axis; its value is a length (m).
    Prismatic,
}

/// One joint and the link that it carries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSpec {
    /// Frame of the joint at value zero, in the frame of the link before; the base for the first.
    pub origin: Pose,
    /// Axis in the joint's frame; any length but nought.
    pub axis: DVec3,
    /// Turns or slides.
    pub kind: JointKind,
    /// The link, in the joint's frame moved by the joint.
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
    /// Inertia of the drive seen at the joint (kg m^2 or kg).
    pub reflected_inertia: f64,
}

impl Default for JointSpec {
    /// A turning joint about z without mass, a whole turn either way, 1 rad/s, 1 rad/s^2, 1 N m.
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

/// A row of standard (distal) Denavit-Hartenberg parameters, `Rz(theta) Tz(d) Tx(a) Rx(alpha)`,
/// for a joint that turns by theta. The body of `spec` is in the frame behind the row, its mount
/// and axis are ignored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DhRow {
    /// Length along x (m).
    pub a_m: f64,
    /// Offset along z (m).
    pub d_m: f64,
    /// Twist about x (rad); within 1e-12 of a quarter turn it is that quarter turn.
    pub alpha_rad: f64,
    /// What is added to the joint's value (rad).
    pub theta_rad: f64,
    /// Limits and link.
    pub spec: JointSpec,
}

/// A joint that cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChainError {
    /// Which joint, 0 the first; the number of joints stands for the tool or for the whole.
    pub joint: usize,
    /// What is wrong.
    pub what: &'static str,
}

impl fmt::Display for ChainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "joint {}: {}", self.joint + 1, self.what)
    }
}

impl std::error::Error for ChainError {}

impl<const N: usize> Chain<N> {
    /// A chain of its joints, base first, and the tool's frame in the frame of the last one.
    /// Gravity points along -z of the base, 9.81 m/s^2.
    ///
    /// # Errors
    /// [`ChainError`].
    pub fn new(joints: &[JointSpec; N], tool: &Pose) -> Result<Chain<N>, ChainError> {
        if N == 0 || N > MAX_JOINTS {
            return Err(ChainError { joint: N, what: "a chain has 1 to 8 joints" });
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
        // Turn of the frame before, whose z was laid into its axis.
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
            limits: Limits {
                q_min: column(|j| j.q_min),
                q_max: column(|j| j.q_max),
                speed_max: column(|j| j.speed_max),
                acceleration_max: column(|j| j.acceleration_max),
                effort_max: column(|j| j.effort_max),
            },
            reflected_inertia: column(|j| j.reflected_inertia),
            #[expect(clippy::cast_precision_loss, reason = "at most eight")]
            mean_link_m: (length / N as f64).max(1e-3),
            wrist: None,
        };
        chain.wrist = SphericalWrist::from_chain(&chain);
        Ok(chain)
    }

    /// A chain of Denavit-Hartenberg rows and a tool in the frame behind the last row.
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
            let turned = Pose::new(exact_quarter_turn(rotation_z, row.theta_rad), DVec3::ZERO);
            let behind = Pose::new(
                exact_quarter_turn(rotation_x, row.alpha_rad),
                DVec3::new(row.a_m, 0.0, row.d_m),
            );
            joints[joint] = JointSpec {
                origin: before.compose(&turned),
                axis: DVec3::Z,
                body: row.spec.body.expressed_in(&behind),
                ..row.spec
            };
            before = behind;
        }
        Chain::new(&joints, &before.compose(tool))
    }

    /// The same chain with free fall along `gravity_m_s2` of the base (m/s^2), for an arm on a wall
    /// or a ceiling. A vector that is not finite, or above 1000 m/s^2, changes nothing.
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

fn check_rigid(pose: &Pose) -> Result<(), &'static str> {
    let r = &pose.rotation;
    let square = (r.transpose() * *r).abs_diff_eq(DMat3::IDENTITY, ORTHONORMALITY_TOLERANCE);
    if !(square && r.determinant() > 0.0) {
        return Err("the rotation of a frame has to be orthonormal, determinant +1");
    }
    if is_length_bounded(pose.translation) { Ok(()) } else { Err("lengths end at 1 km") }
}

/// Whether every coordinate is one that an arm may have; NaN is not.
fn is_length_bounded(v: DVec3) -> bool {
    v.to_array().iter().all(|x| x.abs() <= LENGTH_MAX_M)
}

/// A rotation by `angle`, exact where it is a quarter turn but for rounding.
fn exact_quarter_turn(rotation: fn(f64) -> DMat3, angle: f64) -> DMat3 {
    use core::f64::consts::FRAC_PI_2;
    let turns = (angle / FRAC_PI_2).round();
    let exact = rotation(angle);
    if (angle - turns * FRAC_PI_2).abs() > QUARTER_TURN_TOLERANCE_RAD {
        return exact;
    }
    DMat3::from_cols(exact.x_axis.round(), exact.y_axis.round(), exact.z_axis.round())
}

/// A rotation that turns z onto the unit vector `axis`; none for z itself.
fn rotation_from_z_to(axis: DVec3) -> DMat3 {
    if axis == DVec3::Z {
        return DMat3::IDENTITY;
    }
    // The base axis least along `axis` gives the other two.
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
