//! Watches that steps end: a thread looks from time to time whether the step of before is still at
//! work. A step that does not end cannot be ended from outside, so the process ends.

use std::sync::{Arc, PoisonError, Weak};
use std::time::Duration;

/// A step at work for so long does not end: a thousand times the longest budgets that there are.
pub(crate) const STEP_TIME_MAX: Duration = Duration::from_secs(10);
/// How often the thread looks in that time.
const LOOKS_MAX: u32 = 10;

/// Which step of which run is at work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Heartbeat {
    /// Grows with each step.
    pub(crate) number: u64,
    /// Run of the plan; none in other parts of the check.
    pub(crate) run: Option<usize>,
    /// Step in it.
    pub(crate) step: usize,
}

/// The step as both threads see it.
#[expect(clippy::disallowed_types, reason = "no lane waits here: the steps stand in no lane")]
type SharedHeartbeat = std::sync::Mutex<Heartbeat>;

/// Tells the thread of each step.
#[derive(Debug)]
pub(crate) struct Watchdog {
    beat: Arc<SharedHeartbeat>,
}

impl Watchdog {
    /// Starts the thread, which calls `hang` once with a step that is at work for `limit`. It ends
    /// with this value.
    pub(crate) fn start(
        limit: Duration,
        hang: impl FnOnce(Heartbeat) + Send + 'static,
    ) -> Watchdog {
        let beat = Arc::default();
        let watched = Arc::downgrade(&beat);
        // Without the thread a hanging step is not named, which the operator then sees anyway.
        let thread = std::thread::Builder::new().name("watchdog".into());
        let _ = thread.spawn(move || watch(watched, limit / LOOKS_MAX, hang));
        Watchdog { beat }
    }

    /// A step begins.
    pub(crate) fn begin(&self, run: Option<usize>, step: usize) {
        let mut beat = self.beat.lock().unwrap_or_else(PoisonError::into_inner);
        *beat = Heartbeat { number: beat.number + 1, run, step };
    }
}

#[expect(clippy::needless_pass_by_value, reason = "the thread owns what it watches")]
fn watch(watched: Weak<SharedHeartbeat>, interval: Duration, hang: impl FnOnce(Heartbeat)) {
    let (mut before, mut looks) = (Heartbeat::default(), 0);
    loop {
        std::thread::sleep(interval);
        let Some(beat) = watched.upgrade() else { return };
        let now = *beat.lock().unwrap_or_else(PoisonError::into_inner);
        looks = if now == before && now.number > 0 { looks + 1 } else { 0 };
        before = now;
        if looks >= LOOKS_MAX {
            hang(now);
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn a_step_that_does_not_end_is_named_and_one_that_does_is_not() {
        let (sender, hung) = channel();
        let watchdog = Watchdog::start(Duration::from_millis(300), move |beat| {
            sender.send(beat).unwrap();
        });
        for step in 0..20 {
            watchdog.begin(Some(3), step);
            assert!(hung.recv_timeout(Duration::from_millis(30)).is_err(), "step {step} goes on");
        }
        let beat = hung.recv_timeout(Duration::from_secs(60)).unwrap();
        assert_eq!((beat.run, beat.step), (Some(3), 19));
    }

    #[test]
    fn the_thread_ends_with_the_watchdog() {
        let (sender, hung) = channel::<Heartbeat>();
        let watchdog = Watchdog::start(Duration::from_millis(100), move |beat| {
            sender.send(beat).unwrap();
        });
        drop(watchdog);
        let ended = hung.recv_timeout(Duration::from_secs(60)).unwrap_err();
        assert_eq!(ended, std::sync::mpsc::RecvTimeoutError::Disconnected);
    }
}
