//! The payloads that flow between tasks: those of every port that more than one crate has to know.
//!
//! Joint quantities are in rad, rad/s and N m in the order of joints 1 to 6; tactile quantities are
//! in counts and tactel numbers (columns x = 1..16 along the sensor's x axis, rows y = 1..16 along
//! its y axis); positions are in m in the base frame. This crate holds values and no behaviour:
//! control laws live in tasks, mathematics in `mechanics`, the codes of faults and modes in
//! `rtcore`.
//!
//! # Written and read
//!
//! A payload has a fixed size and no padding that is not zero, so that the same values always give
//! the same bytes; what a log or another process reads back is the value that was written.
//!
//! ```
//! use taktil_rtcore::{Mode, Payload};
//! use taktil_signal::{ControlState, Goal, State};
//!
//! let goal = Goal::<6> { q_rad: [0.0, -0.4, 0.9, 0.0, 0.5, 0.0], valid: 1, ..Goal::ZERO };
//! let mut body = [0; <Goal<6>>::SIZE];
//! goal.encode(&mut body);
//! assert_eq!(<Goal<6>>::decode(&body), Some(goal));
//! assert_eq!(<Goal<6>>::FIELDS[0].name, "q_rad");
//!
//! // Enumerations travel as numbers; a mode that nobody knows is FAULT, which allows no torque.
//! let mut control = ControlState { mode: Mode::Hold.code(), ..ControlState::ZERO };
//! assert_eq!(State::from_code(control.state), Some(State::Start));
//! assert!(control.mode().torque_allowed());
//! control.mode = 99;
//! assert_eq!(control.mode(), Mode::Fault);
//! ```

pub mod motion;
pub mod renamed;
pub mod state;
pub mod touch;

pub use motion::{
    Applied, Desired, Drives, Goal, HomeCheck, JOINTS_MAX, JointState, Lines, MoveCheck, MoveKind,
    MoveQueue, OperatorMove, Torque, check_degrees, is_in_radians, per_joint,
};
pub use state::{ControlState, JogCommand, JogFrame, JogObstacle, JogState, Request, State, Verb};
pub use touch::{
    AnalogInputs, Contact, Features, FingertipPair, GraspState, PhaseChange, Slip,
    TACTEL_SATURATED, TactileBaseline, TactileImage, WRENCH_OVER_RANGE, WRENCH_SATURATED, Wrench,
    contact, defined, phase_cause, slip,
};
