//! A strip that sticks to the layer over its whole width and is moved along x: both tractions at
//! once, coupled through the layer.
//!
//! The tangential traction is even, the normal one odd. At the edges the exact tractions oscillate,
//! as those of every glued punch do unless nu = 0.5; the cosine series of [`super::collocation`]
//! smooths that out, which leaves the total load right to a few parts in a hundred thousand.

use super::collocation::{Collocation, points_for};
use super::kernel::{CouplingKernel, SurfaceKernel};
use super::layer::Transfer;
use super::numeric::elimination::EliminationMatrix;
use core::f64::consts::{FRAC_PI_2, PI};

/// The kernels of the problem.
pub(crate) struct StickingStrip<'a> {
    normal: &'a SurfaceKernel,
    along: SurfaceKernel,
    coupling: CouplingKernel,
    transfer: Transfer,
}

/// Sums over the cosine series, by the difference or the sum of two points' numbers. The points are
/// theta_i = (2 i + 1) pi/(4 half); theta_i - theta_j and theta_i + theta_j are whole multiples k
/// of pi/(2 half), k = i - j and i + j + 1.
struct CosineSums {
    /// sum over odd n of cos(n k pi/(2 half))/n.
    cosines: Vec<f64>,
    /// sum over even and over odd n > 0 of 2 sin(n k pi/(2 half))/n.
    sines: [Vec<f64>; 2],
}

impl CosineSums {
    fn new(half: usize) -> Self {
        let turn = 4 * half;
        let angle = |k: usize| FRAC_PI_2 * k as f64 / half as f64;
        let cosine: Vec<f64> = (0..turn).map(|k| libm::cos(angle(k))).collect();
        let sine: Vec<f64> = (0..turn).map(|k| libm::sin(angle(k))).collect();
        let sum = |circle: &[f64], first: usize, k: usize| -> f64 {
            (first..2 * half).step_by(2).map(|n| circle[n * k % turn] / n as f64).sum()
        };
        let sines = |first: usize| (0..2 * half).map(|k| 2.0 * sum(&sine, first, k)).collect();
        Self {
            cosines: (0..2 * half).map(|k| sum(&cosine, 1, k)).collect(),
            sines: [sines(2), sines(1)],
        }
    }

    /// sum over n of 4 sin(n theta_i) cos(n theta_j)/n, over even and over odd n.
    fn cross_sums(&self, i: usize, j: usize) -> [f64; 2] {
        [0, 1].map(|parity| {
            let sines = &self.sines[parity];
            let difference = sines[i.abs_diff(j)];
            sines[i + j + 1] + if i < j { -difference } else { difference }
        })
    }
}

impl<'a> StickingStrip<'a> {
    pub(crate) fn new(transfer: &Transfer, normal: &'a SurfaceKernel) -> Self {
        Self {
            normal,
            along: SurfaceKernel::new(|a| transfer.tangential_compliance(a)),
            coupling: CouplingKernel::new(transfer),
            transfer: *transfer,
        }
    }

    /// Tangential load per displacement of a strip of half-width `b` thicknesses, in units of the
    /// kernels.
    pub(crate) fn stiffness(&self, b: f64) -> f64 {
        let points = Collocation::new(points_for(b));
        let half = points.half();
        let series = CosineSums::new(half);
        let even = points.even_matrix(&self.along, b);
        let over_m = 1.0 / self.transfer.m;
        let mut matrix = EliminationMatrix::new(2 * half);
        for i in 0..half {
            for j in 0..half {
                let (x, s) = (b * points.cosines[i], b * points.cosines[j]);
                matrix.set(i, j, even.get(i, j));
                matrix.set(half + i, half + j, self.odd_entry(&series, (i, x), (j, s)));
                let [of_even, of_odd] = self.coupling_entry(&series, (i, x), (j, s));
                matrix.set(half + i, j, over_m * of_even);
                matrix.set(i, half + j, -over_m * of_odd);
            }
        }
        let mut sides = [vec![0.0; 2 * half]];
        sides[0][..half].fill(1.0);
        matrix.solve(&mut sides);
        points.total(&sides[0][..half])
    }

    /// Normal displacement at point i per odd pressure at point j.
    fn odd_entry(&self, series: &CosineSums, (i, x): (usize, f64), (j, s): (usize, f64)) -> f64 {
        let logarithm = series.cosines[i.abs_diff(j)] + series.cosines[i + j + 1];
        let smooth = 0.5 * (self.normal.smooth((s - x).abs()) - self.normal.smooth(s + x));
        PI / (series.cosines.len() / 2) as f64 * (logarithm + smooth)
    }

    /// The coupling kernel acting on an even and on an odd traction.
    fn coupling_entry(
        &self,
        series: &CosineSums,
        (i, x): (usize, f64),
        (j, s): (usize, f64),
    ) -> [f64; 2] {
        let half = series.cosines.len() / 2;
        let (near, far) = (self.coupling.smooth(x - s), self.coupling.smooth(x + s));
        let smooth = [0.5 * PI * (near + far), 0.5 * PI * (near - far)];
        let theta = PI * (2 * i + 1) as f64 / (4 * half) as f64;
        let [even, odd] = series.cross_sums(i, j);
        let step = [PI - 2.0 * theta - even, -odd];
        let scale = FRAC_PI_2 * self.transfer.n;
        [0, 1].map(|k| (smooth[k] + scale * step[k]) / half as f64)
    }
}
