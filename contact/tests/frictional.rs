//! Tests the general contact solver: comparison with the spectral one, Coulomb's law, paths of
//! loads.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::plane::compliance::SurfaceCompliance;
use taktil_contact::plane::frictional::{ContactStatus, FrictionLaw, FrictionalContact, LoadStep};
use taktil_contact::plane::noslip::NoSlip;
use taktil_contact::plane::{Friction, Indenter, Load, Refusal, Shape};

const E_MPA: f64 = 27.58;

fn layer(nu: f64) -> Layer {
    Layer::new(0.8, E_MPA, nu).expect("a sound layer")
}

/// Edges of the cells of a bar, finer at its corners.
fn face(width: f64, n: u32) -> Vec<f64> {
    let angle = |i: u32| core::f64::consts::PI * f64::from(i) / f64::from(n);
    (0..=n).map(|i| -0.5 * width * libm::cos(angle(i))).collect()
}

fn even(half: f64, n: u32) -> Vec<f64> {
    (0..=n).map(|i| half * (2.0 * f64::from(i) / f64::from(n) - 1.0)).collect()
}

fn bar(nu: f64, n: u32, law: FrictionLaw) -> FrictionalContact {
    let bed = SurfaceCompliance::of_layer(&layer(nu), &face(12.7, n)).expect("a bed");
    let heights = vec![0.0; bed.count()];
    FrictionalContact::new(bed, heights, law).expect("a grip")
}

fn roll(nu: f64, radius: f64, half: f64, n: u32, law: FrictionLaw) -> FrictionalContact {
    let bed = SurfaceCompliance::of_layer(&layer(nu), &even(half, n)).expect("a bed");
    let round = |x: &f64| x * x / (radius + (radius * radius - x * x).sqrt());
    let heights = bed.x_mm.iter().map(round).collect();
    FrictionalContact::new(bed, heights, law).expect("a grip")
}

fn loads(p_n_mm: f64, q_n_mm: f64) -> LoadStep {
    LoadStep::Loads { load: Load { p_n_mm, q_n_mm }, height_mm: 6.35 }
}

#[test]
fn bars_agree_with_the_spectral_solver() {
    for (ratio, friction) in [
        (0.0, Friction::None),
        (0.2, Friction::None),
        (0.2, Friction::Proportional),
        (0.7, Friction::Proportional),
        (-0.7, Friction::None),
    ] {
        let shape = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
        let mut exact =
            Indenter::new(&layer(0.49), shape, friction, Accuracy::Fine).expect("sound");
        let load = Load { p_n_mm: 0.7, q_n_mm: 0.7 * ratio };
        let contact = exact.press(&load).expect("a contact");
        let law = match friction {
            Friction::None => FrictionLaw::Free,
            Friction::Proportional => FrictionLaw::Proportional(ratio),
        };
        let mut last = f64::INFINITY;
        for n in [48, 96] {
            let mut grip = bar(0.49, n, law);
            grip.step(&loads(load.p_n_mm, load.q_n_mm)).expect("a contact");
            assert!(grip.residual() < 1e-11);
            let peak = 0.7 / 12.7 * 1.7;
            let bed = grip.compliance();
            let miss = (0..bed.count())
                .filter(|i| bed.x_mm[*i].abs() < 5.5)
                .map(|i| {
                    let p = grip.normal_n_mm()[i] / bed.width_mm[i];
                    (p - exact.pressure_mpa(bed.x_mm[i])).abs() / peak
                })
                .fold(0.0, f64::max);
            assert!(miss < 0.7 * last && miss < 0.05, "{ratio} {n}: {miss}");
            last = miss;
            let [descent, tilt, _] = grip.rigid();
            assert!((descent / contact.delta_mm - 1.0).abs() < 0.02, "{ratio} {n}");
            assert!((tilt - contact.slope).abs() < 0.02 * contact.slope.abs() + 1e-9);
        }
    }
}

#[test]
fn cylinders_agree_with_the_spectral_solver_at_second_order() {
    let shape = Shape::Cylinder { radius_mm: 25.4 };
    let mut exact =
        Indenter::new(&layer(0.49), shape, Friction::None, Accuracy::Fine).expect("sound");
    let contact = exact.descend(0.03).expect("a contact");
    let miss = |n: u32| {
        let mut grip = roll(0.49, 25.4, 2.0, n, FrictionLaw::Free);
        grip.step(&LoadStep::Move { dz_mm: 0.03, dx_mm: 0.0 }).expect("a contact");
        (grip.load().p_n_mm / contact.p_n_mm - 1.0).abs()
    };
    let (coarse, fine) = (miss(40), miss(160));
    assert!(coarse < 5e-3 && fine < 4e-4, "{coarse:e} {fine:e}");
}

#[test]
fn growth_in_steps_without_slip_tends_to_the_volterra_solution() {
    let shape = Shape::Cylinder { radius_mm: 25.4 };
    let exact = NoSlip::descend(&layer(0.49), shape, 0.0326).expect("a contact");
    let load = |steps: u32| {
        let mut grip = roll(0.49, 25.4, 1.8, 90, FrictionLaw::Coulomb(f64::INFINITY));
        for k in 1..=steps {
            let dz_mm = 0.0326 * f64::from(k) / f64::from(steps);
            grip.step(&LoadStep::Move { dz_mm, dx_mm: 0.0 }).expect("a contact");
        }
        grip.load().p_n_mm / exact.p_n_mm - 1.0
    };
    let (coarse, fine) = (load(8), load(40));
    assert!(fine.abs() < 0.01 && fine.abs() < coarse.abs(), "{coarse} {fine}");
}

#[test]
fn coulomb_holds_everywhere_and_the_zones_are_those_of_the_law() {
    // A bar under P and then Q first slips nowhere or at the rear edge, and slides as a whole at mu
    // P.
    let mut grip = bar(0.49, 64, FrictionLaw::Coulomb(0.3));
    grip.step(&LoadStep::Upright(Load { p_n_mm: 1.0, q_n_mm: 0.0 })).expect("pressed");
    for k in 1..=9 {
        let q_n_mm = 0.033 * f64::from(k);
        grip.step(&LoadStep::Upright(Load { p_n_mm: 1.0, q_n_mm })).expect("held");
        for (p, q) in grip.normal_n_mm().iter().zip(grip.tangential_n_mm()) {
            assert!(*p >= -1e-12 && q.abs() <= 0.3 * p + 1e-12, "{p} {q}");
        }
        let load = grip.load();
        assert!((load.p_n_mm - 1.0).abs() < 1e-12 && (load.q_n_mm - q_n_mm).abs() < 1e-12);
    }
    assert!(grip.status().contains(&ContactStatus::SlipForward));
    assert!(grip.status().contains(&ContactStatus::Stick));
    let slide = LoadStep::Upright(Load { p_n_mm: 1.0, q_n_mm: 0.31 });
    assert_eq!(grip.step(&slide), Err(Refusal::Sliding));
}

/// Cattaneo and Mindlin: without coupling (nu = 0.5, contact small against the layer) the shear is
/// mu p less mu p of a smaller contact, and the stick zone has the width sqrt(1 - Q/(mu P)).
#[test]
fn partial_slip_of_a_cylinder_is_that_of_cattaneo() {
    let thick = Layer::new(200.0, E_MPA, 0.5).expect("a layer");
    let bed = SurfaceCompliance::of_layer(&thick, &even(1.2, 240)).expect("a bed");
    let heights = bed.x_mm.iter().map(|x| x * x / 20.0).collect();
    let mut grip = FrictionalContact::new(bed, heights, FrictionLaw::Coulomb(0.4)).expect("a grip");
    let a = 1.0;
    let p_n_mm = core::f64::consts::PI * E_MPA * a * a / (4.0 * 10.0 * 0.75);
    grip.step(&LoadStep::Upright(Load { p_n_mm, q_n_mm: 0.0 })).expect("pressed");
    let part = 0.6;
    let load = Load { p_n_mm, q_n_mm: part * 0.4 * p_n_mm };
    grip.step(&LoadStep::Upright(load)).expect("held");
    let stuck = grip.status().iter().filter(|s| **s == ContactStatus::Stick).count();
    let half = 0.5 * stuck as f64 * 0.01;
    assert!((half - (1.0_f64 - part).sqrt()).abs() < 0.02, "stick zone {half}");
    // Under the reversed load -Q the shear is mirrored: the law prefers no direction.
    let back = Load { p_n_mm, q_n_mm: -load.q_n_mm };
    for k in 1..=20 {
        let f = f64::from(k) / 20.0;
        let q_n_mm = load.q_n_mm * (1.0 - 2.0 * f);
        grip.step(&LoadStep::Upright(Load { p_n_mm, q_n_mm })).expect("held");
    }
    assert!((grip.load().q_n_mm - back.q_n_mm).abs() < 1e-9);
    let q = grip.tangential_n_mm();
    let odd: f64 = q.iter().zip(q.iter().rev()).map(|(a, b)| (a - b).abs()).sum();
    assert!(odd < 0.05 * load.q_n_mm, "{odd}");
}

#[test]
fn a_thousand_steps_of_make_and_break() {
    let mut grip = bar(0.49, 32, FrictionLaw::Coulomb(0.5));
    let mut state: u64 = 11;
    let mut unit = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        f64::from((state >> 33) as u32) / f64::from(1_u32 << 31)
    };
    let mut lost = 0;
    for i in 0..1000 {
        let p_n_mm = if i % 4 == 3 { 0.0 } else { 0.1 + unit() };
        let q_n_mm = 0.35 * p_n_mm * (2.0 * unit() - 1.0);
        match grip.step(&loads(p_n_mm, q_n_mm)) {
            Ok(()) => {
                let load = grip.load();
                assert!((load.p_n_mm - p_n_mm).abs() < 1e-9);
                assert!((load.q_n_mm - q_n_mm).abs() < 1e-9);
                assert!(grip.residual() < 1e-9);
            }
            Err(_) => lost += 1,
        }
    }
    assert!(lost == 0, "{lost} unsettled");
}

/// Random load steps of a tall bar up to sliding, of a low bar that keeps full contact, and of a
/// rough bar that lifts off: all of them converge. A bar that never slips and lifts off may have no
/// solution: a place that sticks would be in tension, and apart it would overlap. Then the error
/// says so.
#[test]
fn a_thousand_load_steps_near_sliding_converge() {
    for (law, nu, part, height_mm) in [
        (FrictionLaw::Coulomb(0.5), 0.49, 0.999, 6.35),
        (FrictionLaw::Coulomb(0.5), 0.3, 0.999, 1.0),
        (FrictionLaw::Coulomb(3.0), 0.49, 0.3, 6.35),
        (FrictionLaw::Coulomb(f64::INFINITY), 0.49, 0.9, 6.35),
    ] {
        let limit = match law {
            FrictionLaw::Coulomb(mu) if mu.is_finite() => mu * part,
            _ => part,
        };
        let mut grip = bar(nu, 32, law);
        let mut state: u64 = 5;
        let mut unit = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            f64::from((state >> 33) as u32) / f64::from(1_u32 << 31)
        };
        let mut lost = Vec::new();
        let mut torn = 0;
        let jumps = if law == FrictionLaw::Coulomb(f64::INFINITY) { 40 } else { 1000 };
        for i in 0..jumps {
            let p_n_mm = if i % 7 == 6 { 0.0 } else { 0.1 + unit() };
            let ratio = limit * (2.0 * unit() - 1.0);
            let load = Load { p_n_mm, q_n_mm: ratio * p_n_mm };
            match grip.step(&LoadStep::Loads { load, height_mm }) {
                Ok(()) => assert!(grip.residual() < 1e-9),
                Err(Refusal::EdgeSeparation) if law == FrictionLaw::Coulomb(f64::INFINITY) => {
                    torn += 1
                }
                Err(refusal) => lost.push((i, refusal, ratio)),
            }
        }
        assert!(torn < 40, "some settle");
        assert!(
            lost.is_empty(),
            "{law:?} {nu}: {} lost, {:?}",
            lost.len(),
            &lost[..lost.len().min(4)]
        );
    }
}

/// With friction higher than that of any rubber a solution need not exist: each load step ends in a
/// state that obeys all conditions or in an error that leaves the last state unchanged.
#[test]
fn friction_far_above_one_converges_or_is_refused() {
    for mu in [10.0, 30.0, 1000.0] {
        let mut grip = bar(0.49, 16, FrictionLaw::Coulomb(mu));
        let mut state: u64 = 9;
        let mut unit = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            f64::from((state >> 33) as u32) / f64::from(1_u32 << 31)
        };
        let (mut settled, mut before) = (0, grip.load());
        for _ in 0..40 {
            let p_n_mm = 0.1 + unit();
            let load = Load { p_n_mm, q_n_mm: 0.9 * p_n_mm * (2.0 * unit() - 1.0) };
            match grip.step(&LoadStep::Loads { load, height_mm: 6.35 }) {
                Ok(()) => {
                    settled += 1;
                    let got = grip.load();
                    assert!(grip.residual() < 1e-9, "{mu}: {}", grip.residual());
                    assert!((got.p_n_mm - load.p_n_mm).abs() < 1e-9, "{mu}: {got:?} {load:?}");
                    assert!((got.q_n_mm - load.q_n_mm).abs() < 1e-9, "{mu}: {got:?} {load:?}");
                }
                Err(Refusal::NotConverged) => assert_eq!(grip.load(), before, "{mu}"),
                Err(other) => panic!("{mu}: {other}"),
            }
            before = grip.load();
        }
        assert!(settled > 20, "{mu}: {settled}");
    }
}

/// A search without a solution ends after a bounded number of linear systems, which is smaller for
/// larger systems.
#[test]
fn a_step_without_a_state_is_refused_within_its_budget() {
    let mut grip = bar(0.49, 192, FrictionLaw::Coulomb(1000.0));
    let mut outcome = Ok(());
    for k in 1..=16 {
        let f = f64::from(k) / 16.0;
        outcome = outcome.and_then(|()| grip.step(&loads(0.7 * f, 0.5 * f)));
        assert!(grip.solves() <= 4000, "{}", grip.solves());
    }
    assert_eq!(outcome, Err(Refusal::NotConverged));
    assert_eq!(grip.solves(), 4000, "all of it was tried");
}

/// If the resultant lies between the middle of the last cell and its edge, no cell can carry the
/// bar, although it does not topple; the error says so.
#[test]
fn a_bar_on_its_last_cell_is_not_said_to_topple() {
    let mut grip = bar(0.49, 32, FrictionLaw::Free);
    assert_eq!(grip.step(&loads(1.0, 0.9999)), Err(Refusal::OnLastNode));
    assert_eq!(grip.step(&loads(1.0, -0.9999)), Err(Refusal::OnLastNode));
    assert_eq!(grip.step(&loads(1.0, 1.0001)), Err(Refusal::Toppling));
    grip.step(&loads(1.0, 0.99)).expect("it stands");
}

#[test]
fn friction_of_zero_and_of_three() {
    let mut slick = bar(0.49, 32, FrictionLaw::Coulomb(0.0));
    slick.step(&loads(1.0, 0.0)).expect("pressed");
    assert!(slick.tangential_n_mm().iter().all(|q| q.abs() < 1e-12));
    assert_eq!(slick.step(&loads(1.0, 0.1)), Err(Refusal::Sliding));
    let mut rough = bar(0.3, 32, FrictionLaw::Coulomb(3.0));
    rough.step(&LoadStep::Upright(Load { p_n_mm: 1.0, q_n_mm: 2.0 })).expect("held");
    assert!((rough.load().q_n_mm - 2.0).abs() < 1e-10);
    assert_eq!(rough.step(&loads(1.0, 1.1)), Err(Refusal::Toppling));
}

#[test]
fn invalid_surfaces_and_friction_laws_are_refused() {
    let layer = layer(0.49);
    for edges in [vec![], vec![0.0, 1.0], vec![0.0, 0.0, 1.0], vec![0.0, f64::NAN, 1.0]] {
        assert!(SurfaceCompliance::of_layer(&layer, &edges).is_err(), "{edges:?}");
    }
    let bed = SurfaceCompliance::of_layer(&layer, &[0.0, 0.5, 1.0]).expect("a bed");
    assert!(FrictionalContact::new(bed.clone(), vec![0.0], FrictionLaw::Free).is_err());
    assert!(FrictionalContact::new(bed.clone(), vec![0.0, -1.0], FrictionLaw::Free).is_err());
    assert!(FrictionalContact::new(bed.clone(), vec![0.0; 2], FrictionLaw::Coulomb(-0.1)).is_err());
    let mut grip = FrictionalContact::new(bed, vec![0.0; 2], FrictionLaw::Free).expect("a grip");
    assert_eq!(grip.step(&loads(f64::NAN, 0.0)), Err(Refusal::NotFinite));
    assert_eq!(grip.step(&loads(-1.0, 0.0)), Err(Refusal::Tension));
}
