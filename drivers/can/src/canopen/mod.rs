//! Drives of CANopen in a cyclic synchronous mode. A SYNC makes every drive send statusword,
//! position and torque, and, where it closes a loop itself, velocity and error code in a frame
//! more; a target goes out at each commit and acts when it arrives; controlwords go out when they
//! change.

pub(crate) mod setup;

use taktil_drivers_cia402::{
    Command, CyclicTarget, EnableLine, PositionTarget, PowerStateMachine, QuickStopOption,
    Statusword,
};
use taktil_hal::{Counts, DriveActual, DriveState, Nanos};

use crate::config::{Config, DriveMode};
use crate::drive::{Acts, Drive, DriveMessage, DriveStatus, Wish};
use crate::frame::Frame;

/// Identifier of the SYNC.
pub const SYNC_ID: u16 = 0x080;
/// Identifier of commands to the network management of all nodes.
const MANAGEMENT_ID: u16 = 0x000;
/// Base of emergency messages.
const EMERGENCY_BASE: u16 = 0x080;
/// Base of what nodes send by SYNC.
pub(crate) const STATUS_BASE: u16 = 0x180;
/// Base of what nodes send by SYNC besides, in the modes whose loops the drives close.
pub(crate) const MOTION_BASE: u16 = 0x280;
/// Base of controlwords to nodes.
pub(crate) const CONTROL_BASE: u16 = 0x200;
/// Base of targets to nodes.
pub(crate) const TARGET_BASE: u16 = 0x300;
/// Base of signs of life.
const HEARTBEAT_BASE: u16 = 0x700;
/// The sign of life of a node that takes part in the exchange.
const OPERATIONAL_STATE: u8 = 5;

/// Commands to the network management of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Management {
    /// Take part in the exchange.
    Start,
    /// No more exchange, but service data.
    PreOperational,
}

/// The frame of a command to the network management of a node, 0 for all.
#[must_use]
pub fn management(command: Management, node: u8) -> Frame {
    let code = match command {
        Management::Start => 0x01,
        Management::PreOperational => 0x80,
    };
    Frame::classic(MANAGEMENT_ID, &[code, node])
}

/// The SYNC.
#[must_use]
pub fn sync() -> Frame {
    Frame::classic(SYNC_ID, &[])
}

/// The sign of life of a node that takes part in the exchange.
#[must_use]
pub fn heartbeat(node: u8) -> Frame {
    Frame::classic(HEARTBEAT_BASE + u16::from(node), &[OPERATIONAL_STATE])
}

/// A process data object to a node: values of so many bits, whole bytes, one after the other.
#[must_use]
pub fn process_data(base: u16, node: u8, values: &[(u32, u8)]) -> Frame {
    let (mut data, mut length) = ([0; 8], 0);
    for (value, bits) in values {
        for byte in value.to_le_bytes().into_iter().take(usize::from(bits / 8)) {
            if let Some(place) = data.get_mut(length) {
                *place = byte;
                length += 1;
            }
        }
    }
    Frame::classic(base + u16::from(node), &data[..length])
}

/// An emergency message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Emergency {
    /// Error code, as object 603F has it; 0 when an error has gone.
    pub code: u16,
    /// Error register, object 1001.
    pub register: u8,
}

/// The emergency message of a node; `None` for another frame.
#[must_use]
pub fn emergency(frame: &Frame, node: u8) -> Option<Emergency> {
    if frame.id != u32::from(EMERGENCY_BASE + u16::from(node)) {
        return None;
    }
    match *frame.data() {
        [low, high, register, ..] => {
            Some(Emergency { code: u16::from_le_bytes([low, high]), register })
        }
        _ => None,
    }
}

/// One drive.
#[derive(Debug)]
pub(crate) struct CanOpenDrive {
    id: u8,
    /// Whether a target waits for bit 12.
    needs_follow_bit: bool,
    /// The bit of 60FE:01 that lifts the brakes, on the drive that has it.
    brake_bit: Option<u8>,
    machine: PowerStateMachine,
    line: EnableLine,
    status: Statusword,
    error_code: u16,
    error_register: u8,
    mode: DriveMode,
    position_target: PositionTarget,
    step_max: i32,
    /// The newest target of the mode `position`.
    held: i32,
    /// What came in the first of two frames of this cycle.
    first: Option<i32>,
    position: i32,
    velocity: i32,
    torque: i16,
}

impl CanOpenDrive {
    pub(crate) fn new(
        id: u8,
        config: &Config,
        brake_bit: Option<u8>,
        quick_stop: QuickStopOption,
    ) -> CanOpenDrive {
        CanOpenDrive {
            id,
            needs_follow_bit: config.follow_bit,
            brake_bit,
            machine: PowerStateMachine::with_quick_stop(quick_stop),
            line: EnableLine::default(),
            status: Statusword(0),
            error_code: 0,
            error_register: 0,
            mode: config.mode,
            position_target: PositionTarget::new(config.step_max_counts),
            step_max: i32::try_from(config.step_max_counts).unwrap_or(i32::MAX),
            held: 0,
            first: None,
            position: 0,
            velocity: 0,
            torque: 0,
        }
    }

    /// The statusword as targets wait for it: a drive without bit 12 follows when it is enabled.
    fn target_status(&self) -> Statusword {
        let follows = !self.needs_follow_bit && self.status.is_enabled();
        if follows { Statusword(self.status.0 | FOLLOWS_COMMAND_BIT) } else { self.status }
    }

    /// The controlword towards a command, with the brake's output where the drive has it.
    fn control_frame(&mut self, command: Command, lifts_brake: bool) -> Frame {
        let word = self.machine.step(self.status, command);
        let outputs = self.brake_bit.map_or(0, |bit| u32::from(lifts_brake) << bit);
        let values = [(u32::from(word.0), 16), (outputs, 32)];
        let count = 1 + usize::from(self.brake_bit.is_some());
        process_data(CONTROL_BASE, self.id, &values[..count])
    }

    /// Takes the frame of a cycle with statusword, position and torque.
    fn take_status(&mut self, data: &[u8]) -> DriveMessage {
        let [low, high, a, b, c, d, rest @ ..] = data else { return DriveMessage::Status };
        self.status = Statusword(u16::from_le_bytes([*low, *high]));
        let position = i32::from_le_bytes([*a, *b, *c, *d]);
        if let [low, high, ..] = rest {
            self.torque = i16::from_le_bytes([*low, *high]);
        }
        if self.mode == DriveMode::Torque {
            self.position = position;
            return DriveMessage::Position(position);
        }
        self.first = Some(position);
        DriveMessage::Status
    }

    /// Takes the frame with velocity and error code, which completes the answer of a cycle: a drive
    /// sends it after the other one.
    fn take_motion(&mut self, data: &[u8]) -> DriveMessage {
        let [a, b, c, d, low, high, ..] = *data else { return DriveMessage::Status };
        self.velocity = i32::from_le_bytes([a, b, c, d]);
        self.error_code = u16::from_le_bytes([low, high]);
        let Some(position) = self.first.take() else { return DriveMessage::Status };
        self.position = position;
        DriveMessage::Position(position)
    }
}

/// Bit 12 of a statusword: the drive follows.
const FOLLOWS_COMMAND_BIT: u16 = 0x1000;

impl Drive for CanOpenDrive {
    fn name(&self) -> String {
        format!("drive {}", self.id)
    }

    fn query(&self) -> Option<Frame> {
        None
    }

    fn receive(&mut self, frame: &Frame) -> Option<DriveMessage> {
        if frame.is_extended || frame.is_remote {
            return None;
        }
        let own = |base: u16| frame.id == u32::from(base + u16::from(self.id));
        if own(STATUS_BASE) {
            return Some(self.take_status(frame.data()));
        }
        if own(MOTION_BASE) && self.mode != DriveMode::Torque {
            return Some(self.take_motion(frame.data()));
        }
        if own(HEARTBEAT_BASE) {
            return Some(match frame.data().first() {
                Some(0) => DriveMessage::Restarted,
                Some(state) if state & 0x7f == OPERATIONAL_STATE => DriveMessage::Status,
                _ => DriveMessage::Left,
            });
        }
        let emergency = emergency(frame, self.id)?;
        (self.error_code, self.error_register) = (emergency.code, emergency.register);
        Some(if emergency.code == 0 { DriveMessage::Status } else { DriveMessage::Emergency })
    }

    fn status(&self) -> DriveStatus {
        DriveStatus {
            has_power: self.status.has_voltage(),
            is_enabled: self.status.is_enabled(),
            // A word that shows no state is as bad as a fault.
            has_fault: self.status.is_fault() || self.status.state().is_err(),
            error_code: self.error_code,
        }
    }

    fn torque(&self, code: i16) -> Frame {
        let code = CyclicTarget::torque(self.target_status(), code);
        process_data(TARGET_BASE, self.id, &[(u32::from(code.cast_unsigned()), 16)])
    }

    fn control(&mut self, wish: Wish) -> Option<Frame> {
        let command = self.line.command(wish.enable, &self.machine, wish.is_told);
        Some(self.control_frame(command, wish.lifts_brake))
    }

    fn lead(&mut self, _release: Nanos, acts: Acts) -> Option<Frame> {
        let command = Command { goal: acts.request.into(), fault_reset: acts.reset };
        Some(self.control_frame(command, acts.lifts_brake))
    }

    fn target(&mut self, target: i32) -> Option<Frame> {
        let status = self.target_status();
        let value = match self.mode {
            // The range of targets is within that of the object.
            DriveMode::Torque => return Some(self.torque(target as i16)),
            DriveMode::Velocity => CyclicTarget::velocity(status, target),
            DriveMode::Position => {
                // A target that lies far is approached by the largest step.
                let way = target.wrapping_sub(self.held).clamp(-self.step_max, self.step_max);
                let near = self.held.wrapping_add(way);
                self.held = self.position_target.step(status, self.position, near);
                self.held
            }
        };
        Some(process_data(TARGET_BASE, self.id, &[(value.cast_unsigned(), 32)]))
    }

    fn actual(&self) -> DriveActual {
        let state = self.target_status().drive_state();
        let is_fault = state == DriveState::Fault;
        DriveActual {
            position: Counts(self.position),
            velocity_counts_s: self.velocity,
            torque_code: self.torque.into(),
            state,
            fault_code: if is_fault { self.error_code } else { 0 },
        }
    }

    fn error_code(&self) -> u16 {
        self.error_code
    }

    fn error_register(&self) -> u8 {
        self.error_register
    }
}
