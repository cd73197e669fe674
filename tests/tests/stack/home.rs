//! The home pose by index pulses: a zero that is off by a degree is found to the count, and a pose
//! that contradicts the pulses is refused. The simulated arm's own angles are the measure.

use taktil_lab_world::WorldTruth;
use taktil_rtcore::{FaultCode, FaultSet};
use taktil_signal::{ControlState, HomeCheck, JointState, State};
use toml::Value;

use taktil_tests::bench::{RecordedRun, SceneDraft, run};

fn list(values: [f64; 6]) -> Value {
    Value::Array(values.map(Value::Float).to_vec())
}

/// Largest distance of what `sense` says from where the joints are, in the last job (rad).
fn wrong_rad(kept: &RecordedRun) -> f64 {
    let said = kept.of::<JointState>("sense.joints").pop().unwrap();
    let truth = kept.of::<WorldTruth>("world.truth").pop().unwrap().1;
    (0..6).map(|i| (said.1.q_rad[i] - truth.q_rad[i]).abs()).fold(0.0, f64::max)
}

#[test]
fn a_zero_that_is_off_is_found_by_the_pulses() {
    let kept = run(&SceneDraft::of("home.toml").scene(), 1);
    let told = kept.of::<HomeCheck>("sense.home");
    assert_eq!(told.len(), 2);
    assert_eq!(told[0].1.refused, FaultCode::IndexMissing as u32, "nothing has turned yet");
    assert_eq!(told[1].1.refused, 0);
    // What was 1.1 deg off at power-up is known to a count of each motor: 0.01 deg at the worst.
    assert!(told[1].1.error_rad[5].abs() > 0.01, "{:?}", told[1].1.error_rad);
    assert!(wrong_rad(&kept) < 0.02f64.to_radians(), "{}", wrong_rad(&kept).to_degrees());
    let states: Vec<u32> =
        kept.of::<ControlState>("supervisor.control").iter().map(|row| row.1.state).collect();
    let first = states.iter().position(|state| *state == State::IdleCalibrated as u32).unwrap();
    assert!(states[first..first + 20].contains(&(State::IdleUncalibrated as u32)), "denied");
    assert!(states.contains(&(State::ManualJoint as u32)), "granted, and it moves");
    let control = kept.last_control();
    assert_eq!(FaultSet(control.faults), FaultSet::NONE, "a refusal is a note, nothing stopped");
}

#[test]
fn without_pulses_the_same_zero_stays_wrong() {
    let draft = SceneDraft::of("home.toml").set("robot.sense.index.ignore", true);
    let kept = run(&draft.scene(), 1);
    assert!(wrong_rad(&kept) > 0.3f64.to_radians(), "the pulses made no difference");
}

#[test]
fn a_pose_that_is_far_from_home_by_the_pulses_is_refused() {
    // The pulses are where they are; home is said to be a third of a turn of motor 2 away.
    let home = [120.0, 400.0 + 333.0, 777.0, 0.0, 31.0, 650.0];
    let draft = SceneDraft::of("home.toml").set("robot.sense.index.home_counts", list(home));
    let kept = run(&draft.scene(), 1);
    let told = kept.of::<HomeCheck>("sense.home");
    assert_eq!((told[1].1.refused, told[1].1.motor), (FaultCode::IndexFar as u32, 2));
    let control = kept.last_control();
    assert_eq!(control.state, State::IdleUncalibrated as u32);
    assert_eq!(kept.of::<JointState>("sense.joints").pop().unwrap().1.calibrated, 0);
}
