//! Tests lines past the wrist singularity, which are checked and then executed. An accepted line
//! ends on its goal, within the time and the distance from the path that the check stated, with no
//! joint above its speed limit.

use glam::DVec3;
use taktil_mechanics::Joints;
use taktil_mechanics::Pose;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::{rotation_from_vector, rotation_vector};
use taktil_mechanics::tracking::{GOAL_TOLERANCE_M_RAD, SETTLING_TIME_MAX_S};
use taktil_rtcore::Payload;
use taktil_signal::{MoveCheck, MoveKind, OperatorMove};
use taktil_tasks_trajectory::config::{Goal, Step};
use taktil_tasks_trajectory::online::Online;
use taktil_tasks_trajectory::program::{Outcome, Plan, Program};
use taktil_tasks_trajectory::{Config, typed};
use taktil_tests_script::dice::Dice;

const TICK_S: f64 = 0.0025;
/// Lines drawn for a test; more than half of them are granted.
const LINES_RUN: usize = 600;
/// Jobs that looking and running may take together.
const JOBS_RUN: u64 = 20_000;

/// A line of the tool: from these joints, to this pose, in this time.
#[derive(Clone, Copy, Debug)]
struct Line {
    start: Joints,
    goal: Pose,
    t_s: f64,
}

/// What became of it.
struct RunningLeg {
    check: MoveCheck,
    /// Joints job by job, from the start of the motion to its end.
    q: Vec<Joints>,
}

/// A line whose wrist is not bent much, and turns on the way.
fn draw(dice: &mut Dice, arm: &Puma260) -> Line {
    let mid = Joints::from([0.0, 0.7, -2.6, 0.0, 0.0, 0.0]);
    let spread = [0.8, 0.3, 0.3, 1.5, 0.6, 1.5];
    let start = Joints::from_fn(|i, _| mid[i] + dice.between(-spread[i], spread[i]));
    let here = arm.tool_pose(&start);
    let mut part = |size: f64| DVec3::from_array([(); 3].map(|()| dice.between(-size, size)));
    let (way, turn) = (part(0.05), part(0.6));
    let goal = Pose::new(rotation_from_vector(turn) * here.rotation, here.translation + way);
    Line { start, goal, t_s: dice.between(0.3, 2.0) }
}

/// How far the tool may leave its path.
fn lenient() -> Config {
    Config { path_error_max_mm: 60.0, path_error_max_deg: 20.0, ..Config::default() }
}

fn straight(goal: Pose, t_s: f64) -> Step {
    Step { goal: Goal::Tool(goal), straight: true, t_s: Some(t_s) }
}

/// Checks the steps and runs them if they are granted.
fn run(mut plan: Plan, start: &Joints) -> RunningLeg {
    let mut program = Program::empty(&plan).unwrap();
    if let Err(check) = program.begin(&mut plan, start, TICK_S) {
        return RunningLeg { check, q: vec![] };
    }
    let mut q = vec![];
    for job in 0..JOBS_RUN {
        let granted = program.check().verdict == 2;
        match program.step(&plan, job) {
            Outcome::Refused => {
                assert!(!granted, "granted, and lost on the way: {:?}", program.check());
                return RunningLeg { check: *program.check(), q };
            }
            Outcome::At(at, done) => {
                if program.check().verdict == 2 {
                    q.push(at.q);
                }
                if done {
                    return RunningLeg { check: *program.check(), q };
                }
            }
        }
    }
    panic!("neither refused nor done: {:?}", program.check());
}

/// How far joints are from a pose (m, rad).
fn off(arm: &Puma260, q: &Joints, goal: &Pose) -> (f64, f64) {
    let at = arm.tool_pose(q);
    let turn = rotation_vector(&at.rotation, &goal.rotation).length();
    ((at.translation - goal.translation).length(), turn)
}

/// Every joint within its speed from job to job.
fn within_speed(arm: &Puma260, q: &[Joints]) {
    for pair in q.windows(2) {
        let way = (pair[1] - pair[0]).component_div(&(arm.speed_max_rad_s * TICK_S));
        assert!(way.amax() <= 1.0 + 1e-6, "{way}");
    }
}

#[test]
fn every_line_that_is_granted_ends_on_its_goal() {
    let robot = Robot::puma260();
    let arm = robot.arm;
    let mut dice = Dice::new(11);
    let (mut granted, mut settled) = (0, 0);
    for number in 0..LINES_RUN {
        let line = draw(&mut dice, &arm);
        let steps = vec![straight(line.goal, line.t_s)];
        let run = run(Plan::new(&lenient(), &robot, steps), &line.start);
        let RunningLeg { check, q } = run;
        if check.verdict == 3 {
            continue;
        }
        granted += 1;
        within_speed(&arm, &q);
        let (off_m, off_rad) = off(&arm, q.last().unwrap(), &line.goal);
        assert!(
            off_m.max(off_rad) < GOAL_TOLERANCE_M_RAD,
            "{number}: {off_m} m, {off_rad} rad: {line:?}"
        );
        // In the time that the check stated, to a tick.
        let took_s = (q.len() - 1) as f64 * TICK_S;
        assert!((took_s - check.duration_s).abs() < 1.01 * TICK_S, "{number}: {took_s} {check:?}");
        let settling_s = check.duration_s - line.t_s - 0.2;
        assert!(settling_s < SETTLING_TIME_MAX_S, "{number}: {check:?}");
        if settling_s > TICK_S {
            settled += 1;
            assert!(check.path_error_rad > 0.0, "{number}: {check:?}");
        }
    }
    assert!(granted > 300 && settled > 20, "the lines are hard: {granted} granted, {settled}");
}

/// A line that passes the singularity shortly before its end. Where it was given up with the path,
/// the tool was 4.7 mm and 1.3 deg beside its goal.
fn passing(arm: &Puma260) -> Line {
    let start = Joints::from([-10.0, 30.0, -150.0, 50.0, 30.0, -10.0].map(f64::to_radians));
    let here = arm.tool_pose(&start);
    let goal = Pose::new(
        rotation_from_vector(DVec3::new(0.3, 0.0, 0.0)) * here.rotation,
        here.translation + DVec3::new(0.02, 0.01, 0.03),
    );
    Line { start, goal, t_s: 0.4 }
}

/// Ticks from the start of [`passing`] to the end of its path.
const PASSING_JOBS: usize = 240;

#[test]
fn joints_that_lag_at_the_end_of_a_line_still_reach_the_goal() {
    let robot = Robot::puma260();
    let arm = robot.arm;
    let line = passing(&arm);
    let aside = line.start + Joints::repeat(0.1);
    let back = Step { goal: Goal::Joints(aside), straight: false, t_s: None };
    let steps = vec![straight(line.goal, line.t_s), back];
    let RunningLeg { check, q } = run(Plan::new(&Config::default(), &robot, steps), &line.start);
    assert_eq!((check.verdict, check.moves), (2, 2), "{check:?}");
    within_speed(&arm, &q);
    let behind = off(&arm, &q[PASSING_JOBS + 8], &line.goal);
    assert!(behind.0 > 4e-3 && behind.1 > 0.02, "where the path ends: {behind:?}");
    let on_goal = |q: &Joints| {
        let (off_m, off_rad) = off(&arm, q, &line.goal);
        off_m.max(off_rad) < GOAL_TOLERANCE_M_RAD
    };
    let at = (PASSING_JOBS..q.len()).find(|&tick| on_goal(&q[tick])).expect("it gets there");
    let settling_s = (at - PASSING_JOBS) as f64 * TICK_S;
    assert!(settling_s > 0.1 && settling_s < 0.25, "{settling_s}");
    // The next leg begins there, without a jump, and ends on its goal.
    let change = |tick: usize| (q[tick + 1] - q[tick] * 2.0 + q[tick - 1]) / (TICK_S * TICK_S);
    for tick in at - 20..at + 20 {
        let share = change(tick)[3].abs() / arm.acceleration_max_rad_s2[3];
        assert!(share < 1.0 + 1e-6, "joint 4 at {tick}: {share}");
    }
    assert!((q.last().unwrap() - aside).amax() < 1e-12);
}

#[test]
fn a_typed_line_reaches_its_goal_too_and_a_pause_stops_no_joint_at_once() {
    let robot = Robot::puma260();
    let arm = robot.arm;
    let line = passing(&arm);
    let back = Step { goal: Goal::Joints(line.start), straight: false, t_s: None };
    let typed = [straight(line.goal, line.t_s), back].map(|step| typed::encode(&step, false));
    let command = |kind, sequence| OperatorMove { sequence, ..typed::command(kind) };
    for pause in (0..110).step_by(5) {
        let mut plan = Plan::new(&Config::default(), &robot, vec![]);
        let mut online = Online::empty(&plan).unwrap();
        online.begin(&mut plan, &line.start, TICK_S, None);
        let (mut q, mut since) = (vec![line.start; 2], 0);
        for job in 0..4000 {
            let word = match (job, since) {
                (0, _) => OperatorMove { sequence: 1, ..typed[0] },
                (_, since) if since == 140 + pause => command(MoveKind::Pause, 2),
                (_, since) if since == 400 + pause => command(MoveKind::Resume, 3),
                (_, since) if since == 405 + pause => OperatorMove { sequence: 4, ..typed[1] },
                _ => OperatorMove::ZERO,
            };
            let word = Some(word).filter(|word| word.sequence != 0);
            let at = online.step(&plan, word).unwrap_or_else(|| panic!("{pause}: lost"));
            since += usize::from(since > 0 || online.typed().moving == 1);
            q.push(at.q);
            let [.., a, b, c] = q[..] else { unreachable!() };
            let share = ((c - b * 2.0 + a) / (TICK_S * TICK_S))[3] / arm.acceleration_max_rad_s2[3];
            assert!(share.abs() < 1.0 + 1e-6, "pause {pause}, job {job}: joint 4 {share}");
        }
        within_speed(&arm, &q);
        let on_goal = |q: &Joints| {
            let (off_m, off_rad) = off(&arm, q, &line.goal);
            off_m.max(off_rad) < GOAL_TOLERANCE_M_RAD
        };
        assert!(q.iter().any(on_goal), "pause {pause}: it was on its goal");
        assert_eq!((online.typed().checked, online.typed().refused), (4, 0), "pause {pause}");
        assert!((q.last().unwrap() - line.start).amax() < 1e-12, "pause {pause}: and back");
    }
}
