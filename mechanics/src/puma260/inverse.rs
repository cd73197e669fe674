//! Closed-form inverse of the PUMA 260: all eight branches, their limits and the one nearest to the
//! joints before. Refuses poses out of reach (no branch) and poses that hold a NaN (no branch).
//!
//! Every angle comes from `atan2` of quantities formed without cancellation, and theta5, theta6 are
//! taken after theta4 is fixed (premultiplication, Paul and Zhang 1986), so that the pose is met to
//! rounding even where a joint itself is badly determined.

use super::Puma260;
use crate::spatial::{Joints, Pose, wrap_angle};
use core::f64::consts::{FRAC_PI_2, PI, TAU};
use glam::{DMat3, DVec3};

/// Bit of [`Branch::singular_flags`]: the wrist centre is on the cylinder of the shoulder offset,
/// both shoulder roots fall together.
pub const SHOULDER_SINGULAR: u8 = 1;
/// Bit of [`Branch::singular_flags`]: arm stretched or folded, both elbow roots fall together.
pub const ELBOW_SINGULAR: u8 = 2;
/// Bit of [`Branch::singular_flags`]: axes 4 and 6 in line, theta4 is free and was held.
pub const WRIST_SINGULAR: u8 = 4;

/// Scaled distance below which a double root of shoulder or elbow is flagged.
const DOUBLE_ROOT: f64 = 1e-7;
/// `|sin theta5|` below which theta4 is held: far under what one count moves, and what it costs in
/// the pose is at most its own size.
const WRIST_HOLD: f64 = 1e-11;
/// How far (m) a wrist centre may be out of reach and still be taken as on the boundary.
const REACH_TOLERANCE_M: f64 = 1e-9;
/// Distance of the wrist centre from the shoulder (m) below which theta2 is free.
const FOLDED_M: f64 = 1e-12;

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
    fn empty() -> Branches {
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

    fn push(&mut self, branch: Branch) {
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
struct ArmRoot {
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
    /// `previous` theta4 = 0. A pose out of reach by more than a nanometre, or one with a number
    /// that is not finite, has no branch; `previous` with such numbers counts as absent.
    #[must_use]
    pub fn inverse(&self, wrist: &Pose, previous: Option<&Joints>) -> Branches {
        let mut out = Branches::empty();
        let p = wrist.translation;
        if !wrist.is_finite() || p.abs().max_element() > self.reach_bound_m() {
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
        for shoulder in [1_i8, -1] {
            for elbow in [1_i8, -1] {
                let root = self.arm_root(p, r, shoulder, elbow, previous);
                for sign in [1_i8, -1] {
                    out.push(self.complete(&wrist.rotation, &root, sign, previous));
                }
            }
        }
        out
    }

    /// No coordinate of a wrist centre in reach is larger (m).
    fn reach_bound_m(&self) -> f64 {
        2.0 * (self.a2_m.abs() + self.d3_m.abs() + self.d4_m.abs())
    }

    fn arm_root(
        &self,
        p: DVec3,
        r: f64,
        shoulder: i8,
        elbow: i8,
        previous: Option<&Joints>,
    ) -> ArmRoot {
        let (a2, d3, d4) = (self.a2_m, self.d3_m, self.d4_m);
        let x2 = (r - d3.abs()) * (r + d3.abs());
        let reach = f64::from(shoulder) * x2.max(0.0).sqrt();
        let theta1 = libm::atan2(p.y, p.x) + libm::atan2(d3, reach);

        let l2 = x2.max(0.0) + p.z * p.z;
        let below = (((a2 + d4) * (a2 + d4) - l2) / (2.0 * a2)).max(0.0);
        let above = ((l2 - (a2 - d4) * (a2 - d4)) / (2.0 * a2)).max(0.0);
        let opening = 2.0 * libm::atan2(below.sqrt(), above.sqrt());
        let theta3 = -FRAC_PI_2 + f64::from(elbow) * opening;

        let (s3, c3) = libm::sincos(theta3);
        let (x, y) = (a2 - d4 * s3, d4 * c3);
        let theta2 = if l2 < FOLDED_M * FOLDED_M {
            previous.map_or(0.0, |q| q[1])
        } else {
            libm::atan2(p.z * x - reach * y, reach * x + p.z * y)
        };

        let mut flags = 0;
        if reach.abs() < DOUBLE_ROOT * (a2 + d4) {
            flags |= SHOULDER_SINGULAR;
        }
        if c3.abs() < DOUBLE_ROOT {
            flags |= ELBOW_SINGULAR;
        }
        ArmRoot { shoulder, elbow, theta: [theta1, theta2, theta3].map(wrap_angle), flags }
    }

    fn complete(
        &self,
        rotation: &DMat3,
        root: &ArmRoot,
        wrist: i8,
        previous: Option<&Joints>,
    ) -> Branch {
        let (s1, c1) = libm::sincos(root.theta[0]);
        let (s23, c23) = libm::sincos(root.theta[1] + root.theta[2]);
        let arm = DMat3::from_cols(
            DVec3::new(c1 * c23, s1 * c23, s23),
            DVec3::new(-s1, c1, 0.0),
            DVec3::new(-c1 * s23, -s1 * s23, c23),
        );
        let w = arm.transpose() * *rotation;
        let sign = f64::from(wrist);
        let mut flags = root.flags;
        let theta4 = if (w.z_axis.x * w.z_axis.x + w.z_axis.y * w.z_axis.y).sqrt() < WRIST_HOLD {
            flags |= WRIST_SINGULAR;
            held_theta4(sign, previous)
        } else {
            libm::atan2(-sign * w.z_axis.y, -sign * w.z_axis.x)
        };
        let (s4, c4) = libm::sincos(theta4);
        let theta5 = libm::atan2(-(c4 * w.z_axis.x + s4 * w.z_axis.y), w.z_axis.z);
        let theta6 =
            libm::atan2(-s4 * w.x_axis.x + c4 * w.x_axis.y, -s4 * w.y_axis.x + c4 * w.y_axis.y);
        let [t1, t2, t3] = root.theta;
        let q = Joints::new(t1, t2, t3, theta4, theta5, theta6).map(wrap_angle);
        Branch {
            shoulder: root.shoulder,
            elbow: root.elbow,
            wrist,
            q,
            in_limits: (0..6).all(|i| self.some_turn_inside(i, q[i])),
            singular_flags: flags,
        }
    }

    fn some_turn_inside(&self, joint: usize, angle_rad: f64) -> bool {
        let (low, high) = (self.q_min_rad[joint], self.q_max_rad[joint]);
        let lowest = angle_rad + TAU * ((low - angle_rad) / TAU).ceil();
        lowest <= high || (low <= angle_rad && angle_rad <= high)
    }

    /// The branch nearest to `previous` and its joints, expanded by whole turns: of all shifts inside
    /// the limits the one whose largest joint distance is smallest. The first of equals wins. `None`
    /// when no branch is inside the limits or `previous` holds a number that is not finite.
    #[must_use]
    pub fn nearest(&self, branches: &Branches, previous: &Joints) -> Option<(usize, Joints)> {
        let mut best: Option<(usize, Joints, f64)> = None;
        for (index, branch) in branches.iter().enumerate() {
            let Some((q, distance)) = self.expand(&branch.q, previous) else { continue };
            if best.as_ref().is_none_or(|b| distance < b.2) {
                best = Some((index, q, distance));
            }
        }
        best.map(|(index, q, _)| (index, q))
    }

    /// The whole-turn shift of `q` inside the limits nearest to `previous`, and the largest joint
    /// distance. Joints are independent, so each takes its own nearest turn.
    fn expand(&self, q: &Joints, previous: &Joints) -> Option<(Joints, f64)> {
        let mut out = *q;
        let mut distance: f64 = 0.0;
        for i in 0..6 {
            let (low, high, wish) = (self.q_min_rad[i], self.q_max_rad[i], previous[i]);
            if !wish.is_finite() {
                return None;
            }
            let turns = ((wish.clamp(low, high) - q[i]) / TAU).round();
            let candidate = [turns, turns - 1.0, turns + 1.0]
                .map(|n| q[i] + TAU * n)
                .into_iter()
                .filter(|x| low <= *x && *x <= high)
                .min_by(|a, b| (a - wish).abs().total_cmp(&(b - wish).abs()))?;
            out[i] = candidate;
            distance = distance.max((candidate - wish).abs());
        }
        Some((out, distance))
    }
}

fn held_theta4(sign: f64, previous: Option<&Joints>) -> f64 {
    match previous {
        None if sign > 0.0 => 0.0,
        None => PI,
        Some(q) => {
            let same_side = (q[4] >= 0.0) == (sign > 0.0);
            if same_side { wrap_angle(q[3]) } else { wrap_angle(q[3] + PI) }
        }
    }
}
