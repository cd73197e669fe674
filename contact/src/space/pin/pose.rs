//! The pose of a pin over the array, and the state that the solver reports of a pressed pin.

/// Position and direction of a pin over the array.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlanarPose {
    /// x of the pin's origin, mm.
    pub x_mm: f64,
    /// y of the pin's origin, mm.
    pub y_mm: f64,
    /// Rotation about the array's normal, rad; the axis has the direction (-sin, cos).
    pub rot_rad: f64,
}

/// State of a pressed pin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PinState {
    /// Normal force of the whole pin, N.
    pub force_n: f64,
    /// Moment of the pressure about the origin, across the axis: force times place along it, N mm.
    pub moment_n_mm: f64,
    /// Penetration of the lowest line at the origin, mm.
    pub penetration_mm: f64,
    /// Slope of the axis, rad.
    pub tilt_rad: f64,
    /// Largest half-width of the contact, mm.
    pub half_width_mm: f64,
    /// Length of the pin in contact, mm.
    pub length_mm: f64,
    /// Error of complementarity over the largest penetration. The error of a slice in contact is
    /// the change of its width's penetration that would make the pressure vanish at its edge; the
    /// error of a slice out of contact is the depth by which the layer's surface reaches it. Force
    /// and image are off by the square of the residual. A bar's slice that is in tension on the
    /// whole stays out of contact, even where the layer reaches its middle. A contact that is read
    /// from a table reports the largest residual of the table's contacts.
    pub residual: f64,
    /// Free-boundary steps taken; 1 for a contact that is read from a table.
    pub steps: usize,
}

/// How a row lies along the pin.
#[derive(Clone, Copy, Debug)]
pub(super) struct RowOrientation {
    /// Whether the row's axis runs against the pin's.
    pub(super) is_turned: bool,
    /// Sum of a place along the row and of the same place along the pin, when turned, mm.
    pub(super) mirror_mm: f64,
}

impl RowOrientation {
    /// Place along the pin of what is at `w_mm` along the row.
    pub(super) fn along_pin(self, w_mm: f64) -> f64 {
        if self.is_turned { self.mirror_mm - w_mm } else { w_mm }
    }
}
