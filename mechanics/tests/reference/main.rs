//! The mathematics against reference data computed elsewhere, and against itself on many random
//! poses. Refuses tolerances wider than the data's own.

mod arm;
#[path = "../derivative/mod.rs"]
mod derivative;
mod draws;
mod drives;
mod inverse;
mod lines;
mod motion;
mod paths;
mod previews;
mod table;
mod touch;
