//! Estimates the rate of the error by an observer instead of a filtered difference. The observer
//! predicts the effect of the commanded torque on the joint's inertia, so that its rate belongs to
//! the present instant and not to half a tick before. All other influences on the joint (gravity,
//! friction, other joints) are estimated as one additional acceleration, so that a constant load
//! leaves no error in the rate.
//!
//! Per joint, with e the error, r its rate, d the unknown acceleration, u the torque, `nu` the
//! innovation and p = exp(-w dt) the place of all three poles (the critically damped alpha-beta-
//! gamma filter; Brookner 1998, chapter 1):
//!
//! ```text
//! a = d - u/I             e- = e + r dt + a dt^2/2        r- = r + a dt
//! nu = measured - e-      e = e- + (1 - p^3) nu           r = r- + 3/2 (1 - p^2)(1 - p) nu/dt
//!                                                         d = d + (1 - p)^3 nu/dt^2
//! ```

use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{Fold, StateHash};

/// Delay after which a commanded torque acts on the joint (periods).
const ACTING_DELAY_PERIODS: f64 = 0.5;

/// The observer of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observer<const N: usize = 6> {
    inertia_kg_m2: JointVector<N>,
    corner_rad_s: f64,
    error_rad: Option<JointVector<N>>,
    rate_rad_s: JointVector<N>,
    unknown_rad_s2: JointVector<N>,
    /// Torques of the law in the last job and the one before (N m).
    commanded_nm: [JointVector<N>; 2],
}

impl<const N: usize> Observer<N> {
    /// An observer of joints with this inertia, its poles at `corner_hz` (Hz).
    #[must_use]
    pub fn new(inertia_kg_m2: &JointVector<N>, corner_hz: f64) -> Observer<N> {
        Observer {
            inertia_kg_m2: *inertia_kg_m2,
            corner_rad_s: core::f64::consts::TAU * corner_hz,
            error_rad: None,
            rate_rad_s: JointVector::zeros(),
            unknown_rad_s2: JointVector::zeros(),
            commanded_nm: [JointVector::zeros(); 2],
        }
    }

    /// Forgets the past: the next rate is 0.
    pub fn reset(&mut self) {
        *self = Observer {
            error_rad: None,
            rate_rad_s: JointVector::zeros(),
            unknown_rad_s2: JointVector::zeros(),
            commanded_nm: [JointVector::zeros(); 2],
            ..*self
        };
    }

    /// Updates the observer with an error (rad), `dt_s` after the last one, and returns its rate
    /// (rad/s). Without time between the two the rate stays the same.
    pub fn rate_rad_s(&mut self, measured_rad: &JointVector<N>, dt_s: f64) -> JointVector<N> {
        let Some(error) = self.error_rad.filter(|_| dt_s > 0.0) else {
            self.error_rad = Some(*measured_rad);
            return self.rate_rad_s;
        };
        let [newer, older] = self.commanded_nm;
        let acting = newer * (1.0 - ACTING_DELAY_PERIODS) + older * ACTING_DELAY_PERIODS;
        let acceleration = self.unknown_rad_s2 - acting.component_div(&self.inertia_kg_m2);
        let ahead = error + self.rate_rad_s * dt_s + acceleration * (0.5 * dt_s * dt_s);
        let innovation = measured_rad - ahead;
        let p = libm::exp(-self.corner_rad_s * dt_s);
        let gap = 1.0 - p;
        self.error_rad = Some(ahead + innovation * (1.0 - p * p * p));
        self.rate_rad_s += acceleration * dt_s + innovation * (1.5 * (1.0 - p * p) * gap / dt_s);
        self.unknown_rad_s2 += innovation * (gap * gap * gap / (dt_s * dt_s));
        self.rate_rad_s
    }

    /// Records the torque that the law commands in this job (N m).
    pub fn record_torque(&mut self, torque_nm: &JointVector<N>) {
        self.commanded_nm = [*torque_nm, self.commanded_nm[0]];
    }
}

impl<const N: usize> Fold for Observer<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.error_rad.is_some());
        hash.add(self.error_rad.unwrap_or_else(JointVector::zeros).as_slice())
            .add(self.rate_rad_s.as_slice());
        hash.add(self.unknown_rad_s2.as_slice());
        for asked in &self.commanded_nm {
            hash.add(asked.as_slice());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::Joints;

    const DT_S: f64 = 0.0025;

    #[test]
    fn a_ramp_and_a_steady_acceleration_have_their_rate_of_now() {
        let mut observer = Observer::new(&Joints::repeat(0.4), 60.0);
        for (slope, bend) in [(0.3, 0.0), (0.3, 2.0)] {
            observer.reset();
            let mut t_s = 0.0;
            for _ in 0..400 {
                let e = Joints::repeat(slope * t_s + 0.5 * bend * t_s * t_s);
                let rate = observer.rate_rad_s(&e, DT_S);
                t_s += DT_S;
                if t_s > 0.9 {
                    let now = slope + bend * (t_s - DT_S);
                    assert!((rate[2] - now).abs() < 1e-6, "{} {now}", rate[2]);
                }
            }
        }
    }

    #[test]
    fn torque_that_was_asked_for_is_seen_without_delay_and_a_load_leaves_no_rate() {
        let inertia = 0.4;
        let mut observer = Observer::new(&Joints::repeat(inertia), 60.0);
        let (mut e, mut r, mut older, mut worst) = (0.01, 0.0, 0.0, 0.0f64);
        for tick in 0..2000 {
            let rate = observer.rate_rad_s(&Joints::repeat(e), DT_S)[0];
            worst = worst.max(if tick > 100 { (rate - r).abs() } else { 0.0 });
            let load = 0.5;
            let torque = inertia * 3600.0 * e + inertia * 60.0 * rate;
            observer.record_torque(&Joints::repeat(torque));
            for half in 0..2 {
                let acting = if half == 0 { older } else { torque };
                let a = (load - acting) / inertia;
                e += r * DT_S / 2.0 + a * DT_S * DT_S / 8.0;
                r += a * DT_S / 2.0;
            }
            older = torque;
        }
        assert!(worst < 2e-3, "{worst}");
        let end = observer.rate_rad_s(&Joints::repeat(e), DT_S)[0];
        assert!((e - 0.5 / (inertia * 3600.0)).abs() < 1e-9 && end.abs() < 1e-9, "{e} {end}");
    }

    #[test]
    fn no_time_between_two_looks_changes_nothing() {
        let mut observer = Observer::new(&Joints::repeat(1.0), 60.0);
        observer.rate_rad_s(&Joints::zeros(), DT_S);
        observer.rate_rad_s(&Joints::repeat(0.1), DT_S);
        let rate = observer.rate_rad_s;
        for dt_s in [0.0, -1.0, f64::NAN] {
            assert_eq!(observer.rate_rad_s(&Joints::repeat(0.2), dt_s), rate);
        }
    }
}
