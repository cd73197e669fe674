//! Tests the second fingertip under the pin: the image of its array, the motion of its mount, its
//! cost.

mod common;

use common::{at, bench, load_of, meeting_height, nominal, over, seconds};
use glam::DVec3;
use taktil_hal::{Arrival, Devices, TactileFrame};
use taktil_mechanics::tactile::{Features, Image, Moments, features, moments};
use taktil_sim::scene::{Axis, Fault, FaultKind, Motion};
use taktil_sim::{ArrayGeometry, Carriage, World, WorldConfig};

fn config() -> WorldConfig {
    let mut config = WorldConfig::default();
    config.opposed.present = true;
    config.opposed.rubber = config.finger.rubber;
    config.tactile.noise_counts = 0.0;
    config.opposed.tactile.noise_counts = 0.0;
    config
}

fn pressing(config: &WorldConfig, dx: f64) -> (World, Devices) {
    let z = meeting_height(config) + 1e-4;
    let knots = vec![(0.5, over(z)), (2.0, over(z) + DVec3::new(dx, 0.0, 0.0))];
    bench(config, Carriage { axes: nominal(), knots, float: load_of(15.0) })
}

/// The newest frames of both arrays, the finger's first.
fn frames(devices: &mut Devices, t_s: f64) -> [TactileFrame; 2] {
    let mut frames = [TactileFrame::new(16, 16), TactileFrame::new(16, 16)];
    let now = seconds(t_s);
    assert_eq!(
        devices.tactile.get_mut("tactile").unwrap().sample(now, &mut frames[0]),
        Ok(Arrival::New)
    );
    let opposed = devices.tactile.get_mut("tactile_opposed").expect("a second array");
    assert_eq!(opposed.sample(now, &mut frames[1]), Ok(Arrival::New));
    frames
}

fn moments_and_features(frame: &TactileFrame) -> (Moments, Features) {
    let values: Vec<f32> = frame.values.iter().map(|v| (f64::from(*v) - 300.0) as f32).collect();
    let image = Image::new(16, 16, &values, None).unwrap();
    let moments = moments(&image, 0.0);
    (moments, features(&moments))
}

#[test]
fn both_arrays_show_force_and_place_of_the_contact() {
    let (mut world, mut devices) = pressing(&config(), 0.006);
    let before = at(&mut world, 0.5);
    let rest = frames(&mut devices, 0.5);
    let after = at(&mut world, 2.5);
    let rolled = frames(&mut devices, 2.5);
    for (truth, frames) in [(before, rest), (after, rolled)] {
        let opposed = truth.opposed.unwrap();
        let due = [
            (truth.finger_normal_n, truth.contact_x_tactels.unwrap()),
            (truth.table_normal_n, opposed.contact_x_tactels.unwrap()),
        ];
        for (frame, (force_n, x)) in frames.iter().zip(due) {
            let (sums, seen) = moments_and_features(frame);
            // Rounding on 256 tactels.
            assert!((sums.m0 * 4.0 / 4095.0 - force_n).abs() < 0.05, "{} {force_n}", sums.m0);
            // Under a layer that is thinner than a tactel, the place is measured to a tenth of a
            // tactel.
            assert!((seen.x_c.unwrap() - x).abs() < 0.12, "{:?} {x}", seen.x_c);
        }
        // The pin is at rest: the fingertip below also carries its weight.
        let weight_n = 0.2 * 9.81;
        assert!((truth.table_normal_n - truth.finger_normal_n - weight_n).abs() < 1e-3);
    }
    // In rolling without slip between equal pads the pin moves half as far as the finger, and the
    // contact as far on either pad. The finger's columns are counted against x0, those of the other
    // fingertip along it.
    let way = |a: Option<f64>, b: Option<f64>| {
        (b.unwrap() - a.unwrap()) * ArrayGeometry::THESIS.pitch_x_m
    };
    let finger = way(before.contact_x_tactels, after.contact_x_tactels);
    let tip = |t: &taktil_sim::Truth| t.opposed.unwrap().contact_x_tactels;
    let opposed = way(tip(&before), tip(&after));
    assert!((opposed - 0.003).abs() < 2e-4, "{opposed}");
    assert!((finger - 0.003).abs() < 2e-4, "{finger}");
    assert!((after.pin.x - before.pin.x - 0.003).abs() < 2e-4);
}

#[test]
fn the_mount_moves_like_the_table() {
    let mut config = config();
    config.table.motion =
        vec![Motion::ramp(Axis::Slide, 4.0, 1.0, 2.0), Motion::ramp(Axis::TiltX, 0.5, 1.0, 2.0)];
    let (mut world, mut devices) = pressing(&config, 0.0);
    let before = at(&mut world, 0.9);
    let after = at(&mut world, 2.5);
    let [a, b] = [before, after].map(|truth| truth.opposed.unwrap());
    assert!((b.face.x - a.face.x - 0.004).abs() < 1e-12, "{a:?} {b:?}");
    assert!((b.face_z.y + libm::sin(0.5_f64.to_radians())).abs() < 1e-12);
    // The mount moved by 4 mm and the finger stood, so that the pin moved by half of that.
    assert!((after.pin.x - before.pin.x - 0.002).abs() < 2e-4);
    // The pin touches both pads and leans against each with a part of the tilt.
    let parts = [b.tilt_rad.abs(), after.tilt_rad.abs()];
    assert!((parts[0] + parts[1] - 0.5_f64.to_radians()).abs() < 1e-6, "{parts:?}");
    assert!(parts.iter().all(|part| *part > 0.1_f64.to_radians()), "{parts:?}");
    // Its image shows the tilt: the middle of the load is off the middle row.
    let [_, opposed] = frames(&mut devices, 2.5);
    assert!((moments_and_features(&opposed).1.y_c.unwrap() - 8.5).abs() > 0.2);
}

#[test]
fn a_pin_that_rolls_off_falls_with_a_finite_state() {
    let mut config = config();
    config.pin.fixture = false;
    config.table.motion = vec![Motion::ramp(Axis::Slide, 60.0, 0.6, 1.6)];
    let (mut world, _devices) = pressing(&config, 0.0);
    let held = at(&mut world, 0.5);
    assert!(held.table_normal_n > 10.0);
    let fallen = at(&mut world, 2.5);
    assert!(fallen.pin.is_finite() && fallen.table_normal_n == 0.0);
    assert!(fallen.pin.z < held.pin.z - 0.5, "{}", fallen.pin.z);
    assert_eq!(fallen.opposed.unwrap().contact_x_tactels, None);
}

#[test]
fn each_array_draws_from_streams_of_its_own_and_loses_frames_of_its_own() {
    let run = |edit: &dyn Fn(&mut WorldConfig)| {
        let mut config = config();
        config.tactile.noise_counts = 50.0;
        edit(&mut config);
        let (mut world, mut devices) = pressing(&config, 0.0);
        at(&mut world, 0.5);
        let mut frame = TactileFrame::new(16, 16);
        assert_eq!(
            devices.tactile.get_mut("tactile").unwrap().sample(seconds(0.5), &mut frame),
            Ok(Arrival::New)
        );
        let mut other = TactileFrame::new(16, 16);
        let opposed = devices.tactile.get_mut("tactile_opposed");
        let arrival = opposed.map(|array| array.sample(seconds(0.5), &mut other).unwrap());
        (frame, other, arrival, world.statistics())
    };
    let quiet = run(&|_| ());
    let noisy = run(&|c| c.opposed.tactile.noise_counts = 50.0);
    assert_eq!(quiet.0, noisy.0);
    assert_ne!(quiet.1.values, noisy.1.values);
    assert_ne!(noisy.0.values, noisy.1.values);
    let fault = |opposed| Fault { opposed, ..Fault::at(FaultKind::DropFrames, 0.4) };
    let lost = run(&|c| c.fault = vec![fault(Some(true))]);
    assert_eq!((lost.0, lost.1.acquired), (quiet.0, seconds(0.395)));
    // One image is counted for each array, none for an absent one.
    assert_eq!(quiet.3.tactile_images, 2 * 101);
    let blind = run(&|c| c.opposed.tactile.present = false);
    assert_eq!((blind.2, blind.3.tactile_images), (Some(Arrival::Held), 101));
    let alone = run(&|c| c.opposed.present = false);
    assert_eq!((alone.2, alone.3.tactile_images), (None, 101));
}

#[test]
fn three_dimensions_agree_with_planes_and_are_solved_for_each() {
    let planes = config();
    let mut space = config();
    space.fidelity.contact = taktil_sim::fidelity::ContactModel::Layer3d;
    let both = [planes, space].map(|config| {
        let (mut world, mut devices) = pressing(&config, 0.0);
        let truth = at(&mut world, 0.5);
        (truth, frames(&mut devices, 0.5), world.statistics().spatial_solutions)
    });
    assert_eq!(both[0].2, 0);
    assert!(both[1].2 > 150, "{}", both[1].2);
    for (frame, other) in both[0].1.iter().zip(&both[1].1) {
        let [a, b] = [frame, other].map(|frame| moments_and_features(frame).0.m0);
        assert!((a / b - 1.0).abs() < 0.02, "{a} {b}");
    }
}

#[test]
fn impossible_values_are_refused_with_their_place() {
    let refused = |edit: &dyn Fn(&mut WorldConfig)| {
        let mut config = config();
        edit(&mut config);
        let carriage = Carriage { axes: nominal(), knots: vec![(0.0, over(0.0))], float: None };
        let timing = taktil_sim::Timing::default();
        taktil_sim::build_with_carriage(&config, &timing, 1, carriage).unwrap_err().place
    };
    assert_eq!(refused(&|c| c.pin.present = false), "opposed.present");
    assert_eq!(refused(&|c| c.opposed.x_mm = f64::NAN), "opposed.x_mm");
    assert_eq!(refused(&|c| c.opposed.x_mm = 14.0), "opposed.x_mm");
    assert_eq!(refused(&|c| c.opposed.y_mm = -14.0), "opposed.y_mm");
    assert_eq!(refused(&|c| c.opposed.yaw_deg = 90.0), "opposed.yaw_deg");
    assert_eq!(refused(&|c| c.opposed.yaw_deg = -100.0), "opposed.yaw_deg");
    assert_eq!(refused(&|c| c.opposed.rubber.poisson = 0.5), "opposed.rubber.poisson");
    assert_eq!(refused(&|c| c.opposed.friction = -0.1), "opposed.friction");
    let rest = "opposed.tactile.rest_counts";
    assert_eq!(refused(&|c| c.opposed.tactile.rest_counts = f64::INFINITY), rest);
    assert_eq!(refused(&|c| c.opposed.tactile.row_us = 400.0), "opposed.tactile.row_us");
    let fault = |c: &mut WorldConfig| {
        c.opposed.present = false;
        c.fault = vec![Fault { opposed: Some(true), ..Fault::at(FaultKind::DropFrames, 0.0) }];
    };
    assert_eq!(refused(&fault), "fault[0].opposed");
}
