//! The service over real boards: [`process::main`] is its command line, [`service::Service`] is the
//! machine over the boards of one configuration file, and [`boards::open_boards`] opens these
//! alone. This crate does not depend on the simulator.

pub mod boards;
mod latched_faults;
mod monitor;
pub mod process;
mod recording;
pub mod safe;
pub mod service;
mod systemd;
pub mod viewer;
