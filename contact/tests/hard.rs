//! Tests hard cases of plane contact, each with a known result.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::plane::features::moments;
use taktil_contact::plane::{Friction, Indenter, Load, Mode, Refusal, Shape};

const E_MPA: f64 = 27.58;

fn indenter(t: f64, nu: f64, shape: Shape, friction: Friction) -> Indenter {
    let layer = Layer::new(t, E_MPA, nu).expect("a sound layer");
    Indenter::new(&layer, shape, friction, Accuracy::Fine).expect("a sound indenter")
}

fn load(p_n_mm: f64, q_n_mm: f64) -> Load {
    Load { p_n_mm, q_n_mm }
}

const BAR: Shape = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
const ROLL: Shape = Shape::Cylinder { radius_mm: 25.4 };

#[test]
fn nearly_and_wholly_incompressible() {
    for shape in [BAR, ROLL] {
        let solve = |nu: f64| {
            let mut body = indenter(0.8, nu, shape, Friction::Proportional);
            body.press(&load(1.5, 0.1)).expect("a contact")
        };
        let (a, b, c) = (solve(0.4999), solve(0.499_999), solve(0.5));
        // Linear in 0.5 - nu: a hundredth of the way from the first to the last.
        for of in [
            |c: &taktil_contact::plane::Contact| c.delta_mm,
            |c: &taktil_contact::plane::Contact| c.slope,
            |c: &taktil_contact::plane::Contact| c.x_right_mm,
        ] {
            let (far, near) = (of(&a) - of(&c), of(&b) - of(&c));
            assert!((near - 0.01 * far).abs() <= 1e-3 * far.abs() + 1e-12, "{far:e} {near:e}");
        }
    }
}

#[test]
fn a_layer_a_hundred_times_thinner_than_the_contact() {
    // Far from the edges the layer is a bed of independent springs: p = E (1 - nu)/((1 + nu)(1 - 2
    // nu)) delta/t.
    let (nu, t) = (0.3, 0.127);
    let mut bar = indenter(t, nu, BAR, Friction::None);
    let contact = bar.press(&load(1.0, 0.0)).expect("a contact");
    let modulus = E_MPA * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu));
    let spring = modulus * contact.delta_mm / t;
    let miss = bar.pressure_mpa(0.0) / spring - 1.0;
    assert!(miss.abs() < 1e-8, "{miss:e}");
    // An incompressible layer is squeezed out sideways, so the pressure is a parabola to the order
    // of t/W.
    let mut wet = indenter(t, 0.5, BAR, Friction::None);
    wet.press(&load(1.0, 0.0)).expect("a contact");
    let parabola = |x: f64| 1.5 / 12.7 * (1.0 - (x / 6.35) * (x / 6.35));
    for x in [0.0, 2.0, -4.0] {
        assert!((wet.pressure_mpa(x) / parabola(x) - 1.0).abs() < 0.06, "{x}");
    }
    let mut roll = indenter(0.05, 0.49, ROLL, Friction::None);
    let rolled = roll.press(&load(200.0, 0.0)).expect("a contact");
    assert!(rolled.x_right_mm > 20.0 * 0.05 && rolled.residual < 1e-9, "{rolled:?}");
}

#[test]
fn a_layer_a_hundred_times_thicker_than_the_contact_is_a_half_plane() {
    let mut roll = indenter(100.0, 0.49, Shape::Parabola { radius_mm: 10.0 }, Friction::None);
    let contact = roll.press(&load(0.5, 0.0)).expect("a contact");
    let hertz = (4.0 * 0.5 * 10.0 * (1.0 - 0.49 * 0.49) / (core::f64::consts::PI * E_MPA)).sqrt();
    assert!((contact.x_right_mm / hertz - 1.0).abs() < 1e-4, "{contact:?} {hertz}");
}

#[test]
fn tilt_to_a_line_of_contact() {
    for friction in [Friction::None, Friction::Proportional] {
        let mut bar = indenter(0.8, 0.49, BAR, friction);
        let mut width = 12.7;
        for k in 1..10 {
            let short = libm::exp(-2.0 * f64::from(k));
            let contact = bar.press(&load(1.0, 1.0 - short)).expect("a contact");
            assert_eq!(contact.mode, Mode::LeftLifted);
            let now = contact.x_right_mm - contact.x_left_mm;
            assert!(now < width && now > 0.0 && contact.residual < 1e-7, "{contact:?}");
            width = now;
        }
        // The corner's own law: 4 times the resultant's distance from it.
        assert!((width / (4.0 * 6.35 * libm::exp(-18.0)) - 1.0).abs() < 0.03, "{width}");
        assert_eq!(bar.press(&load(1.0, 1.0)), Err(Refusal::Toppling));
        assert_eq!(bar.press(&load(1.0, -1.0)), Err(Refusal::Toppling));
        assert_eq!(bar.contact().mode, Mode::Open);
        assert_eq!(bar.press(&load(1.0, 0.0)).expect("a contact").mode, Mode::Full);
    }
}

#[test]
fn no_load_full_unloading_and_what_pulls() {
    for shape in [BAR, ROLL] {
        for friction in [Friction::None, Friction::Proportional] {
            let mut body = indenter(0.8, 0.49, shape, friction);
            let open = body.press(&load(0.0, 0.0)).expect("nothing");
            assert_eq!((open.mode, open.delta_mm), (Mode::Open, 0.0));
            let first = body.press(&load(1.0, 0.05)).expect("a contact");
            assert_eq!(body.press(&load(0.0, 0.0)).expect("nothing").mode, Mode::Open);
            assert_eq!(body.pressure_mpa(0.0), 0.0);
            assert!(body.point_forces(0.8).is_empty());
            assert_eq!(body.press(&load(0.0, 0.1)), Err(Refusal::Tension));
            assert_eq!(body.press(&load(-1.0, 0.0)), Err(Refusal::Tension));
            for bad in [f64::NAN, f64::INFINITY] {
                assert_eq!(body.press(&load(bad, 0.0)), Err(Refusal::NotFinite));
                assert_eq!(body.press(&load(1.0, bad)), Err(Refusal::NotFinite));
                assert_eq!(body.descend(bad), Err(Refusal::NotFinite));
            }
            assert_eq!(body.descend(-0.1).expect("nothing").mode, Mode::Open);
            let again = body.press(&load(1.0, 0.05)).expect("a contact");
            assert!((again.delta_mm - first.delta_mm).abs() < 1e-12);
            assert!((again.x_left_mm - first.x_left_mm).abs() < 1e-9);
        }
    }
}

#[test]
fn reversing_the_load_mirrors_the_contact() {
    let mut bar = indenter(0.8, 0.45, BAR, Friction::Proportional);
    for q in [0.05, 0.2, 0.6, 0.2, -0.2, -0.6, 0.0] {
        let one = bar.press(&load(1.0, q)).expect("a contact");
        let other = bar.press(&load(1.0, -q)).expect("a contact");
        assert!((one.x_left_mm + other.x_right_mm).abs() < 1e-9, "{q}");
        assert!((one.slope + other.slope).abs() < 1e-12, "{q}");
    }
}

#[test]
fn friction_from_none_to_three() {
    let low = Shape::Flat { width_mm: 12.7, height_mm: 0.5 };
    for nu in [0.3, 0.49, 0.5] {
        for ratio in [0.0, 0.5, 3.0] {
            for shape in [low, ROLL] {
                let mut body = indenter(0.8, nu, shape, Friction::Proportional);
                let contact = body.press(&load(1.0, ratio)).expect("a contact");
                assert!(contact.residual < 1e-9, "{contact:?}");
                let layer = *body.layer();
                let m = moments(&layer, &body.point_forces(0.8), 0.8).m;
                assert!((m[0] + 1.0).abs() < 1e-10);
                if shape == low {
                    assert!((m[1] + (0.5 + 0.8) * ratio).abs() < 1e-10, "M1 {}", m[1]);
                }
                let inside = 0.5 * (contact.x_left_mm + contact.x_right_mm);
                assert!(body.pressure_mpa(inside) > 0.0);
            }
        }
    }
}

#[test]
fn a_thousand_contacts_made_and_broken_keep_the_result() {
    let mut state: u64 = 7;
    let mut unit = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        f64::from((state >> 33) as u32) / f64::from(1_u32 << 31)
    };
    for (shape, friction) in
        [(BAR, Friction::None), (BAR, Friction::Proportional), (ROLL, Friction::None)]
    {
        let layer = Layer::new(0.8, E_MPA, 0.49).expect("a sound layer");
        let mut warm = Indenter::new(&layer, shape, friction, Accuracy::Default).expect("sound");
        let mut cold = warm.clone();
        for i in 0..1000 {
            let p = if i % 3 == 2 { 0.0 } else { 0.01 + 3.0 * unit() };
            let q = 0.95 * p * (2.0 * unit() - 1.0);
            let found = warm.press(&load(p, q)).expect("an answer");
            if i % 25 == 0 {
                cold.forget();
                let expected = cold.press(&load(p, q)).expect("an answer");
                assert_eq!(found.mode, expected.mode);
                assert!((found.x_left_mm - expected.x_left_mm).abs() < 1e-5, "{found:?}");
                assert!((found.delta_mm - expected.delta_mm).abs() < 1e-8, "{found:?}");
            }
        }
    }
}

#[test]
fn contacts_without_bounds_are_refused() {
    let mut roll = indenter(0.8, 0.49, Shape::Cylinder { radius_mm: 1.0 }, Friction::None);
    assert_eq!(roll.press(&load(1e9, 0.0)), Err(Refusal::TooWide));
    assert_eq!(roll.descend(5.0), Err(Refusal::TooWide));
    assert!(roll.press(&load(1.0, 0.0)).is_ok());
    let layer = Layer::new(1e-3, E_MPA, 0.49).expect("a sound layer");
    let refused = Indenter::new(&layer, BAR, Friction::None, Accuracy::Fine).expect_err("too wide");
    assert_eq!(refused.place, "width_mm");
    for (width_mm, height_mm) in [(0.0, 1.0), (f64::NAN, 1.0), (1.0, -1.0), (1.0, f64::INFINITY)] {
        let shape = Shape::Flat { width_mm, height_mm };
        assert!(shape.check().is_err());
    }
    assert!(Shape::Parabola { radius_mm: f64::NAN }.check().is_err());
}
