//! Tests known lines under noise, dead rows and saturated tactels.

use taktil_signal::{TACTEL_SATURATED, TactileImage};

use super::{Line, LineParameters, LoadProfile};
use crate::config::array::Array;
use crate::perception::TouchFeatures;

/// Features of an image of the default array.
fn touch_features(image: &TactileImage, threshold: f64, contact: f64) -> TouchFeatures {
    crate::perception::touch_features(image, &Array::default(), threshold, contact)
}

fn line(image: &TactileImage, touch: &TouchFeatures, known: &LineParameters) -> Option<Line> {
    super::line(image, &Array::default(), touch, known)
}

const KNOWN: LineParameters =
    LineParameters { profile: LoadProfile::EVEN_LOAD, noise_counts: 50.0, speed_cols_s: 0.0 };

/// Whole counts of a parabolic line load of `total` counts, half as wide as 1.3 columns, whose axis
/// is turned by `theta` and passes column `x` at the middle row.
fn image(x: f64, theta: f64, total: f64) -> TactileImage {
    let mut image =
        TactileImage { valid: vec![1; 256].into(), baseline_ready: 1, ..TactileImage::new(16, 16) };
    let half = 1.3;
    let integral = |u: f64| {
        let u = u.clamp(-half, half) / half;
        0.5 + 0.75 * (u - u * u * u / 3.0)
    };
    for row in 0..16_u8 {
        let middle = x - libm::tan(theta) * (f64::from(row) + 1.0 - 8.5);
        for col in 0..16_u8 {
            let u = f64::from(col) + 1.0 - middle;
            let share = integral(u + 0.5) - integral(u - 0.5);
            image.counts[usize::from(row) * 16 + usize::from(col)] = (share * total / 16.0) as f32;
        }
    }
    image
}

/// Adds noise of standard deviation 50: twelve uniform numbers of a congruence (Knuth's MMIX).
fn noisy(image: &TactileImage, seed: &mut u64) -> TactileImage {
    let mut out = image.clone();
    for counts in &mut out.counts {
        let mut sum = -6.0;
        for _ in 0..12 {
            *seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            sum += (*seed >> 40) as f64 / f64::from(1 << 24);
        }
        *counts = (f64::from(*counts) + 50.0 * sum).round() as f32;
    }
    out
}

fn line_in(image: &TactileImage) -> Option<Line> {
    line(image, &touch_features(image, 150.0, 1000.0), &KNOWN)
}

#[test]
fn a_line_is_read_where_it_is() {
    for (x, theta) in [(8.5, 0.0), (3.2, 0.05), (13.9, -0.1), (8.0, 0.3)] {
        let found = line_in(&image(x, theta, 15_000.0)).unwrap();
        let [x_c, m0, m_x, read] = found.features;
        // Tactels integrate area: what is left is the ripple of the centroid.
        assert!((x_c - x).abs() < 0.02 && (read - theta).abs() < 0.004, "{x} {theta}: {found:?}");
        assert!((m0 - 15_000.0).abs() < 60.0 && m_x.abs() < 600.0, "{x} {theta}: {found:?}");
    }
}

#[test]
fn noise_leaves_the_sum_unbiased_and_the_stated_variances_hold() {
    let (clean, mut seed) = (image(8.3, 0.02, 15_000.0), 7);
    let mut sums = [[0.0; 2]; 4];
    let mut stated = [0.0; 4];
    let number = 400.0;
    for _ in 0..400 {
        let found = line_in(&noisy(&clean, &mut seed)).unwrap();
        let truth = [8.3, 15_000.0, 0.0, 0.02];
        for i in 0..4 {
            let error = found.features[i] - truth[i];
            sums[i][0] += error / number;
            sums[i][1] += error * error / number;
            stated[i] += found.variance[i] / number;
        }
    }
    let deg = sums[3][1].sqrt().to_degrees();
    // A row of 937 counts has 50 sqrt(10)/937 columns, and the line 1/sqrt(340) of that a row.
    assert!((0.4..0.6).contains(&deg), "theta_z: {deg} deg");
    assert!(sums[1][0].abs() < 60.0, "M0 is off by {} of 15000", sums[1][0]);
    for i in 0..4 {
        let ratio = sums[i][1] / stated[i];
        assert!((0.3..2.0).contains(&ratio), "feature {i}: {ratio} of the stated variance");
    }
    // The threshold alone cuts the tails of the load off, which the band avoids.
    let cut = touch_features(&clean, 150.0, 1000.0).m0;
    assert!(cut < 14_500.0, "{cut}");
}

#[test]
fn a_dead_row_and_dead_tactels_are_filled_by_their_neighbours() {
    let whole = line_in(&image(8.3, 0.05, 15_000.0)).unwrap();
    let mut odd = image(8.3, 0.05, 15_000.0);
    odd.valid[5 * 16..6 * 16].fill(0);
    odd.counts[5 * 16..6 * 16].fill(0.0);
    odd.valid[11 * 16 + 7] = 0;
    let found = line_in(&odd).unwrap();
    assert!(found.interpolated >= 6);
    assert!((found.features[1] / whole.features[1] - 1.0).abs() < 0.01, "{found:?}");
    assert!((found.features[3] - 0.05).abs() < 0.01);
    // The thesis's sum loses a sixteenth.
    assert!(touch_features(&odd, 0.0, 1000.0).m0 < 14_200.0);
}

#[test]
fn a_row_that_died_unknown_to_anybody_is_stood_for_by_its_neighbours() {
    let (mut seed, mut clean) = (3, image(8.3, 0.05, 15_000.0));
    clean.counts[5 * 16..6 * 16].fill(0.0);
    let (mut mean, mut noticed) = (0.0, 0);
    for _ in 0..100 {
        let noisy = noisy(&clean, &mut seed);
        let found = line_in(&noisy).unwrap();
        noticed += u32::from(found.interpolated >= 5);
        mean += found.features[1] / 100.0;
    }
    assert!((mean / 15_000.0 - 1.0).abs() < 0.01 && noticed >= 98, "{mean} {noticed}");
    // Half of the load gives half of the sum.
    let mut half = image(8.3, 0.0, 15_000.0);
    half.counts[8 * 16..].fill(0.0);
    let found = line_in(&half).unwrap();
    assert!((found.features[1] - 7_500.0).abs() < 1.0 && found.interpolated == 0, "{found:?}");
}

#[test]
fn a_tactel_at_full_scale_widens_the_error_of_the_sums() {
    let mut heavy = image(8.5, 0.0, 15_000.0);
    let before = line_in(&heavy).unwrap();
    heavy.counts[7 * 16 + 7] = 3795.0;
    heavy.valid[7 * 16 + 7] = TACTEL_SATURATED;
    let found = line_in(&heavy).unwrap();
    assert_eq!((before.saturated, found.saturated), (0, 1));
    assert!(found.variance[1] > 2.0 * before.variance[1]);
    // A reading that is large only because of the calibrated response is not saturated.
    heavy.counts[7 * 16 + 7] = 5000.0;
    heavy.valid[7 * 16 + 7] = 1;
    let found = line_in(&heavy).unwrap();
    assert_eq!(found.saturated, 0);
    assert!(found.variance[1] < 1.1 * before.variance[1]);
}

#[test]
fn rows_scanned_later_are_moved_to_the_time_of_the_image() {
    let mut sheared = image(8.5, 0.0, 15_000.0);
    let speed = 40.0;
    for row in 0..16_usize {
        // Row by row over 5 ms, the last one at the time of the image.
        let late_ns = -312_500 * (15 - i32::try_from(row).unwrap());
        sheared.row_offset_ns[row] = late_ns;
        let there = image(8.5 + speed * f64::from(late_ns) * 1e-9, 0.0, 15_000.0);
        sheared.counts[row * 16..][..16].copy_from_slice(&there.counts[row * 16..][..16]);
    }
    let touched = touch_features(&sheared, 150.0, 1000.0);
    let plain = line(&sheared, &touched, &KNOWN).unwrap().features;
    let moving = LineParameters { speed_cols_s: speed, ..KNOWN };
    let cured = line(&sheared, &touched, &moving).unwrap().features;
    assert!(plain[3].abs() > 0.008, "the skew shows: {plain:?}");
    assert!(cured[3].abs() < 0.002 && (cured[0] - 8.5).abs() < 0.02, "{cured:?}");
}

#[test]
fn an_image_without_a_line_gives_none() {
    assert_eq!(line_in(&image(8.5, 0.0, 0.0)), None);
    let mut across = image(8.5, 0.0, 0.0);
    across.counts[7 * 16..8 * 16].fill(1000.0);
    assert_eq!(line_in(&across), None, "a line along the rows is none across them");
    for odd in [f32::NAN, f32::INFINITY, f32::MAX, f32::MIN, -1e30] {
        let mut all = image(8.5, 0.0, 15_000.0);
        all.counts[100..140].fill(odd);
        if let Some(found) = line_in(&all) {
            assert!(found.features.iter().chain(&found.variance).all(|x| x.is_finite()), "{odd}");
        }
    }
    for (rows, cols) in [(0, 0), (4, 64), (u16::MAX, 3)] {
        assert_eq!(line_in(&TactileImage { rows, cols, ..image(8.5, 0.0, 15_000.0) }), None);
    }
}

#[test]
fn a_contact_that_only_begins_and_one_of_a_single_row_have_features_and_wide_variances() {
    // A third of the load: rows of 250 counts, noise of 112 each.
    let (clean, mut seed) = (image(6.3, 0.05, 4_000.0), 11);
    let mut worst = [0.0_f64; 2];
    let mut sum = 0.0;
    for _ in 0..200 {
        let noisy = noisy(&clean, &mut seed);
        let touch = touch_features(&noisy, 150.0, 300.0);
        let found = line(&noisy, &touch, &KNOWN).expect("there is a line");
        let [x_c, m0, _, theta] = found.features;
        let sigma = [found.variance[0].sqrt(), found.variance[3].sqrt()];
        let off = [(x_c - 6.3).abs() / sigma[0], (theta - 0.05).abs() / sigma[1]];
        worst = [worst[0].max(off[0]), worst[1].max(off[1])];
        assert!(sigma[1] > 0.02, "{sigma:?}");
        sum += m0 / 200.0;
    }
    assert!((sum - 4_000.0).abs() < 150.0, "M0 is {sum} in the mean");
    assert!(worst[0] < 6.0 && worst[1] < 5.0, "{worst:?} standard deviations");
    let mut corner = image(8.5, 0.0, 0.0);
    corner.counts[15 * 16 + 7] = 1_500.0;
    let found = line_in(&corner).unwrap();
    let [x_c, m0, m_x, theta] = found.features;
    assert!((x_c - 8.0).abs() < 0.1 && theta.abs() < 0.05, "{found:?}");
    assert!((m0 - 1_500.0).abs() < 1.0 && (m_x - 7.5 * 1_500.0).abs() < 10.0, "{found:?}");
    assert!(found.variance[3].sqrt() > 0.1, "one row has hardly a direction: {found:?}");
}

/// Mean of the sum by a shape and of the plain one, and their standard deviations, over noise.
fn sums(profile: LoadProfile) -> [f64; 4] {
    let (known, mut seed) = (LineParameters { profile, ..KNOWN }, 11);
    let [mut sum, mut weighted, mut squares, mut shaped_squares] = [0.0; 4];
    for image in (0..400).map(|step| image(6.0 + 0.01 * f64::from(step), 0.05, 15_000.0)) {
        let noisy = noisy(&image, &mut seed);
        let found = line(&noisy, &touch_features(&noisy, 150.0, 1000.0), &known).unwrap();
        let (m0, other) = (found.features[1] - 15_000.0, found.weighted[0] - 15_000.0);
        (sum, squares) = (sum + m0 / 400.0, squares + m0 * m0 / 400.0);
        (weighted, shaped_squares) =
            (weighted + other / 400.0, shaped_squares + other * other / 400.0);
        let due = found.weighted_variance[0].sqrt();
        assert!(due <= found.variance[1].sqrt() + 1e-6, "{due}");
    }
    let spread = |square: f64, mean: f64| (square - mean * mean).sqrt();
    [sum, weighted, spread(squares, sum), spread(shaped_squares, weighted)]
}

#[test]
fn a_sum_by_the_shape_has_less_noise_and_by_an_even_one_is_the_plain_sum() {
    let integral = |u: f64| {
        let u = u.clamp(-1.3, 1.3) / 1.3;
        0.5 + 0.75 * (u - u * u * u / 3.0)
    };
    let [sum, weighted, spread, less] =
        sums(LoadProfile::new(2.5, |away| integral(away + 0.5) - integral(away - 0.5)));
    assert!(sum.abs() < 75.0 && weighted.abs() < 150.0, "{sum} {weighted}");
    assert!((400.0..500.0).contains(&spread) && less < 0.88 * spread, "{spread} {less}");
    let [sum, weighted, spread, same] = sums(LoadProfile::EVEN_LOAD);
    assert!((sum - weighted).abs() < 1e-6 && (spread - same).abs() < 1e-6, "{sum} {weighted}");
}
