//! A Myrmex v2 module behind the AGNI serial protocol, version 1.

use taktil_hal::Nanos;

use crate::Board;
use crate::scan::ScanClock;

const DATAGRAM_HEADER: [u8; 2] = [0xf0, 0xc4];
/// First word of each group of four columns, by row within a group of rows and group of columns.
const GROUP_WORDS: [[usize; 4]; 4] =
    [[208, 224, 32, 0], [192, 48, 16, 64], [176, 144, 112, 80], [160, 240, 128, 96]];

/// A module of 16 x 16 tactels with 12-bit counts; it streams when it was told to.
#[derive(Clone, Debug)]
pub struct Myrmex {
    clock: ScanClock,
    rate_hz: f64,
    ticks: u32,
    heard: Vec<u8>,
    deaf_to_optional: bool,
    checks_errors: bool,
    sensors: Vec<u16>,
}

impl Myrmex {
    /// A module that scans at `rate_hz` until another period is set.
    #[must_use]
    pub fn new(rate_hz: f64) -> Myrmex {
        Myrmex {
            clock: ScanClock::stopped(rate_hz),
            rate_hz,
            ticks: u32::MAX - 100,
            heard: Vec::new(),
            deaf_to_optional: false,
            checks_errors: true,
            sensors: vec![512],
        }
    }

    /// The same module with firmware that knows neither serial number nor topology.
    #[must_use]
    pub fn without_optional_replies(mut self) -> Myrmex {
        self.deaf_to_optional = true;
        self
    }

    /// The same module with firmware before 23 Aug 2021, whose error F1 has no check byte.
    #[must_use]
    pub fn with_old_errors(mut self) -> Myrmex {
        self.checks_errors = false;
        self
    }

    /// The same module with these lengths of data (bytes) as its logical sensors.
    #[must_use]
    pub fn with_sensors(mut self, lengths: &[u16]) -> Myrmex {
        self.sensors = lengths.to_vec();
        self
    }

    fn command(&mut self, now: Nanos, message: &[u8], out: &mut Vec<Vec<u8>>) {
        match (message[2], message[3]) {
            (_, 0x00) => self.clock.stop(),
            (0, 0xc0) => {
                let mut body = vec![0x00, 0x01, 0x00, self.sensors.len() as u8];
                for length in &self.sensors {
                    body.extend([0x00, 0x00]);
                    body.extend(length.to_le_bytes());
                }
                out.push(datagram(&body));
            }
            (0, 0xc1 | 0xc2) if self.deaf_to_optional => {
                let mut error = datagram(&[0xfe, 0xf1]);
                if !self.checks_errors {
                    error.pop();
                }
                out.push(error);
            }
            (0, 0xc1) => out.push(datagram(&[0xf1, 0x11, 1, 1])),
            (0, 0xc2) => out.push(datagram(b"\xf2\x07TAKTIL1")),
            (0, 0xf0) => out.push(datagram(&[0xf0])),
            (0, 0xf1) => self.clock.start(now),
            (1.., 0xd0) if message.len() == 9 => {
                let tenths = u16::from_le_bytes([message[6], message[7]]);
                self.clock.set_period(Nanos(i64::from(tenths) * 100_000));
            }
            _ => out.push(datagram(&[0xfe, 0xf1])),
        }
    }
}

/// A datagram of the board: header, body, XOR of all of it.
fn datagram(body: &[u8]) -> Vec<u8> {
    let mut message = DATAGRAM_HEADER.to_vec();
    message.extend(body);
    message.push(message.iter().fold(0, |sum, byte| sum ^ byte));
    message
}

/// Length of the command at the begin of `bytes`, once it can be told: only the period (D0) has
/// data.
fn command_length(bytes: &[u8]) -> Option<usize> {
    let command = *bytes.get(3)?;
    if command != 0xd0 {
        return Some(5);
    }
    let count = usize::from(u16::from_le_bytes([*bytes.get(4)?, *bytes.get(5)?]));
    let data = if bytes[2] == 0 { 3 * count } else { count };
    Some(7 + data)
}

impl Board for Myrmex {
    fn receive(&mut self, now: Nanos, bytes: &[u8], out: &mut Vec<Vec<u8>>) {
        self.heard.extend(bytes);
        loop {
            let start = self.heard.windows(2).position(|pair| pair == DATAGRAM_HEADER);
            let keep = usize::from(self.heard.last() == Some(&0xf0));
            self.heard.drain(..start.unwrap_or(self.heard.len() - keep));
            let Some(length) = command_length(&self.heard) else { return };
            if self.heard.len() < length {
                return;
            }
            let message: Vec<u8> = self.heard.drain(..length).collect();
            if message.iter().fold(0, |sum, byte| sum ^ byte) == 0 {
                self.command(now, &message, out);
            } else {
                out.push(datagram(&[0xfe, 0xf0]));
            }
        }
    }

    fn scan_due(&self) -> Nanos {
        self.clock.due()
    }

    fn scan(&mut self, values: &[u16], out: &mut Vec<Vec<u8>>) {
        self.clock.advance();
        self.ticks = self.ticks.wrapping_add((self.clock.period().0 / 1_000) as u32);
        for (index, length) in self.sensors.iter().enumerate() {
            let mut body = vec![index as u8 + 1];
            body.extend(self.ticks.to_le_bytes());
            if *length == 512 {
                let mut words = [0_u16; 256];
                for (tactel, value) in values.iter().enumerate().take(256) {
                    let (row, col) = (tactel / 16, tactel % 16);
                    let word = GROUP_WORDS[row % 4][col % 4] + col / 4 + 4 * (row / 4);
                    words[word] = (*value & 0x0fff) | ((word as u16 / 16) << 12);
                }
                body.extend(words.iter().flat_map(|word| word.to_le_bytes()));
            } else {
                body.resize(5 + usize::from(*length), 0xf0);
            }
            out.push(datagram(&body));
        }
    }

    fn restart(&mut self, _now: Nanos) {
        self.clock = ScanClock::stopped(self.rate_hz);
        self.heard.clear();
        self.ticks = 0;
    }

    fn tactels(&self) -> usize {
        256
    }

    fn byte_time(&self) -> Nanos {
        Nanos(1_000)
    }
}
