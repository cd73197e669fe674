//! A hand's kinematics against differences, on a palm that stands and on an arm; the dynamics of
//! the tree of an arm and its fingers against energies of points; and what is no hand.

use super::*;
use crate::rigid_body::Body;
use crate::spatial::{
    rotation_about, rotation_from_vector, rotation_vector, rotation_x, rotation_y, rotation_z,
};

/// A finger whose base stands at `x_m`, with links of 50 mm along its own -z.
fn finger(x_m: f64) -> Chain<3> {
    let down = Pose::new(glam::DMat3::IDENTITY, DVec3::new(0.0, 0.0, -0.05));
    let base = Pose::new(glam::DMat3::IDENTITY, DVec3::new(x_m, 0.0, 0.0));
    let joint = |origin, axis| JointSpec { origin, axis, ..JointSpec::default() };
    let joints = [joint(base, DVec3::X), joint(down, DVec3::Y), joint(down, DVec3::Y)];
    Chain::new(&joints, &down).unwrap()
}

fn pair() -> Hand<2, 6> {
    Hand::new([finger(0.0), finger(0.1)]).unwrap()
}

#[test]
fn a_hand_has_three_joints_a_finger() {
    assert!(Hand::<2, 5>::new([finger(0.0), finger(0.1)]).is_none());
    assert_eq!(pair().q_min().len(), 6);
}

#[test]
fn the_jacobian_of_a_fingertip_is_its_derivative_and_the_other_finger_does_not_move_it() {
    let (hand, q) = (pair(), JointVector::from([0.2, -0.3, 0.9, -0.1, 0.4, 0.5]));
    let (tip, lever) = (hand.fingertip(&q, 1), DVec3::new(0.004, -0.003, 0.001));
    let place = |q: &JointVector<6>| hand.fingertip(q, 1).pose.apply(lever);
    let linear = tip.linear_at(tip.pose.rotation * lever);
    for joint in 0..6 {
        let mut step = JointVector::<6>::zeros();
        step[joint] = 1e-6;
        let moved = (place(&(q + step)) - place(&(q - step))) / 2e-6;
        let stated = match joint.checked_sub(3) {
            Some(own) => to_glam_vector(&linear.column(own).into()),
            None => DVec3::ZERO,
        };
        assert!((moved - stated).length() < 1e-9, "{joint}: {moved} {stated}");
    }
}

#[test]
fn every_joint_has_the_lever_of_its_own_fingertip() {
    let (hand, q) = (pair(), JointVector::from([0.0, -0.3, 0.9, 0.0, -0.3, 0.9]));
    let levers_m: [f64; 6] = core::array::from_fn(|joint| hand.touch_lever_m(joint, &q));
    let other = levers_m[3..].iter();
    assert!(levers_m.iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-12), "{levers_m:?}");
    let chain = hand.fingers()[0];
    let own = Hand::<2, 6>::finger_joints(&q, 0);
    for (joint, lever_m) in levers_m.iter().take(3).enumerate() {
        let by_difference = chain.touch_lever_m(joint, &own);
        assert!((lever_m - by_difference).abs() < 1e-4, "{joint}: {by_difference}");
    }
    assert!((levers_m[2] - 0.05).abs() < 1e-12, "{levers_m:?}");
}

#[test]
fn dynamics_are_those_of_the_fingers_alone() {
    let hand = pair();
    let q = JointVector::from([0.2, -0.3, 0.9, -0.1, 0.4, 0.5]);
    let qd = JointVector::from([1.0, 2.0, -1.0, 0.5, 0.0, 3.0]);
    let own = |v: &JointVector<6>, f| Hand::<2, 6>::finger_joints(v, f);
    let (mass, bias) = (hand.mass_matrix(&q), hand.bias_torque(&q, &qd));
    for f in 0..2 {
        let finger = &hand.fingers()[f];
        let block = mass.fixed_view::<3, 3>(3 * f, 3 * f);
        assert_eq!(block, finger.mass_matrix(&own(&q, f)));
        assert_eq!(own(&bias, f), finger.bias_torque(&own(&q, f), &own(&qd, f)));
    }
    assert_eq!(mass[(0, 3)], 0.0);
}

#[test]
fn a_stretched_finger_is_singular_and_no_pose_is_followed() {
    let hand = pair();
    assert_eq!(hand.singularity_distances(&JointVector::zeros()), [0.0; 3]);
    let bent = JointVector::from([0.0, -0.5, 1.0, 0.0, -0.5, 1.0]);
    assert!(hand.singularity_distances(&bent)[0] > 0.1);
    let pose = hand.tool_pose(&bent);
    assert_eq!(hand.inverse_kinematics_near(&pose, &bent), None);
    assert_eq!(hand.tool_step(&bent, &Joints::zeros(), &bent, 0.0), None);
    assert_eq!(hand.follower(&bent).step(&pose, 0.01), Err(FollowError::OutOfReach));
}

/// An arm of six joints with unlike axes and offsets, and bodies of unlike inertia.
fn arm_joints() -> [JointSpec; 6] {
    let axes = [DVec3::Z, DVec3::Y, DVec3::Y, DVec3::Z, DVec3::Y, DVec3::new(0.6, 0.0, 0.8)];
    core::array::from_fn(|i| {
        let k = i as f64;
        let turn = rotation_x(0.2 * k) * rotation_z(-0.3 * k);
        JointSpec {
            origin: Pose::new(turn, DVec3::new(0.02 * k, -0.03, 0.15)),
            axis: axes[i],
            body: body(2.0 - 0.25 * k, DVec3::new(0.01 * k, 0.02, 0.07), 0.01),
            reflected_inertia: 0.3 - 0.04 * k,
            ..JointSpec::default()
        }
    })
}

/// A body with an inertia that has products.
fn body(mass_kg: f64, com_m: DVec3, size: f64) -> Body {
    let turn = rotation_z(0.7) * rotation_x(0.4);
    let own = Body::diagonal(mass_kg, [0.0; 3], [size, 1.5 * size, 0.8 * size]);
    let turned = own.expressed_in(&Pose::new(turn, DVec3::ZERO));
    Body { com_m, ..turned }
}

/// A finger of the arm's hand at an azimuth, described in the palm's frame.
fn finger_joints(azimuth_rad: f64) -> [JointSpec; 3] {
    let down = Pose::new(rotation_x(0.1), DVec3::new(0.003, 0.0, -0.05));
    let root = Pose::new(rotation_z(azimuth_rad), rotation_z(azimuth_rad) * DVec3::X * 0.03);
    let joint = |origin, axis, mass_kg: f64| JointSpec {
        origin,
        axis,
        body: body(mass_kg, DVec3::new(0.002, 0.0, -0.02), 2e-5),
        reflected_inertia: 1e-3,
        ..JointSpec::default()
    };
    [joint(root, DVec3::X, 0.02), joint(down, DVec3::Y, 0.06), joint(down, DVec3::Y, 0.04)]
}

fn palm() -> Pose {
    Pose::new(rotation_y(0.3), DVec3::new(0.01, 0.02, 0.09))
}

fn tip() -> Pose {
    Pose::new(rotation_x(1.2), DVec3::new(-0.008, 0.0, -0.04))
}

fn on_arm() -> Hand<3, 15> {
    let fingers = [0.0, 2.1, 4.2].map(finger_joints);
    Hand::on_arm(&arm_joints(), &palm(), &fingers, &[tip(); 3]).unwrap()
}

fn bent() -> JointVector<15> {
    JointVector::from_fn(|i, _| 0.4 * libm::sin(1.7 * i as f64 + 0.3))
}

fn moving() -> JointVector<15> {
    JointVector::from_fn(|i, _| 1.3 * libm::cos(2.3 * i as f64))
}

/// Every body of the arm and its fingers with its pose in the base frame, and the poses of the
/// fingertips: products of frames along the tree, apart from the code under test.
fn bodies(q: &JointVector<15>) -> (Vec<(Body, Pose)>, [Pose; 3]) {
    let behind = |before: &Pose, joint: &JointSpec, angle: f64| {
        let turn = Pose::new(rotation_about(joint.axis.normalize(), angle), DVec3::ZERO);
        before.compose(&joint.origin).compose(&turn)
    };
    let mut at = Pose::IDENTITY;
    let mut all = Vec::new();
    for (joint, angle) in arm_joints().iter().zip(q.iter()) {
        at = behind(&at, joint, *angle);
        all.push((joint.body, at));
    }
    let root = at.compose(&palm());
    let tips = core::array::from_fn(|f| {
        let mut at = root;
        for (i, joint) in finger_joints(2.1 * f as f64).iter().enumerate() {
            at = behind(&at, joint, q[6 + 3 * f + i]);
            all.push((joint.body, at));
        }
        at.compose(&tip())
    });
    (all, tips)
}

/// Kinetic energy by differences of the bodies' poses along the motion, with that of the drives.
fn kinetic_energy_j(q: &JointVector<15>, qd: &JointVector<15>) -> f64 {
    const TIME_STEP_S: f64 = 1e-5;
    let [(before, _), (after, _)] = [-TIME_STEP_S, TIME_STEP_S].map(|t| bodies(&(q + qd * t)));
    let mut energy = 0.0;
    for ((body, from), (_, to)) in before.iter().zip(&after) {
        let speed = (to.apply(body.com_m) - from.apply(body.com_m)) / (2.0 * TIME_STEP_S);
        // The rotation vector is in axes of the body.
        let spin = rotation_vector(&from.rotation, &to.rotation) / (2.0 * TIME_STEP_S);
        energy += 0.5 * body.mass_kg * speed.length_squared();
        energy += 0.5 * spin.dot(body.inertia_kg_m2 * spin);
    }
    let arm = arm_joints();
    let drives = (0..15).map(|i| match i {
        0..6 => arm[i].reflected_inertia,
        _ => 1e-3,
    });
    energy
        + drives.zip(qd.iter()).map(|(inertia, speed)| 0.5 * inertia * speed * speed).sum::<f64>()
}

fn potential_energy_j(q: &JointVector<15>) -> f64 {
    let (all, _) = bodies(q);
    all.iter().map(|(body, pose)| 9.81 * body.mass_kg * pose.apply(body.com_m).z).sum()
}

fn unit(i: usize) -> JointVector<15> {
    JointVector::from_fn(|j, _| f64::from(u8::from(i == j)))
}

#[test]
fn the_mass_matrix_of_the_tree_is_its_kinetic_energy_symmetric_and_positive_definite() {
    let (hand, q) = (on_arm(), bent());
    let mass = hand.mass_matrix(&q);
    assert_eq!(mass, mass.transpose());
    assert!(mass.cholesky().is_some());
    for i in 0..15 {
        for j in 0..15 {
            let energy = |speed: &JointVector<15>| kinetic_energy_j(&q, speed);
            let [one, other] = [unit(i), unit(j)];
            let stated = energy(&(one + other)) - energy(&one) - energy(&other);
            let found = mass[(i, j)];
            // Differences over 1e-5 s leave some 1e-9 of the largest entry.
            assert!((found - stated).abs() < 2e-8, "{i} {j}: {found} {stated}");
        }
    }
    // Fingers are coupled to the arm, and not to each other.
    assert!(mass[(0, 6)].abs() > 1e-6 && mass[(6, 9)] == 0.0);
}

#[test]
fn gravity_and_coriolis_torques_of_the_tree_are_those_of_lagrange() {
    const ANGLE_STEP_RAD: f64 = 1e-5;
    let (hand, q, qd) = (on_arm(), bent(), moving());
    let slope = |i: usize| {
        let step = unit(i) * ANGLE_STEP_RAD;
        let mass = (hand.mass_matrix(&(q + step)) - hand.mass_matrix(&(q - step)))
            / (2.0 * ANGLE_STEP_RAD);
        let rise = (potential_energy_j(&(q + step)) - potential_energy_j(&(q - step)))
            / (2.0 * ANGLE_STEP_RAD);
        (mass, rise)
    };
    let (bias, gravity) = (hand.bias_torque(&q, &qd), hand.gravity_torque(&q));
    let slopes: Vec<_> = (0..15).map(slope).collect();
    let along = slopes.iter().zip(qd.iter()).map(|((mass, _), speed)| mass * *speed);
    let rate: JointMatrix<15> = along.sum();
    for (i, (mass, rise)) in slopes.iter().enumerate() {
        let coriolis = (rate * qd)[i] - 0.5 * qd.dot(&(mass * qd));
        assert!((gravity[i] - rise).abs() < 1e-7, "{i}: {} {rise}", gravity[i]);
        let stated = coriolis + rise;
        assert!((bias[i] - stated).abs() < 1e-7, "{i}: {} {stated}", bias[i]);
    }
    let stated = hand.carrier().unwrap().potential_energy_j(&q);
    assert!((stated - potential_energy_j(&q)).abs() < 1e-10, "{stated}");
}

#[test]
fn a_tree_that_moves_freely_keeps_its_energy_and_motors_change_it_by_their_work() {
    let hand = on_arm();
    let torque = JointVector::<15>::from_fn(|i, _| if i < 6 { 0.5 } else { 1e-3 });
    let acceleration = |q: &JointVector<15>, qd: &JointVector<15>| {
        let left = torque - hand.bias_torque(q, qd);
        hand.mass_matrix(q).cholesky().unwrap().solve(&left)
    };
    let energy = |q: &JointVector<15>, qd: &JointVector<15>| {
        0.5 * qd.dot(&(hand.mass_matrix(q) * qd)) + hand.carrier().unwrap().potential_energy_j(q)
    };
    let (mut q, mut qd) = (bent(), moving());
    let (before, start) = (energy(&q, &qd), q);
    // Runge and Kutta's method of fourth order.
    const TIME_STEP_S: f64 = 2e-4;
    for _ in 0..1000 {
        let h = TIME_STEP_S;
        let (v1, a1) = (qd, acceleration(&q, &qd));
        let (v2, a2) =
            (qd + a1 * (h / 2.0), acceleration(&(q + v1 * (h / 2.0)), &(qd + a1 * (h / 2.0))));
        let (v3, a3) =
            (qd + a2 * (h / 2.0), acceleration(&(q + v2 * (h / 2.0)), &(qd + a2 * (h / 2.0))));
        let (v4, a4) = (qd + a3 * h, acceleration(&(q + v3 * h), &(qd + a3 * h)));
        q += (v1 + (v2 + v3) * 2.0 + v4) * (h / 6.0);
        qd += (a1 + (a2 + a3) * 2.0 + a4) * (h / 6.0);
    }
    let (gained, work) = (energy(&q, &qd) - before, torque.dot(&(q - start)));
    assert!(work.abs() > 1e-2 && (gained - work).abs() < 1e-8, "{gained} {work}");
}

#[test]
fn jacobians_of_palm_and_fingertips_on_an_arm_are_derivatives() {
    const ANGLE_STEP_RAD: f64 = 1e-6;
    let (hand, q) = (on_arm(), bent());
    let (palm, lever) = (hand.palm(&q), DVec3::new(0.004, -0.003, 0.001));
    for f in 0..3 {
        let found = hand.fingertip(&q, f);
        let (_, tips) = bodies(&q);
        assert!((found.pose.translation - tips[f].translation).length() < 1e-14);
        assert!(found.pose.rotation.abs_diff_eq(tips[f].rotation, 1e-14));
        assert_eq!(palm.carried(&hand.fingertip_in_palm(&q, f)), found);
        let place = tips[f].apply(lever);
        let by_arm = palm.jacobian_at(place);
        let by_finger = found.linear_at(found.pose.rotation * lever);
        for joint in 0..15 {
            let step = unit(joint) * ANGLE_STEP_RAD;
            let [(_, before), (_, after)] = [bodies(&(q - step)), bodies(&(q + step))];
            let moved = (after[f].apply(lever) - before[f].apply(lever)) / (2.0 * ANGLE_STEP_RAD);
            let turned = before[f].rotation
                * rotation_vector(&before[f].rotation, &after[f].rotation)
                / (2.0 * ANGLE_STEP_RAD);
            let own = joint.checked_sub(Hand::<3, 15>::first_joint(f)).filter(|own| *own < 3);
            let column = |v: [f64; 6]| (DVec3::new(v[0], v[1], v[2]), DVec3::new(v[3], v[4], v[5]));
            let (linear, angular) = match (joint, own) {
                (0..6, _) => column(by_arm.column(joint).into_owned().into()),
                (_, Some(own)) => (
                    to_glam_vector(&by_finger.column(own).into()),
                    to_glam_vector(&found.angular.column(own).into()),
                ),
                _ => (DVec3::ZERO, DVec3::ZERO),
            };
            assert!((moved - linear).length() < 1e-8, "{f} {joint}: {moved} {linear}");
            assert!((turned - angular).length() < 1e-8, "{f} {joint}: {turned} {angular}");
        }
    }
}

#[test]
fn a_palm_on_an_arm_reaches_and_follows_poses_and_the_fingers_stay() {
    let (hand, q) = (on_arm(), bent());
    let mut goal = hand.tool_pose(&q);
    assert_eq!(goal, hand.palm(&q).pose);
    goal.translation += DVec3::new(0.01, -0.02, 0.015);
    let found = hand.inverse_kinematics_near(&goal, &q).unwrap();
    assert!((hand.tool_pose(&found).translation - goal.translation).length() < 1e-9);
    assert_eq!(found.rows(6, 9), q.rows(6, 9));
    let mut follower = hand.follower(&q);
    let step = follower.step(&goal, 1.0).unwrap();
    assert!(step.position_error_m < 1e-9 && step.q.rows(6, 9) == q.rows(6, 9));
    let motion = Joints::new(1e-5, 0.0, -1e-5, 1e-5, 0.0, 2e-5);
    let small = hand.tool_step(&q, &motion, &q, 1e-3).unwrap();
    let moved = hand.tool_pose(&(q + small));
    let asked = hand.tool_pose(&q).compose(&Pose::new(
        rotation_from_vector(DVec3::new(1e-5, 0.0, 2e-5)),
        DVec3::new(1e-5, 0.0, -1e-5),
    ));
    assert!((moved.translation - asked.translation).length() < 1e-9);
    assert!(hand.is_within_reach_bound(&goal) && hand.is_reachable(&goal));
    goal.translation.x = 9.0;
    assert!(!hand.is_within_reach_bound(&goal));
    assert_eq!(hand.inverse_kinematics_near(&goal, &q), None);
}

#[test]
fn a_joint_of_the_arm_has_the_lever_of_the_fingertip_that_it_moves_farthest() {
    let (hand, q) = (on_arm(), bent());
    for joint in 0..15 {
        let step = unit(joint) * 1e-6;
        let ways = (0..3).map(|f| {
            let [from, to] = [q, q + step].map(|q| hand.fingertip(&q, f).pose.translation);
            (to - from).length() / 1e-6
        });
        let longest = ways.fold(0.0, f64::max);
        let lever_m = hand.touch_lever_m(joint, &q);
        assert!((lever_m - longest).abs() < 1e-6, "{joint}: {lever_m} {longest}");
    }
}

#[test]
fn a_hand_on_an_arm_stands_where_its_base_was_moved_to_and_has_six_joints_more() {
    let (hand, q) = (on_arm(), bent());
    let (base_m, yaw_rad) = (DVec3::new(0.3, -0.2, 0.5), 0.6);
    let moved = hand.standing_at(base_m, yaw_rad);
    let place = Pose::new(rotation_z(yaw_rad), base_m);
    for f in 0..3 {
        let asked = place.compose(&hand.fingertip(&q, f).pose);
        assert!((moved.fingertip(&q, f).pose.translation - asked.translation).length() < 1e-14);
    }
    let off = moved.gravity_torque(&q) - hand.gravity_torque(&q);
    assert!(off.amax() < 1e-12, "{off}");
    let fingers = [finger_joints(0.0), finger_joints(2.1)];
    let refused = Hand::<2, 15>::on_arm(&arm_joints(), &palm(), &fingers, &[tip(); 2]);
    assert_eq!(refused.unwrap_err().joint, 15);
    let mut bad = arm_joints();
    bad[4].axis = DVec3::ZERO;
    let refused = Hand::<2, 12>::on_arm(&bad, &palm(), &fingers, &[tip(); 2]);
    assert_eq!(refused.unwrap_err().joint, 4);
    assert_eq!((hand.q_min().len(), hand.effort_max()[3]), (15, 1.0));
}
