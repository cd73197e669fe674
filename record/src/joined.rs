//! A log that is made of others: segments of one recording, or a log that was cut and the flight
//! recorder's records of the same run. Messages keep their bytes, and those that stand in both are
//! written once.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::bail;
use taktil_rtcore::Nanos;
use taktil_rtcore::record::{Observer, Record};

use crate::channel::ChannelSource;
use crate::{Log, METADATA_END, METADATA_RESULT, METADATA_RUN, McapLog};

/// What happens to a message whose tick is not beyond that of the newest one on its channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repetition {
    /// It is written.
    Kept,
    /// It is left out: it stands in a log that was appended before.
    LeftOut,
}

/// A log that is being made of others.
pub struct JoinedLog {
    log: McapLog,
    sources: Vec<ChannelSource>,
    /// Tick of the newest message of each channel.
    newest: Vec<Option<u64>>,
}

impl JoinedLog {
    /// Begins a file with the channels and the metadata of `first`, without those that end a log.
    ///
    /// # Errors
    /// As [`McapLog::create`].
    pub fn create(path: &Path, first: &Log) -> anyhow::Result<JoinedLog> {
        let empty = BTreeMap::new();
        let run = first.metadata().get(METADATA_RUN).unwrap_or(&empty);
        let mut log = McapLog::create_like(path, first, run)?;
        let own = [METADATA_RUN, METADATA_RESULT, METADATA_END];
        for (name, table) in first.metadata().iter().filter(|(name, _)| !own.contains(&&***name)) {
            log.write_table(name, table.clone());
        }
        let (sources, newest) = (first.sources().to_vec(), vec![None; first.channels().len()]);
        Ok(JoinedLog { log, sources, newest })
    }

    /// Appends the messages and the gaps of a log.
    ///
    /// # Errors
    /// A log with other channels.
    pub fn append(&mut self, log: &Log, repetition: Repetition) -> anyhow::Result<()> {
        self.append_telling(log, repetition, &mut || ())
    }

    /// The same; `told` is called after each message.
    ///
    /// # Errors
    /// As [`JoinedLog::append`].
    pub fn append_telling(
        &mut self,
        log: &Log,
        repetition: Repetition,
        told: &mut dyn FnMut(),
    ) -> anyhow::Result<()> {
        if log.sources() != self.sources {
            bail!("it has other signals");
        }
        for gap in log.gaps() {
            self.log.write_gap(gap);
        }
        for message in log.messages() {
            let release = Nanos(message.release_ns);
            let (signal, tick, body) = (message.channel, message.tick, message.body);
            told();
            if repetition == Repetition::LeftOut && !self.is_new(signal, tick) {
                continue;
            }
            self.record(&Record { signal, tick, release, body });
        }
        Ok(())
    }

    /// Whether a record is beyond the newest one on its channel.
    #[must_use]
    pub fn is_new(&self, signal: usize, tick: u64) -> bool {
        self.newest.get(signal).copied().flatten().is_none_or(|newest| tick > newest)
    }

    /// Writes a metadata record.
    pub fn write_table(&mut self, name: &str, table: BTreeMap<String, String>) {
        self.log.write_table(name, table);
    }

    /// Writes what ended `last`, if it says so, and closes the file; the number of messages.
    ///
    /// # Errors
    /// As [`McapLog::finish`].
    pub fn finish(mut self, last: Option<&Log>) -> anyhow::Result<u64> {
        let table = |name: &str| last.and_then(|log| log.metadata().get(name)).cloned();
        if let Some(end) = table(METADATA_END) {
            self.log.write_table(METADATA_END, end);
        }
        let messages = self.log.written();
        self.log.finish_with(&table(METADATA_RESULT).unwrap_or_default())?;
        Ok(messages)
    }
}

impl Observer for JoinedLog {
    fn record(&mut self, record: &Record<'_>) {
        if let Some(newest) = self.newest.get_mut(record.signal) {
            *newest = (*newest).max(Some(record.tick));
        }
        self.log.record(record);
    }
}
