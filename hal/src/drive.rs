//! Drives that close a loop themselves. The host sends one target a cycle, as a torque, a velocity
//! or a position, and says what is wanted of the power sections; the drives report where they are,
//! what they do, and why they have stopped.
//!
//! Numbers are those of the drives: counts of the encoder for positions, counts a second for
//! velocities, codes of the drive for torques. Transmissions, and what a code is worth, belong to
//! the software that knows the wiring.

use crate::encoder::Counts;
use crate::error::Error;
use crate::reading::{CHANNELS, Reading};
use crate::time::Nanos;

/// The quantity that a drive follows: the outermost loop that it closes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum DriveLoop {
    /// Targets are torques, in codes of the drive.
    #[default]
    Torque,
    /// Targets are velocities (counts/s).
    Velocity,
    /// Targets are positions (counts), on the scale of [`DriveActual::position`].
    Position,
}

impl DriveLoop {
    /// All loops, the innermost first.
    pub const ALL: [DriveLoop; 3] = [DriveLoop::Torque, DriveLoop::Velocity, DriveLoop::Position];

    /// One word for configurations and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            DriveLoop::Torque => "torque",
            DriveLoop::Velocity => "velocity",
            DriveLoop::Position => "position",
        }
    }
}

/// What is wanted of the power sections of the drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum DriveRequest {
    /// No torque, from whatever state, at once.
    #[default]
    Off,
    /// A stop by the drive's own ramp, then no torque. A drive without torque stays without.
    QuickStop,
    /// The drive is to follow its target. A drive that has a fault, or has left operation by
    /// itself, does not: the request has to be given up first, after the reset of the fault.
    Follow,
}

impl DriveRequest {
    /// All requests, the weakest first.
    pub const ALL: [DriveRequest; 3] =
        [DriveRequest::Off, DriveRequest::QuickStop, DriveRequest::Follow];
}

/// The word of one cycle to all drives of a half.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveCommand {
    /// Target of each drive, in the unit of [`DriveOut::control_loop`].
    pub targets: [i32; CHANNELS],
    /// What is wanted of the power sections.
    pub request: DriveRequest,
    /// Becomes true to reset the faults of the drives. Only the change counts, and it enables
    /// nothing: quick stop, reset and following are three separate acts.
    pub reset: bool,
}

impl DriveCommand {
    /// No torque.
    pub const SAFE: DriveCommand =
        DriveCommand { targets: [0; CHANNELS], request: DriveRequest::Off, reset: false };
}

impl Default for DriveCommand {
    fn default() -> DriveCommand {
        DriveCommand::SAFE
    }
}

/// The state of a drive's power section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum DriveState {
    /// No torque.
    #[default]
    Off,
    /// On its way to follow; no target is followed yet.
    Enabling,
    /// It follows its target.
    Following,
    /// It stops by its own ramp.
    Stopping,
    /// It has a fault, and no torque or a reaction of its own to the fault.
    Fault,
}

impl DriveState {
    /// All states, in the order of their declaration.
    pub const ALL: [DriveState; 5] = [
        DriveState::Off,
        DriveState::Enabling,
        DriveState::Following,
        DriveState::Stopping,
        DriveState::Fault,
    ];

    /// One word for reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            DriveState::Off => "off",
            DriveState::Enabling => "enabling",
            DriveState::Following => "following",
            DriveState::Stopping => "stopping",
            DriveState::Fault => "fault",
        }
    }
}

/// What one drive reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveActual {
    /// Position, signed, as if the counter had never wrapped.
    pub position: Counts,
    /// Velocity (counts/s); 0 from a drive that does not report it.
    pub velocity_counts_s: i32,
    /// Torque in the drive's codes; 0 from a drive that does not report it.
    pub torque_code: i32,
    /// State of the power section.
    pub state: DriveState,
    /// The drive's own code for its fault, for drives after CiA 402 that of object 603F; 0 without
    /// a fault, and from a drive that tells none.
    pub fault_code: u16,
}

/// The output half of drives that close a loop.
///
/// Dropping the half asks for [`DriveRequest::Off`], as [`DriveOut::safe`] does.
pub trait DriveOut: Send {
    /// How many drives are wired, 1 to [`CHANNELS`]; constant.
    fn channels(&self) -> usize;

    /// The loop that all drives of the half close; constant.
    fn control_loop(&self) -> DriveLoop;

    /// Lowest and highest target, both included, lowest < highest; constant.
    fn target_range(&self) -> (i32, i32);

    /// The longest that a call waits for the device or the kernel, beside its own processor time:
    /// the analysis of the schedule counts it as part of the job; constant.
    fn longest_wait(&self) -> Nanos {
        Nanos::ZERO
    }

    /// Puts out one command for the job released at `release`.
    ///
    /// All or nothing: the targets of all wired channels are checked before one of them is
    /// written, whatever the request is. Entries from [`DriveOut::channels`] on are ignored. A
    /// target acts from `release` plus the machine's actuation delay on, and only while its drive
    /// follows; the first one that does acts from where the drive is, however far it lies.
    ///
    /// # Errors
    /// [`OutOfRange`](crate::ErrorKind::OutOfRange) names the first channel whose target is outside
    /// [`DriveOut::target_range`]; nothing has changed then.
    /// [`Transient`](crate::ErrorKind::Transient): the word could not be handed over this time, or
    /// the drive of that channel does not follow although it was asked to for longer than its
    /// driver allows. [`Lost`](crate::ErrorKind::Lost): the drives are gone.
    fn commit(&mut self, release: Nanos, command: &DriveCommand) -> Result<(), Error>;

    /// Asks for [`DriveRequest::Off`], at once, from any state, as often as wanted. The safe state
    /// is not latched.
    ///
    /// # Errors
    /// [`Lost`](crate::ErrorKind::Lost) or [`Transient`](crate::ErrorKind::Transient) when the word
    /// could not be handed over; the drives' own watchdogs are then what remains.
    fn safe(&mut self) -> Result<(), Error>;

    /// The longest time without a commit after which the drives stop or lose their torque by
    /// themselves, even if every process is dead; positive; constant.
    fn longest_silence(&self) -> Nanos;
}

/// The input half of drives that close a loop.
pub trait DriveIn: Send {
    /// How many drives are wired, 1 to [`CHANNELS`]; constant.
    fn channels(&self) -> usize;

    /// The longest that a call waits for the device or the kernel, beside its own processor time:
    /// the analysis of the schedule counts it as part of the job; constant.
    fn longest_wait(&self) -> Nanos {
        Nanos::ZERO
    }

    /// What the drives report.
    ///
    /// Entries from [`DriveIn::channels`] on are those of [`DriveActual::default`]. A second call
    /// with the same `release` gives the same reading. Positions are those that the encoders of the
    /// same device count, where it has an encoder half.
    ///
    /// # Errors
    /// [`Transient`](crate::ErrorKind::Transient): the exchange failed this time.
    /// [`Stale`](crate::ErrorKind::Stale): the drives have fallen silent.
    /// [`Lost`](crate::ErrorKind::Lost): the drives are gone.
    fn sample(&mut self, release: Nanos) -> Result<Reading<[DriveActual; CHANNELS]>, Error>;
}
