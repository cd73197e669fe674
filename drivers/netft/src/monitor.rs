//! Shows the counters of a stream to any thread, beside the lane that reads it.

use core::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;

use crate::stream::StreamCounts;

/// How many numbers are shown.
const NUMBERS_COUNT: usize = 10;

/// The counters of a stream as the half published them last.
#[derive(Clone, Debug, Default)]
pub struct StreamMonitor {
    words: Arc<[AtomicU64; NUMBERS_COUNT]>,
}

impl StreamMonitor {
    pub(crate) fn publish(&self, seen: &StreamCounts) {
        let words = [
            seen.records,
            seen.missing,
            seen.old,
            seen.invalid,
            seen.strange,
            seen.streams,
            seen.restarts,
            seen.backlogs,
            seen.requests,
            seen.refusals,
        ];
        for (shown, word) in self.words.iter().zip(words) {
            // Relaxed: the numbers order nothing.
            shown.store(word, Ordering::Relaxed);
        }
    }

    /// What was counted since the box was opened, each number with its name: see [`StreamCounts`].
    /// Each is whole; two of them may be a cycle apart.
    #[must_use]
    pub fn counts(&self) -> [(&'static str, u64); NUMBERS_COUNT] {
        let names = [
            "records",
            "missing records",
            "late records",
            "invalid records",
            "strange datagrams",
            "streams begun anew",
            "restarts of the box",
            "backlogs",
            "requests to start again",
            "times nobody listened",
        ];
        let mut named = names.map(|name| (name, 0));
        for ((_, count), word) in named.iter_mut().zip(self.words.iter()) {
            // Relaxed: the numbers order nothing.
            *count = word.load(Ordering::Relaxed);
        }
        named
    }
}
