//! Contact of rigid bodies with rubber bonded to a rigid base: small strain, in plane strain and in
//! three dimensions.
//!
//! Units in this module are mm, N and MPa (line loads N/mm), as in the literature on tactile
//! sensors; callers convert at its door. Frame: x along the surface, z up out of the layer, surface
//! at z = 0, base at z = -t; depths are positive downwards; compression is negative; a normal load
//! P > 0 pushes the layer down, a tangential load Q > 0 pushes it along +x.
//!
//! - [`layer`]: the elastic layer and the exact transfer functions at its surface and its base.
//! - [`field`]: stresses and displacements of a line load at any depth, layer or half plane.
//! - [`half_plane`]: closed forms of the half plane; [`stack`]: several bonded layers.
//! - [`plane`]: rigid indenters on the layer in plane strain; [`fem`]: its finite elements.
//! - [`cylinder`]: a rigid cylinder rolling on it, tabulated for use inside a control period.
//! - [`space`]: contact in three dimensions and the image that an array of tactels makes of it.
//! - [`features`]: features of stress distributions and of images.
//!
//! What it refuses: everything not finite and positive, sizes and loads beyond 1e30, and geometry
//! outside the theory's reach.
//! What it does not know: finite strain, viscosity; free ends of the layer outside [`fem`].

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
pub mod space;
pub mod stack;
mod stick;
mod wave_grid;

/// A parameter that the theory cannot take: where it stands, what is wrong, what would help.
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

/// Largest number that this module takes; sizes are taken down to its inverse. Their powers and
/// products then stay numbers.
pub(crate) const LARGEST: f64 = 1e30;

/// Refuses what is not finite and above zero, and what no size can be.
pub(crate) fn positive(place: &str, value: f64) -> Result<(), Invalid> {
    if (1.0 / LARGEST..=LARGEST).contains(&value) {
        return Ok(());
    }
    if value.is_finite() && value > 0.0 {
        let what = format!("{value:e} is beyond sense");
        return Err(Invalid::new(place, what, "give a number between 1e-30 and 1e30"));
    }
    let what = format!("{value} is not a finite number above zero");
    Err(Invalid::new(place, what, "give a finite number above zero"))
}

/// Refuses what is not finite or beyond [`LARGEST`].
pub(crate) fn finite(place: &str, value: f64) -> Result<(), Invalid> {
    if value.abs() <= LARGEST {
        return Ok(());
    }
    number(place, value)?;
    let what = format!("{value:e} is beyond sense");
    Err(Invalid::new(place, what, "give a number between -1e30 and 1e30"))
}

/// Refuses what is not finite and nothing else, for fields in closed form.
pub(crate) fn number(place: &str, value: f64) -> Result<(), Invalid> {
    if value.is_finite() {
        return Ok(());
    }
    Err(Invalid::new(place, format!("{value} is not a finite number"), "give a finite number"))
}
