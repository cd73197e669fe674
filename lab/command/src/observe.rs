//! `taktil watch` and `taktil scope`: signals of a running machine on a terminal or as a table. The
//! machine sends what it records in any case, so that nothing of this costs a job anything.

use std::collections::BTreeMap;
use std::io::{Error, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};
use clap::Args;
use serde_json::Value;
use taktil_machine_client::{MachineClient, SERVICE_SOCKET};
use taktil_machine_console::option::BadOption;
use taktil_machine_console::{option, out, signals};
use taktil_rtcore::Nanos;

/// How long an answer may take.
const ANSWER_TIMEOUT: Nanos = Nanos::from_secs(5);
/// How long one wait for an event lasts before the request to end is looked at.
const WAIT_STEP: Nanos = Nanos::from_millis(100);

/// Arguments of `taktil watch`.
#[derive(Args, Clone, Debug)]
pub struct WatchArgs {
    /// Signals, fields or elements, such as `sense.joints.q_rad[2]`; none: lists what there is
    pub signals: Vec<String>,
    /// Socket of the run or the service
    #[arg(long, value_name = "SOCKET", default_value = SERVICE_SOCKET)]
    pub at: PathBuf,
    /// Values a second, 0.1 to 100
    #[arg(long, value_name = "HZ", default_value_t = 10.0)]
    pub rate: f64,
    /// A table: a line of names, then a line a time
    #[arg(long)]
    pub csv: bool,
    /// End after so many lines
    #[arg(long, value_name = "N")]
    pub count: Option<u64>,
}

/// Arguments of `taktil scope`.
#[derive(Args, Clone, Debug)]
pub struct ScopeArgs {
    /// Single numbers to capture, at most 8, such as `sense.joints.q_rad[2]`
    #[arg(required = true)]
    pub channels: Vec<String>,
    /// Socket of the run or the service
    #[arg(long, value_name = "SOCKET", default_value = SERVICE_SOCKET)]
    pub at: PathBuf,
    /// The event: a number, rises, falls, above or below, and a level
    #[arg(
        long,
        num_args = 3,
        value_names = ["SIGNAL", "CONDITION", "LEVEL"],
        required = true,
        allow_hyphen_values = true
    )]
    pub trigger: Vec<String>,
    /// Seconds before the event
    #[arg(long, value_name = "S", default_value_t = 0.2)]
    pub before: f64,
    /// Seconds after it
    #[arg(long, value_name = "S", default_value_t = 0.8)]
    pub after: f64,
    /// Write the table to this file instead of standard output
    #[arg(long, value_name = "F.csv")]
    pub csv: Option<PathBuf>,
}

fn connected(path: &Path) -> anyhow::Result<MachineClient> {
    let missing = |error: Error| {
        BadOption(format!(
            "nobody listens at `{}` ({error}); start `taktil rehearse SCENE`, or give the service \
             an [operator] section",
            path.display()
        ))
    };
    Ok(MachineClient::connect(path).map_err(missing)?)
}

/// Says something that must be granted.
fn granted(client: &mut MachineClient, words: &str) -> anyhow::Result<Value> {
    let answer = client.ask(words, ANSWER_TIMEOUT).context("the machine has gone")?;
    if !answer.is_ok {
        bail!(BadOption(answer.text));
    }
    Ok(answer.data)
}

/// Prints signals at a rate until a signal comes, or a number of lines is reached.
///
/// # Errors
/// [`BadOption`] for a name that the machine does not have; a machine that goes.
pub fn watch(arguments: &WatchArgs) -> anyhow::Result<ExitCode> {
    let stop = signals::stop_request()?;
    let mut client = connected(&arguments.at)?;
    if arguments.signals.is_empty() {
        return list(&granted(&mut client, "signals")?);
    }
    let names = arguments.signals.join(" ");
    granted(&mut client, &format!("watch {} {names}", arguments.rate))?;
    let mut header = None;
    let mut lines = 0;
    while !stop.is_set() && arguments.count.is_none_or(|count| lines < count) {
        let Some(event) = client.event(WAIT_STEP).context("the machine has gone")? else {
            continue;
        };
        if event["event"] != "watch" {
            continue;
        }
        let row = flattened(&arguments.signals, &event["values"]);
        // A signal without a value yet has no elements to name.
        if arguments.csv && header.is_none() && event["values"].as_object().is_some_and(has_all) {
            let names: Vec<&str> = row.iter().map(|(name, _)| name.as_str()).collect();
            out::line(format_args!("t_s,{}", names.join(",")))?;
            header = Some(names.len());
        }
        let t_s = event["t_ns"].as_f64().unwrap_or(0.0) * 1e-9;
        let is_open = if arguments.csv {
            if header != Some(row.len()) {
                continue;
            }
            let values: Vec<String> = row.into_iter().map(|(_, value)| value).collect();
            out::line(format_args!("{t_s:.4},{}", values.join(",")))?
        } else {
            let shown: Vec<String> =
                row.iter().map(|(name, value)| format!("{name} {value}")).collect();
            out::line(format_args!("{t_s:10.4} s  {}", shown.join("  ")))?
        };
        lines += 1;
        if !is_open {
            break;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn has_all(values: &serde_json::Map<String, Value>) -> bool {
    values.values().all(|value| !value.is_null())
}

fn list(signals: &Value) -> anyhow::Result<ExitCode> {
    for (signal, fields) in signals.as_object().into_iter().flatten() {
        let field = |field: &Value| {
            let name = field["name"].as_str().unwrap_or_default();
            match field["count"].as_u64() {
                Some(1) | None => name.to_owned(),
                Some(count) => format!("{name}[{count}]"),
            }
        };
        let fields: Vec<String> = fields.as_array().into_iter().flatten().map(field).collect();
        out::line(format_args!("{signal:28} {}", fields.join(" ")))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Every number of the values with its full name, in the order in which they were asked for.
fn flattened(order: &[String], values: &Value) -> Vec<(String, String)> {
    let mut row = Vec::new();
    for name in order {
        flatten(name, &values[name], &mut row);
    }
    row
}

fn flatten(name: &str, value: &Value, row: &mut Vec<(String, String)>) {
    match value {
        Value::Object(fields) => {
            for (field, value) in fields {
                flatten(&format!("{name}.{field}"), value, row);
            }
        }
        Value::Array(elements) => {
            for (at, value) in elements.iter().enumerate() {
                flatten(&format!("{name}[{at}]"), value, row);
            }
        }
        Value::Null => row.push((name.to_owned(), String::new())),
        value => row.push((name.to_owned(), value.to_string())),
    }
}

/// Captures signals around an event and writes them as a table.
///
/// # Errors
/// [`BadOption`] for a name or a condition that the machine refuses; a machine that goes.
pub fn scope(arguments: &ScopeArgs) -> anyhow::Result<ExitCode> {
    if let Some(path) = &arguments.csv {
        option::check_writable("--csv", path)?;
    }
    let stop = signals::stop_request()?;
    let mut client = connected(&arguments.at)?;
    let (channels, trigger) = (arguments.channels.join(" "), arguments.trigger.join(" "));
    let (before, after) = (arguments.before, arguments.after);
    granted(
        &mut client,
        &format!("scope {channels} trigger {trigger} before {before} after {after}"),
    )?;
    out::warn("armed; Ctrl-C gives up");
    while !stop.is_set() {
        let Some(event) = client.event(WAIT_STEP).context("the machine has gone")? else {
            continue;
        };
        if event["event"] != "scope" {
            continue;
        }
        let table = capture_table(&event["channels"]);
        match &arguments.csv {
            None => drop(out::text(table)?),
            Some(path) => std::fs::File::create(path)
                .and_then(|mut file| file.write_all(table.as_bytes()))
                .with_context(|| format!("{}", path.display()))?,
        }
        return Ok(ExitCode::SUCCESS);
    }
    out::warn("the event did not come");
    Ok(ExitCode::from(1))
}

/// A line of names, then a line a time; a channel without a value at a time has none there.
fn capture_table(channels: &Value) -> String {
    let channels = channels.as_array().map(Vec::as_slice).unwrap_or_default();
    // Times are whole microseconds apart at least; as keys they must have an order.
    let mut rows: BTreeMap<i64, Vec<String>> = BTreeMap::new();
    for (at, channel) in channels.iter().enumerate() {
        let times = channel["t_s"].as_array().into_iter().flatten();
        let values = channel["values"].as_array().into_iter().flatten();
        for (time, value) in times.zip(values) {
            #[expect(clippy::cast_possible_truncation, reason = "a capture is at most 60 s long")]
            let key = (time.as_f64().unwrap_or(0.0) * 1e9).round() as i64;
            let row = rows.entry(key).or_insert_with(|| vec![String::new(); channels.len()]);
            row[at] = if value.is_null() { String::new() } else { value.to_string() };
        }
    }
    let names = channels.iter().map(|channel| channel["name"].as_str().unwrap_or_default());
    let mut table = format!("t_s,{}\n", names.collect::<Vec<_>>().join(","));
    for (key, row) in rows {
        let t_s = Nanos(key).as_secs_f64();
        table += &format!("{t_s},{}\n", row.join(","));
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn values_are_named_to_the_last_element_in_the_order_in_which_they_were_asked_for() {
        let values = json!({ "a.b": { "x": 1, "y": [2.5, null] }, "a.a[0]": -1.0 });
        let order = ["a.b".to_owned(), "a.a[0]".to_owned()];
        let row = flattened(&order, &values);
        let text = |name: &str, value: &str| (name.to_owned(), value.to_owned());
        let expected = [
            text("a.b.x", "1"),
            text("a.b.y[0]", "2.5"),
            text("a.b.y[1]", ""),
            text("a.a[0]", "-1.0"),
        ];
        assert_eq!(row, expected);
    }

    #[test]
    fn a_capture_is_a_table_with_a_row_for_each_time() {
        let channels = json!([
            { "name": "fast", "t_s": [-0.0025, 0.0, 0.0025], "values": [1, 2, 3] },
            { "name": "slow", "t_s": [0.0], "values": [9.5] },
        ]);
        assert_eq!(capture_table(&channels), "t_s,fast,slow\n-0.0025,1,\n0,2,9.5\n0.0025,3,\n");
    }
}
