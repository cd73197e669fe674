//! The only producer of the desired joints: chooses the source of motion by state, takes it over
//! without a bump, checks every goal against speed, limits and the measured joints, and brings the
//! arm to rest when there is none. Refuses to smooth: a goal that breaks a bound is refused whole,
//! and the arm holds.

pub mod law;

use serde::Deserialize;
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_rtcore::{
    Cycle, FaultCode, Input, Invalid, Io, Mode, Nanos, Output, Ports, StateHash, Task,
};
use taktil_signal::{ControlState, Desired, Goal, JointState, State};

use law::{Bounds, Facts, Law};

/// Settings of [`Setpoint`].
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Lower joint limits, deg. Default: those of the reference arm.
    pub q_min_deg: [f64; 6],
    /// Upper joint limits, deg. Default: those of the reference arm.
    pub q_max_deg: [f64; 6],
    /// Fastest speed of each joint, deg/s; a goal may step by 1.5 times it. Default: that of the
    /// reference arm.
    pub v_max_deg_s: [f64; 6],
    /// How far the first goal of a source may be from the desired joints, deg. Default: 0.2.
    pub bumpless_deg: f64,
    /// How far moving desired joints may be from the measured ones, deg. Default: 6.
    pub max_lead_deg: f64,
    /// Time in which motion without a source comes to rest, s. Default: 0.2.
    pub stop_time_s: f64,
    /// Age at which a goal is no goal any more, s. Default: 0.01.
    pub goal_stale_s: f64,
}

impl Default for Config {
    fn default() -> Config {
        let arm = Puma260::reference();
        let degrees = |radians: Joints| radians.map(f64::to_degrees).into();
        Config {
            q_min_deg: degrees(arm.q_min_rad),
            q_max_deg: degrees(arm.q_max_rad),
            v_max_deg_s: degrees(arm.speed_max_rad_s),
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
        for i in 0..6 {
            let (low, high) = (self.q_min_deg[i], self.q_max_deg[i]);
            for (place, angle) in [("q_min_deg", low), ("q_max_deg", high)] {
                if !(-1000.0..=1000.0).contains(&angle) {
                    return Err(Invalid::new(
                        format!("{place}[{i}]"),
                        format!("{angle} is not a joint angle"),
                        "give degrees within +-1000",
                    ));
                }
            }
            if low >= high {
                return Err(Invalid::new(
                    format!("q_min_deg[{i}]"),
                    format!("the lower limit {low} is not below the upper limit {high}"),
                    "swap them or move them apart",
                ));
            }
            positive(&format!("v_max_deg_s[{i}]"), self.v_max_deg_s[i], 1e5)?;
        }
        positive("bumpless_deg", self.bumpless_deg, 90.0)?;
        positive("max_lead_deg", self.max_lead_deg, 360.0)?;
        positive("stop_time_s", self.stop_time_s, 10.0)?;
        positive("goal_stale_s", self.goal_stale_s, 10.0)
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

/// Joint angles beyond four turns, or speeds beyond 100 rad/s, are no wish of anybody.
const ABSURD_RAD: f64 = 8.0 * core::f64::consts::PI;
const ABSURD_RAD_S: f64 = 100.0;

/// Joints that somebody can desire.
fn sound(desired: &Desired) -> bool {
    desired.q_rad.iter().all(|q| q.abs() <= ABSURD_RAD)
        && desired.qd_rad_s.iter().all(|qd| qd.abs() <= ABSURD_RAD_S)
}

/// The task.
pub struct Setpoint {
    law: Law,
    last: Option<Nanos>,
    control: Input<ControlState>,
    joints: Input<JointState>,
    jog: Input<Goal>,
    trajectory: Input<Goal>,
    tactile: Input<Goal>,
    desired: Output<Desired>,
}

impl Setpoint {
    /// Declares the ports: in `control`, `joints`, `jog`, `trajectory`, `tactile`, out
    /// `desired`.
    ///
    /// # Errors
    /// What [`Config::check`] refuses.
    pub fn new(config: Config, ports: &mut Ports) -> Result<Setpoint, Invalid> {
        config.check()?;
        let radians = |degrees: [f64; 6]| Joints::from(degrees.map(f64::to_radians));
        let stale = span(config.goal_stale_s);
        Ok(Setpoint {
            law: Law::new(Bounds {
                q_min_rad: radians(config.q_min_deg),
                q_max_rad: radians(config.q_max_deg),
                v_max_rad_s: radians(config.v_max_deg_s),
                bumpless_rad: config.bumpless_deg.to_radians(),
                lead_max_rad: config.max_lead_deg.to_radians(),
                stop_time_s: config.stop_time_s,
            }),
            last: None,
            control: ports.input("control"),
            joints: ports.input("joints"),
            jog: ports.input_within("jog", stale),
            trajectory: ports.input_within("trajectory", stale),
            tactile: ports.input_within("tactile", stale),
            desired: ports.output_within("desired", sound),
        })
    }
}

/// A checked number of seconds in whole nanoseconds.
#[expect(clippy::cast_possible_truncation, reason = "at most ten seconds")]
fn span(seconds: f64) -> Nanos {
    Nanos((seconds * 1e9).round() as i64)
}

/// Time since the last job: the period, or more when jobs were skipped.
fn elapsed(last: Option<Nanos>, cycle: &Cycle) -> Nanos {
    last.map_or(cycle.dt, |last| cycle.release - last).max(cycle.dt)
}

impl Task for Setpoint {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let elapsed = elapsed(self.last, cycle);
        self.last = Some(cycle.release);
        let control = io.read(&self.control).value;
        let joints = io.read(&self.joints).usable();
        let jog = io.read(&self.jog).usable();
        let trajectory = io.read(&self.trajectory).usable();
        let tactile = io.read(&self.tactile).usable();
        let Some(measured) = joints else {
            io.write(&self.desired, Desired::default());
            return Ok(());
        };
        let facts = Facts {
            measured,
            state: State::from_code(control.state).unwrap_or(State::Start),
            mode: u8::try_from(control.mode).ok().and_then(Mode::from_code).unwrap_or(Mode::Fault),
            jog,
            trajectory,
            tactile,
            dt_s: elapsed.as_secs_f64(),
        };
        let (desired, fault) = self.law.step(&facts);
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
            ("v_max_deg_s[1]", |c, x| c.v_max_deg_s[1] = x),
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
        let mut config = Config::default();
        config.q_min_deg[2] = config.q_max_deg[2];
        assert_eq!(config.check().unwrap_err().place, "q_min_deg[2]");
        config.q_max_deg[2] = f64::NAN;
        assert_eq!(config.check().unwrap_err().place, "q_max_deg[2]");
    }

    #[test]
    fn skipped_jobs_count_as_time() {
        let dt = Nanos::from_micros(2500);
        let cycle = Cycle { tick: 7, release: dt * 7, dt, mode: Mode::Moving };
        assert_eq!(elapsed(None, &cycle), dt);
        assert_eq!(elapsed(Some(dt * 6), &cycle), dt);
        assert_eq!(elapsed(Some(dt * 4), &cycle), dt * 3);
    }

    #[test]
    fn seconds_become_whole_nanoseconds() {
        assert_eq!(span(0.01), Nanos(10_000_000));
        assert_eq!(span(10.0), Nanos::from_secs(10));
    }
}
