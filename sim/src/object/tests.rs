//! Compares pressed objects with the exact reference images: force within 1 %, centroid within 0.02
//! mm, direction within 0.2 deg. An edge with the rounding of a pin is that pin. Where plane strain
//! is not enough, the tests pin down its error.

use taktil_contact::Accuracy;
use taktil_contact::features::{ImageFeatures, Part, image_features};
use taktil_contact::space::tactels::Array;

use super::*;
use crate::scene::EdgeProfile;
use crate::scene::RubberConfig;

const FEATURES: &str = include_str!("../../../tests/fixtures/contact/tactile3d_features.csv");

struct Case {
    name: String,
    numbers: Vec<f64>,
}

/// Reference cases of a shape with area means; the numbers are the columns from nu on.
fn cases(shape: &str) -> Vec<Case> {
    let lines = FEATURES.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
    let number = |cell: &&str| cell.trim().parse().unwrap_or(f64::NAN);
    let all: Vec<Case> = lines
        .filter(|cells| cells[1] == "average" && cells[2] == shape)
        .map(|cells| Case {
            name: cells[0].to_owned(),
            numbers: cells[3..].iter().map(number).collect(),
        })
        .collect();
    assert!(all.len() >= 4, "an empty table checks nothing");
    all
}

const ARRAY: ArrayGeometry = ArrayGeometry::THESIS;

fn squares() -> SquareCells {
    SquareCells::new(&ARRAY, "tactile").unwrap()
}

fn rubber(case: &Case) -> RubberConfig {
    let (poisson, thickness_mm) = (case.numbers[0], case.numbers[1]);
    RubberConfig { thickness_mm, youngs_mpa: 27.58, poisson, relaxation_ms: 0.3 }
}

/// Relative motion of an object at rest whose top is `delta` mm inside the pad, turned and tilted
/// as the case says.
fn inside_pad(n: &[f64]) -> RelativeMotion {
    let tilt = if n[9].is_finite() { n[9] } else { 0.0 };
    RelativeMotion {
        place: 1e-3 * DVec3::new(n[6], n[7], -n[5]),
        turn: rotation_z(n[8].to_radians()) * rotation_x(-tilt) * rotation_y(core::f64::consts::PI),
        velocity: DVec3::ZERO,
        spin: DVec3::ZERO,
        h: 0.0,
    }
}

fn features_of(image: &[f64]) -> ImageFeatures {
    image_features(&Array::THESIS, image, Part::Full).unwrap()
}

/// Relative error of M0, of the centroid (mm) and of the direction (deg).
fn errors(case: &Case, found: &ImageFeatures, turned: bool) -> [f64; 3] {
    let n = &case.numbers;
    let apart = [found.xc.unwrap() - n[14], found.yc.unwrap() - n[15]];
    let off = found.theta_long_rad.unwrap_or(0.0) - n[19];
    let off = off - core::f64::consts::PI * (off / core::f64::consts::PI).round();
    [
        (found.m0 / n[11] - 1.0).abs(),
        apart[0].abs().max(apart[1].abs()),
        if turned { off.abs().to_degrees() } else { 0.0 },
    ]
}

fn judge(worst: &mut [f64; 3], case: &Case, errors: [f64; 3], bars: [f64; 3]) {
    for ((worst, error), bar) in worst.iter_mut().zip(errors).zip(bars) {
        *worst = worst.max(error);
        assert!(error < bar, "{}: {errors:?}", case.name);
    }
}

#[test]
fn pressed_spheres_give_the_reference_images() {
    let mut worst = [0.0; 3];
    for case in cases("sphere") {
        let n = &case.numbers;
        let sphere = ObjectConfig { radius_mm: Some(n[2]), ..ObjectConfig::of(ObjectKind::Sphere) };
        let mut ball =
            SphereContact::new(&sphere, &finger_pad(&rubber(&case), &ARRAY), "object[0]").unwrap();
        let sums = ball.evaluate(&inside_pad(n), 0.0);
        assert!((sums.load_n / n[3] - 1.0).abs() < 1e-4, "{}: {}", case.name, sums.load_n);
        let mut image = [0.0; 256];
        ball.image(&mut squares(), &mut image);
        judge(&mut worst, &case, errors(&case, &features_of(&image), false), [2e-3, 2e-3, 0.2]);
    }
    println!("sphere: force {:.1e}, centroid {:.1e} mm", worst[0], worst[1]);
}

#[test]
fn pressed_edges_give_the_reference_images() {
    let mut worst = [0.0; 3];
    for case in cases("inf_cylinder").into_iter().chain(cases("cylinder")) {
        let n = &case.numbers;
        let long = if n[10] > 0.0 { n[10] } else { 80.0 };
        // A length of 12 mm is mostly ends, which another test checks.
        if long < 20.0 {
            continue;
        }
        let (radius_mm, length_mm) = (Some(n[2]), Some(long));
        let edge = ObjectConfig { radius_mm, length_mm, ..ObjectConfig::of(ObjectKind::Edge) };
        let mut contact =
            EdgeContact::new(&edge, &finger_pad(&rubber(&case), &ARRAY), None, "object[0]")
                .unwrap();
        contact.evaluate(&inside_pad(n), 0.0);
        let shares = finger_pad(&rubber(&case), &ARRAY).shares(&squares(), Fineness::FAST).unwrap();
        let mut image = [0.0; 256];
        contact.image(&shares, &mut squares(), &mut image);
        let found = errors(&case, &features_of(&image), true);
        // Under a tilt of 4 mrad the load grows fivefold along the pad, and sections influence each
        // other.
        let steep = n[9].abs() > 3e-3;
        let bars = if steep { [0.02, 0.04, 0.4] } else { [0.01, 0.02, 0.2] };
        judge(&mut worst, &case, found, bars);
    }
    println!("edge: force {:.1e}, centroid {:.1e} mm, {:.1e} deg", worst[0], worst[1], worst[2]);
}

#[test]
fn in_three_dimensions_ends_and_steep_loads_are_right_too() {
    let mut worst = [0.0; 3];
    for case in cases("cylinder") {
        let n = &case.numbers;
        let (radius_mm, length_mm) = (Some(n[2]), Some(n[10]));
        let edge = ObjectConfig { radius_mm, length_mm, ..ObjectConfig::of(ObjectKind::Edge) };
        let mut contact = EdgeContact::new(
            &edge,
            &finger_pad(&rubber(&case), &ARRAY),
            Some(Accuracy::Fast),
            "object[0]",
        )
        .unwrap();
        let plain = contact.evaluate(&inside_pad(n), 0.0);
        let shares = finger_pad(&rubber(&case), &ARRAY).shares(&squares(), Fineness::FAST).unwrap();
        let mut image = [0.0; 256];
        contact.image(&shares, &mut squares(), &mut image);
        judge(&mut worst, &case, errors(&case, &features_of(&image), true), [0.01, 0.02, 0.2]);
        // After the image, the load between images is that of the solution.
        let leaning = contact.evaluate(&inside_pad(n), 0.0);
        if n[10] < 20.0 {
            assert!((leaning.load_n / n[3] - 1.0).abs() < 0.01, "{}", case.name);
            assert!((plain.load_n / n[3] - 1.0).abs() > 0.03, "{}", case.name);
        }
    }
    println!("edge, 3-D: {:.1e}, {:.1e} mm, {:.1e} deg", worst[0], worst[1], worst[2]);
}

#[test]
fn ends_press_as_if_the_edge_continued() {
    // The two ends are 12 mm apart, 15 thicknesses; the bound is the error of plane strain there.
    for case in cases("cylinder").into_iter().filter(|case| case.numbers[10] < 20.0) {
        let n = &case.numbers;
        let (radius_mm, length_mm) = (Some(n[2]), Some(n[10]));
        let edge = ObjectConfig { radius_mm, length_mm, ..ObjectConfig::of(ObjectKind::Edge) };
        let mut contact =
            EdgeContact::new(&edge, &finger_pad(&rubber(&case), &ARRAY), None, "object[0]")
                .unwrap();
        let sums = contact.evaluate(&inside_pad(n), 0.0);
        println!("{}: force {:.4} of the exact one", case.name, sums.load_n / n[3]);
        assert!((sums.load_n / n[3] - 1.0).abs() < 0.1);
    }
}

#[test]
fn the_nearest_place_on_a_curve_is_found() {
    let curves = [
        (EdgeProfile::Straight, None, None),
        (EdgeProfile::Arc, Some(30.0), None),
        (EdgeProfile::Arc, Some(-45.0), None),
        (EdgeProfile::Corner, None, Some(60.0)),
        (EdgeProfile::Corner, None, Some(-90.0)),
    ];
    let plain = ObjectConfig::of(ObjectKind::Edge);
    let rubber = crate::scene::FingerConfig::default().rubber;
    for (profile, arc_radius_mm, corner_deg) in curves {
        let profile = Some(profile);
        let edge = ObjectConfig { profile, arc_radius_mm, corner_deg, ..plain };
        let contact =
            EdgeContact::new(&edge, &finger_pad(&rubber, &ARRAY), None, "object[0]").unwrap();
        for i in 0..400_i32 {
            let place = 1e-3 * DVec2::new(f64::from(i % 20 - 10), f64::from(i / 20 - 10) * 3.0);
            let least = contact.distance_by_search(place);
            let found = contact.distance(place);
            assert!((least - found).abs() < 1e-4, "{edge:?} {place}: {found} {least}");
        }
    }
}

const TILTED: &str = include_str!("../../../contact/tests/fixtures/contact/punch_tilt_none.csv");

#[test]
fn a_tilted_bar_agrees_with_the_reference() {
    let mut lines = TILTED.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').map(str::trim).collect();
    let column = |name: &str| names.iter().position(|n| *n == name).unwrap();
    let [nu, t, w, h] = ["nu", "t_mm", "W_mm", "h_mm"].map(column);
    let [p, q, delta, slope] = ["P", "Q", "delta0", "slope"].map(column);
    let (mut features_of, mut worst) = (0, [0.0_f64; 2]);
    for line in lines {
        let n: Vec<f64> =
            line.split(',').map(|cell| cell.trim().parse().unwrap_or(f64::NAN)).collect();
        let out = (n[q] * n[h] / n[p] / (0.5 * n[w])).abs();
        // A bar that topples has no solution, and loads beyond the table are not in it.
        if !n[delta].is_finite() || !(0.0..0.95).contains(&out) || n[w] > 25.0 {
            continue;
        }
        let rubber = RubberConfig {
            thickness_mm: n[t],
            youngs_mpa: 27.58,
            poisson: n[nu],
            relaxation_ms: 0.3,
        };
        let bar = ObjectConfig { width_mm: Some(n[w]), ..ObjectConfig::of(ObjectKind::Bar) };
        let face = BarContact::new(&bar, &finger_pad(&rubber, &ARRAY), "object[0]").unwrap();
        let deepest_m = 1e-3 * (n[delta] + n[slope].abs() * 0.5 * n[w]);
        let (load_n_m, place_m) = face.plane_load(deepest_m, n[slope].abs());
        let errors =
            [(1e-3 * load_n_m / n[p] - 1.0).abs(), (1e3 * place_m - out * 0.5 * n[w]).abs()];
        assert!(errors[0] < 0.01 && errors[1] < 0.02, "{line}: {errors:?}");
        worst = [worst[0].max(errors[0]), worst[1].max(errors[1])];
        features_of += 1;
    }
    assert!(features_of > 5, "{features_of}");
    println!("bar: {features_of} cases, force {:.1e}, middle {:.1e} mm", worst[0], worst[1]);
}
