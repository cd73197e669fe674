//! Executes LBP16 packets as the card's firmware does: command by command, each address space with
//! its rules; an error ends the packet and swallows its whole answer, while what was written before
//! stays written.

use taktil_hal::Nanos;

use crate::card::Card;

/// Most bytes of an answer that leave the card in one frame.
const ANSWER_BYTES_MAX: usize = 1_472;
/// Words of a 16-bit space.
const SPACE_WORDS: usize = 16;
/// Words of an information area.
const INFO_WORDS: usize = 8;

/// Place of the counter of parser errors in the space of counters.
const PARSE_ERRORS: usize = 1;
/// Place of the counter of accesses outside a space.
const MEMORY_ERRORS: usize = 2;
/// Place of the counter of refused writes.
const WRITE_ERRORS: usize = 3;
/// Places of the counters of packets that came and went.
const PACKETS_IN: [usize; 2] = [4, 5];
/// Places of the counters of packets sent.
const PACKETS_OUT: [usize; 2] = [7, 8];

/// A command's error, by the place of its counter.
#[derive(Clone, Copy, Debug)]
struct Refused(usize);

/// The state of the protocol between packets.
#[derive(Clone, Debug)]
pub(crate) struct Parser {
    /// Where each space goes on without an address, in bytes.
    pointers: [u16; 8],
    info_pointer: u16,
    timers: [u16; SPACE_WORDS],
    counters: [u16; SPACE_WORDS],
    card_name: [u16; SPACE_WORDS],
    chip: [u16; SPACE_WORDS],
    eeprom: [u16; 64],
}

/// One command, taken apart.
#[derive(Clone, Copy, Debug)]
struct Command {
    write: bool,
    space: usize,
    size: u16,
    increments: bool,
    count: usize,
    address: u16,
}

/// Reads what is left of a packet.
struct Words<'a> {
    bytes: &'a [u8],
}

impl Words<'_> {
    fn next(&mut self) -> Result<u16, Refused> {
        let (word, rest) = self.bytes.split_first_chunk::<2>().ok_or(Refused(PARSE_ERRORS))?;
        self.bytes = rest;
        Ok(u16::from_le_bytes(*word))
    }
}

impl Parser {
    pub(crate) fn new(board_name: [u8; 8]) -> Parser {
        let mut parser = Parser {
            pointers: [0; 8],
            info_pointer: 0,
            timers: [0; SPACE_WORDS],
            counters: [0; SPACE_WORDS],
            card_name: [0; SPACE_WORDS],
            chip: [0; SPACE_WORDS],
            eeprom: [0; 64],
        };
        let letters = [&board_name[4..], b"    "].concat();
        for (word, pair) in parser.card_name.iter_mut().zip(letters.chunks(2)) {
            *word = u16::from_le_bytes([pair[0], pair[1]]);
        }
        // Version of the protocol, version of the firmware.
        (parser.card_name[4], parser.card_name[5]) = (3, 15);
        parser
    }

    /// Executes a packet and gives its answer: `None` where nothing was read or something was
    /// wrong.
    pub(crate) fn execute(
        &mut self,
        card: &mut Card,
        now: Nanos,
        packet: &[u8],
    ) -> Option<Vec<u8>> {
        for place in PACKETS_IN {
            self.counters[place] = self.counters[place].wrapping_add(1);
        }
        let mut words = Words { bytes: packet };
        let mut answer = Vec::new();
        while !words.bytes.is_empty() {
            if let Err(Refused(place)) = self.command(card, now, &mut words, &mut answer) {
                self.counters[0] |= 1 << (place - 1);
                self.counters[place] = self.counters[place].saturating_add(1);
                return None;
            }
        }
        if answer.is_empty() || answer.len() > ANSWER_BYTES_MAX {
            return None;
        }
        for place in PACKETS_OUT {
            self.counters[place] = self.counters[place].wrapping_add(1);
        }
        Some(answer)
    }

    fn command(
        &mut self,
        card: &mut Card,
        now: Nanos,
        words: &mut Words<'_>,
        answer: &mut Vec<u8>,
    ) -> Result<(), Refused> {
        let head = words.next()?;
        let (space, info) = (usize::from(head >> 10 & 7), head & 0x2000 != 0);
        let count = usize::from(head & 0x7f);
        if count == 0 || matches!(space, 3 | 5) {
            return Err(Refused(PARSE_ERRORS));
        }
        let pointer = if info { &mut self.info_pointer } else { &mut self.pointers[space] };
        let address = if head & 0x4000 != 0 { words.next()? } else { *pointer };
        *pointer = address;
        let command = Command {
            write: head & 0x8000 != 0,
            space,
            size: head >> 8 & 3,
            increments: head & 0x80 != 0,
            count,
            address,
        };
        if info {
            self.info(command, answer)
        } else if space == 0 {
            self.registers(card, now, command, words, answer)
        } else {
            self.words(now, command, words, answer)
        }
    }

    fn registers(
        &mut self,
        card: &mut Card,
        now: Nanos,
        command: Command,
        words: &mut Words<'_>,
        answer: &mut Vec<u8>,
    ) -> Result<(), Refused> {
        if command.size != 2 {
            return Err(Refused(PARSE_ERRORS));
        }
        let mut address = command.address & !3;
        for _ in 0..command.count {
            if command.write {
                let (low, high) = (words.next()?, words.next()?);
                card.write(address, u32::from(low) | (u32::from(high) << 16), now);
            } else {
                answer.extend(card.read(address, now).to_le_bytes());
            }
            if command.increments {
                address = address.wrapping_add(4);
                self.pointers[0] = address;
            }
        }
        Ok(())
    }

    /// The spaces of 16-bit words.
    fn words(
        &mut self,
        now: Nanos,
        command: Command,
        words: &mut Words<'_>,
        answer: &mut Vec<u8>,
    ) -> Result<(), Refused> {
        if command.size != 1 {
            return Err(Refused(PARSE_ERRORS));
        }
        if command.write && command.space == 7 {
            return Err(Refused(WRITE_ERRORS));
        }
        let mut address = command.address;
        for _ in 0..command.count {
            let at = usize::from(address / 2);
            let space: &mut [u16] = match command.space {
                1 => &mut self.chip,
                2 => &mut self.eeprom,
                4 => &mut self.timers,
                6 => &mut self.counters,
                _ => &mut self.card_name,
            };
            let place = space.get_mut(at).ok_or(Refused(MEMORY_ERRORS))?;
            if command.write {
                *place = words.next()?;
            } else {
                // The first word of the timers' space is the time in microseconds.
                let time = command.space == 4 && at == 0;
                let word = if time { (now.0 / 1_000) as u16 } else { *place };
                answer.extend(word.to_le_bytes());
            }
            if command.increments {
                address = address.wrapping_add(2);
                self.pointers[command.space] = address;
            }
        }
        Ok(())
    }

    /// The information area of a space: cookie, sizes, ranges, pointer, name.
    fn info(&mut self, command: Command, answer: &mut Vec<u8>) -> Result<(), Refused> {
        if command.size != 1 {
            return Err(Refused(PARSE_ERRORS));
        }
        if command.write {
            return Err(Refused(WRITE_ERRORS));
        }
        let name: [u8; 8] = match command.space {
            0 => *b"HostMot2",
            1 => *b"KSZ8851M",
            2 => *b"EtherEEP",
            4 => *b"Timers  ",
            6 => *b"LBP16RW ",
            _ => *b"LBP16RO ",
        };
        let sizes = if command.space == 0 { 0x8104 } else { 0x8102 };
        let letter = |at: usize| u16::from_le_bytes([name[at], name[at + 1]]);
        let area = [
            0x5a00 + command.space as u16,
            sizes,
            if command.space == 0 { 0x10 } else { 0x05 },
            self.pointers[command.space],
            letter(0),
            letter(2),
            letter(4),
            letter(6),
        ];
        debug_assert_eq!(area.len(), INFO_WORDS);
        let mut address = command.address;
        for _ in 0..command.count {
            let word = area.get(usize::from(address / 2)).ok_or(Refused(MEMORY_ERRORS))?;
            answer.extend(word.to_le_bytes());
            if command.increments {
                address = address.wrapping_add(2);
                self.info_pointer = address;
            }
        }
        Ok(())
    }
}
