//! The finger's pad as the contacts with objects see it.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;

use crate::geometry::ArrayGeometry;
use crate::rubber;
use crate::scene::fidelity::ContactModel;
use crate::scene::{Invalid, RubberConfig, WorldConfig};
use crate::spatial::PadSection;

/// Accuracy of the solution of edges in three dimensions, for scenes that ask for it.
pub(super) fn spatial_accuracy(world: &WorldConfig) -> Option<Accuracy> {
    match world.fidelity.contact {
        ContactModel::Layer3d => Some(Accuracy::Fast),
        ContactModel::Layer3dFine => Some(Accuracy::Default),
        ContactModel::Line | ContactModel::Layer2d => None,
    }
}

/// Place of the pad's rubber in the scene, for errors.
const RUBBER: &str = "finger.rubber";

/// The layer of the finger's rubber.
pub(super) fn pad_layer(config: &RubberConfig) -> Result<Layer, Invalid> {
    rubber::layer(config).map_err(rubber::at_place(RUBBER))
}

/// The finger's pad.
pub(super) fn finger_pad<'a>(rubber: &'a RubberConfig, array: &'a ArrayGeometry) -> PadSection<'a> {
    PadSection { array, array_place: "tactile", rubber, rubber_place: RUBBER }
}
