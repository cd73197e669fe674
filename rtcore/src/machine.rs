//! Putting a machine together: lanes, tasks, bindings. Everything that can be wrong with a wiring
//! is found here, before the first job, with the place in the configuration. Refuses to run
//! anything.

use core::any::TypeId;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use taktil_hal::{Invalid, Nanos};

use crate::analysis::{Allowance, Analysis, Demand, analyse, keep_borne};
use crate::fault::FaultCode;
use crate::flight::Recorder;
use crate::lane::{Figures, Lane, Latch, Seat, TaskFigures};
use crate::parameter::{Declaration, Desk, Knobs, Part};
use crate::port::{Binding, InputDeclaration, OutputDeclaration, Ports};
use crate::record::{Catalog, HEADER_BYTES, LaneInfo, Recording, Signal};
use crate::record_ring::{Drain, tap};
use crate::schedule::{LANES_MAX, LaneSpec, Reservation};
use crate::status::LaneHealth;
use crate::tape::TapeDeclaration;
use crate::task::Task;
use crate::trace::{self, Trace};

mod complaint;
mod join;
mod parameters;

use complaint::{check_bindings, check_catalog, check_edge, check_remotes, mismatch, unknown};
use join::{bind_mode, join};

/// How long a lane or an observer may stand still before values or records are lost.
const STALL: Nanos = Nanos::from_millis(500);
/// More seats than bits in a health word cannot be reported.
const SEATS_MAX: usize = 32;

/// A lane's number in its machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LaneId(usize);

struct Draft {
    spec: LaneSpec,
    seats: Vec<Seat>,
    inputs: Vec<(usize, InputDeclaration)>,
    outputs: Vec<(usize, OutputDeclaration)>,
    tapes: Vec<TapeDeclaration>,
    /// By the name of the task.
    parameters: Vec<(String, Declaration)>,
}

/// Collects lanes, tasks and bindings, then checks and joins them.
#[derive(Default)]
pub struct Builder {
    lanes: Vec<Draft>,
    bindings: BTreeMap<String, String>,
    mode: Option<String>,
    allowance: Allowance,
    cpus: Option<BTreeSet<usize>>,
    time_tasks: bool,
    recording: Recording,
    /// For how much longer than usual values are held.
    longer: Nanos,
}

/// A machine that can be run by an executor.
pub struct Machine {
    pub(crate) lanes: Vec<Lane>,
    pub(crate) drains: Vec<Drain>,
    catalog: Catalog,
    analysis: Analysis,
    desk: Desk,
    edit_rings: Vec<rtrb::Producer<Part>>,
}

impl Machine {
    /// Whether the lanes can meet their deadlines, as far as budgets are declared.
    #[must_use]
    pub fn analysis(&self) -> &Analysis {
        &self.analysis
    }

    /// Keeps every record of the lanes in a flight recorder too.
    pub fn keep(&mut self, recorder: Recorder) {
        for (lane, flight) in self.lanes.iter_mut().zip(recorder.into_lanes()) {
            lane.tap.keep(flight);
        }
    }

    /// Every signal and lane.
    #[must_use]
    pub fn catalog(&self) -> &Catalog {
        &self.catalog
    }

    /// What each lane counted, with its specification, in order.
    pub fn figures(&self) -> impl Iterator<Item = (&LaneSpec, &Figures)> {
        self.lanes.iter().map(|lane| (&lane.spec, &lane.figures))
    }

    /// Where jobs panicked, the first place of each lane.
    pub fn panics(&self) -> impl Iterator<Item = &str> {
        self.lanes.iter().filter_map(|lane| lane.panicked.as_deref())
    }

    /// Starts every task in order; the first refusal stops all of them and is returned with the
    /// task's name.
    pub(crate) fn start(&mut self) -> Result<(), (String, FaultCode)> {
        self.lanes.iter_mut().for_each(|lane| lane.stopped = false);
        let refused = self.lanes.iter_mut().flat_map(|lane| &mut lane.seats).find_map(|seat| {
            let fault = seat.task.start().err()?;
            Some((seat.name.clone(), fault))
        });
        let Some(refused) = refused else { return Ok(()) };
        self.stop();
        Err(refused)
    }

    /// Stops every lane that has not been stopped by its own thread.
    pub(crate) fn stop(&mut self) {
        for lane in &mut self.lanes {
            lane.stop();
        }
    }

    /// The names of the tasks of each lane, in order.
    pub fn seats(&self) -> impl Iterator<Item = Vec<&str>> {
        self.lanes.iter().map(|lane| lane.seats.iter().map(|seat| seat.name.as_str()).collect())
    }
}

impl Builder {
    /// An empty machine.
    #[must_use]
    pub fn new() -> Builder {
        Builder::default()
    }

    /// Adds a lane.
    ///
    /// # Errors
    /// A specification out of range, or a name that is taken. The place is `lane.NAME.field`.
    pub fn lane(&mut self, spec: LaneSpec) -> Result<LaneId, Invalid> {
        let outer = format!("lane.{}", spec.name);
        spec.check().map_err(|invalid| invalid.within(&outer))?;
        if self.lanes.iter().any(|draft| draft.spec.name == spec.name) {
            return Err(Invalid::new(
                format!("{outer}.name"),
                format!("two lanes are called `{}`", spec.name),
                "give each lane its own name",
            ));
        }
        if self.lanes.len() == LANES_MAX {
            return Err(Invalid::new(
                outer,
                format!("a machine has at most {LANES_MAX} lanes"),
                "put tasks of one rate into one lane",
            ));
        }
        let (inputs, outputs, parameters) = (Vec::new(), Vec::new(), Vec::new());
        let (seats, tapes) = (Vec::new(), Vec::new());
        let mut draft = Draft { spec, seats, inputs, outputs, tapes, parameters };
        // A lane's own health is its first output, at seat number usize::MAX: it belongs to no
        // task.
        let mut own = Ports::new(0, 0);
        let _ = own.output::<LaneHealth>("health");
        draft.outputs.extend(own.outputs.into_iter().map(|output| (usize::MAX, output)));
        self.lanes.push(draft);
        Ok(LaneId(self.lanes.len() - 1))
    }

    /// Adds a task at the end of a lane; `make` declares its ports and builds it.
    ///
    /// # Errors
    /// Whatever `make` refuses, or a name that another task has: then each of its signals would
    /// have two producers.
    pub fn task(
        &mut self,
        lane: LaneId,
        name: &str,
        make: impl FnOnce(&mut Ports) -> Result<Box<dyn Task>, Invalid>,
    ) -> Result<(), Invalid> {
        if let Some(other) =
            self.lanes.iter().find(|draft| draft.seats.iter().any(|seat| seat.name == name))
        {
            let signal = other
                .outputs
                .iter()
                .find(|(seat, _)| other.seats.get(*seat).is_some_and(|seat| seat.name == name));
            let of = signal
                .map_or_else(String::new, |(_, output)| format!(" of `{name}.{}`", output.name));
            return Err(Invalid::new(
                format!("lane.{}.tasks.{name}", self.lanes[lane.0].spec.name),
                format!(
                    "task `{name}` stands in lane `{}` already: two producers{of}",
                    other.spec.name
                ),
                "name each task once",
            ));
        }
        let draft = &mut self.lanes[lane.0];
        if draft.seats.len() == SEATS_MAX {
            return Err(Invalid::new(
                format!("lane.{}.tasks.{name}", draft.spec.name),
                format!("a lane has at most {SEATS_MAX} tasks"),
                "move some to another lane",
            ));
        }
        let mut ports = Ports::new(draft.inputs.len(), draft.outputs.len());
        ports.first_parameter = draft.parameters.len();
        let task = make(&mut ports)?;
        let seat = draft.seats.len();
        for declared in ports.parameters {
            declared.check().map_err(|invalid| invalid.within(name))?;
            draft.parameters.push((name.to_owned(), declared));
        }
        draft.inputs.extend(ports.inputs.into_iter().map(|input| (seat, input)));
        draft.outputs.extend(ports.outputs.into_iter().map(|output| (seat, output)));
        draft.tapes.extend(ports.tapes);
        let mut seat = Seat::new(name, task);
        seat.parameters = ports.first_parameter..draft.parameters.len();
        draft.seats.push(seat);
        Ok(())
    }

    /// Binds input `task.port` to signal `task.port` (or `lane.health`).
    pub fn bind(&mut self, input: impl Into<String>, signal: impl Into<String>) {
        self.bindings.insert(input.into(), signal.into());
    }

    /// Names the signal of type [`crate::status::ModeStatus`] from which every lane takes
    /// [`crate::Cycle::mode`].
    pub fn mode_from(&mut self, signal: impl Into<String>) {
        self.mode = Some(signal.into());
    }

    /// What the schedule allows for besides the budgets.
    ///
    /// # Errors
    /// An allowance out of range. The place is `schedule.FIELD`.
    pub fn allowance(&mut self, allowance: Allowance) -> Result<(), Invalid> {
        allowance.check().map_err(|invalid| invalid.within("schedule"))?;
        self.allowance = allowance;
        Ok(())
    }

    /// Names the CPUs that there are; a lane on another one is then refused.
    pub fn cpus(&mut self, present: BTreeSet<usize>) {
        self.cpus = Some(present);
    }

    /// Times every task, also in lanes that declare no budgets: one more clock reading a task.
    pub fn time_tasks(&mut self) {
        self.time_tasks = true;
    }

    /// Chooses what leaves the lanes for observers; [`Recording::Full`] unless told otherwise.
    pub fn recording(&mut self, recording: Recording) {
        self.recording = recording;
    }

    /// Makes a machine that repeats a run ([`crate::replay`]): lanes may name CPUs that are not
    /// here, and values are held for `stall`, the longest that a lane stood still. Call it last.
    pub fn for_replay(&mut self, stall: Nanos) {
        (self.cpus, self.longer) = (None, stall);
    }

    /// Joins everything.
    ///
    /// # Errors
    /// A schedule that cannot hold, a CPU that does not exist, a budget of a task that is not
    /// there: the place is `lane.NAME` and below. An input without a binding or whose signal nobody
    /// produces, a wrong type, a loop without a declared delay, a binding of an input that does not
    /// exist. The place is `wiring.TASK.PORT`.
    pub fn build(mut self) -> Result<Machine, Invalid> {
        let mut edits: Vec<_> = self.lanes.iter_mut().map(parameters::declare_edit).collect();
        let desk = parameters::desk(&self.lanes);
        let mut catalog = self.catalog();
        check_catalog(&catalog)?;
        let inputs = self.lanes.iter().flat_map(|draft| {
            let name = |(seat, input): &(usize, InputDeclaration)| {
                format!("{}.{}", draft.seats[*seat].name, input.name)
            };
            draft.inputs.iter().map(name)
        });
        check_bindings(&inputs.collect::<Vec<_>>(), &self.bindings)?;
        let (analysis, reservations) = self.check_schedule()?;
        let homes = self.homes();
        let (stall, jitter) = (STALL + self.longer, self.allowance.release_jitter);
        let mut lanes: Vec<Lane> = Vec::new();
        let (mut drains, mut edit_rings) = (Vec::new(), Vec::new());
        for (index, draft) in self.lanes.iter_mut().enumerate() {
            let timed = self.time_tasks || !draft.spec.budgets.is_empty();
            let (mut lane, drain) = take_lane(draft, index, &catalog, &homes, (timed, stall));
            let (knobs, ring) = parameters::knobs(draft);
            (lane.knobs, lane.edit) = (knobs, edits[index].take());
            (lane.reservation, lane.release_jitter) = (reservations[index], jitter);
            lanes.push(lane);
            drains.push(drain);
            edit_rings.push(ring);
        }
        let mut links = BTreeMap::new();
        for index in 0..self.lanes.len() {
            for (seat, input) in &self.lanes[index].inputs {
                let place = format!("{}.{}", lanes[index].seats[*seat].name, input.name);
                let signal = &self.bindings[&place];
                let home =
                    homes.get(signal).ok_or_else(|| unknown(&place, signal, input, &catalog))?;
                check_edge(&place, signal, input, *seat, index, home)?;
                let period = self.lanes[index].spec.period;
                if home.is_health() && period > self.lanes[home.lane].spec.period {
                    lanes[home.lane].latch.hold_for(period);
                }
                // Two inputs of one lane on one signal share a link.
                let key = (index, home.lane, home.cell);
                let cell = match links.get(&key) {
                    Some(cell) => *cell,
                    None => join(&mut lanes, index, home, input.connect, stall)
                        .ok_or_else(|| mismatch(&place, signal, input, home))?,
                };
                if home.lane != index && links.insert(key, cell).is_none() {
                    catalog.lanes[index].reads.push(signal.clone());
                }
                lanes[index].inputs.push(Binding { cell, seen: 0, stale_after: input.stale_after });
            }
        }
        if let Some(signal) = &self.mode {
            bind_mode(&mut lanes, signal, &homes, &catalog, stall)?;
            for (lane, info) in lanes.iter().zip(&mut catalog.lanes) {
                let known = info.reads.len();
                info.reads.extend((known..lane.trace.remote.len()).map(|_| signal.clone()));
            }
        }
        check_remotes(&lanes)?;
        for lane in &mut lanes {
            lane.record(self.recording);
        }
        Ok(Machine { lanes, drains, catalog, analysis, desk, edit_rings })
    }

    fn check_schedule(&mut self) -> Result<(Analysis, Vec<Option<Reservation>>), Invalid> {
        let (mut demands, mut reservations) = (Vec::new(), Vec::new());
        for Draft { spec, seats, .. } in &self.lanes {
            let outer = format!("lane.{}", spec.name);
            let tasks: Vec<&str> = seats.iter().map(|seat| seat.name.as_str()).collect();
            spec.check_budget_names(&tasks).map_err(|invalid| invalid.within(&outer))?;
            if let Some(present) = &self.cpus {
                spec.check_cpu(present).map_err(|invalid| invalid.within(&outer))?;
            }
            demands.push(Demand { spec: spec.clone(), budget: spec.budget(tasks) });
        }
        keep_borne(&mut demands, self.allowance);
        for (Demand { spec, budget }, draft) in demands.iter().zip(&mut self.lanes) {
            let reservation = spec.reservation(*budget, self.allowance.overhead);
            let outer = || format!("lane.{}", spec.name);
            reservations.push(reservation.map_err(|invalid| invalid.within(&outer()))?);
            draft.spec.guard = spec.guard;
        }
        let analysis = analyse(&demands, self.allowance);
        analysis.refusal().cloned().map_or(Ok((analysis, reservations)), Err)
    }

    fn catalog(&self) -> Catalog {
        let mut catalog = Catalog::default();
        for (lane, draft) in self.lanes.iter().enumerate() {
            catalog.lanes.push(LaneInfo {
                name: draft.spec.name.clone(),
                period: draft.spec.period,
                phase: draft.spec.phase,
                tasks: draft.seats.iter().map(|seat| seat.name.clone()).collect(),
                reads: Vec::new(),
            });
            catalog.signals.extend(draft.tapes.iter().map(|tape| Signal {
                name: tape.name.clone(),
                lane,
                type_name: tape.type_name,
                fields: tape.fields,
                size: tape.size,
            }));
            for (seat, output) in &draft.outputs {
                catalog.signals.push(Signal {
                    name: signal_name(draft, *seat, output.name),
                    lane,
                    type_name: output.type_name,
                    fields: output.fields,
                    size: output.size,
                });
            }
            let traced = trace::signals(lane, &draft.spec, draft.seats.len(), self.recording);
            catalog.signals.extend(traced);
        }
        catalog
    }

    fn homes(&self) -> BTreeMap<String, Home> {
        let mut homes = BTreeMap::new();
        for (lane, draft) in self.lanes.iter().enumerate() {
            for (cell, (seat, output)) in draft.outputs.iter().enumerate() {
                let home = Home {
                    lane,
                    cell,
                    seat: *seat,
                    type_id: output.type_id,
                    type_name: output.type_name,
                };
                homes.insert(signal_name(draft, *seat, output.name), home);
            }
        }
        homes
    }
}

/// Where a signal is produced.
struct Home {
    lane: usize,
    cell: usize,
    seat: usize,
    type_id: TypeId,
    type_name: &'static str,
}

impl Home {
    /// A lane's own health was declared first.
    fn is_health(&self) -> bool {
        self.cell == 0
    }
}

fn signal_name(draft: &Draft, seat: usize, port: &str) -> String {
    let owner = draft.seats.get(seat).map_or(draft.spec.name.as_str(), |seat| seat.name.as_str());
    format!("{owner}.{port}")
}

fn take_lane(
    draft: &mut Draft,
    index: usize,
    catalog: &Catalog,
    homes: &BTreeMap<String, Home>,
    (timed, stall): (bool, Nanos),
) -> (Lane, Drain) {
    let mine =
        || catalog.signals.iter().enumerate().filter(move |(_, signal)| signal.lane == index);
    // A device may be asked twice in a job.
    let tapes: usize = draft.tapes.iter().map(|tape| HEADER_BYTES + tape.size).sum();
    let job_bytes: usize = mine().map(|(_, signal)| HEADER_BYTES + signal.size).sum();
    let job_bytes = job_bytes + tapes;
    let body = mine().map(|(_, signal)| signal.size).max().unwrap_or(0);
    let jobs = usize::try_from((stall.0 / draft.spec.period.0).max(4)).unwrap_or(4);
    let (tap, drain) = tap(job_bytes * jobs, body);
    let signals = mine()
        .filter_map(|(number, signal)| {
            let cell = homes.get(&signal.name)?.cell;
            Some((cell, u16::try_from(number).ok()?))
        })
        .collect();
    // The lane's own health was declared first: it is output cell 0.
    let health = Ports::new(0, 0).output::<LaneHealth>("health");
    let mut cells = Vec::new();
    for (_, output) in &mut draft.outputs {
        cells.push(std::mem::replace(&mut output.cell, crate::port::hollow()));
    }
    let mut figures = Figures::new();
    if timed {
        let task =
            |seat: &Seat| TaskFigures::new(&seat.name, draft.spec.budgets.get(&seat.name).copied());
        figures.tasks = draft.seats.iter().map(task).collect();
    }
    let number = |name: &str| catalog.find(name).and_then(|number| u16::try_from(number).ok());
    let mut trace = Trace::default();
    for tape in std::mem::take(&mut draft.tapes) {
        trace.tapes.extend(number(&tape.name).map(|number| (tape.spool, number)));
    }
    trace.decisions = number(&format!("{}.decision", draft.spec.name));
    trace.state = number(&format!("{}.state", draft.spec.name))
        .map(|number| (number, catalog.signals[usize::from(number)].size / 8));
    let lane = Lane {
        spec: draft.spec.clone(),
        reservation: None,
        release_jitter: Nanos::ZERO,
        seats: std::mem::take(&mut draft.seats),
        cells,
        inputs: Vec::new(),
        trace,
        signals,
        mode: None,
        health,
        latch: Latch::new(Nanos::ZERO),
        knobs: Knobs::new(Box::default()).0,
        edit: None,
        missed: 0,
        pulse: Arc::default(),
        recording: Recording::Full,
        tap,
        scratch: vec![0; HEADER_BYTES + body].into_boxed_slice(),
        next_tick: 0,
        figures,
        panicked: None,
        stopped: false,
    };
    (lane, drain)
}
