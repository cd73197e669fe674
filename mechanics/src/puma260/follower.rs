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
use super::inverse::{forearm, last_two};
use crate::arm::{Followed, Lost};
use crate::spatial::{Joints, Pose, rotation_vector, wrap_angle};

/// Rounding that a limit forgives, relative.
const SLACK: f64 = 1e-9;
/// Slower than this the approach axis stands still (rad/s).
const REST_RAD_S: f64 = 1e-6;
/// A path that passes the singularity nearer than this part of (its rate over joint 4's speed) is
/// missed less by holding joint 4 than by chasing it: where both cost the same, by experiment.
const HOLD_SHARE: f64 = 0.5;
/// Halvings of the step of joint 4 when joints 5 or 6 cannot follow it.
const HALVINGS: u32 = 8;

/// Follows a path of tool poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Follower {
    arm: Puma260,
    q: Joints,
    shoulder: i8,
    elbow: i8,
    /// Speed of joint 4 in the last tick (rad/s).
    speed4: f64,
    /// Where joint 4 was to be in the last tick (rad).
    aim4: f64,
    /// The wanted approach axis of the last tick, across the forearm; 0 is the singularity.
    approach: DVec2,
}

impl Follower {
    /// Starts from rest at `q` (rad), whose branch it keeps; speeds and accelerations are those of
    /// `arm`.
    #[must_use]
    pub fn new(arm: &Puma260, q: &Joints) -> Follower {
        let reach = arm.singular_distance(q).shoulder;
        let opening = wrap_angle(q[2] + core::f64::consts::FRAC_PI_2);
        Follower {
            arm: *arm,
            q: *q,
            shoulder: if reach < 0.0 { -1 } else { 1 },
            elbow: if opening < 0.0 { -1 } else { 1 },
            speed4: 0.0,
            aim4: q[3],
            approach: across(q),
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
    /// [`Lost`]; the joints stay as they were.
    pub fn step(&mut self, tool: &Pose, dt_s: f64) -> Result<Followed, Lost> {
        let wrist = self.arm.tool_to_wrist(tool);
        let aim = self.aim(&wrist)?;
        for joint in 0..3 {
            let ratio =
                (aim[joint] - self.q[joint]).abs() / (self.arm.speed_max_rad_s[joint] * dt_s);
            if ratio > 1.0 + SLACK {
                return Err(Lost::TooFast { joint, ratio });
            }
        }
        let w = forearm(libm::sincos(aim[0]), aim[1] + aim[2]).transpose() * wrist.rotation;
        let held = self.held_plane(&w, dt_s);
        self.approach = DVec2::new(w.z_axis.x, w.z_axis.y);
        if held.is_none() && self.wrist_is_able(&aim, dt_s) {
            self.speed4 = (aim[3] - self.q[3]) / dt_s;
            self.aim4 = aim[3];
            self.q = aim;
            return Ok(Followed { q: aim, off_m: 0.0, off_rad: 0.0 });
        }
        let q = self.lagging(&w, &aim, held, dt_s)?;
        self.speed4 = (q[3] - self.q[3]) / dt_s;
        self.aim4 = held.unwrap_or(aim[3]);
        self.q = q;
        let got = self.arm.tool_pose(&q);
        Ok(Followed {
            q,
            off_m: (got.translation - tool.translation).length(),
            off_rad: rotation_vector(&got.rotation, &tool.rotation).length(),
        })
    }

    /// The exact solution nearest to the last joints on this branch of shoulder and elbow.
    fn aim(&self, wrist: &Pose) -> Result<Joints, Lost> {
        let branches = self.arm.inverse(wrist, Some(&self.q));
        let mut best: Option<(Joints, f64)> = None;
        let mut outside = None;
        for branch in &branches {
            if (branch.shoulder, branch.elbow) != (self.shoulder, self.elbow) {
                continue;
            }
            match self.arm.expand(&branch.q, &self.q) {
                Some((q, distance)) if best.is_none_or(|best| distance < best.1) => {
                    best = Some((q, distance));
                }
                Some(_) => {}
                None => outside = outside.or(Some(branch.q)),
            }
        }
        match (best, outside) {
            (Some((q, _)), _) => Ok(q),
            (None, Some(q)) => Err(Lost::Limit { joint: self.first_outside(&q) }),
            (None, None) => Err(Lost::OutOfReach),
        }
    }

    /// The first joint no turn of which lies within the limits.
    fn first_outside(&self, q: &Joints) -> usize {
        let outside = |joint: &usize| {
            let mut only = self.q;
            only[*joint] = q[*joint];
            self.arm.expand(&only, &self.q).is_none()
        };
        (0..6).find(outside).unwrap_or(0)
    }

    /// Whether joints 4 to 6 get to `aim` in one tick.
    fn wrist_is_able(&self, aim: &Joints, dt_s: f64) -> bool {
        let speed4 = (aim[3] - self.q[3]) / dt_s;
        let change = (speed4 - self.speed4).abs();
        change <= self.arm.acceleration_max_rad_s2[3] * dt_s * (1.0 + SLACK)
            && (3..6).all(|joint| self.within_speed(joint, aim[joint], dt_s))
    }

    fn within_speed(&self, joint: usize, angle: f64, dt_s: f64) -> bool {
        let step = (angle - self.q[joint]).abs();
        step <= self.arm.speed_max_rad_s[joint] * dt_s * (1.0 + SLACK)
    }

    /// The angle of joint 4 (rad) whose plane the approach axis moves along, if it is about to pass
    /// the singularity nearer than joint 4 could ever turn with it.
    fn held_plane(&self, w: &DMat3, dt_s: f64) -> Option<f64> {
        let at = DVec2::new(w.z_axis.x, w.z_axis.y);
        let way = (at - self.approach) / dt_s;
        let rate = way.length();
        let (most, acceleration) =
            (self.arm.speed_max_rad_s[3], self.arm.acceleration_max_rad_s2[3]);
        if rate.is_nan() || rate <= REST_RAD_S {
            return None;
        }
        let miss = (at.perp_dot(way) / rate).abs();
        // Beyond this distance the exact angle asks for little speed and acceleration.
        let calm = libm::cbrt(4.0 * rate * rate * miss / acceleration)
            .max((2.0 * rate * miss / most).sqrt());
        if miss >= HOLD_SHARE * rate / most || at.length() >= calm {
            return None;
        }
        let plane = libm::atan2(way.y, way.x);
        let turned = wrap_angle(2.0 * (plane - self.q[3])) / 2.0;
        Some(self.q[3] + turned)
    }

    /// Joint 4 as near to its aim as it gets, joints 5 and 6 solved for it.
    fn lagging(
        &self,
        w: &DMat3,
        aim: &Joints,
        held: Option<f64>,
        dt_s: f64,
    ) -> Result<Joints, Lost> {
        let acceleration = self.arm.acceleration_max_rad_s2[3];
        let most = self.arm.speed_max_rad_s[3];
        let aim4 = held.unwrap_or(aim[3]);
        // The aim moves too, unless it has just jumped or is held.
        let drift = (aim4 - self.aim4) / dt_s;
        let drift = if drift.abs() <= most { drift } else { 0.0 };
        let gap = aim4 - self.q[3] - drift * dt_s;
        // The speed of approach from which it can still settle on its aim.
        let closing = (2.0 * acceleration * gap.abs()).sqrt().min(gap.abs() / dt_s) * gap.signum();
        let change = acceleration * dt_s;
        let speed =
            (drift + closing).clamp(-most, most).clamp(self.speed4 - change, self.speed4 + change);
        let mut share = 1.0;
        for _ in 0..HALVINGS {
            let q = self.with_theta4(w, aim, self.q[3] + speed * dt_s * share);
            if (3..6).all(|joint| self.within_speed(joint, q[joint], dt_s)) {
                return self.inside(q);
            }
            share *= 0.5;
        }
        let q = self.with_theta4(w, aim, self.q[3]);
        let ratio = |joint: usize| {
            (q[joint] - self.q[joint]).abs() / (self.arm.speed_max_rad_s[joint] * dt_s)
        };
        match [4, 5].into_iter().find(|joint| ratio(*joint) > 1.0 + SLACK) {
            Some(joint) => Err(Lost::TooFast { joint, ratio: ratio(joint) }),
            None => self.inside(q),
        }
    }

    fn with_theta4(&self, w: &DMat3, aim: &Joints, theta4: f64) -> Joints {
        let (theta5, theta6) = last_two(w, theta4);
        let near = |angle: f64, joint: usize| self.q[joint] + wrap_angle(angle - self.q[joint]);
        Joints::new(aim[0], aim[1], aim[2], theta4, near(theta5, 4), near(theta6, 5))
    }

    fn inside(&self, q: Joints) -> Result<Joints, Lost> {
        let (low, high) = (&self.arm.q_min_rad, &self.arm.q_max_rad);
        match (3..6).find(|&joint| q[joint] < low[joint] || q[joint] > high[joint]) {
            Some(joint) => Err(Lost::Limit { joint }),
            None => Ok(q),
        }
    }
}

/// The approach axis across the forearm.
fn across(q: &Joints) -> DVec2 {
    let ((s4, c4), s5) = (libm::sincos(q[3]), libm::sin(q[4]));
    DVec2::new(-c4 * s5, -s4 * s5)
}
