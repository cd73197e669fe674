//! Flat loads in noise: alarms without slip, delays, and what is no load that stands still.

use super::*;
use crate::slip::detector::{SlipDetector, SlipSample};
use crate::slip::place::PlaceTracker;

const SIDE_TACTELS: usize = 16;
const PITCH_MM: f64 = 1.5875;
const NOISE_COUNTS: f64 = 50.0;
const FRAME_S: f64 = 0.005;
const ALL_VALID: [u8; SIDE_TACTELS * SIDE_TACTELS] = [1; SIDE_TACTELS * SIDE_TACTELS];

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

    fn normal(&mut self) -> f64 {
        let size = libm::sqrt(-2.0 * libm::log(self.unit()));
        size * libm::cos(core::f64::consts::TAU * self.unit())
    }
}

/// A bar of 5.5 x 20 mm, turned by 0.2 rad, with edges that rubber of 0.5 mm blurs: counts of each
/// tactel for a load of so many counts, its middle so far along x from the pad's (mm).
fn bar(middle_mm: f64, load_counts: f64) -> Vec<f64> {
    let edge = |distance_mm: f64, half_mm: f64| {
        0.5 * libm::erfc((distance_mm.abs() - half_mm) / (core::f64::consts::SQRT_2 * 0.5))
    };
    let mut counts = Vec::new();
    for r in 0..SIDE_TACTELS {
        for c in 0..SIDE_TACTELS {
            // A tactel adds up what presses on it: 4 x 4 places.
            let mut sum = 0.0;
            for part in 0..16 {
                let at = |index: usize, part: usize| {
                    PITCH_MM * (index as f64 - 7.5 + (part as f64 - 1.5) / 4.0)
                };
                let off = DVec2::new(at(c, part % 4) - middle_mm, at(r, part / 4));
                let own = DVec2::from_angle(-0.2).rotate(off);
                sum += edge(own.x, 2.75) * edge(own.y, 10.0);
            }
            counts.push(sum);
        }
    }
    let all: f64 = counts.iter().sum();
    counts.iter().map(|value| value * load_counts / all).collect()
}

fn noisy(exact: &[f64], noise: &mut Noise) -> Vec<f32> {
    exact.iter().map(|value| (value + NOISE_COUNTS * noise.normal()) as f32).collect()
}

fn sample(frame: u32, counts: &[f32]) -> MatchedSample<'_> {
    MatchedSample {
        t_s: FRAME_S * f64::from(frame),
        counts,
        valid: &ALL_VALID,
        noise_counts: NOISE_COUNTS,
        rolled_mm: DVec2::ZERO,
        seen: SeenMotion::All,
    }
}

fn test(parameters: &SlipParameters) -> MatchedTest {
    MatchedTest::new(parameters, SIDE_TACTELS, SIDE_TACTELS, DVec2::splat(PITCH_MM))
}

#[test]
fn noise_creep_and_a_change_of_the_load_give_no_more_alarms_than_allowed() {
    // 3600 an hour stand for one in 200 frames.
    let allowed = SlipParameters { false_alarms_per_h: 3600.0, ..Default::default() };
    for (creep_mm_s, growth, seen) in [
        (0.0, 0.0, SeenMotion::All),
        (0.0, 0.0, SeenMotion::Along(DVec2::from_angle(0.2))),
        (0.4, 0.3, SeenMotion::All),
    ] {
        let threshold = allowed.threshold(matches!(seen, SeenMotion::Along(_)));
        let mut noise = Noise(1);
        let (mut alarms, mut frames) = (0, 0);
        for _ in 0..20 {
            let mut matched = test(&allowed);
            // Two seconds each, in which the load grows and creeps.
            for frame in 0..400 {
                let t_s = FRAME_S * f64::from(frame);
                let exact = bar(creep_mm_s * t_s, 14_000.0 * (1.0 + growth * t_s));
                let counts = noisy(&exact, &mut noise);
                let found = matched.update(&MatchedSample { seen, ..sample(frame, &counts) });
                frames += u32::from(found.is_some());
                alarms += u32::from(found.is_some_and(|onset| onset.statistic > threshold));
            }
        }
        assert!(frames > 6_000, "{frames}");
        assert!(alarms <= frames / 200 + 10, "{alarms} in {frames} frames, creep {creep_mm_s}");
    }
}

#[test]
fn a_wide_bar_that_slides_is_noticed_sooner_than_by_a_gaussian_weight() {
    let parameters = SlipParameters::default();
    let mut noise = Noise(7);
    let (mut by_shape, mut by_weight, mut velocity_mm_s) = (0, 0, DVec2::ZERO);
    let exact: Vec<_> = (0..5).map(|frame| bar(0.1 * f64::from(frame), 14_000.0)).collect();
    for _ in 0..100 {
        let mut matched = test(&parameters);
        let mut tracker = PlaceTracker::new(DVec2::splat(8.5), [2.2, 0.0, 13.0]).unwrap();
        let mut detector = SlipDetector::new(&parameters);
        for frame in 0..140_u32 {
            // 20 mm/s: 0.1 mm a frame.
            let gone = frame.saturating_sub(135) as usize;
            let counts = noisy(&exact[gone], &mut noise);
            let one = sample(frame, &counts);
            let found = matched.update(&one);
            let place = tracker
                .update((&counts, &ALL_VALID), SIDE_TACTELS, NOISE_COUNTS, DVec2::ZERO)
                .unwrap();
            let verdict = detector.update(&SlipSample {
                t_s: one.t_s,
                place_mm: PITCH_MM * place.centre,
                covariance_mm2: place.covariance.map(|value| PITCH_MM * PITCH_MM * value),
                direction: None,
            });
            let is_found = found.is_some_and(|onset| onset.statistic > parameters.threshold(false));
            assert!(frame >= 135 || !(is_found || verdict.is_detected), "frame {frame}");
            if frame == 139 {
                by_shape += u32::from(is_found);
                by_weight += u32::from(verdict.is_detected);
                velocity_mm_s += 0.01 * found.unwrap().velocity_mm_s;
            }
        }
    }
    // Differences of tactels know a sharp edge too wide; the likeliest of ten onsets is a fast one.
    assert!((velocity_mm_s - DVec2::new(20.0, 0.0)).length() < 6.0, "{velocity_mm_s}");
    assert!(by_shape >= by_weight + 15, "{by_shape} and {by_weight} of 100 within four frames");
}

#[test]
fn a_load_that_the_hand_rolls_is_not_tested_until_it_stands_again() {
    let mut matched = test(&SlipParameters::default());
    let mut noise = Noise(3);
    let exact = bar(0.0, 14_000.0);
    let mut tested = Vec::new();
    for frame in 0..400_u32 {
        let counts = noisy(&exact, &mut noise);
        let way_mm = 6.0 * FRAME_S * f64::from(frame.clamp(100, 150) - 100);
        let rolled_mm = DVec2::new(-way_mm, 0.0);
        let found = matched.update(&MatchedSample { rolled_mm, ..sample(frame, &counts) });
        if found.is_some() {
            tested.push(frame);
        }
    }
    assert_eq!(tested[0], (IMAGES_SINCE_ONSET + SHAPE_IMAGES_MIN - 1) as u32);
    let gap = tested.windows(2).find(|pair| pair[1] > pair[0] + 1).unwrap();
    assert!((101..104).contains(&gap[0]) && gap[1] > 150 + 90, "{gap:?}");
}

#[test]
fn odd_images_begin_a_new_sequence_and_raise_no_alarm() {
    let mut matched = test(&SlipParameters::default());
    let mut noise = Noise(5);
    let exact = bar(0.0, 14_000.0);
    let fill = |matched: &mut MatchedTest, noise: &mut Noise, from: u32| {
        let mut found = None;
        for frame in from..from + 60 {
            let counts = noisy(&exact, noise);
            found = matched.update(&sample(frame, &counts));
        }
        assert!(found.is_some_and(|onset| onset.statistic < 30.0), "{found:?}");
    };
    let counts = noisy(&exact, &mut noise);
    let mut other = ALL_VALID;
    other[40] = 0;
    for (number, odd) in [
        MatchedSample { t_s: f64::NAN, ..sample(0, &counts) },
        MatchedSample { counts: &counts[1..], ..sample(0, &counts) },
        MatchedSample { noise_counts: 0.0, ..sample(0, &counts) },
        MatchedSample { rolled_mm: DVec2::NAN, ..sample(0, &counts) },
        MatchedSample { seen: SeenMotion::Nothing, ..sample(0, &counts) },
        MatchedSample { t_s: 1e6, ..sample(0, &counts) },
    ]
    .iter()
    .enumerate()
    {
        fill(&mut matched, &mut noise, 1000 * number as u32);
        assert_eq!(matched.update(odd), None, "{odd:?}");
    }
    fill(&mut matched, &mut noise, 9000);
    let t_s = FRAME_S * 9060.0;
    assert_eq!(matched.update(&MatchedSample { valid: &other, t_s, ..sample(0, &counts) }), None);
    // Counts that are no numbers count as none; images without load say nothing.
    fill(&mut matched, &mut noise, 10_000);
    let bad = [f32::NAN; SIDE_TACTELS * SIDE_TACTELS];
    for frame in 10_060..10_260 {
        let found = matched.update(&sample(frame, &bad));
        assert!(found.is_none_or(|onset| onset.statistic.is_finite()), "{found:?}");
    }
    assert_eq!(matched.update(&sample(10_260, &bad)), None);
}

#[test]
#[ignore = "a measurement: --ignored --nocapture, profile release"]
#[expect(clippy::disallowed_methods, reason = "a measurement reads a clock")]
fn what_an_image_costs() {
    let mut matched = test(&SlipParameters::default());
    let mut noise = Noise(5);
    let exact = bar(0.0, 14_000.0);
    let images: Vec<_> = (0..1000).map(|_| noisy(&exact, &mut noise)).collect();
    let start = std::time::Instant::now();
    for (frame, counts) in images.iter().enumerate() {
        core::hint::black_box(matched.update(&sample(frame as u32, counts)));
    }
    println!("{:.1} us an image", start.elapsed().as_secs_f64() * 1e3);
}
