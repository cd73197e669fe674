//! Tests the dynamics: torques, mass matrix, energies and whole motions.

use crate::lcg::Lcg;
use crate::table::{joints, rows, toml};
use core::f64::consts::TAU;
use glam::{DMat3, DVec3};
use taktil_mechanics::Joints;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::{Dynamics, State, free_motion, rk4_step};
use taktil_mechanics::rigid_body::Body;

#[test]
fn inverse_dynamics_match_the_reference() {
    let arm = Dynamics::reference();
    let friction = Friction::reference();
    let file = rows("kinematics/rnea.csv");
    assert_eq!(file.len(), 100);
    for row in file {
        let (q, qd, qdd) = (row.joints("q"), row.joints("qd"), row.joints("qdd"));
        let tau = arm.inverse_dynamics(&q, &qd, &qdd);
        assert!((tau - row.joints("tau")).amax() < 1e-10, "row {}", row.word("id"));
        assert!((arm.gravity_torque(&q) - row.joints("grav")).amax() < 1e-10);
        let full = tau + arm.reflected_inertia_kg_m2.component_mul(&qdd) + friction.torque_nm(&qd);
        assert!((full - row.joints("full")).amax() < 1e-10, "row {}", row.word("id"));
    }
}

#[test]
fn recursion_mass_matrix_and_forward_dynamics_agree() {
    let geometry = Puma260::reference();
    // A lopsided tool, so that products of inertia and off-axis masses are there.
    let lopsided = Body {
        mass_kg: 0.7,
        com_m: DVec3::new(0.03, -0.02, 0.09),
        inertia_kg_m2: DMat3::from_cols_array(&[
            1e-3, 2e-4, -1e-4, 2e-4, 2e-3, 3e-4, -1e-4, 3e-4, 1.5e-3,
        ]),
    };
    let mut lcg = Lcg::new(7);
    for arm in [Dynamics::reference(), Dynamics::with_tool(&lopsided)] {
        for _ in 0..1000 {
            let (q, qd, qdd) = (lcg.joints(&geometry), lcg.six(4.0), lcg.six(20.0));
            let m = arm.mass_matrix(&q);
            assert_eq!(m, m.transpose());
            assert!(
                (arm.gravity_torque(&q) - arm.bias_torque(&q, &Joints::zeros())).amax() < 1e-13
            );
            let tau = arm.inverse_dynamics(&q, &qd, &qdd)
                + arm.reflected_inertia_kg_m2.component_mul(&qdd);
            assert!((m * qdd + arm.bias_torque(&q, &qd) - tau).amax() < 1e-12);
            assert!((arm.forward_dynamics(&q, &qd, &tau) - qdd).amax() < 1e-11);
            assert!(arm.kinetic_energy_j(&q, &qd) > 0.0);
            // Gravity torques are the slope of the potential energy.
            for i in 0..6 {
                let at = |h: f64| {
                    let mut moved = q;
                    moved[i] += h;
                    arm.potential_energy_j(&moved)
                };
                assert!(((at(1e-5) - at(-1e-5)) / 2e-5 - arm.gravity_torque(&q)[i]).abs() < 1e-8);
            }
        }
    }
}

#[test]
fn welding_adds_mass_and_moves_the_centre() {
    let one = Body::diagonal(1.0, [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]);
    let two = Body::diagonal(3.0, [0.0, 0.0, -1.0], [0.0, 0.0, 0.5]);
    let both = one.combine(&two);
    assert_eq!((both.mass_kg, both.com_m), (4.0, DVec3::new(0.0, 0.0, -0.5)));
    let inertia = both.inertia_kg_m2;
    // Reduced mass 3/4 kg at 2 m.
    assert_eq!((inertia.x_axis.x, inertia.y_axis.y, inertia.z_axis.z), (3.0, 3.0, 0.5));
    let nothing = Body::diagonal(0.0, [0.0; 3], [0.0; 3]);
    assert_eq!(nothing.combine(&nothing), nothing);
}

/// Follows a reference run at 1 ms and returns the largest joint and energy errors.
fn follow(name: &str, mut torque: impl FnMut(f64, &Joints, &Joints) -> Joints) -> (f64, f64) {
    let arm = Dynamics::reference();
    let file = rows(name);
    let mut state = State { q: file[0].joints("q"), qd: file[0].joints("qd") };
    let (mut worst, mut energy): (f64, f64) = (0.0, 0.0);
    for pair in file.windows(2) {
        let (t, until) = (pair[0].num("t"), pair[1].num("t"));
        state = free_motion(&arm, &state, t, until - t, 1e-3, &mut torque);
        worst = worst.max((state.q - pair[1].joints("q")).amax());
        energy =
            energy.max((arm.kinetic_energy_j(&state.q, &state.qd) - pair[1].num("kinetic")).abs());
        energy = energy.max((arm.potential_energy_j(&state.q) - pair[1].num("potential")).abs());
    }
    (worst, energy)
}

#[test]
fn the_passive_run_matches_the_reference() {
    let (worst, energy) = follow("kinematics/sim_passive.csv", |_, _, _| Joints::zeros());
    println!("passive: {worst:e} rad, {energy:e} J");
    assert!(worst < 1e-9 && energy < 1e-9, "{worst:e} rad, {energy:e} J");
}

#[test]
fn the_driven_run_matches_the_reference() {
    let file = toml("kinematics/sim_driven.toml");
    let [hold, amp, freq, phase] = ["hold", "amp", "freq", "phase"].map(|k| joints(&file, k));
    let viscous = Friction::reference().viscous_nms_rad;
    let (worst, energy) = follow("kinematics/sim_driven.csv", |t, _, qd| {
        Joints::from_fn(|i, _| {
            let swing = libm::sin(TAU * freq[i] * t + phase[i]) - libm::sin(phase[i]);
            hold[i] + amp[i] * swing - viscous[i] * qd[i]
        })
    });
    println!("driven: {worst:e} rad, {energy:e} J");
    assert!(worst < 1e-9 && energy < 1e-9, "{worst:e} rad, {energy:e} J");
}

#[test]
fn free_fall_keeps_its_energy_at_servo_steps() {
    let arm = Dynamics::reference();
    let start = State { q: Joints::new(0.4, 0.8, -1.7, -0.4, 0.6, 1.0), qd: Joints::repeat(0.5) };
    let total = |s: &State| arm.kinetic_energy_j(&s.q, &s.qd) + arm.potential_energy_j(&s.q);
    let end = free_motion(&arm, &start, 0.0, 0.5, 0.0025, &mut |_, _, _| Joints::zeros());
    assert!((total(&end) - total(&start)).abs() < 1e-6);
    assert!((end.q - start.q).amax() > 0.3, "it must have fallen");
}

#[test]
fn bad_spans_and_lost_numbers_are_harmless() {
    let arm = Dynamics::reference();
    let start = State { q: Joints::zeros(), qd: Joints::zeros() };
    let mut idle = |_: f64, _: &Joints, _: &Joints| Joints::zeros();
    for (span, step) in
        [(0.0, 1e-3), (-1.0, 1e-3), (f64::NAN, 1e-3), (1.0, 0.0), (1.0, -1.0), (1.0, 1e-300)]
    {
        assert_eq!(free_motion(&arm, &start, 0.0, span, step, &mut idle), start);
    }
    let mut calls = 0;
    let mut count = |_: f64, _: &Joints, _: &Joints| {
        calls += 1;
        Joints::zeros()
    };
    let _ = free_motion(&arm, &start, 0.0, 0.01, 0.001, &mut count);
    assert_eq!(calls, 40, "ten steps of four, not eleven");
    let lost = Joints::repeat(f64::NAN);
    assert!(arm.forward_dynamics(&lost, &start.qd, &start.qd).iter().all(|x| x.is_nan()));
    let next = rk4_step(&arm, &start, 0.0, 1e-3, &mut |_, _, _| lost);
    assert!(next.qd.iter().all(|x| x.is_nan()));
    let still = Friction::reference().torque_nm(&Joints::zeros());
    assert_eq!(still, Joints::zeros());
}
