//! The text that explains a recording, read back into a catalog; and bodies into numbers. Refuses
//! fields that do not fill the bodies that they are said to describe.

use std::collections::BTreeMap;

use serde_json::{Map, Value};
use taktil_record::flight::{
    FieldDescription, LaneDescription, MachineDescription, SignalDescription,
};
use taktil_record::schema::number;
use taktil_rtcore::Nanos;
use taktil_rtcore::flight::FlightRecording;
use taktil_rtcore::payload::{Field, Primitive, body_size};
use taktil_rtcore::record::{Catalog, LaneInfo, Signal};

/// What a recording says of itself.
pub(super) struct About {
    pub(super) taktil: String,
    pub(super) process: u32,
    pub(super) catalog: Catalog,
    /// Tasks of each lane in order.
    pub(super) tasks: Vec<Vec<String>>,
    pub(super) texts: BTreeMap<String, String>,
}

/// No body is longer (bytes): keeps sums over damaged counts in their words.
const BODY_BYTES_MAX: usize = 1 << 24;

/// A catalog's words live as long as the program that declared them; here that is this command.
fn kept(text: String) -> &'static str {
    Box::leak(text.into_boxed_str())
}

impl About {
    /// From the text in a recording.
    pub(super) fn parse(found: &FlightRecording) -> Result<About, String> {
        let text: MachineDescription = serde_json::from_str(&found.about)
            .map_err(|error| format!("the text that explains it is damaged: {error}"))?;
        if text.lanes.len() != found.lanes.len() {
            return Err("the text that explains it is about another machine".to_owned());
        }
        let lane = |lane: &LaneDescription| LaneInfo {
            name: lane.name.clone(),
            period: Nanos(lane.period_ns),
            phase: Nanos(lane.phase_ns),
            ..LaneInfo::default()
        };
        let lanes: Vec<LaneInfo> = text.lanes.iter().map(lane).collect();
        let mut signals = Vec::new();
        for signal in text.signals {
            signals.push(signal_of(signal, lanes.len())?);
        }
        Ok(About {
            taktil: text.taktil,
            process: text.process,
            catalog: Catalog { signals, lanes },
            tasks: text.lanes.into_iter().map(|lane| lane.tasks).collect(),
            texts: text.texts,
        })
    }
}

fn signal_of(signal: SignalDescription, lanes: usize) -> Result<Signal, String> {
    let SignalDescription { name, lane, type_name, size, fields } = signal;
    let damaged = || format!("the description of `{name}` in it is damaged");
    let mut table = Vec::new();
    for FieldDescription { name: field, kind, count, array } in fields {
        let kind = Primitive::ALL
            .into_iter()
            .find(|known| known.ros_name() == kind)
            .ok_or_else(damaged)?;
        if count == 0 || count > size.min(BODY_BYTES_MAX) {
            return Err(damaged());
        }
        table.push(Field { name: kept(field), kind, count, array });
    }
    if lane >= lanes || size > BODY_BYTES_MAX || body_size(&table) != size {
        return Err(damaged());
    }
    Ok(Signal { name, lane, type_name: type_name.into(), fields: table.into(), size })
}

/// The fields of a body by name.
pub(super) fn values(signal: &Signal, body: &[u8]) -> Map<String, Value> {
    let mut object = Map::new();
    let mut end = 0usize;
    for field in &*signal.fields {
        let size = field.kind.size();
        let start = end.next_multiple_of(size);
        end = field.end_after(end);
        let Some(bytes) = body.get(start..end) else { break };
        let mut all: Vec<Value> =
            bytes.chunks_exact(size).map(|bytes| number(field.kind, bytes)).collect();
        let value = if field.array { Value::Array(all) } else { all.pop().unwrap_or_default() };
        object.insert(field.name.to_owned(), value);
    }
    object
}
