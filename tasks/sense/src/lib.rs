//! The task that reads the encoder board and the digital inputs and publishes joint angles and
//! lines. It owns the zero offsets: it sets them when the supervisor says that the arm stands in
//! its home pose, to the nearest index pulses where the board reports them. After a failed read the
//! task publishes nothing, so that readers see the last value as held.
//!
//! - In: `control` (delayed); the encoder board, the digital inputs and, where there are some,
//!   drives that close a loop.
//! - Out: `joints`, `lines`, `home` with a board that reports index pulses, `drives` with drives.
//! - Rate: every job of the servo lane, 400 Hz; it stands first in the lane.
//! - Source: speeds are first differences of the angles over the time between two acquisitions.

mod drives;
pub mod index;
pub mod law;

use serde::Deserialize;
use taktil_hal::{Counts, DigitalIn, DriveIn, Encoders, LinesIn};
use taktil_mechanics::arm::Arm;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{Cycle, FaultCode, Input, Invalid, Io, Output, Ports, StateHash, Task};
use taktil_signal::{ControlState, HomeCheck, JointState, Lines, check_degrees, per_joint};

use drives::DriveReports;
use index::{Index, IndexConfig, IndexOffset};
use law::{FailureAction, JointAngles, ReadFailurePolicy};

taktil_rtcore::explained! {
    /// Settings of [`Sense`].
    #[derive(Clone, Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// Joint angles of the home pose, deg. Default: those of the arm (PUMA 260: 0, 0, -180, 0,
        /// 90, 0, upper arm and hand level, forearm hanging); in a scene, where its arm starts.
        pub home_deg: Option<Vec<f64>>,
        /// Fastest speed of each joint, deg/s, as a measure for jumps. Default: that of the arm.
        pub v_max_deg_s: Option<Vec<f64>>,
        /// Counts of the board's encoders in a motor turn, over those that the arm is known to
        /// have: a board that divides or multiplies them. Default: 1.
        pub encoder_scale: f64,
        /// Number of failed reads in a row that are tolerated, with the last value held. Default:
        /// 1.
        pub failures_max: u32,
        /// How index pulses are used, where the board reports them.
        pub index: IndexConfig,
    }
}

/// By so much an angle that was converted from degrees may be off (rad).
const ANGLE_ROUNDING_RAD: f64 = 1e-9;
/// The least part of the arm's own speed that may be given as its largest.
const SPEED_SHARE_MIN: f64 = 1.0 / 30.0;

impl Default for Config {
    fn default() -> Config {
        let index = IndexConfig::default();
        let (home_deg, v_max_deg_s) = (None, None);
        Config { home_deg, v_max_deg_s, encoder_scale: 1.0, failures_max: 1, index }
    }
}

impl Config {
    /// Refuses angles that are not finite or beyond a few turns, and speeds that are not positive.
    ///
    /// # Errors
    /// The place, what is wrong there, and the way out.
    pub fn check(&self) -> Result<(), Invalid> {
        for (i, angle) in self.home_deg.iter().flatten().enumerate() {
            if !(-1000.0..=1000.0).contains(angle) {
                return Err(Invalid::new(
                    format!("home_deg[{i}]"),
                    format!("{angle} is not a joint angle"),
                    "give the angle of the home pose in degrees, within +-1000",
                ));
            }
        }
        check_degrees("home_deg", self.home_deg.as_deref().unwrap_or_default())?;
        for (i, speed) in self.v_max_deg_s.iter().flatten().enumerate() {
            if !(*speed > 0.0 && *speed <= 1e5) {
                return Err(Invalid::new(
                    format!("v_max_deg_s[{i}]"),
                    format!("{speed} is not a largest speed"),
                    "give a positive speed in deg/s, at most 100000",
                ));
            }
        }
        if !(0.01..=1000.0).contains(&self.encoder_scale) {
            return Err(Invalid::new(
                "encoder_scale",
                format!("{} times the arm's counts is no encoder", self.encoder_scale),
                "give a number from 0.01 to 1000; 1 for the arm's own",
            ));
        }
        if self.failures_max > 100 {
            return Err(Invalid::new(
                "failures_max",
                format!("{} failed reads in a row would let a dead board pass", self.failures_max),
                "give a number from 0 to 100; 1 is usual",
            ));
        }
        self.index.check().map_err(|bad| bad.within("index"))
    }

    /// Home pose and fastest speeds for an arm (rad, rad/s).
    fn angles<const N: usize, A: Arm<N>>(
        &self,
        robot: &Robot<N, A>,
    ) -> Result<(JointVector<N>, JointVector<N>), Invalid> {
        let radians = |place: &str, list: &Option<Vec<f64>>, usual: &JointVector<N>| match list {
            Some(list) => per_joint(place, list)
                .map(|degrees: [f64; N]| JointVector::from(degrees.map(f64::to_radians))),
            // The values are converted to degrees and rounded, as if the configuration had given
            // them.
            None => Ok(usual.map(|x| x.to_degrees().to_radians())),
        };
        let home = radians("home_deg", &self.home_deg, &robot.home_rad)?;
        let speeds = radians("v_max_deg_s", &self.v_max_deg_s, robot.arm.speed_max())?;
        self.check_arm(robot, &home, &speeds)?;
        Ok((home, speeds))
    }

    /// Refuses a given home pose outside the limits of the arm, and given speeds far below its own.
    fn check_arm<const N: usize, A: Arm<N>>(
        &self,
        robot: &Robot<N, A>,
        home_rad: &JointVector<N>,
        v_max_rad_s: &JointVector<N>,
    ) -> Result<(), Invalid> {
        let (low, high) = (robot.arm.q_min(), robot.arm.q_max());
        for i in (0..N).filter(|_| self.home_deg.is_some()) {
            let range = low[i] - ANGLE_ROUNDING_RAD..=high[i] + ANGLE_ROUNDING_RAD;
            if !range.contains(&home_rad[i]) {
                let joint = robot.joint_label(i);
                let what = format!("{} is outside {joint}", home_rad[i].to_degrees());
                let (low, high) = (low[i].to_degrees(), high[i].to_degrees());
                let remedy = format!("give {low:.1} to {high:.1} degrees");
                return Err(Invalid::new(format!("home_deg[{i}]"), what, remedy));
            }
        }
        for i in (0..N).filter(|_| self.v_max_deg_s.is_some()) {
            let own = robot.arm.speed_max()[i];
            if v_max_rad_s[i] < SPEED_SHARE_MIN * own {
                let (given, own) = (v_max_rad_s[i].to_degrees(), own.to_degrees());
                let what = format!("{given} deg/s is far below the arm's {own:.1}");
                let remedy = "give degrees a second, not radians; less than a thirtieth makes \
                              every motion a jump";
                return Err(Invalid::new(format!("v_max_deg_s[{i}]"), what, remedy));
            }
        }
        Ok(())
    }
}

/// The task.
pub struct Sense<const N: usize = 6> {
    encoders: Box<dyn Encoders>,
    digital: Box<dyn DigitalIn>,
    angles: JointAngles<N>,
    encoder_failures: ReadFailurePolicy,
    digital_failures: ReadFailurePolicy,
    lines_received: bool,
    /// Whether a calibration was requested and waits for an acceptable sample.
    calibrate: bool,
    failures_max: u32,
    drives: Option<DriveReports<N>>,
    /// On a board that reports index pulses, their home pose and the port that reports it.
    index: Option<(Index<N>, Output<HomeCheck<N>>)>,
    control: Input<ControlState>,
    joints: Output<JointState<N>>,
    lines: Output<Lines>,
}

impl<const N: usize> Sense<N> {
    /// Declares the ports: in `control` (delayed), out `joints`, `lines` and, with a board that
    /// reports index pulses, `home`.
    ///
    /// # Errors
    /// What [`Config::check`] and [`Index::new`] refuse, and an encoder board with fewer encoders
    /// than the arm has joints.
    pub fn new<A: Arm<N>>(
        config: Config,
        robot: &Robot<N, A>,
        encoders: Box<dyn Encoders>,
        digital: Box<dyn DigitalIn>,
        ports: &mut Ports,
    ) -> Result<Sense<N>, Invalid> {
        config.check()?;
        if encoders.joints() < N {
            return Err(Invalid::new(
                "",
                format!("the encoder board has {} joints", encoders.joints()),
                format!("wire a board with {N} encoders"),
            ));
        }
        let (home_rad, v_max_rad_s) = config.angles(robot)?;
        let gears = robot.gears.with_encoder_scale(config.encoder_scale);
        let angles = JointAngles::new(gears, v_max_rad_s, home_rad);
        let index = match encoders.has_index() && !config.index.ignore {
            true => {
                let index = Index::new(&config.index, &gears, encoders.index_pulse_reach());
                Some((index.map_err(|bad| bad.within("index"))?, ports.output("home")))
            }
            false => None,
        };
        Ok(Sense {
            encoders,
            digital,
            angles,
            encoder_failures: ReadFailurePolicy::new(config.failures_max),
            digital_failures: ReadFailurePolicy::new(config.failures_max),
            lines_received: false,
            calibrate: false,
            failures_max: config.failures_max,
            drives: None,
            index,
            control: ports.input_delayed("control"),
            joints: ports.output("joints"),
            lines: ports.output("lines"),
        })
    }

    /// The same task with drives that close a loop; declares the port `drives`.
    ///
    /// # Errors
    /// Fewer drives than joints.
    pub fn with_drives(
        self,
        half: Box<dyn DriveIn>,
        ports: &mut Ports,
    ) -> Result<Sense<N>, Invalid> {
        let drives = DriveReports::new(half, self.failures_max, ports)?;
        Ok(Sense { drives: Some(drives), ..self })
    }

    fn read_joints(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        match self.encoders.sample(cycle.release) {
            Ok(reading) => {
                self.encoder_failures.record_success();
                let mut counts = [0; N];
                for (count, Counts(read)) in counts.iter_mut().zip(reading.value) {
                    *count = read;
                }
                let found = self.calibrate.then(|| self.home_offset(&counts));
                let granted = found.filter(|found| found.refused.is_none());
                let home = granted.map(|found| difference(&counts, &found.off));
                // The request is answered by this sample, even if the sample is not accepted: after
                // a jump it is not known whether the arm still stands where the operator saw it.
                self.calibrate = false;
                let state = self.angles.update(counts, reading.acquired, home.as_ref())?;
                io.write(&self.joints, state);
                found.map_or(Ok(()), |found| self.report_home(&found, io))
            }
            Err(error) => {
                match self.encoder_failures.action_on_failure(error.kind, self.angles.has_sample())
                {
                    FailureAction::Hold => Ok(()),
                    FailureAction::Gone => Err(FaultCode::EncoderLost),
                }
            }
        }
    }

    /// How far these counts are past the home pose, by the index pulses if there are any.
    fn home_offset(&self, counts: &[i32; N]) -> IndexOffset<N> {
        match &self.index {
            Some((index, _)) => index.offset_from_home(counts, &self.encoders.index_pulses()),
            None => IndexOffset { off: [0; N], refused: None },
        }
    }

    /// Reports the result of the index pulses, if there are any.
    fn report_home(&self, found: &IndexOffset<N>, io: &mut Io<'_>) -> Result<(), FaultCode> {
        if let Some((_, home)) = &self.index {
            let check = HomeCheck {
                error_rad: self.angles.span_rad(&found.off).into(),
                error_counts: found.off,
                refused: found.refused.map_or(0, |(_, fault)| fault as u32),
                motor: found.refused.map_or(0, |(motor, _)| motor as u32 + 1),
            };
            io.write(home, check);
        }
        found.refused.map_or(Ok(()), |(_, fault)| Err(fault))
    }

    fn read_lines(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        match self.digital.sample(cycle.release) {
            Ok(reading) => {
                self.digital_failures.record_success();
                self.lines_received = true;
                io.write(&self.lines, lines(reading.value));
                Ok(())
            }
            Err(error) => {
                match self.digital_failures.action_on_failure(error.kind, self.lines_received) {
                    FailureAction::Hold => Ok(()),
                    FailureAction::Gone => Err(FaultCode::DigitalLost),
                }
            }
        }
    }
}

/// Counters may have wrapped.
fn difference<const N: usize>(counts: &[i32; N], off: &[i32; N]) -> [i32; N] {
    core::array::from_fn(|i| counts[i].wrapping_sub(off[i]))
}

fn lines(read: LinesIn) -> Lines {
    Lines {
        drive_power: u32::from(read.drive_power),
        estop_a_closed: u32::from(read.estop_a_closed),
        estop_b_closed: u32::from(read.estop_b_closed),
    }
}

impl<const N: usize> Task for Sense<N> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        if io.read(&self.control).fresh().is_some_and(|control| control.calibrate == 1) {
            self.calibrate = true;
        }
        let joints = self.read_joints(cycle, io);
        let lines = self.read_lines(cycle, io);
        let drives = match &mut self.drives {
            Some(drives) => {
                let control = io.read(&self.control).value;
                drives.read(cycle, io, control.mode().torque_allowed())
            }
            None => Ok(()),
        };
        // An error that switches the drives off takes precedence over one that is only reported.
        lines.and(drives).and(joints)
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.angles).add(&self.encoder_failures).add(&self.digital_failures);
        hash.add(&self.lines_received).add(&self.calibrate);
        if let Some(drives) = &self.drives {
            hash.add(drives);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_configuration_is_sound() {
        assert_eq!(Config::default().check(), Ok(()));
    }

    #[test]
    fn unusable_settings_are_refused_with_their_place() {
        for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0, 2e5] {
            let speeds = Some(vec![1.0, 1.0, 1.0, bad]);
            let config = Config { v_max_deg_s: speeds, ..Config::default() };
            assert_eq!(config.check().unwrap_err().place, "v_max_deg_s[3]", "{bad}");
        }
        for bad in [f64::NAN, f64::NEG_INFINITY, 1001.0] {
            let home = Some(vec![0.0, 0.0, 0.0, 0.0, 0.0, bad]);
            let config = Config { home_deg: home, ..Config::default() };
            assert_eq!(config.check().unwrap_err().place, "home_deg[5]", "{bad}");
        }
        let config = Config { failures_max: 101, ..Config::default() };
        assert_eq!(config.check().unwrap_err().place, "failures_max");
        for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0, 1001.0] {
            let config = Config { encoder_scale: bad, ..Config::default() };
            assert_eq!(config.check().unwrap_err().place, "encoder_scale", "{bad}");
        }
    }

    #[test]
    fn a_home_pose_outside_the_arm_and_numbers_in_radians_are_refused() {
        let robot = Robot::puma260();
        let home = |list: [f64; 6]| {
            let config = Config { home_deg: Some(list.to_vec()), ..Config::default() };
            config.check().and_then(|()| config.angles(&robot).map(|_| ())).map_err(|bad| bad.place)
        };
        assert_eq!(home([0.0, 0.0, -180.0, 0.0, 90.0, 0.0]), Ok(()));
        assert_eq!(home([0.0, 0.0, 1000.0, 0.0, 90.0, 0.0]), Err("home_deg[2]".to_owned()));
        assert_eq!(home([-400.0, 0.0, -180.0, 0.0, 90.0, 0.0]), Err("home_deg[0]".to_owned()));
        let radians = [0.0, 0.0, -core::f64::consts::PI, 0.0, 1.571, 0.0];
        assert_eq!(home(radians), Err("home_deg".to_owned()));
        let speeds = Config { v_max_deg_s: Some(vec![2.0; 6]), ..Config::default() };
        assert_eq!(speeds.angles(&robot).unwrap_err().place, "v_max_deg_s[0]");
    }

    #[test]
    fn lists_have_one_number_for_each_joint_or_are_the_arm_s() {
        let robot = Robot::puma260();
        let (home, speeds) = Config::default().angles(&robot).unwrap();
        assert!((home - robot.home_rad).amax() < 1e-15);
        assert!((speeds - robot.arm.speed_max()).amax() < 1e-15);
        let short = Config { home_deg: Some(vec![0.0; 5]), ..Config::default() };
        let bad = short.angles(&robot).unwrap_err();
        assert_eq!((bad.place.as_str(), bad.what.contains("6 joints")), ("home_deg", true));
        let long = Config { v_max_deg_s: Some(vec![1.0; 7]), ..Config::default() };
        assert_eq!(long.angles(&robot).unwrap_err().place, "v_max_deg_s");
    }
}
