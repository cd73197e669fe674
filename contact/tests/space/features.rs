//! Tests features of distributions and images, and their Jacobians, by closed forms and identities,
//! and that undefined features are absent.

use crate::layer;
use core::f64::consts::FRAC_PI_2;
use taktil_contact::features::{Part, image_features, line_features, width_above};
use taktil_contact::plane::{Friction, Indenter, Shape as PlaneShape, rates};
use taktil_contact::space::Prescribed;
use taktil_contact::space::infinite::InfiniteIndenter;
use taktil_contact::space::jacobian::{Feature, Motion, condition, feature_jacobian};
use taktil_contact::space::pin::{Pin, PlanarPose, Profile};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::scene::{Pose, Scene, Shape};
use taktil_contact::space::sphere::Sphere;
use taktil_contact::space::surface::{Cells, Surface};
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};
use taktil_contact::{Accuracy as PlaneLevel, Accuracy};

#[test]
fn moments_of_a_polygon_are_exact() {
    // A triangle of height 2 on (1, 3) with its tip at 2: area 2, second moment about 2: 1/3.
    let (x, s) = ([0.0, 1.0, 2.0, 3.0, 5.0], [0.0, 0.0, -2.0, 0.0, 0.0]);
    let f = line_features(&x, &s, Part::Full).unwrap();
    let wanted = [-2.0, -4.0, -2.0 * 4.0 - 1.0 / 3.0, -2.0 * 8.0 - 3.0 * 2.0 / 3.0];
    for (got, wanted) in f.moments.iter().zip(wanted) {
        assert!((got - wanted).abs() < 1e-13, "{got} {wanted}");
    }
    assert!((f.x_c.unwrap() - 2.0).abs() < 1e-14);
    assert!((f.x_m.unwrap() - 2.0).abs() < 1e-14);
    assert!((width_above(&x, &s, 1.0).unwrap().unwrap() - 1.0).abs() < 1e-14);
    assert_eq!(width_above(&x, &s, 2.0).unwrap(), None);
    // The vertex of a parabola is found between its samples.
    let x = [0.0, 0.3, 0.5, 1.0];
    let s: Vec<f64> = x.iter().map(|x| (x - 0.42) * (x - 0.42) - 1.0).collect();
    let f = line_features(&x, &s, Part::Compressive).unwrap();
    assert!((f.x_m.unwrap() - 0.42).abs() < 1e-14 && (f.szz_peak.unwrap() + 1.0).abs() < 1e-14);
}

#[test]
fn what_is_undefined_is_absent_and_never_nan() {
    let x = [0.0, 1.0, 2.0];
    let none = line_features(&x, &[0.0; 3], Part::Full).unwrap();
    assert_eq!((none.x_c, none.x_m, none.szz_peak), (None, None, None));
    let tension = line_features(&x, &[1.0; 3], Part::Compressive).unwrap();
    assert_eq!((tension.moments, tension.x_c), ([0.0; 4], None));
    assert!(line_features(&x, &[1.0, f64::NAN, 0.0], Part::Full).is_err());
    assert!(line_features(&[0.0, 2.0, 1.0], &[0.0; 3], Part::Full).is_err());
    assert!(line_features(&x[..2], &[0.0; 2], Part::Full).is_err());
    assert!(line_features(&x, &[0.0; 2], Part::Full).is_err());
    assert!(width_above(&x, &[-1.0; 3], 0.0).is_err());
    assert_eq!(width_above(&x, &[-1.0; 3], 0.5).unwrap(), Some(2.0));
    let array = Array { rows: 2, cols: 2, pitch_mm: 1.0 };
    let f = image_features(&array, &[0.0; 4], Part::Full).unwrap();
    assert_eq!((f.xc, f.mu_xx, f.theta_long_rad), (None, None, None));
    // As much tension as compression has moments, but no centroid.
    let f = image_features(&array, &[1.0, -1.0, 1.0, -1.0], Part::Full).unwrap();
    assert_eq!((f.m0, f.xc), (0.0, None));
    assert!(f.my != 0.0);
    let f = image_features(&array, &[-1.0; 4], Part::Full).unwrap();
    assert_eq!((f.xc, f.theta_long_rad), (Some(0.0), None));
    let f = image_features(&array, &[-1.0, 0.0, -1.0, 0.0], Part::Full).unwrap();
    assert!((f.theta_long_rad.unwrap() - FRAC_PI_2).abs() < 1e-15);
    assert!(image_features(&array, &[f64::NAN; 4], Part::Full).is_err());
    assert!(image_features(&array, &[0.0; 3], Part::Full).is_err());
}

#[test]
fn condition_numbers_of_known_matrices() {
    let some = |values: &[f64]| values.iter().map(|v| Some(*v)).collect::<Vec<_>>();
    let near = |got: Option<f64>, wanted: f64| (got.unwrap() / wanted - 1.0).abs() < 1e-12;
    assert!(near(condition(&some(&[3.0, 0.0, 0.0, -0.5]), 2), 6.0));
    // Singular values of a shear by 1: the golden ratio and its inverse.
    let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
    assert!(near(condition(&some(&[1.0, 1.0, 0.0, 1.0]), 2), golden * golden));
    assert!(near(condition(&some(&[1.0, 0.0, 0.0, 0.0, 2.0, 0.0]), 3), 2.0));
    assert!(near(condition(&some(&[1.0, 0.0, 0.0, 2.0, 0.0, 0.0]), 2), 2.0));
    assert_eq!(condition(&some(&[1.0, 2.0, 2.0, 4.0]), 2), None);
    assert_eq!(condition(&[Some(1.0), None, None, Some(1.0)], 2), None);
    assert_eq!(condition(&[], 2), None);
}

fn scene(shape: Shape, array: &Array) -> Scene {
    Scene::new(&layer(0.8, 0.49), shape, array, Sampling::Area, Accuracy::Default).unwrap()
}

#[test]
fn a_spheres_jacobian_is_its_stiffness_and_its_motion() {
    let wide = Array { rows: 40, cols: 40, pitch_mm: 0.8 };
    let mut scene = scene(Shape::Sphere { radius_mm: 10.0 }, &wide);
    let features = [Feature::M0, Feature::Xc, Feature::Yc, Feature::ThetaLong];
    let motions = [Motion::X, Motion::Y, Motion::Z, Motion::RotX, Motion::RotY, Motion::RotZ];
    let found =
        feature_jacobian(&mut scene, Prescribed::ForceN(5.0), Pose::default(), &features, &motions)
            .unwrap();
    // Slope of the force over a small change of penetration, both ways.
    let mut sphere = Sphere::new(&layer(0.8, 0.49), 10.0, Accuracy::Default).unwrap();
    let delta = found.state.penetration_mm.unwrap();
    let mut force = |delta| sphere.press(Prescribed::PenetrationMm(delta)).unwrap().force_n;
    let slope = (force(delta + 1e-5) - force(delta - 1e-5)) / 2e-5;
    let at = |row: usize, column: usize| found.values[row * 6 + column].unwrap();
    assert!((at(0, 2) / -slope - 1.0).abs() < 2e-4, "{} {slope}", at(0, 2));
    assert!((at(1, 0) - 1.0).abs() < 5e-3 && (at(2, 1) - 1.0).abs() < 5e-3, "{found:?}");
    assert!(at(1, 1).abs() < 1e-6 && at(0, 0).abs() < 1e-3, "{found:?}");
    for row in 0..3 {
        for column in 3..6 {
            assert!(at(row, column).abs() < 1e-9);
        }
    }
    // A sphere's image has no axis, so its derivatives are not there, nor a condition number.
    assert!(found.values[18..].iter().all(Option::is_none));
    assert_eq!(found.condition, None);
}

#[test]
fn a_pins_jacobian_of_the_thesis_has_four_by_four_entries() {
    let shape = Shape::Cylinder { radius_mm: 23.0, length_mm: Some(50.0) };
    let mut scene = scene(shape, &Array::THESIS);
    let features = [Feature::Xc, Feature::M0, Feature::Mx, Feature::ThetaLong];
    let motions = [Motion::X, Motion::Z, Motion::RotX, Motion::RotZ];
    let drive = Prescribed::PenetrationMm(0.03);
    let found = feature_jacobian(&mut scene, drive, Pose::default(), &features, &motions).unwrap();
    let at = |row: usize, column: usize| found.values[row * 4 + column].unwrap();
    let error = |row: usize, column: usize| found.errors[row * 4 + column].unwrap();
    // Strips of the same width: slope of force and moment over the array's length.
    let stiffness = at(1, 1) / 25.4;
    let cubed = 25.4 * 25.4 * 25.4;
    assert!((at(2, 2) / (-stiffness * cubed / 12.0) - 1.0).abs() < 0.02, "{found:?}");
    assert!((at(0, 0) - 1.0).abs() < 0.1, "the image follows the pin: {found:?}");
    assert!((at(3, 3) - 1.0).abs() < 0.1, "and turns with it: {found:?}");
    // By symmetry the other entries of the columns dx, dz, rx are zero.
    assert!(at(1, 0).abs() < 1e-4 * at(1, 1).abs() && at(2, 1).abs() < 1e-3 * at(2, 2).abs());
    // The derivative of the image's angle differs by 1 % between the accuracies, and 1.5 times that
    // is the stated error.
    for (row, column, share) in [(0, 0, 1e-2), (1, 1, 1e-2), (2, 2, 1e-2), (3, 3, 2.5e-2)] {
        assert!(error(row, column) < share * at(row, column).abs(), "{found:?}");
    }
    assert!(found.condition.unwrap() > 1e3);
}

/// A steep pin touches at its end only, and its middle is far above the surface. The steps of the
/// differences have to be small compared with the depth of the end.
#[test]
fn a_pin_on_its_end_has_the_derivatives_of_its_contact() {
    let shape = Shape::Cylinder { radius_mm: 20.0, length_mm: Some(15.0) };
    let rubber = layer(1.5, 0.49);
    let of = |level| Scene::new(&rubber, shape, &Array::THESIS, Sampling::Area, level).unwrap();
    let pose = Pose { planar: PlanarPose::default(), tilt_rad: 0.19 };
    let features = [Feature::M0, Feature::Yc];
    let motions = [Motion::Z, Motion::RotX];
    let mut tilted = of(Accuracy::Default);
    let deep = tilted.press(Prescribed::ForceN(0.5), pose).unwrap().penetration_mm.unwrap();
    let drive = Prescribed::PenetrationMm(deep);
    let found = feature_jacobian(&mut tilted, drive, pose, &features, &motions).unwrap();
    // The end is 0.03 mm deep.
    let mut image = vec![0.0; 256];
    let mut at = |dz: f64, turned: f64| {
        let pose = Pose { tilt_rad: pose.tilt_rad + turned, ..pose };
        tilted.press(Prescribed::PenetrationMm(deep + dz), pose).unwrap();
        tilted.image(&mut image).unwrap();
        let seen = image_features(&Array::THESIS, &image, Part::Full).unwrap();
        [seen.m0, seen.yc.unwrap()]
    };
    // A turn about x raises the end towards +y.
    for (column, step, tilt) in [(0, 3e-4, 0.0), (1, 0.0, -3e-5)] {
        let [more, less] = [at(step, tilt), at(-step, -tilt)];
        for row in 0..2 {
            let own = (more[row] - less[row]) / (2.0 * (step + tilt.abs()));
            let value = found.values[row * 2 + column].unwrap();
            let error = found.errors[row * 2 + column].unwrap();
            assert!(
                (value - own).abs() < 2e-3 * own.abs() + error,
                "{row} {column}: {value} {own}"
            );
            assert!(error < 3e-2 * value.abs(), "{row} {column}: {value} {error}");
        }
    }
}

#[test]
fn a_line_load_has_no_depth_and_a_bars_edges_follow_it() {
    let planar = PlanarPose { x_mm: 0.2, y_mm: 0.1, rot_rad: 0.0 };
    let pose = Pose { planar, tilt_rad: 0.0 };
    let features = [Feature::M0, Feature::ThetaLong, Feature::Xc];
    let motions = [Motion::X, Motion::Z, Motion::RotY, Motion::RotZ];
    let mut edge = scene(Shape::Edge { length_mm: Some(10.0) }, &Array::THESIS);
    let found =
        feature_jacobian(&mut edge, Prescribed::ForceN(2.0), pose, &features, &motions).unwrap();
    assert_eq!(found.values[1], None);
    // Near the border of two columns the centroid of a narrow line's image moves faster than the
    // line, and its direction rotates faster in the same ratio.
    let ahead = found.values[8].unwrap();
    assert!(ahead > 1.2, "{found:?}");
    assert!((found.values[7].unwrap() / ahead - 1.0).abs() < 0.05, "{found:?}");
    let mut bar = scene(Shape::Bar { width_mm: 4.0, length_mm: Some(12.0) }, &Array::THESIS);
    let found =
        feature_jacobian(&mut bar, Prescribed::ForceN(20.0), pose, &features, &motions).unwrap();
    assert!(found.values[1].unwrap() < 0.0);
    assert!(found.values[2].unwrap().abs() < 0.02 * found.values[1].unwrap().abs(), "{found:?}");
    assert!((found.values[7].unwrap() - 1.0).abs() < 0.3, "{found:?}");
    let empty = feature_jacobian(&mut bar, Prescribed::ForceN(20.0), pose, &[], &motions);
    assert_eq!(empty.expect_err("refused").place, "features");
}

/// The cells of the general solver under a bar, with its face tilted across.
fn tilted(cells: &Cells, size: [f64; 2], turn: f64) -> Vec<f64> {
    let one = |n: usize| {
        let [x, y] = cells.place_mm(n);
        let under = x.abs() < 0.5 * size[0] && y.abs() < 0.5 * size[1];
        if under { -turn * x } else { f64::INFINITY }
    };
    (0..cells.columns * cells.rows).map(one).collect()
}

#[test]
fn a_bars_roll_is_the_rate_of_the_full_solution() {
    // Central differences of the solution on cells, which uses neither slices nor cosines; both use
    // the same array.
    let (rubber, size) = (layer(0.8, 0.45), [2.4, 4.8]);
    let influence = Influence::new(&rubber).unwrap();
    let shares =
        Shares::new(&influence, &Array::THESIS, Sampling::Area, Fineness::DEFAULT).unwrap();
    let delta = 0.02;
    let rate = |spacing_mm: f64| {
        let cells = Cells {
            columns: (size[0] / spacing_mm).round() as usize + 2,
            rows: (size[1] / spacing_mm).round() as usize + 2,
            spacing_mm,
        };
        let mut surface = Surface::new(&influence, &cells).unwrap();
        let turn = 1e-3;
        let mut image = vec![0.0; 256];
        let mut moment = 0.0;
        for side in [1.0, -1.0] {
            let heights = tilted(&cells, size, side * turn);
            surface.press(&heights, Prescribed::PenetrationMm(delta)).unwrap();
            surface.image_of(&shares, [0.0; 2], side / (2.0 * turn), &mut image);
            let area = spacing_mm * spacing_mm * side / (2.0 * turn);
            let pressure = surface.pressure_mpa().iter().enumerate();
            moment += pressure.map(|(n, p)| p * area * cells.place_mm(n)[0]).sum::<f64>();
        }
        (image, moment)
    };
    let (coarse, fine) = (rate(0.1), rate(0.05));
    let profile = Profile::Bar { width_mm: size[0] };
    let mut pin = Pin::new(&rubber, profile, [-2.4, 2.4], 0.1, Accuracy::Fine).unwrap();
    assert!(pin.roll().unwrap().is_none(), "nothing touches");
    pin.press(Prescribed::PenetrationMm(delta), 0.0).unwrap();
    let roll = pin.roll().unwrap().unwrap();
    let (mut force, mut moment) = (0.0, 0.0);
    roll.loads(|[u, _], load| {
        force += load;
        moment += u * load;
    });
    assert!(force.abs() < 1e-9 * moment, "{force} {moment}");
    assert!((moment / roll.moment_n_mm() - 1.0).abs() < 1e-9);
    // Constant cells lose a sharp edge in proportion to their size.
    let (off, before) = (fine.1 / moment - 1.0, coarse.1 / moment - 1.0);
    assert!((2.0 * off - before).abs() < 3e-3 && off.abs() < 0.6 * before.abs(), "{off} {before}");
    let mut image = vec![0.0; 256];
    roll.image(&shares, PlanarPose::default(), &mut image);
    let largest = image.iter().fold(0.0_f64, |most, s| most.max(s.abs()));
    for (n, found) in image.iter().enumerate() {
        let wanted = 2.0 * fine.0[n] - coarse.0[n];
        assert!((found - wanted).abs() < 3e-3 * largest, "{n}: {found} {wanted}");
    }
}

#[test]
fn a_long_bar_rolls_as_one_without_ends() {
    // The moment about the axis that a roll needs, per mm of the plane problem.
    let rubber = layer(0.8, 0.49);
    let shape = PlaneShape::Flat { width_mm: 3.0, height_mm: 0.0 };
    let mut plane = Indenter::new(&rubber, shape, Friction::None, PlaneLevel::Fine).unwrap();
    plane.descend(0.02).unwrap();
    let rate = plane.rate(rates::Motion::RotY, 0.8).unwrap().unwrap();
    let per_mm: f64 = rate.forces.iter().map(|f| f[0] * f[1]).sum();
    let array = Array { rows: 48, cols: 48, pitch_mm: 0.5 };
    let features = [Feature::M0, Feature::My, Feature::Mx];
    let motions = [Motion::RotX, Motion::RotY];
    for length_mm in [Some(60.0), None] {
        for rot_rad in [0.0, FRAC_PI_2] {
            let pose =
                Pose { planar: PlanarPose { x_mm: 0.3, y_mm: -0.2, rot_rad }, tilt_rad: 0.0 };
            let mut bar = scene(Shape::Bar { width_mm: 3.0, length_mm }, &array);
            let drive = Prescribed::PenetrationMm(0.02);
            let found = feature_jacobian(&mut bar, drive, pose, &features, &motions).unwrap();
            let at = |row: usize, column: usize| found.values[row * 2 + column].unwrap();
            // Lowered towards +x by a turn about y, towards -y by one about x.
            let roll = if rot_rad == 0.0 { [at(1, 1), at(2, 1)] } else { [-at(2, 0), at(1, 0)] };
            assert!((roll[0] / (-per_mm * 24.0) - 1.0).abs() < 3e-3, "{found:?} {per_mm}");
            assert!(roll[1].abs() < 1e-3 * roll[0].abs(), "{found:?}");
        }
    }
    // The same holds in any direction, tactel by tactel.
    let influence = Influence::new(&rubber).unwrap();
    let shares = Shares::new(&influence, &array, Sampling::Area, Fineness::FINE).unwrap();
    let profile = Profile::Bar { width_mm: 3.0 };
    let mut pin = Pin::new(&rubber, profile, [-30.0, 30.0], 0.1, Accuracy::Default).unwrap();
    let mut endless = InfiniteIndenter::new(&rubber, profile, 0.1).unwrap();
    assert!(endless.roll().is_none(), "nothing touches");
    pin.press(Prescribed::PenetrationMm(0.02), 0.0).unwrap();
    endless.press(Prescribed::PenetrationMm(0.02)).unwrap();
    let planar = PlanarPose { x_mm: 1.3, y_mm: -0.2, rot_rad: 0.6 };
    let (mut one, mut other) = (vec![0.0; array.len()], vec![0.0; array.len()]);
    pin.roll().unwrap().unwrap().image(&shares, planar, &mut one);
    endless.roll().unwrap().image(&array, Sampling::Area, planar, &mut other).unwrap();
    let largest = other.iter().fold(0.0_f64, |most, s| most.max(s.abs()));
    for (n, (one, other)) in one.iter().zip(&other).enumerate() {
        assert!((one - other).abs() < 2e-3 * largest, "{n}: {one} {other}");
    }
}

#[test]
fn features_of_any_numbers_are_numbers_or_refused() {
    let array = Array { rows: 1, cols: 4, pitch_mm: 1.0 };
    for huge in [1e308, -1e308, f64::NAN, f64::INFINITY] {
        let refused = image_features(&array, &[huge, -huge, 1.0, huge], Part::Full);
        assert_eq!(refused.expect_err("refused").place, "image");
        let refused = line_features(&[0.0, 1.0, 2.0], &[0.0, huge, 0.0], Part::Full);
        assert_eq!(refused.expect_err("refused").place, "szz_mpa");
        let refused = width_above(&[0.0, 1.0, 2.0], &[0.0, huge, 0.0], 0.1);
        assert_eq!(refused.expect_err("refused").place, "szz_mpa");
        let refused = line_features(&[0.0, 1.0, huge.abs()], &[0.0; 3], Part::Full);
        assert_eq!(refused.expect_err("refused").place, "x_mm");
    }
    // The extreme values that numbers may have.
    for (size, step) in [(1e30, 1e-300), (1e30, 1e29), (1e-308, 1e-300), (1e-308, 1.0)] {
        let x = [0.0, step, 2.0 * step];
        let found = line_features(&x, &[size, -size, size], Part::Full).unwrap();
        assert_eq!((found.x_m, found.szz_peak), (Some(step), Some(-size)));
        assert!(found.moments.iter().all(|moment| moment.is_finite()), "{found:?}");
        let found = image_features(&array, &[-size, 0.0, 0.0, -size], Part::Compressive).unwrap();
        assert_eq!((found.m0, found.xc, found.theta_long_rad), (-2.0 * size, Some(0.0), Some(0.0)));
    }
}
