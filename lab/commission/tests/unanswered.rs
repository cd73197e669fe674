//! Encoders that do not count, motors that are not connected or drive another joint: each is found
//! out with a reason, and no joint has moved by more than a degree by then.

mod wirings;

use taktil_hal::{AnalogOut, CHANNELS, DacCode, Devices, Error, Nanos};
use taktil_lab_commission::simulated::SimulatedRobot;
use taktil_lab_commission::{Cell, Commissioning, Model, Options, Stop};
use taktil_lab_scene::scene::Scene;
use taktil_sim::scene::{Fault, FaultKind};

use wirings::{cases, drawn, scene};

/// Largest motion of a joint before its direction is known, whether its encoder counts or not.
const MOTION_MAX_DEG: f64 = 1.0;
/// Wirings that are drawn for each defect, beside the one of the scene.
const DRAWN_COUNT: u64 = 2;
const JOINT_COUNT: usize = 6;
/// Wirings that are drawn for dead encoders; the first [`CI_CASE_COUNT`] of them are tried in every
/// run of the tests.
const CASE_COUNT: u64 = 50;
const CI_CASE_COUNT: u64 = 4;

/// The reason why the commissioning of a robot stopped, or that it did not; no joint has moved by
/// more than a limit by then.
fn tried(scene: &Scene, change: impl FnOnce(&mut Devices)) -> Result<(), Stop> {
    let (outcome, moved) = moved(scene, change);
    assert!(moved <= MOTION_MAX_DEG, "a joint moved by {moved} degrees: {outcome:?}");
    outcome
}

/// The same, with the largest motion of a joint whose direction nobody knew (deg).
fn moved(scene: &Scene, change: impl FnOnce(&mut Devices)) -> (Result<(), Stop>, f64) {
    let (outcome, robot) = commissioned(scene, change);
    (outcome, robot.excursions().into_iter().map(f64::to_degrees).fold(0.0, f64::max))
}

/// What came of it, and the robot, which is safe.
fn commissioned(
    scene: &Scene,
    change: impl FnOnce(&mut Devices),
) -> (Result<(), Stop>, SimulatedRobot) {
    let (robot, mut devices) = SimulatedRobot::new(scene, 1).unwrap();
    change(&mut devices);
    let home: Vec<f64> = scene.start_deg.iter().map(|q| q.to_radians()).collect();
    let model = Model::new(&scene.robot, &home);
    let (mut pace, mut witness) = (robot.clone(), robot.clone());
    let mut cell = Cell::new(devices, &mut pace, robot.period(), Nanos::ZERO).unwrap();
    let mut progress = |_: &str| {};
    let options = Options { only_joint: Some(JOINT_COUNT - 1), ..Options::default() };
    let outcome = Commissioning::new(&mut cell, &model, &mut witness, &mut progress, options).run();
    drop(cell);
    robot.wait(Nanos::from_millis(20));
    assert!(robot.is_safe(), "left powered");
    (outcome.map(drop), robot)
}

/// The scene's own wiring and drawn ones.
fn wired_scenes() -> impl Iterator<Item = Scene> {
    let drawn = (0..DRAWN_COUNT).map(|case| {
        let mut scene = scene();
        scene.wired = drawn(case);
        scene
    });
    core::iter::once(scene()).chain(drawn)
}

fn motor_channel(scene: &Scene, joint: usize) -> usize {
    scene.wired.motor_channel.as_ref().map_or(joint, |channels| channels[joint] as usize)
}

/// Tries a scene with the encoder of each joint dead, one after the other; the farthest that a
/// joint moved (deg).
fn try_dead_encoders(name: &str, mut scene: Scene) -> f64 {
    let mut worst = 0.0;
    for joint in 0..JOINT_COUNT {
        let number = u32::try_from(joint + 1).unwrap();
        let dead = Fault { joint: Some(number), ..Fault::at(FaultKind::DeadEncoder, 0.0) };
        scene.world.fault = vec![dead];
        let (outcome, robot) = commissioned(&scene, |_| {});
        let stop = outcome.expect_err("an encoder that is dead");
        let others = robot.excursions().into_iter().fold(0.0, f64::max);
        let moved = robot.travels()[joint].max(others).to_degrees();
        println!("{name}, joint {number}: {moved:.2} deg, {}", stop.reason);
        assert!(moved <= MOTION_MAX_DEG, "{name}, joint {number}: {moved} degrees: {stop}");
        // A joint that is thrown along, or coupled, may answer in place of the one that does not:
        // then it is the pairing that does not come out.
        let reasons = ["did not answer", "no encoder of", "is moved by", "from its", "nobody saw"];
        let is_named = reasons.iter().any(|reason| stop.reason.contains(reason));
        assert!(is_named && stop.remedy.contains("cable"), "{name}, joint {number}: {stop}");
        worst = f64::max(worst, moved);
    }
    worst
}

/// The wirings that are drawn.
fn try_drawn_dead_encoders(cases: std::ops::Range<u64>) -> f64 {
    let worst = cases.map(|case| {
        let mut scene = scene();
        scene.wired = drawn(case);
        try_dead_encoders(&format!("case {case}"), scene)
    });
    worst.fold(0.0, f64::max)
}

#[test]
fn a_dead_encoder_of_any_joint_is_found_out_before_its_joint_could_jump() {
    try_dead_encoders("the scene's wiring", scene());
    try_drawn_dead_encoders(0..CI_CASE_COUNT);
}

#[test]
#[ignore = "minutes: cargo test -p taktil-lab-commission --test unanswered -- --ignored"]
fn no_dead_encoder_of_a_drawn_wiring_lets_its_joint_jump() {
    println!("the farthest: {:.2} deg", try_drawn_dead_encoders(cases(CASE_COUNT)));
}

/// Converters whose channels go elsewhere.
struct Rerouted {
    half: Box<dyn AnalogOut>,
    from: usize,
    to: Option<usize>,
}

impl AnalogOut for Rerouted {
    fn channels(&self) -> usize {
        self.half.channels()
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        self.half.code_range()
    }

    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let mut out = *codes;
        out[self.from] = DacCode(0);
        if let Some(to) = self.to.filter(|_| codes[self.from] != DacCode(0)) {
            out[to] = codes[self.from];
        }
        self.half.commit(release, &out)
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.half.safe()
    }

    fn safe_value(&self) -> DacCode {
        self.half.safe_value()
    }

    fn longest_silence(&self) -> Nanos {
        self.half.longest_silence()
    }
}

fn rerouted(devices: &mut Devices, from: usize, to: Option<usize>) {
    let half = devices.analog_out.take().unwrap();
    devices.analog_out = Some(Box::new(Rerouted { half, from, to }));
}

/// Whether the reason names this joint among those that did not answer. The witness may take a
/// joint that is thrown along for the one that is driven.
fn has_no_answer(stop: &Stop, joint: usize) -> bool {
    let name = format!("joint {}", joint + 1);
    [format!("{name} did not answer"), format!("{name},"), "is moved by motor channels".to_owned()]
        .iter()
        .any(|reason| stop.reason.contains(reason))
}

#[test]
fn a_motor_that_is_not_connected_is_named_with_its_joint() {
    for scene in wired_scenes() {
        for joint in 0..JOINT_COUNT {
            let channel = motor_channel(&scene, joint);
            let stop = tried(&scene, |devices| rerouted(devices, channel, None)).unwrap_err();
            assert!(has_no_answer(&stop, joint), "{joint}: {stop}");
        }
    }
}

#[test]
fn a_motor_whose_torque_goes_to_another_joint_is_found_out() {
    for scene in wired_scenes() {
        for joint in 0..JOINT_COUNT {
            let [from, to] =
                [joint, (joint + 1) % JOINT_COUNT].map(|joint| motor_channel(&scene, joint));
            let stop = tried(&scene, |devices| rerouted(devices, from, Some(to))).unwrap_err();
            // A light joint that does not answer stops it before a heavy one is found.
            assert!(has_no_answer(&stop, joint), "joint {joint}: {stop}");
        }
    }
}

#[test]
fn encoders_that_are_too_coarse_by_the_file_are_refused_before_anything_is_powered() {
    let mut scene = scene();
    let gears = [46.72, 69.9733, 42.9867, 43.5111, 39.3846, 31.7692];
    let counts = gears.map(|gear| if gear == 43.5111 { 180.0 } else { 1_000.0 });
    scene.machine.joints.get_or_insert_default().counts_per_rev = Some(counts.to_vec());
    let joints = scene.machine.joints.clone().unwrap();
    scene.robot = joints.applied_to(scene.plain_robot.clone()).unwrap();
    let stop = tried(&scene, |_| {}).unwrap_err();
    assert!(stop.reason.contains("joint 4 has 21.8 counts a degree by the file"), "{stop}");
    assert!(stop.remedy.contains("an encoder of at least 199 counts a turn"), "{stop}");
}

#[test]
fn an_arm_that_is_heavier_than_its_model_is_seen_to_fall() {
    let mut scene = scene();
    scene.world.arm.home_deg = [0.0, 82.0, -90.0, 0.0, 0.0, 0.0];
    scene.start_deg = scene.world.arm.home_deg.to_vec();
    let model_rests = tried(&scene, |_| {});
    let falls = |outcome: &Result<(), Stop>| {
        outcome.as_ref().is_err_and(|stop| stop.reason.contains("moves without torque"))
    };
    assert!(!falls(&model_rests), "{model_rests:?}");
    scene.world.arm.link_mass_scale = [8.0; 6];
    let stop = tried(&scene, |_| {}).unwrap_err();
    assert!(stop.reason.contains("the arm moves without torque"), "{stop}");
}
