//! The states of the robot control program (figure 6.2 of the thesis) as a pure table above the
//! mode machine, which alone decides whether anything may move. It depends on no time, has no ports
//! and keeps no state.
//!
//! ```text
//!                       ┌────────────────────────────────────────────┐
//!   drive power, then   │                   START                    │  drives off, from every
//!   `enable`: the mode  │ mode OFF, CHECKING, READY, ENABLING, FAULT │<── state: a stop has ended,
//!   goes to HOLD        └───────────────────┬────────────────────────┘    or a fault
//!                                           │ by itself, in HOLD
//!                                           v
//! ┌─────────────────────┐ manual_uncalibrated ┌───────────────────┐
//! │ MANUAL/UNCALIBRATED │ <────────────────── │ IDLE/UNCALIBRATED │
//! │       MOVING        │ ──────────────────> │       HOLD        │
//! └─────────────────────┘        idle         └─────────┬─────────┘
//!                                                       │ calibrate (in the home pose; back by
//!                                                       │ itself when the index pulses deny it)
//!                                                       v
//!                                             ┌───────────────────┐
//!                                             │  IDLE/CALIBRATED  │
//!                                             │       HOLD        │
//!                                             └───┬───────────────┘
//!      manual_joint, manual_cartesian,            │           ^ idle;
//!      trajectory, trajectory_user,               │           │ TRAJECTORY by itself: done;
//!      tactile_servo                              v           │ TACTILE-SERVO: done or blind
//! ┌──────────────┬──────────────────┬────────────┬────────────┴────┬───────────────┐
//! │ MANUAL/JOINT │ MANUAL/CARTESIAN │ TRAJECTORY │ TRAJECTORY/USER │ TACTILE-SERVO │
//! │    MOVING    │      MOVING      │   MOVING   │     MOVING      │    MOVING     │
//! └──────────────┴──────────────────┴────────────┴─────────────────┴───────────────┘
//! ```
//! `stop` (in ENABLING, HOLD, MOVING) and `reset` (in FAULT) go to the mode machine and leave the
//! state where it is; the state falls back to START when the drives are off. During STOPPING the
//! state does not change otherwise.

use taktil_rtcore::fault::Class;
use taktil_rtcore::mode::{Event, next as next_mode};
use taktil_rtcore::{FaultSet, Mode};
use taktil_signal::{State, Verb};

/// What a transition depends on besides state and verb.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Guard {
    /// The mode in force.
    pub mode: Mode,
    /// The latched faults.
    pub faults: FaultSet,
    /// The zero of the joint angles is known.
    pub calibrated: bool,
    /// A calibration was requested and did not happen in the time that it needs.
    pub denied: bool,
    /// The source of motion of the present state has nothing left to do.
    pub done: bool,
    /// Touch has been missing for longer than can be bridged.
    pub blind: bool,
}

impl Guard {
    /// Nothing is latched that stops the machine.
    #[must_use]
    pub fn is_clear(&self) -> bool {
        self.faults.worst() < Some(Class::ControlledStop)
    }
}

/// The table of the diagram. `Some` is the state that follows, which may be the same one; `None`
/// means that the verb is refused, or, for [`Verb::None`], that nothing happens by itself.
#[must_use]
pub fn next(state: State, verb: Verb, guard: &Guard) -> Option<State> {
    use State as S;
    let hold = guard.mode == Mode::Hold;
    let moving = guard.mode == Mode::Moving;
    let known = hold && guard.calibrated;
    match (state, verb) {
        (_, Verb::None) => automatic_transition(state, guard),
        (S::Start, Verb::Enable) => {
            (guard.mode == Mode::Ready && guard.is_clear()).then_some(state)
        }
        (_, Verb::Stop) => next_mode(guard.mode, Event::Stop).map(|_| state),
        (_, Verb::Reset) => is_resettable(guard).then_some(state),
        (S::IdleUncalibrated, Verb::Calibrate) => hold.then_some(S::IdleCalibrated),
        (S::IdleUncalibrated, Verb::ManualUncalibrated) => hold.then_some(S::ManualUncalibrated),
        (S::ManualUncalibrated, Verb::Idle) => moving.then_some(S::IdleUncalibrated),
        (S::IdleCalibrated, Verb::ManualJoint) => known.then_some(S::ManualJoint),
        (S::IdleCalibrated, Verb::ManualCartesian) => known.then_some(S::ManualCartesian),
        (S::IdleCalibrated, Verb::Trajectory) => known.then_some(S::Trajectory),
        (S::IdleCalibrated, Verb::TrajectoryUser) => known.then_some(S::TrajectoryUser),
        (S::IdleCalibrated, Verb::TactileServo) => {
            (known && !guard.blind).then_some(S::TactileServo)
        }
        (
            S::ManualJoint
            | S::ManualCartesian
            | S::Trajectory
            | S::TrajectoryUser
            | S::TactileServo,
            Verb::Idle,
        ) => moving.then_some(S::IdleCalibrated),
        _ => None,
    }
}

/// The transitions that happen without a request.
fn automatic_transition(state: State, guard: &Guard) -> Option<State> {
    let moving = guard.mode == Mode::Moving;
    match state {
        State::Start => (guard.mode == Mode::Hold).then_some(State::IdleUncalibrated),
        _ if !guard.mode.brakes_released() => Some(State::Start),
        State::IdleCalibrated => {
            (guard.mode == Mode::Hold && guard.denied).then_some(State::IdleUncalibrated)
        }
        State::Trajectory => (moving && guard.done).then_some(State::IdleCalibrated),
        State::TactileServo => {
            (moving && (guard.done || guard.blind)).then_some(State::IdleCalibrated)
        }
        _ => None,
    }
}

/// A latched fault is acknowledged in FAULT; elsewhere when there is one, and no stop for its sake
/// is under way.
fn is_resettable(guard: &Guard) -> bool {
    match guard.mode {
        Mode::Fault => true,
        Mode::Stopping => false,
        _ => !guard.faults.is_empty(),
    }
}

/// Why a verb is refused, for people; `None` where [`next`] grants it. Reasons say what to do.
#[must_use]
pub fn refusal(state: State, verb: Verb, guard: &Guard) -> Option<&'static str> {
    if verb == Verb::None || next(state, verb, guard).is_some() {
        return None;
    }
    let is_stopping = guard.mode == Mode::Stopping;
    Some(match verb {
        Verb::Stop => "nothing moves and the drives are off, or a stop is under way",
        Verb::Reset if is_stopping => "a stop is under way; wait until the arm stands",
        Verb::Reset => "no fault is latched",
        Verb::Enable if state == State::Start => enable_refusal(guard),
        Verb::Enable => "the drives are on already",
        _ if guard.mode == Mode::Fault => "a fault is latched; say `reset`, then `enable`",
        _ if is_stopping => "a stop is under way; wait until the arm stands",
        _ if state == State::Start => "the drives are off; say `enable` first",
        Verb::Idle => "nothing moves that `idle` could end",
        Verb::Calibrate if state == State::IdleCalibrated => "it is calibrated already",
        Verb::ManualUncalibrated if state == State::IdleCalibrated => {
            "it is calibrated; say `manual_joint`"
        }
        _ if required_mode(state) == Some(Mode::Moving) => "another motion is on; say `idle` first",
        Verb::Calibrate | Verb::ManualUncalibrated => "the drives do not hold the arm yet",
        _ if !guard.calibrated => "the joints' zero is not known; say `calibrate` in the home pose",
        Verb::TactileServo if guard.blind => "there is no tactile image to follow",
        _ => "the drives do not hold the arm yet",
    })
}

/// Why the drives cannot be switched on.
fn enable_refusal(guard: &Guard) -> &'static str {
    match guard.mode {
        Mode::Off => "drive power is off; switch it on",
        Mode::Checking => {
            "the checks do not hold yet; where that lasts, an emergency stop is open, or \
             encoders or touch do not answer"
        }
        Mode::Fault => "a fault is latched; say `reset` first",
        Mode::Ready => "a fault is latched that stops the machine; say `reset` first",
        Mode::Stopping => "a stop is under way; wait until the arm stands",
        Mode::Enabling | Mode::Hold | Mode::Moving => "the drives are being switched on",
    }
}

/// The mode that a state needs while nothing is being stopped; START needs none.
#[must_use]
pub const fn required_mode(state: State) -> Option<Mode> {
    match state {
        State::Start => None,
        State::IdleUncalibrated | State::IdleCalibrated => Some(Mode::Hold),
        State::ManualUncalibrated
        | State::ManualJoint
        | State::ManualCartesian
        | State::Trajectory
        | State::TrajectoryUser
        | State::TactileServo => Some(Mode::Moving),
    }
}

/// The event for the mode machine that brings its mode in line with a new state.
#[must_use]
pub fn mode_event(from: State, to: State) -> Option<Event> {
    match (required_mode(from), required_mode(to)) {
        (Some(Mode::Hold), Some(Mode::Moving)) => Some(Event::Move),
        (Some(Mode::Moving), Some(Mode::Hold)) => Some(Event::Settle),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use State as S;
    use Verb as V;
    use taktil_rtcore::FaultCode;

    fn set(fault: Option<FaultCode>) -> FaultSet {
        let mut faults = FaultSet::NONE;
        if let Some(fault) = fault {
            faults.insert(fault);
        }
        faults
    }

    /// Every guard that the table can tell apart.
    fn guards() -> Vec<Guard> {
        let faults = [None, Some(FaultCode::TactileStale), Some(FaultCode::SoftLimit)];
        let mut all = Vec::new();
        for mode in Mode::ALL {
            for fault in faults {
                for bits in 0..16 {
                    all.push(Guard {
                        mode,
                        faults: set(fault),
                        calibrated: bits & 1 != 0,
                        denied: bits & 8 != 0,
                        done: bits & 2 != 0,
                        blind: bits & 4 != 0,
                    });
                }
            }
        }
        all
    }

    /// The arrows of figure 6.2 that a verb draws: from, verb, to, whether the zero must be known.
    const ARROWS: [(State, Verb, State, bool); 13] = [
        (S::IdleUncalibrated, V::Calibrate, S::IdleCalibrated, false),
        (S::IdleUncalibrated, V::ManualUncalibrated, S::ManualUncalibrated, false),
        (S::ManualUncalibrated, V::Idle, S::IdleUncalibrated, false),
        (S::IdleCalibrated, V::ManualJoint, S::ManualJoint, true),
        (S::IdleCalibrated, V::ManualCartesian, S::ManualCartesian, true),
        (S::IdleCalibrated, V::Trajectory, S::Trajectory, true),
        (S::IdleCalibrated, V::TrajectoryUser, S::TrajectoryUser, true),
        (S::IdleCalibrated, V::TactileServo, S::TactileServo, true),
        (S::ManualJoint, V::Idle, S::IdleCalibrated, false),
        (S::ManualCartesian, V::Idle, S::IdleCalibrated, false),
        (S::Trajectory, V::Idle, S::IdleCalibrated, false),
        (S::TrajectoryUser, V::Idle, S::IdleCalibrated, false),
        (S::TactileServo, V::Idle, S::IdleCalibrated, false),
    ];

    #[test]
    fn every_state_verb_and_guard_is_as_drawn() {
        let mut granted = 0;
        for state in State::ALL {
            for verb in Verb::ALL {
                for guard in guards() {
                    let expected = match verb {
                        V::None => continue,
                        V::Enable => {
                            let may = guard.mode == Mode::Ready && guard.is_clear();
                            (state == S::Start && may).then_some(state)
                        }
                        V::Stop => matches!(guard.mode, Mode::Enabling | Mode::Hold | Mode::Moving)
                            .then_some(state),
                        V::Reset => (guard.mode == Mode::Fault
                            || (guard.mode != Mode::Stopping && !guard.faults.is_empty()))
                        .then_some(state),
                        _ => ARROWS
                            .iter()
                            .find(|arrow| (arrow.0, arrow.1) == (state, verb))
                            .filter(|arrow| required_mode(arrow.0) == Some(guard.mode))
                            .filter(|arrow| guard.calibrated || !arrow.3)
                            .filter(|_| verb != V::TactileServo || !guard.blind)
                            .map(|arrow| arrow.2),
                    };
                    assert_eq!(next(state, verb, &guard), expected, "{state:?} {verb:?} {guard:?}");
                    granted += usize::from(expected.is_some());
                }
            }
        }
        assert!(granted > 500, "the test would pass on an empty table: {granted}");
    }

    #[test]
    fn what_happens_by_itself_is_as_drawn() {
        for state in State::ALL {
            for guard in guards() {
                let off = !matches!(guard.mode, Mode::Hold | Mode::Moving | Mode::Stopping);
                let moving = guard.mode == Mode::Moving;
                let expected = if state == S::Start {
                    (guard.mode == Mode::Hold).then_some(S::IdleUncalibrated)
                } else if off {
                    Some(S::Start)
                } else {
                    let over = match state {
                        S::IdleCalibrated => {
                            let denied = guard.mode == Mode::Hold && guard.denied;
                            assert_eq!(
                                next(state, V::None, &guard),
                                denied.then_some(S::IdleUncalibrated)
                            );
                            continue;
                        }
                        S::Trajectory => guard.done,
                        S::TactileServo => guard.done || guard.blind,
                        _ => false,
                    };
                    (moving && over).then_some(S::IdleCalibrated)
                };
                assert_eq!(next(state, V::None, &guard), expected, "{state:?} {guard:?}");
            }
        }
    }

    #[test]
    fn exactly_the_verbs_that_are_refused_have_a_reason() {
        for state in State::ALL {
            for verb in Verb::ALL.into_iter().skip(1) {
                for guard in guards() {
                    let is_refused = next(state, verb, &guard).is_none();
                    let reason = refusal(state, verb, &guard);
                    assert_eq!(reason.is_some(), is_refused, "{state:?} {verb:?} {guard:?}");
                }
            }
        }
        let off = Guard::default();
        assert_eq!(refusal(S::Start, V::Enable, &off), Some("drive power is off; switch it on"));
        let hold = Guard { mode: Mode::Hold, ..off };
        let zero = refusal(S::IdleUncalibrated, V::Trajectory, &hold).unwrap();
        assert!(zero.contains("calibrate"), "{zero}");
    }

    #[test]
    fn no_verb_moves_anything_while_torque_is_off_or_being_taken_away() {
        for state in State::ALL {
            for verb in Verb::ALL {
                for guard in guards() {
                    if guard.mode == Mode::Stopping || !guard.mode.torque_allowed() {
                        let to = next(state, verb, &guard);
                        assert!(
                            to.is_none_or(|to| to == state || to == S::Start),
                            "{state:?} {verb:?} {guard:?} -> {to:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn each_transition_tells_the_mode_machine_what_the_new_state_needs() {
        for state in State::ALL {
            for verb in Verb::ALL {
                for guard in guards() {
                    let Some(to) = next(state, verb, &guard) else { continue };
                    let fits = required_mode(state).is_none_or(|mode| mode == guard.mode);
                    if to == state || to == S::Start || !fits {
                        continue;
                    }
                    let mode = match mode_event(state, to) {
                        Some(mode_event) => next_mode(guard.mode, mode_event),
                        None => Some(guard.mode),
                    };
                    assert_eq!(mode, required_mode(to), "{state:?} {verb:?} -> {to:?}");
                }
            }
        }
    }

    #[test]
    fn tactile_servo_is_reached_from_start_only_through_calibration() {
        let ready = Guard { mode: Mode::Hold, calibrated: true, ..Guard::default() };
        for state in State::ALL.into_iter().filter(|state| *state != S::IdleCalibrated) {
            assert_eq!(next(state, V::TactileServo, &ready), None, "{state:?}");
        }
        assert_eq!(next(S::IdleCalibrated, V::TactileServo, &ready), Some(S::TactileServo));
        let unknown = Guard { calibrated: false, ..ready };
        assert_eq!(next(S::IdleCalibrated, V::TactileServo, &unknown), None);
    }
}
