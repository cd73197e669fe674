//! The activity of a lane, for observers on other threads: the task that runs now, and the instant
//! at which the job began. It costs one relaxed store for each task and each job. It orders no
//! other memory accesses, so it must not guard values.

use core::sync::atomic::{AtomicI64, AtomicU32, Ordering};

use taktil_hal::Nanos;

/// The task that a lane runs now.
#[derive(Debug, Default)]
pub(crate) struct LaneActivity {
    /// Position in the lane plus 1; 0 between jobs.
    task: AtomicU32,
    /// Begin of the job, ns.
    since: AtomicI64,
    /// The task that computed for so long that the thread lost its priority; 0: none.
    runaway: AtomicU32,
}

impl LaneActivity {
    /// Notes that a job begins at `now`.
    pub(crate) fn begin_job(&self, now: Nanos) {
        // Relaxed, as all here: it is read by a signal handler on this very thread.
        self.since.store(now.0, Ordering::Relaxed);
    }

    /// Notes that the task at `position`, counted from 1, begins; 0 says that the job is over.
    pub(crate) fn enter_task(&self, position: u32) {
        // Relaxed: a hint to a thread that looks again and again; no value depends on it.
        self.task.store(position, Ordering::Relaxed);
    }

    /// The task that runs, counted from 0.
    pub(crate) fn running_task(&self) -> Option<usize> {
        (self.task.load(Ordering::Relaxed) as usize).checked_sub(1)
    }

    /// When the job that runs began.
    pub(crate) fn busy_since(&self) -> Option<Nanos> {
        self.running_task().map(|_| Nanos(self.since.load(Ordering::Relaxed)))
    }

    /// Forgets a runaway task: the lane starts anew, on a thread with its priority.
    pub(crate) fn reset(&self) {
        self.runaway.store(0, Ordering::Relaxed);
    }

    /// Notes that the running task computed for so long that the thread lost its priority.
    pub(crate) fn mark_runaway(&self) {
        self.runaway.store(self.task.load(Ordering::Relaxed), Ordering::Relaxed);
    }

    /// The task for which the thread lost its priority, counted from 0.
    pub(crate) fn runaway_task(&self) -> Option<usize> {
        (self.runaway.load(Ordering::Relaxed) as usize).checked_sub(1)
    }
}
