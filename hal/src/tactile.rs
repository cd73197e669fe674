//! A tactile array's frames: rows x columns of raw counts with the time of every row and the
//! validity of every tactel. Baselines, thresholds and features belong to the tasks above.

use crate::error::Error;
use crate::time::Nanos;

/// The most rows a frame can carry.
pub const MAX_ROWS: usize = 16;

/// The most tactels a frame can carry.
pub const MAX_TACTELS: usize = 256;

/// Whether a call brought a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Arrival {
    /// The frame was filled with one that was not handed out before.
    New,
    /// No newer frame is there; the caller's frame was not touched.
    Held,
}

/// One scan of the array.
///
/// The tactel in row `r`, column `c` (both from 0) stands at index `r * cols + c`. Counts are
/// positive under compression and include the rest level.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TactileFrame {
    /// Rows in use, 1 to [`MAX_ROWS`]; 0 only in a frame that was never filled.
    pub rows: u16,
    /// Columns in use; `rows * cols` is at most [`MAX_TACTELS`].
    pub cols: u16,
    /// Numbers the scans of the device. A newer frame's number is ahead by 1 to 2^31 - 1 modulo
    /// 2^32; a gap counts scans that nobody fetched.
    pub sequence: u32,
    /// When the last row was read: the scan was complete. Never later than the release.
    pub acquired: Nanos,
    /// Raw counts, 0 to the device's full scale; 0 from `rows * cols` on.
    pub values: [u16; MAX_TACTELS],
    /// Whether the device vouches for the tactel; `false` from `rows * cols` on.
    pub valid: [bool; MAX_TACTELS],
    /// When each row was read; never later than `acquired`. Meaningless from `rows` on.
    pub row_acquired: [Nanos; MAX_ROWS],
}

impl TactileFrame {
    /// A frame that was never filled.
    #[must_use]
    pub const fn empty() -> TactileFrame {
        TactileFrame {
            rows: 0,
            cols: 0,
            sequence: 0,
            acquired: Nanos::ZERO,
            values: [0; MAX_TACTELS],
            valid: [false; MAX_TACTELS],
            row_acquired: [Nanos::ZERO; MAX_ROWS],
        }
    }

    /// How many tactels are in use, never more than [`MAX_TACTELS`].
    #[must_use]
    pub fn tactels(&self) -> usize {
        (usize::from(self.rows) * usize::from(self.cols)).min(MAX_TACTELS)
    }
}

impl Default for TactileFrame {
    fn default() -> TactileFrame {
        TactileFrame::empty()
    }
}

/// The input half of a tactile array that scans at its own pace.
pub trait TactileArray: Send {
    /// Rows, 1 to [`MAX_ROWS`]; constant.
    fn rows(&self) -> usize;

    /// Columns, at least 1, `rows * cols` at most [`MAX_TACTELS`]; constant.
    fn cols(&self) -> usize;

    /// The count at which a tactel saturates; positive; constant.
    fn full_scale(&self) -> u16;

    /// The newest complete frame, if it was not handed out before.
    ///
    /// `frame` is written only with [`Arrival::New`], and then wholly: it is never a mixture of two
    /// scans. After `New`, a second call with the same `release` answers [`Arrival::Held`]. A
    /// device that has stopped scanning answers `Held` for ever: how old a frame may be is the
    /// reader's decision, by `acquired`.
    ///
    /// # Errors
    /// [`Transient`](crate::ErrorKind::Transient): only torn or damaged frames could be had within
    /// the driver's bounded retries. [`OutOfRange`](crate::ErrorKind::OutOfRange): a whole frame
    /// with a count above [`TactileArray::full_scale`]; the channel is the tactel's index.
    /// [`Lost`](crate::ErrorKind::Lost): the board is gone. `frame` is untouched in each case.
    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_frame_vouches_for_nothing() {
        let frame = TactileFrame::default();
        assert_eq!(frame.tactels(), 0);
        assert!(frame.valid.iter().all(|valid| !valid));
    }

    #[test]
    fn a_frame_with_absurd_dimensions_still_indexes_within_its_arrays() {
        let frame = TactileFrame { rows: u16::MAX, cols: u16::MAX, ..TactileFrame::empty() };
        assert_eq!(frame.tactels(), MAX_TACTELS);
    }
}
