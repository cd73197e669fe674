//! Puts a machine together: lanes, tasks, bindings. Everything that can be wrong with a wiring is
//! found here, before the first job, with the place in the configuration. Executors run the
//! machine.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use taktil_hal::{Invalid, Nanos};

use crate::analysis::{Allowance, Analysis, Demand, analyse, keep_schedulable_guards};
use crate::fault::FaultCode;
use crate::figures::Figures;
use crate::flight::FlightRecorder;
use crate::lane::{Lane, TaskSlot};
use crate::lateness::LatenessCounts;
use crate::live::{Heartbeat, WatchedHeartbeat};
use crate::parameter::{LaneEdit, ParameterRegistry};
use crate::port::{Binding, InputDeclaration, Ports};
use crate::record::{Catalog, Recording};
use crate::record_ring::RecordReader;
use crate::schedule::{LANES_MAX, LaneSpec, Reservation};
use crate::task::Task;
use crate::timing_faults::TimingFaults;

mod connect;
mod diagnostics;
mod draft;
mod parameters;

use connect::{bind_mode, bind_pace, connect};
use diagnostics::{check_bindings, check_catalog, check_edge, check_remotes, mismatch, unknown};
use draft::{LaneDraft, LaneSettings, SignalOrigin, build_lane, signal_origins};

/// How long a lane or an observer may stand still before values or records are lost.
const STALL_MAX: Nanos = Nanos::from_millis(500);
/// Most tasks of a lane: its health has one bit for each task that was disabled.
const TASKS_MAX: usize = 32;

/// A lane's number in its machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LaneId(usize);

/// Collects lanes, tasks and bindings, then checks and joins them.
#[derive(Default)]
pub struct Builder {
    lanes: Vec<LaneDraft>,
    bindings: BTreeMap<String, String>,
    mode: Option<String>,
    pace: Option<String>,
    allowance: Allowance,
    cpus: Option<BTreeSet<usize>>,
    time_tasks: bool,
    recording: Recording,
    /// For how much longer than [`STALL_MAX`] values are held.
    extra_hold: Nanos,
    /// Threads beside the lanes that the analysis counts.
    threads: Vec<Demand>,
}

/// A machine that can be run by an executor.
pub struct Machine {
    pub(crate) lanes: Vec<Lane>,
    pub(crate) readers: Vec<RecordReader>,
    pub(crate) catalog: Catalog,
    analysis: Analysis,
    registry: ParameterRegistry,
    edit_rings: Vec<rtrb::Producer<LaneEdit>>,
    pub(crate) heartbeats: Vec<WatchedHeartbeat>,
    pub(crate) timing_faults: TimingFaults,
}

impl Machine {
    /// Whether the lanes can meet their deadlines, as far as budgets are declared.
    #[must_use]
    pub fn analysis(&self) -> &Analysis {
        &self.analysis
    }

    /// From now on keeps every record of the lanes in a flight recorder too.
    pub fn attach_flight_recorder(&mut self, recorder: FlightRecorder) {
        for (lane, flight) in self.lanes.iter_mut().zip(recorder.into_lanes()) {
            lane.ports.records.attach_flight_ring(flight);
        }
    }

    /// A heartbeat for a thread without which the machine may not go on: at a fixed pace, lanes
    /// that see it stand still for `limit` raise [`FaultCode::MonitorSilent`].
    pub fn heartbeat(&mut self, limit: Nanos) -> Heartbeat {
        let (heartbeat, watched) = WatchedHeartbeat::new(limit);
        self.heartbeats.push(watched);
        heartbeat
    }

    /// Every signal and lane.
    #[must_use]
    pub fn catalog(&self) -> &Catalog {
        &self.catalog
    }

    /// What each lane counted, with its specification, in order.
    pub fn figures(&self) -> impl Iterator<Item = (&LaneSpec, &Figures)> {
        self.lanes.iter().map(|lane| (&lane.plan.spec, &lane.account.figures))
    }

    /// How late the jobs of each lane began, counted while it runs live, in the order of the
    /// catalog's lanes.
    #[must_use]
    pub fn lateness(&self) -> Vec<Arc<LatenessCounts>> {
        self.lanes.iter().map(|lane| Arc::clone(&lane.lateness)).collect()
    }

    /// Where jobs panicked, the first place of each lane.
    pub fn panics(&self) -> impl Iterator<Item = &str> {
        self.lanes.iter().filter_map(|lane| lane.account.panicked.as_deref())
    }

    /// Starts every task in order; the first refusal stops all of them and is returned with the
    /// task's name.
    pub(crate) fn start(&mut self) -> Result<(), (String, FaultCode)> {
        self.lanes.iter_mut().for_each(|lane| lane.account.stopped = false);
        let refused = self.lanes.iter_mut().flat_map(|lane| &mut lane.tasks).find_map(|slot| {
            let fault = slot.task.start().err()?;
            Some((slot.name.clone(), fault))
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
    pub fn task_names(&self) -> impl Iterator<Item = Vec<&str>> {
        self.lanes.iter().map(|lane| lane.tasks.iter().map(|slot| slot.name.as_str()).collect())
    }
}

impl Builder {
    /// An empty machine.
    #[must_use]
    pub fn new() -> Builder {
        Builder::default()
    }

    /// Has the analysis count a thread that is no lane, such as one that exchanges with a board:
    /// its period, deadline, priority, CPU and budget.
    pub fn thread_beside(&mut self, thread: Demand) {
        self.threads.push(thread);
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
        self.lanes.push(LaneDraft::new(spec));
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
            self.lanes.iter().find(|draft| draft.tasks.iter().any(|slot| slot.name == name))
        {
            let signal = other
                .outputs
                .iter()
                .find(|(task, _)| other.tasks.get(*task).is_some_and(|slot| slot.name == name));
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
        if draft.tasks.len() == TASKS_MAX {
            return Err(Invalid::new(
                format!("lane.{}.tasks.{name}", draft.spec.name),
                format!("a lane has at most {TASKS_MAX} tasks"),
                "move some to another lane",
            ));
        }
        let mut ports = Ports::new(draft.inputs.len(), draft.outputs.len());
        ports.first_parameter = draft.parameters.len();
        let task = make(&mut ports)?;
        let position = draft.tasks.len();
        for declared in ports.parameters {
            declared.check().map_err(|invalid| invalid.within(name))?;
            draft.parameters.push((name.to_owned(), declared));
        }
        draft.inputs.extend(ports.inputs.into_iter().map(|input| (position, input)));
        draft.outputs.extend(ports.outputs.into_iter().map(|output| (position, output)));
        draft.tapes.extend(ports.tapes);
        let mut slot = TaskSlot::new(name, task);
        slot.parameters = ports.first_parameter..draft.parameters.len();
        draft.tasks.push(slot);
        Ok(())
    }

    /// Binds input `task.port` to signal `task.port` (or `lane.ports.health`).
    pub fn bind(&mut self, input: impl Into<String>, signal: impl Into<String>) {
        self.bindings.insert(input.into(), signal.into());
    }

    /// Names the signal of type [`crate::status::ModeStatus`] from which every lane takes
    /// [`crate::Cycle::mode`].
    pub fn mode_from(&mut self, signal: impl Into<String>) {
        self.mode = Some(signal.into());
    }

    /// Names the signal of type [`crate::status::PaceStatus`] by which a live run at a fixed pace
    /// moves the releases of all lanes on the host's clock. Logical time does not change, nor does
    /// a run in virtual time or a replay, in which the signal is one like any other.
    pub fn pace_from(&mut self, signal: impl Into<String>) {
        self.pace = Some(signal.into());
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
        (self.cpus, self.extra_hold) = (None, stall);
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
        let registry = parameters::registry(&self.lanes);
        let mut catalog = draft::catalog(&self.lanes, self.recording);
        check_catalog(&catalog)?;
        let inputs = self.lanes.iter().flat_map(|draft| {
            let name = |(task, input): &(usize, InputDeclaration)| {
                format!("{}.{}", draft.tasks[*task].name, input.name)
            };
            draft.inputs.iter().map(name)
        });
        check_bindings(&inputs.collect::<Vec<_>>(), &self.bindings)?;
        let (analysis, reservations) = self.check_schedule()?;
        let origins = signal_origins(&self.lanes);
        let stall = STALL_MAX + self.extra_hold;
        let mut lanes: Vec<Lane> = Vec::new();
        let (mut readers, mut edit_rings) = (Vec::new(), Vec::new());
        for (index, draft) in self.lanes.iter_mut().enumerate() {
            let settings = LaneSettings {
                reservation: reservations[index],
                release_jitter: self.allowance.release_jitter,
                timed: self.time_tasks || !draft.spec.budgets.is_empty(),
                stall,
            };
            let mut built = build_lane(draft, index, &catalog, &origins, &settings);
            built.lane.ports.edit = edits[index].take();
            lanes.push(built.lane);
            readers.push(built.records);
            edit_rings.push(built.edits);
        }
        self.join_inputs(&mut lanes, &origins, &mut catalog, stall)?;
        if let Some(signal) = &self.mode {
            bind_mode(&mut lanes, signal, &origins, &catalog, stall)?;
            for (lane, info) in lanes.iter().zip(&mut catalog.lanes) {
                let known = info.reads.len();
                info.reads.extend((known..lane.ports.trace.remote.len()).map(|_| signal.clone()));
            }
        }
        if let Some(signal) = &self.pace {
            bind_pace(&mut lanes, signal, &origins, &catalog, stall)?;
        }
        check_remotes(&lanes)?;
        for lane in &mut lanes {
            lane.record(self.recording);
        }
        Ok(Machine {
            lanes,
            readers,
            catalog,
            analysis,
            registry,
            edit_rings,
            heartbeats: Vec::new(),
            timing_faults: TimingFaults::default(),
        })
    }

    /// Gives every input the cell of its signal; links lanes where the signal is another lane's.
    fn join_inputs(
        &self,
        lanes: &mut [Lane],
        origins: &BTreeMap<String, SignalOrigin>,
        catalog: &mut Catalog,
        stall: Nanos,
    ) -> Result<(), Invalid> {
        let mut links = BTreeMap::new();
        for index in 0..self.lanes.len() {
            for (task, input) in &self.lanes[index].inputs {
                let place = format!("{}.{}", lanes[index].tasks[*task].name, input.name);
                let signal = &self.bindings[&place];
                let origin =
                    origins.get(signal).ok_or_else(|| unknown(&place, signal, input, catalog))?;
                check_edge(&place, signal, input, *task, index, origin)?;
                let period = self.lanes[index].spec.period;
                if origin.is_health() && period > self.lanes[origin.lane].spec.period {
                    lanes[origin.lane].account.latch.extend_hold(period);
                }
                // Two inputs of one lane on one signal share a link.
                let key = (index, origin.lane, origin.cell);
                let cell = match links.get(&key) {
                    Some(cell) => *cell,
                    None => connect(lanes, index, origin, input.connect, stall)
                        .ok_or_else(|| mismatch(&place, signal, input, origin))?,
                };
                if origin.lane != index && links.insert(key, cell).is_none() {
                    catalog.lanes[index].reads.push(signal.clone());
                }
                lanes[index].ports.inputs.push(Binding {
                    cell,
                    seen: 0,
                    stale_after: input.stale_after,
                });
            }
        }
        Ok(())
    }

    /// Analyses the schedule and says what each deadline lane has to reserve.
    fn check_schedule(&mut self) -> Result<(Analysis, Vec<Option<Reservation>>), Invalid> {
        let (mut demands, mut reservations) = (Vec::new(), Vec::new());
        for LaneDraft { spec, tasks, .. } in &self.lanes {
            let outer = format!("lane.{}", spec.name);
            let tasks: Vec<&str> = tasks.iter().map(|slot| slot.name.as_str()).collect();
            spec.check_budget_names(&tasks).map_err(|invalid| invalid.within(&outer))?;
            if let Some(present) = &self.cpus {
                spec.check_cpu(present).map_err(|invalid| invalid.within(&outer))?;
            }
            demands.push(Demand { spec: spec.clone(), budget: spec.budget(tasks) });
        }
        let lanes = demands.len();
        demands.extend(self.threads.iter().cloned());
        keep_schedulable_guards(&mut demands, self.allowance);
        for (Demand { spec, budget }, draft) in demands.iter().zip(&mut self.lanes) {
            let reservation = spec.reservation(*budget, self.allowance.overhead);
            let outer = || format!("lane.{}", spec.name);
            reservations.push(reservation.map_err(|invalid| invalid.within(&outer()))?);
            draft.spec.guard = spec.guard;
        }
        let mut analysis = analyse(&demands, self.allowance);
        analysis.lanes.truncate(lanes);
        analysis.refusal().cloned().map_or(Ok((analysis, reservations)), Err)
    }
}
