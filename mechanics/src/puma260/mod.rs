//! Closed-form kinematics of the PUMA 260: forward kinematics, Jacobians, singularities and limits;
//! the inverse kinematics is [`Puma260::inverse_kinematics`], the dynamics [`dynamics`].
//!
//! Distal Denavit-Hartenberg frames with the twists of Paul and Zhang (1986), `A_i = Rz(theta_i)
//! Tz(d_i) Tx(a_i) Rx(alpha_i)`, alpha = (+90, 0, -90, +90, -90, 0) deg; only a2, d3 and d4 are not
//! zero. The base frame has its origin where the axes of joints 1 and 2 cross, and its z axis
//! points up. T6 has its origin at the wrist centre and z6 as approach axis; the tool point is
//! `T6 Trans(0, 0, tool_z)`. At q = 0 the upper arm lies along +x0, the forearm stands along +z0,
//! and the axes of T6 are those of the base frame.

mod arm;
pub mod dynamics;
pub mod follower;
pub(crate) mod inverse;

pub use inverse::{Branch, Branches, ELBOW_SINGULAR, SHOULDER_SINGULAR, WRIST_SINGULAR};

use crate::spatial::{Joints, Matrix6, Pose, SinCos, rotation_x};
use glam::{DMat3, DVec3};

/// Dimensions and limits of a PUMA 260.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Puma260 {
    /// Length of the upper arm, from shoulder to elbow (m).
    pub a2_m: f64,
    /// Shoulder offset along the axis of joint 2 (m).
    pub d3_m: f64,
    /// Length of the forearm, from elbow to wrist centre (m).
    pub d4_m: f64,
    /// Distance from the wrist centre to the tool point along z6 (m).
    pub tool_z_m: f64,
    /// Lower joint limits (rad).
    pub q_min_rad: Joints,
    /// Upper joint limits (rad).
    pub q_max_rad: Joints,
    /// Largest joint speeds (rad/s).
    pub speed_max_rad_s: Joints,
    /// Largest joint accelerations for planning (rad/s^2).
    pub acceleration_max_rad_s2: Joints,
}

/// The distances of a configuration from the three singularities: the scaled factors of the
/// determinant of the Jacobian. They are signed, 0 at the singularity and between -1 and 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingularityDistance {
    /// Distance of the wrist centre from the axis of joint 1 in the plane of the arm, over the
    /// longest reach: `(a2 c2 - d4 s23) / (a2 + d4)`.
    pub shoulder: f64,
    /// `cos theta3`: 0 with the arm stretched or folded.
    pub elbow: f64,
    /// `sin theta5`: 0 with the axes of joints 4 and 6 in line.
    pub wrist: f64,
}

impl SingularityDistance {
    /// The smallest absolute value of the three.
    #[must_use]
    pub fn smallest(&self) -> f64 {
        self.shoulder.abs().min(self.elbow.abs()).min(self.wrist.abs())
    }
}

/// Sines and cosines of a joint vector, and the terms that several formulas of the arm share.
struct TrigTerms {
    s: [f64; 6],
    c: [f64; 6],
    s23: f64,
    c23: f64,
    /// Reach of the wrist centre in the plane of the arm (m): `a2 c2 - d4 s23`.
    reach: f64,
}

impl Puma260 {
    /// The reference arm. Dimensions a2 = d4 = 8.0 in and d3 = 5.0 in are from teaching material of
    /// the University of Pennsylvania for its PUMA 260 (another source has 4.9 in for d3). The tool
    /// length is that of a flange, force sensor and finger (estimate). The limits are the maker's
    /// ranges of 318, 332, 248, 578, 244 and 534 deg, shifted to this zero. The speeds are those at
    /// 1500 motor revolutions per minute, and the accelerations reach them in 0.2 s (estimates).
    #[must_use]
    pub fn reference() -> Puma260 {
        Puma260 {
            a2_m: 0.2032,
            d3_m: 0.1270,
            d4_m: 0.2032,
            tool_z_m: 0.2,
            q_min_rad: joints_from_degrees([-159.0, -76.0, -214.0, -194.0, -122.0, -267.0]),
            q_max_rad: joints_from_degrees([159.0, 256.0, 34.0, 384.0, 122.0, 267.0]),
            speed_max_rad_s: joints_from_degrees([190.0, 125.0, 205.0, 205.0, 225.0, 280.0]),
            acceleration_max_rad_s2: joints_from_degrees([
                950.0, 625.0, 1025.0, 1025.0, 1125.0, 1400.0,
            ]),
        }
    }

    /// The pose of each joint's frame at value zero, whose z axis is the axis of the joint, in the
    /// frame of the joint before it, or in the base frame for the first joint; the frame of the
    /// last joint is T6. The shoulder offset d3 stands before joint 2, along its axis, where the
    /// arm has it: it commutes with the turns of joints 2 and 3.
    #[must_use]
    pub fn joint_origins(&self) -> [Pose; 6] {
        let quarter = core::f64::consts::FRAC_PI_2;
        let along_z = |length_m: f64| DVec3::new(0.0, 0.0, length_m);
        let up = rotation_x(quarter);
        let down = rotation_x(-quarter);
        [
            Pose::IDENTITY,
            Pose::new(up, up * along_z(self.d3_m)),
            Pose::new(DMat3::IDENTITY, DVec3::new(self.a2_m, 0.0, 0.0)),
            Pose::new(down, DVec3::ZERO),
            Pose::new(up, along_z(self.d4_m)),
            Pose::new(down, DVec3::ZERO),
        ]
    }

    fn trig_terms(&self, q: &Joints) -> TrigTerms {
        self.trig_terms_at(&SinCos::new(q))
    }

    fn trig_terms_at(&self, at: &SinCos) -> TrigTerms {
        let SinCos { s, c } = *at;
        let s23 = s[1] * c[2] + c[1] * s[2];
        let c23 = c[1] * c[2] - s[1] * s[2];
        TrigTerms { s, c, s23, c23, reach: self.a2_m * c[1] - self.d4_m * s23 }
    }

    /// The pose of T6, with its origin at the wrist centre, in the base frame, at `q` (rad).
    #[must_use]
    pub fn wrist_pose(&self, q: &Joints) -> Pose {
        self.wrist_pose_from(&self.trig_terms(q))
    }

    fn wrist_pose_from(&self, k: &TrigTerms) -> Pose {
        let rotation = arm_rotation(k) * wrist_rotation(k);
        let translation = DVec3::new(
            k.c[0] * k.reach + k.s[0] * self.d3_m,
            k.s[0] * k.reach - k.c[0] * self.d3_m,
            self.a2_m * k.s[1] + self.d4_m * k.c23,
        );
        Pose { rotation, translation }
    }

    /// Forward kinematics: the pose of the tool frame in the base frame at `q` (rad). It has the
    /// axes of T6 and its origin at the tool point.
    #[must_use]
    pub fn tool_pose(&self, q: &Joints) -> Pose {
        let wrist = self.wrist_pose(q);
        let translation = wrist.translation + self.tool_z_m * wrist.rotation.z_axis;
        Pose { rotation: wrist.rotation, translation }
    }

    /// What the arm is drawn by, in the base frame (m): the base, the shoulder behind its offset
    /// d3, the elbow, the wrist centre and the tool point at `q` (rad).
    #[must_use]
    pub fn joint_centres(&self, q: &Joints) -> [DVec3; 5] {
        let k = self.trig_terms(q);
        let shoulder = DVec3::new(k.s[0] * self.d3_m, -k.c[0] * self.d3_m, 0.0);
        let reach = self.a2_m * k.c[1];
        let elbow = shoulder + DVec3::new(k.c[0] * reach, k.s[0] * reach, self.a2_m * k.s[1]);
        let wrist = self.wrist_pose(q).translation;
        [DVec3::ZERO, shoulder, elbow, wrist, self.tool_pose(q).translation]
    }

    /// The pose of T6 that belongs to the tool pose `tool` (both in the base frame).
    #[must_use]
    pub fn tool_to_wrist(&self, tool: &Pose) -> Pose {
        let translation = tool.translation - self.tool_z_m * tool.rotation.z_axis;
        Pose { rotation: tool.rotation, translation }
    }

    /// The Jacobian of the tool point at `q` (rad), rows vx vy vz wx wy wz, both halves in the base
    /// frame.
    #[must_use]
    pub fn jacobian_base(&self, q: &Joints) -> Matrix6 {
        self.tool_and_jacobian_at(&SinCos::new(q)).1
    }

    /// [`Puma260::tool_pose`] and [`Puma260::jacobian_base`] at a configuration whose sines and
    /// cosines are known, at little more than the cost of the Jacobian alone.
    #[must_use]
    pub fn tool_and_jacobian_at(&self, at: &SinCos) -> (Pose, Matrix6) {
        let (linear, angular, tool) = self.jacobian_columns(at);
        (tool, jacobian_from_columns(&linear, &angular))
    }

    /// The Jacobian of the tool point at `q` (rad), rows vx vy vz wx wy wz, both halves in the tool
    /// frame.
    #[must_use]
    pub fn jacobian_tool(&self, q: &Joints) -> Matrix6 {
        let (mut linear, mut angular, tool) = self.jacobian_columns(&SinCos::new(q));
        let back = tool.rotation.transpose();
        for i in 0..6 {
            linear[i] = back * linear[i];
            angular[i] = back * angular[i];
        }
        jacobian_from_columns(&linear, &angular)
    }

    /// The columns of the Jacobian of the tool point in the base frame, linear and angular, and the
    /// pose of the tool.
    fn jacobian_columns(&self, at: &SinCos) -> ([DVec3; 6], [DVec3; 6], Pose) {
        let k = self.trig_terms_at(at);
        let pose = self.wrist_pose_from(&k);
        let arm = arm_rotation(&k);
        let approach = pose.rotation.z_axis;
        let tool = pose.translation + self.tool_z_m * approach;
        let elbow = DVec3::new(
            k.c[0] * self.a2_m * k.c[1],
            k.s[0] * self.a2_m * k.c[1],
            self.a2_m * k.s[1],
        );
        let z1 = DVec3::new(k.s[0], -k.c[0], 0.0);
        let z4 = arm * DVec3::new(k.s[3], -k.c[3], 0.0);
        let to_tool = self.tool_z_m * approach;
        let angular = [DVec3::Z, z1, z1, arm.z_axis, z4, approach];
        let linear = [
            DVec3::new(-tool.y, tool.x, 0.0),
            z1.cross(tool),
            z1.cross(tool - elbow),
            arm.z_axis.cross(to_tool),
            z4.cross(to_tool),
            DVec3::ZERO,
        ];
        (linear, angular, Pose { rotation: pose.rotation, translation: tool })
    }

    /// The determinant of the Jacobian at `q` (rad) (m^3), from its factors `a2 (d4 c3) (a2 c2 - d4
    /// s23) s5`. It is the same for every tool on z6 and in both frames.
    #[must_use]
    pub fn jacobian_determinant(&self, q: &Joints) -> f64 {
        let k = self.trig_terms(q);
        self.a2_m * (self.d4_m * k.c[2]) * k.reach * k.s[4]
    }

    /// The scaled factors of the determinant of the Jacobian at `q` (rad).
    #[must_use]
    pub fn singularity_distance(&self, q: &Joints) -> SingularityDistance {
        let k = self.trig_terms(q);
        let shoulder = k.reach / (self.a2_m + self.d4_m);
        SingularityDistance { shoulder, elbow: k.c[2], wrist: k.s[4] }
    }

    /// Whether every joint of `q` (rad), without any shift by whole turns, lies inside its limits.
    /// NaN does not.
    #[must_use]
    pub fn within_limits(&self, q: &Joints) -> bool {
        (0..6).all(|i| self.q_min_rad[i] <= q[i] && q[i] <= self.q_max_rad[i])
    }
}

/// The rotation of frame 3, which is that of the first three joints, in the base frame.
fn arm_rotation(k: &TrigTerms) -> DMat3 {
    let (s1, c1) = (k.s[0], k.c[0]);
    DMat3::from_cols(
        DVec3::new(c1 * k.c23, s1 * k.c23, k.s23),
        DVec3::new(-s1, c1, 0.0),
        DVec3::new(-c1 * k.s23, -s1 * k.s23, k.c23),
    )
}

/// The rotation of T6 in frame 3: `Rz(theta4) Ry(-theta5) Rz(theta6)`.
fn wrist_rotation(k: &TrigTerms) -> DMat3 {
    let (s4, c4, s5, c5, s6, c6) = (k.s[3], k.c[3], k.s[4], k.c[4], k.s[5], k.c[5]);
    DMat3::from_cols(
        DVec3::new(c4 * c5 * c6 - s4 * s6, s4 * c5 * c6 + c4 * s6, s5 * c6),
        DVec3::new(-c4 * c5 * s6 - s4 * c6, -s4 * c5 * s6 + c4 * c6, -s5 * s6),
        DVec3::new(-c4 * s5, -s4 * s5, c5),
    )
}

fn jacobian_from_columns(linear: &[DVec3; 6], angular: &[DVec3; 6]) -> Matrix6 {
    let mut j = Matrix6::zeros();
    for i in 0..6 {
        let (v, w) = (linear[i], angular[i]);
        j.column_mut(i).copy_from_slice(&[v.x, v.y, v.z, w.x, w.y, w.z]);
    }
    j
}

fn joints_from_degrees(degrees: [f64; 6]) -> Joints {
    Joints::from(degrees.map(f64::to_radians))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbouring_joint_centres_are_a_link_apart_at_any_angle() {
        let arm = Puma260::reference();
        for step in 0..100 {
            let angle = |joint: usize| 3.0 * libm::sin(f64::from(step) * (1.3 + joint as f64));
            let centres = arm.joint_centres(&Joints::from_fn(|joint, _| angle(joint)));
            let links = [arm.d3_m, arm.a2_m, arm.d4_m, arm.tool_z_m];
            for (pair, length) in centres.windows(2).zip(links) {
                assert!(((pair[1] - pair[0]).length() - length).abs() < 1e-14, "{centres:?}");
            }
        }
    }
}
