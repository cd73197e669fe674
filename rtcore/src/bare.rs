//! Runs jobs of one lane back to back, without release, wait or clock, for benchmarks and
//! instruction counters. It is no executor: values cross lanes only as far as the caller runs both
//! lanes, and nothing is accounted for.

use crate::fault::FaultCode;
use crate::machine::Machine;
use crate::misses::Notice;
use crate::record::Observer;

/// Starts every task, as an executor does before the first job.
///
/// # Errors
/// The first task that refused to start, with its name and its fault.
pub fn start(machine: &mut Machine) -> Result<(), (String, FaultCode)> {
    machine.start()
}

/// Runs the next `jobs` jobs of lane number `lane`, in the order in which lanes were added; without
/// such a lane nothing. The lane's ring holds the records of half a second at least: drain it
/// before.
// Never inlined: an instruction counter is switched on and off by this name.
#[inline(never)]
pub fn jobs(machine: &mut Machine, lane: usize, jobs: u64) {
    let Some(lane) = machine.lanes.get_mut(lane) else { return };
    for _ in 0..jobs {
        lane.job(lane.account.next_tick, Notice::default());
    }
}

/// Hands the records of every lane to `observer`; returns how many.
pub fn drain(machine: &mut Machine, observer: &mut dyn Observer) -> usize {
    machine.readers.iter_mut().map(|reader| reader.drain(observer)).sum()
}

/// Stops every task; lanes gather what they lost.
pub fn stop(machine: &mut Machine) {
    machine.stop();
}
