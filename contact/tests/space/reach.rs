//! Tests the range of contacts that tables cover: from the deepest penetration down to no contact.

use crate::draws::Draws;
use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::pin::{Pin, Profile};
use taktil_contact::space::sphere::Sphere;

/// Tables made for a penetration contain every smaller one, also where the free boundary raises the
/// penetrations of the slices near an end.
#[test]
fn every_penetration_within_the_tables_is_reached() {
    let mut draws = Draws(2718);
    for n in 0..30 {
        let layer = draws.rubber();
        let t = layer.thickness_mm;
        let (radius_mm, length_mm) = (draws.between(2.0, 45.0), t * draws.between(0.5, 30.0));
        let most_mm = (0.1 * t).min(0.1 * radius_mm);
        let tilt_rad = if n % 3 == 0 { 0.0 } else { draws.between(0.0, 0.5 * most_mm / length_mm) };
        let (half, profile) = (0.5 * length_mm, Profile::Cylinder { radius_mm });
        for level in [Accuracy::Fast, Accuracy::Default, Accuracy::Fine] {
            if level == Accuracy::Fine && n % 5 > 0 {
                continue;
            }
            let mut pin = Pin::new(&layer, profile, [-half, half], most_mm, level).expect("a pin");
            for part in [0.5, 0.85, 0.95, 0.999] {
                let deep = part * most_mm - half * libm::tan(tilt_rad);
                let outcome = pin.press(Prescribed::PenetrationMm(deep), tilt_rad);
                if let Err(refused) = outcome {
                    panic!("{level:?} {layer:?} {radius_mm} {length_mm} {tilt_rad}: {refused:?}");
                }
            }
        }
    }
}

/// In the lightest contacts the force per penetration falls only as a logarithm, equally at all
/// accuracies, and a force gives its penetration again. Still lighter contacts count as none.
#[test]
fn the_lightest_contacts_follow_the_logarithmic_law() {
    let layer = crate::layer(0.8, 0.49);
    let profile = Profile::Cylinder { radius_mm: 23.0 };
    let [mut fast, mut default, mut fine] = [Accuracy::Fast, Accuracy::Default, Accuracy::Fine]
        .map(|level| Pin::new(&layer, profile, [-10.0, 10.0], 0.05, level).expect("a pin"));
    let mut before: Option<f64> = None;
    for exponent in 3..=8 {
        let deep = Prescribed::PenetrationMm(libm::pow(10.0, -f64::from(exponent)));
        let pressed = |pin: &mut Pin| {
            pin.release();
            let state = pin.press(deep, 0.0).expect("a contact");
            state.force_n / state.penetration_mm
        };
        let exact = pressed(&mut fine);
        // The inverse grows by a nearly constant step per decade, as under a line load on a half
        // plane.
        if let Some(before) = before {
            let rate = 1.0 / exact - 1.0 / before;
            assert!((1.0e-3..1.4e-3).contains(&rate), "{exponent}: {exact} {before} {rate:e}");
        }
        before = Some(exact).filter(|_| exponent > 4);
        let off = [pressed(&mut fast) / exact - 1.0, pressed(&mut default) / exact - 1.0];
        assert!(off[0].abs() < 1e-2 && off[1].abs() < 1e-3, "{exponent}: {off:?}");
    }
    for force in [1e-3, 1e-4, 1e-5, 3e-6] {
        for (pin, bar) in [(&mut fast, 1e-2), (&mut default, 1e-3), (&mut fine, 1e-4)] {
            pin.release();
            let loaded = pin.press(Prescribed::ForceN(force), 0.0).expect("a contact");
            pin.release();
            let deep = Prescribed::PenetrationMm(loaded.penetration_mm);
            let again = pin.press(deep, 0.0).expect("the same contact");
            assert!((again.force_n / force - 1.0).abs() < bar, "{loaded:?} {again:?}");
        }
    }
    for pin in [&mut fast, &mut default, &mut fine] {
        for drive in [Prescribed::PenetrationMm(1e-9), Prescribed::ForceN(1e-9)] {
            assert_eq!(pin.press(drive, 0.0).expect("no contact").force_n, 0.0);
        }
    }
}

/// Spheres with a contact radius of 3 to 100 thicknesses, where the search from no contact starts
/// with fewer points: a force gives its penetration again, from no contact or from another one.
#[test]
fn wide_spheres_are_found_by_force_and_by_depth() {
    for nu in [0.0, 0.3, 0.49, 0.4999, 0.5] {
        for (wide, depth) in [(3.0, 0.1), (8.0, 0.2), (20.0, 0.2), (40.0, 0.2), (60.0, 0.15)] {
            let layer = Layer::new(1.0, 1.0, nu).expect("a layer");
            let radius_mm = 0.5 * wide * wide / depth;
            let mut sphere = Sphere::new(&layer, radius_mm, Accuracy::Default).expect("a sphere");
            let mut pressed = |drive, cold: bool| {
                if cold {
                    sphere.release();
                }
                sphere.press(drive).unwrap_or_else(|no| panic!("{nu} {wide} {drive:?}: {no:?}"))
            };
            let deep = pressed(Prescribed::PenetrationMm(depth), true);
            for cold in [false, true] {
                let loaded = pressed(Prescribed::ForceN(deep.force_n), cold);
                let off = loaded.penetration_mm / depth - 1.0;
                assert!(
                    off.abs() < 1e-8 && loaded.residual < 1e-5,
                    "{nu} {wide} {cold} {loaded:?}"
                );
                pressed(Prescribed::PenetrationMm(0.5 * depth), false);
                let again = pressed(Prescribed::PenetrationMm(depth), cold);
                assert!((again.force_n / deep.force_n - 1.0).abs() < 1e-8, "{again:?} {deep:?}");
            }
        }
    }
    // The largest contact radius is 120 thicknesses; a larger one is an error.
    let layer = Layer::new(1.0, 1.0, 0.5).expect("a layer");
    let mut sphere = Sphere::new(&layer, 25_000.0, Accuracy::Default).expect("a sphere");
    assert!(sphere.press(Prescribed::PenetrationMm(0.1)).expect("fits").contact_radius_mm > 80.0);
    for drive in [Prescribed::PenetrationMm(0.5), Prescribed::ForceN(1e9)] {
        let refused = sphere.press(drive).expect_err("too wide");
        assert_eq!(refused.why, taktil_contact::space::Why::Unreachable, "{refused:?}");
    }
}
