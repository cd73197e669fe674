//! Tests lanes, bindings and both executors with very small tasks.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use taktil_rtcore::guard::CountingAllocator;
use taktil_rtcore::live::{self, Contract, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Builder, Cycle, FaultCode, FaultSet, Freshness, Input, Invalid, Io, LaneId, LaneSpec, Machine,
    Nanos, Output, Payload, Ports, Task, payload, virtual_time,
};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

payload! {
    /// A number and what its reader saw.
    pub struct Number {
        /// value
        pub value: f64,
        /// age of what was read
        pub age_ns: i64,
        /// 0 absent, 1 new, 2 held, 3 stale
        pub freshness: u32,
    }
}

payload! {
    /// Another type.
    pub struct Other {
        /// value
        pub value: u32,
    }
}

/// Writes its tick, or something wrong at a chosen tick.
struct Source {
    out: Output<Number>,
    trouble: Option<(u64, Trouble)>,
}

#[derive(Clone, Copy, PartialEq)]
enum Trouble {
    NotANumber,
    Panic,
    Fault,
    Silent,
    Allocate,
    OutOfRange,
}

impl Task for Source {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let mut value = cycle.tick as f64;
        match self.trouble.filter(|(tick, _)| *tick == cycle.tick).map(|t| t.1) {
            Some(Trouble::NotANumber) => value = f64::NAN,
            Some(Trouble::OutOfRange) => value = -1e300,
            Some(Trouble::Panic) => panic!("on purpose"),
            Some(Trouble::Fault) => return Err(FaultCode::TactileLost),
            Some(Trouble::Silent) => return Ok(()),
            Some(Trouble::Allocate) => drop(std::hint::black_box(vec![1u8; 64])),
            None => {}
        }
        io.write(&self.out, Number { value, ..Number::ZERO });
        Ok(())
    }
}

/// Reads and writes on what it saw.
struct Echo {
    from: Input<Number>,
    out: Output<Number>,
}

impl Task for Echo {
    fn step(&mut self, _cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let sample = io.read(&self.from);
        let freshness = match sample.freshness {
            Freshness::Absent => 0,
            Freshness::New => 1,
            Freshness::Held => 2,
            Freshness::Stale => 3,
        };
        let seen = Number { value: sample.value.value, age_ns: sample.age.0, freshness };
        io.write(&self.out, seen);
        Ok(())
    }
}

fn source(b: &mut Builder, lane: LaneId, name: &str, trouble: Option<(u64, Trouble)>) {
    b.task(lane, name, |ports| {
        // Ticks are small and not negative.
        let out = ports.output_within("number", |n: &Number| (0.0..1e9).contains(&n.value));
        Ok(Box::new(Source { out, trouble }))
    })
    .unwrap();
}

fn echo(b: &mut Builder, lane: LaneId, name: &str, delayed: bool) {
    b.task(lane, name, |ports: &mut Ports| {
        let from = if delayed {
            ports.input_delayed("from")
        } else {
            ports.input_within("from", Nanos::from_millis(11))
        };
        Ok(Box::new(Echo { from, out: ports.output("number") }))
    })
    .unwrap();
}

/// Keeps every record.
#[derive(Default, PartialEq, Debug)]
struct Keep(Vec<(usize, u64, i64, Vec<u8>)>);

impl Observer for Keep {
    fn record(&mut self, record: &Record<'_>) {
        self.0.push((record.signal, record.tick, record.release.0, record.body.to_vec()));
    }
}

impl RunObserver for Keep {}

impl Keep {
    fn of(&self, machine: &Machine, signal: &str) -> Vec<(i64, Number)> {
        let id = machine.catalog().find(signal).unwrap();
        self.0
            .iter()
            .filter(|row| row.0 == id)
            .map(|row| (row.2, Number::decode(&row.3).unwrap()))
            .collect()
    }

    /// Independent of how the lanes interleave: by signal, then as it came.
    fn by_signal(mut self) -> Keep {
        self.0.sort_by_key(|row| row.0);
        self
    }
}

/// 5 ms source lane (phase 1 ms, delivery 3 ms) read by a 2 ms lane.
fn two_lanes(trouble: Option<(u64, Trouble)>) -> Machine {
    let mut b = Builder::new();
    let mut slow = LaneSpec::new("slow", Nanos::from_millis(5), 50);
    slow.phase = Nanos::from_millis(1);
    slow.delivery = Nanos::from_millis(3);
    slow.deadline = slow.delivery;
    let slow = b.lane(slow).unwrap();
    let fast = b.lane(LaneSpec::new("fast", Nanos::from_millis(2), 60)).unwrap();
    source(&mut b, slow, "source", trouble);
    echo(&mut b, fast, "echo", false);
    b.bind("echo.from", "source.number");
    b.build().unwrap()
}

fn run_virtual(machine: &mut Machine, until: Nanos) -> Keep {
    let mut keep = Keep::default();
    virtual_time::run(machine, until, &AtomicBool::new(false), &mut keep).unwrap();
    keep
}

#[test]
fn between_lanes_a_value_is_visible_at_its_delivery_instant_and_not_before() {
    let mut machine = two_lanes(None);
    let keep = run_virtual(&mut machine, Nanos::from_millis(40));
    for (release, seen) in keep.of(&machine, "echo.number") {
        // Source jobs at 1, 6, 11 ... ms, visible at 4, 9, 14 ...
        let newest = (release - 4_000_000).div_euclid(5_000_000);
        if newest < 0 {
            assert_eq!(seen.freshness, 0, "at {release}");
        } else {
            assert_eq!(seen.value, newest as f64, "at {release}");
            assert_eq!(seen.age_ns, release - (1_000_000 + 5_000_000 * newest));
            let before = (release - 2_000_000 - 4_000_000).div_euclid(5_000_000);
            assert_eq!(seen.freshness, if before == newest { 2 } else { 1 }, "at {release}");
        }
    }
}

#[test]
fn a_missing_value_becomes_stale() {
    let mut machine = two_lanes(Some((2, Trouble::Silent)));
    let keep = run_virtual(&mut machine, Nanos::from_millis(40));
    let stale: Vec<i64> = keep
        .of(&machine, "echo.number")
        .iter()
        .filter(|(_, seen)| seen.freshness == 3)
        .map(|(release, _)| release / 1_000_000)
        .collect();
    // Job 1 (release 6 ms) is 12 ms old at 18 ms, over the limit of 11; job 3 is visible from 19
    // on.
    assert_eq!(stale, [18]);
    let mut machine = two_lanes(Some((0, Trouble::Silent)));
    let keep = run_virtual(&mut machine, Nanos::from_millis(9));
    assert!(keep.of(&machine, "echo.number").iter().all(|(_, seen)| seen.freshness == 0));
}

#[test]
fn inside_a_lane_order_decides_and_feedback_is_one_tick_old() {
    let mut b = Builder::new();
    let lane = b.lane(LaneSpec::new("lane", Nanos::from_millis(1), 50)).unwrap();
    echo(&mut b, lane, "early", true);
    source(&mut b, lane, "source", None);
    echo(&mut b, lane, "late", false);
    b.bind("early.from", "source.number");
    b.bind("late.from", "source.number");
    let mut machine = b.build().unwrap();
    let keep = run_virtual(&mut machine, Nanos::from_millis(5));
    let early: Vec<f64> = keep.of(&machine, "early.number").iter().map(|s| s.1.value).collect();
    let late: Vec<f64> = keep.of(&machine, "late.number").iter().map(|s| s.1.value).collect();
    assert_eq!(early, [0.0, 0.0, 1.0, 2.0, 3.0]);
    assert_eq!(late, [0.0, 1.0, 2.0, 3.0, 4.0]);
}

fn refusal(wire: impl FnOnce(&mut Builder, LaneId) -> Result<(), Invalid>) -> Invalid {
    let mut b = Builder::new();
    let lane = b.lane(LaneSpec::new("lane", Nanos::from_millis(1), 50)).unwrap();
    match wire(&mut b, lane) {
        Err(invalid) => invalid,
        Ok(()) => b.build().err().expect("must be refused"),
    }
}

#[test]
fn a_wrong_wiring_is_refused_with_its_place() {
    let missing = refusal(|b, lane| {
        echo(b, lane, "echo", false);
        Ok(())
    });
    assert_eq!(missing.place, "wiring.echo.from");
    assert!(missing.what.contains("missing producer"), "{missing}");

    let nobody = refusal(|b, lane| {
        echo(b, lane, "echo", false);
        source(b, lane, "source", None);
        b.bind("echo.from", "sauce.number");
        Ok(())
    });
    assert!(nobody.what.contains("nobody produces `sauce.number`"), "{nobody}");
    assert!(nobody.remedy.contains("source.number"), "{nobody}");

    let twice = refusal(|b, lane| {
        source(b, lane, "source", None);
        b.task(lane, "source", |ports| {
            Ok(Box::new(Source { out: ports.output("number"), trouble: None }))
        })
    });
    assert_eq!(twice.place, "lane.lane.tasks.source");
    assert!(twice.what.contains("two producers"), "{twice}");

    let looped = refusal(|b, lane| {
        echo(b, lane, "echo", false);
        source(b, lane, "source", None);
        b.bind("echo.from", "source.number");
        Ok(())
    });
    assert!(looped.what.contains("loop"), "{looped}");

    let mistyped = refusal(|b, lane| {
        echo(b, lane, "echo", false);
        b.bind("echo.from", "lane.health");
        Ok(())
    });
    assert!(mistyped.what.contains("takes Number") && mistyped.what.contains("LaneHealth"));

    let stray = refusal(|b, lane| {
        source(b, lane, "source", None);
        b.bind("echo.from", "source.number");
        Ok(())
    });
    assert_eq!(stray.what, "there is no input `echo.from`");
    assert_eq!(Other::ZERO.value, 0);
}

#[test]
fn non_finite_values_never_pass_a_port() {
    let mut machine = two_lanes(Some((3, Trouble::NotANumber)));
    let keep = run_virtual(&mut machine, Nanos::from_millis(40));
    let values: Vec<f64> = keep.of(&machine, "source.number").iter().map(|s| s.1.value).collect();
    assert_eq!(values, [0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 7.0]);
    let faults = machine.figures().next().unwrap().1.faults;
    assert!(faults.contains(FaultCode::NotFinite));
}

#[test]
fn what_is_out_of_an_output_s_range_never_passes_it_and_the_last_good_value_stays() {
    let mut machine = two_lanes(Some((3, Trouble::OutOfRange)));
    let keep = run_virtual(&mut machine, Nanos::from_millis(40));
    let values: Vec<f64> = keep.of(&machine, "source.number").iter().map(|s| s.1.value).collect();
    assert_eq!(values, [0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 7.0]);
    let faults = machine.figures().next().unwrap().1.faults;
    assert!(faults.contains(FaultCode::OutOfRange) && !faults.contains(FaultCode::NotFinite));
    let seen = keep.of(&machine, "echo.number");
    assert!(seen.iter().all(|(_, seen)| seen.value >= 0.0), "the other lane kept the good one");
}

#[test]
fn a_panic_stops_its_own_task_only() {
    let mut machine = two_lanes(Some((3, Trouble::Panic)));
    let keep = run_virtual(&mut machine, Nanos::from_millis(100));
    assert_eq!(keep.of(&machine, "source.number").len(), 3);
    assert_eq!(keep.of(&machine, "echo.number").len(), 50, "the other lane goes on");
    assert!(machine.figures().next().unwrap().1.faults.contains(FaultCode::TaskPanicked));
}

/// Starts or refuses to, and counts how often it is stopped.
struct Starter {
    fault: Option<FaultCode>,
    stops: Arc<AtomicU32>,
}

impl Task for Starter {
    fn start(&mut self) -> Result<(), FaultCode> {
        self.fault.map_or(Ok(()), Err)
    }

    fn step(&mut self, _cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        Ok(())
    }

    fn stop(&mut self) {
        self.stops.fetch_add(1, Ordering::SeqCst);
    }
}

#[test]
fn a_task_that_refuses_to_start_is_named_and_those_that_had_started_are_stopped() {
    let ms = Nanos::from_millis(1);
    for refuses in [true, false] {
        let stops = Arc::new(AtomicU32::new(0));
        let mut builder = Builder::new();
        let lane = builder.lane(LaneSpec::new("servo", ms, 80)).unwrap();
        for (name, refuses) in [("first", false), ("second", refuses)] {
            let fault = refuses.then_some(FaultCode::TactileLost);
            let task = Starter { fault, stops: Arc::clone(&stops) };
            builder.task(lane, name, |_ports| Ok(Box::new(task))).unwrap();
        }
        let mut machine = builder.build().unwrap();
        let mut keep = Keep::default();
        // Every run that ends has stopped every task once, however often the machine is run.
        for runs in 1..=2 {
            let ended = virtual_time::run(&mut machine, ms, &AtomicBool::new(false), &mut keep);
            let expected = ("second".to_owned(), FaultCode::TactileLost);
            assert_eq!(ended.err(), refuses.then_some(expected));
            assert_eq!(stops.load(Ordering::SeqCst), 2 * runs);
        }
        // Live too, with jobs left and with none.
        for (until, runs) in [(ms * 3, 3), (ms * 3, 4)] {
            let terms = RunOptions { until, contract: Contract::Soft, pace: Pace::Slip };
            let live = live::run(&mut machine, terms, &AtomicBool::new(false), &mut keep);
            assert_eq!(live.is_err(), refuses, "{live:?}");
            assert_eq!(stops.load(Ordering::SeqCst), 2 * runs);
        }
        let jobs = machine.figures().map(|(_, figures)| figures.jobs).sum::<u64>();
        assert_eq!(jobs, if refuses { 0 } else { 3 });
    }
}

#[test]
fn a_fault_stands_in_the_lane_health_of_its_tick() {
    let mut machine = two_lanes(Some((3, Trouble::Fault)));
    let keep = run_virtual(&mut machine, Nanos::from_millis(40));
    let id = machine.catalog().find("slow.health").unwrap();
    let with_fault: Vec<u64> = keep
        .0
        .iter()
        .filter(|row| row.0 == id)
        .filter(|row| {
            let health = taktil_rtcore::status::LaneHealth::decode(&row.3).unwrap();
            FaultSet(health.faults).contains(FaultCode::TactileLost) && health.faulty_task == 1
        })
        .map(|row| row.1)
        .collect();
    assert_eq!(with_fault, [3]);
}

#[test]
fn jobs_do_not_allocate_and_one_that_does_is_counted() {
    let mut machine = two_lanes(None);
    let _ = run_virtual(&mut machine, Nanos::from_secs(20));
    for (spec, figures) in machine.figures() {
        assert_eq!(figures.allocations, 0, "{}", spec.name);
        assert_eq!(figures.jobs, if spec.name == "slow" { 4000 } else { 10_000 });
    }
    let mut machine = two_lanes(Some((7, Trouble::Allocate)));
    let _ = run_virtual(&mut machine, Nanos::from_millis(100));
    assert_eq!(machine.figures().next().unwrap().1.allocations, 2, "one malloc, one free");
}

fn live_twin(pace: Pace, until: Nanos) -> (Machine, Keep) {
    let mut machine = two_lanes(None);
    let mut seen = Keep::default();
    let terms = RunOptions { until, contract: Contract::Soft, pace };
    live::run(&mut machine, terms, &AtomicBool::new(false), &mut seen).unwrap();
    (machine, seen)
}

#[test]
fn live_and_virtual_write_the_same_values_at_the_same_ticks() {
    let until = Nanos::from_millis(200);
    for _ in 0..20 {
        let (machine, seen) = live_twin(Pace::Fixed, until);
        // On a shared machine a job may miss; then nothing is promised and the run says so.
        if machine.figures().any(|(_, f)| f.misses.total() + f.skipped > 0) {
            continue;
        }
        let expected = run_virtual(&mut two_lanes(None), until);
        assert_eq!(seen.by_signal(), expected.by_signal());
        return;
    }
    let _ =
        writeln!(std::io::stderr(), "SKIPPED: no live run of 200 ms without a miss in 20 attempts");
}

#[test]
fn where_the_world_waits_live_and_virtual_are_equal_misses_or_not() {
    let until = Nanos::from_millis(300);
    let expected = run_virtual(&mut two_lanes(None), until).by_signal();
    for _ in 0..3 {
        let (machine, seen) = live_twin(Pace::Slip, until);
        assert!(machine.figures().all(|(_, f)| f.skipped == 0 && f.values_dropped == 0));
        assert_eq!(seen.by_signal(), expected);
    }
}

/// Reads its own releases: each must be phase + k period, to the nanosecond.
struct Metronome {
    count: Output<Other>,
    phase: Nanos,
    jobs: u64,
}

impl Task for Metronome {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let exact = self.phase + cycle.dt * i64::try_from(self.jobs).unwrap_or(i64::MAX);
        self.jobs += 1;
        io.write(&self.count, Other { value: u32::from(cycle.release == exact) });
        if cycle.release == exact { Ok(()) } else { Err(FaultCode::Overrun) }
    }
}

#[test]
fn ten_million_jobs_are_released_to_the_nanosecond_without_a_heap_call() {
    /// Seen from outside: the instants in the records are the same.
    struct Exact {
        next: u64,
        signal: usize,
    }
    impl Observer for Exact {
        fn record(&mut self, record: &Record<'_>) {
            if record.signal == self.signal {
                let release =
                    Nanos(7) + Nanos::from_micros(2500) * i64::try_from(self.next).unwrap();
                assert_eq!((record.tick, record.release), (self.next, release));
                self.next += 1;
            }
        }
    }
    const JOB_COUNT: u64 = 10_000_000;
    let mut builder = Builder::new();
    let mut spec = LaneSpec::new("beat", Nanos::from_micros(2500), 50);
    spec.phase = Nanos(7);
    let lane = builder.lane(spec).unwrap();
    builder
        .task(lane, "metronome", |ports| {
            let count = ports.output("count");
            Ok(Box::new(Metronome { count, phase: Nanos(7), jobs: 0 }))
        })
        .unwrap();
    builder.recording(taktil_rtcore::record::Recording::Values);
    let mut machine = builder.build().unwrap();
    let signal = machine.catalog().find("metronome.count").unwrap();
    let mut exact = Exact { next: 0, signal };
    let until = Nanos::from_micros(2500) * i64::try_from(JOB_COUNT).unwrap();
    virtual_time::run(&mut machine, until, &AtomicBool::new(false), &mut exact).unwrap();
    let (_, figures) = machine.figures().next().unwrap();
    assert_eq!((figures.jobs, figures.allocations), (JOB_COUNT, 0));
    assert_eq!((exact.next, figures.faults), (JOB_COUNT, FaultSet::NONE));
}
