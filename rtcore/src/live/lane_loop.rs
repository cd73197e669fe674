//! The loop of one lane's thread: wait for the release, run the job, account for it, choose the
//! next one. The kernel is not called between a release and the end of its job: its counters are
//! read after the outputs were written, and seldom (`usage.rs`).

use taktil_hal::{Clock, Nanos};

use super::peers::{PeerMonitor, backlog};
use super::usage::{ThreadUsage, UsageSampler};
use super::{Pace, RunOptions, Shared};
use crate::figures::Figures;
use crate::lane::Lane;
use crate::linux::{MonotonicClock, Quota, ThreadCounters, throttle_gap};
use crate::misses::{Backlog, JobMeasurement, MissContext, Notice, OverrunHandler, cause};
use crate::release::{GuardFigures, Wait, WakeMargin, wait};

/// Pause of a lane between two looks at what it waits for, when the world is simulated.
const WORLD_PAUSE: std::time::Duration = std::time::Duration::from_micros(50);

/// Reads what may explain a miss besides the job itself; most of it does not change during a run.
struct MissContextReader {
    constant: MissContext,
    quota: Option<Quota>,
}

impl MissContextReader {
    fn open(release_jitter: Nanos, virtual_machine: bool) -> MissContextReader {
        let throttle_gap = throttle_gap();
        let constant =
            MissContext { release_jitter, throttle_gap, quota_used: false, virtual_machine };
        MissContextReader { constant, quota: Quota::open() }
    }

    /// The context of a job that has just missed its deadline; reads the quota's file once.
    fn after_miss(&mut self) -> MissContext {
        let quota_used = self.quota.as_mut().is_some_and(Quota::has_run_out);
        MissContext { quota_used, ..self.constant }
    }
}

/// What a lane's loop looks at besides its jobs: files of the kernel, and the other threads.
pub(super) struct LaneMonitors<'a> {
    context: MissContextReader,
    peers: PeerMonitor<'a>,
}

impl<'a> LaneMonitors<'a> {
    /// Those of lane number `index`. Opening them allocates, and so the caller may have to wait for
    /// a thread of any priority that holds the allocator: no job may be due yet.
    pub(super) fn open(index: usize, lane: &Lane, shared: &Shared<'a>) -> LaneMonitors<'a> {
        let context = MissContextReader::open(lane.plan.release_jitter, shared.virtual_machine);
        let period = lane.plan.spec.period;
        let peers = PeerMonitor::new(index, period, &shared.progress, shared.heartbeats);
        LaneMonitors { context, peers }
    }
}

/// Runs the jobs of lane number `index` until the options say so or the stop flag is set. It
/// neither allocates nor opens anything: the first releases may be near.
pub(super) fn run_lane_loop(
    (index, lane): (usize, &mut Lane),
    options: RunOptions,
    shared: &Shared<'_>,
    clock: &MonotonicClock,
    LaneMonitors { mut context, mut peers }: LaneMonitors<'_>,
) {
    let jobs = lane.plan.spec.jobs_before(options.until);
    // Without a guard the margin is bounded by zero, and nothing is learnt.
    let bound = lane.plan.spec.guard.map_or(Nanos::ZERO, |guard| guard.spin_max);
    let mut margin = WakeMargin::new(bound);
    lane.account.figures.guard = lane.plan.spec.guard.map(|_| GuardFigures::default());
    let mut overruns = OverrunHandler::new(lane.plan.spec.late, lane.plan.spec.misses);
    let mut notice = Notice::default();
    let mut usage = UsageSampler::new(ThreadUsage::read());
    let started = clock.now();
    let mut awake_since = None;
    while lane.account.next_tick < jobs {
        let tick = lane.account.next_tick;
        let due = lane.plan.spec.release(tick);
        let mut waited = wait(clock, due, margin.get(), || shared.offset());
        if options.pace == Pace::Slip {
            let pauses = wait_for_due_values(index, due, shared);
            waited.sleeps += pauses;
            waited.begin = if pauses > 0 { clock.now() } else { waited.begin };
        }
        if let Some(since) = awake_since {
            count_awake(&mut lane.account.figures, &mut usage, waited.entered - since);
        }
        awake_since = Some(waited.begin);
        if shared.is_over() {
            break;
        }
        let begin = waited.begin;
        // The simulated world waits for a lane that begins later than half of its deadline.
        if options.pace == Pace::Slip && (begin - waited.release) * 2 > lane.plan.spec.deadline {
            shared.slip.raise_to((begin - lane.plan.spec.release(tick)).0);
        }
        lane.activity.begin_job(begin);
        lane.job(tick, notice);
        shared.progress.set_finished(index, tick + 1);
        if options.pace == Pace::Fixed && lane.ports.pace.is_some() {
            shared.pace.set(lane.account.pace.0);
        }
        let end = clock.now();
        let missed = count_job(lane, &waited, end);
        if let Some(job) = usage.end_job(&waited, end - begin, missed, ThreadUsage::read) {
            count_miss(lane, &job_measurement(&waited, end, &job), &context.after_miss());
        }
        count_wait(&mut lane.account.figures, &mut margin, &waited, started);
        // Where the world waits no job is left out, and no value may depend on lateness.
        let fixed = options.pace == Pace::Fixed;
        // The schedule of the jobs is logical; the lock to a board moves it on the host's clock.
        let moved = Nanos(shared.pace.ns());
        let behind =
            if fixed { backlog(lane, begin - moved, end - moved) } else { Backlog::default() };
        let (left_out, own_notice) = overruns.end_job(missed, behind);
        lane.account.figures.skipped += left_out;
        let own_storms = overruns.storms() - lane.account.figures.storms;
        lane.account.figures.storms += own_storms;
        lane.account.next_tick += left_out;
        if fixed {
            let (progress, storms) = (&shared.progress, &shared.storms);
            notice = peers.add_to_notice(progress, storms, end - moved, own_storms, own_notice);
        }
    }
    lane.account.figures.page_faults += usage.page_faults(ThreadUsage::read());
}

/// The measurement of one job.
fn job_measurement(waited: &Wait, end: Nanos, job: &ThreadUsage) -> JobMeasurement {
    let ThreadCounters { page_faults, disk_faults, preemptions, waits } = job.counters;
    JobMeasurement {
        late: waited.begin - waited.release,
        took: end - waited.begin,
        cpu: job.cpu,
        page_faults,
        disk_faults,
        preemptions,
        waits,
    }
}

/// Counts a miss by its cause.
fn count_miss(lane: &mut Lane, job: &JobMeasurement, context: &MissContext) {
    lane.account.figures.misses.add(cause(lane.plan.spec.deadline, job, context));
}

/// Counts how long a cycle kept the thread awake.
fn count_awake(figures: &mut Figures, usage: &mut UsageSampler, awake: Nanos) {
    figures.awake_ns.saturating_record(awake.0.unsigned_abs());
    if usage.end_cycle(awake) {
        figures.evidence_ns.saturating_record(awake.0.unsigned_abs());
    }
}

/// Waits until everything due at `release` has been sent; returns how often the thread slept.
fn wait_for_due_values(lane: usize, release: Nanos, shared: &Shared<'_>) -> u32 {
    let mut pauses = 0;
    while !shared.progress.has_due_values(lane, release) && !shared.is_over() {
        std::thread::sleep(WORLD_PAUSE);
        pauses += 1;
    }
    pauses
}

/// Counts what a wait cost, and lets the margin learn from how late the sleep ended.
fn count_wait(figures: &mut Figures, margin: &mut WakeMargin, waited: &Wait, started: Nanos) {
    if let Some(latency) = waited.latency {
        figures.wake_ns.saturating_record(u64::try_from(latency.0).unwrap_or(0));
    }
    let Some(guard) = &mut figures.guard else { return };
    if let Some(latency) = waited.latency {
        margin.learn(latency);
    }
    guard.spun += waited.spun;
    guard.over = waited.begin - started;
    guard.margin = margin.get();
    guard.early += u64::from(waited.begin < waited.release);
}

/// Counts a job that ended at `end`; true when it missed its deadline.
fn count_job(lane: &mut Lane, waited: &Wait, end: Nanos) -> bool {
    let figures = &mut lane.account.figures;
    let (release, begin) = (waited.release, waited.begin);
    let lateness = u64::try_from((begin - release).0).unwrap_or(0);
    figures.lateness_ns.saturating_record(lateness);
    lane.lateness.count(lateness);
    figures.execution_ns.saturating_record(u64::try_from((end - begin).0).unwrap_or(0));
    end - release > lane.plan.spec.deadline
}
