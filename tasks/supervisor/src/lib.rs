//! The task that decides what the machine does. It steps the state machine of the robot control
//! program and the mode machine that allows torque, and it is the only writer of both. It collects
//! the faults of the lanes, supervises drive power, emergency stop and the arrival of the inputs
//! that everything depends on, and grants or refuses the requests of the operator. A request that
//! is refused is counted in `control`.
//!
//! - In: `request`, `lines`, `joints`, `trajectory`, `servo_health`; on a machine with touch also
//!   `tactile` and `touch_health`.
//! - Out: `control`, `mode`.
//! - Rate: every job of the servo lane, 400 Hz.
//! - Source: P. Sikka, *The Role of Tactile Sensing in Robot Manipulation*, University of Alberta,
//!   1994, figure 6.2, for the states ([`law`]).

pub mod decide;
pub mod law;
pub mod watch;

use serde::Deserialize;
use taktil_rtcore::status::{LaneHealth, ModeStatus};
use taktil_rtcore::{
    Cycle, FaultCode, FaultSet, Input, Invalid, Io, Mode, Nanos, Output, Ports, Sample, StateHash,
    Task,
};
use taktil_signal::{ControlState, Goal, JointState, Lines, Request};

use decide::{DecisionState, Inputs, SourceReport, Timing};

taktil_rtcore::explained! {
    /// Settings of [`Supervisor`].
    #[derive(Clone, Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// Shortest time under servo with the brakes on before they are released, s. Default: 0.05.
        pub enable_time_s: f64,
        /// Band that no joint may leave for the arm to count as standing still, deg. Default: 0.05.
        pub standstill_deg: f64,
        /// How long no joint must leave the band of `standstill_deg` for the arm to count as
        /// standing still, s. Default: 0.04.
        pub standstill_time_s: f64,
        /// Longest time that a stop may take before the drives go off, still or not, s. Default: 1.
        pub stop_time_max_s: f64,
        /// How long the channels of the emergency stop may disagree, s. Default: 0.02.
        pub estop_discrepancy_s: f64,
        /// How long touch may be missing before TACTILE-SERVO is left for IDLE/CALIBRATED, s.
        /// Default: 0.02.
        pub tactile_hold_s: f64,
        /// Age at which the touch lane's health means that the lane is silent, s. Default: 0.1.
        pub tactile_timeout_s: f64,
        /// Age at which joints and lines have stopped coming, s. Default: 0.01.
        pub input_stale_s: f64,
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            enable_time_s: 0.05,
            standstill_deg: 0.05,
            standstill_time_s: 0.04,
            stop_time_max_s: 1.0,
            estop_discrepancy_s: 0.02,
            tactile_hold_s: 0.02,
            tactile_timeout_s: 0.1,
            input_stale_s: 0.01,
        }
    }
}

impl Config {
    /// Refuses times and bands that are not positive and finite, or absurdly long.
    ///
    /// # Errors
    /// The place, what is wrong there, and the way out.
    pub fn check(&self) -> Result<(), Invalid> {
        positive("enable_time_s", self.enable_time_s, 10.0)?;
        positive("standstill_deg", self.standstill_deg, 10.0)?;
        positive("standstill_time_s", self.standstill_time_s, 10.0)?;
        positive("stop_time_max_s", self.stop_time_max_s, 60.0)?;
        positive("estop_discrepancy_s", self.estop_discrepancy_s, 10.0)?;
        positive("tactile_hold_s", self.tactile_hold_s, 10.0)?;
        positive("tactile_timeout_s", self.tactile_timeout_s, 10.0)?;
        positive("input_stale_s", self.input_stale_s, 10.0)?;
        if self.standstill_time_s > self.stop_time_max_s {
            return Err(Invalid::new(
                "standstill_time_s",
                format!(
                    "standing still takes {} s to be seen, longer than the longest stop",
                    self.standstill_time_s
                ),
                format!("give less than stop_time_max_s, which is {}", self.stop_time_max_s),
            ));
        }
        Ok(())
    }

    fn times(&self) -> Timing {
        Timing {
            enable: duration(self.enable_time_s),
            still: duration(self.standstill_time_s),
            still_rad: self.standstill_deg.to_radians(),
            stop_max: duration(self.stop_time_max_s),
            estop_disagree: duration(self.estop_discrepancy_s),
            tactile_hold: duration(self.tactile_hold_s),
            silence: Nanos::MAX,
        }
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

/// A checked number of seconds in whole nanoseconds.
#[expect(clippy::cast_possible_truncation, reason = "at most a minute")]
fn duration(seconds: f64) -> Nanos {
    Nanos((seconds * 1e9).round() as i64)
}

/// Whether a status holds a known mode.
fn is_mode(word: &ModeStatus) -> bool {
    Mode::from_code(word.mode).is_some()
}

/// The inputs from the tactile side, on a machine that has one.
struct TouchInputs<const N: usize> {
    tactile: Input<Goal<N>>,
    health: Input<LaneHealth>,
}

/// The task.
pub struct Supervisor<const N: usize = 6> {
    decision: DecisionState<N>,
    request: Input<Request>,
    lines: Input<Lines>,
    joints: Input<JointState<N>>,
    trajectory: Input<Goal<N>>,
    touch: Option<TouchInputs<N>>,
    servo_health: Input<LaneHealth>,
    control: Output<ControlState>,
    mode: Output<ModeStatus>,
}

impl<const N: usize> Supervisor<N> {
    /// Declares the ports: in `request`, `lines`, `joints`, `trajectory` (delayed), `servo_health`
    /// (delayed) and, for a machine with `touch`, `tactile` (delayed) and `touch_health`; out
    /// `control`, `mode`. Without touch TACTILE-SERVO is not granted.
    ///
    /// # Errors
    /// What [`Config::check`] refuses.
    pub fn new(config: Config, touch: bool, ports: &mut Ports) -> Result<Supervisor<N>, Invalid> {
        config.check()?;
        let stale = duration(config.input_stale_s);
        Ok(Supervisor {
            decision: DecisionState::new(config.times()),
            request: ports.input("request"),
            lines: ports.input_within("lines", stale),
            joints: ports.input_within("joints", stale),
            trajectory: ports.input_delayed("trajectory"),
            touch: touch.then(|| TouchInputs {
                tactile: ports.input_delayed("tactile"),
                health: ports.input_within("touch_health", duration(config.tactile_timeout_s)),
            }),
            servo_health: ports.input_delayed("servo_health"),
            control: ports.output("control"),
            mode: ports.output_within("mode", is_mode),
        })
    }

    /// The same task over boards of which one lets its outputs go after this silence: a lane that
    /// stood still for longer does not take up the drives where it left them.
    #[must_use]
    pub fn with_silence(mut self, silence: Nanos) -> Supervisor<N> {
        self.decision.limit_silence(silence);
        self
    }
}

/// The report of a source. The tactile servo is done only while its goal is valid; an empty
/// trajectory is done too.
fn source_report<const N: usize>(goal: &Sample<Goal<N>>, only_when_valid: bool) -> SourceReport {
    let done = goal.value.done == 1 && (goal.value.valid == 1 || !only_when_valid);
    SourceReport { stamp: goal.stamp, done }
}

impl<const N: usize> Task for Supervisor<N> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let servo = io.read(&self.servo_health);
        let touch = self.touch.as_ref().map(|touch| io.read(&touch.health));
        let raised = |health: Sample<LaneHealth>| health.fresh().map_or(0, |word| word.faults);
        let tactile =
            self.touch.as_ref().map(|touch| source_report(&io.read(&touch.tactile), true));
        let tactile = tactile.unwrap_or_default();
        let inputs = Inputs {
            release: cycle.release,
            lines: io.read(&self.lines).usable(),
            joints: io.read(&self.joints).usable(),
            raised: FaultSet(raised(servo) | touch.map_or(0, raised)),
            present: FaultSet(servo.value.faults | touch.map_or(0, |touch| touch.value.faults)),
            touch: touch.is_some(),
            touch_silent: touch.is_some_and(|touch| touch.usable().is_none()),
            disabled: servo.value.disabled | touch.map_or(0, |touch| touch.value.disabled) != 0,
            trajectory: source_report(&io.read(&self.trajectory), false),
            tactile,
            request: io.read(&self.request).usable(),
        };
        let (control, mode) = self.decision.decide(&inputs);
        io.write(&self.control, control);
        io.write(&self.mode, mode);
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.decision);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_configuration_is_sound() {
        assert_eq!(Config::default().check(), Ok(()));
        assert_eq!(Config::default().times().enable, Nanos::from_millis(50));
    }

    #[test]
    fn unusable_settings_are_refused_with_their_place() {
        type Set = fn(&mut Config, f64);
        let places: [(&str, Set); 8] = [
            ("enable_time_s", |c, x| c.enable_time_s = x),
            ("standstill_deg", |c, x| c.standstill_deg = x),
            ("standstill_time_s", |c, x| c.standstill_time_s = x),
            ("stop_time_max_s", |c, x| c.stop_time_max_s = x),
            ("estop_discrepancy_s", |c, x| c.estop_discrepancy_s = x),
            ("tactile_hold_s", |c, x| c.tactile_hold_s = x),
            ("tactile_timeout_s", |c, x| c.tactile_timeout_s = x),
            ("input_stale_s", |c, x| c.input_stale_s = x),
        ];
        for (place, set) in places {
            for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0, 1e9] {
                let mut config = Config::default();
                set(&mut config, bad);
                assert_eq!(config.check().unwrap_err().place, place, "{bad}");
            }
        }
        let config = Config { standstill_time_s: 1.1, ..Config::default() };
        assert_eq!(config.check().unwrap_err().place, "standstill_time_s");
    }
}
