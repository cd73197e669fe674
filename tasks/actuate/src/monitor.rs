//! Watches the motion that the torque makes: each joint follows within its window and stays within
//! its limits, no motor runs away, no encoder is stuck. It keeps what is needed of earlier jobs;
//! the laws stand in [`crate::law`], [`crate::runaway`], [`crate::stuck_encoder`],
//! [`crate::hidden_motion`] and [`crate::hidden_turn`].

use taktil_mechanics::arm::{Arm, ArmDynamics};
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{FaultCode, Fold, StateHash};
use taktil_signal::JointState;

use crate::contact_age::ContactAge;
use crate::contact_push::ContactPush;
use crate::hidden_motion::{HiddenMotionDetector, Reading, Touch};
use crate::hidden_turn::HiddenTurnDetector;
use crate::law::FollowingWindow;
use crate::runaway::{Motion, MotorContact, MotorModel, RunawayDetector};
use crate::stuck_encoder::{PAD_MOMENT_MAX_NM, StuckEncoderDetector};

/// What one job with open gate knows of the motion.
#[derive(Clone, Copy, Debug)]
pub struct Observation<const N: usize = 6> {
    /// The newest measured joints.
    pub joints: JointState<N>,
    /// Whether they were measured in this job.
    pub is_new: bool,
    /// Desired minus measured angles (rad), of this job.
    pub error_rad: [f64; N],
    /// Torque that leaves in this job (N m).
    pub applied_nm: [f64; N],
    /// Whether the brakes are to be off.
    pub moves: bool,
    /// Period of the job (s).
    pub period_s: f64,
    /// What the fingertip touches.
    pub touch: Touch,
}

/// Readings are compared at this distance or a little less (s); a faster lane leaves some out.
const SAMPLE_DISTANCE_S: f64 = 2.5e-3;

/// For how long a new contact may push motors (s): until then the finger swings on the rubber.
const PUSHED_WITHIN_S: f64 = 0.5;

/// What is kept of the last job.
#[derive(Clone, Copy, Debug)]
struct LastJob<const N: usize> {
    /// Desired angles (rad), and the zero that they count from.
    desired_rad: JointVector<N>,
    datum: u32,
}

/// What is kept of the last reading that was compared.
#[derive(Clone, Copy, Debug)]
struct LastReading<const N: usize> {
    counts: [i32; N],
    /// Measured minus desired angles (counts), without a step where the zero moved.
    departure: JointVector<N>,
    datum: u32,
    /// What is added to the departure for the zeros that moved (counts).
    offset: JointVector<N>,
    /// Torques of the motors that were commanded then (N m).
    torque_nm: JointVector<N>,
    /// Jobs since.
    age: u32,
}

/// The monitor with its memory.
#[derive(Debug)]
pub struct Monitor<const N: usize, L> {
    model: MotorModel<N, L>,
    runaway: RunawayDetector<N>,
    push: ContactPush<N>,
    contact: ContactAge,
    runaway_detection: bool,
    stuck: StuckEncoderDetector<N>,
    hidden: HiddenMotionDetector<N>,
    turns: HiddenTurnDetector<N>,
    q_min_rad: JointVector<N>,
    q_max_rad: JointVector<N>,
    job: Option<LastJob<N>>,
    reading: Option<LastReading<N>>,
}

impl<const N: usize, L> Fold for Monitor<N, L> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.runaway).add(&self.stuck).add(&self.job.map(|job| job.datum));
        hash.add(&self.reading.map(|reading| (reading.age, reading.datum)));
    }
}

impl<const N: usize, L: ArmDynamics<N>> Monitor<N, L> {
    /// A monitor of this robot that has seen nothing; joints may be `margin_rad` beyond their
    /// limits.
    #[must_use]
    pub fn new<A: Arm<N, Dynamics = L>>(robot: &Robot<N, A>, margin_rad: f64) -> Monitor<N, L> {
        Monitor {
            model: MotorModel::new(robot),
            runaway: RunawayDetector::new(),
            push: ContactPush::new(&robot.arm, &robot.gears),
            contact: ContactAge::new(),
            runaway_detection: true,
            stuck: StuckEncoderDetector::new(&levers_m(robot), &pad_torques_nm(robot)),
            hidden: HiddenMotionDetector::new(&robot.arm, &robot.gears),
            turns: HiddenTurnDetector::new(&robot.arm, &robot.gears),
            q_min_rad: robot.arm.q_min().add_scalar(-margin_rad),
            q_max_rad: robot.arm.q_max().add_scalar(margin_rad),
            job: None,
            reading: None,
        }
    }

    /// The same monitor, which finds motors that run away only if asked to.
    #[must_use]
    pub fn with_runaway_detection(mut self, on: bool) -> Monitor<N, L> {
        self.runaway_detection = on;
        self
    }

    /// Forgets the past: the drives are off.
    pub fn reset(&mut self) {
        self.job = None;
        self.forget_readings();
    }

    fn forget_readings(&mut self) {
        self.runaway.reset();
        self.stuck.reset();
        self.hidden.reset();
        self.turns.reset();
        self.reading = None;
    }

    /// Takes one job with open gate.
    ///
    /// # Errors
    /// [`FaultCode::Runaway`] for a motor that departs ever faster against its torque,
    /// [`FaultCode::StuckEncoder`] for one that stands still under its torque,
    /// [`FaultCode::JointLimit`] for a joint beyond its limits, and [`FaultCode::FollowingError`]
    /// for a joint outside its window.
    pub fn update(
        &mut self,
        seen: &Observation<N>,
        window: &FollowingWindow<N>,
    ) -> Result<(), FaultCode> {
        self.compare_motors(seen)?;
        let desired_rad_s = self.desired_speed(seen);
        let q_rad = &seen.joints.q_rad;
        let inside = |i: usize| (self.q_min_rad[i]..=self.q_max_rad[i]).contains(&q_rad[i]);
        if seen.joints.calibrated == 1 && !(0..N).all(inside) {
            return Err(FaultCode::JointLimit);
        }
        match window.contains(&seen.error_rad, &desired_rad_s.into()) {
            true => Ok(()),
            false => Err(FaultCode::FollowingError),
        }
    }

    /// The speeds of the desired joints since the last job (rad/s); zero where the zero of their
    /// angles has moved.
    fn desired_speed(&mut self, seen: &Observation<N>) -> JointVector<N> {
        let desired_rad = JointVector::from(seen.joints.q_rad) + JointVector::from(seen.error_rad);
        let datum = seen.joints.datum;
        let last = self.job.replace(LastJob { desired_rad, datum });
        match last.filter(|last| last.datum == datum) {
            Some(last) => (desired_rad - last.desired_rad) / seen.period_s,
            None => JointVector::zeros(),
        }
    }

    /// Measured minus desired angles of the motors, without a step where the zero moved, and what
    /// has been added to them for that (counts).
    fn departure(&self, seen: &Observation<N>) -> (JointVector<N>, JointVector<N>) {
        let joints = &seen.joints;
        let mut departure = -self.model.counts(&JointVector::from(seen.error_rad));
        let mut offset = self.reading.map_or(JointVector::zeros(), |last| last.offset);
        departure += offset;
        if let Some(last) = self.reading.filter(|last| last.datum != joints.datum) {
            // The desired angles moved with the zero; the arm is where its counts say.
            for i in 0..N {
                let turned = f64::from(joints.counts[i].wrapping_sub(last.counts[i]));
                offset[i] += last.departure[i] + turned - departure[i];
                departure[i] = last.departure[i] + turned;
            }
        }
        (departure, offset)
    }

    /// Compares the motion of the motors with their torques. Readings that are missing break the
    /// comparison off.
    fn compare_motors(&mut self, seen: &Observation<N>) -> Result<(), FaultCode> {
        if !(seen.moves && seen.is_new) {
            self.forget_readings();
            return Ok(());
        }
        let joints = &seen.joints;
        let distance = (SAMPLE_DISTANCE_S / seen.period_s).floor().max(1.0);
        if let Some(last) =
            self.reading.as_mut().filter(|last| f64::from(last.age) + 1.0 < distance)
        {
            last.age += 1;
            return Ok(());
        }
        let (departure, offset) = self.departure(seen);
        let motion = Motion {
            q_rad: joints.q_rad,
            qd_rad_s: joints.qd_rad_s,
            calibrated: joints.calibrated == 1,
        };
        let after_s = seen.period_s * distance;
        let load = self.model.load(&motion, after_s);
        let (counts, datum) = (joints.counts, joints.datum);
        let torque_nm = self.model.motor_torque(&seen.applied_nm);
        let before = self.reading.replace(LastReading {
            counts,
            departure,
            datum,
            offset,
            torque_nm,
            age: 0,
        });
        let has_jumped = self.contact.update(seen.touch.place_m(), after_s);
        let side = |i: usize| self.push.side(&motion.q_rad, i);
        let pushed_side = |i: usize| if motion.calibrated { side(i) } else { 0.0 };
        let is_new = self.contact.age_s() <= PUSHED_WITHIN_S;
        let contact = MotorContact { pushed_side: &pushed_side, is_new };
        let contact = self.contact.lasts().then_some(contact);
        let runaway = self.runaway.update(counts, departure, &load, contact);
        self.runaway.command(torque_nm);
        if self.runaway_detection && runaway.is_some() {
            return Err(FaultCode::Runaway);
        }
        let Some(before) = before else { return Ok(()) };
        let is_touching = seen.touch.place_m().is_some();
        let stuck =
            self.stuck.update(&counts, &departure, &before.torque_nm, &load, after_s, is_touching);
        let acceleration = self.runaway.acceleration();
        let reading = Reading {
            counts: &counts,
            q_rad: &joints.q_rad,
            calibrated: motion.calibrated,
            torque_nm: &before.torque_nm,
            acceleration: &acceleration,
            touch: seen.touch,
            has_jumped,
            after_s,
        };
        let hidden = self.hidden.update(&reading, &load);
        let turned = self.turns.update(&reading, &load);
        stuck.or(hidden).or(turned).map_or(Ok(()), |_| Err(FaultCode::StuckEncoder))
    }
}

/// Levers of what the arm touches about the axes of the joints (m): the larger one of that in the
/// nominal pose and that with the joints behind it a quarter turn further.
fn levers_m<const N: usize, A: Arm<N>>(robot: &Robot<N, A>) -> [f64; N] {
    core::array::from_fn(|i| {
        let lever_m = |behind_rad: f64| {
            let mut q = robot.nominal_rad;
            (i + 1..N).for_each(|j| q[j] += behind_rad);
            robot.arm.touch_lever_m(i, &q)
        };
        lever_m(0.0).max(lever_m(core::f64::consts::FRAC_PI_2))
    })
}

/// Largest torques of the motors that the pad of a fingertip takes (N m).
fn pad_torques_nm<const N: usize, A: Arm<N>>(robot: &Robot<N, A>) -> [f64; N] {
    core::array::from_fn(|i| {
        let mut moment = JointVector::zeros();
        moment[i] = PAD_MOMENT_MAX_NM;
        robot.gears.motor_torque(&moment)[i].abs()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::chain::{Chain, JointSpec};
    use taktil_mechanics::friction::Friction;
    use taktil_mechanics::hand::Hand;
    use taktil_mechanics::rigid_body::Body;
    use taktil_mechanics::spatial::{rotation_z, to_glam_vector};
    use taktil_mechanics::transmission::{Drive, Transmission};
    use taktil_mechanics::{Joints, Pose};
    use taktil_rtcore::Payload;

    const PERIOD_S: f64 = 2.5e-3;
    const WINDOW: FollowingWindow = FollowingWindow { floor_rad: [0.1; 6], gain_s: 0.05 };

    fn monitor() -> Monitor<6, taktil_mechanics::puma260::dynamics::Dynamics> {
        Monitor::new(&Robot::puma260(), 0.02)
    }

    /// Joint 4 measured at `q_rad` and desired at `desired_rad`, without torque.
    fn seen(q_rad: f64, desired_rad: f64, datum: u32) -> Observation {
        let mut joints = JointState { datum, ..JointState::ZERO };
        joints.q_rad[3] = q_rad;
        joints.counts = Robot::puma260().gears.counts(&Joints::from(joints.q_rad));
        let mut error_rad = [0.0; 6];
        error_rad[3] = desired_rad - q_rad;
        let applied_nm = [0.0; 6];
        Observation {
            joints,
            is_new: true,
            error_rad,
            applied_nm,
            moves: true,
            period_s: PERIOD_S,
            touch: Touch::Unknown,
        }
    }

    #[test]
    fn the_window_grows_with_the_desired_speed_and_not_with_the_measured_one() {
        let speed_rad_s = 1.0;
        let at = |tick: i32| speed_rad_s * PERIOD_S * f64::from(tick);
        // The joint stands: it may be 0.05 s behind the motion that it is asked for.
        let mut asked = monitor();
        let left = (0..200).find(|tick| asked.update(&seen(0.0, at(*tick), 0), &WINDOW).is_err());
        assert_eq!(left, Some(61), "0.15 rad");
        // It runs, though nothing is asked for.
        let mut runs = monitor();
        let left = (0..200).find(|tick| runs.update(&seen(at(*tick), 0.0, 0), &WINDOW).is_err());
        assert_eq!(left, Some(41), "0.1 rad");
    }

    #[test]
    fn a_zero_that_moves_is_no_speed_and_no_departure() {
        let mut monitor = monitor();
        for tick in 0..40 {
            let (zero, datum) = if tick < 20 { (0.0, 0) } else { (-1.3, 1) };
            let mut now = seen(0.0, 0.001, 0);
            now.joints.q_rad[3] = zero;
            now.joints.datum = datum;
            assert_eq!(monitor.update(&now, &WINDOW), Ok(()));
            let departure = monitor.reading.unwrap().departure[3];
            assert!((departure + 0.001 * 43.5111 * 800.0 / core::f64::consts::TAU).abs() < 1e-9);
        }
    }

    #[test]
    fn a_calibrated_joint_beyond_its_limits_is_a_fault() {
        let robot = Robot::puma260();
        for (edge, out) in [(robot.arm.q_max_rad[3], 1.0), (robot.arm.q_min_rad[3], -1.0)] {
            for (beyond, calibrated, expected) in [
                (0.019, 1, Ok(())),
                (0.021, 1, Err(FaultCode::JointLimit)),
                (1.0, 0, Ok(())),
                (f64::NAN, 1, Err(FaultCode::JointLimit)),
            ] {
                let place = edge + out * beyond;
                let mut now = seen(place, place, 0);
                now.error_rad = [0.0; 6];
                now.joints.calibrated = calibrated;
                assert_eq!(monitor().update(&now, &WINDOW), expected, "{out} {beyond}");
            }
        }
    }

    #[test]
    fn only_the_last_axis_of_the_puma_passes_through_its_tool() {
        let levers_m = levers_m(&Robot::puma260());
        assert!(levers_m[..5].iter().all(|lever| *lever > 0.18), "{levers_m:?}");
        assert!(levers_m[5] < 1e-9, "{levers_m:?}");
    }

    /// Two fingers of three joints, face to face.
    fn fingers() -> Robot<6, Hand<2, 6>> {
        let vector = |x: f64, y: f64, z: f64| to_glam_vector(&[x, y, z].into());
        let finger = |azimuth_rad: f64| {
            let base = rotation_z(azimuth_rad);
            let joint = |origin: Pose, axis: [f64; 3]| JointSpec {
                origin,
                axis: to_glam_vector(&axis.into()),
                body: Body::diagonal(0.05, [0.0, 0.0, -0.03], [2e-5, 2e-5, 2e-6]),
                reflected_inertia: 4e-3,
                speed_max: 5.0,
                effort_max: 2.0,
                ..JointSpec::default()
            };
            let at = |z| Pose::new(rotation_z(0.0), vector(0.0, 0.0, z));
            let (x, y) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
            let root = Pose::new(base, base * vector(0.005, 0.0, 0.0));
            let joints = [joint(root, x), joint(at(0.0), y), joint(at(-0.065), y)];
            Chain::new(&joints, &at(-0.05)).unwrap()
        };
        let arm = Hand::new([finger(0.0), finger(core::f64::consts::PI)]).unwrap();
        let all = Joints::repeat;
        let home = Joints::from_fn(|i, _| [0.0, -0.7, 0.7][i % 3]);
        Robot {
            torque_max_nm: *arm.effort_max(),
            dynamics: arm,
            arm,
            gears: Transmission::uncoupled(&all(10.0), &all(16384.0)),
            drive: Drive { torque_constant_nm_a: all(0.1), current_max_a: all(2.0), dac_bits: 16 },
            friction: Friction { coulomb_nm: all(0.002), viscous_nms_rad: all(0.005) },
            home_rad: home,
            nominal_rad: home,
            joint_names: Vec::new(),
        }
    }

    /// The job in which a joint of a finger that stands is taken for one with a stuck encoder; it
    /// is asked for so much motion (rad/s) and pulled by a servo.
    fn found(joint: usize, asked_rad_s: f64) -> Option<i32> {
        const SERVO_NM_RAD: f64 = 28.0;
        let robot = fingers();
        let mut monitor = Monitor::new(&robot, 0.02);
        let hold_nm = robot.dynamics.gravity_torque(&robot.home_rad);
        (0..200).find(|job| {
            let q_rad: [f64; 6] = robot.home_rad.into();
            let joints = JointState { calibrated: 1, datum: 1, q_rad, ..JointState::ZERO };
            let mut error_rad = [0.0; 6];
            error_rad[joint] = asked_rad_s * PERIOD_S * f64::from(*job);
            let servo_nm = Joints::from(error_rad) * SERVO_NM_RAD;
            let applied_nm = (hold_nm + servo_nm).into();
            let seen = Observation {
                joints,
                is_new: true,
                error_rad,
                applied_nm,
                moves: true,
                period_s: PERIOD_S,
                touch: Touch::Unknown,
            };
            match monitor.update(&seen, &WINDOW) {
                Ok(()) => false,
                Err(fault) => {
                    assert_eq!(fault, FaultCode::StuckEncoder);
                    true
                }
            }
        })
    }

    /// A finger that grips harder and harder is asked for motion while it hardly moves: 5 mrad in
    /// 0.1 s, as the law of a grasp asks it of a finger against an object of 36 mm.
    #[test]
    fn a_finger_that_presses_is_not_stuck_whichever_finger_it_is() {
        for joint in 0..6 {
            assert_eq!(found(joint, 0.05), None, "joint {}", joint + 1);
            assert!(found(joint, 0.2).is_some(), "joint {}", joint + 1);
        }
    }

    #[test]
    fn a_fast_lane_leaves_readings_out() {
        let mut monitor = monitor();
        let compared = |monitor: &mut Monitor<_, _>| {
            let mut now = seen(0.0, 0.0, 0);
            now.period_s = 1e-3;
            monitor.update(&now, &WINDOW).unwrap();
            monitor.reading.unwrap().age == 0
        };
        let pattern: Vec<bool> = (0..6).map(|_| compared(&mut monitor)).collect();
        assert_eq!(pattern, [true, false, true, false, true, false]);
    }
}
