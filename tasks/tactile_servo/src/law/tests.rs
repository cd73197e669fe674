//! Tests the law of the thesis and its features: signs, limits, implausible images.

use super::thesis::ThesisLaw;
use super::tool_motion;
use crate::config::Config;
use crate::config::array::Array;
use crate::heading::Heading;
use crate::perception::{TouchFeatures, touch_features};
use taktil_mechanics::Joints;
use taktil_signal::TactileImage;

fn image(load: &[(usize, usize, f32)]) -> TactileImage {
    let mut image =
        TactileImage { valid: vec![1; 256].into(), baseline_ready: 1, ..TactileImage::new(16, 16) };
    for (x, y, counts) in load {
        image.counts[(y - 1) * 16 + x - 1] = *counts;
    }
    image
}

fn of(image: &TactileImage) -> TouchFeatures {
    touch_features(image, &Array::default(), 150.0, 500.0)
}

fn law() -> ThesisLaw {
    ThesisLaw::new(&Config::default())
}

#[test]
fn a_point_is_where_it_is() {
    let found = of(&image(&[(3, 12, 2000.0)]));
    assert!(found.trusted && found.contact);
    assert_eq!((found.x_c, found.y_c), (Some(3.0), Some(12.0)));
    assert_eq!((found.m0, found.m_x, found.theta_z_rad), (2000.0, 7000.0, None));
}

#[test]
fn an_empty_an_unready_or_a_blind_image_moves_nothing_wrong() {
    let zero = of(&image(&[]));
    assert!(zero.trusted && !zero.contact && zero.x_c.is_none());
    assert_eq!(law().displacement(&zero, 2.0), [0.0, 0.03, 0.0, 0.0], "seek");
    assert_eq!(of(&TactileImage::new(16, 16)), TouchFeatures::default());
    let mut unready = image(&[(3, 12, 2000.0)]);
    unready.baseline_ready = 0;
    assert_eq!(of(&unready), TouchFeatures::default());
    let mut blind = image(&[(16, 16, 2000.0)]);
    blind.valid[..129].fill(0);
    assert!(!of(&blind).trusted);
    assert_eq!(law().displacement(&of(&blind), 2.0), [0.0; 4]);
    blind.valid[128] = 1;
    assert!(of(&blind).trusted, "exactly half is enough");
    for (rows, cols) in [(0, 16), (16, 17), (u16::MAX, u16::MAX)] {
        let odd = TactileImage { rows, cols, ..image(&[]) };
        assert_eq!(of(&odd), TouchFeatures::default());
    }
}

#[test]
fn nan_and_huge_values_do_no_harm() {
    let mut odd = image(&[(3, 12, 2000.0)]);
    odd.counts[5] = f32::NAN;
    odd.counts[6] = f32::INFINITY;
    odd.counts[7] = f32::NEG_INFINITY;
    assert_eq!(of(&odd).x_c, Some(3.0));
    for counts in [f32::MAX, f32::MIN, f32::NAN, -1e30] {
        for threshold in [0.0, 150.0] {
            let mut all = image(&[]);
            all.counts = vec![counts; 256].into();
            let found = touch_features(&all, &Array::default(), threshold, 500.0);
            let step = law().displacement(&found, 2.0);
            assert!(step.iter().all(|x| x.is_finite()), "{counts}: {step:?}");
            assert!(found.m0.is_finite() && found.m_x.is_finite());
        }
    }
}

#[test]
fn contact_begins_above_its_limit() {
    assert!(!of(&image(&[(8, 8, 500.0)])).contact);
    assert!(of(&image(&[(8, 8, 500.1)])).contact);
}

#[test]
fn without_a_threshold_negative_noise_counts() {
    let mut noisy = image(&[(8, 8, 1000.0)]);
    noisy.counts[0] = -100.0;
    noisy.counts[1] = 100.0;
    assert_eq!(touch_features(&noisy, &Array::default(), 0.0, 500.0).m0, 1000.0);
    assert_eq!(touch_features(&noisy, &Array::default(), 50.0, 500.0).m0, 1100.0);
    assert_eq!(
        touch_features(&noisy, &Array::default(), 100.0, 500.0).m0,
        1100.0,
        "the threshold itself is let in"
    );
    assert_eq!(touch_features(&noisy, &Array::default(), 100.1, 500.0).m0, 1000.0);
    // A centroid outside the array, which noise may cause, is absent.
    let mut wild = image(&[(8, 8, 600.0)]);
    wild.counts[255] = 5000.0;
    wild.counts[0] = -5000.0;
    let found = touch_features(&wild, &Array::default(), 0.0, 500.0);
    assert!(found.contact && found.x_c.is_none() && found.y_c.is_none());
    assert_eq!(law().displacement(&found, 2.0)[0], 0.0);
}

#[test]
fn each_component_answers_its_feature_with_its_gain_and_sign() {
    let at = TouchFeatures {
        trusted: true,
        contact: true,
        m0: 15_000.0,
        m_x: 0.0,
        x_c: Some(2.0),
        y_c: Some(8.5),
        theta_z_rad: Some(0.0),
    };
    assert_eq!(law().displacement(&at, 2.0).map(f64::abs), [0.0; 4]);
    let left = law().displacement(&TouchFeatures { x_c: Some(1.5), ..at }, 2.0);
    assert_eq!(left, [-0.025, 0.0, 0.0, -0.0]);
    let light = law().displacement(&TouchFeatures { m0: 14_800.0, ..at }, 2.0);
    assert_eq!(light[1], 0.01);
    let heavy_at_plus_y = law().displacement(&TouchFeatures { m_x: 2000.0, ..at }, 2.0);
    assert_eq!(heavy_at_plus_y[2], -0.01);
    let turned = law().displacement(&TouchFeatures { theta_z_rad: Some(0.05), ..at }, 2.0);
    assert!((turned[3] - 0.05).abs() < 1e-15);
    let undefined = TouchFeatures { x_c: None, theta_z_rad: None, ..at };
    assert_eq!(law().displacement(&undefined, 15.0), [0.0; 4]);
}

#[test]
fn speeds_are_cut_off_exactly_at_their_limits() {
    let far = TouchFeatures {
        trusted: true,
        contact: true,
        m0: 1e6,
        m_x: -1e9,
        x_c: Some(16.0),
        y_c: Some(8.5),
        theta_z_rad: Some(-1.57),
    };
    let limits = [0.055, -0.02, 0.5, -0.5];
    for (got, limit) in law().displacement(&far, 2.0).iter().zip(limits) {
        assert!((got - limit).abs() < 1e-15, "{got} is not {limit}");
    }
}

#[test]
fn a_lightly_pressed_pin_is_not_rolled() {
    let mut at =
        TouchFeatures { trusted: true, contact: true, x_c: Some(8.0), ..TouchFeatures::default() };
    at.m0 = 5999.0;
    assert_eq!(law().displacement(&at, 2.0)[0], 0.0);
    at.m0 = 6000.0;
    assert!(law().displacement(&at, 2.0)[0] > 0.0, "towards column 2 the sensor moves by +x");
}

#[test]
fn the_heading_turns_inside_the_tolerance_only() {
    let mut heading = Heading::new(&Config::default());
    let mut seen = |x_c: Option<f64>| {
        heading.update(x_c);
        (heading.x_c(), heading.reversals())
    };
    assert_eq!(seen(None), (2.0, 0));
    assert_eq!(seen(Some(2.5)), (2.0, 0), "the limit itself is outside");
    assert_eq!(seen(Some(2.499)), (15.0, 1));
    assert_eq!(seen(Some(2.0)), (15.0, 1));
    assert_eq!(seen(Some(14.501)), (2.0, 2));
    assert_eq!(seen(Some(f64::NAN)), (2.0, 2));
}

#[test]
fn a_displacement_becomes_a_motion_of_the_tool_in_metres_and_radians() {
    let motion = tool_motion(&[1.0, 2.0, 3.0, 4.0]);
    assert_eq!(motion, Joints::new(0.001, 0.0, 0.002, 0.003, 0.0, 0.004));
}
