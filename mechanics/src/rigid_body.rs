//! The inertial parameters of one rigid body (mass, centre of mass, inertia tensor), their change
//! of frame and their sum. Both models of an arm, the PUMA 260 and the general chain, are made of
//! them.

use crate::spatial::Pose;
use glam::{DMat3, DVec3};

/// Acceleration of free fall (m/s^2).
pub const GRAVITY_M_S2: f64 = 9.81;

/// One rigid body in the frame of its link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Mass (kg).
    pub mass_kg: f64,
    /// Centre of mass in the link frame (m).
    pub com_m: DVec3,
    /// Inertia about the centre of mass in the axes of the link frame (kg m^2), symmetric.
    pub inertia_kg_m2: DMat3,
}

impl Body {
    /// A body whose principal axes of inertia are parallel to those of the link frame: mass (kg),
    /// centre of mass (m), moments of inertia about the centre of mass (kg m^2).
    #[must_use]
    pub const fn diagonal(mass_kg: f64, com_m: [f64; 3], inertia_kg_m2: [f64; 3]) -> Body {
        let [x, y, z] = inertia_kg_m2;
        Body {
            mass_kg,
            com_m: DVec3::new(com_m[0], com_m[1], com_m[2]),
            inertia_kg_m2: DMat3::from_cols(
                DVec3::new(x, 0.0, 0.0),
                DVec3::new(0.0, y, 0.0),
                DVec3::new(0.0, 0.0, z),
            ),
        }
    }

    /// The same body with `factor` times its density.
    #[must_use]
    pub fn with_density_factor(&self, factor: f64) -> Body {
        Body {
            mass_kg: factor * self.mass_kg,
            com_m: self.com_m,
            inertia_kg_m2: factor * self.inertia_kg_m2,
        }
    }

    /// The same body expressed in an outer frame, in which its own frame stands at `pose`.
    #[must_use]
    pub fn expressed_in(&self, pose: &Pose) -> Body {
        let rotation = pose.rotation;
        Body {
            mass_kg: self.mass_kg,
            com_m: pose.apply(self.com_m),
            inertia_kg_m2: rotation * self.inertia_kg_m2 * rotation.transpose(),
        }
    }

    /// The rigid union of two bodies, both expressed in the same frame.
    #[must_use]
    pub fn combine(&self, other: &Body) -> Body {
        let mass_kg = self.mass_kg + other.mass_kg;
        if mass_kg <= 0.0 {
            return *self;
        }
        let com_m = (self.mass_kg * self.com_m + other.mass_kg * other.com_m) / mass_kg;
        let about = |b: &Body| b.inertia_kg_m2 + parallel_axis_inertia(b.mass_kg, b.com_m - com_m);
        Body { mass_kg, com_m, inertia_kg_m2: about(self) + about(other) }
    }
}

/// The inertia of a point mass `m` (kg) at `r` (m) about the origin (kg m^2): the term of the
/// parallel axis theorem (Steiner).
pub(crate) fn parallel_axis_inertia(m: f64, r: DVec3) -> DMat3 {
    let square = r.length_squared();
    m * DMat3::from_cols(
        DVec3::new(square, 0.0, 0.0) - r * r.x,
        DVec3::new(0.0, square, 0.0) - r * r.y,
        DVec3::new(0.0, 0.0, square) - r * r.z,
    )
}

/// The term that a first moment `h` (kg m) adds to the inertia about the origin when the origin
/// moves by `-p` (m): `2 h.p I - h p^T - p h^T` (kg m^2).
pub(crate) fn first_moment_inertia(h: DVec3, p: DVec3) -> DMat3 {
    let both = 2.0 * h.dot(p);
    DMat3::from_cols(
        DVec3::new(both, 0.0, 0.0) - h * p.x - p * h.x,
        DVec3::new(0.0, both, 0.0) - h * p.y - p * h.y,
        DVec3::new(0.0, 0.0, both) - h * p.z - p * h.z,
    )
}
