//! Shows how far a command with many parts is, on standard error: a bar on a terminal, a plain line
//! every five seconds elsewhere. A command that is done within two seconds shows nothing.

use std::io::IsTerminal;

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

/// How far a command is.
#[derive(Debug)]
pub struct Progress {
    what: &'static str,
    /// Number of parts, where it is known beforehand.
    total: Option<u64>,
    done: u64,
    begun: Nanos,
    /// When the display is due next.
    next: Nanos,
    terminal: bool,
    /// Hidden until the command counts as long.
    bar: ProgressBar,
}

impl Progress {
    /// A display of `total` parts, each called `what` in the plural, such as `runs`.
    #[must_use]
    pub fn new(what: &'static str, total: usize) -> Progress {
        Progress::with_total(what, Some(total as u64), "{bar:32} {pos} of {len} {msg}  {eta} left")
    }

    /// A display of parts whose number is not known beforehand, such as the steps of a search.
    #[must_use]
    pub fn without_total(what: &'static str) -> Progress {
        Progress::with_total(what, None, "{spinner} {pos} {msg}  {elapsed}")
    }

    fn with_total(what: &'static str, total: Option<u64>, template: &str) -> Progress {
        let (begun, terminal) = (monotonic(), std::io::stderr().is_terminal());
        let bar = ProgressBar::with_draw_target(total, ProgressDrawTarget::hidden());
        let style = ProgressStyle::with_template(template);
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        bar.set_message(what);
        Progress { what, total, done: 0, begun, next: begun + FIRST_SHOWN_AFTER, terminal, bar }
    }

    /// One more part is done.
    pub fn advance(&mut self) {
        self.advance_by(1);
    }

    /// Several parts more are done.
    pub fn advance_by(&mut self, parts: usize) {
        self.done += parts as u64;
        self.bar.set_position(self.done);
        let now = monotonic();
        if now < self.next {
            return;
        }
        self.next = now + LINE_INTERVAL;
        if !self.terminal {
            out::warn(progress_line(self.what, self.total, self.done, now - self.begun));
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

/// A line for pipes and files: what is done, and how long the rest may take or, where nobody knows
/// how much is left, how long it has taken.
fn progress_line(what: &str, total: Option<u64>, done: u64, passed: Nanos) -> String {
    let Some(total) = total else {
        return format!("{done} {what}, {:.0} s", passed.as_secs_f64());
    };
    let left = total.saturating_sub(done) as f64 * passed.as_secs_f64() / done.max(1) as f64;
    format!("{done} of {total} {what}, {left:.0} s left")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_tells_what_is_done_and_what_is_left() {
        let line = progress_line("runs", Some(40), 10, Nanos::from_secs(20));
        assert_eq!(line, "10 of 40 runs, 60 s left");
        assert_eq!(progress_line("runs", Some(0), 0, Nanos::ZERO), "0 of 0 runs, 0 s left");
        assert_eq!(progress_line("steps", None, 7, Nanos::from_secs(20)), "7 steps, 20 s");
    }
}
