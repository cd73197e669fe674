//! Tests of serial chains: against the closed forms of the PUMA 260, against derivatives and
//! energies, by forward and inverse kinematics in turn, and with extreme finite numbers as
//! arguments.

mod closed_form;
#[path = "../derivative/mod.rs"]
mod derivative;
#[path = "../dh_rows/mod.rs"]
mod dh_rows;
mod dynamics;
mod example_arms;
mod finite_inputs;
mod forward;
mod iterative_inverse;
mod tool_step;
mod tracking;
