//! The task that drives the motors, as the last stage of the servo lane: it writes torques to the
//! boards, or targets to drives that close a loop themselves. It limits the
//! torque, checks that it is finite, that the mode allows it and that each joint follows within its
//! window, and it sets the enable and brake lines and feeds the watchdog. A motor that runs away
//! takes enable and brakes with it in the same job. A torque that is more than one job old is not
//! passed on. The boards are left in their safe state when the task stops, when it is dropped, and
//! when one of them fails.
//!
//! - In: `torque`, `control`, `joints`, and `drives` with drives that close a loop.
//! - Out: `applied`; the D/A board or the drives, and the digital outputs.
//! - Rate: every job of the servo lane, 400 Hz; it stands last in the lane.
//! - Source: the gears and drives of the arm that the robot description gives.

mod config;
mod contact_age;
mod contact_push;
mod drive_stage;
pub mod hidden_motion;
pub mod hidden_turn;
pub mod law;
pub mod monitor;
mod motors;
pub mod runaway;
pub mod stuck_encoder;

use taktil_hal::{DigitalOut, DriveLoop, LinesOut};
use taktil_mechanics::arm::{Arm, ArmDynamics};
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::fault::Class;
use taktil_rtcore::{
    Cycle, FaultCode, Freshness, Input, Invalid, Io, Mode, Nanos, Output, Param, Ports, StateHash,
    Task,
};
use taktil_signal::{Applied, ControlState, Features, JOINTS_MAX, JointState, Torque, defined};

pub use config::{Config, LoopName};
pub use motors::Motors;

use drive_stage::{DriveStage, StageSettings, Wanted};
use hidden_motion::Touch;
use law::{Command, FollowingWindow, Gate, Law, gate};
use monitor::{Monitor, Observation};
use motors::{MotorStage, WriteFailurePolicy};

/// The window's growth may be edited up to this at least, s.
const FOLLOWING_GAIN_MAX_S: f64 = 0.2;

/// Features of touch that are older say nothing of the contact: four periods of an array.
const TOUCH_AGE_MAX: Nanos = Nanos::from_millis(20);

/// From where the task knows what the fingertip touches.
enum TouchSource {
    Nothing(Touch),
    /// The features, and the distances of the columns and rows that they count in (m).
    Features {
        features: Input<Features>,
        pitch_m: [f64; 2],
    },
}

impl TouchSource {
    fn touch(&self, io: &mut Io<'_>) -> Touch {
        let TouchSource::Features { features, pitch_m } = self else {
            let TouchSource::Nothing(touch) = self else { return Touch::Unknown };
            return *touch;
        };
        io.read(features).usable().map_or(Touch::Unknown, |features| felt(&features, *pitch_m))
    }
}

/// What features say of the contact, of an array with these distances of its columns and rows (m).
fn felt(features: &Features, pitch_m: [f64; 2]) -> Touch {
    let is_set = |bit: u32| features.defined & bit != 0;
    match (is_set(defined::CONTACT), is_set(defined::CENTROID)) {
        (false, _) if is_set(defined::CONTACT_UNCERTAIN) => Touch::Unknown,
        (false, _) => Touch::Free,
        (true, false) => Touch::Unknown,
        (true, true) => Touch::Contact {
            x_m: features.x_c * pitch_m[0],
            y_m: features.y_c * pitch_m[1],
            yaw_rad: is_set(defined::THETA_Z).then_some(features.theta_z_rad),
        },
    }
}

/// The parameters of the window of the following error.
#[derive(Clone, Copy, Debug)]
struct WindowParameters<const N: usize> {
    floor_deg: [Param; N],
    gain_s: Param,
    /// Values when the parameters were read last.
    last_values: ([f64; N], f64),
}

impl<const N: usize> WindowParameters<N> {
    fn new(config: &Config, floor_deg: [f64; N], ports: &mut Ports) -> WindowParameters<N> {
        let gain_max_s = (4.0 * config.following_gain_s).max(FOLLOWING_GAIN_MAX_S);
        WindowParameters {
            floor_deg: ports.tunables("following_floor_deg", floor_deg),
            gain_s: ports.parameter("following_gain_s", config.following_gain_s, 0.0..=gain_max_s),
            last_values: (floor_deg, config.following_gain_s),
        }
    }

    /// The window after an edit; nothing when there was none.
    fn changed(&mut self, io: &Io<'_>) -> Option<FollowingWindow<N>> {
        let now = (io.parameters(&self.floor_deg), io.parameter(self.gain_s));
        if now == self.last_values {
            return None;
        }
        self.last_values = now;
        Some(FollowingWindow { floor_rad: now.0.map(f64::to_radians), gain_s: now.1 })
    }
}

/// The task.
pub struct Actuate<const N: usize = 6, L: ArmDynamics<N> = Dynamics> {
    motors: MotorStage<N>,
    digital: Box<dyn DigitalOut>,
    law: Law<N>,
    window: FollowingWindow<N>,
    monitor: Monitor<N, L>,
    window_parameters: WindowParameters<N>,
    safe: Command<N>,
    motor_failures: WriteFailurePolicy,
    digital_failures: WriteFailurePolicy,
    feed: bool,
    torque: Input<Torque<N>>,
    control: Input<ControlState>,
    joints: Input<JointState<N>>,
    touch: TouchSource,
    applied: Output<Applied<N>>,
}

impl<const N: usize, L: ArmDynamics<N>> Actuate<N, L> {
    /// Declares the ports: in `torque`, `control`, `joints` and, with drives that close a loop,
    /// `drives`; out `applied`; the parameters `following_floor_deg` (one a joint) and
    /// `following_gain_s`.
    ///
    /// # Errors
    /// What [`Config::check`] refuses, a D/A board or drives with fewer channels than joints or a
    /// narrower range than the drives' codes, and drives that close another loop than
    /// [`Config::drive_loop`].
    pub fn new<A: Arm<N, Dynamics = L>>(
        config: Config,
        robot: &Robot<N, A>,
        motors: Motors,
        digital: Box<dyn DigitalOut>,
        ports: &mut Ports,
    ) -> Result<Actuate<N, L>, Invalid> {
        config.check()?;
        motors.check(&robot.drive, config.drive_loop)?;
        let floor_deg = config.floor_deg()?;
        let law = Law::new(robot.gears, robot.drive, config.limit_nm(robot)?)
            .with_zero(config.zero(&robot.drive)?);
        let safe_word = motors.safe_word();
        let safe = Command { codes: [safe_word; N], tau_nm: law.torque_of(safe_word), limited: 0 };
        let policy = WriteFailurePolicy { allowed: config.failures_max, failed: 0 };
        let window_parameters = WindowParameters::new(&config, floor_deg, ports);
        let monitor = Monitor::new(robot, config.limit_margin_deg.to_radians())
            .with_runaway_detection(config.runaway_detection);
        let (torque, control, joints) =
            (ports.input("torque"), ports.input("control"), ports.input("joints"));
        let motors = match motors {
            Motors::Converters(half) => MotorStage::Converters(half),
            Motors::Drives(half) => {
                let settings = StageSettings {
                    gears: robot.gears,
                    speed_max_rad_s: *robot.arm.speed_max(),
                    position_gain_1_s: config.position_gain_1_s,
                    quick_stop: duration(config.quick_stop_s),
                };
                MotorStage::Drives(DriveStage::new(half, settings, ports.input("drives")))
            }
        };
        Ok(Actuate {
            window_parameters,
            motors,
            digital,
            law,
            window: FollowingWindow {
                floor_rad: floor_deg.map(f64::to_radians),
                gain_s: config.following_gain_s,
            },
            monitor,
            safe,
            motor_failures: policy,
            digital_failures: policy,
            feed: false,
            torque,
            control,
            joints,
            touch: TouchSource::Nothing(Touch::Unknown),
            applied: ports.output("applied"),
        })
    }

    /// The same task, which goes by what the fingertip feels where a joint may be held by what is
    /// touched: it declares the input `features`, whose columns and rows are `pitch_m` apart (m).
    #[must_use]
    pub fn with_touch(mut self, pitch_m: [f64; 2], ports: &mut Ports) -> Actuate<N, L> {
        let features = ports.input_within("features", TOUCH_AGE_MAX);
        self.touch = TouchSource::Features { features, pitch_m };
        self
    }

    /// The same task of an arm that presses against nothing.
    #[must_use]
    pub fn without_touch(mut self) -> Actuate<N, L> {
        self.touch = TouchSource::Nothing(Touch::Absent);
        self
    }

    /// The words for a torque, and whether the brakes may be lifted: drives have to follow first.
    fn command(
        &mut self,
        torque: &Torque<N>,
        joints: &JointState<N>,
        cycle: &Cycle,
        io: &mut Io<'_>,
    ) -> Result<(Command<N>, bool), FaultCode> {
        let allowed = self.law.command(&torque.tau_nm)?;
        let MotorStage::Drives(stage) = &mut self.motors else { return Ok((allowed, true)) };
        let reports = io.read(&stage.reports).usable();
        let is_ready = reports.is_some_and(|reports| reports.all_follow());
        if stage.control_loop() == DriveLoop::Torque {
            return Ok((allowed, is_ready));
        }
        let targets = stage.targets(torque, joints, cycle.dt.as_secs_f64())?;
        let made = reports.map_or([0; N], |reports| reports.torque_codes);
        let tau_nm = self.law.torque_made(&made);
        Ok((Command { codes: targets.words, tau_nm, limited: targets.limited }, is_ready))
    }

    /// Writes both boards; if one board fails, the other one is set to its safe value.
    fn commit(
        &mut self,
        cycle: &Cycle,
        command: &Command<N>,
        lines: &LinesOut,
        is_suspect: bool,
    ) -> Result<(), FaultCode> {
        let wanted = Wanted { follows: lines.enable, is_suspect, period: cycle.dt };
        let written = self.motors.commit(cycle.release, &command.codes, wanted);
        let motors_work = self.motor_failures.tolerates(written);
        let safe = LinesOut { enable: false, brake_release: false, ..*lines };
        let lines = if motors_work { lines } else { &safe };
        let digital = self.digital.commit(cycle.release, lines);
        if !self.digital_failures.tolerates(digital) {
            // Nothing more can be done for a board that cannot be set to its safe value: the fault
            // is reported.
            self.motors.safe();
            return Err(FaultCode::DigitalLost);
        }
        if motors_work { Ok(()) } else { Err(self.motors.lost()) }
    }

    fn make_safe(&mut self) {
        self.motors.safe();
        // A board that does not answer any more has its own watchdog.
        let _ = self.digital.safe();
    }
}

/// A checked number of seconds in whole nanoseconds.
#[expect(clippy::cast_possible_truncation, reason = "at most two seconds")]
fn duration(seconds: f64) -> Nanos {
    Nanos((seconds * 1e9).round() as i64)
}

impl<const N: usize, L: ArmDynamics<N>> Task for Actuate<N, L> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        self.window = self.window_parameters.changed(io).unwrap_or(self.window);
        let control = io.read(&self.control).fresh();
        let torque = io.read(&self.torque);
        let torque_fresh = torque.freshness == Freshness::New;
        let joints = io.read(&self.joints);
        let own = control.map(|control| control.mode());
        // A torque that the port refused leaves the last good one for one job.
        let torque = torque.usable().filter(|_| torque.age <= cycle.dt);
        let gate = gate(own, cycle.mode, torque.is_some());
        self.motors.note_mode(own.unwrap_or(cycle.mode));
        let mut fault = Ok(());
        let mut is_suspect = false;
        let mut command = self.safe;
        let mut lines = LinesOut::SAFE;
        match (gate, torque) {
            (Gate::Open, Some(torque)) => {
                let mut is_ready = true;
                match self.command(&torque, &joints.value, cycle, io) {
                    Ok((allowed, ready)) => (command, is_ready) = (allowed, ready),
                    Err(code) => fault = Err(code),
                }
                let mode = own.unwrap_or(Mode::Fault);
                lines.enable = true;
                let released = mode.brakes_released() && cycle.mode.brakes_released();
                lines.brake_release = released && is_ready;
                let observation = Observation {
                    joints: joints.value,
                    is_new: joints.fresh().is_some(),
                    error_rad: torque.error_rad,
                    applied_nm: command.tau_nm,
                    moves: lines.brake_release,
                    period_s: cycle.dt.as_secs_f64(),
                    touch: self.touch.touch(io),
                };
                let monitored = self.monitor.update(&observation, &self.window);
                fault = fault.and(monitored);
                if fault.is_err_and(|code| code.class() == Class::DriveOff) {
                    (command, lines) = (self.safe, LinesOut::SAFE);
                    is_suspect = true;
                }
            }
            (Gate::Silent, _) => fault = Err(FaultCode::LaneSilent),
            (Gate::Open | Gate::Shut, _) => {}
        }
        if !lines.enable {
            self.monitor.reset();
            self.motors.forget();
        }
        // The watchdog is fed only while every input on which the torque depends is new in each
        // job.
        let fresh = control.is_some() && joints.fresh().is_some();
        if fresh && (torque_fresh || gate == Gate::Shut) {
            self.feed = !self.feed;
        }
        lines.watchdog_feed = self.feed;
        let committed = self.commit(cycle, &command, &lines, is_suspect);
        let mut dac = [self.safe.codes[0]; JOINTS_MAX];
        // The record tells of a hand's first joints only: its length is that of older logs.
        let told = N.min(JOINTS_MAX);
        dac[..told].copy_from_slice(&command.codes[..told]);
        let applied = Applied {
            tau_nm: command.tau_nm,
            dac,
            gate_open: u32::from(gate == Gate::Open),
            limited: command.limited,
        };
        io.write(&self.applied, applied);
        committed.and(fault)
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.motor_failures.failed).add(&self.digital_failures.failed).add(&self.feed);
        hash.add(&self.monitor).add(&self.motors);
    }

    fn stop(&mut self) {
        self.make_safe();
    }
}

impl<const N: usize, L: ArmDynamics<N>> Drop for Actuate<N, L> {
    fn drop(&mut self) {
        self.make_safe();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finger_is_free_only_where_an_image_could_show_a_load() {
        let of = |defined: u32| {
            let sizes = Features { x_c: 4.0, y_c: 5.0, theta_z_rad: 0.1, ..Features::default() };
            felt(&Features { defined, ..sizes }, [2e-3, 3e-3])
        };
        assert_eq!(of(0), Touch::Free);
        assert_eq!(of(defined::CONTACT_UNCERTAIN), Touch::Unknown);
        assert_eq!(of(defined::CONTACT), Touch::Unknown, "a load without a place");
        let placed = defined::CONTACT | defined::CENTROID;
        assert_eq!(of(placed), Touch::Contact { x_m: 8e-3, y_m: 15e-3, yaw_rad: None });
        let directed = Touch::Contact { x_m: 8e-3, y_m: 15e-3, yaw_rad: Some(0.1) };
        assert_eq!(of(placed | defined::THETA_Z), directed);
    }
}
