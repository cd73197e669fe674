//! The set of halves of one robot cell. The traits hide which implementation is inside.

use core::fmt;
use std::collections::BTreeMap;

use crate::analog::{AnalogIn, AnalogOut};
use crate::board_clock::BoardClock;
use crate::digital::{DigitalIn, DigitalOut};
use crate::drive::{DriveIn, DriveOut};
use crate::encoder::Encoders;
use crate::error::{Error, ErrorKind};
use crate::force_torque::ForceTorque;
use crate::tactile::TactileArray;

/// The name of the tactile array on the fingertip in [`Devices::tactile`].
pub const TACTILE: &str = "tactile";

/// The name of the array on a second fingertip opposed to the first.
pub const TACTILE_OPPOSED: &str = "tactile_opposed";

/// The halves that a robot cell has; each may go to a thread of its own.
#[derive(Default)]
pub struct Devices {
    /// Joint encoders.
    pub encoders: Option<Box<dyn Encoders>>,
    /// D/A converters of the motors' amplifiers.
    pub analog_out: Option<Box<dyn AnalogOut>>,
    /// Drives that close a loop themselves, in place of the converters of amplifiers.
    pub drive_out: Option<Box<dyn DriveOut>>,
    /// What those drives report.
    pub drive_in: Option<Box<dyn DriveIn>>,
    /// General A/D converters.
    pub analog_in: Option<Box<dyn AnalogIn>>,
    /// Tactile arrays by name: [`TACTILE`], [`TACTILE_OPPOSED`], or `tactile_NAME`.
    pub tactile: BTreeMap<String, Box<dyn TactileArray>>,
    /// The wrist's force/torque sensor.
    pub force_torque: Option<Box<dyn ForceTorque>>,
    /// Power and emergency-stop lines.
    pub digital_in: Option<Box<dyn DigitalIn>>,
    /// Enable, brake and watchdog lines.
    pub digital_out: Option<Box<dyn DigitalOut>>,
    /// The clock by which the machine may be paced.
    pub board_clock: Option<Box<dyn BoardClock>>,
}

impl Devices {
    /// Sends all output halves to their safe values; tries each even if another one fails.
    ///
    /// # Errors
    /// The first failure.
    pub fn safe(&mut self) -> Result<(), Error> {
        let lines = self.digital_out.as_mut().map_or(Ok(()), |half| half.safe());
        let codes = self.analog_out.as_mut().map_or(Ok(()), |half| half.safe());
        let drives = self.drive_out.as_mut().map_or(Ok(()), |half| half.safe());
        lines.and(codes).and(drives)
    }
}

/// A half that must be there; its absence is that of a device that is gone.
fn present<T: ?Sized>(half: &mut Option<Box<T>>) -> Result<&mut T, Error> {
    half.as_deref_mut().ok_or(Error::whole(ErrorKind::Lost, "a device without this half"))
}

impl Devices {
    /// The encoders.
    ///
    /// # Errors
    /// [`ErrorKind::Lost`] where there are none.
    pub fn require_encoders(&mut self) -> Result<&mut dyn Encoders, Error> {
        present(&mut self.encoders).map(|half| half as &mut dyn Encoders)
    }

    /// The D/A converters.
    ///
    /// # Errors
    /// [`ErrorKind::Lost`] where there are none.
    pub fn require_analog_out(&mut self) -> Result<&mut dyn AnalogOut, Error> {
        present(&mut self.analog_out).map(|half| half as &mut dyn AnalogOut)
    }

    /// The output half of the drives.
    ///
    /// # Errors
    /// [`ErrorKind::Lost`] where there is none.
    pub fn require_drive_out(&mut self) -> Result<&mut dyn DriveOut, Error> {
        present(&mut self.drive_out).map(|half| half as &mut dyn DriveOut)
    }

    /// The output lines.
    ///
    /// # Errors
    /// [`ErrorKind::Lost`] where there are none.
    pub fn require_digital_out(&mut self) -> Result<&mut dyn DigitalOut, Error> {
        present(&mut self.digital_out).map(|half| half as &mut dyn DigitalOut)
    }

    /// The tactile array of this name.
    ///
    /// # Errors
    /// [`ErrorKind::Lost`] where there is none.
    pub fn require_tactile(&mut self, name: &str) -> Result<&mut dyn TactileArray, Error> {
        match self.tactile.get_mut(name) {
            Some(array) => Ok(array.as_mut()),
            None => Err(Error::whole(ErrorKind::Lost, "a device without this array")),
        }
    }
}

impl fmt::Debug for Devices {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let arrays: Vec<_> =
            self.tactile.iter().map(|(name, array)| (name, array.rows(), array.cols())).collect();
        f.debug_struct("Devices")
            .field("encoders", &self.encoders.as_ref().map(|half| half.joints()))
            .field("analog_out", &self.analog_out.as_ref().map(|half| half.channels()))
            .field("drive_out", &self.drive_out.as_ref().map(|half| half.channels()))
            .field("drive_in", &self.drive_in.as_ref().map(|half| half.channels()))
            .field("analog_in", &self.analog_in.as_ref().map(|half| half.channels()))
            .field("tactile", &arrays)
            .field("force_torque", &self.force_torque.is_some())
            .field("digital_in", &self.digital_in.is_some())
            .field("digital_out", &self.digital_out.is_some())
            .field("board_clock", &self.board_clock.as_ref().map(|half| half.cycle()))
            .finish()
    }
}
