//! The force or penetration that a contact is solved for, in units of the solver.

/// Force or penetration that a contact is pressed to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Target {
    /// Force in units of the kernels; without it the penetration is prescribed.
    pub(crate) force: Option<f64>,
    /// Penetration in thicknesses at the place that the caller names, prescribed or, beside a
    /// force, the first guess.
    pub(crate) penetration: f64,
}

impl Target {
    /// A prescribed penetration.
    pub(crate) fn at_penetration(penetration: f64) -> Self {
        Self { force: None, penetration }
    }
}
