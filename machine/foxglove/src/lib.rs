//! The well-known messages of the package `foxglove`, which common viewers (Foxglove, Lichtblick,
//! Rerun, PlotJuggler) draw without being told how: joints, frames of links, tactile images, and
//! bodies that belong to frames. They are encoded in the wire format of Protocol Buffers, together
//! with the descriptors that a reader needs, and with a description of the robot in URDF.
//!
//! Logs for viewers, recordings and the server for live viewers write the same messages from here.
//! Nothing here reads a clock, a file or a socket.

mod arm;
mod bench;
mod messages;
mod protobuf;
mod schemas;
pub mod view;

pub use arm::ArmDrawing;
pub use bench::BenchInstant;
pub use messages::WallTime;
pub use schemas::descriptor_set;
pub use view::{JointValues, RobotView};

/// Encoding of the messages, as channels name it.
pub const MESSAGE_ENCODING: &str = "protobuf";
