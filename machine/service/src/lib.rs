//! The service over real boards: [`process::main`] is its command line, [`service::Service`] is the
//! machine over the boards of one configuration file. This crate does not depend on the simulator.

pub mod process;
pub mod service;
mod systemd;
