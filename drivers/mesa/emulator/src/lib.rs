//! Emulates a HostMot2 card with an Ethernet port: an FPGA's register file with its tables, a 7I77
//! behind smart serial, and the LBP16 protocol as the card's firmware answers it. It is written
//! from the card's side and shares no code with the driver.
//!
//! [`Emulator::receive`] takes a datagram, [`Emulator::poll`] gives the answers that are due; time
//! is an argument of both. [`serve`] joins an emulator with a UDP socket. Behind the card stands a
//! plant: a function from what the card puts out to what its inputs read.
//!
//! Loss, duplication, reordering, delay, corruption, truncation, silence, a pulled cable, a restart
//! and frozen inputs happen by a [`FaultPlan`](taktil_hal::fault::FaultPlan). Corruption and
//! truncation befall answers; a request that is damaged on the way fails its check sums and is
//! never seen by a card, as if it were lost.
//!
//! The analog outputs follow the manuals of the 7I77's family. Two figures are assumptions: a
//! smart-serial exchange takes [`EXCHANGE_TIME`], a start [`START_TIME`].

mod card;
mod channel;
mod emulator;
mod firmware;
mod parser;
mod remote;
mod serve;

pub use card::{Inputs, Outputs, Plant};
pub use channel::IndexPulses;
pub use emulator::{EXECUTED_FAULTS, Emulator, Traffic};
pub use firmware::{Firmware, ModuleEntry, PinEntry};
pub use remote::{EXCHANGE_TIME, REMOTE_SILENCE, RemoteOutputs, START_TIME};
pub use serve::serve;
