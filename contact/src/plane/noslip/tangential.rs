//! A cylinder without slip that was pressed on and then moved along x while its contact stays the
//! same: the tractions of that move, their rate by the descent, and the tension at the glued edges.
//! A real contact transmits no tension and would open there; this model reports how large the
//! tension is.

use super::super::Shape;
use super::super::glued::Chebyshev;
use super::super::rates::{Motion, TractionRate};
use super::super::spectrum::PointForce;
use super::super::surface_kernels::SurfaceKernels;
use super::{NoSlip, moved_points};
use crate::layer::Layer;
use core::f64::consts::PI;

/// Step of the half-width, in parts of it, with which derivatives by the half-width are
/// differenced.
const WIDTH_STEP: f64 = 2e-3;

/// Forces per mm of displacement along x of a glued strip of half-width `b` thicknesses.
pub(super) fn unit_move_forces(
    layer: &Layer,
    kernels: &SurfaceKernels,
    b: f64,
    points: usize,
) -> Vec<PointForce> {
    let strip = Chebyshev::new(points);
    let system = strip.system(kernels, b);
    let moved = strip.solve(&system, |_| 0.0, |_| 1.0);
    let modulus = PI * layer.shear_mpa() / (1.0 - layer.poisson);
    let (scale, t) = (modulus * PI / points as f64, layer.thickness_mm);
    let force = |(j, c): (usize, &f64)| [b * c * t, scale * moved.p[j], scale * moved.q[j]];
    strip.cosines.iter().enumerate().map(force).collect()
}

impl NoSlip {
    /// [`Self::rate`] of a contact that was pressed on and then moved along x by `dx_mm`: the
    /// deeper contact is the wider one, moved by the same distance. `more` multiplies the points
    /// and refines the steps, so that the difference shows the error.
    #[must_use]
    pub fn rate_moved(
        &self,
        shape: Shape,
        motion: Motion,
        dx_mm: f64,
        more: usize,
    ) -> TractionRate {
        let mut rate = self.rate(shape, motion, more);
        if motion != Motion::Z || dx_mm == 0.0 {
            return rate;
        }
        let kernels = SurfaceKernels::new(&self.layer.transfer());
        let (more, t) = (more.max(1), self.layer.thickness_mm);
        let b = self.half_width_mm / t;
        let step = WIDTH_STEP / more as f64 * b;
        for side in [1.0, -1.0] {
            let scale = side * dx_mm * self.widening / (2.0 * step * t);
            let forces =
                unit_move_forces(&self.layer, &kernels, b + side * step, more * moved_points(b));
            rate.forces.extend(forces.iter().map(|[x, p, q]| [*x, scale * p, scale * q]));
        }
        rate
    }

    /// Tension at the edges of the contact after a move of `dx_mm` along x, in N/mm: the largest
    /// tension that the outermost part on either side carries in sum.
    #[must_use]
    pub fn pull_n_mm(&self, dx_mm: f64) -> f64 {
        if dx_mm == 0.0 {
            return 0.0;
        }
        let mut forces = self.point_forces(dx_mm);
        forces.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let least = |forces: &mut dyn Iterator<Item = &PointForce>| {
            let mut sum = 0.0;
            forces.fold(0.0_f64, |least, force| {
                sum += force[1];
                least.min(sum)
            })
        };
        0.0 - least(&mut forces.iter()).min(least(&mut forces.iter().rev()))
    }
}
