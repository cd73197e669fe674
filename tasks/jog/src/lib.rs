//! The task that moves the arm while the operator holds keys: joint by joint, or the tool along and
//! about the axes of the base or of the tool. Keys whose confirmation by the operator's program
//! stops, for a tenth of a second at most, count as released.
//!
//! - In: `control`, `desired`, `joints`, `command`.
//! - Out: `goal`, `state`.
//! - Rate: every job of the servo lane, 400 Hz.
//! - Source: the MANUAL states of figure 6.2 in P. Sikka's thesis (University of Alberta, 1994).
//!
//! The task moves the arm in the MANUAL states only. Each session begins at rest from the joints
//! that are desired at that moment. In MANUAL/UNCALIBRATED only joints move, slowly, and no limit
//! is known. The port `state` says why the arm does not move as a key asks.

pub mod law;

use law::{JogDemand, Law, Obstacle, Rates, Step};
use serde::Deserialize;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{
    Cycle, FaultCode, Input, Invalid, Io, Nanos, Output, Payload, Ports, StateHash, Task,
};
use taktil_signal::{
    ControlState, Desired, Goal, JogCommand, JogFrame, JogObstacle, JogState, JointState, State,
};

/// Speed of every joint below which the arm counts as standing still for the operator (rad/s).
const STANDSTILL_SPEED_RAD_S: f64 = 1e-3;

taktil_rtcore::explained! {
    /// Settings of [`Jog`].
    #[derive(Clone, Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// Share of the joints' largest speeds at full command. Default 0.15.
        pub speed: f64,
        /// Share of the joints' largest speeds at full command before the counts were initialised.
        /// Default 0.05.
        pub speed_uncalibrated: f64,
        /// Speed of the tool point at full command (mm/s). Default 40.
        pub line_mm_s: f64,
        /// Speed of turning the tool at full command (deg/s). Default 20.
        pub turn_deg_s: f64,
        /// Time from rest to full speed and back (s). Default 0.05.
        pub ramp_s: f64,
        /// Keys that were not confirmed for so long are released (s), at most 0.1. Default 0.04:
        /// the arm stands less than 0.1 s after the last confirmation by the operator.
        pub key_timeout_s: f64,
        /// How far the tool may be off its way past a wrist singularity (deg). Default 1.
        pub path_error_max_deg: f64,
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            speed: 0.15,
            speed_uncalibrated: 0.05,
            line_mm_s: 40.0,
            turn_deg_s: 20.0,
            ramp_s: 0.05,
            key_timeout_s: 0.04,
            path_error_max_deg: 1.0,
        }
    }
}

impl Config {
    /// Checks that every number is positive, finite and not too fast for jogging.
    ///
    /// # Errors
    /// The key at fault, what is wrong with it, and a remedy.
    pub fn check(&self) -> Result<(), Invalid> {
        let bounded = [
            ("speed", self.speed, 0.5),
            ("speed_uncalibrated", self.speed_uncalibrated, 0.2),
            ("line_mm_s", self.line_mm_s, 250.0),
            ("turn_deg_s", self.turn_deg_s, 90.0),
            ("ramp_s", self.ramp_s, 0.5),
            ("key_timeout_s", self.key_timeout_s, 0.1),
            ("path_error_max_deg", self.path_error_max_deg, 10.0),
        ];
        for (place, value, most) in bounded {
            if !(value > 0.0 && value <= most) {
                let remedy = format!("give more than 0 and at most {most}");
                return Err(Invalid::new(place, format!("is {value}"), remedy));
            }
        }
        Ok(())
    }

    /// The speeds of an arm under these settings, depending on whether its zeros are known.
    #[must_use]
    pub fn rates<const N: usize, A: Arm<N>>(&self, arm: &A, calibrated: bool) -> Rates<N> {
        let share = if calibrated { self.speed } else { self.speed_uncalibrated };
        Rates {
            joints_rad_s: arm.speed_max() * share,
            ramp_s: self.ramp_s,
            line_m_s: self.line_mm_s * 1e-3,
            turn_rad_s: self.turn_deg_s.to_radians(),
            off_max_rad: self.path_error_max_deg.to_radians(),
        }
    }
}

/// One session in one of the MANUAL states.
#[derive(Clone, Copy, Debug)]
struct ManualSession<const N: usize, A: Arm<N>> {
    law: Law<N, A>,
    /// When it began.
    entered_ns: i64,
    /// The zero of the angles that it counts from.
    datum: u32,
}

/// The task.
pub struct Jog<const N: usize = 6, A: Arm<N> = Puma260> {
    config: Config,
    arm: A,
    dead_man: Nanos,
    control: Input<ControlState>,
    desired: Input<Desired<N>>,
    joints: Input<JointState<N>>,
    command: Input<JogCommand>,
    goal: Output<Goal<N>>,
    state: Output<JogState>,
    /// The last value of `state`; none before the first job.
    jog_state: Option<JogState>,
    session: Option<ManualSession<N, A>>,
    /// Sequence of the newest command, and when it was first seen.
    seen: Option<(u32, Nanos)>,
    last: Option<Nanos>,
}

impl<const N: usize, A: Arm<N>> Jog<N, A> {
    /// Declares `control`, `desired`, `joints`, `command`, `goal` and `state`.
    ///
    /// # Errors
    /// What [`Config::check`] refuses.
    pub fn new(
        config: Config,
        robot: &Robot<N, A>,
        ports: &mut Ports,
    ) -> Result<Jog<N, A>, Invalid> {
        config.check()?;
        #[expect(clippy::cast_possible_truncation, reason = "at most a tenth of a second")]
        let dead_man = Nanos((config.key_timeout_s * 1e9).round() as i64);
        Ok(Jog {
            config,
            arm: robot.arm,
            dead_man,
            control: ports.input("control"),
            desired: ports.input_delayed("desired"),
            joints: ports.input("joints"),
            command: ports.input("command"),
            goal: ports.output("goal"),
            state: ports.output("state"),
            jog_state: None,
            session: None,
            seen: None,
            last: None,
        })
    }

    /// The command of the keys that are held and confirmed. The very first command counts only from
    /// its next confirmation on, because the key may have been held before the task started. `Err`
    /// means that a key is no longer confirmed.
    fn demand(&mut self, command: Option<JogCommand>, now: Nanos) -> Result<JogDemand, JogDemand> {
        let Some(command) = command else { return Ok(JogDemand::ZERO) };
        let held = command.axes.iter().any(|axis| *axis != 0.0);
        match self.seen {
            Some((sequence, since)) if sequence == command.sequence => {
                if now - since > self.dead_man {
                    return if held { Err(JogDemand::ZERO) } else { Ok(JogDemand::ZERO) };
                }
            }
            Some(_) => self.seen = Some((command.sequence, now)),
            None => {
                self.seen = Some((command.sequence, now - self.dead_man - Nanos(1)));
                return Ok(JogDemand::ZERO);
            }
        }
        Ok(match JogFrame::from_code(command.frame) {
            Some(frame) => JogDemand { axes: command.axes, frame },
            None => JogDemand::ZERO,
        })
    }

    /// Starts or ends the session with the state. `None` outside the MANUAL states and without
    /// joints to start from.
    fn update_session(
        &mut self,
        control: Option<ControlState>,
        desired: Option<Desired<N>>,
        joints: Option<JointState<N>>,
    ) -> Option<State> {
        let control = control?;
        let state = State::from_code(control.state)?;
        let manual = matches!(
            state,
            State::ManualUncalibrated | State::ManualJoint | State::ManualCartesian
        );
        let joints = joints.filter(|_| manual)?;
        if self.session.is_some_and(|session| {
            session.entered_ns == control.entered_ns && session.datum == joints.datum
        }) {
            return Some(state);
        }
        let start = desired.filter(|desired| desired.valid == 1)?;
        let calibrated = joints.calibrated == 1;
        if state != State::ManualUncalibrated && !calibrated {
            return None;
        }
        let rates = self.config.rates(&self.arm, state != State::ManualUncalibrated);
        let limited = state != State::ManualUncalibrated;
        let law = Law::new(&self.arm, &rates, &JointVector::from(start.q_rad), limited);
        self.session =
            Some(ManualSession { law, entered_ns: control.entered_ns, datum: joints.datum });
        Some(state)
    }
}

/// The command that a state allows: joints in the joint states, the tool in the Cartesian one.
fn allowed(state: State, demand: JogDemand) -> Result<JogDemand, JogDemand> {
    let joints = demand.frame.is_joints();
    let released = demand.axes == [0.0; 6];
    if joints != (state == State::ManualCartesian) || released {
        Ok(demand)
    } else {
        Err(JogDemand::ZERO)
    }
}

/// The reason why the command does not move the arm: the operator is silent or commands axes that
/// the state does not allow, or else the arm itself is at a limit.
fn jog_state<const N: usize>(operator: JogObstacle, step: &Step<N>) -> JogState {
    let arm = step.obstacle.unwrap_or(Obstacle { kind: operator, joint: None });
    if arm.kind == JogObstacle::None {
        return JogState::ZERO;
    }
    JogState {
        obstacle: arm.kind as u32,
        joint: arm.joint.and_then(|joint| u32::try_from(joint + 1).ok()).unwrap_or(0),
        stopped: u32::from(step.qd.amax() < STANDSTILL_SPEED_RAD_S),
    }
}

impl<const N: usize, A: Arm<N>> Task for Jog<N, A> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let elapsed = self.last.map_or(cycle.dt, |last| cycle.release - last).max(cycle.dt);
        self.last = Some(cycle.release);
        let control = io.read(&self.control).usable();
        let desired = io.read(&self.desired).usable();
        let joints = io.read(&self.joints).usable();
        let command = io.read(&self.command).usable();
        let demand = self.demand(command, cycle.release);
        let state = self.update_session(control, desired, joints);
        let (goal, now) = match (state, &mut self.session) {
            (Some(state), Some(session)) => {
                let (demand, operator) = match demand.map(|demand| allowed(state, demand)) {
                    Ok(Ok(demand)) => (demand, JogObstacle::None),
                    Ok(Err(demand)) => (demand, JogObstacle::Frame),
                    Err(demand) => (demand, JogObstacle::Silent),
                };
                let step = session.law.step(&demand, elapsed.as_secs_f64());
                let goal =
                    Goal { q_rad: step.q.into(), qd_rad_s: step.qd.into(), valid: 1, done: 0 };
                (goal, jog_state(operator, &step))
            }
            _ => {
                self.session = None;
                (Goal::ZERO, JogState::ZERO)
            }
        };
        io.write(&self.goal, goal);
        if self.jog_state != Some(now) {
            io.write(&self.state, now);
            self.jog_state = Some(now);
        }
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.seen).add(&self.last).add(&self.jog_state);
        hash.word(u64::from(self.session.is_some()));
        if let Some(session) = &self.session {
            hash.add(&session.entered_ns).add(&session.datum);
            session.law.fold(hash);
        }
    }

    fn stop(&mut self) {
        self.session = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unusable_settings_are_refused_with_their_place() {
        assert_eq!(Config::default().check(), Ok(()));
        type Set = fn(&mut Config, f64);
        let all: [(&str, Set); 7] = [
            ("speed", |c, x| c.speed = x),
            ("speed_uncalibrated", |c, x| c.speed_uncalibrated = x),
            ("line_mm_s", |c, x| c.line_mm_s = x),
            ("turn_deg_s", |c, x| c.turn_deg_s = x),
            ("ramp_s", |c, x| c.ramp_s = x),
            ("key_timeout_s", |c, x| c.key_timeout_s = x),
            ("path_error_max_deg", |c, x| c.path_error_max_deg = x),
        ];
        for (place, set) in all {
            for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0, 1e9] {
                let mut config = Config::default();
                set(&mut config, bad);
                assert_eq!(config.check().unwrap_err().place, place, "{bad}");
            }
        }
    }

    #[test]
    fn joints_and_tool_have_states_of_their_own() {
        let of = |frame| JogDemand { axes: [1.0; 6], frame };
        for state in [State::ManualUncalibrated, State::ManualJoint] {
            assert_eq!(allowed(state, of(JogFrame::Joints)), Ok(of(JogFrame::Joints)));
            assert_eq!(allowed(state, of(JogFrame::Outer)), Ok(of(JogFrame::Outer)));
            assert_eq!(allowed(state, of(JogFrame::Base)), Err(JogDemand::ZERO));
            assert!(allowed(state, JogDemand { axes: [0.0; 6], frame: JogFrame::Base }).is_ok());
        }
        let tool = of(JogFrame::Tool);
        assert_eq!(allowed(State::ManualCartesian, tool), Ok(tool));
        assert_eq!(allowed(State::ManualCartesian, of(JogFrame::Joints)), Err(JogDemand::ZERO));
    }
}
