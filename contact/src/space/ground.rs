//! What loads on the surface stand on: one bonded layer, or several of different rubber. Its
//! transfer functions of the wave number are in units of the layer at the surface, whose closed
//! forms near a load are those of the whole.
//!
//! Along its wave vector a traction is the plane problem's, [`super::super::layer`]'s and
//! [`super::super::stack`]'s; across it a layer gives way by tanh(k t)/(G k), several as in
//! [`super::super::antiplane`].
//!
//! It refuses layers that their check refuses, and stacks whose fields die too far off.

use super::super::Invalid;
use super::super::layer::{Layer, Transfer};
use super::super::stack::Stack;
use crate::wave_grid::FIELD_REACH;

/// Wave numbers in units of a layer's thickness at which its base function, and what its surface
/// functions differ by from their closed forms, have fallen under 1e-15.
const WAVE_NUMBER_CUTOFFS: [f64; 2] = [40.0, 21.0];
/// A stack's base functions against a layer's: stiff layers carry short waves a bit deeper.
const STACK_CUTOFF_FACTOR: f64 = 1.1;

/// A layer or a stack.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ground<'a> {
    pub(super) sizes: Sizes,
    transfer: Transfer,
    stack: Option<&'a Stack>,
    /// Where fields have died, in thicknesses of the layer at the surface.
    pub(super) reach: f64,
}

/// Sizes of what loads stand on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    /// The layer at the surface.
    pub(super) surface: Layer,
    /// From the surface to the base, mm.
    pub(super) thickness_mm: f64,
    /// Fields die along the surface in so many mm as they do in one thickness of a layer.
    pub(super) spread_mm: f64,
}

impl<'a> Ground<'a> {
    pub(super) fn layer(layer: &Layer) -> Result<Self, Invalid> {
        layer.check()?;
        let t = layer.thickness_mm;
        let sizes = Sizes { surface: *layer, thickness_mm: t, spread_mm: t };
        Ok(Self { sizes, transfer: layer.transfer(), stack: None, reach: FIELD_REACH })
    }

    pub(super) fn stack(stack: &'a Stack) -> Result<Self, Invalid> {
        if let [layer] = stack.layers() {
            return Self::layer(layer);
        }
        let surface = *stack.surface_layer();
        let reach = stack.reach()?;
        let thickness_mm = stack.thickness_mm();
        let spread_mm = (reach * surface.thickness_mm / FIELD_REACH).max(thickness_mm);
        let sizes = Sizes { surface, thickness_mm, spread_mm };
        Ok(Self { sizes, transfer: surface.transfer(), stack: Some(stack), reach })
    }

    /// M/a, T/a and N of [`Transfer`] at the wave number a.
    fn surface(&self, a: f64, which: usize) -> Option<f64> {
        self.stack.map(|stack| stack.surface_compliances(a)[which])
    }

    /// M/a.
    pub(super) fn normal(&self, a: f64) -> f64 {
        self.surface(a, 0).unwrap_or_else(|| self.transfer.normal_compliance(a))
    }

    /// T/a.
    pub(super) fn tangential(&self, a: f64) -> f64 {
        self.surface(a, 1).unwrap_or_else(|| self.transfer.tangential_compliance(a))
    }

    /// N.
    pub(super) fn coupling(&self, a: f64) -> f64 {
        self.surface(a, 2).unwrap_or_else(|| self.transfer.coupling(a))
    }

    /// N of the shortest waves.
    pub(super) fn coupling_far_out(&self) -> f64 {
        self.transfer.n
    }

    /// Displacement per tangential traction across its wave vector: tanh(a)/a of a layer.
    pub(super) fn across(&self, a: f64) -> f64 {
        self.stack.map_or_else(|| tanh_over(a), |stack| stack.across_compliance(a))
    }

    /// Normal stress at the base per pressure.
    pub(super) fn base(&self, a: f64) -> f64 {
        let Some(stack) = self.stack else { return self.transfer.base_normal(a) };
        stack.stress_transforms(self.wave(a), self.sizes.thickness_mm).0
    }

    /// The same per tangential traction, divided by i.
    pub(super) fn base_from_tangential(&self, a: f64) -> f64 {
        let Some(stack) = self.stack else {
            return self.transfer.base_normal_from_tangential(a);
        };
        // Odd in the wave number.
        if a == 0.0 {
            0.0
        } else {
            -stack.stress_transforms(self.wave(a), self.sizes.thickness_mm).1
        }
    }

    /// Wave number in 1/mm.
    fn wave(&self, a: f64) -> f64 {
        a / self.sizes.surface.thickness_mm
    }

    /// Where the base functions, and what the surface's leave over, have fallen under 1e-15.
    pub(super) fn cutoffs(&self) -> [f64; 2] {
        let Some(_) = self.stack else { return WAVE_NUMBER_CUTOFFS };
        let Sizes { surface, thickness_mm, .. } = self.sizes;
        [
            STACK_CUTOFF_FACTOR * WAVE_NUMBER_CUTOFFS[0] * surface.thickness_mm / thickness_mm,
            WAVE_NUMBER_CUTOFFS[1],
        ]
    }
}

/// tanh(a)/a.
pub(super) fn tanh_over(a: f64) -> f64 {
    if a > 0.0 { libm::tanh(a) / a } else { 1.0 }
}
