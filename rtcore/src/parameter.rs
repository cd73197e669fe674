//! Numbers that may be edited while the machine runs: declared by tasks with a range, changed by
//! transactions that take effect in every lane at the first job released at or after one logical
//! instant, recorded by the lane (`lane.edit`). A transaction that is empty, too late, or names
//! what is unknown, out of its range or not a number is refused as a whole, outside the lanes.

use taktil_hal::{Invalid, Nanos};

use crate::payload;
use crate::payload::Payload;

/// Largest number of values that one transaction may change in one lane.
pub const EDIT_VALUES_MAX: usize = 16;
/// Largest number of transactions that wait for a lane.
const PENDING_EDITS_MAX: usize = 16;

/// A task's handle on a parameter of its own; valid in the lane that the task was built for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Param(pub(crate) usize);

/// A parameter of the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// `task.name`, or `task.name[i]` for one of several.
    pub name: String,
    /// Index of its lane.
    pub lane: usize,
    /// Its number within the lane, as `lane.edit` has it.
    pub number: u32,
    /// Value before the first edit.
    pub initial: f64,
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

/// A parameter as a task declares it.
#[derive(Clone, Debug)]
pub(crate) struct Declaration {
    pub(crate) name: String,
    pub(crate) initial: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
}

impl Declaration {
    /// Checks that the range is one and that it holds the first value.
    pub(crate) fn check(&self) -> Result<(), Invalid> {
        let Declaration { name, initial, low, high } = self;
        let ordered = low.is_finite() && high.is_finite() && low <= high;
        if ordered && (*low..=*high).contains(initial) {
            return Ok(());
        }
        let what = format!("{initial} is not a value within {low} to {high}");
        Err(Invalid::new(name.clone(), what, "configure a value within the range"))
    }
}

/// What to change, and from when on. All of it or none.
#[derive(Clone, Debug, PartialEq)]
pub struct Transaction {
    /// Takes effect in every lane at its first job released at or after this instant.
    pub at: Nanos,
    /// Parameters by name with their new values; `task.name` stands for all of `task.name[i]`.
    pub set: Vec<(String, f64)>,
}

payload! {
    /// What an edit changed in a lane: the signal `lane.edit`, written by the job that took it.
    pub struct Edit {
        /// Instant from which it was to take effect.
        pub at_ns: i64,
        /// Values before, in the order of `number`.
        pub old: [f64; 16],
        /// Values after.
        pub new: [f64; 16],
        /// Numbers of the parameters within the lane.
        pub number: [u32; 16],
        /// How many of them count.
        pub count: u32,
    }
}

/// The part of a transaction that belongs to one lane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LaneEdit {
    at: Nanos,
    /// Taken by the first job released at or after this: `at`, or in a replay the job that took it.
    due: Nanos,
    values: [f64; EDIT_VALUES_MAX],
    numbers: [u32; EDIT_VALUES_MAX],
    count: usize,
}

/// A lane's parameters and the edits on their way to it.
pub(crate) struct LaneParameters {
    pub(crate) values: Box<[f64]>,
    /// Known before the run, in order of time.
    planned: Vec<LaneEdit>,
    next: usize,
    /// Sent while it runs.
    ring: rtrb::Consumer<LaneEdit>,
}

impl LaneParameters {
    /// The parameters of a lane, and the other end of its ring.
    pub(crate) fn new(values: Box<[f64]>) -> (LaneParameters, rtrb::Producer<LaneEdit>) {
        let (producer, ring) = rtrb::RingBuffer::new(PENDING_EDITS_MAX);
        (LaneParameters { values, planned: Vec::new(), next: 0, ring }, producer)
    }

    /// Plans what was taken in a recorded run, each edit with the release of the job that took it.
    pub(crate) fn replay(&mut self, taken: impl Iterator<Item = (Nanos, Edit)>) {
        let part = |(due, edit): (Nanos, Edit)| {
            let count = (edit.count as usize).min(EDIT_VALUES_MAX);
            let (values, numbers) = (edit.new, edit.number);
            LaneEdit { at: Nanos(edit.at_ns), due, values, numbers, count }
        };
        self.planned = taken.map(part).collect();
        self.next = 0;
    }

    /// Applies the next edit that is due at `release`; at most one a job, whole.
    pub(crate) fn apply(&mut self, release: Nanos) -> Option<Edit> {
        let planned = self.planned.get(self.next).filter(|part| part.due <= release);
        let part = match planned {
            Some(part) => {
                self.next += 1;
                *part
            }
            None => {
                let due = self.ring.peek().is_ok_and(|part| part.due <= release);
                due.then(|| self.ring.pop().ok()).flatten()?
            }
        };
        let mut edit = Edit { at_ns: part.at.0, ..Edit::ZERO };
        for (number, new) in part.numbers.iter().zip(part.values).take(part.count) {
            let Some(value) = self.values.get_mut(*number as usize) else { continue };
            let index = edit.count as usize;
            (edit.number[index], edit.old[index], edit.new[index]) = (*number, *value, new);
            edit.count += 1;
            *value = new;
        }
        Some(edit)
    }
}

/// Knows the parameters of a machine; checks transactions and splits them by lane.
#[derive(Clone, Debug)]
pub(crate) struct ParameterRegistry {
    pub(crate) parameters: Vec<Parameter>,
    /// Two transactions are at least this far apart: the longest period, so that every lane has a
    /// job between them.
    apart: Nanos,
    latest: Option<Nanos>,
}

impl ParameterRegistry {
    /// Nothing has been edited yet.
    pub(crate) fn new(parameters: Vec<Parameter>, apart: Nanos) -> ParameterRegistry {
        ParameterRegistry { parameters, apart, latest: None }
    }

    /// The parts of a transaction by lane. The place is `at` or `set.NAME`.
    fn split(&self, transaction: &Transaction) -> Result<Vec<(usize, LaneEdit)>, Invalid> {
        let Transaction { at, set } = transaction;
        if set.is_empty() {
            let remedy = "name a parameter and its new value";
            return Err(Invalid::new("set", "nothing is to be changed", remedy));
        }
        if let Some(latest) = self.latest
            && *at < latest + self.apart
        {
            return Err(Invalid::new(
                "at",
                format!("{at} is not {} after the edit at {latest}", self.apart),
                "leave the longest period between two edits, or make them one",
            ));
        }
        let mut parts: Vec<(usize, LaneEdit)> = Vec::new();
        for (name, value) in set {
            for parameter in self.matching(name)? {
                check_value(name, parameter, *value)?;
                let slot = parts.iter().position(|(lane, _)| *lane == parameter.lane);
                let slot = slot.unwrap_or_else(|| {
                    let (values, numbers) = ([0.0; EDIT_VALUES_MAX], [0; EDIT_VALUES_MAX]);
                    let part = LaneEdit { at: *at, due: *at, values, numbers, count: 0 };
                    parts.push((parameter.lane, part));
                    parts.len() - 1
                });
                push_value(&mut parts[slot].1, name, parameter.number, *value)?;
            }
        }
        Ok(parts)
    }

    /// The parameter of this name, or all parameters `name[i]`.
    fn matching(&self, name: &str) -> Result<Vec<&Parameter>, Invalid> {
        let stem = |parameter: &&Parameter| {
            let rest = parameter.name.strip_prefix(name);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('['))
        };
        let found: Vec<&Parameter> = self.parameters.iter().filter(stem).collect();
        if !found.is_empty() {
            return Ok(found);
        }
        let task = name.split('.').next().unwrap_or_default();
        let own = |parameter: &&Parameter| {
            parameter.name.strip_prefix(task).is_some_and(|rest| rest.starts_with('.'))
        };
        let of = |filter: &dyn Fn(&&Parameter) -> bool| {
            let names: Vec<&str> = self.parameters.iter().filter(filter).map(base_name).collect();
            names.chunk_by(|a, b| a == b).map(|same| same[0]).collect::<Vec<_>>().join(", ")
        };
        let near = of(&own);
        let near = if near.is_empty() { of(&|_| true) } else { near };
        let remedy = if near.is_empty() {
            "no task of this machine has parameters".to_owned()
        } else {
            format!("parameters are: {near}")
        };
        Err(Invalid::new(format!("set.{name}"), "there is no such parameter", remedy))
    }
}

fn base_name(parameter: &Parameter) -> &str {
    parameter.name.split('[').next().unwrap_or_default()
}

fn check_value(name: &str, parameter: &Parameter, value: f64) -> Result<(), Invalid> {
    let Parameter { low, high, .. } = parameter;
    if (*low..=*high).contains(&value) {
        return Ok(());
    }
    let what = format!("{value} is not within the range of {}", parameter.name);
    let [low, high] = [*low, *high].map(rounded_for_display);
    Err(Invalid::new(format!("set.{name}"), what, format!("give {low} to {high}")))
}

/// The end of a range, rounded for display: a tenth of 0.35 reads as 0.035.
fn rounded_for_display(end: f64) -> f64 {
    let nine_places = (end * 1e9).round() / 1e9;
    if (1e-3..1e5).contains(&end.abs()) { nine_places } else { end }
}

fn push_value(part: &mut LaneEdit, name: &str, number: u32, value: f64) -> Result<(), Invalid> {
    if part.numbers[..part.count].contains(&number) {
        let remedy = "name it once";
        return Err(Invalid::new(format!("set.{name}"), "is set twice in one edit", remedy));
    }
    if part.count == EDIT_VALUES_MAX {
        let what = format!("more than {EDIT_VALUES_MAX} values of one lane in one edit");
        return Err(Invalid::new(format!("set.{name}"), what, "make it two edits"));
    }
    part.numbers[part.count] = number;
    part.values[part.count] = value;
    part.count += 1;
    Ok(())
}

/// Plans edits before a run: `parameters` by lane.
pub(crate) fn plan(
    registry: &mut ParameterRegistry,
    transactions: &[Transaction],
    parameters: &mut [&mut LaneParameters],
) -> Result<(), Invalid> {
    let mut checked = registry.clone();
    let mut all = Vec::new();
    for (index, transaction) in transactions.iter().enumerate() {
        let outer = format!("edit[{index}]");
        let past = transaction.at < Nanos::ZERO;
        let parts = if past { Err(too_late(transaction.at, Nanos::ZERO)) } else { Ok(()) };
        let parts = parts.and_then(|()| checked.split(transaction));
        all.extend(parts.map_err(|invalid| invalid.within(&outer))?);
        checked.latest = Some(transaction.at);
    }
    *registry = checked;
    for (lane, part) in all {
        parameters[lane].planned.push(part);
    }
    Ok(())
}

fn too_late(at: Nanos, earliest: Nanos) -> Invalid {
    let what = format!("{at} is past, or too near to reach every lane");
    Invalid::new("at", what, format!("give {earliest} or later"))
}

/// Sends edits to the lanes of a machine that runs; from one thread, outside the lanes.
pub struct Editor {
    registry: ParameterRegistry,
    rings: Vec<rtrb::Producer<LaneEdit>>,
}

/// Time between sending an edit and its effect, in longest periods: the time to reach every lane.
const EDIT_LEAD_PERIODS: i64 = 4;
/// Least time between sending an edit and its effect, because the sender is not a real-time thread.
const EDIT_LEAD_MIN: Nanos = Nanos::from_millis(20);

impl Editor {
    pub(crate) fn new(registry: ParameterRegistry, rings: Vec<rtrb::Producer<LaneEdit>>) -> Editor {
        Editor { registry, rings }
    }

    /// The parameters of the machine.
    #[must_use]
    pub fn parameters(&self) -> &[Parameter] {
        &self.registry.parameters
    }

    /// The earliest instant that an edit sent at logical `now` may take effect.
    #[must_use]
    pub fn earliest(&self, now: Nanos) -> Nanos {
        now + (self.registry.apart * EDIT_LEAD_PERIODS).max(EDIT_LEAD_MIN)
    }

    /// Sends a transaction at logical `now`, which [`crate::live::RunObserver::on_time`] tells.
    ///
    /// # Errors
    /// Whatever is wrong with it, and lanes that have not taken earlier ones yet: then no lane has
    /// got anything. The place is `at` or `set.NAME`.
    pub fn send(&mut self, now: Nanos, transaction: &Transaction) -> Result<(), Invalid> {
        let earliest = self.earliest(now);
        if transaction.at < earliest {
            return Err(too_late(transaction.at, earliest));
        }
        let parts = self.registry.split(transaction)?;
        // Only this end fills the rings, so the free room cannot become less.
        if parts.iter().any(|(lane, _)| self.rings[*lane].slots() == 0) {
            let what = format!("{PENDING_EDITS_MAX} edits are under way to a lane already");
            return Err(Invalid::new("at", what, "wait until they have taken effect"));
        }
        for (lane, part) in parts {
            let _ = self.rings[lane].push(part);
        }
        self.registry.latest = Some(transaction.at);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
