//! Tests tangential loads in three dimensions: Cerruti's half space, the plane problem as a sum
//! along a line, equilibrium of the base, cells compared with points, and a sphere with friction.

use crate::layer;
use taktil_contact::features::Part;
use taktil_contact::field::{LineLoad, line};
use taktil_contact::space::Prescribed;
use taktil_contact::space::radial::Influence;
use taktil_contact::space::shear::{Shear, TangentialLoad};
use taktil_contact::space::surface::{Cells, Surface};
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};

#[test]
fn on_a_very_thick_layer_it_is_cerrutis_half_space() {
    for nu in [0.2, 0.49, 0.5] {
        let thick = layer(2000.0, nu);
        let shear = Shear::new(&thick).unwrap();
        let unit = 1.0 / (2.0 * core::f64::consts::PI * thick.shear_mpa());
        for [x, y] in [[1.0_f64, 0.0], [0.6, -0.8], [-0.3, 1.2], [0.0, 0.7]] {
            let r = (x * x + y * y).sqrt();
            let wanted = [
                unit * ((1.0 - nu) + nu * x * x / (r * r)) / r,
                unit * nu * x * y / (r * r * r),
                unit * 0.5 * (1.0 - 2.0 * nu) * x / (r * r),
            ];
            for (found, wanted) in shear.surface_point([x, y]).iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-3 * unit / r, "{nu} {x} {y}: {found} {wanted}");
            }
        }
    }
}

#[test]
fn a_line_of_loads_is_the_plane_problem() {
    let load = LineLoad { p_n_mm: 0.0, q_n_mm: 1.0 };
    for (t, nu) in [(0.8, 0.49), (0.8, 0.5), (2.0, 0.3)] {
        let layer = layer(t, nu);
        let shear = Shear::new(&layer).unwrap();
        for x in [0.3 * t, -0.9 * t, 2.5 * t] {
            let (mut base, mut moved) = (0.0, [0.0; 3]);
            let step = 0.02 * t;
            for i in -2100..=2100 {
                let place = [x, f64::from(i) * step];
                base += step * shear.base_point(place);
                for (sum, u) in moved.iter_mut().zip(shear.surface_point(place)) {
                    *sum += step * u;
                }
            }
            let at_base = line(&layer, &load, t, &[x]).unwrap()[0].szz_mpa.unwrap();
            assert!((base - at_base).abs() < 1e-9 / t, "{t} {nu} {x}: {base} {at_base}");
            let surface = line(&layer, &load, 0.0, &[x]).unwrap()[0];
            let wanted = [surface.ux_mm.unwrap(), 0.0, -surface.uz_mm.unwrap()];
            let size = 1.0 / layer.shear_mpa();
            for (k, (found, wanted)) in moved.iter().zip(wanted).enumerate() {
                assert!((found - wanted).abs() < 1e-9 * size, "{nu} {x} {k}: {found} {wanted}");
            }
        }
    }
}

#[test]
fn the_base_carries_the_moment_of_the_load_and_nothing_else() {
    for (t, nu) in [(0.8, 0.49), (1.3, 0.5), (0.5, 0.2)] {
        let shear = Shear::new(&layer(t, nu)).unwrap();
        let step = 0.125 * t;
        let (mut force, mut moments) = (0.0, [0.0; 2]);
        for i in -318..=318 {
            for j in -318..=318 {
                let [x, y] = [f64::from(i) * step, f64::from(j) * step];
                let part = step * step * shear.base_point([x, y]);
                force += part;
                moments[0] += x * part;
                moments[1] += y * part;
            }
        }
        assert!(force.abs() < 1e-12 && moments[1].abs() < 1e-12, "{force} {moments:?}");
        assert!((moments[0] + t).abs() < 1e-10, "{t} {nu}: {:e}", moments[0] + t);
    }
}

#[test]
fn cells_are_sums_of_their_parts() {
    let shear = Shear::new(&layer(0.8, 0.45)).unwrap();
    for place in [[0.0, 0.0], [0.03, -0.02], [0.4, 0.1], [-1.7, 2.0]] {
        let half = [0.2, 0.15];
        let whole = shear.surface_cell(place, half);
        let mut parts = [0.0; 3];
        let mut base = 0.0;
        for [i, j] in [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]] {
            let seen = [place[0] - i * 0.1, place[1] - j * 0.075];
            for (sum, u) in parts.iter_mut().zip(shear.surface_cell(seen, [0.1, 0.075])) {
                *sum += u;
            }
            base += shear.base_cell(seen, [0.1, 0.075]);
        }
        for (a, b) in whole.iter().zip(parts) {
            assert!((a - b).abs() < 1e-8 * whole[0].abs(), "{place:?}: {whole:?} {parts:?}");
        }
        assert!((shear.base_cell(place, half) - base).abs() < 1e-7, "{place:?}");
    }
    // A small cell from afar is a point.
    let (point, cell) =
        (shear.surface_point([0.9, 0.5]), shear.surface_cell([0.9, 0.5], [0.01; 2]));
    for (p, c) in point.iter().zip(cell) {
        assert!((c / 4e-4 - p).abs() < 1e-3 * point[0].abs(), "{point:?} {cell:?}");
    }
}

#[test]
fn a_sphere_with_friction_presses_more_on_its_leading_side() {
    let rubber = layer(0.8, 0.4);
    let (influence, shear) = (Influence::new(&rubber).unwrap(), Shear::new(&rubber).unwrap());
    let cells = Cells { columns: 31, rows: 31, spacing_mm: 0.1 };
    let mut surface = Surface::new(&influence, &cells).unwrap();
    let heights: Vec<f64> = (0..31 * 31)
        .map(|n| {
            let [x, y] = cells.place_mm(n);
            (x * x + y * y) / 20.0
        })
        .collect();
    let drive = Prescribed::ForceN(1.0);
    let plain = surface.press(&heights, drive).unwrap();
    let mut run = |ratio: f64| {
        let state = shear.press(&mut surface, &heights, drive, ratio).unwrap();
        let pressure = surface.pressure_mpa().to_vec();
        let place: f64 = pressure.iter().enumerate().map(|(n, p)| p * cells.place_mm(n)[0]).sum();
        (state, place * 0.01 / state.force_n, pressure)
    };
    let (still, at, _) = run(0.0);
    assert!((still.penetration_mm / plain.penetration_mm - 1.0).abs() < 1e-5 && at.abs() < 1e-6);
    let (ahead, forward, pressure) = run(0.5);
    let (_, back, _) = run(-0.5);
    assert!((ahead.force_n - 1.0).abs() < 1e-9, "{ahead:?}");
    // The surface sinks ahead of the load: the contact moves back, mirrored for the other way.
    assert!(forward < -1e-4 && (forward + back).abs() < 1e-4, "{forward} {back}");
    // The base's moment is that of the pressure and of t Q, summed over a grid.
    let loads: Vec<([f64; 2], f64)> = (0..31 * 31)
        .map(|n| (cells.place_mm(n), 0.01 * pressure[n]))
        .filter(|l| l.1 > 0.0)
        .collect();
    let rubbing: Vec<TangentialLoad> = loads
        .iter()
        .map(|(place_mm, p)| TangentialLoad { place_mm: *place_mm, force_n: [0.5 * p, 0.0] })
        .collect();
    let step = 0.3;
    let mut moment = 0.0;
    for i in -40..=40 {
        for j in -40..=40 {
            let at = [f64::from(i) * step, f64::from(j) * step];
            moment += step * step * at[0] * shear.base_szz_mpa(at, &rubbing);
        }
    }
    assert!((moment + 0.8 * 0.5).abs() < 1e-4, "{moment}");
    assert!(shear.press(&mut surface, &heights, drive, f64::NAN).is_err());
}

#[test]
fn the_image_of_a_sheared_contact_carries_its_force_and_its_moment() {
    let rubber = layer(0.8, 0.49);
    let (influence, shear) = (Influence::new(&rubber).unwrap(), Shear::new(&rubber).unwrap());
    let array = Array { rows: 15, cols: 17, pitch_mm: 1.1 };
    let [normal, along] = [
        Shares::new(&influence, &array, Sampling::Area, Fineness::FINE).unwrap(),
        Shares::sheared(&shear, &array, Sampling::Area, Fineness::FINE).unwrap(),
    ];
    // One load, off the middle of its tactel: tactel means of the point's own field.
    let (place, q) = ([0.37, -0.21], 1.7);
    let mut image = vec![0.0; array.len()];
    along.add(&mut image, place, q);
    let largest = image.iter().fold(0.0_f64, |most, s| most.max(s.abs()));
    let (mut force, mut moment) = (0.0, 0.0);
    for (n, szz) in image.iter().enumerate() {
        let [x, y] = [array.x_mm(n % array.cols), array.y_mm(n / array.cols)];
        let cell = q * shear.base_cell([x - place[0], y - place[1]], [0.55; 2]) / 1.21;
        assert!((szz - cell).abs() < 1e-6 * largest, "{n}: {szz} {cell}");
        force += 1.21 * szz;
        moment += 1.21 * szz * x;
    }
    // A tactel's mean stands for its middle, which costs two percent of the moment.
    assert!(force.abs() < 1e-3 && (moment / (-0.8 * q) - 1.0).abs() < 0.03, "{force} {moment}");
    // A ball that rubs to the right is pressed ahead and lifted behind.
    let cells = Cells { columns: 31, rows: 31, spacing_mm: 0.1 };
    let mut surface = Surface::new(&influence, &cells).unwrap();
    let ball = |n: usize| cells.place_mm(n).iter().map(|x| x * x / 20.0).sum();
    let heights: Vec<f64> = (0..31 * 31).map(ball).collect();
    let state = shear.press(&mut surface, &heights, Prescribed::ForceN(1.0), 0.5).unwrap();
    let mut whole = vec![0.0; array.len()];
    surface.image(&normal, [0.0; 2], &mut whole);
    let still = whole.clone();
    surface.image_of(&along, [0.0; 2], 0.5, &mut whole);
    let sum = |image: &[f64]| 1.21 * image.iter().sum::<f64>();
    assert!((sum(&whole) + state.force_n).abs() < 2e-3, "{}", sum(&whole));
    let middle = 7 * 17 + 8;
    assert!(whole[middle + 1] < still[middle + 1] && whole[middle - 1] > still[middle - 1]);
    // A sensor of compression only loses the tension and nothing else.
    let mut felt = image.clone();
    Part::Compressive.apply_to(&mut felt);
    assert!(felt.iter().zip(&image).all(|(f, s)| *f == s.min(0.0)) && sum(&felt) < -0.1);
}

#[test]
fn invalid_layers_are_refused_and_far_fields_are_zero() {
    let mut bad = layer(0.8, 0.49);
    bad.poisson = 0.6;
    assert_eq!(Shear::new(&bad).unwrap_err().place, "poisson");
    let shear = Shear::new(&layer(0.8, 0.49)).unwrap();
    assert_eq!(shear.surface_point([0.0, 40.0]), [0.0; 3]);
    assert_eq!(shear.base_point([1e9, 0.0]).abs(), 0.0);
    assert_eq!(shear.base_point([0.0, 0.0]).abs(), 0.0);
    let near = shear.surface_point([31.0, 5.0]);
    assert!(near.iter().all(|u| u.abs() < 1e-10), "{near:?}");
}

/// Where the fields of a layer have decayed, the closed form of a cell and the tabulated remainder
/// cancel, also across the end of the tables.
#[test]
fn cells_far_off_are_not_moved() {
    let layer = layer(0.8, 0.3);
    let shear = Shear::new(&layer).unwrap();
    let unit = 0.16 / layer.shear_mpa();
    for i in 0..60 {
        let r = 0.8 * (34.0 + 0.37 * f64::from(i));
        for place in [[r, 0.0], [0.0, r], [0.6 * r, -0.8 * r]] {
            let moved = shear.surface_cell(place, [0.2; 2]);
            for u in moved {
                assert!(u.abs() < 1e-9 * unit, "{place:?}: {moved:?}");
            }
        }
    }
}
