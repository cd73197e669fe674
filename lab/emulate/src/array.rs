//! A tactile board on a serial line before one of the simulated robot's arrays. A scan of the board
//! shows the newest scan of the array, in counts as wide as the board's.

use taktil_drivers_serial_emulator::Line;
use taktil_hal::Nanos;

use crate::board::Traffic;
use crate::simulated::SimulatedRobot;

/// Which of the robot's arrays a board shows, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ShownArray {
    pub(crate) index: usize,
    /// Width of a count of the array (bits).
    pub(crate) array_bits: u32,
    /// Width of a count of the board (bits).
    pub(crate) board_bits: u32,
}

/// The board on its line.
pub(crate) struct TactileLine {
    line: Line,
    shown: ShownArray,
    /// Bytes for the host.
    pub(crate) outbox: Vec<u8>,
}

impl TactileLine {
    pub(crate) fn new(line: Line, shown: ShownArray) -> TactileLine {
        TactileLine { line, shown, outbox: Vec::new() }
    }

    /// The next instant at which it does something by itself.
    pub(crate) fn next_event(&self) -> Nanos {
        self.line.next_due()
    }

    pub(crate) fn is_plugged(&self, now: Nanos) -> bool {
        self.line.is_plugged(now)
    }

    /// Executes what happens at `now`.
    pub(crate) fn step(&mut self, now: Nanos, robot: &mut SimulatedRobot) {
        let shown = self.shown;
        let mut image = |due: Nanos, values: &mut [u16]| {
            for (value, count) in values.iter_mut().zip(robot.scan(shown.index, due)) {
                *value = rescaled(*count, shown.array_bits, shown.board_bits);
            }
        };
        self.line.poll(now, &mut image, &mut self.outbox);
    }

    /// Takes bytes of the host at `now`.
    pub(crate) fn receive(&mut self, now: Nanos, bytes: &[u8], robot: &mut SimulatedRobot) {
        self.line.receive(now, bytes);
        self.step(now, robot);
    }

    pub(crate) fn traffic(&self) -> Traffic {
        Traffic::Line(self.line.traffic())
    }
}

/// A count of `from` bits as a converter of `to` bits shows it: the lowest bits are cut off, or
/// are zeros.
pub(crate) fn rescaled(count: u16, from: u32, to: u32) -> u16 {
    if from > to {
        count.checked_shr(from - to).unwrap_or(0)
    } else {
        count.checked_shl(to - from).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_count_keeps_its_upper_bits() {
        assert_eq!(rescaled(4_095, 12, 8), 255);
        assert_eq!(rescaled(300, 12, 8), 18);
        assert_eq!(rescaled(300, 12, 12), 300);
        assert_eq!(rescaled(255, 8, 12), 4_080);
        assert_eq!(rescaled(65_535, 16, 0), 0);
    }
}
