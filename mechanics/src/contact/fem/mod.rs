//! Finite elements of a rubber layer of finite width, bonded to a rigid base, in plane strain:
//! four-node quadrilaterals, in the locking-free form with a mean dilatation (B-bar) or, for
//! comparison, the plain one that locks.
//!
//! The historical model of tactile sensors (64 by 4 elements over 25.4 mm), kept to be measured
//! against the exact layer in [`super::plane`], and the one that knows free ends. Units and frame
//! as in [`super`]; the base is z = 0 here, the surface z = t. nu = 0.5 is solved by augmented
//! Lagrange steps on the same factors. The matrix is banded, since a layer is long and thin: with
//! nodes numbered across the thickness half the band is 2 nz + 3, so a banded Cholesky factor has
//! no more entries than a sparse one would fill.
//!
//! It refuses meshes that fold, fewer than two elements along, and sizes that would not fit.

mod band;
mod element;
pub mod layer;
pub mod mesh;

pub use layer::{Elements, Response};
pub use mesh::{Kind, Mesh};
