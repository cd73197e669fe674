//! Writes a recording while the machine runs, on the observer's thread. A write that fails does not
//! stop the machine: later records are dropped and counted, and [`McapLog::finish`] reports the
//! failure.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Cursor, Seek, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions, Writer};
use taktil_rtcore::record::{Catalog, Observer, Record};

use super::{
    CDR_HEADER_BYTES, CRC_BYTES, METADATA_RESULT, METADATA_RUN, STAMP_BYTES, schema::schema_text,
    schema::topic,
};

/// Encapsulation: plain CDR, little endian.
const CDR_LITTLE_ENDIAN: [u8; CDR_HEADER_BYTES] = [0x00, 0x01, 0x00, 0x00];
/// Bytes collected before they go to the kernel.
const BUFFER_BYTES: usize = 1 << 16;

/// Channel number and body size of a signal.
#[derive(Clone, Copy)]
struct ChannelSlot {
    channel: u16,
    size: usize,
}

/// A recording that is being written; give it to the executor as its observer.
pub struct McapLog<W: Write + Seek = BufWriter<File>> {
    writer: Writer<W>,
    path: PathBuf,
    slots: Vec<ChannelSlot>,
    message: Vec<u8>,
    written: u64,
    lost: u64,
    failed: Option<String>,
}

impl McapLog {
    /// Starts a recording of every signal of `catalog`. `metadata` (seed, scene text, versions,
    /// command line) is written first, so that a run cut short still explains itself. An existing
    /// file is replaced.
    ///
    /// # Errors
    /// When the file cannot be created or written; the text names the path.
    pub fn create(
        path: &Path,
        catalog: &Catalog,
        metadata: &BTreeMap<String, String>,
    ) -> anyhow::Result<McapLog> {
        if path.is_dir() {
            bail!("cannot write a log to {}: it is a directory; name a file in it", path.display());
        }
        let file = File::create(path).with_context(|| {
            format!("cannot create the log {}; does its directory exist?", path.display())
        })?;
        let file = BufWriter::with_capacity(BUFFER_BYTES, file);
        McapLog::start(file, path, catalog, metadata)
            .with_context(|| format!("cannot write the log {}", path.display()))
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
        self.close(&BTreeMap::new())?;
        self.check()?;
        Ok(self.writer.into_inner().into_inner())
    }
}

impl<W: Write + Seek> McapLog<W> {
    fn start(
        file: W,
        path: &Path,
        catalog: &Catalog,
        metadata: &BTreeMap<String, String>,
    ) -> anyhow::Result<McapLog<W>> {
        let options = WriteOptions::new()
            .profile("ros2")
            .library(concat!("taktil ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .use_chunks(false);
        let mut writer = options.create(file)?;
        writer
            .write_metadata(&Metadata { name: METADATA_RUN.into(), metadata: metadata.clone() })?;
        let mut slots = Vec::with_capacity(catalog.signals.len());
        let mut longest = 0;
        for signal in &catalog.signals {
            let name = format!("taktil/msg/{}", signal.type_name);
            let text = schema_text(&signal.fields);
            let schema = writer.add_schema(&name, "ros2msg", text.as_bytes())?;
            let mut metadata = BTreeMap::from([("signal".to_owned(), signal.name.clone())]);
            if let Some(lane) = catalog.lanes.get(signal.lane) {
                metadata.insert("lane".to_owned(), lane.name.clone());
                metadata.insert("period_ns".to_owned(), lane.period.0.to_string());
                metadata.insert("phase_ns".to_owned(), lane.phase.0.to_string());
                if signal.name == format!("{}.state", lane.name) {
                    metadata.insert("elements".to_owned(), lane.tasks.join(","));
                } else if signal.name == format!("{}.decision", lane.name) {
                    metadata.insert("elements".to_owned(), lane.reads.join(","));
                }
            }
            let channel = writer.add_channel(schema, &topic(&signal.name), "cdr", &metadata)?;
            slots.push(ChannelSlot { channel, size: signal.size });
            longest = longest.max(signal.size);
        }
        writer.flush()?;
        Ok(McapLog {
            writer,
            path: path.to_owned(),
            slots,
            message: Vec::with_capacity(
                CDR_HEADER_BYTES + STAMP_BYTES + longest.next_multiple_of(CRC_BYTES) + CRC_BYTES,
            ),
            written: 0,
            lost: 0,
            failed: None,
        })
    }

    /// Writes a metadata record with one value, `json`, where the recording stands now.
    pub fn write_metadata(&mut self, name: &str, json: &str) {
        if self.failed.is_none() {
            let metadata = BTreeMap::from([("json".to_owned(), json.to_owned())]);
            let written = self.writer.write_metadata(&Metadata { name: name.into(), metadata });
            self.failed = written.err().map(error_text);
        }
    }

    /// Messages written so far.
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
        self.failed.as_deref()
    }

    /// Hands everything collected so far to the kernel; worth doing a few times a second in a live
    /// run.
    pub fn flush(&mut self) {
        if self.failed.is_none()
            && let Err(error) = self.writer.flush()
        {
            self.failed = Some(error_text(error));
        }
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
        if self.failed.is_none()
            && let Err(error) = self.close(result)
        {
            self.failed = Some(error_text(error));
        }
        self.check()
    }

    fn check(&self) -> anyhow::Result<()> {
        if let Some(failure) = &self.failed {
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

    fn close(&mut self, result: &BTreeMap<String, String>) -> mcap::McapResult<()> {
        if !result.is_empty() {
            let record = Metadata { name: METADATA_RESULT.into(), metadata: result.clone() };
            self.writer.write_metadata(&record)?;
        }
        // This also flushes what lies underneath.
        self.writer.finish().map(drop)
    }
}

impl<W: Write + Seek> Observer for McapLog<W> {
    fn record(&mut self, record: &Record<'_>) {
        let slot = self.slots.get(record.signal).copied();
        let Some(slot) = slot.filter(|slot| slot.size == record.body.len()) else {
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
        let time = u64::try_from(record.release.0).unwrap_or(0);
        let header = MessageHeader {
            channel_id: slot.channel,
            sequence: sequence(record.tick),
            log_time: time,
            publish_time: time,
        };
        match self.writer.write_to_known_channel(&header, message) {
            Ok(()) => self.written += 1,
            Err(error) => {
                self.lost += 1;
                self.failed = Some(error_text(error));
            }
        }
    }
}

/// The text of an error, for input and output errors without the prefix of the format.
fn error_text(error: McapError) -> String {
    match error {
        McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}

/// The low 32 bits of a tick, because the format has a field of 32 bits.
fn sequence(tick: u64) -> u32 {
    (tick & u64::from(u32::MAX)) as u32
}
