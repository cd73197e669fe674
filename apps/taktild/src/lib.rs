//! The service's parts that others use too: the machine file, the wiring, and complaints that name
//! file and line. The shipped service cannot contain a simulator: this crate does not know one.

pub mod config;
pub mod contract;
pub mod cpus;
pub mod operator;
pub mod own;
pub mod process;
pub mod robot;
pub mod service;
pub mod source;
pub mod tape;
pub mod urdf;
pub mod wiring;
