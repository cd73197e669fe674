//! Replaces the compressed chunks of a file by uncompressed ones, so that everything behind it
//! finds records at places of one buffer. Other tools compress with LZ4 or Zstandard.

use std::io::Read;

use anyhow::bail;
use mcap::records::op;

use super::array_at;
use super::scan::{CHUNK_NAME_AT, RECORD_HEADER_BYTES, is_checksum_valid, record_length};

/// Bytes that all chunks of a file may hold together: a few kilobytes of a file that was made for
/// that purpose could ask for the whole memory.
const EXPANDED_BYTES_MAX: usize = 1 << 33;
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
        let size = usize::try_from(self.size()).ok().filter(|n| *n <= EXPANDED_BYTES_MAX)?;
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
/// A compression that the format does not know; chunks of more than 8 GiB together.
pub(super) fn expanded(bytes: Vec<u8>) -> anyhow::Result<Vec<u8>> {
    let mut at = mcap::MAGIC.len().min(bytes.len());
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
            if out.len() as u64 + chunk.size() > EXPANDED_BYTES_MAX as u64 {
                bail!("its chunks hold more than 8 GiB; split it with `mcap filter`");
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
