//! The fidelity of each part of the physics, by name: a scene pays for what it names and for
//! nothing else. [`build`](crate::build) refuses combinations that cannot work.

use serde::Deserialize;

use super::section::{Consistency, names, section};

section! {
    /// `[fidelity]`: arm, contact and integrator of a scene.
    #[derive(Copy, Default, Eq)]
    #[serde(default)]
    pub struct FidelityConfig {
        /// What moves the finger. Default `rigid+motors`.
        arm: ArmModel,
        /// What finger and pin feel of each other. Default `line`.
        contact: ContactModel,
        /// How time passes. Default `auto`.
        integrator: Integrator,
    }
}

impl Consistency for FidelityConfig {}

names!(ArmModel, ContactModel, Integrator);

taktil_hal::explained! {
    /// The arm's model.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    pub enum ArmModel {
        /// No masses at all: the joints follow `arm.trajectory_deg` exactly, whatever drives,
        /// brakes and contacts do. For what is felt, not for how it is servoed.
        #[serde(rename = "kinematic")]
        Kinematic,
        /// Rigid links and rotors; the codes are torques, nothing rubs.
        #[serde(rename = "rigid")]
        Rigid,
        /// Rigid links and rotors with the friction of gears and bearings, which sticks.
        #[default]
        #[serde(rename = "rigid+motors")]
        RigidMotors,
        /// The same as `rigid+motors` behind gears that give way: each rotor turns beside its
        /// joint, on a spring of `arm.gear_stiffness_nm_rad`.
        #[serde(rename = "rigid+motors+compliance")]
        Compliant,
    }
}

taktil_hal::explained! {
    /// The contact between finger and pin.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    pub enum ContactModel {
        /// Plane strain in each row of tactels, rows on their own; the image is that of the normal
        /// pressure.
        #[default]
        #[serde(rename = "line")]
        Line,
        /// Pressure as `line`, and the image also shows what the tangential traction presses and
        /// lifts at the layer's base.
        #[serde(rename = "layer-2d")]
        Layer2d,
        /// The pin on the layer in three dimensions, solved at every image: rows lean on each
        /// other, ends are ends. Between images each row keeps the ratio to its plane solution.
        #[serde(rename = "layer-3d")]
        Layer3d,
        /// As `layer-3d` with finer slices: what the others are measured against.
        #[serde(rename = "layer-3d-fine")]
        Layer3dFine,
    }
}

taktil_hal::explained! {
    /// The integrator.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    pub enum Integrator {
        /// `rk4` where all is smooth (nothing touches, nothing rubs), `implicit` elsewhere.
        #[default]
        #[serde(rename = "auto")]
        Auto,
        /// Semi-implicit Euler, explicit in every force: first order, short steps.
        #[serde(rename = "euler")]
        Euler,
        /// Classical Runge-Kutta, fourth order; for an arm that neither touches nor rubs.
        #[serde(rename = "rk4")]
        Rk4,
        /// Two implicit stages, second order, damps what is stiffer than the step can follow.
        #[serde(rename = "implicit")]
        Implicit,
    }
}
