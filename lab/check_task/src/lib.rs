//! Drives one task alone, in virtual time and with made-up inputs, and looks for what no lane may
//! bear: heap calls, panics, values that are not finite or out of range, stale inputs that count,
//! steps over their budget, steps that do not repeat, state that outlives a stop, memory that is
//! lost with each start. The task is that of a program of one's own; its scene says where it runs.

mod drive;
mod lifecycle;
mod number;
mod plan;
mod progress;
mod quantity;
mod range;
mod scenario;
mod stimulus;
mod task_under_test;
mod watchdog;

pub mod command;
pub mod report;
