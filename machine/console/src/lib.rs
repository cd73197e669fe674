//! What a process of ours says to people and hears from its terminal: [`out`] writes lines,
//! [`option`] holds options of a command line that cannot be used, [`signals`] asks for the end.

pub mod option;
pub mod out;
pub mod signals;
