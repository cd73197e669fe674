//! The task that writes torques to the boards, as the last stage of the servo lane. It limits the
//! torque, checks that it is finite, that the mode allows it and that each joint follows within its
//! window, and it sets the enable and brake lines and feeds the watchdog. A motor that runs away
//! takes enable and brakes with it in the same job. A torque that is more than one job old is not
//! passed on. The boards are left in their safe state when the task stops, when it is dropped, and
//! when one of them fails.
//!
//! - In: `torque`, `control`, `joints`.
//! - Out: `applied`; the D/A board and the digital outputs.
//! - Rate: every job of the servo lane, 400 Hz; it stands last in the lane.
//! - Source: the gears and drives of the arm that the robot description gives.

pub mod law;
pub mod monitor;
pub mod runaway;
pub mod stuck_encoder;

use serde::Deserialize;
use taktil_hal::{AnalogOut, CHANNELS, DacCode, DigitalOut, ErrorKind, LinesOut};
use taktil_mechanics::arm::{Arm, ArmDynamics};
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::transmission::Drive;
use taktil_rtcore::fault::Class;
use taktil_rtcore::{
    Cycle, FaultCode, Freshness, Input, Invalid, Io, Mode, Output, Param, Ports, StateHash, Task,
};
use taktil_signal::{Applied, ControlState, JOINTS_MAX, JointState, Torque, per_joint};

use law::{Command, FollowingWindow, Gate, Law, gate};
use monitor::{Monitor, Observation};

/// Half width of the window of the following error where the configuration gives none, deg.
const FOLLOWING_FLOOR_DEG: f64 = 5.0;
/// The window's growth may be edited up to this at least, s.
const FOLLOWING_GAIN_MAX_S: f64 = 0.2;

taktil_rtcore::explained! {
    /// Settings of [`Actuate`].
    #[derive(Clone, Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// Largest torque at each joint, N m. Default: what the arm's drives and limits allow.
        pub torque_limit_nm: Option<Vec<f64>>,
        /// Code of each motor's converter at which no current flows: read off with the drives on
        /// and the brakes set. At most an eighth of the converter's range. Default 0.
        pub dac_zero: Option<Vec<i32>>,
        /// Half width at rest of the window in which each joint has to follow, deg. Default: 5.
        pub following_floor_deg: Option<Vec<f64>>,
        /// Growth with the desired speed of the half width of the window in which each joint has
        /// to follow, s. Default: 0.05.
        pub following_gain_s: f64,
        /// How far a measured angle may be beyond its joint's limits, deg: farther is a fault, once
        /// the joints are calibrated. Default: 2.
        pub limit_margin_deg: f64,
        /// Whether a motor that departs ever faster against its torque takes the drives. Default:
        /// true; boards are not driven without it. False is for simulations of loops that are made
        /// to swing.
        pub runaway_detection: bool,
        /// Number of failed writes in a row that are tolerated. Default: 1.
        pub failures_max: u32,
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            torque_limit_nm: None,
            dac_zero: None,
            following_floor_deg: None,
            following_gain_s: 0.05,
            limit_margin_deg: 2.0,
            runaway_detection: true,
            failures_max: 1,
        }
    }
}

impl Config {
    /// Refuses limits and windows that are not positive and finite.
    ///
    /// # Errors
    /// The key at fault, what is wrong with it, and a remedy.
    pub fn check(&self) -> Result<(), Invalid> {
        for (i, limit) in self.torque_limit_nm.iter().flatten().enumerate() {
            if !(*limit > 0.0 && *limit <= 1e4) {
                return Err(Invalid::new(
                    format!("torque_limit_nm[{i}]"),
                    format!("{limit} is not a valid torque limit"),
                    "give a positive torque in N m, at most 10000",
                ));
            }
        }
        for (i, floor) in self.following_floor_deg.iter().flatten().enumerate() {
            if !(*floor > 0.0 && *floor <= 360.0) {
                return Err(Invalid::new(
                    format!("following_floor_deg[{i}]"),
                    format!("{floor} is not a window"),
                    "give a positive angle in degrees, at most 360",
                ));
            }
        }
        if !(0.0..=10.0).contains(&self.following_gain_s) {
            return Err(Invalid::new(
                "following_gain_s",
                format!("{} is not a gain", self.following_gain_s),
                "give seconds from 0 to 10",
            ));
        }
        if !(0.0..=90.0).contains(&self.limit_margin_deg) {
            return Err(Invalid::new(
                "limit_margin_deg",
                format!("{} is not a margin", self.limit_margin_deg),
                "give degrees from 0 to 90; 2 is usual",
            ));
        }
        if self.failures_max > 100 {
            return Err(Invalid::new(
                "failures_max",
                format!("{} failed writes in a row would let a dead board pass", self.failures_max),
                "give a number from 0 to 100; 1 is usual",
            ));
        }
        Ok(())
    }

    /// The window at rest, deg.
    fn floor_deg<const N: usize>(&self) -> Result<[f64; N], Invalid> {
        match &self.following_floor_deg {
            Some(list) => per_joint("following_floor_deg", list),
            None => Ok([FOLLOWING_FLOOR_DEG; N]),
        }
    }

    /// Codes at which no current flows.
    fn zero<const N: usize>(&self, drive: &Drive<N>) -> Result<[i32; N], Invalid> {
        let Some(list) = &self.dac_zero else { return Ok([0; N]) };
        let most = (drive.code_range().1 + 1) / 4;
        if let Some(i) = list.iter().position(|code| !(-most..=most).contains(code)) {
            let what = format!("{} is no zero of a converter", list[i]);
            let remedy = format!("give codes from -{most} to {most}");
            return Err(Invalid::new(format!("dac_zero[{i}]"), what, remedy));
        }
        <[i32; N]>::try_from(list.as_slice()).map_err(|_| {
            let what = format!("has {} numbers, the arm has {N} joints", list.len());
            Invalid::new("dac_zero", what, "give one code for each joint")
        })
    }

    /// Largest torques at the joints, N m.
    fn limit_nm<const N: usize, A: Arm<N>>(
        &self,
        robot: &Robot<N, A>,
    ) -> Result<JointVector<N>, Invalid> {
        match &self.torque_limit_nm {
            Some(list) => per_joint("torque_limit_nm", list).map(|limit: [f64; N]| limit.into()),
            None => Ok(robot.torque_max_nm),
        }
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

/// Counts failed writes in a row and decides whether the board is lost. Only transient failures are
/// tolerated: unlike a failed read, a failed write may leave an old torque on the drives.
#[derive(Clone, Copy, Debug)]
struct WriteFailurePolicy {
    allowed: u32,
    failed: u32,
}

impl WriteFailurePolicy {
    /// False when the board counts as lost.
    fn tolerates(&mut self, written: Result<(), taktil_hal::Error>) -> bool {
        match written {
            Ok(()) => {
                self.failed = 0;
                true
            }
            Err(error) => {
                self.failed = self.failed.saturating_add(1);
                error.kind == ErrorKind::Transient && self.failed <= self.allowed
            }
        }
    }
}

/// The task.
pub struct Actuate<const N: usize = 6, L: ArmDynamics<N> = Dynamics> {
    analog: Box<dyn AnalogOut>,
    digital: Box<dyn DigitalOut>,
    law: Law<N>,
    window: FollowingWindow<N>,
    monitor: Monitor<N, L>,
    window_parameters: WindowParameters<N>,
    safe: Command<N>,
    analog_failures: WriteFailurePolicy,
    digital_failures: WriteFailurePolicy,
    feed: bool,
    torque: Input<Torque<N>>,
    control: Input<ControlState>,
    joints: Input<JointState<N>>,
    applied: Output<Applied<N>>,
}

impl<const N: usize, L: ArmDynamics<N>> Actuate<N, L> {
    /// Declares the ports: in `torque`, `control`, `joints`, out `applied`; the parameters
    /// `following_floor_deg` (one a joint) and `following_gain_s`.
    ///
    /// # Errors
    /// What [`Config::check`] refuses, and a D/A board with fewer channels than joints or a
    /// narrower range than the drives' codes.
    pub fn new<A: Arm<N, Dynamics = L>>(
        config: Config,
        robot: &Robot<N, A>,
        analog: Box<dyn AnalogOut>,
        digital: Box<dyn DigitalOut>,
        ports: &mut Ports,
    ) -> Result<Actuate<N, L>, Invalid> {
        config.check()?;
        check_board(analog.as_ref(), &robot.drive)?;
        let floor_deg = config.floor_deg()?;
        let law = Law::new(robot.gears, robot.drive, config.limit_nm(robot)?)
            .with_zero(config.zero(&robot.drive)?);
        let DacCode(safe_code) = analog.safe_value();
        let safe = Command { codes: [safe_code; N], tau_nm: law.torque_of(safe_code), limited: 0 };
        let policy = WriteFailurePolicy { allowed: config.failures_max, failed: 0 };
        let window_parameters = WindowParameters::new(&config, floor_deg, ports);
        Ok(Actuate {
            window_parameters,
            analog,
            digital,
            law,
            window: FollowingWindow {
                floor_rad: floor_deg.map(f64::to_radians),
                gain_s: config.following_gain_s,
            },
            monitor: Monitor::new(robot, config.limit_margin_deg.to_radians())
                .with_runaway_detection(config.runaway_detection),
            safe,
            analog_failures: policy,
            digital_failures: policy,
            feed: false,
            torque: ports.input("torque"),
            control: ports.input("control"),
            joints: ports.input("joints"),
            applied: ports.output("applied"),
        })
    }

    /// Writes both boards; if one board fails, the other one is set to its safe value.
    fn commit(
        &mut self,
        cycle: &Cycle,
        command: &Command<N>,
        lines: &LinesOut,
    ) -> Result<(), FaultCode> {
        let mut codes = [self.analog.safe_value(); CHANNELS];
        for (channel, code) in codes.iter_mut().zip(command.codes) {
            *channel = DacCode(code);
        }
        let analog = self.analog.commit(cycle.release, &codes);
        let analog_works = self.analog_failures.tolerates(analog);
        let safe = LinesOut { enable: false, brake_release: false, ..*lines };
        let lines = if analog_works { lines } else { &safe };
        let digital = self.digital.commit(cycle.release, lines);
        if !self.digital_failures.tolerates(digital) {
            // Nothing more can be done for a board that cannot be set to its safe value: the fault
            // is reported.
            let _ = self.analog.safe();
            return Err(FaultCode::DigitalLost);
        }
        if analog_works { Ok(()) } else { Err(FaultCode::AnalogOutLost) }
    }

    fn make_safe(&mut self) {
        // A board that does not answer any more has its own watchdog.
        let _ = self.analog.safe();
        let _ = self.digital.safe();
    }
}

fn check_board<const N: usize>(analog: &dyn AnalogOut, drive: &Drive<N>) -> Result<(), Invalid> {
    if analog.channels() < N {
        return Err(Invalid::new(
            "",
            format!("the D/A board has {} channels", analog.channels()),
            format!("wire a board with {N} outputs"),
        ));
    }
    let (DacCode(low), DacCode(high)) = analog.code_range();
    let (drive_low, drive_high) = drive.code_range();
    if low > drive_low || high < drive_high {
        return Err(Invalid::new(
            "",
            format!(
                "the D/A board takes {low}..={high}, the drives need {drive_low}..={drive_high}"
            ),
            "wire a board of at least the drives' width",
        ));
    }
    Ok(())
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
        let mut fault = Ok(());
        let mut command = self.safe;
        let mut lines = LinesOut::SAFE;
        match (gate, torque) {
            (Gate::Open, Some(torque)) => {
                match self.law.command(&torque.tau_nm) {
                    Ok(allowed) => command = allowed,
                    Err(code) => fault = Err(code),
                }
                let mode = own.unwrap_or(Mode::Fault);
                lines.enable = true;
                lines.brake_release = mode.brakes_released() && cycle.mode.brakes_released();
                let observation = Observation {
                    joints: joints.value,
                    is_new: joints.fresh().is_some(),
                    error_rad: torque.error_rad,
                    applied_nm: command.tau_nm,
                    moves: lines.brake_release,
                    period_s: cycle.dt.as_secs_f64(),
                };
                let monitored = self.monitor.update(&observation, &self.window);
                fault = fault.and(monitored);
                if fault.is_err_and(|code| code.class() == Class::DriveOff) {
                    (command, lines) = (self.safe, LinesOut::SAFE);
                }
            }
            (Gate::Silent, _) => fault = Err(FaultCode::LaneSilent),
            (Gate::Open | Gate::Shut, _) => {}
        }
        if !lines.enable {
            self.monitor.reset();
        }
        // The watchdog is fed only while every input on which the torque depends is new in each
        // job.
        let fresh = control.is_some() && joints.fresh().is_some();
        if fresh && (torque_fresh || gate == Gate::Shut) {
            self.feed = !self.feed;
        }
        lines.watchdog_feed = self.feed;
        let committed = self.commit(cycle, &command, &lines);
        let mut dac = [self.analog.safe_value().0; JOINTS_MAX];
        // Of a hand the record tells of the first joints only: its length is that of older logs.
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
        hash.add(&self.analog_failures.failed).add(&self.digital_failures.failed).add(&self.feed);
        hash.add(&self.monitor);
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
    use taktil_hal::Error;

    #[test]
    fn the_default_configuration_is_sound_and_at_the_drives_peak() {
        let config = Config::default();
        assert_eq!(config.check(), Ok(()));
        let robot = Robot::puma260();
        assert!((config.limit_nm(&robot).unwrap()[0] - 12.848).abs() < 1e-3);
        assert_eq!(config.floor_deg(), Ok([5.0; 6]));
        let short = Config { torque_limit_nm: Some(vec![1.0; 5]), ..Config::default() };
        assert_eq!(short.limit_nm(&robot).unwrap_err().place, "torque_limit_nm");
        let drive = Robot::puma260().drive;
        assert_eq!(config.zero(&drive), Ok([0; 6]));
        for (list, place) in [
            (vec![0; 5], "dac_zero"),
            (vec![0, 0, 513, 0, 0, 0], "dac_zero[2]"),
            (vec![i32::MIN; 6], "dac_zero[0]"),
        ] {
            let config = Config { dac_zero: Some(list), ..Config::default() };
            assert_eq!(config.zero(&drive).unwrap_err().place, place);
        }
        let long = Config { following_floor_deg: Some(vec![1.0; 7]), ..Config::default() };
        assert_eq!(long.floor_deg::<6>().unwrap_err().place, "following_floor_deg");
    }

    #[test]
    fn unusable_settings_are_refused_with_their_place() {
        for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
            let limits = Some(vec![1.0, 1.0, bad]);
            let config = Config { torque_limit_nm: limits, ..Config::default() };
            assert_eq!(config.check().unwrap_err().place, "torque_limit_nm[2]", "{bad}");
            let floors = Some(vec![1.0, 1.0, 1.0, 1.0, 1.0, bad]);
            let config = Config { following_floor_deg: floors, ..Config::default() };
            assert_eq!(config.check().unwrap_err().place, "following_floor_deg[5]", "{bad}");
        }
        for bad in [f64::NAN, -0.1, 10.1] {
            let config = Config { following_gain_s: bad, ..Config::default() };
            assert_eq!(config.check().unwrap_err().place, "following_gain_s", "{bad}");
        }
        for bad in [f64::NAN, f64::INFINITY, -0.1, 90.1] {
            let config = Config { limit_margin_deg: bad, ..Config::default() };
            assert_eq!(config.check().unwrap_err().place, "limit_margin_deg", "{bad}");
        }
        let config = Config { failures_max: 101, ..Config::default() };
        assert_eq!(config.check().unwrap_err().place, "failures_max");
    }

    #[test]
    fn one_transient_failure_is_borne_and_nothing_else() {
        let mut policy = WriteFailurePolicy { allowed: 1, failed: 0 };
        let transient = Err(Error::whole(ErrorKind::Transient, "test"));
        assert!(policy.tolerates(transient) && policy.tolerates(Ok(())));
        assert!(policy.tolerates(transient) && !policy.tolerates(transient));
        for kind in [ErrorKind::Lost, ErrorKind::OutOfRange, ErrorKind::Stale] {
            let mut policy = WriteFailurePolicy { allowed: 1, failed: 0 };
            assert!(!policy.tolerates(Err(Error::whole(kind, "test"))), "{kind:?}");
        }
    }
}
