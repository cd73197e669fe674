//! The two boards of Weiss: WTS on a USB serial port, DSA on an RS232 line. They share the frame of
//! a message and the arithmetic of the check sum, not what it covers and not the status numbers.

use taktil_hal::Nanos;

use crate::Board;
use crate::scan::ScanClock;

/// Remainder of one byte: polynomial 1021, most significant bit first.
fn remainder(byte: u16) -> u16 {
    (0..8).fold(byte << 8, |word, _| (word << 1) ^ if word & 0x8000 == 0 { 0 } else { 0x1021 })
}

fn check_sum(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xffff, |sum, byte| remainder((sum ^ u16::from(*byte)) & 0xff) ^ (sum >> 8))
}

/// What differs in the frame of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Dialect {
    Wts,
    Dsa,
}

impl Dialect {
    fn message(self, id: u8, payload: &[u8]) -> Vec<u8> {
        let mut message = vec![0xaa, 0xaa, 0xaa, id];
        message.extend((payload.len() as u16).to_le_bytes());
        message.extend(payload);
        match self {
            Dialect::Wts => message.extend(check_sum(&message).to_le_bytes()),
            Dialect::Dsa if !payload.is_empty() => {
                message.extend(check_sum(&message[3..]).to_le_bytes());
            }
            Dialect::Dsa => {}
        }
        message
    }

    /// Takes the first whole message off `heard`: its id, its payload, whether its sum is right.
    fn next(self, heard: &mut Vec<u8>) -> Option<(u8, Vec<u8>, bool)> {
        let start = heard.windows(4).position(|four| four[..3] == [0xaa; 3] && four[3] != 0xaa)?;
        heard.drain(..start);
        let size = usize::from(u16::from_le_bytes([*heard.get(4)?, *heard.get(5)?]));
        let sum = if self == Dialect::Wts || size > 0 { 2 } else { 0 };
        if heard.len() < 6 + size + sum {
            return None;
        }
        let raw: Vec<u8> = heard.drain(..6 + size + sum).collect();
        let payload = raw[6..6 + size].to_vec();
        let right = self.message(raw[3], &payload) == raw;
        Some((raw[3], payload, right))
    }
}

/// A WTS board of `rows` x `cols` tactels with 12-bit counts.
#[derive(Clone, Debug)]
pub struct WeissWts {
    rows: u16,
    cols: u16,
    clock: ScanClock,
    time_ms: f64,
    heard: Vec<u8>,
}

impl WeissWts {
    /// A board that scans at `rate_hz` until it is told otherwise.
    #[must_use]
    pub fn new(rows: u16, cols: u16, rate_hz: f64) -> WeissWts {
        let clock = ScanClock::stopped(rate_hz);
        WeissWts { rows, cols, clock, time_ms: 0.0, heard: Vec::new() }
    }

    fn command(&mut self, now: Nanos, id: u8, payload: &[u8], out: &mut Vec<Vec<u8>>) {
        let mut reply = vec![0, 0];
        match id {
            0x06 => reply.extend(payload),
            0x21 if payload.len() == 3 => {
                let delay_ms = u16::from_le_bytes([payload[1], payload[2]]);
                if delay_ms > 0 {
                    self.clock.set_period(Nanos::from_millis(i64::from(delay_ms)));
                }
                self.clock.start(now);
            }
            0x22 => self.clock.stop(),
            0x30 => {
                for word in [self.cols, self.rows, 340, 340, 4095] {
                    reply.extend(word.to_le_bytes());
                }
            }
            0x21 => reply = vec![13, 0],
            _ => reply = vec![14, 0],
        }
        out.push(Dialect::Wts.message(id, &reply));
    }
}

impl Board for WeissWts {
    fn receive(&mut self, now: Nanos, bytes: &[u8], out: &mut Vec<Vec<u8>>) {
        self.heard.extend(bytes);
        while let Some((id, payload, right)) = Dialect::Wts.next(&mut self.heard) {
            if right {
                self.command(now, id, &payload, out);
            }
        }
    }

    fn scan_due(&self) -> Nanos {
        self.clock.due()
    }

    fn scan(&mut self, values: &[u16], out: &mut Vec<Vec<u8>>) {
        self.clock.advance();
        self.time_ms += self.clock.period().0 as f64 * 1e-6;
        let mut payload = (self.time_ms as u32).to_le_bytes().to_vec();
        payload.push(0);
        payload.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        out.push(Dialect::Wts.message(0x00, &payload));
    }

    fn restart(&mut self, _now: Nanos) {
        self.clock.stop();
        self.heard.clear();
        self.time_ms = 0.0;
    }

    fn tactels(&self) -> usize {
        usize::from(self.rows) * usize::from(self.cols)
    }

    fn byte_time(&self) -> Nanos {
        Nanos(1_000)
    }
}

/// How long a DSA board hears nothing after power-up.
const DEAF_TIME: Nanos = Nanos::from_millis(8_000);
/// When a DSA board begins to send ESC [ 5 n after power-up, and how far apart.
const GREETING_TIMES: [Nanos; 3] =
    [Nanos::from_millis(7_000), Nanos::from_millis(7_400), Nanos::from_millis(7_820)];

/// A DSA board with one matrix of `rows` x `cols` texels with 12-bit counts.
#[derive(Clone, Debug)]
pub struct WeissDsa {
    rows: u16,
    cols: u16,
    clock: ScanClock,
    compressed: bool,
    time_ms: f64,
    heard: Vec<u8>,
    awake_from: Nanos,
    greeted: usize,
}

impl WeissDsa {
    /// A board that has been on for long.
    #[must_use]
    pub fn new(rows: u16, cols: u16, rate_hz: f64) -> WeissDsa {
        WeissDsa {
            rows,
            cols,
            clock: ScanClock::stopped(rate_hz),
            compressed: false,
            time_ms: 0.0,
            heard: Vec::new(),
            awake_from: Nanos(i64::MIN),
            greeted: GREETING_TIMES.len(),
        }
    }

    fn matrix_information(&self) -> Vec<u8> {
        let mut reply = vec![0, 0];
        reply.extend(3.4_f32.to_le_bytes());
        reply.extend(3.4_f32.to_le_bytes());
        reply.extend(self.cols.to_le_bytes());
        reply.extend(self.rows.to_le_bytes());
        reply.extend([0; 9]);
        for _ in 0..6 {
            reply.extend(0.0_f32.to_le_bytes());
        }
        reply.extend(4095.0_f32.to_le_bytes());
        reply.push(0);
        reply
    }

    fn command(&mut self, now: Nanos, id: u8, payload: &[u8], out: &mut Vec<Vec<u8>>) {
        let reply = match (id, payload) {
            (0x01, []) => {
                let mut reply = vec![0; 18];
                reply[7..9].copy_from_slice(&269_u16.to_le_bytes());
                reply
            }
            (0x02, []) => vec![0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0],
            (0x03, [flags, low, high]) => {
                let rate_hz = u16::from_le_bytes([*low, *high]);
                self.compressed = flags & 1 != 0;
                if flags & 0x80 == 0 {
                    self.clock.stop();
                } else {
                    if rate_hz > 0 {
                        self.clock.set_period(Nanos(1_000_000_000 / i64::from(rate_hz)));
                    }
                    self.clock.start(now);
                }
                vec![0, 0]
            }
            (0x0b, [0]) => self.matrix_information(),
            (0x0b, [_]) => vec![23, 0],
            (0x0f | 0x13, [flags, ..]) if flags & 0x80 != 0 => return,
            (0x01 | 0x02, _) => vec![12, 0],
            _ => vec![13, 0],
        };
        out.push(Dialect::Dsa.message(id, &reply));
    }

    fn compress(values: &[u16]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut rest = values;
        while let [first, ..] = rest {
            let run = rest.iter().take(15).take_while(|value| *value == first).count();
            bytes.extend(((first & 0x0fff) | (run as u16) << 12).to_le_bytes());
            rest = &rest[run..];
        }
        bytes
    }
}

impl Board for WeissDsa {
    fn receive(&mut self, now: Nanos, bytes: &[u8], out: &mut Vec<Vec<u8>>) {
        if now < self.awake_from {
            return;
        }
        self.heard.extend(bytes);
        while let Some((id, payload, right)) = Dialect::Dsa.next(&mut self.heard) {
            if right {
                self.command(now, id, &payload, out);
            }
        }
    }

    fn scan_due(&self) -> Nanos {
        self.clock.due()
    }

    fn scan(&mut self, values: &[u16], out: &mut Vec<Vec<u8>>) {
        self.clock.advance();
        self.time_ms += self.clock.period().0 as f64 * 1e-6;
        let mut payload = (self.time_ms as u32).to_le_bytes().to_vec();
        payload.push(u8::from(self.compressed));
        if self.compressed {
            payload.extend(WeissDsa::compress(values));
        } else {
            payload.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        }
        out.push(Dialect::Dsa.message(0x00, &payload));
    }

    fn greet(&mut self, now: Nanos, out: &mut Vec<Vec<u8>>) {
        while self.greeted < GREETING_TIMES.len()
            && now >= self.awake_from - DEAF_TIME + GREETING_TIMES[self.greeted]
        {
            out.push(b"\x1b[5n".to_vec());
            self.greeted += 1;
        }
    }

    fn greet_due(&self) -> Nanos {
        let next = GREETING_TIMES.get(self.greeted);
        next.map_or(Nanos::MAX, |time| self.awake_from - DEAF_TIME + *time)
    }

    fn restart(&mut self, now: Nanos) {
        self.clock.stop();
        self.heard.clear();
        self.compressed = false;
        self.awake_from = now + DEAF_TIME;
        self.greeted = 0;
    }

    fn tactels(&self) -> usize {
        usize::from(self.rows) * usize::from(self.cols)
    }

    fn byte_time(&self) -> Nanos {
        Nanos(86_806)
    }
}
