//! Features of a tactile image: moments, centroid and direction of the long axis (the thesis,
//! section 5.3.2). Tactels that are marked invalid or not finite are left out.
//!
//! Coordinates are tactel numbers: x is the column number 1..=cols, y the row number 1..=rows.
//! Values are counts above the baseline, positive under compression. As in the thesis, the
//! subscript of a moment is the axis *about* which it is taken: `m_x = sum y s`, `m_xx = sum y^2
//! s`.
//!
//! ```
//! use taktil_mechanics::tactile::{Image, features, moments};
//!
//! // Two rows of three tactels; the load is on columns 2 and 3 of row 1.
//! let counts = [0.0_f32, 10.0, 30.0, 0.0, 0.0, 0.0];
//! let image = Image::new(2, 3, &counts, None).unwrap();
//! let features = features(&moments(&image, 5.0));
//! assert_eq!((features.x_c, features.y_c), (Some(2.75), Some(1.0)));
//! assert_eq!(features.m0, 40.0);
//! ```

use core::f64::consts::FRAC_PI_2;
use core::fmt;

/// A tactile image that borrows its values, stored row by row. `T` is `f32` on the robot and `f64`
/// in calculations.
#[derive(Clone, Copy, Debug)]
pub struct Image<'a, T = f32> {
    rows: usize,
    cols: usize,
    values: &'a [T],
    valid: Option<&'a [u8]>,
}

/// The reason why values do not make an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageError {
    /// The image has no row or no column.
    Empty,
    /// The number of values is not rows times columns.
    ValueCount {
        /// Rows times columns.
        expected: usize,
        /// Number of values.
        actual: usize,
    },
    /// The number of validity marks is not rows times columns.
    ValidityCount {
        /// Rows times columns.
        expected: usize,
        /// Number of marks.
        actual: usize,
    },
}

impl fmt::Display for ImageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            ImageError::Empty => write!(f, "an image needs a row and a column"),
            ImageError::ValueCount { expected, actual } => {
                write!(f, "the image has {expected} tactels, there are {actual} values")
            }
            ImageError::ValidityCount { expected, actual } => {
                write!(f, "the image has {expected} tactels, there are {actual} validity marks")
            }
        }
    }
}

impl std::error::Error for ImageError {}

impl<'a, T: Copy + Into<f64>> Image<'a, T> {
    /// An image of `rows` by `cols` tactels. `valid` marks the tactels that count with another
    /// number than 0; without it all do.
    ///
    /// # Errors
    /// [`ImageError`] where there is no tactel or a length is not rows times columns.
    pub fn new(
        rows: usize,
        cols: usize,
        values: &'a [T],
        valid: Option<&'a [u8]>,
    ) -> Result<Image<'a, T>, ImageError> {
        let expected = rows.saturating_mul(cols);
        if expected == 0 {
            return Err(ImageError::Empty);
        }
        if values.len() != expected {
            return Err(ImageError::ValueCount { expected, actual: values.len() });
        }
        if let Some(marks) = valid.filter(|marks| marks.len() != expected) {
            return Err(ImageError::ValidityCount { expected, actual: marks.len() });
        }
        Ok(Image { rows, cols, values, valid })
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    #[must_use]
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// The value at a row and a column, counted from 0; none outside the image and where the
    /// tactel does not count.
    #[must_use]
    pub fn value(&self, row: usize, col: usize) -> Option<f64> {
        if row >= self.rows || col >= self.cols {
            return None;
        }
        let index = row * self.cols + col;
        let is_valid = self.valid.is_none_or(|marks| marks[index] != 0);
        let value: f64 = self.values[index].into();
        (is_valid && value.is_finite()).then_some(value)
    }
}

/// Moments of an image (counts times powers of tactel numbers).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    /// Sum of the values.
    pub m0: f64,
    /// Sum of y times the value.
    pub m_x: f64,
    /// Sum of x times the value.
    pub m_y: f64,
    /// Sum of y^2 times the value.
    pub m_xx: f64,
    /// Sum of x^2 times the value.
    pub m_yy: f64,
    /// Sum of x y times the value.
    pub m_xy: f64,
    /// Sum of (y - middle line) times the value; 0 where the load is even along y.
    pub m_x_centred: f64,
    /// Sum of the absolute values. Where `m0` is only a rounding error of it, values cancel.
    pub absolute_sum: f64,
}

/// The moments of an image over the valid tactels whose value is at least `threshold` (counts).
/// With `f64::NEG_INFINITY` every value counts, with a threshold of NaN none does.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "row and column numbers are small")]
pub fn moments<T: Copy + Into<f64>>(image: &Image<'_, T>, threshold: f64) -> Moments {
    let mut m = Moments::default();
    let middle = 0.5 * (image.rows as f64 + 1.0);
    for (r, row) in image.values.chunks_exact(image.cols).enumerate() {
        // The sums of x^0, x^1 and x^2 times the value along this row.
        let (mut s0, mut s1, mut s2) = (0.0, 0.0, 0.0);
        for (c, value) in row.iter().enumerate() {
            let value: f64 = (*value).into();
            let is_valid = image.valid.is_none_or(|marks| marks[r * image.cols + c] != 0);
            if is_valid && value.is_finite() && value >= threshold {
                let x = (c + 1) as f64;
                s0 += value;
                m.absolute_sum += value.abs();
                s1 += x * value;
                s2 += x * x * value;
            }
        }
        let y = (r + 1) as f64;
        m.m0 += s0;
        m.m_y += s1;
        m.m_yy += s2;
        m.m_x += y * s0;
        m.m_xx += y * y * s0;
        m.m_xy += y * s1;
        m.m_x_centred += (y - middle) * s0;
    }
    m
}

/// The features of an image from which the tactile servo works. No feature is NaN; one that the
/// image does not define is absent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Features {
    /// Column number of the centroid. Absent without contact: `m0` is not positive, or a rounding
    /// error of values that cancel.
    pub x_c: Option<f64>,
    /// Row number of the centroid; absent without contact.
    pub y_c: Option<f64>,
    /// Direction of the long axis in `(-pi/2, pi/2]` (rad): 0 along y, positive from y towards -x,
    /// so that an axis `(-sin a, cos a)` has the direction a. Absent without contact and for an
    /// image without a long axis.
    pub theta_z_rad: Option<f64>,
    /// Sum of the values (counts).
    pub m0: f64,
    /// Moment about the middle line along x (counts times tactels).
    pub m_x_centred: f64,
    /// Central second moment: sum of (y - y_c)^2 (counts times tactels^2).
    pub mu_xx: f64,
    /// Central second moment: sum of (x - x_c)^2 (counts times tactels^2).
    pub mu_yy: f64,
    /// Central second moment: sum of (x - x_c)(y - y_c) (counts times tactels^2).
    pub mu_xy: f64,
}

impl Features {
    /// Direction of the long axis (rad) on an array whose columns and rows are these distances
    /// apart; [`Features::theta_z_rad`] where both are the same.
    #[must_use]
    pub fn theta_z_rad_on(&self, pitch_x: f64, pitch_y: f64) -> Option<f64> {
        if pitch_x.to_bits() == pitch_y.to_bits() {
            return self.theta_z_rad;
        }
        let ratio = pitch_y / pitch_x;
        let (mu_xx, mu_yy, mu_xy) = (ratio * ratio * self.mu_xx, self.mu_yy, ratio * self.mu_xy);
        let (numerator, denominator) = (-2.0 * mu_xy, mu_xx - mu_yy);
        let size = mu_xx.abs() + mu_yy.abs();
        let is_long = numerator.abs().max(denominator.abs()) > ROUNDNESS_RATIO * size;
        let theta = 0.5 * libm::atan2(numerator, denominator);
        (is_long && theta.is_finite()).then(|| if theta <= -FRAC_PI_2 { FRAC_PI_2 } else { theta })
    }
}

/// Values count as cancelling where their sum is below this part of the sum of their absolute
/// values.
const CANCELLATION_RATIO: f64 = 1e-12;
/// An image counts as round where its second moments differ by less than this part of their sum.
const ROUNDNESS_RATIO: f64 = 1e-6;

/// The features that follow from moments: `x_c = m_y/m0`, `y_c = m_x/m0`, `theta_z = 1/2 atan2(-2
/// mu_xy, mu_xx - mu_yy)` (the thesis, section 5.3.2).
#[must_use]
pub fn features(m: &Moments) -> Features {
    let mut out = Features { m0: m.m0, m_x_centred: m.m_x_centred, ..Features::default() };
    let (x_c, y_c) = (m.m_y / m.m0, m.m_x / m.m0);
    if !(m.m0 > CANCELLATION_RATIO * m.absolute_sum && x_c.is_finite() && y_c.is_finite()) {
        return out;
    }
    out.x_c = Some(x_c);
    out.y_c = Some(y_c);
    let mu_xx = m.m_xx - y_c * m.m_x;
    let mu_yy = m.m_yy - x_c * m.m_y;
    let mu_xy = m.m_xy - x_c * m.m_x;
    if !(mu_xx.is_finite() && mu_yy.is_finite() && mu_xy.is_finite()) {
        return out;
    }
    (out.mu_xx, out.mu_yy, out.mu_xy) = (mu_xx, mu_yy, mu_xy);
    let (numerator, denominator) = (-2.0 * mu_xy, mu_xx - mu_yy);
    let size = mu_xx.abs() + mu_yy.abs();
    let rounding = 1e-12 * (m.m_xx.abs() + m.m_yy.abs());
    if numerator.abs().max(denominator.abs()) > (ROUNDNESS_RATIO * size).max(rounding) {
        let theta = 0.5 * libm::atan2(numerator, denominator);
        // The directions -pi/2 and pi/2 are the same axis, of which pi/2 is the value.
        out.theta_z_rad = Some(if theta <= -FRAC_PI_2 { FRAC_PI_2 } else { theta });
    }
    out
}
