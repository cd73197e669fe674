//! Arrays of other sizes and pitches: what an image of a known line of load says, what a law
//! computes for the same pad divided otherwise, and images that do not belong to the array.

use taktil_signal::TactileImage;
use taktil_tasks_tactile_servo::Config;
use taktil_tasks_tactile_servo::config::array::Array;
use taktil_tasks_tactile_servo::law::model::jacobian::ContactModel;
use taktil_tasks_tactile_servo::perception::line::{Line, LineParameters, LoadProfile, line};
use taktil_tasks_tactile_servo::perception::{TouchFeatures, touch_features};

const ARRAYS: [Array; 6] = [
    Array { rows: 16, cols: 16, pitch_x_mm: 1.5875, pitch_y_mm: 1.5875 },
    Array { rows: 12, cols: 32, pitch_x_mm: 2.0, pitch_y_mm: 2.0 },
    Array { rows: 16, cols: 32, pitch_x_mm: 1.0, pitch_y_mm: 3.0 },
    Array { rows: 40, cols: 12, pitch_x_mm: 2.0, pitch_y_mm: 0.5 },
    Array { rows: 64, cols: 64, pitch_x_mm: 0.5, pitch_y_mm: 0.5 },
    Array { rows: 3, cols: 20, pitch_x_mm: 1.5, pitch_y_mm: 6.0 },
];

/// Counts of the whole load, and the width (mm) by which a row's load spreads.
const LOAD_COUNTS: f64 = 15_000.0;
const SPREAD_MM: f64 = 1.2;

/// The image of a line through (`x_mm`, 0) that is turned by `theta_rad` from y towards -x, with
/// loads that grow along y by `lean` of the mean at the border.
fn line_image(array: &Array, x_mm: f64, theta_rad: f64, lean: f64) -> TactileImage {
    let (rows, cols) = (array.rows as usize, array.cols as usize);
    let mut image = TactileImage::new(array.rows as u16, array.cols as u16);
    image.valid.fill(1);
    image.baseline_ready = 1;
    let part = |from: f64, to: f64| {
        let left_of = |u: f64| 0.5 * libm::erfc(-u / (SPREAD_MM * core::f64::consts::SQRT_2));
        left_of(to) - left_of(from)
    };
    for row in 0..rows {
        let y_mm = (row as f64 + 1.0 - array.middle_row()) * array.pitch_y_mm;
        let half_mm = 0.5 * rows as f64 * array.pitch_y_mm;
        let load = LOAD_COUNTS / rows as f64 * (1.0 + lean * y_mm / half_mm);
        let at_mm = x_mm - y_mm * libm::tan(theta_rad);
        for col in 0..cols {
            let off = (col as f64 + 0.5 - array.middle_column()) * array.pitch_x_mm - at_mm;
            let share = part(off, off + array.pitch_x_mm);
            image.counts[row * cols + col] = (load * share) as f32;
        }
    }
    image
}

fn seen(array: &Array, image: &TactileImage) -> (TouchFeatures, Line) {
    let touch = touch_features(image, array, 1.0, 500.0);
    let profile = LoadProfile::new(array.band_half_columns(), |_| 0.2);
    let known = LineParameters { profile, noise_counts: 1.0, speed_cols_s: 0.0 };
    let line = line(image, array, &touch, &known).expect("a line");
    (touch, line)
}

#[test]
fn place_load_and_direction_of_a_line_are_seen_by_every_array() {
    for array in ARRAYS {
        for (x_mm, theta, lean) in [(0.0, 0.0, 0.0), (1.3, 0.1, 0.2), (-1.1, -0.15, -0.3)] {
            let (touch, line) = seen(&array, &line_image(&array, x_mm, theta, lean));
            assert!(touch.trusted && touch.contact);
            let [x_c, m0, m_x, theta_z] = line.features;
            let y_mm = (line.y_c - array.middle_row()) * array.pitch_y_mm;
            let due_mm = x_mm - y_mm * libm::tan(theta);
            let found_mm = (x_c - array.middle_column()) * array.pitch_x_mm;
            // A fit moves at most a tenth of a column by the tails that the band cuts off.
            let bar_mm = 0.1 * array.pitch_x_mm;
            assert!((found_mm - due_mm).abs() < bar_mm, "{array:?}: {found_mm} of {due_mm} mm");
            assert!((m0 / LOAD_COUNTS - 1.0).abs() < 0.01, "{array:?}: {m0}");
            assert!((theta_z - theta).abs() < 0.02, "{array:?}: {theta_z} of {theta}");
            let moments = touch.theta_z_rad.unwrap_or(0.0);
            assert!(array.rows < 12 || (moments - theta).abs() < 0.05, "{array:?}: {moments}");
            // Moment of a load that grows along y: a sixth of the length times the lean.
            let steps = f64::from(array.rows);
            let due = LOAD_COUNTS * lean * (steps * steps - 1.0) / (6.0 * steps);
            assert!((m_x - due).abs() < 0.01 * LOAD_COUNTS, "{array:?}: {m_x} of {due}");
        }
    }
}

#[test]
fn the_same_pad_in_other_rows_and_columns_answers_the_same_motions() {
    let config = Config::default();
    let even = |array: &Array| {
        let mut rows = [0.0; 64];
        rows[..array.rows as usize].fill(LOAD_COUNTS / f64::from(array.rows));
        Line {
            features: [array.middle_column(), LOAD_COUNTS, 0.0, 0.0],
            variance: [1e-3; 4],
            y_c: array.middle_row(),
            weighted: [LOAD_COUNTS, 0.0],
            weighted_variance: [1.0; 2],
            rows,
            saturated: 0,
            interpolated: 0,
        }
    };
    let jacobian = |array: Array| {
        let model = ContactModel::new(&config.model, &array, LOAD_COUNTS).unwrap();
        // In mm/mm, counts/mm and counts x mm/mrad.
        let j = model.jacobian(&even(&array));
        [array.pitch_x_mm * j[(0, 0)], j[(1, 1)], array.pitch_y_mm * j[(2, 2)]]
    };
    let whole = jacobian(Array::default());
    for (rows, cols) in [(32, 16), (8, 32), (64, 8), (16, 64)] {
        let (pitch_x_mm, pitch_y_mm) = (25.4 / f64::from(cols), 25.4 / f64::from(rows));
        let divided = jacobian(Array { rows, cols, pitch_x_mm, pitch_y_mm });
        for (one, other) in whole.iter().zip(divided) {
            // Springs in the middles of fewer rows lean a little less than the whole.
            assert!((other / one - 1.0).abs() < 0.02, "{rows} x {cols}: {divided:?} {whole:?}");
        }
    }
}

#[test]
fn an_image_of_another_size_is_not_trusted_and_has_no_line() {
    let array = Array::default();
    for (rows, cols) in [(1, 1), (1, 64), (12, 32), (32, 12), (64, 64), (8, 32), (0, 0)] {
        let mut image = TactileImage::new(rows, cols);
        image.counts.fill(1e4);
        image.valid.fill(1);
        image.baseline_ready = 1;
        let touch = touch_features(&image, &array, 0.0, 500.0);
        assert_eq!(touch, TouchFeatures::default(), "{rows} x {cols}");
        let forced = TouchFeatures {
            trusted: true,
            contact: true,
            x_c: Some(5.0),
            y_c: Some(5.0),
            ..TouchFeatures::default()
        };
        let known = LineParameters {
            profile: LoadProfile::EVEN_LOAD,
            noise_counts: 1.0,
            speed_cols_s: 0.0,
        };
        assert_eq!(line(&image, &array, &forced, &known), None, "{rows} x {cols}");
    }
}
