//! The cross-section of a pin or bar, and the check of its sizes.

use super::super::super::{Invalid, positive};
use super::strip::Section;

/// Cross-section of an indenter that is long in one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Profile {
    /// A cylinder lying on the layer, the exact circle.
    Cylinder {
        /// Radius, mm.
        radius_mm: f64,
    },
    /// A bar with a flat face and sharp edges.
    Bar {
        /// Width of the face, mm.
        width_mm: f64,
    },
}

impl Profile {
    /// In thicknesses, checked.
    pub(in super::super) fn section(self, thickness_mm: f64) -> Result<Section, Invalid> {
        match self {
            Self::Cylinder { radius_mm } => {
                positive("radius_mm", radius_mm)?;
                Ok(Section::Circle(radius_mm / thickness_mm))
            }
            Self::Bar { width_mm } => {
                positive("width_mm", width_mm)?;
                Ok(Section::Flat(0.5 * width_mm / thickness_mm))
            }
        }
    }
}
