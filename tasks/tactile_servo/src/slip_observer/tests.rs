//! What the observer makes of images and of the motion of the hand.

use super::*;
use crate::perception::touch_features;
use taktil_mechanics::spatial::rotation_z;
use taktil_mechanics::tactile;

const JOB_NS: i64 = 2_500_000;
const IMAGE_NS: i64 = 5_000_000;

/// A line across the pad at this column, 15000 counts, with noise of 50 counts.
fn image(sequence: u32, column: f64, noise: &mut u64) -> TactileImage {
    let load = |index: usize| {
        let off = (index % 16 + 1) as f64 - column;
        15_000.0 / 16.0 * libm::exp(-0.5 * off * off / 1.21) / 2.757
    };
    noisy(sequence, load, noise)
}

/// The part of a tactel's width, from -0.5 to 0.5, that is below a place (tactels).
fn part_below(place: f64) -> f64 {
    (place + 0.5).clamp(0.0, 1.0)
}

/// A flat bar of 5.7 x 20 mm, 13000 counts, turned by 0.2 rad, its middle at this column.
fn bar_image(sequence: u32, column: f64, noise: &mut u64) -> TactileImage {
    let load = |index: usize| {
        let (c, r) = ((index % 16 + 1) as f64, (index / 16 + 1) as f64);
        let middle = column - 0.2 * (r - 8.5);
        let across = part_below(middle + 1.8 - c) - part_below(middle - 1.8 - c);
        let along = part_below(8.5 + 6.3 - r) - part_below(8.5 - 6.3 - r);
        13_000.0 / (3.6 * 12.6) * across * along
    };
    noisy(sequence, load, noise)
}

/// An image of these loads with noise of 50 counts.
fn noisy(sequence: u32, load: impl Fn(usize) -> f64, noise: &mut u64) -> TactileImage {
    let mut image = TactileImage::new(16, 16);
    image.acquired_ns = i64::from(sequence) * IMAGE_NS;
    (image.sequence, image.baseline_ready, image.noise_counts) = (sequence, 1, 50.0);
    image.valid.fill(1);
    for (index, counts) in image.counts.iter_mut().enumerate() {
        let mut sum = -6.0;
        for _ in 0..12 {
            *noise =
                noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963);
            sum += (*noise >> 11) as f64 / (1_u64 << 53) as f64;
        }
        *counts = (load(index) + 50.0 * sum) as f32;
    }
    image
}

/// What is reported for each of 200 images: the finger moves along its x with `finger_mm_s`, the
/// line over the pad with `line_mm_s`, each from image 100 on.
fn reports(config: SlipConfig, finger_mm_s: f64, line_mm_s: f64, seed: u64) -> Vec<Slip> {
    let config = SlipConfig { settling_s: 0.05, ..config };
    let servo = Config { slip: Some(config), ..Config::default() };
    let mut observer = SlipObserver::new(&config, &servo);
    let mut noise = seed;
    let turn = rotation_z(2.0);
    (0..200_u32)
        .map(|sequence| {
            for half in [-1, 0] {
                let t_ns = i64::from(sequence) * IMAGE_NS + half * JOB_NS;
                let way_m = 1e-3 * finger_mm_s * (1e-9 * t_ns as f64 - 0.5).max(0.0);
                let tool = Pose::new(turn, turn * glam::DVec3::new(way_m, 0.0, 0.0));
                observer.record_pose(t_ns, &tool);
            }
            let way_mm = line_mm_s * (0.005 * f64::from(sequence) - 0.5).max(0.0);
            let image = image(sequence, 8.5 + way_mm / 1.5875, &mut noise);
            let touch = touch_features(&image, &servo.array, 150.0, 1000.0);
            observer.observe(&image, &touch, 150.0)
        })
        .collect()
}

#[test]
fn a_pin_that_rolls_does_not_slide_and_one_that_moves_otherwise_does() {
    let rolling = SlipConfig::default();
    for seed in 1..=5 {
        let all = reports(rolling, 12.0, -6.0, seed);
        assert!(all.iter().all(|slip| slip.detected == 0), "seed {seed}");
        let last = all.last().unwrap();
        assert_eq!(last.seen, slip::TEST_READY | slip::ALONG_X, "not along the line");
        assert!((last.high_pass_energy - 1.0).abs() < 0.6, "{last:?}");
    }
    // The pin stands still: the line goes over the pad as fast as the finger goes back.
    let all = reports(rolling, 20.0, -20.0, 1);
    let first = all.iter().position(|slip| slip.detected == 1).unwrap();
    assert!((102..110).contains(&first), "{first}");
    let last = all[130];
    assert!((last.velocity_mm_s[0] + 10.0).abs() < 1.5 && last.onsets == 1, "{last:?}");
}

#[test]
fn what_is_carried_does_not_slide_and_what_is_drawn_away_does() {
    let carried = SlipConfig { rolling_share: [0.0; 2], ..SlipConfig::default() };
    assert!(reports(carried, 30.0, 0.0, 3).iter().all(|slip| slip.detected == 0));
    let all = reports(carried, 0.0, 20.0, 3);
    let first = all.iter().position(|slip| slip.detected == 1).unwrap();
    assert!((102..106).contains(&first), "{first}");
    assert!((all[130].velocity_mm_s[0] - 20.0).abs() < 1.5);
}

#[test]
fn a_wide_bar_on_a_finger_that_stands_is_noticed_within_four_images() {
    let config = SlipConfig { rolling_share: [0.0; 2], settling_s: 0.05, ..SlipConfig::default() };
    let servo = Config { slip: Some(config), ..Config::default() };
    let mut noise = 5;
    let mut soon = 0;
    for draw in 0..100 {
        let mut observer = SlipObserver::new(&config, &servo);
        let mut detected_at = None;
        for sequence in 0..170_u32 {
            observer.record_pose(i64::from(sequence) * IMAGE_NS, &Pose::IDENTITY);
            // 20 mm/s: 0.1 mm an image, and any part of it before the first one.
            let part = 0.01 * f64::from(draw);
            let images = (f64::from(sequence) - 150.0 + part).max(0.0);
            let image = bar_image(sequence, 8.5 + 0.1 * images / 1.5875, &mut noise);
            let touch = touch_features(&image, &servo.array, 150.0, 1000.0);
            let slip = observer.observe(&image, &touch, 150.0);
            if slip.detected == 1 && detected_at.is_none() {
                detected_at = Some(sequence);
            }
        }
        let detected_at = detected_at.unwrap();
        assert!(detected_at > 150, "draw {draw}: an alarm at image {detected_at} without slip");
        soon += u32::from(detected_at <= 154);
    }
    // 97 by the shape of the load, 78 by a Gaussian weight.
    assert!(soon >= 92, "{soon} of 100 within four images");
}

#[test]
fn odd_images_report_nothing_and_harm_nothing() {
    let config = SlipConfig::default();
    let servo = Config { slip: Some(config), ..Config::default() };
    let mut observer = SlipObserver::new(&config, &servo);
    let mut noise = 1;
    for sequence in 0..600_u32 {
        observer.record_pose(i64::from(sequence) * IMAGE_NS, &Pose::IDENTITY);
        let mut image = image(sequence, 8.5, &mut noise);
        match sequence % 7 {
            0 => image.counts[17] = f32::NAN,
            1 => image.counts.fill(f32::MAX),
            2 => image.valid.fill(0),
            3 => image.noise_counts = f32::INFINITY,
            4 => image.acquired_ns = i64::MIN / 4,
            5 => image = TactileImage::new(4, 4),
            _ => image.counts.fill(0.0),
        }
        let touch = touch_features(&image, &servo.array, 150.0, 1000.0);
        let slip = observer.observe(&image, &touch, 150.0);
        assert_eq!(slip.detected, 0, "{sequence}: {slip:?}");
        assert!(taktil_rtcore::Payload::is_finite(&slip), "{sequence}: {slip:?}");
    }
    // Nothing is remembered of it: a sound sequence afterwards is as one from the start.
    assert!(tactile::Image::new(16, 16, &[0.0_f32; 256], None).is_ok());
}
