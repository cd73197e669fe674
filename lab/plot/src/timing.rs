//! How late jobs started and how long they took, from the closing figures of a run. Refuses to
//! draw timing that was not measured: in virtual time there is none.

use anyhow::Context;
use serde_json::Value;

use super::histogram::{Histogram, log_histogram};
use super::svg::Figure;
use taktil_record::{Log, METADATA_RESULT};

/// Key of the closing metadata under which a run's summary (JSON) is kept.
pub const SUMMARY_KEY: &str = "summary";

/// The summary that a run left in its log.
///
/// # Errors
/// A summary that is not JSON.
pub fn summary_of(log: &Log) -> anyhow::Result<Option<Value>> {
    let text = log.metadata().get(METADATA_RESULT).and_then(|about| about.get(SUMMARY_KEY));
    let Some(text) = text else { return Ok(None) };
    let value = serde_json::from_str(text).context("the log's closing summary is not JSON")?;
    Ok(Some(value))
}

fn bins(lane: &Value, key: &str) -> Vec<(f64, f64)> {
    let pair = |bin: &Value| Some((bin.get(0)?.as_f64()?, bin.get(1)?.as_f64()?));
    let list = lane.get(key).and_then(Value::as_array);
    list.map(|bins| bins.iter().filter_map(pair).collect()).unwrap_or_default()
}

/// Whether jobs waited for their time: not in virtual time.
#[must_use]
pub fn waits(summary: &Value) -> bool {
    summary.get("mode").and_then(Value::as_str) != Some("fast")
}

/// Lateness and execution of one lane.
#[derive(Clone, Debug, PartialEq)]
pub struct LaneTiming {
    /// Name of the lane.
    pub name: String,
    /// How late jobs started.
    pub late: Histogram,
    /// How long jobs took.
    pub execution: Histogram,
}

/// The lanes of a summary that have timing figures.
#[must_use]
pub fn lanes(summary: &Value) -> Vec<LaneTiming> {
    let Some(lanes) = summary.get("lanes").and_then(Value::as_array) else { return Vec::new() };
    let one = |lane: &Value| {
        let name = lane.get("name")?.as_str()?;
        let micros = |key: &str| lane.get(key).and_then(Value::as_f64).map(|ns| ns / 1e3);
        let mark = |key: &str, text: &str| micros(key).map(|us| (us, text.to_owned()));
        let quantile = |of: &str, key: &str, text: &str| {
            let us = lane.get(of).and_then(|all| all.get(key)).and_then(Value::as_f64);
            us.filter(|us| *us > 0.0).map(|us| (us, text.to_owned()))
        };
        let late = Histogram {
            title: format!("{name}: release lateness"),
            bins: bins(lane, "release_late_bins"),
            marks: quantile("release_late_us", "p99", "p99").into_iter().collect(),
            colour: 0,
        };
        let execution = Histogram {
            title: format!("{name}: execution"),
            bins: bins(lane, "exec_bins"),
            marks: quantile("exec_us", "p99", "p99")
                .into_iter()
                .chain(mark("deadline_ns", "deadline"))
                .collect(),
            colour: 2,
        };
        let measured = !late.bins.is_empty() || !execution.bins.is_empty();
        measured.then(|| LaneTiming { name: name.to_owned(), late, execution })
    };
    lanes.iter().filter_map(one).collect()
}

const WIDTH: f64 = 430.0;
const HEIGHT: f64 = 190.0;

/// Two pictures a lane: lateness and execution. In virtual time no job waits: execution alone.
#[must_use]
pub fn figures(summary: &Value) -> Vec<Figure> {
    let waits = waits(summary);
    let drawn = |lane: LaneTiming| {
        let late = waits.then_some(lane.late);
        late.into_iter()
            .chain([lane.execution])
            .map(|histogram| log_histogram(&histogram, WIDTH, HEIGHT))
    };
    lanes(summary).into_iter().flat_map(drawn).collect()
}

/// All histograms of a log in one picture, or as a table; `None` when it has none.
///
/// # Errors
/// A summary that is not JSON.
pub(super) fn page(log: &Log, csv: bool) -> anyhow::Result<Option<String>> {
    let Some(summary) = summary_of(log)? else { return Ok(None) };
    if csv {
        let mut out = String::from("lane,what,up_to_us,jobs\n");
        let mut any = false;
        for lane in lanes(&summary) {
            for (what, histogram) in [("release_late", &lane.late), ("exec", &lane.execution)] {
                for (edge, count) in &histogram.bins {
                    out.push_str(&format!("{},{what},{edge},{count}\n", lane.name));
                    any = true;
                }
            }
        }
        return Ok(any.then_some(out));
    }
    let all = figures(&summary);
    if all.is_empty() {
        return Ok(None);
    }
    let rows = all.len().div_ceil(2);
    let mut sheet = Figure::new(2.0 * WIDTH, rows as f64 * HEIGHT, "timing of the lanes");
    for (index, figure) in all.iter().enumerate() {
        let (row, column) = (index / 2, index % 2);
        sheet.place(column as f64 * WIDTH, row as f64 * HEIGHT, figure);
    }
    Ok(Some(sheet.file()))
}
