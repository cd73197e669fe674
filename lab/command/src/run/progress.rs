//! Shows the progress of a run on standard error: a bar on a terminal, plain lines elsewhere. The
//! display is updated a few times a second, so that it costs the run nothing that matters.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use taktil_machine_console::out;
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::{Nanos, Payload};
use taktil_signal::{ControlState, Features, State, defined};

/// Logical time between two updates of the bar.
const BAR_INTERVAL: Nanos = Nanos::from_millis(50);
/// Logical time between two plain lines.
const LINE_INTERVAL: Nanos = Nanos::from_secs(1);

/// The progress display.
pub(super) struct Progress {
    bar: Option<ProgressBar>,
    lines: bool,
    until: Nanos,
    next: Nanos,
    control_id: Option<usize>,
    features_id: Option<usize>,
    state: State,
    features: Features,
}

impl Progress {
    /// A display for a run until `until`; `quiet` shows nothing.
    #[must_use]
    pub(super) fn new(catalog: &Catalog, until: Nanos, quiet: bool) -> Progress {
        let terminal = std::io::stderr().is_terminal();
        let bar = (terminal && !quiet).then(|| {
            let bar = ProgressBar::with_draw_target(
                u64::try_from(until.0 / 1_000_000).ok(),
                ProgressDrawTarget::stderr_with_hz(10),
            );
            let style = ProgressStyle::with_template("{bar:32} {percent:>3} %  {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar
        });
        Progress {
            bar,
            lines: !terminal && !quiet,
            until,
            next: Nanos::ZERO,
            control_id: catalog.find("supervisor.control"),
            features_id: catalog.find("tactile_servo.features"),
            state: State::Start,
            features: Features::default(),
        }
    }

    fn show(&mut self, now: Nanos) {
        let mut text = format!("{:6.2} s  {:<19}", now.as_secs_f64(), self.state.name());
        if self.features.defined & defined::CONTACT != 0 {
            let f = &self.features;
            text += &format!("  x_c {:5.2}  M0 {:6.0}  strokes {}", f.x_c, f.m0, f.reversals);
        }
        match &self.bar {
            Some(bar) => {
                bar.set_position(u64::try_from(now.0 / 1_000_000).unwrap_or(0));
                bar.set_message(text);
                self.next = now + BAR_INTERVAL;
            }
            None => {
                out::warn(format_args!("{text} of {:.2} s", self.until.as_secs_f64()));
                self.next = now + LINE_INTERVAL;
            }
        }
    }

    /// Removes the bar.
    pub(super) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

impl Observer for Progress {
    fn record(&mut self, record: &Record<'_>) {
        if Some(record.signal) == self.control_id {
            if let Some(control) = ControlState::decode(record.body) {
                self.state = State::from_code(control.state).unwrap_or_default();
            }
            if record.release >= self.next && (self.bar.is_some() || self.lines) {
                self.show(record.release);
            }
        } else if Some(record.signal) == self.features_id
            && let Some(features) = Features::decode(record.body)
        {
            self.features = features;
        }
    }
}
