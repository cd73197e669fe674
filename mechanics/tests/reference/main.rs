//! Tests against reference data that other programs computed, and of consistency at many random
//! poses. Tolerances are not wider than the accuracy of the data.

mod arm;
mod cartesian_paths;
#[path = "../derivative/mod.rs"]
mod derivative;
mod dynamics;
mod feasibility;
mod inverse;
mod joint_paths;
mod lcg;
mod table;
mod tactile;
mod transmission;
