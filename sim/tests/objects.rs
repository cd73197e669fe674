//! Tests objects on the table: a finger on rails presses, slides off and comes back.

mod common;

use common::{at, bench, load_of, nominal, over, seconds};
use glam::DVec3;
use taktil_hal::{Arrival, Devices, TactileFrame};
use taktil_mechanics::tactile::{Features, Image, features, moments};
use taktil_sim::scene::{EdgeProfile, ObjectConfig, ObjectKind};
use taktil_sim::{ArrayGeometry, Carriage, Timing, World, WorldConfig, build};

/// Counts per newton: 4095 for 4 N.
const COUNTS_PER_N: f64 = 4095.0 / 4.0;
/// Height of the default object's top (m).
const TOP_M: f64 = -0.149;

fn with(object: ObjectConfig) -> WorldConfig {
    let mut config = WorldConfig { object: vec![object], ..WorldConfig::default() };
    config.pin.present = false;
    config.tactile.noise_counts = 0.0;
    config
}

fn features_of(devices: &mut Devices, t_s: f64) -> Features {
    let mut frame = TactileFrame::new(16, 16);
    assert_eq!(
        devices.tactile.get_mut("tactile").unwrap().sample(seconds(t_s), &mut frame),
        Ok(Arrival::New)
    );
    let values: Vec<f32> = frame.values.iter().map(|v| (f64::from(*v) - 300.0) as f32).collect();
    features(&moments(&Image::new(16, 16, &values, None).unwrap(), 0.0))
}

/// A floating finger under 8 N that is carried by `(dx, dy)` from 0.5 s to 2.5 s.
fn riding(config: &WorldConfig, dx: f64, dy: f64) -> (World, Devices) {
    let start = over(TOP_M + 1e-4);
    let knots = vec![(0.5, start), (2.5, start + DVec3::new(dx, dy, 0.0))];
    bench(config, Carriage { axes: nominal(), knots, float: load_of(8.0) })
}

/// A finger whose height is prescribed: at rest until 0.5 s, then moved in a second.
fn placed(config: &WorldConfig, from: DVec3, to: DVec3) -> (World, Devices) {
    let knots = vec![(0.5, from), (1.5, to)];
    bench(config, Carriage { axes: nominal(), knots, float: None })
}

const KINDS: [ObjectKind; 3] = [ObjectKind::Sphere, ObjectKind::Edge, ObjectKind::Bar];

#[test]
fn at_rest_the_object_carries_the_load_and_the_image_shows_it() {
    for kind in KINDS {
        let (mut world, mut devices) = riding(&with(ObjectConfig::of(kind)), 0.0, 0.0);
        let truth = at(&mut world, 2.0);
        let felt = truth.object.unwrap();
        assert!((felt.normal_n - 8.0).abs() < 1e-6, "{kind:?}: {}", felt.normal_n);
        assert!((truth.finger_normal_n - 8.0).abs() < 1e-6 && truth.in_contact);
        // The sensor looks down, so that a force that pushes it up pushes it along -z.
        assert!((truth.tool_wrench[2] + 8.0).abs() < 1e-6, "{}", truth.tool_wrench[2]);
        let seen = features_of(&mut devices, 2.0);
        let force = seen.m0 / COUNTS_PER_N;
        assert!((force - 8.0).abs() < 0.1, "{kind:?}: the image sums to {force} N");
        assert!((seen.x_c.unwrap() - 8.5).abs() < 0.02, "{:?}", seen.x_c);
        assert!((seen.y_c.unwrap() - 8.5).abs() < 0.02, "{:?}", seen.y_c);
    }
}

#[test]
fn the_images_middle_is_where_the_sphere_is() {
    let sphere = ObjectConfig { x_mm: 3.1, y_mm: -2.2, ..ObjectConfig::of(ObjectKind::Sphere) };
    let (mut world, mut devices) = riding(&with(sphere), 0.0, 0.0);
    let felt = at(&mut world, 2.0).object.unwrap();
    // The sensor's x is opposite to x0.
    assert!((felt.place_m.0 + 3.1e-3).abs() < 1e-9 && (felt.place_m.1 + 2.2e-3).abs() < 1e-9);
    let seen = features_of(&mut devices, 2.0);
    let mm = |place: Option<f64>| 1e3 * ArrayGeometry::THESIS.pitch_x_m * (place.unwrap() - 8.5);
    assert!((mm(seen.x_c) + 3.1).abs() < 0.02 && (mm(seen.y_c) + 2.2).abs() < 0.02, "{seen:?}");
}

#[test]
fn an_edges_image_is_turned_as_the_edge_is() {
    for yaw_deg in [-20.0, 7.0, 35.0] {
        let edge = ObjectConfig { yaw_deg, x_mm: 2.0, ..ObjectConfig::of(ObjectKind::Edge) };
        let (mut world, mut devices) = riding(&with(edge), 0.0, 0.0);
        let felt = at(&mut world, 2.0).object.unwrap();
        // About the sensor's z, which looks down, angles have the opposite sign.
        assert!((felt.yaw_rad.to_degrees() + yaw_deg).abs() < 1e-9, "{}", felt.yaw_rad);
        let across = 2e-3 * libm::cos(f64::to_radians(yaw_deg));
        assert!((felt.off_m + across).abs() < 1e-9, "{} {across}", felt.off_m);
        let theta = features_of(&mut devices, 2.0).theta_z_rad.unwrap();
        let off = (theta - felt.yaw_rad).to_degrees();
        assert!(off.abs() < 0.6, "{yaw_deg}: the image is off by {off} deg");
    }
}

#[test]
fn grazing_neither_pulls_nor_jumps() {
    for kind in KINDS {
        let from = over(TOP_M + 20e-6);
        let (mut world, _devices) =
            placed(&with(ObjectConfig::of(kind)), from, from - DVec3::new(0.0, 0.0, 40e-6));
        let mut last = 0.0;
        for i in 0..400 {
            let force = at(&mut world, 0.5 + 0.0025 * f64::from(i)).finger_normal_n;
            assert!(force >= 0.0 && force.is_finite());
            assert!(force - last < 0.2, "{kind:?}: from {last} to {force}");
            last = force;
        }
        assert!(last > 0.02, "{kind:?}: touched at last, {last}");
    }
}

#[test]
fn contact_is_lost_at_the_pads_edge_and_found_again() {
    for kind in KINDS {
        let deep = over(TOP_M - 60e-6);
        let away = deep + DVec3::new(0.03, 0.0, 0.0);
        let knots = vec![(0.2, deep), (1.2, away), (1.4, away), (2.4, deep)];
        let carriage = Carriage { axes: nominal(), knots, float: None };
        let (mut world, _devices) = bench(&with(ObjectConfig::of(kind)), carriage);
        let first = at(&mut world, 0.1).finger_normal_n;
        assert!(first > 0.3, "{kind:?}: {first}");
        let (mut last, mut lost) = (first, 0);
        for i in 0..920 {
            let truth = at(&mut world, 0.1 + 0.0025 * f64::from(i));
            let force = truth.finger_normal_n;
            assert!(force <= 1.3 * first, "{kind:?}: {force} {first}");
            lost += u32::from(last > 0.0 && force == 0.0);
            last = force;
        }
        assert_eq!(lost, 1, "{kind:?}");
        assert_eq!(at(&mut world, 1.3).finger_normal_n, last, "time does not go back");
        let back = at(&mut world, 2.6).finger_normal_n;
        assert!((back / first - 1.0).abs() < 1e-3, "{kind:?}: {first} before, {back} after");
    }
}

#[test]
fn past_the_limit_it_slides_at_mu_n() {
    for kind in KINDS {
        let sliding = ObjectConfig { friction: Some(0.3), ..ObjectConfig::of(kind) };
        let (mut world, _devices) = riding(&with(sliding), 0.0, 0.004);
        let truth = at(&mut world, 1.5);
        let felt = truth.object.unwrap();
        assert!(felt.slip_m_s > 1e-3, "{kind:?}: {}", felt.slip_m_s);
        let wrench = truth.tool_wrench;
        let drag = (wrench[0] * wrench[0] + wrench[1] * wrench[1]).sqrt();
        assert!((drag - 0.3 * felt.normal_n).abs() < 1e-9, "{kind:?}: {drag}");
        assert!(wrench[1] < 0.0, "against the motion: {}", wrench[1]);
    }
}

#[test]
fn a_table_takes_its_objects_along() {
    let mut config = with(ObjectConfig::of(ObjectKind::Sphere));
    config.table.pan_deg = 30.0;
    let truth = |config: &WorldConfig| {
        let (mut world, _devices) = placed(config, over(TOP_M - 5e-5), over(TOP_M - 5e-5));
        at(&mut world, 0.2)
    };
    assert!(truth(&config).in_contact, "it stands where the scene puts it, whatever the table");
    config.table.motion =
        vec![taktil_sim::scene::Motion::ramp(taktil_sim::scene::Axis::Height, -10.0, 0.05, 0.15)];
    assert!(!truth(&config).in_contact, "and goes down with it");
}

#[test]
fn the_truth_measures_the_length_along_the_curve() {
    let arc = ObjectConfig {
        profile: Some(EdgeProfile::Arc),
        arc_radius_mm: Some(40.0),
        ..ObjectConfig::of(ObjectKind::Edge)
    };
    let (mut world, _devices) = placed(&with(arc), over(-0.1), over(-0.1) + 0.03 * DVec3::Y);
    assert!(at(&mut world, 0.2).object.unwrap().along_m.abs() < 1e-12);
    let felt = at(&mut world, 2.0).object.unwrap();
    // 30 mm on along the tangent of an arc of 40 mm: seen from its middle under atan(3/4).
    assert!((felt.along_m - 0.04 * libm::atan(0.75)).abs() < 1e-9, "{}", felt.along_m);
    assert!((felt.off_m.abs() - 0.01).abs() < 1e-9, "{}", felt.off_m);
    assert!((felt.yaw_rad.abs() - libm::atan(0.75)).abs() < 1e-9, "{}", felt.yaw_rad);
}

#[test]
fn equal_runs_are_equal_and_absent_parts_cost_nothing() {
    let hash = |config: &WorldConfig| {
        let (mut world, _devices) = riding(config, 0.003, 0.002);
        at(&mut world, 1.7);
        (world.state_hash(), world.statistics())
    };
    let config = with(ObjectConfig::of(ObjectKind::Edge));
    assert_eq!(hash(&config), hash(&config));
    let bare = WorldConfig { object: Vec::new(), ..config };
    let work = hash(&bare).1;
    assert_eq!((work.contact_evaluations, work.tactile_images), (0, 0));
}

#[test]
fn impossible_values_are_refused_with_their_place() {
    let place = |config: WorldConfig| {
        build(&config, &Timing::default(), 1).map(|_| ()).map_err(|bad| bad.place).unwrap_err()
    };
    let sphere = ObjectConfig::of(ObjectKind::Sphere);
    assert_eq!(place(with(ObjectConfig { x_mm: f64::NAN, ..sphere })), "object[0].x_mm");
    assert_eq!(place(with(ObjectConfig { top_mm: -1.0, ..sphere })), "object[0].top_mm");
    assert_eq!(place(WorldConfig { object: vec![sphere; 5], ..WorldConfig::default() }), "object");
    let mut euler = with(sphere);
    euler.fidelity.integrator = taktil_sim::fidelity::Integrator::Euler;
    assert_eq!(place(euler), "fidelity.integrator");
}
