//! FlexiTac: AA 55 and one byte a tactel, without length, number or check sum. A header is believed
//! when the next one stands at the expected distance; once locked, a message that came in one piece
//! is believed at once.

use taktil_hal::Nanos;

use super::{Board, Phase, Request, StartError, Verdict, View};
use crate::buffer::bytes_before;
use crate::config::Config;
use crate::payload::{Encoding, Payload};

const FRAME_HEADER: [u8; 2] = [0xaa, 0x55];
/// Share of a period within which a message in one piece has arrived.
const PIECE_SHARE: i64 = 2;
/// Bytes after which a stream without a message is called foreign, in messages.
const FOREIGN_MESSAGES: u32 = 8;

/// The framing for one size.
#[derive(Debug)]
pub(crate) struct FlexiTac {
    message_bytes: usize,
    piece: Nanos,
    timeout: Nanos,
    deadline: Nanos,
    phase: Phase,
    /// When the message being received was long enough.
    complete: Option<Nanos>,
    census: Census,
}

/// What is noted of bytes that belong to no message, to name the mistake.
#[derive(Debug, Default)]
struct Census {
    bytes: u32,
    text: u32,
    /// Bytes since the last header seen.
    since_header: u32,
    distance: u32,
    /// How often that distance was seen in a row.
    distance_count: u32,
    last: u8,
}

impl Census {
    fn take(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.bytes = self.bytes.saturating_add(1);
            self.since_header = self.since_header.saturating_add(1);
            self.text += u32::from(matches!(byte, b' '..=b'~' | b'\r' | b'\n' | b'\t'));
            if self.last == FRAME_HEADER[0] && *byte == FRAME_HEADER[1] {
                let same = self.since_header == self.distance;
                self.distance_count = if same { self.distance_count + 1 } else { 1 };
                self.distance = self.since_header;
                self.since_header = 0;
            }
            self.last = *byte;
        }
    }

    fn diagnosis(&self) -> StartError {
        if self.bytes == 0 {
            StartError::NoAnswer("stream")
        } else if self.text > self.bytes / 10 * 9 {
            StartError::Text
        } else if self.distance_count >= 2 {
            StartError::HeaderDistance(self.distance)
        } else {
            StartError::Foreign
        }
    }
}

impl FlexiTac {
    pub(crate) fn new(config: &Config) -> FlexiTac {
        let geometry = config.geometry();
        let message_bytes = FRAME_HEADER.len() + geometry.rows * geometry.cols;
        FlexiTac {
            message_bytes,
            piece: Nanos(geometry.period.0 / PIECE_SHARE),
            timeout: Nanos::from_millis(i64::from(config.start_timeout_ms)),
            deadline: Nanos::MAX,
            phase: Phase::Starting,
            complete: None,
            census: Census::default(),
        }
    }

    fn skip(&mut self, view: View<'_>, count: usize) -> Verdict {
        if self.phase == Phase::Starting {
            self.census.take(&view.bytes[..count]);
        }
        self.complete = None;
        Verdict::Skip(count)
    }
}

impl Board for FlexiTac {
    fn message_bytes_max(&self) -> usize {
        self.message_bytes + FRAME_HEADER.len()
    }

    fn examine(&mut self, view: View<'_>) -> Verdict {
        let before = bytes_before(view.bytes, FRAME_HEADER);
        if before > 0 {
            return self.skip(view, before);
        }
        if view.bytes.len() < self.message_bytes {
            return Verdict::Incomplete;
        }
        let complete = *self.complete.get_or_insert(view.now);
        let next = &view.bytes[self.message_bytes..];
        if !FRAME_HEADER.starts_with(&next[..next.len().min(FRAME_HEADER.len())]) {
            return self.skip(view, 1);
        }
        let whole = view.locked && complete - view.head_at <= self.piece;
        if next.len() >= FRAME_HEADER.len() || whole {
            return Verdict::Message(self.message_bytes);
        }
        Verdict::Incomplete
    }

    fn accept<'a>(
        &mut self,
        message: &'a [u8],
        _now: Nanos,
    ) -> (Option<Payload<'a>>, Option<Nanos>) {
        self.phase = Phase::Streaming;
        let payload = Payload { bytes: &message[FRAME_HEADER.len()..], encoding: Encoding::Bytes };
        (Some(payload), self.complete.take())
    }

    fn restart(&mut self, now: Nanos) {
        self.phase = Phase::Starting;
        self.deadline = now + self.timeout;
        self.complete = None;
        self.census = Census::default();
    }

    fn poll(&mut self, now: Nanos, _heard: Nanos) -> Option<Request> {
        let many = self.message_bytes as u32 * FOREIGN_MESSAGES + 4_096;
        if self.phase == Phase::Starting && (now >= self.deadline || self.census.bytes > many) {
            self.phase = Phase::Failed(self.census.diagnosis());
        }
        None
    }

    fn phase(&self) -> Phase {
        self.phase
    }
}
