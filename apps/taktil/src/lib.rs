//! The command line's rooms: running a scene, mathematics as a filter, recordings, pictures of
//! them. Refuses to decide anything about the robot: that is the tasks' affair.

pub mod arm;
pub mod bench;
pub mod calc;
pub mod calibrate;
pub mod cli;
pub mod diff;
pub mod doctor;
pub mod experiment;
pub mod identify;
pub mod jitter;
pub mod keys;
pub mod plot;
pub mod postmortem;
pub mod replay;
pub mod report;
pub mod run;
pub mod scenes;
pub mod sim;
pub mod tell;
