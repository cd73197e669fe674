//! Encoders that stop counting while the pin is rolled by touch: each is found, whatever its joint
//! does, before the arm is far from where the machine believes it to be.

use taktil_lab_world::WorldTruth;
use taktil_rtcore::Nanos;
use taktil_signal::{ControlState, JointState};

use taktil_tests::bench::{SceneDraft, run};

/// Joints that the rolling asks for motion, and how far each may be from where it is believed to be
/// when it is found (deg). Joint 6 turns the finger about its own axis, slowly, with a torque that
/// friction might take.
const DRIVEN_LOST_MAX_DEG: [(usize, f64); 2] = [(5, 3.0), (6, 8.0)];
/// The same of joint 3 (deg), which presses and is led by the force over seconds: its motion
/// cancels that of the others on the pad.
const LED_LOST_MAX_DEG: f64 = 7.5;
/// Largest force of a finger whose joint is led by the force (N): two and a half times the set
/// point for the time that an overload takes, and a tenth.
const LED_FORCE_MAX_N: f64 = 45.0;
/// The same of joint 2 (deg), which presses: where the contact is lost, it moves by a torque that
/// friction and an error of the model might take until it is found.
const PRESSING_LOST_MAX_DEG: f64 = 5.0;
/// A joint that is not found stays where it is believed to be (deg), because friction holds it.
const HELD_LOST_MAX_DEG: f64 = 0.05;

/// What became of a dead encoder.
struct Outcome {
    /// Code of the first fault.
    fault: Option<u32>,
    /// Largest distance of the joint from where it is believed to be, until then (deg).
    lost_deg: f64,
    /// Largest force of the finger until then (N).
    force_n: f64,
}

fn with_dead_encoder(joint: usize, at_s: f64) -> Outcome {
    let fault = format!("kind = 'dead_encoder'\njoint = {joint}\nat_s = {at_s}");
    let fault: toml::Table = fault.parse().unwrap();
    let scene = SceneDraft::roll_pin().set("world.fault", vec![fault]).scene();
    let kept = run(&scene, 1);
    let control: Vec<(Nanos, ControlState)> = kept.of("supervisor.control");
    let found = control.iter().find(|(_, control)| control.faults != 0);
    let end = found.map_or(scene.duration, |(at, _)| *at);
    let truth: Vec<(Nanos, WorldTruth)> = kept.of("world.truth");
    let believed: Vec<(Nanos, JointState)> = kept.of("sense.joints");
    let rows: Vec<(&WorldTruth, &JointState)> = truth
        .iter()
        .zip(&believed)
        .filter(|((t, _), _)| t.as_secs_f64() > at_s && *t <= end)
        .map(|((_, truth), (_, believed))| (truth, believed))
        .collect();
    let index = joint - 1;
    let lost = rows.iter().map(|(truth, believed)| truth.q_rad[index] - believed.q_rad[index]);
    let outcome = Outcome {
        fault: found.map(|(_, control)| control.first_fault),
        lost_deg: lost.fold(0.0, |most: f64, lost| most.max(lost.to_degrees().abs())),
        force_n: rows.iter().map(|(truth, _)| truth.finger_normal_n).fold(0.0, f64::max),
    };
    println!(
        "joint {joint} at {at_s} s: fault {:?} at {:.3} s, lost {:.2} deg, {:.1} N",
        outcome.fault,
        end.as_secs_f64(),
        outcome.lost_deg,
        outcome.force_n
    );
    outcome
}

const INSTANTS_S: [f64; 3] = [1.0, 3.0, 5.5];

#[test]
fn a_dead_encoder_is_found_in_the_rolling_scene_where_its_joint_is_driven() {
    for (joint, lost_max_deg) in DRIVEN_LOST_MAX_DEG {
        for at_s in INSTANTS_S {
            let outcome = with_dead_encoder(joint, at_s);
            assert!(outcome.fault.is_some(), "joint {joint} at {at_s} s");
            assert!(outcome.lost_deg <= lost_max_deg, "joint {joint}: {} deg", outcome.lost_deg);
        }
    }
}

#[test]
fn joint_3_with_a_dead_encoder_ends_by_its_load_at_the_latest() {
    for at_s in INSTANTS_S {
        let outcome = with_dead_encoder(3, at_s);
        assert!(outcome.lost_deg <= LED_LOST_MAX_DEG, "{} deg", outcome.lost_deg);
        assert!(outcome.force_n <= LED_FORCE_MAX_N, "{} N", outcome.force_n);
    }
}

#[test]
fn a_joint_whose_dead_encoder_is_not_found_stands_or_is_led_by_the_force() {
    for joint in [1, 4] {
        for at_s in INSTANTS_S {
            let outcome = with_dead_encoder(joint, at_s);
            let is_held = outcome.lost_deg <= HELD_LOST_MAX_DEG;
            assert!(outcome.fault.is_some() || is_held, "{joint}: {} deg", outcome.lost_deg);
        }
    }
    // Joint 2 presses. The law of touch leads it by the force, which it still feels, and asks it
    // for no motion of its own.
    for at_s in INSTANTS_S {
        let outcome = with_dead_encoder(2, at_s);
        assert!(outcome.lost_deg < PRESSING_LOST_MAX_DEG, "{} deg", outcome.lost_deg);
        assert!(outcome.fault.is_some() || outcome.force_n < 15.0, "{} N", outcome.force_n);
    }
}
