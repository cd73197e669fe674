//! Tests that broken halves of drives are detected.
#![expect(clippy::disallowed_types, reason = "a test looks at what a device half keeps")]

use std::sync::{Arc, Mutex};

use super::rules;
use crate::conformance::{
    CycleDriver, check_drive_in, check_drive_out, check_drive_out_drop, check_drive_out_observed,
};
use crate::{
    CHANNELS, Counts, DriveActual, DriveCommand, DriveIn, DriveLoop, DriveOut, DriveRequest,
    DriveState, Error, ErrorKind, Nanos, Reading,
};

#[derive(Clone, Copy, PartialEq, Debug)]
enum Defect {
    None,
    AcceptsAll,
    NamesWrongChannel,
    SafeDoesNothing,
    DropForgets,
    NoSilence,
    ChecksUnused,
    CodeWithoutFault,
    ReportsUnused,
    MovesWithin,
}

const TARGET_MAX: i32 = 1000;
const WIRED_CHANNELS: usize = 3;

struct Fake {
    defect: Defect,
    follows: Arc<Mutex<bool>>,
    samples: i32,
}

impl Fake {
    fn new(defect: Defect) -> Fake {
        Fake { defect, follows: Arc::default(), samples: 0 }
    }
}

impl DriveOut for Fake {
    fn channels(&self) -> usize {
        WIRED_CHANNELS
    }
    fn control_loop(&self) -> DriveLoop {
        DriveLoop::Velocity
    }
    fn target_range(&self) -> (i32, i32) {
        (-TARGET_MAX, TARGET_MAX)
    }
    fn commit(&mut self, _: Nanos, command: &DriveCommand) -> Result<(), Error> {
        let checked = if self.defect == Defect::ChecksUnused { CHANNELS } else { WIRED_CHANNELS };
        let bad = command.targets[..checked].iter().position(|target| target.abs() > TARGET_MAX);
        if let Some(bad) = bad.filter(|_| self.defect != Defect::AcceptsAll) {
            let channel = if self.defect == Defect::NamesWrongChannel { 9 } else { bad as u16 };
            return Err(Error::on_channel(ErrorKind::OutOfRange, "fake", channel));
        }
        *self.follows.lock().unwrap() = command.request == DriveRequest::Follow;
        Ok(())
    }
    fn safe(&mut self) -> Result<(), Error> {
        if self.defect != Defect::SafeDoesNothing {
            *self.follows.lock().unwrap() = false;
        }
        Ok(())
    }
    fn longest_silence(&self) -> Nanos {
        Nanos::from_millis(i64::from(self.defect != Defect::NoSilence))
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        if self.defect != Defect::DropForgets {
            *self.follows.lock().unwrap() = false;
        }
    }
}

impl DriveIn for Fake {
    fn channels(&self) -> usize {
        WIRED_CHANNELS
    }
    fn sample(&mut self, release: Nanos) -> Result<Reading<[DriveActual; CHANNELS]>, Error> {
        let mut value = [DriveActual::default(); CHANNELS];
        self.samples += i32::from(self.defect == Defect::MovesWithin);
        value[0].position = Counts(self.samples);
        value[1].state = DriveState::Fault;
        value[1].fault_code = 0x8611;
        value[2].fault_code = u16::from(self.defect == Defect::CodeWithoutFault);
        value[WIRED_CHANNELS].torque_code = i32::from(self.defect == Defect::ReportsUnused);
        Ok(Reading { value, acquired: release })
    }
}

#[test]
fn sound_halves_pass() {
    let mut bench = CycleDriver::stationary();
    assert_eq!(check_drive_in(&mut Fake::new(Defect::None), &mut bench), []);
    let mut fake = Fake::new(Defect::None);
    let follows = fake.follows.clone();
    let mut observe = move || *follows.lock().unwrap();
    assert_eq!(check_drive_out_observed(&mut fake, &mut bench, &mut observe), []);
    assert_eq!(check_drive_out_drop(Box::new(fake), &mut bench, &mut observe), []);
}

#[test]
fn each_defect_of_an_output_half_is_found() {
    for (defect, rule) in [
        (Defect::AcceptsAll, "range-refused"),
        (Defect::NamesWrongChannel, "refusal-names-channel"),
        (Defect::NoSilence, "silence-positive"),
        (Defect::ChecksUnused, "range-accepted"),
    ] {
        let mut bench = CycleDriver::stationary();
        let found = check_drive_out(&mut Fake::new(defect), &mut bench);
        assert_eq!(rules(&found), [rule], "{defect:?}");
    }
    let mut fake = Fake::new(Defect::SafeDoesNothing);
    let follows = fake.follows.clone();
    let mut observe = move || *follows.lock().unwrap();
    let mut bench = CycleDriver::stationary();
    let found = check_drive_out_observed(&mut fake, &mut bench, &mut observe);
    assert_eq!(rules(&found), ["safe-reached"]);
    let fake = Fake::new(Defect::DropForgets);
    let follows = fake.follows.clone();
    let mut observe = move || *follows.lock().unwrap();
    let found = check_drive_out_drop(Box::new(fake), &mut bench, &mut observe);
    assert_eq!(rules(&found), ["drop-is-safe"]);
}

#[test]
fn each_defect_of_an_input_half_is_found() {
    for (defect, rule) in [
        (Defect::CodeWithoutFault, "fault-code-with-fault"),
        (Defect::ReportsUnused, "unused-channels-zero"),
        (Defect::MovesWithin, "same-release-same-reading"),
    ] {
        let found = check_drive_in(&mut Fake::new(defect), &mut CycleDriver::stationary());
        assert_eq!(rules(&found), [rule], "{defect:?}");
    }
}
