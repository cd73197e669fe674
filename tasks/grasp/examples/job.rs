//! Repeats the job of a grasp that holds, with a new image of each finger, as often as its argument
//! says, so that instructions can be counted as the difference of two runs: `valgrind
//! --tool=callgrind target/release/examples/job 200` and the same with 2200.

use std::hint::black_box;

use glam::{DMat3, DVec3};
use taktil_mechanics::Pose;
use taktil_mechanics::chain::{Chain, JointSpec};
use taktil_mechanics::hand::ThreeFingers;
use taktil_mechanics::rigid_body::Body;
use taktil_mechanics::spatial::{JointVector, rotation_z};
use taktil_signal::TactileImage;
use taktil_tasks_grasp::Config;
use taktil_tasks_grasp::law::{Inputs, Law};
use taktil_tasks_grasp::touch::touch;

/// Jobs without an argument.
const JOBS_USUAL: u32 = 1000;

fn finger(azimuth_rad: f64) -> Option<Chain<3>> {
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
    Chain::new(&joints, &Pose::new(face, DVec3::new(-0.008, 0.0, -0.05))).ok()
}

fn main() {
    let jobs = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(JOBS_USUAL);
    let third = core::f64::consts::TAU / 3.0;
    let fingers = [finger(0.0), finger(third), finger(2.0 * third)];
    let [Some(a), Some(b), Some(c)] = fingers else { return };
    let (Some(hand), config) = (ThreeFingers::new([a, b, c]), Config::default()) else { return };
    let Ok(tuning) = config.tuning() else { return };
    let q = JointVector::from_fn(|i, _| [0.0, -0.45, 0.45][i % 3]);
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
