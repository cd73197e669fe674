//! The flight recorder: the newest records of every lane in a file in memory, which outlives the
//! process and contains all that is needed to read it. A lane copies each record that it hands to
//! observers into its own ring, without a call of the kernel and without the heap. The file must
//! lie in memory, not on a disk. The reader does not trust the file: [`read`] accepts any bytes and
//! reports what is wrong with them.
//!
//! The file, little-endian: a page of header, two texts, then for each lane a block of words and
//! its ring.
//!
//! | at | header |
//! |---|---|
//! | 0 | `TAKTILFR` |
//! | 8 | version, number of lanes (u32 each) |
//! | 16 | first byte and room of the text `about` (u64 each), then of the text `granted` |
//! | 48 + 16 k | first byte of lane k's block, bytes of its ring (u64 each) |
//!
//! A text is its length (u64) and UTF-8. A block is 64 bytes: `tail` and `head`, positions in the
//! endless stream of records (position modulo ring size is the place), then the job and the place
//! in the lane plus 1 of the task that runs, 0 between jobs. A record is its number (u64), signal
//! (u16), two zeros, length of the body (u32), tick (u64), release (i64), body, zeros up to a
//! multiple of 8. Before a record overwrites others `tail` is moved behind them, after it is
//! complete `head` is: whenever the process is killed, what lies between the two is whole.

use std::path::Path;

use taktil_hal::Invalid;

use crate::mapping::{MappedRegion, create};
use crate::record::{Catalog, HEADER_BYTES, Record};

const FILE_MAGIC: &[u8; 8] = b"TAKTILFR";
const FORMAT_VERSION: u32 = 1;
/// Bytes of the header.
const HEADER_PAGE_BYTES: usize = 4096;
/// Bytes of a lane's words.
const LANE_BLOCK_BYTES: usize = 64;
/// Lanes that the header has room for.
const LANES_MAX: usize = (HEADER_PAGE_BYTES - LANE_TABLE_AT) / 16;
/// Where the table of lanes starts.
const LANE_TABLE_AT: usize = 48;
/// Room for what the kernel granted, which is known later.
const GRANTED_BYTES_MAX: usize = 1 << 16;
/// Bytes in front of a body: number, then what a record carries to observers.
const RECORD_HEADER_BYTES: usize = 8 + HEADER_BYTES;
/// Places of a lane's words in its block.
const TAIL_AT: usize = 0;
const HEAD_AT: usize = 8;
const TICK_AT: usize = 16;
const TASK_AT: usize = 24;
/// Most that all rings may take.
const RINGS_BYTES_MAX: usize = 1 << 28;

/// A flight recorder that was not attached to a machine yet.
pub struct FlightRecorder {
    lanes: Vec<FlightRing>,
}

/// Writes the text that says what the kernel granted, which is known after the file was made.
pub struct GrantWriter {
    texts: MappedRegion,
    granted_at: usize,
}

/// The memory of a ring; positions are in bytes. The mapped file implements it, and the tests have
/// an implementation whose writer can be stopped anywhere.
pub(crate) trait Memory {
    /// Bytes of it.
    fn len(&self) -> usize;
    /// Copies `bytes` to a place; in what order they arrive is not said.
    fn write(&mut self, at: usize, bytes: &[u8]);
    /// Copies from a place.
    fn read(&self, at: usize, bytes: &mut [u8]);
    /// Stores a word after everything that was written before, before all that is written after.
    fn store_ordered(&self, at: usize, word: u64);
    /// Stores a word in no particular order.
    fn store_relaxed(&self, at: usize, word: u64);
}

impl Memory for MappedRegion {
    fn len(&self) -> usize {
        MappedRegion::len(self)
    }
    fn write(&mut self, at: usize, bytes: &[u8]) {
        MappedRegion::write(self, at, bytes);
    }
    fn read(&self, at: usize, bytes: &mut [u8]) {
        MappedRegion::read(self, at, bytes);
    }
    fn store_ordered(&self, at: usize, word: u64) {
        MappedRegion::store_ordered(self, at, word);
    }
    fn store_relaxed(&self, at: usize, word: u64) {
        MappedRegion::store_relaxed(self, at, word);
    }
}

/// One lane's ring, written by that lane only.
pub(crate) struct FlightRing<M = MappedRegion> {
    words: M,
    ring: M,
    tail: u64,
    head: u64,
    number: u64,
}

/// Creates the file for a machine with this catalog: rings for the last `seconds` of each lane, and
/// `about`, a text that explains them.
///
/// # Errors
/// Seconds that are none or too many, and a file that cannot be had in memory. The place is
/// `seconds` or `path`.
pub fn record(
    path: &Path,
    catalog: &Catalog,
    seconds: f64,
    about: &str,
) -> Result<(FlightRecorder, GrantWriter), Invalid> {
    if !(0.01..=3600.0).contains(&seconds) {
        let what = format!("{seconds} s is no time to record");
        return Err(Invalid::new("seconds", what, "give 0.01 to 3600 seconds"));
    }
    let rings: Vec<usize> =
        (0..catalog.lanes.len()).map(|lane| ring_bytes(catalog, lane, seconds)).collect();
    if catalog.lanes.len() > LANES_MAX
        || rings.iter().fold(0, |a: usize, b| a.saturating_add(*b)) > RINGS_BYTES_MAX
    {
        let what =
            format!("{seconds} s of this machine are more than {} MiB", RINGS_BYTES_MAX >> 20);
        return Err(Invalid::new("seconds", what, "record fewer seconds"));
    }
    let about_bytes = (8 + about.len()).next_multiple_of(64);
    let mut sizes = vec![HEADER_PAGE_BYTES, about_bytes + GRANTED_BYTES_MAX];
    for ring in &rings {
        sizes.extend([LANE_BLOCK_BYTES, *ring]);
    }
    let mut parts = create(path, &sizes)?.into_iter();
    let (Some(mut header), Some(mut texts)) = (parts.next(), parts.next()) else {
        return Err(Invalid::new("path", "no memory", "name a file in /run or /dev/shm"));
    };
    write_text(&mut texts, 0, about);
    let mut page = vec![0; HEADER_PAGE_BYTES];
    let mut word = |at: usize, word: u64| page[at..at + 8].copy_from_slice(&word.to_le_bytes());
    word(16, HEADER_PAGE_BYTES as u64);
    word(24, about_bytes as u64);
    word(32, (HEADER_PAGE_BYTES + about_bytes) as u64);
    word(40, GRANTED_BYTES_MAX as u64);
    let mut at = HEADER_PAGE_BYTES + about_bytes + GRANTED_BYTES_MAX;
    for (lane, ring) in rings.iter().enumerate() {
        word(LANE_TABLE_AT + 16 * lane, at as u64);
        word(LANE_TABLE_AT + 16 * lane + 8, *ring as u64);
        at += LANE_BLOCK_BYTES + ring;
    }
    page[8..12].copy_from_slice(&FORMAT_VERSION.to_le_bytes());
    page[12..16].copy_from_slice(&u32::try_from(rings.len()).unwrap_or(0).to_le_bytes());
    header.write(8, &page[8..]);
    // Last, so that a file with its mark is complete.
    header.store_ordered(0, u64::from_le_bytes(*FILE_MAGIC));
    let mut lanes = Vec::new();
    while let (Some(words), Some(ring)) = (parts.next(), parts.next()) {
        lanes.push(FlightRing { words, ring, tail: 0, head: 0, number: 0 });
    }
    Ok((FlightRecorder { lanes }, GrantWriter { texts, granted_at: about_bytes }))
}

/// Bytes that a lane writes in `seconds`, and in four jobs at least.
fn ring_bytes(catalog: &Catalog, lane: usize, seconds: f64) -> usize {
    let size = |size: usize| (RECORD_HEADER_BYTES + size).next_multiple_of(8);
    let own = catalog.signals.iter().filter(|signal| signal.lane == lane);
    let job: usize = own.map(|signal| size(signal.size)).sum();
    let jobs = (seconds / catalog.lanes[lane].period.as_secs_f64()).ceil().clamp(4.0, 1e9);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "4 to 1e9")]
    let jobs = jobs as usize;
    job.max(LANE_BLOCK_BYTES).saturating_mul(jobs).min(RINGS_BYTES_MAX + 64).next_multiple_of(64)
}

fn write_text(part: &mut MappedRegion, at: usize, text: &str) {
    part.write(at + 8, text.as_bytes());
    part.store_ordered(at, text.len() as u64);
}

impl FlightRecorder {
    /// The rings, one a lane.
    pub(crate) fn into_lanes(self) -> Vec<FlightRing> {
        self.lanes
    }
}

impl GrantWriter {
    /// Writes what the kernel granted; a text that is too long is left out.
    pub fn write_granted(&mut self, text: &str) {
        if text.len() + 8 <= GRANTED_BYTES_MAX {
            write_text(&mut self.texts, self.granted_at, text);
        }
    }
}

impl<M: Memory> FlightRing<M> {
    /// Job `tick` begins.
    pub(crate) fn begin_job(&self, tick: u64) {
        self.words.store_relaxed(TICK_AT, tick);
    }

    /// The task at `position`, counted from 1, begins; 0: the job is over.
    pub(crate) fn enter_task(&self, position: u32) {
        self.words.store_relaxed(TASK_AT, u64::from(position));
    }

    /// Keeps one record as the lane hands it to observers.
    pub(crate) fn append(&mut self, message: &[u8]) {
        let size = (8 + message.len()).next_multiple_of(8) as u64;
        let capacity = self.ring.len() as u64;
        if size > capacity {
            return;
        }
        // At most one ring full of records is passed over, a record at a time.
        while self.head + size > self.tail + capacity {
            self.tail += self.size_at(self.tail);
        }
        self.words.store_ordered(TAIL_AT, self.tail);
        self.copy(self.head, &self.number.to_le_bytes());
        self.copy(self.head + 8, message);
        self.head += size;
        self.number += 1;
        self.words.store_ordered(HEAD_AT, self.head);
    }

    /// Bytes of the record at a position: its length stands in the word behind its number.
    fn size_at(&self, position: u64) -> u64 {
        let mut word = [0; 8];
        self.ring.read(self.place(position + 8), &mut word);
        let [_, _, _, _, a, b, c, d] = word;
        record_size(u32::from_le_bytes([a, b, c, d]))
    }

    fn place(&self, position: u64) -> usize {
        (position % (self.ring.len() as u64)) as usize
    }

    /// Copies into the ring, around its end if need be.
    fn copy(&mut self, position: u64, bytes: &[u8]) {
        let place = self.place(position);
        let (first, second) = bytes.split_at(bytes.len().min(self.ring.len() - place));
        self.ring.write(place, first);
        self.ring.write(0, second);
    }
}

fn record_size(body: u32) -> u64 {
    (RECORD_HEADER_BYTES as u64 + u64::from(body)).next_multiple_of(8)
}

mod reader;

pub use reader::{FlightRecording, LaneRecording, read};

#[cfg(test)]
mod killed;
#[cfg(test)]
mod tests;
