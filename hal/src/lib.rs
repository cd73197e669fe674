//! The hardware layer: the traits of devices, the quantities that they exchange, time, the stamped
//! [`link`] between two threads, and, below everything that is configured, how a configuration
//! [`explain`]s itself and how it is refused ([`Invalid`], [`OpenError`], [`printable`] text), and
//! the plan of the [`fault`]s of a link that emulators execute.
//!
//! A board splits into input halves (`sample`, once a cycle) and output halves (`commit`, once a
//! cycle, and `safe`). Both take the *logical* time of the job that calls them. This crate contains
//! no device: drivers and the simulator implement its traits.
//!
//! # A device and its reader
//!
//! An A/D board with one channel, whose code is the number of samples taken so far, and a cycle of
//! 2.5 ms that reads it:
//!
//! ```
//! use taktil_hal::{AdcCode, AnalogIn, CHANNELS, Error, ErrorKind, Nanos, Reading};
//!
//! struct Counter {
//!     last: Reading<[AdcCode; CHANNELS]>,
//! }
//!
//! impl AnalogIn for Counter {
//!     fn channels(&self) -> usize {
//!         1
//!     }
//!
//!     fn code_range(&self) -> (AdcCode, AdcCode) {
//!         (AdcCode(-2048), AdcCode(2047))
//!     }
//!
//!     fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
//!         // A second call with the same release gives the same reading again.
//!         if release > self.last.acquired {
//!             self.last.acquired = release;
//!             self.last.value[0].0 += 1;
//!         }
//!         if self.last.value[0] > self.code_range().1 {
//!             return Err(Error::on_channel(ErrorKind::OutOfRange, "counter", 0));
//!         }
//!         Ok(self.last)
//!     }
//! }
//!
//! let mut board = Counter { last: Reading::default() };
//! let period = Nanos::from_micros(2_500);
//! for tick in 1..=4 {
//!     let reading = board.sample(period * tick)?;
//!     assert_eq!(reading.acquired, period * tick);
//!     assert_eq!(reading.value[0], AdcCode(tick as i32));
//! }
//! # Ok::<(), Error>(())
//! ```
//!
//! # What every half promises
//!
//! - **Bounded.** `sample`, `commit` and `safe` return within a time that the driver states. They
//!   neither allocate, lock, log nor format; retries are bounded by a named constant. A half may
//!   make the system calls that its driver lists ([`SystemCall`]), and wait for its device at most
//!   for `longest_wait`, which the analysis of the schedule counts as part of the job. The
//!   real-time sanitizer permits the calls of that list to a driver, and no other.
//! - **Logical time.** `release` is the instant at which the calling job was released, not the
//!   reading of a clock. It never runs backwards on one half. What a half answers depends on its
//!   device and on `release` alone, so that a run can be repeated.
//! - **Once a cycle.** A half is sampled or committed once per release. A second `sample` with the
//!   same `release` gives the same reading again, however often the device has moved on since.
//! - **Nothing from the future.** `acquired` is never later than `release`, and never earlier than
//!   the `acquired` of the reading before it.
//! - **No panics.** Bad values are refused with [`ErrorKind::OutOfRange`]; a device that is gone
//!   answers [`ErrorKind::Lost`].
//! - **Safe.** Each output half names its safe value, goes there on `safe` and on drop, and names
//!   the longest silence after which the device goes there *by itself*, with no software alive.
//!
//! The feature `conformance` holds functions that check these promises on any implementor.

pub mod analog;
pub mod board_clock;
#[cfg(any(test, feature = "conformance"))]
pub mod conformance;
pub mod devices;
pub mod digital;
pub mod drive;
pub mod encoder;
pub mod error;
pub mod explain;
pub mod fault;
pub mod force_torque;
pub mod invalid;
pub mod link;
pub mod open_error;
pub mod printable;
pub mod reading;
pub mod system_call;
pub mod tactile;
pub mod time;

pub use analog::{AdcCode, AnalogIn, AnalogOut, DacCode};
pub use board_clock::{BoardClock, phase_in_cycle};
pub use devices::{Devices, TACTILE, TACTILE_OPPOSED};
pub use digital::{DigitalIn, DigitalOut, LinesIn, LinesOut};
pub use drive::{
    DriveActual, DriveCommand, DriveIn, DriveLoop, DriveOut, DriveRequest, DriveState,
};
pub use encoder::{Counts, Encoders, IndexPulses};
pub use error::{Error, ErrorKind};
pub use force_torque::{FORCE_TORQUE_CHANNELS, ForceTorque, GaugeCodes};
pub use invalid::Invalid;
pub use open_error::OpenError;
pub use reading::{CHANNELS, Reading};
pub use system_call::SystemCall;
pub use tactile::{Arrival, MAX_ROWS, MAX_TACTELS, TactileArray, TactileFrame};
pub use time::{Clock, Nanos};
