//! The exchange of tactile scans between world and devices. A link carries values of one size, and
//! arrays have many sizes: a scan crosses in pieces of one size, with one stamp, and the receiver
//! puts them together. An array of 256 tactels or fewer takes one piece.

use taktil_hal::Nanos;
use taktil_hal::link::{Receiver, Sender, link};

/// Number of readings in a piece.
const PIECE_LEN: usize = 256;

/// One complete scan of an array.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Scan {
    pub(crate) sequence: u32,
    /// When it was acquired, and from when on a receiver may see it.
    pub(crate) stamp: Nanos,
    pub(crate) visible: Nanos,
    /// The readings, row by row.
    pub(crate) values: Box<[u16]>,
}

impl Scan {
    /// Room for a scan of an array of so many tactels. Allocates.
    pub(crate) fn empty(tactels: usize) -> Scan {
        let values = vec![0; tactels].into();
        Scan { sequence: 0, stamp: Nanos::ZERO, visible: Nanos::ZERO, values }
    }
}

/// A part of a scan on its way.
#[derive(Clone, Copy, Debug)]
struct Piece {
    sequence: u32,
    /// Number of the piece in its scan, from 0.
    index: u32,
    values: [u16; PIECE_LEN],
}

/// The world's end.
#[derive(Debug)]
pub(crate) struct ScanSender(Sender<Piece>);

/// The device's end.
pub(crate) struct ScanReceiver {
    pieces: Receiver<Piece>,
    /// The scan that is being put together, and the index of its next piece.
    arriving: Scan,
    next_piece: usize,
    /// The newest complete scan.
    newest: Scan,
}

/// Makes a link that holds up to `capacity` scans of so many tactels. Allocates.
pub(crate) fn scan_link(capacity: usize, tactels: usize) -> (ScanSender, ScanReceiver) {
    let (sender, pieces) = link(capacity * tactels.div_ceil(PIECE_LEN).max(1));
    let (arriving, newest) = (Scan::empty(tactels), Scan::empty(tactels));
    (ScanSender(sender), ScanReceiver { pieces, arriving, next_piece: 0, newest })
}

impl ScanSender {
    /// Sends a scan; a full link counts the pieces that it loses, and the receiver passes over the
    /// scan.
    pub(crate) fn send(&mut self, scan: &Scan) {
        for (index, values) in (0..).zip(scan.values.chunks(PIECE_LEN)) {
            let mut piece = Piece { sequence: scan.sequence, index, values: [0; PIECE_LEN] };
            piece.values[..values.len()].copy_from_slice(values);
            let _ = self.0.send(piece, scan.stamp, scan.visible);
        }
    }

    /// Number of pieces that were lost because the link was full.
    pub(crate) fn dropped(&self) -> u64 {
        self.0.dropped()
    }
}

impl ScanReceiver {
    /// The newest complete scan that is visible at `now`, unless it was handed out before.
    pub(crate) fn newest(&mut self, now: Nanos) -> Option<&Scan> {
        let mut found = false;
        while let Some(entry) = self.pieces.next(now) {
            let Piece { sequence, index, values } = entry.value;
            let (scan, piece) = (&mut self.arriving, index as usize);
            if piece == 0 {
                (scan.sequence, scan.stamp, scan.visible) = (sequence, entry.stamp, entry.visible);
            } else if piece != self.next_piece || sequence != scan.sequence {
                // A piece before this one was lost: the rest of the scan is passed over.
                self.next_piece = usize::MAX;
                continue;
            }
            self.next_piece = piece + 1;
            let mut parts = scan.values.chunks_mut(PIECE_LEN).skip(piece);
            if let Some(part) = parts.next() {
                part.copy_from_slice(&values[..part.len()]);
            }
            if parts.next().is_none() {
                core::mem::swap(&mut self.arriving, &mut self.newest);
                found = true;
            }
        }
        found.then_some(&self.newest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scan(sequence: u32, tactels: usize) -> Scan {
        let values = (0..tactels).map(|i| (i as u32 + 7 * sequence) as u16).collect();
        let at = Nanos(i64::from(sequence));
        Scan { sequence, stamp: at, visible: at, values }
    }

    #[test]
    fn scans_of_every_size_arrive_whole_and_only_once() {
        for tactels in [1, 64, 255, 256, 257, 384, 512, 4096] {
            let (mut sender, mut receiver) = scan_link(4, tactels);
            (1..=3).for_each(|sequence| sender.send(&scan(sequence, tactels)));
            assert!(receiver.newest(Nanos(0)).is_none());
            assert_eq!(receiver.newest(Nanos(2)), Some(&scan(2, tactels)));
            assert!(receiver.newest(Nanos(2)).is_none());
            assert_eq!(receiver.newest(Nanos(9)), Some(&scan(3, tactels)));
        }
    }

    #[test]
    fn a_scan_of_which_a_piece_was_lost_is_passed_over() {
        let (mut sender, mut receiver) = scan_link(2, 600);
        (1..=3).for_each(|sequence| sender.send(&scan(sequence, 600)));
        assert_eq!(sender.dropped(), 3);
        assert_eq!(receiver.newest(Nanos(9)), Some(&scan(2, 600)));
        sender.send(&scan(4, 600));
        // Four places are free after this: the last scan loses its second and third piece.
        assert_eq!(receiver.newest(Nanos(9)), Some(&scan(4, 600)));
        sender.send(&scan(5, 600));
        sender.send(&scan(6, 600));
        sender.send(&scan(7, 600));
        assert_eq!(receiver.newest(Nanos(9)), Some(&scan(6, 600)));
        assert!(receiver.newest(Nanos(9)).is_none());
    }
}
