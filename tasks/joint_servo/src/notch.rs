//! A notch filter on the error of the joints, at the resonance of the contact. Behind the delay of
//! a tick the servo answers that oscillation a quarter of its period late or more, which excites
//! it, and passes on the quantisation of the encoders that beats there; with the notch it does
//! little of either. The notch is wide and leaves a share of the error in its middle, because the
//! resonance is not known exactly.
//!
//! `(s^2 + 2 depth width w s + w^2) / (s^2 + 2 width w s + w^2)` by the bilinear transform with `w`
//! kept in place, as a biquad in transposed direct form II: gain 1 far below and above, `depth` in
//! the middle.

use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{Fold, StateHash};

/// Middle, width and depth of a notch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NotchShape {
    /// Middle (Hz).
    pub hz: f64,
    /// Damping ratio of its poles.
    pub width: f64,
    /// Gain in the middle, 0 to 1.
    pub depth: f64,
}

/// The notch of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Notch<const N: usize = 6> {
    shape: NotchShape,
    /// Joints whose error is filtered.
    joints: [bool; N],
    /// The state of the filter; none before the first error.
    state: Option<[JointVector<N>; 2]>,
}

impl<const N: usize> Fold for Notch<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.state.is_some());
        for state in self.state.unwrap_or([JointVector::zeros(); 2]) {
            hash.add(state.as_slice());
        }
    }
}

impl<const N: usize> Notch<N> {
    /// A notch of this shape on the error of these joints; it remembers nothing.
    #[must_use]
    pub fn new(shape: NotchShape, joints: [bool; N]) -> Notch<N> {
        Notch { shape, joints, state: None }
    }

    /// Resets the state: the next error counts as one that has been constant for long.
    pub fn reset(&mut self) {
        self.state = None;
    }

    /// The error (rad) without what lies in the notch, `dt_s` after the last; the error itself
    /// where the notch would lie above half the rate, and without time between the two.
    pub fn filtered(&mut self, error_rad: &JointVector<N>, dt_s: f64) -> JointVector<N> {
        let NotchShape { hz, width, depth } = self.shape;
        let part = hz * dt_s;
        if !(part > 0.0 && part < 0.5) {
            return *error_rad;
        }
        let k = libm::tan(core::f64::consts::PI * part);
        let whole = 1.0 / (1.0 + 2.0 * width * k + k * k);
        let (near, far) = (2.0 * width * k, 2.0 * width * depth * k);
        let middle = 2.0 * (k * k - 1.0) * whole;
        let a2 = (1.0 - near + k * k) * whole;
        let (b0, b2) = ((1.0 + far + k * k) * whole, (1.0 - far + k * k) * whole);
        let [first, second] = self.state.unwrap_or([error_rad * (1.0 - b0), error_rad * (b2 - a2)]);
        let out = error_rad * b0 + first;
        self.state = Some([(error_rad - out) * middle + second, error_rad * b2 - out * a2]);
        JointVector::from_fn(|j, _| if self.joints[j] { out[j] } else { error_rad[j] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::Joints;

    const DT_S: f64 = 0.0025;
    const NOTCH_SHAPE: NotchShape = NotchShape { hz: 34.0, width: 0.3, depth: 0.15 };

    /// Amplitude after the filter of an oscillation of amplitude 1 at this frequency.
    fn gain(hz: f64) -> f64 {
        let mut notch = Notch::<6>::new(NOTCH_SHAPE, [true; 6]);
        let mut most = 0.0_f64;
        for job in 0..4000 {
            let t_s = DT_S * f64::from(job);
            let x = libm::sin(core::f64::consts::TAU * hz * t_s);
            let y = notch.filtered(&Joints::repeat(x), DT_S)[3];
            most = if job > 2000 { most.max(y.abs()) } else { 0.0 };
        }
        most
    }

    #[test]
    fn the_middle_is_taken_out_and_what_lies_far_from_it_passes() {
        assert!((gain(34.0) - 0.15).abs() < 0.01, "{}", gain(34.0));
        for (hz, low, high) in [(2.0, 0.99, 1.01), (10.0, 0.97, 1.0), (150.0, 0.97, 1.0)] {
            assert!((low..=high).contains(&gain(hz)), "{hz} Hz: {}", gain(hz));
        }
        assert!(gain(28.0) < 0.7 && gain(42.0) < 0.7, "{} {}", gain(28.0), gain(42.0));
    }

    #[test]
    fn joints_without_it_keep_their_error() {
        let mut notch = Notch::<6>::new(NOTCH_SHAPE, [false, true, true, false, true, false]);
        notch.filtered(&Joints::zeros(), DT_S);
        let e = Joints::repeat(1.0);
        let out = notch.filtered(&e, DT_S);
        assert_eq!([out[0], out[3], out[5]], [1.0; 3]);
        assert!(out[1] < 0.99 && out[1] == out[2] && out[1] == out[4], "{out}");
    }

    #[test]
    fn an_error_that_stands_passes_whole_from_the_first_job_on() {
        let mut notch = Notch::<6>::new(NOTCH_SHAPE, [true; 6]);
        let e = Joints::new(0.1, -0.2, 0.0, 1.0, 3.0, -0.01);
        for _ in 0..50 {
            assert!((notch.filtered(&e, DT_S) - e).amax() < 1e-14);
        }
        notch.reset();
        assert!((notch.filtered(&-e, DT_S) + e).amax() < 1e-14);
    }

    #[test]
    fn without_time_between_two_errors_and_above_half_the_rate_nothing_is_done() {
        let mut notch = Notch::<6>::new(NOTCH_SHAPE, [true; 6]);
        notch.filtered(&Joints::zeros(), DT_S);
        let before = notch;
        for dt_s in [0.0, -1.0, f64::NAN, 0.02] {
            assert_eq!(notch.filtered(&Joints::repeat(1.0), dt_s), Joints::repeat(1.0));
            assert_eq!(notch, before);
        }
    }
}
