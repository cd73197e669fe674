//! Writes a recording as MCAP in chunks: schemas and channels first, then a chunk for each tenth of
//! a second of logical time, an index and a summary at the end. Chunks are not compressed, so that
//! what is left of a file that was cut can be read message by message. A disk that fails does not
//! stop the machine: later records are dropped and counted, and [`McapLog::finish`] reports the
//! failure.

mod companion_channels;

use std::collections::BTreeMap;
use std::io::{Cursor, ErrorKind, Seek, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions, Writer};
use taktil_rtcore::Nanos;
use taktil_rtcore::record::{Catalog, Observer, Record};

use crate::channel::ChannelSource;
use crate::file::LogFile;
use crate::gap::Gap;
use crate::reader::Log;
use crate::{
    CDR_HEADER_BYTES, CRC_BYTES, METADATA_GAP, METADATA_RESULT, METADATA_RUN, STAMP_BYTES,
};

/// Encapsulation: plain CDR, little endian.
const CDR_LITTLE_ENDIAN: [u8; CDR_HEADER_BYTES] = [0x00, 0x01, 0x00, 0x00];
/// Logical time after whose passing a chunk is closed and handed to the kernel: half of the 0.2 s
/// that may be missing after a kill, the other half for the way from the lane to here.
pub const CHUNK_SPAN: Nanos = Nanos::from_millis(100);
/// Bytes of messages after which a chunk is closed whatever its span: bounds the memory of a writer
/// in virtual time, and what a reader has to hold.
const CHUNK_BYTES_MAX: usize = 1 << 20;

/// Channel number and body size of a signal.
#[derive(Clone, Copy)]
struct ChannelSlot {
    channel: u16,
    size: usize,
    padded: bool,
}

impl ChannelSlot {
    /// Whether a body of so many bytes is one of this channel.
    fn fits(&self, bytes: usize) -> bool {
        bytes == self.size || (self.padded && bytes.next_multiple_of(CRC_BYTES) == self.size)
    }
}

/// The chunk that is being filled.
#[derive(Clone, Copy, Default)]
struct OpenChunk {
    /// Release of its first message.
    first: Nanos,
    messages: u64,
    bytes: usize,
}

/// A recording that is being written; give it to the executor as its observer.
pub struct McapLog<W: Write + Seek = LogFile> {
    /// There until the recording is closed.
    writer: Option<Writer<W>>,
    path: PathBuf,
    slots: Vec<ChannelSlot>,
    message: Vec<u8>,
    /// Channels of a companion, by its own places.
    companion_channels: Vec<u16>,
    /// What the times in headers are ahead of those in stamps.
    time_base: Nanos,
    chunk: OpenChunk,
    /// Whether the file held another recording when it was opened.
    replaces: bool,
    /// Whether anything went to the kernel.
    begun: bool,
    written: u64,
    bytes: u64,
    lost: u64,
    /// Release of the first record that was lost with the chunk that could not be written.
    lost_from: Option<Nanos>,
    failed: Option<WriteFailure>,
}

/// Why writing stopped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct WriteFailure {
    pub(crate) text: String,
    /// There is no room, or none for this user.
    pub(crate) is_full: bool,
}

impl McapLog {
    /// Starts a recording of every signal of `catalog`. `metadata` (seed, scene text, versions,
    /// command line) is written first, so that a run cut short still explains itself. The file is
    /// locked for as long as it is written. What it held is replaced when the first chunk is
    /// written, and stays when no record ever comes.
    ///
    /// # Errors
    /// When the file cannot be created, is none, or is being written by another process; the text
    /// names the path.
    pub fn create(
        path: &Path,
        catalog: &Catalog,
        metadata: &BTreeMap<String, String>,
    ) -> anyhow::Result<McapLog> {
        McapLog::create_channels(path, &ChannelSource::of_catalog(catalog), metadata)
    }

    /// As [`McapLog::create`], with the channels of a log that was read, as they stand in its file:
    /// a record's signal is an index into [`Log::channels`].
    ///
    /// # Errors
    /// As [`McapLog::create`].
    pub fn create_like(
        path: &Path,
        log: &Log,
        metadata: &BTreeMap<String, String>,
    ) -> anyhow::Result<McapLog> {
        McapLog::create_channels(path, log.sources(), metadata)
    }

    fn create_channels(
        path: &Path,
        channels: &[ChannelSource],
        metadata: &BTreeMap<String, String>,
    ) -> anyhow::Result<McapLog> {
        let file = LogFile::open(path)?;
        let replaces = file.holds_another();
        let log = McapLog::start_channels(file, path, channels, metadata);
        let mut log = log.with_context(|| format!("cannot write the log {}", path.display()))?;
        log.replaces = replaces;
        Ok(log)
    }
}

impl McapLog<Cursor<Vec<u8>>> {
    /// As [`McapLog::create`], into memory: for a run that is compared and thrown away.
    ///
    /// # Errors
    /// None in practice: memory does not fail.
    pub fn in_memory(
        catalog: &Catalog,
        metadata: &BTreeMap<String, String>,
    ) -> anyhow::Result<McapLog<Cursor<Vec<u8>>>> {
        McapLog::start(Cursor::new(Vec::new()), Path::new("memory"), catalog, metadata)
    }

    /// Closes the recording and hands out its bytes.
    ///
    /// # Errors
    /// When a record did not fit the catalog.
    pub fn into_bytes(mut self) -> anyhow::Result<Vec<u8>> {
        self.close(&BTreeMap::new());
        self.check()?;
        Ok(self.writer.take().map(|writer| writer.into_inner().into_inner()).unwrap_or_default())
    }
}

impl<W: Write + Seek> McapLog<W> {
    /// Starts a recording in whatever takes bytes; `path` is for the words of errors.
    pub(crate) fn start(
        file: W,
        path: &Path,
        catalog: &Catalog,
        metadata: &BTreeMap<String, String>,
    ) -> anyhow::Result<McapLog<W>> {
        McapLog::start_channels(file, path, &ChannelSource::of_catalog(catalog), metadata)
    }

    fn start_channels(
        file: W,
        path: &Path,
        channels: &[ChannelSource],
        metadata: &BTreeMap<String, String>,
    ) -> anyhow::Result<McapLog<W>> {
        let options = WriteOptions::new()
            .profile("ros2")
            .library(concat!("taktil ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            // Chunks are collected in memory and closed below.
            .disable_seeking(true)
            .chunk_size(None);
        let mut writer = options.create(file)?;
        writer
            .write_metadata(&Metadata { name: METADATA_RUN.into(), metadata: metadata.clone() })?;
        let mut slots = Vec::with_capacity(channels.len());
        let mut longest = 0;
        for channel in channels {
            let schema =
                writer.add_schema(&channel.schema, "ros2msg", channel.fields.as_bytes())?;
            let number = writer.add_channel(schema, &channel.topic, "cdr", &channel.about)?;
            let (size, padded) = (channel.size, channel.padded);
            slots.push(ChannelSlot { channel: number, size, padded });
            longest = longest.max(channel.size);
        }
        Ok(McapLog {
            writer: Some(writer),
            path: path.to_owned(),
            slots,
            companion_channels: Vec::new(),
            time_base: Nanos::ZERO,
            chunk: OpenChunk::default(),
            replaces: false,
            begun: false,
            bytes: 0,
            message: Vec::with_capacity(
                CDR_HEADER_BYTES + STAMP_BYTES + longest.next_multiple_of(CRC_BYTES) + CRC_BYTES,
            ),
            written: 0,
            lost: 0,
            lost_from: None,
            failed: None,
        })
    }

    /// Writes a metadata record with one value, `json`, where the recording stands now.
    pub fn write_metadata(&mut self, name: &str, json: &str) {
        self.write_table(name, BTreeMap::from([("json".to_owned(), json.to_owned())]));
    }

    /// Writes that records are missing where the recording stands now.
    pub fn write_gap(&mut self, gap: &Gap) {
        self.write_table(METADATA_GAP, gap.table());
    }

    /// Writes a metadata record where the recording stands now.
    pub(crate) fn write_table(&mut self, name: &str, metadata: BTreeMap<String, String>) {
        if let (None, Some(writer)) = (&self.failed, &mut self.writer) {
            let written = writer.write_metadata(&Metadata { name: name.into(), metadata });
            self.failed = written.err().map(WriteFailure::from);
        }
    }

    /// Messages taken so far; those of the open chunk are among them.
    #[must_use]
    pub fn written(&self) -> u64 {
        self.written
    }

    /// Records that were not written: after a failed write, or because they did not fit the
    /// catalog.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Why writing stopped, if it did.
    #[must_use]
    pub fn failure(&self) -> Option<&str> {
        self.failed.as_ref().map(|failure| &*failure.text)
    }

    /// As [`McapLog::failure`], with the kind.
    pub(crate) fn write_failure(&self) -> Option<&WriteFailure> {
        self.failed.as_ref()
    }

    /// Release of the first record that was lost with the chunk that could not be written.
    pub(crate) fn lost_from(&self) -> Option<Nanos> {
        self.lost_from
    }

    /// Whether a chunk is open.
    pub(crate) fn has_open_chunk(&self) -> bool {
        self.chunk.messages > 0
    }

    /// The file, whatever it holds by now.
    pub(crate) fn into_file(mut self) -> Option<W> {
        self.writer.take().map(Writer::into_inner)
    }

    /// Bytes of messages taken so far, without index and summary.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Closes the chunk if it was begun [`CHUNK_SPAN`] before `now` or earlier; worth calling some
    /// ten times a second in a live run, in which records may cease to come.
    pub fn close_due_chunk(&mut self, now: Nanos) {
        if self.chunk.messages > 0 && now - self.chunk.first >= CHUNK_SPAN {
            self.flush();
        }
    }

    /// Closes the chunk and hands it to the kernel, whatever its span.
    pub fn flush(&mut self) {
        if let (None, Some(writer)) = (&self.failed, &mut self.writer) {
            self.begun = true;
            match writer.flush() {
                Ok(()) => self.chunk = OpenChunk::default(),
                Err(error) => self.fail(error),
            }
        }
    }

    /// From now on nothing is written; the messages of the open chunk are lost.
    fn fail(&mut self, error: McapError) {
        self.written -= self.chunk.messages;
        self.lost += self.chunk.messages;
        self.lost_from = (self.chunk.messages > 0).then_some(self.chunk.first);
        self.chunk = OpenChunk::default();
        self.failed = Some(error.into());
    }

    /// Writes summary and footer and closes the file.
    ///
    /// # Errors
    /// When any write since the start failed; the text names the path and how many records are
    /// missing.
    pub fn finish(self) -> anyhow::Result<()> {
        self.finish_with(&BTreeMap::new())
    }

    /// As [`McapLog::finish`], with closing metadata (digest, closing table) unless it is empty.
    ///
    /// # Errors
    /// As [`McapLog::finish`].
    pub fn finish_with(mut self, result: &BTreeMap<String, String>) -> anyhow::Result<()> {
        if self.replaces && !self.begun && self.written == 0 {
            bail!("nothing was recorded; {} keeps what it held", self.path.display());
        }
        self.close(result);
        self.check()
    }

    fn check(&self) -> anyhow::Result<()> {
        if let Some(failure) = self.failure() {
            bail!(
                "the log {} is incomplete: {failure}; {} messages were written, {} were lost; \
                 what was written can be read",
                self.path.display(),
                self.written,
                self.lost
            );
        }
        if self.lost > 0 {
            bail!(
                "{} records did not fit the catalog and are not in {}",
                self.lost,
                self.path.display()
            );
        }
        Ok(())
    }

    /// Writes closing metadata, summary and footer, unless writing failed before.
    pub(crate) fn close(&mut self, result: &BTreeMap<String, String>) {
        if self.failed.is_none()
            && let Err(error) = self.try_close(result)
        {
            self.fail(error);
        }
    }

    fn try_close(&mut self, result: &BTreeMap<String, String>) -> mcap::McapResult<()> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        self.begun = true;
        if !result.is_empty() {
            let record = Metadata { name: METADATA_RESULT.into(), metadata: result.clone() };
            writer.write_metadata(&record)?;
        }
        // This also flushes what lies underneath.
        writer.finish()?;
        self.chunk = OpenChunk::default();
        Ok(())
    }
}

impl<W: Write + Seek> Observer for McapLog<W> {
    fn record(&mut self, record: &Record<'_>) {
        let slot = self.slots.get(record.signal).copied();
        let Some(slot) = slot.filter(|slot| slot.fits(record.body.len())) else {
            self.lost += 1;
            return;
        };
        if self.failed.is_some() {
            self.lost += 1;
            return;
        }
        let message = &mut self.message;
        message.clear();
        message.extend_from_slice(&CDR_LITTLE_ENDIAN);
        message.extend_from_slice(&record.tick.to_le_bytes());
        message.extend_from_slice(&record.release.0.to_le_bytes());
        message.extend_from_slice(record.body);
        message.resize(message.len().next_multiple_of(CRC_BYTES), 0);
        let crc = crc32fast::hash(&message[CDR_HEADER_BYTES..]);
        message.extend_from_slice(&crc.to_le_bytes());
        let time = header_time(self.time_base, record.release);
        let header = MessageHeader {
            channel_id: slot.channel,
            sequence: sequence(record.tick),
            log_time: time,
            publish_time: time,
        };
        let due = self.chunk.messages > 0
            && (record.release - self.chunk.first >= CHUNK_SPAN
                || self.chunk.bytes >= CHUNK_BYTES_MAX);
        if due {
            self.flush();
        }
        self.append(&header, record.release);
    }
}

impl<W: Write + Seek> McapLog<W> {
    /// Writes the message that was made into the open chunk.
    fn append(&mut self, header: &MessageHeader, release: Nanos) {
        let (None, Some(writer)) = (&self.failed, &mut self.writer) else {
            self.lost += 1;
            return;
        };
        match writer.write_to_known_channel(header, &self.message) {
            Ok(()) => {
                if self.chunk.messages == 0 {
                    self.chunk.first = release;
                }
                self.chunk.messages += 1;
                self.chunk.bytes += self.message.len();
                self.bytes += self.message.len() as u64;
                self.written += 1;
            }
            Err(error) => {
                self.lost += 1;
                self.fail(error);
                // The first of a chunk is missing all the same.
                self.lost_from.get_or_insert(release);
            }
        }
    }
}

impl<W: Write + Seek> Drop for McapLog<W> {
    /// A recording that nobody finished gets its summary here, unless it never began: then its file
    /// stays as it was.
    fn drop(&mut self) {
        if let Some(writer) = self.writer.take()
            && (!self.begun || self.failed.is_some())
        {
            drop(writer.into_inner());
        }
    }
}

impl From<McapError> for WriteFailure {
    /// Errors of input and output come without the prefix of the format.
    fn from(error: McapError) -> WriteFailure {
        match error {
            McapError::Io(error) => {
                let full = [ErrorKind::StorageFull, ErrorKind::QuotaExceeded];
                WriteFailure { text: error.to_string(), is_full: full.contains(&error.kind()) }
            }
            other => WriteFailure { text: other.to_string(), is_full: false },
        }
    }
}

/// The time in the header of a message.
fn header_time(time_base: Nanos, release: Nanos) -> u64 {
    u64::try_from(time_base.0.saturating_add(release.0)).unwrap_or(0)
}

/// The low 32 bits of a tick, because the format has a field of 32 bits.
fn sequence(tick: u64) -> u32 {
    (tick & u64::from(u32::MAX)) as u32
}
