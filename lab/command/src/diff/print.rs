//! Prints a comparison as sentences and as JSON.

use std::fmt::Write as _;

use serde_json::{Value, json};

use super::{Change, Comparison, Divergence, SignalComparison};

/// Largest number of signals that are listed in the text; JSON lists all.
const LISTED_MAX: usize = 20;

/// Seconds with nine decimals, computed with integers.
pub(crate) fn seconds(ns: i64) -> String {
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
        out.push_str(&first_text(first, ["A", "B"]));
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

/// The first difference as lines of text; `names` are the names of the two sides.
pub(crate) fn first_text(first: &Divergence, names: [&str; 2]) -> String {
    let (task, port) = first.task_and_port();
    let width = names.iter().map(|name| name.len()).max().unwrap_or(0).max(5);
    let mut out = String::from("first divergence\n");
    let mut line = |what: &str, value: &str| {
        let _ = writeln!(out, "  {what:width$}  {value}");
    };
    line("tick", &first.tick.to_string());
    line("time", &format!("{} s", seconds(first.release_ns)));
    if !first.lane.is_empty() {
        line("lane", &first.lane);
    }
    line("task", task);
    line("port", port);
    match &first.change {
        Change::Field { field, index, a, b } => {
            let index = index.map_or_else(String::new, |index| format!("[{index}]"));
            let of = first.of.as_ref().map_or_else(String::new, |of| format!(", {of}"));
            line("field", &format!("{field}{index}{of}"));
            line(names[0], a);
            line(names[1], b);
        }
        Change::OnlyInA => line(names[1], "has no message at this tick"),
        Change::OnlyInB => line(names[0], "has no message at this tick"),
    }
    out
}

fn table(found: &Comparison) -> String {
    let differing: Vec<&SignalComparison> =
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
        "lane": divergence.lane,
        "of": divergence.of,
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

/// The comparison as one JSON object.
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
