//! Tests of a hand on an arm: the weight of what it holds on the arm's joints, the energy of tree
//! and object together, and the order of convergence while the arm moves.

use glam::DMat3;
use taktil_mechanics::Matrix6;
use taktil_mechanics::arm::ArmDynamics;
use taktil_mechanics::chain::JointSpec;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::hand::{Hand, ThreeFingersOnArm};
use taktil_mechanics::rigid_body::{Body, GRAVITY_M_S2};
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::to_nalgebra_vector;
use taktil_mechanics::transmission::{Drive, Transmission};

use super::*;
use crate::hand::tests::{at_distance, face_height, finger_joints};
use crate::manipulator::Manipulator;

/// Torque of a motor for one code (N m), behind a gear of 10: fine, so that codes round little.
const CODE_NM: f64 = 40.0 / 8_388_608.0;
const STEP_S: f64 = 1.25e-3;
const ON: DriveLines = DriveLines { enabled: true, braked: false };
/// Joints of the arm in which the palm is level (rad).
const ARM_RAD: [f64; 6] = [0.3, 0.5, -1.1, 0.6, 0.0, 0.4];

fn robot() -> Robot<15, ThreeFingersOnArm> {
    let axes = [DVec3::Z, DVec3::Y, DVec3::Y, DVec3::Y, DVec3::X, DVec3::Z];
    let arm = core::array::from_fn(|i| JointSpec {
        origin: Pose::new(DMat3::IDENTITY, DVec3::new(0.05, 0.01, 0.15)),
        axis: axes[i],
        body: Body::diagonal(2.0 - 0.2 * i as f64, [0.02, 0.0, 0.07], [0.01, 0.012, 0.006]),
        reflected_inertia: 0.3,
        q_min: -3.0,
        q_max: 3.0,
        effort_max: 40.0,
        ..JointSpec::default()
    });
    let third = core::f64::consts::TAU / 3.0;
    let fingers = [0.0, third, 2.0 * third].map(finger_joints);
    let (joints, tips) = (fingers.map(|(joints, _)| joints), fingers.map(|(_, tip)| tip));
    let palm = Pose::new(DMat3::IDENTITY, DVec3::new(0.0, 0.02, 0.05));
    let arm = Hand::on_arm(&arm, &palm, &joints, &tips).unwrap();
    let all = |x: f64| JointVector::<15>::from_element(x);
    let home = start();
    Robot {
        torque_max_nm: *arm.effort_max(),
        dynamics: arm,
        arm,
        gears: Transmission::uncoupled(&all(10.0), &all(4096.0)),
        drive: Drive { torque_constant_nm_a: all(0.1), current_max_a: all(40.0), dac_bits: 24 },
        friction: Friction { coulomb_nm: all(0.0), viscous_nms_rad: all(0.0) },
        home_rad: home,
        nominal_rad: home,
        joint_names: Vec::new(),
    }
}

/// The arm level, the fingers at a distance from the middle (m).
fn with_fingers(distance_m: f64) -> JointVector<15> {
    let own = at_distance(distance_m);
    JointVector::from_fn(|i, _| if i < 6 { ARM_RAD[i] } else { own[i - 6] })
}

fn start() -> JointVector<15> {
    with_fingers(0.04)
}

/// A hand around a ball on its support.
fn hand(edit: impl FnOnce(&mut HandConfig)) -> GraspingHand<3, 15> {
    let robot = robot();
    let palm = robot.arm.palm(&start()).pose;
    assert!(palm.rotation.z_axis.abs_diff_eq(DVec3::Z, 1e-12), "{palm:?}");
    let mut world = WorldConfig::default();
    let place_mm = palm.translation * 1e3;
    (world.hand.x_mm, world.hand.y_mm) = (place_mm.x, place_mm.y);
    world.hand.support_mm = place_mm.z + 1e3 * face_height(0.025) - 25.0;
    edit(&mut world.hand);
    GraspingHand::new(&robot, start().as_slice(), &world).unwrap()
}

/// Codes of torques (N m).
fn codes(torque_nm: &JointVector<15>) -> [i32; CHANNELS] {
    let mut codes = [0; CHANNELS];
    for (code, nm) in codes.iter_mut().zip(torque_nm.iter()) {
        *code = (nm / CODE_NM).round().clamp(-8_388_608.0, 8_388_607.0) as i32;
    }
    codes
}

/// Torques of a servo towards joints, with gravity borne.
fn servo(hand: &GraspingHand<3, 15>, target: &JointVector<15>) -> JointVector<15> {
    let (q, qd) = (hand.state.q, hand.state.qd);
    let gain = |i: usize| if i < 6 { [2000.0, 100.0] } else { [20.0, 0.4] };
    let pull = JointVector::from_fn(|i, _| gain(i)[0] * (target[i] - q[i]) - gain(i)[1] * qd[i]);
    pull + hand.robot.arm.gravity_torque(&q)
}

/// Runs the hand with its servo towards a target that depends on time.
fn run(
    hand: &mut GraspingHand<3, 15>,
    from_s: f64,
    to_s: f64,
    target: impl Fn(f64) -> JointVector<15>,
) {
    let steps = ((to_s - from_s) / STEP_S).round() as usize;
    for step in 0..steps {
        let t_s = from_s + STEP_S * step as f64;
        let torque = servo(hand, &target(t_s));
        hand.drive(&codes(&torque), ON);
        hand.step_from(t_s, STEP_S, &Joints::zeros());
    }
}

/// A hand that holds its ball at 0.6 s, when the support goes.
fn holding() -> GraspingHand<3, 15> {
    let mut hand = hand(|c| c.support_until_s = Some(0.6));
    run(&mut hand, 0.0, 0.6, |t_s| with_fingers(0.04 - 0.018 * (t_s / 0.4).min(1.0)));
    hand
}

#[test]
fn what_a_hand_holds_loads_the_joints_of_its_arm_by_its_weight() {
    let mut hand = holding();
    run(&mut hand, 0.6, 1.6, |_| with_fingers(0.022));
    let torque = servo(&hand, &with_fingers(0.022));
    let beside = torque - hand.robot.arm.gravity_torque(&hand.state.q);
    let (object, palm) = (hand.state.object.pose.translation, hand.robot.arm.palm(&hand.state.q));
    let weight = to_nalgebra_vector(DVec3::new(0.0, 0.0, hand.mass_kg * GRAVITY_M_S2));
    let jacobian: Matrix6 = palm.jacobian_at(object);
    let asked = jacobian.fixed_rows::<3>(0).transpose() * weight;
    assert!(asked.amax() > 0.1 && hand.support_n == 0.0, "{asked}");
    for joint in 0..6 {
        let off_nm = beside[joint] - asked[joint];
        assert!(off_nm.abs() < 1e-4, "{joint}: {} {}", beside[joint], asked[joint]);
    }
}

/// Kinetic and potential energy of the tree and the object (J).
fn energy_j(hand: &GraspingHand<3, 15>) -> f64 {
    let (q, qd, object) = (&hand.state.q, &hand.state.qd, &hand.state.object);
    let arm = &hand.robot.arm;
    let tree = 0.5 * qd.dot(&(arm.mass_matrix(q) * qd))
        + arm.carrier().map_or(0.0, |carrier| carrier.potential_energy_j(q));
    let spin = object.pose.rotation.transpose() * object.spin;
    let turning = 0.5 * spin.dot(hand.moments * spin);
    let moving = 0.5 * object.velocity.length_squared();
    tree + turning + hand.mass_kg * (moving + GRAVITY_M_S2 * object.pose.translation.z)
}

#[test]
fn an_arm_that_falls_with_what_it_holds_gains_no_energy() {
    let mut errors = Vec::new();
    for h in [1e-3_f64, 0.5e-3] {
        let mut hand = holding();
        // The fingers are held by their torques of the start, the arm falls.
        let mut torque = servo(&hand, &with_fingers(0.022));
        torque.fixed_rows_mut::<6>(0).fill(0.0);
        hand.drive(&codes(&torque), ON);
        let (before, from) = (energy_j(&hand), hand.state);
        let steps = (0.1 / h).round() as usize;
        for i in 0..steps {
            hand.step_from(0.6 + h * i as f64, h, &Joints::zeros());
        }
        let work = hand.torque.dot(&(hand.state.q - from.q));
        let fallen_m = from.object.pose.translation.z - hand.state.object.pose.translation.z;
        let kinetic_j =
            0.5 * hand.state.qd.dot(&(hand.robot.arm.mass_matrix(&hand.state.q) * hand.state.qd));
        assert!(fallen_m > 5e-3 && kinetic_j > 0.3, "{fallen_m} {kinetic_j}");
        errors.push((energy_j(&hand) - before - work) / kinetic_j);
    }
    println!("energy off by {errors:?} of the kinetic energy");
    // Euler's method backwards loses some, in proportion to its step; what the rubber stores is
    // less.
    assert!(errors.iter().all(|error| *error < 1e-3), "{errors:?}");
    assert!(errors[1].abs() < 0.02, "{errors:?}");
}

#[test]
fn the_steps_are_of_first_order_while_the_arm_moves() {
    let mut start = holding();
    start.state.qd.fixed_rows_mut::<6>(0).copy_from_slice(&[0.2, -0.1, 0.15, 0.1, -0.2, 0.3]);
    let palm = start.robot.arm.palm(&start.state.q);
    let centre = start.state.object.pose.translation;
    let speeds = palm.jacobian_at(centre) * Hand::<3, 15>::arm_joints(&start.state.qd);
    start.state.object.velocity = DVec3::new(speeds[0], speeds[1], speeds[2]);
    start.state.object.spin = DVec3::new(speeds[3], speeds[4], speeds[5]);
    // The motors give their torques of the start all along.
    let torque = servo(&start, &with_fingers(0.022));
    start.drive(&codes(&torque), ON);
    let place = |h: f64| {
        let mut hand = start.clone();
        let steps = (0.05 / h).round() as usize;
        for i in 0..steps {
            hand.step_from(0.6 + h * i as f64, h, &Joints::zeros());
        }
        assert_eq!(hand.work.unconverged, 0);
        (hand.truth().object_m, hand.state.q)
    };
    let finest = place(2.5e-3 / 64.0);
    let mut errors = Vec::new();
    for parts in [1, 2, 4, 8] {
        let (at, q) = place(2.5e-3 / f64::from(parts));
        let (error, turn) = ((at - finest.0).length(), (q - finest.1).amax());
        println!("{:.1} us: {error:.2e} m, {turn:.2e} rad", 2500.0 / f64::from(parts));
        errors.push(error);
    }
    let order = libm::log2(errors[1] / errors[3]) / 2.0;
    println!("order {order:.2}");
    assert!(errors[1] < 5e-4 && (0.8..1.5).contains(&order), "{errors:?} {order}");
}

#[test]
fn a_braked_arm_stands_and_the_same_steps_give_the_same_bits() {
    let digest = || {
        let mut hand = holding();
        let q = hand.state.q;
        hand.drive(&[0; CHANNELS], DriveLines::SAFE);
        for i in 0..80 {
            hand.step_from(0.6 + STEP_S * f64::from(i), STEP_S, &Joints::zeros());
        }
        assert!((hand.state.q - q).amax() < 1e-12);
        assert!(hand.truth().fingers.iter().all(|finger| finger.normal_n > 1.0));
        let mut hash = Hash::default();
        hand.digest(&mut hash);
        hash.value()
    };
    assert_eq!(digest(), digest());
}
