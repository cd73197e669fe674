//! The summary of a flight recording: made of its records, given as JSON and shown to people.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use taktil_record::flight::FlightGrants;
use taktil_record::summary::FaultSummary;
use taktil_rtcore::flight::{FlightRecording, LaneRecording};
use taktil_rtcore::linux::wall_clock;
use taktil_rtcore::record::{LaneInfo, Record};
use taktil_rtcore::status::{LaneHealth, ModeStatus};
use taktil_rtcore::{FaultSet, Mode, Nanos, Payload};

use super::about::{self, About};
use super::in_order;

/// Number of values of an array that are shown to people.
const VALUES_SHOWN_MAX: usize = 6;

/// What a recording holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct PostmortemSummary {
    /// Path of the recording as it was given.
    file: String,
    /// Version of the program that wrote it.
    taktil: String,
    /// Number of its process.
    process: u32,
    /// What the kernel granted, as it stands in the recording; a text where it is no JSON.
    granted: Value,
    /// Release of the last record (s).
    ended_s: Option<f64>,
    /// Time from the last record until now (s).
    age_s: Option<f64>,
    /// The last mode, in capitals.
    mode: Option<String>,
    /// All faults that were latched at the end.
    faults: Vec<FaultSummary>,
    /// The lanes in the order of the catalog.
    lanes: Vec<LaneEnd>,
    /// The last value of each signal.
    last: BTreeMap<String, LastValue>,
}

/// How a lane ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct LaneEnd {
    /// Name of the lane.
    name: String,
    /// From one release to the next (ns).
    period_ns: i64,
    /// Number of the last job.
    last_job: u64,
    /// Release of the last record (s).
    last_release_s: Option<f64>,
    /// The task that was running.
    running: Option<String>,
    /// Number of records.
    records: usize,
    /// Number of jobs from the first record to the last.
    jobs_kept: Option<u64>,
    /// Number of jobs that missed their deadline.
    missed: Option<u32>,
    /// Why records at the end could not be used.
    damage: Option<String>,
}

/// The last value of a signal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct LastValue {
    /// The job that wrote it.
    tick: u64,
    /// Its fields by name.
    value: Map<String, Value>,
}

impl PostmortemSummary {
    /// Summarises a recording.
    pub(super) fn new(file: &Path, found: &FlightRecording, about: &About) -> PostmortemSummary {
        let records = in_order(found, about);
        let mut last: BTreeMap<usize, &Record<'_>> = BTreeMap::new();
        for record in &records {
            last.insert(record.signal, record);
        }
        let end = records.iter().map(|record| record.release).max();
        let zero = serde_json::from_str::<FlightGrants>(&found.granted).unwrap_or_default();
        let zero = zero.zero_unix_ns.map(Nanos);
        let age = zero.zip(end).map(|(zero, end)| {
            let written = zero.0.saturating_add(end.0);
            Nanos(wall_clock().0.saturating_sub(written)).as_secs_f64()
        });
        let is_mode = |signal: &usize| about.catalog.signals[*signal].type_name == ModeStatus::NAME;
        let mode = last.iter().find(|(signal, _)| is_mode(signal));
        let mode = mode.and_then(|(_, record)| ModeStatus::decode(record.body));
        let mut faults = FaultSet(mode.map_or(0, |word| word.faults));
        let mut lanes = Vec::new();
        for (index, (lane, info)) in found.lanes.iter().zip(&about.catalog.lanes).enumerate() {
            let signal = about.catalog.find(&format!("{}.health", info.name));
            let health = signal.and_then(|signal| LaneHealth::decode(last.get(&signal)?.body));
            faults = faults.union(FaultSet(health.map_or(0, |health| health.faults)));
            let tasks = about.tasks.get(index).map_or(&[][..], Vec::as_slice);
            lanes.push(LaneEnd::new(lane, info, tasks, health));
        }
        let last = last.iter().map(|(signal, record)| {
            let signal = &about.catalog.signals[*signal];
            let value = about::values(signal, record.body);
            (signal.name.clone(), LastValue { tick: record.tick, value })
        });
        PostmortemSummary {
            file: file.display().to_string(),
            taktil: about.taktil.clone(),
            process: about.process,
            // What cannot be read is handed on as it stands.
            granted: match &*found.granted {
                "" => Value::Null,
                text => serde_json::from_str(text).unwrap_or_else(|_| text.into()),
            },
            ended_s: end.map(Nanos::as_secs_f64),
            age_s: age,
            mode: mode
                .and_then(|word| Mode::from_code(word.mode))
                .map(|mode| format!("{mode:?}").to_uppercase()),
            faults: faults.iter().map(FaultSummary::from).collect(),
            lanes,
            last: last.collect(),
        }
    }

    /// The JSON object, whose keys are sorted.
    pub(super) fn to_json(&self) -> Value {
        serde_json::to_value(self).unwrap_or_default()
    }

    /// The summary for people.
    pub(super) fn to_text(&self) -> String {
        let mut out = String::new();
        let _ = writeln!(out, "{}: taktil {}", self.file, self.taktil);
        let age = self.age_s.map_or(String::new(), |age| format!(", {age:.1} s ago"));
        let _ = writeln!(out, "last record                at {} s{age}", seconds(self.ended_s));
        let mode = self.mode.as_deref().unwrap_or("-");
        let _ = writeln!(out, "mode                       {mode}");
        for fault in &self.faults {
            let _ = writeln!(out, "FAULT {}: {}", fault.name, fault.text);
        }
        if self.faults.is_empty() {
            let _ = writeln!(out, "faults                     none");
        }
        self.lanes.iter().for_each(|lane| lane.append_text(&mut out));
        let _ = writeln!(out, "last values");
        // What a replay needs says nothing to a person; the JSON has it.
        let inner = |name: &str| name.ends_with(".state") || name.ends_with(".decision");
        for (name, last) in self.last.iter().filter(|(name, _)| !inner(name)) {
            let fields: Vec<String> =
                last.value.iter().map(|(name, value)| field_text(name, value)).collect();
            let _ = writeln!(out, "  {name:<24} job {}: {}", last.tick, fields.join(", "));
        }
        out
    }
}

impl LaneEnd {
    fn new(
        lane: &LaneRecording,
        info: &LaneInfo,
        tasks: &[String],
        health: Option<LaneHealth>,
    ) -> LaneEnd {
        let (oldest, newest) = (lane.records().next(), lane.records().next_back());
        let task =
            |task: usize| tasks.get(task).cloned().unwrap_or_else(|| format!("task {}", task + 1));
        LaneEnd {
            name: info.name.clone(),
            period_ns: info.period.0,
            last_job: lane.tick,
            last_release_s: newest.as_ref().map(|record| record.release.as_secs_f64()),
            running: lane.running.map(task),
            records: lane.records().count(),
            jobs_kept: newest
                .zip(oldest)
                .map(|(newest, oldest)| newest.tick.saturating_sub(oldest.tick) + 1),
            missed: health.map(|health| health.missed),
            damage: lane.damage.clone(),
        }
    }

    fn append_text(&self, out: &mut String) {
        let running = match &self.running {
            Some(task) => format!("task `{task}` was running"),
            None => "between two jobs".to_owned(),
        };
        let _ = writeln!(out, "lane {:<21} job {}, {running}", self.name, self.last_job);
        let _ = writeln!(
            out,
            "    {} records of {} jobs up to {} s, {} jobs missed so far",
            self.records,
            self.jobs_kept.unwrap_or(0),
            seconds(self.last_release_s),
            self.missed.unwrap_or(0)
        );
        if let Some(damage) = &self.damage {
            let _ = writeln!(out, "    damaged: {damage}");
        }
    }
}

fn seconds(time_s: Option<f64>) -> String {
    time_s.map_or("-".to_owned(), |time_s| format!("{time_s:.4}"))
}

fn field_text(name: &str, value: &Value) -> String {
    match value {
        Value::Array(all) => {
            let some: Vec<String> = all.iter().take(VALUES_SHOWN_MAX).map(number_text).collect();
            let more = if all.len() > VALUES_SHOWN_MAX { " ..." } else { "" };
            format!("{name} [{}{more}]", some.join(" "))
        }
        one => format!("{name} {}", number_text(one)),
    }
}

fn number_text(value: &Value) -> String {
    match value.as_f64() {
        Some(x) if value.is_f64() => format!("{x:.6}"),
        _ => value.to_string(),
    }
}
