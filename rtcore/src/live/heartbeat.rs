//! Heartbeats of threads without which a machine may not go on moving: the thread that carries the
//! records and feeds a watchdog, and others that a process names, such as the one that hears the
//! operator. Each lane looks at them in its jobs; one that stands still is a fault.

use core::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;

use taktil_hal::Nanos;

use super::monitor::ProgressMonitor;

/// A beat that never comes: the thread has ended in good order.
const RETIRED_BEATS: u64 = u64::MAX;

/// The heartbeat of one thread that the lanes watch from its first beat on, until it is dropped.
/// When it is dropped by a panic it stands still, and the lanes find out.
#[derive(Debug)]
pub struct Heartbeat(Arc<AtomicU64>);

impl Heartbeat {
    /// Says that the thread is alive. Never waits.
    pub fn beat(&self) {
        // Relaxed: only the number itself is used, and only this thread changes it.
        let beats = self.0.load(Ordering::Relaxed);
        self.0.store(beats.wrapping_add(1).clamp(1, RETIRED_BEATS - 1), Ordering::Relaxed);
    }
}

impl Drop for Heartbeat {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            self.0.store(RETIRED_BEATS, Ordering::Relaxed);
        }
    }
}

/// The side of a heartbeat that the lanes look at.
#[derive(Clone, Debug)]
pub(crate) struct WatchedHeartbeat {
    beats: Arc<AtomicU64>,
    limit: Nanos,
}

impl WatchedHeartbeat {
    /// A heartbeat that may stand still for `limit`, and its watched side.
    pub(crate) fn new(limit: Nanos) -> (Heartbeat, WatchedHeartbeat) {
        let beats = Arc::new(AtomicU64::new(0));
        (Heartbeat(Arc::clone(&beats)), WatchedHeartbeat { beats, limit })
    }

    /// The number of beats while the thread is to be watched.
    fn progress(&self) -> Option<u64> {
        // Relaxed: only the number itself is used.
        let beats = self.beats.load(Ordering::Relaxed);
        (beats != 0 && beats != RETIRED_BEATS).then_some(beats)
    }
}

/// The heartbeats as one lane sees them.
pub(super) struct HeartbeatMonitor<'a> {
    watched: &'a [WatchedHeartbeat],
    progress: ProgressMonitor,
}

impl<'a> HeartbeatMonitor<'a> {
    /// Watches all of them, once in every job of a lane of this period.
    pub(super) fn new(watched: &'a [WatchedHeartbeat], period: Nanos) -> HeartbeatMonitor<'a> {
        let limits = watched.iter().map(|heartbeat| Some(heartbeat.limit));
        HeartbeatMonitor { watched, progress: ProgressMonitor::new(period, limits) }
    }

    /// Whether one of them has stood still for longer than its limit.
    pub(super) fn is_one_silent(&mut self, now: Nanos) -> bool {
        let watched = self.watched;
        self.progress.silent_lanes(now, |index| watched[index].progress()) != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: i64) -> Nanos {
        Nanos::from_millis(ms)
    }

    #[test]
    fn a_thread_is_watched_from_its_first_beat_until_it_ends_in_good_order() {
        let (heartbeat, watched) = WatchedHeartbeat::new(ms(50));
        let watched = [watched];
        let mut monitor = HeartbeatMonitor::new(&watched, ms(5));
        let mut job = 0;
        let mut silent = |jobs: i64, beat: &dyn Fn()| {
            let begin = job;
            job += jobs;
            (begin..job).any(|job| {
                beat();
                monitor.is_one_silent(ms(5 * job))
            })
        };
        assert!(!silent(100, &|| ()), "it has not begun");
        assert!(!silent(100, &|| heartbeat.beat()));
        assert!(silent(12, &|| ()), "60 ms without a beat");
        assert!(!silent(5, &|| heartbeat.beat()));
        drop(heartbeat);
        assert!(!silent(100, &|| ()), "it has ended");
    }

    #[test]
    fn a_thread_that_panicked_is_silent() {
        let (heartbeat, watched) = WatchedHeartbeat::new(ms(50));
        heartbeat.beat();
        let watched = [watched];
        let mut monitor = HeartbeatMonitor::new(&watched, ms(5));
        assert!(!monitor.is_one_silent(ms(0)));
        let ended = std::thread::spawn(move || {
            heartbeat.beat();
            std::panic::panic_any(7);
        });
        assert!(ended.join().is_err());
        assert!((1..20).any(|job| monitor.is_one_silent(ms(5 * job))));
    }
}
