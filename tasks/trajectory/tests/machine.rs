//! The task in a machine, in virtual time, fed by scripts.

use taktil_mechanics::Joints;
use taktil_mechanics::paul::JointPath;
use taktil_mechanics::puma260::Puma260;
use taktil_rtcore::{FaultCode, FaultSet, Payload};
use taktil_signal::{ControlState, Desired, Goal, JointState, MoveCheck, State};
use taktil_tasks_trajectory::{Config, Move, ToolGoal, Trajectory};
use taktil_tests_script::{Bench, PERIOD};

#[derive(Clone, Copy)]
struct Script {
    control: fn(u64) -> ControlState,
    desired: fn(u64) -> Desired,
    joints: fn(u64) -> JointState,
}

fn run(config: Config, script: &Script, ticks: i64) -> (Vec<Goal>, FaultSet) {
    let (goals, faults, _) = run_checked(config, script, ticks);
    (goals, faults)
}

fn run_checked(
    config: Config,
    script: &Script,
    ticks: i64,
) -> (Vec<Goal>, FaultSet, Option<MoveCheck>) {
    let mut bench = Bench::new();
    let lane = bench.servo();
    let Script { control, desired, joints } = *script;
    bench.feed(lane, "control", move |tick| Some(control(tick)));
    bench.feed(lane, "joints", move |tick| Some(joints(tick)));
    bench.task(lane, "trajectory", |ports| Trajectory::new(config, ports));
    bench.feed(lane, "desired", move |tick| Some(desired(tick)));
    bench.bind_feeds("trajectory", &["control", "desired", "joints"]);
    let run = bench.run(PERIOD * ticks);
    (run.of("trajectory.goal"), run.faults(), run.of("trajectory.check").pop())
}

const START: [f64; 6] = [0.0, 0.7, -2.68, -3.13, 1.17, 3.13];
const GOAL_DEG: [f64; 6] = [5.0, 42.0, -150.0, -175.0, 65.0, 170.0];

fn by_mm(shift: [f64; 3], straight: bool) -> Move {
    Move { joints_deg: None, tool: None, by_mm: Some(shift), straight, t_s: None }
}

/// Jobs in which the move of [`queue`] is laid, one, and looked at before it begins.
const LOOKED: usize = 72;

fn queue() -> Config {
    let one = Move {
        joints_deg: Some(GOAL_DEG),
        tool: None,
        by_mm: None,
        straight: false,
        t_s: Some(0.5),
    };
    Config { moves: vec![one], ..Config::default() }
}

/// IDLE, then a stay from tick 10 to 50, IDLE, and another stay from tick 60 on.
fn two_stays(tick: u64) -> ControlState {
    let (state, entered_ns) = match tick {
        0..10 => (State::IdleCalibrated, 0),
        10..50 => (State::Trajectory, 25_000_000),
        50..60 => (State::IdleCalibrated, 125_000_000),
        _ => (State::Trajectory, 150_000_000),
    };
    ControlState { state: state as u32, entered_ns, ..ControlState::ZERO }
}

fn calibrated(_: u64) -> JointState {
    JointState { q_rad: START, calibrated: 1, ..JointState::ZERO }
}

fn still(_: u64) -> Desired {
    Desired { q_rad: START, valid: 1, ..Desired::ZERO }
}

#[test]
fn each_stay_follows_a_path_from_where_the_arm_is_wanted() {
    let script = Script { control: two_stays, desired: still, joints: calibrated };
    let (goals, faults) = run(queue(), &script, 450);
    assert!(faults.is_empty());
    let points = [Joints::from(START), Joints::from(GOAL_DEG.map(f64::to_radians))];
    let path = JointPath::new(&points, &[0.5], 0.1).unwrap();
    for (tick, goal) in goals.iter().enumerate() {
        let since = match tick {
            0..10 | 50..60 => {
                assert_eq!(*goal, Goal::ZERO, "tick {tick}");
                continue;
            }
            10..50 => tick - 10,
            _ => tick - 60,
        };
        // 0.7 s and eight ticks, four at a time.
        let t_s = since.saturating_sub(LOOKED) as f64 * 0.0025;
        let wanted = path.at(t_s);
        assert_eq!((Joints::from(goal.q_rad), Joints::from(goal.qd_rad_s)), (wanted.q, wanted.qd));
        assert_eq!((goal.valid, goal.done == 1), (1, t_s >= path.duration_s()), "tick {tick}");
    }
    assert_eq!(goals[60].q_rad, START, "bumpless");
    assert_eq!(goals[449].done, 1);
}

#[test]
fn what_cannot_start_is_done_without_a_valid_goal() {
    let refused = Goal { done: 1, ..Goal::ZERO };
    let uncalibrated = Script {
        control: two_stays,
        desired: still,
        joints: |tick| JointState { calibrated: 0, ..calibrated(tick) },
    };
    let undesired = Script { desired: |_| Desired::ZERO, joints: calibrated, ..uncalibrated };
    let outside = Script {
        desired: |tick| Desired { q_rad: [9.0; 6], ..still(tick) },
        joints: calibrated,
        ..uncalibrated
    };
    for script in [uncalibrated, undesired, outside] {
        let (goals, faults) = run(queue(), &script, 100);
        assert!(faults.contains(FaultCode::MoveRefused));
        assert_eq!((goals[9], goals[10], goals[49]), (Goal::ZERO, refused, refused));
        assert_eq!((goals[50], goals[60]), (Goal::ZERO, refused));
    }
}

#[test]
fn a_zero_that_moves_ends_the_motion() {
    let script = Script {
        control: two_stays,
        desired: still,
        joints: |tick| JointState { datum: u32::from(tick >= 30), ..calibrated(tick) },
    };
    let (goals, faults) = run(queue(), &script, 70);
    assert!(faults.contains(FaultCode::MoveRefused));
    assert_eq!(
        (goals[29].valid, goals[30], goals[49].done),
        (1, Goal { done: 1, ..Goal::ZERO }, 1)
    );
    assert_eq!(goals[60].valid, 1, "the next stay starts anew");
}

#[test]
fn a_displacement_out_of_reach_is_unreachable_and_an_empty_queue_is_soon_done() {
    let script = Script { control: two_stays, desired: still, joints: calibrated };
    let away = by_mm([0.0, 0.0, 900.0], false);
    let (goals, faults) = run(Config { moves: vec![away], ..Config::default() }, &script, 12);
    assert!(faults.contains(FaultCode::Unreachable));
    assert_eq!(goals[11], Goal { done: 1, ..Goal::ZERO });
    let (goals, faults) = run(Config::default(), &script, 300);
    assert!(faults.is_empty());
    assert_eq!((goals[60].q_rad, goals[60].done), (START, 0));
    assert_eq!((goals[299].q_rad, goals[299].done, goals[299].valid), (START, 1, 1));
}

fn one_stay(tick: u64) -> ControlState {
    let state = if tick < 10 { State::IdleCalibrated } else { State::Trajectory };
    ControlState { state: state as u32, entered_ns: 25_000_000, ..ControlState::ZERO }
}

#[test]
fn straight_moves_run_straight_and_join_joint_moves_at_rest() {
    let script = Script { control: one_stay, desired: still, joints: calibrated };
    let aside = Move { joints_deg: Some(GOAL_DEG), ..by_mm([0.0; 3], false) };
    let aside = Move { by_mm: None, ..aside };
    let moves = vec![aside, by_mm([20.0, 0.0, -10.0], true), by_mm([0.0, 15.0, 0.0], true)];
    let config = Config { moves, line_mm_s: 100.0, ..Config::default() };
    let (goals, faults, check) = run_checked(config, &script, 1200);
    assert!(faults.is_empty());
    let check = check.expect("the check spoke");
    assert_eq!((check.verdict, check.moves, check.reason), (2, 3, 0), "{check:?}");
    assert!(check.speed_share < 0.31 && check.torque_share > 0.01, "{check:?}");
    assert_eq!((check.off_path_m, check.off_path_rad), (0.0, 0.0));
    let last = goals.last().unwrap();
    assert_eq!((last.valid, last.done), (1, 1));
    // From the end of the joint move on, the tool keeps to two lines.
    let arm = Puma260::reference();
    let corner = arm.tool_pose(&Joints::from(GOAL_DEG.map(f64::to_radians)));
    let begin = goals.iter().position(|g| g.q_rad == GOAL_DEG.map(f64::to_radians)).unwrap();
    let mut before = Joints::from(goals[begin].q_rad);
    for goal in &goals[begin + 1..] {
        let q = Joints::from(goal.q_rad);
        let at = corner.inverse().apply(arm.tool_pose(&q).translation) * 1e3;
        // In the plane of both lines, and on the first until 10 mm before the corner at most.
        assert!((at.x + 2.0 * at.z).abs() < 1e-6 || at.y > -1e-6, "{at}");
        assert!(at.x <= 20.0 + 1e-6 && at.y <= 15.0 + 1e-6, "{at}");
        assert!((q - before).amax() < 0.01, "no jump");
        assert!((Joints::from(goal.qd_rad_s) * 0.0025 - (q - before)).amax() < 1e-4);
        before = q;
    }
    let end = corner.inverse().apply(arm.tool_pose(&before).translation) * 1e3;
    assert!((end - glam::DVec3::new(20.0, 15.0, -10.0)).length() < 1e-9, "{end}");
}

#[test]
fn a_queue_that_cannot_be_run_is_refused_before_anything_moves() {
    let script = Script { control: one_stay, desired: still, joints: calibrated };
    let refused = |moves: Vec<Move>| {
        let config = Config { moves, ..Config::default() };
        let (goals, faults, check) = run_checked(config, &script, 900);
        let check = check.expect("the check spoke");
        if check.verdict != 3 {
            return None;
        }
        assert!(goals.iter().all(|goal| goal.valid == 0 || goal.q_rad == START), "nothing moved");
        assert_eq!(goals.last().unwrap(), &Goal { done: 1, ..Goal::ZERO });
        Some((check, faults))
    };
    // Out of reach is seen when the way is laid, and names its own move.
    let moves = vec![by_mm([5.0, 0.0, 0.0], true), by_mm([0.0, 0.0, -260.0], true)];
    let (check, faults) = refused(moves).unwrap();
    assert_eq!((check.moves, check.reason, check.joint), (2, 2, 0), "{check:?}");
    assert!(faults.contains(FaultCode::Unreachable));
    // The tool turned by 100 degrees on the spot: one way round joint 6 has room, the other way it
    // meets its limit on the way, which only looking along the way can tell.
    let here = Puma260::reference().tool_pose(&Joints::from(START)).translation * 1e3;
    let about = |yaw_deg: f64| {
        let tool = ToolGoal {
            p_mm: here.to_array(),
            rotation: None,
            yaw_deg,
            pitch_deg: 0.0,
            roll_deg: 0.0,
        };
        let turn = Move { tool: Some(tool), by_mm: None, ..by_mm([0.0; 3], true) };
        refused(vec![by_mm([5.0, 0.0, 0.0], false), turn])
    };
    let verdicts = [about(100.0), about(-100.0)];
    let ([Some((check, faults)), None] | [None, Some((check, faults))]) = verdicts else {
        panic!("{verdicts:?}")
    };
    assert_eq!((check.moves, check.reason, check.joint), (2, 1, 6), "{check:?}");
    assert!(check.t_s > 1.0 && check.t_s < 3.6, "88 of 100 degrees on: {check:?}");
    assert!(faults.contains(FaultCode::MoveRefused));
}
