//! Detection of sliding between a tactile pad and a body, from images of normal pressure and the
//! motion of the hand: [`place`] measures where the load lies with the accuracy that the noise of
//! one image allows, [`detector`] tests the sequence of places for a ramp that begins at an unknown
//! instant, [`matched`] does so by the load's own shape while it stands still, and [`bound`] says
//! how soon any test on these images could have noticed.
//!
//! A load that sticks to the pad stays where it is; one that is rolled between the pad and a table
//! moves by half of the hand's motion (K. L. Johnson, *Contact Mechanics*, 1985, section 8.1). What
//! is left of the motion of the image after that is taken away is sliding. Sliding along a
//! direction in which the image does not change, such as the axis of a long pin, leaves no trace
//! in it.
//!
//! ```
//! use glam::DVec2;
//! use taktil_mechanics::slip::detector::{SlipDetector, SlipParameters, SlipSample};
//!
//! let mut detector = SlipDetector::new(&SlipParameters::default());
//! let mut found_at = None;
//! for frame in 0..60 {
//!     // 20 mm/s along x from frame 40 on, known to 0.05 mm each frame.
//!     let x = 20.0 * 0.005 * f64::from((frame - 40).max(0));
//!     let sample = SlipSample {
//!         t_s: 0.005 * f64::from(frame),
//!         place_mm: DVec2::new(x, 0.0),
//!         covariance_mm2: [0.0025, 0.0, 0.0025],
//!         direction: None,
//!     };
//!     if detector.update(&sample).is_detected && found_at.is_none() {
//!         found_at = Some(frame);
//!     }
//! }
//! assert_eq!(found_at, Some(43));
//! ```

pub mod bound;
pub mod detector;
pub mod matched;
pub mod place;

/// Probability that a standard normal variable is larger than `z`.
#[must_use]
pub fn normal_tail(z: f64) -> f64 {
    0.5 * libm::erfc(z * core::f64::consts::FRAC_1_SQRT_2)
}

/// Bisections with which [`normal_quantile`] works: each halves the interval of 80.
const BISECTION_COUNT: usize = 80;
/// Largest magnitude of a quantile that is returned.
const QUANTILE_MAX: f64 = 40.0;

/// The `z` that a standard normal variable exceeds with the probability `tail`, within 1e-12 for
/// tails that a double can hold; bisection of [`normal_tail`].
#[must_use]
pub fn normal_quantile(tail: f64) -> f64 {
    let (mut low, mut high) = (-QUANTILE_MAX, QUANTILE_MAX);
    for _ in 0..BISECTION_COUNT {
        let middle = 0.5 * (low + high);
        if normal_tail(middle) > tail {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_tables() {
        // Abramowitz and Stegun, table 26.5, and the median.
        for (tail, z) in [(0.5, 0.0), (0.05, 1.644_853_626_951), (1e-6, 4.753_424_308_823)] {
            assert!((normal_quantile(tail) - z).abs() < 1e-9, "{tail}");
            assert!((normal_quantile(1.0 - tail) + z).abs() < 1e-6, "{tail}");
        }
    }
}
