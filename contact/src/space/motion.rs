//! Names the motions of an indenter, by which the features of its image are differentiated.

/// A motion of the indenter; mm and rad.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Along x.
    X,
    /// Along y.
    Y,
    /// Into the layer.
    Z,
    /// About x.
    RotX,
    /// About y.
    RotY,
    /// About z.
    RotZ,
}

impl Motion {
    /// Whether it is a rotation.
    pub(crate) fn is_rotation(self) -> bool {
        matches!(self, Self::RotX | Self::RotY | Self::RotZ)
    }
}
