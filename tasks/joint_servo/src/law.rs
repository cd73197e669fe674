//! The PD law of one arm, torque from the error between desired and measured angle and from the
//! filtered rate of that error, and the feed-forward of the desired motion. Torque limits belong to
//! `actuate`.
//!
//! The rate is taken of the *error*, not of the measured angle: with a smooth set point the law
//! then follows a ramp without lag. One encoder count per tick is 0.036 to 0.1 rad/s at 400 Hz, so
//! the rate goes through a first-order low-pass first (backward Euler: `r += a ((e - e_last)/dt -
//! r)` with `a = w dt/(1 + w dt)`, stable for every dt).

use taktil_mechanics::arm::ArmDynamics;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{Fold, StateHash};

use crate::notch::Notch;
use crate::observer::Observer;

/// Gains of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains<const N: usize = 6> {
    /// Torque per angle (N m/rad).
    pub kp_nm_rad: JointVector<N>,
    /// Torque per rate (N m s/rad).
    pub kd_nms_rad: JointVector<N>,
}

impl<const N: usize> Gains<N> {
    /// Gains that give a free joint of inertia `inertia_kg_m2` the characteristic polynomial
    /// `s^2 + 2 damping w s + w^2`: `kp = I w^2`, `kd = 2 damping w I`.
    #[must_use]
    pub fn from_bandwidth(
        inertia_kg_m2: &JointVector<N>,
        bandwidth_rad_s: &JointVector<N>,
        damping: &JointVector<N>,
    ) -> Gains<N> {
        let kd_over_damping = 2.0 * inertia_kg_m2.component_mul(bandwidth_rad_s);
        Gains {
            kp_nm_rad: inertia_kg_m2.component_mul(&bandwidth_rad_s.component_mul(bandwidth_rad_s)),
            kd_nms_rad: kd_over_damping.component_mul(damping),
        }
    }
}

/// Torque that the desired motion needs according to the model, without any error: friction,
/// inertia and Coriolis torques. Gravity is separate, because it is compensated at rest too.
#[derive(Clone, Debug)]
pub struct FeedForward<const N: usize = 6, L = Dynamics> {
    /// Share of the friction that is added.
    pub friction_share: f64,
    /// Speed at which half of Coulomb's friction is added (rad/s).
    pub friction_speed_rad_s: f64,
    /// Share of inertia and Coriolis that is added.
    pub acceleration_share: f64,
    /// The arm's friction.
    pub friction: Friction<N>,
    /// The arm's links and motors.
    pub dynamics: L,
    /// Speed desired in the last job (rad/s).
    last_rad_s: Option<JointVector<N>>,
}

impl<const N: usize, L> Fold for FeedForward<N, L> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.last_rad_s.is_some());
        hash.add(self.last_rad_s.unwrap_or_else(JointVector::zeros).as_slice());
    }
}

impl<const N: usize, L: ArmDynamics<N>> FeedForward<N, L> {
    /// The feed-forward of an arm with this friction and these links; nothing was desired before.
    #[must_use]
    pub fn new(
        friction: Friction<N>,
        dynamics: L,
        friction_share: f64,
        friction_speed_rad_s: f64,
        acceleration_share: f64,
    ) -> FeedForward<N, L> {
        FeedForward {
            friction_share,
            friction_speed_rad_s,
            acceleration_share,
            friction,
            dynamics,
            last_rad_s: None,
        }
    }

    /// Forgets the past: the next acceleration is 0.
    pub fn reset(&mut self) {
        self.last_rad_s = None;
    }

    /// The speed desired in the last job (rad/s).
    #[must_use]
    pub fn last_rad_s(&self) -> Option<&JointVector<N>> {
        self.last_rad_s.as_ref()
    }

    /// Torque (N m) for desired angles (rad) and speeds (rad/s), `dt_s` after the last call.
    /// Coulomb's part is `share coulomb qd / (|qd| + half)`: it is smooth at low speeds, where the
    /// direction is uncertain, and tends to the full friction at high speeds.
    pub fn torque_nm(
        &mut self,
        q: &JointVector<N>,
        qd: &JointVector<N>,
        dt_s: f64,
    ) -> JointVector<N> {
        let mut torque = JointVector::zeros();
        if self.friction_share > 0.0 {
            let Friction { coulomb_nm, viscous_nms_rad } = &self.friction;
            let direction = qd.map(|v| v / (v.abs() + self.friction_speed_rad_s));
            torque += (viscous_nms_rad.component_mul(qd) + coulomb_nm.component_mul(&direction))
                * self.friction_share;
        }
        if self.acceleration_share > 0.0 {
            let last = self.last_rad_s.unwrap_or(*qd);
            let qdd = if dt_s > 0.0 { (qd - last) / dt_s } else { JointVector::zeros() };
            // The inertia includes the motors. Gravity is compensated elsewhere.
            let dynamics = &self.dynamics;
            let moving = dynamics.mass_matrix(q) * qdd + dynamics.bias_torque(q, qd)
                - dynamics.gravity_torque(q);
            torque += moving * self.acceleration_share;
        }
        self.last_rad_s = Some(*qd);
        torque
    }
}

/// The law with its memory: the last error and the filtered rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pd<const N: usize = 6> {
    gains: Gains<N>,
    corner_rad_s: f64,
    last_rad: Option<JointVector<N>>,
    rate_rad_s: JointVector<N>,
    observer: Option<Observer<N>>,
    notch: Option<Notch<N>>,
}

impl<const N: usize> Fold for Pd<N> {
    fn fold(&self, hash: &mut StateHash) {
        if let Some(observer) = &self.observer {
            hash.add(observer);
        }
        if let Some(notch) = &self.notch {
            hash.add(notch);
        }
        hash.add(&self.last_rad.is_some());
        hash.add(self.last_rad.unwrap_or_else(JointVector::zeros).as_slice())
            .add(self.rate_rad_s.as_slice());
    }
}

impl<const N: usize> Pd<N> {
    /// A law with its rate filter at `filter_hz` (Hz).
    #[must_use]
    pub fn new(gains: Gains<N>, filter_hz: f64) -> Pd<N> {
        Pd {
            gains,
            corner_rad_s: core::f64::consts::TAU * filter_hz,
            last_rad: None,
            rate_rad_s: JointVector::zeros(),
            observer: None,
            notch: None,
        }
    }

    /// The same law with the rate by an observer instead of the filter.
    #[must_use]
    pub fn with_observer(self, observer: Observer<N>) -> Pd<N> {
        Pd { observer: Some(observer), ..self }
    }

    /// The same law with a notch on the error, or without one.
    #[must_use]
    pub fn with_notch(self, notch: Option<Notch<N>>) -> Pd<N> {
        Pd { notch, ..self }
    }

    /// Continues with other gains and another filter. The state is kept, so that the torque changes
    /// only by the change of the gains.
    pub fn retune(&mut self, gains: Gains<N>, filter_hz: f64) {
        self.gains = gains;
        self.corner_rad_s = core::f64::consts::TAU * filter_hz;
    }

    /// The gains in use.
    #[must_use]
    pub fn gains(&self) -> &Gains<N> {
        &self.gains
    }

    /// The filtered rate of the error (rad/s).
    #[must_use]
    pub fn rate_rad_s(&self) -> &JointVector<N> {
        &self.rate_rad_s
    }

    /// Forgets the past: the next call sees a rate of 0.
    pub fn reset(&mut self) {
        self.last_rad = None;
        self.rate_rad_s = JointVector::zeros();
        if let Some(observer) = &mut self.observer {
            observer.reset();
        }
        if let Some(notch) = &mut self.notch {
            notch.reset();
        }
    }

    /// Torque (N m) for an error of `error_rad` (desired minus measured), `dt_s` after the last
    /// call.
    ///
    /// `None`, and a forgotten past, when the torque would not be finite. With `dt_s` not positive
    /// the rate stays as it is.
    pub fn torque_nm(&mut self, error_rad: &JointVector<N>, dt_s: f64) -> Option<JointVector<N>> {
        let error_rad =
            &self.notch.as_mut().map_or(*error_rad, |notch| notch.filtered(error_rad, dt_s));
        if let Some(observer) = &mut self.observer {
            self.rate_rad_s = observer.rate_rad_s(error_rad, dt_s);
        } else if let Some(last) = self.last_rad.filter(|_| dt_s > 0.0) {
            let share = self.corner_rad_s * dt_s / (1.0 + self.corner_rad_s * dt_s);
            self.rate_rad_s += ((error_rad - last) / dt_s - self.rate_rad_s) * share;
        }
        self.last_rad = Some(*error_rad);
        let torque = self.gains.kp_nm_rad.component_mul(error_rad)
            + self.gains.kd_nms_rad.component_mul(&self.rate_rad_s);
        if torque.iter().all(|x| x.is_finite()) {
            if let Some(observer) = &mut self.observer {
                observer.record_torque(&torque);
            }
            return Some(torque);
        }
        self.reset();
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::Joints;

    const DT_S: f64 = 0.0025;

    fn feed_forward(friction: f64, friction_speed_rad_s: f64, acceleration: f64) -> FeedForward {
        let (arm, links) = (Friction::reference(), Dynamics::reference());
        FeedForward::new(arm, links, friction, friction_speed_rad_s, acceleration)
    }

    fn unit() -> Pd {
        let ones = Joints::repeat(1.0);
        Pd::new(Gains { kp_nm_rad: ones * 100.0, kd_nms_rad: ones * 10.0 }, 60.0)
    }

    #[test]
    fn the_model_ahead_moves_links_and_motors_and_leaves_gravity_out() {
        let mut ahead = feed_forward(0.0, 0.01, 1.0);
        let dynamics = Dynamics::reference();
        let q = Joints::new(0.1, 0.7, -2.6, 0.3, 0.7, 0.2);
        let (before, qd) = (Joints::repeat(0.1), Joints::new(0.2, -0.1, 0.4, 0.1, 0.0, 0.3));
        let coriolis = dynamics.bias_torque(&q, &before) - dynamics.gravity_torque(&q);
        assert!((ahead.torque_nm(&q, &before, DT_S) - coriolis).amax() < 1e-12, "no past");
        let qdd = (qd - before) / DT_S;
        let wanted = dynamics.mass_matrix(&q) * qdd + dynamics.bias_torque(&q, &qd)
            - dynamics.gravity_torque(&q);
        let got = ahead.torque_nm(&q, &qd, DT_S);
        assert!((got - wanted).amax() < 1e-9, "{got} {wanted}");
        assert_eq!(ahead.last_rad_s(), Some(&qd));
        ahead.reset();
        assert_eq!(ahead.last_rad_s(), None);
        for dt_s in [0.0, -1.0, f64::NAN] {
            assert!(ahead.torque_nm(&q, &qd, dt_s).iter().all(|x| x.is_finite()));
        }
    }

    #[test]
    fn friction_ahead_has_the_sign_of_the_motion_and_is_smooth_at_rest() {
        let mut ahead = feed_forward(0.5, 0.01, 0.0);
        let full = Friction::reference();
        let at = |ahead: &mut FeedForward, speed: f64| {
            ahead.torque_nm(&Joints::zeros(), &Joints::repeat(speed), DT_S)
        };
        assert_eq!(at(&mut ahead, 0.0), Joints::zeros());
        let (there, back) = (at(&mut ahead, 0.01), at(&mut ahead, -0.01));
        assert_eq!(there, -back);
        let half = full.coulomb_nm * 0.25 + full.viscous_nms_rad * 0.005;
        assert!((there - half).amax() < 1e-15, "half of half of Coulomb's");
        let fast = at(&mut ahead, 5.0);
        let bound = full.torque_nm(&Joints::repeat(5.0)) * 0.5;
        assert!((0..6).all(|i| fast[i] < bound[i] && fast[i] > 0.99 * bound[i]), "never more");
        assert_eq!(at(&mut feed_forward(0.0, 0.01, 0.0), 5.0), Joints::zeros());
    }

    #[test]
    fn gains_place_the_poles() {
        let gains = Gains::from_bandwidth(
            &Joints::new(0.5, 1.0, 2.0, 1.0, 1.0, 1.0),
            &Joints::repeat(60.0),
            &Joints::new(1.0, 1.0, 1.0, 0.5, 0.7, 2.0),
        );
        assert_eq!(gains.kp_nm_rad, Joints::new(1800.0, 3600.0, 7200.0, 3600.0, 3600.0, 3600.0));
        assert_eq!(gains.kd_nms_rad, Joints::new(60.0, 120.0, 240.0, 60.0, 84.0, 240.0));
    }

    #[test]
    fn the_first_call_and_a_constant_error_are_purely_proportional() {
        let mut law = unit();
        let e = Joints::new(0.1, -0.1, 0.0, 1.0, -1.0, 0.01);
        for _ in 0..3 {
            assert_eq!(law.torque_nm(&e, DT_S), Some(e * 100.0));
        }
    }

    #[test]
    fn the_rate_is_that_of_the_error_after_the_filter() {
        let mut law = unit();
        let share = 120.0 * core::f64::consts::PI * DT_S;
        let share = share / (1.0 + share);
        let slope = 0.4;
        let mut expected = 0.0;
        for tick in 0..200 {
            let e = slope * DT_S * f64::from(tick);
            let tau = law.torque_nm(&Joints::repeat(e), DT_S).unwrap();
            if tick > 0 {
                expected += share * (slope - expected);
            }
            assert!((tau[3] - (100.0 * e + 10.0 * expected)).abs() < 1e-9);
        }
        assert!((law.rate_rad_s()[0] - slope).abs() < 1e-9);
    }

    #[test]
    fn other_gains_change_the_torque_by_what_they_change_and_no_more() {
        let (mut law, mut still) = (unit(), unit());
        for tick in 0..50 {
            let e = Joints::repeat(0.001 * f64::from(tick));
            law.torque_nm(&e, DT_S);
            still.torque_nm(&e, DT_S);
        }
        let (e, ones) = (Joints::repeat(0.05), Joints::repeat(1.0));
        law.retune(Gains { kp_nm_rad: ones * 100.0, kd_nms_rad: ones * 12.0 }, 60.0);
        let (edited, plain) = (law.torque_nm(&e, DT_S), still.torque_nm(&e, DT_S));
        let rate = *still.rate_rad_s();
        assert_eq!(law.rate_rad_s(), &rate, "the filter goes on");
        let step = edited.unwrap() - plain.unwrap();
        assert!((step - rate * 2.0).amax() < 1e-12, "{step}");
    }

    #[test]
    fn a_reset_forgets_the_rate_and_the_last_error() {
        let mut law = unit();
        law.torque_nm(&Joints::repeat(0.0), DT_S);
        law.torque_nm(&Joints::repeat(0.5), DT_S);
        assert!(law.rate_rad_s()[0] > 1.0);
        law.reset();
        assert_eq!(law.torque_nm(&Joints::repeat(-2.0), DT_S), Some(Joints::repeat(-200.0)));
    }

    #[test]
    fn values_that_are_not_finite_give_no_torque_and_leave_no_trace() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308] {
            let mut law = unit();
            law.torque_nm(&Joints::zeros(), DT_S);
            let mut e = Joints::zeros();
            e[4] = bad;
            assert_eq!(law.torque_nm(&e, DT_S), None);
            assert_eq!(law.torque_nm(&Joints::repeat(1.0), DT_S), Some(Joints::repeat(100.0)));
        }
    }

    #[test]
    fn no_time_between_two_calls_leaves_the_rate() {
        let mut law = unit();
        law.torque_nm(&Joints::zeros(), DT_S);
        law.torque_nm(&Joints::repeat(0.1), DT_S);
        let rate = *law.rate_rad_s();
        for dt_s in [0.0, -1.0, f64::NAN] {
            assert!(law.torque_nm(&Joints::repeat(0.3), dt_s).is_some());
            assert_eq!(law.rate_rad_s(), &rate);
        }
    }

    /// A joint of inertia 1 with one tick of latency, counts of 1/7435.7 rad and the 60 rad/s
    /// gains.
    #[test]
    fn a_quantised_joint_with_latency_settles_without_ringing() {
        let gains = Gains::from_bandwidth(
            &Joints::repeat(1.0),
            &Joints::repeat(60.0),
            &Joints::repeat(1.0),
        );
        let mut law = Pd::new(gains, 60.0);
        let (mut q, mut qd, mut acting) = (0.0_f64, 0.0_f64, 0.0_f64);
        let (goal, mut top) = (0.01, 0.0_f64);
        for _ in 0..400 {
            let measured = (q * 7435.7).round() / 7435.7;
            let next = law.torque_nm(&Joints::repeat(goal - measured), DT_S).unwrap()[0];
            for step in 0..50 {
                let tau = if step < 25 { acting } else { next };
                qd += tau * DT_S / 50.0;
                q += qd * DT_S / 50.0;
            }
            acting = next;
            top = top.max(q);
        }
        assert!(top < 1.15 * goal, "overshoot to {top}");
        assert!((q - goal).abs() < 2.0 / 7435.7, "rests at {q}");
    }
}
