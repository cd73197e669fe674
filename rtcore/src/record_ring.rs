//! The lock-free byte ring through which records travel between two threads: those of one lane to
//! its observers, and those of an observer to a thread that may wait ([`queue`]). It never slows
//! its writer down: when the ring is full the record is dropped and counted, and the gap is visible
//! to the observer.

use taktil_hal::Nanos;

use crate::flight::FlightRing;
use crate::record::{Catalog, HEADER_BYTES, Observer, Record};

/// Bytes that every queue offers to a body, also for a catalog with shorter ones: room for records
/// of the queue's owner, whose signal lies behind those of the catalog.
pub const OWN_BODY_BYTES: usize = 64;

/// The lane's end of the ring.
pub(crate) struct RecordWriter {
    ring: rtrb::Producer<u8>,
    dropped: u64,
    flight: Option<FlightRing>,
}

/// The observer's end of the ring.
pub struct RecordReader {
    ring: rtrb::Consumer<u8>,
    scratch: Vec<u8>,
}

/// The end of a [`queue`] that takes records. It neither waits nor allocates nor calls the kernel,
/// so that the thread behind it cannot hold up the one in front.
pub struct RecordSender {
    ring: rtrb::Producer<u8>,
    message: Vec<u8>,
    body_bytes_max: usize,
    capacity: usize,
    lost: u64,
}

/// A bounded queue of records between two threads. It has `capacity_bytes` bytes, or room for one
/// record of each signal of `catalog` if that is more; a record takes 24 bytes and its body. All of
/// it is touched here, so that no page of it is missing later.
#[must_use]
pub fn queue(capacity_bytes: usize, catalog: &Catalog) -> (RecordSender, RecordReader) {
    let bodies = catalog.signals.iter().map(|signal| signal.size);
    let longest = bodies.clone().max().unwrap_or(0).max(OWN_BODY_BYTES);
    let once = bodies.map(|body| HEADER_BYTES + body).sum::<usize>();
    let capacity = capacity_bytes.max(once).max(HEADER_BYTES + longest);
    let (mut ring, mut consumer) = rtrb::RingBuffer::new(capacity);
    if let Ok(all) = ring.write_chunk(capacity) {
        all.commit_all();
    }
    if let Ok(all) = consumer.read_chunk(capacity) {
        all.commit_all();
    }
    let message = Vec::with_capacity(HEADER_BYTES + longest);
    let reader = RecordReader { ring: consumer, scratch: vec![0; HEADER_BYTES + longest] };
    (RecordSender { ring, message, body_bytes_max: longest, capacity, lost: 0 }, reader)
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
        message[..HEADER_BYTES].copy_from_slice(&header(signal, length, tick, release));
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

/// What stands in front of a body.
fn header(signal: u16, length: u32, tick: u64, release: Nanos) -> [u8; HEADER_BYTES] {
    let mut header = [0; HEADER_BYTES];
    header[0..2].copy_from_slice(&signal.to_le_bytes());
    header[4..8].copy_from_slice(&length.to_le_bytes());
    header[8..16].copy_from_slice(&tick.to_le_bytes());
    header[16..24].copy_from_slice(&release.0.to_le_bytes());
    header
}

impl RecordSender {
    /// Puts a record into the queue; false, and counted as lost, when it does not fit: the queue is
    /// full, or the body is longer than that of any signal.
    pub fn send(&mut self, record: &Record<'_>) -> bool {
        let sent = self.try_send(record);
        self.lost += u64::from(!sent);
        sent
    }

    /// As [`RecordSender::send`], of a record that is not counted when it does not fit.
    pub fn try_send(&mut self, record: &Record<'_>) -> bool {
        let numbers = u16::try_from(record.signal).ok().zip(u32::try_from(record.body.len()).ok());
        let fits = record.body.len() <= self.body_bytes_max;
        let Some((signal, length)) = numbers.filter(|_| fits) else { return false };
        self.message.clear();
        self.message.extend_from_slice(&header(signal, length, record.tick, record.release));
        self.message.extend_from_slice(record.body);
        self.ring.push_entire_slice(&self.message).is_ok()
    }

    /// Counts a record as lost that was not tried.
    pub fn count_lost(&mut self) {
        self.lost += 1;
    }

    /// Records that did not fit since the queue was made.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Bytes of the queue.
    #[must_use]
    pub fn capacity_bytes(&self) -> usize {
        self.capacity
    }

    /// Bytes that are waiting in the queue.
    #[must_use]
    pub fn queued_bytes(&self) -> usize {
        self.capacity - self.ring.slots().min(self.capacity)
    }

    /// Whether the thread behind the queue has dropped its end.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.ring.is_abandoned()
    }
}

impl Observer for RecordSender {
    fn record(&mut self, record: &Record<'_>) {
        self.send(record);
    }
}

fn word<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut out = [0; N];
    out.copy_from_slice(&bytes[at..at + N]);
    out
}

impl RecordReader {
    /// Hands every record that is in the ring at the call to `observer`; returns how many. Those
    /// that come while it works are left for the next call: a thread that takes records no faster
    /// than they come would never get to its other duties.
    pub fn drain(&mut self, observer: &mut dyn Observer) -> usize {
        self.drain_at_most(usize::MAX, observer)
    }

    /// As [`RecordReader::drain`], but no more than `count_max` records.
    pub(crate) fn drain_at_most(&mut self, count_max: usize, observer: &mut dyn Observer) -> usize {
        let mut count = 0;
        let mut waiting = self.ring.slots();
        // Records are pushed whole, so a header that is there is followed by its body.
        while waiting >= HEADER_BYTES && count < count_max {
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
            waiting = waiting.saturating_sub(HEADER_BYTES + length);
            observer.record(&Record { signal, tick, release, body });
            count += 1;
        }
        count
    }

    /// Whether the thread in front of the queue has dropped its end.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.ring.is_abandoned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Signal;

    #[derive(Default)]
    struct Seen(Vec<(usize, u64, i64, Vec<u8>)>);

    impl Observer for Seen {
        fn record(&mut self, record: &Record<'_>) {
            self.0.push((record.signal, record.tick, record.release.0, record.body.to_vec()));
        }
    }

    fn catalog(sizes: &[usize]) -> Catalog {
        let signal = |size: &usize| Signal {
            name: format!("a.s{size}"),
            lane: 0,
            type_name: "Bytes".into(),
            fields: Vec::new().into(),
            size: *size,
        };
        Catalog { signals: sizes.iter().map(signal).collect(), lanes: Vec::new() }
    }

    fn record(signal: usize, tick: u64, body: &[u8]) -> Record<'_> {
        Record { signal, tick, release: Nanos(-5 + tick.cast_signed()), body }
    }

    #[test]
    fn what_is_sent_arrives_whole_and_in_order_around_the_end_of_the_queue() {
        let (mut sender, mut reader) = queue(300, &catalog(&[10, 100]));
        let mut seen = Seen::default();
        for tick in 0..50 {
            let body = vec![tick as u8; if tick % 3 == 0 { 100 } else { 10 }];
            assert!(sender.send(&record(1, tick, &body)));
            assert_eq!(sender.queued_bytes(), HEADER_BYTES + body.len());
            assert_eq!(reader.drain(&mut seen), 1);
            assert_eq!(seen.0.pop(), Some((1, tick, tick as i64 - 5, body)));
        }
        assert_eq!((sender.lost(), sender.queued_bytes()), (0, 0));
    }

    /// Sends a record for each that it sees.
    struct Echo(RecordSender);

    impl Observer for Echo {
        fn record(&mut self, record: &Record<'_>) {
            self.0.send(record);
        }
    }

    #[test]
    fn records_that_come_while_others_are_taken_wait_for_the_next_call() {
        let (mut sender, mut reader) = queue(1000, &catalog(&[10]));
        for tick in 0..5 {
            sender.send(&record(0, tick, &[1; 10]));
        }
        let mut echo = Echo(sender);
        assert_eq!(reader.drain(&mut echo), 5);
        assert_eq!(reader.drain_at_most(2, &mut echo), 2);
        assert_eq!(reader.drain(&mut echo), 5);
        assert_eq!(echo.0.lost(), 0);
    }

    #[test]
    fn a_full_queue_drops_counts_and_goes_on() {
        let (mut sender, mut reader) = queue(1000, &catalog(&[100]));
        for tick in 0..20 {
            sender.record(&record(0, tick, &[1; 100]));
        }
        assert_eq!(sender.lost(), 20 - 1000 / 124);
        assert!(!sender.try_send(&record(0, 20, &[1; 100])), "it is full still");
        assert_eq!(sender.lost(), 12, "a trial is not counted");
        let mut seen = Seen::default();
        assert_eq!(reader.drain(&mut seen), 8);
        assert!(seen.0.iter().map(|record| record.1).eq(0..8));
        assert!(sender.send(&record(0, 21, &[2; 100])));
    }

    #[test]
    fn records_that_fit_no_signal_are_lost() {
        let (mut sender, mut reader) = queue(0, &catalog(&[8, 16]));
        assert_eq!(sender.capacity_bytes(), HEADER_BYTES + OWN_BODY_BYTES);
        assert!(!sender.send(&record(0, 0, &[0; OWN_BODY_BYTES + 1])));
        assert!(!sender.send(&record(1 << 16, 0, &[0; 8])));
        assert_eq!(sender.lost(), 2);
        assert!(sender.send(&record(2, 0, &[0; OWN_BODY_BYTES])), "a record of the owner's");
        assert_eq!(reader.drain(&mut Seen::default()), 1);
        drop(reader);
        assert!(sender.is_abandoned());
    }
}
