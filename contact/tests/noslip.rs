//! Compares cylinders pressed on without slip with exact reference data.

mod contact_data;

use contact_data::rows;
use taktil_contact::layer::Layer;
use taktil_contact::plane::features::moments;
use taktil_contact::plane::noslip::{NoSlip, NoSlipError};
use taktil_contact::plane::rates::Motion;
use taktil_contact::plane::{Refusal, Shape, Spectrum};

const E_MPA: f64 = 27.58;

fn near(found: f64, expected: f64, relative: f64, what: &str) {
    let bar = relative * expected.abs();
    assert!((found - expected).abs() <= bar, "{what}: {found} not {expected}, bar {bar:e}");
}

fn no_slip_contact(row: &[f64]) -> (Layer, NoSlip) {
    let layer = Layer::new(row[1], E_MPA, row[0]).expect("a sound layer");
    let shape = Shape::Cylinder { radius_mm: row[2] };
    (layer, NoSlip::widen(&layer, shape, row[3]).expect("a contact"))
}

#[test]
fn loads_stiffnesses_and_moments_are_those_of_the_reference() {
    let text = include_str!("fixtures/contact/cylinder_stick_relation.csv");
    for row in &rows(text) {
        let (layer, held) = no_slip_contact(row);
        let bar = 1e-4;
        near(held.p_n_mm, row[4], bar, "P");
        near(held.delta_mm, row[5], bar, "delta");
        near(held.tangential_n_mm2, row[7], bar, "kx");
        near(held.first_moment_n_mm, row[8], bar, "dM1/dx");
        let forces = held.point_forces(0.0);
        let stress = Spectrum::new(&layer, &forces, row[1], 10.0);
        near(stress.szz(0.0), row[6], bar, "szz");
        let m = moments(&layer, &forces, row[1]).m;
        near(m[0], -held.p_n_mm, 1e-6, "M0");
        near(m[2], row[9], bar, "M2");
        // A small move along x does not change the load.
        let moved = moments(&layer, &held.point_forces(1e-3), row[1]).m;
        assert!((moved[0] - m[0]).abs() < 1e-9 * m[0].abs());
        near(moved[1] - m[1], 1e-3 * row[8], bar, "M1");
    }
}

#[test]
fn base_stresses_are_those_of_the_reference() {
    let text = include_str!("fixtures/contact/cylinder_stick_profiles.csv");
    for group in rows(text).chunk_by(|a, b| a[..4] == b[..4]) {
        let (layer, held) = no_slip_contact(&group[0]);
        let t = group[0][1];
        let still = Spectrum::new(&layer, &held.point_forces(0.0), t, 20.0);
        let moved = Spectrum::new(&layer, &held.point_forces(1.0), t, 20.0);
        let peak = group.iter().map(|row| row[6].abs()).fold(0.0, f64::max);
        let steepest = group.iter().map(|row| row[7].abs()).fold(0.0, f64::max);
        for row in group {
            let szz = still.szz(row[5]);
            assert!((szz - row[6]).abs() < 1e-4 * peak, "{row:?} {szz}");
            let change = moved.szz(row[5]) - szz;
            assert!((change - row[7]).abs() < 1e-4 * steepest, "{row:?} {change}");
        }
    }
}

#[test]
fn load_and_descent_lead_to_the_same_contact() {
    let layer = Layer::new(0.8, E_MPA, 0.49).expect("a sound layer");
    let shape = Shape::Cylinder { radius_mm: 25.4 };
    let wide = NoSlip::widen(&layer, shape, 1.5).expect("a contact");
    near(wide.p_n_mm, 11.123, 1e-4, "the reference's table");
    let pressed = NoSlip::press(&layer, shape, wide.p_n_mm).expect("a contact");
    let descended = NoSlip::descend(&layer, shape, wide.delta_mm).expect("a contact");
    near(pressed.half_width_mm, 1.5, 3e-6, "b of P");
    near(descended.half_width_mm, 1.5, 3e-6, "b of delta");
}

/// A glued contact may be a little wider than a frictionless one: from thin layers to thick ones.
#[test]
fn load_descent_and_width_determine_the_same_contact() {
    for nu in [-0.5, 0.3, 0.49, 0.5] {
        for t in [0.1, 3.2, 100.0] {
            for (radius_mm, parts) in [(10.0, [0.01, 0.6]), (25.4, [0.1, 0.4])] {
                let layer = Layer::new(t, E_MPA, nu).expect("a sound layer");
                let shape = Shape::Cylinder { radius_mm };
                for part in parts {
                    let b = (part * radius_mm).min(5.0 * t);
                    let what = format!("nu {nu} t {t} R {radius_mm} b {b}");
                    let wide = NoSlip::widen(&layer, shape, b).expect(&what);
                    let pressed = NoSlip::press(&layer, shape, wide.p_n_mm).expect(&what);
                    near(pressed.half_width_mm, b, 1e-4, &format!("{what}: b of P"));
                    near(pressed.delta_mm, wide.delta_mm, 2e-4, &format!("{what}: delta of P"));
                    let down = NoSlip::descend(&layer, shape, wide.delta_mm).expect(&what);
                    near(down.half_width_mm, b, 1e-4, &format!("{what}: b of delta"));
                    near(down.p_n_mm, wide.p_n_mm, 1e-4, &format!("{what}: P of delta"));
                }
            }
        }
    }
}

/// A wide contact on a nearly incompressible layer stiffens with the cube of its width. Prescribed
/// by its descent it is computed over another range of widths than prescribed by its width, and
/// both agree.
#[test]
fn wide_contacts_agree_by_descent_and_by_width() {
    let shape = Shape::Cylinder { radius_mm: 25.4 };
    for (nu, thicknesses) in [(0.4999, 8.0), (0.4999, 12.0), (0.5, 20.0)] {
        let layer = Layer::new(0.1, E_MPA, nu).expect("a sound layer");
        let wide = NoSlip::widen(&layer, shape, 0.1 * thicknesses).expect("a contact");
        let down = NoSlip::descend(&layer, shape, wide.delta_mm).expect("a contact");
        near(down.half_width_mm, 0.1 * thicknesses, 2e-5, "b of delta");
        near(down.p_n_mm, wide.p_n_mm, 2e-5, "P of delta");
    }
}

/// Under these loads the glued contact is at least as wide as the frictionless one.
#[test]
fn contacts_wider_than_without_friction_are_found() {
    for (nu, radius_mm, t, p) in [
        (0.49, 25.4, 3.2, 0.7),
        (0.49, 25.4, 12.8, 0.7),
        (0.49, 10.0, 3.0, 0.5),
        (0.5, 10.0, 100.0, 0.5),
    ] {
        let layer = Layer::new(t, E_MPA, nu).expect("a sound layer");
        let shape = Shape::Cylinder { radius_mm };
        let pressed = NoSlip::press(&layer, shape, p).expect("a contact");
        near(pressed.p_n_mm, p, 1e-9, "P");
        let wide = NoSlip::widen(&layer, shape, pressed.half_width_mm).expect("a contact");
        near(wide.p_n_mm, p, 1e-6, "P of b");
    }
}

/// A move along x at fixed contact causes tension at one edge, which grows faster than the move and
/// is the same in both directions. The rate with the descent equals the difference to a deeper
/// contact that was moved by the same distance.
#[test]
fn the_force_on_a_moved_cylinder_has_the_right_derivative() {
    let layer = Layer::new(0.8, E_MPA, 0.49).expect("a sound layer");
    let shape = Shape::Cylinder { radius_mm: 22.9 };
    let held = NoSlip::descend(&layer, shape, 0.005).expect("a contact");
    assert_eq!(held.pull_n_mm(0.0), 0.0);
    let pulls = [1e-4, 1e-3, 1e-2].map(|dx| held.pull_n_mm(dx));
    assert!(pulls[0] > 0.0 && pulls[0] < 1e-4 * held.p_n_mm, "{pulls:?}");
    assert!(pulls.windows(2).all(|w| w[1] > 12.0 * w[0]), "{pulls:?}");
    near(held.pull_n_mm(-1e-2), pulls[2], 1e-9, "the other way");
    let of = |dz: f64| {
        let held = NoSlip::descend(&layer, shape, dz).expect("a contact");
        moments(&layer, &held.point_forces(0.02), 0.8).m
    };
    let step = 1e-6;
    let (more, less) = (of(0.005 + step), of(0.005 - step));
    let rate = held.rate_moved(shape, Motion::Z, 0.02, 2);
    let found = moments(&layer, &rate.forces, 0.8).m;
    for k in 0..4 {
        near(found[k], (more[k] - less[k]) / (2.0 * step), 3e-6, "rate");
    }
    near(found[1], -37.771_68, 1e-5, "dM1/dz");
}

#[test]
fn rows_of_the_reference_are_found_by_load_and_by_descent() {
    let text = include_str!("fixtures/contact/cylinder_stick_relation.csv");
    for row in rows(text) {
        let layer = Layer::new(row[1], E_MPA, row[0]).expect("a sound layer");
        let shape = Shape::Cylinder { radius_mm: row[2] };
        let pressed = NoSlip::press(&layer, shape, row[4]).expect("a contact");
        near(pressed.half_width_mm, row[3], 1e-4, "b of P");
        near(pressed.delta_mm, row[5], 1e-4, "delta of P");
        near(pressed.tangential_n_mm2, row[7], 1e-4, "kx of P");
        let down = NoSlip::descend(&layer, shape, row[5]).expect("a contact");
        near(down.half_width_mm, row[3], 1e-4, "b of delta");
        near(down.p_n_mm, row[4], 1e-4, "P of delta");
        near(down.first_moment_n_mm, row[8], 1e-4, "dM1/dx of delta");
    }
}

#[test]
fn contacts_that_cannot_grow_are_refused() {
    let layer = Layer::new(0.8, E_MPA, 0.49).expect("a sound layer");
    let bar = Shape::Flat { width_mm: 3.0, height_mm: 0.0 };
    assert_eq!(NoSlip::widen(&layer, bar, 1.0).expect_err("a bar"), NoSlipError::Flat);
    let shape = Shape::Cylinder { radius_mm: 1.0 };
    for (p, why) in
        [(0.0, Refusal::Tension), (-1.0, Refusal::Tension), (f64::NAN, Refusal::NotFinite)]
    {
        let refused = NoSlip::press(&layer, shape, p).expect_err("no load");
        assert_eq!(refused, NoSlipError::Refusal(why));
    }
    let refused = NoSlip::press(&layer, shape, 1e6).expect_err("too much");
    assert_eq!(refused, NoSlipError::Refusal(Refusal::TooWide));
    assert!(NoSlip::widen(&layer, shape, f64::NAN).is_err());
}

/// For rubber with Poisson's ratio 0, whose tractions oscillate most at the edges, compares the
/// stress just outside a wide contact, and the stiffness, with a Gauss-Jacobi rule that has the
/// exact exponents.
#[test]
fn a_wide_contact_on_compressible_rubber_is_moved_along() {
    let layer = Layer::new(0.8, E_MPA, 0.0).expect("a sound layer");
    let shape = Shape::Cylinder { radius_mm: 10.0 };
    let held = NoSlip::descend(&layer, shape, 0.160_031_854_305_992_98).expect("a contact");
    near(held.tangential_n_mm2, 70.130_11, 1e-5, "kx");
    let [still, moved] = [0.0, 1.0].map(|dx| {
        let forces = held.point_forces(dx);
        Spectrum::new(&layer, &forces, 0.8, 10.0)
    });
    let rate = |x: f64| moved.szz(x) - still.szz(x);
    let steepest = (0..200).map(|i| rate(0.02 * f64::from(i)).abs()).fold(0.0, f64::max);
    let off = (rate(1.5875) + 6.327_61).abs();
    assert!(off < 1e-4 * steepest, "{off:e} of {steepest}");
    println!("{off:e} of {steepest}, kx {}", held.tangential_n_mm2);
}
