//! The place of drawn loads in noise, beside the bound, and what gives no place.

use super::*;

const SIDE_TACTELS: usize = 16;

/// A load of Gaussian shape with this middle, deviations along its own axes and turn.
fn load(centre: DVec2, deviations: DVec2, turn: f64, sum: f64) -> Vec<f64> {
    let mut counts = Vec::new();
    for r in 1..=SIDE_TACTELS {
        for c in 1..=SIDE_TACTELS {
            let off = DVec2::new(c as f64, r as f64) - centre;
            let own = DVec2::from_angle(-turn).rotate(off) / deviations;
            counts.push(libm::exp(-0.5 * own.length_squared()));
        }
    }
    let all: f64 = counts.iter().sum();
    counts.iter().map(|value| value * sum / all).collect()
}

/// Normal numbers of variance 1: the sum of twelve uniform ones less 6.
fn normal(state: &mut u64) -> f64 {
    let mut sum = -6.0;
    for _ in 0..12 {
        *state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        sum += (*state >> 11) as f64 / (1_u64 << 53) as f64;
    }
    sum
}

fn update(
    tracker: &mut PlaceTracker,
    counts: &[f64],
    noise: f64,
    state: &mut u64,
) -> Option<Place> {
    let noisy: Vec<f32> =
        counts.iter().map(|value| (value + noise * normal(state)) as f32).collect();
    tracker.update(
        (&noisy, &[1; SIDE_TACTELS * SIDE_TACTELS]),
        SIDE_TACTELS,
        noise.max(1.0),
        DVec2::ZERO,
    )
}

#[test]
fn a_load_is_found_where_it_lies_and_followed() {
    let mut state = 5;
    for (deviations, turn) in [(DVec2::new(1.2, 1.2), 0.0), (DVec2::new(1.0, 2.6), 0.4)] {
        let start = DVec2::new(8.0, 9.0);
        let mut tracker = PlaceTracker::new(start + DVec2::splat(0.3), [2.0, 0.0, 2.0]).unwrap();
        for frame in 0..120 {
            let centre = start + DVec2::new(0.01, -0.005) * f64::from(frame);
            let counts = load(centre, deviations, turn, 15_000.0);
            let found = update(&mut tracker, &counts, 0.0, &mut state).unwrap();
            if frame > 3 {
                assert!((found.centre - centre).length() < 0.01, "{frame}: {found:?} {centre}");
            }
        }
        let due = [deviations.x, deviations.y].map(|value| value * value);
        let [xx, _, yy] = tracker.shape();
        assert!((xx + yy - due[0] - due[1]).abs() < 0.05 * (due[0] + due[1]), "{xx} {yy}");
    }
}

#[test]
fn its_noise_is_as_stated_and_near_the_bound_that_no_estimate_beats() {
    let (centre, noise) = (DVec2::new(8.3, 8.6), 50.0);
    let counts = load(centre, DVec2::new(1.5, 2.0), 0.0, 15_000.0);
    let exact = Image::new(SIDE_TACTELS, SIDE_TACTELS, &counts, None).unwrap();
    let [bound_xx, _, bound_yy] = place_bound(&exact, noise);
    let mut tracker = PlaceTracker::new(centre, [2.2, 0.0, 4.0]).unwrap();
    let mut state = 9;
    let (mut squares, mut stated, mut number) = (DVec2::ZERO, DVec2::ZERO, 0.0);
    for frame in 0..4000 {
        let found = update(&mut tracker, &counts, noise, &mut state).unwrap();
        if frame < 100 {
            continue;
        }
        let off = found.centre - centre;
        squares += off * off;
        stated += DVec2::new(found.covariance[0], found.covariance[2]);
        number += 1.0;
    }
    let (found, stated) = (squares / number, stated / number);
    for (found, stated, bound) in [(found.x, stated.x, bound_xx), (found.y, stated.y, bound_yy)] {
        assert!((found / stated - 1.0).abs() < 0.15, "found {found}, stated {stated}");
        assert!(found > 0.9 * bound && found < 1.4 * bound, "found {found}, bound {bound}");
    }
}

#[test]
fn a_line_across_the_pad_is_seen_across_and_not_along() {
    let mut counts = vec![0.0; SIDE_TACTELS * SIDE_TACTELS];
    for row in counts.chunks_exact_mut(SIDE_TACTELS) {
        (row[7], row[8], row[9]) = (300.0, 400.0, 240.0);
    }
    let mut tracker = PlaceTracker::new(DVec2::new(8.9, 8.5), [1.0, 0.0, 21.0]).unwrap();
    let found = update(&mut tracker, &counts, 0.0, &mut 1).unwrap();
    let SeenMotion::Along(axis) = found.seen else { panic!("{found:?}") };
    assert!(axis.x.abs() > 0.999, "{axis}");
    let line = Image::new(SIDE_TACTELS, SIDE_TACTELS, &counts, None).unwrap();
    assert_eq!(place_bound(&line, 50.0)[2], f64::INFINITY);
    let mut edge = PlaceTracker::new(DVec2::new(1.2, 8.0), [2.0, 0.0, 2.0]).unwrap();
    let counts = load(DVec2::new(1.2, 8.0), DVec2::new(1.4, 1.4), 0.0, 15_000.0);
    let found = update(&mut edge, &counts, 0.0, &mut 1).unwrap();
    assert_eq!(found.seen, SeenMotion::Nothing, "{found:?}");
}

#[test]
fn what_is_no_load_gives_no_place() {
    let mut tracker = PlaceTracker::new(DVec2::splat(8.5), [2.0, 0.0, 2.0]).unwrap();
    let before = tracker;
    let mut state = 2;
    assert_eq!(
        update(&mut tracker, &[0.0; SIDE_TACTELS * SIDE_TACTELS], 50.0, &mut state),
        None,
        "noise"
    );
    assert_eq!(
        update(&mut tracker, &[-90.0; SIDE_TACTELS * SIDE_TACTELS], 0.0, &mut state),
        None,
        "negative"
    );
    assert_eq!(
        update(&mut tracker, &[f64::NAN; SIDE_TACTELS * SIDE_TACTELS], 1.0, &mut state),
        None,
        "NaN"
    );
    let marks = [0; SIDE_TACTELS * SIDE_TACTELS];
    let one = [90.0_f32; SIDE_TACTELS * SIDE_TACTELS];
    assert_eq!(
        tracker.update((&one, &marks), SIDE_TACTELS, 1.0, DVec2::ZERO),
        None,
        "none is valid"
    );
    let marks = [1; SIDE_TACTELS * SIDE_TACTELS];
    assert_eq!(tracker.update((&one, &marks), 0, 1.0, DVec2::ZERO), None);
    assert_eq!(tracker.update((&one, &marks), 15, 1.0, DVec2::ZERO), None);
    assert_eq!(tracker.update((&one[1..], &marks), SIDE_TACTELS, 1.0, DVec2::ZERO), None);
    assert_eq!(tracker.update((&one, &marks), SIDE_TACTELS, f64::NAN, DVec2::ZERO), None);
    assert_eq!(tracker, before);
    assert_eq!(PlaceTracker::new(DVec2::NAN, [1.0, 0.0, 1.0]), None);
    assert_eq!(PlaceTracker::new(DVec2::ONE, [f64::INFINITY, 0.0, 1.0]), None);
}
