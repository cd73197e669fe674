//! Contact of rigid bodies with rubber bonded to a rigid base: small strain, plane strain.
//!
//! Units in this module are mm, N and MPa (line loads N/mm), as in the literature on tactile
//! sensors; callers convert at its door. Frame: x along the surface, z up out of the layer, surface
//! at z = 0, base at z = -t; depths are positive downwards; compression is negative.
//!
//! - [`layer`]: the elastic layer and the exact transfer functions of its line loads.
//! - [`cylinder`]: a rigid cylinder rolling on it, tabulated for use inside a control period.
//!
//! What it refuses: everything not finite and positive, and geometry outside the theory's reach.
//! What it does not know: friction with slip, finite strain, viscosity, free ends of the layer.

pub mod cylinder;
pub mod layer;

/// A parameter that the theory cannot take: where it stands, what is wrong, what would help.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Invalid {
    /// Name of the parameter.
    pub place: &'static str,
    /// What is wrong with it, with its value.
    pub what: String,
    /// What to write instead.
    pub remedy: String,
}

impl core::fmt::Display for Invalid {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}: {}; {}", self.place, self.what, self.remedy)
    }
}

impl std::error::Error for Invalid {}

/// Refuses what is not finite and above zero.
pub(crate) fn positive(place: &'static str, value: f64) -> Result<(), Invalid> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(Invalid {
        place,
        what: format!("{value} is not a finite number above zero"),
        remedy: "give a finite number above zero".to_owned(),
    })
}
