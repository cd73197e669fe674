//! From keys to where the joints are to be: speeds that ramp, angles that stop before their limits,
//! straight lines and turns of the tool as far as the arm can follow. Refuses to run on: without a
//! key every speed ramps to zero, and before what the arm cannot pass (a limit, the edge of its
//! reach) its joints are braked within their accelerations, as far ahead as they need.
//! A tool point that would slide along that edge, off the line that is asked for, is braked and
//! stands until another way is asked for; and where its joints, once they are braked, would carry
//! it off that line, as beside a singularity, it is led so slowly that they do not. What stands in
//! the way of a push is told with every step.

mod lead;

use glam::DVec3;
use taktil_mechanics::arm::{Arm, FollowError, PathFollower};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::{Joints, Pose};
use taktil_rtcore::StateHash;
use taktil_signal::{JogFrame, JogWhy};

/// Share of each joint's largest speed at which a moving tool may lead it: the heavy ones, which
/// are the first, less.
const LED_SHARE: [f64; 2] = [0.3, 0.6];
/// How many joints are heavy.
const HEAVY: usize = 3;
/// So far off its line (m) the tool is led no further until other keys are held.
const STRAY_M: f64 = 5e-4;
/// Cosine between two pushes from which on the second is another one.
const SAME_PUSH: f64 = 0.9;

/// Speeds and accelerations of jogging.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates<const N: usize = 6> {
    /// Of each joint at full push (rad/s).
    pub joints_rad_s: JointVector<N>,
    /// Time in which an axis ramps from rest to full speed (s).
    pub ramp_s: f64,
    /// Of the tool point at full push (m/s).
    pub line_m_s: f64,
    /// Of turning the tool at full push (rad/s).
    pub turn_rad_s: f64,
    /// How far the tool may be off its line past a wrist singularity (rad).
    pub off_max_rad: f64,
}

/// What the operator's hands ask for in one job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push {
    /// -1 to 1 each; what is outside or NaN counts as its bound or as released.
    pub axes: [f64; 6],
    /// What the axes are.
    pub frame: JogFrame,
}

impl Push {
    /// No key held.
    pub const NONE: Push = Push { axes: [0.0; 6], frame: JogFrame::Joints };

    fn clean(&self) -> [f64; 6] {
        // `max` and `min` leave the bound for a NaN, which is then taken for released.
        self.axes.map(|axis| if axis.is_nan() { 0.0 } else { axis.clamp(-1.0, 1.0) })
    }
}

/// Motion under way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law<const N: usize = 6, A: Arm<N> = Puma260> {
    arm: A,
    rates: Rates<N>,
    /// Where the joints are to be (rad).
    q: JointVector<N>,
    /// Their speeds in the last job (rad/s).
    qd: JointVector<N>,
    /// Speeds of the axes at hand: rad/s of joints, or m/s and rad/s of the tool.
    speed: Joints,
    frame: JogFrame,
    /// Leads the tool while it moves.
    follower: A::Follower,
    /// Limits apply: the zeros of the joints are known.
    limited: bool,
    /// The push that the tool follows.
    asked: Joints,
    /// How far the tool point has gone off the way of that push (m, base frame).
    stray_m: DVec3,
    /// Why the tool stands until another push.
    held: Option<Obstacle>,
    /// Within which the arm has to be able to stand (s): the ramp, and once no key is held what is
    /// left of it.
    rest_s: f64,
}

/// What one job of jogging comes to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<const N: usize = 6> {
    /// Joints (rad).
    pub q: JointVector<N>,
    /// Their speeds (rad/s).
    pub qd: JointVector<N>,
    /// Why the arm stands, or is slower than it is pushed.
    pub obstacle: Option<Obstacle>,
    /// How often the arm was asked for joints.
    pub tries: u32,
}

/// What stands in the way of a push.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Obstacle {
    /// The kind.
    pub why: JogWhy,
    /// The joint at fault, 0 the first.
    pub joint: Option<usize>,
}

impl From<FollowError> for Obstacle {
    fn from(lost: FollowError) -> Obstacle {
        match lost {
            FollowError::JointLimit { joint } => {
                Obstacle { why: JogWhy::Limit, joint: Some(joint) }
            }
            FollowError::SpeedLimit { joint, .. } => {
                Obstacle { why: JogWhy::Singular, joint: Some(joint) }
            }
            _ => Obstacle { why: JogWhy::Reach, joint: None },
        }
    }
}

impl<const N: usize, A: Arm<N>> Law<N, A> {
    /// At rest at `q` (rad); without `limited` the angles mean nothing and no limit applies.
    #[must_use]
    pub fn new(arm: &A, rates: &Rates<N>, q: &JointVector<N>, limited: bool) -> Law<N, A> {
        // The tool leads no joint faster than the share at which a hand can guide it.
        let share = JointVector::from_fn(|i, _| LED_SHARE[usize::from(i >= HEAVY)]);
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
            asked: Joints::zeros(),
            stray_m: DVec3::ZERO,
            held: None,
            rest_s: rates.ramp_s,
        }
    }

    /// One job of `dt_s` (s). Another frame than that in motion counts once the motion has ended.
    pub fn step(&mut self, push: &Push, dt_s: f64) -> Step<N> {
        // Joints may be braked still when the axes are at rest.
        let moving = self.speed != Joints::zeros() || self.qd != JointVector::<N>::zeros();
        let axes = if moving && push.frame != self.frame { [0.0; 6] } else { push.clean() };
        let pushed = axes.iter().any(|axis| *axis != 0.0);
        self.rest_s = if pushed { self.rates.ramp_s } else { (self.rest_s - dt_s).max(0.0) };
        self.asks(&Joints::from(axes), !moving && push.frame != self.frame);
        if !moving {
            self.frame = push.frame;
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
                let step = match self.held {
                    Some(why) => self.coast(dt_s, Some(why)),
                    None => self.tool(&before, dt_s),
                };
                let moved = self.arm.tool_pose(&self.q).translation - here.translation;
                self.stray_m += moved - moved.dot(along) * along;
                if self.stray_m.length() > STRAY_M {
                    let off = Obstacle { why: JogWhy::Line, joint: None };
                    self.held = self.held.or(step.obstacle).or(Some(off));
                }
                step
            }
        };
        step.obstacle = step.obstacle.filter(|_| pushed);
        step
    }

    /// Begins another way of the tool when the push is `other` or points elsewhere than before.
    fn asks(&mut self, push: &Joints, other: bool) {
        let (cosine, lengths) = (push.dot(&self.asked), push.norm() * self.asked.norm());
        if other || lengths == 0.0 || cosine < SAME_PUSH * lengths {
            (self.asked, self.stray_m, self.held) = (*push, DVec3::ZERO, None);
        }
    }

    /// Velocity of the tool point at these speeds of the axes (m/s, base frame).
    fn point_speed(&self, speed: &Joints, here: &Pose) -> DVec3 {
        let line = DVec3::new(speed[0], speed[1], speed[2]);
        if self.frame == JogFrame::Tool { here.rotation * line } else { line }
    }

    /// Lets every axis change its speed towards its push as fast as the ramp allows.
    fn ramp(&mut self, axes: &[f64; 6], dt_s: f64) {
        let full = self.full();
        for (axis, push) in axes.iter().enumerate() {
            let change = full[axis] / self.rates.ramp_s * dt_s;
            let (old, wanted) = (self.speed[axis], push * full[axis]);
            self.speed[axis] = wanted.max(old - change).min(old + change);
        }
    }

    /// Folds what the next job depends on.
    pub fn fold(&self, hash: &mut StateHash) {
        hash.add(self.q.as_slice()).add(self.qd.as_slice()).add(self.speed.as_slice());
        hash.word(self.frame as u64);
        hash.add(self.follower.joints().as_slice());
        hash.add(self.asked.as_slice())
            .add(&self.stray_m.to_array())
            .word(self.held.is_some().into())
            .add(&self.rest_s);
    }

    /// Speeds of the axes at full push.
    fn full(&self) -> Joints {
        let Rates { joints_rad_s, line_m_s: v, turn_rad_s: w, .. } = self.rates;
        match self.frame {
            // The axes of a hand are six: the other joints stand.
            JogFrame::Joints | JogFrame::Outer => {
                let first = self.first();
                Joints::from_fn(|i, _| joints_rad_s.get(first + i).copied().unwrap_or(0.0))
            }
            JogFrame::Base | JogFrame::Tool => Joints::new(v, v, v, w, w, w),
        }
    }

    /// The joint that the first axis pushes.
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
                    obstacle = Some(Obstacle { why: JogWhy::Limit, joint: Some(joint) });
                }
            }
            self.q[joint] += self.speed[axis] * dt_s;
        }
        self.qd = (self.q - before) / dt_s;
        Step { q: self.q, qd: self.qd, obstacle, tries: 0 }
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
