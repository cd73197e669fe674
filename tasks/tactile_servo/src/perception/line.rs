//! The pin's line in an image: features from a band about it, each with its variance. Refuses
//! images whose load does not lie along one line that crosses the rows.
//!
//! The threshold finds the line; the sums then take every value within `BAND` columns of it, so
//! that the load's tails are not cut off and noise has mean zero: with the thesis's noise a
//! threshold of three standard deviations alone takes a tenth of the load away. A tactel that
//! cannot be believed stands for the mean of its neighbours in the rows beside it. The line is that
//! of least squares through the rows' first moments about the band, each row weighted by its load
//! and by the noise of its tactels: no row is switched in or out, so a contact that only begins, or
//! touches with one row, gives the same features with larger variances. Rows that were scanned at
//! other times are moved to the time of the image.

use taktil_signal::{TACTEL_SATURATED, TactileImage};

use super::Touch;

/// Columns on either side of the line that count.
pub const BAND: f64 = 2.5;
/// Rows and columns of the array that this is made for.
pub const SIDE: usize = 16;
/// Columns of the band.
const COLUMNS: u32 = 5;
/// Steepest line, columns a row: 45 degrees.
const STEEPEST: f64 = 1.0;
/// Standard deviation of the slope before anything is seen (columns a row).
const SLOPE_PRIOR: f64 = 0.35;
/// Variance of a row's centroid that noise does not explain: a hundredth of a column.
const ROW_FLOOR: f64 = 1e-4;
/// Share of the thresholded load that has to lie in the band.
const SHARE_MIN: f64 = 0.5;
/// A row between two that carry load, and that reads less than this share of their mean, is dead.
const DEAD: f64 = 0.4;
/// Two rows carry load when their mean is above this many standard deviations of a row.
const DEAD_SIGMAS: f64 = 5.0;
/// Times that the band is laid about the line.
const ROUNDS: u32 = 3;

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
    /// Sum and moment once more, with the tactels weighted by the share of a load that they are due
    /// ([`Shape`]), and their variances: less noise, but right up to a factor only.
    pub shaped: [f64; 2],
    /// Variance of each.
    pub shaped_variance: [f64; 2],
    /// Load of each row, evened out with the rows beside it (counts, none negative).
    pub rows: [f64; SIDE],
    /// Tactels of the band that stand at full scale: the load is at least what is said.
    pub saturated: u32,
    /// Tactels of the band that neighbours stand for.
    pub filled: u32,
}

impl Line {
    /// The same line with loads so many times as large.
    #[must_use]
    pub fn scaled(&self, by: f64) -> Line {
        let mut line = *self;
        for i in [1, 2] {
            line.features[i] *= by;
            line.variance[i] *= by * by;
            line.shaped[i - 1] *= by;
            line.shaped_variance[i - 1] *= by * by;
        }
        line.rows.iter_mut().for_each(|row| *row *= by);
        line
    }

    /// The same image's touch with the features of its line.
    #[must_use]
    pub fn touch(&self, touch: &Touch) -> Touch {
        let [x_c, m0, m_x, theta_z] = self.features;
        Touch { m0, m_x, x_c: Some(x_c), y_c: Some(self.y_c), theta_z_rad: Some(theta_z), ..*touch }
    }
}

/// Places of a [`Shape`]: 0 to [`BAND`] columns by sixteenths.
const PLACES: usize = 41;

/// How a row's load spreads over the columns beside the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Part of the load on a tactel whose middle lies so many sixteenths of a column away.
    shares: [f64; PLACES],
}

impl Shape {
    /// Of the part of the load on a tactel so many columns beside the line, either way.
    #[must_use]
    pub fn new(share: impl Fn(f64) -> f64) -> Shape {
        Shape { shares: core::array::from_fn(|place| share(place as f64 / 16.0)) }
    }

    /// A load that spreads evenly over the band: weights every tactel alike.
    pub const EVEN: Shape = Shape { shares: [1.0 / COLUMNS as f64; PLACES] };

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    fn share(&self, away: f64) -> f64 {
        let place = (16.0 * away.abs()).min((PLACES - 1) as f64);
        let below = (place as usize).min(PLACES - 2);
        let rise = self.shares[below + 1] - self.shares[below];
        self.shares[below] + rise * (place - below as f64)
    }
}

/// What is known besides the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// How a row's load spreads.
    pub shape: Shape,
    /// Standard deviation of a tactel (counts).
    pub noise_counts: f64,
    /// Speed of the line over the columns (columns/s).
    pub speed_cols_s: f64,
}

/// One row of the band.
#[derive(Clone, Copy, Default)]
struct Row {
    sum: f64,
    /// First moment about the middle of the band (counts x columns).
    first: f64,
    /// Variances of both.
    variance: [f64; 2],
    /// Load by the shape, and its variance.
    shaped: [f64; 2],
    saturated: u32,
    /// What they read together (counts).
    at_rail: f64,
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
    let noise = known.noise_counts * known.noise_counts;
    let from = (middle - BAND).ceil().clamp(1.0, 17.0);
    let to = (middle + BAND).floor().clamp(0.0, 16.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let (from, to) = (from as usize, to as usize);
    let [mut pull, mut pulled, mut weight] = [0.0; 3];
    for col in from..=to {
        let Some((counts, own)) = value(image, row, col - 1) else {
            out.filled += 1;
            continue;
        };
        out.filled += u32::from(!own);
        if own && image.valid[row * SIDE + col - 1] == TACTEL_SATURATED {
            out.saturated += 1;
            out.at_rail += counts;
        }
        let arm = col as f64 - middle;
        // What stands for a tactel shares the noise of the one it was taken from.
        let share = if own { noise } else { 2.0 * noise };
        out.sum += counts;
        out.first += counts * arm;
        out.variance[0] += share;
        out.variance[1] += share * arm * arm;
        let due = known.shape.share(arm);
        pull += due * counts;
        pulled += due * due * share;
        weight += due * due;
    }
    if weight > 0.0 {
        out.shaped = [pull / weight, pulled / (weight * weight)];
    }
    out
}

/// The rows with dead ones stood for by the mean of the two beside them: a pin does not leave one
/// row out.
fn revived(rows: &[Row; SIDE]) -> [Row; SIDE] {
    let mut out = *rows;
    for index in 1..SIDE - 1 {
        let (below, own, above) = (&rows[index - 1], &rows[index], &rows[index + 1]);
        let mean = 0.5 * (below.sum + above.sum);
        let noise = below.variance[0].max(above.variance[0]).sqrt();
        let both = below.sum.min(above.sum) > 0.5 * mean;
        if both && mean > DEAD_SIGMAS * noise && own.sum < DEAD * mean {
            out[index] = Row {
                sum: mean,
                first: 0.5 * (below.first + above.first),
                variance: below.variance,
                shaped: [0.5 * (below.shaped[0] + above.shaped[0]), below.shaped[1]],
                saturated: 0,
                at_rail: 0.0,
                filled: COLUMNS,
            };
        }
    }
    out
}

/// Loads of the rows, evened out with the rows beside them; none is negative.
fn loads(rows: &[Row; SIDE]) -> [f64; SIDE] {
    core::array::from_fn(|index| {
        let (mut sum, mut weight) = (2.0 * rows[index].sum, 2.0);
        if index > 0 {
            (sum, weight) = (sum + rows[index - 1].sum, weight + 1.0);
        }
        if let Some(next) = rows.get(index + 1) {
            (sum, weight) = (sum + next.sum, weight + 1.0);
        }
        (sum / weight).max(0.0)
    })
}

/// The line that a thresholded image points to; absent without contact, when the array is not 16 by
/// 16, and when most of the load lies elsewhere than along one line.
#[must_use]
pub fn line(image: &TactileImage, touch: &Touch, known: &Known) -> Option<Line> {
    if !touch.contact || usize::from(image.rows) != SIDE || usize::from(image.cols) != SIDE {
        return None;
    }
    let (x_c, y_c) = (touch.x_c?, touch.y_c?);
    let start = touch.theta_z_rad.map_or(0.0, |theta| -libm::tan(theta));
    let slope = if start.abs() < STEEPEST { start } else { 0.0 };
    let mut fit = Fit { x: x_c, y: y_c, slope, variance: [0.0; 2] };
    let mut rows = [Row::default(); SIDE];
    for _ in 0..ROUNDS {
        (rows, fit) = pass(image, &fit, known)?;
    }
    let line = summed(&rows, &fit);
    (line.features[1] >= SHARE_MIN * touch.m0).then_some(line)
}

/// A straight line: x at row y, its slope in columns a row, and the variances of both.
#[derive(Clone, Copy)]
struct Fit {
    x: f64,
    y: f64,
    slope: f64,
    variance: [f64; 2],
}

/// Lays the band about a line and fits the next one.
#[expect(clippy::cast_precision_loss, reason = "row numbers are small")]
fn pass(image: &TactileImage, fit: &Fit, known: &Known) -> Option<([Row; SIDE], Fit)> {
    let at = |y: f64| fit.x + fit.slope * (y - fit.y);
    let rows: [Row; SIDE] =
        core::array::from_fn(|index| row(image, index, at((index + 1) as f64), known));
    let rows = revived(&rows);
    let [mut w, mut wy, mut wyy, mut pull, mut turn] = [0.0; 5];
    for (index, (row, load)) in rows.iter().zip(loads(&rows)).enumerate() {
        let y = (index + 1) as f64;
        let late_s = 1e-9 * f64::from(image.row_offset_ns[index]);
        let first = row.first - load * known.speed_cols_s * late_s;
        let variance = row.variance[1] + ROW_FLOOR * load * load;
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
    let (y, prior) = (wy / w, 1.0 / (SLOPE_PRIOR * SLOPE_PRIOR));
    let spread = (wyy - wy * y).max(0.0) + prior;
    let slope = fit.slope + (turn - y * pull - prior * fit.slope) / spread;
    let x = at(y) + (pull / w).clamp(-BAND, BAND);
    let variance = [1.0 / w, 1.0 / spread];
    let next = Fit { x, y, slope: slope.clamp(-STEEPEST, STEEPEST), variance };
    let sound = x.is_finite() && y.is_finite() && slope.is_finite();
    sound.then_some((rows, next))
}

#[expect(clippy::cast_precision_loss, reason = "row numbers are small")]
fn summed(rows: &[Row; SIDE], fit: &Fit) -> Line {
    let middle = 0.5 * (SIDE as f64 + 1.0);
    let mut line = Line {
        features: [0.0; 4],
        variance: [0.0; 4],
        shaped: [0.0; 2],
        shaped_variance: [0.0; 2],
        y_c: middle,
        rows: loads(rows),
        saturated: 0,
        filled: 0,
    };
    let [mut m0, mut m_x] = [0.0, 0.0];
    for (index, row) in rows.iter().enumerate() {
        let arm = (index + 1) as f64 - middle;
        line.saturated += row.saturated;
        line.filled += row.filled;
        m0 += row.sum;
        m_x += arm * row.sum;
        line.variance[1] += row.variance[0];
        line.variance[2] += arm * arm * row.variance[0];
        let [load, variance] = row.shaped;
        line.shaped = [line.shaped[0] + load, line.shaped[1] + arm * load];
        line.shaped_variance[0] += variance;
        line.shaped_variance[1] += arm * arm * variance;
    }
    line.y_c = if m0 > 0.0 { (middle + m_x / m0).clamp(1.0, SIDE as f64) } else { middle };
    let off = line.y_c - fit.y;
    let x_c = fit.x + fit.slope * off;
    line.features = [x_c.clamp(1.0, SIDE as f64), m0, m_x, -libm::atan(fit.slope)];
    // A tactel at full scale hides load: what it may hide widens the error of the sums.
    let hidden = 0.25 * rows.iter().map(|row| row.at_rail).sum::<f64>();
    line.variance[0] = fit.variance[0] + off * off * fit.variance[1] + 1e-4;
    line.variance[1] += hidden * hidden;
    line.variance[2] += 16.0 * hidden * hidden;
    line.shaped_variance[0] += hidden * hidden;
    line.shaped_variance[1] += 16.0 * hidden * hidden;
    line.variance[3] = fit.variance[1] + 1e-6;
    line
}

#[cfg(test)]
mod tests;
