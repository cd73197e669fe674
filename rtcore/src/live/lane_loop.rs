//! The loop of one lane's thread: wait for the release, run the job, account for it, choose the
//! next one. The kernel is not called between a release and the end of its job: its counters are
//! read after the outputs were written, and seldom (`usage.rs`).

use taktil_hal::{Clock, Nanos};

use super::heartbeat::HeartbeatMonitor;
use super::monitor::ProgressMonitor;
use super::usage::{ThreadUsage, UsageSampler};
use super::{Pace, RunOptions, Shared};
use crate::fault::FaultCode;
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
    fn read(release_jitter: Nanos, virtual_machine: bool) -> MissContextReader {
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

/// Runs the jobs of lane number `index` until the options say so or the stop flag is set.
pub(super) fn run_lane_loop(
    (index, lane): (usize, &mut Lane),
    options: RunOptions,
    shared: &Shared<'_>,
    clock: &MonotonicClock,
) {
    let jobs = lane.plan.spec.jobs_before(options.until);
    // Without a guard the margin is bounded by zero, and nothing is learnt.
    let bound = lane.plan.spec.guard.map_or(Nanos::ZERO, |guard| guard.spin_max);
    let mut margin = WakeMargin::new(bound);
    lane.account.figures.guard = lane.plan.spec.guard.map(|_| GuardFigures::default());
    let slip = || Nanos(shared.slip.ns());
    let mut context = MissContextReader::read(lane.plan.release_jitter, shared.virtual_machine);
    let mut overruns = OverrunHandler::new(lane.plan.spec.late, lane.plan.spec.misses);
    let mut notice = Notice::default();
    let mut peers = PeerMonitor {
        progress: shared.progress.peer_monitor(index),
        heartbeats: HeartbeatMonitor::new(shared.heartbeats, lane.plan.spec.period),
        storms: 0,
    };
    let mut usage = UsageSampler::new(ThreadUsage::read());
    let started = clock.now();
    let mut awake_since = None;
    while lane.account.next_tick < jobs {
        let tick = lane.account.next_tick;
        let mut waited = wait(clock, lane.plan.spec.release(tick), margin.get(), slip);
        if options.pace == Pace::Slip {
            let pauses = wait_for_due_values(index, lane.plan.spec.release(tick), shared);
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
        let end = clock.now();
        let missed = count_job(lane, &waited, end);
        if let Some(job) = usage.end_job(&waited, end - begin, missed, ThreadUsage::read) {
            count_miss(lane, &job_measurement(&waited, end, &job), &context.after_miss());
        }
        count_wait(&mut lane.account.figures, &mut margin, &waited, started);
        // Where the world waits no job is left out, and no value may depend on lateness.
        let fixed = options.pace == Pace::Fixed;
        let behind = if fixed { backlog(lane, begin, end) } else { Backlog::default() };
        let (left_out, own_notice) = overruns.end_job(missed, behind);
        lane.account.figures.skipped += left_out;
        let own_storms = overruns.storms() - lane.account.figures.storms;
        lane.account.figures.storms += own_storms;
        lane.account.next_tick += left_out;
        if fixed {
            notice = peers.add_to_notice(shared, end, own_storms, own_notice);
        }
    }
    lane.account.figures.page_faults += usage.page_faults(ThreadUsage::read());
}

/// How far the schedule is ahead of the lane when a job that began at `begin` has ended at `end`.
fn backlog(lane: &Lane, begin: Nanos, end: Nanos) -> Backlog {
    let next = lane.account.next_tick;
    let newest = lane.plan.spec.newest_released(end);
    Backlog {
        superseded: newest.saturating_sub(next),
        served: newest >= next && newest == lane.plan.spec.newest_released(begin),
    }
}

/// The monitor of the other lanes, and of the threads beside them, while a lane runs.
struct PeerMonitor<'a> {
    progress: ProgressMonitor,
    heartbeats: HeartbeatMonitor<'a>,
    /// Storms known so far: the lane's own, and those of others that its tasks have been told of.
    storms: u64,
}

impl PeerMonitor<'_> {
    /// Tells the other lanes of this lane's `own_storms`, and adds to its notice which lanes stand
    /// still at `now`, whether a watched thread does, and whether there was a storm elsewhere: a
    /// supervised lane hears in this way of a storm in a lane that is not supervised, and the whole
    /// robot stops.
    fn add_to_notice(
        &mut self,
        shared: &Shared<'_>,
        now: Nanos,
        own_storms: u64,
        own_notice: Notice,
    ) -> Notice {
        if own_storms > 0 {
            shared.storms.add(own_storms);
            self.storms += own_storms;
        }
        let silent = self.progress.silent_lanes(now, |lane| shared.progress.jobs_done(lane));
        let mut notice = Notice { silent, ..own_notice };
        if silent != 0 {
            notice.faults.insert(FaultCode::LaneSilent);
        }
        if self.heartbeats.is_one_silent(now) {
            notice.faults.insert(FaultCode::MonitorSilent);
        }
        let all = shared.storms.count();
        if core::mem::replace(&mut self.storms, all) != all {
            notice.faults.insert(FaultCode::OverrunStorm);
        }
        notice
    }
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
    figures.execution_ns.saturating_record(u64::try_from((end - begin).0).unwrap_or(0));
    end - release > lane.plan.spec.deadline
}
