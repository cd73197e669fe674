//! Tests that no finite number makes a NaN or a panic: random bits, zeros of either sign, the
//! smallest and the largest numbers, and steps beside singularities, in every place of every
//! argument. The dynamics are tested for motions up to 1e60, the range that they promise.

use crate::example_arms::{Lcg, puma, seven, slider, ur5e_like};
use glam::{DMat3, DVec3};
use taktil_mechanics::chain::{Chain, SearchBudget};
use taktil_mechanics::dls::{damped_least_squares, damping_squared, scale_to_speed_limits};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::{Joints, Pose};

/// Any finite number.
fn odd(lcg: &mut Lcg) -> f64 {
    match lcg.word() >> 60 {
        0 => 0.0,
        1 => -0.0,
        2 => f64::MIN_POSITIVE,
        3 => f64::from_bits(lcg.word() & 0xfff),
        4 => f64::MAX,
        5 => -f64::MAX,
        6 => core::f64::consts::FRAC_PI_2,
        7 => -core::f64::consts::PI,
        8 | 9 => lcg.between(-1.0, 1.0),
        10 => lcg.between(-1e-9, 1e-9),
        _ => {
            let bits = f64::from_bits(lcg.word());
            if bits.is_finite() { bits } else { 1.0 }
        }
    }
}

fn vector<const N: usize>(lcg: &mut Lcg) -> JointVector<N> {
    JointVector::from_fn(|_, _| odd(lcg))
}

fn pose(lcg: &mut Lcg) -> Pose {
    let point = |lcg: &mut Lcg| DVec3::new(odd(lcg), odd(lcg), odd(lcg));
    let rotation = if lcg.word() >> 63 == 0 {
        lcg.rotation()
    } else {
        DMat3::from_cols(point(lcg), point(lcg), point(lcg))
    };
    let place = if lcg.word() >> 63 == 0 { lcg.point(0.4) } else { point(lcg) };
    Pose::new(rotation, place)
}

fn finite<'a>(what: &str, values: impl IntoIterator<Item = &'a f64>) {
    assert!(values.into_iter().all(|x| x.is_finite()), "{what}");
}

#[test]
fn the_puma_s_kinematics_answer_every_finite_number() {
    let arm = Puma260::reference();
    let mut lcg = Lcg(41);
    for _ in 0..20_000 {
        let (q, other): (Joints, Joints) = (vector(&mut lcg), vector(&mut lcg));
        assert!(arm.tool_pose(&q).is_finite());
        finite("Jacobian", arm.jacobian_base(&q).iter());
        finite("Jacobian", arm.jacobian_tool(&q).iter());
        assert!(
            arm.jacobian_determinant(&q).is_finite()
                && arm.singularity_distance(&q).smallest() <= 1.0
        );
        let pose = pose(&mut lcg);
        let branches = arm.inverse_kinematics(&pose, Some(&q));
        for branch in &branches {
            finite("branch", branch.q.iter());
        }
        if let Some((_, near)) = arm.nearest_branch(&branches, &other) {
            finite("nearest", near.iter());
        }
        if let Some(near) = arm.inverse_without_limits(&pose, &other) {
            finite("continued", near.iter());
        }
        finite("speeds", scale_to_speed_limits(&q, &arm.speed_max_rad_s).0.iter());
        if let Some(rates) = damped_least_squares(&arm.jacobian_base(&q), &other, odd(&mut lcg)) {
            finite("rates", rates.iter());
        }
        let damping = damping_squared(odd(&mut lcg), odd(&mut lcg), lcg.between(-1e3, 1e3));
        assert!(damping.is_finite());
    }
}

#[test]
fn the_puma_s_dynamics_answer_motions_up_to_1e60() {
    let arm = Dynamics::reference();
    let mut lcg = Lcg(42);
    for _ in 0..5_000 {
        let q: Joints = vector(&mut lcg);
        let qd = vector::<6>(&mut lcg).map(|x: f64| x.clamp(-1e60, 1e60));
        let qdd = vector::<6>(&mut lcg).map(|x: f64| x.clamp(-1e60, 1e60));
        finite("torque", arm.inverse_dynamics(&q, &qd, &qdd).iter());
        finite("gravity", arm.gravity_torque(&q).iter());
        finite("mass matrix", arm.mass_matrix(&q).iter());
        finite("acceleration", arm.forward_dynamics(&q, &qd, &qdd).iter());
    }
}

fn chain_answers<const N: usize>(chain: &Chain<N>, seed: u64) {
    let mut lcg = Lcg(seed);
    let effort = SearchBudget { starts: 2, steps: 6, ..SearchBudget::default() };
    for _ in 0..2_000 {
        // Slides have a length: the place of a tool on a slide of 1e300 m is no number.
        let q = vector::<N>(&mut lcg).map(|x: f64| x.clamp(-1e60, 1e60));
        let (qd, qdd) = (vector::<N>(&mut lcg), vector::<N>(&mut lcg));
        let (qd, qdd) = (qd.map(|x| x.clamp(-1e60, 1e60)), qdd.map(|x| x.clamp(-1e60, 1e60)));
        assert!(chain.tool_pose(&q).is_finite());
        finite("Jacobian", chain.jacobian_base(&q).iter());
        finite("Jacobian", chain.jacobian_tool(&q).iter());
        finite("singular values", chain.singular_values(&q).iter());
        finite("torque", chain.inverse_dynamics(&q, &qd, &qdd).iter());
        finite("gravity", chain.gravity_torque(&q).iter());
        finite("mass matrix", chain.mass_matrix(&q).iter());
        let pose = pose(&mut lcg);
        match chain.inverse_kinematics(&pose, &vector(&mut lcg), &effort) {
            Ok(found) => finite("found", found.q.iter()),
            Err(lost) => finite("not found", lost.q.iter()),
        }
        let twist = vector::<6>(&mut lcg).map(|x: f64| x.clamp(-1e60, 1e60));
        finite("rates", chain.resolved_rates(&q, &twist, odd(&mut lcg)).0.iter());
        if let Some((near, _)) = chain.nearest_equivalent(&q, &vector(&mut lcg)) {
            finite("expanded", near.iter());
        }
    }
}

#[test]
fn chains_answer_every_finite_number() {
    chain_answers(&puma(), 43);
    chain_answers(&ur5e_like(), 44);
    chain_answers(&seven(), 45);
    chain_answers(&slider(), 46);
}

#[test]
fn the_closed_form_answers_every_finite_number() {
    let mut lcg = Lcg(47);
    for _ in 0..40 {
        let arm = crate::example_arms::random_wrist_arm(&mut lcg).chain(&mut lcg);
        let wrist = arm.spherical_wrist().unwrap();
        for _ in 0..200 {
            let before: Joints = vector(&mut lcg);
            let branches = wrist.inverse_kinematics(&pose(&mut lcg), Some(&before));
            for branch in &branches {
                finite("branch", branch.q.iter());
            }
            if let Some((_, near)) = wrist.nearest_branch(&branches, &before) {
                finite("nearest", near.iter());
            }
            let d = wrist.singularity_distance(&before);
            assert!(d.smallest().is_finite());
        }
    }
}
