//! `taktil log info`: what is in a log.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;

use serde::Serialize;
use taktil_machine_console::out;
use taktil_record::{Log, METADATA_END, METADATA_RECOVERED, METADATA_RESULT, METADATA_RUN};

/// Words of the run's metadata that are short enough for people.
const SHORT_WORDS: [&str; 8] =
    ["mode", "scene", "seed", "service", "taktil", "recording", "segment", "replay_of"];

/// What is in a log.
#[derive(Clone, Debug, Serialize)]
struct LogInfo {
    file: String,
    bytes: usize,
    chunks: usize,
    messages: u64,
    foreign_messages: u64,
    /// Release of the first message and of the last one (s).
    first_s: Option<f64>,
    last_s: Option<f64>,
    duration_s: f64,
    /// Whether the run wrote its closing metadata.
    closed_by_run: bool,
    run: BTreeMap<String, String>,
    /// Why a recorder ended the file before the run ended, as JSON.
    end: Option<String>,
    /// What was lost when the file was made of a damaged one.
    recovered: Option<BTreeMap<String, String>>,
    gaps: Vec<GapInfo>,
    damage: Option<DamageInfo>,
    signals: Vec<SignalInfo>,
}

#[derive(Clone, Debug, Serialize)]
struct GapInfo {
    from_s: f64,
    to_s: f64,
    records: u64,
    cause: String,
}

#[derive(Clone, Debug, Serialize)]
struct DamageInfo {
    offset: usize,
    what: String,
    messages_complete: bool,
}

#[derive(Clone, Debug, Serialize)]
struct SignalInfo {
    signal: String,
    #[serde(rename = "type")]
    type_name: String,
    lane: String,
    messages: u64,
    /// Messages a second between the first and the last one (Hz); none for fewer than two.
    rate_hz: Option<f64>,
    /// Messages whose tick does not follow that of the one before: the number of ticks between.
    missing_ticks: u64,
}

/// What one channel showed so far.
#[derive(Clone, Copy, Default)]
struct Tally {
    messages: u64,
    first_ns: i64,
    last_ns: i64,
    last_tick: u64,
    missing_ticks: u64,
}

impl LogInfo {
    fn new(path: &Path, log: &Log) -> LogInfo {
        let mut tallies = vec![Tally::default(); log.channels().len()];
        for message in log.messages() {
            let tally = &mut tallies[message.channel];
            if tally.messages == 0 {
                tally.first_ns = message.release_ns;
            } else {
                let missing = message.tick.saturating_sub(tally.last_tick).saturating_sub(1);
                tally.missing_ticks = tally.missing_ticks.saturating_add(missing);
            }
            tally.messages += 1;
            (tally.last_ns, tally.last_tick) = (message.release_ns, message.tick);
        }
        let seconds = |nanos: i64| nanos as f64 / 1e9;
        let used = || tallies.iter().filter(|tally| tally.messages > 0);
        let first = used().map(|tally| tally.first_ns).min().map(seconds);
        let last = used().map(|tally| tally.last_ns).max().map(seconds);
        let signals = log.channels().iter().zip(&tallies).map(|(channel, tally)| {
            let span_s = seconds(tally.last_ns - tally.first_ns);
            SignalInfo {
                signal: channel.signal.clone(),
                type_name: channel.type_name.clone(),
                lane: channel.lane.clone(),
                messages: tally.messages,
                rate_hz: (span_s > 0.0).then(|| (tally.messages - 1) as f64 / span_s),
                missing_ticks: tally.missing_ticks,
            }
        });
        let run = log.metadata().get(METADATA_RUN).cloned().unwrap_or_default();
        let gaps = log.gaps().iter().map(|gap| GapInfo {
            from_s: gap.from.as_secs_f64(),
            to_s: gap.to.as_secs_f64(),
            records: gap.records,
            cause: gap.cause.clone(),
        });
        LogInfo {
            file: path.display().to_string(),
            bytes: log.file_bytes(),
            chunks: log.chunks(),
            messages: tallies.iter().map(|tally| tally.messages).sum(),
            foreign_messages: log.foreign_messages(),
            first_s: first,
            last_s: last,
            duration_s: last.unwrap_or(0.0) - first.unwrap_or(0.0),
            closed_by_run: log.metadata().contains_key(METADATA_RESULT),
            run: run.into_iter().filter(|(key, _)| SHORT_WORDS.contains(&&**key)).collect(),
            end: log.metadata().get(METADATA_END).and_then(|end| end.get("json")).cloned(),
            recovered: log.metadata().get(METADATA_RECOVERED).cloned(),
            gaps: gaps.collect(),
            damage: log.damage().map(|damage| DamageInfo {
                offset: damage.offset,
                what: damage.what.clone(),
                messages_complete: damage.messages_complete,
            }),
            signals: signals.collect(),
        }
    }

    fn text(&self) -> String {
        let mut out = String::new();
        let _ = writeln!(out, "{}: {} bytes, {} chunks", self.file, self.bytes, self.chunks);
        let time = |time: Option<f64>| time.map_or("-".to_owned(), |time| format!("{time:.4} s"));
        let _ = writeln!(
            out,
            "time                       {} to {}, {} messages",
            time(self.first_s),
            time(self.last_s),
            self.messages
        );
        for (key, value) in &self.run {
            let _ = writeln!(out, "{key:<26} {value}");
        }
        if let Some(end) = &self.end {
            let _ = writeln!(out, "ended early                {end}");
        }
        if let Some(recovered) = &self.recovered {
            let words: Vec<String> =
                recovered.iter().map(|(key, value)| format!("{key} {value}")).collect();
            let _ = writeln!(out, "recovered                  {}", words.join(", "));
        }
        match &self.damage {
            None => {
                let _ = writeln!(out, "damage                     none");
            }
            Some(damage) => {
                let _ = writeln!(
                    out,
                    "DAMAGE                     readable up to byte {}: {}",
                    damage.offset, damage.what
                );
            }
        }
        for gap in &self.gaps {
            let _ = writeln!(
                out,
                "GAP                        {} records from {:.4} to {:.4} s: {}",
                gap.records, gap.from_s, gap.to_s, gap.cause
            );
        }
        if self.foreign_messages > 0 {
            let _ = writeln!(out, "of other programs          {}", self.foreign_messages);
        }
        for signal in &self.signals {
            let rate = signal.rate_hz.map_or("-".to_owned(), |rate| format!("{rate:.1} Hz"));
            let _ = writeln!(
                out,
                "  {:<28} {:>8} x {:<20} {rate}",
                signal.signal, signal.messages, signal.type_name
            );
        }
        out
    }
}

/// Prints what is in a log.
///
/// # Errors
/// Not a log.
pub(super) fn run(path: &Path, json: bool) -> anyhow::Result<ExitCode> {
    let log = super::open(path)?;
    let info = LogInfo::new(path, &log);
    if json {
        out::line(serde_json::to_value(&info)?)?;
    } else {
        out::text(info.text())?;
    }
    let whole = info.damage.is_none() && info.gaps.is_empty();
    Ok(if whole { ExitCode::SUCCESS } else { ExitCode::from(1) })
}
