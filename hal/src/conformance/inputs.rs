//! Checks of the input halves: stamps, repeatability, unused channels, ranges, frames. Whether a
//! value is right is not judged.

use std::fmt::Debug;

use super::{CycleDriver, Report, Violation};
use crate::analog::{AdcCode, AnalogIn};
use crate::board_clock::BoardClock;
use crate::devices::Devices;
use crate::digital::{DigitalIn, LinesIn};
use crate::drive::{DriveActual, DriveIn, DriveState};
use crate::encoder::{Counts, Encoders, IndexPulses};
use crate::error::{Error, ErrorKind};
use crate::force_torque::{ForceTorque, GaugeCodes};
use crate::reading::{CHANNELS, Reading};
use crate::tactile::{Arrival, MAX_ROWS, TactileArray, TactileFrame};
use crate::time::Nanos;

/// Exercises an encoder half.
pub fn check_encoders(device: &mut dyn Encoders, bench: &mut CycleDriver<'_>) -> Vec<Violation> {
    let mut check = EncodersCheck::default();
    run_cycles(bench, |release| check.cycle(device, release));
    check.0.finish()
}

/// Exercises the input half of drives.
pub fn check_drive_in(device: &mut dyn DriveIn, bench: &mut CycleDriver<'_>) -> Vec<Violation> {
    let mut check = DriveInCheck::default();
    run_cycles(bench, |release| check.cycle(device, release));
    check.finish()
}

/// Exercises an A/D half.
pub fn check_analog_in(device: &mut dyn AnalogIn, bench: &mut CycleDriver<'_>) -> Vec<Violation> {
    let mut check = AnalogInCheck::default();
    run_cycles(bench, |release| check.cycle(device, release));
    check.0.finish()
}

/// Exercises a force/torque half.
pub fn check_force_torque(
    device: &mut dyn ForceTorque,
    bench: &mut CycleDriver<'_>,
) -> Vec<Violation> {
    let mut check = ReadingCheck::<GaugeCodes>::default();
    run_cycles(bench, |release| check.cycle(release, |at| device.sample(at)));
    check.finish()
}

/// Exercises a board's clock: phases that are real ones, of a cycle that stays what it is.
pub fn check_board_clock(
    device: &mut dyn BoardClock,
    bench: &mut CycleDriver<'_>,
) -> Vec<Violation> {
    let mut check = BoardClockCheck::default();
    run_cycles(bench, |release| check.cycle(device, release));
    check.0.finish()
}

/// Exercises the input half of the digital lines.
pub fn check_digital_in(device: &mut dyn DigitalIn, bench: &mut CycleDriver<'_>) -> Vec<Violation> {
    let mut check = ReadingCheck::<LinesIn>::default();
    run_cycles(bench, |release| check.cycle(release, |at| device.sample(at)));
    check.finish()
}

/// Exercises a tactile half; at least one frame must arrive within the driver's cycles.
pub fn check_tactile(device: &mut dyn TactileArray, bench: &mut CycleDriver<'_>) -> Vec<Violation> {
    let mut check = TactileCheck::default();
    run_cycles(bench, |release| check.cycle(device, release));
    check.finish()
}

/// All input halves in the same cycles.
pub(super) fn check_together(devices: &mut Devices, bench: &mut CycleDriver<'_>) -> Vec<Violation> {
    let mut encoders = devices.encoders.is_some().then(EncodersCheck::default);
    let mut drives = devices.drive_in.is_some().then(DriveInCheck::default);
    let mut analog = devices.analog_in.is_some().then(AnalogInCheck::default);
    let mut clock = devices.board_clock.is_some().then(BoardClockCheck::default);
    let mut force = ReadingCheck::<GaugeCodes>::default();
    let mut lines = ReadingCheck::<LinesIn>::default();
    let mut tactile: Vec<TactileCheck> =
        devices.tactile.values().map(|_| TactileCheck::default()).collect();
    run_cycles(bench, |release| {
        if let (Some(check), Some(half)) = (&mut encoders, &mut devices.encoders) {
            check.cycle(half.as_mut(), release);
        }
        if let (Some(check), Some(half)) = (&mut drives, &mut devices.drive_in) {
            check.cycle(half.as_mut(), release);
        }
        if let (Some(check), Some(half)) = (&mut analog, &mut devices.analog_in) {
            check.cycle(half.as_mut(), release);
        }
        if let (Some(check), Some(half)) = (&mut clock, &mut devices.board_clock) {
            check.cycle(half.as_mut(), release);
        }
        if let Some(half) = &mut devices.force_torque {
            force.cycle(release, |at| half.sample(at));
        }
        if let Some(half) = &mut devices.digital_in {
            lines.cycle(release, |at| half.sample(at));
        }
        for (check, array) in tactile.iter_mut().zip(devices.tactile.values_mut()) {
            check.cycle(array.as_mut(), release);
        }
    });
    let mut halves = vec![
        ("encoders".to_owned(), encoders.map(|check| check.0.finish())),
        ("drive_in".to_owned(), drives.map(DriveInCheck::finish)),
        ("analog_in".to_owned(), analog.map(|check| check.0.finish())),
        ("board_clock".to_owned(), clock.map(|check| check.0.finish())),
        ("force_torque".to_owned(), devices.force_torque.as_ref().map(|_| force.finish())),
        ("digital_in".to_owned(), devices.digital_in.as_ref().map(|_| lines.finish())),
    ];
    for (name, check) in devices.tactile.keys().zip(tactile) {
        halves.push((name.clone(), Some(check.finish())));
    }
    let named = |(half, found): (String, Option<Vec<Violation>>)| {
        found
            .unwrap_or_default()
            .into_iter()
            .map(move |v| Violation { rule: v.rule, text: format!("{half}: {}", v.text) })
    };
    halves.into_iter().flat_map(named).collect()
}

fn run_cycles<R>(bench: &mut CycleDriver<'_>, mut cycle: impl FnMut(Nanos) -> R) {
    for _ in 0..bench.cycles() {
        cycle(bench.release());
    }
}

/// What holds for every reading, whatever is inside.
#[derive(Debug)]
struct ReadingCheck<T> {
    report: Report,
    first: Option<Nanos>,
    last: Option<Reading<T>>,
    readings: usize,
    lost: bool,
}

impl<T> Default for ReadingCheck<T> {
    fn default() -> ReadingCheck<T> {
        ReadingCheck {
            report: Report::default(),
            first: None,
            last: None,
            readings: 0,
            lost: false,
        }
    }
}

impl<T: Copy + PartialEq + Debug> ReadingCheck<T> {
    fn cycle(
        &mut self,
        release: Nanos,
        mut sample: impl FnMut(Nanos) -> Result<Reading<T>, Error>,
    ) -> Option<T> {
        match sample(release) {
            Ok(reading) => {
                self.reading(release, reading);
                let again = sample(release);
                self.report.require(again == Ok(reading), "same-release-same-reading", || {
                    format!("at {release} first {reading:?}, then {again:?}")
                });
                Some(reading.value)
            }
            Err(error) => {
                self.report.error(&error);
                self.lost |= error.kind == ErrorKind::Lost;
                None
            }
        }
    }

    fn reading(&mut self, release: Nanos, reading: Reading<T>) {
        let acquired = reading.acquired;
        self.report.require(acquired <= release, "acquired-not-in-future", || {
            format!("acquired {acquired} at release {release}")
        });
        if let Some(last) = self.last {
            self.report.require(acquired >= last.acquired, "acquired-not-backwards", || {
                format!("acquired {acquired} after {}", last.acquired)
            });
        }
        self.report.require(!self.lost, "lost-is-final", || {
            format!("a reading at {release} after the half had reported itself lost")
        });
        self.first.get_or_insert(acquired);
        self.last = Some(reading);
        self.readings += 1;
    }

    fn finish(mut self) -> Vec<Violation> {
        self.report
            .require(self.readings > 0, "delivers", || "not one reading in all cycles".to_owned());
        let stuck = self.readings > 1 && self.first == self.last.map(|last| last.acquired);
        self.report.require(!stuck, "moves-on", || {
            format!("{} readings, all stamped {}", self.readings, self.first.unwrap_or_default())
        });
        self.report.found
    }
}

#[derive(Debug, Default)]
struct EncodersCheck(ReadingCheck<[Counts; CHANNELS]>, IndexPulses);

impl EncodersCheck {
    fn cycle(&mut self, device: &mut dyn Encoders, release: Nanos) {
        let joints = device.joints();
        let value = self.0.cycle(release, |at| device.sample(at));
        let report = &mut self.0.report;
        check_channels(report, joints, device.joints());
        for (joint, counts) in value.iter().flatten().enumerate().skip(joints) {
            report.require(*counts == Counts(0), "unused-channels-zero", || {
                format!("joint {joint} of {joints} reads {counts:?}")
            });
        }
        self.marks(device, joints);
    }

    fn marks(&mut self, device: &dyn Encoders, joints: usize) {
        let (report, marks) = (&mut self.0.report, device.index_pulses());
        report.require(device.has_index() || marks == [None; CHANNELS], "marks-announced", || {
            format!("{marks:?} from a board without index pulses")
        });
        for (joint, (mark, before)) in marks.iter().zip(self.1).enumerate() {
            report.require(joint < joints || mark.is_none(), "unused-channels-zero", || {
                format!("joint {joint} of {joints} has passed an index pulse at {mark:?}")
            });
            report.require(mark.is_some() || before.is_none(), "marks-stay", || {
                format!("the index pulse of joint {joint} is forgotten")
            });
        }
        self.1 = marks;
    }
}

#[derive(Debug, Default)]
struct DriveInCheck(ReadingCheck<[DriveActual; CHANNELS]>);

impl DriveInCheck {
    fn cycle(&mut self, device: &mut dyn DriveIn, release: Nanos) {
        let channels = device.channels();
        let value = self.0.cycle(release, |at| device.sample(at));
        let report = &mut self.0.report;
        check_channels(report, channels, device.channels());
        for (channel, actual) in value.iter().flatten().enumerate() {
            report.require(
                channel < channels || *actual == DriveActual::default(),
                "unused-channels-zero",
                || format!("drive {channel} of {channels} reports {actual:?}"),
            );
            report.require(
                actual.fault_code == 0 || actual.state == DriveState::Fault,
                "fault-code-with-fault",
                || format!("drive {channel} tells code {:#06x} without a fault", actual.fault_code),
            );
        }
    }

    fn finish(self) -> Vec<Violation> {
        self.0.finish()
    }
}

#[derive(Debug, Default)]
struct BoardClockCheck(ReadingCheck<Nanos>);

impl BoardClockCheck {
    fn cycle(&mut self, device: &mut dyn BoardClock, release: Nanos) {
        let cycle = device.cycle();
        let phase = self.0.cycle(release, |at| device.sample(at));
        let report = &mut self.0.report;
        report.require(cycle > Nanos::ZERO, "range-ordered", || format!("a cycle of {cycle}"));
        report.require(device.cycle() == cycle, "constants-constant", || {
            format!("the cycle was {cycle}, is {}", device.cycle())
        });
        let is_near = phase.is_none_or(|phase| (-cycle.0..=cycle.0).contains(&(2 * phase.0)));
        report.require(is_near, "phase-within-half-cycle", || {
            format!("a phase of {} in a cycle of {cycle}", phase.unwrap_or_default())
        });
    }
}

#[derive(Debug, Default)]
struct AnalogInCheck(ReadingCheck<[AdcCode; CHANNELS]>);

impl AnalogInCheck {
    fn cycle(&mut self, device: &mut dyn AnalogIn, release: Nanos) {
        let (channels, (low, high)) = (device.channels(), device.code_range());
        let value = self.0.cycle(release, |at| device.sample(at));
        let report = &mut self.0.report;
        check_channels(report, channels, device.channels());
        report.require(low < high, "range-ordered", || format!("code range {low:?} to {high:?}"));
        report.require(device.code_range() == (low, high), "constants-constant", || {
            format!("code range was {low:?} to {high:?}, is {:?}", device.code_range())
        });
        for (channel, code) in value.iter().flatten().enumerate() {
            if channel >= channels {
                report.require(*code == AdcCode(0), "unused-channels-zero", || {
                    format!("channel {channel} of {channels} reads {code:?}")
                });
            } else {
                report.require((low..=high).contains(code), "code-in-range", || {
                    format!("channel {channel} reads {code:?}, range {low:?} to {high:?}")
                });
            }
        }
    }
}

/// A count of channels must fit the arrays and stay what it is.
pub(super) fn check_channels(report: &mut Report, before: usize, after: usize) {
    report.require((1..=CHANNELS).contains(&before), "channels-in-bounds", || {
        format!("{before} channels; 1 to {CHANNELS} are possible")
    });
    report.require(before == after, "constants-constant", || {
        format!("{before} channels became {after}")
    });
}

/// What a tactile array says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ArrayShape {
    rows: usize,
    cols: usize,
    full_scale: u16,
}

impl ArrayShape {
    fn of(device: &dyn TactileArray) -> ArrayShape {
        let (rows, cols) = (device.rows(), device.cols());
        ArrayShape { rows, cols, full_scale: device.full_scale() }
    }
}

#[derive(Debug, Default)]
struct TactileCheck {
    report: Report,
    last: Option<TactileFrame>,
    lost: bool,
}

impl TactileCheck {
    fn cycle(&mut self, device: &mut dyn TactileArray, release: Nanos) {
        let shape = ArrayShape::of(device);
        self.shape(shape);
        self.foreign_frame(device, release, shape);
        let mut frame = poisoned_frame(shape);
        match device.sample(release, &mut frame) {
            Ok(Arrival::New) => {
                self.frame(release, shape, &frame);
                self.same_release(device, release, shape);
                self.last = Some(frame);
            }
            Ok(Arrival::Held) => self.untouched(&frame, shape, "Held"),
            Err(error) => {
                self.report.error(&error);
                self.lost |= error.kind == ErrorKind::Lost;
                self.untouched(&frame, shape, "an error");
            }
        }
        let after = ArrayShape::of(device);
        self.report.require(after == shape, "constants-constant", || {
            format!("{shape:?} became {after:?}")
        });
    }

    fn shape(&mut self, shape: ArrayShape) {
        let ArrayShape { rows, cols, full_scale } = shape;
        let fits = (1..=MAX_ROWS).contains(&rows) && (1..=MAX_ROWS).contains(&cols);
        self.report.require(fits, "channels-in-bounds", || {
            format!("{rows} rows x {cols} columns; {MAX_ROWS} of each fit")
        });
        self.report.require(full_scale > 0, "range-ordered", || "full scale is 0".to_owned());
    }

    fn frame(&mut self, release: Nanos, shape: ArrayShape, frame: &TactileFrame) {
        let report = &mut self.report;
        report.require(frame.acquired <= release, "acquired-not-in-future", || {
            format!("frame acquired {} at release {release}", frame.acquired)
        });
        for (row, acquired) in frame.row_acquired.iter().enumerate() {
            report.require(*acquired <= frame.acquired, "rows-before-frame", || {
                format!("row {row} read {acquired}, frame complete {}", frame.acquired)
            });
        }
        for (tactel, value) in frame.values.iter().enumerate() {
            report.require(*value <= shape.full_scale, "code-in-range", || {
                format!("tactel {tactel} reads {value}, full scale {}", shape.full_scale)
            });
        }
        report.require(!self.lost, "lost-is-final", || {
            format!("a frame at {release} after the half had reported itself lost")
        });
        if let Some(last) = &self.last {
            report.require(frame.acquired >= last.acquired, "acquired-not-backwards", || {
                format!("frame acquired {} after {}", frame.acquired, last.acquired)
            });
            let ahead = frame.sequence.wrapping_sub(last.sequence);
            report.require((1..1 << 31).contains(&ahead), "sequence-monotone", || {
                format!("frame {} after frame {}", frame.sequence, last.sequence)
            });
        }
    }

    /// A frame that was made for another array is refused and stays as it is.
    fn foreign_frame(&mut self, device: &mut dyn TactileArray, release: Nanos, shape: ArrayShape) {
        let other = ArrayShape { cols: shape.cols % MAX_ROWS + 1, ..shape };
        let mut frame = poisoned_frame(other);
        let answer = device.sample(release, &mut frame);
        let kind = answer.map_err(|error| error.kind);
        self.report.require(
            matches!(kind, Err(ErrorKind::OutOfRange | ErrorKind::Lost)),
            "foreign-frame-refused",
            || format!("a frame of {} columns was answered {answer:?}", other.cols),
        );
        self.untouched(&frame, other, "a frame for another array");
    }

    fn same_release(&mut self, device: &mut dyn TactileArray, release: Nanos, shape: ArrayShape) {
        let mut again = poisoned_frame(shape);
        let answer = device.sample(release, &mut again);
        self.report.require(answer == Ok(Arrival::Held), "held-when-nothing-new", || {
            format!("second call at {release} after a new frame answered {answer:?}")
        });
        if answer != Ok(Arrival::New) {
            self.untouched(&again, shape, "Held");
        }
    }

    fn untouched(&mut self, frame: &TactileFrame, shape: ArrayShape, answer: &str) {
        self.report.require(*frame == poisoned_frame(shape), "frame-untouched", || {
            format!("the caller's frame was changed together with {answer}")
        });
    }

    fn finish(mut self) -> Vec<Violation> {
        self.report
            .require(self.last.is_some(), "delivers", || "not one frame in all cycles".to_owned());
        self.report.found
    }
}

/// A frame that no device may leave behind: every field a device forgets to write breaks a rule.
fn poisoned_frame(shape: ArrayShape) -> TactileFrame {
    let mut frame = TactileFrame::new(shape.rows, shape.cols);
    frame.sequence = 0xaaaa_aaaa;
    frame.acquired = Nanos::MAX;
    frame.values.fill(0xaaaa);
    frame.valid.fill(true);
    frame.row_acquired.fill(Nanos::MAX);
    frame
}
