//! Moves one joint to and fro about its present angle, in the state TRAJECTORY, in place of the
//! programmed moves. A joint that the arm does not have and an amplitude that needs more speed than
//! the joint allows are errors.

use core::f64::consts::TAU;

use crate::law;
use serde::Deserialize;
use taktil_machine::own::Section;
use taktil_machine::robot::AnyRobot;
use taktil_rtcore::{
    Cycle, FaultCode, Input, Invalid, Io, Nanos, Output, Ports, StateHash, Task, payload,
};
use taktil_signal::{ControlState, Desired, Goal, State};

/// `[own.sway]`.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Which joint, 1 to 6.
    joint: usize,
    /// From where it stood to the other end (deg); negative the other way.
    span_deg: f64,
    /// To and back (s).
    period_s: f64,
    /// How often, before the task is done.
    times: u32,
}

impl Config {
    /// Refuses what is out of bounds; `fastest_rad_s` are the joints' largest speeds.
    fn check(&self, fastest_rad_s: &[f64]) -> Result<(), Invalid> {
        let within = |place: &str, value: f64, low: f64, high: f64| {
            if (low..=high).contains(&value) {
                return Ok(());
            }
            Err(Invalid::new(place, format!("is {value}"), format!("give {low} to {high}")))
        };
        within("joint", self.joint as f64, 1.0, fastest_rad_s.len() as f64)?;
        within("span_deg", self.span_deg.abs(), 0.1, 90.0)?;
        within("period_s", self.period_s, 0.1, 60.0)?;
        within("times", f64::from(self.times), 1.0, 1e6)?;
        let peak = self.span_deg.to_radians().abs() * 0.5 * TAU / self.period_s;
        let most = fastest_rad_s[self.joint - 1];
        if peak > most {
            let what = format!("joint {} would go {peak:.2} rad/s of {most:.2}", self.joint);
            return Err(Invalid::new("period_s", what, "give more time or less way"));
        }
        Ok(())
    }
}

payload! {
    /// How far the motion is: the signal `sway.state`.
    pub struct SwayState {
        /// From where the joint stood.
        pub offset_rad: f64,
        /// Times that are done.
        pub times: u32,
        /// 1 while it moves.
        pub at_work: u32,
    }
}

/// The task.
struct Sway {
    config: Config,
    control: Input<ControlState>,
    desired: Input<Desired>,
    goal: Output<Goal>,
    state: Output<SwayState>,
    /// When this stay in TRAJECTORY was entered, and when and where the motion began.
    stay: Option<(i64, Nanos, [f64; 6])>,
}

/// Makes the task; declares in `control` and `desired`, out `goal` and `state`.
///
/// # Errors
/// Another arm than the PUMA 260; what [`Config::check`] refuses.
pub fn make(
    section: &Section,
    robot: &AnyRobot,
    ports: &mut Ports,
) -> Result<Box<dyn Task>, Invalid> {
    let config: Config = section.read()?;
    let AnyRobot::Puma260(robot) = robot else {
        return Err(Invalid::new("", "moves a PUMA 260 only", "leave it out of the lanes"));
    };
    config.check(robot.arm.speed_max_rad_s.as_slice())?;
    Ok(Box::new(Sway {
        config,
        control: ports.input("control"),
        desired: ports.input_delayed("desired"),
        goal: ports.output("goal"),
        state: ports.output("state"),
        stay: None,
    }))
}

impl Task for Sway {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let control = io.read(&self.control).usable();
        let desired = io.read(&self.desired).usable().filter(|desired| desired.valid == 1);
        let control = control.filter(|control| control.state == State::Trajectory as u32);
        self.stay = match (control, self.stay, desired) {
            (None, ..) => None,
            (Some(now), Some(stay), _) if stay.0 == now.entered_ns => Some(stay),
            (Some(now), _, Some(at)) => Some((now.entered_ns, cycle.release, at.q_rad)),
            (Some(_), _, None) => None,
        };
        let Some((_, since, mut q_rad)) = self.stay else {
            io.write(&self.goal, Goal::default());
            io.write(&self.state, SwayState { offset_rad: 0.0, times: 0, at_work: 0 });
            return Ok(());
        };
        let t_s = (cycle.release - since).as_secs_f64();
        let Config { joint, span_deg, period_s, times } = self.config;
        let over = t_s >= period_s * f64::from(times);
        let span_rad = if over { 0.0 } else { span_deg.to_radians() };
        let (offset_rad, speed_rad_s) = law::offset(span_rad, period_s, t_s);
        q_rad[joint - 1] += offset_rad;
        let mut qd_rad_s = [0.0; 6];
        qd_rad_s[joint - 1] = speed_rad_s;
        io.write(&self.goal, Goal { q_rad, qd_rad_s, valid: 1, done: u32::from(over) });
        let done = if over { times } else { (t_s / period_s) as u32 };
        io.write(&self.state, SwayState { offset_rad, times: done, at_work: u32::from(!over) });
        Ok(())
    }

    // What the next step depends on, for `taktil replay` and `taktil diff`.
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.stay.is_some());
        if let Some((entered_ns, since, q_rad)) = &self.stay {
            hash.add(entered_ns).add(since).add(q_rad);
        }
    }

    fn stop(&mut self) {
        self.stay = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPEED_MAX_RAD_S: [f64; 6] = [2.0; 6];

    fn config() -> Config {
        Config { joint: 6, span_deg: 30.0, period_s: 2.0, times: 2 }
    }

    #[test]
    fn what_cannot_be_meant_is_refused_with_its_place() {
        assert_eq!(config().check(&SPEED_MAX_RAD_S), Ok(()));
        let place = |config: Config| config.check(&SPEED_MAX_RAD_S).unwrap_err().place;
        for joint in [0, 7] {
            assert_eq!(place(Config { joint, ..config() }), "joint");
        }
        for span_deg in [f64::NAN, 0.0, 91.0, f64::NEG_INFINITY] {
            assert_eq!(place(Config { span_deg, ..config() }), "span_deg");
        }
        for period_s in [f64::NAN, 0.0, -2.0, 61.0, 0.2] {
            assert_eq!(place(Config { period_s, ..config() }), "period_s");
        }
        assert_eq!(place(Config { times: 0, ..config() }), "times");
    }
}
