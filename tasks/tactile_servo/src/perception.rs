//! Features of an image: those of the thesis from its moments, and whether there is contact. An
//! image whose baseline is unknown is not trusted, and a feature that an image does not define is
//! absent; no feature is ever NaN.
//!
//! [`line`](mod@line) takes the same features from a band about the pin's line, without the
//! threshold's bias and with their covariance.

pub mod line;

use taktil_mechanics::tactile::{Image, features, moments};
use taktil_rtcore::{Fold, StateHash};
use taktil_signal::TactileImage;

use crate::config::array::Array;

/// Sum of the counts of the largest array that a message holds, at full scale.
pub const M0_MAX_COUNTS: f64 = 4.2e6;

/// The features of an image. Every number is finite, whatever the image contains.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TouchFeatures {
    /// The baseline is known and at least half of the tactels are valid.
    pub trusted: bool,
    /// Whether the load is large enough for contact, without which the other features are not
    /// defined.
    pub contact: bool,
    /// Sum of the counts.
    pub m0: f64,
    /// First moment about the middle line (counts x rows).
    pub m_x: f64,
    /// Centroid (column number), inside the array; absent without contact.
    pub x_c: Option<f64>,
    /// Centroid (row number), inside the array; absent without contact.
    pub y_c: Option<f64>,
    /// Direction of the long axis (rad); absent without contact and for a round image.
    pub theta_z_rad: Option<f64>,
}

impl Fold for TouchFeatures {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.trusted).add(&self.contact).add(&self.m0).add(&self.m_x);
        hash.add(&self.x_c).add(&self.y_c).add(&self.theta_z_rad);
    }
}

/// Mean and standard deviation (counts) of the sum of `tactels` tactels that carry only normal
/// noise of standard deviation `noise_counts`, when values below `threshold_counts` count as 0 (0:
/// no threshold). Moments of a truncated normal variable (Johnson, Kotz, Balakrishnan, Continuous
/// Univariate Distributions 1, section 10.1).
#[must_use]
pub fn noise_sum(tactels: f64, noise_counts: f64, threshold_counts: f64) -> (f64, f64) {
    if !(noise_counts > 0.0 && noise_counts.is_finite()) {
        return (0.0, 0.0);
    }
    let (mean, square) = if threshold_counts > 0.0 {
        let t = threshold_counts / noise_counts;
        let density = libm::exp(-0.5 * t * t) / (2.0 * core::f64::consts::PI).sqrt();
        (density, t * density + 0.5 * libm::erfc(t * core::f64::consts::FRAC_1_SQRT_2))
    } else {
        (0.0, 1.0)
    };
    let variance = (square - mean * mean).max(0.0);
    (tactels * noise_counts * mean, noise_counts * (tactels * variance).sqrt())
}

/// Features of an image of this array: tactels below `threshold_counts` count 0 (0: no threshold),
/// and there is contact when their sum is above `contact_counts`. An image of another size is not
/// trusted.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "row and column numbers are small")]
pub fn touch_features(
    image: &TactileImage,
    array: &Array,
    threshold_counts: f64,
    contact_counts: f64,
) -> TouchFeatures {
    let (rows, cols) = (usize::from(image.rows), usize::from(image.cols));
    let tactels = rows * cols;
    if tactels == 0 || image.baseline_ready != 1 || !array.fits(image) {
        return TouchFeatures::default();
    }
    let Ok(view) = Image::new(rows, cols, &image.counts, Some(&image.valid)) else {
        return TouchFeatures::default();
    };
    let marks = image.valid.iter().zip(&image.counts);
    let valid = marks.filter(|(valid, counts)| **valid != 0 && counts.is_finite()).count();
    let threshold = if threshold_counts > 0.0 { threshold_counts } else { f64::NEG_INFINITY };
    let found = features(&moments(&view, threshold));
    let contact = found.m0 > contact_counts;
    let inside = |centre: Option<f64>, size: usize| {
        centre.filter(|c| contact && (1.0..=size as f64).contains(c))
    };
    TouchFeatures {
        trusted: 2 * valid >= tactels,
        contact,
        m0: found.m0,
        m_x: found.m_x_centred,
        x_c: inside(found.x_c, cols),
        y_c: inside(found.y_c, rows),
        // A single row shows how wide the load is, and nothing of its direction.
        theta_z_rad: found
            .theta_z_rad_on(array.pitch_x_mm, array.pitch_y_mm)
            .filter(|_| contact && rows > 1),
    }
}
