//! The book-keeping of a segment: the level of errors, and everything that is counted.

use core::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use taktil_drivers_exchange::ErrorLevel;

/// What has happened on the segment since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Diagnostics {
    /// Exchanges of process data that were begun.
    pub exchanges: u64,
    /// Exchanges that every device served.
    pub answers: u64,
    /// Waits that ended without a frame: it is lost or late.
    pub timeouts: u64,
    /// Frames that came after the wait for them had ended, or that cannot be read.
    pub stray_frames: u64,
    /// Exchanges whose working counter was not that of all devices.
    pub wrong_counters: u64,
    /// Frames that the system did not take.
    pub send_failures: u64,
    /// Exchanges that failed in another way.
    pub broken_exchanges: u64,
    /// Times that the level of errors reached its limit.
    pub link_failures: u64,
    /// Times that a device left operation by itself.
    pub state_drops: u64,
    /// Requests that led a device back to operation.
    pub recoveries: u64,
    /// Faults of drives.
    pub drive_faults: u64,
    /// The code (object 603F) of the newest one.
    pub newest_fault_code: u64,
    /// The position of its drive among the devices, counted from 1.
    pub newest_fault_device: u64,
    /// Outputs that were put at their safe values because their half did not commit in time.
    pub silences: u64,
    /// Emergency messages that came while the segment was opened.
    pub emergencies: u64,
    /// Calls of a half while another thread was on the segment.
    pub collisions: u64,
    /// The level of errors: 2 more for each exchange that failed, 1 less for each good one.
    pub error_level: u64,
}

impl Diagnostics {
    /// How many numbers these are.
    pub(crate) const WORDS_COUNT: usize = 17;

    /// All numbers but the level of errors, each with its name for people.
    #[must_use]
    pub fn named(&self) -> [(&'static str, u64); 16] {
        [
            ("exchanges", self.exchanges),
            ("answers", self.answers),
            ("timeouts", self.timeouts),
            ("stray frames", self.stray_frames),
            ("wrong working counters", self.wrong_counters),
            ("send failures", self.send_failures),
            ("broken exchanges", self.broken_exchanges),
            ("link failures", self.link_failures),
            ("devices that left operation", self.state_drops),
            ("requests of operation", self.recoveries),
            ("drive faults", self.drive_faults),
            ("as code of the newest drive fault", self.newest_fault_code),
            ("as device of the newest drive fault", self.newest_fault_device),
            ("silent halves made safe", self.silences),
            ("emergency messages", self.emergencies),
            ("collisions", self.collisions),
        ]
    }

    /// All numbers, in the order of [`Diagnostics::named`], and the level of errors.
    pub(crate) fn words(&self) -> [u64; Diagnostics::WORDS_COUNT] {
        let mut words = [self.error_level; Diagnostics::WORDS_COUNT];
        for (word, (_, count)) in words.iter_mut().zip(self.named()) {
            *word = count;
        }
        words
    }

    /// The numbers of [`Diagnostics::words`].
    pub(crate) fn from_words(words: [u64; Diagnostics::WORDS_COUNT]) -> Diagnostics {
        let [exchanges, answers, timeouts, stray_frames, wrong_counters, send_failures, ..] = words;
        let [.., silences, emergencies, collisions, error_level] = words;
        Diagnostics {
            exchanges,
            answers,
            timeouts,
            stray_frames,
            wrong_counters,
            send_failures,
            broken_exchanges: words[6],
            link_failures: words[7],
            state_drops: words[8],
            recoveries: words[9],
            drive_faults: words[10],
            newest_fault_code: words[11],
            newest_fault_device: words[12],
            silences,
            emergencies,
            collisions,
            error_level,
        }
    }
}

/// How the segment has served its exchanges.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Health {
    pub(crate) level: ErrorLevel,
    pub(crate) seen: Diagnostics,
    /// The half of the lines is there.
    pub(crate) has_lines: bool,
}

/// The same for whoever looks from outside.
#[derive(Debug, Default)]
pub(crate) struct Counts {
    words: [AtomicU64; Diagnostics::WORDS_COUNT],
    has_lines: AtomicBool,
}

impl Counts {
    pub(crate) fn store(&self, seen: Diagnostics, has_lines: bool) {
        // Relaxed: the numbers order nothing, and halves come and go beside the lane.
        for (shown, word) in self.words.iter().zip(seen.words()) {
            shown.store(word, Ordering::Relaxed);
        }
        self.has_lines.store(has_lines, Ordering::Relaxed);
    }

    /// What had been counted when the segment was left last.
    pub(crate) fn load(&self) -> Diagnostics {
        // Relaxed: each number is whole and only grows; two of them may be of different cycles.
        Diagnostics::from_words(self.words.each_ref().map(|word| word.load(Ordering::Relaxed)))
    }

    /// Whether the half of the lines is there.
    pub(crate) fn has_lines(&self) -> bool {
        // Relaxed: halves are made and dropped before the lane begins, or as it ends.
        self.has_lines.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_survive_the_way_through_words() {
        let words = core::array::from_fn(|word| 100 + word as u64);
        assert_eq!(Diagnostics::from_words(words).words(), words);
    }
}
