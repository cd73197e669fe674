//! Drives on a CAN bus: CANopen with the profile CiA 402, mjbots moteus over CAN FD, and ODrive by
//! CANSimple. A torque is a channel of the analog outputs, an actual position one of the encoders;
//! the line `enable` enables all drives, and their states make up the lines from the cell.
//!
//! # A cycle
//!
//! The first input half that is sampled sends a SYNC (or a question to every drive) and waits for
//! all answers, at most `wait_share` of the period. Torques go out when they are committed and act
//! when they arrive; controlwords go out when they change, and one of them is repeated each cycle.
//! There is no thread of the driver's own.
//!
//! # What the lines mean
//!
//! `drive_power` is true when every drive has its power and none has been wanted for longer than
//! `enable_ms` without being enabled. Both channels of the emergency stop are closed when no drive
//! has a fault, as long as `enable` is on. A fault that these lines have told of is reset by the
//! next rise of `enable`, which enables then; one that nobody was told of, at rest for instance, is
//! only acknowledged by it. A drive that left operation by itself takes a new edge, too.
//!
//! # Drives that close a loop
//!
//! A half for drives commands them by three separate acts, to follow, to stop and to reset a fault,
//! and gives them torques, velocities or positions, by `mode`. Where a half of the lines is in use
//! as well, both have to say so before a drive follows. A quick stop is the drive's own for
//! CANopen, a short circuit of the phases for half a second for a moteus, and no torque for an
//! ODrive. Velocities of CANopen have to be counts a second in the drives.
//!
//! # Silence
//!
//! The sign of life is a heartbeat (CANopen), or the torque itself with the drive's own watchdog.
//! It goes out only as long as every output half that is not at its safe value commits, the lines
//! with a change of the feed line. An ODrive's watchdog has to be switched on in its configuration,
//! because nothing on the bus tells whether it is.
//!
//! # What ends it for good
//!
//! Bus-off, a drive that restarted or left the exchange, and a drive that is silent for `lost_ms`:
//! each is counted under its name, and every half is lost until the bus is opened anew. A missing
//! answer or a full queue is transient.

mod bus;
pub mod canopen;
mod config;
mod drive;
pub mod frame;
mod halves;
mod monitor;
pub mod moteus;
pub mod odrive;
mod opening;
mod port;
pub mod sdo;
mod socket;

pub use bus::BusCounts;
pub use config::{Config, DriveMode, NodeConfig, Protocol};
pub use frame::Frame;
pub use halves::{CanAnalogOut, CanDigitalIn, CanDigitalOut, CanDriveIn, CanDriveOut, CanEncoders};
pub use monitor::BusMonitor;
pub use opening::{Halves, attach, open};
pub use port::{Port, SendError, SocketPort};

use taktil_hal::SystemCall;

/// What the halves ask of the kernel within a job.
pub const SYSTEM_CALLS: &[SystemCall] = &[
    SystemCall {
        name: "send",
        about: "SYNC, questions, torques, controlwords, signs of life; the socket does not block",
    },
    SystemCall {
        name: "recv",
        about: "takes one frame; the socket does not block, and calls of a wait are counted",
    },
    SystemCall {
        name: "poll",
        about: "waits for an answer; the timer ends it, within the wait that the half declares",
    },
    SystemCall { name: "timerfd_settime", about: "sets the end of a wait before it begins" },
];
