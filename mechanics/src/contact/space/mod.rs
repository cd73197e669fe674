//! Contact in three dimensions: rigid indenters on the bonded layer, and the image that an array of
//! tactels at its base makes of them. Small strain; indenters without friction, and in [`shear`]
//! tangential loads and friction in proportion to the pressure.
//!
//! Frame: x and y along the surface, z up; the array is centred on the origin, its columns along x
//! and its rows along y. Forces in N push the indenter into the layer, stresses are negative under
//! compression, penetrations are positive downwards.
//!
//! What it refuses: what is not finite, an indenter that would need more than it can resolve, a
//! force that no penetration reaches. What it does not know: free ends of the layer, stick and
//! slip.

mod across;
mod fourier;
pub mod infinite;
pub mod jacobian;
pub mod pin;
mod quadrature;
pub mod radial;
pub mod scene;
pub mod shear;
pub mod sphere;
pub mod surface;
mod table;
pub mod tactels;

use super::{Invalid, finite};

/// What is prescribed of an indenter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
    /// Normal force in N, at least 0; for an infinite line N per mm.
    ForceN(f64),
    /// Penetration in mm of the point named by the indenter; 0 or less is no contact.
    PenetrationMm(f64),
}

impl Drive {
    /// The number, when it can be one.
    fn check(self, thickness_mm: f64) -> Result<f64, Invalid> {
        match self {
            Self::ForceN(force) => {
                finite(self.place(), force)?;
                if force < 0.0 {
                    let what = format!("{force} pulls; rubber does not hold a rigid body");
                    return Err(Invalid::new(self.place(), what, "give 0 or more"));
                }
                Ok(force)
            }
            Self::PenetrationMm(delta) => {
                finite(self.place(), delta)?;
                if delta >= thickness_mm {
                    let what = format!("{delta} mm is the layer's thickness or more");
                    return Err(Invalid::new(self.place(), what, "give less"));
                }
                Ok(delta)
            }
        }
    }

    fn place(self) -> &'static str {
        match self {
            Self::ForceN(_) => "force_n",
            Self::PenetrationMm(_) => "penetration_mm",
        }
    }
}

/// What is wrong when a larger table would help.
const BEYOND_TABLE: &str = "it needs a penetration beyond the table";

/// Accuracy against time; each solver states what it measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// For control ticks.
    Fast,
    /// Better than a tenth of a percent.
    Default,
    /// As good as the method.
    Fine,
}
