//! Reports the findings for people and as JSON: table, grade, and the warning about what they do
//! not show.

use std::io::IsTerminal;

use hdrhistogram::Histogram;
use serde_json::{Value, json};
use taktil_rtcore::guard;

use super::Findings;
use super::compare::{QUANTILE_COLUMNS, Ratios, quartiles};
use super::measure::LaneTotals;
use taktil_record::granted::{Grants, misses_by_cause};

/// Grades of a machine by its worst lateness, after the latency test of LinuxCNC.
const LATENESS_GRADES: [(u64, &str); 5] = [
    (20_000, "excellent: fit for fast servo loops and for step pulses made in software"),
    (50_000, "good: fit for servo loops of some kHz"),
    (100_000, "fair: fit for servo loops up to about 1 kHz"),
    (1_000_000, "poor: slow servo loops with care"),
    (u64::MAX, "unfit: a control loop may stand still for more than 1 ms"),
];

/// The grade of a worst lateness in ns.
pub(super) fn grade(worst_ns: u64) -> &'static str {
    LATENESS_GRADES.iter().find(|(most, _)| worst_ns <= *most).map_or("", |(_, report)| *report)
}

/// The reasons why the figures do not represent a robot's computer; empty when they do.
pub(super) fn banner(found: &Findings<'_>) -> Vec<String> {
    let attestation = &found.ours.attestation;
    let mut lines = Vec::new();
    if attestation.virtual_machine {
        lines.push("virtual machine: its host takes the processor when it likes".to_owned());
    }
    if !attestation.preempt_rt {
        lines.push("kernel without PREEMPT_RT".to_owned());
    }
    lines.extend(attestation.missing.iter().map(|line| format!("not granted: {line}")));
    lines
}

/// A description of the measurement in one line.
pub(super) fn headline(found: &Findings<'_>) -> String {
    let arguments = found.arguments;
    let rates: Vec<String> = arguments.rate_hz.iter().map(f64::to_string).collect();
    let cpu = arguments.cpu.map_or("any CPU".to_owned(), |cpu| format!("CPU {cpu}"));
    let guard = arguments.guard.map_or("plain sleep".to_owned(), |share| format!("guard {share}"));
    let load = if arguments.load { "under load" } else { "no load of ours" };
    format!("{} Hz, priority {}, {cpu}, {guard}, {load}", rates.join(" + "), arguments.priority)
}

#[expect(clippy::cast_precision_loss, reason = "nanoseconds for people")]
fn microseconds(ns: u64) -> f64 {
    ns as f64 / 1000.0
}

/// Name and value (us) of each column.
fn columns(histogram: &Histogram<u64>) -> [(&'static str, f64); 8] {
    let at = |quantile| microseconds(histogram.value_at_quantile(quantile));
    [
        ("min", microseconds(histogram.min())),
        ("avg", histogram.mean() / 1000.0),
        ("p50", at(0.5)),
        ("p90", at(0.9)),
        ("p99", at(0.99)),
        ("p99.9", at(0.999)),
        ("p99.99", at(0.9999)),
        ("max", microseconds(histogram.max())),
    ]
}

fn row(out: &mut String, name: &str, histogram: &Histogram<u64>) {
    if histogram.is_empty() {
        return;
    }
    *out += &format!("  {name:<22} {:>8}", histogram.len());
    for (_, us) in columns(histogram) {
        *out += &format!(" {us:>9.2}");
    }
    *out += "\n";
}

/// The table for people.
pub(super) fn table(found: &Findings<'_>) -> String {
    let mut out = format!("taktil jitter: {}\n", headline(found));
    let (red, plain) =
        if std::io::stdout().is_terminal() { ("\x1b[41;97m", "\x1b[0m") } else { ("", "") };
    for line in banner(found) {
        out += &format!("{red} NOT A ROBOT'S FIGURES {plain} {line}\n");
    }
    for note in &found.ours.attestation.notes {
        out += &format!("  note: {note}\n");
    }
    out += &format!("\n  {:<22} {:>8}", "us", "count");
    for (name, _) in columns(&Histogram::new(1).expect("one digit is valid")) {
        out += &format!(" {name:>9}");
    }
    out += "\n";
    for (lane, hz) in found.ours.lanes.iter().zip(&found.arguments.rate_hz) {
        row(&mut out, &format!("{hz} Hz: release late"), &lane.late);
        if lane.guard.is_some() {
            row(&mut out, "  wake late", &lane.wake);
        }
        row(&mut out, "  executor, a cycle", &lane.awake);
        row(&mut out, "  with evidence read", &lane.evidence);
    }
    if let Some(comparison) = &found.comparison {
        row(&mut out, "cyclictest", &comparison.theirs);
    }
    out += "\n";
    for (lane, hz) in found.ours.lanes.iter().zip(&found.arguments.rate_hz) {
        out += &counts(lane, *hz);
    }
    if let Some(comparison) = &found.comparison {
        let pairs = comparison.ratios.len();
        out += &format!("\n  ratios of {pairs} adjacent pairs: median (quartiles)\n");
        out += &ratios("ours / cyclictest", &comparison.ratios);
        out += &ratios("cyclictest / itself", &comparison.control);
    }
    let worst = found.ours.lanes.iter().map(|lane| lane.late.max()).max().unwrap_or(0);
    out += &format!("\n  grade: {}\n", grade(worst));
    if found.interrupted {
        out += "  interrupted\n";
    }
    out
}

fn counts(lane: &LaneTotals, hz: f64) -> String {
    let mut out = format!(
        "  {hz} Hz: {} jobs, {} missed, {} left out, {} page faults",
        lane.jobs,
        lane.misses.total(),
        lane.skipped,
        lane.page_faults
    );
    if guard::installed() {
        out += &format!(", {} heap calls in jobs", lane.allocations);
    }
    if let Some(figures) = lane.guard {
        let (share, margin) = (100.0 * figures.share(), figures.margin);
        out += &format!("; guard: margin {margin}, {share:.1} % of one CPU spun");
    }
    out + "\n"
}

fn ratios(name: &str, rows: &[Ratios]) -> String {
    let mut out = format!("  {name:<22}");
    for (column, (quantile, _)) in QUANTILE_COLUMNS.iter().enumerate() {
        out += &match quartiles(rows, column) {
            None => format!("  {quantile} -"),
            Some(m) => format!("  {quantile} {:.3} ({:.3}..{:.3})", m.median, m.low, m.high),
        };
    }
    out + "\n"
}

fn object(histogram: &Histogram<u64>) -> Value {
    if histogram.is_empty() {
        return Value::Null;
    }
    let mut out = serde_json::Map::new();
    out.insert("count".into(), histogram.len().into());
    for (name, us) in columns(histogram) {
        out.insert(name.replace('.', "_"), us.into());
    }
    Value::Object(out)
}

fn ratios_json(rows: &[Ratios]) -> Value {
    let mut out = serde_json::Map::new();
    for (column, (name, _)) in QUANTILE_COLUMNS.iter().enumerate() {
        let value = quartiles(rows, column)
            .map_or(Value::Null, |m| json!({ "median": m.median, "q1": m.low, "q3": m.high }));
        out.insert(name.replace('.', "_"), value);
    }
    json!({ "pairs": rows.len(), "of": out })
}

fn lane_json(lane: &LaneTotals, rate_hz: f64) -> Value {
    json!({
        "rate_hz": rate_hz,
        "period_ns": lane.spec.period.0,
        "priority": lane.spec.priority,
        "release_late_us": object(&lane.late),
        "wake_late_us": object(&lane.wake),
        "executor_us": object(&lane.awake),
        "executor_with_evidence_us": object(&lane.evidence),
        "job_us": object(&lane.execution),
        "jobs": lane.jobs,
        "skipped": lane.skipped,
        "misses": misses_by_cause(&lane.misses),
        "page_faults": lane.page_faults,
        "allocations": guard::installed().then_some(lane.allocations),
        "guard": lane.guard.map(|figures| json!({
            "margin_us": figures.margin.0 as f64 / 1000.0,
            "cpu_share": figures.share(),
            "early": figures.early,
        })),
    })
}

/// The result as one JSON object, in the stable format of `taktil jitter --json`.
pub(super) fn json(found: &Findings<'_>) -> Value {
    let attestation = &found.ours.attestation;
    let lanes = found.ours.lanes.iter().zip(&found.arguments.rate_hz);
    let worst = found.ours.lanes.iter().map(|lane| lane.late.max()).max().unwrap_or(0);
    json!({
        "measured": headline(found),
        "representative_timing": attestation.is_representative(),
        "banner": banner(found),
        "attested": Grants::new(Some(attestation)),
        "lanes": lanes.map(|(lane, hz)| lane_json(lane, *hz)).collect::<Vec<_>>(),
        "cyclictest": found.comparison.as_ref().map(|comparison| json!({
            "late_us": object(&comparison.theirs),
            "ours_over_theirs": ratios_json(&comparison.ratios),
            "theirs_over_itself": ratios_json(&comparison.control),
        })),
        "grade": grade(worst),
        "interrupted": found.interrupted,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grades_get_worse_with_the_worst_lateness() {
        assert!(grade(0).starts_with("excellent"));
        assert!(grade(20_000).starts_with("excellent"));
        assert!(grade(20_001).starts_with("good"));
        assert!(grade(99_000).starts_with("fair"));
        assert!(grade(1_000_000).starts_with("poor"));
        assert!(grade(1_000_001).starts_with("unfit"));
        assert!(grade(u64::MAX).starts_with("unfit"));
    }
}
