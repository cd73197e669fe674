//! Gives the transfer functions of one bonded layer, or of a stack of layers of different rubber,
//! under one interface. They are in units of the layer at the surface: near a load a stack behaves
//! as that layer does.
//!
//! The component of a traction along its wave vector follows the plane problem of
//! [`super::super::layer`] and [`super::super::stack`]. The component across the wave vector is the
//! antiplane problem: tanh(k t)/(G k) for one layer, [`super::super::antiplane`] for several.

use super::super::Invalid;
use super::super::layer::{Layer, Transfer};
use super::super::stack::Stack;
use crate::wave_grid::FIELD_REACH;

/// Wave numbers in units of a layer's thickness beyond which its base function, and the difference
/// of its surface functions from their closed forms, are below 1e-15.
const WAVE_NUMBER_CUTOFFS: [f64; 2] = [40.0, 21.0];
/// Factor on the cutoff of the base functions of a stack, because stiff layers let short waves
/// through to a slightly greater depth than soft ones do.
const STACK_CUTOFF_FACTOR: f64 = 1.1;

/// A layer or a stack.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ground<'a> {
    pub(super) sizes: Sizes,
    transfer: Transfer,
    stack: Option<&'a Stack>,
    /// Distance at which the fields have decayed, in thicknesses of the layer at the surface.
    pub(super) reach: f64,
}

/// Sizes of a layer or a stack.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    /// The layer at the surface.
    pub(super) surface: Layer,
    /// From the surface to the base, mm.
    pub(super) thickness_mm: f64,
    /// Decay length of the fields along the surface, mm: one thickness for a single layer.
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

    /// M/a, T/a or N (`which` 0, 1 or 2) of a stack at the wave number a; absent for one layer.
    fn surface(&self, a: f64, which: usize) -> Option<f64> {
        self.stack.map(|stack| stack.surface_compliances(a)[which])
    }

    /// Normal compliance M/a.
    pub(super) fn normal(&self, a: f64) -> f64 {
        self.surface(a, 0).unwrap_or_else(|| self.transfer.normal_compliance(a))
    }

    /// Tangential compliance T/a along the wave vector.
    pub(super) fn tangential(&self, a: f64) -> f64 {
        self.surface(a, 1).unwrap_or_else(|| self.transfer.tangential_compliance(a))
    }

    /// Coupling N of normal and tangential displacement.
    pub(super) fn coupling(&self, a: f64) -> f64 {
        self.surface(a, 2).unwrap_or_else(|| self.transfer.coupling(a))
    }

    /// Limit of N for short waves.
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

    /// Normal stress at the base per tangential traction, divided by i.
    pub(super) fn base_from_tangential(&self, a: f64) -> f64 {
        let Some(stack) = self.stack else {
            return self.transfer.base_normal_from_tangential(a);
        };
        // The function is odd in the wave number; the stack's transform is not defined at 0.
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

    /// Wave numbers beyond which the base functions, and the remainders of the surface functions,
    /// are below 1e-15.
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
