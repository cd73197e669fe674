//! Compares the contact of pin and pad in three dimensions with the exact reference images, and
//! checks what happens where it cannot be solved.

use glam::{DMat3, DVec3};
use taktil_contact::features::{Part, image_features};
use taktil_contact::space::tactels::Array;

use taktil_hal::Nanos;

use super::*;
use crate::contact::Surface;
use crate::pin::Pin;
use crate::scene::fidelity::ContactModel;
use crate::scene::{EdgeProfile, ObjectConfig, ObjectKind};
use crate::{Carriage, Timing, World, WorldConfig, build_with_carriage};

const FEATURES: &str = include_str!("../../../tests/fixtures/contact/tactile3d_features.csv");

/// A pad of sixteen rows and columns.
fn section(rubber: &RubberConfig) -> PadSection<'_> {
    const ARRAY: &ArrayGeometry = &ArrayGeometry::THESIS;
    PadSection { array: ARRAY, array_place: "tactile", rubber, rubber_place: "finger.rubber" }
}

struct Case {
    name: String,
    numbers: Vec<f64>,
}

/// Reference cases of pins with area means; the numbers are the columns from nu on.
fn pins() -> Vec<Case> {
    let lines = FEATURES.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
    let all: Vec<Case> = lines
        .filter(|cells| cells[1] == "average" && cells[2] == "cylinder")
        .map(|cells| Case {
            name: cells[0].to_owned(),
            numbers: cells[3..].iter().map(|cell| cell.trim().parse().unwrap()).collect(),
        })
        .collect();
    assert!(all.len() > 5, "an empty table checks nothing");
    all
}

/// A pin over a pad that lies in the xy plane of the base frame, as the case says.
fn over_pad(case: &Case) -> (Pin, Surface, Pose) {
    let n = &case.numbers;
    let (radius, delta, x, y) = (1e-3 * n[2], 1e-3 * n[5], 1e-3 * n[6], 1e-3 * n[7]);
    let (rot, tilt, length) = (n[8].to_radians(), n[9], 1e-3 * n[10]);
    // The axis is tilted downwards towards its end.
    let turn =
        taktil_mechanics::spatial::rotation_z(rot) * taktil_mechanics::spatial::rotation_x(-tilt);
    let lowest = DVec3::new(x, y, -delta);
    let pin_axes = DMat3::from_cols(turn.x_axis, turn.y_axis, turn.z_axis);
    let centre = lowest + radius * pin_axes.z_axis;
    let size = CylinderSize { radius_m: radius, length_m: length };
    let pin = Pin::at_rest(centre, &pin_axes, size, 0.1);
    let pad = Pose::IDENTITY;
    (pin, Surface::of_pad(&pad, &taktil_mechanics::Joints::zeros()), pad)
}

#[test]
fn pressed_pins_give_the_reference_images() {
    let area = ArrayGeometry::THESIS.tactel_mm2();
    for (level, [force_bar, centroid_bar, direction_bar]) in
        [(Accuracy::Default, [8e-4, 1.3e-3, 2e-3]), (Accuracy::Fast, [4e-3, 6e-3, 0.08])]
    {
        let mut worst = [0.0_f64; 3];
        for case in pins() {
            let n = &case.numbers;
            let rubber = RubberConfig {
                thickness_mm: n[1],
                youngs_mpa: 27.58,
                poisson: n[0],
                relaxation_ms: 0.0,
            };
            let (pin, surface, pad) = over_pad(&case);
            let size = CylinderSize { radius_m: pin.radius_m, length_m: pin.length_m };
            let mut spatial = SpatialSolver::new(&section(&rubber), size, level).unwrap();
            let line = ContactLine::on_pad(&pin, pin.axis(), &surface).unwrap();
            spatial.solve(&line, &pad).expect("inside the tables");
            let forces = spatial.tactel_forces_n();
            let stresses: Vec<f64> = forces.map(|f| -f / area).collect();
            let found = image_features(&Array::THESIS, &stresses, Part::Full).unwrap();
            let (m0, x_c, y_c, theta) = (n[11], n[14], n[15], n[19]);
            let off = found.theta_long_rad.unwrap() - theta;
            let off = off - core::f64::consts::PI * (off / core::f64::consts::PI).round();
            let apart = [found.xc.unwrap() - x_c, found.yc.unwrap() - y_c];
            let errors = [
                (found.m0 / m0 - 1.0).abs(),
                apart[0].abs().max(apart[1].abs()),
                off.abs().to_degrees(),
            ];
            for (worst, error) in worst.iter_mut().zip(errors) {
                *worst = worst.max(error);
            }
            assert!(errors[0] < force_bar, "{}: force {errors:?}", case.name);
            assert!(errors[1] < centroid_bar, "{}: centroid {errors:?}", case.name);
            assert!(errors[2] < direction_bar, "{}: direction {errors:?}", case.name);
        }
        println!(
            "{level:?}: force {:.1e}, centroid {:.1e} mm, {:.1e} deg",
            worst[0], worst[1], worst[2]
        );
    }
}

#[test]
fn a_segment_counts_by_its_part_over_the_pad() {
    let part = |place, direction, length| overlap(place, direction, length, [10.0; 2]);
    for (swap, sign) in [(false, 1.0), (false, -1.0), (true, 1.0), (true, -1.0)] {
        let of = |x: f64, y: f64| if swap { [sign * y, sign * x] } else { [sign * x, sign * y] };
        // The segment is parallel to a side of the pad: inside, across the end, on the side, beyond
        // it, and at the corner.
        assert_eq!(part(of(0.0, 3.0), of(1.0, 0.0), 2.0), (1.0, 0.0));
        assert_eq!(part(of(9.5, 3.0), of(1.0, 0.0), 2.0), (0.75, -0.25));
        assert_eq!(part(of(10.0, 3.0), of(1.0, 0.0), 2.0), (0.5, -0.5));
        assert_eq!(part(of(11.0, 3.0), of(1.0, 0.0), 2.0), (0.0, 0.0));
        assert_eq!(part(of(0.0, 10.0), of(1.0, 0.0), 2.0), (0.5, 0.0));
        assert_eq!(part(of(10.0, 10.0), of(1.0, 0.0), 2.0), (0.25, -0.5));
        assert_eq!(part(of(0.0, 10.5), of(1.0, 0.0), 2.0).0, 0.0);
        // The segment crosses the corner at an angle; both of its parts count.
        let (s, c) = (0.6, 0.8);
        let (over, off) = part(of(9.8, 9.7), of(c, s), 2.0);
        assert!((over - 0.5 * (1.0 + 0.25)).abs() < 1e-12, "{over}");
        assert!((off + 0.375).abs() < 1e-12, "{off}");
    }
    assert_eq!(part([0.0, 0.0], [0.0, 1.0], 0.0), (1.0, 0.0));
}

/// A pin that leaves the pad over a side loses its force evenly, whatever the direction of its
/// axis, just as the tactels see it.
#[test]
fn a_pin_leaves_the_pad_alike_in_all_directions() {
    let rubber =
        RubberConfig { thickness_mm: 0.8, youngs_mpa: 27.58, poisson: 0.49, relaxation_ms: 0.0 };
    let (radius, length) = (0.023, 0.01);
    let size = CylinderSize { radius_m: radius, length_m: length };
    for level in [Accuracy::Fast, Accuracy::Default] {
        let mut spatial = SpatialSolver::new(&section(&rubber), size, level).unwrap();
        let mut pressed = |rot: f64, out_m: f64, across_m: f64| {
            let axes = taktil_mechanics::spatial::rotation_z(rot);
            let lowest = out_m * axes.y_axis + across_m * axes.x_axis - 1.2e-5 * axes.z_axis;
            let pin = Pin::at_rest(lowest + radius * axes.z_axis, &axes, size, 0.1);
            let surface = Surface::of_pad(&Pose::IDENTITY, &taktil_mechanics::Joints::zeros());
            let line = ContactLine::on_pad(&pin, pin.axis(), &surface).unwrap();
            let solved = spatial.solve(&line, &Pose::IDENTITY).expect("inside the tables");
            (solved, spatial.tactel_forces_n().sum::<f64>())
        };
        let quarter = core::f64::consts::FRAC_PI_2;
        let whole = pressed(0.0, 0.0, 0.0).0.force_n;
        for step in [0, 2, 4, 5, 8] {
            // The steps are parts of a slice; the fourth has its middle on the edge.
            let out_m = ArrayGeometry::THESIS.half_x_m() + 1.1e-4 * f64::from(step - 4);
            let along_y = pressed(0.0, out_m, 1e-3);
            for rot in [quarter, -quarter, 2.0 * quarter] {
                let (solved, seen) = pressed(rot, out_m, 1e-3);
                let off = (solved.force_n - along_y.0.force_n) / whole;
                assert!(off.abs() < 1e-5, "{level:?} {rot} {step}: {solved:?} {along_y:?}");
                let off = (solved.moment_nm - along_y.0.moment_nm) / (whole * length);
                assert!(off.abs() < 1e-5, "{level:?} {rot} {step}: {solved:?} {along_y:?}");
                // The layer carries as much force out over the side as in.
                let off = (seen - solved.force_n) / whole;
                assert!(off.abs() < 3e-3, "{level:?} {rot} {step}: {off:e}");
            }
        }
        // With the axis on the pad's side, half of the force is on the pad, and every number is
        // finite.
        for rot in [0.0, quarter] {
            let (solved, seen) = pressed(rot, 0.0, ArrayGeometry::THESIS.half_x_m());
            assert!((solved.force_n / whole - 0.5).abs() < 1e-4, "{level:?} {rot}: {solved:?}");
            assert!((seen / whole - 0.5).abs() < 3e-3, "{level:?} {rot}: {seen}");
        }
    }
}

/// The force of a pin that is longer than the pad is the force that the tactels see, except for the
/// force that the layer carries over the pad's edge.
#[test]
fn the_force_on_the_pad_is_what_its_tactels_see() {
    let rubber =
        RubberConfig { thickness_mm: 0.8, youngs_mpa: 27.58, poisson: 0.49, relaxation_ms: 0.0 };
    let size = CylinderSize { radius_m: 0.023, length_m: 0.06 };
    for level in [Accuracy::Fast, Accuracy::Default] {
        let mut spatial = SpatialSolver::new(&section(&rubber), size, level).unwrap();
        for (rot, tilt, y_m) in [(0.0, 0.0, 0.0), (0.03, 2e-4, 1e-3), (-0.1, -3e-4, -2.3e-3)] {
            let turn = taktil_mechanics::spatial::rotation_z(rot)
                * taktil_mechanics::spatial::rotation_x(-tilt);
            let axes = DMat3::from_cols(turn.x_axis, turn.y_axis, turn.z_axis);
            let lowest = DVec3::new(1e-3, y_m, -1.2e-5);
            let pin = Pin::at_rest(lowest + 0.023 * axes.z_axis, &axes, size, 0.1);
            let surface = Surface::of_pad(&Pose::IDENTITY, &taktil_mechanics::Joints::zeros());
            let line = ContactLine::on_pad(&pin, pin.axis(), &surface).unwrap();
            let solved = spatial.solve(&line, &Pose::IDENTITY).expect("inside the tables");
            let seen: f64 = spatial.tactel_forces_n().sum();
            let off = seen / solved.force_n - 1.0;
            assert!(off.abs() < 2e-3, "{level:?} {rot} {tilt}: {seen} N of {solved:?}: {off:e}");
        }
    }
}

#[test]
fn rows_are_independent_again_once_the_finger_has_left() {
    let mut config = WorldConfig::default();
    config.fidelity.contact = ContactModel::Layer3d;
    config.pin.length_mm = 20.0;
    let top = 1e-3 * (config.table_height_mm() + 2.0 * config.pin.radius_mm);
    let at = |up: f64| DVec3::new(0.325, -0.127, top + up);
    let knots = vec![(0.1, at(1e-3)), (0.3, at(-2e-4)), (0.5, at(-2e-4)), (0.7, at(1e-3))];
    let axes = DMat3::from_cols(-DVec3::X, DVec3::Y, -DVec3::Z);
    let carriage = Carriage { axes, knots, float: None };
    let (mut world, _devices) =
        build_with_carriage(&config, &Timing::default(), 1, carriage).unwrap();
    let load_factor = |world: &World| world.plant.rolling().map(|rolling| rolling.pad.load_factor);
    assert_eq!(load_factor(&world), Some(LoadFactor::ONE));
    world.advance(Nanos::from_millis(400));
    assert!(world.truth().in_contact);
    assert_ne!(load_factor(&world), Some(LoadFactor::ONE));
    world.advance(Nanos::from_millis(900));
    assert!(!world.truth().in_contact);
    assert_eq!(load_factor(&world), Some(LoadFactor::ONE));
}

/// Numbers of images that were solved and of images that were made from independent rows.
fn solve_counts(config: &WorldConfig, up_m: f64) -> (u64, u64) {
    let top = 1e-3 * (config.table_height_mm() + 2.0 * config.pin.radius_mm);
    let at = |up: f64| DVec3::new(0.325, -0.127, top + up);
    let knots = vec![(0.1, at(1e-3)), (0.3, at(up_m))];
    let axes = DMat3::from_cols(-DVec3::X, DVec3::Y, -DVec3::Z);
    let carriage = Carriage { axes, knots, float: None };
    let (mut world, _devices) =
        build_with_carriage(config, &Timing::default(), 1, carriage).unwrap();
    assert_eq!(
        world.solves_in_three_dimensions(),
        config.fidelity.contact == ContactModel::Layer3d
    );
    world.advance(Nanos::from_millis(400));
    assert!(world.truth().in_contact);
    (world.statistics().spatial_solutions, world.statistics().spatial_failures)
}

#[test]
fn images_of_independent_rows_are_counted() {
    let mut config = WorldConfig::default();
    config.pin.length_mm = 20.0;
    assert_eq!(solve_counts(&config, -2e-4), (0, 0), "nobody is_spatial");
    config.fidelity.contact = ContactModel::Layer3d;
    let (solved, plain) = solve_counts(&config, -2e-4);
    assert!(solved > 20 && plain == 0, "{solved} {plain}");
    // The tables end far beyond small strain.
    config.table.rubber.youngs_mpa = 500.0;
    let (solved, plain) = solve_counts(&config, -7e-4);
    assert!(solved > 5 && plain > 10, "{solved} {plain}");
}

#[test]
fn edges_that_cannot_be_solved_are_counted_as_well() {
    let mut config = WorldConfig::default();
    config.fidelity.contact = ContactModel::Layer3d;
    config.pin.present = false;
    for (profile, is_solved) in [(EdgeProfile::Straight, true), (EdgeProfile::Arc, false)] {
        let mut edge = ObjectConfig::of(ObjectKind::Edge);
        (edge.radius_mm, edge.length_mm, edge.profile) = (Some(5.0), Some(20.0), Some(profile));
        edge.arc_radius_mm = (!is_solved).then_some(100.0);
        let above_pin_mm = edge.top_mm - 2.0 * config.pin.radius_mm;
        config.object = vec![edge];
        let (solved, plain) = solve_counts(&config, 1e-3 * above_pin_mm - 1e-4);
        assert_eq!((solved > 5, plain > 5), (is_solved, !is_solved), "{solved} {plain}");
    }
}
