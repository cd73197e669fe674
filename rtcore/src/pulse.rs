//! Where a lane is, for whoever looks from another thread: the task that runs now. One relaxed
//! store a task. Refuses to be a channel: nothing is ordered by it.

use core::sync::atomic::{AtomicU32, Ordering};

/// The task that a lane runs now.
#[derive(Debug, Default)]
pub(crate) struct Pulse {
    /// Position in the lane plus 1; 0 between jobs.
    seat: AtomicU32,
}

impl Pulse {
    /// The task at `position`, counted from 1, begins; 0: the job is over.
    pub(crate) fn enter(&self, position: u32) {
        // Relaxed: a hint to somebody who looks again and again; no value depends on it.
        self.seat.store(position, Ordering::Relaxed);
    }

    /// The task that runs, counted from 0.
    pub(crate) fn seat(&self) -> Option<usize> {
        (self.seat.load(Ordering::Relaxed) as usize).checked_sub(1)
    }
}
