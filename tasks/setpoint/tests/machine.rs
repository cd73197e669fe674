//! Tests `setpoint` in a machine in virtual time between scripted tasks.

use taktil_mechanics::robot::Robot;
use taktil_rtcore::{FaultCode, Mode, Payload};
use taktil_signal::{ControlState, Desired, Goal, JointState, State};
use taktil_tasks_setpoint::{Config, Setpoint};
use taktil_tests_script::{Bench, SERVO_PERIOD};

const JOBS_RUN: u64 = 200;

/// What the tasks before `setpoint` say in one job; `None`: nothing.
#[derive(Clone, Copy)]
struct Before {
    state: State,
    mode: Mode,
    joints: Option<JointState>,
    trajectory: Option<Goal>,
    tactile: Option<Goal>,
}

const STANDING: Before = Before {
    state: State::IdleCalibrated,
    mode: Mode::Hold,
    joints: Some(JointState { calibrated: 1, ..JointState::ZERO }),
    trajectory: None,
    tactile: None,
};

fn goal(q_rad: f64, qd_rad_s: f64) -> Option<Goal> {
    Some(Goal { q_rad: [q_rad; 6], qd_rad_s: [qd_rad_s; 6], valid: 1, done: 0 })
}

/// Runs [`JOBS_RUN`] jobs; the desired joints of each, and the faults that the lane saw.
fn run(script: fn(u64) -> Before) -> (Vec<Desired>, Vec<FaultCode>) {
    let mut bench = Bench::new();
    let lane = bench.servo();
    bench.feed(lane, "control", move |tick| {
        let Before { state, mode, .. } = script(tick);
        let (state, mode) = (state as u32, mode.code());
        Some(ControlState { state, mode, ..ControlState::ZERO })
    });
    bench.feed(lane, "joints", move |tick| script(tick).joints);
    bench.feed(lane, "trajectory", move |tick| script(tick).trajectory);
    bench.feed(lane, "tactile", move |tick| script(tick).tactile);
    // Nobody jogs here; the port says nothing.
    bench.feed(lane, "jog", |_| None::<Goal>);
    bench.task(lane, "setpoint", |ports| {
        Setpoint::new(Config::default(), &Robot::puma260(), true, ports)
    });
    bench.bind_feeds("setpoint", &["control", "joints", "trajectory", "tactile", "jog"]);
    let run = bench.run(SERVO_PERIOD * i64::try_from(JOBS_RUN).unwrap());
    let desired: Vec<Desired> = run.of("setpoint.desired");
    assert_eq!(desired.len(), usize::try_from(JOBS_RUN).unwrap(), "desired joints in every job");
    (desired, run.faults().iter().collect())
}

/// 0.2 rad/s from job 20 on.
fn path(tick: u64) -> f64 {
    5e-4 * tick.saturating_sub(20) as f64
}

/// Follows [`path`] from job 20 on, with joints that follow exactly.
fn following(tick: u64) -> Before {
    let (state, mode) = if tick < 20 {
        (State::IdleCalibrated, Mode::Hold)
    } else {
        (State::Trajectory, Mode::Moving)
    };
    let joints = JointState { q_rad: [path(tick); 6], calibrated: 1, ..JointState::ZERO };
    let speed = if tick > 20 { 0.2 } else { 0.0 };
    Before { state, mode, joints: Some(joints), trajectory: goal(path(tick), speed), tactile: None }
}

#[test]
fn a_trajectory_is_followed_to_the_letter() {
    let (desired, faults) = run(following);
    assert_eq!(faults, []);
    for (tick, desired) in (0..).zip(&desired) {
        assert_eq!(desired.q_rad, [path(tick); 6], "job {tick}");
        let state = if tick < 20 { State::IdleCalibrated } else { State::Trajectory };
        assert_eq!((desired.source, desired.valid), (state as u32, 1));
    }
}

#[test]
fn nothing_is_desired_before_the_joints_are_known() {
    let (desired, faults) =
        run(|tick| Before { joints: STANDING.joints.filter(|_| tick >= 7), ..STANDING });
    assert_eq!(faults, []);
    for (tick, desired) in (0..).zip(&desired) {
        assert_eq!(desired.valid, u32::from(tick >= 7), "job {tick}");
    }
}

#[test]
fn a_silent_source_is_dropped_after_its_age_and_the_arm_comes_to_rest() {
    let (desired, faults) = run(|tick| {
        let trajectory = following(tick).trajectory.filter(|_| tick <= 100);
        Before { trajectory, ..following(tick) }
    });
    assert_eq!(faults, []);
    let speed = |tick: usize| desired[tick].qd_rad_s[0];
    assert_eq!((speed(100), speed(104)), (0.2, 0.2), "10 ms old is still a goal");
    assert!(speed(105) < 0.2 && speed(105) > 0.19, "then it slows down");
    assert_eq!(speed(190), 0.0);
    assert_eq!(desired[190].q_rad, desired[199].q_rad);
}

#[test]
fn a_jump_of_the_goal_is_refused_and_reported() {
    let (desired, faults) = run(|tick| {
        let far = if tick >= 100 { 0.1 } else { 0.0 };
        Before { trajectory: goal(path(tick) + far, 0.0), ..following(tick) }
    });
    assert_eq!(faults, [FaultCode::SetpointJump, FaultCode::NotBumpless]);
    assert_eq!(desired[199].q_rad, desired[99].q_rad);
}

#[test]
fn a_goal_that_is_not_a_number_does_not_get_through() {
    let (desired, faults) = run(|tick| {
        let q = if tick == 100 { f64::NAN } else { path(tick) };
        Before { trajectory: goal(q, 0.2), ..following(tick) }
    });
    assert_eq!(faults, [FaultCode::NotFinite], "refused where it was written");
    assert!(desired.iter().all(Payload::is_finite));
    assert_eq!(desired[199].q_rad, [path(199); 6], "and the motion goes on");
}

#[test]
fn a_new_zero_causes_no_jump_in_the_servo() {
    let (desired, faults) = run(|tick| {
        let datum = u32::from(tick >= 50);
        let q = if tick >= 50 { -1.0 } else { 0.25 };
        let droop = if tick >= 10 { 0.01 } else { 0.0 };
        let mode = if tick < 10 { Mode::Ready } else { Mode::Hold };
        let joints = JointState { q_rad: [q - droop; 6], datum, ..JointState::ZERO };
        Before { mode, joints: Some(joints), ..STANDING }
    });
    assert_eq!(faults, []);
    for (tick, desired) in desired.iter().enumerate().skip(10) {
        let wanted = if tick >= 50 { -1.0 } else { 0.25 };
        assert!((desired.q_rad[0] - wanted).abs() < 1e-12, "job {tick}");
    }
}
