//! The book-keeping of a segment: the level of errors, and everything that is counted.

use taktil_hal::Nanos;

/// By how much an exchange that failed raises the level of errors.
const LEVEL_RISE: u64 = 2;
/// By how much a good one lowers it.
const LEVEL_FALL: u64 = 1;
/// The level at which the segment counts as failed, until the level is 0 again.
pub const LEVEL_LIMIT: u64 = 10;

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
    is_failed: bool,
    /// The release of the newest good exchange.
    heard: Option<Nanos>,
    pub(crate) seen: Diagnostics,
}

impl Health {
    /// A good exchange for the job released at `release`.
    pub(crate) fn hit(&mut self, release: Nanos) {
        self.seen.answers += 1;
        self.seen.error_level = self.seen.error_level.saturating_sub(LEVEL_FALL);
        self.is_failed &= self.seen.error_level > 0;
        self.heard = Some(release);
    }

    /// One that failed; gives the time since the newest good one.
    pub(crate) fn miss(&mut self, release: Nanos) -> Nanos {
        self.seen.error_level = (self.seen.error_level + LEVEL_RISE).min(LEVEL_LIMIT);
        if self.seen.error_level == LEVEL_LIMIT && !self.is_failed {
            self.is_failed = true;
            self.seen.link_failures += 1;
        }
        release - *self.heard.get_or_insert(release)
    }

    /// Whether so many exchanges failed that readings must not be trusted to it.
    pub(crate) fn is_failed(&self) -> bool {
        self.is_failed
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

    #[test]
    fn the_level_rises_by_two_falls_by_one_and_fails_at_ten() {
        let mut health = Health::default();
        for missing in 1..=4 {
            assert_eq!(health.miss(Nanos(missing)), Nanos(missing - 1));
            assert!(!health.is_failed());
        }
        health.miss(Nanos(5));
        assert!(health.is_failed());
        for answer in 0..9 {
            health.hit(Nanos(6 + answer));
            assert!(health.is_failed());
        }
        health.hit(Nanos(20));
        assert!(!health.is_failed());
        assert_eq!(health.seen.link_failures, 1);
    }
}
