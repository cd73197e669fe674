//! Compares the tables of bars with the solver that they were made with, at loads between their
//! rows, and tests their errors.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::plane::contact_table::ContactTable;
use taktil_contact::plane::features::moments;
use taktil_contact::plane::{Friction, Indenter, Load, Mode, Refusal, Shape, Spectrum};

const PLACES_MM: [f64; 9] = [-9.0, -6.0, -3.0, -1.0, 0.3, 1.0, 2.7, 5.9, 8.0];

#[test]
fn charts_agree_with_the_solver() {
    for (t, nu, width_mm, height_mm, friction) in [
        (0.8, 0.49, 12.7, 6.35, Friction::None),
        (0.8, 0.49, 12.7, 6.35, Friction::Proportional),
        (2.0, 0.3, 5.0, 3.0, Friction::None),
        (0.5, 0.5, 8.0, 10.0, Friction::Proportional),
    ] {
        let layer = Layer::new(t, 27.58, nu).unwrap();
        let shape = Shape::Flat { width_mm, height_mm };
        let mut solver = Indenter::new(&layer, shape, friction, Accuracy::Fine).unwrap();
        let mut chart =
            ContactTable::new(&layer, width_mm, height_mm, friction, &PLACES_MM).unwrap();
        let mut modes = [0, 0, 0];
        for i in 0..60 {
            // Places of the resultant on both sides, out to nearly the corner.
            let s = 0.965 * libm::sin(0.377 * f64::from(i) + 0.1);
            let p_n_mm = 0.2 + 0.03 * f64::from(i);
            let load = Load { p_n_mm, q_n_mm: p_n_mm * s * 0.5 * width_mm / height_mm };
            let (got, wanted) = (chart.press(&load).unwrap(), solver.press(&load).unwrap());
            assert_eq!(got.mode, wanted.mode, "{i}");
            modes[match got.mode {
                Mode::Full => 0,
                Mode::LeftLifted => 1,
                _ => 2,
            }] += 1;
            let near = |a: f64, b: f64, size: f64| {
                assert!((a - b).abs() < 1e-5 * size, "{t} {nu} {i}: {got:?} {wanted:?}");
            };
            near(got.delta_mm, wanted.delta_mm, wanted.delta_mm.abs());
            near(got.slope, wanted.slope, wanted.slope.abs() + 1e-3 * p_n_mm / layer.youngs_mpa);
            near(got.x_left_mm, wanted.x_left_mm, wanted.x_right_mm - wanted.x_left_mm);
            near(got.x_right_mm, wanted.x_right_mm, wanted.x_right_mm - wanted.x_left_mm);
            let forces = solver.point_forces(t);
            let (m, wanted_m) = (chart.moments(), moments(&layer, &forces, t));
            let area = width_mm * width_mm;
            for (k, size) in [1.0, width_mm, area, area * width_mm].iter().enumerate() {
                near(m.m[k], wanted_m.m[k], p_n_mm * size);
            }
            let stress = Spectrum::new(&layer, &forces, t, 10.0);
            let exact = PLACES_MM.map(|x| stress.szz(x));
            let peak = (-40..=40).map(|i| -stress.szz(0.2 * f64::from(i))).fold(0.0, f64::max);
            let mut szz = [0.0; 9];
            chart.base_szz_mpa(&mut szz);
            for (a, b) in szz.iter().zip(&exact) {
                near(*a, *b, 2.0 * peak);
            }
        }
        assert!(modes.iter().all(|count| *count > 5), "{modes:?}");
    }
}

#[test]
fn charts_refuse_contacts_beyond_their_range() {
    let layer = Layer::new(0.8, 27.58, 0.49).unwrap();
    let mut chart = ContactTable::new(&layer, 12.7, 6.35, Friction::None, &[]).unwrap();
    let mut press = |p_n_mm, q_n_mm| chart.press(&Load { p_n_mm, q_n_mm });
    assert_eq!(press(0.0, 0.0).unwrap().mode, Mode::Open);
    assert_eq!(press(f64::NAN, 0.0), Err(Refusal::NotFinite));
    assert_eq!(press(1.0, f64::INFINITY), Err(Refusal::NotFinite));
    assert_eq!(press(-1.0, 0.0), Err(Refusal::Tension));
    assert_eq!(press(0.0, 0.1), Err(Refusal::Tension));
    assert_eq!(press(1.0, 1.0), Err(Refusal::Toppling));
    assert_eq!(press(1.0, -1.5), Err(Refusal::Toppling));
    assert_eq!(press(1.0, 0.999), Err(Refusal::OutsideTable));
    assert!(press(1.0, 0.97).is_ok());
    let new = |[width_mm, height_mm]: [f64; 2], x: &[f64]| {
        ContactTable::new(&layer, width_mm, height_mm, Friction::None, x).expect_err("").place
    };
    assert_eq!(new([0.0, 1.0], &[]), "width_mm");
    assert_eq!(new([1.0, 0.0], &[]), "height_mm");
    assert_eq!(new([1.0, f64::NAN], &[]), "height_mm");
    assert_eq!(new([1.0, 1.0], &[f64::NAN]), "x_mm");
    assert_eq!(new([1e9, 1.0], &[]), "width_mm");
}
