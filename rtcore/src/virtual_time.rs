//! The executor in virtual time: every lane on the calling thread, each job at its release, nobody
//! waits. The order of jobs released at the same instant does not matter to any value, because
//! values cross lanes only later. A panic inside a job is as silent as on a lane's own thread. No
//! job is skipped, and page faults, which matter in a live lane only, are not counted.

use core::cell::Cell;
use core::sync::atomic::{AtomicBool, Ordering};

use taktil_hal::{Clock, Nanos};

use crate::fault::FaultCode;
use crate::linux::monotonic;
use crate::live::disturbed;
use crate::machine::Machine;
use crate::misses::Notice;
use crate::panic_hook;
use crate::record::Observer;
pub use crate::timing_faults::{JobTiming, VirtualHost};

/// A clock that shows the last instant somebody slept until; it never runs backwards.
#[derive(Debug, Default)]
pub struct VirtualClock {
    now: Cell<Nanos>,
}

impl Clock for VirtualClock {
    fn now(&self) -> Nanos {
        self.now.get()
    }

    fn sleep_until(&self, instant: Nanos) {
        self.now.set(self.now.get().max(instant));
    }
}

/// Runs all jobs released before `until`, or until `stop` is set. Records reach `observer` after
/// each job, so none is lost. With faults of lanes in the machine ([`Machine::inject`]) its jobs
/// are as late as these say, and the schedule treats them as on threads at a fixed pace. Returns
/// the instant that was reached.
///
/// # Errors
/// A task that refused to start, with its name.
pub fn run(
    machine: &mut Machine,
    until: Nanos,
    stop: &AtomicBool,
    observer: &mut dyn Observer,
) -> Result<Nanos, (String, FaultCode)> {
    if !machine.timing_faults.is_empty() {
        let mut faults = machine.timing_faults.clone();
        return disturbed::run(machine, &mut faults, until, stop, observer);
    }
    run_chosen(machine, until, stop, observer, |machine| {
        // Few lanes: a scan beats a heap.
        let lanes = machine.lanes.iter().enumerate();
        lanes.map(|(index, lane)| (lane.plan.spec.release(lane.account.next_tick), index)).min()
    })
}

/// As [`run`], on a simulated host: its jobs are as late as the host says, the schedule treats them
/// as on threads at a fixed pace, and the clock of a board moves their releases as it does there.
///
/// # Errors
/// A task that refused to start, with its name.
pub fn run_on_host(
    machine: &mut Machine,
    host: &mut dyn VirtualHost,
    until: Nanos,
    stop: &AtomicBool,
    observer: &mut dyn Observer,
) -> Result<Nanos, (String, FaultCode)> {
    disturbed::run(machine, host, until, stop, observer)
}

/// As [`run`], with the next job chosen by `choose`: its release and its lane, whose `next_tick` is
/// the job's.
pub(crate) fn run_chosen(
    machine: &mut Machine,
    until: Nanos,
    stop: &AtomicBool,
    observer: &mut dyn Observer,
    mut choose: impl FnMut(&mut Machine) -> Option<(Nanos, usize)>,
) -> Result<Nanos, (String, FaultCode)> {
    panic_hook::install();
    machine.start()?;
    let clock = VirtualClock::default();
    while !stop.load(Ordering::Relaxed) {
        let Some((release, index)) = choose(machine).filter(|(release, _)| *release < until) else {
            clock.sleep_until(until);
            break;
        };
        clock.sleep_until(release);
        let lane = &mut machine.lanes[index];
        let begin = monotonic();
        lane.job(lane.account.next_tick, Notice::default());
        let took = monotonic() - begin;
        lane.note_panic();
        lane.account.figures.lateness_ns.saturating_record(0);
        lane.account.figures.execution_ns.saturating_record(took.0.unsigned_abs());
        machine.readers[index].drain(observer);
    }
    machine.stop();
    Ok(clock.now())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_advances_only_during_sleep_and_never_backwards() {
        let clock = VirtualClock::default();
        assert_eq!(clock.now(), Nanos::ZERO);
        clock.sleep_until(Nanos(7));
        clock.sleep_until(Nanos(3));
        assert_eq!(clock.now(), Nanos(7));
    }
}
