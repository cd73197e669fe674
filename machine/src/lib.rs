//! Reads machine files and arms, connects tasks to devices and builds the machine that an executor
//! runs. Errors in a file name its line and the remedy.

pub mod config;
pub mod contract;
pub mod cpus;
mod cross_checks;
pub mod device;
pub mod fault_plan;
pub mod insert;
pub mod joints;
pub mod operator;
pub mod own;
pub mod renamed;
pub mod robot;
pub mod shipped;
pub mod source;
pub mod strict;
pub mod tape;
pub mod touch_task;
pub mod urdf;
pub mod wiring;
