//! `taktil diff`: two logs, signal by signal and tick by tick, and the first place where they part:
//! tick, time, task, port, field, element, both values. Compares bytes, so that -0.0 is not 0.0 and
//! one NaN is not another. Refuses to call two logs equal unless both were read to their end.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use serde_json::{Value, json};
use taktil_rtcore::payload::Kind;

use crate::log::{Channel, FieldInfo, Log, METADATA_RUN, Message};
use crate::run::BadOption;

/// Signals that are listed one by one for people; JSON has them all.
const LISTED_MAX: usize = 20;
/// What the logs may say of themselves that explains why they differ.
const ORIGIN: [&str; 4] = ["scene", "seed", "mode", "taktil"];

/// What the command line says.
#[derive(Clone, Debug)]
pub struct Options {
    /// First log.
    pub a: PathBuf,
    /// Second log.
    pub b: PathBuf,
    /// JSON instead of sentences.
    pub json: bool,
}

/// What is different about one message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// A field has two values.
    Field {
        /// Field name, unit last.
        field: String,
        /// Element of an array.
        index: Option<usize>,
        /// Value in A, floats with their bits.
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
    /// Job.
    pub tick: u64,
    /// Logical time of that job; the earlier one where the logs disagree.
    pub release_ns: i64,
    /// What differs.
    pub change: Change,
}

impl Divergence {
    /// Task and port; the whole name is the task when there is no port.
    #[must_use]
    pub fn task_and_port(&self) -> (&str, &str) {
        self.signal.rsplit_once('.').unwrap_or((&self.signal, ""))
    }
}

/// One signal that both logs have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Compared {
    /// Signal, `task.port`.
    pub signal: String,
    /// Messages in A and in B.
    pub messages: (usize, usize),
    /// Messages at the same tick with other bytes.
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
    pub compared: Vec<Compared>,
    /// Signals that only A has.
    pub only_a: Vec<String>,
    /// Signals that only B has.
    pub only_b: Vec<String>,
    /// Signals whose messages are built differently, so that they were not compared.
    pub other_fields: Vec<String>,
    /// Where A and B stop being readable, in words.
    pub damage: [Option<String>; 2],
    /// Remarks that decide nothing: other seeds, messages of other programs.
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

    /// The first divergence in logical time; of several at one instant the first in A's catalog.
    #[must_use]
    pub fn first(&self) -> Option<&Divergence> {
        // `min_by_key` keeps the first of equals, which is the order of the catalog.
        self.compared
            .iter()
            .filter_map(|signal| signal.first.as_ref())
            .min_by_key(|divergence| divergence.release_ns)
    }

    /// True when what can be read is the same on both sides.
    #[must_use]
    pub fn same_readable(&self) -> bool {
        self.first().is_none()
            && self.only_a.is_empty()
            && self.only_b.is_empty()
            && self.other_fields.is_empty()
    }

    /// True when both logs could be read to their end and are the same.
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

/// Compares two files and says how they differ; exit 0 equal, 1 different.
///
/// # Errors
/// A file that is no log, as [`BadOption`].
pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let open = |path: &PathBuf| Log::open(path).map_err(|error| BadOption(format!("{error:#}")));
    let comparison = Comparison::new(&open(&options.a)?, &open(&options.b)?);
    if options.json {
        println!("{}", to_json(&comparison));
    } else {
        let names = [&options.a, &options.b].map(|path| path.display().to_string());
        print!("{}", text(&comparison, [&names[0], &names[1]]));
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

/// Name of each channel and how many of the same name stand before it.
fn keys(channels: &[Channel]) -> Vec<(&str, usize)> {
    let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
    let mut key = |channel| {
        let count = seen.entry(channel).or_default();
        *count += 1;
        (channel, *count)
    };
    channels.iter().map(|channel| key(channel.signal.as_str())).collect()
}

/// Walks two lists of messages, sorted by tick, side by side.
fn compare(channel: &Channel, a: &[Message<'_>], b: &[Message<'_>]) -> Compared {
    let mut found = Compared {
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
        // Ticks ascend, but a damaged clock may not: what counts is logical time.
        if found.first.as_ref().is_none_or(|first| release_ns < first.release_ns) {
            let signal = channel.signal.clone();
            found.first = Some(Divergence { signal, tick, release_ns, change });
        }
    }
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
                    a: left.map_or_else(String::new, |bytes| shown(field, bytes)),
                    b: right.map_or_else(String::new, |bytes| shown(field, bytes)),
                };
            }
        }
    }
    // Every field agrees: the bytes between them, or the sum over them, do not.
    let at = a.iter().zip(b).position(|(left, right)| left != right).unwrap_or(0);
    let byte = |data: &[u8]| data.get(at).map_or_else(String::new, |byte| format!("{byte:#04x}"));
    Change::Field { field: "(padding)".to_owned(), index: Some(at), a: byte(a), b: byte(b) }
}

fn word<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.try_into().unwrap_or([0; N])
}

/// A value for people; floats with their bits, since two of them can look alike.
fn shown(field: &FieldInfo, bytes: &[u8]) -> String {
    match field.kind {
        Kind::F64 => {
            let value = f64::from_le_bytes(word(bytes));
            format!("{value:?} ({:#018x})", value.to_bits())
        }
        Kind::F32 => {
            let value = f32::from_le_bytes(word(bytes));
            format!("{value:?} ({:#010x})", value.to_bits())
        }
        Kind::I64 => i64::from_le_bytes(word(bytes)).to_string(),
        Kind::U64 => u64::from_le_bytes(word(bytes)).to_string(),
        Kind::I32 => i32::from_le_bytes(word(bytes)).to_string(),
        Kind::U32 => u32::from_le_bytes(word(bytes)).to_string(),
        Kind::I16 => i16::from_le_bytes(word(bytes)).to_string(),
        Kind::U16 => u16::from_le_bytes(word(bytes)).to_string(),
        Kind::U8 => u8::from_le_bytes(word(bytes)).to_string(),
    }
}

fn remarks(a: &Log, b: &Log) -> Vec<String> {
    let mut out = Vec::new();
    for key in ORIGIN {
        let say = |log: &Log| log.metadata().get(METADATA_RUN).and_then(|m| m.get(key)).cloned();
        let (left, right) = (say(a), say(b));
        if left != right {
            let word = |text: Option<String>| text.unwrap_or_else(|| "not stated".to_owned());
            out.push(format!("{key}: {} in A, {} in B", word(left), word(right)));
        }
    }
    for (log, name) in [(a, "A"), (b, "B")] {
        if log.foreign() > 0 {
            let count = log.foreign();
            out.push(format!("{count} messages in {name} are not Taktil's and were left out"));
        }
    }
    out
}

/// Seconds with all nine digits, from integers.
fn seconds(ns: i64) -> String {
    let sign = if ns < 0 { "-" } else { "" };
    let ns = ns.unsigned_abs();
    format!("{sign}{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000)
}

/// The comparison in sentences; `names` are the two files.
#[must_use]
pub fn text(found: &Comparison, names: [&str; 2]) -> String {
    let mut out = format!("A  {}\nB  {}\n", names[0], names[1]);
    for (damage, name) in found.damage.iter().zip(["A", "B"]) {
        if let Some(what) = damage {
            let _ = writeln!(out, "{name} is cut or damaged, {what}");
        }
    }
    let (messages_a, messages_b) = found.messages();
    let signals = found.compared.len();
    if found.same_readable() {
        let short = if found.equal() { "equal" } else { "equal as far as both can be read" };
        let _ = writeln!(out, "{short}: {signals} signals, {messages_a} messages, bit for bit");
    } else {
        let _ = writeln!(
            out,
            "different: {signals} signals compared, {messages_a} messages in A, {messages_b} in B"
        );
    }
    if let Some(first) = found.first() {
        out.push_str(&first_text(first));
    }
    for (list, what) in [
        (&found.only_a, "only in A"),
        (&found.only_b, "only in B"),
        (&found.other_fields, "not compared, built from other fields"),
    ] {
        if !list.is_empty() {
            let _ = writeln!(out, "{what}: {}", list.join(", "));
        }
    }
    out.push_str(&table(found));
    for remark in &found.remarks {
        let _ = writeln!(out, "note: {remark}");
    }
    out
}

fn first_text(first: &Divergence) -> String {
    let (task, port) = first.task_and_port();
    let mut out = format!(
        "first divergence\n  tick   {}\n  time   {} s\n  task   {task}\n  port   {port}\n",
        first.tick,
        seconds(first.release_ns)
    );
    let _ = match &first.change {
        Change::Field { field, index, a, b } => {
            let index = index.map_or_else(String::new, |index| format!("[{index}]"));
            writeln!(out, "  field  {field}{index}\n  A      {a}\n  B      {b}")
        }
        Change::OnlyInA => writeln!(out, "  B has no message at this tick"),
        Change::OnlyInB => writeln!(out, "  A has no message at this tick"),
    };
    out
}

fn table(found: &Comparison) -> String {
    let differing: Vec<&Compared> =
        found.compared.iter().filter(|signal| signal.first.is_some()).collect();
    let Some(width) = differing.iter().map(|signal| signal.signal.chars().count()).max() else {
        return String::new();
    };
    let width = width.max(6);
    let mut out = format!(
        "\n{:width$}  {:>9}  {:>9}  {:>9}  {:>9}  {:>16}\n",
        "signal", "in A", "in B", "changed", "one side", "first at s"
    );
    for signal in differing.iter().take(LISTED_MAX) {
        let at = signal.first.as_ref().map_or_else(String::new, |d| seconds(d.release_ns));
        let _ = writeln!(
            out,
            "{:width$}  {:>9}  {:>9}  {:>9}  {:>9}  {at:>16}",
            signal.signal, signal.messages.0, signal.messages.1, signal.changed, signal.alone
        );
    }
    if differing.len() > LISTED_MAX {
        let _ = writeln!(out, "and {} more; --json lists all", differing.len() - LISTED_MAX);
    }
    out
}

fn divergence_json(divergence: &Divergence) -> Value {
    let (task, port) = divergence.task_and_port();
    let mut out = json!({
        "signal": divergence.signal,
        "task": task,
        "port": port,
        "tick": divergence.tick,
        "release_ns": divergence.release_ns,
    });
    match &divergence.change {
        Change::Field { field, index, a, b } => {
            out["kind"] = json!("field");
            out["field"] = json!(field);
            out["index"] = json!(index);
            out["a"] = json!(a);
            out["b"] = json!(b);
        }
        Change::OnlyInA => out["kind"] = json!("only_in_a"),
        Change::OnlyInB => out["kind"] = json!("only_in_b"),
    }
    out
}

/// The comparison for programs: one object.
#[must_use]
pub fn to_json(found: &Comparison) -> Value {
    let signals: Vec<Value> = found
        .compared
        .iter()
        .map(|signal| {
            json!({
                "signal": signal.signal,
                "messages_a": signal.messages.0,
                "messages_b": signal.messages.1,
                "changed": signal.changed,
                "one_side": signal.alone,
                "first": signal.first.as_ref().map(divergence_json),
            })
        })
        .collect();
    json!({
        "equal": found.equal(),
        "equal_as_far_as_readable": found.same_readable(),
        "first": found.first().map(divergence_json),
        "messages_a": found.messages().0,
        "messages_b": found.messages().1,
        "signals": signals,
        "only_a": found.only_a,
        "only_b": found.only_b,
        "other_fields": found.other_fields,
        "damage_a": found.damage[0],
        "damage_b": found.damage[1],
        "notes": found.remarks,
    })
}
