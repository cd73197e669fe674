//! Solves for both tractions, coupled through the layer, on a strip of the surface that is glued to
//! a rigid body.
//!
//! The tractions are Chebyshev series over sqrt(b^2 - x^2). Their logarithm and step act exactly,
//! the smooth parts of the kernels by Gauss's rule. At the edges the exact tractions oscillate
//! (exponent ln(3 - 4 nu)/(2 pi)), unless nu = 0.5; the series smooths that out, which leaves loads
//! right to about 1e-5 (nu = 0.3) or better. Lengths are in thicknesses, tractions in units of pi
//! G/(1 - nu). Solving allocates.

use super::surface_kernels::SurfaceKernels;
use crate::numeric::elimination::LuMatrix;
use core::f64::consts::{FRAC_PI_2, LN_2, PI};

/// Chebyshev points, and the sums that depend on their number alone.
#[derive(Clone, Debug)]
pub(super) struct Chebyshev {
    /// cos theta, descending.
    pub(super) cosines: Vec<f64>,
    /// Displacement by the logarithm and by the step: row by row, per phi.
    logarithm: Vec<f64>,
    step: Vec<f64>,
}

/// phi of the pressure and of the tangential traction at the points, for unit forces or moves.
#[derive(Clone, Debug, Default)]
pub(super) struct Tractions {
    pub(super) p: Vec<f64>,
    pub(super) q: Vec<f64>,
}

impl Chebyshev {
    pub(super) fn new(n: usize) -> Self {
        let angle = |j: usize| PI * (2 * j + 1) as f64 / (2 * n) as f64;
        // Sums over k of cos(k s pi/n)/k and sin(k s pi/n)/k: products of the angles' functions are
        // those of their sums and differences, which fall on these.
        let circle = |k: usize| PI * k as f64 / n as f64;
        let turn: Vec<[f64; 2]> =
            (0..2 * n).map(|k| [libm::cos(circle(k)), libm::sin(circle(k))]).collect();
        let sum = |s: usize| {
            let term = |k: usize| turn[k * s % (2 * n)].map(|value| value / k as f64);
            (1..n).map(term).fold([0.0; 2], |sum, term| [sum[0] + term[0], sum[1] + term[1]])
        };
        let sums: Vec<[f64; 2]> = (0..2 * n).map(sum).collect();
        let (mut logarithm, mut step) = (Vec::new(), Vec::new());
        let over = PI / n as f64;
        for i in 0..n {
            for j in 0..n {
                let (both, apart) = (sums[i + j + 1], sums[i.abs_diff(j)]);
                let log = 0.5 * (both[0] + apart[0]);
                let jump = 0.5 * (both[1] + if i >= j { apart[1] } else { -apart[1] });
                logarithm.push(over * (LN_2 + 2.0 * log));
                step.push(over * (1.0 - 2.0 * angle(i) / PI - 4.0 / PI * jump));
            }
        }
        Self { cosines: (0..n).map(|j| libm::cos(angle(j))).collect(), logarithm, step }
    }

    pub(super) fn count(&self) -> usize {
        self.cosines.len()
    }

    /// Integral of a traction over the strip.
    pub(super) fn total(&self, phi: &[f64]) -> f64 {
        PI / self.count() as f64 * phi.iter().sum::<f64>()
    }

    /// The factored system of a strip of half-width `b`: descent first, then displacement along x.
    pub(super) fn system(&self, kernels: &SurfaceKernels, b: f64) -> LuMatrix {
        let n = self.count();
        let (over, m) = (PI / n as f64, kernels.transfer.m);
        let jump = kernels.transfer.n * FRAC_PI_2;
        let constant = -libm::log(b) * over;
        let mut dense = LuMatrix::with_capacity(2 * n);
        dense.reset(2 * n);
        for i in 0..n {
            for j in 0..n {
                let x = b * (self.cosines[i] - self.cosines[j]);
                let log = self.logarithm[i * n + j] + constant;
                let coupled = (over * kernels.coupling(x) + jump * self.step[i * n + j]) / m;
                dense.row_mut(i)[j] = log + over * kernels.normal(x);
                dense.row_mut(i)[n + j] = coupled;
                dense.row_mut(n + i)[j] = -coupled;
                dense.row_mut(n + i)[n + j] = log + over * kernels.along(x);
            }
        }
        dense.factor();
        dense
    }

    /// Tractions under a descent and a displacement along x, both functions of the place -1 to 1.
    pub(super) fn solve(
        &self,
        system: &LuMatrix,
        descent: impl Fn(f64) -> f64,
        along: impl Fn(f64) -> f64,
    ) -> Tractions {
        let mut side: Vec<f64> = self.cosines.iter().map(|x| descent(*x)).collect();
        side.extend(self.cosines.iter().map(|x| along(*x)));
        system.solve(&mut side);
        let q = side.split_off(self.count());
        Tractions { p: side, q }
    }

    /// Cosine coefficients of phi.
    pub(super) fn series(&self, phi: &[f64]) -> Vec<f64> {
        let n = self.count();
        let coefficient = |k: usize| {
            let term = |(j, value): (usize, &f64)| {
                value * libm::cos(PI * (k * (2 * j + 1)) as f64 / (2 * n) as f64)
            };
            let sum: f64 = phi.iter().enumerate().map(term).sum();
            sum * if k == 0 { 1.0 } else { 2.0 } / n as f64
        };
        (0..n).map(coefficient).collect()
    }

    /// Descent at x > b outside the strip on its right; `series` is that of the pressure.
    pub(super) fn descent_outside(
        &self,
        kernels: &SurfaceKernels,
        b: f64,
        x: f64,
        tractions: &Tractions,
        series: &[f64],
    ) -> f64 {
        let ratio = x / b;
        let root = ((ratio - 1.0) * (ratio + 1.0)).sqrt();
        let z = 1.0 / (ratio + root);
        let mut sum = -libm::log(0.5 * b / z) * series[0];
        let mut power = 1.0;
        for (k, c) in series.iter().enumerate().skip(1) {
            power *= z;
            sum += c * power / k as f64;
        }
        let m = kernels.transfer.m;
        let pairs = tractions.p.iter().zip(&tractions.q);
        let smooth: f64 = pairs
            .zip(&self.cosines)
            .map(|((p, q), c)| {
                let r = x - b * c;
                p * kernels.normal(r) + q * kernels.coupling(r) / m
            })
            .sum();
        let jump = kernels.transfer.n * FRAC_PI_2 / m * self.total(&tractions.q);
        PI * sum + PI / self.count() as f64 * smooth + jump
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layer::Transfer;

    /// Without coupling (nu = 0.5) and on a half plane a glued punch is a frictionless one.
    #[test]
    fn at_one_half_a_narrow_glued_punch_has_no_shear() {
        let kernels = SurfaceKernels::new(&Transfer::new(0.5));
        let points = Chebyshev::new(16);
        let b = 1e-4;
        let system = points.system(&kernels, b);
        let punch = points.solve(&system, |_| 1.0, |_| 0.0);
        let force = points.total(&punch.p);
        assert!(punch.q.iter().all(|q| q.abs() < 1e-3 * force));
        let expected = libm::log(2.0 / b) + kernels.normal(0.0);
        assert!((1.0 / force - expected).abs() < 1e-6 * expected);
        let series = points.series(&punch.p);
        let at_edge = points.descent_outside(&kernels, b, b, &punch, &series);
        assert!((at_edge - 1.0).abs() < 1e-9, "{at_edge}");
    }
}
