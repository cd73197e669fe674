//! Myrmex v2 behind the AGNI serial protocol, version 1: F0 C4, an id, a body, XOR of everything.
//! Time stamps of the board have no public unit and are not used. Ids that are not known are passed
//! over by resynchronisation.

use taktil_hal::Nanos;

use super::dialogue::Dialogue;
use super::{Board, Phase, Request, StartError, Verdict, View};
use crate::buffer::bytes_before;
use crate::checksum::xor;
use crate::config::Config;
use crate::payload::{Encoding, Payload};

const DATAGRAM_HEADER: [u8; 2] = [0xf0, 0xc4];
/// Bytes of an image.
const IMAGE_BYTES: usize = 512;
/// Header, id, time stamp.
const DATA_START_BYTES: usize = 7;
/// Highest id of a logical sensor.
const SENSORS_MAX: usize = 0xc9;
/// The longest message waited for (bytes): a whole list of sensors, or a long topology.
const MESSAGE_BYTES_MAX: usize = 1_024;
/// Cells of the largest topology.
const CELLS_MAX: usize = 15 * 15;

/// How long the line has to be silent after a stop.
const SILENCE_TIME: Nanos = Nanos::from_millis(100);
/// How long a board may go on sending after a stop.
const STOP_TIME: Nanos = Nanos::from_millis(2_000);
/// From one request to its repetition.
const REPEAT_PAUSE: Nanos = Nanos::from_millis(250);
/// How long an optional answer is waited for.
const OPTIONAL_WAIT: Nanos = Nanos::from_millis(200);

const STOP_COMMAND: u8 = 0x00;
const CONFIGURATION_COMMAND: u8 = 0xc0;
const TOPOLOGY_COMMAND: u8 = 0xc1;
const SERIAL_COMMAND: u8 = 0xc2;
const PERIOD_COMMAND: u8 = 0xd0;
const STREAM_ALL: u8 = 0xf1;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Stop,
    Configuration,
    Serial,
    Topology,
    Period,
    Stream,
}

/// The protocol with the lengths of the board's logical sensors.
#[derive(Debug)]
pub(crate) struct Agni {
    dialogue: Dialogue<Step>,
    /// Bytes of data of each logical sensor, by id; 0 where there is none.
    lengths: [u16; SENSORS_MAX + 1],
    wanted: u8,
    sensor: u8,
    period_tenths_ms: u16,
}

fn command(destination: u8, command: u8, data: &[u8]) -> Request {
    let head = Request::new().with(&DATAGRAM_HEADER).with(&[destination, command]).with(data);
    head.with(&[xor(head.bytes())])
}

impl Agni {
    pub(crate) fn new(config: &Config) -> Agni {
        let timeout = Nanos::from_millis(i64::from(config.start_timeout_ms));
        Agni {
            dialogue: Dialogue::new(Step::Stop, timeout),
            lengths: [IMAGE_BYTES as u16; SENSORS_MAX + 1],
            wanted: config.sensor,
            sensor: config.sensor.max(1),
            period_tenths_ms: (1e4 / config.rate_hz).round().clamp(1.0, 65_535.0) as u16,
        }
    }

    /// Bytes of the message at the begin, `None` while that cannot be told, 0 if it is none.
    fn length(&self, bytes: &[u8]) -> Option<usize> {
        let id = *bytes.get(2)?;
        Some(match id {
            0x00 if *bytes.get(3)? == 1 => 3 + 3 + 4 * usize::from(*bytes.get(5)?) + 1,
            0x01..=0xc9 => match self.lengths[usize::from(id)] {
                0 => 0,
                length => DATA_START_BYTES + usize::from(length) + 1,
            },
            0xf0 => 4,
            0xf1 => topology_length(bytes)?,
            0xf2 => 3 + 1 + usize::from(*bytes.get(3)?) + 1,
            0xfe => match *bytes.get(3)? {
                // Early firmware leaves the check byte out.
                0xf1 if *bytes.get(4)? != 0x3b => 4,
                code @ 0x01..=0xee => 3 + 1 + usize::from(code) + 1,
                _ => 5,
            },
            _ => 0,
        })
    }

    fn take_configuration(&mut self, message: &[u8]) {
        if self.dialogue.step != Step::Configuration {
            return;
        }
        self.lengths = [0; SENSORS_MAX + 1];
        let sensors = message[6..message.len() - 1].as_chunks::<4>().0;
        for (sensor, length) in sensors.iter().zip(self.lengths.iter_mut().skip(1)) {
            *length = u16::from_le_bytes([sensor[2], sensor[3]]);
            if usize::from(*length) + DATA_START_BYTES + 1 > MESSAGE_BYTES_MAX {
                *length = 0;
            }
        }
        let is_image = |length: &u16| usize::from(*length) == IMAGE_BYTES;
        let found = match self.wanted {
            0 => self.lengths.iter().position(is_image),
            id => self.lengths.get(usize::from(id)).is_some_and(is_image).then_some(id.into()),
        };
        match found {
            Some(id) => {
                self.sensor = id as u8;
                self.dialogue.enter(Step::Serial);
            }
            None => self.dialogue.fail(StartError::NoSensor),
        }
    }

    fn take_error(&mut self) {
        // An unknown command answers a request that a board need not know.
        match self.dialogue.step {
            Step::Serial => self.dialogue.enter(Step::Topology),
            Step::Topology => self.dialogue.enter(Step::Period),
            _ => {}
        }
    }

    fn give_up(&mut self, what: &'static str) {
        self.dialogue.fail(StartError::NoAnswer(what));
    }
}

/// Bytes of a topology: a type, and for a matrix the ids of each cell behind their number.
fn topology_length(bytes: &[u8]) -> Option<usize> {
    let kind = *bytes.get(3)?;
    let cells = usize::from(kind >> 4) * usize::from(kind & 0x0f);
    let mut at = 4;
    for _ in 0..cells.min(CELLS_MAX) {
        if at >= MESSAGE_BYTES_MAX {
            return Some(0);
        }
        at += 1 + usize::from(*bytes.get(at)?);
    }
    Some(at + 1)
}

impl Board for Agni {
    fn message_bytes_max(&self) -> usize {
        MESSAGE_BYTES_MAX
    }

    fn examine(&mut self, view: View<'_>) -> Verdict {
        let before = bytes_before(view.bytes, DATAGRAM_HEADER);
        if before > 0 {
            return Verdict::Skip(before);
        }
        match self.length(view.bytes) {
            None => Verdict::Incomplete,
            Some(length) if length == 0 || length > MESSAGE_BYTES_MAX => Verdict::Skip(2),
            Some(length) if view.bytes.len() < length => Verdict::Incomplete,
            Some(4) if view.bytes[2] == 0xfe => Verdict::Message(4),
            Some(length) if xor(&view.bytes[..length]) == 0 => Verdict::Message(length),
            Some(_) => Verdict::Skip(2),
        }
    }

    fn accept<'a>(
        &mut self,
        message: &'a [u8],
        _now: Nanos,
    ) -> (Option<Payload<'a>>, Option<Nanos>) {
        match message[2] {
            0x00 => self.take_configuration(message),
            0xf1 if self.dialogue.step == Step::Topology => self.dialogue.enter(Step::Period),
            0xf2 if self.dialogue.step == Step::Serial => self.dialogue.enter(Step::Topology),
            0xfe => self.take_error(),
            id if id == self.sensor && self.dialogue.step == Step::Stream => {
                self.dialogue.phase = Phase::Streaming;
                let bytes = &message[DATA_START_BYTES..message.len() - 1];
                return (Some(Payload { bytes, encoding: Encoding::MyrmexWords }), None);
            }
            _ => {}
        }
        (None, None)
    }

    fn restart(&mut self, now: Nanos) {
        self.lengths = [IMAGE_BYTES as u16; SENSORS_MAX + 1];
        self.dialogue.restart(Step::Stop, now);
    }

    fn poll(&mut self, now: Nanos, heard: Nanos) -> Option<Request> {
        if self.dialogue.phase != Phase::Starting {
            return None;
        }
        let elapsed = self.dialogue.elapsed(now);
        match self.dialogue.step {
            Step::Stop if elapsed >= SILENCE_TIME && now - heard >= SILENCE_TIME => {
                self.dialogue.enter(Step::Configuration);
            }
            Step::Stop if elapsed >= STOP_TIME => self.dialogue.fail(StartError::NotSilent),
            Step::Serial if elapsed >= OPTIONAL_WAIT => self.dialogue.enter(Step::Topology),
            Step::Topology if elapsed >= OPTIONAL_WAIT => self.dialogue.enter(Step::Period),
            Step::Configuration if self.dialogue.is_late(now) => self.give_up("configuration"),
            Step::Stream if self.dialogue.is_late(now) => self.give_up("stream"),
            _ => {}
        }
        if self.dialogue.phase != Phase::Starting {
            return None;
        }
        match self.dialogue.step {
            Step::Stop => {
                self.dialogue.is_due(now, REPEAT_PAUSE).then(|| command(0, STOP_COMMAND, &[]))
            }
            Step::Configuration => self
                .dialogue
                .is_due(now, REPEAT_PAUSE)
                .then(|| command(0, CONFIGURATION_COMMAND, &[])),
            Step::Serial => {
                self.dialogue.is_due(now, STOP_TIME).then(|| command(0, SERIAL_COMMAND, &[]))
            }
            Step::Topology => {
                self.dialogue.is_due(now, STOP_TIME).then(|| command(0, TOPOLOGY_COMMAND, &[]))
            }
            Step::Period => {
                let period = self.period_tenths_ms.to_le_bytes();
                self.dialogue.enter(Step::Stream);
                Some(command(self.sensor, PERIOD_COMMAND, &[2, 0, period[0], period[1]]))
            }
            Step::Stream => {
                self.dialogue.is_due(now, REPEAT_PAUSE * 4).then(|| command(0, STREAM_ALL, &[]))
            }
        }
    }

    fn phase(&self) -> Phase {
        self.dialogue.phase
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_those_published() {
        let bytes = |request: Request| request.bytes().to_vec();
        assert_eq!(bytes(command(0, STOP_COMMAND, &[])), [0xf0, 0xc4, 0, 0, 0x34]);
        assert_eq!(bytes(command(0, CONFIGURATION_COMMAND, &[])), [0xf0, 0xc4, 0, 0xc0, 0xf4]);
        assert_eq!(bytes(command(0, TOPOLOGY_COMMAND, &[])), [0xf0, 0xc4, 0, 0xc1, 0xf5]);
        assert_eq!(bytes(command(0, SERIAL_COMMAND, &[])), [0xf0, 0xc4, 0, 0xc2, 0xf6]);
        assert_eq!(bytes(command(0, STREAM_ALL, &[])), [0xf0, 0xc4, 0, 0xf1, 0xc5]);
        let period = [0xf0, 0xc4, 1, 0xd0, 2, 0, 0x32, 0, 0xd5];
        assert_eq!(bytes(command(1, PERIOD_COMMAND, &[2, 0, 50, 0])), period);
    }
}
