//! The service over real boards as a function: [`process::main`] is its command line,
//! [`service::Service`] the machine over the boards of one configuration file. No simulator can be
//! reached from here.

pub mod process;
pub mod service;
mod systemd;
