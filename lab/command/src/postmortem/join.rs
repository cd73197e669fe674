//! Joins the log of a process that was killed with what its flight recorder kept: the log lacks the
//! last chunk, the recorder goes to the last record. That both are of one run is shown by the
//! messages that stand in both, which must be the same bytes.

use std::collections::BTreeMap;
use std::path::Path;

use taktil_record::joined::{JoinedLog, Repetition};
use taktil_record::{Log, METADATA_RECOVERED};
use taktil_rtcore::flight::FlightRecording;
use taktil_rtcore::record::{Observer, Record};

use super::about::About;
use super::in_order;

/// What a joined log holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct JoinedSize {
    /// Messages in all.
    pub(super) messages: u64,
    /// Those of them that only the flight recorder had.
    pub(super) added: u64,
}

/// Writes to `out` the messages of `log` and, behind them, those that only the flight recorder has.
///
/// # Errors
/// Recordings of two runs, or of which that cannot be shown; a file that cannot be written.
pub(super) fn write(
    out: &Path,
    path: &Path,
    log: &Log,
    found: &FlightRecording,
    about: &About,
) -> anyhow::Result<JoinedSize> {
    let shown = path.display();
    let mut channels = Vec::new();
    for signal in &about.catalog.signals {
        let channel = log.find(&signal.name);
        let size = |channel: usize| log.channels()[channel].payload_fields().len();
        channels.push(channel.filter(|channel| size(*channel) == signal.fields.len()));
    }
    if channels.contains(&None) {
        anyhow::bail!("{shown} is of another machine than the flight recording");
    }
    let records: Vec<Record<'_>> = in_order(found, about)
        .into_iter()
        .filter_map(|record| Some(Record { signal: channels[record.signal]?, ..record }))
        .collect();
    check_overlap(log, &records)
        .map_err(|why| anyhow::anyhow!("{shown} and the flight recording: {why}"))?;
    let mut joined = JoinedLog::create(out, log)?;
    joined.append(log, Repetition::Kept)?;
    // What the log has of a channel ends at one tick; the recorder's records go on from there.
    let new: Vec<&Record<'_>> =
        records.iter().filter(|record| joined.is_new(record.signal, record.tick)).collect();
    let row = |name: &str, value: String| (name.to_owned(), value);
    let table = BTreeMap::from([
        row("from", shown.to_string()),
        row("flight_records", new.len().to_string()),
        row("log", log.damage().map_or("whole".to_owned(), ToString::to_string)),
    ]);
    joined.write_table(METADATA_RECOVERED, table);
    let added = new.len() as u64;
    for record in new {
        joined.record(record);
    }
    Ok(JoinedSize { messages: joined.finish(None)?, added })
}

/// Compares what stands in both.
fn check_overlap(log: &Log, records: &[Record<'_>]) -> Result<(), String> {
    let flown: BTreeMap<(usize, u64), &[u8]> =
        records.iter().map(|record| ((record.signal, record.tick), record.body)).collect();
    let mut both = 0_u64;
    for message in log.messages() {
        let Some(body) = flown.get(&(message.channel, message.tick)) else { continue };
        if message.body.get(..body.len()) != Some(body) {
            let signal = &log.channels()[message.channel].signal;
            let tick = message.tick;
            return Err(format!("`{signal}` differs at tick {tick}: they are of two runs"));
        }
        both += 1;
    }
    match both {
        0 => Err("nothing stands in both, so that they cannot be shown to be of one run".into()),
        _ => Ok(()),
    }
}
