//! The fit on generated rests: a known Jacobian, noise, drift, and motions made together.

use super::fit::{Estimate, Identification, Row, fit};
use super::rests::Rest;

/// Changes of (m0, x_c, y_c) with (x, y, z, theta_x): theta_x is a tenth of y, as on a dome.
const TRUE_JACOBIAN: [[f64; 4]; 3] =
    [[0.0, 0.0, 14_000.0, 0.0], [-0.63, 0.0, 0.0, 0.0], [0.0, -0.63, 0.0, -0.063]];
/// Noise of one image.
const IMAGE_NOISE: [f64; 3] = [200.0, 0.03, 0.03];

/// A pseudo-random number between -1 and 1.
fn random(word: &mut u64) -> f64 {
    *word = word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
    (*word >> 40) as f64 / f64::from(1_u32 << 23) - 1.0
}

/// Each of four motions in both directions, twice, by `size`; the finger rests in between.
fn rests(size: [f64; 4], noise: f64, drift: f64) -> Vec<Rest> {
    let mut word = 7;
    let mut steps = Vec::new();
    for sweep in 0..2 {
        for (j, size) in size.iter().enumerate() {
            for part in [1.0, 0.0, -1.0, 0.0] {
                let mut step = [0.0; 6];
                step[j] = part * size;
                steps.push((sweep, step));
            }
        }
    }
    let images = 50;
    let rest = |(index, (_, motion)): (usize, &(i32, [f64; 6]))| {
        let at_s = 0.5 * index as f64;
        let mut mean = [None; 5];
        let mut variance = [0.0; 5];
        for (i, (row, sigma)) in TRUE_JACOBIAN.iter().zip(IMAGE_NOISE).enumerate() {
            let moved: f64 = row.iter().zip(motion).map(|(j, x)| j * x).sum();
            // Uniform numbers with this deviation.
            let error = noise * sigma * 3f64.sqrt() * random(&mut word) / f64::from(images).sqrt();
            mean[i] = Some([8000.0, 8.5, 8.5][i] + moved + error + drift * at_s);
            variance[i] = sigma * sigma;
        }
        Rest { at_s, motion: *motion, mean, variance, images: images as usize, run: index / 4 }
    };
    steps.iter().enumerate().map(rest).collect()
}

fn entries(found: &Identification) -> Vec<(f64, f64, f64)> {
    let rows = found.rows.iter().enumerate();
    rows.flat_map(|(i, row)| {
        row.entries.iter().enumerate().map(move |(j, e)| (e.value, e.error, TRUE_JACOBIAN[i][j]))
    })
    .collect()
}

const MOTION_SIZE: [f64; 4] = [1.0, 1.0, 0.1, 5.0];

#[test]
fn a_known_jacobian_comes_out_and_drift_is_not_taken_for_motion() {
    let found = fit(&rests(MOTION_SIZE, 0.0, 0.01)).unwrap();
    assert_eq!((found.motions.len(), found.rows.len()), (4, 3));
    for (value, _, due) in entries(&found) {
        assert!((value - due).abs() < 1e-6 * 14_000.0, "{value}, due {due}");
    }
    assert!((found.rows[1].drift.value - 0.01).abs() < 1e-9);
    assert!(found.test_condition < 1.5, "{}", found.test_condition);
}

#[test]
fn the_uncertainty_covers_what_noise_does() {
    let found = fit(&rests(MOTION_SIZE, 1.0, 0.0)).unwrap();
    let all = entries(&found);
    let inside = all.iter().filter(|(value, error, due)| (value - due).abs() <= *error).count();
    assert!(inside * 10 >= all.len() * 8, "{inside} of {}: {all:?}", all.len());
    // The error is within a tenth of the entry, and no better than the noise allows.
    let (value, error, _) = all[2];
    assert!(error > 0.0 && error < 0.1 * value, "{value} +- {error}");
}

#[test]
fn motions_that_the_image_does_not_distinguish_form_no_task() {
    let found = fit(&rests(MOTION_SIZE, 1.0, 0.0)).unwrap();
    // With four motions and three features, the turn that looks like a shift is left out.
    let task = found.task(&[], &[]);
    assert_eq!((task.motions.clone(), task.features.clone()), (vec![0, 1, 2], vec![0, 1, 2]));
    assert!(found.resolution(&task).unwrap().iter().all(|step| *step < 0.1));
    // When it is requested instead of y, it is detected.
    assert_eq!(found.task(&[2, 3], &[]).motions, [2, 3]);
    assert_eq!(found.task(&[2, 3], &[0, 2]).features, [0, 2]);
    // One feature shows one motion, and a motion that was not made shows none.
    assert_eq!(found.task(&[], &[1]).motions, [0]);
    assert!(found.task(&[5], &[]).motions.is_empty());
    assert_eq!(found.singular_values.len(), 3);
}

#[test]
fn two_motions_that_look_nearly_alike_are_one() {
    // The remainder of one beside the other is 4 deviations; their difference shows by 2.8.
    let row = |feature: usize, values: [f64; 2]| Row {
        feature,
        entries: values.map(|value| Estimate { value, error: 2.0 }).to_vec(),
        uniform_deviation: vec![1.0; 2],
        drift: Estimate { value: 0.0, error: 1.0 },
        noise: 1.0,
        residual: 1.0,
        mean: 0.0,
    };
    let with = |apart: f64| Identification {
        motions: vec![(1, 1.0), (3, 1.0)],
        test_condition: 1.0,
        rows: vec![row(0, [100.0, 100.0]), row(2, [0.0, apart])],
        singular_values: Vec::new(),
    };
    assert_eq!(with(4.0).task(&[], &[]).motions.len(), 1);
    assert_eq!(with(4.0).task(&[1], &[]).motions, [0]);
    assert_eq!(with(5.0).task(&[], &[]).motions, [0, 1]);
}

#[test]
fn motions_made_together_and_few_rests_are_refused() {
    let mut together = rests(MOTION_SIZE, 0.0, 0.0);
    for rest in &mut together {
        rest.motion[1] = rest.motion[0];
        rest.motion[0] += 1e-3 * rest.at_s;
    }
    let bad = fit(&together).unwrap_err();
    assert!(bad.contains("made together"), "{bad}");
    assert!(fit(&[]).unwrap_err().contains("0 rests"));
    let few = &rests(MOTION_SIZE, 0.0, 0.0)[..7];
    assert!(fit(few).unwrap_err().contains("stand at least"));
    let mut still = rests(MOTION_SIZE, 0.0, 0.0);
    still.iter_mut().for_each(|rest| rest.motion = [0.0; 6]);
    assert!(fit(&still).unwrap_err().contains("0 motions"));
}

#[test]
fn a_feature_that_one_rest_lacks_is_left_out() {
    let mut some = rests(MOTION_SIZE, 0.0, 0.0);
    some[3].mean[1] = None;
    let found = fit(&some).unwrap();
    assert_eq!(found.rows.iter().map(|row| row.feature).collect::<Vec<_>>(), [0, 2]);
}
