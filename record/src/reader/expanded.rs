//! Replaces the compressed chunks of a file by uncompressed ones, so that everything behind it
//! finds records at places of one buffer. Other tools compress with LZ4 or Zstandard.

use std::io::Read;

use anyhow::bail;
use mcap::records::op;

use super::array_at;
use super::scan::{CHUNK_NAME_AT, RECORD_HEADER_BYTES, is_checksum_valid, record_length};

/// Bytes that all chunks of a file may hold together, whatever its size, and those for each of its
/// own bytes: a few kilobytes that were made for that purpose could ask for the whole memory. Logs
/// shrink to a third or a tenth.
const EXPANDED_BYTES_MAX: u64 = 1 << 33;
const EXPANDED_BYTES_FREE: u64 = 1 << 26;
const EXPANSION_MAX: u64 = 128;
/// Bytes of an uncompressed size, of a checksum, of the length of a name and of a length.
const FIELD_BYTES: [usize; 4] = [8, 4, 4, 8];

/// A compressed chunk of a file.
struct CompressedChunk<'a> {
    /// Two times, size and checksum, as they stand in the file.
    about: &'a [u8],
    /// `lz4` or `zstd`.
    compression: &'a str,
    packed: &'a [u8],
}

impl<'a> CompressedChunk<'a> {
    /// The chunk in the content of a record; `None` for one that is not compressed or cannot be
    /// read, which the scan tells.
    fn of(content: &'a [u8]) -> Option<CompressedChunk<'a>> {
        let length = u32::from_le_bytes(array_at(content, CHUNK_NAME_AT)) as usize;
        let name_at = CHUNK_NAME_AT + FIELD_BYTES[2];
        let name = content.get(name_at..name_at.checked_add(length)?)?;
        let data_at = name_at + length + FIELD_BYTES[3];
        let packed = content.get(data_at..)?;
        let promised = u64::from_le_bytes(array_at(content, data_at - FIELD_BYTES[3]));
        let compression = std::str::from_utf8(name).ok()?;
        let is_whole = promised == packed.len() as u64;
        let about = &content[..CHUNK_NAME_AT];
        (!name.is_empty() && is_whole).then_some(CompressedChunk { about, compression, packed })
    }

    /// Bytes that the chunk holds, as it says itself.
    fn size(&self) -> u64 {
        u64::from_le_bytes(array_at(self.about, CHUNK_NAME_AT - FIELD_BYTES[1] - FIELD_BYTES[0]))
    }

    /// Appends the chunk without compression; `None` when its bytes cannot be read.
    fn expand(&self, into: &mut Vec<u8>) -> Option<()> {
        let size = usize::try_from(self.size()).ok()?;
        let mut records = Vec::new();
        // One byte more than promised tells of a chunk that holds more.
        let limit = self.size() + 1;
        match self.compression {
            "lz4" => {
                let reader = lz4_flex::frame::FrameDecoder::new(self.packed);
                reader.take(limit).read_to_end(&mut records).ok()?;
            }
            _ => {
                let reader = ruzstd::decoding::StreamingDecoder::new(self.packed).ok()?;
                reader.take(limit).read_to_end(&mut records).ok()?;
            }
        }
        if records.len() != size {
            return None;
        }
        let content = self.about.len() + FIELD_BYTES[2] + FIELD_BYTES[3] + records.len();
        into.push(op::CHUNK);
        into.extend_from_slice(&(content as u64).to_le_bytes());
        into.extend_from_slice(self.about);
        into.extend_from_slice(&0_u32.to_le_bytes());
        into.extend_from_slice(&self.size().to_le_bytes());
        into.extend_from_slice(&records);
        Some(())
    }
}

/// The bytes of a file with its compressed chunks expanded; those of a file without any are handed
/// back as they are. Where a record cannot be read the rest is copied as it stands.
///
/// # Errors
/// A compression that the format does not know; chunks that would grow beyond 128 times the file
/// and 64 MiB, or beyond 8 GiB.
pub(super) fn expanded(bytes: Vec<u8>) -> anyhow::Result<Vec<u8>> {
    let mut at = mcap::MAGIC.len().min(bytes.len());
    let room = (bytes.len() as u64).saturating_mul(EXPANSION_MAX) + EXPANDED_BYTES_FREE;
    let room = room.min(EXPANDED_BYTES_MAX);
    // What stands before `copied` is in `out` already; `out` stays empty without a compressed
    // chunk.
    let (mut out, mut copied) = (Vec::new(), 0);
    while let Some(rest) = bytes.get(at..).filter(|rest| rest.len() >= RECORD_HEADER_BYTES) {
        let length = record_length(rest);
        if rest[0] == 0 || length > rest.len() - RECORD_HEADER_BYTES {
            break;
        }
        let next = at + RECORD_HEADER_BYTES + length;
        if rest[0] == op::DATA_END {
            if copied > 0 && is_checksum_valid(&bytes[..at], array_at(rest, RECORD_HEADER_BYTES)) {
                // The checksum held, and is that of other bytes: 0 stands for none.
                out.extend_from_slice(&bytes[copied..at + RECORD_HEADER_BYTES]);
                out.extend_from_slice(&[0; 4]);
                copied = at + RECORD_HEADER_BYTES + 4;
            }
            break;
        }
        let content = &bytes[at + RECORD_HEADER_BYTES..next];
        if let Some(chunk) = CompressedChunk::of(content).filter(|_| rest[0] == op::CHUNK) {
            if !["lz4", "zstd"].contains(&chunk.compression) {
                bail!(
                    "its chunks are compressed ({}); rewrite it with LZ4, with Zstandard or \
                     without compression, for example with `mcap compress --compression none`",
                    chunk.compression
                );
            }
            if (out.len() as u64).saturating_add(chunk.size()) > room {
                bail!(
                    "its chunks would grow to more than {} MiB; split it with `mcap filter`",
                    room >> 20
                );
            }
            let whole = out.len() + at - copied;
            out.extend_from_slice(&bytes[copied..at]);
            copied = at;
            if chunk.expand(&mut out).is_none() {
                out.truncate(whole);
                break;
            }
            copied = next;
        }
        at = next;
    }
    if copied == 0 {
        return Ok(bytes);
    }
    out.extend_from_slice(&bytes[copied..]);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Log, McapLog};
    use std::collections::BTreeMap;
    use taktil_rtcore::record::{Catalog, LaneInfo, Observer, Record, Signal};
    use taktil_rtcore::{Nanos, Payload, payload};

    payload! {
        /// What a test records.
        pub struct Sample {
            /// A value.
            pub value: f64,
        }
    }

    /// A log of ten seconds in a hundred chunks.
    fn recorded() -> Vec<u8> {
        let signal = Signal {
            name: "a.b".to_owned(),
            lane: 0,
            type_name: Sample::NAME.into(),
            fields: Sample::FIELDS.into(),
            size: Sample::SIZE,
        };
        let catalog = Catalog { signals: vec![signal], lanes: vec![LaneInfo::default()] };
        let mut log = McapLog::in_memory(&catalog, &BTreeMap::new()).unwrap();
        let mut body = vec![0; Sample::SIZE];
        for tick in 0..1000_u32 {
            Sample { value: f64::from(tick) }.encode(&mut body);
            let release = Nanos::from_millis(10 * i64::from(tick));
            log.record(&Record { signal: 0, tick: u64::from(tick), release, body: &body });
        }
        log.into_bytes().unwrap()
    }

    fn packed(compression: &str, records: &[u8]) -> Vec<u8> {
        if compression == "lz4" {
            let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
            std::io::Write::write_all(&mut encoder, records).unwrap();
            return encoder.finish().unwrap();
        }
        ruzstd::encoding::compress_to_vec(records, ruzstd::encoding::CompressionLevel::Fastest)
    }

    /// The file with every chunk compressed; chunks claim to hold `claim` times what they do.
    fn compressed(bytes: &[u8], compression: &str, claim: u64) -> Vec<u8> {
        let mut out = mcap::MAGIC.to_vec();
        let mut at = out.len();
        while bytes.len() - at > mcap::MAGIC.len() {
            let next = at + RECORD_HEADER_BYTES + record_length(&bytes[at..]);
            let content = &bytes[at + RECORD_HEADER_BYTES..next];
            let mut changed = content.to_vec();
            if bytes[at] == op::CHUNK {
                let records = packed(compression, &content[CHUNK_NAME_AT + 4 + 8..]);
                let size = (content.len() - (CHUNK_NAME_AT + 4 + 8)) as u64 * claim;
                changed.truncate(CHUNK_NAME_AT);
                changed[16..24].copy_from_slice(&size.to_le_bytes());
                changed.extend((compression.len() as u32).to_le_bytes());
                changed.extend(compression.as_bytes());
                changed.extend((records.len() as u64).to_le_bytes());
                changed.extend(records);
            } else if bytes[at] == op::DATA_END {
                changed.fill(0);
            }
            out.push(bytes[at]);
            out.extend((changed.len() as u64).to_le_bytes());
            out.extend(changed);
            at = next;
        }
        out.extend(mcap::MAGIC);
        out
    }

    fn values(log: &Log) -> Vec<f64> {
        log.series("a.b").map(|series| series.values("value", 0)).unwrap_or_default()
    }

    #[test]
    fn compressed_chunks_hold_what_they_held() {
        let plain = recorded();
        let all = values(&Log::from_bytes(plain.clone()).unwrap());
        assert_eq!(all.len(), 1000);
        for compression in ["lz4", "zstd"] {
            let log = Log::from_bytes(compressed(&plain, compression, 1)).unwrap();
            assert_eq!((log.damage(), log.chunks()), (None, 100), "{compression}");
            assert_eq!(values(&log), all, "{compression}");
        }
    }

    #[test]
    fn what_was_cut_or_altered_ends_the_readable_part_at_a_whole_chunk() {
        let plain = recorded();
        let all = values(&Log::from_bytes(plain.clone()).unwrap());
        for compression in ["lz4", "zstd"] {
            let whole = compressed(&plain, compression, 1);
            for parts in 1..40 {
                let cut = whole.len() * parts / 41;
                let log = Log::from_bytes(whole[..cut].to_vec()).unwrap();
                assert!(log.damage().is_some(), "{compression}, cut at {cut}");
                let found = values(&log);
                assert_eq!(found, all[..found.len()], "{compression}, cut at {cut}");
                assert_eq!(found.len() % 10, 0, "a chunk is whole or left out");
                let mut altered = whole.clone();
                altered[cut] ^= 0x10;
                // Some bytes belong to no chunk; none makes a value that was not recorded.
                if let Ok(log) = Log::from_bytes(altered) {
                    let found = values(&log);
                    let is_known = |value: &f64| all.contains(value);
                    assert!(found.iter().all(is_known), "{compression}, altered at {cut}");
                }
            }
        }
    }

    #[test]
    fn a_file_that_asks_for_the_memory_is_refused() {
        let bomb = compressed(&recorded(), "lz4", 1 << 30);
        let said = format!("{:#}", Log::from_bytes(bomb).expect_err("it is refused"));
        assert!(said.contains("would grow to more than") && said.contains("mcap filter"), "{said}");
        // A chunk that holds less than it says is damaged.
        let log = Log::from_bytes(compressed(&recorded(), "zstd", 2)).unwrap();
        assert!(log.damage().is_some() && values(&log).is_empty());
    }
}
