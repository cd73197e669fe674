//! The digital lines of a robot cell: power, emergency stop, enable, brakes, watchdog. Voltage
//! levels and polarity are the driver's business: it turns `true` into whatever its board needs,
//! and a broken wire reads `false`.

use crate::error::Error;
use crate::reading::Reading;
use crate::time::Nanos;

/// The lines from the cell. `false` is always the side on which nothing may move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct LinesIn {
    /// The drives' supply is on.
    pub drive_power: bool,
    /// Channel A of the emergency-stop chain is closed: nobody has pressed.
    pub estop_a_closed: bool,
    /// Channel B of the same chain; the two disagreeing is a fault of the chain.
    pub estop_b_closed: bool,
}

/// The lines to the cell. [`LinesOut::SAFE`] is the default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct LinesOut {
    /// The drives may put current into the motors.
    pub enable: bool,
    /// The brakes are lifted.
    pub brake_release: bool,
    /// Toggles every cycle; the device counts only changes of this line as a sign of life.
    pub watchdog_feed: bool,
}

impl LinesOut {
    /// Drives off, brakes on.
    pub const SAFE: LinesOut =
        LinesOut { enable: false, brake_release: false, watchdog_feed: false };
}

/// The input half of the digital lines.
pub trait DigitalIn: Send {
    /// The longest that a call waits for the device or the kernel, beside its own processor time:
    /// the analysis of the schedule counts it as part of the job; constant.
    fn longest_wait(&self) -> Nanos {
        Nanos::ZERO
    }

    /// The lines as they stand.
    ///
    /// A second call with the same `release` gives the same reading.
    ///
    /// # Errors
    /// [`Transient`](crate::ErrorKind::Transient): the lines could not be read this time.
    /// [`Stale`](crate::ErrorKind::Stale): the lines come over a link that has fallen silent.
    /// [`Lost`](crate::ErrorKind::Lost): the board is gone. A caller takes each as "nothing may
    /// move".
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error>;
}

/// The output half of the digital lines.
///
/// Dropping the half writes [`LinesOut::SAFE`], as [`DigitalOut::safe`] does.
pub trait DigitalOut: Send {
    /// The longest that a call waits for the device or the kernel, beside its own processor time:
    /// the analysis of the schedule counts it as part of the job; constant.
    fn longest_wait(&self) -> Nanos {
        Nanos::ZERO
    }

    /// Sets all lines together for the job released at `release`.
    ///
    /// # Errors
    /// [`Transient`](crate::ErrorKind::Transient): the word could not be handed over this time.
    /// [`Lost`](crate::ErrorKind::Lost): the board is gone.
    fn commit(&mut self, release: Nanos, lines: &LinesOut) -> Result<(), Error>;

    /// Drives off and brakes on ([`LinesOut::SAFE`], the feed line excepted: it stays where it is,
    /// so that going safe is no sign of life), at once, from any state, as often as wanted. The
    /// safe state is not latched.
    ///
    /// # Errors
    /// [`Lost`](crate::ErrorKind::Lost) or [`Transient`](crate::ErrorKind::Transient) when the word
    /// could not be handed over; the device's own watchdog is then what remains.
    fn safe(&mut self) -> Result<(), Error>;

    /// The longest time without a change of the feed line after which the device drops enable and
    /// brake release by itself, even if every process is dead; positive; constant.
    fn longest_silence(&self) -> Nanos;
}
