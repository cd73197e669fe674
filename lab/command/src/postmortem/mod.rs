//! `taktil postmortem`: what a flight recorder kept of a process that has ended: last jobs, the
//! task that was running, mode, faults, last values; and the same records as a log. Refuses, with
//! one sentence, whatever is no flight recording, and says of a damaged one how far it goes.

mod about;
mod summary;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use taktil_machine_console::out;
use taktil_rtcore::flight::{self, FlightRecording, LaneRecording};
use taktil_rtcore::record::{Observer, Record};

use about::About;
use summary::PostmortemSummary;
use taktil_machine_console::option::BadOption;
use taktil_record::{METADATA_ATTESTATION, McapLog, read_bytes};

/// What the command line says.
#[derive(Clone, Debug)]
pub struct Options {
    /// The recorder's file.
    pub file: PathBuf,
    /// Log to write.
    pub log: Option<PathBuf>,
    /// JSON instead of sentences.
    pub json: bool,
}

/// Reads a recording and says what it holds.
///
/// # Errors
/// A file that is no recording, or a log that cannot be written, as [`BadOption`].
pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let shown = options.file.display();
    let bad = |why: String| BadOption(format!("{shown}: {why}"));
    let bytes = read_bytes(&options.file, "name a file of `--flight`, or /run/taktil/flight")
        .map_err(|error| bad(error.to_string()))?;
    let found = flight::read(&bytes).map_err(bad)?;
    let about = About::parse(&found).map_err(bad)?;
    if let Some(log) = &options.log {
        if same(log, &options.file) {
            return Err(bad("is what is read; name another log".into()).into());
        }
        write_log(log, &found, &about).map_err(|error| BadOption(format!("{error:#}")))?;
    }
    let summary = PostmortemSummary::new(&options.file, &found, &about);
    if options.json {
        out::line(summary.to_json())?;
    } else {
        out::text(summary.to_text())?;
        if let Some(log) = &options.log {
            out::line(format_args!("log written                taktil plot {}", log.display()))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn same(a: &Path, b: &Path) -> bool {
    let real = |path: &Path| std::fs::canonicalize(path).ok();
    real(a).is_some() && real(a) == real(b)
}

/// All records in order of release, then by lane, as they were written.
fn in_order<'a>(found: &'a FlightRecording, about: &About) -> Vec<Record<'a>> {
    let known = |record: &Record<'_>| {
        about.catalog.signals.get(record.signal).is_some_and(|s| s.size == record.body.len())
    };
    let all = found.lanes.iter().flat_map(LaneRecording::records);
    let mut records: Vec<Record<'a>> = all.filter(known).collect();
    records.sort_by_key(|record| record.release);
    records
}

fn write_log(path: &Path, found: &FlightRecording, about: &About) -> anyhow::Result<()> {
    let mut metadata: BTreeMap<String, String> = about.texts.clone();
    metadata.insert("mode".into(), "postmortem".into());
    metadata.insert("taktil".into(), about.taktil.clone());
    let mut log = McapLog::create(path, &about.catalog, &metadata)?;
    if !found.granted.is_empty() {
        log.write_metadata(METADATA_ATTESTATION, &found.granted);
    }
    for record in in_order(found, about) {
        log.record(&record);
    }
    log.finish()
}
