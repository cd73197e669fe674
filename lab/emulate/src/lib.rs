//! Emulated boards with one simulated robot behind all of them: motors and encoders through a
//! Emulated boards with one simulated robot behind all of them: motors and encoders through a
//! HostMot2 card, a board of registers, drives on a CAN bus or on an EtherCAT segment, the wrist
//! through a box on UDP, touch through tactile arrays on serial lines. What the
//! boards receive moves the robot of a scene, and what they answer is what its sensors read.
//!
//! [`EmulatedRobot`] owns the world and the boards, and only [`EmulatedRobot::advance`] moves them:
//! bytes go in, bytes come out, and equal bytes at equal instants give equal bits. [`Server`] is
//! the same thing with sockets and pseudo-terminals, paced by a clock.
//!
//! ```
//! use taktil_hal::Nanos;
//! use taktil_hal::fault::FaultPlan;
//! use taktil_lab_emulate::{BoardKind, EmulatedRobot};
//! use taktil_lab_scene::scene::Scene;
//!
//! let scene = Scene::load("../../sim/scenes/roll-pin.toml".as_ref())?;
//! let boards = [BoardKind::Mesa, BoardKind::Flexitac];
//! let mut robot = EmulatedRobot::new(&scene, &boards, &FaultPlan::default(), 1)?;
//! robot.advance(Nanos::from_millis(25));
//! let mut bytes = Vec::new();
//! robot.deliver(1, &mut |some| bytes.extend(some.to_vec()));
//! assert_eq!(bytes.windows(2).filter(|two| *two == [0xaa, 0x55]).count(), 4);
//! # Ok::<(), anyhow::Error>(())
//! ```

mod array;
mod board;
mod card;
mod drives;
mod memory;
mod pace;
mod plan;
mod robot;
mod segment;
mod serve;
mod simulated;
mod wired;
mod wiring;
mod wrist;

pub use board::{BoardKind, Traffic};
pub use pace::Lateness;
pub use plan::{fault_plan, faults_of_text};
pub use robot::EmulatedRobot;
pub use serve::{Places, Server};
pub use wiring::CardWiring;
