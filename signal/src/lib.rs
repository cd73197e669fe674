//! What flows between tasks: the payloads of every port that more than one crate has to know.
//!
//! Values only. Joint quantities are in rad, rad/s and N m in the order of joints 1 to 6; tactile
//! quantities are in counts and tactel numbers (columns x = 1..16 along the sensor's x axis, rows y
//! = 1..16 along its y axis); positions in m in the base frame. Refuses behaviour: laws live in
//! tasks, mathematics in `mechanics`, codes of faults and modes in `rtcore`.

pub mod motion;
pub mod state;
pub mod touch;

pub use motion::{
    Applied, Desired, Goal, HomeCheck, JointState, Lines, MoveCheck, MoveKind, Torque, Typed,
    TypedMove, per_joint,
};
pub use state::{ControlState, JogCommand, JogFrame, JogState, JogWhy, Request, State, Verb};
pub use touch::{
    Contact, Features, MAX_TACTELS, Pair, SATURATED, TactileBaseline, TactileImage, Wrench,
    contact, defined,
};
