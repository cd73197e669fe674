//! Finds the pin's line of contact in an image and computes its features, each with a variance,
//! from a band about the line. An image whose load does not lie along one line that crosses the
//! rows gives no features.
//!
//! The threshold finds the line; the sums then take every value in a band of columns about it, so
//! that the load's tails are not cut off and noise has mean zero: with the thesis's noise a
//! threshold of three standard deviations alone takes a tenth of the load away. A tactel that is
//! not trusted is replaced by the mean of its neighbours in the rows beside it. The line is that of
//! least squares through the rows' first moments about the band, each row weighted by its load and
//! by the noise of its tactels: no row is switched in or out, so a contact that only begins, or
//! touches with one row, gives the same features with larger variances. Rows that were scanned at
//! other times are moved to the time of the image. Places are in columns and rows; directions are
//! angles on the pad, whose rows may lie farther apart than its columns.

use taktil_signal::{TACTEL_SATURATED, TactileImage};

use super::TouchFeatures;
use crate::config::array::{Array, ROWS_MAX};

/// Steepest line: 45 degrees.
const SLOPE_MAX: f64 = 1.0;
/// Standard deviation of the slope before anything is seen.
const SLOPE_PRIOR: f64 = 0.35;
/// Variance of a row's centroid that noise does not explain: a hundredth of a column.
const ROW_VARIANCE_MIN: f64 = 1e-4;
/// Share of the thresholded load that has to lie in the band.
const LINE_SHARE_MIN: f64 = 0.5;
/// A row between two that carry load, and that reads less than this share of their mean, is dead.
const DEAD_ROW_SHARE_MAX: f64 = 0.4;
/// Two rows carry load when their mean is above this many standard deviations of a row.
const DEAD_SIGMAS: f64 = 5.0;
/// Number of least-squares fits; each one centres the band on the line of the previous one.
const FIT_ITERATIONS: u32 = 3;

/// The features (x_c, M0, M_x, theta_z) of a line of load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Centroid (columns), sum (counts), moment about the middle line (counts x rows), direction
    /// (rad).
    pub features: [f64; 4],
    /// Variance of each, from the noise of a tactel.
    pub variance: [f64; 4],
    /// Centroid along y (rows).
    pub y_c: f64,
    /// Sum and moment with each tactel weighted by its expected share of the load
    /// ([`LoadProfile`]). They have less noise, but are right up to a constant factor only.
    pub weighted: [f64; 2],
    /// Variance of each.
    pub weighted_variance: [f64; 2],
    /// Load of each row, smoothed with its neighbouring rows (counts, not negative); 0 beyond the
    /// array's rows.
    pub rows: [f64; ROWS_MAX],
    /// Tactels of the band at full scale: the true load is at least the stated one.
    pub saturated: u32,
    /// Tactels of the band that are replaced by the mean of their neighbours.
    pub interpolated: u32,
}

impl Line {
    /// The line with all loads multiplied by `by`.
    #[must_use]
    pub fn scaled(&self, by: f64) -> Line {
        let mut line = *self;
        for i in [1, 2] {
            line.features[i] *= by;
            line.variance[i] *= by * by;
            line.weighted[i - 1] *= by;
            line.weighted_variance[i - 1] *= by * by;
        }
        line.rows.iter_mut().for_each(|row| *row *= by);
        line
    }

    /// The features of the whole image with those of this line in their place.
    #[must_use]
    pub fn refined_features(&self, touch: &TouchFeatures) -> TouchFeatures {
        let [x_c, m0, m_x, theta_z] = self.features;
        TouchFeatures {
            m0,
            m_x,
            x_c: Some(x_c),
            y_c: Some(self.y_c),
            theta_z_rad: Some(theta_z),
            ..*touch
        }
    }
}

/// Places of a [`LoadProfile`]: from the line to the border of the band.
const TABLE_POINTS: usize = 41;

/// The profile of a row's load over the columns beside the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadProfile {
    /// Part of the load on a tactel whose middle lies so many places away.
    shares: [f64; TABLE_POINTS],
    /// Number of places in a column.
    per_column: f64,
}

impl LoadProfile {
    /// A profile whose `share` gives the part of the load on a tactel that many columns beside the
    /// line, on either side, in a band of half the width `half_columns`.
    #[must_use]
    pub fn new(half_columns: f64, share: impl Fn(f64) -> f64) -> LoadProfile {
        let per_column = (TABLE_POINTS - 1) as f64 / half_columns;
        let shares = core::array::from_fn(|place| share(place as f64 / per_column));
        LoadProfile { shares, per_column }
    }

    /// The profile of a load that spreads evenly over a band of five columns, which weights all
    /// tactels equally.
    pub const EVEN_LOAD: LoadProfile =
        LoadProfile { shares: [0.2; TABLE_POINTS], per_column: 16.0 };

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    fn share(&self, away: f64) -> f64 {
        let place = (self.per_column * away.abs()).min((TABLE_POINTS - 1) as f64);
        let below = (place as usize).min(TABLE_POINTS - 2);
        let rise = self.shares[below + 1] - self.shares[below];
        self.shares[below] + rise * (place - below as f64)
    }
}

/// The information that the fit needs besides the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineParameters {
    /// How a row's load spreads.
    pub profile: LoadProfile,
    /// Standard deviation of a tactel (counts).
    pub noise_counts: f64,
    /// Speed of the line over the columns (columns/s).
    pub speed_cols_s: f64,
}

/// One row of the band.
#[derive(Clone, Copy, Debug, Default)]
struct RowSums {
    sum: f64,
    /// First moment about the middle of the band (counts x columns).
    first: f64,
    /// Variances of both.
    variance: [f64; 2],
    /// Weighted load and its variance.
    weighted: [f64; 2],
    saturated: u32,
    /// Sum of the readings of the saturated tactels (counts).
    saturated_counts: f64,
    interpolated: u32,
}

/// The value of a tactel, or of its neighbours in the rows beside it; and whether it is its own.
fn tactel_counts(image: &TactileImage, row: usize, col: usize) -> Option<(f64, bool)> {
    let (rows, cols) = (usize::from(image.rows), usize::from(image.cols));
    let at = |row: usize| {
        let index = row * cols + col;
        let counts = image.counts[index];
        (image.valid[index] != 0 && counts.is_finite()).then_some(f64::from(counts))
    };
    if let Some(own) = at(row) {
        return Some((own, true));
    }
    let below = row.checked_sub(1).and_then(at);
    let above = if row + 1 < rows { at(row + 1) } else { None };
    match (below, above) {
        (Some(below), Some(above)) => Some((0.5 * (below + above), false)),
        (Some(one), None) | (None, Some(one)) => Some((one, false)),
        (None, None) => None,
    }
}

#[expect(clippy::cast_precision_loss, reason = "column numbers are small")]
fn band_sums(
    image: &TactileImage,
    row: usize,
    middle: f64,
    half_columns: f64,
    parameters: &LineParameters,
) -> RowSums {
    let mut out = RowSums::default();
    let noise = parameters.noise_counts * parameters.noise_counts;
    let (cols, last) = (usize::from(image.cols), f64::from(image.cols));
    let from = (middle - half_columns).ceil().clamp(1.0, last + 1.0);
    let to = (middle + half_columns).floor().clamp(0.0, last);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let (from, to) = (from as usize, to as usize);
    let [mut pull, mut weighted_variance, mut weight] = [0.0; 3];
    for col in from..=to {
        let Some((counts, own)) = tactel_counts(image, row, col - 1) else {
            out.interpolated += 1;
            continue;
        };
        out.interpolated += u32::from(!own);
        if own && image.valid[row * cols + col - 1] == TACTEL_SATURATED {
            out.saturated += 1;
            out.saturated_counts += counts;
        }
        let arm = col as f64 - middle;
        // A replaced value has the noise of the tactels from which it was interpolated.
        let share = if own { noise } else { 2.0 * noise };
        out.sum += counts;
        out.first += counts * arm;
        out.variance[0] += share;
        out.variance[1] += share * arm * arm;
        let due = parameters.profile.share(arm);
        pull += due * counts;
        weighted_variance += due * due * share;
        weight += due * due;
    }
    if weight > 0.0 {
        out.weighted = [pull / weight, weighted_variance / (weight * weight)];
    }
    out
}

/// Writes the rows with dead ones replaced by the mean of their two neighbours: a pin cannot leave
/// out a single row.
fn interpolate_dead_rows(rows: &[RowSums], band_columns: u32, out: &mut [RowSums]) {
    out.copy_from_slice(rows);
    for index in 1..rows.len().saturating_sub(1) {
        let (below, own, above) = (&rows[index - 1], &rows[index], &rows[index + 1]);
        let mean = 0.5 * (below.sum + above.sum);
        let noise = below.variance[0].max(above.variance[0]).sqrt();
        let both = below.sum.min(above.sum) > 0.5 * mean;
        if both && mean > DEAD_SIGMAS * noise && own.sum < DEAD_ROW_SHARE_MAX * mean {
            out[index] = RowSums {
                sum: mean,
                first: 0.5 * (below.first + above.first),
                variance: below.variance,
                weighted: [0.5 * (below.weighted[0] + above.weighted[0]), below.weighted[1]],
                saturated: 0,
                saturated_counts: 0.0,
                interpolated: band_columns,
            };
        }
    }
}

/// Load of a row, smoothed with its neighbouring rows; not negative.
fn smoothed_load(rows: &[RowSums], index: usize) -> f64 {
    let (mut sum, mut weight) = (2.0 * rows[index].sum, 2.0);
    if index > 0 {
        (sum, weight) = (sum + rows[index - 1].sum, weight + 1.0);
    }
    if let Some(next) = rows.get(index + 1) {
        (sum, weight) = (sum + next.sum, weight + 1.0);
    }
    (sum / weight).max(0.0)
}

/// Finds lines in the images of one array, with room for its rows.
#[derive(Clone, Debug)]
pub struct LineFinder {
    array: Array,
    /// The rows as they were read, and with dead ones replaced.
    read: Box<[RowSums]>,
    rows: Box<[RowSums]>,
}

impl LineFinder {
    /// Allocates.
    #[must_use]
    pub fn new(array: &Array) -> LineFinder {
        let rows = || vec![RowSums::default(); array.row_count()].into();
        LineFinder { array: *array, read: rows(), rows: rows() }
    }

    /// The line of load, found from a thresholded image. Absent without contact, in an image of
    /// another size than the array's, and when most of the load does not lie along one line.
    #[must_use]
    pub fn line(
        &mut self,
        image: &TactileImage,
        touch: &TouchFeatures,
        parameters: &LineParameters,
    ) -> Option<Line> {
        if !touch.contact || !self.array.fits(image) {
            return None;
        }
        let (x_c, y_c) = (touch.x_c?, touch.y_c?);
        let start = touch.theta_z_rad.map_or(0.0, |theta| -libm::tan(theta));
        let slope = if start.abs() < SLOPE_MAX { start } else { 0.0 };
        let slope = slope * self.array.rows_per_column();
        let mut fit = LineFit { x: x_c, y: y_c, slope, variance: [0.0; 2] };
        for _ in 0..FIT_ITERATIONS {
            fit = self.refined_fit(image, &fit, parameters)?;
        }
        let line = self.line_of_rows(&fit);
        (line.features[1] >= LINE_SHARE_MIN * touch.m0).then_some(line)
    }
}

/// The line of load in one image of an array: see [`LineFinder::line`]. Allocates.
#[must_use]
pub fn line(
    image: &TactileImage,
    array: &Array,
    touch: &TouchFeatures,
    parameters: &LineParameters,
) -> Option<Line> {
    LineFinder::new(array).line(image, touch, parameters)
}

/// A straight line: x at row y, its slope in columns a row, and the variances of both.
#[derive(Clone, Copy)]
struct LineFit {
    x: f64,
    y: f64,
    slope: f64,
    variance: [f64; 2],
}

impl LineFinder {
    /// Centres the band on a line, reads the rows and fits a new line to the loads in them.
    #[expect(clippy::cast_precision_loss, reason = "row numbers are small")]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "few columns")]
    fn refined_fit(
        &mut self,
        image: &TactileImage,
        fit: &LineFit,
        parameters: &LineParameters,
    ) -> Option<LineFit> {
        let half = self.array.band_half_columns();
        let at = |y: f64| fit.x + fit.slope * (y - fit.y);
        for (index, row) in self.read.iter_mut().enumerate() {
            *row = band_sums(image, index, at((index + 1) as f64), half, parameters);
        }
        interpolate_dead_rows(&self.read, (2.0 * half) as u32, &mut self.rows);
        let rows = &self.rows;
        let rows_per_column = self.array.rows_per_column();
        let [mut w, mut wy, mut wyy, mut pull, mut turn] = [0.0; 5];
        for (index, row) in rows.iter().enumerate() {
            let load = smoothed_load(rows, index);
            let y = (index + 1) as f64;
            let late_s = 1e-9 * f64::from(image.row_offset_ns[index]);
            let first = row.first - load * parameters.speed_cols_s * late_s;
            let variance = row.variance[1] + ROW_VARIANCE_MIN * load * load;
            if variance <= 0.0 {
                continue;
            }
            let weight = load * load / variance;
            w += weight;
            wy += weight * y;
            wyy += weight * y * y;
            pull += load * first / variance;
            turn += load * first / variance * y;
        }
        if !(w > 0.0 && w.is_finite()) {
            return None;
        }
        let deviation = SLOPE_PRIOR * rows_per_column;
        let (y, prior) = (wy / w, 1.0 / (deviation * deviation));
        let spread = (wyy - wy * y).max(0.0) + prior;
        let slope = fit.slope + (turn - y * pull - prior * fit.slope) / spread;
        let x = at(y) + (pull / w).clamp(-half, half);
        let variance = [1.0 / w, 1.0 / spread];
        let steepest = SLOPE_MAX * rows_per_column;
        let next = LineFit { x, y, slope: slope.clamp(-steepest, steepest), variance };
        let sound = x.is_finite() && y.is_finite() && slope.is_finite();
        sound.then_some(next)
    }

    #[expect(clippy::cast_precision_loss, reason = "row numbers are small")]
    fn line_of_rows(&self, fit: &LineFit) -> Line {
        let (rows, array) = (&self.rows, &self.array);
        let middle = array.middle_row();
        let mut loads = [0.0; ROWS_MAX];
        for (index, load) in loads.iter_mut().enumerate().take(rows.len()) {
            *load = smoothed_load(rows, index);
        }
        let mut line = Line {
            features: [0.0; 4],
            variance: [0.0; 4],
            weighted: [0.0; 2],
            weighted_variance: [0.0; 2],
            y_c: middle,
            rows: loads,
            saturated: 0,
            interpolated: 0,
        };
        let [mut m0, mut m_x] = [0.0, 0.0];
        for (index, row) in rows.iter().enumerate() {
            let arm = (index + 1) as f64 - middle;
            line.saturated += row.saturated;
            line.interpolated += row.interpolated;
            m0 += row.sum;
            m_x += arm * row.sum;
            line.variance[1] += row.variance[0];
            line.variance[2] += arm * arm * row.variance[0];
            let [load, variance] = row.weighted;
            line.weighted = [line.weighted[0] + load, line.weighted[1] + arm * load];
            line.weighted_variance[0] += variance;
            line.weighted_variance[1] += arm * arm * variance;
        }
        line.y_c =
            if m0 > 0.0 { (middle + m_x / m0).clamp(1.0, f64::from(array.rows)) } else { middle };
        let off = line.y_c - fit.y;
        let x_c = fit.x + fit.slope * off;
        // Columns a row become a tangent by the pitches.
        let per_tangent = 1.0 / array.rows_per_column();
        let theta_z_rad = -libm::atan(fit.slope * per_tangent);
        line.features = [x_c.clamp(1.0, f64::from(array.cols)), m0, m_x, theta_z_rad];
        // A tactel at full scale may carry more load than it shows, which increases the variance of
        // the sums.
        let hidden = 0.25 * rows.iter().map(|row| row.saturated_counts).sum::<f64>();
        // The hidden load lies anywhere within a quarter of the array's length of the middle.
        let arm_square = f64::from(array.rows) * f64::from(array.rows) / 16.0;
        line.variance[0] = fit.variance[0] + off * off * fit.variance[1] + 1e-4;
        line.variance[1] += hidden * hidden;
        line.variance[2] += arm_square * hidden * hidden;
        line.weighted_variance[0] += hidden * hidden;
        line.weighted_variance[1] += arm_square * hidden * hidden;
        line.variance[3] = fit.variance[1] * (per_tangent * per_tangent) + 1e-6;
        line
    }
}

#[cfg(test)]
mod tests;
