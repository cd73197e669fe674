//! Tests the baseline from free, loaded and damaged frames, and the images above it.

use super::*;
use taktil_hal::Nanos;

const SATURATION: SaturationLimits = SaturationLimits { low_counts: 1.0, high_counts: 2000.0 };

fn frame(level: u16) -> TactileFrame {
    let mut frame = TactileFrame::new(16, 16);
    frame.values.fill(level);
    frame.valid.fill(true);
    frame
}

fn image(baseline: &Baseline, frame: &TactileFrame) -> TactileImage {
    let mut image = TactileImage::new(frame.rows(), frame.cols());
    // What was there before must not show.
    image.counts.fill(7.0);
    image.valid.fill(1);
    baseline.image(frame, &mut image);
    image
}

fn report(baseline: &Baseline, acquired_ns: i64) -> TactileBaseline {
    let mut told = TactileBaseline::new(256);
    baseline.report(acquired_ns, &mut told);
    told
}

fn none_dead() -> Box<[bool]> {
    vec![false; 256].into()
}

fn learnt(frames: &[TactileFrame]) -> Baseline {
    let number = u32::try_from(frames.len()).unwrap();
    let mut baseline = Baseline::new(number..=number, none_dead(), SATURATION);
    for frame in frames {
        baseline.add_frame(frame);
    }
    baseline
}

#[test]
fn the_baseline_is_the_mean_of_exactly_the_first_frames() {
    let mut baseline = Baseline::new(3..=3, none_dead(), SATURATION);
    for (level, ready) in [(100, false), (101, false), (103, true), (4000, true)] {
        baseline.add_frame(&frame(level));
        assert_eq!(baseline.is_ready(), ready);
    }
    assert!((baseline.mean_counts(255) - 304.0 / 3.0).abs() < 1e-12);
    baseline.rearm();
    assert!(!baseline.is_ready() && baseline.mean_counts(0) == 0.0);
    (0..3).for_each(|_| baseline.add_frame(&frame(50)));
    assert!((baseline.mean_counts(0) - 50.0).abs() < f64::EPSILON);
}

/// Frames of alternating level, so that the noise is 10 counts, with a load on the middle rows.
fn loaded(job: u32, counts: u16) -> TactileFrame {
    let mut frame = frame(if job.is_multiple_of(2) { 290 } else { 310 });
    frame.values[96..144].iter_mut().for_each(|value| *value += counts);
    // Each frame has both signs, as noise has.
    frame.values.iter_mut().skip(1).step_by(2).for_each(|value| {
        *value = if job.is_multiple_of(2) { *value + 20 } else { *value - 20 };
    });
    frame
}

#[test]
fn frames_count_until_something_touches_and_none_of_a_slow_touch() {
    let mut baseline = Baseline::new(40..=400, none_dead(), SATURATION);
    // Free for 200 frames; then a load that grows by a count on each of 48 tactels a frame.
    let mut closed = 0;
    for job in 0..400 {
        let load = u16::try_from(job.clamp(200, 300) - 200).unwrap();
        baseline.add_frame(&loaded(job, load));
        assert!(baseline.is_ready() == (job >= 39));
        closed += u32::from(!baseline.is_closed());
    }
    assert!(baseline.is_closed() && (200..216).contains(&closed), "{closed}");
    let told = report(&baseline, 0);
    assert!((168..=200).contains(&told.frames), "{}", told.frames);
    assert!((baseline.mean_counts(100) - 300.0).abs() < 0.01, "{}", baseline.mean_counts(100));
    assert!((baseline.noise_counts() - 10.0).abs() < 0.15, "of the first forty");
    baseline.add_frame(&frame(900));
    assert!((baseline.mean_counts(100) - 300.0).abs() < 0.01, "closed for good");
    baseline.rearm();
    assert!(!baseline.is_closed() && !baseline.is_ready());
    (0..40).for_each(|job| baseline.add_frame(&loaded(job, 7)));
    assert!(baseline.is_ready() && !baseline.is_closed(), "a restart begins anew");
    assert!((baseline.mean_counts(100) - 307.0).abs() < 0.01);
}

#[test]
fn without_a_touch_it_ends_with_the_most_frames_and_a_tactel_that_blinks_ends_it_sooner() {
    let frames = |blinks: bool| {
        let mut baseline = Baseline::new(40..=400, none_dead(), SATURATION);
        for job in 0..1000 {
            let mut frame = loaded(job, 0);
            if blinks && job == 150 {
                frame.values[9] = 2_500;
            }
            frame.valid[11] = job < 90;
            baseline.add_frame(&frame);
        }
        assert!(baseline.is_closed());
        let told = report(&baseline, 0);
        assert!((baseline.mean_counts(9) - 300.0).abs() < 0.01);
        (told.frames, told.valid[11])
    };
    assert_eq!(frames(false), (392, 0), "whole blocks of sixteen; seldom valid, not believed");
    assert_eq!(frames(true), (120, 1));
}

#[test]
fn the_noise_is_measured_with_the_rest_level_and_reported_once() {
    let frames: Vec<TactileFrame> = [290, 310, 290, 310].map(frame).to_vec();
    let baseline = learnt(&frames);
    let due = (4.0 * 100.0_f64 / 3.0).sqrt();
    assert!((baseline.noise_counts() - due).abs() < 1e-12, "{}", baseline.noise_counts());
    let told = report(&baseline, 17);
    assert_eq!((told.acquired_ns, told.frames, told.trusted), (17, 4, 256));
    assert_eq!((told.mean_counts[200], told.valid[200]), (300.0, 1));
    assert!((f64::from(image(&baseline, &frame(300)).noise_counts) - due).abs() < 1e-5);
    assert_eq!(learnt(&[frame(300)]).noise_counts(), 0.0, "one frame has no spread");
    let mut odd = Baseline::new(1..=1, vec![true; 256].into(), SATURATION);
    odd.add_frame(&frame(300));
    assert_eq!((odd.noise_counts(), report(&odd, 0).trusted), (0.0, 0));
}

#[test]
fn counts_below_the_rest_level_stay_negative() {
    let baseline = learnt(&[frame(300), frame(300)]);
    let mut pressed = frame(300);
    pressed.values[17] = 1300;
    pressed.values[18] = 250;
    pressed.values[19] = 4095;
    let image = image(&baseline, &pressed);
    assert_eq!(image.counts[16..20], [0.0, 1000.0, -50.0, 3795.0]);
    assert_eq!((image.valid[19], image.baseline_ready), (1, 1), "no rail is known");
}

#[test]
fn a_calibrated_response_is_taken_out_and_the_rail_stays_the_rail() {
    let frames: Vec<TactileFrame> = [290, 310, 290, 310].map(frame).to_vec();
    let response = Response { exponent: 0.8, full_counts: 4095.0, threshold_counts: 0.0 };
    let mut linear = Baseline::new(4..=4, none_dead(), SATURATION);
    linear = linear.linearised(Some(response), 4095);
    frames.iter().for_each(|frame| linear.add_frame(frame));
    let mut pressed = frame(300);
    (pressed.values[1], pressed.values[2], pressed.values[3]) = (1300, 4095, 4094);
    let image = image(&linear, &pressed);
    let due = 4095.0 * libm::pow(1000.0 / 4095.0, 1.25);
    assert!((f64::from(image.counts[1]) - due).abs() < 1e-3, "{}", image.counts[1]);
    assert_eq!((image.counts[0], image.counts[2]), (0.0, 3795.0));
    assert!(image.counts[3] < 3794.0, "only the rail is lifted: {}", image.counts[3]);
    let plain = learnt(&frames).noise_counts();
    assert!(f64::from(image.noise_counts) < plain, "noise is scaled as readings are");
}

#[test]
fn saturation_is_judged_by_the_raw_reading_before_the_curve() {
    for (exponent, full_counts) in [(1.0, 4095.0), (0.6, 2000.0), (0.7, 4095.0), (1.6, 4095.0)] {
        let mut scan = Baseline::new(1..=1, none_dead(), SATURATION);
        let response = Response { exponent, full_counts, threshold_counts: 0.0 };
        scan = scan.linearised(Some(response), 4095);
        let mut rest = frame(300);
        rest.values[5] = 1200;
        scan.add_frame(&rest);
        let mut pressed = rest.clone();
        (pressed.values[3], pressed.values[4], pressed.values[5]) = (3700, 4095, 4095);
        let image = image(&scan, &pressed);
        assert_eq!(image.valid[2..6], [1, 1, TACTEL_SATURATED, TACTEL_SATURATED], "{exponent}");
    }
}

#[test]
fn before_the_baseline_an_image_shows_nothing() {
    let baseline = Baseline::new(2..=2, none_dead(), SATURATION);
    let image = image(&baseline, &frame(3000));
    assert!(image.counts.iter().all(|count| *count == 0.0));
    assert!(image.valid.iter().all(|valid| *valid == 0));
    assert_eq!(image.baseline_ready, 0);
}

#[test]
fn dead_stuck_and_doubtful_tactels_are_not_believed() {
    let mut odd = frame(300);
    odd.values[1] = 0;
    odd.values[2] = 4095;
    odd.valid[3] = false;
    let mut dead = none_dead();
    dead[0] = true;
    let mut baseline = Baseline::new(2..=2, dead, SATURATION);
    baseline.add_frame(&odd);
    baseline.add_frame(&odd);
    let mut now = frame(400);
    now.valid[4] = false;
    let image = image(&baseline, &now);
    assert_eq!(image.valid[..6], [0, 0, 0, 0, 0, 1]);
    assert_eq!(image.counts[..6], [0.0, 0.0, 0.0, 0.0, 0.0, 100.0]);
    assert_eq!(baseline.trusted(), 252);
}

#[test]
fn limits_of_the_rails_are_inside() {
    for (level, valid) in [(0, 0), (1, 1), (2000, 1), (2001, 0)] {
        assert_eq!(image(&learnt(&[frame(level)]), &frame(level)).valid[7], valid, "{level}");
    }
}

#[test]
fn times_of_rows_are_carried_relative_to_the_frame() {
    let mut frame = frame(300);
    frame.acquired = Nanos(10_000_000);
    for (row, at) in frame.row_acquired.iter_mut().enumerate() {
        *at = Nanos(5_000_000 + 312_500 * i64::try_from(row + 1).unwrap());
    }
    frame.row_acquired[1] = Nanos(i64::MIN);
    frame.sequence = 77;
    let image = image(&learnt(std::slice::from_ref(&frame)), &frame);
    assert_eq!((image.acquired_ns, image.sequence), (10_000_000, 77));
    assert_eq!(image.row_offset_ns[0], -4_687_500);
    assert_eq!(image.row_offset_ns[15], 0);
    assert_eq!(image.row_offset_ns[1], i32::MIN);
}

#[test]
fn a_frame_of_another_array_does_no_harm() {
    for (rows, cols) in [(1, 1), (64, 64)] {
        let mut other = TactileFrame::new(rows, cols);
        other.valid.fill(true);
        other.values.fill(300);
        let mut baseline = learnt(&[frame(300)]);
        baseline.add_frame(&other);
        let mut image = TactileImage::new(16, 16);
        baseline.image(&other, &mut image);
        assert_eq!(usize::from(image.valid[255]), usize::from(rows == 64));
    }
}
