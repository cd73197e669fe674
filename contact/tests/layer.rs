//! Compares line loads on the bonded layer with exact reference data, conservation laws and limits.

mod contact_data;

use contact_data::rows;
use taktil_contact::field::{LineLoad, LinePoint, line, line_half_plane};
use taktil_contact::layer::Layer;

const E_MPA: f64 = 27.58;
const P: LineLoad = LineLoad { p_n_mm: 1.0, q_n_mm: 0.0 };
const Q: LineLoad = LineLoad { p_n_mm: 0.0, q_n_mm: 1.0 };

fn layer(t: f64, nu: f64) -> Layer {
    Layer::new(t, E_MPA, nu).expect("a sound layer")
}

fn at(layer: &Layer, load: &LineLoad, depth: f64, x: f64) -> LinePoint {
    line(layer, load, depth, &[x]).expect("a sound point")[0]
}

fn stresses(point: &LinePoint) -> [f64; 3] {
    [point.szz_mpa, point.sxx_mpa, point.sxz_mpa].map(|s| s.expect("a finite stress"))
}

/// Largest difference of the six stresses over rows of t, depth, x, six stresses.
fn worst_stress(nu: f64, text: &str) -> f64 {
    let mut worst: f64 = 0.0;
    for row in rows(text) {
        let layer = layer(row[0], nu);
        for (load, expected) in [(P, &row[3..6]), (Q, &row[6..9])] {
            let found = stresses(&at(&layer, &load, row[1], row[2]));
            for (f, e) in found.iter().zip(expected) {
                worst = worst.max((f - e).abs());
            }
        }
    }
    worst
}

#[test]
fn stresses_of_line_loads_are_those_of_the_reference() {
    for (nu, text) in [
        (0.3, include_str!("fixtures/contact/line_nu3.csv")),
        (0.45, include_str!("fixtures/contact/line_nu45.csv")),
        (0.49, include_str!("fixtures/contact/line_nu49.csv")),
        (0.4999, include_str!("fixtures/contact/line_nu4999.csv")),
        (0.499_999, include_str!("fixtures/contact/line_nu499999.csv")),
        (0.5, include_str!("fixtures/contact/line_nu5.csv")),
    ] {
        let worst = worst_stress(nu, text);
        assert!(worst < 1e-13, "nu {nu}: {worst:e}");
    }
}

#[test]
fn base_stress_under_a_line_is_that_of_the_reference() {
    let text = include_str!("fixtures/contact/line_nu49.csv");
    let rows: Vec<Vec<f64>> = rows(text).into_iter().filter(|row| row[0] == row[1]).collect();
    assert!(rows.len() > 40);
    let layer = layer(0.8, 0.49);
    for row in rows {
        assert!((layer.base_szz_line(row[2]) - row[3]).abs() < 1e-13, "x {}", row[2]);
        assert!((layer.base_szz_line(-row[2]) - row[3]).abs() < 1e-13, "x {}", row[2]);
    }
    assert!((layer.base_szz_line(0.0) + 1.026_139_418_624_304_3).abs() < 1e-14);
}

#[test]
fn stresses_and_displacements_inside_are_those_of_the_reference() {
    let mut misses = Vec::new();
    for row in rows(include_str!("fixtures/contact/line_through_thickness.csv")) {
        let layer = layer(row[1], row[0]);
        let g2 = 2.0 * layer.shear_mpa();
        let (p, q) = (at(&layer, &P, row[2], row[3]), at(&layer, &Q, row[2], row[3]));
        for (found, expected) in stresses(&p).iter().zip(&row[4..7]) {
            assert!((found - expected).abs() < 1e-12, "P {row:?}");
        }
        for (found, expected) in stresses(&q).iter().zip(&row[7..10]) {
            assert!((found - expected).abs() < 1e-12, "Q {row:?}");
        }
        let found = [p.uz_mm, p.ux_mm, q.uz_mm, q.ux_mm].map(|u| u.expect("finite") * g2);
        let off = [0, 1, 2, 3].map(|i| found[i] - row[10 + i]);
        // The odd ones carry no constant.
        assert!(off[1].abs() < 1e-12 && off[2].abs() < 1e-12, "u {row:?}: {off:?}");
        misses.push(([row[0], row[1], row[2]], [off[0], off[3]]));
    }
    only_constants_are_off(&misses);
}

/// The even displacements of the reference differ by a constant for each layer and depth, of up to
/// 4e-10, and by nothing else.
fn only_constants_are_off(misses: &[([f64; 3], [f64; 2])]) {
    for group in misses.chunk_by(|a, b| a.0 == b.0) {
        for i in 0..2 {
            let mean = group.iter().map(|(_, off)| off[i]).sum::<f64>() / group.len() as f64;
            assert!(mean.abs() < 4e-10, "{:?}: {mean:e}", group[0].0);
            for (_, off) in group {
                assert!((off[i] - mean).abs() < 1e-12, "{:?}: {:e} {mean:e}", group[0].0, off[i]);
            }
        }
    }
}

#[test]
fn surface_displacements_are_those_of_the_reference() {
    let mut misses = Vec::new();
    for row in rows(include_str!("fixtures/contact/surface_green.csv")) {
        let layer = layer(row[1], row[0]);
        let pi_g = core::f64::consts::PI * layer.shear_mpa();
        let (p, q) = (at(&layer, &P, 0.0, row[2]), at(&layer, &Q, 0.0, row[2]));
        let (uz_p, ux_q) = (p.uz_mm.expect("finite"), q.ux_mm.expect("finite"));
        let (ux_p, uz_q) = (p.ux_mm.expect("finite"), q.uz_mm.expect("finite"));
        misses.push(([row[0], row[1], 0.0], [-pi_g * uz_p - row[3], pi_g * ux_q - row[4]]));
        assert!((-2.0 * pi_g * uz_q - row[5]).abs() < 1e-13, "{row:?}");
        // Betti: the coupled displacements are the same with the loads exchanged.
        assert!((uz_q - ux_p).abs() < 1e-15, "{row:?}");
    }
    only_constants_are_off(&misses);
}

#[test]
fn surface_stress_continues_the_stress_just_below() {
    for nu in [0.3, 0.49, 0.5] {
        let layer = layer(0.8, nu);
        for load in [P, Q] {
            for x in [-2.0, -0.3, 0.15, 0.9] {
                let [szz, sxx, sxz] = stresses(&at(&layer, &load, 0.0, x));
                let near = stresses(&at(&layer, &load, 0.8 / 500.0, x))[1];
                let far = stresses(&at(&layer, &load, 0.8 / 250.0, x))[1];
                let limit = 2.0 * near - far;
                assert_eq!((szz, sxz), (0.0, 0.0));
                assert!((sxx - limit).abs() < 2e-3 * (1.0 + sxx.abs()), "{nu} {x}: {sxx} {limit}");
            }
        }
    }
}

/// Tests stresses just under the surface: both ways of summing agree at the depth where they meet,
/// the limit is the surface itself, next to the load the stress is Flamant's, and a strip that is
/// cut off is in equilibrium.
#[test]
fn stresses_just_under_the_surface_are_exact() {
    let x = [0.0, 1e-7, -3e-4, 0.02, -0.31, 1.7, 9.0, -40.0];
    for nu in [0.3, 0.49, 0.5] {
        let layer = layer(0.8, nu);
        for load in [P, Q] {
            // The two ways of summing meet at t/20; the difference between the two depths is the
            // change of the stress itself.
            let side = |s: f64| line(&layer, &load, 0.04 * (1.0 + s), &x).expect("sound points");
            let values = |p: &LinePoint| {
                let all = [p.szz_mpa, p.sxx_mpa, p.sxz_mpa, p.uz_mm, p.ux_mm];
                all.map(|v| v.expect("finite"))
            };
            let sides = [-3e-6, -1e-6, 1e-6, 3e-6].map(side);
            for (i, x) in x.iter().enumerate() {
                let [far, below, above, beyond] = [0, 1, 2, 3].map(|s| values(&sides[s][i]));
                for (k, far) in far.iter().enumerate() {
                    let kink = (beyond[k] - far) - 3.0 * (above[k] - below[k]);
                    assert!(kink.abs() < 1e-11, "{nu} {x} {k}: {kink:e}");
                }
            }
            // The surface is the limit of shallower and shallower places.
            for depth in [1e-5, 1e-8, 1e-12] {
                let close = line(&layer, &load, depth, &x[3..]).expect("sound points");
                let there = line(&layer, &load, 0.0, &x[3..]).expect("sound points");
                for (a, b) in close.iter().zip(&there) {
                    for (a, b) in values(a).iter().zip(values(b)) {
                        let bar = 3e3 * depth + 1e-12;
                        assert!((a - b).abs() < bar * (1.0 + b.abs()), "{nu} {depth}: {a} {b}");
                    }
                }
            }
            // Next to the load the field is that of the half plane.
            let depth = 1e-6;
            let near = [0.0, 0.5e-6, -2e-6];
            let own = line(&layer, &load, depth, &near).expect("sound points");
            let half = line_half_plane(&load, depth, &near).expect("sound points");
            for (a, b) in own.iter().zip(&half) {
                for (a, b) in stresses(a).iter().zip(stresses(b)) {
                    assert!((a - b).abs() < 5.0, "{nu}: {a} {b}");
                }
            }
        }
    }
    assert!(line(&layer(0.8, 0.49), &P, 1e-300, &[0.0]).is_ok());
}

#[test]
fn base_moments_obey_statics() {
    for nu in [0.3, 0.49, 0.5] {
        let (t, step) = (0.8, 0.02);
        let layer = layer(t, nu);
        let x: Vec<f64> = (-1600..=1600).map(|i| f64::from(i) * step).collect();
        let sum = |load: &LineLoad, f: &dyn Fn(f64, [f64; 3]) -> f64| -> f64 {
            let points = line(&layer, load, t, &x).expect("sound points");
            x.iter().zip(&points).map(|(x, p)| step * f(*x, stresses(p))).sum()
        };
        assert!((sum(&P, &|_, s| s[0]) + 1.0).abs() < 1e-12);
        assert!((sum(&Q, &|x, s| x * s[0]) + t).abs() < 1e-10);
        assert!((sum(&Q, &|_, s| s[2]) - 1.0).abs() < 1e-12);
        let second = -nu / (1.0 - nu) * t * t;
        assert!((sum(&P, &|x, s| x * x * s[0]) - second).abs() < 1e-10, "nu {nu}");
        assert!((sum(&P, &|_, s| s[1]) + nu / (1.0 - nu)).abs() < 1e-12, "bonded base");
    }
}

#[test]
fn a_thick_layer_is_a_half_plane() {
    let load = LineLoad { p_n_mm: 0.7, q_n_mm: -0.4 };
    let x = [-3.0, -0.2, 0.0, 0.8, 5.0];
    let thick = line(&layer(2500.0, 0.49), &load, 6.0, &x).expect("sound points");
    let half = line_half_plane(&load, 6.0, &x).expect("sound points");
    for (a, b) in thick.iter().zip(&half) {
        let (a, b) = (stresses(a), stresses(b));
        assert!((a[0] - b[0]).abs() < 5e-9, "{a:?} {b:?}");
        assert!((a[1] - b[1]).abs() < 1e-3, "{a:?} {b:?}");
    }
    assert!(half.iter().all(|p| p.uz_mm.is_none() && p.ux_mm.is_none()));
}

#[test]
fn under_the_load_itself_nothing_is_determined_and_far_away_there_is_nothing() {
    let layer = layer(0.8, 0.49);
    assert_eq!(at(&layer, &P, 0.0, 0.0), LinePoint::default());
    assert_eq!(line_half_plane(&P, 0.0, &[0.0]), Ok(vec![LinePoint::default()]));
    for depth in [0.0, 0.4, 0.8] {
        for x in [40.0, 70.0, -1e6, 1e300] {
            let point = at(&layer, &LineLoad { p_n_mm: 1.0, q_n_mm: 1.0 }, depth, x);
            assert!(stresses(&point).iter().all(|s| s.abs() < 1e-14), "{x}: {point:?}");
            assert!(point.uz_mm.is_some_and(|u| u.abs() < 1e-15), "{x}: {point:?}");
            assert!(point.ux_mm.is_some_and(|u| u.abs() < 1e-15), "{x}: {point:?}");
        }
    }
    assert_eq!(layer.base_szz_line(f64::INFINITY), 0.0);
    assert!(layer.base_szz_line(f64::NAN).is_nan());
}

#[test]
fn transfer_functions_keep_their_limits() {
    for nu in [1e-6, 0.3, 0.49, 0.4999, 0.5] {
        let transfer = layer(1.0, nu).transfer();
        assert!((transfer.base_normal(0.0) - 1.0).abs() < 1e-15);
        // A tangential line load has the first moment t at the base.
        let slope = transfer.base_normal_from_tangential(1e-6) / 1e-6;
        assert!((slope - 1.0).abs() < 1e-9, "nu {nu}: {slope}");
        let at_zero = (transfer.kap - 1.0) / (transfer.m * transfer.m);
        assert!((transfer.normal_compliance(0.0) - at_zero).abs() < 1e-15);
        assert!((transfer.tangential_compliance(0.0) - 2.0 / transfer.m).abs() < 1e-14);
        for a in [50.0, 700.0, 1e6, 1e150] {
            assert!((a * transfer.normal_compliance(a) - 1.0).abs() < 1e-12, "{a}");
            assert!((a * transfer.tangential_compliance(a) - 1.0).abs() < 1e-12, "{a}");
            assert!((transfer.coupling(a) - transfer.n).abs() < 1e-12, "{a}");
            assert!(transfer.base_normal(a) < 1e-15, "{a}");
        }
        // Both sides of the change from series to closed form.
        let below = transfer.normal_compliance(0.25 - 1e-12);
        let above = transfer.normal_compliance(0.25);
        assert!((below / above - 1.0).abs() < 1e-9, "nu {nu}: {below} {above}");
    }
    // nu = 0.5: M/a = a^2 (4/3)/(2 m^2) + ..., lost without the series.
    let soft = layer(1.0, 0.5).transfer().normal_compliance(1e-5);
    assert!((soft / (2.0 / 3.0 * 1e-10) - 1.0).abs() < 1e-9, "{soft:e}");
}

#[test]
fn invalid_layers_are_refused_with_the_field_named() {
    for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
        assert_eq!(Layer::new(bad, 1.0, 0.4).expect_err("t").place, "thickness_mm");
        assert_eq!(Layer::new(1.0, bad, 0.4).expect_err("E").place, "youngs_mpa");
    }
    for bad in [f64::NAN, f64::INFINITY, 0.500_001, -1.0, -2.0] {
        assert_eq!(Layer::new(1.0, 1.0, bad).expect_err("nu").place, "poisson");
    }
    for good in [0.5, 0.0, -0.0, -0.999] {
        assert!(Layer::new(1.0, 1.0, good).is_ok(), "{good}");
    }
    let sound = layer(1.0, 0.4);
    for bad in [f64::NAN, f64::INFINITY, -0.1, 1.01, -1e-9] {
        assert_eq!(line(&sound, &P, bad, &[0.0]).expect_err("depth").place, "depth_mm", "{bad}");
    }
    assert_eq!(line(&sound, &P, 0.5, &[0.0, f64::NAN]).expect_err("x").place, "x_mm");
    let load = LineLoad { p_n_mm: f64::NAN, q_n_mm: 0.0 };
    assert_eq!(line(&sound, &load, 0.5, &[0.0]).expect_err("P").place, "p_n_mm");
    let unchecked = Layer { thickness_mm: -1.0, youngs_mpa: 1.0, poisson: 0.4 };
    assert_eq!(line(&unchecked, &P, 0.5, &[0.0]).expect_err("t").place, "thickness_mm");
    assert_eq!(line_half_plane(&P, f64::NAN, &[0.0]).expect_err("depth").place, "depth_mm");
}
