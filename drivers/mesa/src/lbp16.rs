//! Builds LBP16 packets and finds the words of their answers. A packet is encoded once; afterwards
//! only its data words change.
//!
//! A command is a word of 16 bits, little-endian as everything: bit 15 write, bit 14 an address
//! follows, bit 13 information area, bits 12 to 10 address space, bits 9 and 8 size of an element,
//! bit 7 the address goes on after each element, bits 6 to 0 how many elements. Source: the text of
//! the 7I76E manual on LBP16.

/// An address space of the card.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Space {
    /// Registers of the FPGA, 32 bits each.
    Registers,
    /// Timers and scratch words, 16 bits each.
    Timers,
    /// Errors and counts of packets, 16 bits each.
    Counters,
    /// The card's name and versions, 16 bits each.
    Names,
}

impl Space {
    /// The bits of a command that choose space and size. Other sizes than these are refused by the
    /// card, whole answer and all.
    const fn bits(self) -> u16 {
        match self {
            Space::Registers => 2 << 8,
            Space::Timers => (4 << 10) | (1 << 8),
            Space::Counters => (6 << 10) | (1 << 8),
            Space::Names => (7 << 10) | (1 << 8),
        }
    }

    const fn element_bytes(self) -> usize {
        match self {
            Space::Registers => 4,
            Space::Timers | Space::Counters | Space::Names => 2,
        }
    }
}

/// Most elements of one command.
pub const ELEMENTS_MAX: usize = 127;
/// Most bytes of a request or an answer: what one Ethernet frame of 1500 bytes carries over UDP.
pub const PACKET_BYTES_MAX: usize = 1_472;
/// The write bit of a command.
const WRITE_BIT: u16 = 1 << 15;
/// The bits of every command of ours: an address follows, and it goes on.
const ADDRESSED_BITS: u16 = (1 << 14) | (1 << 7);

/// A packet that is being built or is complete.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Packet {
    bytes: Vec<u8>,
    answer_bytes: usize,
}

/// The first of some words in a packet or in an answer, in bytes from its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Place(usize);

impl Place {
    /// The place of the `n`-th word of 32 bits from here.
    #[must_use]
    pub const fn word(self, n: usize) -> Place {
        Place(self.0 + 4 * n)
    }

    /// The word of 32 bits at this place; 0 behind the end.
    #[must_use]
    pub fn read(self, answer: &[u8]) -> u32 {
        let bytes = answer.get(self.0..).and_then(<[u8]>::first_chunk);
        bytes.map_or(0, |bytes| u32::from_le_bytes(*bytes))
    }
}

impl Packet {
    /// Adds the reading of `elements` (1 to [`ELEMENTS_MAX`]) from `address` on, in bytes; gives
    /// the place in the answer.
    pub fn read(&mut self, space: Space, address: u16, elements: usize) -> Place {
        self.command(space, address, elements, 0);
        let place = Place(self.answer_bytes);
        self.answer_bytes += elements * space.element_bytes();
        place
    }

    /// Adds the writing of some words of 32 bits from `address` on; gives the place of the first
    /// one in the packet. A space of 16 bits takes two elements for each.
    pub fn write(&mut self, space: Space, address: u16, words: &[u32]) -> Place {
        self.command(space, address, words.len() * 4 / space.element_bytes(), WRITE_BIT);
        let place = Place(self.bytes.len());
        self.bytes.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        place
    }

    fn command(&mut self, space: Space, address: u16, elements: usize, write: u16) {
        debug_assert!((1..=ELEMENTS_MAX).contains(&elements));
        let command = write | ADDRESSED_BITS | space.bits() | (elements as u16 & 0x7f);
        self.bytes.extend(command.to_le_bytes());
        self.bytes.extend(address.to_le_bytes());
    }

    /// Changes a word that was added by [`Packet::write`].
    pub fn set(&mut self, place: Place, word: u32) {
        if let Some(bytes) = self.bytes.get_mut(place.0..).and_then(<[u8]>::first_chunk_mut) {
            *bytes = word.to_le_bytes();
        }
    }

    /// The packet as it goes on the wire.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// How long its answer is; 0 for no answer at all.
    #[must_use]
    pub const fn answer_bytes(&self) -> usize {
        self.answer_bytes
    }

    /// Whether a datagram may be this packet's answer: it is whole. One that was padded on the way
    /// is longer.
    #[must_use]
    pub const fn is_answered_by(&self, answer: &[u8]) -> bool {
        answer.len() >= self.answer_bytes
    }

    /// Whether request and answer fit one frame each.
    #[must_use]
    pub const fn fits_frame(&self) -> bool {
        self.bytes.len() <= PACKET_BYTES_MAX && self.answer_bytes <= PACKET_BYTES_MAX
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_vector_of_the_manual_reads_the_config_name() {
        let mut packet = Packet::default();
        packet.read(Space::Registers, 0x0104, 2);
        assert_eq!(packet.bytes(), [0x82, 0x42, 0x04, 0x01]);
        assert_eq!(packet.answer_bytes(), 8);
    }

    #[test]
    fn a_write_carries_its_data_and_asks_for_no_answer() {
        let mut packet = Packet::default();
        let place = packet.write(Space::Timers, 0x14, &[0x1234_5678]);
        assert_eq!(packet.bytes(), [0x82, 0xd1, 0x14, 0x00, 0x78, 0x56, 0x34, 0x12]);
        packet.set(place, 1);
        assert_eq!(packet.bytes()[4..], [1, 0, 0, 0]);
        assert_eq!(packet.answer_bytes(), 0);
    }

    #[test]
    fn a_place_behind_the_end_reads_zero_and_changes_nothing() {
        assert_eq!(Place(2).read(&[1, 2, 3, 4, 5]), 0);
        assert_eq!(Place(1).read(&[1, 2, 3, 4, 5]), 0x0504_0302);
        assert_eq!(Place(usize::MAX).read(&[1]), 0);
        let mut packet = Packet::default();
        packet.set(Place(7), 1);
        assert_eq!(packet.bytes(), [0u8; 0]);
    }
}
