//! `taktil log`: recordings as files. What is in one, its messages as text, and new files made of
//! old ones: segments joined, a cut file made whole, some signals for some time, a file for
//! viewers. A file that is read is never written.

mod cat;
mod export;
mod info;
mod rewrite;

use std::path::PathBuf;
use std::process::ExitCode;

use taktil_machine_console::option::BadOption;
use taktil_record::Log;
use taktil_rtcore::Nanos;

/// The subcommands.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum LogCommand {
    /// What is in a log: duration, signals with counts and rates, gaps, damage.
    ///
    /// Exit code 0: whole; 1: cut, damaged or with gaps; 2: not a log.
    Info {
        /// Log file (MCAP)
        log: PathBuf,
        /// One JSON object instead of sentences
        #[arg(long)]
        json: bool,
    },
    /// The messages of a log, one a line, in the order of the file.
    ///
    /// Exit code 0: printed; 2: no such log or signal.
    Cat {
        /// Log file (MCAP)
        log: PathBuf,
        /// Which messages
        #[command(flatten)]
        part: Part,
        /// One JSON object a line
        #[arg(long)]
        json: bool,
        /// A table with a heading; of one signal
        #[arg(long, conflicts_with = "json")]
        csv: bool,
    },
    /// Join the files of one recording into one, with one index, without what stands in two of
    /// them.
    ///
    /// The files are put in order of time. Exit code 0: written; 2: files of different recordings,
    /// or none.
    Pack {
        /// Log files (MCAP) of one recording
        #[arg(required = true)]
        logs: Vec<PathBuf>,
        /// File to write
        #[arg(long, value_name = "F.mcap")]
        out: PathBuf,
        /// One JSON object instead of sentences
        #[arg(long)]
        json: bool,
    },
    /// Make a whole log of one that was cut or damaged, and say what is lost.
    ///
    /// Everything before the first bad byte is kept. Exit code 0: written; 2: not a log.
    Recover {
        /// Log file (MCAP)
        log: PathBuf,
        /// File to write
        #[arg(long, value_name = "F.mcap")]
        out: PathBuf,
        /// One JSON object instead of sentences
        #[arg(long)]
        json: bool,
    },
    /// Write a log for common viewers: joints, frames, tactile images and the robot in their own
    /// messages beside the recording's, at times of the wall clock.
    ///
    /// Foxglove, Lichtblick and Rerun draw robot, pin and images of it, PlotJuggler its joints. It
    /// stays a log: `taktil plot` and the other commands read it. Exit code 0: written; 2: not a
    /// log, or one that does not say what ran.
    Export {
        /// Log file (MCAP)
        log: PathBuf,
        /// File to write
        #[arg(long, value_name = "F.mcap")]
        out: PathBuf,
        /// Which messages
        #[command(flatten)]
        part: Part,
        /// Joints and frames a second; every image is written
        #[arg(long, value_name = "HZ", default_value_t = 50.0, allow_negative_numbers = true)]
        rate: f64,
        /// One JSON object instead of sentences
        #[arg(long)]
        json: bool,
    },
    /// Write some signals, or some time, of a log as a log of its own.
    ///
    /// Exit code 0: written; 2: no such log or signal.
    Filter {
        /// Log file (MCAP)
        log: PathBuf,
        /// File to write
        #[arg(long, value_name = "F.mcap")]
        out: PathBuf,
        /// Which messages
        #[command(flatten)]
        part: Part,
        /// One JSON object instead of sentences
        #[arg(long)]
        json: bool,
    },
}

/// Which messages of a log.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Part {
    /// Signals, separated by commas; all of them when absent
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    signal: Vec<String>,
    /// From this logical time on (s)
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    from: Option<f64>,
    /// Up to this logical time, without it (s)
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    to: Option<f64>,
}

impl Part {
    /// Leaves out of `log` what is not wanted.
    ///
    /// # Errors
    /// A signal that the log does not have, times that are none.
    fn apply(&self, log: &mut Log) -> Result<(), BadOption> {
        let mut wanted = vec![self.signal.is_empty(); log.channels().len()];
        for name in &self.signal {
            let Some(channel) = log.find(name) else {
                let all: Vec<&str> = log.channels().iter().map(|c| c.signal.as_str()).collect();
                return Err(BadOption(format!(
                    "--signal {name}: the log has no such signal; it has {}",
                    all.join(", ")
                )));
            };
            wanted[channel] = true;
        }
        let from = instant("--from", self.from)?.unwrap_or(Nanos(i64::MIN));
        let to = instant("--to", self.to)?.unwrap_or(Nanos::MAX);
        if from >= to {
            return Err(BadOption("--from: there is no time before --to".to_owned()));
        }
        log.retain(|message| {
            wanted[message.channel] && (from.0..to.0).contains(&message.release_ns)
        });
        Ok(())
    }
}

/// An instant of the command line.
fn instant(option: &str, seconds: Option<f64>) -> Result<Option<Nanos>, BadOption> {
    let Some(seconds) = seconds else { return Ok(None) };
    if !(-1e9..=1e9).contains(&seconds) {
        return Err(BadOption(format!("{option} {seconds}: give a number of seconds")));
    }
    #[expect(clippy::cast_possible_truncation, reason = "at most 1e9 s")]
    Ok(Some(Nanos((seconds * 1e9).round() as i64)))
}

/// Does what the command line says.
///
/// # Errors
/// A log, signal or file that cannot be used, as [`BadOption`].
pub fn run(what: &LogCommand) -> anyhow::Result<ExitCode> {
    match what {
        LogCommand::Info { log, json } => info::run(log, *json),
        LogCommand::Cat { log, part, json, csv } => cat::run(log, part, *json, *csv),
        LogCommand::Pack { logs, out, json } => rewrite::pack(logs, out, *json),
        LogCommand::Recover { log, out, json } => rewrite::recover(log, out, *json),
        LogCommand::Export { log, out, part, rate, json } => {
            export::run(log, out, part, *rate, *json)
        }
        LogCommand::Filter { log, out, part, json } => rewrite::filter(log, out, part, *json),
    }
}

/// Reads a log; whatever is wrong with it is wrong with the command line.
fn open(path: &std::path::Path) -> Result<Log, BadOption> {
    Log::open(path).map_err(|error| BadOption(format!("{error:#}")))
}
