//! The command line of the program that makes boards safe after the process that drove them has
//! died: it opens every board that the service's configuration names, writes the safe values of its
//! outputs and closes it. A board that another process drives is left to it.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, Parser};
use taktil_machine_boards::{self as registry, Driver};
use taktil_machine_console::out;

use crate::boards::make_safe;

/// Writes the safe values of the outputs of every board that a service's configuration names:
/// drives off, brakes on, zero volts. For the time after the service has died.
#[derive(Parser, Debug)]
#[command(
    name = "taktil-safe",
    version = env!("TAKTIL_VERSION"),
    after_help = "\
Exit codes: 0 every board with outputs is safe, 1 one of them could not be made safe, 2 a
configuration, or the section of a board, that cannot be used; the other boards are made safe all
the same."
)]
struct Arguments {
    /// Configuration file of the service
    #[arg(long, value_name = "FILE", default_value = "/etc/taktil/taktild.toml")]
    config: PathBuf,
}

/// The definition of the command line: options and their help.
#[must_use]
pub fn definition() -> clap::Command {
    Arguments::command()
}

/// Runs the command line of this process; devices may name `drivers` like Taktil's own.
#[must_use]
pub fn main(drivers: &'static [Driver]) -> ExitCode {
    if let Err(bad) = registry::register(drivers) {
        out::warn(bad);
        return ExitCode::from(2);
    }
    let boards = match make_safe(&Arguments::parse().config) {
        Ok(boards) => boards,
        Err(located) => {
            out::warn(&located);
            return ExitCode::from(2);
        }
    };
    let mut code = 0;
    for (name, outcome) in boards {
        match outcome {
            Ok(()) => out::warn(format_args!("{name}: safe")),
            Err(why) => {
                out::warn(format_args!("{name}: not safe\n{}", why.located));
                // Which board a section stands for that cannot be used, nobody knows: that weighs
                // more than a board that failed.
                code = code.max(if why.is_configuration { 2 } else { 1 });
            }
        }
    }
    ExitCode::from(code)
}
