//! Takes the records of a log in one after another, those in chunks and those beside them, and
//! holds each to what the format promises of it.

use std::collections::BTreeMap;

use mcap::records::{Record, op};
use taktil_signal::renamed;

use crate::channel::ChannelSource;

use super::{Channel, Damage, Log, array_at};
use crate::{
    CDR_HEADER_BYTES, CRC_BYTES, FieldInfo, Gap, METADATA_GAP, METADATA_RUN, STAMP_BYTES,
    TIME_BASE_KEY, parse_schema, topic,
};

/// Bytes of opcode and length in front of a record.
pub(super) const RECORD_HEADER_BYTES: usize = 9;
/// Bytes of channel, sequence and two times in front of a message's data.
const MESSAGE_HEADER_BYTES: usize = 22;
/// Bytes of two times, size and checksum in front of the name of a chunk's compression.
pub(super) const CHUNK_NAME_AT: usize = 28;
/// No job has a larger number, and none is released later (ns): seventy years, in bounds where sums
/// and differences of two fit their words.
const TICK_MAX: u64 = 1 << 61;
/// Bytes of the schemas of all channels: each channel holds that of its own, and a damaged file can
/// give one of megabytes to thousands of them.
const SCHEMAS_BYTES_MAX: usize = 1 << 26;
/// What is found at the end of a file that was cut.
const CUT_RECORD: &str = "the last record is cut";

/// What is wrong with a file that has no checksum over the whole.
const ALTERED_CHUNK: &str = "a chunk fails its checksum: something in it was altered";
/// The same behind what was found first.
const ALSO_ALTERED: &str = "; before it a chunk fails its checksum: something in it was altered";

/// The length that a record's header gives.
pub(super) fn record_length(record: &[u8]) -> usize {
    usize::try_from(u64::from_le_bytes(array_at(record, 1))).unwrap_or(usize::MAX)
}

/// Why no whole record stands at the beginning of these bytes.
fn broken_record(rest: &[u8]) -> &'static str {
    match rest[0] {
        0 if rest.iter().all(|byte| *byte == 0) => "only zeros follow",
        0 => "no record starts here",
        _ => CUT_RECORD,
    }
}

/// Whether a checksum of the format holds; 0 means that the writer made none.
pub(super) fn is_checksum_valid(bytes: &[u8], promised: [u8; CRC_BYTES]) -> bool {
    let promised = u32::from_le_bytes(promised);
    promised == 0 || crc32fast::hash(bytes) == promised
}

/// One pass over the records of a file.
pub(super) struct RecordScan<'a> {
    log: &'a mut Log,
    bytes: &'a [u8],
    schemas: BTreeMap<u16, SchemaSource>,
    /// File's channel number to index in the log; `None` for channels of others.
    ids: BTreeMap<u16, Option<usize>>,
    /// Whether a chunk failed its checksum although all of its messages hold.
    altered: bool,
    /// Bytes of the schemas of all channels so far.
    schemas_bytes: usize,
    /// Time of a message's header less that of its stamp (ns), once it is known.
    time_base: Option<i128>,
}

/// A schema of ours: its name, its text, and the fields that it describes.
struct SchemaSource {
    name: String,
    text: String,
    fields: Vec<FieldInfo>,
}

/// Why the scan of some records ended before their end.
struct Stop {
    offset: usize,
    what: String,
}

impl<'a> RecordScan<'a> {
    pub(super) fn new(log: &'a mut Log, bytes: &'a [u8]) -> RecordScan<'a> {
        let (schemas, ids) = (BTreeMap::new(), BTreeMap::new());
        RecordScan { log, bytes, schemas, ids, altered: false, schemas_bytes: 0, time_base: None }
    }

    /// Reads everything up to the first bad byte, which becomes the log's damage.
    pub(super) fn run(&mut self) {
        let mut at = mcap::MAGIC.len().min(self.bytes.len());
        let mut ended = false;
        while !ended {
            let rest = &self.bytes[at..];
            if rest.is_empty() {
                self.damage(at, "the file ends here without its footer: the run was cut short");
                return;
            }
            let length = record_length(rest);
            let whole =
                rest.len() >= RECORD_HEADER_BYTES && length <= rest.len() - RECORD_HEADER_BYTES;
            if rest[0] == op::CHUNK && rest.len() >= RECORD_HEADER_BYTES {
                let end = if whole { at + RECORD_HEADER_BYTES + length } else { self.bytes.len() };
                if let Err(stop) = self.chunk(at, end, whole) {
                    self.damage(stop.offset, &stop.what);
                    return;
                }
                at = end;
                continue;
            }
            if rest[0] == 0 || !whole {
                self.damage(at, broken_record(rest));
                return;
            }
            let body = at + RECORD_HEADER_BYTES;
            let next = body + length;
            if let Err(what) = self.record(rest[0], body, next) {
                self.damage(at, &what);
                return;
            }
            // What follows DataEnd is an index of what was read already.
            ended = rest[0] == op::DATA_END;
            if ended && !is_checksum_valid(&self.bytes[..at], array_at(rest, RECORD_HEADER_BYTES)) {
                self.damage(at, "the checksum over all of it fails: something in it was altered");
                return;
            }
            at = next;
        }
        if self.altered {
            self.damage(at, ALTERED_CHUNK);
            return;
        }
        let what = if !self.bytes.ends_with(mcap::MAGIC) {
            "all messages are there, the closing summary is cut"
        } else if !self.is_summary_valid(at) {
            "all messages are there, the closing summary fails its checksum"
        } else {
            return;
        };
        self.damage(at, what);
        self.log.damage.iter_mut().for_each(|damage| damage.messages_complete = true);
    }

    /// Whether the footer's checksum holds over the summary, which starts at `start`.
    fn is_summary_valid(&self, start: usize) -> bool {
        let end = self.bytes.len() - mcap::MAGIC.len();
        let at = end.checked_sub(CRC_BYTES).filter(|at| *at >= start);
        at.is_some_and(|at| is_checksum_valid(&self.bytes[start..at], array_at(self.bytes, at)))
    }

    fn damage(&mut self, offset: usize, what: &str) {
        let also = if self.altered && what != ALTERED_CHUNK { ALSO_ALTERED } else { "" };
        let what = format!("{what}{also}");
        self.log.damage = Some(Damage { offset, what, messages_complete: false });
    }

    /// Takes the records of a chunk in, which stands from `at` to `end`; of one that is not `whole`
    /// as many as there are. The error ends the readable part.
    fn chunk(&mut self, at: usize, end: usize, whole: bool) -> Result<(), Stop> {
        let stop = |offset, what: &str| Err(Stop { offset, what: what.to_owned() });
        let cut = "the last chunk is cut";
        let header = at + RECORD_HEADER_BYTES;
        let about = &self.bytes[header..end];
        let name_length = u32::from_le_bytes(array_at(about, CHUNK_NAME_AT)) as usize;
        let name_at = CHUNK_NAME_AT + 4;
        let Some(name) = about.get(name_at..name_at.saturating_add(name_length)) else {
            return stop(at, if whole { "a chunk cannot be read" } else { cut });
        };
        if !name.is_empty() {
            // A whole one would have been expanded.
            return stop(at, if whole { "a compressed chunk cannot be read" } else { cut });
        }
        let first = header + name_at + name_length + 8;
        if first > end {
            return stop(at, if whole { "a chunk cannot be read" } else { cut });
        }
        let sizes: [u64; 2] =
            [16, name_at + name_length].map(|place| u64::from_le_bytes(array_at(about, place)));
        let promised = array_at(about, CHUNK_NAME_AT - CRC_BYTES);
        let here = (end - first) as u64;
        let valid =
            whole && sizes == [here; 2] && is_checksum_valid(&self.bytes[first..end], promised);
        if let Err(mut inner) = self.records_of_chunk(first, end) {
            if !whole && inner.what == CUT_RECORD {
                inner.what = cut.to_owned();
            }
            return Err(inner);
        }
        if !whole {
            return stop(end, cut);
        }
        // Nothing in it is bad by itself: what was altered may be a name or a number of a channel.
        self.altered |= !valid;
        self.log.chunks += 1;
        Ok(())
    }

    fn records_of_chunk(&mut self, first: usize, end: usize) -> Result<(), Stop> {
        let mut at = first;
        while at < end {
            let rest = &self.bytes[at..end];
            let length = record_length(rest);
            if rest[0] == 0
                || rest.len() < RECORD_HEADER_BYTES
                || length > rest.len() - RECORD_HEADER_BYTES
            {
                return Err(Stop { offset: at, what: broken_record(rest).to_owned() });
            }
            let next = at + RECORD_HEADER_BYTES + length;
            self.record(rest[0], at + RECORD_HEADER_BYTES, next)
                .map_err(|what| Stop { offset: at, what })?;
            at = next;
        }
        Ok(())
    }

    /// Takes one record in that is no chunk; the error ends the readable part.
    fn record(&mut self, opcode: u8, start: usize, end: usize) -> Result<(), String> {
        if opcode == op::MESSAGE {
            return self.message(start, end);
        }
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::METADATA) {
            return Ok(());
        }
        let record = mcap::parse_record(opcode, &self.bytes[start..end])
            .map_err(|error| format!("a record cannot be read: {error}"))?;
        match record {
            Record::Schema { header, data } => {
                let text = std::str::from_utf8(&data).ok().filter(|_| header.encoding == "ros2msg");
                if let Some((text, fields)) = text.and_then(|t| Some((t, parse_schema(t).ok()?))) {
                    let source = SchemaSource { name: header.name, text: text.to_owned(), fields };
                    self.schemas.insert(header.id, source);
                }
            }
            Record::Channel(channel) => self.channel(channel)?,
            Record::Metadata(metadata) if metadata.name == METADATA_GAP => {
                self.log.gaps.extend(Gap::from_table(&metadata.metadata));
            }
            Record::Metadata(metadata) => {
                self.log.metadata.insert(metadata.name, metadata.metadata);
            }
            _ => {}
        }
        Ok(())
    }

    fn channel(&mut self, channel: mcap::records::Channel) -> Result<(), String> {
        // Writers of others repeat it in each chunk.
        if self.ids.contains_key(&channel.id) {
            return Ok(());
        }
        let schema = self.schemas.get(&channel.schema_id);
        let Some(schema) = schema.filter(|_| channel.message_encoding == "cdr") else {
            self.ids.insert(channel.id, None);
            return Ok(());
        };
        self.schemas_bytes += schema.text.len();
        if self.schemas_bytes > SCHEMAS_BYTES_MAX {
            return Err(format!("the fields of its channels take {} bytes", self.schemas_bytes));
        }
        let type_name = schema.name.rsplit('/').next().unwrap_or_default();
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
            fields: schema.fields.iter().map(current).collect(),
            topic: if signal == written { channel.topic.clone() } else { topic(signal) },
            signal: signal.to_owned(),
        };
        self.ids.insert(channel.id, Some(self.log.channels.len()));
        let size = described.body_size().saturating_sub(STAMP_BYTES);
        self.log.channels.push(described);
        self.log.sources.push(ChannelSource {
            schema: schema.name.clone(),
            fields: schema.text.clone(),
            topic: channel.topic,
            about: channel.metadata,
            size,
            padded: true,
        });
        Ok(())
    }

    /// Time of a message's header less that of its stamp (ns): a log for viewers says from which
    /// instant of the wall clock its headers count, all others count from the start of the run.
    fn time_base(&mut self) -> i128 {
        let said = || {
            let run = self.log.metadata.get(METADATA_RUN)?;
            run.get(TIME_BASE_KEY)?.parse::<u64>().ok()
        };
        let base = self.time_base.unwrap_or_else(|| i128::from(said().unwrap_or(0)));
        self.time_base = Some(base);
        base
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
        let base = self.time_base();
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
        let time = i128::from(u64::try_from(release).unwrap_or(0));
        let [logged, published] =
            [6, 14].map(|at| i128::from(u64::from_le_bytes(array_at(record, at))));
        let sequence: [u8; 4] = array_at(record, 2);
        if sequence != array_at(data, CDR_HEADER_BYTES)
            || [logged - base, published - base] != [time; 2]
        {
            return Err(place("a message whose header is not that of its stamp"));
        }
        if tick > TICK_MAX || release.unsigned_abs() > TICK_MAX {
            return Err(place("a message at an instant that no run reaches"));
        }
        self.log.order.push(here);
        Ok(())
    }
}
