//! The surface of a layer as cells (or mesh nodes) that carry forces, with its influence matrices:
//! the displacement of each place per force on each other, for the solver in [`super::frictional`].
//!
//! For the exact layer the traction is constant in each cell; logarithm and step of the kernels are
//! integrated in closed form, their smooth rest by Gauss's rule. Any other model of the layer, such
//! as a finite element mesh, gives its own matrices. The construction allocates. Fewer than two
//! cells, edges that do not ascend, and matrices of the wrong size are errors.

use super::surface_kernels::SurfaceKernels;
use crate::layer::Layer;
use crate::numeric::quadrature::THREE_POINT_NODE;
use crate::stack::Stack;
use crate::{Invalid, finite};
use core::f64::consts::{FRAC_PI_2, PI};

/// Most cells.
pub const CELLS_MAX: usize = 1000;
/// Largest width of a cell in thicknesses: a wider one does not resolve a contact.
const CELL_WIDTH_MAX_THICKNESSES: f64 = 20.0;

/// Places on the surface and their compliances, per unit force (N/mm): row i, column j is the
/// displacement of place i under a force at j. Displacements in mm, normal ones downwards.
#[derive(Clone, Debug)]
pub struct SurfaceCompliance {
    /// Places in mm, ascending.
    pub x_mm: Vec<f64>,
    /// Width of the surface that each place represents, in mm.
    pub width_mm: Vec<f64>,
    /// Descent per normal force.
    pub down_per_p: Vec<f64>,
    /// Descent per tangential force.
    pub down_per_q: Vec<f64>,
    /// Displacement along x per normal force.
    pub along_per_p: Vec<f64>,
    /// Displacement along x per tangential force.
    pub along_per_q: Vec<f64>,
}

impl SurfaceCompliance {
    /// Cells between `edges_mm` on the exact layer.
    ///
    /// # Errors
    /// A layer that its check refuses; fewer than 3 or more than [`CELLS_MAX`] + 1 edges; edges
    /// that are not finite or do not ascend.
    pub fn of_layer(layer: &Layer, edges_mm: &[f64]) -> Result<Self, Invalid> {
        layer.check()?;
        Self::from_kernels(layer, edges_mm, || Ok(SurfaceKernels::new(&layer.transfer())))
    }

    /// Cells on several bonded layers.
    ///
    /// # Errors
    /// As [`Self::of_layer`]; a surface layer too thin for the stack below it.
    pub fn of_stack(stack: &Stack, edges_mm: &[f64]) -> Result<Self, Invalid> {
        let kernels = || SurfaceKernels::of_stack(stack);
        Self::from_kernels(stack.surface_layer(), edges_mm, kernels)
    }

    fn from_kernels(
        layer: &Layer,
        edges_mm: &[f64],
        kernels: impl FnOnce() -> Result<SurfaceKernels, Invalid>,
    ) -> Result<Self, Invalid> {
        let n = edges_mm.len().saturating_sub(1);
        if !(2..=CELLS_MAX).contains(&n) {
            let what = format!("{n} cells");
            return Err(Invalid::new("edges_mm", what, "give 2 to 1000 cells"));
        }
        edges_mm.iter().try_for_each(|x| finite("edges_mm", *x))?;
        if !edges_mm.windows(2).all(|w| w[0] < w[1]) {
            let what = "the edges do not ascend".to_owned();
            return Err(Invalid::new("edges_mm", what, "sort them, each once"));
        }
        let kernels = kernels()?;
        let widest = edges_mm.windows(2).fold(0.0_f64, |most, w| most.max(w[1] - w[0]));
        if widest > CELL_WIDTH_MAX_THICKNESSES * layer.thickness_mm {
            let what = format!("{widest:e} mm on {:e} mm of layer", layer.thickness_mm);
            return Err(Invalid::new("edges_mm", what, "give cells of at most 20 thicknesses"));
        }
        let (t, m, n_step) = (layer.thickness_mm, kernels.transfer.m, kernels.transfer.n);
        let unit = 1.0 / (PI * layer.shear_mpa() / (1.0 - layer.poisson));
        let middle = |w: &[f64]| 0.5 * (w[0] + w[1]);
        let x_mm: Vec<f64> = edges_mm.windows(2).map(middle).collect();
        let width_mm: Vec<f64> = edges_mm.windows(2).map(|w| w[1] - w[0]).collect();
        let mut compliance = Self {
            x_mm,
            width_mm,
            down_per_p: Vec::with_capacity(n * n),
            down_per_q: Vec::with_capacity(n * n),
            along_per_p: Vec::with_capacity(n * n),
            along_per_q: Vec::with_capacity(n * n),
        };
        for i in 0..n {
            for j in 0..n {
                let (x, half) = (compliance.x_mm[i] / t, 0.5 * compliance.width_mm[j] / t);
                let (near, far) = (x - edges_mm[j] / t, x - edges_mm[j + 1] / t);
                let mean = |f: &dyn Fn(f64) -> f64| smooth_mean(f, 0.5 * (near + far), half);
                let log = -(log_integral(near) - log_integral(far)) / (2.0 * half);
                let step = ((near.min(half * 2.0).max(0.0)) - (-far).min(half * 2.0).max(0.0))
                    / (2.0 * half);
                let coupled = mean(&|x| kernels.coupling(x)) + n_step * FRAC_PI_2 * step;
                compliance.down_per_p.push(unit * (log + mean(&|x| kernels.normal(x))));
                compliance.down_per_q.push(unit * coupled / m);
                compliance.along_per_p.push(-unit * coupled / m);
                compliance.along_per_q.push(unit * (log + mean(&|x| kernels.along(x))));
            }
        }
        Ok(compliance)
    }

    /// Number of places.
    #[must_use]
    pub fn count(&self) -> usize {
        self.x_mm.len()
    }

    /// # Errors
    /// Matrices that do not fit the places.
    pub fn check(&self) -> Result<(), Invalid> {
        let n = self.count();
        let square = |m: &Vec<f64>| m.len() == n * n && m.iter().all(|v| v.is_finite());
        let matrices = [&self.down_per_p, &self.down_per_q, &self.along_per_p, &self.along_per_q];
        if n >= 2 && self.width_mm.len() == n && matrices.into_iter().all(square) {
            return Ok(());
        }
        let what = format!("{n} places with matrices of another size");
        Err(Invalid::new("bed", what, "give n by n matrices of finite numbers"))
    }
}

/// Integral of ln|x|.
fn log_integral(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x * (libm::log(x.abs()) - 1.0) }
}

/// Mean of a smooth function over a cell of half-width `half` thicknesses.
fn smooth_mean(f: &dyn Fn(f64) -> f64, middle: f64, half: f64) -> f64 {
    let parts = (libm::ceil(2.0 * half) as usize).max(1);
    let width = half / parts as f64;
    let part = |k: usize| {
        let at = middle - half + (2 * k + 1) as f64 * width;
        (5.0 * (f(at - THREE_POINT_NODE * width) + f(at + THREE_POINT_NODE * width)) + 8.0 * f(at))
            / 18.0
    };
    (0..parts).map(part).sum::<f64>() / parts as f64
}
