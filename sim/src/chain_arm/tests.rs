//! Tests arms of six and seven joints that swing, hold, stick and meet their stops.

use core::f64::consts::FRAC_PI_2;

use super::*;
use taktil_mechanics::chain::{Chain, DhRow, JointSpec};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::{Dynamics, LINKS, TOOL};
use taktil_mechanics::rigid_body::Body;
use taktil_mechanics::transmission::{Drive, Transmission};

/// A robot of `N` links of 2 kg that turn about axes across each other.
fn robot<const N: usize>(coulomb_nm: f64, reach_rad: f64) -> ChainRobot<N> {
    let body = Body::diagonal(2.0, [-0.1, 0.0, 0.0], [0.01, 0.02, 0.02]);
    let row = |i: usize| DhRow {
        a_m: 0.2,
        d_m: 0.05,
        alpha_rad: if i.is_multiple_of(2) { FRAC_PI_2 } else { 0.0 },
        theta_rad: 0.0,
        spec: JointSpec { body, q_min: -reach_rad, q_max: reach_rad, ..JointSpec::default() },
    };
    robot_of(Chain::from_dh(&core::array::from_fn(row), &Pose::IDENTITY).unwrap(), coulomb_nm)
}

fn robot_of<const N: usize>(arm: Chain<N>, coulomb_nm: f64) -> ChainRobot<N> {
    ChainRobot {
        dynamics: arm,
        arm,
        gears: Transmission::uncoupled(&JointVector::repeat(100.0), &JointVector::repeat(4000.0)),
        drive: Drive {
            torque_constant_nm_a: JointVector::repeat(0.1),
            current_max_a: JointVector::repeat(10.0),
            dac_bits: 16,
        },
        friction: Friction {
            coulomb_nm: JointVector::repeat(coulomb_nm),
            viscous_nms_rad: JointVector::zeros(),
        },
        home_rad: JointVector::zeros(),
        nominal_rad: JointVector::zeros(),
        torque_max_nm: JointVector::repeat(100.0),
        joint_names: Vec::new(),
    }
}

fn lines(enabled: bool, braked: bool) -> DriveLines {
    DriveLines { enabled, braked }
}

fn released<const N: usize>(robot: &ChainRobot<N>, start: [f64; N]) -> ChainArm<N> {
    let model = ArmModel::RigidMotors;
    let mut arm = ChainArm::new(robot, &start, &ArmConfig::default(), model, false).unwrap();
    arm.drive(&[0; CHANNELS], lines(false, false));
    arm
}

/// Largest drift of the energy over the largest energy of motion in a second.
fn drift<const N: usize>(h: f64) -> f64 {
    let mut arm = released::<N>(&robot(0.0, 1e3), core::array::from_fn(|i| 0.3 + 0.2 * i as f64));
    let start = arm.energy_j();
    let (mut most, mut peak) = (0.0_f64, 0.0_f64);
    for _ in 0..(1.0 / h).round() as u32 {
        arm.step(h, &Joints::zeros());
        most = most.max((arm.energy_j() - start).abs());
        peak = peak
            .max(0.5 * arm.state.qd.dot(&(arm.robot.arm.mass_matrix(&arm.state.q) * arm.state.qd)));
    }
    assert!(peak > 1.0, "it swings: {peak} J");
    most / peak
}

#[test]
fn a_free_swing_keeps_its_energy_to_second_order() {
    for (coarse, fine) in
        [(drift::<6>(1e-3), drift::<6>(2.5e-4)), (drift::<7>(1e-3), drift::<7>(2.5e-4))]
    {
        println!("drift at 1 ms {coarse:.1e}, at 0.25 ms {fine:.1e}");
        assert!(coarse < 2e-2, "{coarse:e}");
        // A quarter of the step gives a sixteenth of the error, with a margin for higher orders.
        assert!(fine < coarse / 6.0, "{coarse:e} {fine:e}");
    }
}

#[test]
fn the_puma_as_a_chain_swings_as_the_puma() {
    let (puma, dynamics) = (Puma260::reference(), Dynamics::reference());
    let twists = [FRAC_PI_2, 0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, 0.0];
    let row = |i: usize| DhRow {
        a_m: if i == 1 { puma.a2_m } else { 0.0 },
        d_m: [0.0, 0.0, puma.d3_m, puma.d4_m, 0.0, 0.0][i],
        alpha_rad: twists[i],
        theta_rad: 0.0,
        spec: JointSpec {
            body: if i == 5 { LINKS[5].combine(&TOOL) } else { LINKS[i] },
            reflected_inertia: dynamics.reflected_inertia_kg_m2[i],
            q_min: -100.0,
            q_max: 100.0,
            ..JointSpec::default()
        },
    };
    let tool = Pose::new(glam::DMat3::IDENTITY, glam::DVec3::new(0.0, 0.0, puma.tool_z_m));
    let chain = Chain::from_dh(&core::array::from_fn(row), &tool).unwrap();
    let start = [0.1, 0.6, -2.4, 0.3, 0.9, -0.2];
    let mut arm = released(&robot_of(chain, 0.0), start);
    let mut other =
        taktil_mechanics::puma260::dynamics::State { q: Joints::from(start), qd: Joints::zeros() };
    let mut none = |_: f64, _: &Joints, _: &Joints| Joints::zeros();
    for _ in 0..2000 {
        arm.step(2.5e-4, &Joints::zeros());
        other = taktil_mechanics::puma260::dynamics::rk4_step(
            &dynamics, &other, 0.0, 2.5e-4, &mut none,
        );
    }
    let off = (arm.state.q - other.q).amax();
    println!("after 0.5 s {off:.1e} rad from the reference");
    assert!(off < 1e-4, "{off:e}");
}

#[test]
fn brakes_hold_stops_stop_and_friction_sticks() {
    let mut arm = released::<7>(&robot(0.0, 0.5), [0.1; 7]);
    arm.drive(&[0; CHANNELS], lines(true, true));
    let before = arm.state.q;
    (0..100).for_each(|_| arm.step(1e-3, &Joints::zeros()));
    assert_eq!((arm.state.q, arm.state.qd), (before, JointVector::zeros()));
    arm.drive(&[0; CHANNELS], lines(false, false));
    (0..4000).for_each(|_| arm.step(1e-3, &Joints::zeros()));
    assert!(arm.state.q.amax() <= 0.5 && arm.state.q.amax() > 0.499, "{}", arm.state.q);
    // With more friction than gravity the arm moves by less than its bristles yield, and then
    // rests.
    let mut stuck = released::<7>(&robot(500.0, 3.0), [0.1; 7]);
    (0..2000).for_each(|_| stuck.step(1.25e-3, &Joints::zeros()));
    assert!((stuck.state.q - JointVector::<7>::repeat(0.1)).amax() < 1e-4, "{}", stuck.state.q);
    assert!(stuck.state.qd.amax() < 1e-9, "{}", stuck.state.qd);
}

#[test]
fn codes_turn_joints_and_counts_follow() {
    let mut arm = released::<7>(&robot(0.0, 3.0), [0.0; 7]);
    let mut codes = [0; CHANNELS];
    codes[6] = 32767;
    arm.drive(&codes, lines(true, false));
    arm.step(1e-3, &Joints::zeros());
    assert!(arm.state.qd[6] > 0.0, "{}", arm.state.qd);
    (0..20).for_each(|_| arm.step(1e-3, &Joints::zeros()));
    let wanted = (arm.state.q[6] * 100.0 * 4000.0 / core::f64::consts::TAU).round();
    assert_eq!(f64::from(arm.counts()[6]), wanted);
    assert_eq!(arm.counts()[7], 0);
    assert_eq!(arm.current_codes(), codes);
    arm.drive(&codes, lines(false, false));
    assert_eq!(arm.current_codes(), [0; CHANNELS]);
}

#[test]
fn impossible_starts_are_refused() {
    let robot = robot::<6>(0.0, 1.0);
    let place = |start: &[f64], config: &ArmConfig| {
        ChainArm::new(&robot, start, config, ArmModel::Rigid, false).unwrap_err().place
    };
    let usual = ArmConfig::default();
    assert_eq!(place(&[0.0; 5], &usual), "arm");
    assert_eq!(place(&[0.0, 0.0, 1.1, 0.0, 0.0, 0.0], &usual), "arm");
    assert_eq!(place(&[f64::NAN; 6], &usual), "arm");
    let careless = ArmConfig { zero_error_deg: [1.0; 6], ..usual };
    assert_eq!(place(&[0.0; 6], &careless), "arm");
}
