//! The checks of inputs find each rule that a broken input half violates.

use super::rules;
use crate::conformance::{
    CycleDriver, check_analog_in, check_digital_in, check_encoders, check_force_torque,
    check_tactile,
};
use crate::{
    AdcCode, AnalogIn, Arrival, CHANNELS, Counts, DigitalIn, Encoders, Error, ErrorKind,
    ForceTorque, GaugeCodes, IndexPulses, LinesIn, Nanos, Reading, TactileArray, TactileFrame,
};

#[derive(Clone, Copy, PartialEq, Debug)]
enum Defect {
    None,
    Future,
    Backwards,
    Unrepeatable,
    Frozen,
    Silent,
    Nameless,
    Resurrected,
    UnusedChannel,
    TooManyChannels,
    Growing,
    ReversedRange,
    CodeOutside,
    Unannounced,
    Forgetful,
}

struct Fake {
    defect: Defect,
    calls: i32,
    last: Option<Nanos>,
}

impl Fake {
    fn new(defect: Defect) -> Fake {
        Fake { defect, calls: 0, last: None }
    }

    fn stamp(&mut self, release: Nanos) -> Result<Nanos, Error> {
        self.calls += 1;
        let lost = Error::whole(ErrorKind::Lost, "fake");
        match self.defect {
            Defect::Future => Ok(release + Nanos(1)),
            Defect::Backwards => Ok(Nanos(0) - release),
            Defect::Frozen => Ok(Nanos(-1)),
            Defect::Silent => Err(Error::whole(ErrorKind::Stale, "fake")),
            Defect::Nameless if self.calls == 1 => Err(Error::whole(ErrorKind::Transient, "")),
            Defect::Resurrected if self.calls == 1 => Err(lost),
            Defect::Unrepeatable if self.last == Some(release) => Err(lost),
            _ => {
                self.last = Some(release);
                Ok(release)
            }
        }
    }

    fn count(&self) -> usize {
        match self.defect {
            Defect::TooManyChannels => CHANNELS + 1,
            Defect::Growing => 3 + self.calls.min(4) as usize,
            _ => 6,
        }
    }

    fn codes(&self) -> [i32; CHANNELS] {
        let mut codes = [0; CHANNELS];
        codes[1] = if self.defect == Defect::CodeOutside { 2048 } else { 2047 };
        codes[CHANNELS - 1] = i32::from(self.defect == Defect::UnusedChannel);
        codes
    }
}

impl Encoders for Fake {
    fn joints(&self) -> usize {
        self.count()
    }
    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let acquired = self.stamp(release)?;
        Ok(Reading { value: self.codes().map(Counts), acquired })
    }
    fn has_index(&self) -> bool {
        self.defect == Defect::Forgetful
    }
    fn index_pulses(&self) -> IndexPulses {
        let mut marks = [None; CHANNELS];
        let there = self.defect == Defect::Forgetful && self.calls.rem_euclid(5) < 3;
        marks[0] = (there || self.defect == Defect::Unannounced).then_some(Counts(7));
        marks
    }
}

impl AnalogIn for Fake {
    fn channels(&self) -> usize {
        self.count()
    }
    fn code_range(&self) -> (AdcCode, AdcCode) {
        let high = if self.defect == Defect::ReversedRange { -2049 } else { 2047 };
        (AdcCode(-2048), AdcCode(high))
    }
    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        let acquired = self.stamp(release)?;
        Ok(Reading { value: self.codes().map(AdcCode), acquired })
    }
}

impl ForceTorque for Fake {
    fn sample(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
        Ok(Reading { value: GaugeCodes::default(), acquired: self.stamp(release)? })
    }
}

impl DigitalIn for Fake {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        Ok(Reading { value: LinesIn::default(), acquired: self.stamp(release)? })
    }
}

const EVERY_READING: [(Defect, &[&str]); 8] = [
    (Defect::None, &[]),
    (Defect::Future, &["acquired-not-in-future"]),
    (Defect::Backwards, &["acquired-not-backwards"]),
    (Defect::Unrepeatable, &["same-release-same-reading"]),
    (Defect::Frozen, &["moves-on"]),
    (Defect::Silent, &["delivers"]),
    (Defect::Nameless, &["error-names-device"]),
    (Defect::Resurrected, &["lost-is-final"]),
];

#[test]
fn every_reading_half_is_held_to_its_stamps() {
    for (defect, due) in EVERY_READING {
        let fresh = || Fake::new(defect);
        let bench = CycleDriver::stationary;
        let found = [
            check_encoders(&mut fresh(), &mut bench()),
            check_analog_in(&mut fresh(), &mut bench()),
            check_force_torque(&mut fresh(), &mut bench()),
            check_digital_in(&mut fresh(), &mut bench()),
        ];
        for found in found {
            assert_eq!(rules(&found), due, "{defect:?}: {found:?}");
        }
    }
}

#[test]
fn channels_and_ranges_are_checked() {
    let both: [(Defect, &[&str]); 3] = [
        (Defect::UnusedChannel, &["unused-channels-zero"]),
        (Defect::TooManyChannels, &["channels-in-bounds"]),
        (Defect::Growing, &["constants-constant"]),
    ];
    for (defect, due) in both {
        let encoders = check_encoders(&mut Fake::new(defect), &mut CycleDriver::stationary());
        assert_eq!(rules(&encoders), due, "{defect:?}: {encoders:?}");
        let analog = check_analog_in(&mut Fake::new(defect), &mut CycleDriver::stationary());
        assert!(rules(&analog).contains(&due[0]), "{defect:?}: {analog:?}");
    }
    for (defect, due) in
        [(Defect::Unannounced, "marks-announced"), (Defect::Forgetful, "marks-stay")]
    {
        let encoders = check_encoders(&mut Fake::new(defect), &mut CycleDriver::stationary());
        assert_eq!(rules(&encoders), [due], "{defect:?}: {encoders:?}");
    }
    let outside =
        check_analog_in(&mut Fake::new(Defect::CodeOutside), &mut CycleDriver::stationary());
    assert_eq!(rules(&outside), ["code-in-range"]);
    let reversed =
        check_analog_in(&mut Fake::new(Defect::ReversedRange), &mut CycleDriver::stationary());
    assert_eq!(rules(&reversed), ["range-ordered", "code-in-range"]);
}

#[test]
fn releases_go_on_from_check_to_check() {
    let mut seen = Vec::new();
    let mut bench =
        CycleDriver::new(Nanos(5), Nanos(10), |release| seen.push(release.0)).with_cycles(3);
    let _ = check_digital_in(&mut Fake::new(Defect::None), &mut bench);
    let _ = check_force_torque(&mut Fake::new(Defect::None), &mut bench);
    drop(bench);
    assert_eq!(seen, [5, 15, 25, 35, 45, 55]);
}

/// One fault in each frame of an otherwise honest array: new frames at every other release.
type Spoil = fn(&mut TactileFrame, i64);

struct FakeArray {
    rows: usize,
    full_scale: u16,
    spoil: Spoil,
    always_new: bool,
    /// Spoils the caller's frame although there is nothing new.
    scribble: bool,
    silent: bool,
    /// Takes a frame of any size.
    takes_any: bool,
    frames: i64,
    last: Option<Nanos>,
}

fn honest() -> FakeArray {
    FakeArray {
        rows: 16,
        full_scale: 4095,
        spoil: |_, _| {},
        always_new: false,
        scribble: false,
        silent: false,
        takes_any: false,
        frames: 0,
        last: None,
    }
}

impl TactileArray for FakeArray {
    fn rows(&self) -> usize {
        self.rows
    }
    fn cols(&self) -> usize {
        12
    }
    fn full_scale(&self) -> u16 {
        self.full_scale
    }
    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        if frame.cols() != 12 || frame.rows() != 16 {
            frame.valid[0] &= !self.takes_any;
            return match self.takes_any {
                true => Ok(Arrival::Held),
                false => Err(Error::whole(ErrorKind::OutOfRange, "fake")),
            };
        }
        let held = self.last == Some(release) || release.0 / 2_500_000 % 2 == 0;
        if self.silent || (held && !self.always_new) {
            frame.values[0] = if self.scribble { 1 } else { frame.values[0] };
            return Ok(Arrival::Held);
        }
        self.last = Some(release);
        self.frames += 1;
        frame.sequence = u32::MAX.wrapping_add(self.frames as u32);
        frame.acquired = release;
        frame.row_acquired.fill(release);
        frame.values.fill(4095);
        frame.valid.fill(true);
        (self.spoil)(frame, self.frames);
        Ok(Arrival::New)
    }
}

#[test]
fn an_honest_array_passes_across_the_wrap_of_its_sequence() {
    assert_eq!(check_tactile(&mut honest(), &mut CycleDriver::stationary()), []);
}

#[test]
fn broken_frames_are_rejected() {
    let spoils: [(Spoil, &str); 5] = [
        (|frame, _| frame.acquired += Nanos(1), "acquired-not-in-future"),
        (|frame, _| frame.row_acquired[15] += Nanos(1), "rows-before-frame"),
        (|frame, _| frame.values[191] = 4096, "code-in-range"),
        (|frame, _| frame.sequence = 7, "sequence-monotone"),
        (|frame, n| frame.sequence = (100 - n) as u32, "sequence-monotone"),
    ];
    for (spoil, due) in spoils {
        let found =
            check_tactile(&mut FakeArray { spoil, ..honest() }, &mut CycleDriver::stationary());
        assert_eq!(rules(&found), [due], "{found:?}");
    }
    let backwards: Spoil = |frame, n| {
        frame.acquired = Nanos(-n);
        frame.row_acquired.fill(Nanos(-n));
    };
    let found = check_tactile(
        &mut FakeArray { spoil: backwards, ..honest() },
        &mut CycleDriver::stationary(),
    );
    assert_eq!(rules(&found), ["acquired-not-backwards"]);
}

#[test]
fn broken_arrays_are_rejected() {
    let broken: [(FakeArray, &[&str]); 6] = [
        (FakeArray { always_new: true, ..honest() }, &["held-when-nothing-new"]),
        (FakeArray { scribble: true, ..honest() }, &["frame-untouched"]),
        (FakeArray { silent: true, ..honest() }, &["delivers"]),
        (FakeArray { rows: 65, ..honest() }, &["channels-in-bounds"]),
        (FakeArray { takes_any: true, ..honest() }, &["foreign-frame-refused", "frame-untouched"]),
        (FakeArray { full_scale: 0, ..honest() }, &["range-ordered", "code-in-range"]),
    ];
    for (mut array, due) in broken {
        let found = check_tactile(&mut array, &mut CycleDriver::stationary());
        assert_eq!(rules(&found)[..due.len()], *due, "{found:?}");
    }
}
