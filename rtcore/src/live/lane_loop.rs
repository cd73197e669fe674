//! The beat of one lane's thread: wait for the release, run the job, account for it, choose the
//! next. Refuses to call the kernel between a release and the end of its job: evidence is read
//! after the outputs are out, and seldom (`usage.rs`).

use taktil_hal::{Clock, Nanos};

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

/// What explains a miss and does not change from job to job.
struct MissContextReader {
    ground: MissContext,
    quota: Option<Quota>,
}

impl MissContextReader {
    fn read(release_jitter: Nanos, virtual_machine: bool) -> MissContextReader {
        let throttle_gap = throttle_gap();
        let ground =
            MissContext { release_jitter, throttle_gap, quota_used: false, virtual_machine };
        MissContextReader { ground, quota: Quota::open() }
    }

    /// Asked only after a miss: one more read.
    fn after_miss(&mut self) -> MissContext {
        let quota_used = self.quota.as_mut().is_some_and(Quota::has_run_out);
        MissContext { quota_used, ..self.ground }
    }
}

/// Runs the lane's jobs until the terms say so or the stop flag is set.
pub(super) fn run_lane_loop(
    (index, lane): (usize, &mut Lane),
    terms: RunOptions,
    shared: &Shared<'_>,
    clock: &MonotonicClock,
) {
    let jobs = lane.plan.spec.jobs_before(terms.until);
    // Without a guard the margin is bounded by zero, and nothing is learnt.
    let bound = lane.plan.spec.guard.map_or(Nanos::ZERO, |guard| guard.spin_max);
    let mut margin = WakeMargin::new(bound);
    lane.account.figures.guard = lane.plan.spec.guard.map(|_| GuardFigures::default());
    let slip = || Nanos(shared.slip.ns());
    let mut miss_context =
        MissContextReader::read(lane.plan.release_jitter, shared.virtual_machine);
    let mut overruns = OverrunHandler::new(lane.plan.spec.late, lane.plan.spec.misses);
    let mut notice = Notice::default();
    let mut peers = PeerMonitor { monitor: shared.progress.peer_monitor(index), storms: 0 };
    let mut usage = UsageSampler::new(ThreadUsage::read());
    let started = clock.now();
    let mut awake_since = None;
    while lane.account.next_tick < jobs {
        let tick = lane.account.next_tick;
        let mut waited = wait(clock, lane.plan.spec.release(tick), margin.get(), slip);
        if terms.pace == Pace::Slip {
            let pauses = wait_for_due_values(index, lane.plan.spec.release(tick), shared);
            waited.sleeps += pauses;
            waited.begin = if pauses > 0 { clock.now() } else { waited.begin };
        }
        if let Some(since) = awake_since {
            let awake = waited.entered - since;
            lane.account.figures.awake_ns.saturating_record(awake.0.unsigned_abs());
            if usage.cycle(awake) {
                lane.account.figures.evidence_ns.saturating_record(awake.0.unsigned_abs());
            }
        }
        awake_since = Some(waited.begin);
        if shared.is_over() {
            break;
        }
        let begin = waited.begin;
        if terms.pace == Pace::Slip && (begin - waited.release) * 2 > lane.plan.spec.deadline {
            shared.slip.raise_to((begin - lane.plan.spec.release(tick)).0);
        }
        lane.activity.begin_job(begin);
        lane.job(tick, notice);
        shared.progress.set_finished(index, tick + 1);
        let end = clock.now();
        let missed = count_job(lane, &waited, end);
        if let Some(job) = usage.job(&waited, end - begin, missed, ThreadUsage::read) {
            count_miss(
                lane,
                (begin - waited.release, end - begin),
                job,
                &miss_context.after_miss(),
            );
        }
        count_wait(&mut lane.account.figures, &mut margin, &waited, started);
        // Where the world waits nothing is left out, and no value may depend on lateness.
        let fixed = terms.pace == Pace::Fixed;
        let newest = if fixed { lane.plan.spec.newest_released(end) } else { 0 };
        let behind = Backlog {
            superseded: newest.saturating_sub(lane.account.next_tick),
            served: newest >= lane.account.next_tick
                && newest == lane.plan.spec.newest_released(begin),
        };
        let (left_out, said) = overruns.end_job(missed, behind);
        lane.account.figures.skipped += left_out;
        let own = overruns.storms() - lane.account.figures.storms;
        lane.account.figures.storms += own;
        lane.account.next_tick += left_out;
        if fixed {
            notice = peers.notice_of_peers(shared, end, own, said);
        }
    }
    lane.account.figures.page_faults += usage.page_faults(ThreadUsage::read());
}

/// What a lane hears of the others while it runs.
struct PeerMonitor {
    monitor: ProgressMonitor,
    /// Storms known so far: the lane's own, and those of others that its tasks have been told of.
    storms: u64,
}

impl PeerMonitor {
    /// Tells the others of this lane's `own` storms, and adds to what was `said` which lanes stand
    /// still at `now` and whether there was a storm elsewhere: a lane that is supervised hears of
    /// one in a lane that is not, and the whole robot stops.
    fn notice_of_peers(
        &mut self,
        shared: &Shared<'_>,
        now: Nanos,
        own: u64,
        said: Notice,
    ) -> Notice {
        if own > 0 {
            shared.storms.add(own);
            self.storms += own;
        }
        let silent = self.monitor.silent_lanes(now, |lane| shared.progress.jobs_done(lane));
        let mut notice = Notice { silent, ..said };
        if silent != 0 {
            notice.faults.insert(FaultCode::LaneSilent);
        }
        let all = shared.storms.count();
        if core::mem::replace(&mut self.storms, all) != all {
            notice.faults.insert(FaultCode::OverrunStorm);
        }
        notice
    }
}

/// Counts a miss by its cause; a job began so late and took so long.
fn count_miss(
    lane: &mut Lane,
    (late, took): (Nanos, Nanos),
    job: ThreadUsage,
    ground: &MissContext,
) {
    let ThreadCounters { page_faults, disk_faults, preemptions, waits } = job.counters;
    let trace =
        JobMeasurement { late, took, cpu: job.cpu, page_faults, disk_faults, preemptions, waits };
    lane.account.figures.misses.add(cause(lane.plan.spec.deadline, &trace, ground));
}

/// Waits until everything due at `release` has been sent; says how many pauses that took.
fn wait_for_due_values(lane: usize, release: Nanos, shared: &Shared<'_>) -> u32 {
    let mut pauses = 0;
    while !shared.progress.has_due_values(lane, release) && !shared.is_over() {
        std::thread::sleep(WORLD_PAUSE);
        pauses += 1;
    }
    pauses
}

/// Learns from a wait and counts what it cost.
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

/// Counts a job; true when it missed its deadline.
fn count_job(lane: &mut Lane, waited: &Wait, end: Nanos) -> bool {
    let figures = &mut lane.account.figures;
    let (release, begin) = (waited.release, waited.begin);
    let lateness = u64::try_from((begin - release).0).unwrap_or(0);
    figures.lateness_ns.saturating_record(lateness);
    figures.execution_ns.saturating_record(u64::try_from((end - begin).0).unwrap_or(0));
    end - release > lane.plan.spec.deadline
}
