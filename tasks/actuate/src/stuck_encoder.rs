//! Detects encoders that do not count: the desired angle of a motor moves away, its torque pulls it
//! after by more than gravity and friction can take, and for 50 ms its encoder has not moved. A
//! motor that is held fast looks the same; a motor that is asked for nothing, or whose torque stays
//! below its friction, shows nothing at all, whatever its encoder does. A motor that presses
//! against something is asked for no motion.
//!
//! A motor whose axis passes through the tool, the last one of most arms, is different: what the
//! tool touches holds it by no more than the friction of the fingertip's pad. Where its torque is
//! beyond that, too, it may be asked for its motion as slowly as one likes. A
//! motor with a lever cannot be treated so: a fingertip that lies flat on something stiff holds
//! joint 5 of the PUMA without one count while it is asked for 0.8 degrees.

use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{Fold, StateHash};

use crate::runaway::Load;

/// How long an encoder may stand still under such a torque (s).
const STANDSTILL_MAX_S: f64 = 0.05;
/// Motion that was asked for longer ago does not count (s): what presses against something stiff
/// creeps, and in the end is asked for as much.
const ASKED_WITHIN_S: f64 = 0.1;
/// Change of a reading that is no motion (counts): a disc between two lines flickers.
const FLICKER_COUNTS: i32 = 1;

/// Desired motion that counts, over the departure that does: a fingertip that is pressed against
/// something stiff is asked for less while it stands.
const ASKED_FACTOR: f64 = 2.5;

/// Lever of the tool about the axis of a joint up to which a touch cannot hold it (m): the radius
/// of a fingertip's pad.
pub(crate) const LEVER_MAX_M: f64 = 0.03;

/// Largest moment by which what is touched holds such a joint (N m): 16 N on a round place of 8 mm
/// radius, with a friction of 0.6.
pub const PAD_MOMENT_MAX_NM: f64 = 0.05;

/// Desired motion that counts for such a joint, over the departure that does.
const FREE_ASKED_FACTOR: f64 = 1.5;

/// How long each encoder has stood still under torque.
#[derive(Clone, Copy, Debug)]
pub struct StuckEncoderDetector<const N: usize = 6> {
    place: [i32; N],
    /// Desired angles since when it stands (counts).
    desired: JointVector<N>,
    standing_s: [f64; N],
    /// Whether the tool has too short a lever to be held by what it touches.
    is_free: [bool; N],
    /// Largest torque of each motor that the pad of a fingertip takes in contact (N m).
    pad_nm: [f64; N],
    free: [Option<Standstill>; N],
}

/// A motor since its encoder counted last.
#[derive(Clone, Copy, Debug)]
struct Standstill {
    place: i32,
    /// Smallest and largest desired angle since then (counts from the place).
    least: f64,
    most: f64,
    /// For how long its torque has pulled it without a break (s).
    pulled_s: f64,
}

impl<const N: usize> Fold for StuckEncoderDetector<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.place).add(self.desired.as_slice()).add(&self.standing_s);
        for motor in &self.free {
            let span = motor.map(|motor| [motor.least, motor.most, motor.pulled_s]);
            hash.add(&motor.map(|motor| motor.place)).add(&span);
        }
    }
}

impl Standstill {
    /// A motor that counts.
    fn new(place: i32, desired: f64) -> Standstill {
        Standstill { place, least: desired, most: desired, pulled_s: 0.0 }
    }

    /// Takes a reading, and the departure, in counts; returns whether the motor is asked for more
    /// than `asked` counts and pulled, and does not count.
    fn update(&mut self, reading: i32, departure: f64, pulled_s: f64, asked: f64) -> bool {
        let moved = reading.wrapping_sub(self.place);
        if !(-FLICKER_COUNTS..=FLICKER_COUNTS).contains(&moved) {
            *self = Standstill::new(reading, -departure);
            return false;
        }
        let desired = f64::from(moved) - departure;
        (self.least, self.most) = (self.least.min(desired), self.most.max(desired));
        self.pulled_s = if pulled_s > 0.0 { self.pulled_s + pulled_s } else { 0.0 };
        self.pulled_s > STANDSTILL_MAX_S && self.most - self.least >= asked
    }
}

impl<const N: usize> StuckEncoderDetector<N> {
    /// A detector that has seen nothing, of an arm whose tool has these levers about the axes of
    /// the joints (m). In contact the pad of a fingertip holds the motors by `pad_nm` (N m).
    #[must_use]
    pub fn new(lever_m: &[f64; N], pad_nm: &[f64; N]) -> StuckEncoderDetector<N> {
        StuckEncoderDetector {
            place: [0; N],
            desired: JointVector::zeros(),
            standing_s: [0.0; N],
            is_free: lever_m.map(|lever_m| lever_m <= LEVER_MAX_M),
            pad_nm: *pad_nm,
            free: [None; N],
        }
    }

    /// Forgets the past.
    pub fn reset(&mut self) {
        self.standing_s = [0.0; N];
        self.free = [None; N];
    }

    /// Takes readings `after_s` after the last ones, under the torques that the motors had since
    /// (N m). `departure` is in counts measured minus desired; `is_touching` where the fingertip
    /// touches something. The first motor whose encoder is stuck is returned, 0 the first.
    pub fn update(
        &mut self,
        counts: &[i32; N],
        departure: &JointVector<N>,
        torque_nm: &JointVector<N>,
        load: &Load<N>,
        after_s: f64,
        is_touching: bool,
    ) -> Option<usize> {
        let mut found = None;
        for i in 0..N {
            let side = -departure[i].signum();
            let pulled = load.excess_nm(i, torque_nm[i], side) > 0.0;
            let moved = counts[i].wrapping_sub(self.place[i]);
            let still = (-FLICKER_COUNTS..=FLICKER_COUNTS).contains(&moved);
            let desired = f64::from(moved) - departure[i];
            let lasts = self.standing_s[i] > 0.0 && self.standing_s[i] < ASKED_WITHIN_S;
            if !(pulled && still && lasts) {
                self.place[i] = counts[i];
                self.desired[i] = -departure[i];
                self.standing_s[i] = if pulled { after_s } else { 0.0 };
                continue;
            }
            self.standing_s[i] += after_s;
            let asked = side * (desired - self.desired[i]);
            let is_asked = asked >= ASKED_FACTOR * load.departure_min()[i];
            if is_asked && self.standing_s[i] > STANDSTILL_MAX_S {
                found = found.or(Some(i));
            }
        }
        found.or(self.update_free(counts, departure, torque_nm, load, after_s, is_touching))
    }

    /// The first motor that a touch cannot hold, and that stands.
    fn update_free(
        &mut self,
        counts: &[i32; N],
        departure: &JointVector<N>,
        torque_nm: &JointVector<N>,
        load: &Load<N>,
        after_s: f64,
        is_touching: bool,
    ) -> Option<usize> {
        let mut found = None;
        for i in (0..N).filter(|i| self.is_free[*i]) {
            let side = -departure[i].signum();
            let held_nm = if is_touching { self.pad_nm[i] } else { 0.0 };
            let pulled = load.excess_nm(i, torque_nm[i], side) > held_nm;
            let pulled_s = if pulled { after_s } else { 0.0 };
            let motor =
                self.free[i].get_or_insert_with(|| Standstill::new(counts[i], -departure[i]));
            let asked = FREE_ASKED_FACTOR * load.departure_min()[i];
            if motor.update(counts[i], departure[i], pulled_s, asked) {
                found = found.or(Some(i));
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runaway::{Motion, MotorModel};
    use taktil_mechanics::robot::Robot;

    const PERIOD_S: f64 = 2.5e-3;
    const ASKED_COUNTS: f64 = 20.0;

    /// The first job in which a motor is found that stands at 7 counts and flickers by one, pulled
    /// in each of these jobs.
    fn found(departure: impl Fn(i32) -> f64, pulled: impl Fn(i32) -> bool) -> Option<i32> {
        let mut motor = Standstill::new(7, -departure(0));
        (0..4000).find(|job| {
            let pulled_s = if pulled(*job) { PERIOD_S } else { 0.0 };
            motor.update(7 + job % 2, departure(*job), pulled_s, ASKED_COUNTS)
        })
    }

    #[test]
    fn however_slowly_it_is_asked_a_motor_that_stands_is_found() {
        for counts_per_job in [0.01, 0.1, 1.0] {
            let job = found(|job| -counts_per_job * f64::from(job), |_| true).unwrap();
            let asked = counts_per_job * f64::from(job);
            assert!(
                (asked - ASKED_COUNTS).abs() <= 1.0 + counts_per_job,
                "{counts_per_job}: {job}"
            );
        }
        assert_eq!(found(|_| -100.0, |_| true), None, "nothing is asked for");
        assert_eq!(found(|job| -f64::from(job), |_| false), None, "friction may hold it");
        assert_eq!(found(|job| -f64::from(job), |job| job % 19 > 0), None, "pulled for 45 ms");
    }

    #[test]
    fn a_motor_that_counts_is_not_found() {
        let mut motor = Standstill::new(0, 0.0);
        for job in 0..4000 {
            // It follows 15 counts behind, three counts at a time.
            let reading = 3 * (job / 100);
            let desired = 0.03 * f64::from(job) + 15.0;
            assert!(
                !motor.update(reading, f64::from(reading) - desired, PERIOD_S, ASKED_COUNTS),
                "{job}"
            );
        }
    }

    /// Whether motor 6 of the PUMA 260, which stands, is found: asked for motion slowly, and pulled
    /// by so much (N m) over what gravity and friction may take.
    fn is_found(excess_nm: f64, is_touching: bool) -> bool {
        const MOTOR_INDEX: usize = 5;
        let robot = Robot::puma260();
        let motion =
            Motion { q_rad: robot.nominal_rad.into(), qd_rad_s: [0.0; 6], calibrated: true };
        let load = MotorModel::new(&robot).load(&motion, PERIOD_S);
        let mut lever_m = [1.0; 6];
        lever_m[MOTOR_INDEX] = 0.0;
        let mut detector = StuckEncoderDetector::new(&lever_m, &[0.003; 6]);
        let mut torque_nm = JointVector::<6>::zeros();
        torque_nm[MOTOR_INDEX] = excess_nm - load.excess_nm(MOTOR_INDEX, 0.0, 1.0);
        (0..4000).any(|job| {
            let mut departure = JointVector::<6>::zeros();
            departure[MOTOR_INDEX] = -0.02 * f64::from(job);
            let counts = [0; 6];
            detector.update(&counts, &departure, &torque_nm, &load, PERIOD_S, is_touching).is_some()
        })
    }

    #[test]
    fn in_contact_the_pad_may_hold_a_motor_whose_axis_passes_through_it() {
        assert!(is_found(0.002, false));
        assert!(!is_found(0.002, true));
        assert!(is_found(0.004, true));
        assert!(!is_found(-0.001, false));
    }
}
