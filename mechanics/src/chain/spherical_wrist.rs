//! The closed-form inverse kinematics of arms with a spherical wrist: all branches of any six
//! revolute joints whose last three axes meet at one point with right angles between neighbours,
//! whose axes 2 and 3 are parallel and whose axis 1 is perpendicular to them, with any offsets
//! between (ortho-parallel bases with spherical wrists, Brandstoetter, Angerer and Hofbaur 2014).
//! Other arms are not recognised. A pose out of reach, or with a number that is not finite, has no
//! branch.
//!
//! The arm is described from its configuration at zero, as rotations about axes that are fixed in
//! the base frame, so that the frames of its description do not matter. As for the PUMA 260, every
//! angle comes from `atan2` of quantities that are formed without cancellation, and joints 5 and 6
//! are computed for the value of joint 4.

use core::f64::consts::PI;

use super::{Chain, JointKind};
use crate::limits;
use crate::puma260::inverse::{DOUBLE_ROOT_DISTANCE, WRIST_SINGULAR_SINE, is_bounded};
use crate::puma260::{
    Branch, Branches, ELBOW_SINGULAR, SHOULDER_SINGULAR, SingularityDistance, WRIST_SINGULAR,
};
use crate::spatial::{JointVector, Joints, Pose, wrap_angle};
use glam::{DMat3, DVec2, DVec3};

/// Tolerance with which axes have to meet (relative to the size of the arm) and to be parallel or
/// perpendicular (sine or cosine of the angle).
const GEOMETRY_TOLERANCE: f64 = 1e-9;
/// Distance beyond the reach at which a wrist centre still counts as on its boundary, over the
/// longest reach.
const REACH_TOLERANCE: f64 = 2.5e-9;
/// Distance of the wrist centre from axis 2, over the longest reach, below which joint 2 is free.
const JOINT2_FREE_DISTANCE: f64 = 2.5e-12;

/// The geometry of an arm with a spherical wrist, from its configuration at zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphericalWrist {
    /// The point of axis 1 nearest to axis 2 (m, base frame).
    shoulder_foot: DVec3,
    /// Axes of the base in the base frame: x of the plane of the arm, the normal of the plane,
    /// which is the direction of axes 2 and 3 up to sign, and axis 1.
    base: DMat3,
    /// Distance from axis 1 to axis 2 along x of the plane (m).
    shoulder_offset_m: f64,
    /// Distance of the wrist centre from axis 1 along the normal of the plane (m).
    lateral_offset_m: f64,
    /// Upper arm in the plane of the arm, as (z, x), so that rotations about the normal are
    /// positive (m).
    upper_arm: DVec2,
    /// Forearm in the plane of the arm, as (z, x) (m).
    forearm: DVec2,
    /// Signs of joints 2 and 3 as rotations about the normal of the plane.
    sign: [f64; 2],
    /// Axes of the wrist at zero in the base frame: x, axis 5 and axis 4.
    wrist: DMat3,
    /// Angle about axis 5 from axis 4 to axis 6 at zero (rad).
    axis6_angle_rad: f64,
    /// Rotation about axis 5 by that angle.
    axis6_rotation: DMat3,
    /// Rotation of the tool at zero in the base frame.
    tool_rotation: DMat3,
    /// The wrist centre from the tool point, in the axes of the tool (m).
    centre_in_tool: DVec3,
    q_min: Joints,
    q_max: Joints,
}

/// The first three joints of a branch (rad).
struct ArmSolution {
    shoulder: i8,
    elbow: i8,
    q: [f64; 3],
    flags: u8,
}

impl SphericalWrist {
    /// The geometry of `chain`, if it has a spherical wrist and an ortho-parallel base.
    pub(super) fn from_chain<const N: usize>(chain: &Chain<N>) -> Option<SphericalWrist> {
        if N != 6 || chain.links.iter().any(|link| link.kind != JointKind::Revolute) {
            return None;
        }
        let zero = chain.frames(&JointVector::<N>::zeros());
        let (z, o) = (zero.axis, zero.origin);
        let size = chain.mean_link_m * 6.0;
        let is_perpendicular = |a: DVec3, b: DVec3| a.dot(b).abs() < GEOMETRY_TOLERANCE;
        let is_near = |a: DVec3, b: DVec3| (a - b).length() < GEOMETRY_TOLERANCE * size;
        // The wrist centre is the point of axis 4 nearest to the origin of joint 5. Axes 5 and 6
        // have to go through it.
        let centre = o[3] + (o[4] - o[3]).dot(z[3]) * z[3];
        let is_on_axis = |i: usize| is_near(centre, o[i] + (centre - o[i]).dot(z[i]) * z[i]);
        let has_wrist = is_perpendicular(z[3], z[4])
            && is_perpendicular(z[4], z[5])
            && is_on_axis(4)
            && is_on_axis(5);
        let has_base =
            z[1].cross(z[2]).length() < GEOMETRY_TOLERANCE && is_perpendicular(z[0], z[1]);
        if !(has_wrist && has_base) {
            return None;
        }
        let foot = o[0] + (o[1] - o[0]).dot(z[0]) * z[0];
        // The x axis of the plane points to the side of axis 1 on which the wrist centre is at
        // zero, which is the front. Where the centre is on axis 1, the side of the elbow decides.
        let across = z[1].cross(z[0]);
        let forward = (centre - foot).dot(across);
        let along = if forward.abs() > GEOMETRY_TOLERANCE * size {
            forward
        } else {
            (o[2] - o[1]).dot(across)
        };
        let x = if along < 0.0 { -across } else { across };
        let y = z[0].cross(x);
        let base = DMat3::from_cols(x, y, z[0]);
        let plane = |v: DVec3| DVec2::new(v.dot(z[0]), v.dot(x));
        let (upper_arm, forearm) = (plane(o[2] - o[1]), plane(centre - o[2]));
        if upper_arm.length() < GEOMETRY_TOLERANCE * size
            || forearm.length() < GEOMETRY_TOLERANCE * size
        {
            return None;
        }
        let wrist = DMat3::from_cols(z[4].cross(z[3]), z[4], z[3]);
        let sixth = wrist.transpose() * z[5];
        let tool = zero.tool;
        let six = |v: &JointVector<N>| Joints::from_fn(|i, _| v[i]);
        Some(SphericalWrist {
            shoulder_foot: foot,
            base,
            shoulder_offset_m: (o[1] - foot).dot(x),
            lateral_offset_m: (centre - foot).dot(y),
            upper_arm,
            forearm,
            sign: [z[1].dot(y).signum(), z[2].dot(y).signum()],
            wrist,
            axis6_angle_rad: libm::atan2(sixth.x, sixth.z),
            axis6_rotation: DMat3::from_cols(
                DVec3::new(sixth.z, 0.0, -sixth.x),
                DVec3::Y,
                DVec3::new(sixth.x, 0.0, sixth.z),
            ),
            tool_rotation: tool.rotation,
            centre_in_tool: tool.rotation.transpose() * (centre - tool.translation),
            q_min: six(&chain.limits.q_min),
            q_max: six(&chain.limits.q_max),
        })
    }

    /// The longest reach from axis 2 (m).
    fn reach_m(&self) -> f64 {
        self.upper_arm.length() + self.forearm.length()
    }

    /// All branches that reach the tool pose `tool` (base frame, orthonormal rotation). They are
    /// ordered by shoulder (+1: the wrist centre is on the side of axis 1 where it is at zero),
    /// elbow (+1: joint 3 is above its value with the arm stretched) and wrist (+1: joint 5 is not
    /// below its value with axes 4 and 6 in line). Where joint 4 is free, `previous` (rad) decides
    /// as for `Puma260::inverse`.
    #[must_use]
    pub fn inverse_kinematics(&self, tool: &Pose, previous: Option<&Joints>) -> Branches {
        let mut out = Branches::empty();
        let longest = self.reach_m();
        let bound = 10.0 * (longest + self.shoulder_foot.length() + self.centre_in_tool.length())
            + self.shoulder_offset_m.abs()
            + self.lateral_offset_m.abs();
        if !is_bounded(tool, bound) {
            return out;
        }
        let previous = previous.filter(|q| q.iter().all(|x| x.is_finite()));
        let centre = tool.apply(self.centre_in_tool) - self.shoulder_foot;
        let p = self.base.transpose() * centre;
        let aside = self.lateral_offset_m.abs();
        let r = (p.x * p.x + p.y * p.y).sqrt();
        let slack = REACH_TOLERANCE * longest;
        if aside - r > slack {
            return out;
        }
        let reach = ((r - aside) * (r + aside)).max(0.0).sqrt();
        let azimuth = libm::atan2(p.y, p.x);
        for shoulder in [1_i8, -1] {
            let reach = f64::from(shoulder) * reach;
            let theta1 = wrap_angle(azimuth - libm::atan2(self.lateral_offset_m, reach));
            let target = DVec2::new(p.z, reach - self.shoulder_offset_m);
            let Some(opening) = self.elbow_opening(target, slack) else { continue };
            for elbow in [1_i8, -1] {
                let stretched = signed_angle(self.upper_arm, self.forearm);
                let bend = f64::from(elbow) * self.sign[1] * opening - stretched;
                let mut arm = ArmSolution { shoulder, elbow, q: [theta1, 0.0, 0.0], flags: 0 };
                arm.q[2] = wrap_angle(self.sign[1] * bend);
                arm.q[1] = self.joint_2(target, bend, previous);
                if reach.abs() < DOUBLE_ROOT_DISTANCE * longest {
                    arm.flags |= SHOULDER_SINGULAR;
                }
                if libm::sin(opening).abs() < DOUBLE_ROOT_DISTANCE {
                    arm.flags |= ELBOW_SINGULAR;
                }
                self.push_wrist_branches(&tool.rotation, &arm, previous, &mut out);
            }
        }
        out
    }

    /// The angle between forearm and upper arm, in `[0, pi]` (rad) and 0 with the arm stretched, at
    /// which the wrist centre has the distance of `target` (m) from axis 2. `None` where it is out
    /// of reach by more than `slack` (m).
    fn elbow_opening(&self, target: DVec2, slack: f64) -> Option<f64> {
        let (a, b) = (self.upper_arm.length(), self.forearm.length());
        let square = target.length_squared();
        let distance = square.sqrt();
        if distance - (a + b) > slack || (a - b).abs() - distance > slack {
            return None;
        }
        let below = ((a + b) * (a + b) - square).max(0.0);
        let above = (square - (a - b) * (a - b)).max(0.0);
        Some(2.0 * libm::atan2(below.sqrt(), above.sqrt()))
    }

    /// Joint 2 (rad) where the elbow is rotated by `bend` (rad) about the normal of the plane.
    fn joint_2(&self, target: DVec2, bend: f64, previous: Option<&Joints>) -> f64 {
        let (s, c) = libm::sincos(bend);
        let forearm = DVec2::new(
            c * self.forearm.x - s * self.forearm.y,
            s * self.forearm.x + c * self.forearm.y,
        );
        let reach_vector = self.upper_arm + forearm;
        let folded = JOINT2_FREE_DISTANCE * self.reach_m();
        if target.length_squared() < folded * folded {
            return previous.map_or(0.0, |q| wrap_angle(q[1]));
        }
        wrap_angle(
            self.sign[0] * libm::atan2(reach_vector.perp_dot(target), reach_vector.dot(target)),
        )
    }

    /// Appends the two branches of the wrist for the first three joints `arm` and the rotation of
    /// the tool.
    fn push_wrist_branches(
        &self,
        rotation: &DMat3,
        arm: &ArmSolution,
        previous: Option<&Joints>,
        out: &mut Branches,
    ) {
        let [q1, q2, q3] = arm.q;
        let arm_from_zero = self.base * arm_rotation(q1, self.sign[0] * q2 + self.sign[1] * q3);
        let arm_from_zero = arm_from_zero * self.base.transpose();
        let w = arm_from_zero.transpose() * *rotation * self.tool_rotation.transpose();
        let m = self.wrist.transpose() * w * self.wrist * self.axis6_rotation;
        let (mx, my) = (m.z_axis.x, m.z_axis.y);
        let is_singular = mx * mx + my * my < WRIST_SINGULAR_SINE * WRIST_SINGULAR_SINE;
        let q4 = if is_singular { self.free_joint_4(previous) } else { libm::atan2(my, mx) };
        let (s4, c4) = libm::sincos(q4);
        let angle = libm::atan2(c4 * mx + s4 * my, m.z_axis.z);
        let q6 = libm::atan2(c4 * m.x_axis.y - s4 * m.x_axis.x, c4 * m.y_axis.y - s4 * m.y_axis.x);
        let flags = arm.flags | if is_singular { WRIST_SINGULAR } else { 0 };
        for (wrist, last) in
            [(1, [q4, angle, q6]), (-1, [half_turn_away(q4), -angle, half_turn_away(q6)])]
        {
            let [q4, angle, q6] = last.map(wrap_angle);
            let q = Joints::new(q1, q2, q3, q4, wrap_angle(angle - self.axis6_angle_rad), q6);
            let in_limits =
                (0..6).all(|i| limits::has_equivalent_in_range(self.q_min[i], self.q_max[i], q[i]));
            let (shoulder, elbow) = (arm.shoulder, arm.elbow);
            out.push(Branch { shoulder, elbow, wrist, q, in_limits, singular_flags: flags });
        }
    }

    /// Joint 4 (rad) of the branch with wrist +1 at the wrist singularity, where it is free.
    fn free_joint_4(&self, previous: Option<&Joints>) -> f64 {
        match previous {
            None => 0.0,
            Some(q) if wrap_angle(wrap_angle(q[4]) + self.axis6_angle_rad) < 0.0 => {
                wrap_angle(wrap_angle(q[3]) + PI)
            }
            Some(q) => wrap_angle(q[3]),
        }
    }

    /// The index of the branch nearest to `previous` (rad), and its joints (rad), shifted by whole
    /// turns to be near `previous` and inside the limits. The distance is the largest one of any
    /// joint; of equal branches the first one is taken. `None` where no branch is inside the
    /// limits.
    #[must_use]
    pub fn nearest_branch(
        &self,
        branches: &Branches,
        previous: &Joints,
    ) -> Option<(usize, Joints)> {
        let mut best: Option<(usize, Joints, f64)> = None;
        for (index, branch) in branches.iter().enumerate() {
            let turns = limits::nearest_equivalent(&branch.q, previous, &self.q_min, &self.q_max);
            let Some((q, distance)) = turns else { continue };
            if best.as_ref().is_none_or(|b| distance < b.2) {
                best = Some((index, q, distance));
            }
        }
        best.map(|(index, q, _)| (index, q))
    }

    /// The distances of `q` (rad) from the three singularities: the distance of the wrist centre
    /// from the plane through axis 1 along axes 2 and 3, over the longest reach from axis 1; the
    /// sine of the angle between forearm and upper arm, positive for elbow +1; the sine of the
    /// angle between axes 4 and 6.
    #[must_use]
    pub fn singularity_distance(&self, q: &Joints) -> SingularityDistance {
        let bend = self.sign[1] * q[2];
        let (s, c) = libm::sincos(bend);
        let forearm = DVec2::new(
            c * self.forearm.x - s * self.forearm.y,
            s * self.forearm.x + c * self.forearm.y,
        );
        let (s, c) = libm::sincos(self.sign[0] * q[1]);
        let reach_vector = self.upper_arm + forearm;
        let reach = self.shoulder_offset_m + s * reach_vector.x + c * reach_vector.y;
        let lengths = self.upper_arm.length() * self.forearm.length();
        SingularityDistance {
            shoulder: reach / (self.reach_m() + self.shoulder_offset_m.abs()),
            elbow: self.sign[1] * self.upper_arm.perp_dot(forearm) / lengths,
            wrist: libm::sin(q[4] + self.axis6_angle_rad),
        }
    }
}

/// `Rz(q1) Ry(q23)` (rad), in the axes of the base.
fn arm_rotation(q1: f64, q23: f64) -> DMat3 {
    let ((s1, c1), (s, c)) = (libm::sincos(q1), libm::sincos(q23));
    DMat3::from_cols(
        DVec3::new(c1 * c, s1 * c, -s),
        DVec3::new(-s1, c1, 0.0),
        DVec3::new(c1 * s, s1 * s, c),
    )
}

/// The angle half a turn away, nearer to zero (rad).
fn half_turn_away(angle_rad: f64) -> f64 {
    if angle_rad < 0.0 { angle_rad + PI } else { angle_rad - PI }
}

/// The angle of the rotation from `from` to `to` in the plane (rad).
fn signed_angle(from: DVec2, to: DVec2) -> f64 {
    libm::atan2(from.perp_dot(to), from.dot(to))
}
