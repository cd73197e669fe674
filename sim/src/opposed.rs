//! The pad of the second fingertip under the pin, carried by the table's mount. The pin's contact
//! with it is computed as the contact with the table, on the rows of a pad instead of an infinite
//! plane.

use glam::{DMat3, DVec3};
use taktil_mechanics::Pose;
use taktil_mechanics::spatial::rotation_z;

use crate::contact::{ContactLine, Surface};
use crate::geometry::ArrayGeometry;
use crate::scene::OpposedConfig;
use crate::spatial::SpatialSolver;
use crate::surroundings::Surroundings;

/// The pad on its mount.
#[derive(Clone, Debug)]
pub(crate) struct OpposedPad {
    /// Middle of its face and its axes, relative to the mount.
    place: DVec3,
    turn: DMat3,
    /// Its tactile array.
    pub(crate) array: ArrayGeometry,
    /// Cosine between the sensor's x and the rolling direction at the latest evaluation.
    pub(crate) rolling_cosine: f64,
    /// The solver of the contact in three dimensions, for scenes that ask for it.
    pub(crate) spatial: Option<Box<SpatialSolver>>,
}

impl OpposedPad {
    /// Puts the pad at the configured x and y on the mount's surface as it stands at the start.
    pub(crate) fn new(
        config: &OpposedConfig,
        finger: DVec3,
        axes: &DMat3,
        surface: &Surface,
        spatial: Option<Box<SpatialSolver>>,
    ) -> OpposedPad {
        let (x, y) = (finger.x + 1e-3 * config.x_mm, finger.y + 1e-3 * config.y_mm);
        let (n, o) = (surface.normal, surface.origin);
        let z = o.z - (n.x * (x - o.x) + n.y * (y - o.y)) / n.z;
        OpposedPad {
            place: axes.transpose() * (DVec3::new(x, y, z) - o),
            turn: rotation_z(config.yaw_deg.to_radians()),
            array: config.tactile.geometry(),
            rolling_cosine: 1.0,
            spatial,
        }
    }

    /// The sensor's frame, z out of its face.
    pub(crate) fn pose(&self, axes: &DMat3, surface: &Surface) -> Pose {
        Pose::new(*axes * self.turn, surface.origin + *axes * self.place)
    }

    /// The sensor's frame under the pin's contact line; updates the cosine of the rolling
    /// direction.
    pub(crate) fn pad_under(&mut self, line: &ContactLine, surroundings: &Surroundings) -> Pose {
        let pad = self.pose(&surroundings.table_axes, &surroundings.table);
        self.rolling_cosine = line.across.dot(pad.rotation.x_axis);
        pad
    }
}
