//! The simulator's pin on its pad against the exact reference images, held to the figures that are
//! stated of it, and what is done where it cannot be solved.

use glam::{DMat3, DVec3};
use taktil_contact::features::{Part, image_features};

use taktil_hal::Nanos;

use super::*;
use crate::contact::Surface;
use crate::fidelity::ContactModel;
use crate::pin::Pin;
use crate::scene::{EdgeProfile, ObjectConfig, ObjectKind};
use crate::{Carriage, Timing, World, WorldConfig, build_with_carriage};

const FEATURES: &str = include_str!("../../../tests/fixtures/contact/tactile3d_features.csv");

struct Case {
    name: String,
    numbers: Vec<f64>,
}

/// Area means of pins: numbers from nu on.
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

/// The pad lies in the base frame's xy plane, the pin over it as the case says.
fn over_pad(case: &Case) -> (Pin, Surface, Pose) {
    let n = &case.numbers;
    let (radius, delta, x, y) = (1e-3 * n[2], 1e-3 * n[5], 1e-3 * n[6], 1e-3 * n[7]);
    let (rot, tilt, length) = (n[8].to_radians(), n[9], 1e-3 * n[10]);
    // The axis dips towards its end by the tilt.
    let turn =
        taktil_mechanics::spatial::rotation_z(rot) * taktil_mechanics::spatial::rotation_x(-tilt);
    let lowest = DVec3::new(x, y, -delta);
    let pin_axes = DMat3::from_cols(turn.x_axis, turn.y_axis, turn.z_axis);
    let centre = lowest + radius * pin_axes.z_axis;
    let pin = Pin::at_rest(centre, &pin_axes, (radius, length), 0.1);
    let pad = Pose::IDENTITY;
    (pin, Surface::of_pad(&pad, &taktil_mechanics::Joints::zeros()), pad)
}

#[test]
fn pressed_pins_give_the_reference_images() {
    let area = (1e3 * PITCH_M) * (1e3 * PITCH_M);
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
            let mut spatial =
                Spatial::new(&rubber, (pin.radius_m, pin.length_m), level, "finger.rubber")
                    .unwrap();
            let line = Line::between(&pin, pin.axis(), &surface).unwrap();
            spatial.solve(&line, &pad).expect("inside the tables");
            let forces = spatial.forces_n();
            let stresses: Vec<f64> = forces.iter().map(|f| -f / area).collect();
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
fn a_piece_counts_by_what_of_it_is_over_the_pad() {
    let part = |place, direction, length| part_over(place, direction, length, 10.0);
    for (swap, sign) in [(false, 1.0), (false, -1.0), (true, 1.0), (true, -1.0)] {
        let of = |x: f64, y: f64| if swap { [sign * y, sign * x] } else { [sign * x, sign * y] };
        // Along one side of the pad: inside, across its end, on it, beyond it, and on the edge.
        assert_eq!(part(of(0.0, 3.0), of(1.0, 0.0), 2.0), (1.0, 0.0));
        assert_eq!(part(of(9.5, 3.0), of(1.0, 0.0), 2.0), (0.75, -0.25));
        assert_eq!(part(of(10.0, 3.0), of(1.0, 0.0), 2.0), (0.5, -0.5));
        assert_eq!(part(of(11.0, 3.0), of(1.0, 0.0), 2.0), (0.0, 0.0));
        assert_eq!(part(of(0.0, 10.0), of(1.0, 0.0), 2.0), (0.5, 0.0));
        assert_eq!(part(of(10.0, 10.0), of(1.0, 0.0), 2.0), (0.25, -0.5));
        assert_eq!(part(of(0.0, 10.5), of(1.0, 0.0), 2.0).0, 0.0);
        // Askew over the corner: what is over both sides.
        let (s, c) = (0.6, 0.8);
        let (over, off) = part(of(9.8, 9.7), of(c, s), 2.0);
        assert!((over - 0.5 * (1.0 + 0.25)).abs() < 1e-12, "{over}");
        assert!((off + 0.375).abs() < 1e-12, "{off}");
    }
    assert_eq!(part([0.0, 0.0], [0.0, 1.0], 0.0), (1.0, 0.0));
}

/// As a pin leaves over a side, along whatever axis, its force leaves the pad as evenly as the
/// tactels see it go, a slice's length or not.
#[test]
fn a_pin_leaves_the_pad_alike_in_all_directions() {
    let rubber =
        RubberConfig { thickness_mm: 0.8, youngs_mpa: 27.58, poisson: 0.49, relaxation_ms: 0.0 };
    let (radius, length) = (0.023, 0.01);
    for level in [Accuracy::Fast, Accuracy::Default] {
        let mut spatial = Spatial::new(&rubber, (radius, length), level, "finger.rubber").unwrap();
        let mut pressed = |rot: f64, out_m: f64, across_m: f64| {
            let axes = taktil_mechanics::spatial::rotation_z(rot);
            let lowest = out_m * axes.y_axis + across_m * axes.x_axis - 1.2e-5 * axes.z_axis;
            let pin = Pin::at_rest(lowest + radius * axes.z_axis, &axes, (radius, length), 0.1);
            let surface = Surface::of_pad(&Pose::IDENTITY, &taktil_mechanics::Joints::zeros());
            let line = Line::between(&pin, pin.axis(), &surface).unwrap();
            let solved = spatial.solve(&line, &Pose::IDENTITY).expect("inside the tables");
            (solved, spatial.forces_n().iter().sum::<f64>())
        };
        let quarter = core::f64::consts::FRAC_PI_2;
        let whole = pressed(0.0, 0.0, 0.0).0.force_n;
        for step in [0, 2, 4, 5, 8] {
            // In steps of a part of a slice; the fourth has its middle on the edge.
            let out_m = PAD_HALF_M + 1.1e-4 * f64::from(step - 4);
            let along_y = pressed(0.0, out_m, 1e-3);
            for rot in [quarter, -quarter, 2.0 * quarter] {
                let (solved, seen) = pressed(rot, out_m, 1e-3);
                let off = (solved.force_n - along_y.0.force_n) / whole;
                assert!(off.abs() < 1e-5, "{level:?} {rot} {step}: {solved:?} {along_y:?}");
                let off = (solved.moment_nm - along_y.0.moment_nm) / (whole * length);
                assert!(off.abs() < 1e-5, "{level:?} {rot} {step}: {solved:?} {along_y:?}");
                // The layer carries as much out over the side as in.
                let off = (seen - solved.force_n) / whole;
                assert!(off.abs() < 3e-3, "{level:?} {rot} {step}: {off:e}");
            }
        }
        // The axis on the pad's side: half of it, and all that is finite.
        for rot in [0.0, quarter] {
            let (solved, seen) = pressed(rot, 0.0, PAD_HALF_M);
            assert!((solved.force_n / whole - 0.5).abs() < 1e-4, "{level:?} {rot}: {solved:?}");
            assert!((seen / whole - 0.5).abs() < 3e-3, "{level:?} {rot}: {seen}");
        }
    }
}

/// A pin over the whole pad and beyond: what it presses on the pad is what the tactels see, but for
/// what the layer carries over the pad's edge in and out.
#[test]
fn the_force_on_the_pad_is_what_its_tactels_see() {
    let rubber =
        RubberConfig { thickness_mm: 0.8, youngs_mpa: 27.58, poisson: 0.49, relaxation_ms: 0.0 };
    for level in [Accuracy::Fast, Accuracy::Default] {
        let mut spatial = Spatial::new(&rubber, (0.023, 0.06), level, "finger.rubber").unwrap();
        for (rot, tilt, y_m) in [(0.0, 0.0, 0.0), (0.03, 2e-4, 1e-3), (-0.1, -3e-4, -2.3e-3)] {
            let turn = taktil_mechanics::spatial::rotation_z(rot)
                * taktil_mechanics::spatial::rotation_x(-tilt);
            let axes = DMat3::from_cols(turn.x_axis, turn.y_axis, turn.z_axis);
            let lowest = DVec3::new(1e-3, y_m, -1.2e-5);
            let pin = Pin::at_rest(lowest + 0.023 * axes.z_axis, &axes, (0.023, 0.06), 0.1);
            let surface = Surface::of_pad(&Pose::IDENTITY, &taktil_mechanics::Joints::zeros());
            let line = Line::between(&pin, pin.axis(), &surface).unwrap();
            let solved = spatial.solve(&line, &Pose::IDENTITY).expect("inside the tables");
            let seen: f64 = spatial.forces_n().iter().sum();
            let off = seen / solved.force_n - 1.0;
            assert!(off.abs() < 2e-3, "{level:?} {rot} {tilt}: {seen} N of {solved:?}: {off:e}");
        }
    }
}

#[test]
fn rows_stand_on_their_own_again_once_the_finger_has_left() {
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
    let lean = |world: &World| world.bench.rolling.as_deref().map(|rolling| rolling.pad.lean);
    assert_eq!(lean(&world), Some(Lean::NONE));
    world.advance(Nanos::from_millis(400));
    assert!(world.truth().in_contact);
    assert_ne!(lean(&world), Some(Lean::NONE));
    world.advance(Nanos::from_millis(900));
    assert!(!world.truth().in_contact);
    assert_eq!(lean(&world), Some(Lean::NONE));
}

/// Images solved and images after which rows stood on their own.
fn tally(config: &WorldConfig, up_m: f64) -> (u64, u64) {
    let top = 1e-3 * (config.table_height_mm() + 2.0 * config.pin.radius_mm);
    let at = |up: f64| DVec3::new(0.325, -0.127, top + up);
    let knots = vec![(0.1, at(1e-3)), (0.3, at(up_m))];
    let axes = DMat3::from_cols(-DVec3::X, DVec3::Y, -DVec3::Z);
    let carriage = Carriage { axes, knots, float: None };
    let (mut world, _devices) =
        build_with_carriage(config, &Timing::default(), 1, carriage).unwrap();
    assert_eq!(world.solves_layers(), config.fidelity.contact == ContactModel::Layer3d);
    world.advance(Nanos::from_millis(400));
    assert!(world.truth().in_contact);
    (world.work().solved, world.work().plain)
}

#[test]
fn where_rows_stand_on_their_own_it_is_counted() {
    let mut config = WorldConfig::default();
    config.pin.length_mm = 20.0;
    assert_eq!(tally(&config, -2e-4), (0, 0), "nobody asked");
    config.fidelity.contact = ContactModel::Layer3d;
    let (solved, plain) = tally(&config, -2e-4);
    assert!(solved > 20 && plain == 0, "{solved} {plain}");
    // Far beyond small strain the tables end.
    config.table.rubber.youngs_mpa = 500.0;
    let (solved, plain) = tally(&config, -7e-4);
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
        edge.bend_mm = (!is_solved).then_some(100.0);
        let above_pin_mm = edge.top_mm - 2.0 * config.pin.radius_mm;
        config.object = vec![edge];
        let (solved, plain) = tally(&config, 1e-3 * above_pin_mm - 1e-4);
        assert_eq!((solved > 5, plain > 5), (is_solved, !is_solved), "{solved} {plain}");
    }
}
