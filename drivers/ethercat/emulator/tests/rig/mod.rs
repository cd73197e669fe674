//! A host that writes datagrams by hand, for the tests of the emulator.
#![allow(dead_code, reason = "each test program uses a part of it")]

use taktil_drivers_ethercat_emulator::Segment;
use taktil_hal::Nanos;

/// From one frame to the next.
const FRAME_PERIOD: Nanos = Nanos::from_micros(100);
/// Address of the first device.
pub(crate) const STATION_ADDRESS: u16 = 0x1001;

/// Bytes of a text of hexadecimal digits.
pub(crate) fn hex(text: &str) -> Vec<u8> {
    let digits: Vec<u8> = text.bytes().filter(u8::is_ascii_hexdigit).collect();
    let pair = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    digits.chunks(2).map(pair).collect()
}

/// A host before a segment.
pub(crate) struct Host {
    pub(crate) segment: Segment,
    pub(crate) now: Nanos,
}

impl Host {
    pub(crate) fn new(segment: Segment) -> Host {
        Host { segment, now: Nanos::from_millis(1) }
    }

    /// Sends what follows Ethernet's header; the same part of the answer.
    pub(crate) fn exchange(&mut self, content: &[u8]) -> Option<Vec<u8>> {
        let mut frame = vec![0xff; 6];
        frame.extend([0x10; 6]);
        frame.extend([0x88, 0xa4]);
        frame.extend(content);
        self.now += FRAME_PERIOD;
        self.segment.receive(self.now, &frame);
        let mut answers = Vec::new();
        self.segment.poll(self.now, &mut answers);
        let answer = answers.pop()?;
        assert_eq!(answer[6], 0x12, "the first device marks what it sends back");
        Some(answer[14..].to_vec())
    }

    /// One datagram; the data of its answer and its working counter.
    pub(crate) fn datagram(&mut self, command: u8, address: u32, data: &[u8]) -> (Vec<u8>, u16) {
        let length = data.len() as u16;
        let mut content = (0x1000 | (length + 12)).to_le_bytes().to_vec();
        content.extend([command, 0]);
        content.extend(address.to_le_bytes());
        content.extend(length.to_le_bytes());
        content.extend([0, 0]);
        content.extend(data);
        content.extend([0, 0]);
        let answer = self.exchange(&content).expect("an answer");
        let end = 12 + data.len();
        let counter = u16::from_le_bytes([answer[end], answer[end + 1]]);
        (answer[12..end].to_vec(), counter)
    }

    /// Writes a register of the device at `station`; the working counter.
    pub(crate) fn write(&mut self, station: u16, register: u16, data: &[u8]) -> u16 {
        self.datagram(5, u32::from(station) | u32::from(register) << 16, data).1
    }

    /// Reads such a register.
    pub(crate) fn read(&mut self, station: u16, register: u16, count: usize) -> (Vec<u8>, u16) {
        self.datagram(4, u32::from(station) | u32::from(register) << 16, &vec![0; count])
    }

    /// State and code of the application layer.
    pub(crate) fn state(&mut self, station: u16) -> (u16, u16) {
        let status = self.read(station, 0x0130, 2).0;
        let code = self.read(station, 0x0134, 2).0;
        (u16::from_le_bytes([status[0], status[1]]), u16::from_le_bytes([code[0], code[1]]))
    }

    /// Gives addresses from 0x1000 on, and mailboxes of 128 bytes to `station`, and leads it to
    /// PREOP.
    pub(crate) fn prepare(&mut self, devices: u16, station: u16) {
        for position in 0..devices {
            let address = u32::from(position.wrapping_neg()) | 0x0010 << 16;
            self.datagram(2, address, &(0x1000 + position).to_le_bytes());
        }
        self.write(station, 0x0800, &hex("0010 8000 26 00 01 00"));
        self.write(station, 0x0808, &hex("8010 8000 22 00 01 00"));
        self.write(station, 0x0120, &[2, 0]);
        assert_eq!(self.state(station), (2, 0));
    }

    /// Writes a message into the mailbox, and reads the answer.
    pub(crate) fn mail(&mut self, station: u16, message: &[u8]) -> Option<Vec<u8>> {
        let mut full = message.to_vec();
        full.resize(128, 0);
        assert_eq!(self.write(station, 0x1000, &full), 1);
        self.collect(station)
    }

    /// Reads the mailbox, when it is full.
    pub(crate) fn collect(&mut self, station: u16) -> Option<Vec<u8>> {
        let (data, counter) = self.read(station, 0x1080, 128);
        (counter == 1).then_some(data)
    }
}
