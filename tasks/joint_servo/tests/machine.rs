//! Tests the task in a machine in virtual time with scripted inputs.

use taktil_mechanics::Joints;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::{FaultCode, FaultSet, Mode, Payload};
use taktil_signal::{ControlState, Desired, JointState, Torque};
use taktil_tasks_joint_servo::{Config, JointServo};
use taktil_tests_script::{Bench, SERVO_PERIOD};

#[derive(Clone, Copy)]
struct Script {
    control: fn(u64) -> ControlState,
    desired: fn(u64) -> Desired,
    joints: fn(u64) -> JointState,
}

fn run(config: Config, script: &Script, ticks: i64) -> (Vec<Torque>, FaultSet) {
    let mut bench = Bench::new();
    let lane = bench.servo();
    let Script { control, desired, joints } = *script;
    bench.feed(lane, "control", move |tick| Some(control(tick)));
    bench.feed(lane, "desired", move |tick| Some(desired(tick)));
    bench.feed(lane, "joints", move |tick| Some(joints(tick)));
    bench.task(lane, "joint_servo", |ports| JointServo::new(config, &Robot::puma260(), ports));
    bench.bind_feeds("joint_servo", &["control", "desired", "joints"]);
    let run = bench.run(SERVO_PERIOD * ticks);
    (run.of("joint_servo.torque"), run.faults())
}

const POSE_RAD: [f64; 6] = [0.0, 0.7, -2.68, -3.13, 1.17, 3.13];

fn in_mode(mode: Mode) -> ControlState {
    ControlState { mode: mode.code(), ..ControlState::ZERO }
}

fn at(q_rad: [f64; 6]) -> JointState {
    JointState { q_rad, calibrated: 1, ..JointState::ZERO }
}

fn wanted(q_rad: [f64; 6]) -> Desired {
    Desired { q_rad, valid: 1, ..Desired::ZERO }
}

fn plain() -> Config {
    Config { gravity: false, kp_nm_rad: Some(vec![100.0; 6]), ..Config::default() }
}

#[test]
fn torque_flows_only_while_the_mode_allows_it_and_something_is_desired() {
    let script = Script {
        control: |tick| in_mode(if tick < 3 { Mode::Ready } else { Mode::Hold }),
        desired: |tick| Desired { valid: u32::from(tick != 6), ..wanted([0.01; 6]) },
        joints: |_| at([0.0; 6]),
    };
    let (torques, faults) = run(plain(), &script, 9);
    assert!(faults.is_empty());
    for (tick, torque) in torques.iter().enumerate() {
        let flows = tick >= 3 && tick != 6;
        assert_eq!(torque.tau_nm, if flows { [1.0; 6] } else { [0.0; 6] }, "tick {tick}");
        let error = if tick == 6 { 0.0 } else { 0.01 };
        assert_eq!(torque.error_rad, [error; 6], "tick {tick}");
    }
}

#[test]
fn a_moving_zero_is_not_taken_for_a_rate() {
    let script = Script {
        control: |_| in_mode(Mode::Hold),
        desired: |tick| wanted(if tick < 5 { [0.01; 6] } else { [1.02; 6] }),
        joints: |tick| {
            let moved = tick >= 5;
            JointState { datum: u32::from(moved), ..at([if moved { 1.0 } else { 0.0 }; 6]) }
        },
    };
    let (torques, _) = run(plain(), &script, 8);
    for torque in &torques[5..] {
        assert!((torque.tau_nm[2] - 2.0).abs() < 1e-12, "{:?}", torque.tau_nm);
    }
}

#[test]
fn gravity_is_whole_at_once_when_calibrated_and_comes_in_slowly_otherwise() {
    let script = Script {
        control: |tick| in_mode(if tick == 0 { Mode::Ready } else { Mode::Enabling }),
        desired: |_| wanted(POSE_RAD),
        joints: |_| at(POSE_RAD),
    };
    let weight = Dynamics::reference().gravity_torque(&Joints::from(POSE_RAD));
    let (torques, _) = run(Config::default(), &script, 3);
    assert_eq!(torques[0].tau_nm, [0.0; 6]);
    assert_eq!(Joints::from(torques[1].tau_nm), weight);
    let script = Script {
        joints: |tick| JointState { calibrated: u32::from(tick >= 10), ..at(POSE_RAD) },
        ..script
    };
    let (torques, _) = run(Config::default(), &script, 150);
    assert_eq!(torques[9].tau_nm, [0.0; 6]);
    let half = Joints::from(torques[59].tau_nm);
    assert!((half - weight * 0.5).amax() < 1e-9, "0.125 s later: {half}");
    assert!((Joints::from(torques[149].tau_nm) - weight).amax() < 1e-12);
    // From an assumed pose the weight is known at once, and calibrating there changes nothing.
    let assumed = Config {
        assumed_pose_deg: Some(POSE_RAD.map(f64::to_degrees).to_vec()),
        ..Config::default()
    };
    let relative = Script {
        desired: |tick| wanted(if tick < 10 { [0.0; 6] } else { POSE_RAD }),
        joints: |tick| {
            let known = u32::from(tick >= 10);
            let q_rad = if tick < 10 { [0.0; 6] } else { POSE_RAD };
            JointState { calibrated: known, datum: known, ..at(q_rad) }
        },
        ..script
    };
    for torque in &run(assumed, &relative, 20).0[1..] {
        assert!((Joints::from(torque.tau_nm) - weight).amax() < 1e-9, "{:?}", torque.tau_nm);
    }
    let off = Config { gravity: false, ..Config::default() };
    assert_eq!(run(off, &script, 150).0[149].tau_nm, [0.0; 6]);
}

#[test]
fn an_error_beyond_all_numbers_gives_no_torque_and_a_fault() {
    let script = Script {
        control: |_| in_mode(Mode::Moving),
        desired: |tick| wanted([if tick == 2 { 1e308 } else { 0.01 }; 6]),
        joints: |tick| at([if tick == 2 { -1e308 } else { 0.0 }; 6]),
    };
    let (torques, faults) = run(plain(), &script, 4);
    assert!(faults.contains(FaultCode::NotFinite));
    assert_eq!((torques[2].tau_nm, torques[2].error_rad), ([0.0; 6], [0.0; 6]));
    assert_eq!(torques[3].tau_nm, [1.0; 6]);
}

#[test]
fn a_bad_table_builds_no_task() {
    let mut bench = Bench::new();
    let lane = bench.servo();
    let config = Config { bandwidth_rad_s: Some(vec![60.0, f64::NAN]), ..plain() };
    let refused = bench
        .refused(lane, "joint_servo", |ports| JointServo::new(config, &Robot::puma260(), ports));
    assert_eq!(refused.place, "bandwidth_rad_s[1]");
}
