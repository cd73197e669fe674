//! Compares the response-time analysis with a brute-force simulation of the preemptive schedule,
//! and tests its errors and the measured times of tasks.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

use taktil_rtcore::analysis::{Bound, Demand, LaneResponse, Verdict, analyse};
use taktil_rtcore::guard::CountingAllocator;
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Allowance, Builder, Cycle, FaultCode, Guard, GuardCondition, Invalid, Io, LaneSpec, Machine,
    Nanos, Task, linux, virtual_time,
};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Knuth's linear congruential generator: the same sets in every run.
struct Lcg(u64);

impl Lcg {
    fn below(&mut self, end: i64) -> i64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963);
        i64::try_from(self.0 >> 33).unwrap() % end
    }
}

/// Periods with a common multiple of 120.
const LANE_PERIODS_NS: [i64; 10] = [4, 5, 6, 8, 10, 12, 15, 20, 24, 30];
const HYPERPERIOD_NS: i64 = 120;

fn demand(name: usize, period: i64, budget: i64, priority: u8) -> Demand {
    let spec = LaneSpec::new(format!("l{name}"), Nanos(period), priority);
    Demand { spec, budget: Some(Nanos(budget)) }
}

/// Two to five lanes; utilisation anywhere from idle to too much.
fn random_lanes(random: &mut Lcg, phases: bool, equal: bool) -> Vec<Demand> {
    let mut lanes = Vec::new();
    let count = usize::try_from(2 + random.below(4)).unwrap();
    for index in 0..count {
        let period = LANE_PERIODS_NS[usize::try_from(random.below(10)).unwrap()];
        let budget = 1 + random.below((period * 2 / i64::try_from(count).unwrap()).max(1));
        let priority = if equal { 1 + random.below(3) } else { 90 - i64::try_from(index).unwrap() };
        let mut lane = demand(index, period, budget, u8::try_from(priority).unwrap());
        lane.spec.deadline = Nanos(period - random.below(period / 3));
        if phases {
            lane.spec.phase = Nanos(random.below(period));
        }
        lanes.push(lane);
    }
    lanes
}

fn exact(release_jitter: i64) -> Allowance {
    Allowance { release_jitter: Nanos(release_jitter), overhead: Nanos::ZERO }
}

struct Job {
    lane: usize,
    nominal: i64,
    arrival: i64,
    left: i64,
}

/// The longest response of each lane in three hyperperiods, nanosecond by nanosecond: at each one
/// the highest priority that has arrived runs; among equals the one that arrived first. What has
/// not ended by then counts with its age.
fn simulate(lanes: &[Demand], mut late: impl FnMut(usize, i64) -> i64) -> Vec<i64> {
    let horizon = 3 * HYPERPERIOD_NS;
    let mut jobs = Vec::new();
    for (lane, demand) in lanes.iter().enumerate() {
        let mut nominal = demand.spec.phase.0;
        while nominal < horizon {
            let arrival = nominal + late(lane, nominal);
            jobs.push(Job { lane, nominal, arrival, left: demand.budget.unwrap().0 });
            nominal += demand.spec.period.0;
        }
    }
    let mut worst = vec![0; lanes.len()];
    // Time enough to finish what was released, when it can be finished at all.
    for now in 0..2 * horizon {
        let chosen =
            jobs.iter_mut().filter(|job| job.arrival <= now && job.left > 0).min_by_key(|job| {
                let first = std::cmp::Reverse(lanes[job.lane].spec.priority);
                (first, job.arrival, job.lane, job.nominal)
            });
        if let Some(job) = chosen {
            job.left -= 1;
            if job.left == 0 {
                worst[job.lane] = worst[job.lane].max(now + 1 - job.nominal);
            }
        }
    }
    for job in jobs.iter().filter(|job| job.left > 0) {
        worst[job.lane] = worst[job.lane].max(2 * horizon - job.nominal);
    }
    worst
}

fn within(bound: Option<Bound>) -> i64 {
    match bound {
        Some(Bound::Within(span)) => span.0,
        other => panic!("no bound: {other:?}"),
    }
}

#[test]
fn a_synchronous_start_without_jitter_is_the_worst_case_itself() {
    let mut random = Lcg(1);
    let (mut met, mut missed) = (0, 0);
    for _ in 0..400 {
        let lanes = random_lanes(&mut random, false, false);
        let seen = simulate(&lanes, |_, _| 0);
        for (lane, seen) in analyse(&lanes, exact(0)).lanes.iter().zip(seen) {
            if lane.verdict == Verdict::Meets {
                assert_eq!(within(lane.any_phase), seen, "{lanes:?}");
                assert_eq!(within(lane.with_phases), seen, "{lanes:?}");
                met += 1;
            } else {
                assert!(seen > lane.deadline.0, "a false alarm: {lane:?} took {seen}");
                missed += 1;
            }
        }
    }
    assert!(met > 300 && missed > 100, "{met} met, {missed} missed: the sets say nothing");
}

#[test]
fn with_phases_the_longest_response_is_found_exactly() {
    let mut random = Lcg(2);
    let (mut met, mut tighter) = (0, 0);
    for _ in 0..400 {
        let lanes = random_lanes(&mut random, true, false);
        let seen = simulate(&lanes, |_, _| 0);
        for (lane, seen) in analyse(&lanes, exact(0)).lanes.iter().zip(seen) {
            if lane.verdict != Verdict::Meets {
                assert!(seen > lane.deadline.0, "a false alarm: {lane:?} took {seen}");
                continue;
            }
            assert_eq!(within(lane.with_phases), seen, "{lanes:?}");
            met += 1;
            let any_phase = lane.any_phase.unwrap();
            assert!(any_phase.span().0 >= seen);
            tighter += i32::from(any_phase.span().0 > seen);
        }
    }
    assert!(met > 300 && tighter > 100, "{met} met, {tighter} tighter");
}

/// The largest response when, for each instant, the releases of the last `jitter` are held back
/// to it.
fn held_back_together(lanes: &[Demand], jitter: i64) -> Vec<i64> {
    let mut worst = vec![0; lanes.len()];
    for start in HYPERPERIOD_NS..2 * HYPERPERIOD_NS {
        let until = start + jitter;
        let held =
            |_, nominal| if (start..=until).contains(&nominal) { until - nominal } else { 0 };
        for (worst, seen) in worst.iter_mut().zip(simulate(lanes, held)) {
            *worst = seen.max(*worst);
        }
    }
    worst
}

#[test]
fn with_jitter_no_schedule_exceeds_the_bound_and_one_reaches_it() {
    let mut random = Lcg(3);
    let (mut met, mut wrong) = (0, 0);
    for _ in 0..60 {
        let lanes = random_lanes(&mut random, true, false);
        let jitter = 1 + random.below(3);
        let analysis = analyse(&lanes, exact(jitter));
        let blind = analyse(&lanes, exact(0));
        let together = held_back_together(&lanes, jitter);
        let drawn = simulate(&lanes, |_, _| random.below(jitter + 1));
        for index in 0..lanes.len() {
            let lane = &analysis.lanes[index];
            if lane.verdict != Verdict::Meets {
                assert!(together[index] > lane.deadline.0, "a false alarm: {lane:?}");
                continue;
            }
            assert_eq!(within(lane.with_phases), together[index], "{lanes:?}");
            assert!(drawn[index] <= together[index]);
            assert!(lane.any_phase.unwrap().span().0 >= together[index]);
            met += 1;
            // A variant that is known to be wrong adds the jitter to the response only and not to
            // the interference; the test detects it.
            let naive = blind.lanes[index].response().map_or(0, |b| b.span().0) + jitter;
            wrong += i32::from(naive < together[index]);
        }
    }
    assert!(met > 30, "{met} met");
    assert!(wrong > 0, "a bound that forgets jitter in the interference was never caught");
}

#[test]
fn equal_priorities_hold_each_other_up_and_stay_within_the_bound() {
    let mut random = Lcg(4);
    let mut met = 0;
    for _ in 0..400 {
        let lanes = random_lanes(&mut random, true, true);
        let jitter = random.below(3);
        let seen = simulate(&lanes, |_, _| random.below(jitter + 1));
        for (lane, seen) in analyse(&lanes, exact(jitter)).lanes.iter().zip(seen) {
            if lane.verdict == Verdict::Meets {
                assert!(lane.response().unwrap().span().0 >= seen, "{lanes:?}");
                met += 1;
            }
        }
    }
    assert!(met > 100, "{met} met");
    let twins = [demand(0, 10, 2, 5), demand(1, 10, 3, 5)];
    let both = analyse(&twins, exact(0));
    assert_eq!(both.lanes[0].interfering, ["l1"]);
    assert_eq!(both.lanes[1].interfering, ["l0"]);
    assert_eq!(both.lanes.iter().map(|l| within(l.any_phase)).collect::<Vec<_>>(), [5, 5]);
}

#[test]
fn the_example_of_audsley_and_others_comes_out() {
    // C, T: (3, 7), (3, 12), (5, 20), highest first: responses 3, 6 and 20.
    let lanes = [demand(0, 7, 3, 30), demand(1, 12, 3, 20), demand(2, 20, 5, 10)];
    let analysis = analyse(&lanes, exact(0));
    let responses: Vec<i64> = analysis.lanes.iter().map(|l| within(l.any_phase)).collect();
    assert_eq!(responses, [3, 6, 20]);
    assert_eq!(analysis.loads[0].ppm, 428_572 + 250_000 + 250_000);
    assert_eq!(analysis.refusal(), None);
}

#[test]
fn lanes_meet_on_their_cpu_and_lanes_without_one_meet_everybody() {
    let mut lanes = [demand(0, 10, 4, 30), demand(1, 10, 4, 20), demand(2, 20, 4, 10)];
    lanes[0].spec.cpu = Some(0);
    lanes[1].spec.cpu = Some(1);
    let analysis = analyse(&lanes, exact(0));
    let interfering: Vec<usize> = analysis.lanes.iter().map(|l| l.interfering.len()).collect();
    assert_eq!(interfering, [0, 0, 2]);
    let loads: Vec<(Option<usize>, u64)> = analysis.loads.iter().map(|l| (l.cpu, l.ppm)).collect();
    assert_eq!(loads, [(Some(0), 600_000), (Some(1), 600_000), (None, 1_000_000)]);
    assert_eq!(within(analysis.lanes[2].any_phase), 20, "12, and 8 more before it ends");
    lanes[2].spec.cpu = Some(1);
    let pinned = analyse(&lanes, exact(0));
    assert_eq!(pinned.refusal(), None);
    assert_eq!(within(pinned.lanes[2].any_phase), 8);
}

#[test]
fn a_guard_costs_its_spin_to_those_after_it_and_not_to_its_own_lane() {
    let mut lanes = [demand(0, 20, 4, 30), demand(1, 20, 4, 20), demand(2, 20, 4, 40)];
    lanes[0].spec.guard = Some(Guard { spin_max: Nanos(3), given: GuardCondition::Always });
    let responses = |lanes: &[Demand]| {
        let analysis = analyse(lanes, exact(0));
        let both = |l: &LaneResponse| (within(l.any_phase), within(l.with_phases));
        (analysis.lanes.iter().map(both).collect::<Vec<_>>(), analysis.loads[0].ppm)
    };
    // With phases the spin is over at instant 0 and does not delay what is released then.
    assert_eq!(responses(&lanes), (vec![(8, 8), (15, 12), (4, 4)], 750_000));
    lanes[1].spec.phase = Nanos(18);
    assert_eq!(responses(&lanes).0[1], (15, 14));
}

/// Which lanes of these have a guard once they are a machine, and how long it may spin.
fn guards(lanes: &[Demand]) -> Vec<Option<Nanos>> {
    let mut builder = Builder::new();
    builder.allowance(Allowance { release_jitter: Nanos(100_000), overhead: Nanos(0) }).unwrap();
    for (index, Demand { spec, budget }) in lanes.iter().enumerate() {
        let name = format!("t{index}");
        let mut spec = spec.clone();
        spec.budgets.extend(budget.map(|budget| (name.clone(), budget)));
        let id = builder.lane(spec).unwrap();
        builder.task(id, &name, |_| Ok(Box::new(Busy(Nanos::ZERO)))).unwrap();
    }
    let machine = builder.build().unwrap();
    machine.figures().map(|(spec, _)| spec.guard.map(|guard| guard.spin_max)).collect()
}

#[test]
fn the_default_guard_is_used_where_every_lane_allows_it() {
    let (ms, us) = (|ms: i64| Nanos(ms * 1_000_000), |us: i64| Nanos(us * 1000));
    let lane = |name, period: Nanos, budget: Nanos, priority| {
        let mut lane = demand(name, period.0, budget.0, priority);
        lane.spec.cpu = Some(0);
        lane.spec.guard = Some(Guard::when_schedulable(period));
        lane
    };
    let easy = [lane(0, ms(1), us(100), 80), lane(1, ms(10), ms(1), 70)];
    assert_eq!(guards(&easy), [Some(us(200)), Some(ms(2))]);
    // 1.1 ms of work beside 0.7 ms in each ms: done after 4 ms, after more than 5 with a guard.
    let mut tight = [lane(0, ms(1), us(700), 80), lane(1, ms(5), us(1100), 70)];
    assert_eq!(guards(&tight), [None, Some(ms(1))]);
    // Beside 0.6 ms it is done in time with half a guard, and not with a whole one.
    let half = [lane(0, ms(1), us(600), 80), lane(1, ms(5), us(1100), 70)];
    assert_eq!(guards(&half), [Some(us(100)), Some(ms(1))]);
    // On a CPU of its own nobody is held up.
    tight[0].spec.cpu = Some(1);
    assert_eq!(guards(&tight), [Some(us(200)), Some(ms(1))]);
    // Not without a CPU, and not before a lane of which nothing is known.
    tight[0].spec.cpu = None;
    tight[1].spec.guard = None;
    assert_eq!(guards(&tight), [None, None]);
    let mut unknown = easy.clone();
    unknown[1].budget = None;
    unknown[1].spec.guard = None;
    assert_eq!(guards(&unknown), [None, None]);
    // What was asked for is not taken away: it is refused.
    tight[0].spec.cpu = Some(0);
    tight[0].spec.guard = Guard::from_cpu_share(0.1, ms(1)).ok();
    let analysis = analyse(&tight, exact(100_000));
    let refusal = analysis.refusal().unwrap().to_string();
    assert!(refusal.contains("and up to 100 us of guard every 1 ms"), "{refusal}");
    assert!(refusal.contains("lower `lane.l0.guard.cpu_share_max`"), "{refusal}");
}

#[test]
fn undeclared_budgets_are_not_judged_and_dependent_results_are_unknown() {
    let mut lanes = [demand(0, 10, 4, 30), demand(1, 20, 4, 20), demand(2, 40, 4, 40)];
    lanes[0].budget = None;
    let analysis = analyse(&lanes, exact(0));
    let verdicts: Vec<Verdict> = analysis.lanes.iter().map(|l| l.verdict).collect();
    assert_eq!(verdicts, [Verdict::NotAnalysed, Verdict::Unknown, Verdict::Meets]);
    assert_eq!(analysis.lanes[1].undeclared, ["l0"]);
    assert_eq!(analysis.loads[0].undeclared, ["l0"]);
    assert_eq!(analysis.lanes[0].response(), None);
    // What cannot hold even without the unknown is refused all the same.
    lanes[1].spec.deadline = Nanos(7);
    assert_eq!(analyse(&lanes, exact(0)).lanes[1].verdict, Verdict::Misses);
}

fn demand_us(name: &str, period: i64, budget: i64, priority: u8) -> Demand {
    let spec = LaneSpec::new(name, Nanos::from_micros(period), priority);
    Demand { spec, budget: Some(Nanos::from_micros(budget)) }
}

#[test]
fn a_refusal_gives_the_numbers_and_a_budget_that_fits() {
    let mut lanes = [demand_us("servo", 2500, 1200, 80), demand_us("touch", 5000, 2000, 75)];
    lanes[1].spec.deadline = Nanos::from_micros(2500);
    let refused = analyse(&lanes, Allowance::default()).refusal().unwrap().clone();
    assert_eq!(refused.place, "lane.touch");
    // 2005 + 2 x 1205 + 100 jitter: the second servo job comes before the end.
    for words in ["may end 4515 us", "deadline is 2500 us", "`servo` (1205 us every 2500 us"] {
        assert!(refused.what.contains(words), "{refused}");
    }
    // 2500 - 100 jitter - 1205 - 5 overhead, before the next servo job comes.
    assert!(refused.remedy.contains("cut its budgets to 1190 us"), "{refused}");
    assert!(refused.remedy.contains("deadline and a delivery of 4515 us"), "{refused}");
    lanes[1].budget = Some(Nanos::from_micros(1190));
    assert_eq!(analyse(&lanes, Allowance::default()).refusal(), None, "the advice is good");
    lanes[1].budget = Some(Nanos::from_micros(1191));
    assert!(analyse(&lanes, Allowance::default()).refusal().is_some(), "and not too modest");
}

#[test]
fn overload_and_absurd_numbers_end_and_are_refused() {
    let full = [demand(0, 10, 10, 30), demand(1, 10, 1, 20)];
    let analysis = analyse(&full, exact(0));
    assert_eq!(within(analysis.lanes[0].any_phase), 10, "exactly the whole CPU");
    assert!(matches!(analysis.lanes[1].any_phase, Some(Bound::Beyond(_))));
    assert!(matches!(analysis.lanes[1].with_phases, Some(Bound::Beyond(_))));
    assert!(analysis.refusal().unwrap().what.contains("or more"));
    // The longest period under the shortest, with a hyperperiod that cannot be walked.
    let long = [demand(0, 20_001, 10_000, 30), demand(1, 9_999_999_967, 4_999_000_000, 20)];
    let analysis = analyse(&long, Allowance { overhead: Nanos::ZERO, ..Allowance::default() });
    assert_eq!(analysis.lanes[1].with_phases, None);
    assert_ne!(analysis.lanes[1].verdict, Verdict::NotAnalysed);
    assert_eq!(analyse(&[], Allowance::default()).refusal(), None);
    let bad = |jitter: i64| exact(jitter).check().unwrap_err().place;
    assert_eq!(bad(-1), "release_jitter_us");
    assert_eq!(bad(i64::MAX), "release_jitter_us");
    assert_eq!(exact(0).check(), Ok(()));
}

/// Keeps a processor busy for a while.
struct Busy(Nanos);

impl Task for Busy {
    fn step(&mut self, _cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        let end = linux::monotonic() + self.0;
        while linux::monotonic() < end {}
        Ok(())
    }
}

/// One lane every 5 ms with the tasks `quick` and `slow` (300 us).
fn machine(
    budgets_us: &[(&str, i64)],
    prepare: impl FnOnce(&mut Builder),
) -> Result<Machine, Invalid> {
    let mut b = Builder::new();
    prepare(&mut b);
    let mut spec = LaneSpec::new("lane", Nanos::from_millis(5), 50);
    spec.cpu = Some(1);
    for (task, us) in budgets_us {
        spec.budgets.insert((*task).to_owned(), Nanos::from_micros(*us));
    }
    let lane = b.lane(spec)?;
    b.task(lane, "quick", |_| Ok(Box::new(Busy(Nanos::ZERO))))?;
    b.task(lane, "slow", |_| Ok(Box::new(Busy(Nanos::from_micros(300)))))?;
    b.build()
}

#[test]
fn a_machine_is_refused_with_the_place() {
    let refused = |budgets: &[(&str, i64)], prepare: fn(&mut Builder)| {
        machine(budgets, prepare).err().expect("must be refused")
    };
    let unknown = refused(&[("quick", 10), ("swift", 10)], |_| ());
    assert_eq!(unknown.place, "lane.lane.budget_us.swift");
    assert!(unknown.remedy.contains("quick, slow"), "{unknown}");
    assert_eq!(refused(&[("quick", 4000), ("slow", 1001)], |_| ()).place, "lane.lane.budget_us");
    // The budgets fit the deadline, the release jitter does not.
    let late = refused(&[("quick", 4000), ("slow", 901)], |_| ());
    assert_eq!(late.place, "lane.lane");
    assert!(late.what.contains("100 us release jitter"), "{late}");
    assert!(machine(&[("quick", 4000), ("slow", 895)], |_| ()).is_ok());
    let nowhere = refused(&[], |b| b.cpus(BTreeSet::from([0])));
    assert_eq!(nowhere.place, "lane.lane.cpu");
    assert!(machine(&[], |b| b.cpus(BTreeSet::from([0, 1]))).is_ok());
    let negative = Allowance { release_jitter: Nanos(-1), ..Allowance::default() };
    let place = Builder::new().allowance(negative).unwrap_err().place;
    assert_eq!(place, "schedule.release_jitter_us");
    let lanes = &machine(&[("quick", 10)], |_| ()).unwrap().analysis().lanes.clone();
    assert_eq!(
        lanes.iter().map(|l: &LaneResponse| l.verdict).collect::<Vec<_>>(),
        [Verdict::NotAnalysed]
    );
}

/// Keeps every record.
#[derive(Default, PartialEq, Debug)]
struct Keep(Vec<(usize, u64, i64, Vec<u8>)>);

impl Observer for Keep {
    fn record(&mut self, record: &Record<'_>) {
        self.0.push((record.signal, record.tick, record.release.0, record.body.to_vec()));
    }
}

#[test]
fn tasks_are_timed_when_asked_for_and_nothing_else_changes() {
    let run = |machine: &mut Machine| {
        let mut keep = Keep::default();
        let until = Nanos::from_millis(250);
        virtual_time::run(machine, until, &AtomicBool::new(false), &mut keep).unwrap();
        keep
    };
    let mut plain = machine(&[], |_| ()).unwrap();
    let expected = run(&mut plain);
    assert!(plain.figures().next().unwrap().1.tasks.is_empty(), "nobody asked");
    let declared: &[(&str, i64)] = &[("quick", 10), ("slow", 400)];
    for mut timed in
        [machine(declared, |_| ()).unwrap(), machine(&[], Builder::time_tasks).unwrap()]
    {
        assert_eq!(run(&mut timed), expected);
        let figures = timed.figures().next().unwrap().1;
        assert_eq!(figures.allocations, 0);
        let [quick, slow] = &figures.tasks[..] else { panic!("two tasks") };
        assert_eq!((quick.name.as_str(), slow.name.as_str()), ("quick", "slow"));
        assert_eq!((quick.execution_ns.len(), slow.execution_ns.len()), (50, 50));
        // Two digits of the histogram: 300 us may be filed as 298.
        assert!(slow.execution_ns.min() >= 297_000, "{}", slow.execution_ns.min());
        assert!(quick.execution_ns.value_at_quantile(0.5) < 100_000);
        assert!(figures.execution_ns.max() >= 297_000);
    }
}
