//! Solves one contact interval under pressure and a tangential traction in proportion to it: the
//! singular integral equation of the layer's surface slope, by Gauss-Jacobi collocation.
//!
//! With g = f/m for q = f p the slope equation is
//!     w'(x) = int [1/(s - x) + S'(x - s) + g J0'(x - s)] p(s) ds + g n pi p(x),
//! and p(x) = phi(xi) (1 - xi)^alpha (1 + xi)^beta with alpha = -1/2 + atan(g n)/pi and
//! alpha + beta = -1. At the zeros of the Jacobi polynomial with the opposite exponents the
//! Gauss rule gives the singular part and g n pi p exactly (Erdogan, Gupta and Cook 1973); what is
//! left is smooth, so everything converges exponentially. A free edge is where phi vanishes.
//!
//! Lengths are in thicknesses, tractions in units of pi G/(1 - nu). Only the construction
//! allocates.

use super::coarse_kernels::CombinedKernel;
use super::surface_kernels::SurfaceKernels;
use crate::numeric::elimination::LuMatrix;
use crate::numeric::jacobi::{self, JacobiRecurrence, JacobiRule};
use crate::wave_grid::FIELD_REACH;
use core::f64::consts::{FRAC_PI_2, PI};

/// Relative difference below which two couplings count as equal.
const COUPLING_TOLERANCE: f64 = 1e-14;

/// The discretised interval; matrix and solutions live in storage that is kept.
#[derive(Clone, Debug)]
pub(crate) struct Interval {
    rule: JacobiRule,
    zeros: Vec<f64>,
    recurrence: JacobiRecurrence,
    dense: LuMatrix,
    half: f64,
    coupling: f64,
    /// Number and exponent of the collocation points that `zeros` holds.
    collocation: (usize, f64),
    /// The coarse kernel, if the solution is a fast one.
    combined: Option<CombinedKernel>,
    /// Mean descent per phi by the kernel's smooth part; empty while it is not computed.
    mean_descents: Vec<f64>,
}

impl Interval {
    pub(crate) fn with_capacity(capacity: usize) -> Self {
        Self {
            rule: JacobiRule::with_capacity(capacity),
            zeros: Vec::with_capacity(capacity),
            recurrence: JacobiRecurrence::with_capacity(capacity),
            dense: LuMatrix::with_capacity(capacity),
            half: 1.0,
            coupling: 0.0,
            collocation: (0, 0.0),
            combined: None,
            mean_descents: Vec::with_capacity(capacity),
        }
    }

    /// The same for errors of about 1e-6: coarse kernels, points found no better than 1e-8.
    pub(crate) fn coarse(capacity: usize) -> Self {
        let mut coarse = Self::with_capacity(capacity);
        coarse.rule = JacobiRule::with_capacity(capacity).with_coarse_tolerance();
        coarse.recurrence = JacobiRecurrence::with_capacity(capacity).with_coarse_tolerance();
        coarse.combined = Some(CombinedKernel::with_capacity(FIELD_REACH));
        coarse
    }

    /// Assembles and factors for a half-width and a coupling g, with `n` points.
    pub(crate) fn assemble(&mut self, kernels: &SurfaceKernels, n: usize, half: f64, g: f64) {
        let same = (g - self.coupling).abs() <= COUPLING_TOLERANCE * g.abs();
        if same && (n, half) == (self.rule.nodes.len(), self.half) {
            return;
        }
        let alpha = exponent(kernels, g);
        (self.half, self.coupling) = (half, g);
        self.mean_descents.clear();
        self.rule.fill(n, alpha, -1.0 - alpha);
        if self.collocation != (n, alpha) {
            self.fill_zeros(n - 1, alpha);
            self.collocation = (n, alpha);
        }
        self.dense.reset(n);
        match &mut self.combined {
            Some(combined) if kernels.coarse.covers(2.0 * half) => {
                kernels.coarse.slopes(g, 2.0 * half, combined);
                let combined = &*combined;
                fill_rows(&mut self.dense, &self.zeros, &self.rule, half, |x| combined.at(x));
            }
            _ if g == 0.0 => {
                fill_rows(&mut self.dense, &self.zeros, &self.rule, half, |x| {
                    kernels.normal_slope(x)
                });
            }
            _ => {
                fill_rows(&mut self.dense, &self.zeros, &self.rule, half, |x| kernels.slopes(x, g))
            }
        }
        for (entry, weight) in self.dense.row_mut(n - 1).iter_mut().zip(&self.rule.weights) {
            *entry = half * weight;
        }
        self.dense.factor();
    }

    /// Collocation points: zeros of the polynomial with the opposite exponents.
    fn fill_zeros(&mut self, n: usize, alpha: f64) {
        if alpha == -0.5 {
            let angle = |j: usize| PI * (j + 1) as f64 / (n + 1) as f64;
            self.zeros.clear();
            self.zeros.extend((0..n).map(|j| libm::cos(angle(j))));
        } else {
            self.recurrence.zeros(n, [-alpha, 1.0 + alpha], &mut self.zeros, |_, _| {});
        }
    }

    /// phi with a total force and the slope w' at the points, as a function of xi.
    pub(crate) fn solve(&self, force: f64, slope: impl Fn(f64) -> f64, phi: &mut Vec<f64>) {
        phi.clear();
        phi.extend(self.zeros.iter().map(|zero| slope(*zero)));
        phi.push(force);
        self.dense.solve(phi);
    }

    /// Force of phi.
    pub(crate) fn total(&self, phi: &[f64]) -> f64 {
        self.half * self.rule.weights.iter().zip(phi).map(|(w, p)| w * p).sum::<f64>()
    }

    /// First moment of phi about the middle of the interval.
    pub(crate) fn moment(&self, phi: &[f64]) -> f64 {
        let pairs = self.rule.nodes.iter().zip(&self.rule.weights);
        let sum: f64 = pairs.zip(phi).map(|((x, w), p)| x * w * p).sum();
        self.half * self.half * sum
    }

    /// phi at xi in [-1, 1].
    pub(crate) fn at(&self, phi: &[f64], xi: f64) -> f64 {
        self.rule.interpolate(phi, xi)
    }

    /// Pressure at xi in (-1, 1).
    pub(crate) fn pressure(&self, phi: &[f64], xi: f64) -> f64 {
        self.at(phi, xi) * self.rule.weight(xi)
    }

    /// Half-width of the last assembly.
    pub(crate) fn half(&self) -> f64 {
        self.half
    }

    /// Exponent alpha of the weight.
    pub(crate) fn alpha(&self) -> f64 {
        self.collocation.1
    }

    /// Means over the interval, with the weight that turns the singular part into a constant: of
    /// the surface's descent under phi, and of any function of xi.
    pub(crate) fn mean_descent(&mut self, kernels: &SurfaceKernels, phi: &[f64]) -> f64 {
        let (alpha, g, half) = (self.collocation.1, self.coupling, self.half);
        let step = g * kernels.transfer.n * FRAC_PI_2;
        let constant = -libm::log(half) - jacobi::mean_log(-1.0 - alpha) - step;
        if self.mean_descents.is_empty() {
            let (rule, out) = (&self.rule, &mut self.mean_descents);
            match &mut self.combined {
                Some(combined) if kernels.coarse.covers(2.0 * half) => {
                    kernels.coarse.descents(g, 2.0 * half, combined);
                    let combined = &*combined;
                    fill_mean_descents(rule, half, out, |x| combined.at(x));
                }
                _ if g == 0.0 => fill_mean_descents(rule, half, out, |x| kernels.normal(x)),
                _ => fill_mean_descents(rule, half, out, |x| kernels.descents(x, g)),
            }
        }
        let smooth: f64 = self
            .mean_descents
            .iter()
            .zip(phi)
            .map(|(mean_descent_part, phi)| mean_descent_part * phi)
            .sum();
        constant * self.total(phi) + half * smooth / jacobi::weight_integral(alpha)
    }

    /// Mean of a function of xi under the weight of [`Self::mean_descent`].
    pub(crate) fn mean(&self, of: impl Fn(f64) -> f64) -> f64 {
        let pairs = self.rule.nodes.iter().zip(&self.rule.weights);
        pairs.map(|(x, w)| w * of(-x)).sum::<f64>() / jacobi::weight_integral(self.collocation.1)
    }
}

/// The rows of the slope equation; `kernel` is its smooth part.
fn fill_rows(
    dense: &mut LuMatrix,
    zeros: &[f64],
    rule: &JacobiRule,
    half: f64,
    kernel: impl Fn(f64) -> f64,
) {
    for (i, &zero) in zeros.iter().enumerate() {
        let pairs = rule.nodes.iter().zip(&rule.weights);
        for (entry, (node, weight)) in dense.row_mut(i).iter_mut().zip(pairs) {
            let x = half * (zero - node);
            *entry = half * weight * (kernel(x) - 1.0 / x);
        }
    }
}

/// Part of each phi in the sum over both places of the smooth part of the descent.
fn fill_mean_descents(
    rule: &JacobiRule,
    half: f64,
    out: &mut Vec<f64>,
    kernel: impl Fn(f64) -> f64,
) {
    // Under the mirrored exponents the nodes are mirrored and keep their weights; so the sum
    // over both places has the kernel at -(s + x), the same for (s, x) and (x, s).
    let (nodes, weights) = (&rule.nodes, &rule.weights);
    out.clear();
    for (i, (node, weight)) in nodes.iter().zip(weights).enumerate() {
        let mut own = weight * kernel(-2.0 * half * node);
        for ((other, part), mean_descent_part) in nodes[..i].iter().zip(weights).zip(out.iter_mut())
        {
            let value = kernel(-half * (node + other));
            own += part * value;
            *mean_descent_part += weight * part * value;
        }
        out.push(weight * own);
    }
}

/// The exponent at the right edge for q = f p, g = f/m.
fn exponent(kernels: &SurfaceKernels, g: f64) -> f64 {
    if g == 0.0 { -0.5 } else { -0.5 + libm::atan(g * kernels.transfer.n) / PI }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layer::Transfer;

    /// On a very thick layer, as on a half plane, a frictionless flat punch has p = P/(pi
    /// sqrt(a^2-x^2)).
    #[test]
    fn a_narrow_flat_punch_is_that_of_the_half_plane() {
        let kernels = SurfaceKernels::new(&Transfer::new(0.3));
        let mut interval = Interval::with_capacity(12);
        interval.assemble(&kernels, 12, 1e-5, 0.0);
        let mut phi = Vec::new();
        interval.solve(1.0, |_| 0.0, &mut phi);
        for p in &phi {
            assert!((p * PI * 1e-5 - 1.0).abs() < 1e-9, "{p}");
        }
        // The descent of the punch is that of ln(2/a) + S(0).
        let expected = libm::log(2.0 / 1e-5) + kernels.normal(0.0);
        assert!((interval.mean_descent(&kernels, &phi) - expected).abs() < 1e-9);
    }

    /// The step in the displacement under friction: both ends give the same mean.
    #[test]
    fn the_mean_of_the_singular_part_is_one_constant() {
        for a0 in [-0.8, -0.01, 0.0, 0.3] {
            let alpha = -0.5 + libm::atan(a0) / PI;
            let beta = -1.0 - alpha;
            let right = -jacobi::mean_log(beta) - a0 * FRAC_PI_2;
            let left = -jacobi::mean_log(alpha) + a0 * FRAC_PI_2;
            assert!((right - left).abs() < 1e-13, "{a0}: {right} {left}");
        }
    }
}
