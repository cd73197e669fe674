//! `taktil diff`: compares two logs signal by signal and tick by tick, and finds the first
//! difference: tick, time, task, port, field, element and both values. Bytes are compared, so -0.0
//! differs from 0.0, and NaNs with different bits differ. Two logs are equal only if both were read
//! to their end.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;

use taktil_machine_console::out;
use taktil_rtcore::payload::Primitive;

use taktil_machine_console::option::BadOption;
use taktil_record::{Channel, FieldInfo, Log, METADATA_RUN, Message};

mod print;

pub(crate) use print::{first_text, seconds};
pub use print::{text, to_json};

/// Metadata of the logs that may explain why they differ.
const ORIGIN_KEYS: [&str; 4] = ["scene", "seed", "mode", "taktil"];

/// The arguments of the command line.
#[derive(Clone, Debug)]
pub struct Options {
    /// First log.
    pub a: PathBuf,
    /// Second log.
    pub b: PathBuf,
    /// JSON instead of sentences.
    pub json: bool,
}

/// The difference of one message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// A field has two values.
    Field {
        /// Field name, unit last.
        field: String,
        /// Index of the element in an array.
        index: Option<usize>,
        /// Value in A; floats with their bits.
        a: String,
        /// Value in B.
        b: String,
    },
    /// Only A has a message at this tick.
    OnlyInA,
    /// Only B has a message at this tick.
    OnlyInB,
}

/// A place where two logs differ.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Divergence {
    /// Signal, `task.port`.
    pub signal: String,
    /// Lane of the job; empty when the logs do not name it.
    pub lane: String,
    /// What the element of an array stands for: a task in a lane's state, a signal in its decision.
    pub of: Option<String>,
    /// Number of the job.
    pub tick: u64,
    /// Logical time of that job; the earlier time where the logs disagree.
    pub release_ns: i64,
    /// The difference.
    pub change: Change,
}

impl Divergence {
    /// Task and port. A name without a port is the task. For a lane's state it is the task whose
    /// state differs.
    #[must_use]
    pub fn task_and_port(&self) -> (&str, &str) {
        let (task, port) = self.signal.rsplit_once('.').unwrap_or((&self.signal, ""));
        match &self.of {
            Some(task) if port == "state" => (task, port),
            _ => (task, port),
        }
    }

    /// The same divergence with A and B exchanged.
    fn swapped(mut self) -> Divergence {
        if let Change::Field { a, b, .. } = &mut self.change {
            std::mem::swap(a, b);
        }
        self
    }

    /// The order of differences at one instant, causes before effects: inputs and decisions, then
    /// what tasks wrote to ports and devices, then their states, then the lane's health.
    fn rank(&self) -> u8 {
        match self.signal.rsplit_once('.') {
            Some(("hal", "analog_out" | "digital_out")) => 2,
            Some(("hal", _)) => 0,
            Some((lane, "decision")) if lane == self.lane => 0,
            Some((lane, "state")) if lane == self.lane => 3,
            Some((lane, "health")) if lane == self.lane => 4,
            _ => 1,
        }
    }
}

/// The comparison of a signal that both logs have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SignalComparison {
    /// Signal, `task.port`.
    pub signal: String,
    /// Messages in A and in B.
    pub messages: (usize, usize),
    /// Messages at the same tick with different bytes.
    pub changed: usize,
    /// Messages that the other log lacks.
    pub alone: usize,
    /// The first difference.
    pub first: Option<Divergence>,
}

/// The comparison of two logs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Comparison {
    /// Signals of both logs with the same fields, in A's catalog order.
    pub compared: Vec<SignalComparison>,
    /// Signals that only A has.
    pub only_a: Vec<String>,
    /// Signals that only B has.
    pub only_b: Vec<String>,
    /// Signals with different fields, which were not compared.
    pub other_fields: Vec<String>,
    /// Where A and B stop being readable, as text.
    pub damage: [Option<String>; 2],
    /// The difference of the message at which one of them stops being readable.
    pub broken: Option<Divergence>,
    /// Remarks that do not affect the result, such as different seeds or program versions.
    pub remarks: Vec<String>,
}

impl Comparison {
    /// Compares two logs.
    #[must_use]
    pub fn new(a: &Log, b: &Log) -> Comparison {
        let (by_a, by_b) = (by_channel(a), by_channel(b));
        let (keys_a, keys_b) = (keys(a.channels()), keys(b.channels()));
        let mut found = Comparison {
            compared: Vec::new(),
            only_a: Vec::new(),
            only_b: Vec::new(),
            other_fields: Vec::new(),
            damage: [a, b].map(|log| log.damage().map(ToString::to_string)),
            broken: damaged_divergence(a, b, &by_b)
                .or_else(|| damaged_divergence(b, a, &by_a).map(Divergence::swapped)),
            remarks: remarks(a, b),
        };
        for (at, key) in keys_a.iter().enumerate() {
            let channel = &a.channels()[at];
            match keys_b.iter().position(|other| other == key) {
                None => found.only_a.push(channel.signal.clone()),
                Some(to) if b.channels()[to].fields != channel.fields => {
                    found.other_fields.push(channel.signal.clone());
                }
                Some(to) => found.compared.push(compare(channel, &by_a[at], &by_b[to])),
            }
        }
        for (at, key) in keys_b.iter().enumerate() {
            if !keys_a.contains(key) {
                found.only_b.push(b.channels()[at].signal.clone());
            }
        }
        found
    }

    /// The damaged message, if there is one; otherwise the first divergence in logical time, and of
    /// several at one instant the likeliest cause.
    #[must_use]
    pub fn first(&self) -> Option<&Divergence> {
        // `min_by_key` keeps the first of equals, which is the order of the catalog.
        let all = self.compared.iter().filter_map(|signal| signal.first.as_ref());
        let first = all.min_by_key(|divergence| (divergence.release_ns, divergence.rank()));
        self.broken.as_ref().or(first)
    }

    /// True when the readable parts are equal.
    #[must_use]
    pub fn same_readable(&self) -> bool {
        self.first().is_none()
            && self.only_a.is_empty()
            && self.only_b.is_empty()
            && self.other_fields.is_empty()
    }

    /// True when both logs could be read to their end and are equal.
    #[must_use]
    pub fn equal(&self) -> bool {
        self.same_readable() && self.damage.iter().all(Option::is_none)
    }

    /// Messages in A and in B of the signals that both have.
    #[must_use]
    pub fn messages(&self) -> (usize, usize) {
        self.compared
            .iter()
            .fold((0, 0), |(a, b), signal| (a + signal.messages.0, b + signal.messages.1))
    }
}

/// Compares two files and prints how they differ; the exit code is 0 for equal, 1 for different.
///
/// # Errors
/// A file that is not a log, as [`BadOption`].
pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let open = |path: &PathBuf| Log::open(path).map_err(|error| BadOption(format!("{error:#}")));
    let comparison = Comparison::new(&open(&options.a)?, &open(&options.b)?);
    if options.json {
        out::line(to_json(&comparison))?;
    } else {
        let names = [&options.a, &options.b].map(|path| path.display().to_string());
        out::text(text(&comparison, [&names[0], &names[1]]))?;
    }
    Ok(if comparison.equal() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// Messages of each channel in order of their ticks.
fn by_channel(log: &Log) -> Vec<Vec<Message<'_>>> {
    let mut out = vec![Vec::new(); log.channels().len()];
    for message in log.messages() {
        if let Some(list) = out.get_mut(message.channel) {
            list.push(message);
        }
    }
    for list in &mut out {
        list.sort_by_key(|message| message.tick);
    }
    out
}

/// Name of each channel, and how many channels of the same name precede it.
fn keys(channels: &[Channel]) -> Vec<(&str, usize)> {
    let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
    let mut key = |channel| {
        let count = seen.entry(channel).or_default();
        *count += 1;
        (channel, *count)
    };
    channels.iter().map(|channel| key(channel.signal.as_str())).collect()
}

/// Compares two lists of messages, sorted by tick.
fn compare(channel: &Channel, a: &[Message<'_>], b: &[Message<'_>]) -> SignalComparison {
    let mut found = SignalComparison {
        signal: channel.signal.clone(),
        messages: (a.len(), b.len()),
        changed: 0,
        alone: 0,
        first: None,
    };
    let (mut i, mut j) = (0, 0);
    loop {
        let order = match (a.get(i), b.get(j)) {
            (None, None) => return found,
            (Some(_), None) => Ordering::Less,
            (None, Some(_)) => Ordering::Greater,
            (Some(left), Some(right)) => left.tick.cmp(&right.tick),
        };
        let divergence = match order {
            Ordering::Less => Some((a[i].tick, a[i].release_ns, Change::OnlyInA)),
            Ordering::Greater => Some((b[j].tick, b[j].release_ns, Change::OnlyInB)),
            Ordering::Equal if a[i].data == b[j].data => None,
            Ordering::Equal => {
                let release_ns = a[i].release_ns.min(b[j].release_ns);
                Some((a[i].tick, release_ns, first_change(channel, a[i].data, b[j].data)))
            }
        };
        i += usize::from(order.is_le());
        j += usize::from(order.is_ge());
        let Some((tick, release_ns, change)) = divergence else { continue };
        if order.is_eq() {
            found.changed += 1;
        } else {
            found.alone += 1;
        }
        // Logical time decides, because a damaged clock may not ascend with the ticks.
        if found.first.as_ref().is_none_or(|first| release_ns < first.release_ns) {
            found.first = Some(divergence_of(channel, (tick, release_ns), change));
        }
    }
}

fn divergence_of(channel: &Channel, (tick, release_ns): (u64, i64), change: Change) -> Divergence {
    let of = match &change {
        Change::Field { index: Some(index), .. } => channel.elements.get(*index).cloned(),
        _ => None,
    };
    let (signal, lane) = (channel.signal.clone(), channel.lane.clone());
    Divergence { signal, lane, of, tick, release_ns, change }
}

/// The difference between the message at which `damaged` fails its CRC and the same message in
/// `other`, whose values come second.
fn damaged_divergence(
    damaged: &Log,
    other: &Log,
    by_other: &[Vec<Message<'_>>],
) -> Option<Divergence> {
    let suspect = damaged.corrupt_message()?;
    let channel = &damaged.channels()[suspect.channel];
    let to = other.find(&channel.signal)?;
    // The message's number in the channel is used as well, because its tick may be damaged.
    let before = damaged.messages().filter(|message| message.channel == suspect.channel).count();
    let twin = by_other[to].iter().find(|message| message.tick == suspect.tick);
    let twin = twin.or(by_other[to].get(before))?;
    if other.channels()[to].fields != channel.fields || twin.data == suspect.data {
        return None;
    }
    let change = first_change(channel, suspect.data, twin.data);
    Some(divergence_of(channel, (twin.tick, twin.release_ns), change))
}

/// The first field, in the order of the schema, whose bytes differ.
fn first_change(channel: &Channel, a: &[u8], b: &[u8]) -> Change {
    let last = channel.fields.len().saturating_sub(1);
    for field in &channel.fields[..last] {
        let size = field.kind.size();
        for element in 0..field.count {
            let at = field.offset + element * size;
            let (left, right) = (a.get(at..at + size), b.get(at..at + size));
            if left != right {
                return Change::Field {
                    field: field.name.clone(),
                    index: field.array.then_some(element),
                    a: left.map_or_else(String::new, |bytes| format_value(field, bytes)),
                    b: right.map_or_else(String::new, |bytes| format_value(field, bytes)),
                };
            }
        }
    }
    // Every field agrees, so the padding between them or the checksum differs.
    let at = a.iter().zip(b).position(|(left, right)| left != right).unwrap_or(0);
    let byte = |data: &[u8]| data.get(at).map_or_else(String::new, |byte| format!("{byte:#04x}"));
    let crc = channel.fields.last().is_some_and(|crc| at >= crc.offset);
    let field = if crc { "(crc)" } else { "(padding)" };
    Change::Field { field: field.to_owned(), index: Some(at), a: byte(a), b: byte(b) }
}

fn fixed_bytes<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.try_into().unwrap_or([0; N])
}

/// A value as text; floats with their bits, because two different floats can print alike.
fn format_value(field: &FieldInfo, bytes: &[u8]) -> String {
    match field.kind {
        Primitive::F64 => {
            let value = f64::from_le_bytes(fixed_bytes(bytes));
            format!("{value:?} ({:#018x})", value.to_bits())
        }
        Primitive::F32 => {
            let value = f32::from_le_bytes(fixed_bytes(bytes));
            format!("{value:?} ({:#010x})", value.to_bits())
        }
        Primitive::I64 => i64::from_le_bytes(fixed_bytes(bytes)).to_string(),
        Primitive::U64 => u64::from_le_bytes(fixed_bytes(bytes)).to_string(),
        Primitive::I32 => i32::from_le_bytes(fixed_bytes(bytes)).to_string(),
        Primitive::U32 => u32::from_le_bytes(fixed_bytes(bytes)).to_string(),
        Primitive::I16 => i16::from_le_bytes(fixed_bytes(bytes)).to_string(),
        Primitive::U16 => u16::from_le_bytes(fixed_bytes(bytes)).to_string(),
        Primitive::U8 => u8::from_le_bytes(fixed_bytes(bytes)).to_string(),
    }
}

fn remarks(a: &Log, b: &Log) -> Vec<String> {
    let mut out = Vec::new();
    for key in ORIGIN_KEYS {
        let say = |log: &Log| log.metadata().get(METADATA_RUN).and_then(|m| m.get(key)).cloned();
        let (left, right) = (say(a), say(b));
        if left != right {
            let word = |text: Option<String>| text.unwrap_or_else(|| "not stated".to_owned());
            out.push(format!("{key}: {} in A, {} in B", word(left), word(right)));
        }
    }
    for (log, name) in [(a, "A"), (b, "B")] {
        if log.foreign_messages() > 0 {
            let count = log.foreign_messages();
            out.push(format!("{count} messages in {name} are not Taktil's and were left out"));
        }
    }
    out
}
