//! Tests the task in a machine in virtual time with scripted inputs.

use taktil_mechanics::Joints;
use taktil_mechanics::paul::JointPath;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::{FaultCode, FaultSet, Payload};
use taktil_signal::{
    ControlState, Desired, Goal, JointState, MoveCheck, MoveKind, MoveQueue, OperatorMove, State,
};
use taktil_tasks_trajectory::config::{Goal as Aim, Step};
use taktil_tasks_trajectory::{Config, Move, ToolGoal, Trajectory, typed};
use taktil_tests_script::{Bench, SERVO_PERIOD};

#[derive(Clone, Copy)]
struct Script {
    control: fn(u64) -> ControlState,
    desired: fn(u64) -> Desired,
    joints: fn(u64) -> JointState,
    moves: fn(u64) -> OperatorMove,
}

fn silent(_: u64) -> OperatorMove {
    OperatorMove::ZERO
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
    let (keep, faults) = run_kept(config, script, ticks);
    (keep.goals, faults, keep.check)
}

/// What came out of the task.
struct Keep {
    goals: Vec<Goal>,
    check: Option<MoveCheck>,
    typed: Vec<MoveQueue>,
}

fn run_kept(config: Config, script: &Script, ticks: i64) -> (Keep, FaultSet) {
    let mut bench = Bench::new();
    let lane = bench.servo();
    let Script { control, desired, joints, moves } = *script;
    bench.feed(lane, "control", move |tick| Some(control(tick)));
    bench.feed(lane, "joints", move |tick| Some(joints(tick)));
    bench.feed(lane, "moves", move |tick| Some(moves(tick)));
    bench.task(lane, "trajectory", |ports| Trajectory::new(config, &Robot::puma260(), ports));
    bench.feed(lane, "desired", move |tick| Some(desired(tick)));
    bench.bind_feeds("trajectory", &["control", "desired", "joints", "moves"]);
    let run = bench.run(SERVO_PERIOD * ticks);
    let (check, typed) = (run.of("trajectory.check").pop(), run.of("trajectory.queue"));
    (Keep { goals: run.of("trajectory.goal"), check, typed }, run.faults())
}

const START_RAD: [f64; 6] = [0.0, 0.7, -2.68, -3.13, 1.17, 3.13];
const GOAL_DEG: [f64; 6] = [5.0, 42.0, -150.0, -175.0, 65.0, 170.0];

fn by_mm(shift: [f64; 3], straight: bool) -> Move {
    Move { joints_deg: None, tool: None, by_mm: Some(shift), straight, t_s: None }
}

/// Jobs in which the move of [`queue`] is planned, one, and checked before it begins.
const JOBS_CHECKED: usize = 72;

fn queue() -> Config {
    let one = Move {
        joints_deg: Some(GOAL_DEG.to_vec()),
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
    JointState { q_rad: START_RAD, calibrated: 1, ..JointState::ZERO }
}

fn still(_: u64) -> Desired {
    Desired { q_rad: START_RAD, valid: 1, ..Desired::ZERO }
}

#[test]
fn each_stay_follows_a_path_from_where_the_arm_is_wanted() {
    let script = Script { control: two_stays, desired: still, joints: calibrated, moves: silent };
    let (goals, faults) = run(queue(), &script, 450);
    assert!(faults.is_empty());
    let points = [Joints::from(START_RAD), Joints::from(GOAL_DEG.map(f64::to_radians))];
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
        let t_s = since.saturating_sub(JOBS_CHECKED) as f64 * 0.0025;
        let wanted = path.at(t_s);
        assert_eq!((Joints::from(goal.q_rad), Joints::from(goal.qd_rad_s)), (wanted.q, wanted.qd));
        assert_eq!((goal.valid, goal.done == 1), (1, t_s >= path.duration_s()), "tick {tick}");
    }
    assert_eq!(goals[60].q_rad, START_RAD, "bumpless");
    assert_eq!(goals[449].done, 1);
}

#[test]
fn what_cannot_start_is_done_without_a_valid_goal() {
    let refused = Goal { done: 1, ..Goal::ZERO };
    let uncalibrated = Script {
        control: two_stays,
        desired: still,
        joints: |tick| JointState { calibrated: 0, ..calibrated(tick) },
        moves: silent,
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
        moves: silent,
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
    let script = Script { control: two_stays, desired: still, joints: calibrated, moves: silent };
    let away = by_mm([0.0, 0.0, 900.0], false);
    let (goals, faults) = run(Config { moves: vec![away], ..Config::default() }, &script, 12);
    assert!(faults.contains(FaultCode::Unreachable));
    assert_eq!(goals[11], Goal { done: 1, ..Goal::ZERO });
    let (goals, faults) = run(Config::default(), &script, 300);
    assert!(faults.is_empty());
    assert_eq!((goals[60].q_rad, goals[60].done), (START_RAD, 0));
    assert_eq!((goals[299].q_rad, goals[299].done, goals[299].valid), (START_RAD, 1, 1));
}

fn one_stay(tick: u64) -> ControlState {
    let state = if tick < 10 { State::IdleCalibrated } else { State::Trajectory };
    ControlState { state: state as u32, entered_ns: 25_000_000, ..ControlState::ZERO }
}

#[test]
fn straight_moves_run_straight_and_join_joint_moves_at_rest() {
    let script = Script { control: one_stay, desired: still, joints: calibrated, moves: silent };
    let aside = Move { joints_deg: Some(GOAL_DEG.to_vec()), ..by_mm([0.0; 3], false) };
    let aside = Move { by_mm: None, ..aside };
    let moves = vec![aside, by_mm([20.0, 0.0, -10.0], true), by_mm([0.0, 15.0, 0.0], true)];
    let config = Config { moves, line_mm_s: 100.0, ..Config::default() };
    let (goals, faults, check) = run_checked(config, &script, 1200);
    assert!(faults.is_empty());
    let check = check.expect("the check spoke");
    assert_eq!((check.verdict, check.moves, check.reason), (2, 3, 0), "{check:?}");
    assert!(check.speed_share < 0.31 && check.torque_share > 0.01, "{check:?}");
    assert_eq!((check.path_error_m, check.path_error_rad), (0.0, 0.0));
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
    let script = Script { control: one_stay, desired: still, joints: calibrated, moves: silent };
    let refused = |moves: Vec<Move>| {
        let config = Config { moves, ..Config::default() };
        let (goals, faults, check) = run_checked(config, &script, 900);
        let check = check.expect("the check spoke");
        if check.verdict != 3 {
            return None;
        }
        assert!(
            goals.iter().all(|goal| goal.valid == 0 || goal.q_rad == START_RAD),
            "nothing moved"
        );
        assert_eq!(goals.last().unwrap(), &Goal { done: 1, ..Goal::ZERO });
        Some((check, faults))
    };
    // Out of reach is seen when the way is planned, and names its own move.
    let moves = vec![by_mm([5.0, 0.0, 0.0], true), by_mm([0.0, 0.0, -260.0], true)];
    let (check, faults) = refused(moves).unwrap();
    assert_eq!((check.moves, check.reason, check.joint), (2, 2, 0), "{check:?}");
    assert!(faults.contains(FaultCode::Unreachable));
    // The tool turned by 100 degrees on the spot: one way round joint 6 has room, the other way it
    // meets its limit on the way, which only looking along the way can tell.
    let here = Puma260::reference().tool_pose(&Joints::from(START_RAD)).translation * 1e3;
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

fn typing(tick: u64) -> ControlState {
    let state = if tick < 10 { State::IdleCalibrated } else { State::TrajectoryUser };
    ControlState { state: state as u32, entered_ns: 25_000_000, ..ControlState::ZERO }
}

fn word(one: &Move, sequence: u32) -> OperatorMove {
    let config = Config { line_mm_s: 60.0, ..Config::default() };
    let step = config.step(one, &Robot::puma260()).unwrap();
    OperatorMove { sequence, ..typed::encode(&step, false) }
}

fn to_joints(by_deg: f64, sequence: u32) -> OperatorMove {
    let goal = Aim::Joints(Joints::from(GOAL_DEG.map(|deg| (deg + by_deg).to_radians())));
    let step = Step { goal, straight: false, t_s: Some(1.0) };
    OperatorMove { sequence, ..typed::encode(&step, false) }
}

/// Every setpoint follows from the one before it by its speed, and its speed within the arm's
/// accelerations: nothing jumps.
fn nothing_jumps(goals: &[Goal]) {
    let arm = Puma260::reference();
    for (tick, pair) in goals.windows(2).enumerate().skip(10) {
        let [a, b] = pair else { unreachable!() };
        let (q, qd) = (Joints::from(b.q_rad), Joints::from(b.qd_rad_s));
        let (q0, qd0) = (Joints::from(a.q_rad), Joints::from(a.qd_rad_s));
        assert_eq!(b.valid, 1, "tick {tick}");
        let share = (qd - qd0).component_div(&(arm.acceleration_max_rad_s2 * 0.0025)).amax();
        assert!(share <= 1.0 + 1e-6, "tick {tick}: {share} of the acceleration");
        assert!((q - q0 - (qd + qd0) * 0.00125).amax() < 2e-4, "tick {tick}: no jump");
        let share = qd.component_div(&arm.speed_max_rad_s).amax();
        assert!(share <= 1.0 + 1e-9, "tick {tick}: {share} of the speed");
    }
}

fn end_of(goals: &[Goal]) -> [f64; 6] {
    goals.last().unwrap().q_rad.map(f64::to_degrees)
}

#[test]
fn a_move_typed_in_mid_motion_is_joined_without_a_stop() {
    let moves = |tick: u64| match tick {
        0..20 => OperatorMove::ZERO,
        20..200 => to_joints(0.0, 1),
        _ => to_joints(-12.0, 2),
    };
    let script = Script { control: typing, desired: still, joints: calibrated, moves };
    let (keep, faults) = run_kept(Config::default(), &script, 1500);
    assert!(faults.is_empty());
    nothing_jumps(&keep.goals);
    let moving = |goal: &&Goal| Joints::from(goal.qd_rad_s) != Joints::zeros();
    let first = keep.goals.iter().position(|goal| moving(&goal)).unwrap();
    let span = keep.goals[first..].iter().take_while(moving).count();
    let rest = keep.goals[first + span..].iter().filter(moving).count();
    assert_eq!(rest, 0, "one motion, without a stop");
    assert!(span > 100, "{span}");
    let wanted = GOAL_DEG.map(|deg| deg - 12.0);
    assert!(end_of(&keep.goals).iter().zip(wanted).all(|(q, w)| (q - w).abs() < 1e-9));
    let typed = keep.typed.last().unwrap();
    assert_eq!((typed.received, typed.checked, typed.refused), (2, 2, 0));
    assert_eq!((typed.queued, typed.moving, typed.paused), (0, 0, 0));
    assert_eq!(keep.check.unwrap().verdict, 2);
}

#[test]
fn joints_and_lines_are_mixed_and_join_at_rest() {
    let moves = |tick: u64| match tick {
        0..20 => OperatorMove::ZERO,
        20..40 => to_joints(0.0, 1),
        40..50 => word(&by_mm([20.0, 0.0, 0.0], true), 2),
        50..80 => word(&by_mm([0.0, 15.0, 0.0], true), 3),
        _ => to_joints(2.0, 4),
    };
    let script = Script { control: typing, desired: still, joints: calibrated, moves };
    let (keep, faults) = run_kept(Config::default(), &script, 2400);
    assert!(faults.is_empty());
    nothing_jumps(&keep.goals);
    let most = keep.typed.iter().map(|typed| typed.queued).max();
    assert_eq!(most, Some(4), "all wait at first");
    let wanted = GOAL_DEG.map(|deg| deg + 2.0);
    assert!(end_of(&keep.goals).iter().zip(wanted).all(|(q, w)| (q - w).abs() < 1e-9));
}

#[test]
fn a_pause_stays_on_the_path_and_the_motion_ends_where_it_would_have() {
    fn command(kind: MoveKind, sequence: u32) -> OperatorMove {
        OperatorMove { sequence, ..typed::command(kind) }
    }
    fn begin(tick: u64, first: fn() -> OperatorMove) -> OperatorMove {
        match tick {
            0..20 => OperatorMove::ZERO,
            20..240 => first(),
            240..500 => command(MoveKind::Pause, 2),
            _ => command(MoveKind::Resume, 3),
        }
    }
    let line = |tick: u64| begin(tick, || word(&by_mm([60.0, 10.0, 0.0], true), 1));
    let joints = |tick: u64| begin(tick, || to_joints(0.0, 1));
    for (moves, straight) in [(line as fn(u64) -> OperatorMove, true), (joints, false)] {
        let script = Script { control: typing, desired: still, joints: calibrated, moves };
        let (keep, faults) = run_kept(Config::default(), &script, 1800);
        assert!(faults.is_empty());
        nothing_jumps(&keep.goals);
        let stood = &keep.goals[400..500];
        assert!(stood.iter().all(|goal| goal == &stood[0]), "stands");
        assert_eq!((keep.typed[450].paused, keep.typed[450].moving), (1, 0));
        assert_eq!(keep.typed[450].queued, 1);
        assert_ne!(stood[0].q_rad, keep.goals.last().unwrap().q_rad, "on the way");
        if straight {
            let arm = Puma260::reference();
            let (from, way) =
                (arm.tool_pose(&Joints::from(START_RAD)), glam::DVec3::new(6.0, 1.0, 0.0));
            for goal in &keep.goals[30..] {
                let pose = arm.tool_pose(&Joints::from(goal.q_rad));
                let at = from.inverse().apply(pose.translation);
                assert!(at.cross(way.normalize()).length() < 1e-9, "on the line: {at}");
            }
        }
    }
}

#[test]
fn an_impossible_move_is_refused_and_the_previous_one_continues() {
    let moves = |tick: u64| match tick {
        0..20 => OperatorMove::ZERO,
        20..30 => to_joints(0.0, 1),
        30..40 => word(&by_mm([0.0, 0.0, 900.0], false), 2),
        _ => to_joints(-3.0, 3),
    };
    let script = Script { control: typing, desired: still, joints: calibrated, moves };
    let (keep, faults) = run_kept(Config::default(), &script, 1500);
    assert!(faults.is_empty(), "no fault of the machine");
    nothing_jumps(&keep.goals);
    let typed = keep.typed.last().unwrap();
    assert_eq!((typed.received, typed.refused, typed.queued), (3, 2, 0));
    assert_eq!((keep.check.unwrap().verdict, keep.check.unwrap().reason), (3, 2));
    assert!(end_of(&keep.goals).iter().zip(GOAL_DEG).all(|(q, w)| (q - w).abs() < 1e-9));
}

#[test]
fn a_move_now_takes_the_place_of_those_before_it_and_clear_forgets_them() {
    let moves = |tick: u64| match tick {
        0..20 => OperatorMove::ZERO,
        20..200 => to_joints(0.0, 1),
        _ => OperatorMove { now: 1, ..to_joints(5.0, 2) },
    };
    let script = Script { control: typing, desired: still, joints: calibrated, moves };
    let (keep, _) = run_kept(Config::default(), &script, 1500);
    nothing_jumps(&keep.goals);
    let wanted = GOAL_DEG.map(|deg| deg + 5.0);
    assert!(end_of(&keep.goals).iter().zip(wanted).all(|(q, w)| (q - w).abs() < 1e-9));
    let clear = |tick: u64| match tick {
        0..20 => OperatorMove::ZERO,
        20..200 => to_joints(0.0, 1),
        _ => OperatorMove { sequence: 2, ..typed::command(MoveKind::Clear) },
    };
    let script = Script { moves: clear, ..script };
    let (keep, _) = run_kept(Config::default(), &script, 800);
    nothing_jumps(&keep.goals);
    assert_eq!(keep.typed.last().unwrap().queued, 0);
    assert!(end_of(&keep.goals).iter().zip(GOAL_DEG).any(|(q, w)| (q - w).abs() > 1.0));
    assert_eq!(keep.goals[700], keep.goals[799], "stands where it came to rest");
}

#[test]
fn moves_with_nan_are_refused() {
    let moves = |tick: u64| match tick {
        0..20 => OperatorMove::ZERO,
        20..30 => OperatorMove { values: [1e300; 12], ..to_joints(0.0, 1) },
        30..40 => OperatorMove { t_s: 1e12, ..to_joints(0.0, 2) },
        40..50 => OperatorMove { t_s: -1.0, ..word(&by_mm([1.0; 3], true), 3) },
        50..60 => OperatorMove {
            values: [0.0; 12],
            kind: MoveKind::Tool as u32,
            sequence: 4,
            ..OperatorMove::ZERO
        },
        _ => OperatorMove { kind: 77, sequence: 5, ..OperatorMove::ZERO },
    };
    let script = Script { control: typing, desired: still, joints: calibrated, moves };
    let (keep, faults) = run_kept(Config::default(), &script, 200);
    assert!(faults.is_empty());
    assert_eq!(keep.goals.last().unwrap().q_rad, START_RAD, "nothing moved");
    let typed = keep.typed.last().unwrap();
    assert_eq!((typed.received, typed.refused, typed.queued), (5, 4, 0));
}
