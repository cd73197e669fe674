//! Holding still: with the gravity term the finger keeps its place; without it every joint gives
//! way by the angle that gravity, Kp and friction predict. The gains are those of the
//! configuration.

use glam::DVec3;
use taktil_lab_scene::scene::Scene;
use taktil_lab_world::WorldTruth;
use taktil_mechanics::Joints;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::Nanos;
use taktil_signal::{ControlState, State, Torque};

use taktil_tests::bench::{RecordedRun, SceneDraft, run};

/// After the state was entered, how long settling may take.
const SETTLING_TIME: Nanos = Nanos::from_secs(1);

/// The machine stands in IDLE for at least 10 s, a hand's breadth over the pin.
fn standing_scene() -> Scene {
    SceneDraft::of("hold.toml").set("duration_s", 12.0).scene()
}

fn scene_without_gravity_term(coulomb_scale: f64) -> Scene {
    let mut scene = standing_scene();
    scene.machine.joint_servo.get_or_insert_default().gravity = false;
    scene.world.arm.coulomb_scale = coulomb_scale;
    scene
}

/// When the machine came to stand in IDLE/CALIBRATED, checked to hold for 10 s from there.
fn settling_end(kept: &RecordedRun) -> Nanos {
    let control = kept.last_control();
    assert_eq!((control.state, control.faults), (State::IdleCalibrated as u32, 0));
    let last = kept.of::<ControlState>("supervisor.control").last().unwrap().0;
    assert!(last - Nanos(control.entered_ns) > Nanos::from_secs(10), "held for less than 10 s");
    Nanos(control.entered_ns) + SETTLING_TIME
}

/// Mean error of each joint, desired minus measured, and mean measured angles (rad).
#[expect(clippy::cast_precision_loss, reason = "counts of samples")]
fn mean_error(kept: &RecordedRun) -> (Joints, Joints) {
    let since = settling_end(kept);
    let torque = kept.of::<Torque>("joint_servo.torque");
    let errors: Vec<Joints> =
        torque.iter().filter(|row| row.0 >= since).map(|row| row.1.error_rad.into()).collect();
    let angles: Vec<Joints> = kept
        .of::<taktil_signal::JointState>("sense.joints")
        .iter()
        .filter(|row| row.0 >= since)
        .map(|row| row.1.q_rad.into())
        .collect();
    let mean = |list: &[Joints]| list.iter().sum::<Joints>() / list.len() as f64;
    (mean(&errors), mean(&angles))
}

/// Kp of the scene's servo (N m/rad).
fn stiffness(scene: &Scene) -> Joints {
    let servo = scene.machine.joint_servo.clone().unwrap();
    servo.tuning(&Robot::puma260()).unwrap().gains().kp_nm_rad
}

#[test]
fn with_the_gravity_term_the_finger_keeps_its_place() {
    let kept = run(&standing_scene(), 1);
    let since = settling_end(&kept);
    let truth: Vec<(Nanos, WorldTruth)> = kept.of("world.truth");
    // Its place is where it stood with the brakes on.
    let place = DVec3::from_array(truth[0].1.tool_m);
    let far = truth.iter().filter(|row| row.0 >= since);
    let far = far.map(|row| (DVec3::from_array(row.1.tool_m) - place).length() * 1e3);
    let far = far.fold(0.0, f64::max);
    assert!(far < 0.1, "the finger left its place by {far} mm");
}

#[test]
fn without_it_and_without_friction_the_droop_is_gravity_over_kp() {
    let scene = scene_without_gravity_term(0.0);
    let kept = run(&scene, 1);
    let (error, q) = mean_error(&kept);
    let dynamics = Dynamics::reference();
    let kp = stiffness(&scene);
    let gravity = dynamics.gravity_torque(&q);
    let due = gravity.component_div(&kp);
    let mut loaded = 0;
    for joint in 0..6 {
        let (found, due) = (error[joint].to_degrees(), due[joint].to_degrees());
        // A joint carries load when its droop is far more than one encoder count.
        if due.abs() > 0.1 {
            loaded += 1;
            let share = found / due;
            assert!((share - 1.0).abs() < 0.02, "joint {}: {found} of {due} deg", joint + 1);
        } else {
            assert!((found - due).abs() < 0.01, "joint {}: {found} for {due} deg", joint + 1);
        }
    }
    assert!(loaded >= 2, "shoulder and elbow carry the arm, {loaded} joints did");
}

#[test]
fn without_it_friction_bears_a_part_of_the_load() {
    let scene = scene_without_gravity_term(1.0);
    let kept = run(&scene, 1);
    let (error, q) = mean_error(&kept);
    let dynamics = Dynamics::reference();
    let kp = stiffness(&scene);
    let band = Friction::reference().coulomb_nm;
    let left = dynamics.gravity_torque(&q) - kp.component_mul(&error);
    for joint in 0..6 {
        // The 2 % is what rounding to encoder counts and D/A words may add.
        let most = band[joint] * 1.02;
        assert!(left[joint].abs() <= most, "joint {}: {} N m of {most}", joint + 1, left[joint]);
    }
    // And the load is there to be borne: the finger did sink.
    let truth: Vec<(Nanos, WorldTruth)> = kept.of("world.truth");
    let sunk = (truth[0].1.tool_m[2] - truth.last().unwrap().1.tool_m[2]) * 1e3;
    assert!(sunk > 1.0, "the finger sank by {sunk} mm only");
}
