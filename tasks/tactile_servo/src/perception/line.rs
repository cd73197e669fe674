//! The pin's line in an image: features from a band about it, each with its variance. Refuses
//! images whose long axis lies across the rows, and rows that noise could have made.
//!
//! The threshold finds the line; the sums then take every value within `BAND` columns of it, so
//! that the load's tails are not cut off and noise has mean zero: with the thesis's noise a
//! threshold of three standard deviations alone takes a tenth of the load away. A tactel that
//! cannot be believed stands for the mean of its neighbours in the rows beside it. The line is that
//! of least squares through the rows' centroids, each weighted by its variance (propagated from
//! that of a tactel); rows that were scanned at other times are moved to the time of the image.

use taktil_signal::TactileImage;

use super::Touch;

/// Columns on either side of the line that count.
const BAND: f64 = 2.5;
/// Rows and columns of the array that this is made for.
pub const SIDE: usize = 16;
/// A row carries load when its sum is above this many standard deviations.
const ROW_SIGMAS: f64 = 4.0;
/// Steepest line, columns a row: 45 degrees.
const STEEPEST: f64 = 1.0;
/// Times that the band is laid about the line.
const ROUNDS: u32 = 2;

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
    /// Load of each row (counts).
    pub rows: [f64; SIDE],
    /// Tactels of the band that stand at full scale: the load is at least what is said.
    pub saturated: u32,
    /// Tactels of the band that neighbours stand for.
    pub filled: u32,
}

impl Line {
    /// A contact too short for a line: the sums that are known, in the row where the load is, and a
    /// direction that may be any.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped first")]
    pub fn short(touch: &Touch, known: &Known) -> Option<Line> {
        let (x_c, y_c) = (touch.x_c?, touch.y_c?);
        let noise = known.noise_counts * known.noise_counts;
        let mut rows = [0.0; SIDE];
        rows[(y_c.round().clamp(1.0, SIDE as f64) as usize) - 1] = touch.m0;
        Some(Line {
            features: [x_c, touch.m0, touch.m_x, 0.0],
            variance: [0.25, 16.0 * noise, 16.0 * 64.0 * noise, 1.0],
            y_c,
            rows,
            saturated: 0,
            filled: 0,
        })
    }

    /// The same image's touch with the features of its line.
    #[must_use]
    pub fn touch(&self, touch: &Touch) -> Touch {
        let [x_c, m0, m_x, theta_z] = self.features;
        Touch { m0, m_x, x_c: Some(x_c), y_c: Some(self.y_c), theta_z_rad: Some(theta_z), ..*touch }
    }
}

/// What is known besides the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// Standard deviation of a tactel (counts).
    pub noise_counts: f64,
    /// Speed of the line over the columns (columns/s).
    pub speed_cols_s: f64,
    /// Counts above the rest level from which a tactel counts as saturated.
    pub saturated_counts: f64,
}

/// One row of the band.
#[derive(Clone, Copy, Default)]
struct Row {
    sum: f64,
    centre: f64,
    variance: f64,
    saturated: u32,
    filled: u32,
}

/// The value of a tactel, or of its neighbours in the rows beside it; and whether it is its own.
fn value(image: &TactileImage, row: usize, col: usize) -> Option<(f64, bool)> {
    let at = |row: usize| {
        let index = row * SIDE + col;
        let counts = image.counts[index];
        (image.valid[index] != 0 && counts.is_finite()).then_some(f64::from(counts))
    };
    if let Some(own) = at(row) {
        return Some((own, true));
    }
    let below = row.checked_sub(1).and_then(at);
    let above = if row + 1 < SIDE { at(row + 1) } else { None };
    match (below, above) {
        (Some(below), Some(above)) => Some((0.5 * (below + above), false)),
        (Some(one), None) | (None, Some(one)) => Some((one, false)),
        (None, None) => None,
    }
}

#[expect(clippy::cast_precision_loss, reason = "column numbers are small")]
fn row(image: &TactileImage, row: usize, middle: f64, known: &Known) -> Row {
    let mut out = Row::default();
    let (mut first, mut number) = (0.0, 0.0);
    let from = (middle - BAND).ceil().clamp(1.0, 17.0);
    let to = (middle + BAND).floor().clamp(0.0, 16.0);
    let mut values = [0.0; 8];
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let (from, to) = (from as usize, to as usize);
    for (slot, col) in (from..=to).take(values.len()).enumerate() {
        let Some((counts, own)) = value(image, row, col - 1) else {
            out.filled += 1;
            continue;
        };
        out.filled += u32::from(!own);
        out.saturated += u32::from(counts >= known.saturated_counts);
        values[slot] = counts;
        out.sum += counts;
        first += counts * (col as f64 - middle);
        number += if own { 1.0 } else { 2.0 };
    }
    let noise = known.noise_counts * known.noise_counts;
    out.variance = number * noise;
    out.centre = middle;
    if out.sum > ROW_SIGMAS * out.variance.sqrt() && out.sum > 0.0 {
        out.centre = middle + first / out.sum;
    } else {
        out.sum = out.sum.max(0.0);
    }
    out
}

/// The line that a thresholded image points to; absent without contact, when the array is not 16 by
/// 16, and when fewer than two rows carry load.
#[must_use]
pub fn line(image: &TactileImage, touch: &Touch, known: &Known) -> Option<Line> {
    if !touch.contact || usize::from(image.rows) != SIDE || usize::from(image.cols) != SIDE {
        return None;
    }
    let (x_c, y_c) = (touch.x_c?, touch.y_c?);
    let start = touch.theta_z_rad.map_or(0.0, |theta| -libm::tan(theta));
    let mut fit = Fit { x: x_c, y: y_c, slope: if start.abs() < STEEPEST { start } else { 0.0 } };
    let mut found = None;
    for _ in 0..ROUNDS {
        let (rows, next) = pass(image, &fit, known)?;
        fit = next.0;
        found = Some((rows, next.1));
    }
    found.map(|(rows, variance)| summed(&rows, &fit, variance, known))
}

/// A straight line: x at row y, and its slope in columns a row.
#[derive(Clone, Copy)]
struct Fit {
    x: f64,
    y: f64,
    slope: f64,
}

/// Lays the band about a line and fits the next one; with the variance of its slope.
#[expect(clippy::cast_precision_loss, reason = "row numbers are small")]
fn pass(image: &TactileImage, fit: &Fit, known: &Known) -> Option<([Row; SIDE], (Fit, f64))> {
    let mut rows = [Row::default(); SIDE];
    let (mut w, mut wy, mut wx, mut wyy, mut wxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let noise = known.noise_counts * known.noise_counts;
    for (index, slot) in rows.iter_mut().enumerate() {
        let y = (index + 1) as f64;
        let middle = fit.x + fit.slope * (y - fit.y);
        *slot = row(image, index, middle, known);
        if slot.sum <= ROW_SIGMAS * slot.variance.sqrt() || slot.sum <= 0.0 {
            continue;
        }
        let late_s = 1e-9 * f64::from(image.row_offset_ns[index]);
        slot.centre -= known.speed_cols_s * late_s;
        // Tactels at the distances -2 to 2 share the noise of the centroid, and the band itself
        // makes a floor of a hundredth of a column.
        let weight = 1.0 / (10.0 * noise / (slot.sum * slot.sum) + 1e-4);
        w += weight;
        wy += weight * y;
        wx += weight * slot.centre;
        wyy += weight * y * y;
        wxy += weight * y * slot.centre;
    }
    let spread = wyy - wy * wy / w;
    if !(w > 0.0 && spread > 1e-6 * w) {
        return None;
    }
    let slope = ((wxy - wy * wx / w) / spread).clamp(-STEEPEST, STEEPEST);
    let next = Fit { x: wx / w, y: wy / w, slope };
    let sound = next.x.is_finite() && next.y.is_finite() && slope.is_finite();
    sound.then_some((rows, (next, 1.0 / spread)))
}

#[expect(clippy::cast_precision_loss, reason = "row numbers are small")]
fn summed(rows: &[Row; SIDE], fit: &Fit, slope_variance: f64, known: &Known) -> Line {
    let middle = 0.5 * (SIDE as f64 + 1.0);
    let mut line = Line {
        features: [0.0; 4],
        variance: [0.0; 4],
        y_c: middle,
        rows: [0.0; SIDE],
        saturated: 0,
        filled: 0,
    };
    let [mut m0, mut m_x] = [0.0, 0.0];
    for (index, row) in rows.iter().enumerate() {
        let arm = (index + 1) as f64 - middle;
        line.rows[index] = row.sum;
        line.saturated += row.saturated;
        line.filled += row.filled;
        m0 += row.sum;
        m_x += arm * row.sum;
        line.variance[1] += row.variance;
        line.variance[2] += arm * arm * row.variance;
    }
    line.y_c = if m0 > 0.0 { (middle + m_x / m0).clamp(1.0, SIDE as f64) } else { middle };
    let x_c = fit.x + fit.slope * (line.y_c - fit.y);
    line.features = [x_c.clamp(1.0, SIDE as f64), m0, m_x, -libm::atan(fit.slope)];
    let noise = known.noise_counts * known.noise_counts;
    // A tactel at full scale hides load: what it may hide widens the error of the sums.
    let hidden = f64::from(line.saturated) * 0.25 * known.saturated_counts;
    line.variance[0] = 160.0 * noise / (m0 * m0).max(1.0) + 1e-4;
    line.variance[1] += hidden * hidden;
    line.variance[2] += 16.0 * hidden * hidden;
    line.variance[3] = slope_variance + 1e-6;
    line
}

#[cfg(test)]
mod tests;
