//! Reads and writes registers in the width and order of bytes that a description states, and values
//! that take several of them.

use std::sync::Arc;

use crate::description::{ByteOrder, Description, Expected, WordOrder};
use crate::io::RegisterFile;

/// The registers of a board with their width and order of bytes.
#[derive(Clone, Debug)]
pub(crate) struct Bus {
    file: Arc<RegisterFile>,
    width: Width,
    big: bool,
}

#[derive(Clone, Copy, Debug)]
enum Width {
    Bits8,
    Bits16,
    Bits32,
}

impl Bus {
    pub(crate) fn new(file: Arc<RegisterFile>, description: &Description) -> Bus {
        let width = match description.bus_bytes() {
            2 => Width::Bits16,
            4 => Width::Bits32,
            _ => Width::Bits8,
        };
        Bus { file, width, big: description.byte_order == ByteOrder::Big }
    }

    /// The word in a register.
    #[inline]
    pub(crate) fn read(&self, offset: usize) -> u32 {
        match (self.width, self.big) {
            (Width::Bits8, _) => u32::from(self.file.load8(offset)),
            (Width::Bits16, true) => u32::from(u16::from_be(self.file.load16(offset))),
            (Width::Bits16, false) => u32::from(u16::from_le(self.file.load16(offset))),
            (Width::Bits32, true) => u32::from_be(self.file.load32(offset)),
            (Width::Bits32, false) => u32::from_le(self.file.load32(offset)),
        }
    }

    /// Writes the word of a register; bits beyond its width are dropped.
    #[inline]
    pub(crate) fn write(&self, offset: usize, word: u32) {
        match (self.width, self.big) {
            (Width::Bits8, _) => self.file.store8(offset, word as u8),
            (Width::Bits16, true) => self.file.store16(offset, (word as u16).to_be()),
            (Width::Bits16, false) => self.file.store16(offset, (word as u16).to_le()),
            (Width::Bits32, true) => self.file.store32(offset, word.to_be()),
            (Width::Bits32, false) => self.file.store32(offset, word.to_le()),
        }
    }

    /// Everything read before is done before anything read after.
    pub(crate) fn order_reads(&self) {
        self.file.order_reads();
    }

    /// Everything written before can be seen before anything written after.
    pub(crate) fn order_writes(&self) {
        self.file.order_writes();
    }
}

/// Bits of one value in one or more registers, which are 32 bits together at most.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Field {
    offset: usize,
    stride: usize,
    words: usize,
    bus_bits: u32,
    high_first: bool,
    shift: u32,
    mask: u32,
}

impl Field {
    /// The field of `bits` above `shift` others in `words` registers from `offset` on; checked with
    /// the description.
    pub(crate) fn new(
        description: &Description,
        offset: usize,
        words: usize,
        bits: u32,
        shift: u32,
    ) -> Field {
        Field {
            offset,
            stride: description.stride(),
            words,
            bus_bits: 8 * description.bus_bytes() as u32,
            high_first: description.words_in_order() == WordOrder::HighFirst,
            shift,
            mask: u32::MAX >> (32 - bits),
        }
    }

    /// How far a word of the field stands from the lowest bit.
    #[inline]
    fn place(&self, word: usize) -> u32 {
        let from_low = if self.high_first { self.words - 1 - word } else { word };
        self.bus_bits * from_low as u32
    }

    /// All bits of its registers, which are read in the order of their offsets.
    #[inline]
    pub(crate) fn read_whole(&self, bus: &Bus) -> u32 {
        let mut whole = 0;
        for word in 0..self.words {
            whole |= bus.read(self.offset + word * self.stride) << self.place(word);
        }
        whole
    }

    /// The field's bits of all bits of its registers.
    #[inline]
    pub(crate) fn bits(&self, whole: u32) -> u32 {
        (whole >> self.shift) & self.mask
    }

    /// Whether a bit outside the field is set.
    #[inline]
    pub(crate) fn has_unused(&self, whole: u32) -> bool {
        whole & !(self.mask << self.shift) != 0
    }

    /// Writes the field, and 0 around it, in the order of the registers' offsets.
    #[inline]
    pub(crate) fn write(&self, bus: &Bus, bits: u32) {
        let whole = (bits & self.mask) << self.shift;
        for word in 0..self.words {
            bus.write(self.offset + word * self.stride, whole >> self.place(word));
        }
    }
}

/// Fields of the given channels of a bank, in that order.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bank<'a> {
    pub(crate) description: &'a Description,
    pub(crate) offset: usize,
    pub(crate) channel_stride_bytes: Option<usize>,
    pub(crate) words: usize,
    pub(crate) bits: u32,
    pub(crate) shift: u32,
}

impl Bank<'_> {
    /// The fields of some channels.
    pub(crate) fn fields(&self, channels: &[usize]) -> Box<[Field]> {
        let stride = self.description.channel_stride(self.channel_stride_bytes, self.words);
        let field = |channel: &usize| {
            let offset = self.offset + channel * stride;
            Field::new(self.description, offset, self.words, self.bits, self.shift)
        };
        channels.iter().map(field).collect()
    }
}

/// Bits that a register reads while something holds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct State {
    offset: usize,
    mask: u32,
    value: u32,
}

impl State {
    /// The state of a register's bits; all of the bus where no mask is given.
    pub(crate) fn new(
        description: &Description,
        offset: usize,
        mask: Option<u32>,
        value: Option<u32>,
    ) -> State {
        let mask = mask.unwrap_or_else(|| description.bus_mask());
        State { offset, mask, value: value.unwrap_or(mask) }
    }

    pub(crate) fn expected(description: &Description, expected: &Expected) -> State {
        State::new(description, expected.offset, expected.mask, Some(expected.value))
    }

    /// Whether it holds.
    #[inline]
    pub(crate) fn holds(&self, bus: &Bus) -> bool {
        bus.read(self.offset) & self.mask == self.value
    }
}
