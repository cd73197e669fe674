//! Learns and compensates the Coulomb friction of each joint: the friction is measured at the
//! reversals of the joint's own motion, and compensated where the desired motion reverses. No
//! friction is configured: an arm with twice the friction, or with none, is learned as it is.
//!
//! A joint that slides one way, reverses and slides the other way takes a torque that differs by
//! twice its friction. What else it carries (a load, gravity that is not known) is the same before
//! and after, and drops out of the difference. The mean torque of the last tenth of a second before
//! a reversal and that of one soon after it therefore give the friction (Armstrong-Helouvry,
//! Control of Machines with Friction, 1991, does so for whole strokes). Reversals that take long,
//! strokes that were short or slow and differences against the motion are not used, because the
//! load has changed meanwhile.
//!
//! The compensation follows the desired motion like a bristle: it goes from one side to the other
//! over a short travel, so that small oscillations of the desired motion cause little torque. Where
//! reversals follow each other within a tenth of a second the compensation is reduced in proportion
//! to the time between them, because it leads the joint there, and a loop around the servo would
//! oscillate.

use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{Fold, StateHash};

/// Measured travel after which a joint has changed to the other side (rad).
const SIDE_CHANGE_TRAVEL_RAD: f64 = 1e-3;
/// Speed from which a joint slides (rad/s).
const SLIDING_SPEED_MIN_RAD_S: f64 = 0.02;
/// Time constant of the filter of the speed (s).
const SPEED_FILTER_S: f64 = 0.025;
/// The torque is averaged from this time of sliding on (s).
const AVERAGING_DELAY_S: f64 = 0.05;
/// Time over which the torque is averaged (s).
const AVERAGING_TIME_S: f64 = 0.1;
/// Least time of sliding before a reversal (s).
const SLIDING_TIME_MIN_S: f64 = 0.1;
/// Longest time that a reversal may take (s).
const REVERSAL_TIME_MAX_S: f64 = 0.25;
/// The friction is the mean over this many reversals at most; a later one has the weight of one
/// among as many.
const REVERSALS_AVERAGED: u32 = 2;
/// Time constant with which a learned friction is applied (s).
const BLEND_IN_TIME_S: f64 = 0.2;
/// From this time between two reversals on the friction is compensated in full (s).
const FULL_COMPENSATION_INTERVAL_S: f64 = 0.1;

/// One joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct JointFriction {
    /// Positions between the two sides, -1 to 1, of the measured and of the desired motion.
    measured: f64,
    desired: f64,
    speed_rad_s: f64,
    /// The direction in which the joint slid last, for how long (s), the mean torque (N m), and how
    /// long ago that was (s).
    side: f64,
    slid_s: f64,
    mean_nm: f64,
    ago_s: f64,
    /// Mean torque before the last reversal (N m), if that reversal is used.
    before_nm: Option<f64>,
    /// The learned friction (N m), the number of reversals that it is the mean of, and the part of
    /// it that is applied already (N m).
    friction_nm: f64,
    turns: u32,
    blended_nm: f64,
    /// The direction of the desired motion, how long it has lasted (s), and the time between the
    /// last two reversals (s).
    way: f64,
    since_s: f64,
    between_s: f64,
}

impl Fold for JointFriction {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.measured).add(&self.desired).add(&self.speed_rad_s).add(&self.side);
        hash.add(&self.slid_s).add(&self.mean_nm).add(&self.ago_s).add(&self.before_nm);
        hash.add(&self.friction_nm).add(&self.turns).add(&self.blended_nm);
        hash.add(&self.way).add(&self.since_s).add(&self.between_s);
    }
}

impl JointFriction {
    /// Updates the estimate with a motion by `moved_rad` under a torque.
    fn learn(&mut self, moved_rad: f64, torque_nm: f64, most_nm: f64, dt_s: f64) {
        self.measured = bristle_position(self.measured, moved_rad, SIDE_CHANGE_TRAVEL_RAD);
        self.speed_rad_s +=
            (moved_rad / dt_s - self.speed_rad_s) * (dt_s / SPEED_FILTER_S).min(1.0);
        self.ago_s += dt_s;
        let slides = self.speed_rad_s * self.measured >= SLIDING_SPEED_MIN_RAD_S;
        if !slides || self.measured.abs() < 1.0 {
            return;
        }
        if self.measured * self.side <= 0.0 {
            let counts = self.slid_s >= SLIDING_TIME_MIN_S && self.ago_s <= REVERSAL_TIME_MAX_S;
            self.before_nm = counts.then_some(self.mean_nm);
            (self.side, self.slid_s) = (self.measured, 0.0);
        }
        (self.ago_s, self.slid_s) = (0.0, self.slid_s + dt_s);
        let span_s = (self.slid_s - AVERAGING_DELAY_S).clamp(dt_s, AVERAGING_TIME_S);
        let change = (torque_nm - self.mean_nm) * (dt_s / span_s);
        self.mean_nm =
            if self.slid_s <= AVERAGING_DELAY_S { torque_nm } else { self.mean_nm + change };
        if self.slid_s < AVERAGING_DELAY_S + AVERAGING_TIME_S {
            return;
        }
        if let Some(before_nm) = self.before_nm.take() {
            let half_nm = 0.5 * self.side * (self.mean_nm - before_nm);
            if half_nm > 0.0 {
                self.turns = (self.turns + 1).min(REVERSALS_AVERAGED);
                let off_nm = half_nm.min(most_nm) - self.friction_nm;
                self.friction_nm += off_nm / f64::from(self.turns);
            }
        }
    }

    /// Compensation torque (N m) when the desired angle changes by `way_rad`.
    fn compensation_nm(&mut self, way_rad: f64, turn_rad: f64, dt_s: f64) -> f64 {
        self.desired = bristle_position(self.desired, way_rad, turn_rad);
        self.blended_nm += (self.friction_nm - self.blended_nm) * (dt_s / BLEND_IN_TIME_S).min(1.0);
        self.since_s += dt_s;
        if self.way * self.desired <= 0.0 && self.desired != 0.0 {
            // In the middle between the sides the compensation is zero, so the share may change at
            // once without a step of the torque.
            self.between_s =
                if self.way == 0.0 { FULL_COMPENSATION_INTERVAL_S } else { self.since_s };
            (self.way, self.since_s) = (self.desired, 0.0);
        }
        let apart_s = self.between_s.max(self.since_s).min(FULL_COMPENSATION_INTERVAL_S);
        self.blended_nm * self.desired * (apart_s / FULL_COMPENSATION_INTERVAL_S)
    }
}

/// The position of a bristle, -1 to 1, whose two sides are `width_rad` apart, after a further
/// motion by `way_rad`.
fn bristle_position(place: f64, way_rad: f64, width_rad: f64) -> f64 {
    let next = place + 2.0 * way_rad / width_rad;
    if next.is_finite() { next.clamp(-1.0, 1.0) } else { place }
}

/// The friction of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearnedFriction<const N: usize = 6> {
    share: f64,
    turn_rad: f64,
    most_nm: JointVector<N>,
    joints: [JointFriction; N],
    /// Measured and desired angles of the last job (rad).
    desired_rad: Option<JointVector<N>>,
    measured_rad: Option<JointVector<N>>,
}

impl<const N: usize> Fold for LearnedFriction<N> {
    fn fold(&self, hash: &mut StateHash) {
        for joint in &self.joints {
            hash.add(joint);
        }
        for angles in [&self.desired_rad, &self.measured_rad] {
            hash.add(&angles.is_some()).add(angles.unwrap_or_else(JointVector::zeros).as_slice());
        }
    }
}

impl<const N: usize> LearnedFriction<N> {
    /// A learner that has learned nothing yet. It compensates `share` of the friction, and changes
    /// the side over `turn_rad` (rad) of desired motion. The friction of a joint is at most its
    /// `most_nm` (N m).
    #[must_use]
    pub fn new(share: f64, turn_rad: f64, most_nm: JointVector<N>) -> LearnedFriction<N> {
        let joints = [JointFriction::default(); N];
        LearnedFriction { share, turn_rad, most_nm, joints, desired_rad: None, measured_rad: None }
    }

    /// Forgets all.
    pub fn reset(&mut self) {
        *self = LearnedFriction::new(self.share, self.turn_rad, self.most_nm);
    }

    /// The friction learned of each joint (N m).
    #[must_use]
    pub fn friction_nm(&self) -> JointVector<N> {
        JointVector::from(self.joints.map(|joint| joint.friction_nm))
    }

    /// Compensation torque (N m) at desired angles (rad), `dt_s` after the last call.
    pub fn torque_nm(&mut self, desired_rad: &JointVector<N>, dt_s: f64) -> JointVector<N> {
        let last = self.desired_rad.replace(*desired_rad).unwrap_or(*desired_rad);
        if self.share <= 0.0 || dt_s.is_nan() || dt_s <= 0.0 {
            return JointVector::zeros();
        }
        let mut torque = JointVector::zeros();
        for (i, joint) in self.joints.iter_mut().enumerate() {
            torque[i] =
                self.share * joint.compensation_nm(desired_rad[i] - last[i], self.turn_rad, dt_s);
        }
        torque
    }

    /// Learns from measured angles (rad) and the torque (N m) that the servo commands there, which
    /// includes the compensation and excludes gravity.
    pub fn learn(&mut self, measured_rad: &JointVector<N>, torque_nm: &JointVector<N>, dt_s: f64) {
        let last = self.measured_rad.replace(*measured_rad).unwrap_or(*measured_rad);
        let moved = measured_rad - last;
        let finite = moved.iter().chain(torque_nm.iter()).all(|x| x.is_finite());
        if self.share <= 0.0 || dt_s.is_nan() || dt_s <= 0.0 || !finite {
            return;
        }
        for (i, joint) in self.joints.iter_mut().enumerate() {
            joint.learn(moved[i], torque_nm[i], self.most_nm[i], dt_s);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::Joints;

    const DT_S: f64 = 0.0025;

    fn learned() -> LearnedFriction {
        LearnedFriction::new(0.8, 5e-4, Joints::repeat(4.0))
    }

    /// Moves to and fro at 50 mrad/s, `strokes` strokes of 0.5 s, under a friction and a load that
    /// depend on the number of the stroke. Returns the compensation in each job.
    fn slides(
        law: &mut LearnedFriction,
        strokes: u32,
        (friction_nm, load_nm): (f64, impl Fn(u32) -> f64),
    ) -> Vec<f64> {
        let (mut q, mut given) = (0.0, Vec::new());
        for stroke in 0..strokes {
            let way = if stroke % 2 == 0 { 1.0 } else { -1.0 };
            for _ in 0..200 {
                q += 0.05 * way * DT_S;
                given.push(law.torque_nm(&Joints::repeat(q), DT_S)[1]);
                let torque = way * friction_nm + load_nm(stroke);
                law.learn(&Joints::repeat(q), &Joints::repeat(torque), DT_S);
            }
        }
        given
    }

    #[test]
    fn one_turn_tells_the_friction_whatever_the_load_and_it_is_given_along_the_desired_way() {
        for (friction_nm, load_nm) in [(0.0, 1.0), (0.3, -5.0), (1.2, 0.0), (2.4, 5.0)] {
            let mut law = learned();
            slides(&mut law, 1, (friction_nm, |_| load_nm));
            assert_eq!(law.friction_nm(), Joints::zeros(), "one way alone tells nothing");
            let given = slides(&mut law, 3, (friction_nm, |_| load_nm));
            let found = law.friction_nm()[1];
            assert!((found - friction_nm).abs() < 1e-9, "{found} {friction_nm}");
            // At the end of the stroke after the one in which it was learned.
            let due = 0.8 * friction_nm;
            assert!((given[595] - due).abs() <= 0.02 * friction_nm, "{} {due}", given[595]);
        }
    }

    #[test]
    fn the_friction_compensation_reverses_over_the_width_without_a_step() {
        let mut law = learned();
        slides(&mut law, 4, (1.0, |_| 0.0));
        let start = law.torque_nm(&Joints::zeros(), DT_S)[0];
        assert!((start + 0.8).abs() < 0.02, "{start}: the last stroke went down");
        let mut last = start;
        for step in 1..=20 {
            let now = law.torque_nm(&Joints::repeat(5e-5 * f64::from(step)), DT_S)[0];
            assert!(now - last < 0.17 && now >= last, "{last} {now}");
            last = now;
        }
        assert!((last - 0.8).abs() < 0.02, "{last}");
    }

    #[test]
    fn turns_that_follow_each_other_at_once_are_given_less() {
        let most = |period_s: f64| {
            let mut law = learned();
            slides(&mut law, 4, (1.0, |_| 0.0));
            let mut given = Vec::new();
            for job in 0..400 {
                let at_s = f64::from(job) * DT_S;
                let q = 2e-3 * libm::sin(2.0 * core::f64::consts::PI * at_s / period_s);
                given.push(law.torque_nm(&Joints::repeat(q), DT_S)[1]);
            }
            given[200..].iter().fold(0.0_f64, |most, given| most.max(given.abs()))
        };
        // Half a period of 25 Hz is 20 ms, a fifth of the interval for full compensation.
        let fast = most(0.04);
        assert!((fast - 0.8 * 0.2).abs() < 0.03, "{fast}");
        assert!((most(0.1) - 0.8 * 0.5).abs() < 0.05, "{}", most(0.1));
        assert!((most(0.4) - 0.8).abs() < 1e-4, "{}", most(0.4));
    }

    #[test]
    fn a_load_during_motion_is_not_taken_for_friction_beyond_the_bound() {
        let mut law = learned();
        slides(&mut law, 2, (0.5, |stroke| 30.0 * f64::from(stroke)));
        assert_eq!(law.friction_nm(), Joints::zeros(), "against the motion");
        law.reset();
        slides(&mut law, 2, (0.5, |stroke| -30.0 * f64::from(stroke)));
        assert_eq!(law.friction_nm(), Joints::repeat(4.0));
    }

    #[test]
    fn a_long_rest_at_the_turn_and_a_short_stroke_before_it_teach_nothing() {
        let mut law = learned();
        slides(&mut law, 1, (1.0, |_| 0.0));
        let rest = Joints::repeat(0.025);
        for _ in 0..120 {
            law.learn(&rest, &Joints::repeat(3.0), DT_S);
        }
        let back = |law: &mut LearnedFriction, from: f64, jobs: u32, torque: f64| {
            for job in 1..=jobs {
                let q = from + 0.05 * torque.signum() * DT_S * f64::from(job);
                law.learn(&Joints::repeat(q), &Joints::repeat(torque), DT_S);
            }
        };
        back(&mut law, 0.025, 200, -2.0);
        assert_eq!(law.friction_nm(), Joints::zeros(), "0.3 s of rest");
        back(&mut law, 0.0, 30, 1.0);
        assert_eq!(law.friction_nm(), Joints::zeros(), "not yet");
        back(&mut law, 0.00375, 200, -1.0);
        assert_eq!(law.friction_nm(), Joints::zeros(), "75 ms of sliding");
    }

    #[test]
    fn zero_share_zero_time_and_nan_change_nothing() {
        let mut law = LearnedFriction { share: 0.0, ..learned() };
        assert!(slides(&mut law, 4, (1.0, |_| 0.0)).iter().all(|given| *given == 0.0));
        let mut law = learned();
        slides(&mut law, 4, (1.0, |_| 0.0));
        let before = law.friction_nm();
        for dt_s in [0.0, -1.0, f64::NAN] {
            assert_eq!(law.torque_nm(&Joints::zeros(), dt_s), Joints::zeros());
            law.learn(&Joints::repeat(9.0), &Joints::repeat(9.0), dt_s);
        }
        law.learn(&Joints::repeat(f64::NAN), &Joints::repeat(1.0), DT_S);
        law.torque_nm(&Joints::repeat(f64::NAN), DT_S);
        assert_eq!(law.friction_nm(), before);
        assert!(law.torque_nm(&Joints::zeros(), DT_S).iter().all(|x| x.is_finite()));
        law.reset();
        assert_eq!(law, learned());
    }
}
