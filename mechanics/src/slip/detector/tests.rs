//! Alarms of noise, of ramps and of motions of the hand, and their delays.

use super::*;

/// Normal numbers: SplitMix64 (Steele, Lea, Flood 2014) and Box and Muller's transform.
struct Noise(u64);

impl Noise {
    #[expect(clippy::cast_precision_loss, reason = "53 bits")]
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (((z ^ (z >> 31)) >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> DVec2 {
        let size = libm::sqrt(-2.0 * libm::log(self.unit()));
        let turn = core::f64::consts::TAU * self.unit();
        size * DVec2::new(libm::cos(turn), libm::sin(turn))
    }
}

const DEVIATION_MM: f64 = 0.05;

fn sample(frame: u32, place_mm: DVec2, noise: &mut Noise) -> SlipSample {
    let variance = DEVIATION_MM * DEVIATION_MM;
    SlipSample {
        t_s: 0.005 * f64::from(frame),
        place_mm: place_mm + DEVIATION_MM * noise.normal(),
        covariance_mm2: [variance, 0.0, variance],
        direction: None,
    }
}

#[test]
fn noise_alone_gives_no_more_false_alarms_than_allowed() {
    // 360 an hour stand for one in 2000 frames; creep within the tolerance changes nothing.
    for (tolerance_mm_s, creep_mm_s) in [(0.0, 0.0), (0.4, 0.4)] {
        let allowed =
            SlipParameters { false_alarms_per_h: 360.0, tolerance_mm_s, ..Default::default() };
        let mut detector = SlipDetector::new(&allowed);
        let mut noise = Noise(1);
        let mut alarms = 0;
        for frame in 0..400_000 {
            let place = DVec2::new(creep_mm_s * 0.005 * f64::from(frame), 0.0);
            if detector.update(&sample(frame, place, &mut noise)).is_detected {
                alarms += 1;
                detector.reset();
            }
        }
        assert!(alarms <= 200, "{alarms} of 200 that are allowed");
        // Boole's inequality and the tolerance leave some of them out, not all.
        assert!(tolerance_mm_s > 0.0 || alarms > 10, "{alarms}: the threshold is too high");
    }
}

#[test]
fn slips_are_found_within_the_delay_of_the_bound_and_a_few_frames() {
    for (speed_mm_s, frames_max) in [(2.0, 40), (5.0, 14), (20.0, 5), (50.0, 3)] {
        let mut noise = Noise(7);
        let mut late = 0;
        for draw in 0..200 {
            let mut detector = SlipDetector::new(&SlipParameters::default());
            let direction = noise.normal().normalize();
            let found = (0..200).find(|frame| {
                let way_mm = speed_mm_s * 0.005 * (f64::from(*frame) - 60.0).max(0.0);
                let verdict = detector.update(&sample(*frame, way_mm * direction, &mut noise));
                verdict.is_detected
            });
            let found = found.unwrap_or_else(|| panic!("{speed_mm_s} mm/s, draw {draw}"));
            assert!(found > 60, "a false alarm at {found}");
            late += u32::from(found > 60 + frames_max);
        }
        assert!(late <= 10, "{speed_mm_s} mm/s: {late} of 200 later than {frames_max} frames");
    }
}

#[test]
fn along_a_line_nothing_is_seen_and_across_it_everything() {
    let across = DVec2::new(0.8, 0.6);
    for (way, is_seen) in [(across.perp(), false), (across, true)] {
        let mut detector = SlipDetector::new(&SlipParameters::default());
        let mut noise = Noise(11);
        let found = (0..200).find(|frame| {
            let way_mm = 20.0 * 0.005 * (f64::from(*frame) - 60.0).max(0.0);
            let one = sample(*frame, way_mm * way, &mut noise);
            detector.update(&SlipSample { direction: Some(across), ..one }).is_detected
        });
        assert_eq!(found.is_some_and(|frame| (61..66).contains(&frame)), is_seen, "{found:?}");
        assert_eq!(found.is_some(), is_seen);
    }
    // The normal distribution at 1/7 200 000 on both sides, by tables 5.27; two dimensions 31.6.
    let parameters = SlipParameters::default();
    assert!((parameters.threshold(true).sqrt() - 5.266).abs() < 0.01);
    assert!((parameters.threshold(false) - 31.579).abs() < 0.01);
}

#[test]
fn velocity_is_measured_while_it_slides_and_the_end_is_found() {
    let mut detector = SlipDetector::new(&SlipParameters::default());
    let mut noise = Noise(3);
    let mut place = DVec2::ZERO;
    let (mut during, mut after) = (SlipVerdict::default(), SlipVerdict::default());
    for frame in 0..300 {
        if (60..120).contains(&frame) {
            place += 0.005 * DVec2::new(0.0, -20.0);
        }
        let verdict = detector.update(&sample(frame, place, &mut noise));
        match frame {
            115 => during = verdict,
            160 => after = verdict,
            _ => {}
        }
        assert!(verdict.is_detected || frame != 100);
        assert!(!verdict.is_detected || frame < 160, "frame {frame}: {verdict:?}");
    }
    assert!((during.velocity_mm_s - DVec2::new(0.0, -20.0)).length() < 1.0, "{during:?}");
    assert!(!after.is_detected);
}

#[test]
fn odd_frames_begin_a_new_sequence_and_raise_no_alarm() {
    let mut detector = SlipDetector::new(&SlipParameters::default());
    let still =
        |t_s: f64| SlipSample { t_s, covariance_mm2: [1e-3, 0.0, 1e-3], ..Default::default() };
    for frame in 0..40 {
        detector.update(&still(0.005 * f64::from(frame)));
    }
    assert!(detector.update(&still(0.2)).is_ready);
    for odd in [
        SlipSample { place_mm: DVec2::new(f64::NAN, 0.0), ..still(0.205) },
        SlipSample { covariance_mm2: [f64::INFINITY, 0.0, 1.0], ..still(0.21) },
        SlipSample { place_mm: DVec2::splat(9.0), ..still(0.1) },
        SlipSample { place_mm: DVec2::splat(-9.0), ..still(5.0) },
        still(f64::NAN),
    ] {
        let verdict = detector.update(&odd);
        assert!(!verdict.is_detected && !verdict.is_ready, "{odd:?}");
    }
    // A covariance that has no inverse says nothing.
    for frame in 0..40 {
        let flat = SlipSample { covariance_mm2: [0.0; 3], ..still(9.0 + 0.005 * f64::from(frame)) };
        let moved = SlipSample { place_mm: DVec2::splat(f64::from(frame)), ..flat };
        assert!(!detector.update(&moved).is_detected);
    }
}
