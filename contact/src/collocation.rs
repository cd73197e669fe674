//! A strip on the bonded layer with its normal or tangential displacement prescribed: the integral
//! equation of the first kind, solved by collocation at Chebyshev points.
//!
//! The traction is phi(theta)/(b sin theta) with x = b cos theta and phi a cosine series. The
//! logarithm of the kernel acts on that series exactly, its smooth remainder by Gauss-Chebyshev
//! quadrature; both converge exponentially. Lengths are in layer thicknesses, tractions in units
//! that make the kernel K of [`super::kernel`] act without a factor.

use super::kernel::SurfaceKernel;
use super::numeric::elimination::EliminationMatrix;
use core::f64::consts::{LN_2, PI};

/// Points on the half x > 0 of a strip of half-width `b` thicknesses: enough for about 1e-7.
pub(crate) fn points_for(b: f64) -> usize {
    16 + libm::ceil(3.0 * b) as usize
}

/// Chebyshev points on half a strip, and the sums that depend on their number alone.
pub(crate) struct Collocation {
    /// cos theta, descending.
    pub(crate) cosines: Vec<f64>,
    /// sum over l of cos(l pi j/h)/(2l), j = 0 .. 2h - 1: the logarithm's part without n = 0.
    series: Vec<f64>,
}

impl Collocation {
    pub(crate) fn new(half: usize) -> Self {
        let angle = |j: usize| PI * (2 * j + 1) as f64 / (4 * half) as f64;
        let circle: Vec<f64> =
            (0..2 * half).map(|j| libm::cos(PI * j as f64 / half as f64)).collect();
        let series = |j: usize| {
            (1..half).map(|l| circle[(l * j) % (2 * half)] / (2 * l) as f64).sum::<f64>()
        };
        Self {
            cosines: (0..half).map(|j| libm::cos(angle(j))).collect(),
            series: (0..2 * half).map(series).collect(),
        }
    }

    pub(crate) fn half(&self) -> usize {
        self.cosines.len()
    }

    /// The matrix from phi at the points to the displacement at the points, for even phi.
    pub(crate) fn even_matrix(&self, kernel: &SurfaceKernel, b: f64) -> EliminationMatrix {
        let half = self.half();
        let constant = LN_2 - libm::log(b);
        let mut matrix = EliminationMatrix::new(half);
        for i in 0..half {
            for j in 0..=i {
                let logarithm = constant + self.series[i - j] + self.series[i + j + 1];
                let (x, s) = (b * self.cosines[i], b * self.cosines[j]);
                let smooth = 0.5 * (kernel.smooth(s - x) + kernel.smooth(s + x));
                let value = PI / half as f64 * (logarithm + smooth);
                matrix.set(i, j, value);
                matrix.set(j, i, value);
            }
        }
        matrix
    }

    /// The integral of the traction over the whole strip.
    pub(crate) fn total(&self, phi: &[f64]) -> f64 {
        PI / self.half() as f64 * phi.iter().sum::<f64>()
    }

    /// phi at the edge theta = 0, from its cosine series.
    pub(crate) fn edge(&self, phi: &[f64]) -> f64 {
        // Sum of the cosine polynomials that interpolate at the points: an alternating kernel.
        let half = self.half();
        let term = |(j, value): (usize, &f64)| {
            let angle = PI * (2 * j + 1) as f64 / (4 * half) as f64;
            let sign = if j % 2 == 0 { 1.0 } else { -1.0 };
            sign * value * libm::cos(angle) / libm::sin(angle)
        };
        phi.iter().enumerate().map(term).sum::<f64>() / half as f64
    }
}
