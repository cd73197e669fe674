//! The fidelity of each part of the physics, by name: a scene pays for what it names and for
//! nothing else. [`build`](crate::build) refuses combinations that cannot work.

use serde::Deserialize;

use super::section::{Consistency, names, section};

section! {
    /// `[fidelity]`: arm, contact and integrator of a scene.
    #[derive(Copy, Default, Eq)]
    #[serde(default)]
    pub struct FidelityConfig {
        /// The model of the arm that moves the finger. Default `rigid+motors`.
        arm: ArmModel,
        /// The model of the contact between finger and pin. Default `line`.
        contact: ContactModel,
        /// The integrator of the motion. Default `auto`.
        integrator: Integrator,
    }
}

impl Consistency for FidelityConfig {}

names!(ArmModel, ContactModel, Integrator);

taktil_hal::explained! {
    /// The arm's model.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    pub enum ArmModel {
        /// An arm without masses: the joints follow `arm.trajectory_deg` exactly, whatever drives,
        /// brakes and contacts do. It serves studies of sensing, not of control.
        #[serde(rename = "kinematic")]
        Kinematic,
        /// Rigid links and rotors; the codes are torques, and there is no friction.
        #[serde(rename = "rigid")]
        Rigid,
        /// Rigid links and rotors with the friction of gears and bearings, which sticks.
        #[default]
        #[serde(rename = "rigid+motors")]
        RigidMotors,
        /// The same as `rigid+motors` behind compliant gears: each rotor turns beside its joint, on
        /// a spring of `arm.gear_stiffness_nm_rad`.
        #[serde(rename = "rigid+motors+compliance")]
        Compliant,
    }
}

taktil_hal::explained! {
    /// The contact between finger and pin.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    pub enum ContactModel {
        /// Plane strain in each row of tactels, with independent rows; the image is that of the
        /// normal pressure.
        #[default]
        #[serde(rename = "line")]
        Line,
        /// Pressure as `line`; the image also contains the normal stress that the tangential
        /// traction causes at the layer's base.
        #[serde(rename = "layer-2d")]
        Layer2d,
        /// The pin on the layer in three dimensions, solved at every image: rows influence each
        /// other, and the pin has ends. Between images each row keeps the ratio to its plane
        /// solution.
        #[serde(rename = "layer-3d")]
        Layer3d,
        /// As `layer-3d` with finer slices: the reference for the other models.
        #[serde(rename = "layer-3d-fine")]
        Layer3dFine,
    }
}

taktil_hal::explained! {
    /// The integrator.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    pub enum Integrator {
        /// `rk4` if all forces are smooth (no contact, no friction), else `implicit`.
        #[default]
        #[serde(rename = "auto")]
        Auto,
        /// Semi-implicit Euler, explicit in every force: first order, short steps.
        #[serde(rename = "euler")]
        Euler,
        /// Classical Runge-Kutta, fourth order; for an arm without contact and friction.
        #[serde(rename = "rk4")]
        Rk4,
        /// Two implicit stages, second order, damps what is stiffer than the step can follow.
        #[serde(rename = "implicit")]
        Implicit,
    }
}
