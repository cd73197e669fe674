//! A stretch of a recording in which records are missing, as it stands in the log.

use std::collections::BTreeMap;

use taktil_rtcore::Nanos;

/// Records that were not written, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gap {
    /// Release of the first one that is missing.
    pub from: Nanos,
    /// Release of the last one.
    pub to: Nanos,
    /// How many are missing.
    pub records: u64,
    /// The cause in words, such as `the disk is slow`.
    pub cause: String,
}

impl Gap {
    /// The gap of one record.
    #[must_use]
    pub fn new(release: Nanos, cause: &str) -> Gap {
        Gap { from: release, to: release, records: 1, cause: cause.to_owned() }
    }

    /// One more record is missing.
    pub fn extend(&mut self, release: Nanos) {
        (self.from, self.to) = (self.from.min(release), self.to.max(release));
        self.records += 1;
    }

    /// The words of the log's metadata record.
    pub(crate) fn table(&self) -> BTreeMap<String, String> {
        let row = |name: &str, value: String| (name.to_owned(), value);
        BTreeMap::from([
            row("from_ns", self.from.0.to_string()),
            row("to_ns", self.to.0.to_string()),
            row("records", self.records.to_string()),
            row("cause", self.cause.clone()),
        ])
    }

    /// Reads the words back; `None` when one is missing or is no number.
    pub(crate) fn from_table(table: &BTreeMap<String, String>) -> Option<Gap> {
        let nanos = |key: &str| Some(Nanos(table.get(key)?.parse().ok()?));
        Some(Gap {
            from: nanos("from_ns")?,
            to: nanos("to_ns")?,
            records: table.get("records")?.parse().ok()?,
            cause: table.get("cause")?.clone(),
        })
    }
}
