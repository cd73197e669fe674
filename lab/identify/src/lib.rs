//! `taktil identify`: identifies parameters of the robot and of a touch task from the log of a run.
//! It moves nothing: `taktil run` or the service makes the run.

pub mod calibrate;
pub mod friction;
pub mod jacobian;

use std::path::PathBuf;
use std::process::ExitCode;

use taktil_machine_console::out;

use taktil_machine_console::option::BadOption;
use taktil_record::Log;

/// What can be identified.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Identify {
    /// Coulomb and viscous friction of each joint, with uncertainties, beside the model's.
    ///
    /// Every joint has to have moved both ways at several speeds, in the air: see
    /// sim/scenes/friction.toml. Exit code 0: all six joints; 1: a joint moved too little.
    Friction {
        /// Log file (MCAP) of `taktil run --log` or `taktild --log`
        log: PathBuf,
        /// One JSON object instead of the table
        #[arg(long)]
        json: bool,
    },
    /// The feature Jacobian of a task of touch, from small test motions in contact.
    ///
    /// The finger stands in contact, moves a little along or about one axis of the sensor, stands
    /// again, and so on both ways: see sim/scenes/identify-jacobian.toml. Printed are the Jacobian
    /// with uncertainties, which motions the image tells apart, and a `task_frame` with its
    /// condition number. Exit code 0: found; 1: no motion can be told; 2: bad input.
    Jacobian(jacobian::Options),
}

/// Identifies what was requested.
///
/// # Errors
/// [`BadOption`] for a log that cannot be used.
pub fn run(what: &Identify) -> anyhow::Result<ExitCode> {
    let path = match what {
        Identify::Friction { log, .. } => log,
        Identify::Jacobian(options) => &options.log,
    };
    let log = Log::open(path).map_err(|error| BadOption(format!("{error:#}")))?;
    if let Some(damage) = log.damage() {
        out::warn(format_args!("note: the log is {damage}"));
    }
    match what {
        Identify::Friction { json, .. } => friction::run(&log, *json),
        Identify::Jacobian(options) => jacobian::run(&log, options),
    }
}
