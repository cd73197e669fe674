//! Tests feature Jacobians in plane strain: compares the exact derivatives with differences of the
//! exact solver and with reference data, and tests that undefined ones are absent.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::plane::noslip::NoSlip;
use taktil_contact::plane::rates::{Feature, Motion, StressFeatures, TractionRate};
use taktil_contact::plane::{Contact, Friction, Indenter, Load, Mode, Shape};

const ALL: [Feature; 12] = [
    Feature::Moment(0),
    Feature::Moment(1),
    Feature::Moment(2),
    Feature::Moment(3),
    Feature::Centroid,
    Feature::CompressiveMoment(0),
    Feature::CompressiveMoment(1),
    Feature::CompressiveMoment(2),
    Feature::CompressiveMoment(3),
    Feature::CompressiveCentroid,
    Feature::PeakPlace,
    Feature::PeakStress,
];

fn layer(t: f64, nu: f64) -> Layer {
    Layer::new(t, 27.58, nu).expect("a sound layer")
}

fn features(body: &Indenter) -> Vec<f64> {
    let t = body.layer().thickness_mm;
    let image = StressFeatures::new(body.layer(), &body.point_forces(t), t, false);
    image.features(&ALL).iter().map(|f| f.expect("defined")).collect()
}

fn derivatives(body: &mut Indenter, motion: Motion) -> Vec<f64> {
    let t = body.layer().thickness_mm;
    let image = StressFeatures::new(body.layer(), &body.point_forces(t), t, false);
    let rate = body.rate(motion, t).expect("a rate").expect("a contact");
    image.derivatives(&rate, &ALL).iter().map(|f| f.expect("defined")).collect()
}

/// Features per unit of P and of Q, and the rigid motion of each, by differences.
fn by_load(body: &mut Indenter, load: Load, h: f64) -> [(Vec<f64>, Contact, Contact); 2] {
    [[h, 0.0], [0.0, h]].map(|[p, q]| {
        let mut at = |side: f64| {
            let load = Load { p_n_mm: load.p_n_mm + side * p, q_n_mm: load.q_n_mm + side * q };
            let contact = body.press(&load).expect("a contact");
            (features(body), contact)
        };
        let ((more, above), (less, below)) = (at(1.0), at(-1.0));
        let slope = more.iter().zip(&less).map(|(a, b)| (a - b) / (2.0 * h)).collect();
        (slope, above, below)
    })
}

/// A bar whose loads change moves by dz and turns by ry: both sides of the chain rule agree.
#[test]
fn a_bars_derivatives_are_those_of_the_solver_by_load() {
    let bar = |width_mm: f64| Shape::Flat { width_mm, height_mm: 6.35 };
    // Whole face; lifted; nearly a line; other rubber.
    for (t, nu, width, p, q) in [
        (0.8, 0.49, 12.7, 0.7, 0.05),
        (0.8, 0.49, 12.7, 0.175, 0.0876),
        (0.8, 0.5, 12.7, 0.7, 0.62),
        (2.3, 0.3, 6.0, 1.4, 0.3),
    ] {
        let body = Indenter::new(&layer(t, nu), bar(width), Friction::None, Accuracy::Fine);
        let mut body = body.expect("a sound indenter");
        let load = Load { p_n_mm: p, q_n_mm: q };
        body.press(&load).expect("a contact");
        let dz = derivatives(&mut body, Motion::Z);
        let ry = derivatives(&mut body, Motion::RotY);
        for (slope, above, below) in by_load(&mut body, load, 1e-4 * p) {
            let deeper = (above.delta_mm - below.delta_mm) / (2e-4 * p);
            let turned = (above.slope - below.slope) / (2e-4 * p);
            for (i, expected) in slope.iter().enumerate() {
                let found = dz[i] * deeper + ry[i] * turned;
                let size = (dz[i] * deeper).abs() + (ry[i] * turned).abs() + 1e-3;
                assert!(
                    (found - expected).abs() < 2e-5 * size,
                    "{:?} {p} {q}: {found} {expected}",
                    ALL[i]
                );
            }
        }
    }
}

#[test]
fn a_cylinders_derivative_is_that_of_the_solver_by_descent() {
    for (t, nu, radius_mm, dz) in
        [(0.8, 0.49, 25.4, 0.02), (0.8, 0.5, 5.0, 0.1), (3.0, 0.2, 9.0, 0.4)]
    {
        let shape = Shape::Cylinder { radius_mm };
        let body = Indenter::new(&layer(t, nu), shape, Friction::None, Accuracy::Fine);
        let mut body = body.expect("a sound indenter");
        body.descend(dz).expect("a contact");
        let found = derivatives(&mut body, Motion::Z);
        let h = 1e-3 * dz;
        let mut at = |dz: f64| {
            body.descend(dz).expect("a contact");
            features(&body)
        };
        let (more, less, far, near) = (at(dz + h), at(dz - h), at(dz + 2.0 * h), at(dz - 2.0 * h));
        for i in 0..ALL.len() {
            let expected = (8.0 * (more[i] - less[i]) - (far[i] - near[i])) / (12.0 * h);
            let size = found[i].abs().max(more[i].abs() / dz).max(1e-1);
            assert!(
                (found[i] - expected).abs() < 1e-6 * size,
                "{:?} {t} {size:e}: {:e} {expected:e}",
                ALL[i],
                found[i]
            );
        }
        body.descend(dz).expect("a contact");
        assert!(derivatives(&mut body, Motion::RotY).iter().all(|d| d.abs() < 1e-12));
    }
}

/// A parabola is round as a cylinder is: without glue a turn about its own axis changes nothing.
#[test]
fn a_turned_parabola_is_round() {
    let shape = Shape::Parabola { radius_mm: 23.0 };
    let body = Indenter::new(&layer(0.8, 0.49), shape, Friction::Proportional, Accuracy::Default);
    let mut body = body.expect("a sound indenter");
    body.press(&Load { p_n_mm: 1.0, q_n_mm: 0.2 }).expect("a contact");
    assert_eq!(body.rate(Motion::RotY, 0.8), Ok(Some(TractionRate::default())));
}

#[test]
fn a_slide_shifts_the_image() {
    let shape = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
    let body = Indenter::new(&layer(0.8, 0.49), shape, Friction::Proportional, Accuracy::Fine);
    let mut body = body.expect("a sound indenter");
    body.press(&Load { p_n_mm: 0.7, q_n_mm: 0.3 }).expect("a contact");
    let found = derivatives(&mut body, Motion::X);
    let t = 0.8;
    let h = 1e-4;
    let at = |dx: f64| {
        let forces: Vec<[f64; 3]> =
            body.point_forces(t).iter().map(|f| [f[0] + dx, f[1], f[2]]).collect();
        let image = StressFeatures::new(body.layer(), &forces, t, false);
        image.features(&ALL).iter().map(|f| f.expect("defined")).collect::<Vec<_>>()
    };
    let (more, less) = (at(h), at(-h));
    for i in 0..ALL.len() {
        let expected = (more[i] - less[i]) / (2.0 * h);
        assert!((found[i] - expected).abs() < 1e-6 * (1.0 + expected.abs()), "{:?}", ALL[i]);
    }
}

/// Reference data, no slip, b = 1.5, R = 22.9: stiffnesses 676.947 and 55.0, dM1/dx -68.2.
#[test]
fn a_glued_cylinders_rates_are_those_of_the_reference() {
    let (layer, shape) = (layer(0.8, 0.49), Shape::Cylinder { radius_mm: 22.9 });
    let held = NoSlip::widen(&layer, shape, 1.5).expect("a contact");
    let image = StressFeatures::new(&layer, &held.point_forces(0.0), 0.8, true);
    let of = |motion: Motion, more: usize| -> Vec<f64> {
        let rate = held.rate(shape, motion, more);
        image.derivatives(&rate, &ALL).iter().map(|f| f.expect("defined")).collect()
    };
    let (dx, dz, ry) = (of(Motion::X, 1), of(Motion::Z, 1), of(Motion::RotY, 1));
    assert!((dz[0] / -676.947 - 1.0).abs() < 1e-5, "{}", dz[0]);
    assert!(dx[0].abs() < 1e-6 && (dx[1] - held.first_moment_n_mm).abs() < 1e-6, "{dx:?}");
    assert!((dx[1] + 68.2).abs() < 0.05, "{}", dx[1]);
    // Differences of grown contacts give the same stiffness.
    let load = |dz: f64| NoSlip::descend(&layer, shape, dz).expect("a contact").p_n_mm;
    let h = 1e-3 * held.delta_mm;
    let slope = (load(held.delta_mm + h) - load(held.delta_mm - h)) / (2.0 * h);
    assert!((slope / -dz[0] - 1.0).abs() < 1e-3, "{slope} {}", dz[0]);
    // A roll about the axis drags the surface back by R per rad, and tilts it.
    assert!(ry[0].abs() < 1e-6 * ry[1].abs() && ry[1] > 0.7 * 22.9 * 68.2, "{ry:?}");
    for (coarse, fine) in of(Motion::RotY, 1).iter().zip(of(Motion::RotY, 2)) {
        assert!((coarse - fine).abs() < 1e-4 * fine.abs().max(1.0), "{coarse} {fine}");
    }
}

#[test]
fn nothing_touched_has_no_derivative_and_none_is_nan() {
    for shape in
        [Shape::Flat { width_mm: 12.7, height_mm: 6.35 }, Shape::Cylinder { radius_mm: 25.4 }]
    {
        let body = Indenter::new(&layer(0.8, 0.49), shape, Friction::None, Accuracy::Default);
        let mut body = body.expect("a sound indenter");
        for motion in [Motion::X, Motion::Z, Motion::RotY] {
            assert_eq!(body.rate(motion, 0.8), Ok(None));
            body.press(&Load::default()).expect("nothing");
            assert_eq!(body.rate(motion, 0.8), Ok(None));
        }
        let image = StressFeatures::new(body.layer(), &[], 0.8, true);
        let none = image.derivatives(&TractionRate { forces: Vec::new(), shift: 1.0 }, &ALL);
        assert_eq!(none[4], None);
        assert!(none.iter().flatten().all(|value| value.is_finite()));
        // A line of contact, and the least load.
        let load = match shape {
            Shape::Flat { .. } => Load { p_n_mm: 1.0, q_n_mm: 1.0 - 1e-7 },
            _ => Load { p_n_mm: 1e-9, q_n_mm: 0.0 },
        };
        let contact = body.press(&load).expect("a contact");
        assert_ne!(contact.mode, Mode::Full);
        for motion in [Motion::X, Motion::Z, Motion::RotY] {
            assert!(derivatives(&mut body, motion).iter().all(|value| value.is_finite()));
        }
    }
}

/// At lift-off the derivative goes on without a step.
#[test]
fn lifting_off_is_smooth() {
    let shape = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
    let body = Indenter::new(&layer(0.8, 0.49), shape, Friction::None, Accuracy::Fine);
    let mut body = body.expect("a sound indenter");
    let (mut low, mut high) = (0.2, 0.35);
    while high - low > 1e-7 {
        let middle = 0.5 * (low + high);
        let mode = body.press(&Load { p_n_mm: 1.0, q_n_mm: middle }).expect("a contact").mode;
        if mode == Mode::Full { low = middle } else { high = middle }
    }
    assert!((low - 0.2688).abs() < 1e-4, "{low}");
    for motion in [Motion::Z, Motion::RotY] {
        body.press(&Load { p_n_mm: 1.0, q_n_mm: low }).expect("a contact");
        let before = derivatives(&mut body, motion);
        body.press(&Load { p_n_mm: 1.0, q_n_mm: high }).expect("a contact");
        let largest = before.iter().fold(0.0_f64, |most, d| most.max(d.abs()));
        for (a, b) in before.iter().zip(derivatives(&mut body, motion)) {
            let bar = 1e-3 * a.abs() + 1e-5 * largest;
            assert!((a - b).abs() < bar, "{motion:?}: {a} {b}");
        }
    }
}
