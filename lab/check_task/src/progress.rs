//! Shows how far a check is, on standard error: a bar on a terminal, a line a second elsewhere.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use taktil_machine_console::out;
use taktil_rtcore::Nanos;
use taktil_rtcore::linux::monotonic;

/// Steps between two looks at the clock, less one: a mask.
const STEPS_MASK: u64 = 0xFFF;
/// Time between two plain lines.
const LINE_INTERVAL: Nanos = Nanos::from_secs(1);

/// The progress display.
#[derive(Debug)]
pub(crate) struct Progress {
    bar: Option<ProgressBar>,
    lines: bool,
    stage: &'static str,
    done: u64,
    total: u64,
    next: Nanos,
}

impl Progress {
    /// A display before the first stage; `quiet` shows nothing.
    pub(crate) fn new(quiet: bool) -> Progress {
        let terminal = std::io::stderr().is_terminal();
        let bar = (terminal && !quiet).then(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr_with_hz(10));
            let style = ProgressStyle::with_template("{bar:32} {percent:>3} %  {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar
        });
        let next = monotonic() + LINE_INTERVAL;
        Progress { bar, lines: !terminal && !quiet, stage: "", done: 0, total: 0, next }
    }

    /// A part of the check begins, of so many steps or starts.
    pub(crate) fn begin(&mut self, stage: &'static str, total: usize) {
        (self.stage, self.done, self.total) = (stage, 0, total as u64);
        if let Some(bar) = &self.bar {
            bar.set_length(self.total);
            bar.set_position(0);
            bar.set_message(stage);
        }
    }

    /// One more is done.
    pub(crate) fn advance(&mut self) {
        self.done += 1;
        if self.done & STEPS_MASK != 0 {
            return;
        }
        if let Some(bar) = &self.bar {
            bar.set_position(self.done);
        } else if self.lines && monotonic() >= self.next {
            out::warn(format_args!("{}: {} of {}", self.stage, self.done, self.total));
            self.next = monotonic() + LINE_INTERVAL;
        }
    }

    /// Removes the bar.
    pub(crate) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
