//! Tests several bonded layers in three dimensions: one layer in parts, the plane problem summed
//! along a line, modes of shear, statics of the base, and contacts on cells.

use crate::{E_MPA, layer, max_difference, peak};
use core::f64::consts::PI;
use taktil_contact::field::LineLoad;
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::grip::{BodyMotion, Grip};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::shear::Shear;
use taktil_contact::space::surface::{Cells, Surface};
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};
use taktil_contact::stack::Stack;

fn stack(layers: &[(f64, f64, f64)]) -> Stack {
    let layers: Vec<Layer> =
        layers.iter().map(|(t, e, nu)| Layer::new(*t, *e, *nu).expect("a sound layer")).collect();
    Stack::new(&layers).expect("a sound stack")
}

#[test]
fn two_equal_layers_are_one() {
    for nu in [0.3, 0.49, 0.5] {
        let whole = layer(0.8, nu);
        let parted = stack(&[(0.3, E_MPA, nu), (0.5, E_MPA, nu)]);
        let (one, two) = (Influence::new(&whole).unwrap(), Influence::of_stack(&parted).unwrap());
        let (rubbed, both) = (Shear::new(&whole).unwrap(), Shear::of_stack(&parted).unwrap());
        let unit = 1.0 / (whole.shear_mpa() * 0.8);
        for r in [0.05, 0.3, 0.8, 2.1, 5.0, 17.0] {
            let off = one.surface_point(r) - two.surface_point(r);
            assert!(off.abs() < 1e-10 * unit, "{nu} {r}: {off:e}");
            let off = one.base_point(r) - two.base_point(r);
            assert!(off.abs() < 3e-8, "{nu} {r}: {off:e}");
            let place = [0.6 * r, -0.8 * r];
            let off = max_difference(&rubbed.surface_point(place), &both.surface_point(place));
            assert!(off < 1e-9 * unit, "{nu} {r}: {off:e}");
            let off = rubbed.base_point(place) - both.base_point(place);
            assert!(off.abs() < 1e-10, "{nu} {r}: {off:e}");
        }
    }
}

/// A stiff layer below acts as a base; a stiff skin spreads the load that is put on it.
#[test]
fn a_line_of_point_loads_is_the_plane_problem() {
    for layers in [
        vec![(0.4, 27.58, 0.49), (0.4, 5.0, 0.4)],
        vec![(0.3, 5.0, 0.5), (0.5, 27.58, 0.3), (0.4, 2.0, 0.45)],
        vec![(0.8, 27.58, 0.49), (1.0, 27.58e5, 0.3)],
    ] {
        let stack = stack(&layers);
        let (normal, shear) =
            (Influence::of_stack(&stack).unwrap(), Shear::of_stack(&stack).unwrap());
        let whole = stack.thickness_mm();
        let size = 1.0 / stack.surface_layer().shear_mpa();
        let loads = [(1.0, 0.0), (0.0, 1.0)].map(|(p_n_mm, q_n_mm)| LineLoad { p_n_mm, q_n_mm });
        for x in [0.3, -0.9, 2.5, 6.0] {
            let (mut sunk, mut base, mut rubbed, mut moved) = (0.0, 0.0, 0.0, [0.0; 3]);
            let step = 0.01;
            for i in -16_000..=16_000 {
                let y = step * f64::from(i);
                let r = libm::hypot(x, y);
                sunk += step * normal.surface_point(r);
                base += step * normal.base_point(r);
                rubbed += step * shear.base_point([x, y]);
                for (sum, u) in moved.iter_mut().zip(shear.surface_point([x, y])) {
                    *sum += step * u;
                }
            }
            let [p, q] = loads
                .map(|load| [0.0, whole].map(|depth| stack.line(&load, depth, &[x]).unwrap()[0]));
            for (name, found, wanted, bar) in [
                ("sunk", sunk, -p[0].uz_mm.unwrap(), 1e-8 * size),
                ("base", base, p[1].szz_mpa.unwrap(), 1e-8),
                ("rubbed", rubbed, q[1].szz_mpa.unwrap(), 1e-8),
                ("along", moved[0], q[0].ux_mm.unwrap(), 1e-8 * size),
                ("across", moved[1], 0.0, 1e-8 * size),
                ("coupled", moved[2], -q[0].uz_mm.unwrap(), 1e-8 * size),
            ] {
                assert!((found - wanted).abs() < bar, "{layers:?} {x} {name}: {found} {wanted}");
            }
        }
    }
}

/// A line of loads along itself shears the layers alone: two of one thickness have modes
/// cos(kappa z) above and sin(kappa (2 t - z)) below with tan(kappa t)^2 the lower shear modulus
/// over the upper, and each leaves its square at the surface times exp(-kappa x)/(2 kappa).
#[test]
fn a_line_along_itself_is_the_sum_of_the_modes_of_shear() {
    let t = 0.6;
    for (above, below) in [(27.58, 27.58), (27.58, 3.0), (2.0, 40.0)] {
        let stack = stack(&[(t, above, 0.49), (t, below, 0.3)]);
        let shear = Shear::of_stack(&stack).unwrap();
        let [g, lower] = [above / 2.98, below / 2.6];
        let first = libm::atan((lower / g).sqrt());
        let modes = |x: f64| -> f64 {
            let one = |n: i32| {
                let turn = if n % 2 == 0 { first } else { PI - first } + PI * f64::from(n / 2);
                let kappa = turn / t;
                // Half of each function's square, and what is left of it at the interface.
                let (s, c) = libm::sincos(turn);
                let rest = 0.5 * s * c / kappa;
                let weight = g * (0.5 * t + rest) + lower * (c / s) * (c / s) * (0.5 * t - rest);
                libm::exp(-kappa * x) / (2.0 * kappa * weight)
            };
            (0..80).map(one).sum()
        };
        for x in [0.3, 0.9, 2.5, 6.0] {
            let (mut sum, step) = (0.0, 0.01);
            for i in -16_000..=16_000 {
                // Along the load is along the line.
                sum += step * shear.surface_point([step * f64::from(i), x])[0];
            }
            let wanted = modes(x);
            assert!((sum - wanted).abs() < 1e-8 / g, "{above} {below} {x}: {sum} {wanted}");
        }
    }
}

#[test]
fn the_base_carries_the_load_and_its_moment() {
    let stack = stack(&[(0.3, 5.0, 0.5), (0.5, 27.58, 0.3), (0.4, 6.0, 0.45)]);
    let array = Array { rows: 200, cols: 200, pitch_mm: 0.4 };
    let (normal, shear) = (Influence::of_stack(&stack).unwrap(), Shear::of_stack(&stack).unwrap());
    let shares = Shares::new(&normal, &array, Sampling::Area, Fineness::FINE).unwrap();
    let sheared = Shares::sheared(&shear, &array, Sampling::Area, Fineness::FINE).unwrap();
    let place = [0.23, -0.41];
    let [mut pressed, mut rubbed] = [vec![0.0; array.len()], vec![0.0; array.len()]];
    shares.add(&mut pressed, place, 2.0);
    sheared.add(&mut rubbed, place, 3.0);
    let sums = |image: &[f64]| {
        let mut sums = [0.0; 3];
        for (n, s) in image.iter().enumerate() {
            let [x, y] = [array.x_mm(n % array.cols), array.y_mm(n / array.cols)];
            let s = s * array.pitch_mm * array.pitch_mm;
            [1.0, x, y].iter().zip(&mut sums).for_each(|(w, sum)| *sum += w * s);
        }
        sums
    };
    for (found, wanted) in sums(&pressed).iter().zip([-2.0, -0.46, 0.82]) {
        assert!((found - wanted).abs() < 1e-6, "{found} {wanted}");
    }
    for (found, wanted) in sums(&rubbed).iter().zip([0.0, -3.0 * 1.2, 0.0]) {
        assert!((found - wanted).abs() < 1e-6, "{found} {wanted}");
    }
}

fn ball(cells: &Cells) -> Vec<f64> {
    let height = |n: usize| {
        let [x, y] = cells.place_mm(n);
        (x * x + y * y) / 20.0
    };
    (0..cells.columns * cells.rows).map(height).collect()
}

#[test]
fn a_body_grips_a_stack_as_it_does_a_layer() {
    let cells = Cells { columns: 32, rows: 30, spacing_mm: 0.1 };
    let body = ball(&cells);
    let carried = |normal: &Influence, shear: &Shear| {
        let surface = Surface::new(normal, &cells).unwrap();
        let mut grip = Grip::new(surface, shear, 0.4).unwrap();
        grip.step(&body, Prescribed::ForceN(2.0), &BodyMotion::default()).unwrap();
        let carry = BodyMotion { shift_mm: [3e-3, 1e-3], turn_rad: 2e-3 };
        let state = grip.step(&body, Prescribed::ForceN(2.0), &carry).unwrap();
        (state, grip.pressure_mpa().to_vec(), grip.traction_mpa()[0].to_vec())
    };
    let on = |layers: &[(f64, f64, f64)]| {
        let stack = stack(layers);
        carried(&Influence::of_stack(&stack).unwrap(), &Shear::of_stack(&stack).unwrap())
    };
    let whole = layer(0.8, 0.49);
    let one = carried(&Influence::new(&whole).unwrap(), &Shear::new(&whole).unwrap());
    let two = on(&[(0.3, E_MPA, 0.49), (0.5, E_MPA, 0.49)]);
    assert!(max_difference(&one.1, &two.1) < 1e-5 * peak(&one.1));
    assert!(max_difference(&one.2, &two.2) < 1e-5 * peak(&one.2));
    // On a base of metal the rubber is the layer again; on foam the ball sinks further, and drags
    // less along.
    let metal = on(&[(0.8, E_MPA, 0.49), (2.0, 1e4 * E_MPA, 0.3)]);
    assert!(max_difference(&one.1, &metal.1) < 2e-3 * peak(&one.1));
    let foam = on(&[(0.8, E_MPA, 0.49), (2.0, 0.1 * E_MPA, 0.2)]);
    let deep = |state: &taktil_contact::space::grip::GripState| {
        [state.pressed.penetration_mm, state.force_n[0]]
    };
    let ([depth, force], [foam_depth, foam_force]) = (deep(&one.0), deep(&foam.0));
    assert!(foam_depth > 1.5 * depth && foam_force < 0.7 * force, "{one:?} {foam:?}");
}

#[test]
fn a_skin_too_thin_for_its_stack_is_refused_by_name() {
    let thin = stack(&[(1e-3, E_MPA, 0.49), (2.0, E_MPA, 0.49)]);
    assert_eq!(Influence::of_stack(&thin).expect_err("too thin").place, "layers");
    assert_eq!(Shear::of_stack(&thin).expect_err("too thin").place, "layers");
    // Cells are as fine as the layer at the surface wants them.
    let two = stack(&[(0.2, E_MPA, 0.49), (0.6, E_MPA, 0.49)]);
    let cells = Cells { columns: 8, rows: 8, spacing_mm: 0.2 };
    let refused = Surface::new(&Influence::of_stack(&two).unwrap(), &cells);
    assert_eq!(refused.expect_err("too wide").place, "spacing_mm");
}
