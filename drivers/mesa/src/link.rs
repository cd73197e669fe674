//! The book-keeping of the link: numbers of requests, the level of errors, and everything that is
//! counted.

use taktil_hal::Nanos;

/// By how much a missing answer raises the level of errors.
const LEVEL_RISE: u32 = 2;
/// By how much an answer lowers it.
const LEVEL_FALL: u32 = 1;
/// The level at which the link counts as failed, until the level is 0 again.
pub const LEVEL_LIMIT: u32 = 10;

/// What has happened on the link and on the card since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Diagnostics {
    /// Requests sent.
    pub requests: u64,
    /// Answers to the request that was waited for.
    pub answers: u64,
    /// Waits that ended without one.
    pub timeouts: u64,
    /// Answers to an older request, discarded.
    pub stale_answers: u64,
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
}

/// What an arriving datagram is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Fresh,
    Stale,
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
    is_failed: bool,
    /// The release of the newest answer.
    heard: Option<Nanos>,
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
            is_failed: false,
            heard: None,
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
            Some(behind) if behind < self.sent => Kind::Stale,
            _ => Kind::Malformed,
        };
        match kind {
            Kind::Fresh => (self.answered, self.newest_answered) = (true, number),
            Kind::Stale => self.seen.stale_answers += 1,
            Kind::Duplicate => self.seen.duplicate_answers += 1,
            Kind::Malformed => self.seen.malformed_answers += 1,
        }
        kind
    }

    /// An answer came for the job released at `release`.
    pub(crate) fn hit(&mut self, release: Nanos) {
        self.seen.answers += 1;
        self.seen.error_level = self.seen.error_level.saturating_sub(LEVEL_FALL);
        self.is_failed &= self.seen.error_level > 0;
        self.heard = Some(release);
    }

    /// None came; gives the silence so far.
    pub(crate) fn miss(&mut self, release: Nanos) -> Nanos {
        self.seen.timeouts += 1;
        self.seen.error_level = (self.seen.error_level + LEVEL_RISE).min(LEVEL_LIMIT);
        if self.seen.error_level == LEVEL_LIMIT && !self.is_failed {
            self.is_failed = true;
            self.seen.link_failures += 1;
        }
        release - *self.heard.get_or_insert(release)
    }

    /// Whether so many answers were missing that outputs must not be trusted to it.
    pub(crate) fn is_failed(&self) -> bool {
        self.is_failed
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
        assert_eq!(link.judge(Some(u32::MAX)), Kind::Stale);
        assert_eq!(link.judge(Some(7)), Kind::Malformed);
        assert_eq!(link.judge(Some(u32::MAX - 1)), Kind::Malformed, "from before the opening");
        assert_eq!(link.judge(None), Kind::Malformed);
        assert_eq!(link.judge(Some(0)), Kind::Fresh);
        assert_eq!(link.judge(Some(0)), Kind::Duplicate);
    }

    #[test]
    fn the_level_rises_by_two_falls_by_one_and_fails_at_ten() {
        let mut link = Link::new(0);
        for missing in 1..=4 {
            assert_eq!(link.miss(Nanos(missing)), Nanos(missing - 1));
            assert!(!link.is_failed());
        }
        link.miss(Nanos(5));
        assert!(link.is_failed());
        for answer in 0..9 {
            link.hit(Nanos(6 + answer));
            assert!(link.is_failed());
        }
        link.hit(Nanos(20));
        assert!(!link.is_failed());
        assert_eq!(link.seen.link_failures, 1);
    }
}
