//! A tactile array's frames: rows x columns of raw counts with the time of every row and the
//! validity of every tactel. Baselines, thresholds and features belong to the tasks above.

use crate::error::Error;
use crate::time::Nanos;

/// The most rows, and the most columns, that an array may have.
pub const MAX_ROWS: usize = 64;

/// The most tactels that an array may have.
pub const MAX_TACTELS: usize = 4096;

/// Whether a call brought a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Arrival {
    /// The frame was filled with one that was not handed out before.
    New,
    /// No newer frame is there; the caller's frame was not touched.
    Held,
}

/// One scan of the array. It is made for one array, with its numbers of rows and columns, and keeps
/// them: filling it allocates nothing.
///
/// The tactel in row `r`, column `c` (both from 0) stands at index `r * cols + c`. Counts are
/// positive under compression and include the rest level.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TactileFrame {
    rows: u16,
    cols: u16,
    /// Numbers the scans of the device. A newer frame's number is ahead by 1 to 2^31 - 1 modulo
    /// 2^32; a gap counts scans that nobody fetched.
    pub sequence: u32,
    /// When the last row was read: the scan was complete. Never later than the release.
    pub acquired: Nanos,
    /// Raw counts, 0 to the device's full scale.
    pub values: Box<[u16]>,
    /// Whether the device vouches for the tactel.
    pub valid: Box<[bool]>,
    /// When each row was read; never later than `acquired`.
    pub row_acquired: Box<[Nanos]>,
}

impl TactileFrame {
    /// A frame for an array of these many rows and columns that was never filled: nothing in it is
    /// valid. Allocates. Numbers beyond [`MAX_ROWS`] are taken as that.
    #[must_use]
    pub fn new(rows: usize, cols: usize) -> TactileFrame {
        let (rows, cols) = (rows.min(MAX_ROWS), cols.min(MAX_ROWS));
        let narrow = |number: usize| u16::try_from(number).unwrap_or(0);
        TactileFrame {
            rows: narrow(rows),
            cols: narrow(cols),
            sequence: 0,
            acquired: Nanos::ZERO,
            values: vec![0; rows * cols].into(),
            valid: vec![false; rows * cols].into(),
            row_acquired: vec![Nanos::ZERO; rows].into(),
        }
    }

    /// A frame for this array.
    #[must_use]
    pub fn of(array: &dyn TactileArray) -> TactileFrame {
        TactileFrame::new(array.rows(), array.cols())
    }

    /// Whether the frame was made for an array of the size of this one.
    #[must_use]
    pub fn fits<A: TactileArray + ?Sized>(&self, array: &A) -> bool {
        usize::from(self.rows) == array.rows() && usize::from(self.cols) == array.cols()
    }

    /// Rows of the array.
    #[must_use]
    pub fn rows(&self) -> u16 {
        self.rows
    }

    /// Columns of the array.
    #[must_use]
    pub fn cols(&self) -> u16 {
        self.cols
    }

    /// How many tactels the array has.
    #[must_use]
    pub fn tactels(&self) -> usize {
        self.values.len()
    }
}

/// The input half of a tactile array that scans at its own pace.
pub trait TactileArray: Send {
    /// Rows, 1 to [`MAX_ROWS`]; constant.
    fn rows(&self) -> usize;

    /// Columns, 1 to [`MAX_ROWS`], `rows * cols` at most [`MAX_TACTELS`]; constant.
    fn cols(&self) -> usize;

    /// The count at which a tactel saturates; positive; constant.
    fn full_scale(&self) -> u16;

    /// The longest that a call waits for the device or the kernel, beside its own processor time:
    /// the analysis of the schedule counts it as part of the job; constant.
    fn longest_wait(&self) -> Nanos {
        Nanos::ZERO
    }

    /// The newest complete frame, if it was not handed out before.
    ///
    /// `frame` was made for this array ([`TactileFrame::of`]); one made for another array is not
    /// filled, which is [`OutOfRange`](crate::ErrorKind::OutOfRange). It is written only with
    /// [`Arrival::New`], and then wholly: it is never a mixture of two scans. After `New`, a second
    /// call with the same `release` answers [`Arrival::Held`]. A device that has stopped scanning
    /// answers `Held` for ever: how old a frame may be is the reader's decision, by `acquired`.
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
    fn a_frame_that_was_never_filled_vouches_for_nothing() {
        let frame = TactileFrame::new(12, 32);
        assert_eq!((frame.rows(), frame.cols(), frame.tactels()), (12, 32, 384));
        assert!(frame.valid.iter().all(|valid| !valid));
    }

    #[test]
    fn absurd_dimensions_make_a_bounded_frame() {
        let frame = TactileFrame::new(usize::MAX, usize::MAX);
        assert_eq!(frame.tactels(), MAX_TACTELS);
        assert_eq!(TactileFrame::new(0, 5).tactels(), 0);
    }
}
