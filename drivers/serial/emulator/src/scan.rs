//! The clock of a board's scans: a first instant and a period, without drift.

use taktil_hal::Nanos;

/// When the scans of a board are complete.
#[derive(Clone, Debug)]
pub(crate) struct ScanClock {
    period: Nanos,
    next: Nanos,
}

impl ScanClock {
    /// A clock that stands still.
    pub(crate) fn stopped(rate_hz: f64) -> ScanClock {
        ScanClock { period: Nanos((1e9 / rate_hz) as i64), next: Nanos::MAX }
    }

    pub(crate) fn start(&mut self, now: Nanos) {
        self.next = now + self.period;
    }

    pub(crate) fn stop(&mut self) {
        self.next = Nanos::MAX;
    }

    pub(crate) fn set_period(&mut self, period: Nanos) {
        self.period = Nanos(period.0.max(100_000));
    }

    pub(crate) fn period(&self) -> Nanos {
        self.period
    }

    pub(crate) fn due(&self) -> Nanos {
        self.next
    }

    pub(crate) fn advance(&mut self) {
        self.next += self.period;
    }
}
