//! One cycle with the boards of a robot: time, lines, counts, codes. Whatever fails leaves the
//! outputs safe.

use taktil_hal::{CHANNELS, DacCode, Devices, Error, ErrorKind, LinesIn, LinesOut, Nanos};

use crate::stop::Stop;

/// Reads, or writes, in a row that may fail before the outputs are kept safe until one succeeds.
const FAILURES_MAX: u32 = 2;
/// For how long they may fail before the robot is stopped: a board on a network that finds its way
/// back after its watchdog has bitten takes some cycles (s).
const FAILING_S: f64 = 0.3;

/// Lets time pass: until a release of the cycle, on a clock or in a simulated world.
pub trait Pace {
    /// Returns at or after `release`, with the instant that it is then.
    fn wait_until(&mut self, release: Nanos) -> Nanos;
}

/// How well the cycles kept their time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Punctuality {
    /// Cycles that were begun.
    pub cycles: u64,
    /// Releases that had passed before their cycle could begin, and were left out.
    pub left_out: u64,
    /// The longest time from a release to the beginning of its cycle.
    pub latest: Nanos,
    /// Cycles in which a board did not answer, or did not take its outputs.
    pub failed: u64,
    /// Pulses that were given again, because a cycle within them was late or failed.
    pub repeated_pulses: u64,
}

impl Punctuality {
    /// Whether nothing was late and nothing failed.
    #[must_use]
    pub fn is_perfect(&self) -> bool {
        self.left_out == 0 && self.failed == 0
    }
}

/// What the encoders say, as if their counters never wrapped; 0 at the first cycle.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sample {
    pub(crate) counts: [i64; CHANNELS],
    /// Counts at the newest index pulses.
    pub(crate) pulses: [Option<i64>; CHANNELS],
    /// When they were asked.
    pub(crate) at: Nanos,
    /// What was put out did not act for one cycle since the sample before, or the counts are not
    /// new: the cycle began too late, or a board failed.
    pub(crate) is_disturbed: bool,
}

/// What the boards are told in one cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Drive {
    /// No torque, brakes on.
    Safe,
    /// No torque, brakes lifted.
    Loose,
    /// Codes on the converters, brakes lifted.
    Codes([i32; CHANNELS]),
}

/// The boards of a robot in their cycle.
pub struct Cell<'a> {
    devices: Devices,
    pace: &'a mut dyn Pace,
    period: Nanos,
    release: Nanos,
    feed: bool,
    first: Option<[i32; CHANNELS]>,
    latest: [i32; CHANNELS],
    sample: Sample,
    /// Failures in a row of reads and of writes.
    read_failures: u32,
    write_failures: u32,
    pub(crate) punctuality: Punctuality,
    /// How many encoders and converters there are.
    pub(crate) encoders: usize,
    pub(crate) motors: usize,
    /// Largest code in both directions.
    pub(crate) code_max: i32,
    pub(crate) has_index: bool,
    /// How much finer than the coarsest each encoder has shown to be: limits of pulses in counts
    /// are as many times as wide.
    pub(crate) fineness: [i64; CHANNELS],
    /// How far the pulses of each motor have left a joint to one side that moves in each pulse as
    /// far as its bound allows for, in parts of that bound.
    pub(crate) left_share: [f64; CHANNELS],
}

fn missing(what: &str) -> Stop {
    Stop::new(
        format!("there is no device for the robot's {what}"),
        "name one with `[device.NAME]` in the machine file",
    )
}

impl<'a> Cell<'a> {
    /// The boards `devices`, which are put into their safe state, with a cycle of `period` whose
    /// first release is `first`.
    ///
    /// # Errors
    /// A half that is missing or does not go safe.
    pub fn new(
        mut devices: Devices,
        pace: &'a mut dyn Pace,
        period: Nanos,
        first: Nanos,
    ) -> Result<Cell<'a>, Stop> {
        let encoders = devices.encoders.as_ref().ok_or_else(|| missing("encoders"))?;
        let (wired, has_index) = (encoders.joints(), encoders.has_index());
        let outputs = devices.analog_out.as_ref().ok_or_else(|| missing("analog outputs"))?;
        let (low, high) = outputs.code_range();
        let motors = outputs.channels();
        if devices.digital_out.is_none() || devices.digital_in.is_none() {
            return Err(missing("lines (power, emergency stop, enable, brakes)"));
        }
        devices.safe().map_err(|bad| Stop::of_device(&bad))?;
        Ok(Cell {
            devices,
            pace,
            period,
            release: first,
            feed: false,
            first: None,
            latest: [0; CHANNELS],
            sample: Sample::default(),
            read_failures: 0,
            write_failures: 0,
            punctuality: Punctuality::default(),
            encoders: wired.min(CHANNELS),
            motors: motors.min(CHANNELS),
            code_max: high.0.min(low.0.saturating_neg()),
            has_index,
            fineness: [1; CHANNELS],
            left_share: [0.0; CHANNELS],
        })
    }

    /// Time between two cycles (s).
    pub(crate) fn period_s(&self) -> f64 {
        self.period.as_secs_f64()
    }

    /// What the encoders said in the latest cycle.
    pub(crate) fn counts(&self) -> [i64; CHANNELS] {
        self.sample.counts
    }

    /// How many cycles a time takes.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "short times")]
    pub(crate) fn cycles(&self, time_s: f64) -> usize {
        libm::ceil(time_s / self.period_s()) as usize
    }

    /// Waits for the next release and reads the boards.
    ///
    /// # Errors
    /// A line that does not allow motion, or a board that does not answer; the outputs are safe.
    pub(crate) fn sample(&mut self) -> Result<Sample, Stop> {
        let now = self.pace.wait_until(self.release);
        let late = (now - self.release).max(Nanos::ZERO);
        // Releases that have passed are left out: cycles that are made up in a hurry would last
        // shorter than they say.
        let passed = late.0 / self.period.0.max(1);
        self.release += self.period * passed;
        let seen = &mut self.punctuality;
        (seen.cycles, seen.latest) = (seen.cycles + 1, seen.latest.max(late));
        seen.left_out += passed.unsigned_abs();
        (self.sample.at, self.sample.is_disturbed) = (now, passed > 0 || self.write_failures > 0);
        match self.read() {
            Ok(()) => self.read_failures = 0,
            Err(Failure::Device(error)) => {
                self.read_failures += 1;
                self.bear(error, self.read_failures)?;
            }
            Err(Failure::Line(stop)) => return Err(self.fail(stop)),
        }
        Ok(self.sample)
    }

    /// Bears a failure that passes, `count` of them in a row.
    fn bear(&mut self, error: Error, count: u32) -> Result<(), Stop> {
        let most = FAILURES_MAX.max(u32::try_from(self.cycles(FAILING_S)).unwrap_or(u32::MAX));
        let passes = matches!(error.kind, ErrorKind::Transient | ErrorKind::Stale);
        if !passes || count > most {
            return Err(self.fail(Stop::of_device(&error)));
        }
        self.punctuality.failed += 1;
        self.sample.is_disturbed = true;
        Ok(())
    }

    fn read(&mut self) -> Result<(), Failure> {
        let lines = match self.devices.digital_in.as_mut() {
            Some(half) => half.sample(self.release)?.value,
            None => LinesIn::default(),
        };
        check_lines(lines).map_err(Failure::Line)?;
        let counts = self.devices.require_encoders()?.sample(self.release)?.value;
        let counts = counts.map(|count| count.0);
        if self.first.is_none() {
            self.first = Some(counts);
            self.latest = counts;
        }
        for (i, count) in counts.into_iter().enumerate() {
            self.sample.counts[i] += i64::from(count.wrapping_sub(self.latest[i]));
            self.latest[i] = count;
        }
        if self.has_index {
            let pulses = self.devices.require_encoders()?.index_pulses();
            for (i, pulse) in pulses.into_iter().enumerate() {
                let back = |pulse: i32| i64::from(self.latest[i].wrapping_sub(pulse));
                self.sample.pulses[i] = pulse.map(|pulse| self.sample.counts[i] - back(pulse.0));
            }
        }
        Ok(())
    }

    /// Writes the outputs of this cycle.
    ///
    /// # Errors
    /// A board that does not take them; the outputs are safe.
    pub(crate) fn commit(&mut self, drive: Drive) -> Result<(), Stop> {
        // Nobody drives blind.
        let drive = if self.read_failures > FAILURES_MAX { Drive::Safe } else { drive };
        match self.write(drive) {
            Ok(()) => self.write_failures = 0,
            Err(error) => {
                self.write_failures += 1;
                self.bear(error, self.write_failures)?;
            }
        }
        self.release += self.period;
        Ok(())
    }

    /// How well the cycles have kept their time so far.
    #[must_use]
    pub fn punctuality(&self) -> Punctuality {
        self.punctuality
    }

    /// The longest silence after which the boards' outputs go safe by themselves, which bounds a
    /// pulse that this program cannot end in time.
    #[must_use]
    pub fn longest_silence(&self) -> Option<Nanos> {
        self.devices.analog_out.as_ref().map(|half| half.longest_silence())
    }

    fn write(&mut self, drive: Drive) -> Result<(), Error> {
        self.feed = !self.feed;
        let (enable, brake_release) = match drive {
            Drive::Safe => (false, false),
            Drive::Loose => (false, true),
            Drive::Codes(_) => (true, true),
        };
        let lines = LinesOut { enable, brake_release, watchdog_feed: self.feed };
        let most = self.code_max;
        let release = self.release;
        let outputs = self.devices.require_analog_out()?;
        let mut codes = [outputs.safe_value(); CHANNELS];
        if let Drive::Codes(wanted) = drive {
            codes = wanted.map(|code| DacCode(code.clamp(-most, most)));
        }
        outputs.commit(release, &codes)?;
        self.devices.require_digital_out()?.commit(release, &lines)
    }

    /// One cycle in which the codes do not depend on the counts.
    pub(crate) fn step(&mut self, drive: Drive) -> Result<Sample, Stop> {
        let sample = self.sample()?;
        self.commit(drive)?;
        Ok(sample)
    }

    /// Stands still with the brakes on.
    pub(crate) fn rest(&mut self, time_s: f64) -> Result<Sample, Stop> {
        let mut sample = self.step(Drive::Safe)?;
        for _ in 1..self.cycles(time_s) {
            sample = self.step(Drive::Safe)?;
        }
        Ok(sample)
    }

    /// Puts the outputs into their safe state and hands the reason on.
    pub(crate) fn fail(&mut self, stop: Stop) -> Stop {
        match self.devices.safe() {
            Ok(()) => stop,
            Err(bad) => Stop::new(
                format!("{}; and the outputs did not go safe: {bad}", stop.reason),
                "press the emergency stop",
            ),
        }
    }
}

impl Drop for Cell<'_> {
    fn drop(&mut self) {
        // Who drops the cell cannot hear of a failure; the halves write their safe values as well.
        let _ = self.devices.safe();
    }
}

enum Failure {
    Device(Error),
    Line(Stop),
}

impl From<Error> for Failure {
    fn from(error: Error) -> Failure {
        Failure::Device(error)
    }
}

fn check_lines(lines: LinesIn) -> Result<(), Stop> {
    if lines.estop_a_closed != lines.estop_b_closed {
        let what = "the two channels of the emergency stop disagree";
        return Err(Stop::new(what, "look at its wiring: nothing may move before they agree"));
    }
    if !lines.estop_a_closed {
        let what = "the emergency stop is pressed, or its line is broken";
        return Err(Stop::new(what, "release it, look at both channels, then begin anew"));
    }
    if !lines.drive_power {
        let what = "the drives have no power";
        return Err(Stop::new(what, "switch the drives' supply on and look at its line"));
    }
    Ok(())
}
