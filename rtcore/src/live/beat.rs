//! The beat of one lane's thread: wait for the release, run the job, account for it, choose the
//! next. Refuses to call the kernel between a release and the end of its job: evidence is read
//! after the outputs are out, and seldom (`evidence.rs`).

use taktil_hal::{Clock, Nanos};

use super::evidence::{Evidence, Reading};
use super::watch::Watch;
use super::{Pace, Shared, Terms};
use crate::fault::FaultCode;
use crate::lane::{Figures, Lane};
use crate::linux::{MonotonicClock, Quota, ThreadCounters, throttle_gap};
use crate::misses::{Behind, Discipline, Ground, Notice, Trace, cause};
use crate::release::{GuardFigures, Margin, Wait, wait};

/// Pause of a lane between two looks at what it waits for, when the world is simulated.
const WORLD_PAUSE: std::time::Duration = std::time::Duration::from_micros(50);

/// What explains a miss and does not change from job to job.
struct Circumstances {
    ground: Ground,
    quota: Option<Quota>,
}

impl Circumstances {
    fn read(release_jitter: Nanos, virtual_machine: bool) -> Circumstances {
        let throttle_gap = throttle_gap();
        let ground = Ground { release_jitter, throttle_gap, quota_used: false, virtual_machine };
        Circumstances { ground, quota: Quota::watch() }
    }

    /// Asked only after a miss: one more read.
    fn now(&mut self) -> Ground {
        let quota_used = self.quota.as_mut().is_some_and(Quota::ran_out);
        Ground { quota_used, ..self.ground }
    }
}

/// Runs the lane's jobs until the terms say so or the stop flag is set.
pub(super) fn beat(
    (index, lane): (usize, &mut Lane),
    terms: Terms,
    shared: &Shared<'_>,
    clock: &MonotonicClock,
) {
    let jobs = lane.spec.jobs_before(terms.until);
    // Without a guard the margin is bounded by zero, and nothing is learnt.
    let bound = lane.spec.guard.map_or(Nanos::ZERO, |guard| guard.spin_max);
    let mut margin = Margin::new(bound);
    lane.figures.guard = lane.spec.guard.map(|_| GuardFigures::default());
    let slip = || Nanos(shared.slip.ns());
    let mut circumstances = Circumstances::read(lane.release_jitter, shared.virtual_machine);
    let mut discipline = Discipline::new(lane.spec.late, lane.spec.misses);
    let mut notice = Notice::default();
    let mut ears = Ears { watch: shared.ledger.watch(index), storms: 0 };
    let mut evidence = Evidence::new(Reading::take());
    let started = clock.now();
    let mut awake_since = None;
    while lane.next_tick < jobs {
        let tick = lane.next_tick;
        let mut waited = wait(clock, lane.spec.release(tick), margin.get(), slip);
        if terms.pace == Pace::Slip {
            let pauses = await_due(index, lane.spec.release(tick), shared);
            waited.sleeps += pauses;
            waited.begin = if pauses > 0 { clock.now() } else { waited.begin };
        }
        if let Some(since) = awake_since {
            let awake = waited.entered - since;
            lane.figures.awake_ns.saturating_record(awake.0.unsigned_abs());
            if evidence.cycle(awake) {
                lane.figures.evidence_ns.saturating_record(awake.0.unsigned_abs());
            }
        }
        awake_since = Some(waited.begin);
        if shared.over() {
            break;
        }
        let begin = waited.begin;
        if terms.pace == Pace::Slip && (begin - waited.release) * 2 > lane.spec.deadline {
            shared.slip.reach((begin - lane.spec.release(tick)).0);
        }
        lane.pulse.begin(begin);
        lane.job(tick, notice);
        shared.ledger.finished(index, tick + 1);
        let end = clock.now();
        let missed = account(lane, &waited, end);
        if let Some(job) = evidence.job(&waited, end - begin, missed, Reading::take) {
            explain(lane, (begin - waited.release, end - begin), job, &circumstances.now());
        }
        note_wait(&mut lane.figures, &mut margin, &waited, started);
        // Where the world waits nothing is left out, and no value may depend on lateness.
        let fixed = terms.pace == Pace::Fixed;
        let newest = if fixed { lane.spec.newest_released(end) } else { 0 };
        let behind = Behind {
            superseded: newest.saturating_sub(lane.next_tick),
            served: newest >= lane.next_tick && newest == lane.spec.newest_released(begin),
        };
        let (left_out, said) = discipline.after(missed, behind);
        lane.figures.skipped += left_out;
        let own = discipline.storms() - lane.figures.storms;
        lane.figures.storms += own;
        lane.next_tick += left_out;
        if fixed {
            notice = ears.hear(shared, end, own, said);
        }
    }
    lane.figures.page_faults += evidence.page_faults(Reading::take());
}

/// What a lane hears of the others while it runs.
struct Ears {
    watch: Watch,
    /// Storms known so far: the lane's own, and those of others that its tasks have been told of.
    storms: u64,
}

impl Ears {
    /// Tells the others of this lane's `own` storms, and adds to what was `said` which lanes stand
    /// still at `now` and whether there was a storm elsewhere: a lane that is supervised hears of
    /// one in a lane that is not, and the whole robot stops.
    fn hear(&mut self, shared: &Shared<'_>, now: Nanos, own: u64, said: Notice) -> Notice {
        if own > 0 {
            shared.storms.add(own);
            self.storms += own;
        }
        let silent = self.watch.look(now, |lane| shared.ledger.progress(lane));
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
fn explain(lane: &mut Lane, (late, took): (Nanos, Nanos), job: Reading, ground: &Ground) {
    let ThreadCounters { page_faults, disk_faults, preemptions, waits } = job.counters;
    let trace = Trace { late, took, cpu: job.cpu, page_faults, disk_faults, preemptions, waits };
    lane.figures.misses.add(cause(lane.spec.deadline, &trace, ground));
}

/// Waits until everything due at `release` has been sent; says how many pauses that took.
fn await_due(lane: usize, release: Nanos, shared: &Shared<'_>) -> u32 {
    let mut pauses = 0;
    while !shared.ledger.due_is_done(lane, release) && !shared.over() {
        std::thread::sleep(WORLD_PAUSE);
        pauses += 1;
    }
    pauses
}

/// Learns from a wait and counts what it cost.
fn note_wait(figures: &mut Figures, margin: &mut Margin, waited: &Wait, started: Nanos) {
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
fn account(lane: &mut Lane, waited: &Wait, end: Nanos) -> bool {
    let figures = &mut lane.figures;
    let (release, begin) = (waited.release, waited.begin);
    let lateness = u64::try_from((begin - release).0).unwrap_or(0);
    figures.lateness_ns.saturating_record(lateness);
    figures.execution_ns.saturating_record(u64::try_from((end - begin).0).unwrap_or(0));
    end - release > lane.spec.deadline
}
