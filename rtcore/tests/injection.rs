//! Faults by plan in tasks and lanes: a task that panics or writes numbers that are not finite,
//! lanes that are late, take long, fall silent or lose time, on the schedule's own code in virtual
//! time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use taktil_hal::fault::{Fault, FaultPlan};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::status::LaneHealth;
use taktil_rtcore::{
    Builder, Cycle, FaultCode, FaultSet, Io, LaneSpec, Machine, Nanos, Output, Payload, Task,
    payload, virtual_time,
};

payload! {
    /// What the counter writes.
    pub struct Number {
        /// the tick
        pub value: f64,
    }
}

/// Writes its tick and counts how often it was stopped, with the tick after which that was.
struct Counter {
    output: Output<Number>,
    stopped: Arc<AtomicU64>,
}

impl Task for Counter {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        io.write(&self.output, Number { value: cycle.tick as f64 });
        Ok(())
    }

    fn stop(&mut self) {
        self.stopped.fetch_add(1, Ordering::SeqCst);
    }
}

const CYCLE_PERIOD: Nanos = Nanos::from_millis(10);

/// Two lanes of 10 ms with a counter each, with the faults of these texts.
fn machine(faults: &[&str]) -> (Machine, Arc<AtomicU64>) {
    let stopped = Arc::new(AtomicU64::new(0));
    let mut builder = Builder::new();
    for name in ["one", "two"] {
        let lane = builder.lane(LaneSpec::new(name, CYCLE_PERIOD, 50)).unwrap();
        let stopped = Arc::clone(&stopped);
        let make = move |ports: &mut taktil_rtcore::Ports| {
            let output = ports.output("number");
            Ok(Box::new(Counter { output, stopped }) as Box<dyn Task>)
        };
        builder.task(lane, &format!("counter_{name}"), make).unwrap();
    }
    let mut machine = builder.build().unwrap();
    let plan = faults.iter().map(|text| text.parse::<Fault>().unwrap()).collect();
    machine.inject(&FaultPlan::new(plan), "world").unwrap();
    (machine, stopped)
}

/// Numbers of the first lane by tick, and the healths of both.
#[derive(Default)]
struct Seen {
    signals: [Option<usize>; 3],
    numbers: Vec<(u64, f64)>,
    health: [Vec<(u64, LaneHealth)>; 2],
}

impl Observer for Seen {
    fn record(&mut self, record: &Record<'_>) {
        let signal = Some(record.signal);
        if signal == self.signals[0] {
            let number = Number::decode(record.body).unwrap();
            self.numbers.push((record.tick, number.value));
        }
        for lane in 0..2 {
            if signal == self.signals[1 + lane] {
                let health = LaneHealth::decode(record.body).unwrap();
                self.health[lane].push((record.tick, health));
            }
        }
    }
}

impl Seen {
    fn of(machine: &mut Machine, until: Nanos) -> Seen {
        let find = |name: &str| machine.catalog().find(name);
        let signals = [find("counter_one.number"), find("one.health"), find("two.health")];
        let mut seen = Seen { signals, ..Seen::default() };
        let stop = AtomicBool::new(false);
        virtual_time::run(machine, until, &stop, &mut seen).unwrap();
        seen
    }

    fn ticks(&self) -> Vec<u64> {
        self.numbers.iter().map(|number| number.0).collect()
    }

    /// The first tick at which a lane's health has a fault.
    fn first(&self, lane: usize, fault: FaultCode) -> Option<u64> {
        let has = |entry: &&(u64, LaneHealth)| FaultSet(entry.1.faults).contains(fault);
        self.health[lane].iter().find(has).map(|entry| entry.0)
    }
}

fn run(faults: &[&str], ms: i64) -> Seen {
    Seen::of(&mut machine(faults).0, Nanos::from_millis(ms))
}

#[test]
fn lateness_within_the_deadline_changes_nothing() {
    let plain = run(&[], 500);
    let late = run(&["kind=lateness target=lane.one value=0.004"], 500);
    assert_eq!(late.numbers, plain.numbers);
    assert_eq!(late.health, plain.health);
    assert_eq!(plain.ticks(), (0..50).collect::<Vec<u64>>());
}

#[test]
fn one_long_job_is_a_miss_and_many_are_a_storm() {
    let once = run(&["kind=overrun target=lane.one at=0.1 for=0.005 value=0.025"], 500);
    assert_eq!(once.first(0, FaultCode::Overrun), Some(12), "told to the next job that runs");
    assert!(!once.ticks().contains(&11), "job 11 was due while job 10 ran");
    assert_eq!(once.first(0, FaultCode::OverrunStorm), None);
    let storm = run(&["kind=overrun target=lane.one at=0.1 for=0.2 value=0.012"], 500);
    let told = storm.first(0, FaultCode::OverrunStorm).unwrap();
    assert!((12..20).contains(&told), "{told}");
    assert!(storm.first(1, FaultCode::OverrunStorm).is_some(), "the other lane hears of it");
}

#[test]
fn a_lane_that_falls_silent_is_seen_by_the_other_and_comes_back_in_phase() {
    let seen = run(&["kind=silence target=lane.one at=0.1 for=0.25"], 600);
    // Silent after ten periods.
    let told = seen.first(1, FaultCode::LaneSilent).unwrap();
    assert!((19..=21).contains(&told), "{told}");
    let ticks = seen.ticks();
    assert!(!ticks.contains(&20) && ticks.contains(&10), "job 10 begins when the silence ends");
    assert!(ticks.contains(&36) && ticks.contains(&59), "{ticks:?}");
    assert!(seen.numbers.iter().all(|(tick, value)| *value == *tick as f64), "the phase is kept");
}

#[test]
fn a_gap_of_the_clock_befalls_every_lane_and_none_is_silent() {
    let seen = run(&["kind=clock_gap target=clock at=0.1 value=0.2"], 600);
    assert!(!seen.ticks().contains(&20));
    for lane in 0..2 {
        assert_eq!(seen.first(lane, FaultCode::LaneSilent), None, "all stood still together");
        assert!(seen.first(lane, FaultCode::OverrunStorm).is_some());
    }
}

#[test]
fn a_task_that_panics_is_taken_out_of_its_lane() {
    let (mut machine, stopped) = machine(&["kind=panic target=task.counter_one at=0.1"]);
    let seen = Seen::of(&mut machine, Nanos::from_millis(500));
    assert_eq!(seen.first(0, FaultCode::TaskPanicked), Some(10));
    assert_eq!(seen.numbers.last().map(|number| number.0), Some(9));
    assert_eq!(seen.first(1, FaultCode::TaskPanicked), None);
    assert!(stopped.load(Ordering::SeqCst) >= 2, "each task is stopped");
}

#[test]
fn a_number_that_is_not_finite_is_refused_at_the_port() {
    let seen = run(&["kind=not_finite target=task.counter_one at=0.1 for=0.02"], 300);
    assert_eq!(seen.first(0, FaultCode::NotFinite), Some(10));
    let ticks = seen.ticks();
    assert!(!ticks.contains(&10) && !ticks.contains(&11) && ticks.contains(&12), "{ticks:?}");
}

#[test]
fn what_is_not_there_is_refused_with_its_key() {
    for (text, place) in [
        ("kind=panic target=task.nobody", "fault[0].target"),
        ("kind=silence target=lane.nowhere", "fault[0].target"),
        ("kind=jump target=task.counter_one value=1", "fault[0].kind"),
        ("kind=panic target=lane.one", "fault[0].kind"),
        ("kind=panic target=clock", "fault[0].kind"),
    ] {
        let plan = FaultPlan::new(vec![text.parse().unwrap()]);
        let refused = machine(&[]).0.inject(&plan, "world").unwrap_err();
        assert_eq!(refused.place, place, "{text}");
    }
    let spared = FaultPlan::new(vec!["kind=silence target=lane.one".parse().unwrap()]);
    assert!(machine(&[]).0.inject(&spared, "one").is_err(), "the world is never late");
}
