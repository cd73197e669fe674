//! ODrive controllers by CANSimple: classic frames whose identifier holds the number of the axis
//! and the command. The controller's own watchdog has to be switched on in its configuration.

use taktil_hal::{Counts, DriveActual, Nanos};

use crate::drive::{Act, ActLatch, Acts, Drive, DriveMessage, DriveStatus, Latch, Request, Wish};
use crate::frame::Frame;

/// Commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// State and error, sent by the axis.
    Heartbeat,
    /// The wanted state.
    SetAxisState,
    /// Position and velocity.
    EncoderEstimates,
    /// What is controlled, and how it is filtered.
    SetControllerMode,
    /// Wanted position, with velocity and torque ahead of it.
    SetInputPosition,
    /// Wanted velocity, with torque ahead of it.
    SetInputVelocity,
    /// Wanted torque.
    SetInputTorque,
    /// Forgets errors.
    ClearErrors,
}

impl Command {
    const fn number(self) -> u16 {
        match self {
            Command::Heartbeat => 0x01,
            Command::SetAxisState => 0x07,
            Command::EncoderEstimates => 0x09,
            Command::SetControllerMode => 0x0b,
            Command::SetInputPosition => 0x0c,
            Command::SetInputVelocity => 0x0d,
            Command::SetInputTorque => 0x0e,
            Command::ClearErrors => 0x18,
        }
    }

    /// The identifier of the command to or from an axis.
    #[must_use]
    pub const fn id(self, axis: u8) -> u16 {
        (axis as u16) << 5 | self.number()
    }
}

/// State of an axis without torque.
const IDLE_STATE: u32 = 1;
/// State of an axis that follows.
const CLOSED_LOOP_STATE: u32 = 8;

/// Asks an axis for a state.
#[must_use]
pub fn axis_state(axis: u8, state: u32) -> Frame {
    Frame::classic(Command::SetAxisState.id(axis), &state.to_le_bytes())
}

/// Asks an axis for a torque (Nm).
#[must_use]
pub fn input_torque(axis: u8, torque_nm: f32) -> Frame {
    Frame::classic(Command::SetInputTorque.id(axis), &torque_nm.to_le_bytes())
}

/// Asks an axis for a velocity (turn/s), with a torque ahead of it (Nm).
#[must_use]
pub fn input_velocity(axis: u8, velocity: f32, torque_nm: f32) -> Frame {
    let [a, b, c, d] = velocity.to_le_bytes();
    let [e, f, g, h] = torque_nm.to_le_bytes();
    Frame::classic(Command::SetInputVelocity.id(axis), &[a, b, c, d, e, f, g, h])
}

/// Asks an axis for a position (turns), with velocity and torque ahead of it in thousandths.
#[must_use]
pub fn input_position(axis: u8, turns: f32, velocity_milli: i16, torque_milli: i16) -> Frame {
    let [a, b, c, d] = turns.to_le_bytes();
    let ([e, f], [g, h]) = (velocity_milli.to_le_bytes(), torque_milli.to_le_bytes());
    Frame::classic(Command::SetInputPosition.id(axis), &[a, b, c, d, e, f, g, h])
}

/// Sets an axis up for torques that act as they come.
#[must_use]
pub fn torque_mode(axis: u8) -> Frame {
    let (torque, passthrough) = (1_u32, 1_u32);
    let mut data = [0; 8];
    data[..4].copy_from_slice(&torque.to_le_bytes());
    data[4..].copy_from_slice(&passthrough.to_le_bytes());
    Frame::classic(Command::SetControllerMode.id(axis), &data)
}

/// Position (turns) and velocity (turn/s) that an axis tells; `None` for another frame or for
/// numbers that are not finite.
#[must_use]
pub fn estimates(frame: &Frame, axis: u8) -> Option<(f32, f32)> {
    if frame.is_remote || frame.id != u32::from(Command::EncoderEstimates.id(axis)) {
        return None;
    }
    let [a, b, c, d, e, f, g, h] = *frame.data() else { return None };
    let (turns, speed) = (f32::from_le_bytes([a, b, c, d]), f32::from_le_bytes([e, f, g, h]));
    (turns.is_finite() && speed.is_finite()).then_some((turns, speed))
}

/// One axis.
#[derive(Debug)]
pub(crate) struct OdriveAxis {
    id: u8,
    counts_per_turn: f64,
    latch: Latch,
    acts: ActLatch,
    state: u8,
    error: u32,
    /// Measured position and velocity (counts, counts/s).
    position: i32,
    velocity: f64,
}

impl OdriveAxis {
    pub(crate) fn new(id: u8, counts_per_turn: u32) -> OdriveAxis {
        let counts_per_turn = f64::from(counts_per_turn);
        OdriveAxis {
            id,
            counts_per_turn,
            latch: Latch::default(),
            acts: ActLatch::default(),
            state: 0,
            error: 0,
            position: 0,
            velocity: 0.0,
        }
    }

    pub(crate) fn idle_frame(&self) -> Frame {
        axis_state(self.id, IDLE_STATE)
    }
}

impl Drive for OdriveAxis {
    fn name(&self) -> String {
        format!("axis {}", self.id)
    }

    fn query(&self) -> Option<Frame> {
        Some(Frame::remote(Command::EncoderEstimates.id(self.id)))
    }

    fn receive(&mut self, frame: &Frame) -> Option<DriveMessage> {
        if frame.is_remote || frame.is_extended {
            return None;
        }
        if frame.id == u32::from(Command::Heartbeat.id(self.id)) {
            if let [a, b, c, d, state, ..] = *frame.data() {
                (self.error, self.state) = (u32::from_le_bytes([a, b, c, d]), state);
            }
            return Some(DriveMessage::Status);
        }
        let (turns, turns_s) = estimates(frame, self.id)?;
        self.velocity = f64::from(turns_s) * self.counts_per_turn;
        // Counts wrap at the ends of `i32`, as hal's do.
        let counts = (f64::from(turns) * self.counts_per_turn).round() as i64 as i32;
        self.position = counts;
        Some(DriveMessage::Position(counts))
    }

    fn status(&self) -> DriveStatus {
        DriveStatus {
            has_power: true,
            is_enabled: u32::from(self.state) == CLOSED_LOOP_STATE,
            has_fault: self.error != 0,
            error_code: u16::try_from(self.error).unwrap_or(u16::MAX),
        }
    }

    fn torque(&self, code: i16) -> Frame {
        let code = if self.status().is_enabled { code } else { 0 };
        input_torque(self.id, f32::from(code) * 1e-3)
    }

    fn control(&mut self, wish: Wish) -> Option<Frame> {
        let status = self.status();
        Some(match self.latch.step(wish, status) {
            Request::Off => axis_state(self.id, IDLE_STATE),
            Request::Clear => Frame::classic(Command::ClearErrors.id(self.id), &[]),
            Request::On => axis_state(self.id, CLOSED_LOOP_STATE),
        })
    }

    fn lead(&mut self, release: Nanos, acts: Acts) -> Option<Frame> {
        match self.acts.step(release, acts, self.status()) {
            Act::Follow => Some(axis_state(self.id, CLOSED_LOOP_STATE)),
            // It has no stop by a ramp of its own, and idling resets no error.
            Act::Off | Act::Brake | Act::Nothing => Some(axis_state(self.id, IDLE_STATE)),
            Act::Clear => Some(Frame::classic(Command::ClearErrors.id(self.id), &[])),
        }
    }

    fn off(&self) -> Option<Frame> {
        Some(self.idle_frame())
    }

    fn target(&mut self, target: i32) -> Option<Frame> {
        Some(self.torque(target as i16))
    }

    fn actual(&self) -> DriveActual {
        let status = self.status();
        DriveActual {
            position: Counts(self.position),
            velocity_counts_s: self.velocity.round() as i32,
            torque_code: 0,
            state: self.acts.state(status),
            fault_code: if status.has_fault { status.error_code } else { 0 },
        }
    }
}
