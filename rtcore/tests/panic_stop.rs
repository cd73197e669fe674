//! A task that panics is stopped at once, so that the board that it drives does not keep its last
//! word until a watchdog ends it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{Builder, Cycle, FaultCode, Io, LaneSpec, Nanos, Task, virtual_time};

/// Panics in job 3, and counts how often it is stopped.
struct Doomed {
    stops: Arc<AtomicU32>,
}

impl Task for Doomed {
    fn step(&mut self, cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        assert!(cycle.tick != 3, "the test wants it");
        Ok(())
    }

    fn stop(&mut self) {
        self.stops.fetch_add(1, Ordering::SeqCst);
        panic!("and once more");
    }
}

/// Counts the jobs in which the task before it had not been stopped.
struct Witness {
    stops: Arc<AtomicU32>,
    jobs: Arc<AtomicU32>,
}

impl Task for Witness {
    fn step(&mut self, _cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        if self.stops.load(Ordering::SeqCst) == 0 {
            self.jobs.fetch_add(1, Ordering::SeqCst);
        }
        Ok(())
    }
}

struct NoObserver;

impl Observer for NoObserver {
    fn record(&mut self, _record: &Record<'_>) {}
}

#[test]
fn a_task_that_panics_is_stopped_in_the_same_job() {
    let (stops, jobs) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicU32::new(0)));
    let mut builder = Builder::new();
    let lane = builder.lane(LaneSpec::new("lane", Nanos::from_millis(1), 50)).unwrap();
    let doomed = Doomed { stops: stops.clone() };
    builder.task(lane, "doomed", |_| Ok(Box::new(doomed))).unwrap();
    let witness = Witness { stops: stops.clone(), jobs: jobs.clone() };
    builder.task(lane, "witness", |_| Ok(Box::new(witness))).unwrap();
    let mut machine = builder.build().unwrap();
    let (until, stop) = (Nanos::from_millis(10), AtomicBool::new(false));
    virtual_time::run(&mut machine, until, &stop, &mut NoObserver).unwrap();
    assert_eq!(jobs.load(Ordering::SeqCst), 3, "its neighbour sees it stopped in job 3");
    assert_eq!(stops.load(Ordering::SeqCst), 2, "and at the end, like all others");
}
