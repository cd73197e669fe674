//! The program as people start it: exit codes, what it says, what it leaves behind. Refuses to look
//! inside: everything goes through arguments, pipes, signals and files.

mod arm;
mod calc;
mod experiment;
mod hang;
mod identify;
mod interrupt;
mod options;
mod outputs;
mod postmortem;
mod process;
mod replay;
mod rights;
mod run;
mod scenes;
mod tell;
