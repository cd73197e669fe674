//! Drives of CANopen in cyclic synchronous torque mode. A SYNC makes every drive send statusword,
//! position and torque; a torque goes out at each commit and acts when it arrives; controlwords go
//! out when they change.

pub(crate) mod setup;

use taktil_drivers_cia402::{CyclicTarget, EnableLine, PowerStateMachine, Statusword};

use crate::drive::{Drive, DriveMessage, DriveStatus, Wish};
use crate::frame::Frame;

/// Identifier of the SYNC.
pub const SYNC_ID: u16 = 0x080;
/// Identifier of commands to the network management of all nodes.
const MANAGEMENT_ID: u16 = 0x000;
/// Base of emergency messages.
const EMERGENCY_BASE: u16 = 0x080;
/// Base of what nodes send by SYNC.
pub(crate) const STATUS_BASE: u16 = 0x180;
/// Base of controlwords to nodes.
pub(crate) const CONTROL_BASE: u16 = 0x200;
/// Base of torques to nodes.
pub(crate) const TORQUE_BASE: u16 = 0x300;
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
}

impl CanOpenDrive {
    pub(crate) fn new(id: u8, needs_follow_bit: bool, brake_bit: Option<u8>) -> CanOpenDrive {
        CanOpenDrive {
            id,
            needs_follow_bit,
            brake_bit,
            machine: PowerStateMachine::new(),
            line: EnableLine::default(),
            status: Statusword(0),
            error_code: 0,
        }
    }
}

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
            let [low, high, a, b, c, d, ..] = *frame.data() else {
                return Some(DriveMessage::Status);
            };
            self.status = Statusword(u16::from_le_bytes([low, high]));
            return Some(DriveMessage::Position(i32::from_le_bytes([a, b, c, d])));
        }
        if own(HEARTBEAT_BASE) {
            return Some(match frame.data().first() {
                Some(0) => DriveMessage::Restarted,
                Some(state) if state & 0x7f == OPERATIONAL_STATE => DriveMessage::Status,
                _ => DriveMessage::Left,
            });
        }
        let emergency = emergency(frame, self.id)?;
        self.error_code = emergency.code;
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
        let code = if self.needs_follow_bit {
            CyclicTarget::torque(self.status, code)
        } else if self.status.is_enabled() {
            code
        } else {
            0
        };
        process_data(TORQUE_BASE, self.id, &[(u32::from(code.cast_unsigned()), 16)])
    }

    fn control(&mut self, wish: Wish) -> Option<Frame> {
        let command = self.line.command(wish.enable, &self.machine);
        let word = self.machine.step(self.status, command);
        let outputs = self.brake_bit.map_or(0, |bit| u32::from(wish.lifts_brake) << bit);
        let values = [(u32::from(word.0), 16), (outputs, 32)];
        let count = 1 + usize::from(self.brake_bit.is_some());
        Some(process_data(CONTROL_BASE, self.id, &values[..count]))
    }
}
