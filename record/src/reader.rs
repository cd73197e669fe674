//! Reads a recording back, even when its end is missing or damaged: everything before the first bad
//! byte is used. A closed file is held to its checksums, so that no bit of it can change unseen; a
//! file that was cut has only the checksums of its chunks and messages. Directories, empty files,
//! other formats and compressed chunks are errors with a text for people. Ports and fields that
//! were renamed since the file was written appear under the names that they have now.

mod expanded;
mod scan;

use std::collections::BTreeMap;
use std::fmt;
use std::fs::OpenOptions;
use std::io::{ErrorKind, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;
use std::time::Duration;

use crate::{CRC_BYTES, FieldInfo, Gap, STAMP_BYTES};
use anyhow::{Context, anyhow, bail};
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use taktil_rtcore::payload::Primitive;
use taktil_signal::renamed;

use crate::channel::ChannelSource;
use crate::series::{Column, Series};
use scan::RecordScan;

/// One signal of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Topic, `/task/port`.
    pub topic: String,
    /// Signal, `task.port`.
    pub signal: String,
    /// Payload type name.
    pub type_name: String,
    /// Lane that wrote it; empty when the file does not say.
    pub lane: String,
    /// Period of that lane in ns; 0 when the file does not say.
    pub period_ns: i64,
    /// What the elements of an array stand for: the tasks of a lane's state, the signals of its
    /// decisions; empty for other signals.
    pub elements: Vec<String>,
    /// Every field of a message: stamp, payload, CRC.
    pub fields: Vec<FieldInfo>,
}

impl Channel {
    /// The payload's own fields.
    #[must_use]
    pub fn payload_fields(&self) -> &[FieldInfo] {
        let end = self.fields.len().saturating_sub(1);
        self.fields.get(2..end).unwrap_or_default()
    }

    /// Number of elements of a payload field of this name.
    #[must_use]
    pub fn field_length(&self, name: &str) -> Option<usize> {
        self.payload_fields().iter().find(|field| field.name == name).map(|field| field.count)
    }

    /// Bytes of a body, from the stamp up to the CRC.
    fn body_size(&self) -> usize {
        self.fields.last().map_or(0, |crc| crc.offset)
    }
}

/// The schema of a channel as it stands in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChannelSchema<'a> {
    /// Name, `taktil/msg/Type`.
    pub name: &'a str,
    /// Text in the language `ros2msg`.
    pub text: &'a str,
    /// Topic of the channel.
    pub topic: &'a str,
    /// Signal, lane, period and so on.
    pub about: &'a BTreeMap<String, String>,
}

/// Where the readable part of a log ends, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Byte in the file from which nothing was used.
    pub offset: usize,
    /// What was found there.
    pub what: String,
    /// All messages stand before it: only the closing summary is missing or damaged.
    pub messages_complete: bool,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "readable up to byte {}: {}", self.offset, self.what)
    }
}

/// One message as it lies in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// Index into [`Log::channels`].
    pub channel: usize,
    /// Job that wrote it.
    pub tick: u64,
    /// Logical time of that job.
    pub release_ns: i64,
    /// The encoded payload, with the padding in front of the CRC.
    pub body: &'a [u8],
    /// Stamp, payload and CRC: what has to be the same in two runs of one seed.
    pub data: &'a [u8],
}

/// A log in memory, checked message by message.
pub struct Log {
    bytes: Vec<u8>,
    channels: Vec<Channel>,
    /// The channels as they stand in the file, without names of today.
    sources: Vec<ChannelSource>,
    /// Channel and offset of the stamp of each message, in the order of the file.
    order: Vec<(usize, usize)>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    gaps: Vec<Gap>,
    chunks: usize,
    damage: Option<Damage>,
    /// The message that fails its CRC, if that is the damage.
    corrupt_message: Option<(usize, usize)>,
    foreign_messages: u64,
}

impl fmt::Debug for Log {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Log")
            .field("channels", &self.channels.len())
            .field("messages", &self.order.len())
            .field("damage", &self.damage)
            .finish_non_exhaustive()
    }
}

impl Log {
    /// Reads a file. A file that was cut or damaged is no error: see [`Log::damage`].
    ///
    /// # Errors
    /// A directory, a missing, unreadable or empty file, another format, chunks that are compressed
    /// neither with LZ4 nor with Zstandard.
    pub fn open(path: &Path) -> anyhow::Result<Log> {
        let shown = path.display();
        let bytes = read_bytes(path, "name a log of `taktil run --log` or `taktild --log`")
            .with_context(|| format!("cannot read the log {shown}"))?;
        Log::from_bytes(bytes).with_context(|| format!("cannot use {shown} as a log"))
    }

    /// As [`Log::open`], from memory.
    ///
    /// # Errors
    /// As [`Log::open`].
    pub fn from_bytes(bytes: Vec<u8>) -> anyhow::Result<Log> {
        if bytes.is_empty() {
            bail!("it is empty: the run ended before anything was written; name another log");
        }
        let magic = &mcap::MAGIC[..mcap::MAGIC.len().min(bytes.len())];
        if !bytes.starts_with(magic) {
            bail!("it is not an MCAP file; logs are written by `taktil run --log FILE`");
        }
        let mut log = Log {
            bytes: Vec::new(),
            channels: Vec::new(),
            sources: Vec::new(),
            order: Vec::new(),
            metadata: BTreeMap::new(),
            gaps: Vec::new(),
            chunks: 0,
            damage: None,
            corrupt_message: None,
            foreign_messages: 0,
        };
        let bytes = expanded::expanded(bytes)?;
        RecordScan::new(&mut log, &bytes).run();
        log.bytes = bytes;
        Ok(log)
    }

    /// The signals, in the order in which they stand in the file.
    #[must_use]
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// The channels as they stand in the file.
    pub(crate) fn sources(&self) -> &[ChannelSource] {
        &self.sources
    }

    /// The name and the text of the schema of a channel and what its file says about it, as they
    /// stand in the file; `None` when there is no such channel.
    #[must_use]
    pub fn channel_schema(&self, channel: usize) -> Option<ChannelSchema<'_>> {
        self.sources.get(channel).map(|source| ChannelSchema {
            name: &source.schema,
            text: &source.fields,
            topic: &source.topic,
            about: &source.about,
        })
    }

    /// A signal by its name (`task.port`) or its topic (`/task/port`).
    #[must_use]
    pub fn find(&self, name: &str) -> Option<usize> {
        let current = renamed::current_port(name);
        let named = |channel: &Channel| channel.signal == current || channel.topic == name;
        self.channels.iter().position(named)
    }

    /// Key-value records by their name.
    #[must_use]
    pub fn metadata(&self) -> &BTreeMap<String, BTreeMap<String, String>> {
        &self.metadata
    }

    /// The stretches in which records are missing because the recorder dropped them, as the file
    /// says.
    #[must_use]
    pub fn gaps(&self) -> &[Gap] {
        &self.gaps
    }

    /// Chunks that were read whole; 0 for a file that has none.
    #[must_use]
    pub fn chunks(&self) -> usize {
        self.chunks
    }

    /// Bytes of the file, its chunks without compression.
    #[must_use]
    pub fn file_bytes(&self) -> usize {
        self.bytes.len()
    }

    /// Where the readable part ends; `None` for a complete file.
    #[must_use]
    pub fn damage(&self) -> Option<&Damage> {
        self.damage.as_ref()
    }

    /// The message that fails its CRC, if that is where the readable part ends: worth comparing
    /// with its twin, and nothing else.
    #[must_use]
    pub fn corrupt_message(&self) -> Option<Message<'_>> {
        self.corrupt_message.and_then(|(channel, offset)| self.message(channel, offset))
    }

    /// Keeps the messages for which `wanted` is true.
    pub fn retain(&mut self, mut wanted: impl FnMut(&Message<'_>) -> bool) {
        let mut order = std::mem::take(&mut self.order);
        order.retain(|&(channel, offset)| {
            self.message(channel, offset).is_some_and(|message| wanted(&message))
        });
        self.order = order;
    }

    /// Leaves out every message of a job released at `until` or later.
    pub fn truncate_at(&mut self, until: i64) {
        self.retain(|message| message.release_ns < until);
    }

    /// Messages on channels that Taktil did not write; they are left out.
    #[must_use]
    pub fn foreign_messages(&self) -> u64 {
        self.foreign_messages
    }

    /// Every message in the order of the file.
    pub fn messages(&self) -> impl Iterator<Item = Message<'_>> {
        self.order.iter().filter_map(|&(channel, offset)| self.message(channel, offset))
    }

    fn message(&self, channel: usize, offset: usize) -> Option<Message<'_>> {
        let size = self.channels.get(channel)?.body_size();
        let data = self.bytes.get(offset..offset + size + CRC_BYTES)?;
        Some(Message {
            channel,
            tick: u64::from_le_bytes(array_at(data, 0)),
            release_ns: i64::from_le_bytes(array_at(data, 8)),
            body: data.get(STAMP_BYTES..size)?,
            data,
        })
    }

    /// A signal as columns; `None` when the log has no such signal, an empty series when it was
    /// never written.
    #[must_use]
    pub fn series(&self, name: &str) -> Option<Series> {
        let wanted = self.find(name)?;
        let fields = self.channels[wanted].payload_fields();
        let mut columns: Vec<Column> = fields
            .iter()
            .map(|field| Column {
                name: field.name.clone(),
                width: field.count,
                array: field.array,
                values: Vec::new(),
            })
            .collect();
        let mut series = Series::default();
        for &(channel, offset) in self.order.iter().filter(|(channel, _)| *channel == wanted) {
            let Some(message) = self.message(channel, offset) else { continue };
            series.t_s.push(message.release_ns as f64 / 1e9);
            series.tick.push(message.tick);
            for (column, field) in columns.iter_mut().zip(fields) {
                for element in 0..field.count {
                    let at = field.offset + element * field.kind.size();
                    column.values.push(number_at(field.kind, message.data, at));
                }
            }
        }
        series.columns = columns;
        Some(series)
    }

    /// Logical time of the newest message in s; 0 when there is none.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.messages().map(|message| message.release_ns).max().unwrap_or(0) as f64 / 1e9
    }
}

/// A recording in memory, from a file or a pipe; `remedy` says what to name instead.
///
/// # Errors
/// Nothing there, a directory, a device that never ends, what the kernel refuses.
pub fn read_bytes(path: &Path, remedy: &str) -> anyhow::Result<Vec<u8>> {
    let kind = match std::fs::metadata(path) {
        Ok(about) => about.file_type(),
        Err(error) => bail!("{error}; {remedy}"),
    };
    if kind.is_dir() {
        bail!("it is a directory; {remedy}");
    }
    if kind.is_char_device() || kind.is_block_device() {
        bail!("it is a device; {remedy}");
    }
    if !kind.is_fifo() {
        return std::fs::read(path).map_err(|error| anyhow!("{error}; {remedy}"));
    }
    let bytes = read_pipe(path)?;
    if bytes.is_empty() {
        bail!("nobody writes to this pipe; {remedy}");
    }
    Ok(bytes)
}

/// How often it is looked whether somebody writes to a pipe, and the time between.
const PIPE_LOOKS_MAX: u32 = 100;
const PIPE_LOOK_PERIOD: Duration = Duration::from_millis(10);

/// Everything that is written to a pipe, if somebody has it open or opens it within a second.
fn read_pipe(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut options = OpenOptions::new();
    let mut pipe = options.read(true).custom_flags(OFlag::O_NONBLOCK.bits()).open(path)?;
    let mut bytes = Vec::new();
    for _ in 0..PIPE_LOOKS_MAX {
        let mut first = [0; 4096];
        match pipe.read(&mut first) {
            Ok(0) => std::thread::sleep(PIPE_LOOK_PERIOD),
            Ok(count) => {
                bytes.extend_from_slice(&first[..count]);
                break;
            }
            // Somebody has it open, and takes his time.
            Err(error) if error.kind() == ErrorKind::WouldBlock => break,
            Err(error) => return Err(error),
        }
    }
    fcntl(&pipe, FcntlArg::F_SETFL(OFlag::empty()))?;
    pipe.read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn array_at<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut out = [0; N];
    if let Some(source) = bytes.get(at..at + N) {
        out.copy_from_slice(source);
    }
    out
}

fn number_at(kind: Primitive, bytes: &[u8], at: usize) -> f64 {
    match kind {
        Primitive::F64 => f64::from_le_bytes(array_at(bytes, at)),
        Primitive::F32 => f64::from(f32::from_le_bytes(array_at(bytes, at))),
        Primitive::I64 => i64::from_le_bytes(array_at(bytes, at)) as f64,
        Primitive::U64 => u64::from_le_bytes(array_at(bytes, at)) as f64,
        Primitive::I32 => f64::from(i32::from_le_bytes(array_at(bytes, at))),
        Primitive::U32 => f64::from(u32::from_le_bytes(array_at(bytes, at))),
        Primitive::I16 => f64::from(i16::from_le_bytes(array_at(bytes, at))),
        Primitive::U16 => f64::from(u16::from_le_bytes(array_at(bytes, at))),
        Primitive::U8 => f64::from(u8::from_le_bytes(array_at(bytes, at))),
    }
}
