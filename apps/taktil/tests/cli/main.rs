//! The program on the command line: exit codes, output and files. The tests use only arguments,
//! pipes, signals and files.

mod arm;
mod calc;
mod closing_table;
mod experiment;
mod hang;
mod identify;
mod installed;
mod interrupt;
mod log;
mod options;
mod outputs;
mod postmortem;
mod process;
mod rehearsal;
mod replay;
mod rights;
mod run;
mod scenes;
mod tell;
