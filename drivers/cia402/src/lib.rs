//! Drives after CiA 402 (IEC 61800-7-201), whatever bus they hang on: the power state machine and
//! the controlwords that lead through it, modes of operation, a start without a jump, units, and
//! error codes as texts for people. Nothing here does I/O, knows time, allocates or panics, so that
//! a job may call all of it.
//!
//! # A drive is enabled
//!
//! The words of a drive that follows each command at once:
//!
//! ```
//! use taktil_drivers_cia402::{Command, Goal, PowerStateMachine, State, Statusword};
//!
//! let mut machine = PowerStateMachine::new();
//! let command = Command { goal: Goal::Enabled, fault_reset: false };
//! let words = [0x0250, 0x0231, 0x0233, 0x1237].map(Statusword);
//! let commands = words.map(|status| machine.step(status, command).0);
//! assert_eq!(commands, [0x0006, 0x0007, 0x000f, 0x000f]);
//! assert_eq!(words[3].state(), Ok(State::OperationEnabled));
//!
//! // A fault ends it. It takes two acts to move again: a reset, and another wish to enable.
//! assert_eq!(machine.step(Statusword(0x0218), command).0, 0x0000);
//! assert!(machine.needs_reset());
//! ```

pub mod control;
pub mod error_code;
pub mod mode;
pub mod object;
pub mod power;
pub mod status;
pub mod target;
pub mod units;

pub use control::Controlword;
pub use error_code::error_text;
pub use mode::Mode;
pub use object::Object;
pub use power::{Command, EnableLine, Goal, Inhibition, PowerStateMachine, QuickStopOption};
pub use status::{Inconsistency, State, Statusword};
pub use target::{CyclicTarget, PositionTarget};
pub use units::{InterpolationPeriod, PositionScale, RatedTorque};
