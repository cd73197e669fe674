//! Counts edges as one channel of the FPGA's encoder module does: a count and a stamp of 16 bits,
//! and a latch that an index pulse triggers.

/// Control: latch the count on an index pulse.
const LATCH_ON_INDEX: u32 = 1 << 4;
/// Control: clear the count on an index pulse.
const CLEAR_ON_INDEX: u32 = 1 << 5;
/// Control: latch and clear act once and switch themselves off.
const JUST_ONCE: u32 = 1 << 6;
/// Bits of the control register that keep what is written.
const CONTROL_MASK: u32 = 0xcff8;

/// Where the index pulses of a disc come, in counts of the plant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IndexPulses {
    /// The place of one of them.
    pub first: i64,
    /// From one to the next; 0 for a disc without pulses.
    pub turn: i64,
}

/// One encoder channel.
#[derive(Clone, Debug, Default)]
pub(crate) struct Channel {
    /// Where the plant's disc stood when the count was 0.
    zero: i64,
    disc: i64,
    stamp: u16,
    control: u32,
    latch: u16,
}

impl Channel {
    /// The disc has moved to `disc`; `ticks` is the time-stamp counter.
    pub(crate) fn advance(&mut self, disc: i64, ticks: u16, pulses: IndexPulses) {
        let IndexPulses { first, turn } = pulses;
        if disc == self.disc {
            return;
        }
        self.stamp = ticks;
        let before = self.disc;
        self.disc = disc;
        if turn <= 0 {
            return;
        }
        // The multiples of a turn that were reached or passed, seen in the direction of motion.
        let (from, to) = (before.min(disc) - first, before.max(disc) - first);
        let (from, to) = if disc > before { (from + 1, to) } else { (from, to - 1) };
        let pulse = if disc > before {
            to.div_euclid(turn) * turn
        } else {
            from.div_euclid(turn) * turn + if from.rem_euclid(turn) == 0 { 0 } else { turn }
        };
        if (from..=to).contains(&pulse) {
            self.index(pulse + first);
        }
    }

    fn index(&mut self, disc: i64) {
        if self.control & LATCH_ON_INDEX != 0 {
            self.latch = (disc - self.zero) as u16;
        }
        if self.control & CLEAR_ON_INDEX != 0 {
            self.zero = disc;
        }
        if self.control & JUST_ONCE != 0 {
            self.control &= !(LATCH_ON_INDEX | CLEAR_ON_INDEX);
        }
    }

    pub(crate) fn count_word(&self) -> u32 {
        (u32::from(self.stamp) << 16) | u32::from((self.disc - self.zero) as u16)
    }

    /// Any write clears the count.
    pub(crate) fn clear(&mut self) {
        self.zero = self.disc;
    }

    pub(crate) fn control_word(&self) -> u32 {
        (u32::from(self.latch) << 16) | self.control
    }

    pub(crate) fn write_control(&mut self, word: u32) {
        self.control = word & CONTROL_MASK;
    }

    /// Power was switched on: the disc stays where it is.
    pub(crate) fn restart(&mut self) {
        *self = Channel { zero: self.disc, disc: self.disc, ..Channel::default() };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURN_PULSES: IndexPulses = IndexPulses { first: 0, turn: 1_000 };

    #[test]
    fn a_pulse_is_latched_once_when_asked_once() {
        let mut channel = Channel::default();
        channel.write_control(LATCH_ON_INDEX | JUST_ONCE);
        channel.advance(950, 1, TURN_PULSES);
        assert_eq!(channel.control_word() & LATCH_ON_INDEX, LATCH_ON_INDEX);
        channel.advance(1_010, 2, TURN_PULSES);
        assert_eq!(channel.control_word() >> 16, 1_000);
        assert_eq!(channel.control_word() & LATCH_ON_INDEX, 0);
        channel.advance(2_010, 3, TURN_PULSES);
        assert_eq!(channel.control_word() >> 16, 1_000);
        channel.write_control(LATCH_ON_INDEX);
        channel.advance(1_999, 4, TURN_PULSES);
        assert_eq!(channel.control_word() >> 16, 2_000);
        channel.advance(-5, 5, TURN_PULSES);
        assert_eq!(channel.control_word() >> 16, 0);
    }

    #[test]
    fn pulses_stand_where_the_disc_has_them() {
        let mut channel = Channel::default();
        let pulses = IndexPulses { first: -130, turn: 800 };
        channel.write_control(LATCH_ON_INDEX);
        channel.advance(669, 1, pulses);
        assert_eq!(channel.control_word() >> 16, 0);
        channel.advance(670, 2, pulses);
        assert_eq!(channel.control_word() >> 16, 670);
        channel.advance(-131, 3, pulses);
        assert_eq!((channel.control_word() >> 16) as u16, -130_i16 as u16);
    }

    #[test]
    fn any_write_clears_the_count() {
        let mut channel = Channel::default();
        channel.advance(70_000, 9, IndexPulses::default());
        assert_eq!(channel.count_word(), (9 << 16) | (70_000 & 0xffff));
        channel.clear();
        channel.advance(69_999, 10, IndexPulses::default());
        assert_eq!(channel.count_word(), (10 << 16) | 0xffff);
    }
}
