//! Between the start of the run's time and the end of the last job no lane's thread allocates: a
//! lock of the allocator may be held by a thread of any priority, for as long as others keep that
//! thread off the processor.
#![expect(unsafe_code, reason = "a global allocator is an unsafe trait, and asks for a name")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use taktil_rtcore::live::{self, Attestation, Contract, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{Builder, Cycle, FaultCode, Io, LaneSpec, Nanos, Task};

/// The name of the lanes' threads, which the allocator asks the kernel for.
const LANE: &str = "watched_lane";
/// Jobs of each lane.
const JOB_COUNT: u64 = 20;

static IS_STARTED: AtomicBool = AtomicBool::new(false);
static CALLS: AtomicU64 = AtomicU64::new(0);

struct CountingLanes;

/// Counts a call of a lane's thread in the time that is watched.
fn count() {
    if !IS_STARTED.load(Ordering::SeqCst) {
        return;
    }
    let mut name = [0_u8; 16];
    // SAFETY: the kernel writes at most 16 bytes to the place that it is given.
    unsafe { libc::prctl(libc::PR_GET_NAME, name.as_mut_ptr()) };
    if name.starts_with(LANE.as_bytes()) {
        CALLS.fetch_add(1, Ordering::SeqCst);
    }
}

// SAFETY: every method passes its arguments on to the system's allocator; counting allocates
// nothing.
unsafe impl GlobalAlloc for CountingLanes {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promise on `layout` is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        count();
        // SAFETY: `block` came from `System` with this `layout`.
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: CountingLanes = CountingLanes;

/// Counts its jobs; the watched time ends in the last one of a lane.
struct LastJob;

impl Task for LastJob {
    fn step(&mut self, cycle: &Cycle, _: &mut Io<'_>) -> Result<(), FaultCode> {
        if cycle.tick + 1 == JOB_COUNT {
            IS_STARTED.store(false, Ordering::SeqCst);
        }
        Ok(())
    }
}

/// The watched time begins when all lanes are ready, before they hear of the run's time.
struct Start(bool);

impl Observer for Start {
    fn record(&mut self, _: &Record<'_>) {}
}

impl RunObserver for Start {
    fn on_attestation(&mut self, _: &Attestation) {
        self.0 = true;
        IS_STARTED.store(true, Ordering::SeqCst);
    }
}

/// What is counted of a thread with a lane's name that allocates one block and frees it.
fn calls_of_a_block() -> u64 {
    let work = || {
        IS_STARTED.store(true, Ordering::SeqCst);
        drop(std::hint::black_box(Box::new(0_u64)));
        IS_STARTED.store(false, Ordering::SeqCst);
    };
    std::thread::Builder::new().name(format!("{LANE}9")).spawn(work).unwrap().join().unwrap();
    CALLS.swap(0, Ordering::SeqCst)
}

#[test]
fn a_lanes_thread_does_not_allocate_once_the_time_of_the_run_has_begun() {
    assert_eq!(calls_of_a_block(), 2);
    let mut builder = Builder::new();
    for (number, priority) in [(0, 50), (1, 40)] {
        let spec = LaneSpec::new(format!("{LANE}{number}"), Nanos::from_millis(5), priority);
        let lane = builder.lane(spec).unwrap();
        builder.task(lane, &format!("last{number}"), |_| Ok(Box::new(LastJob))).unwrap();
    }
    let mut machine = builder.build().unwrap();
    let until = Nanos::from_millis(5 * JOB_COUNT as i64);
    let options = RunOptions { until, contract: Contract::Soft, pace: Pace::Fixed };
    let mut start = Start(false);
    live::run(&mut machine, options, &AtomicBool::new(false), &mut start).unwrap();
    assert!(start.0, "nobody was told that the lanes are ready");
    assert_eq!(CALLS.load(Ordering::SeqCst), 0, "heap calls of the lanes' threads");
}
