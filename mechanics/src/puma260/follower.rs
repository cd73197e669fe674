//! A follower of tool paths on one branch of the inverse kinematics, also through and past the
//! wrist singularity. It reports the joint where the path would leave the branch or a limit, or
//! exceed the speed of joints 1 to 3.
//!
//! Near the wrist singularity joints 4 and 6 would have to rotate faster than they can. Then joint
//! 4 moves as fast as its speed and acceleration allow, and joints 5 and 6 are computed for the
//! angle that it has. The error of the orientation is `|sin theta5|` times the sine of the lag of
//! joint 4, and vanishes at the singularity itself. The wrist centre never leaves its path.
//!
//! The target is the nearer of the two wrist solutions, so that on a path straight through the
//! singularity joint 5 changes its sign without error. A path that passes very near is treated in
//! the same way: joint 4 holds the plane in which the approach axis moves, and the error is the
//! angle at which the path passes the singularity, at most about half the rate of the approach axis
//! over the speed of joint 4.

use glam::{DMat3, DVec2};

use super::Puma260;
use super::inverse::{forearm_rotation, theta5_and_theta6};
use crate::arm::{FollowError, FollowerStep};
use crate::spatial::{Joints, Pose, rotation_vector, wrap_angle};

/// Relative excess over a limit that counts as rounding.
const LIMIT_ROUNDING: f64 = 1e-9;
/// Rate below which the approach axis counts as standing still (rad/s).
const APPROACH_RATE_MIN_RAD_S: f64 = 1e-6;
/// A path holds joint 4 where it passes the singularity nearer than this ratio times (the rate of
/// the approach axis over the largest speed of joint 4). At this ratio, found by experiment,
/// holding and tracking cause the same error.
const HOLD_DISTANCE_RATIO: f64 = 0.5;
/// How often the step of joint 4 is halved where joints 5 or 6 cannot follow it.
const STEP_HALVINGS_MAX: u32 = 8;

/// The state of a follower of tool poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Follower {
    arm: Puma260,
    q: Joints,
    shoulder: i8,
    elbow: i8,
    /// Speed of joint 4 in the last tick (rad/s).
    joint4_speed_rad_s: f64,
    /// Target of joint 4 in the last tick (rad).
    joint4_target_rad: f64,
    /// Desired approach axis of the last tick, projected on the plane normal to the forearm; 0 at
    /// the singularity.
    approach_across: DVec2,
}

impl Follower {
    /// A follower that starts from rest at `q` (rad) and keeps the branch of these joints. The
    /// largest speeds and accelerations are those of `arm`.
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

    /// The joints for the tool pose `tool` (base frame), one tick of `dt_s` (s) after the last one.
    ///
    /// # Errors
    /// [`FollowError`]; the joints of the last tick are kept.
    pub fn step(&mut self, tool: &Pose, dt_s: f64) -> Result<FollowerStep, FollowError> {
        let wrist = self.arm.tool_to_wrist(tool);
        let target = self.target_joints(&wrist)?;
        for joint in 0..3 {
            let ratio =
                (target[joint] - self.q[joint]).abs() / (self.arm.speed_max_rad_s[joint] * dt_s);
            if ratio > 1.0 + LIMIT_ROUNDING {
                return Err(FollowError::SpeedLimit { joint, ratio });
            }
        }
        let (sin1, cos1) = libm::sincos(target[0]);
        let w = forearm_rotation(sin1, cos1, target[1] + target[2]).transpose() * wrist.rotation;
        let hold = self.hold_angle(&w, dt_s);
        self.approach_across = DVec2::new(w.z_axis.x, w.z_axis.y);
        if hold.is_none() && self.can_wrist_reach(&target, dt_s) {
            self.joint4_speed_rad_s = (target[3] - self.q[3]) / dt_s;
            self.joint4_target_rad = target[3];
            self.q = target;
            return Ok(FollowerStep {
                q: target,
                position_error_m: 0.0,
                orientation_error_rad: 0.0,
            });
        }
        let q = self.lagging_joints(&w, &target, hold, dt_s)?;
        self.joint4_speed_rad_s = (q[3] - self.q[3]) / dt_s;
        self.joint4_target_rad = hold.unwrap_or(target[3]);
        self.q = q;
        let reached = self.arm.tool_pose(&q);
        Ok(FollowerStep {
            q,
            position_error_m: (reached.translation - tool.translation).length(),
            orientation_error_rad: rotation_vector(&reached.rotation, &tool.rotation).length(),
        })
    }

    /// The exact solution nearest to the joints of the last tick, on this branch of shoulder and
    /// elbow.
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

    /// The first joint of `q` that lies outside its limits however many whole turns are added.
    fn first_joint_outside(&self, q: &Joints) -> usize {
        let outside = |joint: &usize| {
            let mut only = self.q;
            only[*joint] = q[*joint];
            self.arm.nearest_equivalent(&only, &self.q).is_none()
        };
        (0..6).find(outside).unwrap_or(0)
    }

    /// Whether joints 4 to 6 can reach `target` in one tick of `dt_s` (s).
    fn can_wrist_reach(&self, target: &Joints, dt_s: f64) -> bool {
        let speed4 = (target[3] - self.q[3]) / dt_s;
        let change = (speed4 - self.joint4_speed_rad_s).abs();
        change <= self.arm.acceleration_max_rad_s2[3] * dt_s * (1.0 + LIMIT_ROUNDING)
            && (3..6).all(|joint| self.is_within_speed(joint, target[joint], dt_s))
    }

    /// Whether `joint` can reach `angle` (rad) in one tick of `dt_s` (s) at its largest speed.
    fn is_within_speed(&self, joint: usize, angle: f64, dt_s: f64) -> bool {
        let step = (angle - self.q[joint]).abs();
        step <= self.arm.speed_max_rad_s[joint] * dt_s * (1.0 + LIMIT_ROUNDING)
    }

    /// The angle of joint 4 (rad) in whose plane the approach axis moves, where the path is about
    /// to pass the singularity so near that joint 4 could not rotate with it.
    fn hold_angle(&self, w: &DMat3, dt_s: f64) -> Option<f64> {
        let approach = DVec2::new(w.z_axis.x, w.z_axis.y);
        let velocity = (approach - self.approach_across) / dt_s;
        let rate = velocity.length();
        let (speed_max, acceleration) =
            (self.arm.speed_max_rad_s[3], self.arm.acceleration_max_rad_s2[3]);
        if rate.is_nan() || rate <= APPROACH_RATE_MIN_RAD_S {
            return None;
        }
        let miss = (approach.perp_dot(velocity) / rate).abs();
        // Beyond this distance from the singularity joint 4 can track the exact angle.
        let tracking_distance = libm::cbrt(4.0 * rate * rate * miss / acceleration)
            .max((2.0 * rate * miss / speed_max).sqrt());
        if miss >= HOLD_DISTANCE_RATIO * rate / speed_max || approach.length() >= tracking_distance
        {
            return None;
        }
        let plane = libm::atan2(velocity.y, velocity.x);
        let rotation = wrap_angle(2.0 * (plane - self.q[3])) / 2.0;
        Some(self.q[3] + rotation)
    }

    /// The joints with joint 4 as near to its target as its speed and acceleration allow, and with
    /// joints 5 and 6 computed for that angle.
    fn lagging_joints(
        &self,
        w: &DMat3,
        target: &Joints,
        hold: Option<f64>,
        dt_s: f64,
    ) -> Result<Joints, FollowError> {
        let acceleration = self.arm.acceleration_max_rad_s2[3];
        let speed_max = self.arm.speed_max_rad_s[3];
        let target4 = hold.unwrap_or(target[3]);
        // The speed of the target. A faster one is a jump of the target and not followed.
        let drift = (target4 - self.joint4_target_rad) / dt_s;
        let drift = if drift.abs() <= speed_max { drift } else { 0.0 };
        let gap = target4 - self.q[3] - drift * dt_s;
        // The largest speed relative to the target from which joint 4 can still stop at it.
        let closing = (2.0 * acceleration * gap.abs()).sqrt().min(gap.abs() / dt_s) * gap.signum();
        let change = acceleration * dt_s;
        let speed = (drift + closing)
            .clamp(-speed_max, speed_max)
            .clamp(self.joint4_speed_rad_s - change, self.joint4_speed_rad_s + change);
        let mut share = 1.0;
        for _ in 0..STEP_HALVINGS_MAX {
            let q = self.joints_with_theta4(w, target, self.q[3] + speed * dt_s * share);
            if (3..6).all(|joint| self.is_within_speed(joint, q[joint], dt_s)) {
                return self.check_wrist_limits(q);
            }
            share *= 0.5;
        }
        let q = self.joints_with_theta4(w, target, self.q[3]);
        let ratio = |joint: usize| {
            (q[joint] - self.q[joint]).abs() / (self.arm.speed_max_rad_s[joint] * dt_s)
        };
        match [4, 5].into_iter().find(|joint| ratio(*joint) > 1.0 + LIMIT_ROUNDING) {
            Some(joint) => Err(FollowError::SpeedLimit { joint, ratio: ratio(joint) }),
            None => self.check_wrist_limits(q),
        }
    }

    /// The joints `target` with joint 4 at `theta4` (rad) and joints 5 and 6 computed for it.
    fn joints_with_theta4(&self, w: &DMat3, target: &Joints, theta4: f64) -> Joints {
        let (theta5, theta6) = theta5_and_theta6(w, theta4);
        let near = |angle: f64, joint: usize| self.q[joint] + wrap_angle(angle - self.q[joint]);
        Joints::new(target[0], target[1], target[2], theta4, near(theta5, 4), near(theta6, 5))
    }

    /// `q`, if joints 4 to 6 lie inside their limits.
    fn check_wrist_limits(&self, q: Joints) -> Result<Joints, FollowError> {
        let (low, high) = (&self.arm.q_min_rad, &self.arm.q_max_rad);
        match (3..6).find(|&joint| q[joint] < low[joint] || q[joint] > high[joint]) {
            Some(joint) => Err(FollowError::JointLimit { joint }),
            None => Ok(q),
        }
    }
}

/// The approach axis at `q` (rad), projected on the plane normal to the forearm.
fn approach_across_forearm(q: &Joints) -> DVec2 {
    let ((s4, c4), s5) = (libm::sincos(q[3]), libm::sin(q[4]));
    DVec2::new(-c4 * s5, -s4 * s5)
}
