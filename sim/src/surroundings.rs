//! Where the parts around a body are at an instant and how they move: the finger's pad and the
//! table. Refuses to compute them; whoever evaluates contacts states them.

use glam::DMat3;
use taktil_mechanics::Pose;

use crate::contact::Surface;

/// Finger and table as a contact needs them; base frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surroundings {
    /// The sensor's frame.
    pub(crate) pad: Pose,
    /// The face of the finger's rubber.
    pub(crate) finger: Surface,
    /// The surface of the table.
    pub(crate) table: Surface,
    /// Axes of the table as columns: its x, its y and its normal.
    pub(crate) table_axes: DMat3,
}
