//! Logs that end anywhere: nothing panics, everything up to the last whole chunk is read, nothing
//! is read that was not written, and what is recovered is a whole log of the same messages.

use std::collections::BTreeMap;
use std::path::PathBuf;

use taktil_record::joined::{JoinedLog, Repetition};
use taktil_record::{Log, McapLog};
use taktil_rtcore::record::{Catalog, LaneInfo, Observer, Record, Signal};
use taktil_rtcore::{Nanos, Payload};

/// Bytes of opcode and length in front of a record of the format.
const RECORD_HEADER_BYTES: usize = 9;
/// Opcode of a message.
const MESSAGE_OPCODE: u8 = 0x05;
/// Opcode of a chunk.
const CHUNK_OPCODE: u8 = 0x06;
/// Bytes of a chunk without compression in front of its records: two times, size, checksum, the
/// empty name of the compression, size.
const CHUNK_HEADER_BYTES: usize = 40;
/// Places at which a long log is cut beside the ends of its records.
const DRAWN_CUTS: u64 = 1000;

taktil_rtcore::payload! {
    /// A body of some bytes.
    pub struct Block {
        /// Numbers that nobody reads.
        pub words: [u64; 5],
    }
}

fn catalog() -> Catalog {
    let signal = |name: &str| Signal {
        name: name.into(),
        lane: 0,
        type_name: Block::NAME.into(),
        fields: Block::FIELDS.into(),
        size: Block::SIZE,
    };
    Catalog { signals: vec![signal("a.x"), signal("b.y")], lanes: vec![LaneInfo::default()] }
}

/// A log of so many jobs, one each 10 ms, thus of ten in a chunk.
fn log(jobs: u64) -> Vec<u8> {
    let about = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
    let mut log = McapLog::in_memory(&catalog(), &about).unwrap();
    for tick in 0..jobs {
        let release = Nanos::from_millis(10 * tick.cast_signed());
        for signal in 0..2 {
            let body = [tick.to_le_bytes()[0] ^ 0x55; Block::SIZE];
            log.record(&Record { signal, tick, release, body: &body });
        }
        if tick % 25 == 7 {
            log.write_metadata("note", "{}");
        }
    }
    log.into_bytes().unwrap()
}

/// Where records end, those in chunks too, and how many messages stand before each end; the second
/// of each pair counts those of whole chunks only.
struct Boundary {
    end: usize,
    messages: usize,
    messages_of_whole_chunks: usize,
}

fn boundaries(bytes: &[u8]) -> Vec<Boundary> {
    let size = |at: usize| {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap());
        RECORD_HEADER_BYTES + usize::try_from(length).unwrap()
    };
    let (mut at, mut messages, mut whole) = (8, 0, 0);
    let mut all = Vec::new();
    let end_of_file = bytes.len() - 8;
    while at < end_of_file {
        let end = at + size(at);
        if bytes[at] == CHUNK_OPCODE {
            let mut inner = at + RECORD_HEADER_BYTES + CHUNK_HEADER_BYTES;
            while inner < end {
                messages += usize::from(bytes[inner] == MESSAGE_OPCODE);
                inner += size(inner);
                let whole = if inner == end { messages } else { whole };
                all.push(Boundary { end: inner, messages, messages_of_whole_chunks: whole });
            }
            whole = messages;
        }
        at = end;
        all.push(Boundary { end, messages, messages_of_whole_chunks: whole });
    }
    all
}

/// What a log says: channel and tick of each message.
fn messages(log: &Log) -> Vec<(usize, u64)> {
    log.messages().map(|message| (message.channel, message.tick)).collect()
}

/// Cuts a log at a byte and holds what is read against what was written.
fn check_cut(bytes: &[u8], all: &[(usize, u64)], boundaries: &[Boundary], cut: usize) {
    let before = boundaries.partition_point(|boundary| boundary.end <= cut);
    let last = before.checked_sub(1).map(|index| &boundaries[index]);
    let least = last.map_or(0, |boundary| boundary.messages_of_whole_chunks);
    let most = last.map_or(0, |boundary| boundary.messages);
    match Log::from_bytes(bytes[..cut].to_vec()) {
        Ok(read) => {
            let found = messages(&read);
            assert!(all.starts_with(&found), "cut at {cut}");
            let count = found.len();
            assert!((least..=most).contains(&count), "cut at {cut}: {least}, {count}, {most}");
            assert_eq!(read.damage().is_none(), cut == bytes.len(), "cut at {cut}");
        }
        Err(refused) => assert!(cut == 0, "cut at {cut}: {refused:#}"),
    }
}

#[test]
fn a_short_log_is_read_up_to_its_last_whole_chunk_wherever_it_ends() {
    let bytes = log(130);
    assert!((20_000..=64_000).contains(&bytes.len()), "{} bytes", bytes.len());
    let boundaries = boundaries(&bytes);
    let all = messages(&Log::from_bytes(bytes.clone()).unwrap());
    assert_eq!(all.len(), 260);
    assert_eq!(boundaries.last().unwrap().messages_of_whole_chunks, 260);
    for cut in 0..=bytes.len() {
        check_cut(&bytes, &all, &boundaries, cut);
    }
}

#[test]
fn a_long_log_is_read_up_to_its_last_whole_chunk_wherever_it_ends() {
    let bytes = log(1000);
    assert!(bytes.len() > 200_000, "{} bytes", bytes.len());
    let boundaries = boundaries(&bytes);
    let all = messages(&Log::from_bytes(bytes.clone()).unwrap());
    for boundary in &boundaries {
        for cut in boundary.end - 1..=boundary.end + 1 {
            check_cut(&bytes, &all, &boundaries, cut);
        }
    }
    let mut state: u64 = 1;
    for _ in 0..DRAWN_CUTS {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let cut = usize::try_from(state >> 33).unwrap() % bytes.len();
        check_cut(&bytes, &all, &boundaries, cut);
    }
}

#[test]
fn what_is_recovered_is_a_whole_log_of_what_could_be_read() {
    let bytes = log(60);
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("cuts");
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("recovered.mcap");
    for boundary in boundaries(&bytes) {
        for cut in boundary.end - 1..=boundary.end + 1 {
            let read = Log::from_bytes(bytes[..cut].to_vec()).unwrap();
            // A file that holds another log is kept when there is nothing to write.
            let _ = std::fs::remove_file(&path);
            let mut joined = JoinedLog::create(&path, &read).unwrap();
            joined.append(&read, Repetition::Kept).unwrap();
            joined.finish(Some(&read)).unwrap();
            let recovered = Log::open(&path).unwrap();
            assert_eq!(recovered.damage(), None, "cut at {cut}");
            assert_eq!(messages(&recovered), messages(&read), "cut at {cut}");
        }
    }
}
