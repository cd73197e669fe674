//! The halves of a set of drives: positions, torques and lines, each by hal's traits.

use taktil_hal::{
    AnalogOut, CHANNELS, Counts, DacCode, DigitalIn, DigitalOut, Encoders, Error, ErrorKind,
    LinesIn, LinesOut, Nanos, Reading,
};

use crate::bus::{Failure, Half};
use crate::sharing::Shared;

const ENCODERS_NAME: &str = "can.encoders";
const ANALOG_OUT_NAME: &str = "can.analog_out";
const DIGITAL_IN_NAME: &str = "can.digital_in";
const DIGITAL_OUT_NAME: &str = "can.digital_out";
/// No torque.
const SAFE_CODE: DacCode = DacCode(0);

/// Makes the answer of a half out of what the bus gave; a bus that another lane is in gives
/// nothing this time.
fn answer<T>(device: &'static str, outcome: Option<Result<T, Failure>>) -> Result<T, Error> {
    let outcome = outcome.unwrap_or(Err(Failure { kind: ErrorKind::Transient, channel: None }));
    outcome.map_err(|failure| Error {
        kind: failure.kind,
        device,
        channel: failure.channel.unwrap_or(Error::ALL_CHANNELS),
    })
}

/// Positions of the drives.
#[derive(Debug)]
pub struct CanEncoders {
    pub(crate) shared: Shared,
    pub(crate) joints: usize,
    pub(crate) wait: Nanos,
}

impl CanEncoders {
    /// Asks the drives early in the job released at `release`; the half that is sampled later
    /// collects their answers.
    pub fn request(&self, release: Nanos) {
        let _ = self.shared.with(|bus| bus.request(release));
    }
}

impl Encoders for CanEncoders {
    fn longest_wait(&self) -> Nanos {
        self.wait
    }

    fn joints(&self) -> usize {
        self.joints
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let outcome = self.shared.with(|bus| bus.positions(release));
        let value = answer(ENCODERS_NAME, outcome)?;
        Ok(Reading { value, acquired: release })
    }
}

/// Lines that the states of the drives make up: power, and no fault.
#[derive(Debug)]
pub struct CanDigitalIn {
    pub(crate) shared: Shared,
}

impl DigitalIn for CanDigitalIn {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        let outcome = self.shared.with(|bus| bus.lines(release));
        let value = answer(DIGITAL_IN_NAME, outcome)?;
        Ok(Reading { value, acquired: release })
    }
}

/// Torques of the drives.
#[derive(Debug)]
pub struct CanAnalogOut {
    pub(crate) shared: Shared,
    pub(crate) channels: usize,
    pub(crate) torque_max: i32,
    pub(crate) silence: Nanos,
}

impl AnalogOut for CanAnalogOut {
    fn channels(&self) -> usize {
        self.channels
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        (DacCode(-self.torque_max), DacCode(self.torque_max))
    }

    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let (low, high) = self.code_range();
        for (channel, code) in codes.iter().take(self.channels).enumerate() {
            if !(low..=high).contains(code) {
                let channel = channel as u16;
                return Err(Error::on_channel(ErrorKind::OutOfRange, ANALOG_OUT_NAME, channel));
            }
        }
        answer(ANALOG_OUT_NAME, self.shared.with(|bus| bus.commit_torques(release, codes)))
    }

    fn safe(&mut self) -> Result<(), Error> {
        answer(ANALOG_OUT_NAME, self.shared.safe(Half::Torques))
    }

    fn safe_value(&self) -> DacCode {
        SAFE_CODE
    }

    fn longest_silence(&self) -> Nanos {
        self.silence
    }
}

impl Drop for CanAnalogOut {
    fn drop(&mut self) {
        self.shared.end(Half::Torques);
    }
}

/// Lines to the drives: enable, and brakes where a drive has an output for them.
#[derive(Debug)]
pub struct CanDigitalOut {
    pub(crate) shared: Shared,
    pub(crate) silence: Nanos,
}

impl DigitalOut for CanDigitalOut {
    fn commit(&mut self, release: Nanos, lines: &LinesOut) -> Result<(), Error> {
        answer(DIGITAL_OUT_NAME, self.shared.with(|bus| bus.commit_lines(release, lines)))
    }

    fn safe(&mut self) -> Result<(), Error> {
        answer(DIGITAL_OUT_NAME, self.shared.safe(Half::Lines))
    }

    fn longest_silence(&self) -> Nanos {
        self.silence
    }
}

impl Drop for CanDigitalOut {
    fn drop(&mut self) {
        self.shared.end(Half::Lines);
    }
}
