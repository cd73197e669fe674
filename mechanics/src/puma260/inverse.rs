//! The closed-form inverse kinematics of the PUMA 260: all eight branches, whether they lie inside
//! the limits, and the branch nearest to given joints. A pose out of reach, or with a number that
//! is not finite, has no branch.
//!
//! Every angle comes from `atan2` of quantities that are formed without cancellation. theta5 and
//! theta6 are computed for the value of theta4 (premultiplication, Paul and Zhang 1986), so that
//! the pose is reached to rounding even where a joint itself is badly determined.

use super::Puma260;
use crate::limits;
use crate::spatial::{Joints, Pose, wrap_angle};
use core::f64::consts::{FRAC_PI_2, PI};
use glam::{DMat3, DVec3};

/// Bit of [`Branch::singular_flags`]: the wrist centre lies on the cylinder about axis 1 whose
/// radius is the shoulder offset, where both shoulder solutions coincide.
pub const SHOULDER_SINGULAR: u8 = 1;
/// Bit of [`Branch::singular_flags`]: the arm is stretched or folded, and both elbow solutions
/// coincide.
pub const ELBOW_SINGULAR: u8 = 2;
/// Bit of [`Branch::singular_flags`]: axes 4 and 6 are in line. theta4 is free and was taken from
/// the previous joints.
pub const WRIST_SINGULAR: u8 = 4;

/// Scaled distance from the shoulder or elbow singularity below which both solutions are flagged as
/// coinciding.
pub(crate) const DOUBLE_ROOT_DISTANCE: f64 = 1e-7;
/// `|sin theta5|` below which theta4 is taken as free (rad). It is far below one encoder count, and
/// the error of the orientation that it causes is at most its own value.
pub(crate) const WRIST_SINGULAR_SINE: f64 = 1e-11;
/// Distance beyond the reach at which a wrist centre still counts as on its boundary (m).
const REACH_TOLERANCE_M: f64 = 1e-9;
/// Distance of the wrist centre from the shoulder (m) below which theta2 is free.
const THETA2_FREE_DISTANCE_M: f64 = 1e-12;

/// One solution of the inverse kinematics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Branch {
    /// +1 where the wrist centre is in front of the shoulder (positive reach), -1 where it is
    /// behind it.
    pub shoulder: i8,
    /// +1 where theta3 is above -90 deg, -1 where it is below.
    pub elbow: i8,
    /// +1 where theta5 >= 0, -1 where theta5 < 0.
    pub wrist: i8,
    /// Joint angles (rad), each in `[-pi, pi)`.
    pub q: Joints,
    /// Whether every joint, shifted by whole turns where needed, lies inside its limits.
    pub in_limits: bool,
    /// Bits [`SHOULDER_SINGULAR`], [`ELBOW_SINGULAR`] and [`WRIST_SINGULAR`].
    pub singular_flags: u8,
}

/// The solutions for one pose: 8, 4 or none, ordered by shoulder, elbow and wrist with +1 first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Branches {
    branches: [Branch; 8],
    len: usize,
}

impl Branches {
    pub(crate) fn empty() -> Branches {
        let branch = Branch {
            shoulder: 0,
            elbow: 0,
            wrist: 0,
            q: Joints::zeros(),
            in_limits: false,
            singular_flags: 0,
        };
        Branches { branches: [branch; 8], len: 0 }
    }

    pub(crate) fn push(&mut self, branch: Branch) {
        self.branches[self.len] = branch;
        self.len += 1;
    }

    /// The solutions as a slice.
    #[must_use]
    pub fn as_slice(&self) -> &[Branch] {
        &self.branches[..self.len]
    }

    /// An iterator over the solutions.
    pub fn iter(&self) -> core::slice::Iter<'_, Branch> {
        self.as_slice().iter()
    }

    /// The number of solutions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no solution: the pose is out of reach.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}

impl core::ops::Index<usize> for Branches {
    type Output = Branch;
    fn index(&self, index: usize) -> &Branch {
        &self.as_slice()[index]
    }
}

impl<'a> IntoIterator for &'a Branches {
    type Item = &'a Branch;
    type IntoIter = core::slice::Iter<'a, Branch>;
    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

/// The wrist centre in the vertical plane of the arm, from the shoulder.
struct PlanarPoint {
    /// Horizontal distance (m), negative behind the shoulder.
    reach: f64,
    /// Height (m).
    height: f64,
}

/// The first three joints of a branch (rad).
struct ArmSolution {
    shoulder: i8,
    elbow: i8,
    theta: [f64; 3],
    flags: u8,
}

impl Puma260 {
    /// All branches that reach the pose `wrist` of T6 (base frame, orthonormal rotation).
    ///
    /// `previous` (rad) decides theta4 where the wrist is singular: the branch with the sign of the
    /// previous theta5 keeps the previous theta4, and the other branch is half a turn away from it.
    /// Without `previous` theta4 is 0 there. There is no branch for a pose that is out of reach by
    /// more than a nanometre, that has a number that is not finite, or whose rotation has an
    /// element above 2. A `previous` that is not finite counts as absent.
    #[must_use]
    pub fn inverse_kinematics(&self, wrist: &Pose, previous: Option<&Joints>) -> Branches {
        let mut out = Branches::empty();
        let p = wrist.translation;
        if !is_bounded(wrist, self.coordinate_bound_m()) {
            return out;
        }
        let previous = previous.filter(|q| q.iter().all(|x| x.is_finite()));
        let r = (p.x * p.x + p.y * p.y).sqrt();
        let d3 = self.d3_m.abs();
        let l2 = (r - d3) * (r + d3) + p.z * p.z;
        // `l` is the distance of the wrist centre from the shoulder in the plane of the arm.
        let (stretched, folded) = (self.a2_m + self.d4_m, (self.a2_m - self.d4_m).abs());
        let l = l2.max(0.0).sqrt();
        let is_outside = d3 - r > REACH_TOLERANCE_M
            || l - stretched > REACH_TOLERANCE_M
            || folded - l > REACH_TOLERANCE_M;
        if is_outside {
            return out;
        }
        let azimuth = libm::atan2(p.y, p.x);
        let opening = self.elbow_opening(l2);
        for shoulder in [1_i8, -1] {
            let reach = f64::from(shoulder) * ((r - d3) * (r + d3)).max(0.0).sqrt();
            let centre = PlanarPoint { reach, height: p.z };
            let theta1 = wrap_angle(azimuth + libm::atan2(self.d3_m, reach));
            let (sin1, cos1) = libm::sincos(theta1);
            for elbow in [1_i8, -1] {
                let theta3 = wrap_angle(-FRAC_PI_2 + f64::from(elbow) * opening);
                let arm = self.arm_solution(shoulder, elbow, theta1, theta3, &centre, previous);
                self.push_wrist_branches(&wrist.rotation, &arm, sin1, cos1, previous, &mut out);
            }
        }
        out
    }

    /// An upper bound of the coordinates of any wrist centre within reach (m).
    fn coordinate_bound_m(&self) -> f64 {
        2.0 * (self.a2_m.abs() + self.d3_m.abs() + self.d4_m.abs())
    }

    /// The angle of the elbow from the stretched arm, in `[0, pi]` (rad), for the squared distance
    /// `l2` (m^2) of the wrist centre from the shoulder. It is the law of cosines in a form that
    /// keeps its accuracy near either end.
    fn elbow_opening(&self, l2: f64) -> f64 {
        let (a2, d4) = (self.a2_m, self.d4_m);
        let below = (((a2 + d4) * (a2 + d4) - l2) / (2.0 * a2)).max(0.0);
        let above = ((l2 - (a2 - d4) * (a2 - d4)) / (2.0 * a2)).max(0.0);
        2.0 * libm::atan2(below.sqrt(), above.sqrt())
    }

    /// The first three joints: theta2 for theta1 and theta3 (rad) and the wrist
    /// centre in the plane of the arm.
    fn arm_solution(
        &self,
        shoulder: i8,
        elbow: i8,
        theta1: f64,
        theta3: f64,
        centre: &PlanarPoint,
        previous: Option<&Joints>,
    ) -> ArmSolution {
        let PlanarPoint { reach, height } = *centre;
        let (s3, c3) = libm::sincos(theta3);
        let (x, y) = (self.a2_m - self.d4_m * s3, self.d4_m * c3);
        let theta2 =
            if reach * reach + height * height < THETA2_FREE_DISTANCE_M * THETA2_FREE_DISTANCE_M {
                previous.map_or(0.0, |q| q[1])
            } else {
                libm::atan2(height * x - reach * y, reach * x + height * y)
            };
        let mut flags = 0;
        if reach.abs() < DOUBLE_ROOT_DISTANCE * (self.a2_m + self.d4_m) {
            flags |= SHOULDER_SINGULAR;
        }
        if c3.abs() < DOUBLE_ROOT_DISTANCE {
            flags |= ELBOW_SINGULAR;
        }
        ArmSolution { shoulder, elbow, theta: [theta1, wrap_angle(theta2), theta3], flags }
    }

    /// Appends the two branches of the wrist for the first three joints `arm` and the rotation of
    /// T6. `sin1` and `cos1` are those of theta1.
    fn push_wrist_branches(
        &self,
        rotation: &DMat3,
        arm: &ArmSolution,
        sin1: f64,
        cos1: f64,
        previous: Option<&Joints>,
        out: &mut Branches,
    ) {
        let [t1, t2, t3] = arm.theta;
        let w = forearm_rotation(sin1, cos1, t2 + t3).transpose() * *rotation;
        let (wx, wy) = (w.z_axis.x, w.z_axis.y);
        let is_singular = wx * wx + wy * wy < WRIST_SINGULAR_SINE * WRIST_SINGULAR_SINE;
        let theta4 = if is_singular { free_theta4(previous) } else { libm::atan2(-wy, -wx) };
        let (theta5, theta6) = theta5_and_theta6(&w, theta4);
        let arm_in_limits = (self.has_equivalent_in_range(0, t1)
            & self.has_equivalent_in_range(1, t2))
            & self.has_equivalent_in_range(2, t3);
        let flags = arm.flags | if is_singular { WRIST_SINGULAR } else { 0 };
        // The other wrist: axes 4 and 6 are half a turn away, and joint 5 has the other sign.
        for (wrist, last) in [
            (1, [theta4, theta5, theta6]),
            (-1, [half_turn_away(theta4), -theta5, half_turn_away(theta6)]),
        ] {
            let [t4, t5, t6] = last.map(wrap_angle);
            out.push(Branch {
                shoulder: arm.shoulder,
                elbow: arm.elbow,
                wrist,
                q: Joints::new(t1, t2, t3, t4, t5, t6),
                in_limits: arm_in_limits
                    && self.has_equivalent_in_range(3, t4)
                    && self.has_equivalent_in_range(4, t5)
                    && self.has_equivalent_in_range(5, t6),
                singular_flags: flags,
            });
        }
    }

    /// Whether `angle_rad` plus whole turns lies inside the limits of `joint`.
    fn has_equivalent_in_range(&self, joint: usize, angle_rad: f64) -> bool {
        limits::has_equivalent_in_range(self.q_min_rad[joint], self.q_max_rad[joint], angle_rad)
    }

    /// The index of the branch nearest to `previous` (rad), and its joints (rad), shifted by whole
    /// turns to be near `previous` and inside the limits. The distance is the largest one of any
    /// joint; of equal branches the first one is taken. `None` where no branch is inside the limits
    /// or `previous` has a number that is not finite.
    #[must_use]
    pub fn nearest_branch(
        &self,
        branches: &Branches,
        previous: &Joints,
    ) -> Option<(usize, Joints)> {
        let mut best: Option<(usize, Joints, f64)> = None;
        for (index, branch) in branches.iter().enumerate() {
            let Some((q, distance)) = self.nearest_equivalent(&branch.q, previous) else {
                continue;
            };
            if best.as_ref().is_none_or(|b| distance < b.2) {
                best = Some((index, q, distance));
            }
        }
        best.map(|(index, q, _)| (index, q))
    }

    /// The joints nearest to `previous` (rad) that reach the tool pose `tool` (base frame), inside
    /// or outside the limits: for the drawing of a motion, not for its execution. `None` where the
    /// pose is out of reach or a number is not finite.
    #[must_use]
    pub fn inverse_without_limits(&self, tool: &Pose, previous: &Joints) -> Option<Joints> {
        if previous.iter().any(|x| !x.is_finite()) {
            return None;
        }
        let branches = self.inverse_kinematics(&self.tool_to_wrist(tool), Some(previous));
        let mut best: Option<(Joints, f64)> = None;
        for branch in &branches {
            let shift = (branch.q - previous).map(wrap_angle);
            let distance = shift.amax();
            if best.as_ref().is_none_or(|best| distance < best.1) {
                best = Some((previous + shift, distance));
            }
        }
        best.map(|(q, _)| q)
    }

    /// [`limits::nearest_equivalent`] of `q` inside the limits of this arm.
    pub(super) fn nearest_equivalent(
        &self,
        q: &Joints,
        previous: &Joints,
    ) -> Option<(Joints, f64)> {
        limits::nearest_equivalent(q, previous, &self.q_min_rad, &self.q_max_rad)
    }
}

/// Whether the elements of the rotation are at most 2 and those of the translation at most
/// `bound_m` (m) in size, so that no later computation overflows. NaN is not.
#[inline]
pub(crate) fn is_bounded(pose: &Pose, bound_m: f64) -> bool {
    let rotation = pose.rotation.to_cols_array();
    let translation = pose.translation.to_array();
    rotation.iter().all(|x| x.abs() <= 2.0) && translation.iter().all(|x| x.abs() <= bound_m)
}

/// The rotation of the frame of the forearm in the base frame, for the sine and cosine of theta1,
/// and for theta2 + theta3 (rad).
pub(super) fn forearm_rotation(sin1: f64, cos1: f64, theta23: f64) -> DMat3 {
    let (s23, c23) = libm::sincos(theta23);
    DMat3::from_cols(
        DVec3::new(cos1 * c23, sin1 * c23, s23),
        DVec3::new(-sin1, cos1, 0.0),
        DVec3::new(-cos1 * s23, -sin1 * s23, c23),
    )
}

/// theta5 and theta6 (rad) that for a given `theta4` come nearest to the rotation `w` of T6 in the
/// frame of the forearm. The error is the component of the approach axis normal to the plane that
/// theta4 determines.
pub(super) fn theta5_and_theta6(w: &DMat3, theta4: f64) -> (f64, f64) {
    let (s4, c4) = libm::sincos(theta4);
    let theta5 = libm::atan2(-(c4 * w.z_axis.x + s4 * w.z_axis.y), w.z_axis.z);
    let theta6 =
        libm::atan2(-s4 * w.x_axis.x + c4 * w.x_axis.y, -s4 * w.y_axis.x + c4 * w.y_axis.y);
    (theta5, theta6)
}

/// The angle half a turn away, nearer to zero (rad).
fn half_turn_away(angle_rad: f64) -> f64 {
    if angle_rad < 0.0 { angle_rad + PI } else { angle_rad - PI }
}

/// theta4 (rad) of the branch with wrist +1 at the wrist singularity, where it is free.
fn free_theta4(previous: Option<&Joints>) -> f64 {
    match previous {
        None => 0.0,
        Some(q) if q[4] < 0.0 => wrap_angle(q[3] + PI),
        Some(q) => wrap_angle(q[3]),
    }
}
