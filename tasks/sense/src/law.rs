//! Converts counts to joint angles and speeds: gears, zero offset, speeds by differences, and the
//! check for jumps. This module also decides what a failed read means, by the kind of its error.

use taktil_hal::{ErrorKind, Nanos};
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::transmission::Transmission;
use taktil_rtcore::{FaultCode, Fold, StateHash};
use taktil_signal::JointState;

/// A motion faster than this multiple of the joint's largest speed counts as a jump of its encoder.
pub const JUMP_MARGIN: f64 = 1.5;

/// The newest sample that was accepted, from which differences are taken.
#[derive(Clone, Copy, Debug)]
struct LastSample<const N: usize> {
    /// Joint angles without the zero offset, rad.
    raw_rad: JointVector<N>,
    acquired: Nanos,
    qd_rad_s: JointVector<N>,
}

/// Turns samples of the encoder board into joint states.
#[derive(Clone, Debug)]
pub struct JointAngles<const N: usize = 6> {
    transmission: Transmission<N>,
    v_max_rad_s: JointVector<N>,
    home_rad: JointVector<N>,
    offset_rad: JointVector<N>,
    datum: u32,
    calibrated: bool,
    /// Whether the newest sample jumped.
    jumped: bool,
    last: Option<LastSample<N>>,
}

impl<const N: usize> JointAngles<N> {
    /// Uncalibrated: angles are those of the counts, zero where the counters were at power-up.
    #[must_use]
    pub fn new(
        transmission: Transmission<N>,
        v_max_rad_s: JointVector<N>,
        home_rad: JointVector<N>,
    ) -> JointAngles<N> {
        JointAngles {
            transmission,
            v_max_rad_s,
            home_rad,
            offset_rad: JointVector::zeros(),
            datum: 0,
            calibrated: false,
            jumped: false,
            last: None,
        }
    }

    /// Joint angles of so many counts (rad).
    #[must_use]
    pub fn span_rad(&self, counts: &[i32; N]) -> JointVector<N> {
        self.transmission.joints(counts)
    }

    /// True once a sample was accepted.
    #[must_use]
    pub fn has_sample(&self) -> bool {
        self.last.is_some()
    }

    /// Takes one sample; with `home`, the counts of the home pose, the zero offset is set so that
    /// the angles of those counts are the home angles.
    ///
    /// Speeds are differences over the time between the two acquisitions, so they act half of it
    /// late; the first is zero, and a second sample of the same instant keeps the speed.
    ///
    /// # Errors
    /// [`FaultCode::EncoderJump`] when a joint moved more than [`JUMP_MARGIN`] * v_max * (time
    /// between the acquisitions). The zero is lost then, and differences start anew from this
    /// sample. A calibration asked for does not happen, with the next sample neither: whoever asks
    /// for it then has not heard of the jump.
    pub fn update(
        &mut self,
        counts: [i32; N],
        acquired: Nanos,
        home: Option<&[i32; N]>,
    ) -> Result<JointState<N>, FaultCode> {
        let raw_rad = self.transmission.joints(&counts);
        let mut qd_rad_s = JointVector::zeros();
        if let Some(last) = self.last {
            let span_s = (acquired - last.acquired).as_secs_f64().max(0.0);
            let moved_rad = raw_rad - last.raw_rad;
            if (0..N).any(|i| moved_rad[i].abs() > JUMP_MARGIN * self.v_max_rad_s[i] * span_s) {
                self.last = Some(LastSample { raw_rad, acquired, qd_rad_s });
                (self.calibrated, self.jumped) = (false, true);
                return Err(FaultCode::EncoderJump);
            }
            qd_rad_s = if span_s > 0.0 { moved_rad / span_s } else { last.qd_rad_s };
        }
        self.last = Some(LastSample { raw_rad, acquired, qd_rad_s });
        let has_just_jumped = core::mem::take(&mut self.jumped);
        if let Some(home) = home.filter(|_| !has_just_jumped) {
            self.offset_rad = self.home_rad - self.transmission.joints(home);
            self.datum = self.datum.wrapping_add(1);
            self.calibrated = true;
        }
        Ok(JointState {
            q_rad: (raw_rad + self.offset_rad).into(),
            qd_rad_s: qd_rad_s.into(),
            counts,
            datum: self.datum,
            calibrated: u32::from(self.calibrated),
        })
    }
}

impl<const N: usize> Fold for JointAngles<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(self.offset_rad.as_slice()).add(&self.datum).add(&self.calibrated);
        if self.jumped {
            hash.add(&self.jumped);
        }
        hash.add(&self.last.is_some());
        if let Some(LastSample { raw_rad, acquired, qd_rad_s }) = &self.last {
            hash.add(raw_rad.as_slice()).add(acquired).add(qd_rad_s.as_slice());
        }
    }
}

/// What to do about a read that failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FailureAction {
    /// The last value is held a little longer.
    Hold,
    /// The device counts as lost.
    Gone,
}

/// Decides what a failed read means, by counting failures in a row. A device that has never
/// delivered a value may still be starting, so its failures are tolerated; a failed write is judged
/// more strictly, by the task `actuate`.
#[derive(Clone, Copy, Debug)]
pub struct ReadFailurePolicy {
    /// Number of failures in a row that are tolerated.
    allowed: u32,
    failed: u32,
}

impl Fold for ReadFailurePolicy {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.failed);
    }
}

impl ReadFailurePolicy {
    /// A policy that tolerates `allowed` failures in a row.
    #[must_use]
    pub fn new(allowed: u32) -> ReadFailurePolicy {
        ReadFailurePolicy { allowed, failed: 0 }
    }

    /// A read succeeded.
    pub fn record_success(&mut self) {
        self.failed = 0;
    }

    /// A read failed; `arrived` says whether a value was ever there.
    ///
    /// A lost device is gone at once. A stale one has already been silent for longer than it
    /// promises: gone, unless it has never spoken. Transient failures and impossible values are
    /// tolerated up to the allowed number.
    pub fn action_on_failure(&mut self, kind: ErrorKind, arrived: bool) -> FailureAction {
        match kind {
            ErrorKind::Lost => FailureAction::Gone,
            ErrorKind::Stale | ErrorKind::Transient | ErrorKind::OutOfRange if !arrived => {
                FailureAction::Hold
            }
            ErrorKind::Stale => FailureAction::Gone,
            ErrorKind::Transient | ErrorKind::OutOfRange => {
                self.failed = self.failed.saturating_add(1);
                if self.failed > self.allowed { FailureAction::Gone } else { FailureAction::Hold }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::Joints;
    use taktil_mechanics::transmission::{COUNTS_PER_REVOLUTION, GEAR_RATIO};

    const TICK_PERIOD: Nanos = Nanos(2_500_000);

    fn angles() -> JointAngles {
        let v_max = Joints::repeat(2.0);
        let home = Joints::new(0.1, 0.2, -3.0, 0.0, 1.5, -0.25);
        JointAngles::new(Transmission::reference(), v_max, home)
    }

    fn joint_1_rad(counts: f64) -> f64 {
        counts * core::f64::consts::TAU / COUNTS_PER_REVOLUTION[0] / GEAR_RATIO[0]
    }

    #[test]
    fn before_calibration_angles_are_those_of_the_counts() {
        let mut law = angles();
        assert!(!law.has_sample());
        let first = law.update([1000, 0, 0, 0, 0, 0], Nanos(7), None).unwrap();
        assert!(law.has_sample());
        assert!((first.q_rad[0] - joint_1_rad(1000.0)).abs() < 1e-15);
        assert_eq!(first.qd_rad_s, [0.0; 6], "no speed from one sample");
        assert_eq!((first.calibrated, first.datum), (0, 0));
        assert_eq!(first.counts[0], 1000);
    }

    #[test]
    fn the_wrist_is_decoupled() {
        let mut law = angles();
        let q = Joints::new(0.0, 0.0, 0.0, 0.5, 0.0, 0.0);
        let counts = Transmission::reference().counts(&q);
        assert_ne!(counts[4], 0, "motor 5 turns when joint 4 does");
        let state = law.update(counts, Nanos(0), None).unwrap();
        assert!((Joints::from(state.q_rad) - q).amax() < 2e-3);
        assert!(state.q_rad[4].abs() < 1e-3);
    }

    #[test]
    fn calibration_moves_the_zero_and_not_the_speed() {
        let mut law = angles();
        let _ = law.update([50, -20, 3, 4, 5, 6], Nanos(0), None).unwrap();
        let home =
            law.update([52, -20, 3, 4, 5, 6], TICK_PERIOD, Some(&[52, -20, 3, 4, 5, 6])).unwrap();
        let expected = [0.1, 0.2, -3.0, 0.0, 1.5, -0.25];
        for (found, wanted) in home.q_rad.iter().zip(expected) {
            assert!((found - wanted).abs() < 1e-15);
        }
        assert_eq!((home.calibrated, home.datum), (1, 1));
        assert!((home.qd_rad_s[0] - joint_1_rad(2.0) / 0.0025).abs() < 1e-12);
        let next = law.update([52, -20, 3, 4, 5, 6], TICK_PERIOD + TICK_PERIOD, None).unwrap();
        assert_eq!(next.q_rad, home.q_rad);
        assert_eq!((next.calibrated, next.datum, next.qd_rad_s), (1, 1, [0.0; 6]));
        let again = law
            .update([52, -20, 3, 4, 5, 6], TICK_PERIOD * 3, Some(&[52, -20, 3, 4, 5, 6]))
            .unwrap();
        assert_eq!(again.datum, 2, "each new zero is a new datum");
    }

    #[test]
    fn speed_is_over_the_stamps_whatever_the_tick() {
        let mut law = angles();
        let _ = law.update([0; 6], Nanos(1_000), None).unwrap();
        let state = law.update([6, 0, 0, 0, 0, 0], Nanos(3_001_000), None).unwrap();
        assert!((state.qd_rad_s[0] - joint_1_rad(6.0) / 0.003).abs() < 1e-12);
        let same = law.update([6, 0, 0, 0, 0, 0], Nanos(3_001_000), None).unwrap();
        assert_eq!(same.qd_rad_s, state.qd_rad_s, "the same instant again keeps the speed");
    }

    #[test]
    fn a_jump_is_more_than_the_margin_over_the_fastest_joint() {
        let limit = JUMP_MARGIN * 2.0 * 0.0025;
        let most = (limit / joint_1_rad(1.0)).floor();
        let count = |n: f64| [n as i32, 0, 0, 0, 0, 0];
        for sign in [-1.0, 1.0] {
            let mut law = angles();
            let _ = law.update([0; 6], Nanos(0), None).unwrap();
            assert!(law.update(count(sign * most), TICK_PERIOD, None).is_ok());
            let mut law = angles();
            let _ = law.update([0; 6], Nanos(0), Some(&[0; 6])).unwrap();
            let jump = law.update(
                count(sign * (most + 1.0)),
                TICK_PERIOD,
                Some(&count(sign * (most + 1.0))),
            );
            assert_eq!(jump, Err(FaultCode::EncoderJump));
            let after =
                law.update(count(sign * (most + 1.0)), TICK_PERIOD + TICK_PERIOD, None).unwrap();
            assert_eq!(after.qd_rad_s, [0.0; 6], "differences start anew");
            assert_eq!((after.calibrated, after.datum), (0, 1), "the zero is not known any more");
        }
    }

    #[test]
    fn a_calibration_that_was_asked_for_before_the_jump_was_known_does_not_happen() {
        let jumped = [10_000, 0, 0, 0, 0, 0];
        let at = |tick: i64| Nanos(tick * TICK_PERIOD.0);
        let mut law = angles();
        let _ = law.update([0; 6], at(0), None).unwrap();
        assert_eq!(law.update(jumped, at(1), None), Err(FaultCode::EncoderJump));
        let with_the_jump = law.update(jumped, at(2), Some(&jumped)).unwrap();
        assert_eq!((with_the_jump.calibrated, with_the_jump.datum), (0, 0));
        let after_it = law.update(jumped, at(3), Some(&jumped)).unwrap();
        assert_eq!((after_it.calibrated, after_it.datum), (1, 1));
    }

    #[test]
    fn the_allowance_grows_with_the_time_that_passed() {
        let step = (JUMP_MARGIN * 2.0 * 0.0075 / joint_1_rad(1.0)).floor() as i32;
        let mut law = angles();
        let _ = law.update([0; 6], Nanos(0), None).unwrap();
        assert!(law.update([step, 0, 0, 0, 0, 0], TICK_PERIOD * 3, None).is_ok());
        let mut law = angles();
        let _ = law.update([0; 6], Nanos(0), None).unwrap();
        assert!(law.update([step, 0, 0, 0, 0, 0], TICK_PERIOD + TICK_PERIOD, None).is_err());
    }

    #[test]
    fn extreme_counts_and_stamps_are_a_jump_and_no_panic() {
        let mut law = angles();
        let _ = law.update([i32::MIN; 6], Nanos(0), None).unwrap();
        assert_eq!(law.update([i32::MAX; 6], TICK_PERIOD, None), Err(FaultCode::EncoderJump));
        assert_eq!(
            law.update([0; 6], Nanos(-1), None),
            Err(FaultCode::EncoderJump),
            "moved back in time"
        );
        let mut law = angles();
        let _ = law.update([0; 6], TICK_PERIOD, None).unwrap();
        assert_eq!(
            law.update([1; 6], TICK_PERIOD, None),
            Err(FaultCode::EncoderJump),
            "moved in no time"
        );
    }

    #[test]
    fn patience_ends_after_the_allowed_failures_in_a_row() {
        let mut patience = ReadFailurePolicy::new(1);
        assert_eq!(patience.action_on_failure(ErrorKind::Transient, true), FailureAction::Hold);
        patience.record_success();
        assert_eq!(patience.action_on_failure(ErrorKind::OutOfRange, true), FailureAction::Hold);
        assert_eq!(patience.action_on_failure(ErrorKind::Transient, true), FailureAction::Gone);
        assert_eq!(
            ReadFailurePolicy::new(0).action_on_failure(ErrorKind::Transient, true),
            FailureAction::Gone
        );
        assert_eq!(
            ReadFailurePolicy::new(9).action_on_failure(ErrorKind::Lost, false),
            FailureAction::Gone
        );
        assert_eq!(
            ReadFailurePolicy::new(9).action_on_failure(ErrorKind::Stale, true),
            FailureAction::Gone
        );
        assert_eq!(
            ReadFailurePolicy::new(0).action_on_failure(ErrorKind::Stale, false),
            FailureAction::Hold,
            "has never spoken"
        );
    }
}
