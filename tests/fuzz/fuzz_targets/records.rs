//! Whatever stands in a log, a flight recording or the schema of a signal: read as far as it goes,
//! or refused in words; never a panic. The first byte says which it is.
#![no_main]

use libfuzzer_sys::fuzz_target;
use taktil_record::joined::{JoinedLog, Repetition};
use taktil_record::schema::parse_schema;
use taktil_record::{Log, METADATA_RUN};
use taktil_rtcore::flight;

/// Bytes of one message of a schema that are still read as columns.
const COLUMN_BYTES_MAX: usize = 1 << 16;

fn log(bytes: &[u8]) {
    let read = match Log::from_bytes(bytes.to_vec()) {
        Ok(read) => read,
        Err(refused) => return assert!(!refused.to_string().is_empty()),
    };
    let _ = read.metadata().get(METADATA_RUN);
    if let Some(damage) = read.damage() {
        assert!(damage.offset <= bytes.len(), "{damage}");
    }
    let mut last = 0;
    for message in read.messages() {
        let fields = read.channels()[message.channel].payload_fields();
        for field in fields.iter().filter(|field| field.count < COLUMN_BYTES_MAX) {
            let _ = field.value(message.data);
        }
        // Differences of any two instants fit their word.
        let release_ns: i64 = message.release_ns;
        assert!(release_ns.checked_sub(last).is_some(), "{release_ns} ns after {last} ns");
        last = release_ns;
    }
    for channel in read.channels() {
        let series = read.series(&channel.signal);
        assert!(series.is_some(), "{}", channel.signal);
    }
}

/// What is recovered of a damaged log is a whole one of the same messages.
fn recovered(bytes: &[u8]) {
    let Ok(read) = Log::from_bytes(bytes.to_vec()) else { return };
    if read.messages().next().is_none() {
        return;
    }
    let path = std::env::temp_dir().join(format!("taktil-fuzz-{}.mcap", std::process::id()));
    let Ok(mut joined) = JoinedLog::create(&path, &read) else { return };
    if joined.append(&read, Repetition::Kept).is_ok() && joined.finish(Some(&read)).is_ok() {
        let again = Log::open(&path).expect("a log that was written");
        assert_eq!(again.damage(), None);
        assert_eq!(again.messages().count(), read.messages().count());
    }
    let _ = std::fs::remove_file(&path);
}

fn flight_recording(bytes: &[u8]) {
    match flight::read(bytes) {
        Ok(found) => {
            for lane in &found.lanes {
                let bodies: usize = lane.records().map(|record| record.body.len()).sum();
                assert!(bodies <= bytes.len());
            }
        }
        Err(refused) => assert!(!refused.is_empty()),
    }
}

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, rest)) = bytes.split_first() else { return };
    match kind % 4 {
        0 => log(rest),
        1 => recovered(rest),
        2 => flight_recording(rest),
        _ => {
            if let Ok(text) = std::str::from_utf8(rest) {
                let _ = parse_schema(text);
            }
        }
    }
});
