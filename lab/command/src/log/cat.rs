//! `taktil log cat`: the messages of a log as lines, JSON or a table. Numbers are exact, also
//! integers of 64 bits.

use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;

use serde_json::{Map, Value, json};
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_record::{FieldInfo, Log, Message};

use super::Part;

/// Elements of an array that a line for people shows.
const ELEMENTS_SHOWN_MAX: usize = 8;

/// Prints messages.
///
/// # Errors
/// Not a log, no such signal, or a table of more than one.
pub(super) fn run(path: &Path, part: &Part, json: bool, csv: bool) -> anyhow::Result<ExitCode> {
    let mut log = super::open(path)?;
    part.apply(&mut log)?;
    if csv && part.signal.len() != 1 {
        return Err(
            BadOption("--csv: name one --signal, whose fields are the columns".into()).into()
        );
    }
    if csv {
        let Some(channel) = part.signal.first().and_then(|name| log.find(name)) else {
            return Ok(ExitCode::SUCCESS);
        };
        out::line(heading(log.channels()[channel].payload_fields()))?;
    }
    for message in log.messages() {
        let fields = log.channels()[message.channel].payload_fields();
        out::line(match (json, csv) {
            (true, _) => object(&log, &message, fields).to_string(),
            (_, true) => row(&message, fields),
            _ => sentence(&log, &message, fields),
        })?;
    }
    if let Some(damage) = log.damage() {
        out::warn(format_args!("the log is {damage}"));
    }
    Ok(ExitCode::SUCCESS)
}

fn seconds(message: &Message<'_>) -> f64 {
    message.release_ns as f64 / 1e9
}

fn object(log: &Log, message: &Message<'_>, fields: &[FieldInfo]) -> Value {
    let value: Map<String, Value> =
        fields.iter().map(|field| (field.name.clone(), field.value(message.data))).collect();
    json!({
        "signal": log.channels()[message.channel].signal,
        "tick": message.tick,
        "release_ns": message.release_ns,
        "value": value,
    })
}

fn sentence(log: &Log, message: &Message<'_>, fields: &[FieldInfo]) -> String {
    let signal = &log.channels()[message.channel].signal;
    let mut line = format!("{:.6} {signal} {}", seconds(message), message.tick);
    for field in fields {
        let value = field.value(message.data);
        let text = match &value {
            Value::Array(all) if all.len() > ELEMENTS_SHOWN_MAX => {
                let shown: Vec<String> =
                    all[..ELEMENTS_SHOWN_MAX].iter().map(ToString::to_string).collect();
                format!("[{},... of {}]", shown.join(","), all.len())
            }
            _ => value.to_string(),
        };
        let _ = write!(line, " {}={text}", field.name);
    }
    line
}

fn heading(fields: &[FieldInfo]) -> String {
    let mut columns = vec!["t_s".to_owned(), "tick".to_owned()];
    for field in fields {
        match field.array {
            true => columns.extend((0..field.count).map(|n| format!("{}[{n}]", field.name))),
            false => columns.push(field.name.clone()),
        }
    }
    columns.join(",")
}

fn row(message: &Message<'_>, fields: &[FieldInfo]) -> String {
    let text = |value: &Value| if value.is_null() { "nan".to_owned() } else { value.to_string() };
    let mut cells = vec![seconds(message).to_string(), message.tick.to_string()];
    for field in fields {
        match field.value(message.data) {
            Value::Array(all) => cells.extend(all.iter().map(text)),
            value => cells.push(text(&value)),
        }
    }
    cells.join(",")
}
