//! Writes a log for common viewers (Foxglove, Lichtblick, Rerun, PlotJuggler): every message of the
//! recording as it is, and beside them what a viewer draws without being told how: the joints, the
//! frames of the links, pin and table, tactile images and the shapes that belong to the frames, in
//! the well-known messages of the package `foxglove` in protobuf, and a description of the robot in
//! URDF. Times are those of the wall clock.

mod export;
mod truth;

pub use export::{ExportOptions, Exported, export};
pub use taktil_machine_foxglove::ArmDrawing;
