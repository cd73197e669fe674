//! The live executor: one thread a lane, `SCHED_FIFO`, released by absolute sleeps on the monotonic clock. The calling thread stays
//! ordinary and carries records to the observer. Refuses to hide what the kernel did not grant: it is read back per lane.

use core::sync::atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicUsize, Ordering};
use std::sync::OnceLock;
use std::thread;

use taktil_hal::{Clock, Nanos};

use crate::fault::FaultCode;
use crate::lane::Lane;
use crate::linux::{
    MonotonicClock, ThreadCounters, become_fifo, kernel, lock_memory, pin_to, thread_counters,
    thread_cpu_time, touch_stack, unlock_memory,
};
use crate::machine::Machine;
use crate::record::{Drain, Observer};
use crate::schedule::Late;

/// Stack of a lane's thread: all of it is locked in memory.
const STACK_BYTES: usize = 1024 * 1024;
/// From the start of the threads to the release of the first job.
const LEAD: Nanos = Nanos::from_millis(50);
/// Pause of the carrying thread between two looks at the rings.
const CARRY_PAUSE: std::time::Duration = std::time::Duration::from_millis(2);

/// What the kernel granted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Attestation {
    /// What was asked for and not granted, one sentence each.
    pub missing: Vec<String>,
    /// The kernel is built with PREEMPT_RT.
    pub preempt_rt: bool,
    /// It runs in a virtual machine.
    pub virtual_machine: bool,
}

impl Attestation {
    /// Policy, priority, processor and memory are as asked for.
    #[must_use]
    pub fn granted(&self) -> bool {
        self.missing.is_empty()
    }

    /// Timing figures of this run say something about the machine's real-time abilities.
    #[must_use]
    pub fn representative(&self) -> bool {
        self.granted() && self.preempt_rt && !self.virtual_machine
    }
}

/// Whether a run may go on with less than it asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contract {
    /// Anything missing refuses the run before the first job.
    Hard,
    /// Anything missing is reported and every timing figure marked.
    Soft,
}

/// What happens to logical time when a lane is woken later than its deadline leaves room for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Nothing: the world outside goes on, jobs are skipped or caught up as each lane says. For real boards.
    Fixed,
    /// The whole schedule slips by the stall, for every lane alike, and no job is skipped: the world is simulated and can wait.
    /// Misses are counted all the same, and the slip is reported.
    Slip,
}

/// How a live run is to be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Terms {
    /// Jobs released before this instant are run.
    pub until: Nanos,
    /// Whether missing rights refuse the run.
    pub contract: Contract,
    /// What a stall does to logical time.
    pub pace: Pace,
}

/// How a live run went, besides what each lane counted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Account {
    /// What the kernel granted.
    pub attestation: Attestation,
    /// By how much the schedule slipped in all; zero at a fixed pace.
    pub slipped: Nanos,
}

/// Why a live run did not take place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LiveError {
    /// A task refused to start.
    TaskRefused(String, FaultCode),
    /// The contract was hard and this is missing.
    NotGranted(Attestation),
    /// The operating system gave no thread.
    NoThread(String),
}

impl core::fmt::Display for LiveError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            LiveError::TaskRefused(task, fault) => {
                write!(f, "task `{task}` refused to start: {}", fault.text())
            }
            LiveError::NotGranted(attestation) => {
                write!(f, "the kernel did not grant: {}", attestation.missing.join("; "))
            }
            LiveError::NoThread(why) => write!(f, "no thread for a lane: {why}"),
        }
    }
}

impl std::error::Error for LiveError {}

/// Who is told how a live run goes, on the carrying thread.
pub trait Audience: Observer {
    /// What the kernel granted, before the first job.
    fn attested(&mut self, _attestation: &Attestation) {}

    /// The logical time, every few milliseconds.
    fn passed(&mut self, _now: Nanos) {}
}

/// What the lanes' threads share with the carrying thread.
struct Shared<'a> {
    stop: &'a AtomicBool,
    /// Threads that have asked the kernel for everything.
    ready: AtomicUsize,
    /// [`WAIT`], [`GO`] or [`ABANDON`].
    signal: AtomicU8,
    /// Threads that have not ended.
    running: AtomicUsize,
    /// Wall time minus logical time that stalls have cost so far, ns.
    slip: AtomicI64,
}

const WAIT: u8 = 0;
const GO: u8 = 1;
const ABANDON: u8 = 2;

/// Runs the machine on the kernel's clock until the terms say so or until `stop` is set.
///
/// # Errors
/// A task that refuses to start, a hard contract that is not met, no threads.
pub fn run(
    machine: &mut Machine,
    terms: Terms,
    stop: &AtomicBool,
    audience: &mut dyn Audience,
) -> Result<Account, LiveError> {
    machine.start().map_err(|(task, fault)| LiveError::TaskRefused(task, fault))?;
    let (preempt_rt, virtual_machine) = kernel();
    let mut attestation = Attestation { missing: Vec::new(), preempt_rt, virtual_machine };
    if let Err(why) = lock_memory() {
        attestation.missing.push(why);
    }
    let outcome = run_threads(machine, terms, stop, audience, &mut attestation);
    unlock_memory();
    machine.stop();
    outcome.map(|slipped| Account { attestation, slipped })
}

fn run_threads(
    machine: &mut Machine,
    terms: Terms,
    stop: &AtomicBool,
    audience: &mut dyn Audience,
    attestation: &mut Attestation,
) -> Result<Nanos, LiveError> {
    let count = machine.lanes.len();
    let shared = Shared {
        stop,
        ready: AtomicUsize::new(0),
        signal: AtomicU8::new(WAIT),
        running: AtomicUsize::new(count),
        slip: AtomicI64::new(0),
    };
    let (lanes, drains) = (&mut machine.lanes, &mut machine.drains);
    let clock = OnceLock::new();
    let granted: Vec<OnceLock<Vec<String>>> = (0..count).map(|_| OnceLock::new()).collect();
    thread::scope(|scope| {
        for (lane, grant) in lanes.iter_mut().zip(&granted) {
            let (shared, clock) = (&shared, &clock);
            let builder =
                thread::Builder::new().name(lane.spec.name.clone()).stack_size(STACK_BYTES);
            let body = move || lane_thread(lane, terms, shared, clock, grant);
            if let Err(why) = builder.spawn_scoped(scope, body) {
                shared.signal.store(ABANDON, Ordering::Release);
                return Err(LiveError::NoThread(why.to_string()));
            }
        }
        while shared.ready.load(Ordering::Acquire) < count {
            thread::sleep(CARRY_PAUSE);
        }
        attestation.missing.extend(granted.iter().filter_map(OnceLock::get).flatten().cloned());
        if terms.contract == Contract::Hard && !attestation.granted() {
            shared.signal.store(ABANDON, Ordering::Release);
            return Err(LiveError::NotGranted(attestation.clone()));
        }
        audience.attested(attestation);
        let epoch = *clock.get_or_init(|| MonotonicClock::starting_in(LEAD));
        shared.signal.store(GO, Ordering::Release);
        while shared.running.load(Ordering::Acquire) > 0 {
            carry(drains, audience);
            audience.passed(epoch.now() - Nanos(shared.slip.load(Ordering::Relaxed)));
            thread::sleep(CARRY_PAUSE);
        }
        carry(drains, audience);
        Ok(Nanos(shared.slip.load(Ordering::Relaxed)))
    })
}

fn carry(drains: &mut [Drain], observer: &mut dyn Observer) {
    for drain in drains {
        drain.drain(observer);
    }
}

fn lane_thread(
    lane: &mut Lane,
    terms: Terms,
    shared: &Shared<'_>,
    clock: &OnceLock<MonotonicClock>,
    grant: &OnceLock<Vec<String>>,
) {
    let mut missing = Vec::new();
    if let Some(cpu) = lane.spec.cpu {
        missing.extend(pin_to(cpu).err().map(|why| format!("lane {}: {why}", lane.spec.name)));
    }
    missing.extend(
        become_fifo(lane.spec.priority).err().map(|why| format!("lane {}: {why}", lane.spec.name)),
    );
    touch_stack();
    let _ = grant.set(missing);
    shared.ready.fetch_add(1, Ordering::AcqRel);
    while shared.signal.load(Ordering::Acquire) == WAIT {
        thread::sleep(CARRY_PAUSE);
    }
    if let (GO, Some(clock)) = (shared.signal.load(Ordering::Acquire), clock.get()) {
        beat(lane, terms, shared, clock);
    }
    lane.stop();
    shared.running.fetch_sub(1, Ordering::AcqRel);
}

/// The beat itself: sleep to the release, run, account, choose the next job.
fn beat(lane: &mut Lane, terms: Terms, shared: &Shared<'_>, clock: &MonotonicClock) {
    let jobs = lane.spec.jobs_before(terms.until);
    while lane.next_tick < jobs {
        let tick = lane.next_tick;
        let release = sleep_to(lane.spec.release(tick), shared, clock);
        if shared.stop.load(Ordering::Relaxed) {
            break;
        }
        let before = thread_counters();
        let cpu_before = thread_cpu_time();
        let begin = clock.now();
        let lateness = begin - release;
        if terms.pace == Pace::Slip && lateness * 2 > lane.spec.deadline {
            // Every lane that was held up by the same stall finds about the same figure: the largest stands for all.
            shared.slip.fetch_max((begin - lane.spec.release(tick)).0, Ordering::Relaxed);
        }
        lane.job(tick);
        let end = clock.now();
        let cpu = thread_cpu_time() - cpu_before;
        let after = thread_counters();
        account(lane, release, begin, end, cpu, before, after);
        let newest = lane.spec.newest_released(end);
        if terms.pace == Pace::Fixed && lane.spec.late == Late::Skip && newest > lane.next_tick {
            lane.figures.skipped += newest - lane.next_tick;
            lane.next_tick = newest;
        }
    }
}

/// Sleeps to a logical release, also when the schedule slips meanwhile; returns the release on the wall.
fn sleep_to(release: Nanos, shared: &Shared<'_>, clock: &MonotonicClock) -> Nanos {
    loop {
        let wall = release + Nanos(shared.slip.load(Ordering::Relaxed));
        clock.sleep_until(wall);
        if release + Nanos(shared.slip.load(Ordering::Relaxed)) == wall {
            return wall;
        }
    }
}

fn account(
    lane: &mut Lane,
    release: Nanos,
    begin: Nanos,
    end: Nanos,
    cpu: Nanos,
    before: ThreadCounters,
    after: ThreadCounters,
) {
    let deadline = lane.spec.deadline;
    let figures = &mut lane.figures;
    let lateness = begin - release;
    let faults = after.page_faults - before.page_faults;
    figures.lateness_ns.saturating_record(u64::try_from(lateness.0).unwrap_or(0));
    figures.execution_ns.saturating_record(u64::try_from((end - begin).0).unwrap_or(0));
    figures.page_faults += faults;
    if end - release <= deadline {
        return;
    }
    let misses = &mut figures.misses;
    // In order of how much each can explain: had the wake been on time, would the job have made it?
    if end - begin <= deadline {
        misses.late_wake += 1;
    } else if cpu > deadline {
        misses.overrun += 1;
    } else if faults > 0 {
        misses.page_fault += 1;
    } else if after.preemptions > before.preemptions {
        misses.preempted += 1;
    } else if after.waits > before.waits {
        misses.blocked += 1;
    } else {
        // The thread never left its processor, and yet time passed: the host or throttling took it.
        misses.throttled += 1;
    }
}
