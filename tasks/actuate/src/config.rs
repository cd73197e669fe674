//! The settings of the task that drives the motors: limits, windows, and which loop its drives
//! close.

use serde::Deserialize;
use taktil_hal::DriveLoop;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::transmission::Drive;
use taktil_rtcore::Invalid;
use taktil_signal::per_joint;

/// Half width of the window of the following error where the configuration gives none, deg.
const FOLLOWING_FLOOR_DEG: f64 = 5.0;

taktil_rtcore::explained! {
    /// The loop that drives close by themselves.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum LoopName {
        /// The drives make torques; our servo closes the loops around them.
        Torque,
        /// The drives follow velocities; our task closes the loop of the position.
        Velocity,
        /// The drives follow positions.
        Position,
    }
}

impl LoopName {
    /// The loop of this name.
    #[must_use]
    pub const fn drive_loop(self) -> DriveLoop {
        match self {
            LoopName::Torque => DriveLoop::Torque,
            LoopName::Velocity => DriveLoop::Velocity,
            LoopName::Position => DriveLoop::Position,
        }
    }
}

taktil_rtcore::explained! {
    /// Settings of [`Actuate`](crate::Actuate).
    #[derive(Clone, Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// The loop that the drives close themselves, which then get targets by `drive_out` and
        /// report by `drive_in`. Default: none; the motors are driven by `analog_out`.
        pub drive_loop: Option<LoopName>,
        /// With `drive_loop = "velocity"`: speed for an error of the angle, 1/s. Default: 10.
        pub position_gain_1_s: f64,
        /// How long drives may stop by their own ramp when torque is taken from them, before they
        /// are switched off, s; 0 switches them off at once. The brakes do not wait for it. A
        /// motor that runs away is switched off at once. Default: 0.2.
        pub quick_stop_s: f64,
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
            drive_loop: None,
            position_gain_1_s: 10.0,
            quick_stop_s: 0.2,
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
        self.check_drives()
    }

    /// Refuses what drives cannot be told.
    fn check_drives(&self) -> Result<(), Invalid> {
        if !(0.0..=200.0).contains(&self.position_gain_1_s) {
            return Err(Invalid::new(
                "position_gain_1_s",
                format!("{} is not a gain", self.position_gain_1_s),
                "give 0 to 200 a second; 10 is usual",
            ));
        }
        if !(0.0..=2.0).contains(&self.quick_stop_s) {
            return Err(Invalid::new(
                "quick_stop_s",
                format!("{} is not the time of a stop", self.quick_stop_s),
                "give seconds from 0 to 2; 0.2 is usual",
            ));
        }
        Ok(())
    }

    /// The window at rest, deg.
    pub(crate) fn floor_deg<const N: usize>(&self) -> Result<[f64; N], Invalid> {
        match &self.following_floor_deg {
            Some(list) => per_joint("following_floor_deg", list),
            None => Ok([FOLLOWING_FLOOR_DEG; N]),
        }
    }

    /// Codes at which no current flows.
    pub(crate) fn zero<const N: usize>(&self, drive: &Drive<N>) -> Result<[i32; N], Invalid> {
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
    pub(crate) fn limit_nm<const N: usize, A: Arm<N>>(
        &self,
        robot: &Robot<N, A>,
    ) -> Result<JointVector<N>, Invalid> {
        match &self.torque_limit_nm {
            Some(list) => per_joint("torque_limit_nm", list).map(|limit: [f64; N]| limit.into()),
            None => Ok(robot.torque_max_nm),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        type Set = fn(&mut Config, f64);
        let bounded: [(&str, f64, Set); 4] = [
            ("following_gain_s", 10.1, |config, x| config.following_gain_s = x),
            ("limit_margin_deg", 90.1, |config, x| config.limit_margin_deg = x),
            ("position_gain_1_s", 200.1, |config, x| config.position_gain_1_s = x),
            ("quick_stop_s", 2.1, |config, x| config.quick_stop_s = x),
        ];
        for (place, above, set) in bounded {
            for bad in [f64::NAN, f64::INFINITY, -0.1, above] {
                let mut config = Config::default();
                set(&mut config, bad);
                assert_eq!(config.check().unwrap_err().place, place, "{bad}");
            }
        }
        let config = Config { failures_max: 101, ..Config::default() };
        assert_eq!(config.check().unwrap_err().place, "failures_max");
    }
}
