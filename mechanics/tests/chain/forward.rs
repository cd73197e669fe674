//! Tests of the poses and Jacobians of chains.

use crate::example_arms::{Lcg, PI, puma, seven, slider, ur5e_like};
use crate::{derivative, dh_rows};
use glam::{DMat3, DVec3};
use taktil_mechanics::Pose;
use taktil_mechanics::chain::{Chain, DhRow, JointSpec};
use taktil_mechanics::dls::singular_values;
use taktil_mechanics::puma260::Puma260;

#[test]
fn the_puma_by_its_rows_is_the_puma() {
    let (arm, chain) = (Puma260::reference(), puma());
    let mut lcg = Lcg(1);
    for _ in 0..2000 {
        let q = lcg.inside(&chain);
        let (got, want) = (chain.tool_pose(&q), arm.tool_pose(&q));
        assert!(got.rotation.abs_diff_eq(want.rotation, 3e-15));
        assert!((got.translation - want.translation).length() < 1e-15);
        assert!((chain.jacobian_base(&q) - arm.jacobian_base(&q)).amax() < 3e-15);
        assert!((chain.jacobian_tool(&q) - arm.jacobian_tool(&q)).amax() < 3e-15);
    }
}

#[test]
fn published_rows_reach_the_published_place() {
    // At zero the UR5e lies stretched along -x: a2 + a3, -(d4 + d6), d1 - d5.
    let at = ur5e_like().tool_pose(&nalgebra::SVector::zeros());
    let want = DVec3::new(-0.8172, -0.2329, 0.0628);
    assert!((at.translation - want).length() < 1e-15, "{:?}", at.translation);
    // The seven-joint arm straight up: d1 + d3 + d5 less the flange, which points down.
    let at = seven().tool_pose(&nalgebra::SVector::zeros());
    assert!((at.translation - DVec3::new(0.088, 0.0, 1.033 - 0.107)).length() < 1e-15);
    assert!((at.rotation.z_axis + DVec3::Z).length() < 1e-15);
}

#[test]
fn rows_of_either_convention_are_the_same_arm() {
    // Franka Robotics publishes modified rows, the examples use standard ones.
    let (modified, standard) =
        (seven(), dh_rows::chain(&dh_rows::SEVEN_JOINT_ROWS, &JointSpec::default()));
    let mut lcg = Lcg(3);
    for _ in 0..500 {
        let q = lcg.inside(&modified);
        let (got, want) = (standard.tool_pose(&q), modified.tool_pose(&q));
        assert!((got.translation - want.translation).length() < 1e-14);
        assert!(got.rotation.abs_diff_eq(want.rotation, 1e-14));
    }
}

fn check_derivative<const N: usize>(chain: &Chain<N>, seed: u64) {
    let mut lcg = Lcg(seed);
    for _ in 0..100 {
        let q = lcg.inside(chain);
        let (base, tool) = (chain.jacobian_base(&q), chain.jacobian_tool(&q));
        derivative::check(&q, &lcg.vector(1.0), |q| chain.tool_pose(q), base, tool);
    }
}

#[test]
fn jacobians_are_derivatives_of_the_pose() {
    check_derivative(&ur5e_like(), 2);
    check_derivative(&seven(), 3);
    check_derivative(&slider(), 4);
}

#[test]
fn singular_values_are_those_of_the_scaled_jacobian() {
    let chain = puma();
    let mut lcg = Lcg(5);
    for _ in 0..200 {
        let q = lcg.inside(&chain);
        let got = chain.singular_values(&q);
        let mut j = chain.jacobian_base(&q);
        // The mean of 0.2032, 0.127, 0.2032 and the tool's 0.2 over six joints.
        j.fixed_rows_mut::<3>(0).unscale_mut(0.7334 / 6.0);
        for (a, b) in got.iter().zip(singular_values(&j)) {
            assert!((a - b).abs() < 1e-13 * got[0], "{got:?}");
        }
    }
    let mut straight = lcg.inside(&chain);
    straight[4] = 0.0;
    assert!(chain.singular_values(&straight)[5] < 1e-15);
    assert!(chain.singular_values(&nalgebra::SVector::repeat(f64::NAN))[5].is_nan());
    // Five joints span five directions.
    assert!(slider().singular_values(&nalgebra::SVector::zeros())[5] < 1e-15);
}

#[test]
fn invalid_chains_are_refused_with_the_joint_named() {
    let good = [JointSpec::default(); 3];
    let refused = |change: &dyn Fn(&mut JointSpec)| {
        let mut joints = good;
        change(&mut joints[1]);
        let bad = Chain::new(&joints, &Pose::IDENTITY).unwrap_err();
        assert!(bad.to_string().starts_with("joint 2: "), "{bad}");
    };
    assert!(Chain::new(&good, &Pose::IDENTITY).is_ok());
    for bad in [f64::NAN, f64::INFINITY, -f64::INFINITY, 1e300] {
        refused(&|j| j.origin.translation.x = bad);
        refused(&|j| j.origin.rotation.x_axis.x = bad);
        refused(&|j| j.axis.y = bad);
        refused(&|j| j.body.mass_kg = bad);
        refused(&|j| j.body.com_m.z = bad);
        refused(&|j| j.body.inertia_kg_m2.x_axis.x = bad);
        refused(&|j| j.q_max = bad);
        refused(&|j| j.speed_max = bad);
        refused(&|j| j.effort_max = bad);
        refused(&|j| j.reflected_inertia = bad);
    }
    refused(&|j| j.axis = DVec3::ZERO);
    refused(&|j| j.body.mass_kg = -1.0);
    refused(&|j| j.body.inertia_kg_m2.x_axis.y = 0.1);
    refused(&|j| (j.q_min, j.q_max) = (1.0, -1.0));
    refused(&|j| j.speed_max = 0.0);
    refused(&|j| j.origin.rotation = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)));
    let nobody: [JointSpec; 0] = [];
    assert_eq!(Chain::new(&nobody, &Pose::IDENTITY).unwrap_err().joint, 0);
    assert_eq!(Chain::new(&[JointSpec::default(); 10], &Pose::IDENTITY).unwrap_err().joint, 10);
    let spec = JointSpec::default();
    let row = DhRow { a_m: 0.1, d_m: f64::NAN, alpha_rad: 0.0, theta_rad: PI, spec };
    assert_eq!(Chain::from_dh(&[row; 2], &Pose::IDENTITY).unwrap_err().joint, 0);
}
