//! The terminal of a process: [`out`] writes lines for people, [`option`] holds the error of a
//! command-line option that cannot be used, [`signals`] turns Ctrl-C and SIGTERM into a request to
//! end, and [`background`] does what may wait in a thread of its own.

pub mod background;
pub mod option;
pub mod out;
pub mod signals;
