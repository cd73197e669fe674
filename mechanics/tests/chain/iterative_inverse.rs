//! Tests the inverse kinematics by damped steps: solutions are found in few steps and lie inside
//! the limits, the same call gives the same bits, and a pose without a solution is reported as
//! such.

use crate::example_arms::{Lcg, puma, seven, slider, ur5e_like};
use glam::DVec3;
use taktil_mechanics::Pose;
use taktil_mechanics::chain::{Chain, SearchBudget};
use taktil_mechanics::spatial::JointVector;

/// Share of random reachable poses that are reached from random joints, and the mean of starts.
fn share<const N: usize>(chain: &Chain<N>, seed: u64, count: u32) -> (f64, f64) {
    let mut lcg = Lcg(seed);
    let (mut found, mut starts) = (0.0, 0.0);
    for _ in 0..count {
        let (goal, before) = (lcg.inside(chain), lcg.inside(chain));
        let tool = chain.tool_pose(&goal);
        if let Ok(got) = chain.inverse_kinematics(&tool, &before, &SearchBudget::default()) {
            let at = chain.tool_pose(&got.q);
            assert!((at.translation - tool.translation).length() < 1.1e-10);
            assert!(at.rotation.abs_diff_eq(tool.rotation, 1e-9) && chain.within_limits(&got.q));
            (found, starts) = (found + 1.0, starts + f64::from(got.starts));
        }
    }
    (found / f64::from(count), starts / found)
}

#[test]
fn random_poses_are_found() {
    for (name, (found, starts)) in [
        ("UR5e-like", share(&ur5e_like(), 31, 300)),
        ("seven joints", share(&seven(), 32, 300)),
        ("PUMA 260", share(&puma(), 33, 300)),
    ] {
        println!("{name}: {found} found, {starts} starts");
        // With joints clamped after the step instead of held in it, seven joints take 3.6 starts.
        assert!(found == 1.0 && starts < 3.0, "{name}: {found} found, {starts} starts");
    }
}

fn follows<const N: usize>(chain: &Chain<N>, seed: u64) {
    let mut lcg = Lcg(seed);
    for _ in 0..50 {
        let q = lcg.inside(chain) * 0.9;
        if !chain.within_limits(&q) || chain.singular_values(&q)[5.min(N - 1)] < 0.1 {
            continue;
        }
        // A tick of motion: the nearest solution is the one that is found.
        let near = q + lcg.vector::<N>(0.01);
        if !chain.within_limits(&near) {
            continue;
        }
        let got =
            chain.inverse_kinematics(&chain.tool_pose(&near), &q, &SearchBudget::TICK).unwrap();
        assert!((got.q - q).norm() <= (near - q).norm() * 1.01 && got.steps <= 8, "{got:?}");
        assert_eq!(
            got,
            chain.inverse_kinematics(&chain.tool_pose(&near), &q, &SearchBudget::TICK).unwrap()
        );
    }
}

#[test]
fn a_tick_of_motion_takes_the_nearest_joints_in_few_steps() {
    follows(&ur5e_like(), 34);
    follows(&seven(), 35);
    follows(&puma(), 36);
}

#[test]
fn whole_turns_stay_with_the_joints_before() {
    let chain = ur5e_like();
    let before = JointVector::<6>::new(5.5, -1.0, 1.2, -4.0, 1.0, 6.0);
    let got = chain
        .inverse_kinematics(&chain.tool_pose(&before), &before, &SearchBudget::default())
        .unwrap();
    assert!((got.q - before).amax() < 1e-9, "{}", got.q);
    let (turned, distance) =
        chain.nearest_equivalent(&before.map(|x| x - core::f64::consts::TAU), &before).unwrap();
    assert!((turned[0] - before[0]).abs() < 1e-12 && distance < 1e-12);
}

#[test]
fn what_cannot_be_reached_is_said_with_how_far_off() {
    let chain = ur5e_like();
    let mut far = chain.tool_pose(&JointVector::zeros());
    far.translation = DVec3::new(2.0, 0.0, 0.1625);
    let few = SearchBudget { starts: 4, ..SearchBudget::default() };
    let lost = chain.inverse_kinematics(&far, &JointVector::repeat(0.3), &few).unwrap_err();
    assert!(
        lost.position_error_m + lost.orientation_error_rad > 0.5 && chain.within_limits(&lost.q),
        "{lost}"
    );
    for bad in [f64::NAN, f64::INFINITY, 1e300] {
        let mut pose = far;
        pose.translation.y = bad;
        assert_eq!(
            chain
                .inverse_kinematics(&pose, &JointVector::zeros(), &few)
                .unwrap_err()
                .position_error_m,
            f64::INFINITY
        );
        let lost = JointVector::repeat(bad);
        assert_eq!(
            chain.inverse_kinematics(&far, &lost, &few).unwrap_err().position_error_m,
            f64::INFINITY
        );
    }
    let none = SearchBudget { starts: 0, ..few };
    assert!(chain.inverse_kinematics(&far, &JointVector::zeros(), &none).is_err());
    // A slider's goal beyond its slide is not turned back into it.
    let slide = slider();
    let mut q = JointVector::<5>::zeros();
    q[1] = 1.5;
    assert_eq!(slide.nearest_equivalent(&q, &JointVector::zeros()), None);
}

#[test]
fn rates_follow_a_twist_and_say_what_they_miss() {
    let chain = seven();
    let q = JointVector::<7>::from([0.1, 0.4, -0.3, -1.8, 0.2, 1.7, 0.5]);
    let twist = nalgebra::Vector6::new(0.1, -0.2, 0.05, 0.3, 0.1, -0.2);
    let (rates, missed) = chain.resolved_rates(&q, &twist, 0.0);
    assert!(missed.amax() < 1e-10 && (chain.jacobian_base(&q) * rates - twist).amax() < 1e-10);
    let (slow, missed) = chain.resolved_rates(&q, &twist, 0.5);
    assert!(slow.norm() < rates.norm() && missed.amax() > 1e-3);
    for bad in [f64::NAN, f64::INFINITY] {
        assert_eq!(chain.resolved_rates(&q, &(twist * bad), 0.1).0, JointVector::<7>::zeros());
        assert!(chain.resolved_rates(&q, &twist, bad).0.iter().all(|x| x.is_finite()));
    }
    let pose = Pose::IDENTITY;
    assert!(
        chain
            .inverse_kinematics(&pose, &q, &SearchBudget { steps: 0, ..SearchBudget::TICK })
            .is_err()
    );
}
