//! The elastic layer bonded to a rigid base and the exact transfer functions of its line loads.

use super::{Invalid, positive};

/// A homogeneous isotropic layer, bonded to a rigid base, infinite along its surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layer {
    /// Thickness t in mm.
    pub thickness_mm: f64,
    /// Young's modulus E in MPa.
    pub youngs_mpa: f64,
    /// Poisson's ratio, above 0 up to and including 0.5.
    pub poisson: f64,
}

impl Layer {
    /// Checks and keeps the three constants; refuses NaN, infinity, zero, less, and a Poisson's
    /// ratio outside (0, 0.5].
    pub fn new(thickness_mm: f64, youngs_mpa: f64, poisson: f64) -> Result<Self, Invalid> {
        let layer = Self { thickness_mm, youngs_mpa, poisson };
        layer.check()?;
        Ok(layer)
    }

    /// The checks of [`Layer::new`], for a layer that was filled in by hand.
    pub fn check(&self) -> Result<(), Invalid> {
        positive("thickness_mm", self.thickness_mm)?;
        positive("youngs_mpa", self.youngs_mpa)?;
        positive("poisson", self.poisson)?;
        if self.poisson > 0.5 {
            return Err(Invalid {
                place: "poisson",
                what: format!("{} is above 0.5", self.poisson),
                remedy: "give a ratio in (0, 0.5]; rubber is 0.49 to 0.5".to_owned(),
            });
        }
        Ok(())
    }
}
