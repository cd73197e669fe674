//! The published numbers of LBP16, HostMot2 and the 7I77 as they stand on the wire: every address,
//! word and order that the driver sends to a 7I92 with a 7I77, byte by byte, against figures of the
//! manuals and of the firmware's sources.

mod rig;

use rig::{CYCLE_PERIOD, Rig, with_7i77};
use taktil_drivers_mesa::lbp16::{Packet, Space};
use taktil_drivers_mesa::{Config, Halves, LEVEL_LIMIT};
use taktil_drivers_mesa_emulator::Firmware;
use taktil_hal::{AnalogOut, CHANNELS, DacCode, DigitalOut, Encoders, LinesOut, Nanos};

/// One command of a packet.
#[derive(Clone, Debug, PartialEq)]
struct Command {
    head: u16,
    address: u16,
    /// Data of a write, in words of 16 bits.
    data: Vec<u16>,
}

impl Command {
    fn is_write(&self) -> bool {
        self.head & 0x8000 != 0
    }

    fn word(&self, index: usize) -> u32 {
        u32::from(self.data[2 * index]) | (u32::from(self.data[2 * index + 1]) << 16)
    }
}

/// Takes a packet apart by the table of the manual: bit 15 write, 14 address, 13 information area,
/// 12 to 10 space, 9 and 8 size, 7 increment, 6 to 0 count.
fn commands(packet: &[u8]) -> Vec<Command> {
    let mut words = packet.chunks(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]]));
    let mut all = Vec::new();
    while let Some(head) = words.next() {
        assert_eq!(head & 0x4000, 0x4000, "an address of its own");
        assert_eq!(head & 0x2000, 0, "no information area");
        assert_eq!(head & 0x0080, 0x0080, "addresses go on");
        let size_words = match (head >> 10 & 7, head >> 8 & 3) {
            (0, 2) => 2,
            (4 | 6 | 7, 1) => 1,
            other => panic!("space and size {other:?} are refused by a card"),
        };
        let count = usize::from(head & 0x7f);
        assert_ne!(count, 0, "a count of 0 is refused by a card");
        let address = words.next().unwrap();
        let data = if head & 0x8000 == 0 { 0 } else { size_words * count };
        all.push(Command { head, address, data: words.by_ref().take(data).collect() });
    }
    all
}

/// The registers that some packets write, in order.
fn writes(packets: &[Vec<u8>]) -> Vec<(u16, u32)> {
    let commands = packets.iter().flat_map(|packet| commands(packet));
    let registers = commands.filter(|c| c.is_write() && c.head >> 10 & 7 == 0);
    registers.map(|command| (command.address, command.word(0))).collect()
}

struct Wire {
    rig: Rig,
    halves: Halves,
    release: Nanos,
    opening: Vec<Vec<u8>>,
}

fn open(config: &Config) -> Wire {
    let rig = Rig::new(Firmware::with_7i77());
    rig.set_counts([0; 6]);
    let halves = rig.open(config).unwrap();
    let opening = std::mem::take(&mut rig.world.lock().unwrap().sent);
    Wire { rig, halves, release: Nanos::from_millis(500), opening }
}

impl Wire {
    fn cycle(&mut self, code: i32, lines: LinesOut) -> Vec<Vec<u8>> {
        self.release += CYCLE_PERIOD;
        self.rig.advance(self.release);
        self.halves.encoders.as_mut().unwrap().sample(self.release).unwrap();
        let codes = [DacCode(code); CHANNELS];
        self.halves.analog_out.as_mut().unwrap().commit(self.release, &codes).unwrap();
        self.halves.digital_out.as_mut().unwrap().commit(self.release, &lines).unwrap();
        std::mem::take(&mut self.rig.world.lock().unwrap().sent)
    }
}

const LIVE_LINES: LinesOut = LinesOut { enable: true, brake_release: false, watchdog_feed: true };

#[test]
fn reading_the_config_name_is_the_vector_of_the_manual() {
    let mut packet = Packet::default();
    packet.read(Space::Registers, 0x0104, 2);
    assert_eq!(packet.bytes(), [0x82, 0x42, 0x04, 0x01]);
    // The other spaces are of 16 bits: timers 4, counters 6, names 7.
    for (space, head) in [(Space::Timers, 0x51), (Space::Counters, 0x59), (Space::Names, 0x5d)] {
        let mut packet = Packet::default();
        packet.read(space, 0x0002, 3);
        assert_eq!(packet.bytes(), [0x83, head, 0x02, 0x00]);
        assert_eq!(packet.answer_bytes(), 6);
    }
}

#[test]
fn every_packet_keeps_the_rules_whose_breach_swallows_an_answer() {
    let mut wire = open(&with_7i77());
    let mut packets = wire.opening.clone();
    for _ in 0..5 {
        packets.extend(wire.cycle(5, LIVE_LINES));
    }
    assert!(packets.len() > 20);
    for packet in &packets {
        assert!(packet.len() <= 1_472 && !commands(packet).is_empty());
    }
}

#[test]
fn a_card_is_identified_at_the_published_places() {
    let wire = open(&with_7i77());
    let reads: Vec<(u16, u16)> = wire
        .opening
        .iter()
        .flat_map(|packet| commands(packet))
        .filter(|command| !command.is_write() && command.head >> 10 & 7 == 0)
        .map(|command| (command.address, command.head & 0x7f))
        .collect();
    // Cookie, name and place of the IDROM; its head; 32 modules of 3 words; a word for each pin.
    assert_eq!(reads[..4], [(0x0100, 4), (0x0400, 16), (0x0440, 96), (0x0600, 34)]);
}

#[test]
fn an_answer_is_numbered_by_the_scratch_words() {
    let mut wire = open(&with_7i77());
    wire.cycle(0, LIVE_LINES);
    let sent = wire.cycle(0, LIVE_LINES);
    let (read, write) = (commands(&sent[0]), commands(&sent[1]));
    // Space 4: the request's number at 0x10, the write's at 0x14, both read back in one packet.
    assert_eq!((read[0].head, read[0].address), (0xd182, 0x10));
    let last = read.last().unwrap();
    assert_eq!((last.head, last.address), (0x5186, 0x10));
    let last = write.last().unwrap();
    assert_eq!((last.head, last.address), (0xd182, 0x14));
    let stamp = read.iter().position(|command| command.address == 0x3800).unwrap();
    let counts = read.iter().position(|command| command.address == 0x3500).unwrap();
    assert!(stamp < counts, "the stamps' clock before the counts");
    assert_eq!(read[counts].head, 0x4286, "six counts in one command");
    let addresses: Vec<u16> = read.iter().map(|command| command.address).collect();
    for address in [0x0d00, 0x3600, 0x5a00, 0x5b00, 0x5c00, 0x5c04, 0x5d00] {
        assert!(addresses.contains(&address), "{address:#x} in {addresses:x?}");
    }
}

#[test]
fn codes_enables_and_exchange_stand_where_the_7i77_has_them() {
    let mut wire = open(&with_7i77());
    wire.cycle(0, LIVE_LINES);
    // A change of the feed line is what makes lines alive.
    let lines = LinesOut { watchdog_feed: false, ..LIVE_LINES };
    let written = writes(&wire.cycle(-4_096, lines)[1..]);
    // Six times 13 bits of which only the highest is set, and bit 78 of the 96.
    let bits = (0..6).fold(1_u128 << 78, |bits, channel| bits | (1 << (13 * channel + 12)));
    let words = [bits as u32, (bits >> 32) as u32, (bits >> 64) as u32];
    for (address, word) in [
        (0x5d00, 1 | 2),
        (0x5d04, words[0]),
        (0x5e04, words[1]),
        (0x5f04, words[2]),
        (0x5a00, 0x1000 | 3),
        (0x0e00, 0x5a00_0000),
    ] {
        assert!(written.contains(&(address, word)), "{address:#x} {word:#x}: {written:x?}");
    }
    // The exchange comes behind the words that it carries, the sign of life behind both.
    let at = |address| written.iter().position(|(other, _)| *other == address).unwrap();
    assert!(at(0x5f04) < at(0x5a00) && at(0x5d00) < at(0x5a00) && at(0x5a00) < at(0x0e00));
    let (low, high) = wire.halves.analog_out.as_ref().unwrap().code_range();
    assert_eq!((low, high), (DacCode(-4_096), DacCode(4_095)));
}

#[test]
fn nothing_comes_out_before_directions_and_alternates_and_zeros_come_first() {
    let wire = open(&with_7i77());
    let written = writes(&wire.opening);
    let first = |address| written.iter().position(|(other, _)| *other == address).unwrap();
    for zero in [0x5d04, 0x5e04, 0x5f04, 0x1000, 0x1300, 0x1400, 0x1200] {
        assert!(first(zero) < first(0x1100), "{zero:#x}");
        assert!(written.iter().filter(|(at, _)| *at == zero && *at != 0x1200).all(|w| w.1 == 0));
    }
    // Transmit and enable pins of two channels, and the select line of the muxed encoders; the
    // third channel is not used, its pins stay inputs.
    let pins = (1 << 3) | (1 << 5) | (1 << 7);
    assert!(written.contains(&(0x1200, pins)) && written.contains(&(0x1100, pins)), "{written:x?}");
    // Stop, setup mode to ask for names, stop, start: the channels 0 and 1.
    let commands: Vec<u32> =
        written.iter().filter(|(at, _)| *at == 0x5a00).map(|(_, word)| *word).collect();
    assert_eq!(commands, [0x0800, 0x0f03, 0x0800, 0x0903]);
    // The watchdog is off (the sign bit), its status clear, before any output is asked for.
    assert!(written.contains(&(0x0c00, 0x8000_0000)) && written.contains(&(0x0d00, 0)));
}

#[test]
fn encoders_are_set_up_by_the_published_bits() {
    let wire = open(&with_7i77());
    let written = writes(&wire.opening);
    // 100 MHz by 1 MHz, less 2.
    assert!(written.contains(&(0x3700, 98)));
    // Filter, once, latch on index, index high.
    for channel in 0..6 {
        let control = (1 << 11) | (1 << 6) | (1 << 4) | (1 << 3);
        assert!(written.contains(&(0x3600 + 4 * channel, control)), "{channel}: {written:x?}");
    }
    // Any write to a count clears it: there is none.
    assert!(written.iter().all(|(address, _)| !(0x3500..0x3600).contains(address)));
}

#[test]
fn the_watchdog_counts_the_low_clock_and_bites_when_the_card_is_let_go() {
    let mut wire = open(&Config { watchdog_ms: 10, ..with_7i77() });
    let written = writes(&wire.cycle(0, LIVE_LINES));
    assert!(written.contains(&(0x0c00, 999_999)), "10 ms of 100 MHz: {written:x?}");
    let Wire { rig, halves, .. } = wire;
    drop(halves);
    let written = writes(&std::mem::take(&mut rig.world.lock().unwrap().sent));
    assert_eq!(written.last(), Some(&(0x0c00, 1)), "{written:x?}");
}

#[test]
fn a_link_fails_at_a_level_of_ten() {
    assert_eq!(LEVEL_LIMIT, 10);
}
