//! Compares the influence of loads with direct Hankel integrals, the half space, the plane problem
//! and equilibrium.

use crate::{E_MPA, layer};
use core::f64::consts::PI;
use taktil_contact::layer::Layer;
use taktil_contact::space::radial::Influence;

fn influence(t: f64, nu: f64) -> Influence {
    Influence::new(&layer(t, nu)).expect("a sound layer")
}

/// Integral of f over (0, end) by Gauss's two points on many pieces.
fn integral(end: f64, pieces: usize, f: impl Fn(f64) -> f64) -> f64 {
    let h = end / pieces as f64;
    let offset = 0.5 / 3.0_f64.sqrt();
    let piece = |n: usize| {
        let middle = n as f64 + 0.5;
        0.5 * h * (f(h * (middle - offset)) + f(h * (middle + offset)))
    };
    (0..pieces).map(piece).sum()
}

#[test]
fn kernels_are_the_hankel_transforms_of_the_transfer_functions() {
    for nu in [0.2, 0.3, 0.49, 0.4999, 0.499_999, 0.5] {
        let (t, layer) = (0.8, layer(0.8, nu));
        let found = Influence::new(&layer).expect("a sound layer");
        let transfer = layer.transfer();
        let compliance = (1.0 - nu) / (2.0 * PI * layer.shear_mpa());
        for r in [0.0, 0.1, 0.5, 1.0, 2.3, 6.0, 11.0] {
            let base = integral(45.0, 9000, |a| a * transfer.base_normal(a) * libm::j0(a * r / t));
            let wanted = -base / (2.0 * PI * t * t);
            let off = (found.base_point(r) - wanted).abs() * t * t;
            assert!(off < 1e-8, "base, nu {nu}, r {r}: {off:e}");
            if r > 0.0 {
                let rest = integral(25.0, 9000, |a| {
                    (a * transfer.normal_compliance(a) - 1.0) * libm::j0(a * r / t)
                });
                let wanted = compliance / t * (t / r + rest);
                let off = (found.surface_point(r) - wanted).abs() * t / compliance;
                assert!(off < 2e-7, "surface, nu {nu}, r {r}: {off:e}");
            }
        }
    }
}

#[test]
fn a_thick_layer_is_the_half_space_of_boussinesq_and_love() {
    let (t, nu) = (1e5, 0.3);
    let found = influence(t, nu);
    let layer = layer(t, nu);
    let boussinesq = |r: f64| (1.0 - nu) / (2.0 * PI * layer.shear_mpa() * r);
    for r in [1e-6, 0.1, 1.0, 10.0] {
        let off = found.surface_point(r) / boussinesq(r) - 1.0;
        // What the finite depth takes away is of the order of r/t.
        assert!(off.abs() < 2.0 * r / t + 1e-12, "{r}: {off:e}");
    }
    // Love: the middle of a uniformly loaded square of side 2a sinks by 2 a p (1 - nu)/(pi G)
    // times 2 ln(1 + sqrt 2).
    let a = 0.5;
    let wanted = 4.0 * a * (1.0 - nu) / (PI * layer.shear_mpa()) * libm::log(1.0 + 2.0_f64.sqrt());
    let off = found.surface_cell([0.0; 2], [a; 2]) / wanted - 1.0;
    assert!(off.abs() < 1e-4, "{off:e}");
    // Far away, a cell acts as a point load.
    let far = found.surface_cell([30.0, 4.0], [a; 2]);
    let off = far / (4.0 * a * a * found.surface_point((900.0_f64 + 16.0).sqrt())) - 1.0;
    assert!(off.abs() < 1e-3, "{off:e}");
}

#[test]
fn cells_are_integrals_of_the_point_load() {
    let found = influence(0.8, 0.49);
    for place in [[1.1, 0.4], [3.0, -2.0], [0.2, 0.9]] {
        let half = [0.15, 0.25];
        let (mut surface, mut base) = (0.0, 0.0);
        let n = 60;
        for k in 0..n * n {
            let along = |i: usize, h: f64| h * ((2 * i + 1) as f64 / n as f64 - 1.0);
            let x = place[0] - along(k % n, half[0]);
            let y = place[1] - along(k / n, half[1]);
            let r = (x * x + y * y).sqrt();
            let area = 4.0 * half[0] * half[1] / (n * n) as f64;
            surface += area * found.surface_point(r);
            base += area * found.base_point(r);
        }
        let cell = found.surface_cell(place, half);
        assert!((cell / surface - 1.0).abs() < 1e-4, "{place:?}: {cell} {surface}");
        let cell = found.base_cell(place, half);
        assert!((cell / base - 1.0).abs() < 2e-4, "{place:?}: {cell} {base}");
    }
}

#[test]
fn the_base_carries_the_load_and_projects_to_the_plane_problem() {
    for nu in [0.3, 0.49, 0.5] {
        for t in [0.05, 0.8, 12.7] {
            let (found, layer) = (influence(t, nu), layer(t, nu));
            let total = integral(30.0 * t, 3000, |r| 2.0 * PI * r * found.base_point(r));
            assert!((total + 1.0).abs() < 1e-8, "nu {nu}, t {t}: {total}");
            for x in [0.0, 0.7 * t, 2.0 * t] {
                let line =
                    2.0 * integral(30.0 * t, 3000, |y| found.base_point((x * x + y * y).sqrt()));
                let off = (line - layer.base_szz_line(x)).abs() * t;
                assert!(off < 1e-8, "nu {nu}, t {t}, x {x}: {off:e}");
            }
        }
    }
}

#[test]
fn kernels_are_finite_everywhere_and_continuous_at_one_half() {
    let near: Vec<Influence> =
        [0.499_999, 0.499_999_999, 0.5].iter().map(|nu| influence(0.8, *nu)).collect();
    for r in [1e-300, 1e-9, 0.3, 5.0, 31.9, 32.1, 1e3, 1e9, 1e300] {
        let [a, b, c] = [0, 1, 2].map(|i| near[i].surface_point(r));
        assert!(a.is_finite() || r < 1e-290, "{r}: {a}");
        let size = c.abs() + 1e-3 * near[2].surface_point(1.0).abs();
        assert!((b - c).abs() < 1e-7 * size || r < 1e-290, "{r}: {b} {c}");
        let [a, b, c] = [0, 1, 2].map(|i| near[i].base_point(r));
        assert!(a.is_finite() && (b - c).abs() < 1e-8, "{r}: {b} {c}");
    }
    assert!(near[0].surface_point(f64::NAN).is_nan());
    assert_eq!(near[0].base_point(f64::NAN), 0.0);
    for bad in [f64::NAN, 0.0, -0.8, f64::INFINITY] {
        let layer = Layer { thickness_mm: bad, youngs_mpa: E_MPA, poisson: 0.49 };
        assert_eq!(Influence::new(&layer).expect_err("refused").place, "thickness_mm");
    }
    let layer = Layer { thickness_mm: 0.8, youngs_mpa: E_MPA, poisson: 0.500_1 };
    assert_eq!(Influence::new(&layer).expect_err("refused").place, "poisson");
}
