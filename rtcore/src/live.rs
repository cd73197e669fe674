//! The live executor: one thread a lane, `SCHED_FIFO`, released by absolute sleeps on the monotonic
//! clock. The calling thread stays ordinary and carries records to the observer. What the kernel
//! granted is read back for each lane, so that nothing that is missing stays hidden.

pub(crate) mod disturbed;
mod flags;
mod grant;
mod heartbeat;
mod lane_loop;
mod monitor;
mod peers;
mod progress;
mod usage;

use core::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread;

use taktil_hal::{Clock, Nanos};

use crate::activity::LaneActivity;
pub use crate::attest::Attestation;
use crate::contract::{Demands, Item, Shortfall};
pub use crate::facts::{Facts, LaneGrant};
use crate::fault::FaultCode;
use crate::lane::Lane;
use crate::linux::{
    CpuLatencyRequest, MonotonicClock, RealTimeLimit, kernel, lock_memory, prefault_stack,
    run_bounded, unlock_memory,
};
use crate::machine::Machine;
use crate::panic_hook;
use crate::record::Observer;
use crate::record_ring::RecordReader;
use crate::release::GuardCondition;
use crate::schedule::LaneSpec;
use flags::{ArrivalCount, PaceOffset, Slip, StartGate, StartSignal, StormCount};
pub use grant::trial_attestation;
use grant::{complete_attestation, request_grant};
pub use heartbeat::Heartbeat;
pub(crate) use heartbeat::WatchedHeartbeat;
use lane_loop::{LaneMonitors, run_lane_loop};
use monitor::ProgressMonitor;
use progress::JobProgress;

/// The atomics that `flags.rs` uses; loom puts its own in their place.
mod sync {
    pub(super) use core::sync::atomic::{AtomicI64, AtomicU8, AtomicU64, AtomicUsize, Ordering};
}

/// Stack of a lane's thread: all of it is locked in memory.
const STACK_BYTES: usize = 1024 * 1024;
/// From the start of the threads to the release of the first job.
const START_LEAD: Nanos = Nanos::from_millis(50);
/// How often the observer is told of the run's time at most, because it has heard too late.
const ANNOUNCEMENTS_MAX: u32 = 20;
/// A task that has not returned for twice the time after which its lane is silent, and for this
/// long at least, is taken to hang: others act on silence long before, a watchdog of a second
/// after.
const HANG_MIN: Nanos = Nanos::from_millis(500);
/// The same where the world waits: nothing is at stake, and the machine may be very busy.
const HANG_MIN_SLIP: Nanos = Nanos::from_secs(2);
/// Number of looks at the rings between stopping the other lanes and reporting that a task hangs:
/// time to carry their last records.
const HANG_GRACE_LOOKS: u32 = 50;
/// How long the carrying thread may stand still while the lanes go on, at a fixed pace.
const CARRIER_SILENCE_MAX: Nanos = Nanos::from_millis(500);
/// Pause of the carrying thread between two looks at the rings.
const CARRY_PAUSE: std::time::Duration = std::time::Duration::from_millis(2);
/// Most records of one lane that the carrying thread takes between two looks at the clock: half a
/// million in a second. On a processor that leaves it too little time records are lost, which is
/// counted, but it goes on to watch the lanes and to tell who watches it that it lives.
const RECORDS_PER_LOOK_MAX: usize = 1024;

/// Whether a run may go on with less than it asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contract {
    /// A priority, CPU, memory or PREEMPT_RT that is missing refuses the run before the first job;
    /// what else is missing is reported. The short form of [`Demands::BOARD`].
    Hard,
    /// Anything missing is reported and every timing figure marked.
    Soft,
    /// Item by item.
    Items(Demands),
}

impl Contract {
    /// The weight of every item.
    #[must_use]
    pub const fn demands(self) -> Demands {
        match self {
            Contract::Hard => Demands::BOARD,
            Contract::Soft => Demands::SOFT,
            Contract::Items(demands) => demands,
        }
    }
}

/// What happens to logical time when a lane is woken later than its deadline leaves room for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Nothing: the world outside goes on, jobs are skipped or caught up as each lane says. For
    /// real boards.
    Fixed,
    /// The whole schedule slips by the stall, for every lane alike; no job is skipped, and none
    /// begins before the values that are due at its release have been sent: the world is simulated
    /// and can wait. Such a run carries the same bits as one in virtual time. Misses are counted
    /// all the same, and the slip is reported.
    Slip,
}

/// How a live run is to be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunOptions {
    /// Jobs released before this instant are run.
    pub until: Nanos,
    /// The consequence of missing rights.
    pub contract: Contract,
    /// The effect of a stall on logical time.
    pub pace: Pace,
}

/// How a live run went, besides what each lane counted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunReport {
    /// What the kernel granted.
    pub attestation: Attestation,
    /// By how much the schedule slipped in all; zero at a fixed pace.
    pub slipped: Nanos,
    /// Where jobs panicked, the first place of each lane.
    pub panics: Vec<String>,
}

/// Why a live run did not take place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LiveError {
    /// A task refused to start.
    TaskRefused(String, FaultCode),
    /// Something that the contract demands is missing.
    NotGranted(Box<Attestation>),
    /// The operating system gave no thread.
    NoThread(String),
    /// A task did not return for longer than its lane may stand still; it has returned since.
    Hung(Hang),
}

/// A task that does not return.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hang {
    /// The lane whose thread it holds.
    pub lane: String,
    /// The task.
    pub task: String,
}

impl core::fmt::Display for Hang {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "task `{}` in lane {} does not return", self.task, self.lane)
    }
}

impl core::fmt::Display for LiveError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            LiveError::TaskRefused(task, fault) => {
                write!(f, "task `{task}` refused to start: {}", fault.text())
            }
            LiveError::NotGranted(attestation) => {
                write!(f, "the contract does not hold, no output was armed")?;
                attestation.refused().try_for_each(|short| write!(f, "\n  {short}"))
            }
            LiveError::NoThread(why) => write!(f, "no thread for a lane: {why}"),
            LiveError::Hung(hang) => hang.fmt(f),
        }
    }
}

impl std::error::Error for LiveError {}

/// An observer that is also told how a live run goes, on the carrying thread.
pub trait RunObserver: Observer {
    /// Called before the first job with what the kernel granted.
    fn on_attestation(&mut self, _attestation: &Attestation) {}

    /// The run's time is 0 at `origin` of the kernel's monotonic clock; called before the first
    /// job, and again whenever that has changed: when somebody was too slow to hear of it in time,
    /// and when the lock to the clock of a board has moved it.
    fn on_epoch(&mut self, _origin: Nanos) {}

    /// Called every few milliseconds with the logical time.
    fn on_time(&mut self, _now: Nanos) {}

    /// A task does not return. The other lanes have been stopped, their outputs made safe, and all
    /// their records carried; those of the lane that hangs end safe by their driver's longest
    /// silence. A thread cannot be ended from outside, so the run waits for the task: who cannot
    /// wait ends the process here.
    fn on_hang(&mut self, _hang: &Hang) {}
}

/// What the lanes' threads share with the carrying thread.
struct Shared<'a> {
    stop: &'a AtomicBool,
    /// Whether a hypervisor may take the processor, which explains some misses.
    virtual_machine: bool,
    /// Threads that have asked the kernel for everything.
    ready: ArrivalCount,
    start: StartGate,
    /// Threads that have ended.
    ended: ArrivalCount,
    /// Wall time minus logical time that stalls have cost so far, ns.
    slip: Slip,
    /// Wall time minus logical time that the lock to the clock of a board asks for, ns.
    pace: PaceOffset,
    /// Storms of misses in any lane, of which every lane hears.
    storms: StormCount,
    /// Which lane has finished which job.
    progress: JobProgress,
    /// The threads that the lanes watch: the carrying one, and those that the process named.
    heartbeats: &'a [WatchedHeartbeat],
}

impl Shared<'_> {
    /// Wall time minus logical time.
    fn offset(&self) -> Nanos {
        Nanos(self.slip.ns() + self.pace.ns())
    }

    /// Whether no lane will run another job.
    fn is_over(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.start.signal() == StartSignal::Abandon
    }
}

/// The answer of a lane's thread before the first job: what it was not granted, and what it runs
/// with.
type GrantAnswer = OnceLock<(Vec<Shortfall>, LaneGrant)>;

/// Runs the machine on the kernel's clock until the options say so or until `stop` is set.
///
/// # Errors
/// A task that refuses to start, a hard contract that is not met, no threads.
pub fn run(
    machine: &mut Machine,
    options: RunOptions,
    stop: &AtomicBool,
    observer: &mut dyn RunObserver,
) -> Result<RunReport, LiveError> {
    machine.start().map_err(|(task, fault)| LiveError::TaskRefused(task, fault))?;
    panic_hook::install();
    let (preempt_rt, virtual_machine) = kernel();
    let mut attestation = Attestation { preempt_rt, virtual_machine, ..Attestation::default() };
    let asked = Vec::from_iter(lock_memory().err().map(|why| Shortfall::new(Item::Memory, why)));
    let awake = CpuLatencyRequest::hold();
    attestation.facts.dma_latency_held = awake.is_some();
    let outcome = run_threads(machine, options, stop, observer, (&mut attestation, asked));
    drop(awake);
    unlock_memory();
    machine.stop();
    let panics = machine.panics().map(str::to_owned).collect();
    outcome.map(|slipped| RunReport { attestation, slipped, panics })
}

fn run_threads(
    machine: &mut Machine,
    options: RunOptions,
    stop: &AtomicBool,
    observer: &mut dyn RunObserver,
    (attestation, asked): (&mut Attestation, Vec<Shortfall>),
) -> Result<Nanos, LiveError> {
    let count = machine.lanes.len();
    let (carrier, watched) = WatchedHeartbeat::new(CARRIER_SILENCE_MAX);
    let heartbeats: Vec<_> = machine.heartbeats.iter().cloned().chain([watched]).collect();
    let shared = Shared {
        stop,
        virtual_machine: attestation.virtual_machine,
        ready: ArrivalCount::new(),
        start: StartGate::new(),
        ended: ArrivalCount::new(),
        slip: Slip::new(),
        pace: PaceOffset::new(),
        storms: StormCount::new(),
        progress: JobProgress::new(machine.lanes.iter().map(|lane| &lane.plan.spec), options.until),
        heartbeats: &heartbeats,
    };
    // What was run before this run is done.
    for (index, lane) in machine.lanes.iter().enumerate() {
        shared.progress.set_finished(index, lane.account.next_tick);
    }
    let hangs = HangDetector::new(&machine.lanes, options.pace);
    let shortest = machine.lanes.iter().map(|lane| hang_limit(&lane.plan.spec, options.pace)).min();
    let (lanes, readers) = (&mut machine.lanes, &mut machine.readers);
    let clock = OnceLock::new();
    let answers: Vec<GrantAnswer> = (0..count).map(|_| GrantAnswer::new()).collect();
    thread::scope(|scope| {
        let _ends = EndOnUnwind(&shared.start);
        for (index, (lane, answer)) in lanes.iter_mut().zip(&answers).enumerate() {
            let (shared, clock) = (&shared, &clock);
            let builder =
                thread::Builder::new().name(lane.plan.spec.name.clone()).stack_size(STACK_BYTES);
            let body = move || lane_thread((index, lane), options, shared, clock, answer);
            if let Err(why) = builder.spawn_scoped(scope, body) {
                shared.start.set(StartSignal::Abandon);
                return Err(LiveError::NoThread(why.to_string()));
            }
        }
        while shared.ready.count() < count {
            thread::sleep(CARRY_PAUSE);
        }
        let granted = answers.iter().filter_map(|answer| answer.get().cloned());
        complete_attestation(attestation, asked, granted, &options.contract.demands());
        if attestation.refused().next().is_some() {
            shared.start.set(StartSignal::Abandon);
            return Err(LiveError::NotGranted(Box::new(attestation.clone())));
        }
        observer.on_attestation(attestation);
        // After the attestation, which tells the limit as it was found.
        let _limit = shortest.map(RealTimeLimit::hold);
        let epoch = *clock.get_or_init(|| announced_epoch(observer));
        shared.start.set(StartSignal::Go);
        carry_records(&shared, (readers, observer), &epoch, (hangs, &carrier))?;
        Ok(Nanos(shared.slip.ns()))
    })
}

/// A clock whose zero is near, and of which the observer has heard with half of the lead left: this
/// thread may be kept off the processor while it tells, and jobs that are due before the lanes are
/// let go would be missed.
fn announced_epoch(observer: &mut dyn RunObserver) -> MonotonicClock {
    let mut epoch = MonotonicClock::starting_in(START_LEAD);
    observer.on_epoch(epoch.origin());
    for _ in 1..ANNOUNCEMENTS_MAX {
        if epoch.now() <= Nanos::ZERO - Nanos(START_LEAD.0 / 2) {
            break;
        }
        epoch = MonotonicClock::starting_in(START_LEAD);
        observer.on_epoch(epoch.origin());
    }
    epoch
}

/// Carries records to the observer until all lanes have ended.
fn carry_records(
    shared: &Shared<'_>,
    (readers, observer): (&mut [RecordReader], &mut dyn RunObserver),
    epoch: &MonotonicClock,
    (mut hangs, carrier): (HangDetector, &Heartbeat),
) -> Result<(), LiveError> {
    let (count, mut pace) = (readers.len(), 0);
    while shared.ended.count() < count {
        for reader in &mut *readers {
            reader.drain_at_most(RECORDS_PER_LOOK_MAX, observer);
        }
        if core::mem::replace(&mut pace, shared.pace.ns()) != pace {
            observer.on_epoch(epoch.origin() + Nanos(pace));
        }
        let now = epoch.now();
        observer.on_time(now - shared.offset());
        hangs.check(now, shared, observer);
        carrier.beat();
        thread::sleep(CARRY_PAUSE);
    }
    for reader in readers {
        reader.drain(observer);
    }
    hangs.found.map_or(Ok(()), |hang| Err(LiveError::Hung(hang)))
}

/// The time after which a task of a lane is taken to hang.
fn hang_limit(spec: &LaneSpec, pace: Pace) -> Nanos {
    let least = if pace == Pace::Fixed { HANG_MIN } else { HANG_MIN_SLIP };
    (spec.silent_after * 2).max(least)
}

/// Ends the lanes when the carrying thread unwinds: whoever observes may panic, and the arm is not
/// to go on without anybody who carries its records.
struct EndOnUnwind<'a>(&'a StartGate);

impl Drop for EndOnUnwind<'_> {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.set(StartSignal::Abandon);
        }
    }
}

/// Finds tasks that do not return, on the carrying thread.
struct HangDetector {
    monitor: ProgressMonitor,
    /// Name, tasks and pulse of each lane.
    lanes: Vec<(String, Vec<String>, Arc<LaneActivity>)>,
    found: Option<Hang>,
    grace: u32,
}

impl HangDetector {
    fn new(lanes: &[Lane], pace: Pace) -> HangDetector {
        let limit = |lane: &Lane| Some(hang_limit(&lane.plan.spec, pace));
        let about = |lane: &Lane| {
            lane.activity.reset();
            let tasks = lane.tasks.iter().map(|seat| seat.name.clone()).collect();
            (lane.plan.spec.name.clone(), tasks, Arc::clone(&lane.activity))
        };
        let step = Nanos::from_micros(i64::try_from(CARRY_PAUSE.as_micros()).unwrap_or(1));
        HangDetector {
            monitor: ProgressMonitor::new(step, lanes.iter().map(limit)),
            lanes: lanes.iter().map(about).collect(),
            found: None,
            grace: HANG_GRACE_LOOKS,
        }
    }

    /// Looks for a task that hangs; stops the other lanes when it finds one, and tells the observer
    /// once they have ended.
    fn check(&mut self, now: Nanos, shared: &Shared<'_>, observer: &mut dyn RunObserver) {
        if let Some(hang) = &self.found {
            self.grace = self.grace.saturating_sub(1);
            if self.grace == 1 {
                observer.on_hang(hang);
            }
            return;
        }
        // A lane between two jobs is late or waits, which the others see; it does not hang.
        let busy = |lane: usize| {
            self.lanes[lane].2.running_task().and_then(|_| shared.progress.jobs_done(lane))
        };
        let silent = self.monitor.silent_lanes(now, busy);
        let silent = silent.trailing_zeros() as usize;
        let ran_away =
            self.lanes.iter().position(|(.., activity)| activity.runaway_task().is_some());
        let Some((lane, tasks, activity)) = self.lanes.get(ran_away.unwrap_or(silent)) else {
            return;
        };
        let task =
            activity.runaway_task().or(activity.running_task()).and_then(|seat| tasks.get(seat));
        let Some(task) = task else { return };
        self.found = Some(Hang { lane: lane.clone(), task: task.clone() });
        shared.start.set(StartSignal::Abandon);
    }
}

fn lane_thread(
    (index, lane): (usize, &mut Lane),
    options: RunOptions,
    shared: &Shared<'_>,
    clock: &OnceLock<MonotonicClock>,
    answer: &GrantAnswer,
) {
    let granted = request_grant(&lane.plan.spec, lane.plan.reservation);
    // At an ordinary priority spinning only takes time away from everybody else.
    let fixed = granted.1.priority > 0;
    lane.plan.spec.guard =
        lane.plan.spec.guard.filter(|guard| fixed || guard.given == GuardCondition::Always);
    prefault_stack();
    panic_hook::warm_up_unwinding();
    let monitors = LaneMonitors::open(index, lane, shared);
    let _ = answer.set(granted);
    shared.ready.arrive();
    while shared.start.signal() == StartSignal::Wait {
        thread::sleep(CARRY_PAUSE);
    }
    if let (StartSignal::Go, Some(clock)) = (shared.start.signal(), clock.get()) {
        let (activity, limit) =
            (Arc::clone(&lane.activity), hang_limit(&lane.plan.spec, options.pace));
        run_bounded(&activity, clock, limit, || {
            run_lane_loop((index, lane), options, shared, clock, monitors);
        });
    }
    // A simulated world sees the run to its end before the outputs are made safe; a board does not.
    while options.pace == Pace::Slip && !shared.progress.is_complete() && !shared.is_over() {
        thread::sleep(CARRY_PAUSE);
    }
    lane.stop();
    lane.note_panic();
    shared.ended.arrive();
}
