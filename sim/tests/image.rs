//! Compares the tactile image with the forces that caused it.

mod common;

use common::{at, bench, load_of, meeting_height, nominal, over, seconds};
use glam::DVec3;
use taktil_hal::{Arrival, Devices, TactileFrame};
use taktil_mechanics::spatial::rotation_x;
use taktil_mechanics::tactile::{Features, Image, Moments, features, moments};
use taktil_sim::{Carriage, WorldConfig};

fn newest(devices: &mut Devices, t_s: f64) -> TactileFrame {
    let mut frame = TactileFrame::new(16, 16);
    let answer = devices.tactile.get_mut("tactile").unwrap().sample(seconds(t_s), &mut frame);
    assert_eq!(answer, Ok(Arrival::New));
    frame
}

fn moments_and_features(frame: &TactileFrame, rest: f64) -> (Moments, Features) {
    let values: Vec<f32> = frame.values.iter().map(|v| (f64::from(*v) - rest) as f32).collect();
    let image = Image::new(16, 16, &values, None).unwrap();
    let moments = moments(&image, 0.0);
    (moments, features(&moments))
}

fn quiet() -> WorldConfig {
    let mut config = WorldConfig::default();
    config.tactile.noise_counts = 0.0;
    config
}

fn pressed(config: &WorldConfig, axes: glam::DMat3, x: f64) -> (taktil_sim::Truth, TactileFrame) {
    let z = meeting_height(config) + 1e-4;
    let knots = vec![(0.3, over(z)), (1.0, over(z) + DVec3::new(x, 0.0, 0.0))];
    let (mut world, mut devices) = bench(config, Carriage { axes, knots, float: load_of(15.0) });
    let truth = at(&mut world, 1.5);
    (truth, newest(&mut devices, 1.5))
}

#[test]
fn the_sum_of_the_image_is_the_normal_force() {
    for x in [-0.012, 0.0, 0.0031, 0.008] {
        let (truth, frame) = pressed(&quiet(), nominal(), x);
        let (sums, seen) = moments_and_features(&frame, 300.0);
        let force = sums.m0 * 4.0 / 4095.0;
        // The bound is the rounding on 256 tactels, most of which carry less than half a count.
        assert!((force - truth.finger_normal_n).abs() < 0.04, "{force} {}", truth.finger_normal_n);
        let due = truth.contact_x_tactels.unwrap();
        let x_c = seen.x_c.unwrap();
        assert!((x_c - due).abs() < 0.03, "x_c {x_c}, contact {due}");
        assert!((seen.y_c.unwrap() - 8.5).abs() < 0.01);
    }
}

#[test]
fn with_noise_the_sum_is_the_force_within_the_noise() {
    let (truth, frame) = pressed(&WorldConfig::default(), nominal(), 0.0);
    let sum: f64 = frame.values.iter().map(|v| f64::from(*v) - 300.0).sum();
    let sigma = 50.0 * 16.0;
    let due = truth.finger_normal_n * 4095.0 / 4.0;
    assert!((sum - due).abs() < 4.0 * sigma, "{sum} {due}");
    assert!((sum - due).abs() > 1.0, "there is noise");
}

#[test]
fn a_lifted_finger_reads_the_rest_level() {
    let config = WorldConfig::default();
    let carriage = Carriage { axes: nominal(), knots: vec![(0.0, over(-0.1))], float: None };
    let (mut world, mut devices) = bench(&config, carriage);
    let (mut sum, mut square, mut n) = (0.0, 0.0, 0.0);
    for i in 1..=40 {
        let t_s = 0.005 * f64::from(i);
        world.advance(seconds(t_s));
        for value in newest(&mut devices, t_s).values {
            let off = f64::from(value) - 300.0;
            (sum, square, n) = (sum + off, square + off * off, n + 1.0);
        }
    }
    let (mean, sd): (f64, f64) = (sum / n, (square / n).sqrt());
    assert!(mean.abs() < 2.5, "{mean}");
    assert!((sd - 50.0).abs() < 1.5, "{sd}");
    let (mut world, mut devices) =
        bench(&quiet(), Carriage { axes: nominal(), knots: vec![(0.0, over(-0.1))], float: None });
    world.advance(seconds(0.005));
    assert!(newest(&mut devices, 0.005).values.iter().all(|v| *v == 300));
}

#[test]
fn the_images_axis_is_the_pins_axis() {
    for yaw in [-6.0, 2.0, 6.0] {
        let mut config = quiet();
        config.pin.yaw_deg = yaw;
        let (truth, frame) = pressed(&config, nominal(), 0.0);
        let (_, seen) = moments_and_features(&frame, 300.0);
        let theta = seen.theta_z_rad.unwrap();
        // About z_s = -z0 the angle has the opposite sign. To second moments a line of finite width
        // looks slightly shorter, but not turned.
        assert!((truth.pin_yaw_rad.to_degrees() + yaw).abs() < 0.1, "{}", truth.pin_yaw_rad);
        assert!((theta - truth.pin_yaw_rad).abs() < 0.3_f64.to_radians(), "{theta}");
    }
}

#[test]
fn a_tilted_finger_presses_one_side() {
    for (tilt, sign) in [(0.05_f64, 1.0), (-0.05, -1.0)] {
        let axes = nominal() * rotation_x(tilt.to_radians());
        let (truth, frame) = pressed(&quiet(), axes, 0.0);
        let (_, seen) = moments_and_features(&frame, 300.0);
        assert!(sign * truth.tilt_rad > 0.0, "{}", truth.tilt_rad);
        assert!(sign * (seen.y_c.unwrap() - 8.5) > 0.05, "{:?}", seen.y_c);
        assert!(sign * seen.m_x_centred > 0.0);
    }
}

#[test]
fn ten_bits_saturate_at_ten_bits() {
    let mut config = quiet();
    config.tactile.bits = 10;
    config.tactile.full_scale_n = 0.2;
    let (_, frame) = pressed(&config, nominal(), 0.0);
    assert_eq!(frame.values.iter().max(), Some(&1023));
}
