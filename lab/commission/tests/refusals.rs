//! What does not answer ends a commissioning with a reason and a remedy, and leaves the robot safe.

use std::path::Path;

use taktil_hal::{Devices, Nanos};
use taktil_lab_commission::simulated::SimulatedRobot;
use taktil_lab_commission::{
    Answer, Cell, Commissioning, Findings, Model, Options, Shown, Stop, Witness,
};
use taktil_lab_scene::scene::Scene;
use taktil_sim::scene::{Fault, FaultKind};

fn scene() -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes/commission.toml");
    Scene::load(&path).unwrap_or_else(|bad| panic!("{bad}"))
}

fn fault(kind: FaultKind, at_s: f64, joint: Option<u32>) -> Fault {
    Fault { joint, ..Fault::at(kind, at_s) }
}

/// Tries to commission the robot of a scene; what comes out, and whether the robot is safe.
fn tried(
    scene: &Scene,
    change: impl FnOnce(&mut Devices),
    options: Options,
    witness: impl FnOnce(SimulatedRobot) -> Box<dyn Witness>,
) -> Result<Findings, Stop> {
    let (robot, mut devices) = SimulatedRobot::new(scene, 1).unwrap();
    change(&mut devices);
    let home: Vec<f64> = scene.start_deg.iter().map(|q| q.to_radians()).collect();
    let model = Model::new(&scene.robot, &home);
    let mut pace = robot.clone();
    let mut witness = witness(robot.clone());
    let mut cell = Cell::new(devices, &mut pace, robot.period(), Nanos::ZERO)?;
    let mut progress = |_: &str| {};
    let commissioning =
        Commissioning::new(&mut cell, &model, witness.as_mut(), &mut progress, options);
    let outcome = commissioning.run();
    robot.wait(Nanos::from_millis(20));
    assert!(robot.is_safe(), "left powered");
    outcome
}

fn stopped(scene: &Scene) -> Stop {
    tried(scene, |_| {}, Options::default(), |robot| Box::new(robot)).unwrap_err()
}

#[test]
fn lines_that_do_not_allow_motion_stop_it_at_once_and_later() {
    for at_s in [0.0, 3.0, 30.0] {
        let mut scene = scene();
        scene.world.fault = vec![fault(FaultKind::EmergencyStop, at_s, None)];
        assert!(stopped(&scene).reason.contains("emergency stop"), "{at_s}");
        scene.world.fault = vec![fault(FaultKind::PowerLoss, at_s, None)];
        assert!(stopped(&scene).reason.contains("no power"), "{at_s}");
    }
}

#[test]
fn an_encoder_that_does_not_count_is_found_out() {
    let mut scene = scene();
    scene.world.fault = vec![fault(FaultKind::DeadEncoder, 0.0, Some(1))];
    let stop = stopped(&scene);
    assert!(stop.reason.contains("motor channel"), "{stop}");
    // In the middle of a joint's way to its stop.
    scene.world.fault = vec![fault(FaultKind::DeadEncoder, 20.0, Some(6))];
    let stop = stopped(&scene);
    assert!(stop.reason.contains("joint 6"), "{stop}");
}

#[test]
fn a_robot_that_falls_when_its_brakes_lift_is_left_alone() {
    let mut scene = scene();
    scene.world.arm.home_deg = [0.0, 10.0, -90.0, 0.0, 0.0, 0.0];
    scene.start_deg = scene.world.arm.home_deg.to_vec();
    let stop = stopped(&scene);
    assert!(stop.reason.contains("moves without torque"), "{stop}");
    assert!(stop.remedy.contains("straight up"), "{stop}");
}

#[test]
fn missing_halves_and_missing_index_pulses_are_refused() {
    let lost = |change: fn(&mut Devices)| {
        tried(&scene(), change, Options::default(), |robot| Box::new(robot)).unwrap_err()
    };
    assert!(lost(|devices| devices.encoders = None).reason.contains("encoders"));
    assert!(lost(|devices| devices.analog_out = None).reason.contains("analog outputs"));
    assert!(lost(|devices| devices.digital_in = None).reason.contains("lines"));
    let mut scene = scene();
    scene.world.arm.index_counts = None;
    assert!(stopped(&scene).reason.contains("no index pulses"));
    let options = Options { seek_stops: false, only_joint: Some(2), ..Options::default() };
    // Without stops the scales of the file are used, and the rest is found.
    scene.wired.gear = None;
    scene.wired.counts_per_rev = None;
    let found = tried(&scene, |_| {}, options, |robot| Box::new(robot)).unwrap();
    assert_eq!(found.joints[1].motor_sign, -1.0);
    assert!(found.joints[2].torque.is_some() && found.joints[1].torque.is_none());
    assert!(!found.unknown.is_empty());
}

#[test]
fn motors_that_are_too_weak_are_named() {
    let options = Options { torque_share_max: 0.05, ..Options::default() };
    let stop = tried(&scene(), |_| {}, options, |robot| Box::new(robot)).unwrap_err();
    assert!(stop.reason.contains("motor channels move an encoder"), "{stop}");
}

/// A witness who mistakes the direction of one joint, or sees nothing.
struct Mistaken {
    eyes: SimulatedRobot,
    joint: Option<usize>,
}

impl Witness for Mistaken {
    fn look(&mut self) -> Result<bool, Stop> {
        self.eyes.look()
    }

    fn seen(&mut self, shown: &Shown) -> Result<Option<Answer>, Stop> {
        Ok(self.eyes.seen(shown)?.map(|answer| match (answer, self.joint) {
            (_, None) => Answer::Again,
            (Answer::Moved { joint, grew }, Some(mistaken)) => {
                Answer::Moved { joint, grew: grew != (joint == mistaken) }
            }
            (answer, _) => answer,
        }))
    }

    fn allow(&mut self, _: usize, _: &str) -> Result<bool, Stop> {
        Ok(true)
    }
}

#[test]
fn a_witness_who_is_wrong_about_a_loaded_joint_is_contradicted() {
    let mistaken = |joint| move |eyes| Box::new(Mistaken { eyes, joint }) as Box<dyn Witness>;
    let stop = tried(&scene(), |_| {}, Options::default(), mistaken(Some(1))).unwrap_err();
    assert!(stop.reason.contains("joint 2"), "{stop}");
    let stop = tried(&scene(), |_| {}, Options::default(), mistaken(None)).unwrap_err();
    assert!(stop.reason.contains("nobody saw"), "{stop}");
}
