//! Tests that broken output halves are detected, observed through a cell that stands for the wire.
#![expect(clippy::disallowed_types, reason = "a test looks at what a device half keeps")]

use std::sync::{Arc, Mutex};

use super::rules;
use crate::conformance::{
    CycleDriver, check_analog_out, check_analog_out_drop, check_analog_out_observed,
    check_digital_out, check_digital_out_drop, check_digital_out_observed,
};
use crate::{AnalogOut, CHANNELS, DacCode, DigitalOut, Error, ErrorKind, LinesOut, Nanos};

#[derive(Clone, Copy, PartialEq, Debug)]
enum Defect {
    None,
    AcceptsAll,
    Clamps,
    WritesBeforeChecking,
    NamesWrongChannel,
    WrongKind,
    RefusesTopOfRange,
    LosesWords,
    SafeFailsTwice,
    SafeDoesNothing,
    SafeOutsideRange,
    NoSilence,
    MinusOneChannels,
    ChecksUnused,
    DropForgets,
    SafeFeeds,
}

const CODE_MIN: i32 = -2048;
const CODE_MAX: i32 = 2047;
const WIRED_CHANNELS: usize = 6;

struct Fake {
    defect: Defect,
    wire: Arc<Mutex<[DacCode; CHANNELS]>>,
    lines: Arc<Mutex<LinesOut>>,
    safe_calls: usize,
}

impl Fake {
    fn new(defect: Defect) -> Fake {
        let (wire, lines) = (Arc::default(), Arc::default());
        Fake { defect, wire, lines, safe_calls: 0 }
    }

    fn has(&self, defect: Defect) -> bool {
        self.defect == defect
    }

    fn refuse(&self, channel: usize) -> Error {
        let channel = if self.has(Defect::NamesWrongChannel) { 7 } else { channel as u16 };
        let kind =
            if self.has(Defect::WrongKind) { ErrorKind::Transient } else { ErrorKind::OutOfRange };
        Error::on_channel(kind, "fake", channel)
    }

    fn quiet(&mut self) -> Result<bool, Error> {
        self.safe_calls += 1;
        if self.has(Defect::SafeFailsTwice) && self.safe_calls == 2 {
            return Err(Error::whole(ErrorKind::Transient, "fake"));
        }
        Ok(!self.has(Defect::SafeDoesNothing))
    }
}

impl AnalogOut for Fake {
    fn channels(&self) -> usize {
        if self.has(Defect::MinusOneChannels) { 0 } else { WIRED_CHANNELS }
    }
    fn code_range(&self) -> (DacCode, DacCode) {
        (DacCode(CODE_MIN), DacCode(CODE_MAX))
    }
    fn commit(&mut self, _: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let highest = CODE_MAX - i32::from(self.has(Defect::RefusesTopOfRange));
        let checked = if self.has(Defect::ChecksUnused) { CHANNELS } else { WIRED_CHANNELS };
        let mut next = *self.wire.lock().unwrap();
        for (channel, code) in codes.iter().enumerate().take(checked) {
            if !(CODE_MIN..=highest).contains(&code.0) && !self.has(Defect::AcceptsAll) {
                if !self.has(Defect::Clamps) {
                    return Err(self.refuse(channel));
                }
                next[channel] = DacCode(code.0.clamp(CODE_MIN, highest));
                continue;
            }
            next[channel] = *code;
            if self.has(Defect::WritesBeforeChecking) {
                *self.wire.lock().unwrap() = next;
            }
        }
        if !self.has(Defect::LosesWords) {
            *self.wire.lock().unwrap() = next;
        }
        Ok(())
    }
    fn safe(&mut self) -> Result<(), Error> {
        if self.quiet()? {
            *self.wire.lock().unwrap() = [AnalogOut::safe_value(self); CHANNELS];
        }
        Ok(())
    }
    fn safe_value(&self) -> DacCode {
        DacCode(if self.has(Defect::SafeOutsideRange) { CODE_MAX + 1 } else { 0 })
    }
    fn longest_silence(&self) -> Nanos {
        Nanos::from_millis(i64::from(!self.has(Defect::NoSilence)))
    }
}

impl DigitalOut for Fake {
    fn commit(&mut self, _: Nanos, lines: &LinesOut) -> Result<(), Error> {
        if self.has(Defect::RefusesTopOfRange) && lines.enable {
            return Err(Error::whole(ErrorKind::Transient, "fake"));
        }
        if !self.has(Defect::LosesWords) {
            *self.lines.lock().unwrap() = *lines;
        }
        Ok(())
    }
    fn safe(&mut self) -> Result<(), Error> {
        if self.quiet()? {
            let mut lines = self.lines.lock().unwrap();
            let fed = lines.watchdog_feed ^ (self.defect == Defect::SafeFeeds);
            *lines = LinesOut { watchdog_feed: fed, ..LinesOut::SAFE };
        }
        Ok(())
    }
    fn longest_silence(&self) -> Nanos {
        AnalogOut::longest_silence(self)
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        if !self.has(Defect::DropForgets) {
            let _ = AnalogOut::safe(self);
            let _ = DigitalOut::safe(self);
        }
    }
}

fn observed(defect: Defect) -> Vec<&'static str> {
    let mut fake = Fake::new(defect);
    let wire = fake.wire.clone();
    let mut observe = || *wire.lock().unwrap();
    rules(&check_analog_out_observed(&mut fake, &mut CycleDriver::stationary(), &mut observe))
}

fn observed_lines(defect: Defect) -> Vec<&'static str> {
    let mut fake = Fake::new(defect);
    let lines = fake.lines.clone();
    let mut observe = || *lines.lock().unwrap();
    rules(&check_digital_out_observed(&mut fake, &mut CycleDriver::stationary(), &mut observe))
}

#[test]
fn honest_outputs_pass() {
    assert_eq!(check_analog_out(&mut Fake::new(Defect::None), &mut CycleDriver::stationary()), []);
    assert_eq!(check_digital_out(&mut Fake::new(Defect::None), &mut CycleDriver::stationary()), []);
    assert_eq!(observed(Defect::None), [""; 0]);
    assert_eq!(observed_lines(Defect::None), [""; 0]);
}

#[test]
fn every_broken_analog_output_is_rejected_by_its_rule() {
    let cases: [(Defect, &[&str]); 13] = [
        (Defect::AcceptsAll, &["range-refused", "refusal-changes-nothing"]),
        (Defect::Clamps, &["range-refused", "refusal-changes-nothing"]),
        (Defect::WritesBeforeChecking, &["refusal-changes-nothing"]),
        (Defect::NamesWrongChannel, &["refusal-names-channel"]),
        (Defect::WrongKind, &["range-refused"]),
        (Defect::RefusesTopOfRange, &["range-accepted"]),
        (Defect::LosesWords, &["commit-reaches-output"]),
        (Defect::SafeFailsTwice, &["safe-from-any-state"]),
        (Defect::SafeDoesNothing, &["safe-reached"]),
        (Defect::SafeOutsideRange, &["safe-in-range"]),
        (Defect::NoSilence, &["silence-positive"]),
        (Defect::MinusOneChannels, &["channels-in-bounds"]),
        (Defect::ChecksUnused, &["unused-channels-ignored"]),
    ];
    for (defect, due) in cases {
        let found = observed(defect);
        assert!(due.iter().all(|rule| found.contains(rule)), "{defect:?}: {found:?}");
    }
}

#[test]
fn every_broken_digital_output_is_rejected_by_its_rule() {
    let cases = [
        (Defect::RefusesTopOfRange, "lines-accepted"),
        (Defect::LosesWords, "commit-reaches-output"),
        (Defect::SafeFailsTwice, "safe-from-any-state"),
        (Defect::SafeDoesNothing, "safe-reached"),
        (Defect::NoSilence, "silence-positive"),
        (Defect::SafeFeeds, "safe-is-no-sign-of-life"),
    ];
    for (defect, due) in cases {
        let found = observed_lines(defect);
        assert!(found.contains(&due), "{defect:?}: {found:?}");
    }
}

#[test]
fn without_an_observer_the_answers_alone_are_judged() {
    let broken =
        check_analog_out(&mut Fake::new(Defect::AcceptsAll), &mut CycleDriver::stationary());
    assert_eq!(rules(&broken), ["range-refused"]);
    let unseen =
        check_analog_out(&mut Fake::new(Defect::LosesWords), &mut CycleDriver::stationary());
    assert_eq!(unseen, []);
}

#[test]
fn an_output_that_leaves_its_last_word_behind_is_rejected() {
    for (defect, due) in [(Defect::None, vec![]), (Defect::DropForgets, vec!["drop-is-safe"])] {
        let fake = Fake::new(defect);
        let wire = fake.wire.clone();
        let mut observe = || *wire.lock().unwrap();
        let found =
            check_analog_out_drop(Box::new(fake), &mut CycleDriver::stationary(), &mut observe);
        assert_eq!(rules(&found), due);

        let fake = Fake::new(defect);
        let lines = fake.lines.clone();
        let mut observe = || *lines.lock().unwrap();
        let found =
            check_digital_out_drop(Box::new(fake), &mut CycleDriver::stationary(), &mut observe);
        assert_eq!(rules(&found), due);
    }
}
