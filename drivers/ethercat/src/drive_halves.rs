//! The halves of the drives of a segment: what they report, and the commands to those that close a
//! loop themselves.

use std::sync::Arc;

use taktil_drivers_exchange::{Half, Shared};
use taktil_hal::{
    CHANNELS, DriveActual, DriveCommand, DriveIn, DriveLoop, DriveOut, Error, ErrorKind, Nanos,
    Reading,
};

use crate::bus::Bus;
use crate::halves::{Input, Output, OutputTimes};

const DRIVE_IN_NAME: &str = "ethercat.drive_in";
const DRIVE_OUT_NAME: &str = "ethercat.drive_out";

/// What the drives report.
#[derive(Debug)]
pub struct EthercatDriveIn {
    input: Input,
    drives: usize,
}

impl EthercatDriveIn {
    pub(crate) fn new(shared: Arc<Shared<Bus>>, drives: usize, wait: Nanos) -> EthercatDriveIn {
        EthercatDriveIn { input: Input::new(shared, DRIVE_IN_NAME, wait), drives }
    }
}

impl DriveIn for EthercatDriveIn {
    fn channels(&self) -> usize {
        self.drives
    }

    fn longest_wait(&self) -> Nanos {
        self.input.wait
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[DriveActual; CHANNELS]>, Error> {
        self.input.sample(release, |snapshot| snapshot.drives)
    }
}

/// What the drives of a segment take alike.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DriveTargets {
    pub(crate) drives: usize,
    pub(crate) control_loop: DriveLoop,
    pub(crate) low: i32,
    pub(crate) high: i32,
}

/// The commands to drives, all in one mode.
#[derive(Debug)]
pub struct EthercatDriveOut {
    output: Output,
    targets: DriveTargets,
}

impl EthercatDriveOut {
    pub(crate) fn new(
        shared: Arc<Shared<Bus>>,
        targets: DriveTargets,
        times: OutputTimes,
    ) -> EthercatDriveOut {
        let output = Output::new(shared, Half::Motors, DRIVE_OUT_NAME, times);
        EthercatDriveOut { output, targets }
    }
}

impl DriveOut for EthercatDriveOut {
    fn channels(&self) -> usize {
        self.targets.drives
    }

    fn control_loop(&self) -> DriveLoop {
        self.targets.control_loop
    }

    fn target_range(&self) -> (i32, i32) {
        (self.targets.low, self.targets.high)
    }

    fn longest_wait(&self) -> Nanos {
        self.output.longest_wait()
    }

    fn commit(&mut self, release: Nanos, command: &DriveCommand) -> Result<(), Error> {
        let range = self.targets.low..=self.targets.high;
        let mut word = DriveCommand { targets: [0; CHANNELS], ..*command };
        let wired = word.targets.iter_mut().zip(command.targets).take(self.targets.drives);
        for (channel, (slot, target)) in (0_u16..).zip(wired) {
            if !range.contains(&target) {
                return Err(Error::on_channel(ErrorKind::OutOfRange, DRIVE_OUT_NAME, channel));
            }
            *slot = target;
        }
        self.output.act(|bus| bus.commit_drives(release, &word))
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.output.safe()
    }

    fn longest_silence(&self) -> Nanos {
        self.output.times.longest_silence
    }
}

impl Drop for EthercatDriveOut {
    fn drop(&mut self) {
        let _ = self.output.safe();
    }
}
