//! Compares the arm with motions that another program computed, to 1e-6 rad.

use core::f64::consts::TAU;
use std::path::PathBuf;

use super::*;

/// Rows of a reference run: time, angles, speeds.
fn run_of(name: &str) -> Vec<(f64, Joints, Joints)> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/kinematics");
    let text = std::fs::read_to_string(path.join(name)).expect("the fixture is there");
    let row = |line: &str| {
        let n: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        let six = |from: usize| Joints::from_fn(|i, _| n[from + i]);
        (n[0], six(1), six(7))
    };
    text.lines().skip(1).map(row).collect()
}

fn list(table: &toml::Table, key: &str) -> Joints {
    let values = table[key].as_array().expect("a list");
    let number = |v: &toml::Value| v.as_float().unwrap_or(0.0);
    Joints::from_fn(|i, _| number(&values[i]))
}

/// Largest error of an angle (rad) when the run is followed with steps of `h`.
fn follow(
    name: &str,
    model: ArmModel,
    h: f64,
    mut torque: impl FnMut(f64, &Joints, &Joints) -> Joints,
) -> f64 {
    let rows = run_of(name);
    let config = ArmConfig { coulomb_scale: 0.0, ..ArmConfig::default() };
    let mut arm = Arm::new(&config, model, 1).unwrap();
    arm.lines.braked = false;
    (arm.state.q, arm.state.qd) = (rows[0].1, rows[0].2);
    let mut worst = 0.0_f64;
    for pair in rows.windows(2) {
        let steps = ((pair[1].0 - pair[0].0) / h).round();
        for i in 0..steps as u32 {
            arm.step_rk4_under(pair[0].0 + h * f64::from(i), h, &mut torque);
        }
        worst = worst.max((arm.state.q - pair[1].1).amax());
    }
    worst
}

#[test]
fn the_passive_reference_is_met_at_servo_steps_and_below() {
    for (h, bar) in [(2.5e-3, 1e-6), (1e-3, 1e-7)] {
        let worst = follow("sim_passive.csv", ArmModel::Rigid, h, |_, _, _| Joints::zeros());
        println!("passive, {h} s: {worst:.1e} rad");
        assert!(worst < bar, "{worst:e}");
    }
}

#[test]
fn the_driven_reference_is_met_at_servo_steps_and_below() {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/kinematics");
    let text = std::fs::read_to_string(path.join("sim_driven.toml")).unwrap();
    let file: toml::Table = text.parse().unwrap();
    let [hold, amp, freq, phase] = ["hold", "amp", "freq", "phase"].map(|key| list(&file, key));
    for (h, bar) in [(2.5e-3, 1e-6), (1e-3, 1e-7)] {
        let worst = follow("sim_driven.csv", ArmModel::RigidMotors, h, |t, _, _| {
            Joints::from_fn(|i, _| {
                let swing = libm::sin(TAU * freq[i] * t + phase[i]) - libm::sin(phase[i]);
                hold[i] + amp[i] * swing
            })
        });
        println!("driven, {h} s: {worst:.1e} rad");
        assert!(worst < bar, "{worst:e}");
    }
}

#[test]
fn a_rigid_arm_has_no_friction() {
    let config = ArmConfig::default();
    assert!(Arm::new(&config, ArmModel::Rigid, 1).unwrap().is_smooth());
    assert!(!Arm::new(&config, ArmModel::RigidMotors, 1).unwrap().is_smooth());
}

#[test]
fn an_arm_at_home_reads_its_home_counts() {
    let mut config = ArmConfig::default();
    for model in [ArmModel::Rigid, ArmModel::RigidMotors, ArmModel::Compliant] {
        let arm = Arm::new(&config, model, 1).unwrap();
        assert_eq!(arm.home_counts().unwrap().counts, [0; JOINT_COUNT], "{model:?}");
    }
    // With soft gears the motors stand hundreds of counts from the joints.
    config.gear_stiffness_nm_rad = [50.0; JOINT_COUNT];
    let arm = Arm::new(&config, ArmModel::Compliant, 1).unwrap();
    assert_eq!(arm.home_counts().unwrap().counts, [0; JOINT_COUNT]);
    let sag = arm.state.rotors.q - arm.state.q;
    assert!(sag.amax() > 1e-3, "{sag:?}");
    let off =
        arm.transmission.counts(&arm.state.rotors.q)[1] - arm.transmission.counts(&arm.state.q)[1];
    assert!(off.abs() > 10, "{off} counts");
}

#[test]
fn a_blow_on_an_end_stop_leaves_the_momenta_of_the_other_joints() {
    let mut arm = Arm::new(&ArmConfig::default(), ArmModel::Rigid, 1).unwrap();
    arm.state.q = Joints::new(arm.puma.q_max_rad[0] + 1e-4, 0.7, -2.6, 1.7, 1.2, 2.8);
    arm.state.qd = Joints::new(0.45, -0.1, 0.2, 0.3, -0.4, 0.1);
    let speeds = arm.state.qd;
    arm.stop_at_limits();
    assert_eq!((arm.state.q[0], arm.state.qd[0]), (arm.puma.q_max_rad[0], 0.0));
    let blow = arm.dynamics.mass_matrix(&arm.state.q) * (arm.state.qd - speeds);
    assert!(blow[0] < -0.1, "{blow}");
    // Rounding of a solution of six equations.
    assert!((1..JOINT_COUNT).all(|i| blow[i].abs() < 1e-12), "{blow}");
    assert!((arm.state.qd[4] - speeds[4]).abs() > 1e-3, "{}", arm.state.qd);
}
