//! `taktil replay`: repeats the run of a log from the recorded answers of its devices and the
//! recorded decisions of its lanes, and compares the two bit for bit. A run counts as equal only up
//! to the instant until which its log is complete. A log that does not state what ran is an error.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use serde_json::{Value, json};
use taktil_machine::tape::player::Tapes;
use taktil_machine_console::out;
use taktil_machine_console::signals::{self, SecondSignal};
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::replay::{self, Gap, RecordedRun};
use taktil_rtcore::{LaneSpec, Machine, Nanos};

use crate::diff::{Comparison, first_text, seconds, to_json};
use taktil_lab_progress::Progress;
use taktil_lab_scene::origin::Origin;
use taktil_machine_console::option::{BadOption, check_writable};
use taktil_record::{Channel, Log, McapLog};

/// Exit code of an incomplete log, even when all that could be replayed is equal.
const EXIT_INCOMPLETE_LOG: u8 = 2;

/// The arguments of the command line.
#[derive(Clone, Debug)]
pub struct Options {
    /// The log.
    pub log: PathBuf,
    /// JSON instead of sentences.
    pub json: bool,
    /// Where the repeated run is written to.
    pub out: Option<PathBuf>,
}

/// The result of a replay.
#[derive(Debug)]
pub struct Outcome {
    /// Scene or board, mode and seed, as text.
    pub title: String,
    /// The comparison of the log up to the end of the replay with the repeated run.
    pub comparison: Comparison,
    /// Where the log is incomplete, as text and as an instant.
    pub gap: Option<(String, Nanos)>,
    /// What is wrong with a log that holds the complete run, as text.
    pub flaw: Option<String>,
    /// The first answer of a device that the tapes lack.
    pub lack: Option<(&'static str, Nanos)>,
    /// Tasks that were run again, lane by lane.
    pub rerun: Vec<String>,
    /// Tasks whose values were taken from the log.
    pub fed: Vec<String>,
    /// Number of jobs that were repeated.
    pub jobs: u64,
    /// The instant that the replay reached.
    pub reached: Nanos,
}

impl Outcome {
    /// True when everything that was repeated is equal.
    #[must_use]
    pub fn equal(&self) -> bool {
        self.comparison.same_readable() && self.lack.is_none()
    }

    fn code(&self) -> ExitCode {
        match (self.equal(), &self.gap) {
            (false, _) => ExitCode::from(1),
            (true, Some(_)) => ExitCode::from(EXIT_INCOMPLETE_LOG),
            (true, None) => ExitCode::SUCCESS,
        }
    }
}

/// Replays a log and prints the result; the exit code is 0 for equal, 1 for different, 2 for a log
/// that is invalid or incomplete.
///
/// # Errors
/// A log that cannot be used, as [`BadOption`].
pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let bad = |error: anyhow::Error| BadOption(format!("{error:#}"));
    let log = Log::open(&options.log).map_err(bad)?;
    if let Some(out) = &options.out {
        check_writable("--out", out)?;
    }
    let damage = log.damage().map(|damage| format!("; the file is {damage}")).unwrap_or_default();
    let (outcome, repeated) = repeat(log).map_err(|what| {
        let shown = options.log.display();
        BadOption(format!("{shown} cannot be replayed: {what}{damage}"))
    })?;
    if let Some(out) = &options.out {
        std::fs::write(out, repeated)
            .map_err(|error| BadOption(format!("cannot write {}: {error}", out.display())))?;
    }
    if options.json {
        out::line(object(&outcome))?;
    } else {
        out::text(text(&outcome))?;
    }
    Ok(outcome.code())
}

/// Repeats the run that `log` records; returns the result, and the repeated run as a log.
///
/// # Errors
/// The reason why the log cannot be replayed, as one sentence.
pub fn repeat(mut log: Log) -> Result<(Outcome, Vec<u8>), String> {
    let origin = Origin::of(&log)?;
    let (plain, _) = origin.machine(Tapes::default(), Nanos::ZERO)?;
    let signals = channel_numbers(&log, plain.catalog())?;
    let seated = |task: &&str| plain.task_names().flatten().any(|seat| seat == *task);
    let fed: Vec<&str> = origin.replayed_tasks().into_iter().filter(seated).collect();
    let specs: Vec<LaneSpec> = plain.figures().map(|(spec, _)| spec.clone()).collect();
    let mut script = RecordedRun::new(plain.catalog(), &fed);
    let tapes = collect(&log, plain.catalog(), &signals, &mut script)?;
    if script.jobs() == 0 {
        return Err("it holds no decision: the run ended before its first job".to_owned());
    }
    let (flaw, cut) = match log.damage() {
        Some(damage) if damage.messages_complete => (Some(damage.to_string()), None),
        damage => (None, damage.map(ToString::to_string)),
    };
    let gap = script.gap(specs.iter(), cut.is_some());
    let until = gap.as_ref().map_or(Nanos::MAX, |gap| gap.until);
    let (mut machine, lack) = origin.machine(tapes, script.longest_pause(specs.iter()))?;
    let about = BTreeMap::from([("replay_of".to_owned(), origin.title())]);
    let plainly = |error: anyhow::Error| format!("{error:#}");
    let mut repeated = McapLog::in_memory(machine.catalog(), &about).map_err(plainly)?;
    let stop = signals::watch(SecondSignal::Exits).map_err(plainly)?;
    let progress = Progress::new("records", log.messages().count());
    let mut watched = WatchedLog { log: &mut repeated, progress, untold: 0 };
    let reached = replay::run(&mut machine, &script, &fed, until, &stop, &mut watched)
        .map_err(|error| error.to_string())?;
    drop(watched);
    let bytes = repeated.into_bytes().map_err(plainly)?;
    let again = Log::from_bytes(bytes.clone()).map_err(plainly)?;
    let end = again.messages().map(|message| message.release_ns).max().unwrap_or(0);
    log.truncate_at(until.0);
    let mut comparison = Comparison::new(&log, &again);
    comparison.remarks.clear();
    // The cut end is reported as a gap of the log.
    (comparison.damage, comparison.broken) = ([None, None], None);
    let outcome = Outcome {
        title: origin.title(),
        comparison,
        gap: gap.map(|gap| (gap_description(&gap, cut.as_deref()), gap.until)),
        flaw,
        lack: lack.first(),
        rerun: tasks_run_again(&machine, &fed),
        fed: fed.iter().map(|task| (*task).to_owned()).collect(),
        jobs: machine.figures().map(|(_, figures)| figures.jobs).sum(),
        reached: reached.min(Nanos(end)),
    };
    Ok((outcome, bytes))
}

/// Records between two looks at the clock.
const RECORDS_TOLD_TOGETHER: usize = 1024;

/// The log of the repeated run, with the progress of the repetition.
struct WatchedLog<'a, L: Observer> {
    log: &'a mut L,
    progress: Progress,
    untold: usize,
}

impl<L: Observer> Observer for WatchedLog<'_, L> {
    fn record(&mut self, record: &Record<'_>) {
        self.log.record(record);
        self.untold += 1;
        if self.untold == RECORDS_TOLD_TOGETHER {
            self.progress.advance_by(std::mem::take(&mut self.untold));
        }
    }
}

fn gap_description(gap: &Gap, cut: Option<&str>) -> String {
    let after = gap.after.map_or_else(|| "its start".to_owned(), |tick| format!("tick {tick}"));
    match cut {
        Some(damage) => damage.to_owned(),
        None => format!("records of lane {} after {after} were lost in the run", gap.lane),
    }
}

fn tasks_run_again(machine: &Machine, fed: &[&str]) -> Vec<String> {
    let tasks = machine.task_names().flatten();
    tasks.filter(|task| !fed.contains(task)).map(str::to_owned).collect()
}

/// The number in `catalog` of each channel of the log; `None` for channels that the catalog does
/// not have.
fn channel_numbers(log: &Log, catalog: &Catalog) -> Result<Vec<Option<usize>>, String> {
    let remedy = "replay it with the build that wrote it";
    for signal in &catalog.signals {
        let Some(index) = log.find(&signal.name) else {
            return Err(format!("it has no signal `{}`; {remedy}", signal.name));
        };
        let there = log.channels()[index].payload_fields();
        let same = there.len() == signal.fields.len()
            && there.iter().zip(&*signal.fields).all(|(a, b)| {
                (a.name.as_str(), a.kind, a.count, a.array) == (b.name, b.kind, b.count, b.array)
            });
        if !same {
            return Err(format!("its signal `{}` has other fields; {remedy}", signal.name));
        }
    }
    let number = |channel: &Channel| catalog.find(&channel.signal);
    if let Some(stranger) = log.channels().iter().find(|channel| number(channel).is_none()) {
        return Err(format!("its signal `{}` is unknown here; {remedy}", stranger.signal));
    }
    if let Some(lane) =
        catalog.lanes.iter().find(|lane| catalog.find(&format!("{}.decision", lane.name)).is_none())
    {
        return Err(format!(
            "the decisions of lane `{}` were not recorded; record with `record = \"full\"`",
            lane.name
        ));
    }
    Ok(log.channels().iter().map(number).collect())
}

/// Passes every record to the script and to the tapes.
fn collect(
    log: &Log,
    catalog: &Catalog,
    signals: &[Option<usize>],
    script: &mut RecordedRun,
) -> Result<Tapes, String> {
    let mut tapes = Tapes::default();
    for message in log.messages() {
        let Some(signal) = signals[message.channel] else { continue };
        let about = &catalog.signals[signal];
        let release = Nanos(message.release_ns);
        let body = message.body.get(..about.size).unwrap_or_default();
        script.record(&Record { signal, tick: message.tick, release, body });
        if !tapes.append(&about.name, &about.fields, release, body) {
            return Err(format!("an entry of `{}` cannot be read", about.name));
        }
    }
    Ok(tapes)
}

/// The outcome as sentences.
#[must_use]
pub fn text(outcome: &Outcome) -> String {
    let mut out = format!("replay of {}\n", outcome.title);
    let _ = writeln!(
        out,
        "  {} jobs up to {} s; run again: {}; fed from the log: {}",
        outcome.jobs,
        seconds(outcome.reached.0),
        outcome.rerun.join(", "),
        outcome.fed.join(", ")
    );
    let (messages, repeated) = outcome.comparison.messages();
    let signals = outcome.comparison.compared.len();
    if outcome.equal() {
        let until = if outcome.gap.is_some() { "equal until there" } else { "equal" };
        let _ = writeln!(
            out,
            "{until}: {messages} records of {signals} signals, bit for bit: values, device \
             answers, decisions, states"
        );
    } else {
        let _ = writeln!(
            out,
            "different: {messages} records in the log, {repeated} repeated; the log was altered, a \
             task is no function of its inputs, or another build of taktil {} wrote it",
            env!("CARGO_PKG_VERSION")
        );
    }
    if let Some(first) = outcome.comparison.first() {
        out += &first_text(first, ["recorded", "repeated"]);
    }
    if let Some((device, release)) = outcome.lack {
        let at = seconds(release.0);
        let _ = writeln!(out, "tape {device} holds no answer for the job released at {at} s");
    }
    if let Some(flaw) = &outcome.flaw {
        let _ = writeln!(out, "the file is damaged all the same: {flaw}");
    }
    if let Some((why, until)) = &outcome.gap {
        let _ = writeln!(out, "not whole: {why}; complete until {} s", seconds(until.0));
    }
    out
}

/// The outcome as one JSON object.
#[must_use]
pub fn object(outcome: &Outcome) -> Value {
    let mut object = to_json(&outcome.comparison);
    object["equal"] = json!(outcome.equal() && outcome.gap.is_none());
    object["replay_of"] = json!(outcome.title);
    object["jobs"] = json!(outcome.jobs);
    object["reached_ns"] = json!(outcome.reached.0);
    object["rerun"] = json!(outcome.rerun);
    object["fed"] = json!(outcome.fed);
    object["gap"] = json!(
        outcome
            .gap
            .as_ref()
            .map(|(why, until)| { json!({ "reason": why, "complete_until_ns": until.0 }) })
    );
    object["flaw"] = json!(outcome.flaw);
    object["lack"] = json!(
        outcome
            .lack
            .map(|(device, release)| { json!({ "tape": device, "release_ns": release.0 }) })
    );
    object
}
