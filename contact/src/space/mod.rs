//! Solves contacts in three dimensions: rigid indenters on the bonded layer, and the image that an
//! array of tactels at its base measures. Strains are small. Indenters are frictionless, except in
//! [`shear`] (tangential loads, and friction in proportion to the pressure) and [`grip`] (stick and
//! slip).
//!
//! Frame: x and y along the surface, z up; the array is centred on the origin, its columns along x
//! and its rows along y. Forces in N push the indenter into the layer, stresses are negative under
//! compression, penetrations are positive downwards.
//!
//! Numbers that are not finite, indenters beyond the resolution of the tables, and forces that no
//! penetration reaches are errors. The layer is infinite: its free edges are not modelled.

mod across;
mod array;
mod cubic;
pub mod field;
mod fourier;
pub mod grip;
mod ground;
pub mod infinite;
pub mod jacobian;
mod motion;
pub mod pin;
mod proportional_friction;
pub mod radial;
mod refusal;
pub mod scene;
pub mod shear;
pub mod sphere;
mod straight;
pub mod surface;
mod table;
pub mod tactels;

use crate::Accuracy;
pub use refusal::{Refusal, Why};

/// The quantity that is prescribed for an indenter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prescribed {
    /// Normal force in N, at least 0; for an infinite line N per mm.
    ForceN(f64),
    /// Penetration in mm of the point named by the indenter; 0 or less is no contact.
    PenetrationMm(f64),
}

/// The text of the error that a larger table would avoid.
const BEYOND_TABLE: &str = "it needs a penetration beyond the table";
