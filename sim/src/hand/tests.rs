//! Tests of the held object against motions that are known in closed form, the order of convergence
//! of its steps, and the hard cases: an edge, a corner, a light object, sliding, lost contact.

use taktil_mechanics::chain::{Chain, JointSpec};
use taktil_mechanics::friction::Friction;
use taktil_mechanics::hand::ThreeFingers;
use taktil_mechanics::rigid_body::{Body, GRAVITY_M_S2};
use taktil_mechanics::spatial::{rotation_x, rotation_y};
use taktil_mechanics::transmission::{Drive, Transmission};

use super::*;
use crate::manipulator::Manipulator;
use glam::DMat3;

/// Radius of the fingers' bases about the palm's middle, and lengths of their links (m).
const BASE_M: f64 = 0.005;
const LINK_M: [f64; 2] = [0.065, 0.05];
/// Distance of the pad's face from its link (m).
const FACE_M: f64 = 0.008;
/// Torque that a motor gives for one code (N m), behind a gear of 10: 2 N m at 32768 codes.
const CODE_NM: f64 = 2.0 / 32768.0;

/// The joints of a finger at this azimuth, abduction and then two bends towards the middle, and its
/// fingertip.
pub(super) fn finger_joints(azimuth_rad: f64) -> ([JointSpec; 3], Pose) {
    let base = rotation_z(azimuth_rad);
    let link = |mass_kg: f64, length_m: f64| {
        let long = mass_kg * length_m * length_m / 12.0;
        Body::diagonal(mass_kg, [0.0, 0.0, -0.5 * length_m], [long, long, 0.1 * long])
    };
    let joint = |origin: Pose, axis: DVec3, body: Body| JointSpec {
        origin,
        axis,
        body,
        reflected_inertia: 2e-3,
        q_min: -1.5,
        q_max: 1.5,
        speed_max: 10.0,
        acceleration_max: 100.0,
        effort_max: 2.0,
        ..JointSpec::default()
    };
    let at = |x, z| Pose::new(DMat3::IDENTITY, DVec3::new(x, 0.0, z));
    let joints = [
        joint(Pose::new(base, base * DVec3::new(BASE_M, 0.0, 0.0)), DVec3::X, link(0.02, 0.02)),
        joint(at(0.0, 0.0), DVec3::Y, link(0.06, LINK_M[0])),
        joint(at(0.0, -LINK_M[0]), DVec3::Y, link(0.04, LINK_M[1])),
    ];
    // The face looks inwards: z of the tip is -x of the link, y is up.
    let face = DMat3::from_cols(-DVec3::Y, DVec3::Z, -DVec3::X);
    let tip = Pose::new(face, DVec3::new(-FACE_M, 0.0, -LINK_M[1]));
    (joints, tip)
}

fn finger(azimuth_rad: f64) -> Chain<3> {
    let (joints, tip) = finger_joints(azimuth_rad);
    Chain::new(&joints, &tip).unwrap()
}

fn robot(coulomb_nm: f64) -> Robot<9, ThreeFingers> {
    let third = core::f64::consts::TAU / 3.0;
    let arm = ThreeFingers::new([finger(0.0), finger(third), finger(2.0 * third)]).unwrap();
    let all = |x: f64| JointVector::<9>::from_element(x);
    let (gears, drive) = (
        Transmission::uncoupled(&all(10.0), &all(4096.0)),
        Drive { torque_constant_nm_a: all(0.1), current_max_a: all(2.0), dac_bits: 16 },
    );
    Robot {
        torque_max_nm: *arm.effort_max(),
        dynamics: arm,
        arm,
        gears,
        drive,
        friction: Friction { coulomb_nm: all(coulomb_nm), viscous_nms_rad: all(0.005) },
        home_rad: open(),
        nominal_rad: open(),
        joint_names: Vec::new(),
    }
}

/// Joints at which the faces stand upright at this distance from the middle (m).
pub(super) fn at_distance(distance_m: f64) -> JointVector<9> {
    let lean = libm::asin((distance_m + FACE_M - BASE_M) / LINK_M[0]);
    JointVector::from_fn(|i, _| [0.0, -lean, lean][i % 3])
}

fn open() -> JointVector<9> {
    at_distance(0.04)
}

/// Height of the faces' middles at this distance (m).
pub(super) fn face_height(distance_m: f64) -> f64 {
    let lean = libm::asin((distance_m + FACE_M - BASE_M) / LINK_M[0]);
    -LINK_M[0] * libm::cos(lean) - LINK_M[1]
}

fn world(edit: impl FnOnce(&mut HandConfig)) -> WorldConfig {
    let mut world = WorldConfig::default();
    world.hand.support_mm = 1e3 * face_height(0.025) - 25.0;
    edit(&mut world.hand);
    world
}

fn hand(world: &WorldConfig) -> GraspingHand<3, 9> {
    GraspingHand::new(&robot(0.002), open().as_slice(), world).unwrap()
}

/// Codes of a servo that draws the joints towards `target` with this stiffness, and bears gravity.
fn servo(hand: &GraspingHand<3, 9>, target: &JointVector<9>, kp: f64) -> [i32; CHANNELS] {
    use taktil_mechanics::arm::ArmDynamics;
    let (q, qd) = (hand.state.q, hand.state.qd);
    let torque = (target - q) * kp - qd * (0.02 * kp) + hand.robot.arm.gravity_torque(&q);
    let mut codes = [0; CHANNELS];
    for (i, code) in codes.iter_mut().enumerate().take(9) {
        *code = (torque[i] / CODE_NM).round().clamp(-32768.0, 32767.0) as i32;
    }
    codes
}

const ON: DriveLines = DriveLines { enabled: true, braked: false };

/// Stiffness of the tests' servo (N m/rad).
const SERVO_NM_RAD: f64 = 20.0;

/// Runs the hand with a servo of 400 Hz towards targets that depend on time, in steps of `h`.
fn run(
    hand: &mut GraspingHand<3, 9>,
    from_s: f64,
    to_s: f64,
    h: f64,
    target: impl Fn(f64) -> JointVector<9>,
) {
    let jobs = ((to_s - from_s) / 2.5e-3).round() as usize;
    let steps = (2.5e-3 / h).round() as usize;
    for job in 0..jobs {
        let t = from_s + 2.5e-3 * job as f64;
        let codes = servo(hand, &target(t), SERVO_NM_RAD);
        hand.drive(&codes, ON);
        for i in 0..steps {
            hand.step_from(t + h * i as f64, h, &Joints::zeros());
        }
    }
}

/// A target that closes from the open hand to `inner_m` within half a second.
fn closing(inner_m: f64) -> impl Fn(f64) -> JointVector<9> {
    move |t: f64| at_distance(0.04 + (inner_m - 0.04) * (t / 0.5).min(1.0))
}

/// A hand that holds its object since half a second ago, at one second.
fn holding(world: &WorldConfig, inner_m: f64, h: f64) -> GraspingHand<3, 9> {
    let mut hand = hand(world);
    run(&mut hand, 0.0, 1.0, h, closing(inner_m));
    hand
}

#[test]
fn an_object_falls_freely_with_an_error_that_halves_with_the_step() {
    let mut errors = Vec::new();
    for h in [2e-3_f64, 1e-3, 0.5e-3] {
        let mut hand = hand(&world(|c| c.support_until_s = Some(0.0)));
        let start = hand.state.object.pose.translation.z;
        let steps = (0.1 / h).round() as usize;
        for i in 0..steps {
            hand.step_from(h * i as f64, h, &Joints::zeros());
        }
        let fallen = start - hand.state.object.pose.translation.z;
        errors.push(fallen - 0.5 * GRAVITY_M_S2 * 0.01);
        let speed = hand.state.object.velocity.z;
        assert!((speed + GRAVITY_M_S2 * 0.1).abs() < 1e-12, "{speed}");
    }
    for pair in errors.windows(2) {
        let order = libm::log2(pair[0] / pair[1]);
        assert!((order - 1.0).abs() < 1e-6, "{order}");
    }
}

#[test]
fn a_free_object_keeps_its_momentum_and_its_angular_momentum_nearly() {
    let mut hand = hand(&world(|c| {
        (c.shape, c.support_until_s) = (HeldShape::Cuboid, Some(0.0));
        c.size_mm = [30.0, 40.0, 50.0];
    }));
    hand.state.object.pose.translation.z -= 1.0;
    hand.state.object.spin = DVec3::new(3.0, 4.0, -2.0);
    let momentum = |hand: &GraspingHand<3, 9>| {
        let axes = hand.state.object.pose.rotation;
        let inertia = axes * DMat3::from_diagonal(hand.moments) * axes.transpose();
        inertia * hand.state.object.spin
    };
    let before = momentum(&hand);
    for i in 0..200 {
        hand.step_from(5e-4 * f64::from(i), 5e-4, &Joints::zeros());
    }
    let off = (momentum(&hand) - before).length() / before.length();
    println!("angular momentum off by {:.2e} after 0.1 s", off);
    assert!(off < 2e-3, "{off}");
}

#[test]
fn every_shape_rests_on_its_support() {
    for shape in [HeldShape::Sphere, HeldShape::Cylinder, HeldShape::Cuboid] {
        let mut hand = hand(&world(|c| c.shape = shape));
        let before = hand.state.object;
        for i in 0..400 {
            hand.step_from(1.25e-3 * f64::from(i), 1.25e-3, &Joints::zeros());
        }
        let after = hand.state.object;
        let moved = (after.pose.translation - before.pose.translation).length();
        assert!(moved < 1e-9, "{shape:?}: {moved}");
        assert!((hand.support_n - 0.1 * GRAVITY_M_S2).abs() < 1e-6, "{shape:?}");
    }
}

#[test]
fn a_grasp_carries_the_weight_when_the_support_goes_and_balances_it() {
    let mut hand = hand(&world(|c| c.support_until_s = Some(1.0)));
    run(&mut hand, 0.0, 1.0, 1.25e-3, closing(0.022));
    let held = hand.state.object.pose.translation;
    run(&mut hand, 1.0, 3.0, 1.25e-3, closing(0.022));
    let truth = hand.truth();
    let sunk_m = held.z - truth.object_m.z;
    assert!(sunk_m < 1e-3 && truth.support_n == 0.0, "{sunk_m}");
    // At rest the pads' forces balance the weight.
    let mut sum = DVec3::ZERO;
    for (f, finger) in truth.fingers.iter().enumerate() {
        let axes = hand.robot.arm.fingertip(&hand.state.q, f).pose.rotation;
        let [x, y, _] = finger.friction;
        sum += axes * DVec3::new(x, y, finger.normal_n);
        assert!(finger.effort < 1.0 && finger.normal_n > 1.0, "{finger:?}");
    }
    let weight = DVec3::new(0.0, 0.0, 0.1 * GRAVITY_M_S2);
    assert!((sum - weight).length() < 2e-3, "{sum}");
}

/// A hand that holds an object at one second, with a push that begins then.
fn pushed_hand() -> GraspingHand<3, 9> {
    let world = world(|c| {
        c.support_until_s = Some(0.7);
        c.push = vec![PushConfig {
            from_s: 1.0,
            to_s: 1.6,
            force_n: [0.6, -0.4, -0.5],
            at_mm: [0.0, 0.0, 5.0],
            ramp_s: 0.2,
        }];
    });
    holding(&world, 0.022, 1.25e-3)
}

#[test]
fn the_steps_are_of_first_order_under_a_push() {
    let start = pushed_hand();
    // Motors that give their torques of the start all along: a servo's codes would round.
    let mut gravity = start.clone();
    let codes = servo(&start, &closing(0.022)(1.0), SERVO_NM_RAD);
    let mut place = |h: f64| {
        gravity.clone_from(&start);
        gravity.drive(&codes, ON);
        let steps = (0.1 / h).round() as usize;
        for i in 0..steps {
            gravity.step_from(1.0 + h * i as f64, h, &Joints::zeros());
        }
        let truth = gravity.truth();
        let load: f64 = truth.fingers.iter().map(|finger| finger.normal_n).sum();
        (truth.object_m, load)
    };
    let finest = place(2.5e-3 / 256.0);
    let mut errors = Vec::new();
    for parts in [1, 2, 4, 8, 16] {
        let (at, load) = place(2.5e-3 / f64::from(parts));
        let error = (at - finest.0).length();
        println!("{:.1} us: {error:.2e} m, {:.2e} N", 2500.0 / f64::from(parts), load - finest.1);
        errors.push(error);
    }
    let order = libm::log2(errors[1] / errors[3]) / 2.0;
    println!("order {order:.2}");
    assert!(errors[1] < 5e-5 && (0.8..1.5).contains(&order), "{errors:?} {order}");
}

#[test]
fn a_push_beyond_the_cone_slides_and_one_within_it_does_not() {
    for (push_n, slides) in [(1.0, false), (20.0, true)] {
        let world = world(|c| {
            c.support_until_s = Some(0.9);
            c.push = vec![PushConfig {
                from_s: 1.0,
                to_s: 2.0,
                force_n: [0.0, 0.0, -push_n],
                at_mm: [0.0; 3],
                ramp_s: 0.1,
            }];
        });
        let mut hand = holding(&world, 0.022, 1.25e-3);
        let before = hand.state.object.pose.translation.z;
        run(&mut hand, 1.0, 1.5, 1.25e-3, closing(0.022));
        let sunk_m = before - hand.state.object.pose.translation.z;
        assert_eq!(sunk_m > 0.01, slides, "{push_n}: {sunk_m}");
        assert_eq!(hand.truth().fingers.iter().all(|f| f.normal_n == 0.0), slides);
    }
}

#[test]
fn a_light_object_and_one_of_a_kilogram_are_held_alike() {
    for mass_kg in [1e-4, 1e-3, 0.1, 1.0] {
        let world = world(|c| (c.mass_kg, c.support_until_s) = (mass_kg, Some(0.9)));
        let mut hand = hand(&world);
        let inner_m = if mass_kg < 0.5 { 0.022 } else { 0.015 };
        run(&mut hand, 0.0, 2.0, 1.25e-3, closing(inner_m));
        let truth = hand.truth();
        assert!(truth.object_m_s.length() < 1e-4, "{mass_kg}: {:?}", truth.object_m_s);
        assert!(truth.fingers.iter().all(|f| f.effort < 1.0 && f.normal_n > 0.0), "{mass_kg}");
        assert_eq!(hand.work.unconverged, 0, "{mass_kg}");
    }
}

#[test]
fn a_face_an_edge_and_a_corner_of_a_box_are_pressed_without_a_jump() {
    // One pad meets a box that is turned from face to edge to corner: the load is continuous in
    // the turn, and the deeper a shape is pressed in the more it bears.
    let config = world(|c| c.shape = HeldShape::Cuboid);
    let hand = hand(&config);
    let half_m = DVec3::new(0.02, 0.02, 0.03);
    let load = |turn: DMat3, depth_m: f64| {
        let Solid::Cuboid { half_m: half } = hand.solid else { panic!("no box") };
        assert_eq!(half, half_m);
        let mut height = 0.0_f64;
        for i in 0..8 {
            let sign = |bit: usize| if i >> bit & 1 == 0 { 1.0 } else { -1.0 };
            height = height.max(-(turn * (half_m * DVec3::new(sign(0), sign(1), sign(2)))).z);
        }
        let pose = Pose::new(turn, DVec3::new(0.0, 0.0, height - depth_m));
        let at = Relative { pose, twist: Joints::zeros(), h: 0.0 };
        hand.pad.evaluate(&hand.solid, &at, &Bristle::zeros()).normal_n
    };
    let face = load(DMat3::IDENTITY, 50e-6);
    let edge = load(rotation_x(core::f64::consts::FRAC_PI_4), 0.5e-3);
    let corner = load(
        rotation_y(libm::atan(core::f64::consts::FRAC_1_SQRT_2))
            * rotation_x(core::f64::consts::FRAC_PI_4),
        1e-3,
    );
    assert!(face > 10.0 && edge > 0.0 && corner > 0.0, "{face} {edge} {corner}");
    let mut before = face;
    for i in 1..=200 {
        let turn = 1e-5 * f64::from(i);
        let now = load(rotation_x(turn), 50e-6);
        assert!(now <= before * 1.001 && now > 0.95 * before, "{turn}: {before} {now}");
        before = now;
    }
}

#[test]
fn braked_fingers_stand_and_bear_the_object() {
    let config = world(|c| c.support_until_s = Some(0.9));
    let mut hand = holding(&config, 0.022, 1.25e-3);
    let (q, held) = (hand.state.q, hand.state.object.pose.translation);
    hand.drive(&[0; CHANNELS], DriveLines::SAFE);
    for i in 0..400 {
        hand.step_from(1.0 + 1.25e-3 * f64::from(i), 1.25e-3, &Joints::zeros());
    }
    assert!((hand.state.q - q).amax() < 1e-12);
    assert!((hand.state.object.pose.translation - held).length() < 1e-3);
}

#[test]
fn an_object_in_a_fingertip_and_a_start_of_another_length_are_refused() {
    let wide = world(|c| c.radius_mm = 60.0);
    let place = |world: &WorldConfig, start: &[f64]| {
        GraspingHand::new(&robot(0.0), start, world).unwrap_err().place
    };
    assert_eq!(place(&wide, open().as_slice()), "hand");
    assert_eq!(place(&world(|_| ()), &[0.0; 6]), "arm");
    assert_eq!(place(&world(|_| ()), &[9.0; 9]), "arm");
}

#[test]
fn the_same_steps_give_the_same_bits() {
    let digest = || {
        let config = world(|c| c.support_until_s = Some(0.6));
        let hand = holding(&config, 0.022, 1.25e-3);
        let mut hash = Hash::default();
        hand.digest(&mut hash);
        hash.value()
    };
    assert_eq!(digest(), digest());
}
