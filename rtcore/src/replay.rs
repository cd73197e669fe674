//! The executor that repeats a recorded run: every lane on the calling thread in virtual time, each
//! job at its recorded tick, with exactly the values of other lanes that it had. Devices answer
//! from their tapes (whoever builds the machine sees to that), and a task whose inputs came from
//! outside the machine is *fed*: what it wrote is written again. Nothing is guessed: where records
//! are missing the executor says until when the recording is complete.

use core::sync::atomic::AtomicBool;
use std::collections::{BTreeMap, VecDeque};

use taktil_hal::Nanos;

use crate::fault::FaultCode;
use crate::machine::Machine;
use crate::parameter::Edit;
use crate::payload::Payload;
use crate::port::Io;
use crate::record::{Catalog, Observer, Record};
use crate::schedule::LaneSpec;
use crate::state::StateHash;
use crate::task::{Cycle, Task};
use crate::trace::Decision;
use crate::virtual_time;

/// A place from which on a recording is not complete.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gap {
    /// The lane whose records are missing.
    pub lane: String,
    /// The last job of that lane of which everything was recorded.
    pub after: Option<u64>,
    /// Every job released before this instant, in any lane, was recorded wholly.
    pub until: Nanos,
}

/// Why a machine cannot repeat a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReplayError {
    /// There is no task of this name to be fed.
    NoSuchTask(String),
    /// The decisions of a lane were not recorded.
    NoDecisions(String),
    /// A task refused to start.
    TaskRefused(String, FaultCode),
}

impl core::fmt::Display for ReplayError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            ReplayError::NoSuchTask(task) => write!(f, "there is no task `{task}` to be fed"),
            ReplayError::NoDecisions(lane) => {
                write!(f, "the decisions of lane `{lane}` were not recorded")
            }
            ReplayError::TaskRefused(task, fault) => {
                write!(f, "task `{task}` refused to start: {}", fault.text())
            }
        }
    }
}

impl std::error::Error for ReplayError {}

/// Records of one signal: tick and body.
type Rows = VecDeque<(u64, Vec<u8>)>;

/// What is known of a run: collected from its records, as an observer of the run or from its log.
#[derive(Clone, Debug, Default)]
pub struct RecordedRun {
    lanes: Vec<Vec<(u64, Decision)>>,
    /// Lane of each signal that is a decision.
    decisions: BTreeMap<usize, usize>,
    /// Records of fed tasks, of their lanes' states and of edits, by signal.
    kept: BTreeMap<usize, Rows>,
}

impl RecordedRun {
    /// A script for the signals of a machine in which the tasks `fed` are to be fed.
    #[must_use]
    pub fn new(catalog: &Catalog, fed: &[&str]) -> RecordedRun {
        let mut script =
            RecordedRun { lanes: vec![Vec::new(); catalog.lanes.len()], ..RecordedRun::default() };
        for (number, signal) in catalog.signals.iter().enumerate() {
            let own = format!("{}.decision", catalog.lanes[signal.lane].name);
            if signal.name == own {
                script.decisions.insert(number, signal.lane);
            }
            let owner = signal.name.rsplit_once('.').map_or("", |(owner, _)| owner);
            let state = signal.name == format!("{}.state", catalog.lanes[signal.lane].name);
            if fed.contains(&owner) || state || signal.type_name == Edit::NAME {
                script.kept.insert(number, VecDeque::new());
            }
        }
        script
    }

    /// Where the recording of one of `specs` is not complete, if anywhere; `cut` says that the
    /// recording ended before the run did.
    #[must_use]
    pub fn gap<'a>(&self, specs: impl Iterator<Item = &'a LaneSpec>, cut: bool) -> Option<Gap> {
        let gaps = specs.zip(&self.lanes).filter_map(|(spec, jobs)| {
            let (mut after, mut lost) = (None, 0);
            for (tick, decision) in jobs {
                let next = after.map_or(0, |tick: u64| tick + 1);
                if *tick != next + u64::from(decision.skipped) || decision.lost != lost {
                    break;
                }
                (after, lost) = (Some(*tick), decision.lost);
            }
            let whole = jobs.last().map(|job| job.0) == after;
            let until = after.map_or(spec.phase, |tick| spec.release(tick + 1));
            (cut || !whole).then(|| Gap { lane: spec.name.clone(), after, until })
        });
        gaps.min_by_key(|gap| gap.until)
    }

    /// The longest that one of `specs` went without a job: for so long a machine that repeats the
    /// run must hold values, see [`crate::Builder::for_replay`].
    #[must_use]
    pub fn longest_pause<'a>(&self, specs: impl Iterator<Item = &'a LaneSpec>) -> Nanos {
        let pauses = specs.zip(&self.lanes).flat_map(|(spec, jobs)| {
            let ticks = core::iter::once(0).chain(jobs.iter().map(|job| job.0));
            ticks.zip(jobs).map(|(before, job)| spec.release(job.0) - spec.release(before))
        });
        pauses.max().unwrap_or(Nanos::ZERO)
    }

    /// Number of jobs that were recorded.
    #[must_use]
    pub fn jobs(&self) -> usize {
        self.lanes.iter().map(Vec::len).sum()
    }
}

impl Observer for RecordedRun {
    fn record(&mut self, record: &Record<'_>) {
        if let Some(lane) = self.decisions.get(&record.signal) {
            if let Some(decision) = Decision::decode(record.body) {
                self.lanes[*lane].push((record.tick, decision));
            }
        } else if let Some(kept) = self.kept.get_mut(&record.signal) {
            kept.push_back((record.tick, record.body.to_vec()));
        }
    }
}

/// Stands in for a task: writes what that task wrote.
struct PlaybackTask {
    /// Cells with what was written to them.
    outputs: Vec<(usize, Rows)>,
    /// Place in the lane, and the lane's recorded states.
    place: usize,
    states: Rows,
    state: u64,
}

fn take_due(queue: &mut Rows, tick: u64) -> Option<Vec<u8>> {
    while queue.front().is_some_and(|entry| entry.0 < tick) {
        queue.pop_front();
    }
    let here = queue.front().is_some_and(|entry| entry.0 == tick);
    here.then(|| queue.pop_front()).flatten().map(|entry| entry.1)
}

impl Task for PlaybackTask {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        for (cell, queue) in &mut self.outputs {
            if let Some(body) = take_due(queue, cycle.tick) {
                io.inject(*cell, &body);
            }
        }
        let recorded = take_due(&mut self.states, cycle.tick);
        let word = recorded.as_deref().and_then(|body| body.chunks_exact(8).nth(self.place));
        self.state = word.map_or(0, |word| {
            let mut bytes = [0; 8];
            bytes.copy_from_slice(word);
            u64::from_le_bytes(bytes)
        });
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        // Its state is not repeated either, only carried over.
        *hash = StateHash::from_value(self.state);
    }
}

/// Repeats the jobs of `script` released before `until`, or until `stop` is set; `fed` names the
/// tasks that are fed, as in [`RecordedRun::new`]. Records reach `observer` as in the other
/// executors. Returns the instant that was reached.
///
/// # Errors
/// A task that is to be fed and does not exist, a lane without decisions, a task that refused to
/// start.
pub fn run(
    machine: &mut Machine,
    script: &RecordedRun,
    fed: &[&str],
    until: Nanos,
    stop: &AtomicBool,
    observer: &mut dyn Observer,
) -> Result<Nanos, ReplayError> {
    for task in fed {
        substitute_playback(machine, script, task)?;
    }
    if let Some(lane) = machine.lanes.iter().find(|lane| lane.ports.trace.decisions.is_none()) {
        return Err(ReplayError::NoDecisions(lane.plan.spec.name.clone()));
    }
    replay_edits(machine, script);
    let mut next = vec![0; machine.lanes.len()];
    let choose = |machine: &mut Machine| {
        let jobs = script.lanes.iter().zip(&next).map(|(jobs, next)| jobs.get(*next));
        let take_due = jobs.zip(&machine.lanes).enumerate().filter_map(|(index, (job, lane))| {
            let release = lane.plan.spec.release(job?.0);
            Some((release, index))
        });
        let (release, index) = take_due.min()?;
        let (tick, decision) = script.lanes[index][next[index]];
        next[index] += 1;
        let lane = &mut machine.lanes[index];
        lane.account.next_tick = tick;
        lane.ports.trace.replayed = Some(decision);
        Some((release, index))
    };
    virtual_time::run_chosen(machine, until, stop, observer, choose)
        .map_err(|(task, fault)| ReplayError::TaskRefused(task, fault))
}

/// Plans for every lane the edits that it took in the recorded run.
fn replay_edits(machine: &mut Machine, script: &RecordedRun) {
    for index in 0..machine.lanes.len() {
        let name = format!("{}.edit", machine.lanes[index].plan.spec.name);
        let rows = machine.catalog().find(&name).and_then(|signal| script.kept.get(&signal));
        let Some(rows) = rows else { continue };
        let lane = &mut machine.lanes[index];
        let spec = &lane.plan.spec;
        let taken =
            rows.iter().filter_map(|(tick, body)| Some((spec.release(*tick), Edit::decode(body)?)));
        lane.parameters.replay(taken);
    }
}

/// Replaces `task` by one that writes what the task wrote in the recorded run.
fn substitute_playback(
    machine: &mut Machine,
    script: &RecordedRun,
    task: &str,
) -> Result<(), ReplayError> {
    let signals = &machine.catalog().signals;
    let records = |number: usize| script.kept.get(&number).cloned().unwrap_or_default();
    let found = machine.lanes.iter().enumerate().find_map(|(index, lane)| {
        let place = lane.tasks.iter().position(|seat| seat.name == task)?;
        Some((index, place))
    });
    let (index, place) = found.ok_or_else(|| ReplayError::NoSuchTask(task.to_owned()))?;
    let lane = &machine.lanes[index];
    let mine = |number: usize| signals[number].name.rsplit_once('.').is_some_and(|s| s.0 == task);
    let outputs = lane.ports.signals.iter().map(|(cell, number)| (*cell, usize::from(*number)));
    // A task may be called as its lane: the lane's own health is its cell 0, and is not fed.
    let outputs = outputs.filter(|(cell, number)| *cell != 0 && mine(*number));
    let fed = PlaybackTask {
        outputs: outputs.map(|(cell, number)| (cell, records(number))).collect(),
        place,
        states: lane
            .ports
            .trace
            .state
            .map(|state| records(usize::from(state.0)))
            .unwrap_or_default(),
        state: 0,
    };
    machine.lanes[index].tasks[place].task = Box::new(fed);
    Ok(())
}
