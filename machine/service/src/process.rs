//! The service's command line: arguments and exit codes. [`Service`] loads, checks and runs the
//! machine.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, Parser};

use crate::service::Service;
use taktil_machine::own::{self, OwnTask};
use taktil_machine::source::Located;
use taktil_machine_boards::{self as boards, Driver};
use taktil_machine_console::{out, signals};
use taktil_rtcore::{Nanos, linux};

/// Robot control over real boards, as a systemd service. It comes up with the drives off and waits
/// in READY.
#[derive(Parser, Debug)]
#[command(
    name = "taktild",
    version = env!("TAKTIL_VERSION"),
    after_help = "\
Exit codes: 0 ended by SIGTERM or SIGINT (--check: read), 1 the machine or its record failed,
2 a configuration that cannot be used, 3 a task that does not return."
)]
struct Arguments {
    /// Configuration file: machine, board, contract with the kernel
    #[arg(long, value_name = "FILE", default_value = "/etc/taktil/taktild.toml")]
    config: PathBuf,
    /// Read the configuration, open the board, print what would run, and end
    #[arg(long)]
    check: bool,
    /// Run as root: a mistake of this process can then do anything to the host
    #[arg(long)]
    allow_root: bool,
    /// Record the run to this MCAP file, instead of the configuration's `[log] path`
    #[arg(long, value_name = "F.mcap")]
    log: Option<PathBuf>,
}

/// How long the end of the process waits for the journal to read.
const FAREWELL_TIMEOUT: Nanos = Nanos::from_millis(300);

/// What root is told.
const ROOT_REFUSED: &str = "error: the service does not run as root, whose mistakes have no bounds
  = start it by its unit (`systemctl start taktild`), or as a user who may use the boards and
    real-time priorities; `--allow-root` runs it nevertheless";

/// The definition of the command line: options and their help.
#[must_use]
pub fn definition() -> clap::Command {
    Arguments::command()
}

/// Runs the command line of this process; lanes may name `tasks`, and devices
/// `drivers`, like Taktil's own.
#[must_use]
pub fn main(tasks: &'static [OwnTask], drivers: &'static [Driver]) -> ExitCode {
    if let Err(bad) = own::register(tasks).and_then(|()| boards::register(drivers)) {
        out::warn(bad);
        return ExitCode::from(2);
    }
    let arguments = Arguments::parse();
    // Before the first thread, which may be one of a driver.
    if let Err(error) = signals::block() {
        return fail(&error);
    }
    let mut service = match Service::load(&arguments.config) {
        Ok(service) => service,
        Err(located) => {
            out::warn(&located);
            return ExitCode::from(2);
        }
    };
    if let Some(path) = arguments.log {
        service.record_to(path);
    }
    if arguments.check {
        return match out::text(service.describe()) {
            Ok(_) => ExitCode::SUCCESS,
            Err(error) => fail(&error),
        };
    }
    if linux::is_root() && !arguments.allow_root {
        out::warn(ROOT_REFUSED);
        return ExitCode::from(2);
    }
    // From here on nobody waits for the reader of the journal.
    if let Err(error) = out::write_errors_behind() {
        return fail(&anyhow::Error::new(error).context("no thread for the journal"));
    }
    let code = match service.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(&error),
    };
    out::flush_errors(FAREWELL_TIMEOUT);
    code
}

fn fail(error: &anyhow::Error) -> ExitCode {
    match error.downcast_ref::<Located>() {
        Some(located) => {
            out::warn(located);
            ExitCode::from(2)
        }
        None => {
            out::complain(error);
            ExitCode::from(1)
        }
    }
}
