//! Places and motions of the finger's pad and of the table, as the contacts of a body need them.
//! Other modules compute them.

use glam::DMat3;
use taktil_mechanics::Pose;

use crate::contact::Surface;

/// Places and motions of finger and table in the base frame.
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
