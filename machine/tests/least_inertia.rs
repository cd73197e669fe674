//! What the watch over motors that run away takes for the least inertia of a motor in a pose that
//! is not known: no shipped arm or hand has less in any pose.

use std::path::Path;

use taktil_machine::robot::{ArmConfig, load};
use taktil_machine::with_robot;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_tasks_actuate::runaway::{Motion, MotorModel};

const PERIOD_S: f64 = 2.5e-3;
const POSE_COUNT: u32 = 60;
const MACHINES: [&str; 6] = [
    "ur5e-like",
    "seven-joints",
    "two-fingers",
    "three-fingers",
    "arm-with-two-fingers",
    "arm-with-three-fingers",
];

/// A number from 0 to 1 for joint `i` in pose `k`, by a sequence of small discrepancy.
fn share(k: u32, i: usize) -> f64 {
    let golden = 0.618_033_988_749_895;
    let step = (0..i).fold(golden, |power, _| power * golden);
    (f64::from(k) * step + 0.37 * i as f64).fract()
}

/// Tries an arm in many poses; tells what the watch takes of what is there, at the largest, and
/// what is there of the inertia in the nominal pose, at the smallest.
fn tried<const N: usize, A: Arm<N>>(name: &str, robot: &Robot<N, A>) -> (f64, f64) {
    let model = MotorModel::new(robot);
    let (low, high) = (robot.arm.q_min(), robot.arm.q_max());
    let load = |q: JointVector<N>, calibrated| {
        let motion = Motion { q_rad: q.into(), qd_rad_s: [0.0; N], calibrated };
        model.load(&motion, PERIOD_S)
    };
    let unknown = load(JointVector::zeros(), false);
    let (mut taken, mut nominal) = (0.0, f64::INFINITY);
    for k in 0..POSE_COUNT {
        let pose = JointVector::from_fn(|i, _| {
            let (low, high) = (low[i].max(-3.15), high[i].min(3.15));
            low + share(k, i) * (high - low)
        });
        let here = load(pose, true);
        for i in 0..N {
            let (found, least) = (here.own_inertia(i), unknown.least_inertia(i));
            assert!(least > 0.0 && least <= found, "{name}, pose {k}, motor {i}: {least} {found}");
            taken = f64::max(taken, least / found);
            nominal = f64::min(nominal, found / unknown.own_inertia(i));
        }
    }
    (taken, nominal)
}

#[test]
fn no_shipped_arm_has_less_inertia_in_any_pose_than_the_watch_over_its_motors_takes() {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sim/scenes/machine");
    for name in MACHINES {
        let text = std::fs::read_to_string(scenes.join(format!("{name}.toml"))).unwrap();
        let table: toml::Table = text.parse().unwrap();
        let arm: ArmConfig = table["arm"].clone().try_into().unwrap();
        let (robot, _) = load(Some(&arm), &scenes).unwrap();
        let (taken, nominal) = with_robot!(&robot, robot => tried(name, robot));
        println!("{name}: {taken:.2} taken at most, {nominal:.2} of the nominal pose at least");
    }
}
