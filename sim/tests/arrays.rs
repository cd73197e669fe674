//! Tactile arrays of other sizes than 16 x 16 under the pin: what their frames show of its force
//! and place, at every level of the contact, whole and from a snapshot.

use glam::DVec3;
use taktil_hal::{Devices, Nanos, TactileFrame};
use taktil_sim::fidelity::ContactModel;
use taktil_sim::{Carriage, FloatingGuide, Timing, World, WorldConfig, build_with_carriage};

/// An array of the scene: rows, columns, pitch along x and along y (mm).
type Sizes = (u32, u32, f64, f64);

const SIZES: [Sizes; 6] = [
    (16, 16, 1.5875, 1.5875),
    (12, 32, 2.0, 2.0),
    (16, 32, 1.0, 2.0),
    (64, 64, 0.5, 0.5),
    (16, 16, 5.0, 5.0),
    (1, 64, 0.5, 3.0),
];

fn world(sizes: Sizes, contact: ContactModel) -> WorldConfig {
    let mut world = WorldConfig::default();
    let tactile = &mut world.tactile;
    (tactile.rows, tactile.cols, tactile.pitch_x_mm, tactile.pitch_y_mm) = sizes;
    (tactile.bits, tactile.noise_counts, tactile.rest_counts) = (16, 0.0, 300.0);
    world.fidelity.contact = contact;
    world
}

/// The finger pressed onto the pin, which lies `x_mm` beside the middle of the pad.
fn pressed(config: &WorldConfig, x_mm: f64) -> (World, Devices) {
    let axes = glam::DMat3::from_cols(DVec3::X, -DVec3::Y, -DVec3::Z);
    let above_mm = config.table_height_mm() + 2.0 * config.pin.radius_mm + 0.5;
    let knots = vec![(0.0, 1e-3 * DVec3::new(325.0, -127.0, above_mm))];
    let float = Some(FloatingGuide { mass_kg: 1.0, load_n: 14.65, damping_n_s_m: 200.0 });
    let mut config = config.clone();
    (config.pin.x_mm, config.pin.y_mm) = (x_mm, 0.0);
    let carriage = Carriage { axes, knots, float };
    let (mut world, devices) =
        build_with_carriage(&config, &Timing::default(), 1, carriage).unwrap();
    world.advance(Nanos::from_millis(500));
    (world, devices)
}

fn frame(world: &World, devices: &mut Devices) -> TactileFrame {
    let array = devices.tactile.get_mut("tactile").unwrap();
    let mut frame = TactileFrame::of(array.as_ref());
    array.sample(world.now(), &mut frame).unwrap();
    frame
}

/// Force (N) and load-weighted column number of a frame.
fn force_and_column(config: &WorldConfig, frame: &TactileFrame) -> (f64, f64) {
    let tactile = &config.tactile;
    let per_n = f64::from(u16::MAX) / tactile.full_scale_n;
    let (mut sum, mut first) = (0.0, 0.0);
    for (index, value) in frame.values.iter().enumerate() {
        let force = (f64::from(*value) - tactile.rest_counts) / per_n;
        sum += force;
        first += force * (index % tactile.cols as usize + 1) as f64;
    }
    (sum, first / sum)
}

#[test]
fn every_array_shows_the_force_and_the_place_of_the_pin() {
    for contact in [ContactModel::Line, ContactModel::Layer2d, ContactModel::Layer3d] {
        for sizes in SIZES {
            // A row of 0.5 by 3 mm has pitches that no few squares fit.
            if contact == ContactModel::Layer3d && sizes == (1, 64, 0.5, 3.0) {
                continue;
            }
            let config = world(sizes, contact);
            let (world, mut devices) = pressed(&config, 1.2);
            let truth = world.truth();
            let frame = frame(&world, &mut devices);
            assert_eq!((u32::from(frame.rows()), u32::from(frame.cols())), (sizes.0, sizes.1));
            let (force_n, column) = force_and_column(&config, &frame);
            let name = format!("{contact:?} {sizes:?}");
            // The layer carries a little over the border of the pad.
            assert!((force_n / truth.finger_normal_n - 1.0).abs() < 0.02, "{name}: {force_n} N");
            let due = truth.contact_x_tactels.unwrap();
            // A load narrower than a tactel does not show where inside the tactel it lies.
            let bar = if sizes.2 > 3.0 { 0.3 } else { 0.03 / sizes.2 };
            assert!((column - due).abs() < bar, "{name}: column {column} of {due}");
            assert!((truth.finger_normal_n - 14.65).abs() < 0.3, "{name}: {truth:?}");
        }
    }
}

#[test]
fn a_snapshot_of_any_array_goes_on_alike() {
    for sizes in [(12, 32, 2.0, 2.0), (64, 64, 0.5, 0.5), (1, 64, 0.5, 3.0)] {
        let mut config = world(sizes, ContactModel::Line);
        (config.tactile.noise_counts, config.tactile.delay_scans) = (20.0, 2);
        config.tactile.row_us = 50.0;
        let (mut world, mut devices) = pressed(&config, 0.0);
        let (mut again, mut other) = world.snapshot().restore();
        let (now, then) = (frame(&world, &mut devices), frame(&again, &mut other));
        assert_eq!(now, then, "{sizes:?}");
        for _ in 0..5 {
            let to = world.now() + Nanos::from_millis(5);
            world.advance(to);
            again.advance(to);
            assert_eq!(frame(&world, &mut devices), frame(&again, &mut other), "{sizes:?}");
        }
        assert_eq!(world.state_hash(), again.state_hash(), "{sizes:?}");
    }
}

#[test]
fn sizes_that_cannot_be_are_refused_with_their_place() {
    let place = |sizes: Sizes, contact| {
        let config = world(sizes, contact);
        let built = taktil_sim::build(&config, &Timing::default(), 1);
        built.map(|_| ()).map_err(|bad| bad.place)
    };
    let line = ContactModel::Line;
    assert_eq!(place((64, 64, 1.0, 1.0), line), Ok(()));
    assert_eq!(place((0, 16, 1.0, 1.0), line), Err("tactile.rows".to_owned()));
    assert_eq!(place((65, 16, 1.0, 1.0), line), Err("tactile.rows".to_owned()));
    assert_eq!(place((16, 65, 1.0, 1.0), line), Err("tactile.cols".to_owned()));
    assert_eq!(place((16, 16, f64::NAN, 1.0), line), Err("tactile.pitch_x_mm".to_owned()));
    assert_eq!(place((16, 16, 1.0, 1.7), line), Ok(()));
    let solved = place((16, 16, 1.0, 1.7), ContactModel::Layer3d);
    assert_eq!(solved, Err("tactile.pitch_y_mm".to_owned()));
}
