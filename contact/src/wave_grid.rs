//! Wave numbers and weights with which Fourier integrals over the wave number are summed, in units
//! of one over the layer's thickness.
//!
//! The transfer functions of a bonded layer are even and analytic in a strip about the real axis
//! and die exponentially. The trapezoidal rule then converges exponentially: it is cut off where
//! the integrand has died, with a step whose period lies so far beyond the points wanted that the
//! periodic images have died there. Close under the surface the integrand dies slowly; with the
//! half plane's part taken out it dies as exp(-2a + a d), and Gauss's rule sums it in panels.

use super::numeric::quadrature::legendre_array;
use core::f64::consts::PI;

/// Distance in thicknesses at which the fields of a layer have died to about 1e-13 (they decay at
/// least as exp(-0.739 x)).
pub(crate) const FIELD_REACH: f64 = 40.0;
/// Points of one panel of Gauss's rule.
pub(crate) const GAUSS_POINTS: usize = 10;
/// Width of a panel in radians of the fastest cosine: ten points are then exact to 1e-11.
const RADIANS_PER_PANEL: f64 = 5.0;
/// Exponent by which an integrand has fallen to the rounding of its sum: exp(-42) is 6e-19.
pub(crate) const DECAY_EXPONENT: f64 = 42.0;

/// Step of the trapezoidal rule for points up to `span` from the origin, of fields that have died
/// at a distance of `far`.
fn trapezoidal_step(span: f64, far: f64) -> f64 {
    2.0 * PI / (span + 1.2 * far)
}

/// Number of steps of the trapezoidal rule up to a cut-off wave number.
pub(crate) fn trapezoidal_steps(span: f64, far: f64, cutoff: f64) -> f64 {
    libm::ceil(cutoff / trapezoidal_step(span, far))
}

/// Wave numbers and weights of the trapezoidal rule, each as a pair.
pub(crate) fn trapezoidal_grid(span: f64, far: f64, cutoff: f64) -> Vec<[f64; 2]> {
    let step = trapezoidal_step(span, far);
    let count = trapezoidal_steps(span, far, cutoff) as usize;
    (0..=count).map(|i| [i as f64 * step, if i == 0 { 0.5 * step } else { step }]).collect()
}

/// Number of panels of Gauss's rule for points up to `span` from the origin at a depth, with the
/// half plane's part taken out.
pub(crate) fn gauss_panels(span: f64, depth: f64) -> f64 {
    libm::ceil(DECAY_EXPONENT / (2.0 - depth) * (span / RADIANS_PER_PANEL).max(1.5))
}

/// Wave numbers and weights of Gauss's rule, panel after panel, each as a pair.
pub(crate) fn gauss_grid(span: f64, depth: f64) -> Vec<[f64; 2]> {
    let cutoff = DECAY_EXPONENT / (2.0 - depth);
    let panels = gauss_panels(span, depth) as usize;
    let width = cutoff / panels as f64;
    let rule = legendre_array::<GAUSS_POINTS>();
    let mut grid = Vec::with_capacity(panels * GAUSS_POINTS);
    for panel in 0..panels {
        for [x, w] in rule {
            grid.push([(panel as f64 + 0.5 * (1.0 + x)) * width, 0.5 * w * width]);
        }
    }
    grid
}
