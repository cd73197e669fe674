//! `taktil postmortem`: what a flight recorder kept of a process that has ended: last jobs, the
//! task that was running, mode, faults, last values; and the same records as a log. Refuses, with
//! one sentence, whatever is no flight recording, and says of a damaged one how far it goes.

mod about;
mod join;
mod summary;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use taktil_machine_console::out;
use taktil_rtcore::flight::{self, FlightRecording, LaneRecording};
use taktil_rtcore::record::{Observer, Record};

use serde_json::json;

use about::About;
use join::JoinedSize;
use summary::PostmortemSummary;
use taktil_machine_console::option::BadOption;
use taktil_record::{Log, METADATA_ATTESTATION, McapLog, read_bytes};

/// What to do about a file that is no recording.
const FILE_REMEDY: &str = "name a file of `--flight`, or /run/taktil/flight";

/// What the command line says.
#[derive(Clone, Debug)]
pub struct Options {
    /// The recorder's file.
    pub file: PathBuf,
    /// Log to write.
    pub log: Option<PathBuf>,
    /// Log of the same run, to be joined with the recording.
    pub join: Option<PathBuf>,
    /// JSON instead of sentences.
    pub json: bool,
}

/// Reads a recording and says what it holds.
///
/// # Errors
/// A file that is no recording, or a log that cannot be written, as [`BadOption`].
pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let shown = options.file.display();
    let bad = |why: String| match why.contains(';') {
        true => BadOption(format!("{shown}: {why}")),
        false => BadOption(format!("{shown}: {why}; {FILE_REMEDY}")),
    };
    let bytes =
        read_bytes(&options.file, FILE_REMEDY).map_err(|error| bad(format!("{error:#}")))?;
    let found = flight::read(&bytes).map_err(bad)?;
    let about = About::parse(&found).map_err(bad)?;
    let joined = write_logs(options, &found, &about)?;
    let summary = PostmortemSummary::new(&options.file, &found, &about);
    if options.json {
        let mut object = summary.to_json();
        if let Some(joined) = joined {
            object["joined"] = json!({ "messages": joined.messages, "added": joined.added });
        }
        out::line(object)?;
    } else {
        out::text(summary.to_text())?;
        if let Some(joined) = joined {
            let (messages, added) = (joined.messages, joined.added);
            out::line(format_args!(
                "joined                     {messages} messages, {added} of them only here"
            ))?;
        }
        if let Some(log) = &options.log {
            out::line(format_args!("log written                taktil plot {}", log.display()))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes the log that is asked for: of the recording, or of it and the log of its run.
fn write_logs(
    options: &Options,
    found: &FlightRecording,
    about: &About,
) -> Result<Option<JoinedSize>, BadOption> {
    let bad = |error: anyhow::Error| BadOption(format!("{error:#}"));
    let Some(out) = &options.log else {
        return match &options.join {
            None => Ok(None),
            Some(_) => Err(BadOption("--join: name the file to write with --log".to_owned())),
        };
    };
    if [Some(&options.file), options.join.as_ref()]
        .into_iter()
        .flatten()
        .any(|read| same(out, read))
    {
        let shown = out.display();
        return Err(BadOption(format!("{shown}: is what is read; name another log")));
    }
    let Some(path) = &options.join else {
        return write_log(out, found, about).map_err(bad).map(|()| None);
    };
    let log = Log::open(path).map_err(bad)?;
    join::write(out, path, &log, found, about).map_err(bad).map(Some)
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
