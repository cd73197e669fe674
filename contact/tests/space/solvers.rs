//! Compares the solvers with closed forms, with each other, and with conservation laws.

use crate::{layer, max_difference, peak};
use core::f64::consts::PI;
use taktil_contact::Accuracy;
use taktil_contact::space::Prescribed;
use taktil_contact::space::infinite::InfiniteIndenter;
use taktil_contact::space::pin::{Pin, PlanarPose, Profile};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::scene::{Pose, Scene, Shape};
use taktil_contact::space::sphere::Sphere;
use taktil_contact::space::surface::{Cells, Surface};
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};

/// 32 by 32 tactels on two inches: wide enough to hold a whole image.
const WIDE: Array = Array { rows: 32, cols: 32, pitch_mm: 1.5875 };

fn sum(array: &Array, image: &[f64]) -> f64 {
    image.iter().sum::<f64>() * array.pitch_mm * array.pitch_mm
}

#[test]
fn a_sphere_on_a_thick_layer_is_hertzs() {
    let (radius, t, nu) = (10.0, 1e5, 0.3);
    let layer = layer(t, nu);
    let mut sphere = Sphere::new(&layer, radius, Accuracy::Default).unwrap();
    // Shallow, so that the circle is its parabola.
    let delta = 1e-4;
    let state = sphere.press(Prescribed::PenetrationMm(delta)).unwrap();
    let modulus = layer.youngs_mpa / (1.0 - nu * nu);
    let wanted = 4.0 / 3.0 * modulus * (radius * delta * delta * delta).sqrt();
    assert!((state.force_n / wanted - 1.0).abs() < 1e-4, "{state:?} {wanted}");
    assert!((state.contact_radius_mm / (radius * delta).sqrt() - 1.0).abs() < 1e-4, "{state:?}");
}

#[test]
fn a_spheres_image_sums_to_its_force_and_stiffness_is_the_slope_of_force() {
    for (nu, t) in [(-0.5, 0.8), (0.0, 0.8), (0.3, 0.8), (0.49, 0.8), (0.5, 0.8), (0.49, 0.2)] {
        let mut sphere = Sphere::new(&layer(t, nu), 10.0, Accuracy::Fine).unwrap();
        let state = sphere.press(Prescribed::ForceN(5.0)).unwrap();
        let mut image = vec![0.0; WIDE.len()];
        sphere.image(&WIDE, Sampling::Area, [0.4, -0.3], &mut image).unwrap();
        let total = sum(&WIDE, &image);
        assert!((total + 5.0).abs() < 1e-6, "nu {nu}, t {t}: {total}");
        // Force given and penetration given are inverse to each other.
        let back = sphere.press(Prescribed::PenetrationMm(state.penetration_mm)).unwrap();
        assert!((back.force_n / 5.0 - 1.0).abs() < 1e-10, "{back:?}");
    }
}

#[test]
fn a_sphere_from_the_chart_agrees_with_the_solved_one() {
    // Thin and thick layers, small and very large spheres, and contacts beyond the chart.
    let cases = [(0.8, 10.0, 0.49), (3.0, 10.0, 0.5), (0.3, 45.0, 0.3), (1.0, 0.6, 0.0)];
    for (t, radius, nu) in cases.into_iter().chain([(0.8, 10.0, -0.5), (0.5, 2000.0, 0.499)]) {
        let layer = layer(t, nu);
        let mut read = Sphere::new(&layer, radius, Accuracy::Fast).unwrap();
        let mut solved = Sphere::new(&layer, radius, Accuracy::Default).unwrap();
        let deepest = (0.7 * t).min(0.3 * radius);
        let mut images = [[0.0; 256]; 2];
        for i in 1..=40 {
            let part = f64::from(i * i) / 1600.0;
            let delta = deepest * part * part;
            let exact = solved.press(Prescribed::PenetrationMm(delta)).unwrap();
            for drive in [Prescribed::PenetrationMm(delta), Prescribed::ForceN(exact.force_n)] {
                let state = read.press(drive).unwrap();
                let near = |got: f64, wanted: f64| (got / wanted - 1.0).abs() < 2e-5;
                let what = format!("{t} {radius} {nu} {drive:?}: {state:?} {exact:?}");
                assert!(near(state.force_n, exact.force_n), "{what}");
                assert!(near(state.penetration_mm, exact.penetration_mm), "{what}");
                assert!(near(state.contact_radius_mm, exact.contact_radius_mm), "{what}");
                assert!(state.residual < 2e-5, "{what}");
            }
            for (sphere, image) in [&read, &solved].into_iter().zip(&mut images) {
                sphere.image(&Array::THESIS, Sampling::Area, [0.3, -0.4], image).unwrap();
            }
            let off = super::max_difference(&images[0], &images[1]) / super::peak(&images[1]);
            assert!(off < 1e-3, "{t} {radius} {nu} {delta}: {off}");
        }
        read.press(Prescribed::PenetrationMm(0.0)).unwrap();
        read.image(&Array::THESIS, Sampling::Area, [0.0; 2], &mut images[0]).unwrap();
        assert_eq!((read.state(), images[0]), (Default::default(), [0.0; 256]));
    }
}

#[test]
fn cells_agree_with_the_sphere_and_converge() {
    let layer = layer(0.8, 0.49);
    let influence = Influence::new(&layer).unwrap();
    let shares = Shares::new(&influence, &Array::THESIS, Sampling::Area, Fineness::DEFAULT);
    let shares = shares.unwrap();
    let mut sphere = Sphere::new(&layer, 10.0, Accuracy::Default).unwrap();
    let exact = sphere.press(Prescribed::ForceN(5.0)).unwrap();
    let mut wanted = vec![0.0; 256];
    sphere.image(&Array::THESIS, Sampling::Area, [0.4, -0.3], &mut wanted).unwrap();
    for (spacing, bar) in [(0.2, 2e-2), (0.1, 2e-3), (0.05, 1e-3)] {
        let n = (2.4 / spacing) as usize;
        let cells = Cells { columns: n, rows: n, spacing_mm: spacing };
        let mut surface = Surface::new(&influence, &cells).unwrap();
        let heights: Vec<f64> = (0..n * n)
            .map(|cell| {
                let [x, y] = cells.place_mm(cell);
                10.0 - (100.0 - x * x - y * y).sqrt()
            })
            .collect();
        let state =
            surface.press(&heights, Prescribed::PenetrationMm(exact.penetration_mm)).unwrap();
        assert!((state.force_n / 5.0 - 1.0).abs() < bar, "{spacing}: {state:?}");
        assert!(state.residual <= 1e-6, "{spacing}: {state:?}");
        let mut image = vec![0.0; 256];
        surface.image(&shares, [0.4, -0.3], &mut image);
        assert!(max_difference(&image, &wanted) < bar * peak(&wanted), "{spacing}");
        // Complementarity, by the pressures themselves.
        for (pressure, height) in surface.pressure_mpa().iter().zip(&heights) {
            assert!(*pressure >= 0.0);
            assert!(*pressure == 0.0 || *height < exact.penetration_mm);
        }
        let by_force = surface.press(&heights, Prescribed::ForceN(5.0)).unwrap();
        assert!((by_force.force_n - 5.0).abs() < 1e-9, "{by_force:?}");
        let off = by_force.penetration_mm / exact.penetration_mm - 1.0;
        assert!(off.abs() < bar, "{spacing}: {by_force:?}");
    }
}

/// A body with an edge is moved by jumps: cells that it has left carry no pressure.
#[test]
fn a_body_on_cells_may_move() {
    let layer = layer(0.8, 0.49);
    let influence = Influence::new(&layer).unwrap();
    let cells = Cells { columns: 40, rows: 30, spacing_mm: 0.1 };
    let heights = |at: [f64; 2]| -> Vec<f64> {
        let height = |cell: usize| {
            let [x, y] = cells.place_mm(cell);
            let (u, v) = (x - at[0], y - at[1]);
            if u.abs() < 0.36 && v.abs() < 0.51 { 0.05 * u * u } else { f64::INFINITY }
        };
        (0..40 * 30).map(height).collect()
    };
    let mut warm = Surface::new(&influence, &cells).unwrap();
    let mut seed = 5_u64;
    let mut draw = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (seed >> 33) as f64 / (1_u64 << 31) as f64
    };
    for n in 0..60 {
        let body = heights([2.0 * draw() - 1.0, 1.2 * draw() - 0.6]);
        let drive = match n % 2 {
            0 => Prescribed::PenetrationMm(0.02 + 0.05 * draw()),
            _ => Prescribed::ForceN(1.0 + 4.0 * draw()),
        };
        let moved = warm.press(&body, drive).expect("a contact");
        let state = Surface::new(&influence, &cells).unwrap().press(&body, drive).unwrap();
        assert!((moved.force_n / state.force_n - 1.0).abs() < 1e-5, "{n}: {moved:?} {state:?}");
        let off = moved.penetration_mm / state.penetration_mm - 1.0;
        assert!(off.abs() < 1e-5, "{n}: {moved:?} {state:?}");
        for (pressure, height) in warm.pressure_mpa().iter().zip(&body) {
            assert!(*pressure == 0.0 || height.is_finite(), "{n}: {pressure} in the air");
        }
    }
}

#[test]
fn cells_agree_with_a_tilted_pin() {
    let layer = layer(0.8, 0.45);
    let influence = Influence::new(&layer).unwrap();
    let (radius, length, delta, tilt) = (8.0, 6.0, 0.02, 0.004);
    let profile = Profile::Cylinder { radius_mm: radius };
    let ends = [-0.5 * length, 0.5 * length];
    let mut pin = Pin::new(&layer, profile, ends, 0.05, Accuracy::Default).unwrap();
    let state = pin.press(Prescribed::PenetrationMm(delta), tilt).unwrap();
    // The pin's ends stand between cells: 60 cells of 0.1 mm.
    let cells = Cells { columns: 32, rows: 64, spacing_mm: 0.1 };
    let mut surface = Surface::new(&influence, &cells).unwrap();
    let heights: Vec<f64> = (0..32 * 64)
        .map(|cell| {
            let [u, v] = cells.place_mm(cell);
            if v.abs() > 0.5 * length {
                return f64::INFINITY;
            }
            radius - (radius * radius - u * u).sqrt() - v * libm::tan(tilt)
        })
        .collect();
    let other = surface.press(&heights, Prescribed::PenetrationMm(delta)).unwrap();
    // The cells lose about 0.17 of a cell at each end.
    let off = state.force_n / other.force_n - 1.0;
    assert!(off.abs() < 1.2e-2, "{state:?} {other:?}");
    let moment: f64 = surface
        .pressure_mpa()
        .iter()
        .enumerate()
        .map(|(cell, p)| p * 0.01 * cells.place_mm(cell)[1])
        .sum();
    assert!((state.moment_n_mm / moment - 1.0).abs() < 2e-2, "{state:?} {moment}");
}

#[test]
fn halving_the_slices_changes_little() {
    for (nu, t, radius, length) in
        [(0.3, 0.8, 23.0, 20.0), (0.49, 2.0, 10.0, 15.0), (0.5, 0.5, 30.0, 12.0)]
    {
        let layer = layer(t, nu);
        let profile = Profile::Cylinder { radius_mm: radius };
        let ends = [-0.5 * length, 0.5 * length];
        let press = |level| {
            let mut pin = Pin::new(&layer, profile, ends, 0.1 * t, level).unwrap();
            pin.press(Prescribed::PenetrationMm(0.04 * t), 0.001).unwrap()
        };
        let (coarse, fine) = (press(Accuracy::Default), press(Accuracy::Fine));
        let off = coarse.force_n / fine.force_n - 1.0;
        assert!(off.abs() < 1e-3, "nu {nu}, t {t}: {off:e}");
    }
}

#[test]
fn a_pin_far_from_its_ends_is_the_infinite_cylinder() {
    let layer = layer(0.8, 0.49);
    let at = |length_mm| {
        let shape = Shape::Cylinder { radius_mm: 23.0, length_mm };
        let array = Array { rows: 4, cols: 16, pitch_mm: 1.5875 };
        let mut scene =
            Scene::new(&layer, shape, &array, Sampling::Area, Accuracy::Default).unwrap();
        let planar = PlanarPose { x_mm: 0.3, y_mm: 0.0, rot_rad: 0.2 };
        scene.press(Prescribed::PenetrationMm(0.02), Pose { planar, tilt_rad: 0.0 }).unwrap();
        let mut image = vec![0.0; array.len()];
        scene.image(&mut image).unwrap();
        image
    };
    let (long, endless) = (at(Some(40.0)), at(None));
    assert!(max_difference(&long, &endless) < 2e-4 * peak(&endless));
}

/// A piece added to a long pin carries the load per length of the infinite one. Incompressible
/// rubber is nearly rigid under a contact many thicknesses wide, so that distant slices matter
/// most.
#[test]
fn a_piece_added_to_a_pin_carries_the_load_of_the_infinite_one() {
    let cylinder = Profile::Cylinder { radius_mm: 45.0 };
    for (profile, depth, level, within) in [
        (cylinder, 0.25, Accuracy::Fast, 8e-3),
        (cylinder, 0.25, Accuracy::Default, 2e-4),
        (Profile::Bar { width_mm: 2.0 }, 0.05, Accuracy::Default, 1e-4),
    ] {
        let layer = layer(0.3, 0.5);
        let delta = Prescribed::PenetrationMm(0.3 * depth);
        let force = |half: f64| {
            let pin = Pin::new(&layer, profile, [-half, half], 0.45 * depth, level);
            pin.expect("a pin").press(delta, 0.0).expect("a contact").force_n
        };
        let added = (force(20.0) - force(14.0)) / 12.0;
        let mut endless = InfiniteIndenter::new(&layer, profile, 0.45 * depth).expect("a line");
        let wanted = endless.press(delta).expect("a contact").force_n_mm;
        let off = added / wanted - 1.0;
        assert!(off.abs() < within, "{profile:?} {level:?}: {added} {wanted} {off:e}");
    }
}

#[test]
fn a_flat_bar_has_the_plane_stiffness_and_its_force_on_the_base() {
    // Indentation per line load of a bar 12.7 mm wide, from the plane reference.
    for (nu, wanted) in [(0.49, 1.987_141e-4), (0.495, 1.34e-4), (0.4999, 6.7e-5)] {
        let shape = Shape::Bar { width_mm: 12.7, length_mm: None };
        let layer = layer(0.8, nu);
        let mut scene =
            Scene::new(&layer, shape, &Array::THESIS, Sampling::Area, Accuracy::Default).unwrap();
        let touch = scene.press(Prescribed::ForceN(1.96), Pose::default()).unwrap();
        let off = touch.penetration_mm.unwrap() / 1.96 / wanted - 1.0;
        assert!(off.abs() < if nu == 0.49 { 1e-6 } else { 6e-3 }, "nu {nu}: {off:e}");
        let mut image = vec![0.0; 256];
        scene.image(&mut image).unwrap();
        let along = sum(&Array::THESIS, &image) / (16.0 * 1.5875);
        assert!((along / -1.96 - 1.0).abs() < 1e-3, "nu {nu}: {along}");
    }
    let shape = Shape::Bar { width_mm: 6.35, length_mm: Some(12.0) };
    let layer = layer(0.8, 0.49);
    let mut scene = Scene::new(&layer, shape, &WIDE, Sampling::Area, Accuracy::Default).unwrap();
    let touch = scene.press(Prescribed::ForceN(20.0), Pose::default()).unwrap();
    assert!((touch.force_n / 20.0 - 1.0).abs() < 2e-4, "{touch:?}");
    let mut image = vec![0.0; WIDE.len()];
    scene.image(&mut image).unwrap();
    assert!((sum(&WIDE, &image) / -20.0 - 1.0).abs() < 1e-3);
}

#[test]
fn an_edge_is_the_line_load() {
    let layer = layer(0.8, 0.49);
    let shape = Shape::Edge { length_mm: None };
    let mut scene =
        Scene::new(&layer, shape, &Array::THESIS, Sampling::Centre, Accuracy::Fine).unwrap();
    let planar = PlanarPose { x_mm: 0.25, y_mm: 1.0, rot_rad: 0.3 };
    scene.press(Prescribed::ForceN(0.5), Pose { planar, tilt_rad: 0.0 }).unwrap();
    let mut image = vec![0.0; 256];
    scene.image(&mut image).unwrap();
    for (n, value) in image.iter().enumerate() {
        let x = Array::THESIS.x_mm(n % 16) - 0.25;
        let y = Array::THESIS.y_mm(n / 16) - 1.0;
        let wanted = 0.5 * layer.base_szz_line(x * libm::cos(0.3) + y * libm::sin(0.3));
        assert!((value - wanted).abs() < 2e-6, "{n}: {value} {wanted}");
    }
    let shape = Shape::Edge { length_mm: Some(8.0) };
    let mut scene = Scene::new(&layer, shape, &WIDE, Sampling::Area, Accuracy::Default).unwrap();
    scene.press(Prescribed::ForceN(3.0), Pose::default()).unwrap();
    let mut image = vec![0.0; WIDE.len()];
    scene.image(&mut image).unwrap();
    assert!((sum(&WIDE, &image) / -3.0 - 1.0).abs() < 1e-4);
}

#[test]
fn a_half_turn_mirrors_the_image() {
    let layer = layer(0.8, 0.49);
    let shape = Shape::Cylinder { radius_mm: 23.0, length_mm: Some(30.0) };
    let mut scene =
        Scene::new(&layer, shape, &Array::THESIS, Sampling::Area, Accuracy::Default).unwrap();
    let mut at = |rot_rad: f64, tilt_rad: f64| {
        let planar = PlanarPose { x_mm: 0.0, y_mm: 0.0, rot_rad };
        scene.release();
        scene.press(Prescribed::PenetrationMm(0.03), Pose { planar, tilt_rad }).unwrap();
        let mut image = vec![0.0; 256];
        scene.image(&mut image).unwrap();
        image
    };
    let (one, other) = (at(0.3, 0.001), at(0.3 + PI, 0.001));
    let turned: Vec<f64> = other.iter().rev().copied().collect();
    assert!(max_difference(&one, &turned) < 1e-6 * peak(&one));
    let (one, other) = (at(0.3, 0.001), at(0.3, -0.001));
    let turned: Vec<f64> = other.iter().rev().copied().collect();
    assert!(max_difference(&one, &turned) < 2e-4 * peak(&one));
}
