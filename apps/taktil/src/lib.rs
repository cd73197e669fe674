//! The command line's rooms: mathematics as a filter, recordings, pictures of them. Refuses to be a library for others.

pub mod calc;
pub mod log;
pub mod series;
