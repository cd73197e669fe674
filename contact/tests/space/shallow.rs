//! Tests contacts much shallower than the tables: at a sharp end, where they are wide but only a
//! few micrometres long, and along long pins, where the slices at the ends act on each other more
//! than on themselves.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::pin::{Pin, Profile};

/// A cylinder's radius and half its length.
#[derive(Clone, Copy, Debug)]
struct Size {
    radius_mm: f64,
    half_mm: f64,
}

/// A pin at the fast and at the default level on a layer of a thickness and Poisson's ratio, made
/// for penetrations up to `made_mm`.
fn cylinder(thickness_mm: f64, nu: f64, size: Size, made_mm: f64) -> [Pin; 2] {
    let Size { radius_mm, half_mm } = size;
    let layer = Layer::new(thickness_mm, 27.58, nu).expect("a layer");
    let profile = Profile::Cylinder { radius_mm };
    [Accuracy::Fast, Accuracy::Default]
        .map(|level| Pin::new(&layer, profile, [-half_mm, half_mm], made_mm, level).expect("a pin"))
}

/// A steep pin whose contact is a fiftieth to a two-hundredth of the thickness long is solved by
/// the tables without iterations at the fast accuracy, from no contact or from another one, for a
/// given penetration or force.
#[test]
fn the_smallest_contacts_on_an_end_are_read() {
    for (thickness_mm, nu, [radius_mm, half_mm], made_mm, delta_mm, tilt_rad) in [
        (1.8825, 0.0467, [15.05, 3.6315], 0.4966, -0.680_22, -0.19),
        (1.8825, 0.0467, [30.26, 4.022], 0.4154, -0.531_34, -0.132_544),
        (0.7444, 0.036, [31.5, 1.592], 0.1817, -0.230_57, 0.144_975),
        (1.6452, 0.5, [4.6537, 2.3507], 0.2014, -0.446_1, -0.19),
        (1.8984, 0.1844, [16.77, 5.597], 0.3106, -0.253_91, -0.045_664),
    ] {
        let size = Size { radius_mm, half_mm };
        let [mut fast, mut default] = cylinder(thickness_mm, nu, size, made_mm);
        let exact =
            default.press(Prescribed::PenetrationMm(delta_mm), tilt_rad).expect("a contact");
        assert!(exact.length_mm < thickness_mm / 45.0, "{exact:?}");
        let check = |fast: &mut Pin, drive| {
            let state = fast.press(drive, tilt_rad).expect("a contact");
            assert_eq!(state.steps, 1, "{thickness_mm} {nu} {size:?} {drive:?}: {state:?}");
            let off = (state.force_n / exact.force_n - 1.0).abs();
            let deep = exact.penetration_mm + half_mm * libm::tan(tilt_rad.abs());
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
    for (thickness_mm, nu, [radius_mm, half_mm], made_mm, delta_mm, slope) in [
        (0.7507, 0.5, [4.638, 13.036], 0.0797, 4.098e-4, 1.659e-5),
        (0.6703, 0.21, [36.77, 14.963], 0.1824, 3.4e-4, 9.53e-6),
        (0.6703, 0.21, [3.2377, 18.5278], 0.0869, 2.493e-4, 5.043e-5),
        (1.293, 0.3, [11.055, 17.2957], 0.3178, 4.496e-4, 1.333e-5),
        (0.7981, 0.1715, [15.644, 12.5136], 0.0903, 1.0578e-3, 1.884e-5),
    ] {
        let size = Size { radius_mm, half_mm };
        let [mut fast, mut default] = cylinder(thickness_mm, nu, size, made_mm);
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
