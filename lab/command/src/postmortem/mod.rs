//! `taktil postmortem`: what a flight recorder kept of a process that has ended: last jobs, the
//! task that was running, mode, faults, last values; and the same records as a log. Refuses, with
//! one sentence, whatever is no flight recording, and says of a damaged one how far it goes.

mod about;

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use serde_json::{Value, json};
use taktil_machine_console::out;
use taktil_rtcore::flight::{self, FlightRecording, LaneRecording};
use taktil_rtcore::linux::wall_clock;
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::status::{LaneHealth, ModeStatus};
use taktil_rtcore::{FaultCode, FaultSet, Mode, Nanos, Payload};

use about::About;
use taktil_machine_console::option::BadOption;
use taktil_record::{METADATA_ATTESTATION, McapLog, read_bytes};

/// Values of a field that are shown.
const SHOWN: usize = 6;

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
    let summary = summary(&options.file, &found, &about);
    if options.json {
        out::line(&summary)?;
    } else {
        out::text(text(&summary))?;
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

/// Everything that is said, as one object.
fn summary(file: &Path, found: &FlightRecording, about: &About) -> Value {
    let records = in_order(found, about);
    let mut last: BTreeMap<usize, &Record<'_>> = BTreeMap::new();
    for record in &records {
        last.insert(record.signal, record);
    }
    let end = records.iter().map(|record| record.release).max();
    // What cannot be read is handed on as it stands.
    let granted: Value = match &*found.granted {
        "" => Value::Null,
        text => serde_json::from_str(text).unwrap_or_else(|_| text.into()),
    };
    let zero = granted["zero_unix_ns"].as_i64();
    let age = zero.zip(end).map(|(zero, end)| (wall_clock() - Nanos(zero) - end).as_secs_f64());
    let of = |name: &str| {
        let signal = about.catalog.signals.iter().position(|s| s.type_name == name)?;
        last.get(&signal).copied()
    };
    let mode = of(ModeStatus::NAME).and_then(|record| ModeStatus::decode(record.body));
    let mut faults = FaultSet(mode.map_or(0, |word| word.faults));
    let mut lanes = Vec::new();
    for (index, (lane, info)) in found.lanes.iter().zip(&about.catalog.lanes).enumerate() {
        let signal = about.catalog.find(&format!("{}.health", info.name));
        let health = signal.and_then(|signal| LaneHealth::decode(last.get(&signal)?.body));
        faults = faults.union(FaultSet(health.map_or(0, |health| health.faults)));
        let tasks = about.tasks.get(index).map_or(&[][..], Vec::as_slice);
        let newest = lane.records().next_back();
        lanes.push(json!({
            "name": info.name,
            "period_ns": info.period.0,
            "last_job": lane.tick,
            "last_release_s": newest.map(|record| record.release.as_secs_f64()),
            "running": lane.running.map(|seat| {
                tasks.get(seat).cloned().unwrap_or_else(|| format!("task {}", seat + 1))
            }),
            "records": lane.records().count(),
            "jobs_kept": newest.zip(lane.records().next()).map(|(b, a)| b.tick - a.tick + 1),
            "missed": health.map(|health| health.missed),
            "damage": lane.damage,
        }));
    }
    let values = last.iter().map(|(signal, record)| {
        let about = &about.catalog.signals[*signal];
        let value = about::values(about, record.body);
        (about.name.clone(), json!({ "tick": record.tick, "value": value }))
    });
    json!({
        "file": file.display().to_string(),
        "taktil": about.taktil,
        "process": about.process,
        "granted": granted,
        "ended_s": end.map(Nanos::as_secs_f64),
        "age_s": age,
        "mode": mode.and_then(|word| Mode::from_code(word.mode)).map(|mode| {
            format!("{mode:?}").to_uppercase()
        }),
        "faults": faults.iter().map(fault).collect::<Vec<_>>(),
        "lanes": lanes,
        "last": values.collect::<serde_json::Map<_, _>>(),
    })
}

fn fault(fault: FaultCode) -> Value {
    json!({ "code": fault as u16, "name": format!("{fault:?}"), "text": fault.text() })
}

/// The summary for people.
fn text(s: &Value) -> String {
    let mut out = String::new();
    let seconds = |value: &Value| value.as_f64().map_or("-".into(), |s| format!("{s:.4}"));
    let words = |value: &Value| value.as_str().unwrap_or("-").to_owned();
    let _ = writeln!(out, "{}: taktil {}", words(&s["file"]), words(&s["taktil"]));
    let age = s["age_s"].as_f64().map_or(String::new(), |age| format!(", {age:.1} s ago"));
    let _ = writeln!(out, "last record                at {} s{age}", seconds(&s["ended_s"]));
    let _ = writeln!(out, "mode                       {}", words(&s["mode"]));
    for fault in s["faults"].as_array().into_iter().flatten() {
        let _ = writeln!(out, "FAULT {}: {}", words(&fault["name"]), words(&fault["text"]));
    }
    if s["faults"].as_array().is_some_and(Vec::is_empty) {
        let _ = writeln!(out, "faults                     none");
    }
    for lane in s["lanes"].as_array().into_iter().flatten() {
        let running = lane["running"].as_str().map_or_else(
            || "between two jobs".to_owned(),
            |task| format!("task `{task}` was running"),
        );
        let (name, job) = (words(&lane["name"]), &lane["last_job"]);
        let _ = writeln!(out, "lane {name:<21} job {job}, {running}");
        let (records, jobs) = (&lane["records"], &lane["jobs_kept"]);
        let at = seconds(&lane["last_release_s"]);
        let missed = lane["missed"].as_u64().unwrap_or(0);
        let _ = writeln!(
            out,
            "    {records} records of {jobs} jobs up to {at} s, {missed} jobs missed so far"
        );
        if let Some(damage) = lane["damage"].as_str() {
            let _ = writeln!(out, "    damaged: {damage}");
        }
    }
    let _ = writeln!(out, "last values");
    // What a replay needs says nothing to a person; the JSON has it.
    let inner = |name: &str| name.ends_with(".state") || name.ends_with(".decision");
    let last = s["last"].as_object().into_iter().flatten();
    for (name, last) in last.filter(|(name, _)| !inner(name)) {
        let fields = last["value"].as_object().into_iter().flatten();
        let fields: Vec<String> = fields.map(|(name, value)| shown(name, value)).collect();
        let _ = writeln!(out, "  {name:<24} job {}: {}", last["tick"], fields.join(", "));
    }
    out
}

fn shown(name: &str, value: &Value) -> String {
    match value {
        Value::Array(all) => {
            let some: Vec<String> = all.iter().take(SHOWN).map(number).collect();
            let more = if all.len() > SHOWN { " ..." } else { "" };
            format!("{name} [{}{more}]", some.join(" "))
        }
        one => format!("{name} {}", number(one)),
    }
}

fn number(value: &Value) -> String {
    match value.as_f64() {
        Some(x) if value.is_f64() => format!("{x:.6}"),
        _ => value.to_string(),
    }
}
