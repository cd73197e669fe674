//! The stage before drives that close a loop themselves: the target of each motor from the desired
//! joints, and what is wanted of the power sections. Enabling, a stop by the drive's own ramp, and
//! the reset of faults are three separate acts here as well.
//!
//! - Torque: the codes of the last gate, as for converters.
//! - Velocity: `v = v_desired + k e`, limited at each joint, where `v_desired` is the change of the
//!   desired angle since the job before and `e` the error of the angle.
//! - Position: the counts that were measured plus those of the error, which are the counts of the
//!   desired angle whatever the zero of the angles is. What follows the arm when the drives are off
//!   starts from where the arm is.

use taktil_hal::{CHANNELS, DriveCommand, DriveLoop, DriveOut, DriveRequest, Error, Nanos};
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::transmission::Transmission;
use taktil_rtcore::{FaultCode, Fold, Input, Mode, StateHash};
use taktil_signal::{Drives, JointState, Torque};

/// A target velocity may be this multiple of the joint's largest speed.
const SPEED_MARGIN: f64 = 1.5;

/// What the stage needs to know of the arm and of its settings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StageSettings<const N: usize> {
    pub(crate) gears: Transmission<N>,
    /// Largest speeds of the joints (rad/s).
    pub(crate) speed_max_rad_s: JointVector<N>,
    /// Speed for an error of the angle (1/s).
    pub(crate) position_gain_1_s: f64,
    /// How long drives may stop by their own ramp.
    pub(crate) quick_stop: Nanos,
}

/// Targets of the motors, and which joints were limited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Targets<const N: usize> {
    pub(crate) words: [i32; N],
    /// Bit j is set when joint j was limited.
    pub(crate) limited: u32,
}

/// The desired angles of the job before, and the zero that they count from.
#[derive(Clone, Copy, Debug)]
struct LastDesired<const N: usize> {
    desired_rad: JointVector<N>,
    datum: u32,
}

/// The stage with its half.
pub(crate) struct DriveStage<const N: usize> {
    half: Box<dyn DriveOut>,
    control_loop: DriveLoop,
    settings: StageSettings<N>,
    pub(crate) reports: Input<Drives<N>>,
    last_desired: Option<LastDesired<N>>,
    /// How long drives that followed may still stop by their own ramp.
    stop_left: Nanos,
    /// The faults of the drives are to be reset: a person has acknowledged the fault.
    resets: bool,
    was_fault: bool,
}

impl<const N: usize> Fold for DriveStage<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.stop_left).add(&self.resets).add(&self.was_fault);
        hash.add(&self.last_desired.map(|last| last.datum));
        if let Some(last) = &self.last_desired {
            hash.add(last.desired_rad.as_slice());
        }
    }
}

impl<const N: usize> DriveStage<N> {
    pub(crate) fn new(
        half: Box<dyn DriveOut>,
        settings: StageSettings<N>,
        reports: Input<Drives<N>>,
    ) -> DriveStage<N> {
        DriveStage {
            control_loop: half.control_loop(),
            half,
            settings,
            reports,
            last_desired: None,
            stop_left: Nanos::ZERO,
            resets: false,
            was_fault: false,
        }
    }

    /// The loop that the drives close.
    pub(crate) fn control_loop(&self) -> DriveLoop {
        self.control_loop
    }

    /// Forgets the desired angles: torque is not allowed.
    pub(crate) fn forget(&mut self) {
        self.last_desired = None;
    }

    /// The targets of drives that close the loop of the velocity or of the position, from the
    /// measured joints and the error that belongs to them.
    ///
    /// # Errors
    /// [`FaultCode::NotFinite`] for an angle or an error that is NaN or infinite.
    pub(crate) fn targets(
        &mut self,
        torque: &Torque<N>,
        joints: &JointState<N>,
        period_s: f64,
    ) -> Result<Targets<N>, FaultCode> {
        let error_rad = JointVector::from(torque.error_rad);
        let desired_rad = JointVector::from(joints.q_rad) + error_rad;
        if !desired_rad.iter().all(|angle| angle.is_finite()) {
            self.forget();
            return Err(FaultCode::NotFinite);
        }
        let now = LastDesired { desired_rad, datum: joints.datum };
        let last = self.last_desired.replace(now).filter(|last| last.datum == joints.datum);
        if self.control_loop == DriveLoop::Velocity {
            let moved = last.map_or(JointVector::zeros(), |last| desired_rad - last.desired_rad);
            return Ok(self.velocities(&(moved / period_s), &error_rad));
        }
        let ahead = self.settings.gears.counts(&error_rad);
        let words = core::array::from_fn(|i| joints.counts[i].wrapping_add(ahead[i]));
        Ok(Targets { words, limited: 0 })
    }

    /// Velocities of the motors (counts/s).
    fn velocities(&self, desired_rad_s: &JointVector<N>, error_rad: &JointVector<N>) -> Targets<N> {
        let mut limited = 0;
        let velocity = JointVector::from_fn(|i, _| {
            let asked = desired_rad_s[i] + self.settings.position_gain_1_s * error_rad[i];
            let most = SPEED_MARGIN * self.settings.speed_max_rad_s[i];
            limited |= u32::from(asked.abs() > most) << i;
            asked.clamp(-most, most)
        });
        Targets { words: self.settings.gears.counts(&velocity), limited }
    }

    /// Notes the mode: faults of the drives are reset when a person has reset the fault of the
    /// machine, and until the drives are wanted again.
    pub(crate) fn note_mode(&mut self, mode: Mode) {
        let is_fault = mode == Mode::Fault;
        self.resets = !is_fault && (self.resets || self.was_fault) && !mode.torque_allowed();
        self.was_fault = is_fault;
    }

    /// What is wanted of the power sections in a job of `period`.
    fn request(&mut self, follows: bool, is_suspect: bool, period: Nanos) -> DriveRequest {
        if follows {
            self.stop_left = self.settings.quick_stop;
            return DriveRequest::Follow;
        }
        if is_suspect {
            self.stop_left = Nanos::ZERO;
        }
        let stops = self.stop_left > Nanos::ZERO;
        self.stop_left = (self.stop_left - period).max(Nanos::ZERO);
        if stops { DriveRequest::QuickStop } else { DriveRequest::Off }
    }

    /// Puts targets out; `is_suspect` when a motor runs away or its encoder cannot be trusted.
    pub(crate) fn commit(
        &mut self,
        release: Nanos,
        words: &[i32; N],
        wanted: Wanted,
    ) -> Result<(), Error> {
        let request = self.request(wanted.follows, wanted.is_suspect, wanted.period);
        let mut targets = [0; CHANNELS];
        for (target, word) in targets.iter_mut().zip(words) {
            *target = *word;
        }
        let command = DriveCommand { targets, request, reset: self.resets };
        self.half.commit(release, &command)
    }

    /// No torque, at once.
    pub(crate) fn safe(&mut self) -> Result<(), Error> {
        self.stop_left = Nanos::ZERO;
        self.half.safe()
    }
}

/// What a job wants of the drives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wanted {
    /// They are to follow their targets.
    pub(crate) follows: bool,
    /// A motor or its encoder cannot be trusted: no stop by the drive's own loop.
    pub(crate) is_suspect: bool,
    /// Period of the job.
    pub(crate) period: Nanos,
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_hal::link::{Receiver, Sender, link};
    use taktil_mechanics::arm::Arm;
    use taktil_mechanics::robot::Robot;
    use taktil_rtcore::{Builder, Invalid, LaneSpec};

    const JOB_PERIOD: Nanos = Nanos::from_micros(2_500);

    type Drives6 = taktil_signal::Drives<6>;

    struct Bus(Sender<DriveCommand>, DriveLoop);

    impl DriveOut for Bus {
        fn channels(&self) -> usize {
            6
        }
        fn control_loop(&self) -> DriveLoop {
            self.1
        }
        fn target_range(&self) -> (i32, i32) {
            (i32::MIN, i32::MAX)
        }
        fn commit(&mut self, release: Nanos, command: &DriveCommand) -> Result<(), Error> {
            self.0.send(*command, release, release).expect("the test reads");
            Ok(())
        }
        fn safe(&mut self) -> Result<(), Error> {
            Ok(())
        }
        fn longest_silence(&self) -> Nanos {
            Nanos::from_millis(10)
        }
    }

    /// An input that nothing reads.
    fn reports() -> Input<Drives6> {
        let mut builder = Builder::new();
        let lane = builder.lane(LaneSpec::new("servo", JOB_PERIOD, 80)).unwrap();
        let mut input = None;
        let made = builder.task(lane, "actuate", |ports| {
            input = Some(ports.input("drives"));
            Err(Invalid::new("", "no task is made", "the input is what is needed"))
        });
        assert!(made.is_err());
        input.unwrap()
    }

    fn stage(control_loop: DriveLoop) -> (DriveStage<6>, Receiver<DriveCommand>) {
        let robot = Robot::puma260();
        let (to, from) = link(64);
        let settings = StageSettings {
            gears: robot.gears,
            speed_max_rad_s: *robot.arm.speed_max(),
            position_gain_1_s: 10.0,
            quick_stop: JOB_PERIOD * 3,
        };
        (DriveStage::new(Box::new(Bus(to, control_loop)), settings, reports()), from)
    }

    fn joints(counts: [i32; 6], datum: u32) -> JointState {
        let q_rad = Robot::puma260().gears.joints(&counts).into();
        JointState { q_rad, counts, datum, ..JointState::default() }
    }

    fn error(rad: f64) -> Torque {
        Torque { error_rad: [rad; 6], ..Torque::default() }
    }

    #[test]
    fn a_position_is_where_the_motor_is_plus_the_error_whatever_the_zero() {
        let (mut stage, _from) = stage(DriveLoop::Position);
        let at = joints([5, -7, i32::MAX, 0, 1, 2], 0);
        let here = stage.targets(&error(0.0), &at, 2.5e-3).unwrap();
        assert_eq!((here.words, here.limited), (at.counts, 0), "nothing jumps at the start");
        let ahead = Robot::puma260().gears.counts(&JointVector::<6>::repeat(0.01));
        let moved = stage.targets(&error(0.01), &at, 2.5e-3).unwrap();
        let places = at.counts.iter().zip(ahead).map(|(here, ahead)| here.wrapping_add(ahead));
        assert!(places.eq(moved.words.iter().copied().take(6)), "it wraps as counts do");
        for bad in [f64::NAN, f64::INFINITY] {
            let refused = stage.targets(&error(bad), &at, 2.5e-3);
            assert_eq!(refused, Err(FaultCode::NotFinite));
        }
    }

    #[test]
    fn a_velocity_is_that_of_the_desired_angle_and_of_the_error_within_its_limit() {
        let (mut stage, _from) = stage(DriveLoop::Velocity);
        let gears = Robot::puma260().gears;
        let at = joints([0; 6], 0);
        let first = stage.targets(&error(0.01), &at, 2.5e-3).unwrap();
        assert_eq!(first.words, gears.counts(&JointVector::<6>::repeat(0.1)), "no step is a speed");
        let next = stage.targets(&error(0.0105), &at, 2.5e-3).unwrap();
        assert_eq!(next.words, gears.counts(&JointVector::<6>::repeat(0.2 + 0.105)));
        let new_zero = stage.targets(&error(0.01), &joints([0; 6], 1), 2.5e-3).unwrap();
        assert_eq!(new_zero.words, first.words, "a zero that moves is no speed");
        let fast = stage.targets(&error(3.0), &joints([0; 6], 1), 2.5e-3).unwrap();
        let most = *Robot::puma260().arm.speed_max() * SPEED_MARGIN;
        assert_eq!((fast.words, fast.limited), (gears.counts(&most), 0b11_1111));
    }

    #[test]
    fn drives_stop_by_their_ramp_and_go_off_and_at_once_when_a_motor_is_suspect() {
        let requests = |is_suspect: bool| {
            let (mut stage, mut from) = stage(DriveLoop::Position);
            let mut seen = Vec::new();
            for job in 0..7 {
                let wanted = Wanted {
                    follows: (1..3).contains(&job),
                    is_suspect: is_suspect && job == 3,
                    period: JOB_PERIOD,
                };
                stage.commit(JOB_PERIOD * job, &[0; 6], wanted).unwrap();
                seen.push(from.newest(Nanos::MAX).unwrap().value.request);
            }
            seen
        };
        use DriveRequest::{Follow, Off, QuickStop};
        assert_eq!(requests(false), [Off, Follow, Follow, QuickStop, QuickStop, QuickStop, Off]);
        assert_eq!(requests(true), [Off, Follow, Follow, Off, Off, Off, Off]);
    }

    #[test]
    fn only_leaving_a_fault_resets_the_drives_and_until_they_are_wanted() {
        let (mut stage, _from) = stage(DriveLoop::Position);
        let course = [
            (Mode::Off, false),
            (Mode::Checking, false),
            (Mode::Ready, false),
            (Mode::Enabling, false),
            (Mode::Hold, false),
            (Mode::Fault, false),
            (Mode::Fault, false),
            (Mode::Checking, true),
            (Mode::Ready, true),
            (Mode::Enabling, false),
            (Mode::Stopping, false),
            (Mode::Ready, false),
        ];
        for (step, (mode, resets)) in course.into_iter().enumerate() {
            stage.note_mode(mode);
            assert_eq!(stage.resets, resets, "step {step}, {mode:?}");
        }
    }
}
