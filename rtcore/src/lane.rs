//! A lane at run time: its tasks in order, its cells, and what it counts. All executors run exactly
//! this code. A job gets its release as an argument and does not ask for the real time: the clock
//! is read only to time tasks, if that is requested, and no decision depends on it.

use core::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use taktil_hal::Nanos;

use crate::activity::LaneActivity;
use crate::fault::FaultCode;
use crate::fault_latch::FaultLatch;
use crate::figures::Figures;
use crate::guard;
use crate::lateness::LatenessCounts;
use crate::linux::monotonic;
use crate::misses::Notice;
use crate::mode::Mode;
use crate::panic_hook;
use crate::parameter::{Edit, LaneParameters};
use crate::port::{AnyCell, Binding, Input, Io, Output};
use crate::record::{HEADER_BYTES, Recording};
use crate::record_ring::RecordWriter;
use crate::schedule::{LaneSpec, Reservation};
use crate::state::StateHash;
use crate::status::{LaneHealth, ModeStatus, PaceStatus};
use crate::task::{Cycle, Task};
use crate::trace::Trace;

/// A task and its place in the lane.
pub(crate) struct TaskSlot {
    pub(crate) name: String,
    pub(crate) task: Box<dyn Task>,
    pub(crate) disabled: bool,
    /// Hash of the task's state after its last step.
    pub(crate) state: u64,
    /// Which of the lane's parameters are the task's.
    pub(crate) parameters: Range<usize>,
}

impl TaskSlot {
    pub(crate) fn new(name: &str, task: Box<dyn Task>) -> TaskSlot {
        let name = name.to_owned();
        TaskSlot { name, task, disabled: false, state: 0, parameters: 0..0 }
    }

    /// Runs one step; if `hashed`, also hashes the state that it left: the task's parameters as
    /// edited, and what the task folds.
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>, hashed: bool) -> Result<(), FaultCode> {
        // A step that panics leaves no state.
        self.state = 0;
        let outcome = self.task.step(cycle, io);
        if hashed {
            let mut hash = StateHash::new();
            if let Some(values) = io.parameters.get(self.parameters.clone()) {
                hash.add(values);
            }
            self.task.fold(&mut hash);
            self.state = hash.value();
        }
        outcome
    }

    /// Runs one step and catches a panic in it: the task is then stopped at once, since the board
    /// that it drives would keep its last word, and is taken out of the lane.
    pub(crate) fn step_contained(
        &mut self,
        cycle: &Cycle,
        io: &mut Io<'_>,
        hashed: bool,
    ) -> Option<FaultCode> {
        match catch_unwind(AssertUnwindSafe(|| self.step(cycle, io, hashed))) {
            Ok(outcome) => outcome.err(),
            Err(payload) => {
                // Dropping the payload would free memory here, and could panic once more.
                core::mem::forget(payload);
                self.disabled = true;
                self.stop_contained();
                Some(FaultCode::TaskPanicked)
            }
        }
    }

    /// Lets the task leave its outputs safe. A task that panics in doing so must not keep the
    /// others from it.
    fn stop_contained(&mut self) {
        if let Err(payload) = catch_unwind(AssertUnwindSafe(|| self.task.stop())) {
            core::mem::forget(payload);
        }
    }
}

/// The plan of a lane, fixed before the first job.
pub(crate) struct LanePlan {
    pub(crate) spec: LaneSpec,
    /// What its thread asks for when it is scheduled by deadline.
    pub(crate) reservation: Option<Reservation>,
    /// Lateness of a release that the schedule allows for.
    pub(crate) release_jitter: Nanos,
    pub(crate) recording: Recording,
}

/// The paths of the values and records of a lane.
pub(crate) struct LanePorts {
    pub(crate) cells: Vec<Box<dyn AnyCell>>,
    pub(crate) inputs: Vec<Binding>,
    /// Cells written here, with the number of their signal in the catalog.
    pub(crate) signals: Vec<(usize, u16)>,
    pub(crate) mode: Option<Input<ModeStatus>>,
    /// The pace of the machine, where a task of this lane writes it.
    pub(crate) pace: Option<Input<PaceStatus>>,
    pub(crate) health: Output<LaneHealth>,
    pub(crate) edit: Option<Output<Edit>>,
    /// What is recorded about jobs besides their values, and the cells that other lanes feed.
    pub(crate) trace: Trace,
    pub(crate) records: RecordWriter,
    /// Room for one record, allocated before the first job.
    pub(crate) scratch: Box<[u8]>,
}

/// What a lane counts and remembers from job to job.
pub(crate) struct LaneAccount {
    pub(crate) next_tick: u64,
    pub(crate) missed: u32,
    pub(crate) latch: FaultLatch,
    pub(crate) figures: Figures,
    /// Where a task of this lane panicked first.
    pub(crate) panicked: Option<String>,
    pub(crate) stopped: bool,
    /// What the newest pace adds to logical time.
    pub(crate) pace: Nanos,
}

/// One lane, ready to run jobs.
pub(crate) struct Lane {
    pub(crate) plan: LanePlan,
    pub(crate) tasks: Vec<TaskSlot>,
    pub(crate) parameters: LaneParameters,
    pub(crate) ports: LanePorts,
    pub(crate) account: LaneAccount,
    pub(crate) activity: Arc<LaneActivity>,
    pub(crate) lateness: Arc<LatenessCounts>,
}

impl Lane {
    /// Runs job `tick` from taking its inputs to publishing its outputs; `notice` is the report of
    /// the schedule on the jobs before.
    pub(crate) fn job(&mut self, tick: u64, notice: Notice) {
        let ((), allocations) = guard::count_heap_calls(|| self.run(tick, notice));
        self.account.figures.jobs += 1;
        self.account.figures.allocations += allocations;
        self.account.next_tick = tick + 1;
    }

    /// The whole job. The real-time sanitizer checks that no call in it may block.
    #[cfg_attr(taktil_rtsan, sanitize(realtime = "nonblocking"))]
    fn run(&mut self, tick: u64, notice: Notice) {
        let release = self.plan.spec.release(tick);
        let notice = self.ports.trace.take_inputs((tick, release), notice, &mut self.ports.cells);
        let hashed = self.ports.trace.state.is_some();
        let mut faults = notice.faults;
        let mut faulty_task = 0;
        let mut disabled = 0;
        let mut cycle = Cycle { tick, release, dt: self.plan.spec.period, mode: Mode::Off };
        self.ports.records.begin_job(tick);
        let edit = self.parameters.apply(release);
        let mut io = Io {
            cells: &mut self.ports.cells,
            inputs: &mut self.ports.inputs,
            parameters: &self.parameters.values,
            release,
            refused: None,
        };
        if let (Some(output), Some(edit)) = (&self.ports.edit, edit) {
            io.write(output, edit);
        }
        let mut clock = (!self.account.figures.tasks.is_empty()).then(monotonic);
        for (position, slot) in (1u32..).zip(self.tasks.iter_mut()) {
            if slot.disabled {
                disabled |= 1u32.checked_shl(position - 1).unwrap_or(0);
                continue;
            }
            if let Some(input) = &self.ports.mode {
                cycle.mode = io.read(input).value.mode();
            }
            self.activity.enter_task(position);
            self.ports.records.enter_task(position);
            let fault = slot.step_contained(&cycle, &mut io, hashed);
            if let Some(before) = &mut clock {
                let after = monotonic();
                if let Some(task) = self.account.figures.tasks.get_mut(position as usize - 1) {
                    let took = (after - *before).0.unsigned_abs();
                    task.execution_ns.saturating_record(took);
                }
                *before = after;
            }
            let refused = core::mem::take(&mut io.refused);
            for fault in [fault, refused].into_iter().flatten() {
                faults.insert(fault);
                if faulty_task == 0 {
                    faulty_task = position;
                }
            }
        }
        self.activity.enter_task(0);
        self.account.missed = self.account.missed.saturating_add(notice.missed);
        let (held, faulty_task) = self.account.latch.latch(release, faults, faulty_task);
        let health = LaneHealth {
            jobs: self.account.figures.jobs + 1,
            faults: held.0,
            faulty_task,
            disabled,
            missed: self.account.missed,
            silent: notice.silent,
        };
        if let Some(input) = &self.ports.pace {
            self.account.pace = Nanos(io.read(input).value.correction_ns);
        }
        io.write(&self.ports.health, health);
        self.account.figures.faults = self.account.figures.faults.union(faults);
        self.publish(tick, release);
        self.ports.records.enter_task(0);
    }

    /// Sets what is recorded. Without recording only signals that other lanes read are looked at
    /// after a job.
    pub(crate) fn record(&mut self, recording: Recording) {
        self.plan.recording = recording;
        if recording == Recording::Off {
            let cells = &self.ports.cells;
            self.ports.signals.retain(|&(cell, _)| cells[cell].is_linked());
            self.ports.trace.tapes.clear();
        }
    }

    /// Keeps the place of the lane's first panic. To be called outside jobs, on the thread that
    /// runs them.
    pub(crate) fn note_panic(&mut self) {
        if !self.account.figures.faults.contains(FaultCode::TaskPanicked) {
            return;
        }
        let Some(site) = panic_hook::take_first_site() else { return };
        let told = || format!("lane {}: panicked at {site}", self.plan.spec.name);
        self.account.panicked.get_or_insert_with(told);
    }

    fn publish(&mut self, tick: u64, release: Nanos) {
        let visible = release + self.plan.spec.delivery;
        self.ports.trace.publish_tapes(tick, &mut self.ports.records, &mut self.ports.scratch);
        for &(cell, signal) in &self.ports.signals {
            let scratch = (self.plan.recording > Recording::Off)
                .then_some(&mut self.ports.scratch[HEADER_BYTES..]);
            if let Some(length) = self.ports.cells[cell].publish(visible, scratch) {
                self.ports.records.append(
                    signal,
                    tick,
                    release,
                    &mut self.ports.scratch[..HEADER_BYTES + length],
                );
            }
        }
        let states = self.tasks.iter().map(|slot| slot.state);
        self.ports.trace.publish(
            (tick, release),
            states,
            &mut self.ports.records,
            &mut self.ports.scratch,
        );
    }

    /// After the last job: tasks leave their outputs safe, counters are gathered.
    /// A second call does nothing.
    pub(crate) fn stop(&mut self) {
        if core::mem::replace(&mut self.account.stopped, true) {
            return;
        }
        for slot in &mut self.tasks {
            slot.stop_contained();
        }
        self.account.figures.records_dropped =
            self.ports.records.dropped() + self.ports.trace.tape_lost();
        self.account.figures.values_dropped =
            self.ports.cells.iter().map(|cell| cell.dropped()).sum();
    }
}
