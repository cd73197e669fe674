//! Emulates a Net F/T box: it takes requests and sends records by RDT, at its own rate, until it is
//! told to stop. It is written from the box's side and shares no code with the driver.
//!
//! [`Emulator::receive`] takes a datagram, [`Emulator::poll`] gives the records that are due; time
//! is an argument of both. [`serve`] joins an emulator with a UDP socket. Behind the box stands a
//! sensor: a function from the time to six counts.
//!
//! Loss, duplication, reordering, delay, truncation, silence, a pulled cable, a restart, frozen
//! readings and readings that fail happen by a [`FaultPlan`](taktil_hal::fault::FaultPlan).
//! Corruption is absent: a record that is damaged on the way fails its check sum and is lost.

mod emulator;
mod serve;

pub use emulator::{EXECUTED_FAULTS, Emulator, FAILURE_STATUS, Sensor, Traffic};
pub use serve::serve;
