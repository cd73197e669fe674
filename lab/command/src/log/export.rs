//! `taktil log export`: a log for common viewers.

use std::path::Path;
use std::process::ExitCode;
use std::time::UNIX_EPOCH;

use serde_json::json;
use taktil_lab_scene::origin::Origin;
use taktil_lab_viewer::{ExportOptions, export};
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_machine_service::viewer::drawing;
use taktil_record::{Log, METADATA_RUN};
use taktil_rtcore::Nanos;

use super::Part;
use super::rewrite::{check_out, losses};

/// Bounds of `--rate` (Hz).
const RATE_HZ_MIN: f64 = 0.1;
const RATE_HZ_MAX: f64 = 1000.0;

/// Writes the file.
///
/// # Errors
/// A file that is no log or does not say what ran, options that cannot be used, a file that cannot
/// be written.
pub(super) fn run(
    path: &Path,
    out: &Path,
    part: &Part,
    rate_hz: f64,
    json: bool,
) -> anyhow::Result<ExitCode> {
    if !(RATE_HZ_MIN..=RATE_HZ_MAX).contains(&rate_hz) {
        let what = format!("--rate {rate_hz}: give {RATE_HZ_MIN} to {RATE_HZ_MAX} Hz");
        return Err(BadOption(what).into());
    }
    check_out(out, &[path.to_owned()])?;
    let mut log = super::open(path)?;
    let began = began(&log, path);
    part.apply(&mut log)?;
    let shown = path.display();
    let robot = Origin::of(&log).and_then(|origin| origin.robot());
    let robot = robot.map_err(|why| BadOption(format!("{shown}: {why}")))?;
    #[expect(clippy::cast_possible_truncation, reason = "at most 1e10 ns")]
    let period = Nanos((1e9 / rate_hz) as i64);
    let options = ExportOptions { began, period };
    let written = export(&log, &drawing(&robot), out, options)
        .map_err(|error| BadOption(format!("--out: {error:#}")))?;
    let lost = losses(&[(path.to_owned(), log)]);
    if json {
        out::line(json!({
            "out": out.display().to_string(),
            "messages": written.messages,
            "for_viewers": written.for_viewers,
            "began_unix_ns": began.0,
            "lost": lost,
        }))?;
        return Ok(ExitCode::SUCCESS);
    }
    out::line(format_args!(
        "{}: {} messages, and {} for viewers",
        out.display(),
        written.messages,
        written.for_viewers
    ))?;
    if let Some(lost) = lost {
        out::line(format_args!("lost                       {lost}"))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The instant of the wall clock at which the run began. A recording of the service says when its
/// file was begun; of a run in virtual time only the file's own time is known, and that is when it
/// ended.
fn began(log: &Log, path: &Path) -> Nanos {
    let run = log.metadata().get(METADATA_RUN);
    let said = run.and_then(|run| run.get("began_unix_ns")?.parse::<i64>().ok());
    let first = log.messages().next().map_or(0, |message| message.release_ns);
    if let Some(unix) = said {
        return Nanos(unix.saturating_sub(first).max(0));
    }
    let last = log.messages().map(|message| message.release_ns).max().unwrap_or(0);
    let modified = std::fs::metadata(path).and_then(|about| about.modified()).ok();
    let ended = modified.and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    let ended = ended.and_then(|since| i64::try_from(since.as_nanos()).ok()).unwrap_or(0);
    Nanos(ended.saturating_sub(last).max(0))
}
