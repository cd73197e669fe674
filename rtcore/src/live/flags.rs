//! The atomic words through which the threads of a live run report their progress to each other:
//! jobs done, the start, how many threads have arrived, the slip of the schedule and its pace, and
//! storms of misses. A comment at each operation justifies its memory order; loom tries all
//! interleavings (`tests/loom`), also with weakened orders. Values go through links; these words
//! only tell when they can be taken.

use super::sync::{AtomicI64, AtomicU8, AtomicU64, AtomicUsize, Ordering};

/// How many jobs of a lane are done.
pub(super) struct JobsDone(AtomicU64);

impl JobsDone {
    /// No job is done yet.
    pub(super) fn new() -> JobsDone {
        JobsDone(AtomicU64::new(0))
    }

    /// Says that the lane has sent everything of its first `jobs` jobs.
    pub(super) fn publish(&self, jobs: u64) {
        // Release: whoever sees the number sees the values in the rings.
        self.0.store(jobs, Ordering::Release);
    }

    /// The number of jobs whose values can be taken.
    pub(super) fn load(&self) -> u64 {
        // Acquire: pairs with the store in `publish`.
        self.0.load(Ordering::Acquire)
    }

    /// The number of jobs done, for a thread that takes no values.
    pub(super) fn load_relaxed(&self) -> u64 {
        // Relaxed: only the number itself is used.
        self.0.load(Ordering::Relaxed)
    }
}

/// Whether the lanes may begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StartSignal {
    /// Not yet.
    Wait,
    /// The epoch is set: begin.
    Go,
    /// No further job.
    Abandon,
}

/// Holds all lanes until they are let go or the run is abandoned.
pub(super) struct StartGate(AtomicU8);

impl StartGate {
    /// A gate at which every lane waits.
    pub(super) fn new() -> StartGate {
        StartGate(AtomicU8::new(StartSignal::Wait as u8))
    }

    /// Gives `signal` to all lanes.
    pub(super) fn set(&self, signal: StartSignal) {
        // Release: whoever sees `Go` sees the epoch that was set before.
        self.0.store(signal as u8, Ordering::Release);
    }

    /// The signal that was given last.
    pub(super) fn signal(&self) -> StartSignal {
        // Acquire: pairs with the store in `set`.
        match self.0.load(Ordering::Acquire) {
            0 => StartSignal::Wait,
            1 => StartSignal::Go,
            _ => StartSignal::Abandon,
        }
    }
}

/// How many threads have arrived at a point of their program.
pub(super) struct ArrivalCount(AtomicUsize);

impl ArrivalCount {
    /// No thread has arrived.
    pub(super) fn new() -> ArrivalCount {
        ArrivalCount(AtomicUsize::new(0))
    }

    /// Counts the calling thread; what it wrote before may be read by whoever counts it.
    pub(super) fn arrive(&self) {
        // Release: whoever counts this thread sees what it wrote, and through it what all threads
        // before it wrote, because each addition continues the release of the one before.
        self.0.fetch_add(1, Ordering::Release);
    }

    /// How many threads have arrived.
    pub(super) fn count(&self) -> usize {
        // Acquire: pairs with the additions in `arrive`.
        self.0.load(Ordering::Acquire)
    }
}

/// By how much logical time has slipped behind the wall clock (ns): it only grows.
pub(super) struct Slip(AtomicI64);

impl Slip {
    /// Logical time has not slipped yet.
    pub(super) fn new() -> Slip {
        Slip(AtomicI64::new(0))
    }

    /// Raises the slip to `ns` unless it is larger already. Lanes held up by the same stall measure
    /// about the same slip, of which the largest counts.
    pub(super) fn raise_to(&self, ns: i64) {
        // Relaxed: only the number itself is used; a maximum needs no order to be right.
        self.0.fetch_max(ns, Ordering::Relaxed);
    }

    /// The slip so far (ns).
    pub(super) fn ns(&self) -> i64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// By how much releases are moved on the host's clock to keep their place in the cycle of a board
/// (ns), of either sign; one lane sets it.
pub(super) struct PaceOffset(AtomicI64);

impl PaceOffset {
    /// Releases are where logical time has them.
    pub(super) fn new() -> PaceOffset {
        PaceOffset(AtomicI64::new(0))
    }

    /// Moves the releases to come.
    pub(super) fn set(&self, ns: i64) {
        // Relaxed: only the number itself is used, and its one writer moves it in small steps.
        self.0.store(ns, Ordering::Relaxed);
    }

    /// The offset in force (ns).
    pub(super) fn ns(&self) -> i64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// How many storms of misses there have been, in all lanes together.
pub(super) struct StormCount(AtomicU64);

impl StormCount {
    /// There has been no storm yet.
    pub(super) fn new() -> StormCount {
        StormCount(AtomicU64::new(0))
    }

    /// Adds the `storms` of the calling lane.
    pub(super) fn add(&self, storms: u64) {
        // Relaxed: only the number itself is used, and an addition loses none.
        self.0.fetch_add(storms, Ordering::Relaxed);
    }

    /// How many storms there have been.
    pub(super) fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}
