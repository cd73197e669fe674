//! Tests hand-overs, refusals, stops and changes of the zero, one rule in each test.

use super::*;
use taktil_mechanics::Joints;
use taktil_rtcore::Payload;

const DT_S: f64 = 0.0025;
const V_MAX: f64 = 2.0;
/// The largest step of a goal in one job.
const STEP_MAX_RAD: f64 = STEP_MARGIN * V_MAX * DT_S;

fn law() -> Law {
    Law::new(Bounds {
        q_min_rad: Joints::repeat(-1.0),
        q_max_rad: Joints::repeat(1.0),
        v_max_rad_s: Joints::repeat(V_MAX),
        bumpless_rad: 0.004,
        lead_max_rad: 0.1,
        stop_time_s: 0.2,
    })
}

fn inputs(state: State, mode: Mode, measured: f64) -> Inputs {
    Inputs {
        measured: JointState { q_rad: [measured; 6], calibrated: 1, ..JointState::ZERO },
        state,
        mode,
        jog: None,
        trajectory: None,
        tactile: None,
        dt_s: DT_S,
    }
}

fn goal(q: f64, qd: f64) -> Option<Goal> {
    Some(Goal { q_rad: [q; 6], qd_rad_s: [qd; 6], valid: 1, done: 0 })
}

/// A law in TRAJECTORY that has taken over a goal at `q` with speed `qd`.
fn moving(q: f64, qd: f64) -> (Law, Inputs) {
    let mut law = law();
    let mut inputs = inputs(State::Trajectory, Mode::Moving, q);
    inputs.trajectory = goal(q, qd);
    assert_eq!(law.step(&inputs).1, Ok(()));
    (law, inputs)
}

#[test]
fn each_state_has_the_source_that_the_table_names() {
    for state in State::ALL {
        let expected = match state {
            State::Trajectory | State::TrajectoryUser => Source::Trajectory,
            State::TactileServo => Source::Tactile,
            State::ManualUncalibrated | State::ManualJoint | State::ManualCartesian => Source::Jog,
            _ => Source::Hold,
        };
        assert_eq!(source(state), expected, "{state:?}");
        let mut law = law();
        let mut inputs = inputs(state, Mode::Moving, 0.0);
        inputs.trajectory = goal(0.001, 0.0);
        inputs.tactile = goal(0.002, 0.0);
        inputs.jog = goal(0.003, 0.0);
        let (desired, fault) = law.step(&inputs);
        assert_eq!(fault, Ok(()));
        let wanted = match expected {
            Source::Hold => 0.0,
            Source::Trajectory => 0.001,
            Source::Tactile => 0.002,
            Source::Jog => 0.003,
        };
        assert_eq!(desired.q_rad, [wanted; 6], "{state:?}");
        assert_eq!((desired.source, desired.valid), (state as u32, 1));
    }
}

#[test]
fn without_torque_the_desired_joints_are_the_measured_ones() {
    for mode in Mode::ALL {
        let (mut law, mut inputs) = moving(0.0, 1.0);
        inputs.mode = mode;
        inputs.measured.q_rad = [0.05; 6];
        inputs.trajectory = goal(0.0, 0.0);
        let (desired, _) = law.step(&inputs);
        if mode.torque_allowed() {
            assert_ne!(desired.q_rad, [0.05; 6], "{mode:?}");
        } else {
            assert_eq!((desired.q_rad, desired.qd_rad_s), ([0.05; 6], [0.0; 6]), "{mode:?}");
        }
    }
}

#[test]
fn enabling_holds_the_place_where_torque_began() {
    let mut law = law();
    let _ = law.step(&inputs(State::Start, Mode::Ready, 0.3));
    for measured in [0.31, 0.25, -0.5] {
        let (desired, fault) = law.step(&inputs(State::Start, Mode::Enabling, measured));
        assert_eq!((desired.q_rad, fault), ([0.3; 6], Ok(())));
    }
}

#[test]
fn the_first_goal_of_a_source_must_be_where_the_arm_is_wanted() {
    let (mut law, mut inputs) = moving(0.0, 0.0);
    inputs.state = State::TactileServo;
    inputs.tactile = goal(0.004, 0.0);
    assert_eq!(law.step(&inputs).0.q_rad, [0.004; 6], "the bound itself is allowed");
    for bad in [-0.000_2, 0.008_1, f64::NAN, f64::INFINITY, -1e300] {
        let mut law = law.clone();
        inputs.state = State::TrajectoryUser;
        inputs.trajectory = goal(bad, 0.0);
        for _ in 0..3 {
            let (desired, fault) = law.step(&inputs);
            assert_eq!(fault, Err(FaultCode::NotBumpless), "{bad}");
            assert_eq!(desired.q_rad, [0.004; 6], "held");
        }
    }
}

#[test]
fn a_source_that_paused_has_to_be_bumpless_again() {
    let (mut law, mut inputs) = moving(0.0, 0.0);
    inputs.trajectory = Some(Goal { valid: 0, ..goal(0.0, 0.0).unwrap() });
    assert_eq!(law.step(&inputs).1, Ok(()));
    inputs.trajectory = goal(0.006, 0.0);
    assert_eq!(law.step(&inputs).1, Err(FaultCode::NotBumpless));
    let (mut law, mut inputs) = moving(0.0, 0.0);
    inputs.trajectory = goal(0.006, 0.0);
    assert_eq!(law.step(&inputs).1, Ok(()), "the same step of a source at work is fine");
}

#[test]
fn a_goal_steps_no_further_than_the_speed_allows() {
    for sign in [-1.0, 1.0] {
        let (mut law, mut inputs) = moving(0.0, 0.0);
        inputs.trajectory = goal(sign * STEP_MAX_RAD, 0.0);
        assert_eq!(law.step(&inputs).1, Ok(()), "the limit itself is allowed");
        let (mut law, mut inputs) = moving(0.0, 0.0);
        inputs.trajectory = goal(sign * STEP_MAX_RAD * 1.001, 0.0);
        let (desired, fault) = law.step(&inputs);
        assert_eq!((desired.q_rad, fault), ([0.0; 6], Err(FaultCode::SetpointJump)));
        let (mut law, mut inputs) = moving(0.0, 0.0);
        inputs.dt_s = 2.0 * DT_S;
        inputs.trajectory = goal(sign * STEP_MAX_RAD * 1.9, 0.0);
        assert_eq!(law.step(&inputs).1, Ok(()), "a skipped job allows for two steps");
    }
    for bad in [f64::NAN, f64::NEG_INFINITY, 1e300] {
        let (mut law, mut inputs) = moving(0.0, 0.0);
        inputs.trajectory = goal(bad, 0.0);
        assert_eq!(law.step(&inputs).1, Err(FaultCode::SetpointJump), "{bad}");
    }
}

#[test]
fn a_goal_claims_no_impossible_speed() {
    for bad in [STEP_MARGIN * V_MAX * 1.001, f64::NAN, f64::INFINITY] {
        let (mut law, mut inputs) = moving(0.0, 0.0);
        inputs.trajectory = goal(0.0, bad);
        let (desired, fault) = law.step(&inputs);
        assert_eq!((desired.qd_rad_s, fault), ([0.0; 6], Err(FaultCode::SetpointJump)), "{bad}");
    }
}

#[test]
fn limits_hold_once_they_mean_something() {
    for sign in [-1.0, 1.0] {
        let (mut law, mut inputs) = moving(sign * 0.999, 0.0);
        inputs.trajectory = goal(sign, 0.0);
        assert_eq!(law.step(&inputs).1, Ok(()), "the limit itself is allowed");
        inputs.trajectory = goal(sign * 1.000_001, 0.0);
        let (desired, fault) = law.clone().step(&inputs);
        assert_eq!((desired.q_rad, fault), ([sign; 6], Err(FaultCode::SoftLimit)));
        inputs.measured.calibrated = 0;
        assert_eq!(law.step(&inputs).1, Ok(()), "angles without a zero have no limits");
    }
}

#[test]
fn from_outside_the_limits_the_way_leads_in_only() {
    for sign in [-1.0, 1.0] {
        let mut law = law();
        let mut inputs = inputs(State::Trajectory, Mode::Ready, sign * 1.05);
        let _ = law.step(&inputs);
        inputs.mode = Mode::Moving;
        inputs.trajectory = goal(sign * 1.049, 0.0);
        assert_eq!(law.step(&inputs).1, Ok(()), "inwards");
        inputs.trajectory = goal(sign * 1.0495, 0.0);
        assert_eq!(law.step(&inputs).1, Err(FaultCode::SoftLimit), "outwards again");
    }
}

#[test]
fn the_desired_joints_do_not_run_away_from_a_blocked_arm() {
    let (mut law, mut inputs) = moving(0.0, 0.4);
    for tick in 1..=200 {
        inputs.trajectory = goal(0.001 * f64::from(tick), 0.4);
        let (desired, fault) = law.step(&inputs);
        assert_eq!(fault, Ok(()));
        assert!(desired.q_rad.iter().all(|q| *q <= 0.1), "measured stays at zero");
    }
    inputs.measured.q_rad = [0.15; 6];
    inputs.trajectory = goal(0.2, 0.0);
    assert_eq!(law.step(&inputs).0.q_rad, [0.2; 6], "freed, the goal is reached");
}

#[test]
fn a_stop_comes_to_rest_in_its_time_without_a_step_in_speed() {
    for (mode, state) in [
        (Mode::Stopping, State::Trajectory),
        (Mode::Hold, State::IdleCalibrated),
        (Mode::Moving, State::Trajectory),
    ] {
        let (mut law, mut inputs) = moving(0.0, 0.8);
        inputs.mode = mode;
        inputs.state = state;
        inputs.trajectory = (mode == Mode::Stopping).then_some(goal(0.5, 2.0)).flatten();
        let mut last = law.step(&inputs).0;
        assert!((last.qd_rad_s[0] - 0.79).abs() < 1e-12);
        for tick in 2..=80 {
            inputs.measured.q_rad = last.q_rad;
            let (desired, fault) = law.step(&inputs);
            assert_eq!(fault, Ok(()));
            assert!((last.qd_rad_s[3] - desired.qd_rad_s[3] - 0.01).abs() < 1e-9, "tick {tick}");
            last = desired;
        }
        assert!((last.q_rad[0] - 0.08).abs() < 1e-9, "half of speed times time");
        assert!(last.qd_rad_s[0].abs() < 1e-9);
        let _ = law.step(&inputs);
        let rest = law.step(&inputs).0;
        assert_eq!(rest.qd_rad_s, [0.0; 6]);
        assert_eq!(law.step(&inputs).0.q_rad, rest.q_rad);
    }
}

#[test]
fn a_stop_does_not_pass_a_limit_nor_leave_a_blocked_arm_behind() {
    let (mut law, mut inputs) = moving(0.99, 1.0);
    inputs.mode = Mode::Stopping;
    for _ in 0..100 {
        assert!(law.step(&inputs).0.q_rad.iter().all(|q| *q <= 1.0));
    }
    let (mut law, mut inputs) = moving(0.0, 2.0);
    inputs.mode = Mode::Stopping;
    for _ in 0..100 {
        assert!(law.step(&inputs).0.q_rad.iter().all(|q| *q <= 0.1));
    }
}

#[test]
fn a_new_zero_moves_the_desired_joints_with_the_measured_ones() {
    let mut law = law();
    let _ = law.step(&inputs(State::IdleUncalibrated, Mode::Ready, 0.01));
    let mut inputs = inputs(State::IdleCalibrated, Mode::Hold, 0.0);
    let before = law.step(&inputs).0;
    assert_eq!(before.q_rad, [0.01; 6], "the arm droops by 0.01");
    inputs.measured.datum = 1;
    inputs.measured.q_rad = [-0.7; 6];
    let after = law.step(&inputs).0;
    assert!(after.q_rad.iter().all(|q| (q - -0.69).abs() < 1e-15), "the droop stays");
    assert_eq!(law.step(&inputs).0.q_rad, after.q_rad, "once only");
}

#[test]
fn a_goal_in_the_old_zero_is_not_taken() {
    let (mut law, mut inputs) = moving(0.0, 0.0);
    inputs.measured.datum = 7;
    inputs.measured.q_rad = [0.5; 6];
    let (desired, fault) = law.step(&inputs);
    assert_eq!((desired.q_rad, fault), ([0.5; 6], Err(FaultCode::NotBumpless)));
}

#[test]
fn measured_nan_does_not_panic() {
    for mode in Mode::ALL {
        let (mut law, mut inputs) = moving(0.0, 1.0);
        inputs.mode = mode;
        inputs.measured.q_rad = [f64::NAN; 6];
        let _ = law.step(&inputs);
        inputs.trajectory = None;
        let _ = law.step(&inputs);
        inputs.measured.datum = 1;
        let _ = law.step(&inputs);
    }
}
