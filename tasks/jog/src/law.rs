//! From keys to where the joints are to be: speeds that ramp, angles that stop before their limits,
//! straight lines and turns of the tool as far as the arm can follow. Refuses to run on: without a
//! key every speed ramps to zero, and before what the arm cannot pass (a limit, the edge of its
//! reach) its joints are braked within their accelerations, as far ahead as they need.
//! A tool point that would slide along that edge, off the line that is asked for, is braked and
//! stands until another way is asked for; and where its joints, once they are braked, would carry
//! it off that line, as beside a singularity, it is led so slowly that they do not.

use glam::DVec3;
use taktil_mechanics::arm::{Arm, Follow, Lost};
use taktil_mechanics::chain::Vector;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::rotation_of;
use taktil_mechanics::{Joints, Pose};
use taktil_rtcore::StateHash;
use taktil_signal::JogFrame;

/// Share of each joint's largest speed at which a moving tool may lead it: the heavy ones, which
/// are the first, less.
const LED_SHARE: [f64; 2] = [0.3, 0.6];
/// How many joints are heavy.
const HEAVY: usize = 3;
/// How often, and by how much beyond what is needed, the tool slows down for a joint in one job.
const SLOWER: u32 = 8;
const SLOWER_BY: f64 = 1.02;
/// Below this share of its speed the tool stands.
const CREEPING: f64 = 1e-6;
/// How often the speed is mended in one job until the joints' accelerations are those planned.
const REFINED: u32 = 4;
/// Share of each joint's largest acceleration with which it is braked before its edge, so that the
/// other joints, which the same tool moves, stay below theirs.
const BRAKE_SHARE: f64 = 0.4;
/// Share of it that is planned with: the arm's geometry bends within a tick.
const PLANNED_SHARE: f64 = 0.75;

/// Share of its way in one job that the tool point may miss, beside what a tool that is turned
/// misses at the end of its lever (m), and what is rounding (m).
const SLIDE: f64 = 0.02;
const LEVER_M: f64 = 0.5;
const ROUNDING_M: f64 = 1e-8;
/// So far off its line (m) the tool is led no further until other keys are held, and no faster than
/// that it comes to rest within it, and within this share of the way on which it does.
const STRAY_M: f64 = 5e-4;
const STRAY: f64 = 0.02;
/// How much slower, at least, the tool is tried when it would not.
const STRAY_SLOWER: f64 = 1.1;
/// Cosine between two pushes from which on the second is another one.
const SAME_PUSH: f64 = 0.9;

/// Speeds and accelerations of jogging.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates<const N: usize = 6> {
    /// Of each joint at full push (rad/s).
    pub joints_rad_s: Vector<N>,
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
    q: Vector<N>,
    /// Their speeds in the last job (rad/s).
    qd: Vector<N>,
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
    held: Option<Lost>,
    /// Within which the arm has to be able to stand (s): the ramp, and once no key is held what is
    /// left of it.
    rest_s: f64,
}

/// A speed of the tool that the arm can follow.
struct Tried<const N: usize, F> {
    speed: Joints,
    follower: F,
    /// Speeds of the joints (rad/s).
    qd: Vector<N>,
}

/// What one job of jogging comes to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<const N: usize = 6> {
    /// Joints (rad).
    pub q: Vector<N>,
    /// Their speeds (rad/s).
    pub qd: Vector<N>,
    /// What stands in the way of the tool.
    pub blocked: Option<Lost>,
}

impl<const N: usize, A: Arm<N>> Law<N, A> {
    /// At rest at `q` (rad); without `limited` the angles mean nothing and no limit applies.
    #[must_use]
    pub fn new(arm: &A, rates: &Rates<N>, q: &Vector<N>, limited: bool) -> Law<N, A> {
        // The tool leads no joint faster than the share at which a hand can guide it.
        let share = Vector::from_fn(|i, _| LED_SHARE[usize::from(i >= HEAVY)]);
        let arm = arm.with_speed_max(&arm.speed_max().component_mul(&share));
        Law {
            arm,
            rates: *rates,
            q: *q,
            qd: Vector::zeros(),
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
        let moving = self.speed != Joints::zeros() || self.qd != Vector::<N>::zeros();
        let axes = if moving && push.frame != self.frame { [0.0; 6] } else { push.clean() };
        let pushed = axes.iter().any(|axis| *axis != 0.0);
        self.rest_s = if pushed { self.rates.ramp_s } else { (self.rest_s - dt_s).max(0.0) };
        self.asks(&Joints::from(axes), !moving && push.frame != self.frame);
        if !moving {
            self.frame = push.frame;
            self.follower = self.arm.follower(&self.q);
        }
        match self.frame {
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
                    self.held = self.held.or(Some(step.blocked.unwrap_or(Lost::OutOfReach)));
                }
                step
            }
        }
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
        let before = self.q;
        for axis in 0..N.min(6) {
            let joint = self.first() + axis;
            if self.limited {
                let brake = full[axis] / self.rates.ramp_s;
                let low = (self.q[joint] - self.arm.q_min()[joint]).max(0.0);
                let high = (self.arm.q_max()[joint] - self.q[joint]).max(0.0);
                let speed = self.speed[axis];
                self.speed[axis] =
                    speed.max(-stoppable(low, brake, dt_s)).min(stoppable(high, brake, dt_s));
            }
            self.q[joint] += self.speed[axis] * dt_s;
        }
        self.qd = (self.q - before) / dt_s;
        Step { q: self.q, qd: self.qd, blocked: None }
    }

    /// The tool at the speed that the ramp gives, or at the one that it had `before`, faster or
    /// slower by what the joints' accelerations need.
    fn tool(&mut self, before: &Joints, dt_s: f64) -> Step<N> {
        let ramped = self.speed;
        // A push the other way is no reason to go on.
        let along = if *before == Joints::zeros() { 0.0 } else { ramped.dot(before) };
        let share = if along > 0.0 { ramped.norm() / before.norm() } else { 0.0 };
        let mut blocked = None;
        for (speed, wanted) in [(ramped, 1.0), (*before, share)] {
            if speed == Joints::zeros() {
                if self.reachable(&Vector::zeros(), dt_s) {
                    break;
                }
                continue;
            }
            match self.try_to(speed, wanted, dt_s) {
                Ok(Some(step)) => return step,
                Ok(None) => {}
                Err(why) => blocked = blocked.or(Some(why)),
            }
        }
        self.coast(dt_s, blocked)
    }

    /// Where the tool can go on neither way the joints are braked, all by the same share, as fast
    /// as they can be: on the last of the way the tool is not led.
    fn coast(&mut self, dt_s: f64, blocked: Option<Lost>) -> Step<N> {
        let mut left = 0.0f64;
        for joint in 0..N {
            let change = PLANNED_SHARE * self.arm.acceleration_max()[joint] * dt_s;
            left = left.max(1.0 - change / self.qd[joint].abs().max(change));
        }
        self.qd *= left;
        self.speed *= left;
        if left > 0.0 {
            let ahead = self.q + self.qd * dt_s;
            self.q = ahead.sup(self.arm.q_min()).inf(self.arm.q_max());
            self.follower = self.arm.follower(&self.q);
            return Step { q: self.q, qd: self.qd, blocked: None };
        }
        self.speed = Joints::zeros();
        Step { q: self.q, qd: self.qd, blocked }
    }

    /// Moves the tool at `wanted` times `speed`, or as near to it as the joints can be accelerated
    /// and braked before their edges; `Ok(None)` when that takes another direction.
    fn try_to(&mut self, speed: Joints, wanted: f64, dt_s: f64) -> Result<Option<Step<N>>, Lost> {
        let mut scale = 1.0;
        let mut tried = self.able(speed, dt_s)?;
        // The arm's geometry bends: a step scaled is not quite the scaled step.
        for _ in 0..REFINED {
            let Tried { speed: at, qd, .. } = &tried;
            let (least, most) = self.between(qd, dt_s);
            if least > most {
                return Ok(None);
            }
            let unhurried = 1.0 / self.haste(&(self.q + qd * dt_s), dt_s);
            let by = (wanted / scale).min(unhurried).max(least).min(most);
            if (by - 1.0).abs() < 1e-3 {
                break;
            }
            scale *= by;
            tried = self.able(at * by, dt_s)?;
            if scale < CREEPING {
                break;
            }
        }
        if !self.reachable(&tried.qd, dt_s) {
            // No scale was found at which the joints can follow.
            return Ok(None);
        }
        (self.speed, self.follower, self.qd) = (tried.speed, tried.follower, tried.qd);
        self.q = *self.follower.joints();
        Ok(Some(Step { q: self.q, qd: self.qd, blocked: None }))
    }

    /// Near a singularity the tool slows down and the joint keeps its speed: the fastest at which
    /// the arm can follow, and the joints' speeds then.
    fn able(&self, mut speed: Joints, dt_s: f64) -> Result<Tried<N, A::Follower>, Lost> {
        let mut why = Lost::TooFast { joint: 2, ratio: SLOWER_BY };
        for attempt in 0..SLOWER {
            match self.trial(&speed, dt_s) {
                Ok((follower, q)) => return Ok(Tried { speed, follower, qd: (q - self.q) / dt_s }),
                Err(lost @ Lost::TooFast { ratio, .. }) => {
                    why = lost;
                    // At the edge of the reach joints go as the root of the tool's way, and a
                    // fraction is tried before it is given up.
                    let late = attempt >= SLOWER / 2;
                    let by = if late { (ratio * ratio).max(1.4) } else { ratio };
                    speed /= by * SLOWER_BY;
                }
                Err(lost) => {
                    why = lost;
                    speed *= 0.5;
                }
            }
        }
        Err(why)
    }

    /// Where the joints are led in one job at this speed of the tool.
    fn trial(&self, speed: &Joints, dt_s: f64) -> Result<(A::Follower, Vector<N>), Lost> {
        let mut follower = self.follower;
        let got = follower.step(&self.displaced(speed, dt_s), dt_s)?;
        // The tool point is off by its lever where the tool is turned; by more, it slides along the
        // edge of the reach.
        let way_m = DVec3::new(speed[0], speed[1], speed[2]).length() * dt_s;
        if got.off_m > SLIDE * way_m + LEVER_M * got.off_rad + ROUNDING_M {
            return Err(Lost::OutOfReach);
        }
        if got.off_rad > self.rates.off_max_rad {
            return Err(Lost::TooFast { joint: 3, ratio: 1.0 });
        }
        match self.strays(speed, &got.q, dt_s) {
            Some((joint, ratio)) => Err(Lost::TooFast { joint, ratio }),
            None => Ok((follower, got.q)),
        }
    }

    /// The joint that is slowest to brake and how much slower the tool has to be, if it, led to `q`
    /// (rad) in one job and left to the brakes there ([`Law::coast`]), would come to rest off its
    /// line or too late.
    fn strays(&self, speed: &Joints, q: &Vector<N>, dt_s: f64) -> Option<(usize, f64)> {
        let qd = (q - self.q) / dt_s;
        let (mut slowest, mut jobs) = (0, 0.0);
        for joint in 0..N {
            let needed =
                qd[joint].abs() / (PLANNED_SHARE * self.arm.acceleration_max()[joint] * dt_s);
            if needed > jobs {
                (slowest, jobs) = (joint, needed);
            }
        }
        // However it is led, the arm can be at rest as soon as hands may expect.
        if jobs * dt_s > self.rest_s {
            return Some((slowest, jobs * dt_s / self.rest_s.max(dt_s)));
        }
        // All joints lose the same share, a job after another: 1 - 1/jobs, 1 - 2/jobs ...
        let whole = jobs.floor();
        let more = if whole > 0.0 { whole - 0.5 * whole * (whole + 1.0) / jobs } else { 0.0 };
        let rest = (q + qd * (dt_s * more)).sup(self.arm.q_min()).inf(self.arm.q_max());
        let here = self.arm.tool_pose(&self.q);
        let along = self.point_speed(speed, &here).normalize_or_zero();
        let moved = self.arm.tool_pose(&rest).translation - here.translation;
        let stray = self.stray_m + moved - moved.dot(along) * along;
        let bound = STRAY_M + STRAY * moved.length();
        let strays = stray.length() > bound && stray.length() > self.stray_m.length();
        // The way to rest goes as the square of the speed.
        strays.then(|| (slowest, (stray.length() / bound).sqrt().max(STRAY_SLOWER)))
    }

    /// Between which multiples of the speeds `qd` (rad/s) every joint's acceleration is one that it
    /// has; the first is larger than the second when there is none.
    fn between(&self, qd: &Vector<N>, dt_s: f64) -> (f64, f64) {
        let (mut least, mut most) = (0.0f64, f64::INFINITY);
        for joint in 0..N {
            let change = PLANNED_SHARE * self.arm.acceleration_max()[joint] * dt_s;
            let (low, high) = (self.qd[joint] - change, self.qd[joint] + change);
            let speed = qd[joint];
            if speed != 0.0 {
                least = least.max((low / speed).min(high / speed));
                most = most.min((low / speed).max(high / speed));
            } else if low > 0.0 || high < 0.0 {
                return (1.0, 0.0);
            }
        }
        (least, most)
    }

    /// Whether the joints can have the speeds `qd` (rad/s) in one job.
    fn reachable(&self, qd: &Vector<N>, dt_s: f64) -> bool {
        let change = self.arm.acceleration_max() * dt_s;
        (0..N).all(|joint| (qd[joint] - self.qd[joint]).abs() <= change[joint])
    }

    /// The speed of the joint that is hastiest towards its edge over the one from which it can be
    /// braked before it, when they go to `q` (rad) in `dt_s` (s).
    fn haste(&self, q: &Vector<N>, dt_s: f64) -> f64 {
        let mut most = f64::MIN_POSITIVE;
        for joint in 0..N {
            let way = (q[joint] - self.q[joint]).abs();
            let brake = BRAKE_SHARE * self.arm.acceleration_max()[joint];
            let allowed = stoppable(self.arm.room(joint, &self.q, q), brake, dt_s) * dt_s;
            most = most.max(way / allowed.max(f64::MIN_POSITIVE));
        }
        most
    }

    /// Where the tool is after `span_s` (s) at `speed` (m/s, rad/s).
    fn displaced(&self, speed: &Joints, span_s: f64) -> Pose {
        let here = self.arm.tool_pose(&self.q);
        let line = DVec3::new(speed[0], speed[1], speed[2]) * span_s;
        let turn = rotation_of(DVec3::new(speed[3], speed[4], speed[5]) * span_s);
        match self.frame {
            JogFrame::Tool => {
                Pose::new(here.rotation * turn, here.translation + here.rotation * line)
            }
            JogFrame::Base | JogFrame::Joints | JogFrame::Outer => {
                Pose::new(turn * here.rotation, here.translation + line)
            }
        }
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
