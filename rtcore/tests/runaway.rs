//! Tests that a real-time thread that computes without a wait on the only processor is detected, by
//! the action of this machine's kernel at its limit. Nothing depends on the speed of the machine.

use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError};

use taktil_rtcore::linux::{monotonic, set_fifo, thread_grant};
use taktil_rtcore::live::{self, Contract, Hang, LiveError, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Builder, Cycle, FaultCode, Io, LaneSpec, LatePolicy, Machine, Nanos, Task, virtual_time,
};

/// Computes without a wait in each job, or in one until its thread is ordinary.
struct Computes {
    each: Nanos,
    until_ordinary_at: Option<u64>,
    was_ordinary: Arc<AtomicBool>,
}

impl Computes {
    fn new(each: Nanos, until_ordinary_at: Option<u64>) -> Computes {
        Computes { each, until_ordinary_at, was_ordinary: Arc::default() }
    }
}

impl Task for Computes {
    fn step(&mut self, cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        let begin = monotonic();
        while monotonic() - begin < self.each {}
        if self.until_ordinary_at == Some(cycle.tick) {
            // It comes back at last, so that a lost watch fails the test and does not hang it.
            while fifo() && monotonic() - begin < Nanos::from_secs(20) {}
            self.was_ordinary.store(!fifo(), Ordering::SeqCst);
        }
        Ok(())
    }
}

/// Whether the calling thread runs under `SCHED_FIFO`.
fn fifo() -> bool {
    thread_grant("").policy == "SCHED_FIFO"
}

/// Whether threads of this process may.
fn may_be_fifo() -> bool {
    let granted = std::thread::spawn(|| set_fifo(50).is_ok() && fifo()).join().unwrap();
    if !granted {
        let _ = writeln!(std::io::stderr(), "SKIPPED: no SCHED_FIFO here; run it as root");
    }
    granted
}

struct Nobody;

impl Observer for Nobody {
    fn record(&mut self, _record: &Record<'_>) {}
}

impl RunObserver for Nobody {}

/// The limit is the process's: one live run at a time.
#[expect(clippy::disallowed_types, reason = "keeps tests apart; no lane of the product locks")]
static ONE: std::sync::Mutex<()> = std::sync::Mutex::new(());

fn run(machine: &mut Machine, pace: Pace, until: Nanos) -> Result<(), LiveError> {
    let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let terms = RunOptions { until, contract: Contract::Soft, pace };
    live::run(machine, terms, &AtomicBool::new(false), &mut Nobody).map(drop)
}

fn ms(ms: i64) -> Nanos {
    Nanos::from_millis(ms)
}

#[test]
fn a_task_that_computes_for_ever_loses_its_priority_and_is_named() {
    if !may_be_fifo() {
        return;
    }
    for pace in [Pace::Fixed, Pace::Slip] {
        let selfish = Computes::new(Nanos::ZERO, Some(4));
        let ordinary = Arc::clone(&selfish.was_ordinary);
        let mut b = Builder::new();
        let lane = b.lane(LaneSpec { cpu: Some(0), ..LaneSpec::new("first", ms(5), 50) }).unwrap();
        b.task(lane, "calm", |_| Ok(Box::new(Computes::new(Nanos::ZERO, None)))).unwrap();
        b.task(lane, "selfish", |_| Ok(Box::new(selfish))).unwrap();
        let mut machine = b.build().unwrap();
        let outcome = run(&mut machine, pace, Nanos::from_secs(3600));
        assert!(ordinary.load(Ordering::SeqCst), "{pace:?}: it kept its priority");
        let hang = Hang { lane: "first".into(), task: "selfish".into() };
        assert_eq!(outcome, Err(LiveError::Hung(hang)), "{pace:?}");
        let done = machine.figures().next().unwrap().1.jobs;
        let soon = Nanos((done.cast_signed() + 5) * ms(5).0);
        assert_eq!(run(&mut machine, pace, soon), Ok(()), "{pace:?}: it may be run again");
    }
}

#[test]
fn jobs_without_a_pause_between_them_are_not_a_hang() {
    if !may_be_fifo() {
        return;
    }
    let mut b = Builder::new();
    let late = LatePolicy::CatchUp { at_most: 1000 };
    let lane = b.lane(LaneSpec { late, ..LaneSpec::new("first", ms(10), 50) }).unwrap();
    b.task(lane, "busy", |_| Ok(Box::new(Computes::new(ms(40), None)))).unwrap();
    let mut machine = b.build().unwrap();
    run(&mut machine, Pace::Fixed, ms(500)).unwrap();
    // Two seconds of processor time without a wait: three words from the kernel.
    assert_eq!(machine.figures().next().unwrap().1.jobs, 50);
}

#[test]
fn the_limit_of_the_process_is_as_before_afterwards() {
    let limit = || {
        let limits = std::fs::read_to_string("/proc/self/limits").unwrap();
        let row = limits.lines().find(|row| row.starts_with("Max realtime timeout")).unwrap();
        row.to_owned()
    };
    let before = {
        let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
        limit()
    };
    struct Looks(Box<dyn Fn() -> String + Send>, Arc<AtomicBool>, String);
    impl Task for Looks {
        fn step(&mut self, cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
            self.1.fetch_or(cycle.tick == 3 && self.0() != self.2, Ordering::SeqCst);
            Ok(())
        }
    }
    let differs = Arc::new(AtomicBool::new(false));
    let machine = || {
        let mut b = Builder::new();
        let lane = b.lane(LaneSpec::new("first", ms(5), 50)).unwrap();
        let looks = Looks(Box::new(limit), Arc::clone(&differs), before.clone());
        b.task(lane, "looks", |_| Ok(Box::new(looks))).unwrap();
        b.build().unwrap()
    };
    virtual_time::run(&mut machine(), ms(50), &AtomicBool::new(false), &mut Nobody).unwrap();
    assert!(!differs.load(Ordering::SeqCst), "virtual time has no need of it");
    run(&mut machine(), Pace::Fixed, ms(50)).unwrap();
    assert!(differs.load(Ordering::SeqCst), "the kernel was told");
    let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    assert_eq!(limit(), before);
}
