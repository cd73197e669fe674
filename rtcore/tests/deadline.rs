//! Tests lanes scheduled by deadline: reservations are read back, impossible ones are refused with
//! the numbers, at load or by the kernel, and a job that uses more than it declared is throttled.
//! The tests need the right to real-time scheduling; without it they say so and test the rest.
#![expect(clippy::disallowed_types, reason = "tests wait for each other, lanes do not")]

use std::io::Write;
use std::sync::atomic::AtomicBool;
use std::sync::{Barrier, Mutex, MutexGuard, PoisonError};

use taktil_rtcore::analysis::{Bound, Demand, analyse};
use taktil_rtcore::live::{self, Contract, Pace, RunObserver, RunOptions, RunReport};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Allowance, Builder, Cycle, FaultCode, Invalid, Io, LaneSpec, Machine, Nanos, Policy,
    Reservation, Task, linux,
};

/// Computes for so long in each job.
struct Burn(Nanos);

impl Task for Burn {
    fn step(&mut self, _cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        let end = linux::thread_cpu_time() + self.0;
        while linux::thread_cpu_time() < end {
            std::hint::spin_loop();
        }
        Ok(())
    }
}

struct Nobody;

impl Observer for Nobody {
    fn record(&mut self, _record: &Record<'_>) {}
}

impl RunObserver for Nobody {}

const LANE_PERIOD: Nanos = Nanos::from_millis(5);

fn us(us: i64) -> Nanos {
    Nanos::from_micros(us)
}

fn by_deadline(name: &str) -> LaneSpec {
    LaneSpec { policy: Policy::Deadline, ..LaneSpec::new(name, LANE_PERIOD, 99) }
}

/// A machine of one lane, whose task declares `budget` and computes for `burn`.
fn machine(mut spec: LaneSpec, budget: Option<Nanos>, burn: Nanos) -> Result<Machine, Invalid> {
    spec.budgets.extend(budget.map(|budget| ("burn".to_owned(), budget)));
    let mut builder = Builder::new();
    let lane = builder.lane(spec)?;
    builder.task(lane, "burn", |_| Ok(Box::new(Burn(burn))))?;
    builder.build()
}

fn run(machine: &mut Machine, jobs: i64) -> RunReport {
    let terms =
        RunOptions { until: LANE_PERIOD * jobs, contract: Contract::Soft, pace: Pace::Fixed };
    live::run(machine, terms, &AtomicBool::new(false), &mut Nobody).unwrap()
}

/// Reservations are of the whole computer: one test at a time.
fn alone() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whether this process may reserve anything; says so if not.
fn may_reserve() -> bool {
    let little = Reservation { runtime: us(20), deadline: LANE_PERIOD, period: LANE_PERIOD };
    let granted = std::thread::spawn(move || linux::set_deadline(&little)).join().unwrap();
    if let Err(why) = &granted {
        let _ = writeln!(std::io::stderr(), "SKIPPED: no reservation can be tried here: {why}");
    }
    granted.is_ok()
}

#[test]
fn what_is_reserved_is_the_budget_with_its_overhead_and_is_read_back() {
    let _alone = alone();
    if !may_reserve() {
        return;
    }
    let mut machine = machine(by_deadline("servo"), Some(us(500)), us(50)).unwrap();
    let account = run(&mut machine, 60);
    let grant = &account.attestation.lanes[0];
    assert_eq!((grant.policy.as_str(), grant.priority), ("SCHED_DEADLINE", 0));
    let runtime = us(500) + Allowance::default().overhead;
    let wanted = Reservation { runtime, deadline: LANE_PERIOD, period: LANE_PERIOD };
    assert_eq!(grant.reserved, Some(wanted));
    let missing = &account.attestation.missing;
    assert!(missing.iter().all(|missing| !missing.contains("servo")), "{missing:?}");
    let (_, figures) = machine.figures().next().unwrap();
    assert_eq!(figures.jobs + figures.skipped, 60);
}

#[test]
fn a_lane_of_fixed_priority_reserves_nothing() {
    let _alone = alone();
    let mut machine = machine(LaneSpec::new("servo", LANE_PERIOD, 50), None, us(50)).unwrap();
    let grant = &run(&mut machine, 5).attestation.lanes[0];
    assert_eq!(grant.reserved, None);
    assert!(grant.policy == "SCHED_FIFO" || grant.policy == "SCHED_OTHER", "{}", grant.policy);
}

#[test]
fn a_job_beyond_its_declared_budget_is_throttled_and_reported() {
    let _alone = alone();
    if !may_reserve() {
        return;
    }
    let mut machine = machine(by_deadline("servo"), Some(us(500)), us(2000)).unwrap();
    run(&mut machine, 80);
    let (_, figures) = machine.figures().next().unwrap();
    let misses = &figures.misses;
    assert!(misses.throttled > 0 && misses.throttled * 2 > misses.total(), "{misses:?}");
}

#[test]
fn a_lane_on_one_cpu_is_refused_with_the_way_out() {
    let _alone = alone();
    let cpus = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    if !may_reserve() || cpus < 2 {
        return;
    }
    let spec = LaneSpec { cpu: Some(0), ..by_deadline("servo") };
    let mut machine = machine(spec, Some(us(500)), us(50)).unwrap();
    let missing = run(&mut machine, 5).attestation.missing;
    let Some(said) = missing.iter().find(|missing| missing.contains("SCHED_DEADLINE")) else {
        let _ =
            writeln!(std::io::stderr(), "SKIPPED: here CPU 0 is a cpuset of its own: {missing:?}");
        return;
    };
    for word in ["lane servo", "CPUs [0] alone", "leave `cpu` out", "cpuset.cpus.partition"] {
        assert!(said.contains(word), "no `{word}` in {said}");
    }
}

#[test]
fn what_the_kernel_cannot_admit_is_refused_with_the_numbers() {
    let _alone = alone();
    if !may_reserve() {
        return;
    }
    // As many sleepers as it takes until nothing is left to reserve.
    let most = 2 * std::thread::available_parallelism().map_or(1, std::num::NonZero::get) + 2;
    let period = Nanos::from_millis(100);
    let hog = Reservation { runtime: Nanos::from_millis(60), deadline: period, period };
    let (asked, over) = (Barrier::new(most + 1), Barrier::new(most + 1));
    let missing = std::thread::scope(|scope| {
        for _ in 0..most {
            scope.spawn(|| {
                let _ = linux::set_deadline(&hog);
                asked.wait();
                over.wait();
            });
        }
        asked.wait();
        let mut machine = machine(by_deadline("servo"), Some(us(4500)), us(50)).unwrap();
        let missing = run(&mut machine, 5).attestation.missing;
        over.wait();
        missing
    });
    let said = missing.iter().find(|missing| missing.contains("SCHED_DEADLINE")).unwrap();
    for word in ["lane servo", "4505 us within 5 ms of every 5 ms (90.1 %)", "do not fit beside"] {
        assert!(said.contains(word), "no `{word}` in {said}");
    }
}

#[test]
fn a_lane_without_budgets_or_with_a_period_of_no_use_is_refused_at_load() {
    let place = |spec, budget| machine(spec, budget, us(1)).map(drop).unwrap_err().place;
    assert_eq!(place(by_deadline("servo"), None), "lane.servo.budget_us");
    assert_eq!(place(by_deadline("servo"), Some(us(4999))), "lane.servo.budget_us", "no overhead");
    let spec = |period| {
        let spec = LaneSpec::new("servo", period, 99);
        LaneSpec { policy: Policy::Deadline, ..spec }
    };
    assert_eq!(place(spec(us(50)), Some(us(10))), "lane.servo.period_us");
    assert_eq!(place(spec(Nanos::from_secs(5)), Some(us(10))), "lane.servo.period_us");
}

#[test]
fn deadline_lanes_are_judged_together_and_before_all_fixed_priorities() {
    let demand = |spec: LaneSpec, budget_us: i64| Demand { spec, budget: Some(us(budget_us)) };
    let exact = Allowance { release_jitter: Nanos::ZERO, overhead: Nanos::ZERO };
    let fixed = LaneSpec::new("fixed", LANE_PERIOD * 2, 99);
    let lanes = [
        demand(by_deadline("a"), 2000),
        demand(by_deadline("b"), 2500),
        demand(fixed.clone(), 500),
    ];
    let judged = analyse(&lanes, exact);
    assert_eq!(judged.refusal(), None);
    assert_eq!(judged.lanes[0].response(), Some(Bound::Within(LANE_PERIOD)));
    assert_eq!(judged.lanes[0].interfering, ["b"], "no fixed priority comes before it");
    // 500 us of its own, each deadline lane once: they fit before the second release.
    assert_eq!(judged.lanes[2].response(), Some(Bound::Within(us(5000))));
    assert_eq!(judged.lanes[2].interfering, ["a", "b"]);
    // 110 % of a CPU, which two CPUs may not give to two lanes that may both want one.
    let judged = analyse(&[demand(by_deadline("a"), 3000), demand(by_deadline("b"), 2500)], exact);
    let refused = judged.refusal().unwrap().to_string();
    for word in ["lane.a: ", "110.0 % of a CPU", "`b` (2500 us every 5 ms, by deadline)"] {
        assert!(refused.contains(word), "no `{word}` in {refused}");
    }
    // Apart, on CPUs of their own, both fit.
    let on = |name, cpu| LaneSpec { cpu: Some(cpu), ..by_deadline(name) };
    let apart = [demand(on("a", 0), 3000), demand(on("b", 1), 2500)];
    assert_eq!(analyse(&apart, exact).refusal(), None);
}
