//! Reads a recording back, even when its end is missing or damaged: everything before the first bad
//! byte is used. A closed file is held to its checksums, so that no bit of it can change unseen; a
//! file that was cut has only the checksums of its messages. Directories, empty files, other
//! formats and chunked MCAP files are errors with a text for people. Ports and fields that were
//! renamed since the file was written appear under the names that they have now.

use std::collections::BTreeMap;
use std::fmt;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

use crate::{CDR_HEADER_BYTES, CRC_BYTES, FieldInfo, STAMP_BYTES, parse_schema, topic};
use anyhow::{Context, bail};
use mcap::records::{Record, op};
use taktil_rtcore::payload::Primitive;
use taktil_signal::renamed;

use crate::series::{Column, Series};

/// Bytes of opcode and length in front of a record.
const RECORD_HEADER_BYTES: usize = 9;
/// Bytes of channel, sequence and two times in front of a message's data.
const MESSAGE_HEADER_BYTES: usize = 22;

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
    /// Channel and offset of the stamp of each message, in the order of the file.
    order: Vec<(usize, usize)>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
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
    /// A directory, a missing, unreadable or empty file, another format, a chunked MCAP file.
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
            bail!("it is empty: the run ended before anything was written");
        }
        let magic = &mcap::MAGIC[..mcap::MAGIC.len().min(bytes.len())];
        if !bytes.starts_with(magic) {
            bail!("it is not an MCAP file; logs are written by `taktil run --log FILE`");
        }
        let mut log = Log {
            bytes: Vec::new(),
            channels: Vec::new(),
            order: Vec::new(),
            metadata: BTreeMap::new(),
            damage: None,
            corrupt_message: None,
            foreign_messages: 0,
        };
        RecordScan { log: &mut log, bytes: &bytes, schemas: BTreeMap::new(), ids: BTreeMap::new() }
            .run()?;
        log.bytes = bytes;
        Ok(log)
    }

    /// The signals, in the order in which they stand in the file.
    #[must_use]
    pub fn channels(&self) -> &[Channel] {
        &self.channels
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

    /// Leaves out every message of a job released at `until` or later.
    pub fn truncate_at(&mut self, until: i64) {
        let mut order = std::mem::take(&mut self.order);
        order.retain(|&(channel, offset)| {
            self.message(channel, offset).is_some_and(|message| message.release_ns < until)
        });
        self.order = order;
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
    Ok(std::fs::read(path)?)
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

/// Whether a checksum of the format holds; 0 means that the writer made none.
fn is_checksum_valid(bytes: &[u8], promised: [u8; CRC_BYTES]) -> bool {
    let promised = u32::from_le_bytes(promised);
    promised == 0 || crc32fast::hash(bytes) == promised
}

/// One pass over the records of a file.
struct RecordScan<'a> {
    log: &'a mut Log,
    bytes: &'a [u8],
    schemas: BTreeMap<u16, (String, Vec<FieldInfo>)>,
    /// File's channel number to index in the log; `None` for channels of others.
    ids: BTreeMap<u16, Option<usize>>,
}

impl RecordScan<'_> {
    fn run(&mut self) -> anyhow::Result<()> {
        let mut at = mcap::MAGIC.len().min(self.bytes.len());
        let mut ended = false;
        while !ended {
            let rest = &self.bytes[at..];
            if rest.is_empty() {
                self.damage(at, "the file ends here without its footer: the run was cut short");
                return Ok(());
            }
            let length =
                usize::try_from(u64::from_le_bytes(array_at(rest, 1))).unwrap_or(usize::MAX);
            let whole =
                rest.len() >= RECORD_HEADER_BYTES && length <= rest.len() - RECORD_HEADER_BYTES;
            if rest[0] == 0 || !whole {
                let what = match rest[0] {
                    0 if rest.iter().all(|byte| *byte == 0) => "only zeros follow",
                    0 => "no record starts here",
                    _ => "the last record is cut",
                };
                self.damage(at, what);
                return Ok(());
            }
            let body = at + RECORD_HEADER_BYTES;
            let next = body + length;
            if let Err(what) = self.record(rest[0], body, next)? {
                self.damage(at, &what);
                return Ok(());
            }
            // What follows DataEnd is an index of what was read already.
            ended = rest[0] == op::DATA_END;
            if ended && !is_checksum_valid(&self.bytes[..at], array_at(rest, RECORD_HEADER_BYTES)) {
                self.damage(at, "the checksum over all of it fails: something in it was altered");
                return Ok(());
            }
            at = next;
        }
        let what = if !self.bytes.ends_with(mcap::MAGIC) {
            "all messages are there, the closing summary is cut"
        } else if !self.is_summary_valid(at) {
            "all messages are there, the closing summary fails its checksum"
        } else {
            return Ok(());
        };
        self.damage(at, what);
        self.log.damage.iter_mut().for_each(|damage| damage.messages_complete = true);
        Ok(())
    }

    /// Whether the footer's checksum holds over the summary, which starts at `start`.
    fn is_summary_valid(&self, start: usize) -> bool {
        let end = self.bytes.len() - mcap::MAGIC.len();
        let at = end.checked_sub(CRC_BYTES).filter(|at| *at >= start);
        at.is_some_and(|at| is_checksum_valid(&self.bytes[start..at], array_at(self.bytes, at)))
    }

    fn damage(&mut self, offset: usize, what: &str) {
        self.log.damage = Some(Damage { offset, what: what.to_owned(), messages_complete: false });
    }

    /// Takes one record in; the outer error refuses the file, the inner one ends the readable part.
    fn record(
        &mut self,
        opcode: u8,
        start: usize,
        end: usize,
    ) -> anyhow::Result<Result<(), String>> {
        if opcode == op::CHUNK {
            bail!("its messages are packed in chunks; Taktil reads only unchunked MCAP files");
        }
        if opcode == op::MESSAGE {
            return Ok(self.message(start, end));
        }
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::METADATA) {
            return Ok(Ok(()));
        }
        let record = match mcap::parse_record(opcode, &self.bytes[start..end]) {
            Ok(record) => record,
            Err(error) => return Ok(Err(format!("a record cannot be read: {error}"))),
        };
        match record {
            Record::Schema { header, data } => {
                let text = std::str::from_utf8(&data).ok().filter(|_| header.encoding == "ros2msg");
                if let Some(fields) = text.and_then(|text| parse_schema(text).ok()) {
                    let name = header.name.rsplit('/').next().unwrap_or_default().to_owned();
                    self.schemas.insert(header.id, (name, fields));
                }
            }
            Record::Channel(channel) => self.channel(channel),
            Record::Metadata(metadata) => {
                self.log.metadata.insert(metadata.name, metadata.metadata);
            }
            _ => {}
        }
        Ok(Ok(()))
    }

    fn channel(&mut self, channel: mcap::records::Channel) {
        let schema = self.schemas.get(&channel.schema_id);
        let Some((type_name, fields)) = schema.filter(|_| channel.message_encoding == "cdr") else {
            self.ids.insert(channel.id, None);
            return;
        };
        let about = |key: &str| channel.metadata.get(key).cloned();
        let from_topic = || channel.topic.trim_start_matches('/').replace('/', ".");
        let written = about("signal").unwrap_or_else(from_topic);
        let signal = renamed::current_port(&written);
        let current = |field: &FieldInfo| {
            let name = renamed::current_field(signal, &field.name).to_owned();
            FieldInfo { name, ..field.clone() }
        };
        let described = Channel {
            lane: about("lane").unwrap_or_default(),
            elements: about("elements")
                .map(|text| text.split(',').map(renamed::current_port).map(str::to_owned).collect())
                .unwrap_or_default(),
            period_ns: about("period_ns").and_then(|text| text.parse().ok()).unwrap_or(0),
            type_name: renamed::current_payload(signal, type_name).to_owned(),
            fields: fields.iter().map(current).collect(),
            topic: if signal == written { channel.topic } else { topic(signal) },
            signal: signal.to_owned(),
        };
        self.ids.insert(channel.id, Some(self.log.channels.len()));
        self.log.channels.push(described);
    }

    fn message(&mut self, start: usize, end: usize) -> Result<(), String> {
        let record = &self.bytes[start..end];
        if record.len() < MESSAGE_HEADER_BYTES {
            return Err("a message is shorter than its header".to_owned());
        }
        let id = u16::from_le_bytes(array_at(record, 0));
        let Some(index) = self.ids.get(&id).copied().flatten() else {
            self.log.foreign_messages += 1;
            return Ok(());
        };
        let channel = &self.log.channels[index];
        let data = &record[MESSAGE_HEADER_BYTES..];
        let size = channel.body_size();
        let tick = u64::from_le_bytes(array_at(data, CDR_HEADER_BYTES));
        let place = |what: &str| format!("{what} on {} at tick {tick}", channel.topic);
        if data.len() != CDR_HEADER_BYTES + size + CRC_BYTES {
            return Err(place("a message of the wrong length"));
        }
        let (body, crc) = data[CDR_HEADER_BYTES..].split_at(size);
        let here = (index, start + MESSAGE_HEADER_BYTES + CDR_HEADER_BYTES);
        if crc32fast::hash(body) != u32::from_le_bytes(array_at(crc, 0)) {
            let what = place("a message fails its CRC");
            self.log.corrupt_message = Some(here);
            return Err(what);
        }
        // The header repeats the stamp: what only that checksum covers would be found nowhere in a
        // file that was cut.
        let release = i64::from_le_bytes(array_at(data, CDR_HEADER_BYTES + 8));
        let time = u64::try_from(release).unwrap_or(0).to_le_bytes();
        let header =
            (array_at::<4>(record, 2), array_at::<8>(record, 6), array_at::<8>(record, 14));
        if header != (array_at(data, CDR_HEADER_BYTES), time, time) {
            return Err(place("a message whose header is not that of its stamp"));
        }
        self.log.order.push(here);
        Ok(())
    }
}
