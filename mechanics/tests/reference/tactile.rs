//! Compares tactile features with contact images that another program computed, and tests them on
//! images made by hand.

use crate::table::rows;
use core::f64::consts::{FRAC_PI_2, PI};
use taktil_mechanics::tactile::{Features, Image, ImageError, features, moments};

const PITCH_MM: f64 = 1.5875;

/// A file's image (row = y, column = x), compression positive, and its features.
fn reference_image(row: &crate::table::Row) -> Vec<f64> {
    (0..256).map(|n| -row.num(&format!("s_{}_{}", n % 16, n / 16))).collect()
}

fn of(values: &[f64], threshold: f64) -> Features {
    features(&moments(&Image::new(16, 16, values, None).unwrap(), threshold))
}

#[test]
fn features_match_the_reference_images() {
    let all = rows("contact/tactile3d_features.csv");
    let images = rows("contact/tactile3d_images.csv");
    assert_eq!(images.len(), 26);
    let mut angles = 0;
    for image in &images {
        let want = all
            .iter()
            .find(|r| r.word("case") == image.word("case") && r.word("sampling") == "average")
            .unwrap();
        let values = reference_image(image);
        // All values, then the compressive ones alone.
        for (threshold, tail) in [(f64::NEG_INFINITY, ""), (0.0, "_c")] {
            let got = of(&values, threshold);
            let name = want.word("case");
            let area = PITCH_MM * PITCH_MM;
            let column = |c: &str| want.num(&format!("{c}{tail}"));
            // The images are printed with nine digits; the lever is half the sensor.
            let (force, lever) = (column("M0").abs(), 12.7);
            let near = |a: f64, b: f64, size: f64| {
                assert!((a - b).abs() < 3e-9 * size, "{name}{tail}: {a} for {b}");
            };
            near(got.m0 * area, -column("M0"), force);
            near(got.m_x_centred * area * PITCH_MM, -column("Mx"), force * lever);
            near((got.x_c.unwrap() - 8.5) * PITCH_MM, column("xc"), lever);
            near((got.y_c.unwrap() - 8.5) * PITCH_MM, column("yc"), lever);
            let second = area * PITCH_MM * PITCH_MM;
            near(got.mu_yy * second, -column("mu_xx"), force * lever * lever);
            near(got.mu_xx * second, -column("mu_yy"), force * lever * lever);
            near(got.mu_xy * second, -column("mu_xy"), force * lever * lever);
            let Some(theta) = got.theta_z_rad else {
                assert!(name.starts_with("sphere") && name.ends_with("x0_y0"), "{name}");
                continue;
            };
            // The file's angle is that of the long axis from x, ours from y.
            let off = theta + FRAC_PI_2 - column("theta_long_rad");
            let off = off - PI * (off / PI).round();
            // The roundest image loses most digits.
            assert!(off.abs() < 2e-7, "{name}: {off:e}");
            angles += 1;
        }
    }
    assert_eq!(angles, 2 * (26 - 3));
}

#[test]
fn a_pin_turned_by_alpha_reads_alpha() {
    for degrees in [-80.0_f64, -45.0, -10.0, 0.0, 5.0, 22.0, 45.0, 80.0, 90.0] {
        let alpha = degrees.to_radians();
        let (s, c) = libm::sincos(alpha);
        let values: Vec<f32> = (0..256_u16)
            .map(|n| {
                let (x, y) = (f64::from(n % 16) - 7.5, f64::from(n / 16) - 7.5);
                // Distances across and along the axis (-sin, cos).
                let (across, along) = (x * c + y * s, -x * s + y * c);
                let load = libm::exp(-across * across - 0.05 * along * along);
                #[expect(clippy::cast_possible_truncation, reason = "an image of the machine")]
                let count = (1000.0 * load) as f32;
                count
            })
            .collect();
        let got = features(&moments(&Image::new(16, 16, &values, None).unwrap(), 0.0));
        let off = got.theta_z_rad.unwrap() - alpha;
        let off = off - PI * (off / PI).round();
        assert!(off.abs() < 2e-3, "{degrees} deg: {off}");
        assert!((got.x_c.unwrap() - 8.5).abs() < 1e-6 && got.m_x_centred.abs() < 1e-3);
    }
}

#[test]
fn a_file_of_counts_has_the_sums_it_should() {
    // Rows and columns apart: value 1 at row 1, column 3; value 2 at row 2, column 1.
    let values = [0.0_f32, 0.0, 1.0, 2.0, 0.0, 0.0];
    let m = moments(&Image::new(2, 3, &values, None).unwrap(), 0.0);
    assert_eq!((m.m0, m.m_x, m.m_y), (3.0, 5.0, 5.0));
    assert_eq!((m.m_xx, m.m_yy, m.m_xy), (9.0, 11.0, 7.0));
    assert_eq!(m.m_x_centred, 0.5);
    let f = features(&m);
    assert_eq!((f.x_c, f.y_c), (Some(5.0 / 3.0), Some(5.0 / 3.0)));
}

#[test]
fn thresholds_and_marks_leave_tactels_out() {
    let values = [1.0_f32, 5.0, f32::NAN, 7.0];
    let marks = [1, 2, 1, 0];
    let image = Image::new(2, 2, &values, Some(&marks)).unwrap();
    assert_eq!(moments(&image, 0.0).m0, 6.0);
    assert_eq!(moments(&image, 1.0).m0, 6.0);
    assert_eq!(moments(&image, 1.5).m0, 5.0);
    assert_eq!(moments(&image, f64::NAN).m0, 0.0);
    let image = Image::new(2, 2, &values, None).unwrap();
    assert_eq!(moments(&image, f64::NEG_INFINITY).m0, 13.0);
    assert_eq!(moments(&Image::new(1, 2, &[-3.0_f32, 2.0], None).unwrap(), 0.0).m0, 2.0);
}

#[test]
fn images_without_an_answer_say_so() {
    let nothing = of(&[0.0; 256], 0.0);
    assert_eq!((nothing.x_c, nothing.y_c, nothing.theta_z_rad), (None, None, None));
    assert_eq!(nothing.m0, 0.0);
    let pulled = of(&[-1.0; 256], f64::NEG_INFINITY);
    assert_eq!((pulled.x_c, pulled.theta_z_rad, pulled.m0), (None, None, -256.0));
    let flat = of(&[7.0; 256], 0.0);
    assert_eq!((flat.x_c, flat.y_c, flat.theta_z_rad), (Some(8.5), Some(8.5), None));
    let mut spot = [0.0; 256];
    spot[16 * 3 + 12] = 4095.0;
    let spot = of(&spot, 0.0);
    assert_eq!((spot.x_c, spot.y_c, spot.theta_z_rad), (Some(13.0), Some(4.0), None));
    let saturated = of(&[1e308; 256], 0.0);
    assert_eq!((saturated.x_c, saturated.theta_z_rad), (None, None));
    let unheard = of(&[f64::NAN; 256], 0.0);
    assert_eq!((unheard.m0, unheard.x_c), (0.0, None));
    // A row has one direction, pi/2, not -pi/2 as well.
    let row = moments(&Image::new(1, 3, &[1.0, 2.0, 1.0], None).unwrap(), 0.0);
    assert_eq!(features(&row).theta_z_rad, Some(FRAC_PI_2));
    // Values that cancel leave rounding, which has no centroid whatever its sign.
    for four in [[0.1, 0.2, -0.3, 1e-17], [0.3, -0.1, -0.2, 0.0], [1e308, -1e308, 1e308, -1e308]] {
        let all = moments(&Image::new(1, 4, &four, None).unwrap(), f64::NEG_INFINITY);
        assert!(all.m0.abs() < 1e-15, "{all:?}");
        let found = features(&all);
        assert_eq!((found.x_c, found.y_c, found.theta_z_rad), (None, None, None), "{four:?}");
    }
}

#[test]
fn wrong_lengths_are_refused() {
    let values = [0.0_f32; 255];
    let wanted = ImageError::ValueCount { expected: 256, actual: 255 };
    assert_eq!(Image::new(16, 16, &values, None).unwrap_err(), wanted);
    assert_eq!(Image::new(0, 16, &values[..0], None).unwrap_err(), ImageError::Empty);
    let marks = [1; 3];
    let wanted = ImageError::ValidityCount { expected: 255, actual: 3 };
    assert_eq!(Image::new(15, 17, &values, Some(&marks)).unwrap_err(), wanted);
    assert!(Image::new(usize::MAX, 3, &values, None).is_err());
}
