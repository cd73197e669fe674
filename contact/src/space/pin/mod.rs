//! A rigid pin or bar of finite length, with flat ends, tilted along its axis: a reduced model of
//! slices. Each slice carries the pressure of a plane contact (a few cosines over the square-root
//! singularity), and the slices are coupled through the layer. The solver solves Galerkin's form of
//! the exact problem: its error falls with the slice length and the number of cosines, and force
//! and image are of second order in it.
//!
//! Newton's method finds the free width of each slice: a wrong width leaves a punch's singularity
//! at the edge, and the plane problem gives the penetration that removes it. Slices in tension
//! leave the contact, and come back when the layer would touch them. A contact is the first guess
//! of the next one. Pressing does not allocate.
//!
//! A tilted pin touches from its deeper end on. Therefore there are, beside the row of slices over
//! the whole pin, shorter rows over its end, each a fixed part as long as the one before; the
//! shortest row that holds the contact is used, so a contact always spreads over a number of
//! slices. The fast level solves the contacts of a cylinder on its end and on a good part of its
//! length when the pin is made, and reads them from tables; so do the fast and the default level
//! with all contacts of a bar. The table of an end holds widths, and the pressure is solved on them
//! anew; the default level reads them from the fast level's table and refines them. All other
//! contacts are found by iteration. At the fine level the widths on an end, which do not converge
//! one by one, are solved together.
//!
//! Strips of constant pressure see an end inside of its place, by a part of their length that a
//! punch on the layer determines. The slices are laid out for it. The default and the fine level
//! add a correction of the remaining error to force and image.
//!
//! See [`Pin::new`] and [`Pin::press`] for the ranges of the tables.

mod anderson;
mod conjugate_gradients;
mod contact;
mod cosine_sums;
mod coupling;
mod dense;
mod end_contact;
mod end_loss;
mod failure;
mod free_boundary;
mod image;
mod lengthening;
mod line_loads;
mod linear;
mod lookup;
mod mode_convolution;
mod newton;
mod newton_system;
mod point_rule;
mod pose;
mod profile;
mod resolution;
mod roll;
mod row;
mod row_search;
mod solve;
mod solver;
mod spread_loads;
mod state;
pub(super) mod strip;
mod tables;
mod tabulate;
mod target;

pub(crate) use lengthening::ContactedEnds;
pub use pose::{PinState, PlanarPose};
pub use profile::Profile;
pub use roll::Roll;
pub(super) use row::TILT_MAX_RAD;
pub use solver::Pin;
