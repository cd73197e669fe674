//! Finite elements of a rubber layer of finite width, bonded to a rigid base: quadrilaterals in
//! plane strain and bricks in space, of order 1 or 2, in the locking-free form whose dilatation is
//! projected (B-bar; order 2: Q2/P-1) or, for comparison, the plain one that locks.
//!
//! It is the historical model of tactile sensors (64 by 4 elements over 25.4 mm). It is kept for
//! comparison with the exact layer in [`super::plane`] and [`super::space`], and because it is the
//! only model with free ends. Units and frame are those of [`super`]; the base is z = 0 here, the
//! surface z = t. nu = 0.5 is solved by augmented Lagrange steps on the same factors.
//!
//! In the plane the matrix is banded, since a layer is long and thin: with nodes numbered across
//! the shorter side half the band is twice its elements and 3, so that a banded factor has no more
//! entries than a sparse one would fill. In space it is sparse, in the order of nested dissection;
//! [`mesh_contact`] holds the contact. None of it is meant for control periods.
//!
//! These are errors: meshes that fold or do not fit their nodes, fewer than two elements along, and
//! a factor of more than [`ENTRIES_MAX`] numbers, before anything is allocated for it.

mod base;
mod dissect;
mod element;
mod factor;
pub mod layer;
pub mod mesh;
pub mod mesh_contact;
mod right_sides;

pub use factor::{ENTRIES_MAX, Method};
pub use layer::{Elements, Response};
pub use mesh::{Kind, Mesh, graded_edges};
pub use mesh_contact::MeshContact;
