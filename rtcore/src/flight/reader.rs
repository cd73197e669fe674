//! Reads the file of a flight recorder. Every number in it is checked: only records that fit the
//! file and their neighbours are used.

use taktil_hal::Nanos;

use super::{
    FILE_MAGIC, FORMAT_VERSION, HEAD_AT, HEADER_PAGE_BYTES, LANE_BLOCK_BYTES, LANE_TABLE_AT,
    LANES_MAX, RECORD_HEADER_BYTES, TAIL_AT, TASK_AT, TICK_AT,
};
use super::{Record, record_size};

/// No job has a larger number, and none is released later (ns): seventy years, in bounds where sums
/// and differences of two fit their words.
const TICK_MAX: u64 = 1 << 61;

/// What was found in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlightRecording {
    /// What explains the records.
    pub about: String,
    /// What the kernel granted; empty when the process ended before that was known.
    pub granted: String,
    /// Each lane, in the machine's order.
    pub lanes: Vec<LaneRecording>,
}

/// What one lane left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LaneRecording {
    /// The job that ran last.
    pub tick: u64,
    /// The task, counted from 0, that was running when the process ended.
    pub running: Option<usize>,
    /// Why records at its end could not be used, if so.
    pub damage: Option<String>,
    bytes: Vec<u8>,
    records: Vec<usize>,
}

impl LaneRecording {
    /// Its records from the oldest on.
    pub fn records(&self) -> impl DoubleEndedIterator<Item = Record<'_>> {
        self.records.iter().map(|at| {
            let head = &self.bytes[*at..];
            Record {
                signal: usize::from(u16::from_le_bytes([head[8], head[9]])),
                tick: word(head, 16),
                release: Nanos(word(head, 24).cast_signed()),
                body: &head[RECORD_HEADER_BYTES..RECORD_HEADER_BYTES + length(head)],
            }
        })
    }
}

/// Reads a whole file.
///
/// # Errors
/// The reason why it is not a flight recording: empty, another format, another version, cut.
pub fn read(file: &[u8]) -> Result<FlightRecording, String> {
    if file.is_empty() {
        return Err("it is empty".to_owned());
    }
    if file.len() < HEADER_PAGE_BYTES || !file.starts_with(FILE_MAGIC) {
        return Err("it is no flight recording; `--flight FILE` writes one".to_owned());
    }
    let version = u32::from_le_bytes([file[8], file[9], file[10], file[11]]);
    if version != FORMAT_VERSION {
        return Err(format!(
            "it has version {version} of the format, this program reads {FORMAT_VERSION}"
        ));
    }
    let count = u32::from_le_bytes([file[12], file[13], file[14], file[15]]) as usize;
    if count > LANES_MAX {
        return Err(format!("its header is damaged: {count} lanes"));
    }
    let about = text(file, 16, "explains")?;
    let granted = text(file, 32, "says what was granted")?;
    let mut lanes = Vec::new();
    // A ring is copied: those of a damaged header could be the whole file, again and again.
    let mut room = file.len() as u64;
    for lane in 0..count {
        let (first, ring) =
            (word(file, LANE_TABLE_AT + 16 * lane), word(file, LANE_TABLE_AT + 16 * lane + 8));
        let block = slice(file, first, LANE_BLOCK_BYTES as u64);
        let bytes = slice(file, first.saturating_add(LANE_BLOCK_BYTES as u64), ring);
        let (Some(block), Some(bytes)) = (block, bytes) else {
            return Err(format!("it is cut: {} bytes, and lane {lane} lies behind", file.len()));
        };
        room = room.checked_sub(ring).ok_or("its header is damaged: rings overlap")?;
        lanes.push(trace(block, bytes));
    }
    Ok(FlightRecording { about, granted, lanes })
}

fn word(bytes: &[u8], at: usize) -> u64 {
    let mut word = [0; 8];
    word.copy_from_slice(&bytes[at..at + 8]);
    u64::from_le_bytes(word)
}

fn length(head: &[u8]) -> usize {
    u32::from_le_bytes([head[12], head[13], head[14], head[15]]) as usize
}

fn slice(file: &[u8], first: u64, bytes: u64) -> Option<&[u8]> {
    let first = usize::try_from(first).ok()?;
    file.get(first..first.checked_add(usize::try_from(bytes).ok()?)?)
}

fn text(file: &[u8], at: usize, what: &str) -> Result<String, String> {
    let room = slice(file, word(file, at), word(file, at + 8)).filter(|room| room.len() >= 8);
    let room = room.ok_or_else(|| format!("it is cut before the text that {what}"))?;
    let bytes = slice(room, 8, word(room, 0));
    let text = bytes.and_then(|bytes| core::str::from_utf8(bytes).ok());
    text.map(str::to_owned).ok_or_else(|| format!("the text that {what} is damaged"))
}

/// Walks a ring from its tail to its head.
pub(super) fn trace(block: &[u8], ring: &[u8]) -> LaneRecording {
    let (tail, head) = (word(block, TAIL_AT), word(block, HEAD_AT));
    let running = usize::try_from(word(block, TASK_AT)).ok().and_then(|task| task.checked_sub(1));
    let mut lane =
        LaneRecording { tick: word(block, TICK_AT), running, ..LaneRecording::default() };
    let capacity = ring.len() as u64;
    if capacity == 0 || head < tail || head - tail > capacity {
        lane.damage = Some(format!("its ends {tail} and {head} do not fit a ring of {capacity}"));
        return lane;
    }
    // Unrolled, so that a record is one piece.
    let start = (tail % capacity) as usize;
    lane.bytes = ring[start..].iter().chain(&ring[..start]).copied().collect();
    let used = (head - tail) as usize;
    let (mut at, mut number) = (0, None);
    while at < used {
        let here = &lane.bytes[at..used];
        let size =
            if here.len() < RECORD_HEADER_BYTES { None } else { u32::try_from(length(here)).ok() };
        let size = size.map(|body| record_size(body) as usize).filter(|size| *size <= here.len());
        let follows = size.is_some()
            && number.is_none_or(|number: u64| Some(word(here, 0)) == number.checked_add(1));
        let is_instant = size.is_some()
            && word(here, 16) <= TICK_MAX
            && word(here, 24).cast_signed().unsigned_abs() <= TICK_MAX;
        let (Some(size), true) = (size, follows && is_instant) else {
            let whole = lane.records.len();
            lane.damage =
                Some(format!("{} bytes behind its record {whole} are damaged", used - at));
            break;
        };
        number = Some(word(here, 0));
        lane.records.push(at);
        at += size;
    }
    lane
}
