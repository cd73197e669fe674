//! What hardware must offer: device traits, device nouns, time, and the stamped link between two threads.
//!
//! A board splits into input halves (`sample`, once a cycle) and output halves (`commit`, once a cycle, and `safe`). Both take the
//! *logical* time of the job that calls them. This crate refuses to contain a device: implementations are drivers and the simulator.

pub mod link;
pub mod time;

pub use time::{Clock, Nanos};
