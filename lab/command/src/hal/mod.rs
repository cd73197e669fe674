//! `taktil hal`: boards, real and emulated.

use std::process::ExitCode;

pub mod emulate;

/// What is done with boards.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Hal {
    /// Serve the simulated robot of a scene over the real interface of boards.
    ///
    /// A driver that opens them in another process finds the motors, encoders and lines of the
    /// scene's robot behind the card, and its touch behind the tactile boards. All boards named at
    /// once serve one world, which runs in real time. Where each is found is printed as
    /// `BOARD at PLACE`, then `ready`; the counts follow at the end.
    Emulate(emulate::EmulateArgs),
}

/// Executes the command.
///
/// # Errors
/// As [`emulate::run`].
pub fn run(command: &Hal) -> anyhow::Result<ExitCode> {
    match command {
        Hal::Emulate(arguments) => emulate::run(arguments),
    }
}
