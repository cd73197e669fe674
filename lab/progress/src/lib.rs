//! Shows how far a command with many parts is, on standard error: a bar on a terminal, a plain line
//! every five seconds elsewhere. A command that is done within two seconds shows nothing.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicI64, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use taktil_machine_console::out;
use taktil_rtcore::Nanos;
use taktil_rtcore::linux::monotonic;

/// Time after which a command counts as long.
const FIRST_SHOWN_AFTER: Nanos = Nanos::from_secs(2);
/// Time between two plain lines.
const LINE_INTERVAL: Nanos = Nanos::from_secs(5);
/// Updates of the bar a second.
const BAR_RATE_HZ: u8 = 10;

/// How far a command is; threads may advance it together.
#[derive(Debug)]
pub struct Progress {
    what: &'static str,
    total: u64,
    begun: Nanos,
    terminal: bool,
    /// Counts what is done; hidden until the command counts as long.
    bar: ProgressBar,
    /// When a line is due next (ns). Relaxed: whoever moves it on prints, and nothing else depends
    /// on it.
    next: AtomicI64,
}

impl Progress {
    /// A display of `total` parts, each called `what` in the plural, such as `runs`.
    #[must_use]
    pub fn new(what: &'static str, total: usize) -> Progress {
        let (begun, terminal) = (monotonic(), std::io::stderr().is_terminal());
        let total = total as u64;
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::hidden());
        let style = ProgressStyle::with_template("{bar:32} {pos} of {len} {msg}  {eta} left");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        bar.set_message(what);
        let next = AtomicI64::new((begun + FIRST_SHOWN_AFTER).0);
        Progress { what, total, begun, terminal, bar, next }
    }

    /// One more part is done.
    pub fn advance(&self) {
        self.bar.inc(1);
        let now = monotonic();
        let due = self.next.load(Ordering::Relaxed);
        let after = (now + LINE_INTERVAL).0;
        let is_first = now.0 >= due
            && self.next.compare_exchange(due, after, Ordering::Relaxed, Ordering::Relaxed).is_ok();
        if !is_first {
            return;
        }
        if !self.terminal {
            let done = self.bar.position();
            out::warn(progress_line(self.what, self.total, done, now - self.begun));
        } else if self.bar.is_hidden() {
            self.bar.set_draw_target(ProgressDrawTarget::stderr_with_hz(BAR_RATE_HZ));
        }
    }
}

impl Drop for Progress {
    /// Removes the bar.
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// A line for pipes and files: what is done, and how long the rest may take.
fn progress_line(what: &str, total: u64, done: u64, passed: Nanos) -> String {
    let left = total.saturating_sub(done) as f64 * passed.as_secs_f64() / done.max(1) as f64;
    format!("{done} of {total} {what}, {left:.0} s left")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_tells_what_is_done_and_what_is_left() {
        let line = progress_line("runs", 40, 10, Nanos::from_secs(20));
        assert_eq!(line, "10 of 40 runs, 60 s left");
        assert_eq!(progress_line("runs", 0, 0, Nanos::ZERO), "0 of 0 runs, 0 s left");
    }

    #[test]
    fn threads_advance_together() {
        let progress = Progress::new("parts", 400);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..100).for_each(|_| progress.advance()));
            }
        });
        assert_eq!(progress.bar.position(), 400);
    }
}
