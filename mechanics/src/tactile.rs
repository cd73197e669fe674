//! Features of a tactile image: moments, centroid, direction of the long axis (the thesis, section
//! 5.3.2). Refuses images of the wrong length; tactels marked invalid or not finite are left out.
//!
//! Coordinates are tactel numbers: x = column number 1..=cols, y = row number 1..=rows. Values are
//! counts after the baseline, positive under compression. In the thesis's names the subscript is
//! the axis *about* which the moment is taken: `m_x = sum y s`, `m_xx = sum y^2 s`.

use core::f64::consts::FRAC_PI_2;
use core::fmt;

/// A tactile image that borrows its numbers, row by row. `T` is `f32` on the machine, `f64` for
/// calculations.
#[derive(Clone, Copy, Debug)]
pub struct Image<'a, T = f32> {
    rows: usize,
    cols: usize,
    values: &'a [T],
    valid: Option<&'a [bool]>,
}

/// Why an image was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageError {
    /// No row or no column.
    Empty,
    /// The number of values is not rows times columns.
    ValueCount {
        /// Values wanted.
        expected: usize,
        /// Values given.
        actual: usize,
    },
    /// The number of validity marks is not rows times columns.
    ValidityCount {
        /// Marks wanted.
        expected: usize,
        /// Marks given.
        actual: usize,
    },
}

impl fmt::Display for ImageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            ImageError::Empty => write!(f, "an image needs a row and a column"),
            ImageError::ValueCount { expected: wanted, actual: given } => {
                write!(f, "the image has {wanted} tactels, there are {given} values")
            }
            ImageError::ValidityCount { expected: wanted, actual: given } => {
                write!(f, "the image has {wanted} tactels, there are {given} validity marks")
            }
        }
    }
}

impl std::error::Error for ImageError {}

impl<'a, T: Copy + Into<f64>> Image<'a, T> {
    /// An image of `rows` by `cols` tactels; `valid` absent means that all are.
    ///
    /// # Errors
    /// When it has no tactel or a length does not fit.
    pub fn new(
        rows: usize,
        cols: usize,
        values: &'a [T],
        valid: Option<&'a [bool]>,
    ) -> Result<Image<'a, T>, ImageError> {
        let wanted = rows.saturating_mul(cols);
        if wanted == 0 {
            return Err(ImageError::Empty);
        }
        if values.len() != wanted {
            return Err(ImageError::ValueCount { expected: wanted, actual: values.len() });
        }
        if let Some(marks) = valid.filter(|marks| marks.len() != wanted) {
            return Err(ImageError::ValidityCount { expected: wanted, actual: marks.len() });
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
}

/// Moments of an image (counts times tactel numbers).
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
    /// Sum of (y - middle line) times the value; 0 means an even load along y.
    pub m_x_centred: f64,
    /// Sum of the values' sizes: where `m0` is but rounding of it, values cancel.
    pub absolute_sum: f64,
}

/// Sums of an image over the valid tactels whose value is at least `threshold` (counts); the
/// others count 0. `f64::NEG_INFINITY` lets every value in, a threshold of NaN none.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "row and column numbers are small")]
pub fn moments<T: Copy + Into<f64>>(image: &Image<'_, T>, threshold: f64) -> Moments {
    let mut m = Moments::default();
    let middle = 0.5 * (image.rows as f64 + 1.0);
    for (r, row) in image.values.chunks_exact(image.cols).enumerate() {
        // Sums along the row first: x^0, x^1, x^2.
        let (mut s0, mut s1, mut s2) = (0.0, 0.0, 0.0);
        for (c, value) in row.iter().enumerate() {
            let value: f64 = (*value).into();
            let trusted = image.valid.is_none_or(|marks| marks[r * image.cols + c]);
            if trusted && value.is_finite() && value >= threshold {
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

/// What the servo reads from an image. Nothing here is NaN; what an image does not define is
/// absent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Features {
    /// Column number of the centroid; absent without contact (`m0 <= 0`, or but rounding of values
    /// that cancel).
    pub x_c: Option<f64>,
    /// Row number of the centroid; absent without contact.
    pub y_c: Option<f64>,
    /// Direction of the long axis in `(-pi/2, pi/2]` (rad): 0 along y, positive from y towards -x,
    /// so that an axis `(-sin a, cos a)` gives a. Absent without contact and for a round image.
    pub theta_z_rad: Option<f64>,
    /// Sum of the values (counts).
    pub m0: f64,
    /// Moment about the middle line along x (counts times tactels).
    pub m_x_centred: f64,
    /// Central second moment: sum of (y - y_c)^2 (counts times tactels^2).
    pub mu_xx: f64,
    /// Central second moment: sum of (x - x_c)^2.
    pub mu_yy: f64,
    /// Central second moment: sum of (x - x_c)(y - y_c).
    pub mu_xy: f64,
}

/// Values cancel when their sum is less than this part of the sum of their sizes.
const CANCELLATION_RATIO: f64 = 1e-12;
/// An image counts as round when its second moments differ by less than this part of their size.
const ROUNDNESS_RATIO: f64 = 1e-6;

/// Features of the moments: `x_c = m_y/m0`, `y_c = m_x/m0`, `theta_z = 1/2 atan2(-2 mu_xy, mu_xx -
/// mu_yy)`.
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
    let (across, along) = (-2.0 * mu_xy, mu_xx - mu_yy);
    let size = mu_xx.abs() + mu_yy.abs();
    let rounding = 1e-12 * (m.m_xx.abs() + m.m_yy.abs());
    if across.abs().max(along.abs()) > (ROUNDNESS_RATIO * size).max(rounding) {
        let theta = 0.5 * libm::atan2(across, along);
        // One value for each axis: -pi/2 is the axis of pi/2.
        out.theta_z_rad = Some(if theta <= -FRAC_PI_2 { FRAC_PI_2 } else { theta });
    }
    out
}
