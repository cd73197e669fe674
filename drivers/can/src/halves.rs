//! The halves of a set of drives: positions, torques and lines, each by hal's traits.

use std::sync::Arc;

use taktil_drivers_exchange::{Failure, Half, Shared};
use taktil_hal::{
    AnalogOut, CHANNELS, Counts, DacCode, DigitalIn, DigitalOut, DriveActual, DriveCommand,
    DriveIn, DriveLoop, DriveOut, Encoders, Error, ErrorKind, LinesIn, LinesOut, Nanos, Reading,
};

use crate::bus::Bus;

const ENCODERS_NAME: &str = "can.encoders";
const ANALOG_OUT_NAME: &str = "can.analog_out";
const DRIVE_IN_NAME: &str = "can.drive_in";
const DRIVE_OUT_NAME: &str = "can.drive_out";
const DIGITAL_IN_NAME: &str = "can.digital_in";
const DIGITAL_OUT_NAME: &str = "can.digital_out";
/// No torque.
const SAFE_CODE: DacCode = DacCode(0);

/// Makes the answer of a half out of what the bus gave; a bus that another lane is in gives
/// nothing this time.
fn answer<T>(device: &'static str, outcome: Option<Result<T, Failure>>) -> Result<T, Error> {
    let outcome = outcome.unwrap_or(Err(Failure::whole(ErrorKind::Transient)));
    outcome.map_err(|failure| failure.of(device))
}

/// Positions of the drives.
#[derive(Debug)]
pub struct CanEncoders {
    pub(crate) shared: Arc<Shared<Bus>>,
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
    pub(crate) shared: Arc<Shared<Bus>>,
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
    pub(crate) shared: Arc<Shared<Bus>>,
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
        answer(ANALOG_OUT_NAME, self.shared.safe(Half::Motors))
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
        self.shared.end(Half::Motors);
    }
}

/// What the drives report.
#[derive(Debug)]
pub struct CanDriveIn {
    pub(crate) shared: Arc<Shared<Bus>>,
    pub(crate) drives: usize,
}

impl DriveIn for CanDriveIn {
    fn channels(&self) -> usize {
        self.drives
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[DriveActual; CHANNELS]>, Error> {
        let outcome = self.shared.with(|bus| bus.reports(release));
        let value = answer(DRIVE_IN_NAME, outcome)?;
        Ok(Reading { value, acquired: release })
    }
}

/// Commands to the drives: targets, and what is wanted of their power sections.
#[derive(Debug)]
pub struct CanDriveOut {
    pub(crate) shared: Arc<Shared<Bus>>,
    pub(crate) drives: usize,
    pub(crate) control_loop: DriveLoop,
    pub(crate) targets: (i32, i32),
    pub(crate) silence: Nanos,
}

impl DriveOut for CanDriveOut {
    fn channels(&self) -> usize {
        self.drives
    }

    fn control_loop(&self) -> DriveLoop {
        self.control_loop
    }

    fn target_range(&self) -> (i32, i32) {
        self.targets
    }

    fn commit(&mut self, release: Nanos, command: &DriveCommand) -> Result<(), Error> {
        let (low, high) = self.targets;
        let mut targets = command.targets.iter().take(self.drives);
        if let Some(channel) = targets.position(|target| !(low..=high).contains(target)) {
            let channel = channel as u16;
            return Err(Error::on_channel(ErrorKind::OutOfRange, DRIVE_OUT_NAME, channel));
        }
        answer(DRIVE_OUT_NAME, self.shared.with(|bus| bus.commit_drives(release, command)))
    }

    fn safe(&mut self) -> Result<(), Error> {
        answer(DRIVE_OUT_NAME, self.shared.safe(Half::Motors))
    }

    fn longest_silence(&self) -> Nanos {
        self.silence
    }
}

impl Drop for CanDriveOut {
    fn drop(&mut self) {
        self.shared.end(Half::Motors);
    }
}

/// Lines to the drives: enable, and brakes where a drive has an output for them.
#[derive(Debug)]
pub struct CanDigitalOut {
    pub(crate) shared: Arc<Shared<Bus>>,
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
