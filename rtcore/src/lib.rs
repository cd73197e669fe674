//! The real-time core: when jobs are released and how values move between tasks. It holds the
//! schedule, lanes, ports, links, modes, faults, records, and the executors.
//!
//! A *lane* is one thread at one rate; it runs its tasks in order. The same lane code runs live
//! (one thread a lane, absolute sleeps on the monotonic clock: [`live`]) and in virtual time (all
//! lanes on one thread, no waiting: [`virtual_time`]). This crate knows no robot.
//!
//! # Two tasks in one lane
//!
//! A counter writes how often it ran, a doubler reads that and writes twice the number. Both stand
//! in one lane of 1 ms, which runs for 5 ms of virtual time while an observer collects what the
//! doubler wrote.
//!
//! ```
//! use std::sync::atomic::AtomicBool;
//! use taktil_rtcore::record::{Observer, Record};
//! use taktil_rtcore::{
//!     Builder, Cycle, FaultCode, Input, Io, LaneSpec, Nanos, Output, Payload, Task, payload,
//!     virtual_time,
//! };
//!
//! payload! {
//!     /// A whole number.
//!     pub struct Count {
//!         /// The number.
//!         pub n: u64,
//!     }
//! }
//!
//! struct Counter(Output<Count>);
//!
//! impl Task for Counter {
//!     fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
//!         io.write(&self.0, Count { n: cycle.tick + 1 });
//!         Ok(())
//!     }
//! }
//!
//! struct Doubler(Input<Count>, Output<Count>);
//!
//! impl Task for Doubler {
//!     fn step(&mut self, _cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
//!         if let Some(count) = io.read(&self.0).fresh() {
//!             io.write(&self.1, Count { n: 2 * count.n });
//!         }
//!         Ok(())
//!     }
//! }
//!
//! /// The numbers written to one signal.
//! struct Numbers(usize, Vec<u64>);
//!
//! impl Observer for Numbers {
//!     fn record(&mut self, record: &Record<'_>) {
//!         if record.signal == self.0 {
//!             self.1.extend(Count::decode(record.body).map(|count| count.n));
//!         }
//!     }
//! }
//!
//! let mut builder = Builder::new();
//! let lane = builder.lane(LaneSpec::new("control", Nanos::from_millis(1), 50))?;
//! builder.task(lane, "counter", |ports| Ok(Box::new(Counter(ports.output("count")))))?;
//! builder.task(lane, "doubler", |ports| {
//!     Ok(Box::new(Doubler(ports.input("count"), ports.output("twice"))))
//! })?;
//! builder.bind("doubler.count", "counter.count");
//! let mut machine = builder.build()?;
//!
//! let twice = machine.catalog().find("doubler.twice").unwrap();
//! let mut numbers = Numbers(twice, Vec::new());
//! let stop = AtomicBool::new(false);
//! virtual_time::run(&mut machine, Nanos::from_millis(5), &stop, &mut numbers).unwrap();
//! assert_eq!(numbers.1, [2, 4, 6, 8, 10]);
//! # Ok::<(), taktil_rtcore::Invalid>(())
//! ```
#![cfg_attr(taktil_rtsan, feature(sanitize))]

mod activity;
pub mod analysis;
pub mod array_payload;
pub mod attest;
pub mod bare;
mod buffer_link;
pub mod contract;
pub mod cpus;
pub mod detection;
pub mod facts;
pub mod fault;
mod fault_latch;
pub mod figures;
pub mod flight;
pub mod guard;
pub mod harness;
pub mod hyperperiod;
pub mod injection;
mod lane;
pub mod lateness;
pub mod linux;
pub mod live;
pub mod machine;
mod mapping;
pub mod misses;
pub mod mode;
mod panic_hook;
pub mod parameter;
pub mod payload;
pub mod phase_lock;
pub mod port;
pub mod record;
pub mod record_ring;
pub mod release;
pub mod replay;
pub mod schedule;
pub mod state;
pub mod status;
mod tape;
pub mod task;
mod timing_faults;
pub mod trace;
pub mod virtual_time;

pub use analysis::{Allowance, Analysis};
pub use array_payload::{ArrayPayload, FromRecord};
pub use fault::{FaultCode, FaultSet};
pub use figures::{Figures, TaskFigures};
pub use machine::{Builder, LaneId, Machine};
pub use misses::{LatePolicy, LeakyBucket, Misses, Notice};
pub use mode::Mode;
pub use parameter::{Editor, Param, Transaction};
pub use payload::Payload;
pub use phase_lock::{PhaseLock, PhaseStep};
pub use port::{Freshness, Input, Io, Output, Ports, Sample};
pub use record::Recording;
pub use release::{Guard, GuardCondition, GuardFigures};
pub use schedule::{LaneSpec, Policy, Reservation};
pub use state::{Fold, StateHash};
pub use taktil_hal::{Invalid, Nanos, explain, explained, printable};
pub use tape::{ArrayTape, Tape};
pub use task::{Cycle, Task};
