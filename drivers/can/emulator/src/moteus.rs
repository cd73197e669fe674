//! A moteus controller from its own side: subframes that read and write registers, the modes, and
//! the watchdog that ends position mode.

use taktil_hal::Nanos;

use crate::wire::BusFrame;

/// Registers that a host may write, by their numbers, and what they are after power came on.
const WRITABLE_REGISTERS: [(u32, f64); 6] =
    [(0x20, f64::NAN), (0x21, 0.0), (0x22, 0.0), (0x23, 1.0), (0x24, 1.0), (0x27, 0.1)];

/// The phases of the motor are shorted.
const BRAKE_MODE: i64 = 15;
/// Torque for a turn of position error (Nm): 50 rad/s with the motor behind it.
const POSITION_GAIN_NM: f64 = 25.0;
/// Torque for a turn a second of speed error (Nm).
const VELOCITY_GAIN_NM: f64 = 1.0;
/// The most that the controller gives (Nm).
const TORQUE_MAX_NM: f64 = 3.0;

/// A controller.
#[derive(Clone, Debug)]
pub(crate) struct Moteus {
    id: u8,
    mode: i64,
    fault: i64,
    has_cause: bool,
    turns: f64,
    /// How fast the shaft turns (turn/s).
    speed: f64,
    written: [f64; WRITABLE_REGISTERS.len()],
    /// When position mode was asked for last.
    commanded: Option<Nanos>,
    pub(crate) outbox: Vec<BusFrame>,
}

impl Moteus {
    pub(crate) fn new(id: u8) -> Moteus {
        Moteus {
            id,
            mode: 0,
            fault: 0,
            has_cause: false,
            turns: 0.0,
            speed: 0.0,
            written: WRITABLE_REGISTERS.map(|(_, value)| value),
            commanded: None,
            outbox: Vec::new(),
        }
    }

    pub(crate) fn restart(&mut self) {
        *self = Moteus { turns: self.turns, ..Moteus::new(self.id) };
    }

    pub(crate) fn is_enabled(&self) -> bool {
        self.mode == 10
    }

    fn setting(&self, register: u32) -> f64 {
        let place = WRITABLE_REGISTERS.iter().position(|(number, _)| *number == register);
        place.map_or(f64::NAN, |place| self.written[place])
    }

    pub(crate) fn torque_nm(&self) -> f64 {
        if self.mode == BRAKE_MODE {
            return -VELOCITY_GAIN_NM * self.speed;
        }
        if !self.is_enabled() {
            return 0.0;
        }
        let (place, speed) = (self.setting(0x20), self.setting(0x21));
        // A place that is not told is held by nothing.
        let error = if place.is_finite() { place - self.turns } else { 0.0 };
        let position = self.setting(0x23) * POSITION_GAIN_NM * error;
        let velocity = self.setting(0x24) * VELOCITY_GAIN_NM * (speed - self.speed);
        (self.setting(0x22) + position + velocity).clamp(-TORQUE_MAX_NM, TORQUE_MAX_NM)
    }

    /// The torque that was asked for (mNm).
    pub(crate) fn target(&self) -> i16 {
        if self.is_enabled() { (1e3 * self.setting(0x22)).round() as i16 } else { 0 }
    }

    pub(crate) fn set_motion(&mut self, turns: f64, speed: f64) {
        (self.turns, self.speed) = (turns, speed);
    }

    pub(crate) fn set_fault(&mut self, is_there: bool) {
        if is_there && !self.has_cause {
            (self.mode, self.fault) = (1, 36);
        }
        self.has_cause = is_there;
    }

    pub(crate) fn next_event(&self) -> Option<Nanos> {
        let wait = self.setting(0x27);
        let is_watched = self.is_enabled() && wait.is_finite();
        self.commanded.filter(|_| is_watched).map(|at| at + Nanos((1e9 * wait) as i64))
    }

    pub(crate) fn advance(&mut self, now: Nanos) {
        if self.next_event().is_some_and(|at| at <= now) {
            self.mode = 11;
        }
    }

    pub(crate) fn receive(&mut self, now: Nanos, frame: &BusFrame) {
        if frame.id() & 0x7f != u32::from(self.id) {
            return;
        }
        let mut reader = Reader { data: &frame.data, at: 0 };
        let mut answer = Vec::new();
        while let Some(head) = reader.byte() {
            if head == 0x50 {
                continue;
            }
            let (kind, format) = (head & 0xf0, (head >> 2) & 3);
            let count = match head & 3 {
                0 => reader.number(),
                count => Some(u32::from(count)),
            };
            let (Some(count), Some(first)) = (count, reader.number()) else { return };
            match kind {
                0x00 => {
                    for register in first..first.saturating_add(count) {
                        let Some(raw) = reader.value(format) else { return };
                        self.write(now, register, raw, format);
                    }
                }
                0x10 => self.tell(&mut answer, format, first, count),
                _ => return,
            }
        }
        if frame.id() & 0x8000 != 0 {
            let source = (frame.id() >> 8) & 0x7f;
            self.answer(answer, source);
        }
    }

    fn answer(&mut self, mut data: Vec<u8>, source: u32) {
        let lengths = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];
        let full = lengths.into_iter().find(|length| *length >= data.len()).unwrap_or(64);
        data.resize(full, 0x50);
        let id = u32::from(self.id) << 8 | source;
        let word = if id > 0x7ff { id | 0x8000_0000 } else { id };
        self.outbox.push(BusFrame { word, is_fd: true, data });
    }

    fn write(&mut self, now: Nanos, register: u32, raw: f64, format: u8) {
        if register == 0 {
            match raw as i64 {
                0 if !self.has_cause => (self.mode, self.fault) = (0, 0),
                BRAKE_MODE if self.mode != 1 => self.mode = BRAKE_MODE,
                10 if self.mode == 0 || self.mode == 10 => {
                    (self.mode, self.commanded) = (10, Some(now));
                }
                // A fault and a time-out are left by stopping only.
                _ => {}
            }
            return;
        }
        let scales = match register {
            0x20 => [0.01, 0.0001, 0.00001, 1.0],
            0x21 => [0.1, 0.00025, 0.00001, 1.0],
            0x22 => [0.5, 0.01, 0.001, 1.0],
            0x23 | 0x24 => [1.0 / 127.0, 1.0 / 32_767.0, 1.0 / 2_147_483_647.0, 1.0],
            0x27 => [0.01, 0.001, 1e-6, 1.0],
            _ => return,
        };
        if let Some(place) = WRITABLE_REGISTERS.iter().position(|(number, _)| *number == register) {
            self.written[place] = raw * scales[usize::from(format)];
        }
    }

    fn tell(&self, answer: &mut Vec<u8>, format: u8, first: u32, count: u32) {
        answer.push(0x20 | format << 2);
        answer.push(count as u8);
        answer.push(first as u8);
        for register in first..first.saturating_add(count) {
            let (value, scales) = match register {
                0 => (self.mode as f64, [1.0; 4]),
                1 => (self.turns, [0.01, 0.0001, 0.00001, 1.0]),
                2 => (self.speed, [0.1, 0.00025, 0.00001, 1.0]),
                3 => (self.torque_nm(), [0.5, 0.01, 0.001, 1.0]),
                0x0f => (self.fault as f64, [1.0; 4]),
                _ => (0.0, [1.0; 4]),
            };
            let scaled = value / scales[usize::from(format)];
            match format {
                0 => answer.extend((scaled.round() as i8).to_le_bytes()),
                1 => answer.extend((scaled.round() as i16).to_le_bytes()),
                2 => answer.extend((scaled.round() as i32).to_le_bytes()),
                _ => answer.extend((scaled as f32).to_le_bytes()),
            }
        }
    }
}

/// Reads what a frame holds, from its begin to its end.
struct Reader<'a> {
    data: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn byte(&mut self) -> Option<u8> {
        let byte = *self.data.get(self.at)?;
        self.at += 1;
        Some(byte)
    }

    fn number(&mut self) -> Option<u32> {
        let (mut number, mut shift) = (0, 0);
        loop {
            let byte = self.byte()?;
            number |= u32::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(number);
            }
            shift += 7;
            if shift > 21 {
                return None;
            }
        }
    }

    /// A value of a format; not a number where the lowest whole number stands for none.
    fn value(&mut self, format: u8) -> Option<f64> {
        let count = [1, 2, 4, 4][usize::from(format)];
        let bytes = self.data.get(self.at..self.at + count)?;
        self.at += count;
        Some(match (format, bytes) {
            (0, [a]) if *a == 0x80 => f64::NAN,
            (0, [a]) => f64::from(*a as i8),
            (1, [a, b]) => match i16::from_le_bytes([*a, *b]) {
                i16::MIN => f64::NAN,
                number => f64::from(number),
            },
            (2, [a, b, c, d]) => match i32::from_le_bytes([*a, *b, *c, *d]) {
                i32::MIN => f64::NAN,
                number => f64::from(number),
            },
            (_, [a, b, c, d]) => f64::from(f32::from_le_bytes([*a, *b, *c, *d])),
            _ => return None,
        })
    }
}
