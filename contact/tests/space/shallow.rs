//! Tests contacts much shallower than the tables: at a sharp end, where they are wide but only a
//! few micrometres long, and along long pins, where the slices at the ends act on each other more
//! than on themselves.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::pin::{Pin, Profile};

/// Pins of a cylinder at the fast and the default accuracy. `rubber` is thickness (mm) and
/// Poisson's ratio, `size` radius and half the length (mm).
fn cylinder(rubber: (f64, f64), size: (f64, f64), made_mm: f64) -> [Pin; 2] {
    let ((t, nu), (radius_mm, half_mm)) = (rubber, size);
    let layer = Layer::new(t, 27.58, nu).expect("a layer");
    let profile = Profile::Cylinder { radius_mm };
    [Accuracy::Fast, Accuracy::Default]
        .map(|level| Pin::new(&layer, profile, [-half_mm, half_mm], made_mm, level).expect("a pin"))
}

/// A steep pin whose contact is a fiftieth to a two-hundredth of the thickness long is solved by
/// the tables without iterations at the fast accuracy, from no contact or from another one, for a
/// given penetration or force.
#[test]
fn the_smallest_contacts_on_an_end_are_read() {
    for (rubber, size, made_mm, delta_mm, tilt_rad) in [
        ((1.8825, 0.0467), (15.05, 3.6315), 0.4966, -0.680_22, -0.19),
        ((1.8825, 0.0467), (30.26, 4.022), 0.4154, -0.531_34, -0.132_544),
        ((0.7444, 0.036), (31.5, 1.592), 0.1817, -0.230_57, 0.144_975),
        ((1.6452, 0.5), (4.6537, 2.3507), 0.2014, -0.446_1, -0.19),
        ((1.8984, 0.1844), (16.77, 5.597), 0.3106, -0.253_91, -0.045_664),
    ] {
        let [mut fast, mut default] = cylinder(rubber, size, made_mm);
        let exact =
            default.press(Prescribed::PenetrationMm(delta_mm), tilt_rad).expect("a contact");
        assert!(exact.length_mm < rubber.0 / 45.0, "{exact:?}");
        let check = |fast: &mut Pin, drive| {
            let state = fast.press(drive, tilt_rad).expect("a contact");
            assert_eq!(state.steps, 1, "{rubber:?} {size:?} {drive:?}: {state:?}");
            let off = (state.force_n / exact.force_n - 1.0).abs();
            let deep = exact.penetration_mm + size.1 * libm::tan(tilt_rad.abs());
            let moved = (state.penetration_mm - exact.penetration_mm).abs();
            assert!(off < 1e-2 && moved < 1e-2 * deep, "{state:?} {exact:?}");
        };
        for drive in [Prescribed::PenetrationMm(delta_mm), Prescribed::ForceN(exact.force_n)] {
            fast.release();
            check(&mut fast, drive);
            fast.press(Prescribed::ForceN(5.0), 0.01).expect("another contact");
            check(&mut fast, drive);
        }
    }
}

/// A long pin is pressed by a thousandth of the thickness. The pressures of slices near its ends
/// would oscillate, so a change is damped once it reverses its sign.
#[test]
fn long_pins_at_the_lightest_touch_converge() {
    for (rubber, size, made_mm, delta_mm, slope) in [
        ((0.7507, 0.5), (4.638, 13.036), 0.0797, 4.098e-4, 1.659e-5),
        ((0.6703, 0.21), (36.77, 14.963), 0.1824, 3.4e-4, 9.53e-6),
        ((0.6703, 0.21), (3.2377, 18.5278), 0.0869, 2.493e-4, 5.043e-5),
        ((1.293, 0.3), (11.055, 17.2957), 0.3178, 4.496e-4, 1.333e-5),
        ((0.7981, 0.1715), (15.644, 12.5136), 0.0903, 1.0578e-3, 1.884e-5),
    ] {
        let [mut fast, mut default] = cylinder(rubber, size, made_mm);
        let quick = fast.press(Prescribed::PenetrationMm(delta_mm), slope).expect("a contact");
        let exact = default.press(Prescribed::PenetrationMm(delta_mm), slope).expect("a contact");
        assert!(exact.residual < 1e-2, "{exact:?}");
        assert!((quick.force_n / exact.force_n - 1.0).abs() < 3e-3, "{quick:?} {exact:?}");
        default.release();
        let loaded = default.press(Prescribed::ForceN(exact.force_n), slope).expect("a contact");
        let moved = (loaded.penetration_mm - delta_mm).abs();
        assert!(moved < 3e-3 * delta_mm, "{loaded:?} {exact:?}");
    }
}
