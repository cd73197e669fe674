//! Tests the task in a machine in virtual time: operators hold keys, release them, fall silent and
//! return.

use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::Payload;
use taktil_signal::{
    ControlState, Desired, Goal, JogCommand, JogFrame, JogObstacle, JogState, JointState, State,
};
use taktil_tasks_jog::{Config, Jog};
use taktil_tests_script::{Bench, SERVO_PERIOD};

const START_RAD: [f64; 6] = [0.1, 0.7, -2.6, 0.35, 0.7, 0.2];
fn run(
    state: fn(u64) -> Option<ControlState>,
    keys: fn(u64) -> Option<JogCommand>,
    joints: fn(u64) -> Option<JointState>,
    ticks: i64,
) -> Vec<Goal> {
    ran(state, keys, joints, ticks).0
}

/// The goals, and the values of the port `state`.
fn ran(
    state: fn(u64) -> Option<ControlState>,
    keys: fn(u64) -> Option<JogCommand>,
    joints: fn(u64) -> Option<JointState>,
    ticks: i64,
) -> (Vec<Goal>, Vec<JogState>) {
    let mut bench = Bench::new();
    let lane = bench.servo();
    bench.feed(lane, "control", state);
    bench.feed(lane, "command", keys);
    bench.feed(lane, "joints", joints);
    bench.task(lane, "jog", |ports| Jog::new(Config::default(), &Robot::puma260(), ports));
    let desired = Desired { q_rad: START_RAD, valid: 1, ..Desired::ZERO };
    bench.feed(lane, "desired", move |_| Some(desired));
    bench.bind_feeds("jog", &["control", "desired", "joints", "command"]);
    let run = bench.run(SERVO_PERIOD * ticks);
    assert!(run.faults().is_empty());
    (run.of("jog.goal"), run.of("jog.state"))
}

#[expect(clippy::unnecessary_wraps, reason = "a feed may be silent")]
fn manual_joint(tick: u64) -> Option<ControlState> {
    let state = if tick < 10 { State::IdleCalibrated } else { State::ManualJoint };
    Some(ControlState { state: state as u32, entered_ns: 25_000_000, ..ControlState::ZERO })
}

#[expect(clippy::unnecessary_wraps, reason = "a feed may be silent")]
fn calibrated(_: u64) -> Option<JointState> {
    Some(JointState { q_rad: START_RAD, calibrated: 1, ..JointState::ZERO })
}

#[expect(clippy::cast_possible_truncation, reason = "small ticks")]
fn held_key(tick: u64) -> JogCommand {
    JogCommand {
        axes: [0.0, 1.0, 0.0, 0.0, 0.0, -1.0],
        frame: JogFrame::Joints as u32,
        sequence: tick as u32,
    }
}

/// Held from tick 20 on; silent from tick 300 on.
fn first_half(tick: u64) -> Option<JogCommand> {
    (tick < 300).then(|| if tick < 20 { JogCommand::ZERO } else { held_key(tick) })
}

/// Jobs from `from` until the goal rests.
fn rests_after(goals: &[Goal], from: usize) -> usize {
    goals[from..].iter().position(|goal| goal.qd_rad_s == [0.0; 6]).expect("it rests")
}

#[test]
fn a_held_key_moves_its_axis_and_a_silent_hand_stops_it_within_a_tenth_of_a_second() {
    // A key is held from tick 20 to 300; then the reader of the keys ends, and its last message was
    // a held key.
    let goals = run(manual_joint, first_half, calibrated, 400);
    assert_eq!(goals[9], Goal::ZERO, "no stay, no goal");
    assert_eq!(
        (goals[10].valid, goals[10].q_rad),
        (1, START_RAD),
        "begins at rest where it stands"
    );
    let full = Puma260::reference().speed_max_rad_s * Config::default().speed;
    assert!((goals[200].qd_rad_s[1] - full[1]).abs() < 1e-12);
    assert!((goals[200].qd_rad_s[5] + full[5]).abs() < 1e-12);
    assert_eq!(goals[200].qd_rad_s[0], 0.0);
    let jobs = rests_after(&goals, 300);
    assert!(jobs * 25 <= 1000, "{jobs} jobs of 2.5 ms after the last word");
    assert_eq!(goals[399].q_rad, goals[300 + jobs].q_rad);
}

#[test]
fn a_hand_that_hangs_on_one_word_stops_it_too_and_going_on_takes_a_new_word() {
    let stuck = |tick: u64| {
        let sequence =
            if tick < 600 { held_key(tick.min(300)).sequence } else { held_key(tick).sequence };
        Some(JogCommand { sequence, ..held_key(0) })
    };
    let goals = run(manual_joint, stuck, calibrated, 700);
    let jobs = rests_after(&goals, 301);
    assert!(jobs * 25 <= 1000, "{jobs}");
    assert!(goals[450..600].iter().all(|goal| goal.qd_rad_s == [0.0; 6]));
    assert!(goals[650].qd_rad_s[1] > 0.0, "the hand is back");
}

#[test]
fn a_key_held_before_anybody_looked_does_nothing() {
    let old = |_| Some(JogCommand { sequence: 7, ..held_key(0) });
    let goals = run(manual_joint, old, calibrated, 200);
    assert!(goals.iter().all(|goal| goal.qd_rad_s == [0.0; 6]));
}

#[test]
fn another_state_or_a_moved_zero_ends_the_stay() {
    let state = |tick| {
        let state = match tick {
            0..10 | 150.. => State::IdleCalibrated,
            _ => State::ManualJoint,
        };
        Some(ControlState { state: state as u32, entered_ns: 25_000_000, ..ControlState::ZERO })
    };
    let goals = run(state, |tick| Some(held_key(tick)), calibrated, 200);
    assert!(goals[149].qd_rad_s[1] > 0.0);
    assert_eq!(goals[150], Goal::ZERO);
    let moved = |tick| {
        calibrated(tick).map(|joints| JointState { datum: u32::from(tick >= 100), ..joints })
    };
    let goals = run(manual_joint, |tick| Some(held_key(tick)), moved, 105);
    assert!(goals[99].qd_rad_s[1] > 0.0);
    let start = goals[100].q_rad;
    let near = |a: [f64; 6], b: [f64; 6]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4);
    assert!(near(start, START_RAD), "anew from where it is wanted, {start:?}");
}

#[test]
fn without_zeros_joints_move_slowly_and_the_tool_not_at_all() {
    let state = |_| {
        let state = State::ManualUncalibrated as u32;
        Some(ControlState { state, ..ControlState::ZERO })
    };
    let raw = |tick| calibrated(tick).map(|joints| JointState { calibrated: 0, ..joints });
    let goals = run(state, |tick| Some(held_key(tick)), raw, 200);
    let slow = Puma260::reference().speed_max_rad_s * Config::default().speed_uncalibrated;
    assert!((goals[199].qd_rad_s[1] - slow[1]).abs() < 1e-12);
    let tool = |tick| Some(JogCommand { frame: JogFrame::Tool as u32, ..held_key(tick) });
    let goals = run(state, tool, raw, 200);
    assert!(goals.iter().all(|goal| goal.qd_rad_s == [0.0; 6]));
    let unknown = |tick| Some(JogCommand { frame: 99, ..held_key(tick) });
    let goals = run(state, unknown, raw, 200);
    assert!(goals.iter().all(|goal| goal.qd_rad_s == [0.0; 6]));
}

fn state(obstacle: JogObstacle, joint: u32, stopped: u32) -> JogState {
    JogState { obstacle: obstacle as u32, joint, stopped }
}

#[test]
fn an_operator_is_told_once_per_change_why_the_arm_does_not_move() {
    // Joint 1 to its limit, then the key is let go.
    let keys = |tick| {
        let pushed = f64::from(u32::from((20..2500).contains(&tick)));
        Some(JogCommand { axes: [pushed, 0.0, 0.0, 0.0, 0.0, 0.0], ..held_key(tick) })
    };
    let (goals, jog_state) = ran(manual_joint, keys, calibrated, 2600);
    let limit = Puma260::reference().q_max_rad[0];
    assert!((goals[2499].q_rad[0] - limit).abs() < 1e-3);
    let free = JogState::ZERO;
    let (slow, stopped) = (state(JogObstacle::Limit, 1, 0), state(JogObstacle::Limit, 1, 1));
    assert_eq!(jog_state, [free, slow, stopped, free]);
    // The tool's keys where joints are pushed.
    let tool = |tick| Some(JogCommand { frame: JogFrame::Tool as u32, ..held_key(tick) });
    let (_, jog_state) = ran(manual_joint, tool, calibrated, 200);
    assert_eq!(jog_state, [free, state(JogObstacle::Frame, 0, 1)]);
    // A hand that falls silent: the arm slows down, then stands.
    let (_, jog_state) = ran(manual_joint, first_half, calibrated, 400);
    assert_eq!(
        jog_state,
        [free, state(JogObstacle::Silent, 0, 0), state(JogObstacle::Silent, 0, 1)]
    );
    // Nothing is reported for a key that the arm obeys, nor outside the MANUAL states.
    let (_, jog_state) = ran(manual_joint, |tick| Some(held_key(tick)), calibrated, 200);
    assert_eq!(jog_state, [free]);
    let idle = |_| Some(ControlState { state: State::IdleCalibrated as u32, ..ControlState::ZERO });
    assert_eq!(ran(idle, |tick| Some(held_key(tick)), calibrated, 200).1, [free]);
}

#[test]
fn a_tool_at_the_edge_of_the_workspace_is_reported() {
    let state = |tick| {
        let state = State::ManualCartesian as u32;
        manual_joint(tick).map(|control| ControlState { state, ..control })
    };
    let away = |tick| {
        let frame = JogFrame::Base as u32;
        Some(JogCommand { axes: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], frame, ..held_key(tick) })
    };
    let (goals, jog_state) = ran(state, away, calibrated, 6000);
    assert!(goals[5999].qd_rad_s.iter().all(|speed| speed.abs() < 1e-3));
    let last = jog_state.last().unwrap();
    assert_eq!(last.stopped, 1, "{jog_state:?}");
    let edges = [
        JogObstacle::Limit,
        JogObstacle::Reach,
        JogObstacle::Branch,
        JogObstacle::Singular,
        JogObstacle::Line,
    ];
    assert!(edges.iter().any(|edge| *edge as u32 == last.obstacle), "{jog_state:?}");
    assert!(jog_state.len() < 200, "{}", jog_state.len());
}
