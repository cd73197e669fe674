//! The executor in virtual time whose jobs begin late and take long as a host does it: by a plan of
//! faults, or by whoever simulates the host. Skips, buckets, notices, the monitors of lanes and the
//! pace by the clock of a board are those of the threads at a fixed pace; only the clock is not the
//! kernel's.

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
use crate::timing_faults::{JobTiming, VirtualHost};

/// What the schedule knows of one lane.
struct LaneSchedule<'a> {
    overruns: OverrunHandler,
    peers: PeerMonitor<'a>,
    notice: Notice,
    /// When the job before ended.
    free: Nanos,
    /// The next job: its release, and how the host times it.
    release: Nanos,
    next: JobTiming,
    storms: u64,
}

impl LaneSchedule<'_> {
    /// Plans the job that is released at `release`.
    fn plan(&mut self, timing: JobTiming, release: Nanos) {
        (self.release, self.next) = (release, timing);
    }

    /// When the next job begins on the host's clock, if releases are `moved` on it.
    fn begin(&self, moved: Nanos) -> Nanos {
        (self.release + moved + self.next.late).max(self.free)
    }
}

/// Runs all jobs that begin before `until` in logical time, or until `stop` is set. Returns the
/// instant that was reached.
///
/// # Errors
/// A task that refused to start, with its name.
pub(crate) fn run(
    machine: &mut Machine,
    host: &mut dyn VirtualHost,
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
            free: Nanos(i64::MIN),
            release: Nanos::ZERO,
            next: JobTiming::default(),
            storms: 0,
        };
        let release = spec.release(lane.account.next_tick);
        schedule.plan(host.timing(index, release), release);
        schedules.push(schedule);
    }
    let (mut now, mut moved) = (Nanos::ZERO, Nanos::ZERO);
    while !stop.load(Ordering::Relaxed) {
        let begins = schedules.iter().enumerate().map(|(index, lane)| (lane.begin(moved), index));
        let Some((begin, index)) = begins.min().filter(|(begin, _)| *begin - moved < until) else {
            now = until;
            break;
        };
        now = begin - moved;
        host.begin(begin);
        let (lane, schedule) = (&mut machine.lanes[index], &mut schedules[index]);
        let tick = lane.account.next_tick;
        let release = lane.plan.spec.release(tick);
        let took = schedule.next.took;
        lane.job(tick, schedule.notice);
        lane.note_panic();
        machine.readers[index].drain(observer);
        let lane = &mut machine.lanes[index];
        progress.set_finished(index, tick + 1);
        if lane.ports.pace.is_some() {
            moved = lane.account.pace;
        }
        // The schedule of the jobs is logical.
        let (begin, end) = (now, begin + took - moved);
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
        schedule.free = end + moved;
        let release = lane.plan.spec.release(lane.account.next_tick);
        schedule.plan(host.timing(index, release), release);
    }
    machine.stop();
    Ok(now)
}
