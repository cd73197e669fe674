//! Incremental encoders: counts per joint. The transmission, which is not known here, turns counts
//! into angles.

use crate::error::Error;
use crate::reading::{CHANNELS, Reading};
use crate::time::Nanos;

/// Encoder counts of one joint, signed, as if the counter had never wrapped: a driver unfolds a
/// counter narrower than 32 bits. At the ends of `i32` it wraps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Counts(pub i32);

/// The index pulses of a bank of encoders: for each channel the count at which the newest pulse
/// came, `None` as long as none has come since power-up.
pub type IndexPulses = [Option<Counts>; CHANNELS];

/// The input half of a bank of encoder counters.
pub trait Encoders: Send {
    /// How many joints are wired, 1 to [`CHANNELS`]; constant.
    fn joints(&self) -> usize;

    /// All joints' counts, latched together: no two of them from different instants.
    ///
    /// Entries from [`Encoders::joints`] on are 0. A second call with the same `release` gives the
    /// same reading. A count is never half of one value and half of another.
    ///
    /// # Errors
    /// [`Transient`](crate::ErrorKind::Transient): the latch did not settle within the driver's
    /// bounded retries. [`Stale`](crate::ErrorKind::Stale): the counters come over a link that has
    /// fallen silent. [`Lost`](crate::ErrorKind::Lost): the board is gone.
    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error>;

    /// The longest that a call waits for the device or the kernel, beside its own processor time:
    /// the analysis of the schedule counts it as part of the job; constant.
    fn longest_wait(&self) -> Nanos {
        Nanos::ZERO
    }

    /// Whether the board latches index pulses, one a turn of each disc; constant.
    fn has_index(&self) -> bool {
        false
    }

    /// The newest index pulses at the latest [`Encoders::sample`] that answered with a reading; on
    /// the scale of its counts. All `None` before that, from [`Encoders::joints`] on, and on a
    /// board without [`Encoders::has_index`]. A pulse is never forgotten.
    fn index_pulses(&self) -> IndexPulses {
        [None; CHANNELS]
    }

    /// How many counts a pulse may lie from the count at which the board was attached for
    /// [`Encoders::index_pulses`] to place it right; constant. A board whose counters are narrow
    /// knows a pulse from before that only modulo their range. By default any distance is allowed.
    fn index_pulse_reach(&self) -> i32 {
        i32::MAX
    }
}
