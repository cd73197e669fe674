//! The book-keeping of the link: numbers of requests, the level of errors, and everything that is
//! counted.

use core::sync::atomic::{AtomicU64, Ordering};

use taktil_drivers_exchange::ErrorLevel;
use taktil_hal::CHANNELS;

/// What has happened on the link and on the card since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Diagnostics {
    /// Requests sent.
    pub requests: u64,
    /// Answers to the request that was waited for.
    pub answers: u64,
    /// Waits that ended without one.
    pub timeouts: u64,
    /// Answers that came after the wait for them had ended, discarded.
    pub late_answers: u64,
    /// Answers that a newer one has overtaken, discarded.
    pub reordered_answers: u64,
    /// Second answers to a request that was answered, discarded.
    pub duplicate_answers: u64,
    /// Datagrams that are no answer: wrong length or a number that was never given; discarded.
    pub malformed_answers: u64,
    /// Answers that told that the newest write packet had not arrived.
    pub lost_writes: u64,
    /// Packets that the system did not take.
    pub send_failures: u64,
    /// The level of errors: 2 more for each missing answer, 1 less for each that came; at 10 the
    /// link counts as failed until it is 0 again.
    pub error_level: u32,
    /// Times that the link counted as failed.
    pub link_failures: u64,
    /// Bites of the FPGA's watchdog.
    pub bites: u64,
    /// Faults of a remote, such as the bite of its own watchdog.
    pub remote_faults: u64,
    /// Exchanges of smart serial that failed.
    pub failed_exchanges: u64,
    /// Cycles in which smart serial had not finished the exchange before.
    pub slow_exchanges: u64,
    /// Readings of encoders that were not believed.
    pub bad_readings: u64,
    /// Calls of a half while another thread was in the card.
    pub collisions: u64,
    /// The card restarted and has forgotten its settings and counts.
    pub restarts: u64,
    /// Another program opened the card: since then nothing is written to it.
    pub takeovers: u64,
    /// Waits in which the address told that nobody listens there.
    pub refusals: u64,
}

impl Diagnostics {
    /// How many numbers these are.
    pub(crate) const WORDS_COUNT: usize = 20;

    /// All numbers but the level of errors, each with its name for people.
    #[must_use]
    pub fn named(&self) -> [(&'static str, u64); 19] {
        [
            ("requests", self.requests),
            ("answers", self.answers),
            ("timeouts", self.timeouts),
            ("late answers", self.late_answers),
            ("overtaken answers", self.reordered_answers),
            ("doubled answers", self.duplicate_answers),
            ("malformed answers", self.malformed_answers),
            ("lost writes", self.lost_writes),
            ("send failures", self.send_failures),
            ("link failures", self.link_failures),
            ("watchdog bites", self.bites),
            ("remote faults", self.remote_faults),
            ("failed exchanges", self.failed_exchanges),
            ("slow exchanges", self.slow_exchanges),
            ("readings not believed", self.bad_readings),
            ("collisions", self.collisions),
            ("restarts", self.restarts),
            ("takeovers", self.takeovers),
            ("refusals", self.refusals),
        ]
    }

    /// All numbers, in the order of their declaration.
    pub(crate) fn words(&self) -> [u64; Diagnostics::WORDS_COUNT] {
        [
            self.requests,
            self.answers,
            self.timeouts,
            self.late_answers,
            self.reordered_answers,
            self.duplicate_answers,
            self.malformed_answers,
            self.lost_writes,
            self.send_failures,
            u64::from(self.error_level),
            self.link_failures,
            self.bites,
            self.remote_faults,
            self.failed_exchanges,
            self.slow_exchanges,
            self.bad_readings,
            self.collisions,
            self.restarts,
            self.takeovers,
            self.refusals,
        ]
    }

    /// The numbers of [`Diagnostics::words`].
    pub(crate) fn from_words(words: [u64; Diagnostics::WORDS_COUNT]) -> Diagnostics {
        let [requests, answers, timeouts, late, reordered, duplicate, malformed, ..] = words;
        let [.., collisions, restarts, takeovers, refusals] = words;
        Diagnostics {
            requests,
            answers,
            timeouts,
            late_answers: late,
            reordered_answers: reordered,
            duplicate_answers: duplicate,
            malformed_answers: malformed,
            lost_writes: words[7],
            send_failures: words[8],
            error_level: words[9] as u32,
            link_failures: words[10],
            bites: words[11],
            remote_faults: words[12],
            failed_exchanges: words[13],
            slow_exchanges: words[14],
            bad_readings: words[15],
            collisions,
            restarts,
            takeovers,
            refusals,
        }
    }
}

/// What was counted and the speeds, for whoever looks from outside.
#[derive(Debug, Default)]
pub(crate) struct CardNumbers {
    counts: [AtomicU64; Diagnostics::WORDS_COUNT],
    /// The bits of the speeds.
    speeds: [AtomicU64; CHANNELS],
}

impl CardNumbers {
    pub(crate) fn store(&self, seen: Diagnostics, speeds: [f64; CHANNELS]) {
        // Relaxed: the numbers order nothing.
        for (shown, word) in self.counts.iter().zip(seen.words()) {
            shown.store(word, Ordering::Relaxed);
        }
        for (shown, speed) in self.speeds.iter().zip(speeds) {
            shown.store(speed.to_bits(), Ordering::Relaxed);
        }
    }

    /// What had been counted when the card was left last.
    pub(crate) fn diagnostics(&self) -> Diagnostics {
        // Relaxed: each number is whole and only grows; two of them may be of different cycles.
        Diagnostics::from_words(self.counts.each_ref().map(|word| word.load(Ordering::Relaxed)))
    }

    /// Speeds when the card was left last (counts a second).
    pub(crate) fn speeds(&self) -> [f64; CHANNELS] {
        self.speeds.each_ref().map(|bits| f64::from_bits(bits.load(Ordering::Relaxed)))
    }
}

/// What an arriving datagram is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Fresh,
    Late,
    Reordered,
    Duplicate,
    Malformed,
}

/// The state of the link.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Link {
    /// The number of the newest request.
    number: u32,
    answered: bool,
    /// The number that was answered last.
    newest_answered: Option<u32>,
    /// How many requests there were, as far as a number can be told to be one of them.
    sent: u32,
    pub(crate) level: ErrorLevel,
    pub(crate) seen: Diagnostics,
}

impl Link {
    /// Numbers begin behind `first`.
    pub(crate) fn new(first: u32) -> Link {
        Link {
            number: first,
            answered: true,
            newest_answered: None,
            sent: 0,
            level: ErrorLevel::default(),
            seen: Diagnostics::default(),
        }
    }

    /// The number of a new request.
    pub(crate) fn next_number(&mut self) -> u32 {
        self.number = self.number.wrapping_add(1);
        self.answered = false;
        self.sent = self.sent.saturating_add(1);
        self.seen.requests += 1;
        self.number
    }

    /// Judges a datagram by the number that it carries, `None` for a wrong length, and counts it.
    pub(crate) fn judge(&mut self, number: Option<u32>) -> Kind {
        let behind = number.map(|number| self.number.wrapping_sub(number));
        let kind = match behind {
            Some(0) if self.answered => Kind::Duplicate,
            Some(0) => Kind::Fresh,
            Some(_) if number == self.newest_answered => Kind::Duplicate,
            Some(behind) if behind < self.sent => {
                // An answer to a newer request than this one has come already.
                let newest = self.newest_answered.map(|newest| self.number.wrapping_sub(newest));
                let overtaken = newest.is_some_and(|newest| newest < behind);
                if overtaken { Kind::Reordered } else { Kind::Late }
            }
            _ => Kind::Malformed,
        };
        match kind {
            Kind::Fresh => (self.answered, self.newest_answered) = (true, number),
            Kind::Late => self.seen.late_answers += 1,
            Kind::Reordered => self.seen.reordered_answers += 1,
            Kind::Duplicate => self.seen.duplicate_answers += 1,
            Kind::Malformed => self.seen.malformed_answers += 1,
        }
        kind
    }

    /// What was counted.
    pub(crate) fn seen(&self) -> Diagnostics {
        Diagnostics {
            error_level: self.level.level(),
            link_failures: self.level.failures(),
            ..self.seen
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_tell_fresh_answers_from_others_across_their_wrap() {
        let mut link = Link::new(u32::MAX - 1);
        assert_eq!(link.judge(Some(u32::MAX - 1)), Kind::Duplicate, "never asked, never fresh");
        assert_eq!(link.next_number(), u32::MAX);
        assert_eq!(link.next_number(), 0);
        assert_eq!(link.judge(Some(u32::MAX)), Kind::Late);
        assert_eq!(link.judge(Some(7)), Kind::Malformed);
        assert_eq!(link.judge(Some(u32::MAX - 1)), Kind::Malformed, "from before the opening");
        assert_eq!(link.judge(None), Kind::Malformed);
        assert_eq!(link.judge(Some(0)), Kind::Fresh);
        assert_eq!(link.judge(Some(0)), Kind::Duplicate);
        assert_eq!(link.judge(Some(u32::MAX)), Kind::Reordered);
    }

    #[test]
    fn counts_survive_the_way_through_words() {
        let words = core::array::from_fn(|word| 100 + word as u64);
        assert_eq!(Diagnostics::from_words(words).words(), words);
    }
}
