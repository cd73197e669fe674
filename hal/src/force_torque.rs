//! A six-axis force/torque sensor's raw gauges. The calibration matrix that turns them into newtons
//! belongs to the software above.

use crate::analog::AdcCode;
use crate::error::Error;
use crate::reading::Reading;
use crate::time::Nanos;

/// How many gauge channels a six-axis sensor has.
pub const FORCE_TORQUE_CHANNELS: usize = 6;

/// The input half of a force/torque sensor.
pub trait ForceTorque: Send {
    /// The longest that a call waits for the device or the kernel, beside its own processor time:
    /// the analysis of the schedule counts it as part of the job; constant.
    fn longest_wait(&self) -> Nanos {
        Nanos::ZERO
    }

    /// All gauges' codes, from one conversion, before any calibration.
    ///
    /// A second call with the same `release` gives the same reading.
    ///
    /// # Errors
    /// [`Transient`](crate::ErrorKind::Transient): no untorn set within the driver's bounded
    /// retries. [`Stale`](crate::ErrorKind::Stale): the sensor's link has fallen silent.
    /// [`Lost`](crate::ErrorKind::Lost): the board is gone.
    fn sample(
        &mut self,
        release: Nanos,
    ) -> Result<Reading<[AdcCode; FORCE_TORQUE_CHANNELS]>, Error>;
}
