//! Controllers of the kind mjbots moteus over CAN FD: registers in subframes, one frame for one
//! controller.
//! Torque is position mode with both gains scaled to zero, so that no place is held; the watchdog
//! of the controller ends it, and only stopping clears what the watchdog did.

use taktil_hal::{Counts, DriveActual, Nanos};

use crate::config::DriveMode;
use crate::drive::{Act, ActLatch, Acts, Drive, DriveMessage, DriveStatus, Latch, Request, Wish};
use crate::frame::{DATA_BYTES_MAX, Frame};

/// Bit of an identifier that asks for an answer.
const ANSWER_BIT: u32 = 0x8000;
/// What fills a frame up: the controller takes it for nothing.
const PADDING_BYTE: u8 = 0x50;

/// Modes of register 000.
pub mod mode {
    /// No torque; clears faults.
    pub const STOPPED_MODE: i8 = 0;
    /// A fault.
    pub const FAULT_MODE: i8 = 1;
    /// Position and torque.
    pub const POSITION_MODE: i8 = 10;
    /// The watchdog ended position mode.
    pub const TIMEOUT_MODE: i8 = 11;
    /// The phases of the motor are shorted.
    pub const BRAKE_MODE: i8 = 15;
}

/// Registers.
pub mod register {
    /// Mode.
    pub const MODE_REGISTER: u8 = 0x00;
    /// Measured position.
    pub const POSITION_REGISTER: u8 = 0x01;
    /// Measured velocity.
    pub const VELOCITY_REGISTER: u8 = 0x02;
    /// Measured torque.
    pub const MEASURED_TORQUE_REGISTER: u8 = 0x03;
    /// Fault.
    pub const FAULT_REGISTER: u8 = 0x0f;
    /// Wanted position.
    pub const TARGET_REGISTER: u8 = 0x20;
    /// Feed-forward torque.
    pub const TORQUE_REGISTER: u8 = 0x22;
    /// Scale of the gain of position; that of velocity follows.
    pub const GAIN_REGISTER: u8 = 0x23;
    /// Time-out of the watchdog.
    pub const WATCHDOG_REGISTER: u8 = 0x27;
}

/// How a value is encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// One byte.
    Int8,
    /// Two bytes.
    Int16,
    /// Four bytes.
    Int32,
    /// IEEE 754, four bytes.
    Float,
}

impl Encoding {
    const fn bits(self) -> u8 {
        match self {
            Encoding::Int8 => 0x00,
            Encoding::Int16 => 0x04,
            Encoding::Int32 => 0x08,
            Encoding::Float => 0x0c,
        }
    }

    const fn from_bits(bits: u8) -> Encoding {
        match bits & 0x0c {
            0x00 => Encoding::Int8,
            0x04 => Encoding::Int16,
            0x08 => Encoding::Int32,
            _ => Encoding::Float,
        }
    }

    const fn bytes(self) -> usize {
        match self {
            Encoding::Int8 => 1,
            Encoding::Int16 => 2,
            Encoding::Int32 | Encoding::Float => 4,
        }
    }
}

/// Data of a frame, put together from subframes.
#[derive(Clone, Copy, Debug)]
pub struct Subframes {
    data: [u8; DATA_BYTES_MAX],
    length: usize,
}

impl Default for Subframes {
    fn default() -> Subframes {
        Subframes { data: [0; DATA_BYTES_MAX], length: 0 }
    }
}

impl Subframes {
    fn push(mut self, bytes: &[u8]) -> Subframes {
        for byte in bytes {
            // A frame that is full keeps what it has; no frame of this driver is.
            if let Some(place) = self.data.get_mut(self.length) {
                *place = *byte;
                self.length += 1;
            }
        }
        self
    }

    fn head(self, base: u8, count: usize, register: u8) -> Subframes {
        match count {
            1..=3 => self.push(&[base | count as u8, register]),
            _ => self.push(&[base, count as u8, register]),
        }
    }

    /// Writes whole numbers of a byte to registers from `register` on.
    #[must_use]
    pub fn write_int8(self, register: u8, values: &[i8]) -> Subframes {
        let bytes = values.iter().map(|value| value.cast_unsigned());
        bytes.fold(self.head(0x00, values.len(), register), |all, byte| all.push(&[byte]))
    }

    /// Writes whole numbers of two bytes to registers from `register` on.
    #[must_use]
    pub fn write_int16(self, register: u8, values: &[i16]) -> Subframes {
        let start = self.head(0x04, values.len(), register);
        values.iter().fold(start, |all, value| all.push(&value.to_le_bytes()))
    }

    /// Writes floating-point numbers to registers from `register` on.
    #[must_use]
    pub fn write_float(self, register: u8, values: &[f32]) -> Subframes {
        let start = self.head(0x0c, values.len(), register);
        values.iter().fold(start, |all, value| all.push(&value.to_le_bytes()))
    }

    /// Asks for `count` registers from `register` on.
    #[must_use]
    pub fn read(self, encoding: Encoding, register: u8, count: usize) -> Subframes {
        self.head(0x10 | encoding.bits(), count, register)
    }

    /// The data so far.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        &self.data[..self.length]
    }

    /// The frame from `host` to a controller.
    #[must_use]
    pub fn frame(&self, host: u8, controller: u8, wants_answer: bool) -> Frame {
        let id = u32::from(host) << 8 | u32::from(controller);
        let id = if wants_answer { id | ANSWER_BIT } else { id };
        Frame::flexible(id, self.data(), PADDING_BYTE)
    }
}

/// A register that a controller told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegisterValue {
    /// Its number.
    pub register: u32,
    /// Its value as it is encoded; `None` where the controller has none.
    pub raw: Option<f64>,
    /// How it is encoded.
    pub encoding: Encoding,
}

/// The registers that the data of an answer tell, in their order. What cannot be read ends them.
pub fn registers(data: &[u8]) -> impl Iterator<Item = RegisterValue> + '_ {
    let mut at = 0;
    let (mut left, mut register, mut encoding) = (0_u32, 0_u32, Encoding::Int8);
    core::iter::from_fn(move || {
        while left == 0 {
            let head = *data.get(at)?;
            at += 1;
            if head == PADDING_BYTE {
                continue;
            }
            if head & 0xf0 != 0x20 {
                return None;
            }
            encoding = Encoding::from_bits(head);
            left = u32::from(head & 3);
            if left == 0 {
                left = varuint(data, &mut at)?;
            }
            register = varuint(data, &mut at)?;
        }
        let bytes = data.get(at..at + encoding.bytes())?;
        at += encoding.bytes();
        left -= 1;
        let own = register;
        register = register.wrapping_add(1);
        Some(RegisterValue { register: own, raw: value(encoding, bytes), encoding })
    })
}

/// A number in groups of seven bits, the lowest first.
fn varuint(data: &[u8], at: &mut usize) -> Option<u32> {
    let mut value = 0;
    for group in 0..4 {
        let byte = *data.get(*at)?;
        *at += 1;
        value |= u32::from(byte & 0x7f) << (7 * group);
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

/// The number in some bytes; the lowest whole number stands for none.
fn value(encoding: Encoding, bytes: &[u8]) -> Option<f64> {
    let number = match (encoding, bytes) {
        (Encoding::Int8, [a]) if *a != 0x80 => f64::from(a.cast_signed()),
        (Encoding::Int16, [a, b]) => {
            let number = i16::from_le_bytes([*a, *b]);
            (number != i16::MIN).then(|| f64::from(number))?
        }
        (Encoding::Int32, [a, b, c, d]) => {
            let number = i32::from_le_bytes([*a, *b, *c, *d]);
            (number != i32::MIN).then(|| f64::from(number))?
        }
        (Encoding::Float, [a, b, c, d]) => f64::from(f32::from_le_bytes([*a, *b, *c, *d])),
        _ => return None,
    };
    number.is_finite().then_some(number)
}

/// A turn for one of a position of two bytes, and of four.
#[must_use]
pub const fn position_scale(encoding: Encoding) -> f64 {
    match encoding {
        Encoding::Int8 => 0.01,
        Encoding::Int16 => 0.0001,
        Encoding::Int32 => 0.00001,
        Encoding::Float => 1.0,
    }
}

/// A turn a second for one of a velocity.
#[must_use]
pub const fn velocity_scale(encoding: Encoding) -> f64 {
    match encoding {
        Encoding::Int8 => 0.1,
        Encoding::Int16 => 0.00025,
        Encoding::Int32 => 0.00001,
        Encoding::Float => 1.0,
    }
}

/// A newton metre for one of a torque.
#[must_use]
pub const fn torque_scale(encoding: Encoding) -> f64 {
    match encoding {
        Encoding::Int8 => 0.5,
        Encoding::Int16 => 0.01,
        Encoding::Int32 => 0.001,
        Encoding::Float => 1.0,
    }
}

/// One controller.
#[derive(Debug)]
pub(crate) struct MoteusDrive {
    host: u8,
    id: u8,
    counts_per_turn: f64,
    watchdog_ms: i16,
    latch: Latch,
    is_on: bool,
    mode: i8,
    fault: u16,
    acts: ActLatch,
    follows: DriveMode,
    step_max: i64,
    /// Measured position and velocity (counts, counts/s) and torque (mNm).
    position: i32,
    velocity: f64,
    torque_mnm: f64,
    /// The newest target of the mode `position`; none while it does not follow.
    held: Option<i32>,
}

impl MoteusDrive {
    pub(crate) fn new(host: u8, id: u8, counts_per_turn: u32, watchdog_ms: u32) -> MoteusDrive {
        MoteusDrive {
            host,
            id,
            counts_per_turn: f64::from(counts_per_turn),
            watchdog_ms: i16::try_from(watchdog_ms).unwrap_or(i16::MAX),
            latch: Latch::default(),
            is_on: false,
            mode: mode::STOPPED_MODE,
            fault: 0,
            acts: ActLatch::default(),
            follows: DriveMode::Torque,
            step_max: 0,
            position: 0,
            velocity: 0.0,
            torque_mnm: 0.0,
            held: None,
        }
    }

    /// The same controller, which follows `mode` under a half for drives, with steps of positions
    /// that are bounded.
    pub(crate) fn following(self, mode: DriveMode, step_max_counts: u32) -> MoteusDrive {
        MoteusDrive { follows: mode, step_max: i64::from(step_max_counts), ..self }
    }

    fn mode_frame(&self, mode: i8) -> Frame {
        let frame = Subframes::default().write_int8(register::MODE_REGISTER, &[mode]);
        frame.frame(self.host, self.id, false)
    }

    /// Position mode with a place or a velocity, and the gains that hold it.
    fn motion_frame(&self, turns: f32, turns_s: f32, gains: [i8; 2]) -> Frame {
        let frame = Subframes::default()
            .write_int8(register::MODE_REGISTER, &[mode::POSITION_MODE])
            .write_float(register::TARGET_REGISTER, &[turns, turns_s, 0.0])
            .write_int8(register::GAIN_REGISTER, &gains)
            .write_int16(register::WATCHDOG_REGISTER, &[self.watchdog_ms]);
        frame.frame(self.host, self.id, false)
    }

    pub(crate) fn stop_frame(&self) -> Frame {
        let stop = Subframes::default().write_int8(register::MODE_REGISTER, &[mode::STOPPED_MODE]);
        stop.frame(self.host, self.id, false)
    }
}

impl Drive for MoteusDrive {
    fn name(&self) -> String {
        format!("controller {}", self.id)
    }

    fn query(&self) -> Option<Frame> {
        let count = if self.follows == DriveMode::Torque { 2 } else { 4 };
        let query = Subframes::default()
            .read(Encoding::Int32, register::MODE_REGISTER, count)
            .read(Encoding::Int8, register::FAULT_REGISTER, 1);
        Some(query.frame(self.host, self.id, true))
    }

    fn receive(&mut self, frame: &Frame) -> Option<DriveMessage> {
        if frame.id != u32::from(self.id) << 8 | u32::from(self.host) || frame.is_remote {
            return None;
        }
        let mut position = None;
        for told in registers(frame.data()) {
            let Some(raw) = told.raw else { continue };
            match u8::try_from(told.register) {
                Ok(register::MODE_REGISTER) => self.mode = raw as i8,
                Ok(register::POSITION_REGISTER) => {
                    let turns = raw * position_scale(told.encoding);
                    // Counts wrap at the ends of `i32`, as hal's do.
                    let counts = (turns * self.counts_per_turn).round() as i64 as i32;
                    self.position = counts;
                    position = Some(counts);
                }
                Ok(register::VELOCITY_REGISTER) => {
                    self.velocity = raw * velocity_scale(told.encoding) * self.counts_per_turn;
                }
                Ok(register::MEASURED_TORQUE_REGISTER) => {
                    self.torque_mnm = raw * torque_scale(told.encoding) * 1e3;
                }
                Ok(register::FAULT_REGISTER) => self.fault = raw as i8 as u16,
                _ => {}
            }
        }
        Some(position.map_or(DriveMessage::Status, DriveMessage::Position))
    }

    fn status(&self) -> DriveStatus {
        DriveStatus {
            has_power: true,
            is_enabled: self.mode == mode::POSITION_MODE,
            has_fault: matches!(self.mode, mode::FAULT_MODE | mode::TIMEOUT_MODE),
            error_code: self.fault,
        }
    }

    fn torque(&self, code: i16) -> Frame {
        if !self.is_on {
            return self.stop_frame();
        }
        let torque_nm = f32::from(code) * 1e-3;
        let frame = Subframes::default()
            .write_int8(register::MODE_REGISTER, &[mode::POSITION_MODE])
            // No place to hold, and no velocity.
            .write_int8(register::TARGET_REGISTER, &[i8::MIN, 0])
            .write_float(register::TORQUE_REGISTER, &[torque_nm])
            .write_int8(register::GAIN_REGISTER, &[0, 0])
            .write_int16(register::WATCHDOG_REGISTER, &[self.watchdog_ms]);
        frame.frame(self.host, self.id, false)
    }

    fn control(&mut self, wish: Wish) -> Option<Frame> {
        let status = self.status();
        self.is_on = self.latch.step(wish, status) == Request::On;
        // Stopping also clears a fault; torques enable.
        (!self.is_on).then(|| self.stop_frame())
    }

    fn lead(&mut self, release: Nanos, acts: Acts) -> Option<Frame> {
        let act = self.acts.step(release, acts, self.status());
        self.is_on = act == Act::Follow;
        match act {
            Act::Follow | Act::Nothing => None,
            Act::Brake => Some(self.mode_frame(mode::BRAKE_MODE)),
            Act::Off | Act::Clear => Some(self.stop_frame()),
        }
    }

    fn target(&mut self, target: i32) -> Option<Frame> {
        if !self.is_on {
            self.held = None;
            return None;
        }
        let turns = |counts: f64| (counts / self.counts_per_turn) as f32;
        Some(match self.follows {
            DriveMode::Torque => self.torque(target as i16),
            // Without the gain of position no place is held.
            DriveMode::Velocity => self.motion_frame(f32::NAN, turns(f64::from(target)), [0, 127]),
            DriveMode::Position => {
                let from = i64::from(self.held.unwrap_or(self.position));
                let step = (i64::from(target) - from).clamp(-self.step_max, self.step_max);
                let place = (from + step) as i32;
                let frame = self.motion_frame(turns(f64::from(place)), 0.0, [127, 127]);
                self.held = Some(place);
                frame
            }
        })
    }

    fn actual(&self) -> DriveActual {
        let status = self.status();
        DriveActual {
            position: Counts(self.position),
            velocity_counts_s: self.velocity.round() as i32,
            torque_code: self.torque_mnm.round() as i32,
            state: self.acts.state(status),
            fault_code: if status.has_fault { self.fault } else { 0 },
        }
    }
}
