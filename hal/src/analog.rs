//! D/A outputs and A/D inputs. Both use codes; the conversion to volts, amperes and torques belongs
//! to the software that knows the wiring.

use crate::error::Error;
use crate::reading::{CHANNELS, Reading};
use crate::time::Nanos;

/// A code for a D/A converter, signed about zero volts; how the board encodes it (offset binary,
/// two's complement) is the driver's business.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DacCode(pub i32);

/// A code from an A/D converter, signed about zero volts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AdcCode(pub i32);

/// The output half of a D/A board.
///
/// Dropping the half writes the safe value, as [`AnalogOut::safe`] does.
pub trait AnalogOut: Send {
    /// How many channels are wired, 1 to [`CHANNELS`]; constant.
    fn channels(&self) -> usize;

    /// Lowest and highest code the converter takes, both included, lowest < highest; constant.
    fn code_range(&self) -> (DacCode, DacCode);

    /// The longest that a call waits for the device or the kernel, beside its own processor time:
    /// the analysis of the schedule counts it as part of the job; constant.
    fn longest_wait(&self) -> Nanos {
        Nanos::ZERO
    }

    /// Puts out one code per channel for the job released at `release`.
    ///
    /// All or nothing: every wired channel is checked before the first one is written. Entries
    /// from [`AnalogOut::channels`] on are ignored, whatever they hold. The word acts from
    /// `release` plus the machine's actuation delay, which is not the driver's to add.
    ///
    /// # Errors
    /// [`OutOfRange`](crate::ErrorKind::OutOfRange) names the first channel whose code is outside
    /// [`AnalogOut::code_range`]; no output has changed then.
    /// [`Transient`](crate::ErrorKind::Transient): the words could not be handed over this time.
    /// [`Lost`](crate::ErrorKind::Lost): the board is gone.
    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error>;

    /// Puts [`AnalogOut::safe_value`] on every channel, at once, from any state: before the first
    /// commit, after a refused one, twice in a row. The safe state is not latched: the next commit
    /// drives the outputs again (whether it may is not the driver's decision).
    ///
    /// # Errors
    /// [`Lost`](crate::ErrorKind::Lost) or [`Transient`](crate::ErrorKind::Transient) when the
    /// words could not be handed over; the device's own watchdog is then what remains.
    fn safe(&mut self) -> Result<(), Error>;

    /// The code at which the actuator does no harm, inside [`AnalogOut::code_range`]; constant. For
    /// current amplifiers: no current.
    fn safe_value(&self) -> DacCode;

    /// The longest time without a commit after which the device goes to the safe value by itself,
    /// even if every process is dead; positive; constant.
    fn longest_silence(&self) -> Nanos;
}

/// The input half of an A/D board.
pub trait AnalogIn: Send {
    /// How many channels are wired, 1 to [`CHANNELS`]; constant.
    fn channels(&self) -> usize;

    /// Lowest and highest code the converter can give, both included, lowest < highest; constant.
    /// A code at either end may mean a clipped input.
    fn code_range(&self) -> (AdcCode, AdcCode);

    /// The longest that a call waits for the device or the kernel, beside its own processor time:
    /// the analysis of the schedule counts it as part of the job; constant.
    fn longest_wait(&self) -> Nanos {
        Nanos::ZERO
    }

    /// One code per channel.
    ///
    /// Entries from [`AnalogIn::channels`] on are 0. A second call with the same `release` gives
    /// the same reading.
    ///
    /// # Errors
    /// [`Transient`](crate::ErrorKind::Transient): a conversion did not finish in its bounded time.
    /// [`OutOfRange`](crate::ErrorKind::OutOfRange): the board delivered a code outside
    /// [`AnalogIn::code_range`]. [`Stale`](crate::ErrorKind::Stale): the converter's link has
    /// fallen silent. [`Lost`](crate::ErrorKind::Lost): the board is gone.
    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error>;
}
