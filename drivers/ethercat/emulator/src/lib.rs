//! Emulates an EtherCAT segment as a host meets it: a coupler, terminals with analog and digital
//! channels and encoders, and drives by CiA 402, with a plant behind them. Each device has a
//! controller's memory with sync managers, FMMUs, watchdogs and clock, an information memory, the
//! state machine of the application layer, and CoE with a mailbox. It is written from the devices'
//! side and shares no code with the driver.
//!
//! [`Segment::receive`] takes a frame, [`Segment::poll`] gives the answers that are due; time is an
//! argument of both. [`serve`] joins a segment with an interface, such as one end of a veth pair.
//!
//! ```
//! use taktil_drivers_ethercat_emulator::{Model, Segment, idle_motors};
//! use taktil_hal::Nanos;
//!
//! let devices = [Model::Coupler, Model::Drive].map(Into::into).to_vec();
//! let mut segment = Segment::new(devices, idle_motors());
//! // How many devices are there? Everyone answers a broadcast, and counts.
//! let mut frame = vec![0xff; 6];
//! frame.extend([0x10; 6]);
//! frame.extend([0x88, 0xa4, 0x0d, 0x10, 7, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]);
//! segment.receive(Nanos(1_000), &frame);
//! let mut answers = Vec::new();
//! segment.poll(Nanos(1_000), &mut answers);
//! assert_eq!(answers[0][27..], [2, 0]);
//! ```
//!
//! Clocks drift as [`Segment::set_clock_drift`] says, follow the reference, and make SYNC0, by
//! which a device acts when it is asked to. Not emulated: SYNC1 (its registers are memory),
//! complete access, the boot loader's state, redundancy. Faults by plan: see [`EXECUTED_FAULTS`].

mod application;
mod bits;
mod clock;
mod controller;
mod datagram;
mod description;
mod device;
mod dictionary;
mod drive;
mod information;
mod mapping;
mod plant;
mod segment;
mod serve;

pub use description::{
    DRIVE_PRODUCT_ID, DRIVE_VENDOR_ID, Description, Model, RATED_TORQUE_MNM, TORQUE_MAX_PERMILLE,
};
pub use device::{State, SyncFigures};
pub use drive::{COMMUNICATION_ERROR_CODE, PLANNED_ERROR_CODE};
pub use plant::{Inputs, Outputs, Plant, Shaft, idle_motors};
pub use segment::{DEVICES_MAX, EXECUTED_FAULTS, Segment, Traffic};
pub use serve::{RawSocket, serve};
