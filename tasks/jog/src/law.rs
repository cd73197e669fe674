//! From keys to where the joints are to be: speeds that ramp, angles that stop before their limits,
//! straight lines and turns of the tool as far as the arm can follow. Refuses to run on: without a
//! key every speed ramps to zero, and so it does before what the arm cannot pass (a limit, the edge
//! of its reach, a singularity at that speed): the way that it takes to stop is tried first.

use glam::DVec3;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::follow::{Follower, Lost};
use taktil_mechanics::spatial::rotation_of;
use taktil_mechanics::{Joints, Pose};
use taktil_rtcore::StateHash;
use taktil_signal::JogFrame;

/// Share of each joint's largest speed at which a moving tool may lead it: the heavy ones less.
const LED_SHARE: [f64; 6] = [0.3, 0.3, 0.3, 0.6, 0.6, 0.6];
/// How often, and by how much beyond what is needed, the tool slows down for a joint in one job.
const SLOWER: u32 = 3;
const SLOWER_BY: f64 = 1.02;

/// Speeds and accelerations of jogging.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Of each joint at full push (rad/s).
    pub joints_rad_s: Joints,
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
pub struct Law {
    arm: Puma260,
    rates: Rates,
    /// Where the joints are to be (rad).
    q: Joints,
    /// Speeds of the axes at hand: rad/s of joints, or m/s and rad/s of the tool.
    speed: Joints,
    frame: JogFrame,
    /// Leads the tool while it moves.
    follower: Follower,
    /// Limits apply: the zeros of the joints are known.
    limited: bool,
}

/// What one job of jogging comes to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Joints (rad).
    pub q: Joints,
    /// Their speeds (rad/s).
    pub qd: Joints,
    /// What stands in the way of the tool.
    pub blocked: Option<Lost>,
}

impl Law {
    /// At rest at `q` (rad); without `limited` the angles mean nothing and no limit applies.
    #[must_use]
    pub fn new(arm: &Puma260, rates: &Rates, q: &Joints, limited: bool) -> Law {
        // The tool leads no joint faster than the share at which a hand can guide it.
        let led = arm.speed_max_rad_s.component_mul(&Joints::from(LED_SHARE));
        let arm = &Puma260 { speed_max_rad_s: led, ..*arm };
        Law {
            arm: *arm,
            rates: *rates,
            q: *q,
            speed: Joints::zeros(),
            frame: JogFrame::Joints,
            follower: Follower::new(arm, q),
            limited,
        }
    }

    /// One job of `dt_s` (s). Another frame than that in motion counts once the motion has ended.
    pub fn step(&mut self, push: &Push, dt_s: f64) -> Step {
        let moving = self.speed != Joints::zeros();
        let axes = if moving && push.frame != self.frame { [0.0; 6] } else { push.clean() };
        if !moving {
            self.frame = push.frame;
            self.follower = Follower::new(&self.arm, &self.q);
        }
        match self.frame {
            JogFrame::Joints => {
                self.ramp(&axes, dt_s);
                self.joints(dt_s)
            }
            JogFrame::Base | JogFrame::Tool => {
                let before = self.speed;
                self.ramp(&axes, dt_s);
                if !self.may_go_on(dt_s) {
                    self.speed = before;
                    self.ramp(&[0.0; 6], dt_s);
                }
                self.tool(dt_s)
            }
        }
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
        hash.add(self.q.as_slice()).add(self.speed.as_slice()).word(self.frame as u64);
        hash.add(self.follower.joints().as_slice());
    }

    /// Speeds of the axes at full push.
    fn full(&self) -> Joints {
        let Rates { joints_rad_s, line_m_s: v, turn_rad_s: w, .. } = self.rates;
        match self.frame {
            JogFrame::Joints => joints_rad_s,
            JogFrame::Base | JogFrame::Tool => Joints::new(v, v, v, w, w, w),
        }
    }

    fn joints(&mut self, dt_s: f64) -> Step {
        let full = self.full();
        let before = self.q;
        for joint in 0..6 {
            if self.limited {
                let brake = full[joint] / self.rates.ramp_s;
                let low = (self.q[joint] - self.arm.q_min_rad[joint]).max(0.0);
                let high = (self.arm.q_max_rad[joint] - self.q[joint]).max(0.0);
                let speed = self.speed[joint];
                self.speed[joint] =
                    speed.max(-stoppable(low, brake, dt_s)).min(stoppable(high, brake, dt_s));
            }
            self.q[joint] += self.speed[joint] * dt_s;
        }
        Step { q: self.q, qd: (self.q - before) / dt_s, blocked: None }
    }

    fn tool(&mut self, dt_s: f64) -> Step {
        let before = self.q;
        let stand = |q: Joints, blocked| Step { q, qd: Joints::zeros(), blocked };
        if self.speed == Joints::zeros() {
            return stand(before, None);
        }
        for _ in 0..SLOWER {
            let mut follower = self.follower;
            match follower.step(&self.displaced(dt_s), dt_s) {
                Ok(got) if got.off_rad <= self.rates.off_max_rad => {
                    self.follower = follower;
                    self.q = got.q;
                    return Step { q: self.q, qd: (self.q - before) / dt_s, blocked: None };
                }
                Ok(_) => return self.stand_still(Lost::TooFast { joint: 3, ratio: 1.0 }),
                // Near a singularity the tool slows down and the joint keeps its speed.
                Err(Lost::TooFast { ratio, .. }) => self.speed /= ratio * SLOWER_BY,
                Err(why) => return self.stand_still(why),
            }
        }
        self.stand_still(Lost::TooFast { joint: 2, ratio: SLOWER_BY })
    }

    /// Where the tool is after `span_s` (s) at the present speed.
    fn displaced(&self, span_s: f64) -> Pose {
        let here = self.arm.tool_pose(&self.q);
        let line = DVec3::new(self.speed[0], self.speed[1], self.speed[2]) * span_s;
        let turn = rotation_of(DVec3::new(self.speed[3], self.speed[4], self.speed[5]) * span_s);
        match self.frame {
            JogFrame::Tool => {
                Pose::new(here.rotation * turn, here.translation + here.rotation * line)
            }
            JogFrame::Base | JogFrame::Joints => {
                Pose::new(turn * here.rotation, here.translation + line)
            }
        }
    }

    /// Whether the arm can follow as far as the tool runs on when the keys are let go now.
    fn may_go_on(&self, dt_s: f64) -> bool {
        let share = self.speed.component_div(&self.full()).amax();
        let span_s = dt_s + 0.5 * self.rates.ramp_s * share;
        let mut scout = self.follower;
        scout.step(&self.displaced(span_s), span_s).is_ok()
    }

    /// The tool goes no further this way; the joints stay where they are.
    fn stand_still(&mut self, why: Lost) -> Step {
        self.speed = Joints::zeros();
        Step { q: self.q, qd: Joints::zeros(), blocked: Some(why) }
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
mod tests {
    use super::*;

    const DT_S: f64 = 0.0025;

    fn rates() -> Rates {
        let arm = Puma260::reference();
        Rates {
            joints_rad_s: arm.speed_max_rad_s * 0.1,
            ramp_s: 0.1,
            line_m_s: 0.05,
            turn_rad_s: 0.5,
            off_max_rad: 0.01,
        }
    }

    fn bent() -> Joints {
        Joints::from([10.0, 40.0, -150.0, 20.0, 40.0, 10.0].map(f64::to_radians))
    }

    fn push(axis: usize, by: f64, frame: JogFrame) -> Push {
        let mut axes = [0.0; 6];
        axes[axis] = by;
        Push { axes, frame }
    }

    #[test]
    fn a_joint_ramps_up_runs_and_ramps_down() {
        let mut law = Law::new(&Puma260::reference(), &rates(), &bent(), true);
        let full = rates().joints_rad_s[2];
        let held = push(2, 1.0, JogFrame::Joints);
        let mut last = Joints::zeros();
        for tick in 0..80 {
            let step = law.step(&held, DT_S);
            assert!((step.qd - last).amax() <= full / 0.1 * DT_S * (1.0 + 1e-9), "{tick}");
            last = step.qd;
        }
        assert!((last[2] - full).abs() < 1e-12 && last[0] == 0.0);
        for _ in 0..41 {
            last = law.step(&Push::NONE, DT_S).qd;
        }
        assert_eq!(last, Joints::zeros(), "at rest a tenth of a second after the key");
    }

    #[test]
    fn joints_stop_at_their_limits_and_go_back() {
        let arm = Puma260::reference();
        for (joint, sign) in (0..6).flat_map(|joint| [(joint, 1.0), (joint, -1.0)]) {
            let mut law = Law::new(&arm, &rates(), &bent(), true);
            let held = push(joint, sign, JogFrame::Joints);
            let mut q = bent();
            for _ in 0..20_000 {
                q = law.step(&held, DT_S).q;
                assert!(arm.within_limits(&q), "{joint} {sign}: {q}");
            }
            let limit = if sign > 0.0 { arm.q_max_rad[joint] } else { arm.q_min_rad[joint] };
            assert!((q[joint] - limit).abs() < 1e-3, "{joint} {sign}: {} of {limit}", q[joint]);
            let back = push(joint, -sign, JogFrame::Joints);
            for _ in 0..100 {
                q = law.step(&back, DT_S).q;
            }
            assert!((q[joint] - limit).abs() > 1e-3);
        }
        // Without zeros there are no limits.
        let mut law = Law::new(&arm, &rates(), &arm.q_max_rad, false);
        let q = (0..100).map(|_| law.step(&push(0, 1.0, JogFrame::Joints), DT_S).q).last().unwrap();
        assert!(q[0] > arm.q_max_rad[0]);
    }

    #[test]
    fn the_tool_runs_along_its_own_axes_or_those_of_the_base() {
        let arm = Puma260::reference();
        let here = arm.tool_pose(&bent());
        for frame in [JogFrame::Base, JogFrame::Tool] {
            for axis in 0..3 {
                let mut law = Law::new(&arm, &rates(), &bent(), true);
                let mut q = bent();
                for _ in 0..200 {
                    q = law.step(&push(axis, 1.0, frame), DT_S).q;
                }
                let moved = arm.tool_pose(&q);
                let way = moved.translation - here.translation;
                let mut wanted = [0.0; 3];
                wanted[axis] = 1.0;
                let wanted = DVec3::from_array(wanted);
                let along = if frame == JogFrame::Tool { here.rotation * wanted } else { wanted };
                assert!((way.normalize() - along).length() < 1e-9, "{frame:?} {axis}");
                assert!((way.length() - 0.0226).abs() < 5e-4, "0.5 s at 50 mm/s less the ramp");
                assert!(moved.rotation.abs_diff_eq(here.rotation, 1e-9));
            }
            for axis in 3..6 {
                let mut law = Law::new(&arm, &rates(), &bent(), true);
                let mut q = bent();
                for _ in 0..120 {
                    q = law.step(&push(axis, -1.0, frame), DT_S).q;
                }
                let moved = arm.tool_pose(&q);
                assert!((moved.translation - here.translation).length() < 1e-9, "on the spot");
                assert!(!moved.rotation.abs_diff_eq(here.rotation, 0.05), "{frame:?} {axis}");
            }
        }
    }

    #[test]
    fn the_tool_stands_at_the_edge_of_reach_and_comes_back() {
        let arm = Puma260::reference();
        let mut law = Law::new(&arm, &rates(), &bent(), true);
        let mut q = bent();
        let (mut fastest, mut last) = (0.0f64, Joints::zeros());
        for tick in 0..8000 {
            let step = law.step(&push(0, 1.0, JogFrame::Base), DT_S);
            let share = step.qd.component_div(&arm.speed_max_rad_s).amax();
            assert!(share <= 0.6 + 1e-9 && arm.within_limits(&step.q), "{tick}: {share}");
            // It brakes before the edge; the last of a joint's speed, by the edge itself, goes at
            // once.
            let jump = (step.qd - last).component_div(&arm.speed_max_rad_s).amax();
            assert!(jump < 0.3, "{tick}: a jump of {jump} of the largest speed");
            last = step.qd;
            if step.blocked.is_some() {
                fastest = fastest.max(share);
            }
            q = step.q;
        }
        assert_eq!(fastest, 0.0, "stands still where it is blocked");
        let edge = arm.tool_pose(&q).translation.x;
        assert!(edge > arm.tool_pose(&bent()).translation.x + 0.05, "it went some way");
        let creeping = law.step(&push(0, 1.0, JogFrame::Base), DT_S).qd;
        assert!(creeping.amax() < 0.1, "and stands: {creeping}");
        for _ in 0..200 {
            q = law.step(&push(0, -1.0, JogFrame::Base), DT_S).q;
        }
        assert!(arm.tool_pose(&q).translation.x < edge - 0.01, "it comes back");
    }

    #[test]
    fn a_change_of_frame_waits_for_rest_and_nonsense_is_released() {
        let arm = Puma260::reference();
        let mut law = Law::new(&arm, &rates(), &bent(), true);
        for _ in 0..80 {
            law.step(&push(0, 1.0, JogFrame::Joints), DT_S);
        }
        let other = push(2, 1.0, JogFrame::Tool);
        let mut ticks = 0;
        while law.frame == JogFrame::Joints {
            law.step(&other, DT_S);
            ticks += 1;
        }
        assert!((40..=42).contains(&ticks), "it ramps down first: {ticks}");
        let mut law = Law::new(&arm, &rates(), &bent(), true);
        for bad in [f64::NAN, f64::INFINITY, -1e300] {
            for frame in JogFrame::ALL {
                let step = law.step(&Push { axes: [bad; 6], frame }, DT_S);
                assert!(step.q.iter().chain(step.qd.iter()).all(|x| x.is_finite()));
                let full = law.full();
                assert!(law.speed.iter().zip(full.iter()).all(|(v, full)| v.abs() <= *full));
            }
        }
    }
}
