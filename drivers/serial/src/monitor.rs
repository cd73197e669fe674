//! Shows the counters of a line to any thread, beside the lane that reads it and the thread that
//! owns its port.

use core::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;

use crate::health::Health;

/// How many numbers are shown.
const NUMBERS_COUNT: usize = 8;

/// The counters of a line as its thread published them last.
#[derive(Clone, Debug, Default)]
pub struct LineMonitor {
    words: Arc<[AtomicU64; NUMBERS_COUNT]>,
}

impl LineMonitor {
    pub(crate) fn publish(&self, health: &Health) {
        let words = [
            health.scans,
            health.missing,
            health.garbled,
            health.skipped_bytes,
            health.overruns,
            health.losses,
            health.reopened,
            health.restarts,
        ];
        for (shown, word) in self.words.iter().zip(words) {
            // Relaxed: the numbers order nothing.
            shown.store(word, Ordering::Relaxed);
        }
    }

    /// What was counted since the line was opened, each number with its name: see [`Health`]. Each
    /// is whole; two of them may be a cycle apart.
    #[must_use]
    pub fn counts(&self) -> [(&'static str, u64); NUMBERS_COUNT] {
        let names = [
            "scans",
            "missing scans",
            "times out of step",
            "bytes of no message",
            "scans left out",
            "times lost",
            "times reopened",
            "times started",
        ];
        let mut named = names.map(|name| (name, 0));
        for ((_, count), word) in named.iter_mut().zip(self.words.iter()) {
            // Relaxed: the numbers order nothing.
            *count = word.load(Ordering::Relaxed);
        }
        named
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_is_shown_under_its_name() {
        let monitor = LineMonitor::default();
        let health = Health {
            scans: 1,
            missing: 2,
            garbled: 3,
            skipped_bytes: 4,
            overruns: 5,
            losses: 6,
            reopened: 7,
            restarts: 8,
            ..Health::default()
        };
        monitor.clone().publish(&health);
        let shown = monitor.counts();
        assert_eq!(shown.map(|(_, count)| count), [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!((shown[1].0, shown[6].0), ("missing scans", "times reopened"));
    }
}
