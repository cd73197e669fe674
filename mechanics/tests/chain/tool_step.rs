//! Joint steps for small motions of the tool: they move it as asked, the shortest of them where
//! joints are left, and a wish does not move the tool. Damped near singularities, refused in them.

use taktil_mechanics::chain::Chain;
use taktil_mechanics::spatial::{JointVector, Joints, linear_and_angular, rotation_vector};

use crate::example_arms::{Lcg, puma, seven, ur5e_like};

/// Distance from a singularity that the tests bear.
const DISTANCE_MIN: f64 = 0.05;

/// The largest difference (m, rad) of the tool's motion by `step` from `motion`, in its own axes.
fn miss<const N: usize>(
    arm: &Chain<N>,
    q: &JointVector<N>,
    step: &JointVector<N>,
    motion: &Joints,
) -> f64 {
    let (before, after) = (arm.tool_pose(q), arm.tool_pose(&(q + step)));
    let moved = before.rotation.transpose() * (after.translation - before.translation);
    let turned = rotation_vector(&before.rotation, &after.rotation);
    let (linear, angular) = linear_and_angular(motion);
    (moved - linear).abs().max_element().max((turned - angular).abs().max_element())
}

fn moves_as_asked<const N: usize>(arm: &Chain<N>) {
    let mut lcg = Lcg(7);
    let mut tried = 0;
    for _ in 0..300 {
        let (q, motion) = (lcg.inside(arm), lcg.vector::<6>(1e-5));
        let wish = lcg.vector::<N>(1e-5);
        let Some(step) = arm.tool_step(&q, &motion, &wish, DISTANCE_MIN) else { continue };
        if arm.singular_values(&q)[5] < 3.0 * 6f64.sqrt() * DISTANCE_MIN {
            // Damped, perhaps: it lags.
            continue;
        }
        tried += 1;
        // The miss is that of a straight line against a curve: the square of the step.
        assert!(miss(arm, &q, &step, &motion) < 3.0 * step.norm_squared() + 1e-13);
    }
    assert!(tried > 20, "{tried} poses away from singularities");
}

#[test]
fn a_step_moves_the_tool_as_asked_whatever_is_wished() {
    moves_as_asked(&puma());
    moves_as_asked(&ur5e_like());
    moves_as_asked(&seven());
}

#[test]
fn without_a_wish_the_step_is_the_shortest_and_a_wish_alone_does_not_move_the_tool() {
    let arm = seven();
    let mut lcg = Lcg(11);
    let mut tried = 0;
    for _ in 0..200 {
        let (q, motion) = (lcg.inside(&arm), lcg.vector::<6>(1e-5));
        let wish = lcg.vector::<7>(1e-5);
        let zero = JointVector::<7>::zeros();
        let Some(shortest) = arm.tool_step(&q, &motion, &zero, 0.2) else { continue };
        let free = arm.tool_step(&q, &Joints::zeros(), &wish, 0.2).unwrap();
        tried += 1;
        // What a wish adds stands at a right angle to the shortest step.
        assert!(shortest.dot(&free).abs() < 1e-9 * (shortest.norm() * free.norm()).max(1e-20));
        assert!((arm.jacobian_tool(&q) * free).amax() < 1e-16);
        // The part of a wish is the same when it is wished again.
        let again = arm.tool_step(&q, &Joints::zeros(), &free, 0.2).unwrap();
        assert!((again - free).amax() < 1e-13 * (1.0 + free.amax()));
    }
    assert!(tried > 20, "{tried}");
}

#[test]
fn six_joints_have_nothing_left_for_a_wish() {
    let (arm, motion) = (ur5e_like(), Joints::repeat(1e-5));
    let q = JointVector::from([0.0, -75.0, 90.0, -105.0, -90.0, 90.0].map(f64::to_radians));
    let step = |wish: f64| arm.tool_step(&q, &motion, &JointVector::repeat(wish), 0.05).unwrap();
    assert_eq!(step(0.0), step(1.0));
}

#[test]
fn near_a_singularity_a_step_is_damped_and_in_it_refused() {
    let arm = ur5e_like();
    let at = |wrist_deg: f64| {
        JointVector::from([0.0, -75.0, 90.0, -105.0, wrist_deg, 90.0].map(f64::to_radians))
    };
    let motion = Joints::new(0.0, 0.0, 0.0, 1e-4, 1e-4, 0.0);
    let zero = JointVector::zeros();
    let step = |q: &JointVector<6>, least: f64| arm.tool_step(q, &motion, &zero, least);
    // The distance is between the smallest singular value and that over the root of six.
    for wrist_deg in [-90.0, -40.0, -12.0] {
        let least = arm.singular_values(&at(wrist_deg))[5];
        assert!(step(&at(wrist_deg), 1.001 * least).is_none());
        assert!(step(&at(wrist_deg), 0.999 * least / 6f64.sqrt()).is_some());
    }
    // Half of the singular value is damping already; a hundredth is none.
    let q = at(-12.0);
    let least = arm.singular_values(&q)[5];
    let (damped, exact) = (step(&q, 0.5 * least), step(&q, 0.01 * least));
    let (damped, exact) = (damped.unwrap(), exact.unwrap());
    assert!(damped.norm() < 0.995 * exact.norm(), "{} {}", damped.norm(), exact.norm());
    assert!(miss(&arm, &q, &exact, &motion) < 3.0 * exact.norm_squared());
    for bad in [f64::NAN, f64::INFINITY] {
        assert!(arm.tool_step(&at(bad), &motion, &zero, 0.05).is_none());
        assert!(arm.tool_step(&at(-90.0), &Joints::repeat(bad), &zero, 0.05).is_none());
    }
    assert!(step(&at(0.0), 1e-6).is_none(), "axes 4 and 6 are parallel");
}

#[test]
fn an_arm_that_stands_elsewhere_moves_alike_there() {
    use glam::DVec3;
    let (arm, place) = (seven(), DVec3::new(-0.2, 0.3, -0.5));
    let there = arm.standing_at(place, core::f64::consts::FRAC_PI_2);
    let q = JointVector::<7>::from([0.1, 0.2, 0.3, -2.0, 0.5, 2.0, 0.7]);
    let (here, pose) = (arm.tool_pose(&q).translation, there.tool_pose(&q).translation);
    assert!((pose - (place + DVec3::new(-here.y, here.x, here.z))).length() < 1e-15);
    assert!((arm.gravity_torque(&q) - there.gravity_torque(&q)).amax() < 1e-12);
    assert!((arm.mass_matrix(&q) - there.mass_matrix(&q)).amax() < 1e-12);
    assert_eq!(arm.standing_at(DVec3::NAN, 0.0), arm);
    assert_eq!(arm.standing_at(DVec3::ZERO, f64::INFINITY), arm);
}
