//! Repeats the job of a grasp that holds, with a new image of each finger, as often as its argument
//! says, so that instructions can be counted as the difference of two runs: `valgrind
//! --tool=callgrind target/release/examples/job 200` and the same with 2200. With the word `arm`
//! after it an arm carries the palm and lifts it all along: 15 joints.

use std::hint::black_box;

use glam::{DMat3, DVec3};
use taktil_mechanics::Pose;
use taktil_mechanics::chain::{Chain, JointSpec};
use taktil_mechanics::hand::{Hand, ThreeFingers, ThreeFingersOnArm};
use taktil_mechanics::rigid_body::Body;
use taktil_mechanics::spatial::{JointVector, rotation_z};
use taktil_signal::TactileImage;
use taktil_tasks_grasp::Config;
use taktil_tasks_grasp::law::{Inputs, Law};
use taktil_tasks_grasp::touch::touch;

/// Jobs without an argument.
const JOBS_USUAL: u32 = 1000;

/// The joints of a finger and its fingertip, palm frame.
fn finger_joints(azimuth_rad: f64) -> ([JointSpec; 3], Pose) {
    let base = rotation_z(azimuth_rad);
    let joint = |origin: Pose, axis: DVec3| JointSpec {
        origin,
        axis,
        body: Body::diagonal(0.05, [0.0, 0.0, -0.03], [1e-5; 3]),
        ..JointSpec::default()
    };
    let at = |z| Pose::new(DMat3::IDENTITY, DVec3::new(0.0, 0.0, z));
    let joints = [
        joint(Pose::new(base, base * DVec3::new(0.005, 0.0, 0.0)), DVec3::X),
        joint(at(0.0), DVec3::Y),
        joint(at(-0.065), DVec3::Y),
    ];
    let face = DMat3::from_cols(-DVec3::Y, DVec3::Z, -DVec3::X);
    (joints, Pose::new(face, DVec3::new(-0.008, 0.0, -0.05)))
}

/// A hand whose palm stands.
fn on_palm(fingers: [([JointSpec; 3], Pose); 3]) -> Option<ThreeFingers> {
    let [a, b, c] = fingers.map(|(joints, tip)| Chain::new(&joints, &tip).ok());
    ThreeFingers::new([a?, b?, c?])
}

/// The same on an arm.
fn on_arm(fingers: [([JointSpec; 3], Pose); 3]) -> Option<ThreeFingersOnArm> {
    let axes = [DVec3::Z, DVec3::Y, DVec3::Y, DVec3::Y, DVec3::X, DVec3::Z];
    let arm = axes.map(|axis| JointSpec {
        origin: Pose::new(DMat3::IDENTITY, DVec3::new(0.05, 0.0, 0.2)),
        axis,
        body: Body::diagonal(1.0, [0.0, 0.0, 0.1], [1e-2; 3]),
        ..JointSpec::default()
    });
    let (joints, tips) = (fingers.map(|(joints, _)| joints), fingers.map(|(_, tip)| tip));
    ThreeFingersOnArm::on_arm(&arm, &Pose::IDENTITY, &joints, &tips).ok()
}

/// Repeats the job.
fn repeat<const N: usize>(hand: Hand<3, N>, jobs: u32) {
    let mut config = Config { lift_after_s: 0.0, ..Config::default() };
    if hand.carrier().is_some() {
        (config.lift_mm, config.lift_mm_s) = ([0.0, 0.0, 50.0], 10.0);
    }
    let Ok(tuning) = config.tuning() else { return };
    let bent = [0.3, 0.5, -1.1, 0.6, 0.2, 0.4];
    let q = JointVector::from_fn(|i, _| match i.checked_sub(Hand::<3, N>::CARRIER_JOINTS) {
        None => bent[i],
        Some(own) => [0.0, -0.45, 0.45][own % 3],
    });
    let mut law = Law::new(hand, tuning, &q);
    let mut image = TactileImage::new(16, 16);
    image.valid.fill(1);
    (image.baseline_ready, image.noise_counts) = (1, 10.0);
    for tactel in [118, 119, 120, 134, 135, 136, 150, 151, 152] {
        image.counts[tactel] = 250.0;
    }
    let scale = config.scale();
    for _ in 0..jobs {
        let touch = core::array::from_fn(|_| touch(black_box(&image), &scale));
        let torque_nm = JointVector::from_element(0.1);
        black_box(law.step(&Inputs { q, torque_nm, touch, dt_s: 2.5e-3 }));
    }
}

fn main() {
    let mut words = std::env::args().skip(1);
    let jobs = words.next().and_then(|text| text.parse().ok()).unwrap_or(JOBS_USUAL);
    let third = core::f64::consts::TAU / 3.0;
    let fingers = [0.0, third, 2.0 * third].map(finger_joints);
    if words.next().is_some_and(|word| word == "arm") {
        if let Some(hand) = on_arm(fingers) {
            repeat(hand, jobs);
        }
    } else if let Some(hand) = on_palm(fingers) {
        repeat(hand, jobs);
    }
}
