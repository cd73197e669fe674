//! The halves of a segment: encoders, analog channels and lines, each by hal's traits.

use std::ops::RangeInclusive;
use std::sync::Arc;

use taktil_drivers_exchange::{Failure, Half, Presence, Shared};
use taktil_hal::{
    AdcCode, AnalogIn, AnalogOut, CHANNELS, Counts, DacCode, DigitalIn, DigitalOut, Encoders,
    Error, ErrorKind, LinesIn, LinesOut, Nanos, Reading,
};

use crate::bus::{Bus, Snapshot, words_in_range};
use crate::health::Diagnostics;
use crate::wiring::{TERMINAL_CODE_MAX, TERMINAL_CODE_MIN};

const ENCODERS_NAME: &str = "ethercat.encoders";
const ANALOG_OUT_NAME: &str = "ethercat.analog_out";
const ANALOG_IN_NAME: &str = "ethercat.analog_in";
const DIGITAL_IN_NAME: &str = "ethercat.digital_in";
const DIGITAL_OUT_NAME: &str = "ethercat.digital_out";

/// No torque, no speed, no volts.
const SAFE_CODE: DacCode = DacCode(0);

/// Tells what was counted; it is no device half. A copy may stand on any thread: what it tells is
/// read without entering the segment, and disturbs no lane.
#[derive(Clone, Debug)]
pub struct SegmentMonitor {
    shared: Arc<Shared<Bus>>,
}

impl SegmentMonitor {
    pub(crate) fn new(shared: Arc<Shared<Bus>>) -> SegmentMonitor {
        SegmentMonitor { shared }
    }

    /// What had happened when a half left the segment last. Each number is whole; two of them may
    /// be a cycle apart.
    #[must_use]
    pub fn diagnostics(&self) -> Diagnostics {
        self.shared.shown().load()
    }
}

/// What an input half needs for its answers.
#[derive(Debug)]
pub(crate) struct Input {
    shared: Arc<Shared<Bus>>,
    device: &'static str,
    pub(crate) wait: Nanos,
    presence: Presence,
}

impl Input {
    pub(crate) fn new(shared: Arc<Shared<Bus>>, device: &'static str, wait: Nanos) -> Input {
        Input { shared, device, wait, presence: Presence::default() }
    }

    pub(crate) fn sample<T>(
        &mut self,
        release: Nanos,
        part: impl FnOnce(&Snapshot) -> T,
    ) -> Result<Reading<T>, Error> {
        let outcome = self.shared.with(|bus| bus.sample(release));
        let snapshot = self.presence.answer(self.device, outcome)?;
        Ok(Reading { value: part(&snapshot), acquired: snapshot.acquired })
    }
}

/// The encoders of drives or of terminals.
#[derive(Debug)]
pub struct EthercatEncoders {
    input: Input,
    joints: usize,
}

impl EthercatEncoders {
    pub(crate) fn new(shared: Arc<Shared<Bus>>, joints: usize, wait: Nanos) -> EthercatEncoders {
        EthercatEncoders { input: Input::new(shared, ENCODERS_NAME, wait), joints }
    }
}

impl Encoders for EthercatEncoders {
    fn joints(&self) -> usize {
        self.joints
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        self.input.sample(release, |snapshot| snapshot.counts)
    }

    fn longest_wait(&self) -> Nanos {
        self.input.wait
    }
}

/// The channels of analog input terminals.
#[derive(Debug)]
pub struct EthercatAnalogIn {
    input: Input,
    channels: usize,
}

impl EthercatAnalogIn {
    pub(crate) fn new(shared: Arc<Shared<Bus>>, channels: usize, wait: Nanos) -> EthercatAnalogIn {
        EthercatAnalogIn { input: Input::new(shared, ANALOG_IN_NAME, wait), channels }
    }
}

impl AnalogIn for EthercatAnalogIn {
    fn channels(&self) -> usize {
        self.channels
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        (AdcCode(TERMINAL_CODE_MIN), AdcCode(TERMINAL_CODE_MAX))
    }

    fn longest_wait(&self) -> Nanos {
        self.input.wait
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        self.input.sample(release, |snapshot| snapshot.codes)
    }
}

/// Lines from the cell, at terminals or as drives report them.
#[derive(Debug)]
pub struct EthercatDigitalIn {
    input: Input,
}

impl EthercatDigitalIn {
    pub(crate) fn new(shared: Arc<Shared<Bus>>, wait: Nanos) -> EthercatDigitalIn {
        EthercatDigitalIn { input: Input::new(shared, DIGITAL_IN_NAME, wait) }
    }
}

impl DigitalIn for EthercatDigitalIn {
    fn longest_wait(&self) -> Nanos {
        self.input.wait
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        self.input.sample(release, |snapshot| snapshot.lines)
    }
}

/// How long an output half lives without a commit, and how long a commit may wait.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OutputTimes {
    pub(crate) longest_silence: Nanos,
    pub(crate) wait: Nanos,
}

/// What an output half needs for its answers.
#[derive(Debug)]
pub(crate) struct Output {
    shared: Arc<Shared<Bus>>,
    half: Half,
    device: &'static str,
    pub(crate) times: OutputTimes,
    presence: Presence,
}

impl Output {
    pub(crate) fn new(
        shared: Arc<Shared<Bus>>,
        half: Half,
        device: &'static str,
        times: OutputTimes,
    ) -> Output {
        Output { shared, half, device, times, presence: Presence::default() }
    }

    /// Acts on the segment.
    pub(crate) fn act(
        &mut self,
        act: impl FnOnce(&mut Bus) -> Result<(), Failure>,
    ) -> Result<(), Error> {
        let outcome = self.shared.with(act);
        self.presence.answer(self.device, outcome)
    }

    /// The lines commit last and wait for the exchange, where there are some; otherwise targets or
    /// volts do.
    pub(crate) fn longest_wait(&self) -> Nanos {
        match self.half == Half::Motors && self.shared.shown().has_lines() {
            true => Nanos::ZERO,
            false => self.times.wait,
        }
    }

    pub(crate) fn safe(&mut self) -> Result<(), Error> {
        // The wish stays until somebody heard it: this call, or whoever is on the segment.
        self.presence.answer(self.device, self.shared.safe(self.half))
    }
}

/// Targets of drives, or analog output terminals.
#[derive(Debug)]
pub struct EthercatAnalogOut {
    output: Output,
    channels: usize,
    range: RangeInclusive<DacCode>,
}

impl EthercatAnalogOut {
    pub(crate) fn new(
        shared: Arc<Shared<Bus>>,
        channels: usize,
        range: RangeInclusive<DacCode>,
        times: OutputTimes,
    ) -> EthercatAnalogOut {
        let output = Output::new(shared, Half::Motors, ANALOG_OUT_NAME, times);
        EthercatAnalogOut { output, channels, range }
    }
}

impl AnalogOut for EthercatAnalogOut {
    fn channels(&self) -> usize {
        self.channels
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        (*self.range.start(), *self.range.end())
    }

    fn longest_wait(&self) -> Nanos {
        self.output.longest_wait()
    }

    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let words = words_in_range(codes, self.channels, &self.range).map_err(|channel| {
            Error::on_channel(ErrorKind::OutOfRange, ANALOG_OUT_NAME, channel)
        })?;
        self.output.act(|bus| bus.commit_codes(release, &words))
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.output.safe()
    }

    fn safe_value(&self) -> DacCode {
        SAFE_CODE
    }

    fn longest_silence(&self) -> Nanos {
        self.output.times.longest_silence
    }
}

impl Drop for EthercatAnalogOut {
    fn drop(&mut self) {
        let _ = self.output.safe();
    }
}

/// Lines to the cell, at terminals or the drives' enable.
#[derive(Debug)]
pub struct EthercatDigitalOut {
    output: Output,
}

impl EthercatDigitalOut {
    pub(crate) fn new(shared: Arc<Shared<Bus>>, times: OutputTimes) -> EthercatDigitalOut {
        shared.with(|bus| bus.set_lines(true));
        EthercatDigitalOut { output: Output::new(shared, Half::Lines, DIGITAL_OUT_NAME, times) }
    }
}

impl DigitalOut for EthercatDigitalOut {
    fn longest_wait(&self) -> Nanos {
        self.output.longest_wait()
    }

    fn commit(&mut self, release: Nanos, lines: &LinesOut) -> Result<(), Error> {
        self.output.act(|bus| bus.commit_lines(release, lines))
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.output.safe()
    }

    fn longest_silence(&self) -> Nanos {
        self.output.times.longest_silence
    }
}

impl Drop for EthercatDigitalOut {
    fn drop(&mut self) {
        let _ = self.output.safe();
        self.output.shared.with(|bus| bus.set_lines(false));
    }
}
