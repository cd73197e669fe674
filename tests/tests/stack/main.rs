//! The whole stack over the simulated robot, in virtual time: what it promises about physics and
//! repeatability. No result depends on how fast this machine is.

mod arms;
mod arrays;
mod dead_encoders;
mod determinism;
mod edits;
mod experiments;
mod hard;
mod hold;
mod home;
mod jog;
mod laws;
mod lines;
mod margins;
mod opposed;
mod phases;
mod physics;
mod rewired;
mod rolling;
mod stop;
mod tasks;
mod wrist;
