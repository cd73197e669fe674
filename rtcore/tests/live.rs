//! Tests the live executor on the kernel of this machine. The tests check order and counts, never
//! times.

use std::io::Write;
use std::process::Command;
use std::sync::atomic::AtomicBool;

use taktil_rtcore::contract::{Demands, Weight};
use taktil_rtcore::guard::{self, CountingAllocator};
use taktil_rtcore::live::{self, Contract, Pace, RunObserver, RunOptions, RunReport};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Builder, Cycle, FaultCode, Guard, Io, LaneSpec, Machine, Nanos, Output, Task, payload,
    virtual_time,
};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

payload! {
    /// A number.
    pub struct Number {
        /// value
        pub value: u64,
    }
}

/// Writes its tick; panics at one.
struct Counter {
    out: Output<Number>,
    panic_at: Option<u64>,
    way: Way,
}

/// How a task panics.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    /// With a payload of its own.
    Payload,
    /// With a text that needs no formatting.
    Words,
    /// By an index that is out of bounds, whose text the standard library makes.
    Index,
    /// By `unwrap`, which writes out the error.
    Unwrap,
}

impl Way {
    fn go(self) {
        match self {
            Way::Payload => std::panic::panic_any(Spiteful),
            Way::Words => panic!("on purpose"),
            Way::Index => {
                let place = std::hint::black_box(3);
                std::hint::black_box([0u8; 3][place]);
            }
            Way::Unwrap => {
                let refused: Result<(), _> = "on purpose".parse::<i32>().map(drop);
                refused.unwrap();
            }
        }
    }
}

/// A payload whose end is a panic of its own.
struct Spiteful;

impl Drop for Spiteful {
    fn drop(&mut self) {
        panic!("on purpose, once more");
    }
}

impl Task for Counter {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        if self.panic_at == Some(cycle.tick) {
            self.way.go();
        }
        io.write(&self.out, Number { value: cycle.tick });
        Ok(())
    }
}

/// Counts records.
#[derive(Default)]
struct Count(u64);

impl Observer for Count {
    fn record(&mut self, _record: &Record<'_>) {
        self.0 += 1;
    }
}

impl RunObserver for Count {}

/// Takes longer for a record than the lane for a job.
#[derive(Default)]
struct SlowObserver {
    has_begun: bool,
    looks: u32,
}

impl Observer for SlowObserver {
    fn record(&mut self, _record: &Record<'_>) {
        self.has_begun = true;
        std::thread::sleep(std::time::Duration::from_micros(1100));
    }
}

impl RunObserver for SlowObserver {
    fn on_time(&mut self, now: Nanos) {
        self.looks += u32::from(self.has_begun && now < Nanos::from_millis(900));
    }
}

fn machine(guard: Option<Guard>, panics: &[Option<u64>]) -> Machine {
    let mut builder = Builder::new();
    let spec = LaneSpec { guard, ..LaneSpec::new("lane", Nanos::from_millis(1), 50) };
    add_lane(&mut builder, spec, panics);
    builder.build().unwrap()
}

fn two_lanes(a: [Option<u64>; 2], b: [Option<u64>; 2]) -> Machine {
    let mut builder = Builder::new();
    add_lane(&mut builder, LaneSpec::new("a", Nanos::from_millis(1), 50), &a);
    add_lane(&mut builder, LaneSpec::new("b", Nanos::from_millis(1), 50), &b);
    builder.build().unwrap()
}

fn add_lane(builder: &mut Builder, spec: LaneSpec, panics: &[Option<u64>]) {
    add_panicking_lane(builder, spec, panics, Way::Payload);
}

fn add_panicking_lane(builder: &mut Builder, spec: LaneSpec, panics: &[Option<u64>], way: Way) {
    let name = spec.name.clone();
    let lane = builder.lane(spec).unwrap();
    for (index, panic_at) in panics.iter().enumerate() {
        builder
            .task(lane, &format!("{name}_counter{index}"), |ports| {
                Ok(Box::new(Counter { out: ports.output("number"), panic_at: *panic_at, way }))
            })
            .unwrap();
    }
}

fn run(machine: &mut Machine, pace: Pace) -> RunReport {
    let terms = RunOptions { until: Nanos::from_millis(300), contract: Contract::Soft, pace };
    live::run(machine, terms, &AtomicBool::new(false), &mut Count::default()).unwrap()
}

#[test]
fn a_guard_never_releases_early_and_stays_in_its_bound() {
    let period = Nanos::from_millis(1);
    let guard = Guard::from_cpu_share(0.2, period).unwrap();
    for pace in [Pace::Fixed, Pace::Slip] {
        let mut machine = machine(Some(guard), &[None]);
        run(&mut machine, pace);
        let (_, figures) = machine.figures().next().unwrap();
        let found = figures.guard.expect("the lane has a guard");
        assert_eq!(found.early, 0);
        assert!(figures.jobs > 0);
        // Jobs were waited for by spinning, and the margin is what the bound allows.
        assert!(found.spun > Nanos::ZERO, "{found:?}");
        assert!(found.margin <= guard.spin_max, "{found:?}");
        assert_eq!(figures.allocations, 0);
        if pace == Pace::Slip {
            assert_eq!(figures.jobs, 300, "a slipping schedule leaves no job out");
        }
    }
}

#[test]
fn who_takes_records_more_slowly_than_they_come_is_told_the_time_all_the_same() {
    let mut observer = SlowObserver::default();
    let options =
        RunOptions { until: Nanos::from_millis(1000), contract: Contract::Soft, pace: Pace::Fixed };
    let never = AtomicBool::new(false);
    live::run(&mut machine(None, &[None]), options, &never, &mut observer).unwrap();
    assert!(observer.looks >= 2, "{} looks", observer.looks);
}

#[test]
fn the_default_guard_spins_at_a_fixed_priority_only() {
    let period = Nanos::from_millis(1);
    let mut spec = LaneSpec::new("lane", period, 50);
    spec.guard = Some(Guard::when_schedulable(period));
    spec.cpu = Some(0);
    spec.budgets.insert("lane_counter0".to_owned(), Nanos::from_micros(100));
    let mut builder = Builder::new();
    add_lane(&mut builder, spec, &[None]);
    let mut machine = builder.build().unwrap();
    let account = run(&mut machine, Pace::Slip);
    let (_, figures) = machine.figures().next().unwrap();
    assert_eq!(figures.guard.is_some(), account.attestation.lanes[0].priority > 0);
}

#[test]
fn without_a_guard_nothing_spins() {
    let mut machine = machine(None, &[None]);
    run(&mut machine, Pace::Slip);
    let (_, figures) = machine.figures().next().unwrap();
    assert_eq!(figures.guard, None);
    assert_eq!(figures.jobs, 300);
    assert_eq!(figures.lateness_ns.len(), 300);
    assert_eq!(figures.awake_ns.len(), 299, "from the second wait on");
    let read = figures.evidence_ns.len();
    assert!((299 / 16..=299).contains(&read), "evidence was read in {read} cycles");
}

#[test]
fn what_a_lane_runs_with_is_read_back() {
    let mut machine = machine(None, &[None]);
    let attestation = run(&mut machine, Pace::Slip).attestation;
    let lane = &attestation.lanes[0];
    assert_eq!(attestation.lanes.len(), 1);
    assert_eq!(lane.lane, "lane");
    assert!(!lane.cpus.is_empty());
    let refused = attestation.missing.iter().any(|line| line.contains("SCHED_FIFO"));
    let found = (lane.policy.as_str(), lane.priority);
    assert_eq!(found == ("SCHED_FIFO", 50), !refused, "{attestation:?}");
    assert!(attestation.facts.resident_kib.is_some_and(|kib| kib > 0));
    assert!(attestation.facts.rtprio.is_some());
    assert_eq!(attestation.facts.rows().len(), 13);
}

#[test]
fn an_item_that_is_demanded_and_missing_refuses_the_run_before_the_first_job() {
    let mut machine = machine(None, &[None]);
    let found = live::trial_attestation(&machine, Contract::Soft);
    assert_eq!(found.lanes.len(), 1);
    assert!(found.refused().next().is_none(), "soft refuses nothing");
    let Some(short) = found.shortfalls.iter().find(|short| !short.item.is_core()) else {
        let _ = writeln!(std::io::stderr(), "SKIPPED: nothing is missing on this machine");
        return;
    };
    let contract = Contract::Items(Demands::SOFT.with(short.item, Weight::Hard));
    let terms = RunOptions { until: Nanos::from_millis(50), contract, pace: Pace::Fixed };
    let mut count = Count::default();
    let outcome = live::run(&mut machine, terms, &AtomicBool::new(false), &mut count);
    let text = outcome.unwrap_err().to_string();
    let line = format!("\n  {}: {}; wanted ", short.item.name(), short.found);
    assert!(text.contains("no output was armed") && text.contains(&line), "{text}");
    assert_eq!((count.0, machine.figures().next().unwrap().1.jobs), (0, 0));
}

#[test]
fn an_observer_that_panics_ends_the_run_and_not_after_its_time() {
    struct Impatient(u32);
    impl Observer for Impatient {
        fn record(&mut self, _record: &Record<'_>) {
            self.0 += 1;
            assert!(self.0 < 20, "on purpose");
        }
    }
    impl RunObserver for Impatient {}
    let mut machine = machine(None, &[None]);
    // The run would take a day if the lanes did not end it.
    let until = Nanos::from_secs(86_400);
    let terms = RunOptions { until, contract: Contract::Soft, pace: Pace::Fixed };
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        live::run(&mut machine, terms, &AtomicBool::new(false), &mut Impatient(0))
    }));
    assert!(outcome.is_err());
    let (_, figures) = machine.figures().next().unwrap();
    assert!(figures.jobs > 0);
}

/// Heap calls that one panic may cost.
const PANIC_HEAP_CALLS: u64 = 2;

const CHILD: &str = "TAKTIL_PANIC_CHILD";

/// The child of the next test; alone it does nothing.
#[test]
fn child_that_panics_in_a_job() {
    if std::env::var_os(CHILD).is_none() {
        return;
    }
    let mut machine = machine(None, &[Some(20), Some(30), None]);
    let account = run(&mut machine, Pace::Slip);
    let (_, figures) = machine.figures().next().unwrap();
    assert_eq!(figures.jobs, 300, "the lane goes on");
    // A payload of one's own takes itself and its exception from the heap, and nothing more: no
    // text is made of it, nothing is printed, no trace is taken.
    assert!(guard::installed());
    assert!(figures.allocations <= 2 * PANIC_HEAP_CALLS, "{} heap calls", figures.allocations);
    println!("longest job, a panic or not: {} us", figures.execution_ns.max() / 1000);
    assert!(figures.faults.contains(FaultCode::TaskPanicked));
    assert_eq!(account.panics.len(), 1, "the first place of the lane");
    assert!(account.panics[0].contains("tests/live.rs:"), "{:?}", account.panics);
    // Outside jobs a panic still prints its message.
    assert!(std::panic::catch_unwind(|| panic!("words outside jobs")).is_err());
}

/// Panics of each kind that people write, one lane each: the standard library makes their text
/// before any hook hears of them, with so many heap calls and no more.
#[test]
fn child_that_panics_as_people_do() {
    if std::env::var_os(CHILD).is_none() {
        return;
    }
    for (way, heap_calls) in [(Way::Words, 3), (Way::Index, 5), (Way::Unwrap, 5)] {
        let mut builder = Builder::new();
        let spec = LaneSpec::new("lane", Nanos::from_millis(1), 50);
        add_panicking_lane(&mut builder, spec, &[Some(20), Some(30), None], way);
        let mut machine = builder.build().unwrap();
        let account = run(&mut machine, Pace::Slip);
        let (_, figures) = machine.figures().next().unwrap();
        assert_eq!(figures.jobs, 300, "{way:?}: the lane goes on");
        let (found, longest) = (figures.allocations, figures.execution_ns.max() / 1000);
        println!("{way:?}: {found} heap calls in two panics, longest job {longest} us");
        assert!(found <= 2 * heap_calls, "{way:?}: {found} heap calls");
        assert!(found > 2 * PANIC_HEAP_CALLS, "{way:?}: no text is made any more, say so");
        assert!(account.panics[0].contains("live.rs:"), "{way:?}: {:?}", account.panics);
    }
    assert!(std::panic::catch_unwind(|| panic!("words outside jobs")).is_err());
}

/// The other child: the same in virtual time, where all lanes share a thread.
#[test]
fn child_that_panics_in_virtual_time() {
    if std::env::var_os(CHILD).is_none() {
        return;
    }
    let mut machine = two_lanes([Some(20), Some(30)], [None, Some(40)]);
    let until = Nanos::from_millis(300);
    virtual_time::run(&mut machine, until, &AtomicBool::new(false), &mut Count::default()).unwrap();
    for (_, figures) in machine.figures() {
        assert_eq!(figures.jobs, 300, "the lane goes on");
        assert!(figures.faults.contains(FaultCode::TaskPanicked));
    }
    let panics: Vec<&str> = machine.panics().collect();
    assert_eq!(panics.len(), 2, "the first place of each lane: {panics:?}");
    assert!(panics[0].starts_with("lane a: panicked at "), "{panics:?}");
    assert!(panics[1].starts_with("lane b: panicked at "), "{panics:?}");
    assert!(std::panic::catch_unwind(|| panic!("words outside jobs")).is_err());
}

#[test]
fn a_panic_in_a_job_is_silent_and_the_lane_continues() {
    assert_silent("child_that_panics_in_a_job");
}

#[test]
fn a_panic_in_virtual_time_is_as_silent() {
    assert_silent("child_that_panics_in_virtual_time");
}

#[test]
fn the_text_of_a_panic_in_a_job_costs_few_heap_calls_and_is_not_said() {
    assert_silent("child_that_panics_as_people_do");
}

fn assert_silent(child: &str) {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", child, "--nocapture"])
        .env(CHILD, "1")
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}\n{}", String::from_utf8_lossy(&output.stdout));
    assert_eq!(stderr.matches("panicked").count(), 1, "{stderr}");
    assert!(stderr.contains("words outside jobs"), "{stderr}");
    assert!(!stderr.contains("on purpose"), "{stderr}");
}

/// Takes its time when it hears of the run's time for the first few times.
#[derive(Default)]
struct SlowToHear {
    announced: u32,
    slow: u32,
}

impl Observer for SlowToHear {
    fn record(&mut self, _record: &Record<'_>) {}
}

impl RunObserver for SlowToHear {
    fn on_epoch(&mut self, _origin: Nanos) {
        self.announced += 1;
        if self.announced <= self.slow {
            std::thread::sleep(std::time::Duration::from_millis(120));
        }
    }
}

#[test]
fn an_observer_that_hears_late_costs_no_job() {
    let mut observer = SlowToHear { slow: 3, ..SlowToHear::default() };
    let mut machine = machine(None, &[None]);
    let until = Nanos::from_millis(50);
    let options = RunOptions { until, contract: Contract::Soft, pace: Pace::Fixed };
    live::run(&mut machine, options, &AtomicBool::new(false), &mut observer).unwrap();
    assert!(observer.announced >= 4, "told {} times", observer.announced);
}
