//! The register map: the place of each word and the meaning of its bits. An offset that is odd or
//! outside the block is an error at compile time.
//!
//! The layout follows the kind of boards in the thesis (16-bit big-endian words, offset binary
//! converters, encoder counters in two halves, a scan processor's dual-ported memory). It is a
//! layout of its own, not the register map of any one of those products; `boards/taktil.toml` says
//! the same to the driver.
//!
//! | offset | words | register |
//! |---|---|---|
//! | 0x000 | 1 | `ID`: reads [`ID_VALUE`] while the board is there |
//! | 0x002 | 1 | `VERSION`: layout, [`VERSION_VALUE`] |
//! | 0x004 | 1 | `WATCHDOG_MS`: longest silence of both output groups; 0 keeps them safe |
//! | 0x006 | 1 | `FEATURES`: bit 0 the board latches index pulses; others have no meaning yet |
//! | 0x010 | 8 | `DAC`: offset binary, right-justified; taken over together by the strobe |
//! | 0x020 | 1 | `DAC_STROBE`: each write of another number puts all D/A words out |
//! | 0x022 | 1 | `DIGITAL_OUT`: bit 0 enable, 1 brake release, 2 watchdog feed |
//! | 0x024 | 1 | `DIGITAL_IN`: bit 0 drive power, 1 stop A, 2 stop B; bits 8-15 beat |
//! | 0x030 | 1 | `ENCODER_LATCH`: each write of another number latches all counters together |
//! | 0x032 | 18 | encoder block: begin, 8 x (high, low), end |
//! | 0x060 | 10 | A/D block: begin, 8 offset binary words, end |
//! | 0x080 | 8 | force/torque block: begin, 6 offset binary words, end |
//! | 0x0a0 | 19 | index block: begin, 8 x (high, low) counter at the newest pulse, seen, end |
//! | 0x1fe | 258 | tactile block: begin, 16 rows x 16 columns, end |
//!
//! A *block* is published under a number that the board counts up: it writes the number to `begin`,
//! then the words, then the same number to `end`. A reader goes the other way, `end`, words,
//! `begin`, and takes the words only if both numbers agree. (Reading `begin` first would accept a
//! block that was finished while it was being read.)

use taktil_hal::FORCE_TORQUE_CHANNELS;

/// Channels of each bank of the layout.
pub const LAYOUT_CHANNELS: usize = 8;

/// Bytes of the whole block: a shorter file or device window is refused.
pub const BLOCK_BYTES: usize = 0x402;

/// What `ID` reads.
pub const ID_VALUE: u16 = 0x544b;
/// The layout described here.
pub const VERSION_VALUE: u16 = 1;

/// Rows of the tactile block.
pub const TACTILE_ROWS: usize = 16;
/// Columns of the tactile block.
pub const TACTILE_COLS: usize = 16;

/// `DIGITAL_OUT`: the drives may put current into the motors.
pub const OUT_ENABLE: u16 = 1 << 0;
/// `DIGITAL_OUT`: the brakes are lifted.
pub const OUT_BRAKE_RELEASE: u16 = 1 << 1;
/// `DIGITAL_OUT`: the watchdog's feed line.
pub const OUT_WATCHDOG_FEED: u16 = 1 << 2;
/// `DIGITAL_IN`: the drives' supply is on.
pub const IN_DRIVE_POWER: u16 = 1 << 0;
/// `DIGITAL_IN`: channel A of the emergency-stop chain is closed.
pub const IN_ESTOP_A_CLOSED: u16 = 1 << 1;
/// `DIGITAL_IN`: channel B of the emergency-stop chain is closed.
pub const IN_ESTOP_B_CLOSED: u16 = 1 << 2;
/// `DIGITAL_IN`: bits that read 0 on a board that works.
pub const IN_RESERVED: u16 = 0x00f8;
/// `DIGITAL_IN`: how far the beat stands from bit 0.
pub const IN_BEAT_SHIFT: u32 = 8;

/// `FEATURES`: the board latches the encoders' index pulses and publishes the index block. A board
/// without reads 0.
pub const FEATURE_INDEX: u16 = 1 << 0;

/// The place of one 16-bit word: even, inside the block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Register(usize);

impl Register {
    const fn at(offset_bytes: usize) -> Register {
        match Register::from_offset(offset_bytes) {
            Some(register) => register,
            None => panic!("a register stands at an even offset inside the block"),
        }
    }

    /// The register at an offset from the start of the block (bytes), also one that the project's
    /// own layout leaves free; `None` for an odd offset and for one past the end.
    #[must_use]
    pub const fn from_offset(offset_bytes: usize) -> Option<Register> {
        if offset_bytes.is_multiple_of(2) && offset_bytes + 2 <= BLOCK_BYTES {
            Some(Register(offset_bytes))
        } else {
            None
        }
    }

    /// Bytes from the start of the block: even, at most [`BLOCK_BYTES`] - 2.
    #[must_use]
    pub const fn offset_bytes(self) -> usize {
        self.0
    }
}

/// A row of registers, one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bank {
    first: usize,
    words: usize,
}

impl Bank {
    const fn at(offset_bytes: usize, words: usize) -> Bank {
        let _ = Register::at(offset_bytes);
        let _ = Register::at(offset_bytes + 2 * words - 2);
        Bank { first: offset_bytes, words }
    }

    /// The registers in order.
    pub fn iter(self) -> impl Iterator<Item = Register> {
        (0..self.words).map(move |word| Register(self.first + 2 * word))
    }

    /// The register of one channel, if there is such a channel.
    #[must_use]
    pub const fn get(self, word: usize) -> Option<Register> {
        if word < self.words { Some(Register(self.first + 2 * word)) } else { None }
    }
}

/// Words published together under a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// Written before the words.
    pub begin: Register,
    /// The words.
    pub words: Bank,
    /// Written after the words.
    pub end: Register,
}

impl Block {
    const fn at(offset_bytes: usize, words: usize) -> Block {
        Block {
            begin: Register::at(offset_bytes),
            words: Bank::at(offset_bytes + 2, words),
            end: Register::at(offset_bytes + 2 + 2 * words),
        }
    }
}

/// Says that the board is there.
pub const ID: Register = Register::at(0x000);
/// Says which layout it has.
pub const VERSION: Register = Register::at(0x002);
/// Longest silence in ms.
pub const WATCHDOG_MS: Register = Register::at(0x004);
/// What the board can beside the rest of the layout.
pub const FEATURES: Register = Register::at(0x006);
/// D/A words.
pub const DAC: Bank = Bank::at(0x010, LAYOUT_CHANNELS);
/// Puts the D/A words out.
pub const DAC_STROBE: Register = Register::at(0x020);
/// Lines to the cell.
pub const DIGITAL_OUT: Register = Register::at(0x022);
/// Lines from the cell.
pub const DIGITAL_IN: Register = Register::at(0x024);
/// Latches the encoder counters.
pub const ENCODER_LATCH: Register = Register::at(0x030);
/// Latched counters: high and low half of each.
pub const ENCODERS: Block = Block::at(0x032, 2 * LAYOUT_CHANNELS);
/// A/D words.
pub const ADC: Block = Block::at(0x060, LAYOUT_CHANNELS);
/// Force/torque gauge words.
pub const FORCE_TORQUE: Block = Block::at(0x080, FORCE_TORQUE_CHANNELS);
/// Counters at the newest index pulse, high and low half of each; then one word with a bit for each
/// channel that has passed one since power-up.
pub const INDEX: Block = Block::at(0x0a0, 2 * LAYOUT_CHANNELS + 1);
/// The tactile frame, row by row.
pub const TACTILE: Block = Block::at(0x1fe, TACTILE_ROWS * TACTILE_COLS);

#[cfg(test)]
mod tests {
    use super::*;

    fn every_register() -> Vec<Register> {
        let mut all = vec![ID, VERSION, WATCHDOG_MS, DAC_STROBE, DIGITAL_OUT, DIGITAL_IN];
        all.extend([FEATURES, ENCODER_LATCH]);
        all.extend(DAC.iter());
        for block in [ENCODERS, ADC, FORCE_TORQUE, INDEX, TACTILE] {
            all.extend([block.begin, block.end]);
            all.extend(block.words.iter());
        }
        all
    }

    #[test]
    fn no_two_registers_share_a_word_and_the_last_one_ends_the_block() {
        let mut all = every_register();
        let count = all.len();
        all.sort();
        all.dedup();
        assert_eq!(all.len(), count);
        assert_eq!(all.last().map(|last| last.offset_bytes() + 2), Some(BLOCK_BYTES));
    }

    #[test]
    fn offsets_are_those_of_the_table() {
        let offsets = [DAC_STROBE, ENCODERS.begin, ADC.begin, FORCE_TORQUE.begin, TACTILE.begin];
        let offsets = offsets.map(Register::offset_bytes);
        assert_eq!(offsets, [0x020, 0x032, 0x060, 0x080, 0x1fe]);
        let ends = [ENCODERS.end, ADC.end, FORCE_TORQUE.end, TACTILE.end];
        assert_eq!(ends.map(Register::offset_bytes), [0x054, 0x072, 0x08e, 0x400]);
    }

    #[test]
    fn a_register_stands_at_an_even_offset_inside_the_block() {
        assert_eq!(Register::from_offset(0x022), Some(DIGITAL_OUT));
        assert_eq!(Register::from_offset(0x400), Some(TACTILE.end));
        assert_eq!([0x021, 0x401, 0x402].map(Register::from_offset), [None; 3]);
    }

    #[test]
    fn a_bank_has_no_register_past_its_end() {
        assert_eq!(DAC.get(7).map(Register::offset_bytes), Some(0x01e));
        assert_eq!(DAC.get(8), None);
        assert_eq!(DAC.get(usize::MAX), None);
    }
}
