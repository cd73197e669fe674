//! Laws: from what an image says to a displacement (dx, dz, dtheta_x, dtheta_z) of the sensor in
//! its own frame (mm, mm, mrad, mrad). Each is a pure function in a file of its own; a scene names
//! the one it wants. Refuses devices, joints and time other than what it is told.
//!
//! Signs follow from geometry ([`SIGNS`]):
//! - x: a sensor that moves by +x over a pin that rolls takes the pin along by half of it, so the
//!   contact moves by -1/2 in the sensor: x_c falls.
//! - z: points out of the face; +z presses and M0 grows.
//! - theta_x: a turn about x moves the face at +y along +z (x cross y = z), so the load grows
//!   there: M_x grows.
//! - theta_z: a turn of the sensor by +a about z turns the image by -a: theta_z falls.

pub mod hybrid_force;
pub mod model;
pub mod projector_pid;
pub mod task_frame;
pub mod thesis;

use serde::Deserialize;
use taktil_mechanics::Joints;

/// Signs of the diagonal of the feature Jacobian for (x_c, M0, M_x, theta_z).
pub const SIGNS: [f64; 4] = [-1.0, 1.0, 1.0, -1.0];

taktil_rtcore::explained! {
    /// The laws that a scene may name.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Name {
        /// The diagonal Jacobian of 1994.
        #[default]
        Thesis,
        /// PID on selected features (Li et al. 2013).
        ProjectorPid,
        /// The coupled Jacobian of the contact, delay and table motion observed.
        Model,
        /// The wrist's force and centre of pressure.
        HybridForce,
        /// The wrist's force, with the centre of pressure and the direction from touch.
        HybridForceTouch,
        /// The task that the scene describes.
        TaskFrame,
    }
}

impl Name {
    /// Every law that rolls a pin.
    pub const ALL: [Name; 5] =
        [Name::Thesis, Name::ProjectorPid, Name::Model, Name::HybridForce, Name::HybridForceTouch];

    /// As a scene writes it.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Name::Thesis => "thesis",
            Name::ProjectorPid => "projector-pid",
            Name::Model => "model",
            Name::HybridForce => "hybrid-force",
            Name::HybridForceTouch => "hybrid-force-touch",
            Name::TaskFrame => "task-frame",
        }
    }

    /// The law reads the port `wrench`.
    #[must_use]
    pub const fn feels_the_wrist(self) -> bool {
        matches!(self, Name::HybridForce | Name::HybridForceTouch)
    }
}

/// A displacement (mm, mm, mrad, mrad) as a small motion of the tool frame `[v; w]` (m, rad); y and
/// theta_y are not the law's.
#[must_use]
pub fn tool_motion(displacement: &[f64; 4]) -> Joints {
    let [x, z, theta_x, theta_z] = displacement.map(|value| value * 1e-3);
    Joints::new(x, 0.0, z, theta_x, 0.0, theta_z)
}

#[cfg(test)]
mod tests;
