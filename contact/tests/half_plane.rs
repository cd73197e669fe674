//! Tests the closed forms of the half plane: each formula of the thesis that had to be corrected is
//! shown to fail where the correction holds.

use core::f64::consts::PI;
use taktil_contact::field::LineLoad;
use taktil_contact::half_plane::{
    Stresses, cylinder_half_width_mm, cylinder_pressure_mpa, cylinder_stresses,
    displacements_from_moments, line_displacements, line_moments, line_peak_mm, line_stresses,
    punch_pressure_mpa, punch_stresses,
};
use taktil_contact::layer::Layer;

const POINTS_MM: [[f64; 2]; 6] =
    [[0.3, 0.4], [-1.2, 0.8], [2.0, 0.1], [0.0, 1.0], [-0.9, 2.5], [1.0, 0.3]];

fn rubber() -> Layer {
    Layer::new(1.0, 27.58, 0.49).expect("a material")
}

fn load(p_n_mm: f64, q_n_mm: f64) -> LineLoad {
    LineLoad { p_n_mm, q_n_mm }
}

/// Hooke's law on numerical strains of a displacement field (along x, down).
fn hooke(u: &dyn Fn(f64, f64) -> [f64; 2], x: f64, z: f64) -> [f64; 3] {
    let material = rubber();
    let h = 1e-4;
    // Fourth order central differences.
    let slope =
        |f: &dyn Fn(f64) -> f64| (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h);
    let exx = slope(&|d| u(x + d, z)[0]);
    let ezz = slope(&|d| u(x, z + d)[1]);
    let shear = slope(&|d| u(x, z + d)[0]) + slope(&|d| u(x + d, z)[1]);
    let g = material.shear_mpa();
    let lame = 2.0 * g * material.poisson / (1.0 - 2.0 * material.poisson);
    [2.0 * g * exx + lame * (exx + ezz), 2.0 * g * ezz + lame * (exx + ezz), g * shear]
}

#[test]
fn displacements_give_the_stresses_and_the_printed_ones_do_not() {
    for load in [load(0.7, 0.0), load(0.0, 0.4), load(0.7, -0.4)] {
        for [x, z] in POINTS_MM {
            let exact = line_stresses(&load, x, z);
            let wanted = [exact.sxx_mpa, exact.szz_mpa, -exact.sxz_mpa];
            let ours = |x: f64, z: f64| line_displacements(&rubber(), &load, x, z, 10.0);
            let found = hooke(&ours, x, z);
            for (found, wanted) in found.iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-8, "{x} {z}: {found} {wanted}");
            }
            if load.q_n_mm == 0.0 || x == 0.0 {
                continue;
            }
            // A.14 as printed: + z^2/r^2.
            let scale = (1.0 + 0.49) / (PI * 27.58);
            let printed = |x: f64, z: f64| {
                let [along, down] = ours(x, z);
                let r2 = x * x + z * z;
                [along + scale * load.q_n_mm * (z * z - x * x) / r2, down]
            };
            let wrong = hooke(&printed, x, z);
            let off = (0..3).map(|k| (wrong[k] - wanted[k]).abs()).fold(0.0, f64::max);
            assert!(off > 1e-3, "{x} {z}: {off:e}");
        }
    }
}

/// Sum of line loads under a pressure; the substitution x = a sin t removes the singularities at
/// its edges.
fn superposed(pressure: &dyn Fn(f64) -> f64, a: f64, x: f64, z: f64) -> Stresses {
    let count = 4000;
    let mut sum = Stresses::default();
    for i in 0..count {
        let t = PI * ((f64::from(i) + 0.5) / f64::from(count) - 0.5);
        let (s, c) = libm::sincos(t);
        let part = pressure(a * s) * a * c * PI / f64::from(count);
        let one = line_stresses(&load(part, 0.0), x - a * s, z);
        sum.szz_mpa += one.szz_mpa;
        sum.sxx_mpa += one.sxx_mpa;
        sum.sxz_mpa += one.sxz_mpa;
    }
    sum
}

fn near(a: Stresses, b: Stresses) {
    for (a, b) in [(a.szz_mpa, b.szz_mpa), (a.sxx_mpa, b.sxx_mpa), (a.sxz_mpa, b.sxz_mpa)] {
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
}

/// r1, r2, r and the angles t1, t2, t from +z.
fn polar(a: f64, x: f64, z: f64) -> [f64; 6] {
    let (r1, r2) = (libm::hypot(x - a, z), libm::hypot(x + a, z));
    [r1, r2, libm::hypot(x, z), libm::atan2(x - a, z), libm::atan2(x + a, z), libm::atan2(x, z)]
}

#[test]
fn a_17_wants_three_halves() {
    let (a, p) = (1.3, 0.9);
    for [x, z] in POINTS_MM {
        let exact = punch_stresses(p, a, x, z);
        near(exact, superposed(&|s| punch_pressure_mpa(p, a, s), a, x, z));
        let [r1, r2, r, t1, t2, t] = polar(a, x, z);
        let with = |angle: f64| {
            let first = libm::cos(0.5 * (t1 + t2)) / (r1 * r2).sqrt();
            let cube = (r1 * r2).sqrt() * r1 * r2;
            -p / PI * (first + r * r / cube * libm::cos(t) * libm::cos(t - angle * (t1 + t2)))
        };
        assert!((with(1.5) - exact.szz_mpa).abs() < 1e-13, "{x} {z}");
        let wrong = (with(0.5) / exact.szz_mpa - 1.0).abs();
        assert!(x == 0.0 || wrong > 0.005, "{x} {z}: {wrong}");
        assert!(exact.szz_mpa < 0.0);
    }
}

#[test]
fn a_20_wants_a_minus_and_no_third_term() {
    let (a, p) = (1.3, 0.9);
    for [x, z] in POINTS_MM {
        let exact = cylinder_stresses(p, a, x, z);
        near(exact, superposed(&|s| cylinder_pressure_mpa(p, a, s), a, x, z));
        let [r1, r2, r, t1, t2, t] = polar(a, x, z);
        let root = (r1 * r2).sqrt();
        let first = root * libm::cos(0.5 * (t1 + t2));
        let second = r * r / root * libm::cos(t) * libm::cos(t - 0.5 * (t1 + t2));
        let scale = -2.0 * p / (PI * a * a);
        // The printed formula seems to be the stress along x.
        let printed = scale * (first + second - 2.0 * r * libm::cos(t));
        assert!((printed - exact.sxx_mpa).abs() < 1e-12, "{x} {z}");
        assert!((printed - exact.szz_mpa).abs() > 1e-3, "{x} {z}");
        assert!((scale * (first - second) - exact.szz_mpa).abs() < 1e-12, "{x} {z}");
    }
}

#[test]
fn pressures_carry_their_loads_and_hertz_fits_its_circle() {
    let (a, p) = (0.7, 1.9);
    for pressure in [punch_pressure_mpa, cylinder_pressure_mpa] {
        let count = 2000;
        let sum: f64 = (0..count)
            .map(|i| {
                let t = PI * ((f64::from(i) + 0.5) / f64::from(count) - 0.5);
                pressure(p, a, a * libm::sin(t)) * a * libm::cos(t) * PI / f64::from(count)
            })
            .sum();
        assert!((sum - p).abs() < 1e-6, "{sum}");
        assert_eq!(pressure(p, a, 1.01 * a), 0.0);
    }
    // The surface's slope under Hertz's pressure is x/R: A.15 differentiated, superposed.
    let (radius, load_n_mm) = (25.4, 0.7);
    let half = cylinder_half_width_mm(&rubber(), radius, load_n_mm);
    let down = |x: f64| -> f64 {
        (0..20_000)
            .map(|i| {
                let t = PI * ((f64::from(i) + 0.5) / 20_000.0 - 0.5);
                let s = half * libm::sin(t);
                let part = cylinder_pressure_mpa(load_n_mm, half, s) * half * libm::cos(t);
                let one = load(part * PI / 20_000.0, 0.0);
                line_displacements(&rubber(), &one, x - s, 1e-9, 1.0)[1]
            })
            .sum()
    };
    let fall = down(0.0) - down(0.5 * half);
    let circle = 0.25 * half * half / (2.0 * radius);
    assert!((fall / circle - 1.0).abs() < 1e-3, "{fall} {circle}");
}

#[test]
fn moments_peak_and_inversion() {
    let (line, z) = (load(0.175, 0.0876), 0.8);
    let step = 0.01;
    let sum = |of: &dyn Fn(f64) -> f64| -> f64 {
        (-4_000_000..4_000_000_i32).map(|i| of((f64::from(i) + 0.5) * step) * step).sum()
    };
    let szz = |x: f64| line_stresses(&line, x, z).szz_mpa;
    let [m0, m1] = line_moments(&line, z);
    assert!((sum(&szz) - m0).abs() < 1e-6);
    // Its tail falls as 1/x^2: 2/pi Q z^2 2/X are missing.
    assert!((sum(&|x| x * szz(x)) - m1).abs() < 1e-5);
    let x = line_peak_mm(&line, z);
    assert!(szz(x) < szz(x + 1e-4) && szz(x) < szz(x - 1e-4));
    assert_eq!(line_peak_mm(&load(1.0, 0.0), z), 0.0);
    let printed = z * ((4.0 * 0.175_f64 * 0.175 + 3.0 * 0.0876 * 0.0876).sqrt() - 0.35);
    assert!((x - printed / (3.0 * 0.0876)).abs() < 1e-12);
    // 4.1 and 4.2 are A.14 and A.15 under x = 0 with the loads taken from the moments, nu = 0.5.
    let soft = Layer::new(1.0, 27.58, 0.5).expect("a material");
    let found = displacements_from_moments(&soft, [m0, m1], z, 10.0);
    let exact = line_displacements(&soft, &line, 0.0, z, 10.0);
    for (found, exact) in found.iter().zip(exact) {
        assert!((found - exact).abs() < 1e-15, "{found} {exact}");
    }
}
