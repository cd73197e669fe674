//! The halves of the simulated drives, each with one end of a stamped link to the world.

use taktil_hal::link::{Receiver, Sender, link};
use taktil_hal::{
    CHANNELS, Devices, DriveActual, DriveCommand, DriveIn, DriveLoop, DriveOut, Error, ErrorKind,
    Nanos, Reading,
};

use super::DriveSpec;
use crate::devices::{DelayedOutput, LINK_CAPACITY, LONGEST_SILENCE, NewestReading};

const DRIVE_IN: &str = "sim.drive_in";
const DRIVE_OUT: &str = "sim.drive_out";

/// The world's ends of the links.
#[derive(Debug)]
pub(crate) struct DriveLinks {
    pub(crate) commands: Receiver<DriveCommand>,
    pub(crate) reports: Sender<[DriveActual; CHANNELS]>,
}

impl DriveLinks {
    /// Ends of links whose other ends do not exist.
    pub(crate) fn disconnected() -> DriveLinks {
        DriveLinks { commands: link(1).1, reports: link(1).0 }
    }
}

/// Puts the halves of drives into `devices`, in place of the converters.
pub(crate) fn connect_drives(delay: Nanos, spec: DriveSpec, devices: &mut Devices) -> DriveLinks {
    let (commands_tx, commands) = link(LINK_CAPACITY);
    let (reports, reports_rx) = link(LINK_CAPACITY);
    devices.analog_out = None;
    devices.drive_out =
        Some(Box::new(SimDriveOut { order: DelayedOutput::new(commands_tx, delay), spec }));
    devices.drive_in = Some(Box::new(SimDriveIn {
        reports: NewestReading::new(reports_rx, DRIVE_IN),
        drives: spec.joints,
    }));
    DriveLinks { commands, reports }
}

struct SimDriveIn {
    reports: NewestReading<[DriveActual; CHANNELS]>,
    drives: usize,
}

impl DriveIn for SimDriveIn {
    fn channels(&self) -> usize {
        self.drives
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[DriveActual; CHANNELS]>, Error> {
        self.reports.sample(release)
    }
}

struct SimDriveOut {
    order: DelayedOutput<DriveCommand>,
    spec: DriveSpec,
}

impl DriveOut for SimDriveOut {
    fn channels(&self) -> usize {
        self.spec.joints
    }

    fn control_loop(&self) -> DriveLoop {
        self.spec.control_loop
    }

    fn target_range(&self) -> (i32, i32) {
        self.spec.target_range()
    }

    fn commit(&mut self, release: Nanos, command: &DriveCommand) -> Result<(), Error> {
        let (low, high) = self.spec.target_range();
        let mut word = DriveCommand { targets: [0; CHANNELS], ..*command };
        let wired = word.targets.iter_mut().zip(command.targets).take(self.spec.joints);
        for (channel, (slot, target)) in wired.enumerate() {
            if !(low..=high).contains(&target) {
                return Err(Error::on_channel(ErrorKind::OutOfRange, DRIVE_OUT, channel as u16));
            }
            *slot = target;
        }
        self.order.send(word, release, DRIVE_OUT)
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.order.send_now(DriveCommand::SAFE, DRIVE_OUT)
    }

    fn longest_silence(&self) -> Nanos {
        LONGEST_SILENCE
    }
}

impl Drop for SimDriveOut {
    fn drop(&mut self) {
        // The link is full only when the world has stopped; then nothing is left to make safe.
        let _ = self.safe();
    }
}
