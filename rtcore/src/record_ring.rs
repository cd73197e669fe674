//! The lock-free byte ring through which the records of one lane reach observers. It never slows
//! the lane down: when the ring is full the record is dropped and counted, and the gap is visible
//! to the observer.

use taktil_hal::Nanos;

use crate::flight::FlightRing;
use crate::record::{HEADER_BYTES, Observer, Record};

/// The lane's end of the ring.
pub(crate) struct RecordWriter {
    ring: rtrb::Producer<u8>,
    dropped: u64,
    flight: Option<FlightRing>,
}

/// The observer's end of the ring.
pub(crate) struct RecordReader {
    ring: rtrb::Consumer<u8>,
    scratch: Vec<u8>,
}

/// A ring of `bytes` bytes for records whose bodies are at most `body` bytes.
pub(crate) fn record_ring(bytes: usize, body: usize) -> (RecordWriter, RecordReader) {
    let (producer, consumer) = rtrb::RingBuffer::new(bytes);
    (
        RecordWriter { ring: producer, dropped: 0, flight: None },
        RecordReader { ring: consumer, scratch: vec![0; HEADER_BYTES + body] },
    )
}

impl RecordWriter {
    /// Writes one record; `message` holds [`HEADER_BYTES`] free bytes and then the body.
    pub(crate) fn append(&mut self, signal: u16, tick: u64, release: Nanos, message: &mut [u8]) {
        let Ok(length) = u32::try_from(message.len() - HEADER_BYTES) else { return };
        message[0..2].copy_from_slice(&signal.to_le_bytes());
        message[2..4].fill(0);
        message[4..8].copy_from_slice(&length.to_le_bytes());
        message[8..16].copy_from_slice(&tick.to_le_bytes());
        message[16..24].copy_from_slice(&release.0.to_le_bytes());
        if self.ring.push_entire_slice(message).is_err() {
            self.dropped += 1;
        }
        if let Some(flight) = &mut self.flight {
            flight.append(message);
        }
    }

    /// From now on keeps every record in a flight recorder's ring too.
    pub(crate) fn attach_flight_ring(&mut self, flight: FlightRing) {
        self.flight = Some(flight);
    }

    /// Job `tick` begins.
    pub(crate) fn begin_job(&self, tick: u64) {
        if let Some(flight) = &self.flight {
            flight.begin_job(tick);
        }
    }

    /// The task at `position`, counted from 1, begins; 0: the job is over.
    pub(crate) fn enter_task(&self, position: u32) {
        if let Some(flight) = &self.flight {
            flight.enter_task(position);
        }
    }

    pub(crate) fn dropped(&self) -> u64 {
        self.dropped
    }
}

fn word<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut out = [0; N];
    out.copy_from_slice(&bytes[at..at + N]);
    out
}

impl RecordReader {
    /// Hands every complete record in the ring to `observer`; returns how many.
    pub(crate) fn drain(&mut self, observer: &mut dyn Observer) -> usize {
        let mut count = 0;
        // Records are pushed whole, so a header that is there is followed by its body.
        while self.ring.slots() >= HEADER_BYTES {
            let (head, _) = self.scratch.split_at_mut(HEADER_BYTES);
            if self.ring.pop_entire_slice(head).is_err() {
                break;
            }
            let length = u32::from_le_bytes(word(head, 4)) as usize;
            let signal = usize::from(u16::from_le_bytes(word(head, 0)));
            let tick = u64::from_le_bytes(word(head, 8));
            let release = Nanos(i64::from_le_bytes(word(head, 16)));
            let body = &mut self.scratch[HEADER_BYTES..HEADER_BYTES + length];
            if self.ring.pop_entire_slice(body).is_err() {
                break;
            }
            observer.record(&Record { signal, tick, release, body });
            count += 1;
        }
        count
    }
}
