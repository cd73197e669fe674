//! Compares the dynamics with the PUMA 260's own recursion, which agrees with the reference data,
//! and checks properties that hold for any arm.

use crate::example_arms::{Lcg, puma, puma_with, seven, slider, ur5e_like};
use glam::{DMat3, DVec3};
use taktil_mechanics::chain::Chain;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::rigid_body::Body;
use taktil_mechanics::spatial::{JointMatrix, JointVector};

#[test]
fn the_puma_by_its_rows_moves_like_the_puma() {
    let (arm, chain) = (Dynamics::reference(), puma());
    let mut lcg = Lcg(11);
    for _ in 0..500 {
        let q = lcg.inside(&chain);
        let (qd, qdd) = (lcg.vector(3.0), lcg.vector(20.0));
        let off = chain.inverse_dynamics(&q, &qd, &qdd) - arm.inverse_dynamics(&q, &qd, &qdd);
        assert!(off.amax() < 1e-13, "{:e}", off.amax());
        assert!((chain.gravity_torque(&q) - arm.gravity_torque(&q)).amax() < 1e-14);
        assert!((chain.bias_torque(&q, &qd) - arm.bias_torque(&q, &qd)).amax() < 1e-13);
        assert!((chain.mass_matrix(&q) - arm.mass_matrix(&q)).amax() < 1e-15);
        let tau = lcg.vector(2.0);
        let off = chain.forward_dynamics(&q, &qd, &tau) - arm.forward_dynamics(&q, &qd, &tau);
        assert!(off.amax() < 1e-9, "{:e}", off.amax());
    }
}

#[test]
fn links_in_the_fewest_numbers_move_like_lopsided_bodies() {
    let mut lcg = Lcg(15);
    for _ in 0..50 {
        let mut body = || {
            let turn = lcg.rotation();
            let sizes = DVec3::splat(0.02) + 0.5 * lcg.point(0.02);
            Body {
                mass_kg: lcg.between(0.1, 4.0),
                com_m: lcg.point(0.2),
                inertia_kg_m2: turn * DMat3::from_diagonal(sizes) * turn.transpose(),
            }
        };
        let arm = Dynamics::from_bodies(core::array::from_fn(|_| body()), &body());
        let chain = puma_with(&arm);
        for _ in 0..20 {
            let q = lcg.inside(&chain);
            let (qd, qdd) = (lcg.vector(3.0), lcg.vector(20.0));
            let off = chain.inverse_dynamics(&q, &qd, &qdd) - arm.inverse_dynamics(&q, &qd, &qdd);
            assert!(off.amax() < 1e-11, "{:e}", off.amax());
            assert!((chain.gravity_torque(&q) - arm.gravity_torque(&q)).amax() < 1e-12);
            assert!((chain.mass_matrix(&q) - arm.mass_matrix(&q)).amax() < 1e-13);
            assert!((chain.potential_energy_j(&q) - arm.potential_energy_j(&q)).abs() < 1e-12);
        }
    }
}

/// Mass matrix, gravity and Coriolis terms agree with each other and with the energy of each mass.
fn check_energy<const N: usize>(chain: &Chain<N>, seed: u64) {
    let mut lcg = Lcg(seed);
    for _ in 0..100 {
        let (q, qd, qdd) = (lcg.inside(chain), lcg.vector(2.0), lcg.vector(5.0));
        let m = chain.mass_matrix(&q);
        let still = JointVector::zeros();
        let rigid = m - JointMatrix::from_diagonal(chain.reflected_inertia());
        let inertial = chain.inverse_dynamics(&q, &still, &qdd) - chain.gravity_torque(&q);
        assert!((rigid * qdd - inertial).amax() < 1e-12 * (1.0 + inertial.amax()));
        // qd . (Coriolis terms) is half of qd . dM/dt qd.
        let h = 1e-6;
        let rate =
            (chain.mass_matrix(&(q + qd * h)) - chain.mass_matrix(&(q - qd * h))) / (2.0 * h);
        let coriolis = chain.bias_torque(&q, &qd) - chain.gravity_torque(&q);
        assert!((qd.dot(&coriolis) - 0.5 * qd.dot(&(rate * qd))).abs() < 1e-7);
        let back = chain.forward_dynamics(
            &q,
            &qd,
            &(chain.inverse_dynamics(&q, &qd, &qdd)
                + chain.reflected_inertia().component_mul(&qdd)),
        );
        assert!((back - qdd).amax() < 1e-8, "{:e}", (back - qdd).amax());
        // Gravity is the slope of the potential energy.
        let slope = JointVector::<N>::from_fn(|i, _| {
            let mut aside = JointVector::<N>::zeros();
            aside[i] = h;
            (chain.potential_energy_j(&(q + aside)) - chain.potential_energy_j(&(q - aside)))
                / (2.0 * h)
        });
        let off = (slope - chain.gravity_torque(&q)).amax();
        assert!(off < 1e-7, "{off:e}");
    }
}

#[test]
fn matrices_forces_and_energies_agree() {
    check_energy(&ur5e_like(), 12);
    check_energy(&seven(), 13);
    check_energy(&slider(), 14);
}

#[test]
fn gravity_may_point_anywhere() {
    let (floor, q) = (ur5e_like(), JointVector::<6>::new(0.3, -1.0, 1.2, 0.4, -0.7, 2.0));
    assert!(floor.gravity_torque(&q)[0].abs() < 1e-13, "a vertical axis bears nothing");
    let ceiling = floor.with_gravity(DVec3::new(0.0, 0.0, 9.81));
    assert!((ceiling.gravity_torque(&q) + floor.gravity_torque(&q)).amax() < 1e-13);
    let wall = floor.with_gravity(DVec3::new(0.0, 9.81, 0.0));
    assert!(wall.gravity_torque(&q)[0].abs() > 1.0);
    assert_eq!(floor.with_gravity(DVec3::NAN), floor);
    assert_eq!(floor.with_gravity(DVec3::splat(1e9)), floor);
}
