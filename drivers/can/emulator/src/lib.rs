//! Emulates a CAN bus with drives on it: CANopen with the profile CiA 402, moteus controllers over
//! CAN FD, and ODrive axes. It is written from the drives' side, reads and writes frames with code
//! of its own, and shares none with the driver.
//!
//! [`Emulator::receive`] takes a frame, [`Emulator::poll`] gives those that are due; time is an
//! argument of both. [`serve`] joins an emulator with a [`Link`]. Behind each drive turns a motor
//! with inertia and friction, or whatever the caller puts there.
//!
//! Lost, doubled and late frames, silence, a pulled cable, drives that restart, freeze or have a
//! fault happen by a [`FaultPlan`](taktil_hal::fault::FaultPlan); a fault may befall one drive, as
//! `can.3`. Damage to a frame is absent: a bus repeats such a frame by itself.

mod canopen;
mod emulator;
mod interface;
mod moteus;
mod motor;
mod objects;
mod odrive;
mod serve;
mod wire;

pub use emulator::{EXECUTED_FAULTS, Emulator, Kind, Outputs, Traffic};
pub use interface::InterfaceSocket;
pub use motor::Motor;
pub use serve::{Link, PathLink, serve};
pub use wire::{BusFrame, error_report};
