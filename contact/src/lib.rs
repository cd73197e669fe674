//! Contact of rigid bodies with rubber bonded to a rigid base: small strain, in plane strain and in
//! three dimensions.
//!
//! The image that 16 by 16 tactels under a layer of rubber make of a pin, 8 mm in diameter, that is
//! pressed on with 20 N, moved aside and turned:
//!
//! ```
//! use taktil_contact::Accuracy;
//! use taktil_contact::features::{Part, image_features};
//! use taktil_contact::layer::Layer;
//! use taktil_contact::space::Prescribed;
//! use taktil_contact::space::pin::PlanarPose;
//! use taktil_contact::space::scene::{Pose, Scene, Shape};
//! use taktil_contact::space::tactels::{Array, Sampling};
//!
//! let rubber = Layer::new(0.8, 27.58, 0.49)?; // mm, MPa, Poisson's ratio
//! let array = Array { rows: 16, cols: 16, pitch_mm: 1.6 };
//! let pin = Shape::Cylinder { radius_mm: 4.0, length_mm: Some(12.0) };
//! let mut scene = Scene::new(&rubber, pin, &array, Sampling::Area, Accuracy::Fast)?;
//!
//! let planar = PlanarPose { x_mm: 1.5, y_mm: -0.5, rot_rad: 0.3 };
//! scene.press(Prescribed::ForceN(20.0), Pose { planar, tilt_rad: 0.0 })?;
//! let mut image = vec![0.0; array.len()]; // MPa, negative under compression
//! scene.image(&mut image)?;
//!
//! // The tactels together carry the force, and the image is centred where the pin stands.
//! let features = image_features(&array, &image, Part::Full)?;
//! assert!((features.m0 / -20.0 - 1.0).abs() < 0.01, "{features:?}");
//! assert!(features.xc.is_some_and(|x_mm| (x_mm - 1.5).abs() < 0.02), "{features:?}");
//! # Ok::<(), taktil_contact::Invalid>(())
//! ```
//!
//! Units in this crate are mm, N and MPa (line loads N/mm), as in the literature on tactile
//! sensors; callers convert where they call. Frame: x along the surface, z up out of the layer,
//! surface at z = 0, base at z = -t; depths are positive downwards; compression is negative; a
//! normal load P > 0 pushes the layer down, a tangential load Q > 0 pushes it along +x.
//!
//! - [`Accuracy`]: how well a contact is solved, and what each choice promises.
//! - [`layer`]: the elastic layer and the exact transfer functions at its surface and its base.
//! - [`field`]: stresses and displacements of a line load at any depth, layer or half plane.
//! - [`half_plane`]: closed forms of the half plane; [`stack`]: several bonded layers.
//! - [`plane`]: rigid indenters on the layer in plane strain; [`fem`]: its finite elements.
//! - [`cylinder`]: a rigid cylinder rolling on it, tabulated for use inside a control period.
//! - [`solved`]: such tables that were solved lately.
//! - [`space`]: contact in three dimensions and the image that an array of tactels makes of it.
//! - [`features`]: features of stress distributions and of images.
//!
//! Parameters that are not finite, sizes that are not above zero, sizes and loads beyond 1e30, and
//! geometry outside the theory's reach are refused with an [`Invalid`]. Finite strain and viscosity
//! are not modelled; free ends of the layer are modelled in [`fem`] only.

mod accuracy;
mod antiplane;
mod collocation;
pub mod cylinder;
pub mod features;
pub mod fem;
pub mod field;
pub mod half_plane;
mod kernel;
pub mod layer;
mod numeric;
pub mod plane;
mod share;
pub mod solved;
pub mod space;
pub mod stack;
mod sticking_strip;
mod wave_grid;

pub use accuracy::Accuracy;

/// A parameter that the theory does not cover: its name, what is wrong with it, and the remedy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Invalid {
    /// Name of the parameter.
    pub place: String,
    /// What is wrong with it, with its value.
    pub what: String,
    /// What to write instead.
    pub remedy: String,
}

impl Invalid {
    pub(crate) fn new(place: &str, what: String, remedy: &str) -> Self {
        Self { place: place.to_owned(), what, remedy: remedy.to_owned() }
    }
}

impl core::fmt::Display for Invalid {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}: {}; {}", self.place, self.what, self.remedy)
    }
}

impl std::error::Error for Invalid {}

/// Largest magnitude of a parameter, and inverse of the smallest size: powers and products of them
/// then stay finite.
pub(crate) const MAGNITUDE_MAX: f64 = 1e30;

/// Refuses a size that is not finite and above zero, or is outside 1e-30 to 1e30.
pub(crate) fn positive(place: &str, value: f64) -> Result<(), Invalid> {
    if (1.0 / MAGNITUDE_MAX..=MAGNITUDE_MAX).contains(&value) {
        return Ok(());
    }
    if value.is_finite() && value > 0.0 {
        let what = format!("{value:e} is beyond sense");
        return Err(Invalid::new(place, what, "give a number between 1e-30 and 1e30"));
    }
    let what = format!("{value} is not a finite number above zero");
    Err(Invalid::new(place, what, "give a finite number above zero"))
}

/// Refuses a number that is not finite or beyond [`MAGNITUDE_MAX`].
pub(crate) fn finite(place: &str, value: f64) -> Result<(), Invalid> {
    if value.abs() <= MAGNITUDE_MAX {
        return Ok(());
    }
    number(place, value)?;
    let what = format!("{value:e} is beyond sense");
    Err(Invalid::new(place, what, "give a number between -1e30 and 1e30"))
}

/// Refuses a number that is not finite; for fields in closed form, which take any magnitude.
pub(crate) fn number(place: &str, value: f64) -> Result<(), Invalid> {
    if value.is_finite() {
        return Ok(());
    }
    Err(Invalid::new(place, format!("{value} is not a finite number"), "give a finite number"))
}
