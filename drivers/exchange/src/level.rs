//! The level of errors of an exchange: when so many answers are missing that what comes is not
//! trusted, and how long nothing has come.

use taktil_hal::Nanos;

/// By how much an exchange that failed raises the level.
const LEVEL_RISE: u32 = 2;
/// By how much a good one lowers it.
const LEVEL_FALL: u32 = 1;
/// The level at which the exchange counts as failed, until the level is 0 again.
pub const LEVEL_LIMIT: u32 = 10;

/// The level, with the newest sign of life.
#[derive(Clone, Copy, Debug, Default)]
pub struct ErrorLevel {
    level: u32,
    is_failed: bool,
    failures: u64,
    /// The release of the newest good exchange.
    heard: Option<Nanos>,
}

impl ErrorLevel {
    /// A good exchange for the job released at `release`.
    pub fn hit(&mut self, release: Nanos) {
        self.level = self.level.saturating_sub(LEVEL_FALL);
        self.is_failed &= self.level > 0;
        self.heard = Some(release);
    }

    /// One that failed; gives the time since the newest good one.
    pub fn miss(&mut self, release: Nanos) -> Nanos {
        self.level = (self.level + LEVEL_RISE).min(LEVEL_LIMIT);
        if self.level == LEVEL_LIMIT && !self.is_failed {
            self.is_failed = true;
            self.failures += 1;
        }
        release - *self.heard.get_or_insert(release)
    }

    /// Whether so many exchanges failed that readings must not be trusted to it.
    #[must_use]
    pub const fn is_failed(&self) -> bool {
        self.is_failed
    }

    /// The level: 2 more for each exchange that failed, 1 less for each good one.
    #[must_use]
    pub const fn level(&self) -> u32 {
        self.level
    }

    /// How often the level has reached its limit.
    #[must_use]
    pub const fn failures(&self) -> u64 {
        self.failures
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_level_rises_by_two_falls_by_one_and_fails_at_ten() {
        let mut level = ErrorLevel::default();
        for missing in 1..=4 {
            assert_eq!(level.miss(Nanos(missing)), Nanos(missing - 1));
            assert!(!level.is_failed());
        }
        level.miss(Nanos(5));
        assert!(level.is_failed());
        for answer in 0..9 {
            level.hit(Nanos(6 + answer));
            assert!(level.is_failed());
        }
        level.hit(Nanos(20));
        assert!(!level.is_failed());
        assert_eq!((level.failures(), level.level()), (1, 0));
    }
}
