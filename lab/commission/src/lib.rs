//! The first power-up of a robot whose wiring nobody knows: which encoder and which motor belong to
//! which joint, which way they count and drive, and their scales, found at low torque, one joint at
//! a time. What was found becomes the section `[joints]` of a machine file.
//!
//! The order of things keeps the robot from running away. Before a joint's direction is known, its
//! motor gets nothing but single pulses of torque, which grow until some encoder moves by a few
//! counts; the brakes are on between them, and the end of a pulse never waits for a decision. Only
//! then is the loop closed. [`Commissioning`] drives any [`taktil_hal::Devices`]; a [`Pace`] lets
//! time pass, which is a clock before boards and the world's own time before a simulated robot.
//!
//! Nothing here knows which joint a motor moves unless somebody looks: the [`Witness`] says which
//! joint moved and which way, and gravity contradicts him where it can.

mod assignment;
mod cell;
mod excite;
mod findings;
mod fit;
mod model;
mod pairing;
mod probe;
mod procedure;
mod servo;
pub mod simulated;
mod stop;
mod travel;
mod unseen;

pub use cell::{Cell, Pace, Punctuality};
pub use findings::{Findings, JointFindings, Source};
pub use model::Model;
pub use procedure::{Commissioning, Options, Progress};
pub use stop::Stop;
pub use witness::{Answer, Shown, Witness};

mod witness;
