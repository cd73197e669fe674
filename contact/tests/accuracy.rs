//! Tests the stated errors of the levels over randomly drawn bars and cylinders: compares fast and
//! default with fine.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::plane::{Contact, Friction, Indenter, Load, Shape, Spectrum};

struct Draws(u64);

impl Draws {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        low + (high - low) * f64::from((self.0 >> 33) as u32) / f64::from(1_u32 << 31)
    }
}

/// Solves the contact and its base stress at some places.
fn solved(
    layer: &Layer,
    shape: Shape,
    friction: Friction,
    level: Accuracy,
    load: &Load,
) -> (Contact, Vec<f64>) {
    let mut body = Indenter::new(layer, shape, friction, level).expect("a sound indenter");
    let contact = body.press(load).expect("a contact");
    let t = layer.thickness_mm;
    let stress = Spectrum::new(layer, &body.point_forces(t), t, 30.0);
    let szz = (-24..=24).map(|i| stress.szz(0.5 * f64::from(i))).collect();
    (contact, szz)
}

#[test]
fn fast_is_half_a_percent_and_default_a_hundred_thousandth() {
    let mut draws = Draws(3);
    let mut worst = [[0.0_f64; 3]; 2];
    for i in 0..60 {
        let layer = Layer::new(draws.between(0.4, 3.0), 27.58, draws.between(0.2, 0.5));
        let layer = layer.expect("a sound layer");
        let friction = if i % 3 == 0 { Friction::None } else { Friction::Proportional };
        let (shape, most) = if i % 4 == 3 {
            (Shape::Cylinder { radius_mm: draws.between(5.0, 30.0) }, 0.6)
        } else {
            let width_mm = draws.between(3.0, 16.0);
            (Shape::Flat { width_mm, height_mm: 6.35 }, 0.45 * width_mm / 6.35)
        };
        let p_n_mm = draws.between(0.1, 2.0);
        let load = Load { p_n_mm, q_n_mm: p_n_mm * draws.between(-most, most) };
        let (fine, exact) = solved(&layer, shape, friction, Accuracy::Fine, &load);
        let peak = exact.iter().fold(0.0_f64, |most, s| most.max(s.abs()));
        let width = fine.x_right_mm - fine.x_left_mm;
        for (k, level) in [Accuracy::Fast, Accuracy::Default].into_iter().enumerate() {
            let (contact, szz) = solved(&layer, shape, friction, level, &load);
            let miss =
                szz.iter().zip(&exact).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs())) / peak;
            let edges = (contact.x_left_mm - fine.x_left_mm)
                .abs()
                .max((contact.x_right_mm - fine.x_right_mm).abs())
                / width;
            let depth = (contact.delta_mm / fine.delta_mm - 1.0).abs();
            for (w, v) in worst[k].iter_mut().zip([miss, edges, depth]) {
                *w = w.max(v);
            }
        }
    }
    println!("{worst:?}");
    assert!(worst[0].iter().all(|miss| *miss < 5e-3), "{worst:?}");
    assert!(worst[1].iter().all(|miss| *miss < 1e-5), "{worst:?}");
}

/// Tests two cases that enlarge errors: an incompressible contact many thicknesses wide descends by
/// a small part of what its pressure causes nearby, and a circle is infinitely steep at its side.
#[test]
fn stated_errors_hold_on_wide_soft_and_steep_contacts() {
    let bar = |width_mm: f64| Shape::Flat { width_mm, height_mm: 1.5 };
    let cases = [
        (0.8, 0.5, bar(25.4), Friction::None, [1.0, 0.4]),
        (0.8, 0.4999, bar(31.7), Friction::None, [0.003, 0.002]),
        (1.75, 0.5, bar(99.0), Friction::Proportional, [0.005, 0.003]),
        (0.2, 0.499_99, bar(14.0), Friction::Proportional, [2.0, -1.0]),
        (3.9, 0.45, Shape::Cylinder { radius_mm: 1.68 }, Friction::None, [66.0, 0.0]),
        (3.9, 0.45, Shape::Cylinder { radius_mm: 1.68 }, Friction::Proportional, [60.0, -40.0]),
        (0.8, 0.5, Shape::Cylinder { radius_mm: 2.0 }, Friction::None, [80.0, 0.0]),
    ];
    for (t, nu, shape, friction, [p_n_mm, q_n_mm]) in cases {
        let layer = Layer::new(t, 27.58, nu).expect("a sound layer");
        let load = Load { p_n_mm, q_n_mm };
        let (fine, _) = solved(&layer, shape, friction, Accuracy::Fine, &load);
        let width = fine.x_right_mm - fine.x_left_mm;
        for (level, bar) in [(Accuracy::Fast, 5e-3), (Accuracy::Default, 1e-5)] {
            let (found, _) = solved(&layer, shape, friction, level, &load);
            let miss = [
                (found.delta_mm - fine.delta_mm) / fine.delta_mm,
                (found.slope - fine.slope) * 0.5 * width / fine.delta_mm,
                (found.x_left_mm - fine.x_left_mm) / width,
                (found.x_right_mm - fine.x_right_mm) / width,
            ];
            assert!(miss.iter().all(|m| m.abs() < bar), "{shape:?} {level:?}: {miss:?}");
        }
    }
}
