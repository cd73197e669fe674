//! A writer that is killed after any store leaves whole records. The tests try every place where a
//! process can be killed, with every outcome for the bytes that nothing orders there, and protocols
//! with one step wrong have to be rejected by the same tests. What the processor does is not
//! modelled: the reader comes after the writer's end, when all that the writer stored before has
//! arrived.

use std::cell::RefCell;
use std::rc::Rc;

use taktil_hal::Nanos;

use super::reader::trace;
use super::*;

/// Bytes of the ring: some records, not a whole number of them, so that they lie across its end.
const RING_BYTES: usize = 200;

/// One store as the protocol asks for it.
#[derive(Clone, Debug, PartialEq)]
struct Store {
    /// Into the ring, not into the words.
    ring: bool,
    at: usize,
    bytes: Vec<u8>,
    /// Between what came before and what comes after.
    ordered: bool,
}

type Journal = Rc<RefCell<Vec<Store>>>;

/// Memory that writes down each store.
struct JournaledMemory {
    bytes: RefCell<Vec<u8>>,
    ring: bool,
    journal: Journal,
}

impl JournaledMemory {
    fn new(size: usize, ring: bool, journal: &Journal) -> JournaledMemory {
        JournaledMemory { bytes: RefCell::new(vec![0; size]), ring, journal: journal.clone() }
    }

    fn store(&self, at: usize, bytes: &[u8], ordered: bool) {
        if bytes.is_empty() {
            return;
        }
        self.bytes.borrow_mut()[at..at + bytes.len()].copy_from_slice(bytes);
        let (ring, bytes) = (self.ring, bytes.to_vec());
        self.journal.borrow_mut().push(Store { ring, at, bytes, ordered });
    }
}

impl Memory for JournaledMemory {
    fn len(&self) -> usize {
        self.bytes.borrow().len()
    }
    fn write(&mut self, at: usize, bytes: &[u8]) {
        self.store(at, bytes, false);
    }
    fn read(&self, at: usize, bytes: &mut [u8]) {
        bytes.copy_from_slice(&self.bytes.borrow()[at..at + bytes.len()]);
    }
    fn store_ordered(&self, at: usize, word: u64) {
        self.store(at, &word.to_le_bytes(), true);
    }
    fn store_relaxed(&self, at: usize, word: u64) {
        self.store(at, &word.to_le_bytes(), false);
    }
}

/// Body of record `number`: of some lengths, each byte the number.
fn body(number: u8) -> Vec<u8> {
    vec![number; [10, 24, 0, 17][usize::from(number % 4)]]
}

fn message(number: u8) -> Vec<u8> {
    let body = body(number);
    let mut out = vec![1, 0, 0, 0];
    out.extend(u32::try_from(body.len()).unwrap().to_le_bytes());
    out.extend(u64::from(number).to_le_bytes());
    out.extend((1_000 * i64::from(number)).to_le_bytes());
    out.extend(body);
    out
}

/// The stores of each of so many records.
fn journal(records: u8) -> Vec<Vec<Store>> {
    let journal = Journal::default();
    let (words, ring) = (
        JournaledMemory::new(LANE_BLOCK_BYTES, false, &journal),
        JournaledMemory::new(RING_BYTES, true, &journal),
    );
    let mut flight = FlightRing { words, ring, tail: 0, head: 0, number: 0 };
    let put = |number| {
        flight.append(&message(number));
        journal.take()
    };
    (0..records).map(put).collect()
}

/// Memory after the process ended.
#[derive(Clone)]
struct MemoryAfterKill {
    words: Vec<u8>,
    ring: Vec<u8>,
}

impl MemoryAfterKill {
    fn take(&mut self, store: &Store) {
        let memory = if store.ring { &mut self.ring } else { &mut self.words };
        memory[store.at..store.at + store.bytes.len()].copy_from_slice(&store.bytes);
    }

    /// The same with something else where the store was to go.
    fn corrupt(&mut self, store: &Store, garbage: u8) {
        if store.ring {
            self.ring[store.at..store.at + store.bytes.len()].fill(garbage);
        }
    }

    /// What the reader makes of it, if that is no run of whole records up to one of `last`.
    fn wrong(&self, last: &[Option<u8>]) -> Option<String> {
        let lane = trace(&self.words, &self.ring);
        if let Some(damage) = lane.damage {
            return Some(damage);
        }
        let ticks: Vec<u64> = lane.records().map(|record| record.tick).collect();
        let whole = lane.records().all(|record| {
            let number = u8::try_from(record.tick).unwrap_or(u8::MAX);
            record.body == body(number) && record.release == Nanos(1_000 * i64::from(number))
        });
        let in_row = ticks.windows(2).all(|pair| pair[1] == pair[0] + 1);
        let end = last.contains(&ticks.last().and_then(|tick| u8::try_from(*tick).ok()));
        (!(whole && in_row && end)).then(|| format!("records {ticks:?}, expected up to {last:?}"))
    }
}

/// Kills the writer at every place of every record; the first place where that is seen, if any.
///
/// Between two ordered stores the others may have arrived or not, each for itself and torn: words
/// are taken old or new, in all combinations, and bytes of the ring are garbage of three kinds.
fn first_inconsistency(journal: &[Vec<Store>]) -> Option<String> {
    let mut before =
        MemoryAfterKill { words: vec![0; LANE_BLOCK_BYTES], ring: vec![0; RING_BYTES] };
    let mut last = None;
    for (number, stores) in journal.iter().enumerate() {
        let new = u8::try_from(number).ok();
        // What has certainly arrived, and from there on what is under way.
        let mut first = 0;
        for stop in 0..=stores.len() {
            if stop > 0 && stores[stop - 1].ordered {
                stores[first..stop].iter().for_each(|store| before.take(store));
                first = stop;
            }
            let under_way = &stores[first..stop];
            let words: Vec<&Store> = under_way.iter().filter(|store| !store.ring).collect();
            for chosen in 0..1_u32 << words.len() {
                for garbage in [0x00, 0xA5, 0xFF] {
                    let mut found = before.clone();
                    under_way.iter().for_each(|store| found.corrupt(store, garbage));
                    let arrived = words.iter().enumerate().filter(|(n, _)| chosen >> n & 1 == 1);
                    arrived.for_each(|(_, store)| found.take(store));
                    let ends = [last, new];
                    if let Some(wrong) = found.wrong(&ends) {
                        return Some(format!("record {number}, {stop} stores: {wrong}"));
                    }
                }
            }
        }
        stores[first..].iter().for_each(|store| before.take(store));
        last = new;
        if let Some(wrong) = before.wrong(&[last]) {
            return Some(format!("after record {number}: {wrong}"));
        }
    }
    None
}

const RECORD_COUNT: u8 = 40;

#[test]
fn a_writer_killed_at_any_store_leaves_whole_records() {
    let journal = journal(RECORD_COUNT);
    let across = |store: &&Store| store.ring && store.at == 0;
    assert!(journal.iter().flatten().filter(across).count() > 4, "the ring's end is passed");
    assert_eq!(first_inconsistency(&journal), None);
}

/// A protocol with one step wrong.
type Mistake = fn(&mut Vec<Store>);

#[test]
fn protocols_with_one_step_wrong_are_rejected() {
    let wrong: [(&str, Mistake); 6] = [
        ("the head before the copy", |stores| {
            let head = stores.pop().unwrap();
            stores.insert(1, head);
        }),
        ("the tail after the copy", |stores| {
            let tail = stores.remove(0);
            stores.insert(stores.len() - 1, tail);
        }),
        ("the tail after the head", |stores| stores.rotate_left(1)),
        ("no tail", |stores| drop(stores.remove(0))),
        ("the tail in no order", |stores| stores[0].ordered = false),
        ("the head in no order", |stores| stores.last_mut().unwrap().ordered = false),
    ];
    for (name, mistake) in wrong {
        let mut journal = journal(RECORD_COUNT);
        for stores in &mut journal {
            let ends = [&stores[0], stores.last().unwrap()].map(|store| (store.ring, store.at));
            assert_eq!(ends, [(false, TAIL_AT), (false, HEAD_AT)], "the protocol is another");
            mistake(stores);
        }
        assert!(first_inconsistency(&journal).is_some(), "{name} was not rejected");
    }
}
