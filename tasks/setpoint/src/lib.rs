//! The task that produces the desired joints, as the only one. It chooses the source of motion by
//! the state, takes the source over without a step, checks every goal against speeds, limits and
//! the measured joints, and brings the arm to rest when there is no source. A goal that breaks a
//! bound is refused as a whole, and the arm holds; goals are never smoothed.
//!
//! - In: `control`, `joints`, `jog`, `trajectory`, and `tactile` on a machine with touch.
//! - Out: `desired`.
//! - Rate: every job of the servo lane, 400 Hz.
//! - Source: the state diagram of the supervisor; see the table in [`law`].

pub mod law;

use serde::Deserialize;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{Cycle, FaultCode, Input, Invalid, Io, Nanos, Output, Ports, StateHash, Task};
use taktil_signal::{ControlState, Desired, Goal, JointState, State, per_joint};

use law::{Bounds, Inputs, Law};

taktil_rtcore::explained! {
    /// Settings of [`Setpoint`].
    #[derive(Clone, Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// Lower joint limits, deg. Default: those of the arm.
        pub q_min_deg: Option<Vec<f64>>,
        /// Upper joint limits, deg. Default: those of the arm.
        pub q_max_deg: Option<Vec<f64>>,
        /// Fastest speed of each joint, deg/s; a goal may step by 1.5 times it. Default: that of
        /// the arm.
        pub v_max_deg_s: Option<Vec<f64>>,
        /// How far the first goal of a source may be from the desired joints, deg. Default: 0.2.
        pub bumpless_deg: f64,
        /// How far moving desired joints may be from the measured ones, deg. Default: 6.
        pub max_lead_deg: f64,
        /// Time in which motion without a source comes to rest, s. Default: 0.2.
        pub stop_time_s: f64,
        /// Age at which a goal is no longer valid, s. Default: 0.01.
        pub goal_stale_s: f64,
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            q_min_deg: None,
            q_max_deg: None,
            v_max_deg_s: None,
            bumpless_deg: 0.2,
            max_lead_deg: 6.0,
            stop_time_s: 0.2,
            goal_stale_s: 0.01,
        }
    }
}

impl Config {
    /// Refuses reversed limits and everything that is not positive and finite.
    ///
    /// # Errors
    /// The place, what is wrong there, and the way out.
    pub fn check(&self) -> Result<(), Invalid> {
        for (place, list) in [("q_min_deg", &self.q_min_deg), ("q_max_deg", &self.q_max_deg)] {
            for (i, angle) in list.iter().flatten().enumerate() {
                if !(-1000.0..=1000.0).contains(angle) {
                    return Err(Invalid::new(
                        format!("{place}[{i}]"),
                        format!("{angle} is not a joint angle"),
                        "give degrees within +-1000",
                    ));
                }
            }
        }
        for (i, speed) in self.v_max_deg_s.iter().flatten().enumerate() {
            positive(&format!("v_max_deg_s[{i}]"), *speed, 1e5)?;
        }
        positive("bumpless_deg", self.bumpless_deg, 90.0)?;
        positive("max_lead_deg", self.max_lead_deg, 360.0)?;
        positive("stop_time_s", self.stop_time_s, 10.0)?;
        positive("goal_stale_s", self.goal_stale_s, 10.0)
    }

    /// The bounds for an arm.
    ///
    /// # Errors
    /// A list of another length than the arm, and reversed limits.
    fn bounds<const N: usize, A: Arm<N>>(&self, robot: &Robot<N, A>) -> Result<Bounds<N>, Invalid> {
        let radians = |place: &str, list: &Option<Vec<f64>>, usual: &JointVector<N>| {
            let degrees = match list {
                Some(list) => per_joint(place, list)?,
                None => usual.map(f64::to_degrees).into(),
            };
            Ok(JointVector::from(degrees.map(f64::to_radians)))
        };
        let q_min_rad = radians("q_min_deg", &self.q_min_deg, robot.arm.q_min())?;
        let q_max_rad = radians("q_max_deg", &self.q_max_deg, robot.arm.q_max())?;
        if let Some(i) = (0..N).find(|i| q_min_rad[*i] >= q_max_rad[*i]) {
            let (low, high) = (q_min_rad[i].to_degrees(), q_max_rad[i].to_degrees());
            return Err(Invalid::new(
                format!("q_min_deg[{i}]"),
                format!(
                    "the lower limit {low} of {} is not below the upper limit {high}",
                    robot.joint_label(i)
                ),
                "swap them or move them apart",
            ));
        }
        Ok(Bounds {
            q_min_rad,
            q_max_rad,
            v_max_rad_s: radians("v_max_deg_s", &self.v_max_deg_s, robot.arm.speed_max())?,
            bumpless_rad: self.bumpless_deg.to_radians(),
            lead_max_rad: self.max_lead_deg.to_radians(),
            stop_time_s: self.stop_time_s,
        })
    }
}

fn positive(place: &str, value: f64, most: f64) -> Result<(), Invalid> {
    if value > 0.0 && value <= most {
        return Ok(());
    }
    Err(Invalid::new(
        place,
        format!("{value} is not positive or is larger than {most}"),
        format!("give a number above 0, at most {most}"),
    ))
}

/// Largest plausible joint angle (rad), four turns. A larger angle, or a speed above
/// [`SPEED_PLAUSIBLE_MAX_RAD_S`], means an error.
const ANGLE_PLAUSIBLE_MAX_RAD: f64 = 8.0 * core::f64::consts::PI;
const SPEED_PLAUSIBLE_MAX_RAD_S: f64 = 100.0;

/// Whether desired joints are plausible.
fn is_plausible<const N: usize>(desired: &Desired<N>) -> bool {
    desired.q_rad.iter().all(|q| q.abs() <= ANGLE_PLAUSIBLE_MAX_RAD)
        && desired.qd_rad_s.iter().all(|qd| qd.abs() <= SPEED_PLAUSIBLE_MAX_RAD_S)
}

/// The task.
pub struct Setpoint<const N: usize = 6> {
    law: Law<N>,
    last: Option<Nanos>,
    control: Input<ControlState>,
    joints: Input<JointState<N>>,
    jog: Input<Goal<N>>,
    trajectory: Input<Goal<N>>,
    tactile: Option<Input<Goal<N>>>,
    desired: Output<Desired<N>>,
}

impl<const N: usize> Setpoint<N> {
    /// Declares the ports: in `control`, `joints`, `jog`, `trajectory` and, for a machine with
    /// `touch`, `tactile`; out `desired`.
    ///
    /// # Errors
    /// What [`Config::check`] refuses, lists of another length than the arm, reversed limits.
    pub fn new<A: Arm<N>>(
        config: Config,
        robot: &Robot<N, A>,
        touch: bool,
        ports: &mut Ports,
    ) -> Result<Setpoint<N>, Invalid> {
        config.check()?;
        let stale = duration(config.goal_stale_s);
        Ok(Setpoint {
            law: Law::new(config.bounds(robot)?),
            last: None,
            control: ports.input("control"),
            joints: ports.input("joints"),
            jog: ports.input_within("jog", stale),
            trajectory: ports.input_within("trajectory", stale),
            tactile: touch.then(|| ports.input_within("tactile", stale)),
            desired: ports.output_within("desired", is_plausible),
        })
    }
}

/// A checked number of seconds in whole nanoseconds.
#[expect(clippy::cast_possible_truncation, reason = "at most ten seconds")]
fn duration(seconds: f64) -> Nanos {
    Nanos((seconds * 1e9).round() as i64)
}

/// Time since the last job: the period, or more when jobs were skipped.
fn elapsed(last: Option<Nanos>, cycle: &Cycle) -> Nanos {
    last.map_or(cycle.dt, |last| cycle.release - last).max(cycle.dt)
}

impl<const N: usize> Task for Setpoint<N> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let elapsed = elapsed(self.last, cycle);
        self.last = Some(cycle.release);
        let control = io.read(&self.control).value;
        let joints = io.read(&self.joints).usable();
        let jog = io.read(&self.jog).usable();
        let trajectory = io.read(&self.trajectory).usable();
        let tactile = self.tactile.as_ref().and_then(|tactile| io.read(tactile).usable());
        let Some(measured) = joints else {
            io.write(&self.desired, Desired::default());
            return Ok(());
        };
        let inputs = Inputs {
            measured,
            state: State::from_code(control.state).unwrap_or(State::Start),
            mode: control.mode(),
            jog,
            trajectory,
            tactile,
            dt_s: elapsed.as_secs_f64(),
        };
        let (desired, fault) = self.law.step(&inputs);
        io.write(&self.desired, desired);
        fault
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.law).add(&self.last);
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
        type Set = fn(&mut Config, f64);
        let positive: [(&str, Set); 5] = [
            ("v_max_deg_s[1]", |c, x| c.v_max_deg_s = Some(vec![1.0, x])),
            ("bumpless_deg", |c, x| c.bumpless_deg = x),
            ("max_lead_deg", |c, x| c.max_lead_deg = x),
            ("stop_time_s", |c, x| c.stop_time_s = x),
            ("goal_stale_s", |c, x| c.goal_stale_s = x),
        ];
        for (place, set) in positive {
            for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0, 1e9] {
                let mut config = Config::default();
                set(&mut config, bad);
                assert_eq!(config.check().unwrap_err().place, place, "{bad}");
            }
        }
        let robot = Robot::puma260();
        let level = Some(vec![-1.0, -1.0, 1.0, -1.0, -1.0, -1.0]);
        let above = Some(vec![1.0; 6]);
        let config = Config { q_min_deg: level, q_max_deg: above.clone(), ..Config::default() };
        assert_eq!(config.check(), Ok(()));
        let bad = config.bounds(&robot).unwrap_err();
        assert_eq!(bad.place, "q_min_deg[2]");
        let named = Robot { joint_names: (1..7).map(|n| format!("axis_{n}")).collect(), ..robot };
        assert!(config.bounds(&named).unwrap_err().what.contains("joint 3 (`axis_3`)"));
        let config = Config { q_max_deg: Some(vec![1.0, f64::NAN]), ..Config::default() };
        assert_eq!(config.check().unwrap_err().place, "q_max_deg[1]");
        let short = Config { v_max_deg_s: Some(vec![1.0; 5]), ..Config::default() };
        assert_eq!(short.bounds(&named).err().map(|bad| bad.place).as_deref(), Some("v_max_deg_s"));
    }

    #[test]
    fn skipped_jobs_count_as_time() {
        let dt = Nanos::from_micros(2500);
        let cycle = Cycle { tick: 7, release: dt * 7, dt, mode: taktil_rtcore::Mode::Moving };
        assert_eq!(elapsed(None, &cycle), dt);
        assert_eq!(elapsed(Some(dt * 6), &cycle), dt);
        assert_eq!(elapsed(Some(dt * 4), &cycle), dt * 3);
    }

    #[test]
    fn seconds_become_whole_nanoseconds() {
        assert_eq!(duration(0.01), Nanos(10_000_000));
        assert_eq!(duration(10.0), Nanos::from_secs(10));
    }
}
