//! `taktil hal`: boards, real and emulated.

use std::process::ExitCode;

pub mod check;
pub mod drivers;
pub mod emulate;
pub mod list;

/// What is done with boards.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Hal {
    /// What is plugged in that a driver could open: serial ports, cards, boards in memory.
    ///
    /// Works without any board and without root, and says what it could not look at. Nothing is
    /// written to a device but a question to a card.
    List(list::ListArgs),
    /// Open the boards of a configuration and see whether they keep what their drivers promise.
    ///
    /// Times of each half against its declared wait, lost exchanges, noise, frames and tactels of
    /// each array; on request wires from outputs to inputs, joints turned by hand and the bite of
    /// the watchdog. Drives stay off unless --drive is given. Writes a report with pictures.
    Check(check::CheckArgs),
    /// The drivers of this program, and what may stand in a section of a device.
    Drivers(drivers::DriversArgs),
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
/// As the function `run` of the module of each command.
pub fn run(command: &Hal) -> anyhow::Result<ExitCode> {
    match command {
        Hal::List(arguments) => list::run(arguments),
        Hal::Check(arguments) => check::run(arguments),
        Hal::Drivers(arguments) => drivers::run(arguments),
        Hal::Emulate(arguments) => emulate::run(arguments),
    }
}
