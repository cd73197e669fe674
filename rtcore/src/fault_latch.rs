//! Holds a fault in the health of a lane for so long that every lane that reads the health sees it.

use taktil_hal::Nanos;

use crate::fault::FaultSet;

/// Keeps each fault in the lane's health until the slowest lane that reads it has had a job.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FaultLatch {
    hold: Nanos,
    faults: FaultSet,
    task: u32,
    until: [Nanos; 64],
}

impl FaultLatch {
    /// Faults are held for `hold` after the job that raised them.
    pub(crate) fn new(hold: Nanos) -> FaultLatch {
        FaultLatch { hold, faults: FaultSet::NONE, task: 0, until: [Nanos::ZERO; 64] }
    }

    /// Holds faults for `period` at least, so that a reader with this period misses none.
    pub(crate) fn extend_hold(&mut self, period: Nanos) {
        self.hold = self.hold.max(period);
    }

    /// Takes in the faults of the job released at `release`, of which `task` raised the first;
    /// returns what the health says.
    pub(crate) fn latch(&mut self, release: Nanos, faults: FaultSet, task: u32) -> (FaultSet, u32) {
        if faults.is_empty() && self.faults.is_empty() {
            return (FaultSet::NONE, 0);
        }
        for (bit, until) in self.until.iter_mut().enumerate() {
            let mask = 1 << bit;
            if faults.0 & mask != 0 {
                *until = release + self.hold;
            } else if *until <= release {
                self.faults.0 &= !mask;
            }
        }
        if self.faults.is_empty() || self.task == 0 {
            self.task = task;
        }
        self.faults = self.faults.union(faults);
        (self.faults, if self.faults.is_empty() { 0 } else { self.task })
    }
}
