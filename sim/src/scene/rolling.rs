//! `[finger]` and `[pin]`: the rubber on the fingertip and the pin that it rolls. Sizes and masses
//! have to be positive.

use super::section::{Consistency, section};

section! {
    /// A rubber layer bonded to a rigid base.
    #[derive(Copy)]
    pub struct RubberConfig {
        /// Thickness (mm).
        thickness_mm: f64 [0.05, 100.0],
        /// Young's modulus (MPa).
        youngs_mpa: f64 [0.01, 1000.0],
        /// Poisson's ratio, below 0.5.
        poisson: f64 [0.0, 0.4999],
        /// Kelvin-Voigt relaxation time: damping = stiffness x this (ms). Default 0.3.
        #[serde(default = "relaxation_ms_default")]
        relaxation_ms: f64 [0.0, 100.0],
    }
}

fn relaxation_ms_default() -> f64 {
    0.3
}

impl Consistency for RubberConfig {}

section! {
    /// `[finger]`
    #[derive(Copy)]
    #[serde(default)]
    pub struct FingerConfig {
        /// Layer over the tactels. Default 0.8 mm, 2 MPa, 0.49. The thesis's finite elements use
        /// 27.58 MPa (4000 psi), ten times a rubber that one would put on a fingertip: 15 N would
        /// press a 23 mm pin in by 7 um only, and steps would have to be much shorter. That value
        /// is allowed, with a heavier pin or a shorter step.
        rubber: RubberConfig,
        /// Coulomb coefficient against the pin. Default 0.8.
        friction: f64 [0.0, 5.0],
    }
}

impl Consistency for FingerConfig {}

impl Default for FingerConfig {
    fn default() -> FingerConfig {
        let rubber =
            RubberConfig { thickness_mm: 0.8, youngs_mpa: 2.0, poisson: 0.49, relaxation_ms: 0.3 };
        FingerConfig { rubber, friction: 0.8 }
    }
}

section! {
    /// `[pin]`
    #[derive(Copy)]
    #[serde(default)]
    pub struct PinConfig {
        /// Whether there is a pin. Default true.
        present: bool,
        /// Radius (mm). Default 23.
        radius_mm: f64 [1.0, 500.0],
        /// Length (mm). Default 80.
        length_mm: f64 [1.0, 1000.0],
        /// Mass (kg), as a solid cylinder. Default 0.2: a plastic bar of the default size.
        mass_kg: f64 [1e-3, 100.0],
        /// Start of the pin's centre along x0, counted from the finger's start (mm). Default 0.
        x_mm: f64 [-1000.0, 1000.0],
        /// Start along y0, counted from the finger's start (mm). Default 0.
        y_mm: f64 [-1000.0, 1000.0],
        /// Start of the axis about the table's normal, from the table's y axis (deg). Default 0.
        yaw_deg: f64 [-70.0, 70.0],
        /// Whether a fixture holds the pin to its place on the table (spring and damper in the
        /// table's plane and against rolling) until the finger has first pressed with
        /// `fixture_release_n`. Default true.
        fixture: bool,
        /// The finger's normal force at which the fixture releases the pin for the rest of the run
        /// (N). Default 5.
        fixture_release_n: f64 [1e-3, 1000.0],
        /// Rolling resistance: moment = this x normal force, on either side (mm). Default 0.
        rolling_resistance_mm: f64 [0.0, 1.0],
    }
}

impl Consistency for PinConfig {}

impl Default for PinConfig {
    fn default() -> PinConfig {
        PinConfig {
            present: true,
            radius_mm: 23.0,
            length_mm: 80.0,
            mass_kg: 0.2,
            x_mm: 0.0,
            y_mm: 0.0,
            yaw_deg: 0.0,
            fixture: true,
            fixture_release_n: 5.0,
            rolling_resistance_mm: 0.0,
        }
    }
}
