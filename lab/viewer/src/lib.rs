//! Writes a log for common viewers (Foxglove, Lichtblick, Rerun, PlotJuggler): every message of the
//! recording as it is, and beside them what a viewer draws without being told how: the joints, the
//! frames of the links, pin and table, tactile images and the shapes that belong to the frames, in
//! the well-known messages of the package `foxglove` in protobuf, and a description of the robot in
//! URDF. Times are those of the wall clock.

pub mod arm;
mod export;
mod messages;
mod protobuf;
mod schemas;
mod truth;

pub use arm::ArmDrawing;
pub use export::{ExportOptions, Exported, export};
