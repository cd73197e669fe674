//! A six-axis force/torque sensor's raw gauges. The calibration matrix that turns them into newtons
//! belongs to the software above.

use crate::analog::AdcCode;
use crate::error::Error;
use crate::reading::Reading;
use crate::time::Nanos;

/// How many gauge channels a six-axis sensor has.
pub const FORCE_TORQUE_CHANNELS: usize = 6;

/// What the gauges of a sensor gave in one conversion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GaugeCodes {
    /// The code of each gauge, before any calibration.
    pub codes: [AdcCode; FORCE_TORQUE_CHANNELS],
    /// Where the converter stood at an end of its range: the load is at least that of the code, and
    /// nobody knows by how much it is more. The wrench of all gauges is unknown then, because each
    /// gauge enters all of its components.
    pub over_range: [bool; FORCE_TORQUE_CHANNELS],
}

impl GaugeCodes {
    /// Codes of converters that all go from `low` to `high`.
    #[must_use]
    pub fn within(
        low: AdcCode,
        high: AdcCode,
        codes: [AdcCode; FORCE_TORQUE_CHANNELS],
    ) -> GaugeCodes {
        GaugeCodes { codes, over_range: codes.map(|code| code <= low || code >= high) }
    }

    /// Whether every gauge was within its converter's range.
    #[must_use]
    pub fn is_within_range(&self) -> bool {
        self.over_range == [false; FORCE_TORQUE_CHANNELS]
    }
}

/// The input half of a force/torque sensor.
pub trait ForceTorque: Send {
    /// The longest that a call waits for the device or the kernel, beside its own processor time:
    /// the analysis of the schedule counts it as part of the job; constant.
    fn longest_wait(&self) -> Nanos {
        Nanos::ZERO
    }

    /// All gauges' codes, from one conversion, before any calibration, and which of them stood at
    /// an end of its converter's range.
    ///
    /// A second call with the same `release` gives the same reading.
    ///
    /// # Errors
    /// [`Transient`](crate::ErrorKind::Transient): no untorn set within the driver's bounded
    /// retries. [`Stale`](crate::ErrorKind::Stale): the sensor's link has fallen silent.
    /// [`Lost`](crate::ErrorKind::Lost): the board is gone.
    fn sample(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_of_the_range_are_over_range_and_nothing_else_is() {
        let codes = [-2048, -2047, 0, 2046, 2047, 1].map(AdcCode);
        let gauges = GaugeCodes::within(AdcCode(-2048), AdcCode(2047), codes);
        assert_eq!(gauges.over_range, [true, false, false, false, true, false]);
        assert!(!gauges.is_within_range() && GaugeCodes::default().is_within_range());
    }
}
