//! `taktil log pack`, `recover` and `filter`: new logs made of old ones. Messages keep their bytes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use serde_json::json;
use taktil_lab_progress::Progress;
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_record::joined::{JoinedLog, Repetition};
use taktil_record::{Log, METADATA_RECOVERED, METADATA_RUN};

use super::Part;

/// Words of the run's metadata in which the files of one recording may differ.
const WORDS_OF_SEGMENT: [&str; 2] = ["segment", "began_unix_ns"];

/// Refuses to write what is read.
pub(super) fn check_out(out: &Path, read: &[PathBuf]) -> Result<(), BadOption> {
    let real = |path: &Path| std::fs::canonicalize(path).ok();
    match read.iter().find(|path| real(out).is_some() && real(path) == real(out)) {
        None => Ok(()),
        Some(_) => {
            let shown = out.display();
            Err(BadOption(format!("--out {shown} is what is read; name another file")))
        }
    }
}

fn bad(error: anyhow::Error) -> BadOption {
    BadOption(format!("{error:#}"))
}

/// Says what was written.
fn report(out: &Path, messages: u64, lost: Option<&str>, json: bool) -> anyhow::Result<ExitCode> {
    let shown = out.display();
    if json {
        out::line(json!({ "out": shown.to_string(), "messages": messages, "lost": lost }))?;
    } else {
        out::line(format_args!("{shown}: {messages} messages"))?;
        if let Some(lost) = lost {
            out::line(format_args!("lost                       {lost}"))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// What is missing from some logs, in words.
pub(super) fn losses(logs: &[(PathBuf, Log)]) -> Option<String> {
    let mut all = Vec::new();
    for (path, log) in logs {
        let damage = log.damage().map(|damage| format!("{} is {damage}", path.display()));
        let gaps = log.gaps().iter().map(|gap| {
            let (from, to) = (gap.from.as_secs_f64(), gap.to.as_secs_f64());
            format!("{} records from {from:.4} to {to:.4} s: {}", gap.records, gap.cause)
        });
        all.extend(damage.into_iter().chain(gaps));
    }
    (!all.is_empty()).then(|| all.join("; "))
}

/// Joins the files of one recording.
///
/// # Errors
/// Files that are no logs, or of different recordings; a file that cannot be written.
pub(super) fn pack(paths: &[PathBuf], out: &Path, json: bool) -> anyhow::Result<ExitCode> {
    check_out(out, paths)?;
    let mut logs = Vec::new();
    for path in paths {
        logs.push((path.clone(), super::open(path)?));
    }
    let begin = |log: &Log| log.messages().map(|message| message.release_ns).min();
    logs.sort_by_key(|(_, log)| begin(log).unwrap_or(i64::MAX));
    let run = |log: &Log| {
        let mut words = log.metadata().get(METADATA_RUN).cloned().unwrap_or_default();
        words.retain(|key, _| !WORDS_OF_SEGMENT.contains(&&**key));
        words
    };
    let (first_path, first) = &logs[0];
    if let Some((other, _)) = logs.iter().find(|(_, log)| run(log) != run(first)) {
        let (a, b) = (first_path.display(), other.display());
        return Err(BadOption(format!("{a} and {b} are of different recordings")).into());
    }
    let mut joined = JoinedLog::create(out, first).map_err(bad)?;
    let total = logs.iter().map(|(_, log)| log.messages().count()).sum();
    let mut progress = Progress::new("messages", total);
    let mut told = || progress.advance();
    for (path, log) in &logs {
        joined.append_telling(log, Repetition::LeftOut, &mut told).map_err(|error| {
            BadOption(format!("{} does not go on with the others: {error:#}", path.display()))
        })?;
    }
    let last = logs.last().map(|(_, log)| log);
    let messages = joined.finish(last).map_err(bad)?;
    report(out, messages, losses(&logs).as_deref(), json)
}

/// Appends all of a log, and shows how far it is.
fn append(joined: &mut JoinedLog, log: &Log) -> Result<(), BadOption> {
    let mut progress = Progress::new("messages", log.messages().count());
    joined.append_telling(log, Repetition::Kept, &mut || progress.advance()).map_err(bad)
}

/// Makes a whole log of what can be read of one.
///
/// # Errors
/// A file that is no log, or one that cannot be written.
pub(super) fn recover(path: &Path, out: &Path, json: bool) -> anyhow::Result<ExitCode> {
    check_out(out, &[path.to_owned()])?;
    let log = super::open(path)?;
    let mut joined = JoinedLog::create(out, &log).map_err(bad)?;
    append(&mut joined, &log)?;
    if let Some(damage) = log.damage() {
        let row = |name: &str, value: String| (name.to_owned(), value);
        let about = BTreeMap::from([
            row("from", path.display().to_string()),
            row("damage", damage.to_string()),
            row("last_s", log.end_s().to_string()),
        ]);
        joined.write_table(METADATA_RECOVERED, about);
    }
    let messages = joined.finish(Some(&log)).map_err(bad)?;
    let logs = [(path.to_owned(), log)];
    report(out, messages, losses(&logs).as_deref(), json)
}

/// Writes a part of a log.
///
/// # Errors
/// A file that is no log, no such signal, a file that cannot be written.
pub(super) fn filter(path: &Path, out: &Path, part: &Part, json: bool) -> anyhow::Result<ExitCode> {
    check_out(out, &[path.to_owned()])?;
    let mut log = super::open(path)?;
    part.apply(&mut log)?;
    let mut joined = JoinedLog::create(out, &log).map_err(bad)?;
    append(&mut joined, &log)?;
    let messages = joined.finish(Some(&log)).map_err(bad)?;
    let logs = [(path.to_owned(), log)];
    report(out, messages, losses(&logs).as_deref(), json)
}
