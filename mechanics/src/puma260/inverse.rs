//! Closed-form inverse of the PUMA 260: all eight branches, their limits and the one nearest to
//! the joints before. Refuses poses out of reach (no branch) and poses that hold a NaN (no
//! branch).
//!
//! Every angle comes from `atan2` of quantities formed without cancellation, and theta5, theta6
//! are taken after theta4 is fixed (premultiplication, Paul and Zhang 1986), so that the pose is
//! met to rounding even where a joint itself is badly determined.

use super::Puma260;
use crate::limits;
use crate::spatial::{Joints, Pose, wrap_angle};
use core::f64::consts::{FRAC_PI_2, PI};
use glam::{DMat3, DVec3};

/// Bit of [`Branch::singular_flags`]: the wrist centre is on the cylinder of the shoulder offset,
/// both shoulder roots fall together.
pub const SHOULDER_SINGULAR: u8 = 1;
/// Bit of [`Branch::singular_flags`]: arm stretched or folded, both elbow roots fall together.
pub const ELBOW_SINGULAR: u8 = 2;
/// Bit of [`Branch::singular_flags`]: axes 4 and 6 in line, theta4 is free and was held.
pub const WRIST_SINGULAR: u8 = 4;

/// Scaled distance below which a double root of shoulder or elbow is flagged.
pub(crate) const DOUBLE_ROOT_DISTANCE: f64 = 1e-7;
/// `|sin theta5|` below which theta4 is held: far under what one count moves, and what it costs in
/// the pose is at most its own size.
pub(crate) const WRIST_SINGULAR_SINE: f64 = 1e-11;
/// How far (m) a wrist centre may be out of reach and still be taken as on the boundary.
const REACH_TOLERANCE_M: f64 = 1e-9;
/// Distance of the wrist centre from the shoulder (m) below which theta2 is free.
const THETA2_FREE_DISTANCE_M: f64 = 1e-12;

/// One solution of the inverse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Branch {
    /// +1: the wrist centre is forward of the shoulder (positive reach); -1: behind it.
    pub shoulder: i8,
    /// +1: theta3 above -90 deg; -1: below.
    pub elbow: i8,
    /// +1: theta5 >= 0; -1: theta5 < 0.
    pub wrist: i8,
    /// Joint angles (rad), each in `[-pi, pi)`.
    pub q: Joints,
    /// Whether some whole-turn shift of every joint lies inside the limits.
    pub in_limits: bool,
    /// [`SHOULDER_SINGULAR`], [`ELBOW_SINGULAR`], [`WRIST_SINGULAR`].
    pub singular_flags: u8,
}

/// The solutions of one pose: 8, 4 or none, ordered by shoulder, elbow, wrist, +1 first.
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

    /// The solutions.
    #[must_use]
    pub fn as_slice(&self) -> &[Branch] {
        &self.branches[..self.len]
    }

    /// The solutions in order.
    pub fn iter(&self) -> core::slice::Iter<'_, Branch> {
        self.as_slice().iter()
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether the pose is out of reach.
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

/// The first three joints of a branch.
struct ArmSolution {
    shoulder: i8,
    elbow: i8,
    theta: [f64; 3],
    flags: u8,
}

impl Puma260 {
    /// All branches that reach T6 `wrist` (base frame, orthonormal rotation).
    ///
    /// `previous` decides theta4 where the wrist is singular: the branch with the sign of the
    /// previous theta5 keeps the previous theta4, the other is half a turn from it; without
    /// `previous` theta4 = 0. A pose out of reach by more than a nanometre, one with a number that
    /// is not finite, and one whose rotation holds a number above 2 has no branch; `previous` that
    /// is not finite counts as absent.
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
        let (stretched, folded) = (self.a2_m + self.d4_m, (self.a2_m - self.d4_m).abs());
        let l = l2.max(0.0).sqrt();
        let outside = d3 - r > REACH_TOLERANCE_M
            || l - stretched > REACH_TOLERANCE_M
            || folded - l > REACH_TOLERANCE_M;
        if outside {
            return out;
        }
        let azimuth = libm::atan2(p.y, p.x);
        let opening = self.elbow_opening(l2);
        for shoulder in [1_i8, -1] {
            let reach = f64::from(shoulder) * ((r - d3) * (r + d3)).max(0.0).sqrt();
            let theta1 = wrap_angle(azimuth + libm::atan2(self.d3_m, reach));
            let turn = libm::sincos(theta1);
            for elbow in [1_i8, -1] {
                let theta3 = wrap_angle(-FRAC_PI_2 + f64::from(elbow) * opening);
                let root =
                    self.arm_solution(shoulder, elbow, [theta1, theta3], reach, p.z, previous);
                self.push_wrist_branches(&wrist.rotation, &root, turn, previous, &mut out);
            }
        }
        out
    }

    /// No coordinate of a wrist centre in reach is larger (m).
    fn coordinate_bound_m(&self) -> f64 {
        2.0 * (self.a2_m.abs() + self.d3_m.abs() + self.d4_m.abs())
    }

    /// Angle of the elbow from stretched, in `[0, pi]`, for the square of the distance from the
    /// shoulder to the wrist centre (m^2): an arc cosine without loss near either end.
    fn elbow_opening(&self, l2: f64) -> f64 {
        let (a2, d4) = (self.a2_m, self.d4_m);
        let below = (((a2 + d4) * (a2 + d4) - l2) / (2.0 * a2)).max(0.0);
        let above = ((l2 - (a2 - d4) * (a2 - d4)) / (2.0 * a2)).max(0.0);
        2.0 * libm::atan2(below.sqrt(), above.sqrt())
    }

    /// Joint 2 for joints 1 and 3, the reach in the plane of the arm and the height (m).
    fn arm_solution(
        &self,
        shoulder: i8,
        elbow: i8,
        [theta1, theta3]: [f64; 2],
        reach: f64,
        height: f64,
        previous: Option<&Joints>,
    ) -> ArmSolution {
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

    /// Both wrists of an arm; `turn` is sine and cosine of theta1.
    fn push_wrist_branches(
        &self,
        rotation: &DMat3,
        root: &ArmSolution,
        (s1, c1): (f64, f64),
        previous: Option<&Joints>,
        out: &mut Branches,
    ) {
        let [t1, t2, t3] = root.theta;
        let w = forearm_rotation((s1, c1), t2 + t3).transpose() * *rotation;
        let (wx, wy) = (w.z_axis.x, w.z_axis.y);
        let singular = wx * wx + wy * wy < WRIST_SINGULAR_SINE * WRIST_SINGULAR_SINE;
        let theta4 = if singular { free_theta4(previous) } else { libm::atan2(-wy, -wx) };
        let (theta5, theta6) = theta5_and_theta6(&w, theta4);
        let inside = (self.has_equivalent_in_range(0, t1) & self.has_equivalent_in_range(1, t2))
            & self.has_equivalent_in_range(2, t3);
        let flags = root.flags | if singular { WRIST_SINGULAR } else { 0 };
        // The other wrist: half a turn of axes 4 and 6, joint 5 mirrored.
        for (wrist, last) in [
            (1, [theta4, theta5, theta6]),
            (-1, [half_turn_away(theta4), -theta5, half_turn_away(theta6)]),
        ] {
            let [t4, t5, t6] = last.map(wrap_angle);
            out.push(Branch {
                shoulder: root.shoulder,
                elbow: root.elbow,
                wrist,
                q: Joints::new(t1, t2, t3, t4, t5, t6),
                in_limits: inside
                    && self.has_equivalent_in_range(3, t4)
                    && self.has_equivalent_in_range(4, t5)
                    && self.has_equivalent_in_range(5, t6),
                singular_flags: flags,
            });
        }
    }

    fn has_equivalent_in_range(&self, joint: usize, angle_rad: f64) -> bool {
        limits::has_equivalent_in_range(self.q_min_rad[joint], self.q_max_rad[joint], angle_rad)
    }

    /// The branch nearest to `previous` and its joints, expanded by whole turns: of all shifts
    /// inside the limits the one whose largest joint distance is smallest. The first of equals
    /// wins. `None` when no branch is inside the limits or `previous` holds a number that is not
    /// finite.
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

    /// The joints that reach tool pose `tool` (base frame) nearest to `previous`, on its turns,
    /// whether inside the limits or not: for drawing a motion, not for making it. `None` out of
    /// reach or where a number is not finite.
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

    /// The whole-turn shift of `q` inside the limits nearest to `previous`, and the largest joint
    /// distance. Joints are independent, so each takes its own nearest turn.
    pub(super) fn nearest_equivalent(
        &self,
        q: &Joints,
        previous: &Joints,
    ) -> Option<(Joints, f64)> {
        limits::nearest_equivalent(q, previous, &self.q_min_rad, &self.q_max_rad)
    }
}

/// Whether a pose is made of numbers, none of them beyond what a rotation and a place in reach are
/// made of: then nothing that follows overflows.
#[inline]
pub(crate) fn is_bounded(pose: &Pose, bound_m: f64) -> bool {
    let rotation = pose.rotation.to_cols_array();
    let place = pose.translation.to_array();
    rotation.iter().all(|x| x.abs() <= 2.0) && place.iter().all(|x| x.abs() <= bound_m)
}

/// Rotation of the forearm's frame in the base, for sine and cosine of theta1 and theta2 + theta3.
pub(super) fn forearm_rotation((s1, c1): (f64, f64), theta23: f64) -> DMat3 {
    let (s23, c23) = libm::sincos(theta23);
    DMat3::from_cols(
        DVec3::new(c1 * c23, s1 * c23, s23),
        DVec3::new(-s1, c1, 0.0),
        DVec3::new(-c1 * s23, -s1 * s23, c23),
    )
}

/// theta5 and theta6 that come nearest to the wrist's rotation `w` with this theta4; they meet it
/// but for the part of the approach that lies out of the plane of theta4.
pub(super) fn theta5_and_theta6(w: &DMat3, theta4: f64) -> (f64, f64) {
    let (s4, c4) = libm::sincos(theta4);
    let theta5 = libm::atan2(-(c4 * w.z_axis.x + s4 * w.z_axis.y), w.z_axis.z);
    let theta6 =
        libm::atan2(-s4 * w.x_axis.x + c4 * w.x_axis.y, -s4 * w.y_axis.x + c4 * w.y_axis.y);
    (theta5, theta6)
}

fn half_turn_away(angle_rad: f64) -> f64 {
    if angle_rad < 0.0 { angle_rad + PI } else { angle_rad - PI }
}

/// theta4 of the branch with wrist +1 where it is free; the other branch is half a turn away.
fn free_theta4(previous: Option<&Joints>) -> f64 {
    match previous {
        None => 0.0,
        Some(q) if q[4] < 0.0 => wrap_angle(q[3] + PI),
        Some(q) => wrap_angle(q[3]),
    }
}
