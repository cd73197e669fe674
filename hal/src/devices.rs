//! The set of halves of one robot cell. The traits hide which implementation is inside.

use core::fmt;

use crate::analog::{AnalogIn, AnalogOut};
use crate::digital::{DigitalIn, DigitalOut};
use crate::encoder::Encoders;
use crate::error::Error;
use crate::force_torque::ForceTorque;
use crate::tactile::TactileArray;

/// Seven halves, and one that not every cell has; each may go to a thread of its own.
pub struct Devices {
    /// Joint encoders.
    pub encoders: Box<dyn Encoders>,
    /// D/A converters of the motors' amplifiers.
    pub analog_out: Box<dyn AnalogOut>,
    /// General A/D converters.
    pub analog_in: Box<dyn AnalogIn>,
    /// The tactile array on the fingertip.
    pub tactile: Box<dyn TactileArray>,
    /// The tactile array on a second fingertip opposed to the first, where there is one.
    pub tactile_opposed: Option<Box<dyn TactileArray>>,
    /// The wrist's force/torque sensor.
    pub force_torque: Box<dyn ForceTorque>,
    /// Power and emergency-stop lines.
    pub digital_in: Box<dyn DigitalIn>,
    /// Enable, brake and watchdog lines.
    pub digital_out: Box<dyn DigitalOut>,
}

impl Devices {
    /// Sends both output halves to their safe values; tries both even if the first one fails.
    ///
    /// # Errors
    /// The first failure.
    pub fn safe(&mut self) -> Result<(), Error> {
        let lines = self.digital_out.safe();
        let codes = self.analog_out.safe();
        lines.and(codes)
    }
}

impl fmt::Debug for Devices {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Devices")
            .field("joints", &self.encoders.joints())
            .field("analog_out", &self.analog_out.channels())
            .field("analog_in", &self.analog_in.channels())
            .field("tactile_rows", &self.tactile.rows())
            .field("tactile_cols", &self.tactile.cols())
            .finish_non_exhaustive()
    }
}
