//! Serial chains against the PUMA 260's own code, against derivatives and energies, and against
//! themselves there and back; and every finite number that anybody may give them.

mod any;
mod arms;
mod closed;
#[path = "../derivative/mod.rs"]
mod derivative;
mod following;
mod forward;
mod motion;
#[path = "../rows/mod.rs"]
mod rows;
mod searching;
