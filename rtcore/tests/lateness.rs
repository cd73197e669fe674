//! Tests the treatment of jobs that are too late and of tasks that do not return: in the lane's
//! health, in the other lanes' health, and on the carrying thread. Lateness is made on purpose;
//! nothing depends on the speed of this machine.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use taktil_rtcore::live::{self, Contract, Hang, LiveError, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::schedule::PERIOD_MAX;
use taktil_rtcore::status::LaneHealth;
use taktil_rtcore::{
    Builder, Cycle, FaultCode, FaultSet, Input, Io, LaneSpec, LatePolicy, LeakyBucket, Machine,
    Nanos, Output, Payload, Task, payload, virtual_time,
};

payload! {
    /// What a reader saw of a health.
    pub struct Seen {
        /// faults
        pub faults: u64,
    }
}

/// Is late on purpose, raises a fault, or does not return until it is let go.
#[derive(Clone, Default)]
struct Trouble {
    late: Option<(u64, u64)>,
    fault_at: Option<u64>,
    hang_at: Option<u64>,
    /// Hangs in a computation, not in a wait.
    spins: bool,
    let_go: Arc<AtomicBool>,
}

impl Task for Trouble {
    fn step(&mut self, cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        if self.late.is_some_and(|(from, to)| (from..to).contains(&cycle.tick)) {
            std::thread::sleep(Duration::from_millis(12));
        }
        while self.hang_at == Some(cycle.tick) && !self.let_go.load(Ordering::SeqCst) {
            if self.spins {
                std::hint::spin_loop();
            } else {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        if self.fault_at == Some(cycle.tick) { Err(FaultCode::TactileLost) } else { Ok(()) }
    }
}

/// Tells what it reads of a lane's health.
struct Reader {
    health: Input<LaneHealth>,
    seen: Output<Seen>,
}

impl Task for Reader {
    fn step(&mut self, _cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let faults = io.read(&self.health).value.faults;
        io.write(&self.seen, Seen { faults });
        Ok(())
    }
}

/// Every health of a run, by lane, and what was said of a hang.
#[derive(Default)]
struct Keep {
    health: Vec<(usize, u64, LaneHealth)>,
    seen: Vec<u64>,
    lanes: Vec<usize>,
    hung: Option<Hang>,
    let_go: Arc<AtomicBool>,
}

impl Keep {
    fn new(machine: &Machine, trouble: &Trouble) -> Keep {
        let catalog = machine.catalog();
        let health = |lane: &taktil_rtcore::record::LaneInfo| {
            catalog.find(&format!("{}.health", lane.name)).unwrap()
        };
        let lanes = catalog.lanes.iter().map(health).collect();
        Keep { lanes, let_go: Arc::clone(&trouble.let_go), ..Keep::default() }
    }

    fn of(&self, lane: usize) -> impl Iterator<Item = (u64, LaneHealth)> + '_ {
        self.health.iter().filter(move |row| row.0 == lane).map(|row| (row.1, row.2))
    }

    fn faults(&self, lane: usize) -> FaultSet {
        self.of(lane).fold(FaultSet::NONE, |all, (_, health)| all.union(FaultSet(health.faults)))
    }
}

impl Observer for Keep {
    fn record(&mut self, record: &Record<'_>) {
        match self.lanes.iter().position(|signal| *signal == record.signal) {
            Some(lane) => {
                self.health.push((lane, record.tick, LaneHealth::decode(record.body).unwrap()));
            }
            // States and decisions are of other lengths.
            None => self.seen.extend(Seen::decode(record.body).map(|seen| seen.faults)),
        }
    }
}

impl RunObserver for Keep {
    fn on_hang(&mut self, hang: &Hang) {
        assert_eq!(self.hung.replace(hang.clone()), None, "said once");
        self.let_go.store(true, Ordering::SeqCst);
    }
}

/// A lane `first` of 5 ms with the trouble, and a lane `second` of 5 ms without.
fn machine(trouble: &Trouble, late: LatePolicy) -> Machine {
    let mut b = Builder::new();
    let bucket = LeakyBucket { capacity: 6, leak_jobs: 100 };
    let spec = LaneSpec { late, misses: bucket, ..LaneSpec::new("first", ms(5), 50) };
    let first = b.lane(spec).unwrap();
    // Its own bucket never fills, however busy this machine is.
    let misses = LeakyBucket { capacity: 1_000_000, leak_jobs: 1 };
    let second = b.lane(LaneSpec { misses, ..LaneSpec::new("second", ms(5), 50) }).unwrap();
    b.task(first, "trouble", |_| Ok(Box::new(trouble.clone()))).unwrap();
    b.task(second, "calm", |_| Ok(Box::new(Trouble::default()))).unwrap();
    b.build().unwrap()
}

fn ms(ms: i64) -> Nanos {
    Nanos::from_millis(ms)
}

/// One live run at a time: one that holds a processor must not starve another's carrying thread.
#[expect(clippy::disallowed_types, reason = "tests wait for each other, no lane does")]
static ONE: std::sync::Mutex<()> = std::sync::Mutex::new(());

fn run(machine: &mut Machine, keep: &mut Keep, pace: Pace, until: Nanos) -> Result<(), LiveError> {
    let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let terms = RunOptions { until, contract: Contract::Soft, pace };
    live::run(machine, terms, &AtomicBool::new(false), keep).map(drop)
}

#[test]
fn misses_stand_in_the_health_of_the_next_job_and_a_storm_follows() {
    let trouble = Trouble { late: Some((3, 6)), ..Trouble::default() };
    let mut machine = machine(&trouble, LatePolicy::Skip);
    let mut keep = Keep::new(&machine, &trouble);
    run(&mut machine, &mut keep, Pace::Fixed, ms(100)).unwrap();
    let (_, first) = keep.of(0).find(|(_, health)| health.missed > 0).unwrap();
    assert!(FaultSet(first.faults).contains(FaultCode::Overrun));
    // Job 3 took 12 ms: 4 is left out. It was left out itself where the machine stood still.
    let was_run = |wanted: u64| keep.of(0).any(|(tick, _)| tick == wanted);
    assert!(!was_run(3) || !was_run(4));
    let mut last = 0;
    for (tick, health) in keep.of(0) {
        assert!(u64::from(health.missed) <= tick && health.missed >= last);
        last = health.missed;
    }
    let (_, figures) = machine.figures().next().unwrap();
    assert!(figures.skipped >= 1 && figures.misses.total() >= 1);
    let storm = keep.faults(0).contains(FaultCode::OverrunStorm);
    assert!(!storm || figures.storms > 0, "no storm without a full bucket");
    assert!(!keep.faults(0).contains(FaultCode::DeadlineMissed));

    let trouble = Trouble { late: Some((3, 90)), ..Trouble::default() };
    let mut machine = self::machine(&trouble, LatePolicy::Skip);
    let mut keep = Keep::new(&machine, &trouble);
    run(&mut machine, &mut keep, Pace::Fixed, ms(500)).unwrap();
    assert!(keep.faults(0).contains(FaultCode::OverrunStorm), "too many");
}

#[test]
fn a_storm_in_one_lane_is_reported_to_the_tasks_of_every_other() {
    let trouble = Trouble { late: Some((3, 90)), ..Trouble::default() };
    let mut machine = machine(&trouble, LatePolicy::Skip);
    let mut keep = Keep::new(&machine, &trouble);
    run(&mut machine, &mut keep, Pace::Fixed, ms(600)).unwrap();
    let storms: Vec<u64> = machine.figures().map(|(_, figures)| figures.storms).collect();
    assert!(storms[0] > 0 && storms[1] == 0, "{storms:?}");
    let told =
        |(_, health): &(u64, LaneHealth)| FaultSet(health.faults).contains(FaultCode::OverrunStorm);
    let first = keep.of(0).find(told).expect("in its own health").0;
    let second = keep.of(1).find(told).expect("in the other's health").0;
    assert!(second >= 6, "not before it was one: {first}, {second}");
    let jobs = keep.of(1).filter(told).count() as u64;
    assert!(jobs <= 2 * storms[0], "each storm is told once, and held for a reader: {jobs}");
}

#[test]
fn a_lane_that_catches_up_leaves_nothing_out_within_its_bound() {
    let trouble = Trouble { late: Some((3, 5)), ..Trouble::default() };
    let mut machine = machine(&trouble, LatePolicy::CatchUp { at_most: 1000 });
    let mut keep = Keep::new(&machine, &trouble);
    run(&mut machine, &mut keep, Pace::Fixed, ms(200)).unwrap();
    let ticks: Vec<u64> = keep.of(0).map(|(tick, _)| tick).collect();
    assert_eq!(ticks, (0..40).collect::<Vec<_>>());
    assert_eq!(machine.figures().next().unwrap().1.skipped, 0);
}

#[test]
fn a_lane_that_may_not_miss_reports_a_miss_in_its_next_job() {
    let trouble = Trouble { late: Some((3, 4)), ..Trouble::default() };
    let mut machine = machine(&trouble, LatePolicy::Fault);
    let mut keep = Keep::new(&machine, &trouble);
    run(&mut machine, &mut keep, Pace::Fixed, ms(200)).unwrap();
    assert!(keep.faults(0).contains(FaultCode::DeadlineMissed));
}

#[test]
fn where_the_world_waits_lateness_changes_no_value() {
    let trouble = Trouble { late: Some((3, 20)), ..Trouble::default() };
    let mut live_machine = machine(&trouble, LatePolicy::Fault);
    let mut live_keep = Keep::new(&live_machine, &trouble);
    run(&mut live_machine, &mut live_keep, Pace::Slip, ms(150)).unwrap();
    let figures: Vec<_> = live_machine.figures().map(|(_, figures)| figures).collect();
    assert!(figures[0].misses.total() >= 17 && figures[0].storms > 0, "they are counted");
    let calm = Trouble::default();
    let mut machine = machine(&calm, LatePolicy::Fault);
    let mut keep = Keep::new(&machine, &calm);
    virtual_time::run(&mut machine, ms(150), &AtomicBool::new(false), &mut keep).unwrap();
    for lane in 0..2 {
        let rows = |keep: &Keep| keep.of(lane).collect::<Vec<_>>();
        assert_eq!(rows(&live_keep), rows(&keep));
    }
}

#[test]
fn a_task_that_does_not_return_is_seen_by_the_other_lane_and_by_the_carrying_thread() {
    let trouble = Trouble { hang_at: Some(4), ..Trouble::default() };
    let mut machine = machine(&trouble, LatePolicy::Skip);
    let mut keep = Keep::new(&machine, &trouble);
    let outcome = run(&mut machine, &mut keep, Pace::Fixed, PERIOD_MAX * 360);
    let hang = Hang { lane: "first".into(), task: "trouble".into() };
    assert_eq!(outcome, Err(LiveError::Hung(hang.clone())));
    assert_eq!(keep.hung, Some(hang));
    let (tick, silent) = keep.of(1).find(|(_, health)| health.silent != 0).unwrap();
    assert_eq!(silent.silent, 1, "lane 0");
    assert!(FaultSet(silent.faults).contains(FaultCode::LaneSilent));
    assert!(tick >= 10, "not before 50 ms: {tick}");
    assert!(!keep.faults(0).contains(FaultCode::LaneSilent));
}

#[test]
fn a_task_that_computes_for_ever_is_seen() {
    // Without a CPU the other lane moves to a free one; beside it there is the carrying thread.
    for cpu in [None, Some(0)] {
        let trouble = Trouble { hang_at: Some(4), spins: true, ..Trouble::default() };
        let mut b = Builder::new();
        let first = b.lane(LaneSpec { cpu, ..LaneSpec::new("first", ms(5), 50) }).unwrap();
        let second = b.lane(LaneSpec { cpu, ..LaneSpec::new("second", ms(5), 40) }).unwrap();
        b.task(first, "trouble", |_| Ok(Box::new(trouble.clone()))).unwrap();
        b.task(second, "calm", |_| Ok(Box::new(Trouble::default()))).unwrap();
        let mut machine = b.build().unwrap();
        let mut keep = Keep::new(&machine, &trouble);
        let outcome = run(&mut machine, &mut keep, Pace::Fixed, PERIOD_MAX * 360);
        let hang = Hang { lane: "first".into(), task: "trouble".into() };
        assert_eq!(outcome, Err(LiveError::Hung(hang)), "{cpu:?}");
        let seen = keep.of(1).any(|(_, health)| health.silent == 1);
        assert!(seen || cpu.is_some(), "by the other lane");
    }
}

#[test]
fn at_a_slipping_pace_only_the_carrying_thread_reports_a_hang() {
    let trouble = Trouble { hang_at: Some(4), ..Trouble::default() };
    let mut machine = machine(&trouble, LatePolicy::Skip);
    let mut keep = Keep::new(&machine, &trouble);
    let outcome = run(&mut machine, &mut keep, Pace::Slip, PERIOD_MAX * 360);
    assert!(matches!(outcome, Err(LiveError::Hung(hang)) if hang.task == "trouble"));
    assert!(keep.faults(0).union(keep.faults(1)).is_empty());
}

/// A 1 ms lane whose task raises one fault, read by a lane of 5 ms.
#[test]
fn a_slow_reader_misses_no_fault_of_a_fast_lane() {
    for fault_at in 20..30 {
        let trouble = Trouble { fault_at: Some(fault_at), ..Trouble::default() };
        let mut b = Builder::new();
        let fast = b.lane(LaneSpec::new("fast", ms(1), 60)).unwrap();
        let slow = b.lane(LaneSpec::new("slow", ms(5), 50)).unwrap();
        b.task(fast, "trouble", |_| Ok(Box::new(trouble.clone()))).unwrap();
        b.task(slow, "reader", |ports| {
            Ok(Box::new(Reader { health: ports.input("health"), seen: ports.output("seen") }))
        })
        .unwrap();
        b.bind("reader.health", "fast.health");
        let mut machine = b.build().unwrap();
        let mut keep = Keep::new(&machine, &trouble);
        virtual_time::run(&mut machine, ms(100), &AtomicBool::new(false), &mut keep).unwrap();
        let seen = keep.seen.iter().filter(|seen| **seen != 0).count();
        assert_eq!(seen, 1, "fault of job {fault_at}");
        let held: Vec<u32> =
            keep.of(0).filter(|(_, h)| h.faults != 0).map(|(_, h)| h.faulty_task).collect();
        assert_eq!(held, [1; 5]);
    }
}

/// Keeps health as [`Keep`] does, and stands still in one look at the time, once.
struct StallingKeep {
    keep: Keep,
    stall: Option<std::time::Duration>,
}

impl Observer for StallingKeep {
    fn record(&mut self, record: &Record<'_>) {
        self.keep.record(record);
    }
}

impl RunObserver for StallingKeep {
    fn on_time(&mut self, now: Nanos) {
        if now > ms(50)
            && let Some(stall) = self.stall.take()
        {
            std::thread::sleep(stall);
        }
    }
}

#[test]
fn lanes_notice_a_carrying_thread_that_stands_still() {
    let faults = |stall| {
        let trouble = Trouble::default();
        let mut machine = machine(&trouble, LatePolicy::Skip);
        let keep = Keep::new(&machine, &trouble);
        let mut observer = StallingKeep { keep, stall };
        let options = RunOptions { until: ms(1200), contract: Contract::Soft, pace: Pace::Fixed };
        live::run(&mut machine, options, &AtomicBool::new(false), &mut observer).unwrap();
        observer.keep.faults(0).union(observer.keep.faults(1))
    };
    let stalled = faults(Some(std::time::Duration::from_millis(900)));
    assert!(stalled.contains(FaultCode::MonitorSilent));
}

#[test]
fn lanes_notice_a_watched_thread_that_stands_still() {
    let trouble = Trouble::default();
    let mut machine = machine(&trouble, LatePolicy::Skip);
    let heartbeat = machine.heartbeat(ms(60));
    heartbeat.beat();
    let mut keep = Keep::new(&machine, &trouble);
    run(&mut machine, &mut keep, Pace::Fixed, ms(300)).unwrap();
    assert!(keep.faults(0).contains(FaultCode::MonitorSilent));
    let mut machine = self::machine(&trouble, LatePolicy::Skip);
    drop(machine.heartbeat(ms(60)));
    let mut keep = Keep::new(&machine, &trouble);
    run(&mut machine, &mut keep, Pace::Fixed, ms(300)).unwrap();
    assert!(!keep.faults(0).contains(FaultCode::MonitorSilent), "it has ended in good order");
}
