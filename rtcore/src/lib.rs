//! When things happen and how values move: schedule, lanes, ports, links, modes, faults, records,
//! and the two executors.
//!
//! A *lane* is one thread at one rate; it runs its tasks in order. The same lane code runs live
//! (one thread a lane, absolute sleeps on the monotonic clock) and in virtual time (all lanes on
//! one thread, no waiting). This crate knows no robot.
#![cfg_attr(taktil_rtsan, feature(sanitize))]

mod activity;
pub mod analysis;
pub mod attest;
pub mod bare;
pub mod contract;
pub mod cpus;
pub mod detection;
pub mod facts;
pub mod fault;
mod fault_latch;
pub mod figures;
pub mod flight;
pub mod guard;
pub mod hyperperiod;
mod lane;
pub mod linux;
pub mod live;
pub mod machine;
mod mapping;
pub mod misses;
pub mod mode;
mod panic_hook;
pub mod parameter;
pub mod payload;
pub mod port;
pub mod record;
mod record_ring;
pub mod release;
pub mod replay;
pub mod schedule;
pub mod state;
pub mod status;
mod tape;
pub mod task;
pub mod trace;
pub mod virtual_time;

pub use analysis::{Allowance, Analysis};
pub use fault::{FaultCode, FaultSet};
pub use figures::{Figures, TaskFigures};
pub use machine::{Builder, LaneId, Machine};
pub use misses::{LatePolicy, LeakyBucket, Misses, Notice};
pub use mode::Mode;
pub use parameter::{Editor, Param, Transaction};
pub use payload::Payload;
pub use port::{Freshness, Input, Io, Output, Ports, Sample};
pub use record::Recording;
pub use release::{Guard, GuardCondition, GuardFigures};
pub use schedule::{LaneSpec, Policy, Reservation};
pub use state::{Fold, StateHash};
pub use taktil_hal::{Invalid, Nanos, explain, explained};
pub use tape::Tape;
pub use task::{Cycle, Task};
