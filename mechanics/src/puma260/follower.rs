//! Following a tool path tick by tick on one branch of the inverse kinematics, also through and
//! past the wrist singularity. Refuses to leave the branch, a limit, or the speed of joints 1 to
//! 3: there the path itself is at fault, and the caller is told which joint.
//!
//! Past the singularity joints 4 and 6 would have to spin faster than they can. Then joint 4 turns
//! as fast as its speed and acceleration allow, and joints 5 and 6 are solved anew for the angle
//! that it has: what is missed is `|sin theta5|` times the sine of joint 4's lag, an error of
//! orientation that vanishes at the singularity itself. The wrist centre never leaves its path.
//! The nearer of both wrist configurations is the aim, so a path straight through the singularity
//! lets joint 5 change its sign and costs nothing; one that passes very near is treated likewise:
//! joint 4 holds the plane in which the approach axis moves, and the path is missed by the angle
//! at which it misses the singularity, never by more than about half the rate of the approach axis
//! over the speed of joint 4.

use glam::{DMat3, DVec2};

use super::Puma260;
use super::inverse::{forearm_rotation, theta5_and_theta6};
use crate::arm::{FollowError, FollowerStep};
use crate::spatial::{Joints, Pose, rotation_vector, wrap_angle};

/// Rounding that a limit forgives, relative.
const LIMIT_ROUNDING: f64 = 1e-9;
/// Slower than this the approach axis stands still (rad/s).
const APPROACH_RATE_MIN_RAD_S: f64 = 1e-6;
/// A path that passes the singularity nearer than this part of (its rate over joint 4's speed) is
/// missed less by holding joint 4 than by chasing it: where both cost the same, by experiment.
const HOLD_DISTANCE_RATIO: f64 = 0.5;
/// Halvings of the step of joint 4 when joints 5 or 6 cannot follow it.
const STEP_HALVINGS_MAX: u32 = 8;

/// Follows a path of tool poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Follower {
    arm: Puma260,
    q: Joints,
    shoulder: i8,
    elbow: i8,
    /// Speed of joint 4 in the last tick (rad/s).
    joint4_speed_rad_s: f64,
    /// Where joint 4 was to be in the last tick (rad).
    joint4_target_rad: f64,
    /// The wanted approach axis of the last tick, across the forearm; 0 is the singularity.
    approach_across: DVec2,
}

impl Follower {
    /// Starts from rest at `q` (rad), whose branch it keeps; speeds and accelerations are those of
    /// `arm`.
    #[must_use]
    pub fn new(arm: &Puma260, q: &Joints) -> Follower {
        let reach = arm.singularity_distance(q).shoulder;
        let opening = wrap_angle(q[2] + core::f64::consts::FRAC_PI_2);
        Follower {
            arm: *arm,
            q: *q,
            shoulder: if reach < 0.0 { -1 } else { 1 },
            elbow: if opening < 0.0 { -1 } else { 1 },
            joint4_speed_rad_s: 0.0,
            joint4_target_rad: q[3],
            approach_across: approach_across_forearm(q),
        }
    }

    /// The joints of the last tick (rad).
    #[must_use]
    pub fn joints(&self) -> &Joints {
        &self.q
    }

    /// The joints for tool pose `tool` (base frame) one tick of `dt_s` (s) after the last.
    ///
    /// # Errors
    /// [`FollowError`]; the joints stay as they were.
    pub fn step(&mut self, tool: &Pose, dt_s: f64) -> Result<FollowerStep, FollowError> {
        let wrist = self.arm.tool_to_wrist(tool);
        let aim = self.target_joints(&wrist)?;
        for joint in 0..3 {
            let ratio =
                (aim[joint] - self.q[joint]).abs() / (self.arm.speed_max_rad_s[joint] * dt_s);
            if ratio > 1.0 + LIMIT_ROUNDING {
                return Err(FollowError::SpeedLimit { joint, ratio });
            }
        }
        let w =
            forearm_rotation(libm::sincos(aim[0]), aim[1] + aim[2]).transpose() * wrist.rotation;
        let held = self.hold_angle(&w, dt_s);
        self.approach_across = DVec2::new(w.z_axis.x, w.z_axis.y);
        if held.is_none() && self.can_wrist_reach(&aim, dt_s) {
            self.joint4_speed_rad_s = (aim[3] - self.q[3]) / dt_s;
            self.joint4_target_rad = aim[3];
            self.q = aim;
            return Ok(FollowerStep { q: aim, position_error_m: 0.0, orientation_error_rad: 0.0 });
        }
        let q = self.lagging_joints(&w, &aim, held, dt_s)?;
        self.joint4_speed_rad_s = (q[3] - self.q[3]) / dt_s;
        self.joint4_target_rad = held.unwrap_or(aim[3]);
        self.q = q;
        let got = self.arm.tool_pose(&q);
        Ok(FollowerStep {
            q,
            position_error_m: (got.translation - tool.translation).length(),
            orientation_error_rad: rotation_vector(&got.rotation, &tool.rotation).length(),
        })
    }

    /// The exact solution nearest to the last joints on this branch of shoulder and elbow.
    fn target_joints(&self, wrist: &Pose) -> Result<Joints, FollowError> {
        let branches = self.arm.inverse_kinematics(wrist, Some(&self.q));
        let mut best: Option<(Joints, f64)> = None;
        let mut outside = None;
        for branch in &branches {
            if (branch.shoulder, branch.elbow) != (self.shoulder, self.elbow) {
                continue;
            }
            match self.arm.nearest_equivalent(&branch.q, &self.q) {
                Some((q, distance)) if best.is_none_or(|best| distance < best.1) => {
                    best = Some((q, distance));
                }
                Some(_) => {}
                None => outside = outside.or(Some(branch.q)),
            }
        }
        match (best, outside) {
            (Some((q, _)), _) => Ok(q),
            (None, Some(q)) => Err(FollowError::JointLimit { joint: self.first_joint_outside(&q) }),
            (None, None) => Err(FollowError::OutOfReach),
        }
    }

    /// The first joint no turn of which lies within the limits.
    fn first_joint_outside(&self, q: &Joints) -> usize {
        let outside = |joint: &usize| {
            let mut only = self.q;
            only[*joint] = q[*joint];
            self.arm.nearest_equivalent(&only, &self.q).is_none()
        };
        (0..6).find(outside).unwrap_or(0)
    }

    /// Whether joints 4 to 6 get to `aim` in one tick.
    fn can_wrist_reach(&self, aim: &Joints, dt_s: f64) -> bool {
        let speed4 = (aim[3] - self.q[3]) / dt_s;
        let change = (speed4 - self.joint4_speed_rad_s).abs();
        change <= self.arm.acceleration_max_rad_s2[3] * dt_s * (1.0 + LIMIT_ROUNDING)
            && (3..6).all(|joint| self.is_within_speed(joint, aim[joint], dt_s))
    }

    fn is_within_speed(&self, joint: usize, angle: f64, dt_s: f64) -> bool {
        let step = (angle - self.q[joint]).abs();
        step <= self.arm.speed_max_rad_s[joint] * dt_s * (1.0 + LIMIT_ROUNDING)
    }

    /// The angle of joint 4 (rad) whose plane the approach axis moves along, if it is about to pass
    /// the singularity nearer than joint 4 could ever turn with it.
    fn hold_angle(&self, w: &DMat3, dt_s: f64) -> Option<f64> {
        let at = DVec2::new(w.z_axis.x, w.z_axis.y);
        let way = (at - self.approach_across) / dt_s;
        let rate = way.length();
        let (most, acceleration) =
            (self.arm.speed_max_rad_s[3], self.arm.acceleration_max_rad_s2[3]);
        if rate.is_nan() || rate <= APPROACH_RATE_MIN_RAD_S {
            return None;
        }
        let miss = (at.perp_dot(way) / rate).abs();
        // Beyond this distance the exact angle asks for little speed and acceleration.
        let calm = libm::cbrt(4.0 * rate * rate * miss / acceleration)
            .max((2.0 * rate * miss / most).sqrt());
        if miss >= HOLD_DISTANCE_RATIO * rate / most || at.length() >= calm {
            return None;
        }
        let plane = libm::atan2(way.y, way.x);
        let turned = wrap_angle(2.0 * (plane - self.q[3])) / 2.0;
        Some(self.q[3] + turned)
    }

    /// Joint 4 as near to its aim as it gets, joints 5 and 6 solved for it.
    fn lagging_joints(
        &self,
        w: &DMat3,
        aim: &Joints,
        held: Option<f64>,
        dt_s: f64,
    ) -> Result<Joints, FollowError> {
        let acceleration = self.arm.acceleration_max_rad_s2[3];
        let most = self.arm.speed_max_rad_s[3];
        let aim4 = held.unwrap_or(aim[3]);
        // The aim moves too, unless it has just jumped or is held.
        let drift = (aim4 - self.joint4_target_rad) / dt_s;
        let drift = if drift.abs() <= most { drift } else { 0.0 };
        let gap = aim4 - self.q[3] - drift * dt_s;
        // The speed of approach from which it can still settle on its aim.
        let closing = (2.0 * acceleration * gap.abs()).sqrt().min(gap.abs() / dt_s) * gap.signum();
        let change = acceleration * dt_s;
        let speed = (drift + closing)
            .clamp(-most, most)
            .clamp(self.joint4_speed_rad_s - change, self.joint4_speed_rad_s + change);
        let mut share = 1.0;
        for _ in 0..STEP_HALVINGS_MAX {
            let q = self.joints_with_theta4(w, aim, self.q[3] + speed * dt_s * share);
            if (3..6).all(|joint| self.is_within_speed(joint, q[joint], dt_s)) {
                return self.check_wrist_limits(q);
            }
            share *= 0.5;
        }
        let q = self.joints_with_theta4(w, aim, self.q[3]);
        let ratio = |joint: usize| {
            (q[joint] - self.q[joint]).abs() / (self.arm.speed_max_rad_s[joint] * dt_s)
        };
        match [4, 5].into_iter().find(|joint| ratio(*joint) > 1.0 + LIMIT_ROUNDING) {
            Some(joint) => Err(FollowError::SpeedLimit { joint, ratio: ratio(joint) }),
            None => self.check_wrist_limits(q),
        }
    }

    fn joints_with_theta4(&self, w: &DMat3, aim: &Joints, theta4: f64) -> Joints {
        let (theta5, theta6) = theta5_and_theta6(w, theta4);
        let near = |angle: f64, joint: usize| self.q[joint] + wrap_angle(angle - self.q[joint]);
        Joints::new(aim[0], aim[1], aim[2], theta4, near(theta5, 4), near(theta6, 5))
    }

    fn check_wrist_limits(&self, q: Joints) -> Result<Joints, FollowError> {
        let (low, high) = (&self.arm.q_min_rad, &self.arm.q_max_rad);
        match (3..6).find(|&joint| q[joint] < low[joint] || q[joint] > high[joint]) {
            Some(joint) => Err(FollowError::JointLimit { joint }),
            None => Ok(q),
        }
    }
}

/// The approach axis across the forearm.
fn approach_across_forearm(q: &Joints) -> DVec2 {
    let ((s4, c4), s5) = (libm::sincos(q[3]), libm::sin(q[4]));
    DVec2::new(-c4 * s5, -s4 * s5)
}
