//! A lane at run time: its tasks in order, its cells, and what it counts. Both executors run
//! exactly this code. Refuses to know what time it really is: a job is told its release. The clock
//! is read to time tasks, if that is wanted, and decides nothing.

use core::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use hdrhistogram::Histogram;
use taktil_hal::Nanos;

use crate::fault::{FaultCode, FaultSet};
use crate::guard;
use crate::linux::monotonic;
use crate::misses::{Misses, Notice};
use crate::mode::Mode;
use crate::parameter::{Edit, Knobs};
use crate::port::{AnyCell, Binding, Input, Io, Output};
use crate::pulse::Pulse;
use crate::record::{HEADER_BYTES, Recording};
use crate::record_ring::Tap;
use crate::release::GuardFigures;
use crate::schedule::{LaneSpec, Reservation};
use crate::silence;
use crate::state::StateHash;
use crate::status::{LaneHealth, ModeStatus};
use crate::task::{Cycle, Task};
use crate::trace::Trace;

/// A task and its place in the lane.
pub(crate) struct Seat {
    pub(crate) name: String,
    pub(crate) task: Box<dyn Task>,
    pub(crate) disabled: bool,
    /// Hash of the task's state after its last step.
    pub(crate) state: u64,
    /// Which of the lane's parameters are the task's.
    pub(crate) parameters: Range<usize>,
}

impl Seat {
    pub(crate) fn new(name: &str, task: Box<dyn Task>) -> Seat {
        let name = name.to_owned();
        Seat { name, task, disabled: false, state: 0, parameters: 0..0 }
    }

    /// One step, and the state that it left: its parameters as edited, and what it folds.
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

    /// One step whose panic goes no further: the task is taken out of the lane.
    fn contained(&mut self, cycle: &Cycle, io: &mut Io<'_>, hashed: bool) -> Option<FaultCode> {
        match catch_unwind(AssertUnwindSafe(|| self.step(cycle, io, hashed))) {
            Ok(outcome) => outcome.err(),
            Err(payload) => {
                // Dropping it would free memory here, and could panic once more.
                core::mem::forget(payload);
                self.disabled = true;
                Some(FaultCode::TaskPanicked)
            }
        }
    }
}

/// One lane, ready to run jobs.
pub(crate) struct Lane {
    pub(crate) spec: LaneSpec,
    /// What its thread asks for when it is scheduled by deadline.
    pub(crate) reservation: Option<Reservation>,
    /// Lateness of a release that the schedule allows for.
    pub(crate) release_jitter: Nanos,
    pub(crate) seats: Vec<Seat>,
    pub(crate) cells: Vec<Box<dyn AnyCell>>,
    pub(crate) inputs: Vec<Binding>,
    /// What is recorded about jobs besides their values, and the cells that other lanes feed.
    pub(crate) trace: Trace,
    /// Cells written here, with the number of their signal in the catalog.
    pub(crate) signals: Vec<(usize, u16)>,
    pub(crate) mode: Option<Input<ModeStatus>>,
    pub(crate) health: Output<LaneHealth>,
    pub(crate) latch: Latch,
    pub(crate) knobs: Knobs,
    pub(crate) edit: Option<Output<Edit>>,
    pub(crate) missed: u32,
    pub(crate) pulse: Arc<Pulse>,
    pub(crate) recording: Recording,
    pub(crate) tap: Tap,
    pub(crate) scratch: Box<[u8]>,
    pub(crate) next_tick: u64,
    pub(crate) figures: Figures,
    /// Where a task of this lane panicked first.
    pub(crate) panicked: Option<String>,
    pub(crate) stopped: bool,
}

/// Keeps each fault in the lane's health until the slowest lane that reads it has had a job.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Latch {
    hold: Nanos,
    faults: FaultSet,
    task: u32,
    until: [Nanos; 64],
}

impl Latch {
    /// Faults are held for `hold` after the job that raised them.
    pub(crate) fn new(hold: Nanos) -> Latch {
        Latch { hold, faults: FaultSet::NONE, task: 0, until: [Nanos::ZERO; 64] }
    }

    /// A reader with this period must not miss any fault.
    pub(crate) fn hold_for(&mut self, period: Nanos) {
        self.hold = self.hold.max(period);
    }

    /// What the health says at `release`, after `faults` of which `task` raised the first.
    fn hold(&mut self, release: Nanos, faults: FaultSet, task: u32) -> (FaultSet, u32) {
        if faults.is_empty() && self.faults.is_empty() {
            return (FaultSet::NONE, 0);
        }
        for (bit, until) in self.until.iter_mut().enumerate() {
            let mask = 1 << bit;
            if faults.0 & mask != 0 {
                *until = release + self.hold;
            } else if *until <= release {
                self.faults.0 &= !mask;
            }
        }
        if self.faults.is_empty() || self.task == 0 {
            self.task = task;
        }
        self.faults = self.faults.union(faults);
        (self.faults, if self.faults.is_empty() { 0 } else { self.task })
    }
}

/// What a lane counted.
#[derive(Clone, Debug)]
pub struct Figures {
    /// Jobs that were run.
    pub jobs: u64,
    /// Jobs left out because the lane was more than a period late.
    pub skipped: u64,
    /// Actual start minus release, ns. In virtual time all zero.
    pub lateness_ns: Histogram<u64>,
    /// Start to end of a job on the clock, ns.
    pub execution_ns: Histogram<u64>,
    /// Jobs that ended after their deadline, by cause.
    pub misses: Misses,
    /// Misses at which the bucket was full: where the world does not wait, each stops the machine.
    pub storms: u64,
    /// Heap calls inside jobs; meaningful when [`guard::installed`].
    pub allocations: u64,
    /// Page faults of the lane's thread during jobs.
    pub page_faults: u64,
    /// Records lost because the observer was slow.
    pub records_dropped: u64,
    /// Values lost because another lane stood still.
    pub values_dropped: u64,
    /// Every fault that a task of this lane raised.
    pub faults: FaultSet,
    /// From waking to going to sleep again, without what the guard spun, ns: jobs and executor.
    pub awake_ns: Histogram<u64>,
    /// Of these, the cycles in which the kernel was asked for the evidence of misses, ns.
    pub evidence_ns: Histogram<u64>,
    /// How late sleeps ended, ns: with a guard that is not how late jobs began.
    pub wake_ns: Histogram<u64>,
    /// What the guard did; absent without one.
    pub guard: Option<GuardFigures>,
    /// Task by task in order; empty when the lane declares no budgets and nobody asked.
    pub tasks: Vec<TaskFigures>,
}

/// What a task took.
#[derive(Clone, Debug)]
pub struct TaskFigures {
    /// Its name.
    pub name: String,
    /// What it declared.
    pub budget: Option<Nanos>,
    /// From the end of the task before to its own end on the clock, ns: also what preempted it.
    pub execution_ns: Histogram<u64>,
}

impl TaskFigures {
    pub(crate) fn new(name: &str, budget: Option<Nanos>) -> TaskFigures {
        TaskFigures { name: name.to_owned(), budget, execution_ns: histogram() }
    }
}

/// 1 ns to [`LONGEST_NS`] at two digits: 3 968 counters, allocated here and never again.
fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, LONGEST_NS, 2).expect("constant bounds are valid")
}

/// Ten times the longest period: what is longer is counted as this.
const LONGEST_NS: u64 = 100_000_000_000;

impl Figures {
    pub(crate) fn new() -> Figures {
        Figures {
            jobs: 0,
            skipped: 0,
            lateness_ns: histogram(),
            execution_ns: histogram(),
            misses: Misses::default(),
            storms: 0,
            allocations: 0,
            page_faults: 0,
            records_dropped: 0,
            values_dropped: 0,
            faults: FaultSet::NONE,
            awake_ns: histogram(),
            evidence_ns: histogram(),
            wake_ns: histogram(),
            guard: None,
            tasks: Vec::new(),
        }
    }
}

impl Lane {
    /// Runs job `tick` from taking its inputs to publishing its outputs; `notice` is what the
    /// schedule has to say about the jobs before.
    pub(crate) fn job(&mut self, tick: u64, notice: Notice) {
        let ((), allocations) = guard::guarded(|| self.run(tick, notice));
        self.figures.jobs += 1;
        self.figures.allocations += allocations;
        self.next_tick = tick + 1;
    }

    /// Everything that a job does. The sanitizer's lane sees each call in it that may block.
    #[cfg_attr(taktil_rtsan, sanitize(realtime = "nonblocking"))]
    fn run(&mut self, tick: u64, notice: Notice) {
        let release = self.spec.release(tick);
        let notice = self.trace.take((tick, release), notice, &mut self.cells);
        let hashed = self.trace.state.is_some();
        let mut faults = notice.faults;
        let mut faulty_task = 0;
        let mut disabled = 0;
        let mut cycle = Cycle { tick, release, dt: self.spec.period, mode: Mode::Off };
        self.tap.begin(tick);
        let edit = self.knobs.apply(release);
        let mut io = Io {
            cells: &mut self.cells,
            inputs: &mut self.inputs,
            parameters: &self.knobs.values,
            release,
            refused: None,
        };
        if let (Some(output), Some(edit)) = (&self.edit, edit) {
            io.write(output, edit);
        }
        let mut clock = (!self.figures.tasks.is_empty()).then(monotonic);
        for (position, seat) in (1u32..).zip(self.seats.iter_mut()) {
            if seat.disabled {
                disabled |= 1u32.checked_shl(position - 1).unwrap_or(0);
                continue;
            }
            if let Some(input) = &self.mode {
                cycle.mode = io.read(input).value.mode();
            }
            self.pulse.enter(position);
            self.tap.enter(position);
            let fault = seat.contained(&cycle, &mut io, hashed);
            if let Some(before) = &mut clock {
                let after = monotonic();
                if let Some(task) = self.figures.tasks.get_mut(position as usize - 1) {
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
        self.pulse.enter(0);
        self.missed = self.missed.saturating_add(notice.missed);
        let (held, faulty_task) = self.latch.hold(release, faults, faulty_task);
        let health = LaneHealth {
            jobs: self.figures.jobs + 1,
            faults: held.0,
            faulty_task,
            disabled,
            missed: self.missed,
            silent: notice.silent,
        };
        io.write(&self.health, health);
        self.figures.faults = self.figures.faults.union(faults);
        self.publish(tick, release);
        self.tap.enter(0);
    }

    /// Without recording only what other lanes read has to be looked at after a job.
    pub(crate) fn record(&mut self, recording: Recording) {
        self.recording = recording;
        if recording == Recording::Off {
            let cells = &self.cells;
            self.signals.retain(|&(cell, _)| cells[cell].linked());
            self.trace.tapes.clear();
        }
    }

    /// Outside jobs, on the thread that runs them: keeps the place of the lane's first panic.
    pub(crate) fn note_panic(&mut self) {
        if !self.figures.faults.contains(FaultCode::TaskPanicked) {
            return;
        }
        let Some(site) = silence::take() else { return };
        let told = || format!("lane {}: panicked at {site}", self.spec.name);
        self.panicked.get_or_insert_with(told);
    }

    fn publish(&mut self, tick: u64, release: Nanos) {
        let visible = release + self.spec.delivery;
        self.trace.publish_tapes(tick, &mut self.tap, &mut self.scratch);
        for &(cell, signal) in &self.signals {
            let scratch =
                (self.recording > Recording::Off).then_some(&mut self.scratch[HEADER_BYTES..]);
            if let Some(length) = self.cells[cell].publish(visible, scratch) {
                self.tap.put(signal, tick, release, &mut self.scratch[..HEADER_BYTES + length]);
            }
        }
        let states = self.seats.iter().map(|seat| seat.state);
        self.trace.publish((tick, release), states, &mut self.tap, &mut self.scratch);
    }

    /// After the last job: tasks leave their outputs safe, counters are gathered.
    /// A second call does nothing.
    pub(crate) fn stop(&mut self) {
        if core::mem::replace(&mut self.stopped, true) {
            return;
        }
        for seat in &mut self.seats {
            // A task that panics while stopping must not keep the others from doing so.
            let _ = catch_unwind(AssertUnwindSafe(|| seat.task.stop()));
        }
        self.figures.records_dropped = self.tap.dropped() + self.trace.tape_lost();
        self.figures.values_dropped = self.cells.iter().map(|cell| cell.dropped()).sum();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::LONGEST_PERIOD;

    #[test]
    fn what_a_legal_lane_may_take_is_counted_as_it_is() {
        let mut figures = Figures::new();
        for span in [400_000_000, LONGEST_PERIOD.0.unsigned_abs(), LONGEST_NS] {
            figures.execution_ns.saturating_record(span);
            let most = figures.execution_ns.max() as f64 / span as f64;
            assert!((1.0..1.01).contains(&most), "{span} ns is counted as {most} of it");
        }
        figures.execution_ns.saturating_record(u64::MAX);
        assert!(figures.execution_ns.max() < 2 * LONGEST_NS);
    }
}
