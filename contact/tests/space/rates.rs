//! Compares feature Jacobians with those of a finer level and with differences over rotations.

use crate::layer;
use taktil_contact::Accuracy;
use taktil_contact::features::{Part, image_features};
use taktil_contact::space::Prescribed;
use taktil_contact::space::jacobian::{Feature, Motion, feature_jacobian};
use taktil_contact::space::pin::PlanarPose;
use taktil_contact::space::scene::{Pose, Scene, Shape};
use taktil_contact::space::tactels::{Array, Sampling};

const FEATURES: [Feature; 9] = [
    Feature::M0,
    Feature::My,
    Feature::Mx,
    Feature::Xc,
    Feature::Yc,
    Feature::MuXx,
    Feature::MuXy,
    Feature::MuYy,
    Feature::ThetaLong,
];
const MOTIONS: [Motion; 6] =
    [Motion::X, Motion::Y, Motion::Z, Motion::RotX, Motion::RotY, Motion::RotZ];

fn scene(shape: Shape, level: Accuracy) -> Scene {
    Scene::new(&layer(1.2, 0.45), shape, &Array::THESIS, Sampling::Area, level).unwrap()
}

#[test]
fn stated_errors_cover_what_a_level_is_off_by() {
    // The poses are partly off the array, on an end, and across the array.
    let shapes = [
        (Shape::Sphere { radius_mm: 9.0 }, Prescribed::PenetrationMm(0.1), 0.0),
        (Shape::Edge { length_mm: Some(9.0) }, Prescribed::ForceN(4.0), 0.0),
        (
            Shape::Cylinder { radius_mm: 12.0, length_mm: Some(9.0) },
            Prescribed::PenetrationMm(0.05),
            0.03,
        ),
        (Shape::Bar { width_mm: 2.0, length_mm: Some(6.0) }, Prescribed::ForceN(25.0), -0.01),
    ];
    for (shape, drive, tilt_rad) in shapes {
        let pose = Pose { planar: PlanarPose { x_mm: 10.5, y_mm: -1.3, rot_rad: 0.4 }, tilt_rad };
        let at = |level: Accuracy| {
            feature_jacobian(&mut scene(shape, level), drive, pose, &FEATURES, &MOTIONS).unwrap()
        };
        let fine = at(Accuracy::Fine);
        for level in [Accuracy::Fast, Accuracy::Default] {
            let found = at(level);
            for (n, value) in found.values.iter().enumerate() {
                let (Some(value), Some(truth)) = (*value, fine.values[n]) else {
                    assert!(value.is_none() || fine.values[n].is_none());
                    continue;
                };
                let of = fine.values[n / 6 * 6..n / 6 * 6 + 6].iter().flatten();
                let size = of.fold(0.0_f64, |most, value| most.max(value.abs()));
                let stated = found.errors[n].unwrap() + fine.errors[n].unwrap() + 1e-9 * size;
                // What the level beside it is off by, too, at the fast level.
                let off = (value - truth).abs();
                assert!(off <= 2.0 * stated + 2e-4 * size, "{shape:?} {level:?} {n}: {off}");
            }
        }
    }
}

/// Pins that are longer than the pad or leave it with an end, and a shorter one.
fn cut_pins() -> [(Shape, Pose); 4] {
    let pose = |x_mm, y_mm, rot_rad, tilt_rad| Pose {
        planar: PlanarPose { x_mm, y_mm, rot_rad },
        tilt_rad,
    };
    let cylinder = |length| Shape::Cylinder { radius_mm: 6.0, length_mm: Some(length) };
    let bar = |length| Shape::Bar { width_mm: 2.5, length_mm: Some(length) };
    [
        (cylinder(40.0), pose(2.0, -1.0, 0.3, 0.002)),
        (bar(40.0), pose(-1.5, 2.0, -0.7, -0.001)),
        (cylinder(12.0), pose(0.7, 9.0, 0.1, 0.0)),
        (bar(12.0), pose(-8.0, 1.0, 1.3, 0.003)),
    ]
}

#[test]
fn derivatives_of_cut_pins_equal_differences_of_whole_motions() {
    let drive = Prescribed::PenetrationMm(0.1);
    for (shape, pose) in cut_pins() {
        let mut pin = scene(shape, Accuracy::Default).cut_at_array();
        let found = feature_jacobian(&mut pin, drive, pose, &FEATURES, &MOTIONS).unwrap();
        // Each moved pin is cut anew. The steps of the differences are long, because slices are
        // added and left out between them.
        let mut measured = |column: usize, amount: f64| {
            let mut moved = pose;
            match MOTIONS[column] {
                Motion::X => moved.planar.x_mm += amount,
                Motion::Y => moved.planar.y_mm += amount,
                _ => moved.planar.rot_rad += 0.05 * amount,
            }
            pin.press(drive, moved).unwrap();
            let mut image = vec![0.0; 256];
            pin.image(&mut image).unwrap();
            let f = image_features(&Array::THESIS, &image, Part::Full).unwrap();
            [f.m0, f.my, f.mx, f.xc.unwrap(), f.yc.unwrap()]
        };
        for column in [0, 1, 5] {
            let step = if column == 5 { 0.05 * 0.4 } else { 0.4 };
            let sides = [0.4, -0.4].map(|amount| measured(column, amount));
            // The tolerance is the force of one more slice, times its lever.
            let force = measured(0, 0.0)[0];
            let levers = [force, 5.0 * force, 5.0 * force, 5.0, 5.0];
            for (row, (more, less)) in sides[0].iter().zip(&sides[1]).enumerate() {
                let wanted = (more - less) / (2.0 * step);
                let value = found.values[row * 6 + column].unwrap();
                let noise = 2e-4 * levers[row].abs() / step;
                let off = (value - wanted).abs();
                assert!(
                    off < 0.02 * wanted.abs() + noise,
                    "{shape:?} {row} {column}: {value} {wanted}"
                );
            }
        }
    }
}

#[test]
fn stated_errors_cover_what_the_default_level_leaves_of_pins() {
    let uncut = Pose { planar: PlanarPose { x_mm: 1.0, y_mm: 0.4, rot_rad: 0.4 }, tilt_rad: 0.01 };
    let short = [
        (Shape::Cylinder { radius_mm: 6.0, length_mm: Some(8.0) }, uncut),
        (Shape::Bar { width_mm: 2.5, length_mm: Some(8.0) }, uncut),
    ];
    let drive = Prescribed::PenetrationMm(0.1);
    for (shape, pose) in cut_pins().into_iter().skip(2).chain(short) {
        let at = |level: Accuracy| {
            let mut scene = scene(shape, level).cut_at_array();
            feature_jacobian(&mut scene, drive, pose, &FEATURES, &MOTIONS).unwrap()
        };
        let (fine, found) = (at(Accuracy::Fine), at(Accuracy::Default));
        let mut close = 0;
        for (n, (value, truth)) in found.values.iter().zip(&fine.values).enumerate() {
            let (value, truth) = (value.unwrap(), truth.unwrap());
            let stated = found.errors[n].unwrap();
            let of = found.values[n / 6 * 6..n / 6 * 6 + 6].iter().flatten();
            let size = of.fold(0.0_f64, |most, value| most.max(value.abs()));
            let off = (value - truth).abs();
            assert!(off <= stated + 1e-9 * size, "{shape:?} {n}: {value} {truth} {stated}");
            close += usize::from(stated < 0.02 * size);
        }
        // Most derivatives agree relative to their own size, too.
        assert!(close > 38, "{shape:?}: {close}");
    }
}

/// Turned by `turn` rad about x (0) or y (1), the axis as a vector.
fn turned(pose: Pose, about: usize, turn: f64) -> Pose {
    let (s, c) = (libm::sin(pose.planar.rot_rad), libm::cos(pose.planar.rot_rad));
    let (down, along) = (libm::sin(pose.tilt_rad), libm::cos(pose.tilt_rad));
    let [x, y, z] = [-s * along, c * along, -down];
    let (sin, cos) = (libm::sin(turn), libm::cos(turn));
    let axis = if about == 0 {
        [x, cos * y - sin * z, sin * y + cos * z]
    } else {
        [cos * x + sin * z, y, cos * z - sin * x]
    };
    let rot_rad = libm::atan2(-axis[0], axis[1]);
    let tilt_rad = libm::asin(-axis[2]);
    Pose { planar: PlanarPose { rot_rad, ..pose.planar }, tilt_rad }
}

#[test]
fn a_tilted_pin_turns_about_the_axes_of_the_array() {
    let shape = Shape::Cylinder { radius_mm: 12.0, length_mm: Some(8.0) };
    let planar = PlanarPose { x_mm: 0.7, y_mm: -0.4, rot_rad: 0.5 };
    let (pose, drive) = (Pose { planar, tilt_rad: 0.12 }, Prescribed::PenetrationMm(-0.2));
    let features = [Feature::M0, Feature::Xc, Feature::Yc, Feature::ThetaLong];
    let motions = [Motion::RotX, Motion::RotY, Motion::RotZ];
    let mut pin = scene(shape, Accuracy::Default);
    let found = feature_jacobian(&mut pin, drive, pose, &features, &motions).unwrap();
    let mut measured = |pose: Pose| {
        pin.press(drive, pose).unwrap();
        let mut image = vec![0.0; 256];
        pin.image(&mut image).unwrap();
        let f = image_features(&Array::THESIS, &image, Part::Full).unwrap();
        [f.m0, f.xc.unwrap(), f.yc.unwrap(), f.theta_long_rad.unwrap()]
    };
    let step = 1e-3;
    for about in 0..2 {
        let sides = [step, -step].map(|turn| measured(turned(pose, about, turn)));
        for (row, (more, less)) in sides[0].iter().zip(&sides[1]).enumerate() {
            let wanted = (more - less) / (2.0 * step);
            let at = |column: usize| found.values[row * 3 + column].unwrap();
            let size = (0..3).fold(0.0_f64, |most, column| most.max(at(column).abs()));
            let off = (at(about) - wanted).abs();
            // The tangent of the tilt, an eighth, of the turn about z is what was left out.
            assert!(off < 1e-2 * size, "{about} {row}: {} {wanted}", at(about));
        }
    }
}

/// A contact just touched grows on one side only: no derivative, not one of the step's making.
#[test]
fn a_contact_without_force_has_no_derivatives() {
    for shape in [
        Shape::Sphere { radius_mm: 9.0 },
        Shape::Cylinder { radius_mm: 12.0, length_mm: Some(9.0) },
        Shape::Bar { width_mm: 2.0, length_mm: Some(6.0) },
    ] {
        let mut scene = scene(shape, Accuracy::Fast);
        let drive = Prescribed::ForceN(0.0);
        let found = feature_jacobian(&mut scene, drive, Pose::default(), &FEATURES, &MOTIONS);
        let found = found.expect("an answer");
        assert!(found.values.iter().chain(&found.errors).all(Option::is_none), "{shape:?}");
        assert_eq!(found.condition, None);
    }
}
