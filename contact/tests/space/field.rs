//! Tests the fields of a point load at any depth: the half space of Boussinesq and Cerruti, the
//! plane problem summed along a line, Hooke's law and equilibrium, the tables at the surface and
//! the base.

use crate::E_MPA;
use core::f64::consts::PI;
use taktil_contact::field::LineLoad;
use taktil_contact::layer::Layer;
use taktil_contact::space::field::{PointField, PointLoad, point};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::shear::Shear;
use taktil_contact::stack::Stack;

const BOTH: PointLoad = PointLoad { p_n: 1.3, q_n: -0.7 };

fn stack(layers: &[(f64, f64, f64)]) -> Stack {
    let layers: Vec<Layer> =
        layers.iter().map(|(t, e, nu)| Layer::new(*t, *e, *nu).expect("a sound layer")).collect();
    Stack::new(&layers).expect("a sound stack")
}

fn three() -> Stack {
    stack(&[(0.3, 5.0, 0.45), (0.5, 27.58, 0.3), (0.4, 6.0, 0.2)])
}

fn one(stack: &Stack, load: PointLoad, depth: f64, place: [f64; 2]) -> PointField {
    point(stack, &load, depth, &[place]).expect("a field")[0]
}

#[test]
fn deep_rubber_is_the_half_space_of_boussinesq_and_cerruti() {
    for nu in [0.0, 0.3, 0.5] {
        let deep = stack(&[(3000.0, E_MPA, nu)]);
        for (z, [x, y]) in [(1.0, [0.0_f64, 0.0]), (0.7, [0.9, -0.4]), (0.2, [-1.1, 0.6])] {
            let r: f64 = (x * x + y * y + z * z).sqrt();
            let unit = 3.0 / (2.0 * PI * r * r * r * r * r);
            let PointLoad { p_n: p, q_n: q } = BOTH;
            // The traction on a plane along the surface points at the load.
            let pull = unit * z * (q * x + p * z);
            let found = one(&deep, BOTH, z, [x, y]).stress_mpa;
            let wanted = [-pull * z, pull * y, pull * x];
            for (found, wanted) in [found[2], found[3], found[4]].iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-6, "{nu} {z} {x}: {found} {wanted}");
            }
            // The mean stress, -(1 + nu)/(3 pi R^3) times what is along the way.
            let mean = (found[0] + found[1] + found[2]) / 3.0;
            let wanted = -(1.0 + nu) / (3.0 * PI * r * r * r) * (p * z + q * x);
            assert!((mean - wanted).abs() < 1e-6, "{nu} {z} {x}: {mean} {wanted}");
        }
    }
}

#[test]
fn a_line_of_loads_is_the_plane_problem_at_any_depth() {
    let step = 0.1;
    let steps: Vec<f64> = (0..=400).map(|i| step * f64::from(i)).collect();
    for (stack, depths) in
        [(three(), [0.2, 0.3, 0.62, 1.2]), (stack(&[(0.8, E_MPA, 0.5)]), [0.2, 0.4, 0.79, 0.8])]
    {
        for depth in depths {
            let x = 0.35;
            let places: Vec<[f64; 2]> = steps.iter().map(|y| [x, *y]).collect();
            let fields = point(&stack, &BOTH, depth, &places).expect("fields");
            // Both halves of the line do the same here.
            let half = |of: &dyn Fn(&PointField) -> f64| fields.iter().map(of).sum::<f64>();
            let sum = |of: &dyn Fn(&PointField) -> f64| step * (2.0 * half(of) - of(&fields[0]));
            let load = LineLoad { p_n_mm: BOTH.p_n, q_n_mm: BOTH.q_n };
            let line = stack.line(&load, depth, &[x]).expect("a line")[0];
            for (name, found, wanted) in [
                ("szz", sum(&|f| f.stress_mpa[2]), line.szz_mpa),
                ("sxx", sum(&|f| f.stress_mpa[0]), line.sxx_mpa),
                ("sxz", sum(&|f| f.stress_mpa[4]), line.sxz_mpa),
                ("uz", sum(&|f| f.moved_mm[2]), line.uz_mm),
                ("ux", sum(&|f| f.moved_mm[0]), line.ux_mm),
            ] {
                let wanted = wanted.expect("finite");
                assert!((found - wanted).abs() < 1e-9, "{depth} {name}: {found} {wanted}");
            }
        }
    }
}

/// Central differences of the displacements are the stresses, and those of the stresses balance.
#[test]
fn fields_keep_hookes_law_and_equilibrium() {
    let stack = three();
    let h = 2e-3;
    for (depth, [x, y]) in [(0.17, [0.4, 0.2]), (0.55, [-0.3, 0.5]), (1.0, [0.8, -0.9])] {
        let (e, nu) = match depth {
            d if d < 0.3 => (5.0, 0.45),
            d if d < 0.8 => (27.58, 0.3),
            _ => (6.0, 0.2),
        };
        let at = |i: usize, side: f64| {
            let mut place = [x, y, -depth];
            place[i] += side * h;
            one(&stack, BOTH, -place[2], [place[0], place[1]])
        };
        let rate = |of: &dyn Fn(&PointField) -> f64, i: usize| {
            (of(&at(i, 1.0)) - of(&at(i, -1.0))) / (2.0 * h)
        };
        let strain =
            |i: usize, j: usize| 0.5 * (rate(&|f| f.moved_mm[i], j) + rate(&|f| f.moved_mm[j], i));
        let g = e / (2.0 * (1.0 + nu));
        let lame = 2.0 * g * nu / (1.0 - 2.0 * nu);
        let swelling = lame * (strain(0, 0) + strain(1, 1) + strain(2, 2));
        let found = one(&stack, BOTH, depth, [x, y]).stress_mpa;
        let pairs = [[0, 0], [1, 1], [2, 2], [1, 2], [0, 2], [0, 1]];
        for (n, [i, j]) in pairs.into_iter().enumerate() {
            let wanted = 2.0 * g * strain(i, j) + if i == j { swelling } else { 0.0 };
            assert!((found[n] - wanted).abs() < 1e-3, "{depth} {n}: {} {wanted}", found[n]);
        }
        let numbers = [[0, 5, 4], [5, 1, 3], [4, 3, 2]];
        for row in numbers {
            let terms = [0, 1, 2].map(|i| rate(&|f| f.stress_mpa[row[i]], i));
            let size = terms.iter().fold(0.0, |most: f64, term| most.max(term.abs()));
            let left: f64 = terms.iter().sum();
            assert!(left.abs() < 1e-3 * (1.0 + size), "{depth}: {terms:?}");
        }
    }
}

#[test]
fn layers_stay_bonded() {
    let stack = three();
    for (interface, [x, y]) in [(0.3, [0.2, 0.1]), (0.8, [-0.5, 0.7]), (0.8, [0.05, 0.0])] {
        let [over, under] =
            [-1.0, 1.0].map(|side| one(&stack, BOTH, interface + side * 1e-8, [x, y]));
        let size = over.stress_mpa.iter().fold(0.0, |most: f64, s| most.max(s.abs()));
        for k in [2, 3, 4] {
            let off = over.stress_mpa[k] - under.stress_mpa[k];
            assert!(off.abs() < 1e-6 * size, "{interface} {x} {k}: {off:e}");
        }
        for k in 0..3 {
            let off = over.moved_mm[k] - under.moved_mm[k];
            assert!(off.abs() < 1e-6 * size, "{interface} {x} {k}: {off:e}");
        }
        // Along the surface they are pulled each by their own stiffness.
        assert!((over.stress_mpa[0] - under.stress_mpa[0]).abs() > 1e-3 * size);
    }
}

#[test]
fn tables_of_the_surface_and_the_base_are_its_ends() {
    for stack in [three(), stack(&[(0.8, E_MPA, 0.49)])] {
        let (normal, shear) =
            (Influence::of_stack(&stack).unwrap(), Shear::of_stack(&stack).unwrap());
        for [x, y] in [[0.5, 0.0], [-0.4, 0.9], [2.0, 1.0]] {
            let r = libm::hypot(x, y);
            let base = one(&stack, BOTH, stack.thickness_mm(), [x, y]);
            let wanted = BOTH.p_n * normal.base_point(r) + BOTH.q_n * shear.base_point([x, y]);
            assert!((base.stress_mpa[2] - wanted).abs() < 3e-8);
            assert!(base.moved_mm.iter().all(|u| u.abs() < 1e-13), "{:?}", base.moved_mm);
            // The surface is the limit of two depths. A pressure draws it along as, by
            // reciprocity, a traction lifts it from the other side.
            let [a, b] = [2e-3, 1e-3].map(|depth| one(&stack, BOTH, depth, [x, y]).moved_mm);
            let [along, across] = [shear.surface_point([x, y]), shear.surface_point([y, x])];
            let wanted = [
                BOTH.q_n * along[0] - BOTH.p_n * along[2],
                BOTH.q_n * along[1] - BOTH.p_n * across[2],
                -BOTH.p_n * normal.surface_point(r) - BOTH.q_n * along[2],
            ];
            for ((a, b), wanted) in a.iter().zip(b).zip(wanted) {
                let limit = 2.0 * b - a;
                assert!((limit - wanted).abs() < 2e-5, "{x} {y}: {limit} {wanted}");
            }
        }
    }
}

#[test]
fn impossible_arguments_are_refused_by_name() {
    let rubber = stack(&[(0.8, E_MPA, 0.49)]);
    for depth in [0.0, -0.1, 0.81, f64::NAN, f64::INFINITY, 1e-9] {
        let refused = point(&rubber, &BOTH, depth, &[[0.1, 0.2]]).expect_err("no depth");
        assert_eq!(refused.place, "depth_mm", "{depth}");
    }
    assert_eq!(point(&rubber, &BOTH, 0.4, &[[f64::NAN, 0.0]]).expect_err("NaN").place, "x_mm");
    let load = PointLoad { p_n: f64::INFINITY, q_n: 0.0 };
    assert_eq!(point(&rubber, &load, 0.4, &[[0.0; 2]]).expect_err("infinite").place, "p_n");
    assert_eq!(one(&rubber, BOTH, 0.4, [1e6, 0.0]), PointField::default());
    assert!(point(&rubber, &BOTH, 0.4, &[]).expect("nothing").is_empty());
}
