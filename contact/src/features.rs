//! Features of a stress distribution over a line and of the image of an array: moments, centroid,
//! principal axis, widths. Lengths in mm, stresses in MPa, negative under compression.
//!
//! Nothing here is NaN: what a distribution does not define (a centroid without force, the axis of
//! a round image, the width above a level that is never reached) is absent. Refused are lists that
//! do not fit each other and numbers that are not finite or beyond 1e30.

use super::space::tactels::Array;
use super::{Invalid, finite};

/// An image counts as round when its second moments differ by less than this part of their size.
const ROUND_IMAGE_TOLERANCE: f64 = 1e-6;
/// A force counts as none when it is less than this part of the sum of its parts' sizes.
const ZERO_FORCE_TOLERANCE: f64 = 1e-12;

/// Sums over an image of szz times the tactel's area.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImageFeatures {
    /// Sum, N; negative under compression.
    pub m0: f64,
    /// Sum of x times the value, N mm.
    pub my: f64,
    /// Sum of y times the value, N mm.
    pub mx: f64,
    /// Centroid my/m0, mm; absent without force.
    pub xc: Option<f64>,
    /// Centroid mx/m0, mm; absent without force.
    pub yc: Option<f64>,
    /// Central second moment of (x - xc)^2, N mm^2; absent without force.
    pub mu_xx: Option<f64>,
    /// Central second moment of (x - xc)(y - yc).
    pub mu_xy: Option<f64>,
    /// Central second moment of (y - yc)^2.
    pub mu_yy: Option<f64>,
    /// Angle of the long axis from +x in (-pi/2, pi/2], rad: 1/2 atan2(-2 mu_xy, -(mu_xx -
    /// mu_yy)); absent without force and for a round image.
    pub theta_long_rad: Option<f64>,
}

/// Which values of a distribution count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// All of them.
    Full,
    /// Only those under compression.
    Compressive,
}

impl Part {
    fn of(self, value: f64) -> f64 {
        if self == Self::Compressive { value.min(0.0) } else { value }
    }

    /// Sets what does not belong to this part of an image to 0, as a sensor does that feels
    /// compression alone.
    pub fn apply_to(self, image: &mut [f64]) {
        image.iter_mut().for_each(|value| *value = self.of(*value));
    }
}

/// Features of an image, row by row (row = y, column = x, both ascending).
///
/// # Errors
/// An array that [`Array::check`] refuses, an image of another length or with a value that is not
/// finite or beyond 1e30.
pub fn image_features(array: &Array, image: &[f64], part: Part) -> Result<ImageFeatures, Invalid> {
    array.check_image(image)?;
    image.iter().try_for_each(|value| finite("image", *value))?;
    let area = array.pitch_mm * array.pitch_mm;
    let mut out = ImageFeatures::default();
    let mut size = 0.0;
    let load = |n: usize| part.of(image[n]) * area;
    let place = |n: usize| (array.x_mm(n % array.cols), array.y_mm(n / array.cols));
    for n in 0..image.len() {
        let (s, (x, y)) = (load(n), place(n));
        out.m0 += s;
        out.my += x * s;
        out.mx += y * s;
        size += s.abs();
    }
    if out.m0.abs() <= ZERO_FORCE_TOLERANCE * size || size == 0.0 {
        return Ok(out);
    }
    let (xc, yc) = (out.my / out.m0, out.mx / out.m0);
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for n in 0..image.len() {
        let (s, (x, y)) = (load(n), place(n));
        let (x, y) = (x - xc, y - yc);
        xx += x * x * s;
        xy += x * y * s;
        yy += y * y * s;
    }
    (out.xc, out.yc) = (Some(xc), Some(yc));
    (out.mu_xx, out.mu_xy, out.mu_yy) = (Some(xx), Some(xy), Some(yy));
    let (across, along) = (-2.0 * xy, yy - xx);
    if across.abs().max(along.abs()) > ROUND_IMAGE_TOLERANCE * (xx.abs() + yy.abs()) {
        let theta = 0.5 * libm::atan2(across, along);
        // One value for each axis: -pi/2 is the axis of pi/2.
        let half = core::f64::consts::FRAC_PI_2;
        out.theta_long_rad = Some(if theta <= -half { half } else { theta });
    }
    Ok(out)
}

/// Moments and shape of a stress distribution over a line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineFeatures {
    /// Integrals of x^n szz, n = 0 to 3: N/mm, N, N mm, N mm^2.
    pub moments: [f64; 4],
    /// Centroid, mm; absent without force.
    pub x_c: Option<f64>,
    /// Place of the largest compression, mm: the vertex of the parabola through the largest sample
    /// and its neighbours; absent without compression.
    pub x_m: Option<f64>,
    /// The compression there, as a stress (negative), MPa.
    pub szz_peak: Option<f64>,
}

/// Features of samples at ascending places, taken as straight between them: moments are exact for
/// that polygon, so their error goes as the square of the spacing.
///
/// # Errors
/// Fewer than three samples, lists of different lengths, places that do not ascend, numbers that
/// are not finite or beyond 1e30.
pub fn line_features(x_mm: &[f64], szz_mpa: &[f64], part: Part) -> Result<LineFeatures, Invalid> {
    check_line(x_mm, szz_mpa)?;
    let mut out = LineFeatures::default();
    let mut size = 0.0;
    for (x, s) in x_mm.windows(2).zip(szz_mpa.windows(2)) {
        let (from, to) = (part.of(s[0]), part.of(s[1]));
        let width = x[1] - x[0];
        // Gauss's three points are exact for a cubic times a straight line.
        for (g, w) in [(0.112_701_665_379_258_3, 5.0), (0.5, 8.0), (0.887_298_334_620_741_7, 5.0)] {
            let (place, value) = (x[0] + g * width, from + g * (to - from));
            let mut term = w / 18.0 * width * value;
            size += term.abs();
            for moment in &mut out.moments {
                *moment += term;
                term *= place;
            }
        }
    }
    if size > 0.0 && out.moments[0].abs() > ZERO_FORCE_TOLERANCE * size {
        out.x_c = Some(out.moments[1] / out.moments[0]);
    }
    if let Some((x, s)) = peak(x_mm, szz_mpa) {
        (out.x_m, out.szz_peak) = (Some(x), Some(s));
    }
    Ok(out)
}

fn check_line(x_mm: &[f64], szz_mpa: &[f64]) -> Result<(), Invalid> {
    if x_mm.len() != szz_mpa.len() || x_mm.len() < 3 {
        let what = format!("{} places and {} stresses", x_mm.len(), szz_mpa.len());
        return Err(Invalid::new("x_mm", what, "give as many of each, at least three"));
    }
    x_mm.iter().try_for_each(|place| finite("x_mm", *place))?;
    szz_mpa.iter().try_for_each(|stress| finite("szz_mpa", *stress))?;
    if x_mm.windows(2).any(|pair| pair[1] <= pair[0]) {
        let what = "the places do not ascend".to_owned();
        return Err(Invalid::new("x_mm", what, "sort them, each once"));
    }
    Ok(())
}

/// Place and value of the largest compression.
fn peak(x: &[f64], s: &[f64]) -> Option<(f64, f64)> {
    let mut lowest = 0;
    for n in 0..s.len() {
        if s[n] < s[lowest] {
            lowest = n;
        }
    }
    if s[lowest] >= 0.0 {
        return None;
    }
    if lowest == 0 || lowest + 1 == s.len() {
        return Some((x[lowest], s[lowest]));
    }
    let (left, right) = (x[lowest] - x[lowest - 1], x[lowest + 1] - x[lowest]);
    let rise = [(s[lowest] - s[lowest - 1]) / left, (s[lowest + 1] - s[lowest]) / right];
    let bend = (rise[1] - rise[0]) / (left + right);
    if bend <= 0.0 {
        return Some((x[lowest], s[lowest]));
    }
    let slope = (rise[0] * right + rise[1] * left) / (left + right);
    let step = -slope / (2.0 * bend);
    let vertex = (x[lowest] + step, s[lowest] - bend * step * step);
    // Places too close for slopes to be numbers have no parabola.
    Some(vertex).filter(|(x, s)| x.is_finite() && s.is_finite()).or(Some((x[lowest], s[lowest])))
}

/// Width of the connected region about the largest compression where the compression exceeds
/// `threshold_mpa` > 0, between the crossings of the polygon; absent when it is never exceeded. A
/// region that runs to an end of the samples ends there.
///
/// # Errors
/// As [`line_features`], and a threshold that is not finite and above zero.
pub fn width_above(
    x_mm: &[f64],
    szz_mpa: &[f64],
    threshold_mpa: f64,
) -> Result<Option<f64>, Invalid> {
    check_line(x_mm, szz_mpa)?;
    super::positive("threshold_mpa", threshold_mpa)?;
    let level = -threshold_mpa;
    let mut lowest = 0;
    for n in 0..szz_mpa.len() {
        if szz_mpa[n] < szz_mpa[lowest] {
            lowest = n;
        }
    }
    if szz_mpa[lowest] >= level {
        return Ok(None);
    }
    let crossing = |inside: usize, outside: usize| {
        let part = (level - szz_mpa[inside]) / (szz_mpa[outside] - szz_mpa[inside]);
        x_mm[inside] + part * (x_mm[outside] - x_mm[inside])
    };
    let left = (0..lowest).rev().find(|n| szz_mpa[*n] >= level);
    let right = (lowest + 1..x_mm.len()).find(|n| szz_mpa[*n] >= level);
    let from = left.map_or(x_mm[0], |n| crossing(n + 1, n));
    let to = right.map_or(x_mm[x_mm.len() - 1], |n| crossing(n - 1, n));
    Ok(Some(to - from))
}
