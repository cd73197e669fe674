//! The boards of Weiss. WTS sums the preamble too and always; DSA sums what follows the preamble,
//! and only when there is a payload. The numbers of their status words differ from 12 on.

use taktil_hal::Nanos;

use super::dialogue::Dialogue;
use super::{Board, Phase, Request, StartError, Verdict, View};
use crate::buffer::bytes_before;
use crate::checksum::weiss;
use crate::config::{BoardKind, Config};
use crate::payload::{Encoding, Payload};

const PREAMBLE_BYTES: [u8; 3] = [0xaa; 3];
/// Preamble, id, size.
const HEAD_BYTES: usize = 6;
/// Time stamp and flags of a scan.
const SCAN_HEAD_BYTES: usize = 5;
/// The longest answer waited for (bytes of payload).
const ANSWER_BYTES_MAX: usize = 128;
/// From one request to its repetition.
const REPEAT_PAUSE: Nanos = Nanos::from_millis(500);

const SCAN_ID: u8 = 0x00;
const DSA_CONTROLLER: u8 = 0x01;
const DSA_SENSOR: u8 = 0x02;
const DSA_ACQUISITION: u8 = 0x03;
const DSA_MATRIX: u8 = 0x0b;
const WTS_START: u8 = 0x21;
const WTS_STOP: u8 = 0x22;
const WTS_MATRIX: u8 = 0x30;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Stop,
    Controller,
    Sensor,
    /// The description of this matrix.
    Matrix(u8),
    Start,
    Stream,
}

/// The protocol of either board.
#[derive(Debug)]
pub(crate) struct Weiss {
    dsa: bool,
    dialogue: Dialogue<Step>,
    rows: u16,
    cols: u16,
    full_scale: u16,
    rate_hz: f64,
    compress: bool,
    matrix: u8,
    matrices: u8,
    /// Texels of the matrices in front of ours, and of all.
    skip: usize,
    total: usize,
    payload_bytes_max: usize,
}

fn word(payload: &[u8], at: usize) -> u16 {
    let byte = |at: usize| payload.get(at).copied().unwrap_or(0);
    u16::from_le_bytes([byte(at), byte(at + 1)])
}

impl Weiss {
    pub(crate) fn new(config: &Config) -> Weiss {
        let timeout = Nanos::from_millis(i64::from(config.start_timeout_ms));
        let (rows, cols) = (config.rows, config.cols);
        let tactels = usize::from(rows) * usize::from(cols);
        let dsa = config.board == BoardKind::WeissDsa;
        // A hand has six matrices; ours may stand behind as many texels again.
        let texels_max = if dsa { (2 * tactels).max(512) } else { tactels };
        Weiss {
            dsa,
            dialogue: Dialogue::new(Step::Stop, timeout),
            rows,
            cols,
            full_scale: config.full_scale,
            rate_hz: config.rate_hz,
            compress: config.compress,
            matrix: config.sensor,
            matrices: 0,
            skip: 0,
            total: 0,
            payload_bytes_max: (SCAN_HEAD_BYTES + 2 * texels_max).max(ANSWER_BYTES_MAX),
        }
    }

    fn request(&self, id: u8, payload: &[u8]) -> Request {
        let size = (payload.len() as u16).to_le_bytes();
        let head = Request::new().with(&PREAMBLE_BYTES).with(&[id]).with(&size).with(payload);
        if self.dsa && payload.is_empty() {
            return head;
        }
        let covered = if self.dsa { &head.bytes()[PREAMBLE_BYTES.len()..] } else { head.bytes() };
        let sum = weiss(covered).to_le_bytes();
        head.with(&sum)
    }

    fn step_request(&self) -> (Request, &'static str) {
        match (self.dialogue.step, self.dsa) {
            (Step::Stop, false) => (self.request(WTS_STOP, &[]), "stop"),
            (Step::Stop, true) => (self.request(DSA_ACQUISITION, &[0x01, 0, 0]), "stop"),
            (Step::Controller, _) => (self.request(DSA_CONTROLLER, &[]), "controller information"),
            (Step::Sensor, _) => (self.request(DSA_SENSOR, &[]), "sensor information"),
            (Step::Matrix(_), false) => (self.request(WTS_MATRIX, &[]), "matrix information"),
            (Step::Matrix(number), true) => {
                (self.request(DSA_MATRIX, &[number]), "matrix information")
            }
            (Step::Start | Step::Stream, false) => {
                let delay_ms = (1e3 / self.rate_hz).round().clamp(1.0, 65_535.0) as u16;
                let [low, high] = delay_ms.to_le_bytes();
                (self.request(WTS_START, &[0, low, high]), "start")
            }
            (Step::Start | Step::Stream, true) => {
                let [low, high] = (self.rate_hz.round() as u16).to_le_bytes();
                let flags = 0x80 | u8::from(self.compress);
                (self.request(DSA_ACQUISITION, &[flags, low, high]), "start")
            }
        }
    }

    /// The answer that the step waits for.
    fn is_answer(&self, id: u8) -> bool {
        match self.dialogue.step {
            Step::Stop if self.dsa => id == DSA_ACQUISITION,
            Step::Stop => id == WTS_STOP,
            Step::Controller => id == DSA_CONTROLLER,
            Step::Sensor => id == DSA_SENSOR,
            Step::Matrix(_) if self.dsa => id == DSA_MATRIX,
            Step::Matrix(_) => id == WTS_MATRIX,
            Step::Start if self.dsa => id == DSA_ACQUISITION,
            Step::Start => id == WTS_START,
            Step::Stream => false,
        }
    }

    fn take_answer(&mut self, id: u8, payload: &[u8], now: Nanos) {
        if !self.is_answer(id) || payload.len() < 2 {
            return;
        }
        let status = word(payload, 0);
        // A board that is not acquiring may refuse to stop.
        if status != 0 && self.dialogue.step != Step::Stop {
            let (_, name) = self.step_request();
            return self.dialogue.fail(StartError::Refused(name, status));
        }
        match self.dialogue.step {
            Step::Stop if self.dsa => self.dialogue.enter(Step::Controller),
            Step::Stop => self.dialogue.enter(Step::Matrix(0)),
            Step::Controller => self.dialogue.enter(Step::Sensor),
            Step::Sensor => {
                self.matrices = word(payload, 2).min(255) as u8;
                if self.matrix >= self.matrices {
                    return self.dialogue.fail(StartError::NoMatrix);
                }
                self.dialogue.enter(Step::Matrix(0));
            }
            Step::Matrix(number) if self.dsa => self.take_dsa_matrix(number, payload),
            Step::Matrix(_) => self.take_wts_matrix(payload),
            Step::Start => self.dialogue.wait(Step::Stream, now),
            Step::Stream => {}
        }
    }

    fn take_wts_matrix(&mut self, payload: &[u8]) {
        let (cols, rows, full_scale) = (word(payload, 2), word(payload, 4), word(payload, 10));
        if (rows, cols) != (self.rows, self.cols) {
            self.dialogue.fail(StartError::Size { rows, cols });
        } else if full_scale != if self.full_scale == 0 { 4_095 } else { self.full_scale } {
            self.dialogue.fail(StartError::FullScale(full_scale));
        } else {
            (self.skip, self.total) = (0, usize::from(rows) * usize::from(cols));
            self.dialogue.enter(Step::Start);
        }
    }

    fn take_dsa_matrix(&mut self, number: u8, payload: &[u8]) {
        let (cols, rows) = (word(payload, 10), word(payload, 12));
        if number == 0 {
            (self.skip, self.total) = (0, 0);
        }
        if number == self.matrix && (rows, cols) != (self.rows, self.cols) {
            return self.dialogue.fail(StartError::Size { rows, cols });
        }
        let texels = usize::from(rows) * usize::from(cols);
        self.skip += if number < self.matrix { texels } else { 0 };
        self.total += texels;
        let next = number.saturating_add(1);
        let last = next >= self.matrices;
        self.dialogue.enter(if last { Step::Start } else { Step::Matrix(next) });
    }

    fn image<'a>(&self, payload: &'a [u8]) -> Option<Payload<'a>> {
        let flags = *payload.get(SCAN_HEAD_BYTES - 1)?;
        let bytes = &payload[SCAN_HEAD_BYTES..];
        let tactels = usize::from(self.rows) * usize::from(self.cols);
        if flags & 1 == 0 {
            if bytes.len() != 2 * self.total {
                return Some(Payload { bytes: &[], encoding: Encoding::Words });
            }
            let own = bytes.get(2 * self.skip..2 * (self.skip + tactels))?;
            return Some(Payload { bytes: own, encoding: Encoding::Words });
        }
        let encoding = Encoding::Runs { skip: self.skip, total: self.total };
        // The compression of WTS is not public; it was not asked for either.
        let bytes = if self.dsa { bytes } else { &[] };
        Some(Payload { bytes, encoding })
    }
}

impl Board for Weiss {
    fn message_bytes_max(&self) -> usize {
        HEAD_BYTES + self.payload_bytes_max + 2
    }

    fn examine(&mut self, view: View<'_>) -> Verdict {
        let bytes = view.bytes;
        let before = bytes_before(bytes, PREAMBLE_BYTES);
        if before > 0 {
            return Verdict::Skip(before);
        }
        // The id AA does not exist: the preamble begins one byte later.
        if bytes.get(3) == Some(&0xaa) {
            return Verdict::Skip(1);
        }
        if bytes.len() < HEAD_BYTES {
            return Verdict::Incomplete;
        }
        let size = usize::from(word(bytes, 4));
        if size > self.payload_bytes_max {
            return Verdict::Skip(1);
        }
        let end = HEAD_BYTES + size;
        if self.dsa && size == 0 {
            return Verdict::Message(end);
        }
        if bytes.len() < end + 2 {
            return Verdict::Incomplete;
        }
        let covered = &bytes[if self.dsa { PREAMBLE_BYTES.len() } else { 0 }..end];
        if weiss(covered) == word(bytes, end) {
            Verdict::Message(end + 2)
        } else {
            Verdict::Skip(1)
        }
    }

    fn accept<'a>(
        &mut self,
        message: &'a [u8],
        now: Nanos,
    ) -> (Option<Payload<'a>>, Option<Nanos>) {
        let (id, size) = (message[3], usize::from(word(message, 4)));
        let payload = &message[HEAD_BYTES..HEAD_BYTES + size];
        if id != SCAN_ID {
            self.take_answer(id, payload, now);
            return (None, None);
        }
        if !matches!(self.dialogue.step, Step::Start | Step::Stream) || self.total == 0 {
            // A scan of an earlier session.
            return (None, None);
        }
        let image = self.image(payload);
        if image.is_some_and(|image| image.is_image(self.rows as usize * self.cols as usize)) {
            self.dialogue.enter(Step::Stream);
            self.dialogue.phase = Phase::Streaming;
        }
        (image, None)
    }

    fn restart(&mut self, now: Nanos) {
        self.dialogue.restart(Step::Stop, now);
        self.total = 0;
    }

    fn poll(&mut self, now: Nanos, _heard: Nanos) -> Option<Request> {
        if self.dialogue.phase != Phase::Starting {
            return None;
        }
        let (request, name) = self.step_request();
        if self.dialogue.is_late(now) {
            self.dialogue.fail(StartError::NoAnswer(name));
            return None;
        }
        self.dialogue.is_due(now, REPEAT_PAUSE).then_some(request)
    }

    fn phase(&self) -> Phase {
        self.dialogue.phase
    }
}
