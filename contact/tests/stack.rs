//! Tests stacks of bonded layers: one layer in parts, limits, statics, and stresses between the
//! layers.

use taktil_contact::field::{LineLoad, LinePoint, line};
use taktil_contact::layer::Layer;
use taktil_contact::stack::Stack;

const E_MPA: f64 = 27.58;
const LOADS: [LineLoad; 2] =
    [LineLoad { p_n_mm: 1.0, q_n_mm: 0.0 }, LineLoad { p_n_mm: 0.0, q_n_mm: 1.0 }];
const PLACES_MM: [f64; 6] = [0.0, 0.1, -0.4, 0.9, 2.3, -5.0];

fn layer(t: f64, e: f64, nu: f64) -> Layer {
    Layer::new(t, e, nu).expect("a sound layer")
}

fn stack(layers: &[Layer]) -> Stack {
    Stack::new(layers).expect("a sound stack")
}

fn values(point: &LinePoint, g2: f64) -> [f64; 5] {
    let LinePoint { szz_mpa, sxx_mpa, sxz_mpa, uz_mm, ux_mm } = *point;
    let u = |u: Option<f64>| u.map(|u| u * g2);
    [szz_mpa, sxx_mpa, sxz_mpa, u(uz_mm), u(ux_mm)].map(|v| v.unwrap_or(f64::NAN))
}

fn worst(a: &[LinePoint], b: &[LinePoint], g2: f64) -> f64 {
    let mut most: f64 = 0.0;
    for (a, b) in a.iter().zip(b) {
        for (a, b) in values(a, g2).iter().zip(values(b, g2)) {
            assert_eq!(a.is_nan(), b.is_nan());
            most = if a.is_nan() { most } else { most.max((a - b).abs()) };
        }
    }
    most
}

#[test]
fn one_layer_in_parts_is_one_layer() {
    for nu in [0.3, 0.49, 0.499_999, 0.5] {
        let whole = layer(0.8, E_MPA, nu);
        let g2 = 2.0 * whole.shear_mpa();
        let part = |t: f64| layer(t, E_MPA, nu);
        let parted = [
            stack(&[whole]),
            stack(&[part(0.3), part(0.5)]),
            stack(&[part(0.05), part(0.7), part(0.05)]),
        ];
        for load in LOADS {
            for depth in [0.0, 0.1, 0.3, 0.41, 0.8] {
                let exact = line(&whole, &load, depth, &PLACES_MM).expect("sound points");
                for stack in &parted {
                    let found = stack.line(&load, depth, &PLACES_MM).expect("sound points");
                    let off = worst(&exact, &found, g2);
                    // Stresses over 1/t = 1.25/mm per unit load.
                    assert!(off < 3e-12, "nu {nu}, depth {depth}: {off:e}");
                }
            }
        }
    }
}

#[test]
fn amplitudes_of_a_split_layer_agree_at_any_wave_number() {
    for nu in [0.3, 0.49, 0.5] {
        let one = stack(&[layer(1.0, E_MPA, nu)]);
        let two = stack(&[layer(0.4, E_MPA, nu), layer(0.6, E_MPA, nu)]);
        for k in [1e-6, 1e-3, 0.1, 0.99, 1.01, 2.4, 2.6, 10.0, 100.0, 1e4] {
            for depth in [0.0, 0.2, 0.4, 0.7, 1.0] {
                let (a, b) =
                    (one.amplitudes(k, depth, -1.0, 0.4), two.amplitudes(k, depth, -1.0, 0.4));
                for (a, b) in [(a.szz, b.szz), (a.sxz, b.sxz), (a.sxx, b.sxx)] {
                    assert!((a - b).abs() < 1e-12, "nu {nu} k {k} depth {depth}: {a} {b}");
                }
                // Displacements of the surface are up to (1 - nu)/(G k) or t/G.
                let size = (1.0 / k).min(1.0) / layer(1.0, E_MPA, nu).shear_mpa();
                for (a, b) in [(a.ux, b.ux), (a.uz, b.uz)] {
                    assert!((a - b).abs() < 1e-12 * size, "nu {nu} k {k} depth {depth}: {a} {b}");
                }
            }
        }
    }
}

#[test]
fn a_rigid_layer_below_is_a_base_and_a_thick_one_above_is_alone() {
    let rubber = layer(0.8, E_MPA, 0.49);
    let on_steel = stack(&[rubber, layer(2.0, 1e12, 0.3)]);
    let thick = stack(&[layer(40.0, E_MPA, 0.49), layer(1.0, 2.0, 0.3)]);
    for load in LOADS {
        let exact = line(&rubber, &load, 0.8, &PLACES_MM).expect("sound points");
        let found = on_steel.line(&load, 0.8, &PLACES_MM).expect("sound points");
        assert!(worst(&exact, &found, 2.0 * rubber.shear_mpa()) < 1e-8);
        let alone = line(&layer(40.0, E_MPA, 0.49), &load, 0.5, &PLACES_MM).expect("sound points");
        let found = thick.line(&load, 0.5, &PLACES_MM).expect("sound points");
        // A soft base 40 mm below still increases all displacements, so only stresses are compared.
        for (a, b) in alone.iter().zip(&found) {
            let (a, b) = (values(a, 1.0), values(b, 1.0));
            assert!((a[0] - b[0]).abs() < 1e-3 && (a[2] - b[2]).abs() < 1e-3, "{a:?} {b:?}");
        }
    }
}

#[test]
fn statics_hold_at_every_interface_and_fields_are_continuous_there() {
    let soft = layer(0.5, 5.0, 0.45);
    let hard = layer(0.4, 60.0, 0.45);
    let glue = layer(0.1, 900.0, 0.3);
    let stack = stack(&[hard, glue, soft]);
    let step = 0.1;
    let x: Vec<f64> = (-1000..=1000).map(|i| f64::from(i) * step).collect();
    for depth in [0.4, 1.0] {
        for (i, load) in LOADS.iter().enumerate() {
            let points = stack.line(load, depth, &x).expect("sound points");
            let sum = |of: &dyn Fn(f64, [f64; 5]) -> f64| -> f64 {
                x.iter().zip(&points).map(|(x, p)| step * of(*x, values(p, 1.0))).sum()
            };
            let wanted = if i == 0 { [-1.0, 0.0, 0.0] } else { [0.0, -depth, 1.0] };
            let found = [sum(&|_, v| v[0]), sum(&|x, v| x * v[0]), sum(&|_, v| v[2])];
            for (found, wanted) in found.iter().zip(wanted) {
                // Rounding of 1e-11 a point, times levers of 100 mm.
                assert!((found - wanted).abs() < 1e-6, "depth {depth}: {found} {wanted}");
            }
        }
    }
    for face in [0.4, 0.5] {
        for load in LOADS {
            let above = stack.line(&load, face - 1e-9, &PLACES_MM).expect("sound points");
            let below = stack.line(&load, face + 1e-9, &PLACES_MM).expect("sound points");
            for (a, b) in above.iter().zip(&below) {
                let (a, b) = (values(a, 1.0), values(b, 1.0));
                for k in [0, 2, 3, 4] {
                    assert!((a[k] - b[k]).abs() < 1e-6, "{face}: {a:?} {b:?}");
                }
            }
        }
    }
}

#[test]
fn invalid_stacks_are_refused() {
    assert_eq!(Stack::new(&[]).expect_err("empty").place, "layers");
    assert!(Stack::new(&vec![layer(1.0, 1.0, 0.4); 65]).is_err());
    let bad = Layer { thickness_mm: -1.0, youngs_mpa: 1.0, poisson: 0.4 };
    assert_eq!(Stack::new(&[bad]).expect_err("t").place, "thickness_mm");
    let sound = stack(&[layer(1.0, 1.0, 0.4)]);
    for depth in [f64::NAN, -0.1, 1.1, -1e-6] {
        assert!(sound.line(&LOADS[0], depth, &PLACES_MM).is_err(), "{depth}");
    }
    assert!(sound.line(&LOADS[0], 0.5, &[f64::NAN]).is_err());
    // A skin so thin that a line load needs too many waves, and too many layers, are errors.
    for skin in [1e-6, 1e-12, 1e-29] {
        let thin = stack(&[layer(skin, 1.0, 0.4), layer(1.0, 2.0, 0.4)]);
        for depth in [0.0, 0.3 * skin] {
            let refused = thin.line(&LOADS[0], depth, &PLACES_MM).expect_err("too many waves");
            assert_eq!(refused.place, "thickness_mm", "{skin} {depth}: {refused}");
        }
        assert!(thin.line(&LOADS[0], 0.7, &PLACES_MM).is_ok());
    }
    // Each wave passes through all of them.
    let mut many = vec![layer(1e-3, 1.0, 0.4)];
    many.resize(64, layer(1.0 / 63.0, 1.0, 0.4));
    let refused = stack(&many).line(&LOADS[0], 0.0, &PLACES_MM).expect_err("too many waves in all");
    assert!(refused.what.contains("64 layers") && refused.remedy.contains("fewer layers"));
    assert!(stack(&many[..8]).line(&LOADS[0], 0.0, &PLACES_MM).is_ok());
}
