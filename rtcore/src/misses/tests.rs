//! Causes from made-up readings, the bucket and the three policies.

use super::*;

const JOB_DEADLINE: Nanos = Nanos::from_micros(2500);

fn us(us: i64) -> Nanos {
    Nanos::from_micros(us)
}

fn of(took_us: i64, cpu_us: i64, change: impl FnOnce(&mut JobMeasurement)) -> JobMeasurement {
    let mut trace =
        JobMeasurement { took: us(took_us), cpu: us(cpu_us), ..JobMeasurement::default() };
    change(&mut trace);
    trace
}

fn why(trace: &JobMeasurement) -> Cause {
    cause(JOB_DEADLINE, trace, &MissContext::default())
}

#[test]
fn each_cause_has_its_own_evidence() {
    assert_eq!(why(&of(9000, 2501, |t| t.waits = 1)), Cause::Overrun);
    assert_eq!(why(&of(9000, 100, |t| t.preemptions = 1)), Cause::Preempted);
    assert_eq!(why(&of(9000, 100, |t| t.waits = 1)), Cause::Blocked);
    assert_eq!(why(&of(9000, 100, |t| (t.waits, t.disk_faults) = (1, 1))), Cause::PageFault);
    assert_eq!(why(&of(9000, 100, |t| t.page_faults = 1)), Cause::PageFault);
    assert_eq!(why(&of(9000, 100, |_| ())), Cause::Unexplained);
    let guest = MissContext { virtual_machine: true, ..MissContext::default() };
    assert_eq!(cause(JOB_DEADLINE, &of(9000, 100, |_| ()), &guest), Cause::Host);
}

#[test]
fn a_late_begin_is_the_cause_where_it_weighs_most() {
    let ground = MissContext { release_jitter: us(100), ..MissContext::default() };
    let why = |late_us, took_us, cpu_us, change: fn(&mut JobMeasurement)| {
        let trace = JobMeasurement { late: us(late_us), ..of(took_us, cpu_us, change) };
        cause(JOB_DEADLINE, &trace, &ground)
    };
    assert_eq!(why(2450, 100, 90, |_| ()), Cause::LateWake);
    assert_eq!(why(1300, 1300, 100, |t| t.preemptions = 1), Cause::LateWake, "1300 beside 1200");
    assert_eq!(why(20, 2500, 100, |t| t.preemptions = 3), Cause::Preempted, "20 beside 2400");
    assert_eq!(why(20, 2490, 2490, |_| ()), Cause::Overrun, "20 are allowed for");
    assert_eq!(why(200, 2450, 2440, |_| ()), Cause::LateWake, "200 are not");
    assert_eq!(why(90, 2480, 100, |t| t.waits = 2), Cause::Blocked);
    assert_eq!(why(50_000, 2501, 2501, |_| ()), Cause::Overrun, "in time it would miss as well");
}

#[test]
fn faults_that_caused_a_delay_are_distinguished_from_others() {
    let many = of(4000, 3900, |t| t.page_faults = 1400);
    assert_eq!(why(&many), Cause::PageFault, "1400 us of them at least");
    let few = of(4000, 3900, |t| t.page_faults = 10);
    assert_eq!(why(&few), Cause::Overrun);
    let beside = of(9000, 100, |t| (t.page_faults, t.preemptions) = (10, 1));
    assert_eq!(why(&beside), Cause::Preempted, "a fault without disk never leaves the processor");
    assert_eq!(why(&of(9000, 2600, |t| t.page_faults = u64::MAX)), Cause::PageFault);
}

#[test]
fn throttling_is_asked_for_and_not_assumed() {
    let gone = |away_us: i64| of(100 + away_us, 100, |t| t.preemptions = 1);
    let throttled = MissContext { throttle_gap: Some(us(50_000)), ..MissContext::default() };
    assert_eq!(cause(JOB_DEADLINE, &gone(49_000), &throttled), Cause::Throttled);
    assert_eq!(
        cause(JOB_DEADLINE, &gone(24_000), &throttled),
        Cause::Preempted,
        "too short for it"
    );
    assert_eq!(cause(JOB_DEADLINE, &gone(49_000), &MissContext::default()), Cause::Preempted);
    let quota = MissContext { quota_used: true, ..MissContext::default() };
    assert_eq!(cause(JOB_DEADLINE, &gone(9_000), &quota), Cause::Throttled);
    let waited = of(90_000, 100, |t| t.waits = 1);
    assert_eq!(cause(JOB_DEADLINE, &waited, &throttled), Cause::Blocked);
}

#[test]
fn counts_add_up() {
    let mut misses = Misses::default();
    let causes = [
        Cause::LateWake,
        Cause::Overrun,
        Cause::Preempted,
        Cause::Blocked,
        Cause::PageFault,
        Cause::Throttled,
        Cause::Host,
        Cause::Unexplained,
    ];
    for (index, cause) in causes.into_iter().enumerate() {
        misses.add(cause);
        assert_eq!(misses.rows()[index].1, 1, "{cause:?}");
    }
    assert_eq!(misses.total(), 8);
    assert!(misses.plus(&misses).rows().iter().all(|(_, count)| *count == 2));
}

fn overruns(late: LatePolicy) -> OverrunHandler {
    OverrunHandler::new(late, LeakyBucket { capacity: 3, leak_jobs: 4 })
}

fn behind(superseded: u64) -> Backlog {
    Backlog { superseded, served: false }
}

fn storm(notice: Notice) -> bool {
    notice.faults.contains(FaultCode::OverrunStorm)
}

#[test]
fn the_bucket_fills_by_misses_and_leaks_by_good_jobs() {
    let mut lane = overruns(LatePolicy::Skip);
    assert!(!storm(lane.end_job(true, behind(0)).1) && !storm(lane.end_job(true, behind(0)).1));
    for _ in 0..4 {
        assert_eq!(lane.end_job(false, behind(0)).1, Notice::default());
    }
    assert!(!storm(lane.end_job(true, behind(0)).1), "one has leaked");
    for _ in 0..3 {
        lane.end_job(false, behind(0));
    }
    let third = lane.end_job(true, behind(0)).1;
    assert!(storm(third), "three good jobs are not enough");
    assert!(third.faults.contains(FaultCode::Overrun));
    assert!(storm(lane.end_job(true, behind(0)).1), "full stays full");
    assert_eq!(lane.storms(), 2);
    for _ in 0..1000 {
        assert!(lane.end_job(false, behind(0)).1.faults.is_empty());
    }
    assert!(
        !storm(lane.end_job(true, behind(0)).1) && !storm(lane.end_job(true, behind(0)).1),
        "it ran empty"
    );
}

#[test]
fn a_job_that_is_left_out_weighs_as_much_as_a_late_one() {
    let mut lane = overruns(LatePolicy::Skip);
    let (left_out, notice) = lane.end_job(true, behind(2));
    assert_eq!((left_out, notice.missed), (2, 3));
    assert!(storm(notice));
    assert_eq!(
        lane.end_job(true, behind(u64::MAX)),
        (u64::MAX, Notice { missed: u32::MAX, ..notice })
    );
}

#[test]
fn a_job_that_the_late_one_has_served_is_left_out_unless_jobs_are_counted() {
    let served = Backlog { superseded: 3, served: true };
    assert_eq!(overruns(LatePolicy::Skip).end_job(true, served).0, 4);
    assert_eq!(overruns(LatePolicy::Fault).end_job(true, served).0, 4);
    let mut counting = overruns(LatePolicy::CatchUp { at_most: 1 });
    assert_eq!(counting.end_job(true, served).0, 0);
    assert_eq!(counting.end_job(true, served).0, 3, "the newest is run");
    assert_eq!(counting.end_job(false, Backlog { superseded: 0, served: true }).0, 0);
}

#[test]
fn catching_up_is_bounded_and_drops_the_rest() {
    let mut lane = overruns(LatePolicy::CatchUp { at_most: 2 });
    assert_eq!(lane.end_job(true, behind(7)).0, 0);
    assert_eq!(lane.end_job(true, behind(6)).0, 0);
    assert_eq!(lane.end_job(true, behind(5)).0, 5, "two were caught up, the rest is left out");
    assert_eq!(lane.end_job(true, behind(1)).0, 0, "and again");
    lane.end_job(false, behind(0));
    assert_eq!(
        (lane.end_job(true, behind(3)).0, lane.end_job(true, behind(2)).0),
        (0, 0),
        "the count begins anew"
    );
    let mut world = overruns(LatePolicy::CatchUp { at_most: u32::MAX });
    assert!((0..10_000).all(|_| world.end_job(true, behind(50)).0 == 0));
}

#[test]
fn a_lane_that_may_not_miss_raises_a_fault_at_once() {
    let mut lane = overruns(LatePolicy::Fault);
    assert!(lane.end_job(false, behind(0)).1.faults.is_empty());
    let (left_out, notice) = lane.end_job(true, behind(4));
    assert_eq!(left_out, 4, "the phase is kept");
    assert!(notice.faults.contains(FaultCode::DeadlineMissed));
    assert!(
        !overruns(LatePolicy::Skip)
            .end_job(true, behind(0))
            .1
            .faults
            .contains(FaultCode::DeadlineMissed)
    );
}

#[test]
fn a_bucket_that_cannot_be_meant_is_refused() {
    assert_eq!(LeakyBucket::default().check(), Ok(()));
    for bad in [0, BUCKET_MAX + 1, u32::MAX] {
        assert_eq!(
            LeakyBucket { capacity: bad, leak_jobs: 1 }.check().unwrap_err().place,
            "bucket"
        );
        assert_eq!(
            LeakyBucket { capacity: 1, leak_jobs: bad }.check().unwrap_err().place,
            "leak_jobs"
        );
    }
}
