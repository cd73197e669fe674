//! What leaves a lane for observers: one record per value written, through a lock-free byte ring.
//! Refuses to slow a lane down: when the ring is full the record is dropped and counted, and the
//! gap is visible to the observer.

use taktil_hal::Nanos;

use crate::flight::Flight;
use crate::payload::Field;

/// What leaves the lanes for observers, each level with all of the ones before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Recording {
    /// Nothing: values reach other lanes only.
    Off,
    /// Every value that is written, and what stands on tapes.
    Values,
    /// How each job came about: enough to replay the run.
    Decisions,
    /// The hash of each task's state after each job.
    #[default]
    Full,
}

/// One signal of a machine: an output port of a task, a tape, or one of a lane's own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signal {
    /// `task.port`, the name of a tape, or `lane.health`, `lane.state`, `lane.decision`.
    pub name: String,
    /// Index into [`Catalog::lanes`] of the lane that writes it.
    pub lane: usize,
    /// Payload type name.
    pub type_name: &'static str,
    /// Fields of the payload.
    pub fields: &'static [Field],
    /// Bytes of an encoded body.
    pub size: usize,
}

/// One lane as seen by an observer.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LaneInfo {
    /// Name.
    pub name: String,
    /// Period.
    pub period: Nanos,
    /// Phase of job 0.
    pub phase: Nanos,
    /// Its tasks in order, as the elements of `lane.state`.
    pub tasks: Vec<String>,
    /// The signals of other lanes that it reads, as the lags of `lane.decision`.
    pub reads: Vec<String>,
}

/// Everything that a machine can record. A record's `signal` is an index into `signals`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Catalog {
    /// Signals in a fixed order: by lane; there its tapes, its health, the ports by task and as
    /// declared, its states, its decisions.
    pub signals: Vec<Signal>,
    /// Lanes in order.
    pub lanes: Vec<LaneInfo>,
}

impl Catalog {
    /// The index of a signal by its name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<usize> {
        self.signals.iter().position(|signal| signal.name == name)
    }
}

/// One value as it left a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'a> {
    /// Index into [`Catalog::signals`].
    pub signal: usize,
    /// Job that wrote it.
    pub tick: u64,
    /// Logical time of that job.
    pub release: Nanos,
    /// Encoded payload.
    pub body: &'a [u8],
}

/// Something that sees every record, off the lanes' threads.
pub trait Observer {
    /// Called for each record; within one signal in order of time.
    fn record(&mut self, record: &Record<'_>);
}

/// Bytes in front of a body in the ring: signal, length, tick, release.
const HEADER: usize = 24;

/// The lane's end of the ring.
pub(crate) struct Tap {
    ring: rtrb::Producer<u8>,
    dropped: u64,
    flight: Option<Flight>,
}

/// The observer's end of the ring.
pub(crate) struct Drain {
    ring: rtrb::Consumer<u8>,
    scratch: Vec<u8>,
}

/// A ring of `bytes` bytes for records whose bodies are at most `body` bytes.
pub(crate) fn tap(bytes: usize, body: usize) -> (Tap, Drain) {
    let (producer, consumer) = rtrb::RingBuffer::new(bytes);
    (
        Tap { ring: producer, dropped: 0, flight: None },
        Drain { ring: consumer, scratch: vec![0; HEADER + body] },
    )
}

impl Tap {
    /// Writes one record; `message` holds [`HEADER`] free bytes and then the body.
    pub(crate) fn put(&mut self, signal: u16, tick: u64, release: Nanos, message: &mut [u8]) {
        let Ok(length) = u32::try_from(message.len() - HEADER) else { return };
        message[0..2].copy_from_slice(&signal.to_le_bytes());
        message[2..4].fill(0);
        message[4..8].copy_from_slice(&length.to_le_bytes());
        message[8..16].copy_from_slice(&tick.to_le_bytes());
        message[16..24].copy_from_slice(&release.0.to_le_bytes());
        if self.ring.push_entire_slice(message).is_err() {
            self.dropped += 1;
        }
        if let Some(flight) = &mut self.flight {
            flight.put(message);
        }
    }

    /// From now on keeps every record in a flight recorder's ring too.
    pub(crate) fn keep(&mut self, flight: Flight) {
        self.flight = Some(flight);
    }

    /// Job `tick` begins.
    pub(crate) fn begin(&self, tick: u64) {
        if let Some(flight) = &self.flight {
            flight.begin(tick);
        }
    }

    /// The task at `position`, counted from 1, begins; 0: the job is over.
    pub(crate) fn enter(&self, position: u32) {
        if let Some(flight) = &self.flight {
            flight.enter(position);
        }
    }

    pub(crate) fn dropped(&self) -> u64 {
        self.dropped
    }
}

/// Room that a lane keeps in front of the encoded body.
pub(crate) const HEADER_BYTES: usize = HEADER;

fn word<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut out = [0; N];
    out.copy_from_slice(&bytes[at..at + N]);
    out
}

impl Drain {
    /// Hands every complete record in the ring to `observer`; returns how many.
    pub(crate) fn drain(&mut self, observer: &mut dyn Observer) -> usize {
        let mut count = 0;
        // Records are pushed whole, so a header that is there is followed by its body.
        while self.ring.slots() >= HEADER {
            let (head, _) = self.scratch.split_at_mut(HEADER);
            if self.ring.pop_entire_slice(head).is_err() {
                break;
            }
            let length = u32::from_le_bytes(word(head, 4)) as usize;
            let signal = usize::from(u16::from_le_bytes(word(head, 0)));
            let tick = u64::from_le_bytes(word(head, 8));
            let release = Nanos(i64::from_le_bytes(word(head, 16)));
            let body = &mut self.scratch[HEADER..HEADER + length];
            if self.ring.pop_entire_slice(body).is_err() {
                break;
            }
            observer.record(&Record { signal, tick, release, body });
            count += 1;
        }
        count
    }
}
