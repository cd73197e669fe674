//! The law of jogging converts keys to desired joints: speeds ramp up and down, joints stop before
//! their limits, and the tool moves along straight lines and rotates as far as the arm can follow.
//! Without a key every speed ramps to zero. Before an obstacle (a limit, the edge of the arm's
//! reach) the joints are braked within their accelerations, as early as they need.
//!
//! A tool point that would slide along the edge of the reach, off the commanded line, is braked and
//! stands until another direction is commanded. Beside a singularity the joints, once they are
//! braked, could carry the tool point off that line; there the tool moves so slowly that they do
//! not. Every step reports the obstacle that limits the motion.

mod tool_motion;

use glam::DVec3;
use taktil_mechanics::arm::{Arm, FollowError, PathFollower};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::{Joints, Pose};
use taktil_rtcore::StateHash;
use taktil_signal::{JogFrame, JogObstacle};

/// Share of each joint's largest speed that a motion of the tool may use: the first value holds for
/// the heavy joints at the base, the second for the others.
const TOOL_MOTION_SPEED_SHARES: [f64; 2] = [0.3, 0.6];
/// Number of joints, counted from the base, that are heavy.
const HEAVY_JOINTS: usize = 3;
/// Deviation of the tool point from its line (m) beyond which it stops until the operator holds
/// other keys.
const DEVIATION_MAX_M: f64 = 5e-4;
/// Two commands whose directions have a smaller cosine than this count as different commands.
const SAME_DEMAND_COSINE_MIN: f64 = 0.9;

/// Speeds and accelerations of jogging.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates<const N: usize = 6> {
    /// Speed of each joint at full command (rad/s).
    pub joints_rad_s: JointVector<N>,
    /// Time in which an axis ramps from rest to full speed (s).
    pub ramp_s: f64,
    /// Speed of the tool point at full command (m/s).
    pub line_m_s: f64,
    /// Angular speed of the tool at full command (rad/s).
    pub turn_rad_s: f64,
    /// Largest error of the tool's orientation past a wrist singularity (rad).
    pub off_max_rad: f64,
}

/// What the operator's keys command in one job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JogDemand {
    /// Command of each axis, -1 to 1. A value outside counts as the bound, NaN as released.
    pub axes: [f64; 6],
    /// What the axes are.
    pub frame: JogFrame,
}

impl JogDemand {
    /// No key held.
    pub const ZERO: JogDemand = JogDemand { axes: [0.0; 6], frame: JogFrame::Joints };

    fn clamped(&self) -> [f64; 6] {
        // `max` and `min` leave the bound for a NaN, which is then taken for released.
        self.axes.map(|axis| if axis.is_nan() { 0.0 } else { axis.clamp(-1.0, 1.0) })
    }
}

/// The state of the motion, with the speeds and accelerations that bound it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law<const N: usize = 6, A: Arm<N> = Puma260> {
    arm: A,
    rates: Rates<N>,
    /// Desired joints (rad).
    q: JointVector<N>,
    /// Their speeds in the last job (rad/s).
    qd: JointVector<N>,
    /// Speeds of the axes at hand: rad/s of joints, or m/s and rad/s of the tool.
    speed: Joints,
    frame: JogFrame,
    /// Follows the path of the tool while it moves.
    follower: A::Follower,
    /// Limits apply: the zeros of the joints are known.
    limited: bool,
    /// The command that the tool follows.
    followed_demand: Joints,
    /// Deviation of the tool point from the line of that command (m, base frame).
    deviation_m: DVec3,
    /// The obstacle for which the tool stands until another command comes.
    blocked_by: Option<Obstacle>,
    /// Time within which the arm has to be able to stop (s): the time of the ramp and, once no key
    /// is held, the rest of it.
    rest_s: f64,
}

/// Result of one job of jogging.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<const N: usize = 6> {
    /// Joints (rad).
    pub q: JointVector<N>,
    /// Their speeds (rad/s).
    pub qd: JointVector<N>,
    /// The obstacle for which the arm stands or moves more slowly than commanded.
    pub obstacle: Option<Obstacle>,
    /// Number of inverse kinematics that were solved.
    pub trials: u32,
}

/// The obstacle that keeps the arm from following a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Obstacle {
    /// The kind.
    pub kind: JogObstacle,
    /// The joint at fault, 0 the first.
    pub joint: Option<usize>,
}

impl From<FollowError> for Obstacle {
    fn from(lost: FollowError) -> Obstacle {
        match lost {
            FollowError::JointLimit { joint } => {
                Obstacle { kind: JogObstacle::Limit, joint: Some(joint) }
            }
            FollowError::SpeedLimit { joint, .. } => {
                Obstacle { kind: JogObstacle::Singular, joint: Some(joint) }
            }
            _ => Obstacle { kind: JogObstacle::Reach, joint: None },
        }
    }
}

impl<const N: usize, A: Arm<N>> Law<N, A> {
    /// At rest at `q` (rad); without `limited` the angles mean nothing and no limit applies.
    #[must_use]
    pub fn new(arm: &A, rates: &Rates<N>, q: &JointVector<N>, limited: bool) -> Law<N, A> {
        // A motion of the tool uses at most this share of each joint's largest speed.
        let share =
            JointVector::from_fn(|i, _| TOOL_MOTION_SPEED_SHARES[usize::from(i >= HEAVY_JOINTS)]);
        let arm = arm.with_speed_max(&arm.speed_max().component_mul(&share));
        Law {
            arm,
            rates: *rates,
            q: *q,
            qd: JointVector::zeros(),
            speed: Joints::zeros(),
            frame: JogFrame::Joints,
            follower: arm.follower(q),
            limited,
            followed_demand: Joints::zeros(),
            deviation_m: DVec3::ZERO,
            blocked_by: None,
            rest_s: rates.ramp_s,
        }
    }

    /// One job of `dt_s` (s). A command in another frame counts as soon as the present motion has
    /// ended.
    pub fn step(&mut self, demand: &JogDemand, dt_s: f64) -> Step<N> {
        // The joints may still be braking when the commanded axes are at rest.
        let moving = self.speed != Joints::zeros() || self.qd != JointVector::<N>::zeros();
        let axes = if moving && demand.frame != self.frame { [0.0; 6] } else { demand.clamped() };
        let pushed = axes.iter().any(|axis| *axis != 0.0);
        self.rest_s = if pushed { self.rates.ramp_s } else { (self.rest_s - dt_s).max(0.0) };
        self.follow_demand(&Joints::from(axes), !moving && demand.frame != self.frame);
        if !moving {
            self.frame = demand.frame;
            self.follower = self.arm.follower(&self.q);
        }
        let mut step = match self.frame {
            JogFrame::Joints | JogFrame::Outer => {
                self.ramp(&axes, dt_s);
                self.joints(dt_s)
            }
            JogFrame::Base | JogFrame::Tool => {
                let (before, here) = (self.speed, self.arm.tool_pose(&self.q));
                self.ramp(&axes, dt_s);
                let along = self.point_speed(&self.speed, &here).normalize_or_zero();
                let step = match self.blocked_by {
                    Some(why) => self.coast(dt_s, Some(why)),
                    None => self.tool(&before, dt_s),
                };
                let moved = self.arm.tool_pose(&self.q).translation - here.translation;
                self.deviation_m += moved - moved.dot(along) * along;
                if self.deviation_m.length() > DEVIATION_MAX_M {
                    let off = Obstacle { kind: JogObstacle::Line, joint: None };
                    self.blocked_by = self.blocked_by.or(step.obstacle).or(Some(off));
                }
                step
            }
        };
        step.obstacle = step.obstacle.filter(|_| pushed);
        step
    }

    /// Begins a new line of the tool when the command is `other` or has another direction than
    /// before.
    fn follow_demand(&mut self, demand: &Joints, other: bool) {
        let (cosine, lengths) =
            (demand.dot(&self.followed_demand), demand.norm() * self.followed_demand.norm());
        if other || lengths == 0.0 || cosine < SAME_DEMAND_COSINE_MIN * lengths {
            (self.followed_demand, self.deviation_m, self.blocked_by) =
                (*demand, DVec3::ZERO, None);
        }
    }

    /// Velocity of the tool point at these speeds of the axes (m/s, base frame).
    fn point_speed(&self, speed: &Joints, here: &Pose) -> DVec3 {
        let line = DVec3::new(speed[0], speed[1], speed[2]);
        if self.frame == JogFrame::Tool { here.rotation * line } else { line }
    }

    /// Changes the speed of every axis towards its command as fast as the ramp allows.
    fn ramp(&mut self, axes: &[f64; 6], dt_s: f64) {
        let full = self.full();
        for (axis, demand) in axes.iter().enumerate() {
            let change = full[axis] / self.rates.ramp_s * dt_s;
            let (old, wanted) = (self.speed[axis], demand * full[axis]);
            self.speed[axis] = wanted.max(old - change).min(old + change);
        }
    }

    /// Folds what the next job depends on.
    pub fn fold(&self, hash: &mut StateHash) {
        hash.add(self.q.as_slice()).add(self.qd.as_slice()).add(self.speed.as_slice());
        hash.word(self.frame as u64);
        hash.add(self.follower.joints().as_slice());
        hash.add(self.followed_demand.as_slice())
            .add(&self.deviation_m.to_array())
            .word(self.blocked_by.is_some().into())
            .add(&self.rest_s);
    }

    /// Speeds of the axes at full command.
    fn full(&self) -> Joints {
        let Rates { joints_rad_s, line_m_s: v, turn_rad_s: w, .. } = self.rates;
        match self.frame {
            // There are six axes for commands, so the other joints stand still.
            JogFrame::Joints | JogFrame::Outer => {
                let first = self.first();
                Joints::from_fn(|i, _| joints_rad_s.get(first + i).copied().unwrap_or(0.0))
            }
            JogFrame::Base | JogFrame::Tool => Joints::new(v, v, v, w, w, w),
        }
    }

    /// Index of the joint that the first axis commands.
    fn first(&self) -> usize {
        if self.frame == JogFrame::Outer { N.saturating_sub(6) } else { 0 }
    }

    fn joints(&mut self, dt_s: f64) -> Step<N> {
        let full = self.full();
        let (before, mut obstacle) = (self.q, None);
        for axis in 0..N.min(6) {
            let joint = self.first() + axis;
            if self.limited {
                let brake = full[axis] / self.rates.ramp_s;
                let low = (self.q[joint] - self.arm.q_min()[joint]).max(0.0);
                let high = (self.arm.q_max()[joint] - self.q[joint]).max(0.0);
                let speed = self.speed[axis];
                self.speed[axis] =
                    speed.max(-stoppable(low, brake, dt_s)).min(stoppable(high, brake, dt_s));
                if self.speed[axis] != speed {
                    obstacle = Some(Obstacle { kind: JogObstacle::Limit, joint: Some(joint) });
                }
            }
            self.q[joint] += self.speed[axis] * dt_s;
        }
        self.qd = (self.q - before) / dt_s;
        Step { q: self.q, qd: self.qd, obstacle, trials: 0 }
    }
}

/// The largest speed from which a joint still stops within `room` (rad) at `brake` (rad/s^2) when
/// its speed changes once in `dt_s` (s).
fn stoppable(room: f64, brake: f64, dt_s: f64) -> f64 {
    // v dt + v^2 / (2 brake) = room, solved for v.
    let half = brake * dt_s;
    let speed = (half * half + 2.0 * brake * room).sqrt() - half;
    speed.min(room / dt_s).max(0.0)
}

#[cfg(test)]
mod tests;
