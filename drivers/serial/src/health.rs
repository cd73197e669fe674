//! Counts what goes wrong on a line and judges it: healthy, degraded or lost.

use taktil_hal::Nanos;

use crate::config::Config;

/// How good a line is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum LineState {
    /// Scans arrive, few are missing or damaged.
    #[default]
    Healthy,
    /// More scans are missing or damaged than `degraded_share` of the last window.
    Degraded,
    /// No scan for `lost_after_ms`, the port is gone, or more than `lost_share` is missing or
    /// damaged.
    Lost,
}

/// The counters of a line since it was opened, and its state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Health {
    /// The state of now.
    pub state: LineState,
    /// Scans that arrived whole.
    pub scans: u64,
    /// Scans that did not arrive, by the gaps between arrivals.
    pub missing: u64,
    /// Times that the lock on messages was lost to damaged or foreign bytes.
    pub garbled: u64,
    /// Bytes that belonged to no message.
    pub skipped_bytes: u64,
    /// Scans that found the queue to the lane full and were left out.
    pub overruns: u64,
    /// Times that the line went from healthy or degraded to lost.
    pub losses: u64,
    /// Times that the port was opened again.
    pub reopened: u64,
    /// Times that the start-up dialogue was begun again.
    pub restarts: u64,
    /// Largest distance of an arrival from the envelope in the last block of scans.
    pub spread: Nanos,
    /// The period of scans as estimated.
    pub period: Nanos,
}

/// Judges the counters by windows.
#[derive(Clone, Debug)]
pub(crate) struct HealthMonitor {
    pub(crate) health: Health,
    degraded_share: f64,
    lost_share: f64,
    lost_after: Nanos,
    window: Nanos,
    window_end: Nanos,
    /// Scans, and missing or damaged ones, at the begin of the window.
    good_before: u64,
    bad_before: u64,
    last_scan: Nanos,
    /// The verdict of the last whole window.
    verdict: LineState,
}

impl HealthMonitor {
    pub(crate) fn new(config: &Config) -> HealthMonitor {
        let window = Nanos::from_millis(i64::from(config.window_ms));
        HealthMonitor {
            health: Health { state: LineState::Lost, ..Health::default() },
            degraded_share: config.degraded_share,
            lost_share: config.lost_share,
            lost_after: Nanos::from_millis(i64::from(config.lost_after_ms)),
            window,
            window_end: Nanos::ZERO,
            good_before: 0,
            bad_before: 0,
            last_scan: Nanos(i64::MIN / 4),
            verdict: LineState::Healthy,
        }
    }

    pub(crate) fn scan(&mut self, now: Nanos) {
        self.health.scans += 1;
        if self.health.state == LineState::Lost && now - self.last_scan >= self.lost_after {
            // The line has come back: its past is not held against it.
            self.verdict = LineState::Healthy;
            self.begin_window(now);
        }
        self.last_scan = now;
    }

    /// No scan can be expected: the port is gone.
    pub(crate) fn disconnect(&mut self) {
        self.last_scan = Nanos(i64::MIN / 4);
        self.judge(LineState::Lost);
    }

    /// Whether nothing has come for so long that the board may have forgotten its settings.
    pub(crate) fn is_silent(&self, now: Nanos) -> bool {
        now - self.last_scan >= self.lost_after
    }

    pub(crate) fn update(&mut self, now: Nanos) {
        if now >= self.window_end {
            let good = self.health.scans - self.good_before;
            let bad = self.health.missing + self.health.garbled - self.bad_before;
            let share = bad as f64 / (good + bad).max(1) as f64;
            self.verdict = if share > self.lost_share {
                LineState::Lost
            } else if share > self.degraded_share {
                LineState::Degraded
            } else {
                LineState::Healthy
            };
            self.begin_window(now);
        }
        self.judge(if self.is_silent(now) { LineState::Lost } else { self.verdict });
    }

    fn begin_window(&mut self, now: Nanos) {
        self.window_end = now + self.window;
        self.good_before = self.health.scans;
        self.bad_before = self.health.missing + self.health.garbled;
    }

    fn judge(&mut self, state: LineState) {
        if state == LineState::Lost && self.health.state != LineState::Lost {
            self.health.losses += 1;
        }
        self.health.state = state;
    }
}
