//! The command line of Taktil as a function of the tasks that a program adds: [`main`] reads the
//! arguments, runs the command and returns the exit code. Each command is a module here, or a crate
//! of its own under `lab`.

pub mod arm;
pub mod bench;
pub mod cli;
pub mod commission;
pub mod diff;
pub mod hal;
mod input;
pub mod keys;
pub mod log;
pub mod new_crate;
pub mod observe;
pub mod pages;
pub mod postmortem;
pub mod replay;
pub mod run;
pub mod scenes;
pub mod sim;
pub mod tell;

pub use cli::main;
