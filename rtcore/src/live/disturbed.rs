//! The executor in virtual time whose jobs begin late and take long as a plan of faults says.
//! Skips, buckets, notices and the monitors of lanes are those of the threads at a fixed pace; only
//! the clock is not the kernel's. A lane that the plan does not name is never late.

use core::sync::atomic::{AtomicBool, Ordering};

use taktil_hal::Nanos;

use super::flags::StormCount;
use super::peers::{PeerMonitor, backlog};
use super::progress::JobProgress;
use crate::fault::FaultCode;
use crate::machine::Machine;
use crate::misses::{Notice, OverrunHandler};
use crate::panic_hook;
use crate::record::Observer;
use crate::timing_faults::{JobTiming, TimingFaults};

/// What the schedule knows of one lane.
struct LaneSchedule<'a> {
    overruns: OverrunHandler,
    peers: PeerMonitor<'a>,
    notice: Notice,
    /// When the job before ended.
    free: Nanos,
    /// The next job: when it begins, and how long it takes.
    next: (Nanos, Nanos),
    storms: u64,
}

impl LaneSchedule<'_> {
    /// Plans the job that is released at `release`.
    fn plan(&mut self, timing: JobTiming, release: Nanos) {
        self.next = ((release + timing.late).max(self.free), timing.took);
    }
}

/// Runs all jobs that begin before `until`, or until `stop` is set. Returns the instant that was
/// reached.
///
/// # Errors
/// A task that refused to start, with its name.
pub(crate) fn run(
    machine: &mut Machine,
    faults: &TimingFaults,
    until: Nanos,
    stop: &AtomicBool,
    observer: &mut dyn Observer,
) -> Result<Nanos, (String, FaultCode)> {
    panic_hook::install();
    machine.start()?;
    let progress = JobProgress::new(machine.lanes.iter().map(|lane| &lane.plan.spec), until);
    let storms = StormCount::new();
    let mut schedules: Vec<LaneSchedule<'_>> = Vec::new();
    for (index, lane) in machine.lanes.iter().enumerate() {
        let spec = &lane.plan.spec;
        let mut schedule = LaneSchedule {
            overruns: OverrunHandler::new(spec.late, spec.misses),
            peers: PeerMonitor::new(index, spec.period, &progress, &[]),
            notice: Notice::default(),
            free: Nanos::ZERO,
            next: (Nanos::ZERO, Nanos::ZERO),
            storms: 0,
        };
        let release = spec.release(lane.account.next_tick);
        schedule.plan(faults.timing(index, release), release);
        schedules.push(schedule);
    }
    let mut now = Nanos::ZERO;
    while !stop.load(Ordering::Relaxed) {
        let begins = schedules.iter().enumerate().map(|(index, lane)| (lane.next.0, index));
        let Some((begin, index)) = begins.min().filter(|(begin, _)| *begin < until) else {
            now = until;
            break;
        };
        now = begin;
        let (lane, schedule) = (&mut machine.lanes[index], &mut schedules[index]);
        let tick = lane.account.next_tick;
        let release = lane.plan.spec.release(tick);
        let took = schedule.next.1;
        lane.job(tick, schedule.notice);
        lane.note_panic();
        machine.readers[index].drain(observer);
        let lane = &mut machine.lanes[index];
        progress.set_finished(index, tick + 1);
        let end = begin + took;
        let missed = end - release > lane.plan.spec.deadline;
        let (left_out, own) = schedule.overruns.end_job(missed, backlog(lane, begin, end));
        let figures = &mut lane.account.figures;
        figures.lateness_ns.saturating_record((begin - release).0.unsigned_abs());
        figures.execution_ns.saturating_record(took.0.unsigned_abs());
        figures.skipped += left_out;
        let own_storms = schedule.overruns.storms() - schedule.storms;
        schedule.storms += own_storms;
        figures.storms += own_storms;
        lane.account.next_tick += left_out;
        schedule.notice = schedule.peers.add_to_notice(&progress, &storms, end, own_storms, own);
        schedule.free = end;
        let release = lane.plan.spec.release(lane.account.next_tick);
        schedule.plan(faults.timing(index, release), release);
    }
    machine.stop();
    Ok(now)
}
