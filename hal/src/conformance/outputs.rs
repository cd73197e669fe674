//! Checks of the output halves: refusals that change nothing, safe values from any state. The
//! `_observed` variants do not trust the half about what it put out, but look at the outputs from
//! outside.

use super::inputs::check_channels;
use super::{CycleDriver, Report, Violation};
use crate::analog::{AnalogOut, DacCode};
use crate::digital::{DigitalOut, LinesOut};
use crate::error::Error;
use crate::reading::CHANNELS;
use crate::time::Nanos;

/// What the outside sees on the D/A channels.
type ObserveCodes<'a> = Option<&'a mut dyn FnMut() -> [DacCode; CHANNELS]>;
/// What the outside sees on the lines.
type ObserveLines<'a> = Option<&'a mut dyn FnMut() -> LinesOut>;

/// Exercises a D/A half over its whole range and leaves it safe. Answers alone are judged.
pub fn check_analog_out(device: &mut dyn AnalogOut, bench: &mut CycleDriver<'_>) -> Vec<Violation> {
    AnalogOutCheck { report: Report::default(), device, bench, observe: None }.run()
}

/// Like [`check_analog_out`], and compares after every call what `observe` sees on the outputs
/// (unused channels are not looked at). `observe` may let a simulated world move on until the last
/// word has acted.
pub fn check_analog_out_observed(
    device: &mut dyn AnalogOut,
    bench: &mut CycleDriver<'_>,
    observe: &mut dyn FnMut() -> [DacCode; CHANNELS],
) -> Vec<Violation> {
    AnalogOutCheck { report: Report::default(), device, bench, observe: Some(observe) }.run()
}

/// Drives every channel to the top of its range, drops the half and expects the safe value.
pub fn check_analog_out_drop(
    mut device: Box<dyn AnalogOut>,
    bench: &mut CycleDriver<'_>,
    observe: &mut dyn FnMut() -> [DacCode; CHANNELS],
) -> Vec<Violation> {
    let mut report = Report::default();
    let (channels, safe) = (device.channels().min(CHANNELS), device.safe_value());
    let (_, high) = device.code_range();
    accepted(&mut report, "range-accepted", device.commit(bench.release(), &[high; CHANNELS]));
    drop(device);
    let seen = observe();
    report.require(seen[..channels].iter().all(|code| *code == safe), "drop-is-safe", || {
        format!("after drop the outputs read {:?}, safe is {safe:?}", &seen[..channels])
    });
    report.found
}

/// Exercises the output half of the digital lines and leaves it safe. Answers alone are judged.
pub fn check_digital_out(
    device: &mut dyn DigitalOut,
    bench: &mut CycleDriver<'_>,
) -> Vec<Violation> {
    digital_out(device, bench, None)
}

/// Like [`check_digital_out`], and compares after every call what `observe` sees on the lines.
pub fn check_digital_out_observed(
    device: &mut dyn DigitalOut,
    bench: &mut CycleDriver<'_>,
    observe: &mut dyn FnMut() -> LinesOut,
) -> Vec<Violation> {
    digital_out(device, bench, Some(observe))
}

/// Raises enable and brake release, drops the half and expects both down.
pub fn check_digital_out_drop(
    mut device: Box<dyn DigitalOut>,
    bench: &mut CycleDriver<'_>,
    observe: &mut dyn FnMut() -> LinesOut,
) -> Vec<Violation> {
    let mut report = Report::default();
    let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: true };
    accepted(&mut report, "lines-accepted", device.commit(bench.release(), &lines));
    drop(device);
    let seen = observe();
    report.require(!seen.enable && !seen.brake_release, "drop-is-safe", || {
        format!("after drop the lines read {seen:?}")
    });
    report.found
}

pub(super) fn accepted(report: &mut Report, rule: &'static str, answer: Result<(), Error>) {
    if let Err(error) = answer {
        report.error(&error);
        report.add(rule, format!("refused with \"{error}\""));
    }
}

pub(super) fn check_silence(report: &mut Report, before: Nanos, after: Nanos) {
    report.require(before > Nanos::ZERO, "silence-positive", || {
        format!("longest silence is {before}")
    });
    report.require(before == after, "constants-constant", || {
        format!("longest silence was {before}, is {after}")
    });
}

struct AnalogOutCheck<'a, 'b> {
    report: Report,
    device: &'a mut dyn AnalogOut,
    bench: &'a mut CycleDriver<'b>,
    observe: ObserveCodes<'a>,
}

impl AnalogOutCheck<'_, '_> {
    fn run(mut self) -> Vec<Violation> {
        let channels = self.device.channels();
        let (low, high) = self.device.code_range();
        let (safe, silence) = (self.device.safe_value(), self.device.longest_silence());
        self.report.require(low < high, "range-ordered", || format!("{low:?} to {high:?}"));
        self.report.require((low..=high).contains(&safe), "safe-in-range", || {
            format!("safe value {safe:?}, range {low:?} to {high:?}")
        });
        self.safe("before the first commit");
        for code in [low, high, safe] {
            self.commit([code; CHANNELS]);
        }
        self.refusals(low, high);
        self.unused_ignored(channels, high);
        self.safe("after a commit");
        self.safe("a second time");
        self.commit([high; CHANNELS]);
        let mut bad = [safe; CHANNELS];
        bad[0] = DacCode(high.0.saturating_add(1));
        let _ = self.device.commit(self.bench.release(), &bad);
        self.safe("after a refused commit");
        check_channels(&mut self.report, channels, self.device.channels());
        check_silence(&mut self.report, silence, self.device.longest_silence());
        let after = (self.device.code_range(), self.device.safe_value());
        self.report.require(after == ((low, high), safe), "constants-constant", || {
            format!("code range and safe value became {after:?}")
        });
        self.report.found
    }

    fn channels(&self) -> usize {
        self.device.channels().min(CHANNELS)
    }

    fn safe(&mut self, when: &str) {
        accepted(&mut self.report, "safe-from-any-state", self.device.safe());
        self.expect("safe-reached", &[self.device.safe_value(); CHANNELS], when);
    }

    fn commit(&mut self, codes: [DacCode; CHANNELS]) {
        let answer = self.device.commit(self.bench.release(), &codes);
        accepted(&mut self.report, "range-accepted", answer);
        self.expect("commit-reaches-output", &codes, "after a commit");
    }

    /// One channel outside on either side, every other one moved: all or nothing.
    fn refusals(&mut self, low: DacCode, high: DacCode) {
        let outside = [low.0.checked_sub(1), high.0.checked_add(1), Some(i32::MIN), Some(i32::MAX)];
        for channel in 0..self.channels() {
            for code in outside.into_iter().flatten() {
                if (low.0..=high.0).contains(&code) {
                    continue;
                }
                self.commit([high; CHANNELS]);
                let mut codes = [low; CHANNELS];
                codes[channel] = DacCode(code);
                let answer = self.device.commit(self.bench.release(), &codes);
                self.report.refusal(channel, format_args!("code {code}"), answer);
                self.expect("refusal-changes-nothing", &[high; CHANNELS], "after a refusal");
            }
        }
    }

    fn unused_ignored(&mut self, channels: usize, high: DacCode) {
        let mut codes = [DacCode(i32::MAX); CHANNELS];
        codes.iter_mut().take(channels).for_each(|code| *code = high);
        let answer = self.device.commit(self.bench.release(), &codes);
        accepted(&mut self.report, "unused-channels-ignored", answer);
    }

    fn expect(&mut self, rule: &'static str, due: &[DacCode; CHANNELS], when: &str) {
        let channels = self.channels();
        if let Some(observe) = self.observe.as_mut() {
            let seen = observe();
            self.report.require(seen[..channels] == due[..channels], rule, || {
                let (seen, due) = (&seen[..channels], &due[..channels]);
                format!("{when} the outputs read {seen:?}, due is {due:?}")
            });
        }
    }
}

fn digital_out(
    device: &mut dyn DigitalOut,
    bench: &mut CycleDriver<'_>,
    mut observe: ObserveLines<'_>,
) -> Vec<Violation> {
    let mut report = Report::default();
    let silence = device.longest_silence();
    safe_lines(&mut report, device, &mut observe, "before the first commit");
    // Every combination, the feed line changing from each to the next: a watchdog stays fed.
    for step in 0..8 {
        let lines = LinesOut {
            enable: step & 2 != 0,
            brake_release: step & 4 != 0,
            watchdog_feed: step & 1 == 0,
        };
        accepted(&mut report, "lines-accepted", device.commit(bench.release(), &lines));
        if let Some(observe) = observe.as_mut() {
            let seen = observe();
            report.require(seen == lines, "commit-reaches-output", || {
                format!("committed {lines:?}, the lines read {seen:?}")
            });
        }
        safe_lines(&mut report, device, &mut observe, "after a commit");
        safe_lines(&mut report, device, &mut observe, "a second time");
    }
    check_silence(&mut report, silence, device.longest_silence());
    report.found
}

fn safe_lines(
    report: &mut Report,
    device: &mut dyn DigitalOut,
    observe: &mut ObserveLines<'_>,
    when: &str,
) {
    let fed_before = observe.as_mut().map(|observe| observe().watchdog_feed);
    accepted(report, "safe-from-any-state", device.safe());
    if let Some(observe) = observe.as_mut() {
        let seen = observe();
        report.require(!seen.enable && !seen.brake_release, "safe-reached", || {
            format!("{when} the lines read {seen:?}")
        });
        report.require(Some(seen.watchdog_feed) == fed_before, "safe-is-no-sign-of-life", || {
            format!("going safe {when} toggled the watchdog's feed line")
        });
    }
}
