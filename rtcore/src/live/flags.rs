//! The words through which the threads of a live run speak to each other: jobs done, the start, how
//! many are there, the slip, and storms of misses. Each operation's order of memory is argued where
//! it stands; loom tries them all in every order (`tests/loom`), also with the orders weakened.
//! Refuses to carry values: those go through links, and these words say when they are there.

use super::sync::{AtomicI64, AtomicU8, AtomicU64, AtomicUsize, Ordering};

/// How many jobs of a lane are done.
pub(super) struct JobsDone(AtomicU64);

impl JobsDone {
    /// None yet.
    pub(super) fn new() -> JobsDone {
        JobsDone(AtomicU64::new(0))
    }

    /// The lane has sent everything of its first `jobs` jobs.
    pub(super) fn publish(&self, jobs: u64) {
        // Release: whoever sees the number sees the values in the rings.
        self.0.store(jobs, Ordering::Release);
    }

    /// Jobs whose values can be taken.
    pub(super) fn seen(&self) -> u64 {
        // Acquire: with the store above.
        self.0.load(Ordering::Acquire)
    }

    /// Jobs done, for whoever takes no values.
    pub(super) fn glance(&self) -> u64 {
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

/// The start of all lanes.
pub(super) struct StartGate(AtomicU8);

impl StartGate {
    /// Nobody begins.
    pub(super) fn new() -> StartGate {
        StartGate(AtomicU8::new(StartSignal::Wait as u8))
    }

    /// Says `word` to all lanes.
    pub(super) fn say(&self, word: StartSignal) {
        // Release: whoever sees `Go` sees the epoch that was set before.
        self.0.store(word as u8, Ordering::Release);
    }

    /// What was said last.
    pub(super) fn word(&self) -> StartSignal {
        // Acquire: with the store above.
        match self.0.load(Ordering::Acquire) {
            0 => StartSignal::Wait,
            1 => StartSignal::Go,
            _ => StartSignal::Abandon,
        }
    }
}

/// How many threads have come to a place.
pub(super) struct ArrivalCount(AtomicUsize);

impl ArrivalCount {
    /// None.
    pub(super) fn new() -> ArrivalCount {
        ArrivalCount(AtomicUsize::new(0))
    }

    /// One more has come; what it left behind may be looked at.
    pub(super) fn come(&self) {
        // Release: whoever counts it sees its answers, and through it those of all before, because
        // each addition continues the release of the one before.
        self.0.fetch_add(1, Ordering::Release);
    }

    /// How many have come.
    pub(super) fn count(&self) -> usize {
        // Acquire: with the additions above.
        self.0.load(Ordering::Acquire)
    }
}

/// By how much logical time has slipped behind the wall's, ns: it only grows.
pub(super) struct Slip(AtomicI64);

impl Slip {
    /// Not at all.
    pub(super) fn new() -> Slip {
        Slip(AtomicI64::new(0))
    }

    /// Lanes held up by the same stall find about the same figure: the largest stands.
    pub(super) fn reach(&self, ns: i64) {
        // Relaxed: only the number itself is used; a maximum needs no order to be right.
        self.0.fetch_max(ns, Ordering::Relaxed);
    }

    /// The slip so far.
    pub(super) fn ns(&self) -> i64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// How many storms of misses there have been, in all lanes together.
pub(super) struct StormCount(AtomicU64);

impl StormCount {
    /// None.
    pub(super) fn new() -> StormCount {
        StormCount(AtomicU64::new(0))
    }

    /// So many more, in the lane that says so.
    pub(super) fn add(&self, storms: u64) {
        // Relaxed: only the number itself is used, and an addition loses none.
        self.0.fetch_add(storms, Ordering::Relaxed);
    }

    /// How many there have been.
    pub(super) fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}
