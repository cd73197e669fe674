//! Chunks: when they reach the file, what is left of them, and files of others; and what a log does
//! not replace.

use std::collections::BTreeMap;
use std::path::Path;

use taktil_hal::Nanos;
use taktil_record::{Log, McapLog};

use crate::{append_value, catalog, file, joints, write};

/// A file with one empty chunk whose header names a compression.
fn chunk_compressed_by(name: &str) -> Vec<u8> {
    let length = (name.len() as u32).to_le_bytes();
    let header = [&[0; 28][..], &length, name.as_bytes(), &[0; 8]].concat();
    let mut bytes = mcap::MAGIC.to_vec();
    bytes.push(6);
    bytes.extend((header.len() as u64).to_le_bytes());
    bytes.extend(header);
    bytes
}

#[test]
fn compressions_that_the_format_does_not_know_are_refused_with_what_helps() {
    let said = format!("{:#}", Log::from_bytes(chunk_compressed_by("brotli")).unwrap_err());
    assert!(said.contains("compressed (brotli)") && said.contains("--compression none"), "{said}");
    // No byte of these is Zstandard: the file is damaged there.
    let log = Log::from_bytes(chunk_compressed_by("zstd")).unwrap();
    let damage = log.damage().expect("its chunk holds nothing");
    assert!(damage.what.contains("compressed chunk"), "{damage}");
}

#[test]
fn chunks_of_other_programs_are_read_and_their_messages_counted() {
    let path = file("foreign.mcap");
    let out = std::io::BufWriter::new(std::fs::File::create(&path).unwrap());
    let mut writer = mcap::WriteOptions::new().compression(None).create(out).unwrap();
    let channel = writer.add_channel(0, "/a", "json", &BTreeMap::new()).unwrap();
    let (sequence, log_time, publish_time) = (0, 0, 0);
    let header =
        mcap::records::MessageHeader { channel_id: channel, sequence, log_time, publish_time };
    writer.write_to_known_channel(&header, b"{}").unwrap();
    writer.finish().unwrap();
    let log = Log::open(&path).unwrap();
    assert_eq!((log.damage(), log.chunks(), log.foreign_messages()), (None, 1, 1));
}

/// The same messages as records that stand beside each other, as logs were written before.
fn without_chunks(bytes: &[u8], closed: bool) -> Vec<u8> {
    let options = mcap::WriteOptions::new().compression(None).use_chunks(false);
    let mut writer = options.create(std::io::Cursor::new(Vec::new())).unwrap();
    for message in mcap::MessageStream::new(bytes).unwrap() {
        writer.write(&message.unwrap()).unwrap();
    }
    if closed {
        writer.finish().unwrap();
    }
    writer.into_inner().into_inner()
}

#[test]
fn logs_without_chunks_are_read_as_before() {
    let path = file("unchunked.mcap");
    write(&path, 20, "7", true);
    let bytes = std::fs::read(&path).unwrap();
    let chunked = Log::from_bytes(bytes.clone()).unwrap();
    assert!(chunked.chunks() > 0);
    let plain = Log::from_bytes(without_chunks(&bytes, true)).unwrap();
    assert_eq!((plain.damage(), plain.chunks()), (None, 0));
    assert!(
        plain
            .messages()
            .map(|message| message.data)
            .eq(chunked.messages().map(|message| message.data))
    );
    let cut = without_chunks(&bytes, false);
    let cut = Log::from_bytes(cut[..cut.len() - 3].to_vec()).unwrap();
    assert_eq!(cut.messages().count(), 49);
    assert_eq!(cut.damage().unwrap().what, "the last record is cut");
}

/// The bytes that have reached the file while a run of so many ticks goes on.
fn bytes_after(path: &Path, ticks: u64) -> Vec<u8> {
    let mut log = McapLog::create(path, &catalog(), &BTreeMap::new()).unwrap();
    for tick in 0..ticks {
        append_value(&mut log, 0, tick, 2_500_000, &joints(tick));
    }
    let bytes = std::fs::read(path).unwrap();
    drop(log);
    bytes
}

#[test]
fn at_most_a_fifth_of_a_second_has_not_reached_the_file() {
    let path = file("chunks.mcap");
    let _ = std::fs::remove_file(&path);
    for ticks in [1, 39, 41, 42, 100, 333, 1000] {
        let log = Log::from_bytes(bytes_after(&path, ticks));
        let there = log.map_or(0, |log| log.messages().count() as u64);
        let missing = (ticks - there) as f64 * 0.0025;
        assert!(missing < 0.2, "{missing} s of {ticks} ticks are missing");
        assert!(there > 0 || ticks < 41, "{there} of {ticks}");
    }
}

#[test]
fn a_chunk_is_closed_by_the_time_when_no_record_comes_any_more() {
    let path = file("silent.mcap");
    let _ = std::fs::remove_file(&path);
    let mut log = McapLog::create(&path, &catalog(), &BTreeMap::new()).unwrap();
    append_value(&mut log, 0, 4, 2_500_000, &joints(4));
    let there =
        || Log::from_bytes(std::fs::read(&path).unwrap()).map_or(0, |log| log.messages().count());
    log.close_due_chunk(Nanos::from_millis(109));
    assert_eq!(there(), 0);
    log.close_due_chunk(Nanos::from_millis(110));
    assert_eq!(there(), 1);
}

#[test]
fn a_log_is_not_replaced_by_a_run_without_records_nor_by_another_writer() {
    let path = file("kept.mcap");
    let _ = std::fs::remove_file(&path);
    let empty = || McapLog::create(&path, &catalog(), &BTreeMap::new()).unwrap();
    drop(empty());
    assert!(!path.exists(), "nothing was recorded, so there is no file");
    write(&path, 5, "7", true);
    let before = std::fs::read(&path).unwrap();
    drop(empty());
    let said = format!("{:#}", empty().finish().unwrap_err());
    assert!(said.contains("keeps what it held"), "{said}");
    assert_eq!(std::fs::read(&path).unwrap(), before);
    let mut writing = empty();
    append_value(&mut writing, 0, 0, 2_500_000, &joints(0));
    let second = McapLog::create(&path, &catalog(), &BTreeMap::new()).err().unwrap();
    assert!(format!("{second:#}").contains("another process is writing it"), "{second:#}");
    writing.finish().unwrap();
    assert_eq!(Log::open(&path).unwrap().messages().count(), 1);
}

#[test]
fn what_only_the_checksum_of_a_chunk_covers_does_not_change_unseen() {
    for finished in [false, true] {
        let path = file(&format!("altered_chunk_{finished}.mcap"));
        write(&path, 30, "7", finished);
        let mut bytes = std::fs::read(&path).unwrap();
        let at = bytes.windows(5).position(|found| found == b"q_rad").unwrap();
        bytes[at] = b'p';
        let log = Log::from_bytes(bytes).unwrap();
        assert_eq!(log.messages().count(), 75, "every message holds by itself");
        let what = &log.damage().unwrap().what;
        assert!(what.contains("something in it was altered"), "{what}");
    }
}
