//! A frame's way through a chain of devices: each datagram is executed by the devices that it
//! addresses, and its working counter grows by what each of them did.

use taktil_hal::Nanos;

use crate::controller::LogicalCommand;
use crate::device::Device;

/// Ethernet's header.
const ETHERNET_BYTES: usize = 14;
/// Where the datagrams begin: behind the headers of Ethernet and EtherCAT.
const FIRST_DATAGRAM: usize = ETHERNET_BYTES + 2;
/// Header of a datagram.
const HEADER_BYTES: usize = 10;
/// Working counter of a datagram.
const COUNTER_BYTES: usize = 2;
/// Type of EtherCAT in Ethernet's header, as it stands on the wire.
pub(crate) const ETHERNET_TYPE_BYTES: [u8; 2] = [0x88, 0xa4];
/// The first device marks the source of what it sends back.
const RETURNED_BIT: u8 = 2;
/// More datagrams follow.
const MORE_BIT: u16 = 0x8000;

/// Whether bytes are a frame of EtherCAT.
pub(crate) fn is_frame(bytes: &[u8]) -> bool {
    bytes.len() >= FIRST_DATAGRAM && bytes[12..14] == ETHERNET_TYPE_BYTES
}

/// Whether a frame carries the logical image.
pub(crate) fn is_cyclic(frame: &[u8]) -> bool {
    let mut at = FIRST_DATAGRAM;
    while let Some(header) = frame.get(at..at + HEADER_BYTES) {
        if (10..=12).contains(&header[0]) {
            return true;
        }
        let flags = u16::from_le_bytes([header[6], header[7]]);
        if flags & MORE_BIT == 0 {
            return false;
        }
        at += HEADER_BYTES + usize::from(flags & 0x07ff) + COUNTER_BYTES;
    }
    false
}

/// Leads a frame through the chain, in place. Datagrams that the frame cuts short are left alone.
pub(crate) fn execute(chain: &mut [Device], frame: &mut [u8], now: Nanos) {
    if !is_frame(frame) {
        return;
    }
    let length = usize::from(u16::from_le_bytes([frame[14], frame[15]]) & 0x07ff);
    let end = (FIRST_DATAGRAM + length).min(frame.len());
    let mut at = FIRST_DATAGRAM;
    while at + HEADER_BYTES + COUNTER_BYTES <= end {
        let flags = u16::from_le_bytes([frame[at + 6], frame[at + 7]]);
        let count = usize::from(flags & 0x07ff);
        let next = at + HEADER_BYTES + count + COUNTER_BYTES;
        if next > end {
            break;
        }
        execute_one(chain, &mut frame[at..next], now);
        at = next;
        if flags & MORE_BIT == 0 {
            break;
        }
    }
    frame[6] |= RETURNED_BIT;
}

/// How a command finds its devices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Addressing {
    Position,
    Station,
    Broadcast,
}

fn execute_one(chain: &mut [Device], datagram: &mut [u8], now: Nanos) {
    let command = datagram[0];
    let (header, body) = datagram.split_at_mut(HEADER_BYTES);
    let (data, counter) = body.split_at_mut(body.len() - COUNTER_BYTES);
    let place = u16::from_le_bytes([header[2], header[3]]);
    let offset = u16::from_le_bytes([header[4], header[5]]);
    let mut count = u16::from_le_bytes([counter[0], counter[1]]);
    match command {
        1..=9 | 13 | 14 => {
            let addressing = match command {
                1..=3 | 13 => Addressing::Position,
                4..=6 | 14 => Addressing::Station,
                _ => Addressing::Broadcast,
            };
            let mut walk = Walk { place, offset, now };
            for device in chain {
                let added = walk.pass(device, command, addressing, data);
                count = count.wrapping_add(added);
            }
            header[2..4].copy_from_slice(&walk.place.to_le_bytes());
        }
        10..=12 => {
            let logical = u32::from(place) | u32::from(offset) << 16;
            let kind = LogicalCommand { reads: command != 11, writes: command != 10 };
            let outgoing = data.to_vec();
            for device in chain {
                count = count.wrapping_add(device.exchange(logical, kind, &outgoing, data, now));
            }
        }
        _ => {}
    }
    counter.copy_from_slice(&count.to_le_bytes());
}

/// A datagram with a physical address on its way.
struct Walk {
    place: u16,
    offset: u16,
    now: Nanos,
}

impl Walk {
    /// Passes one device; what it adds to the counter.
    fn pass(
        &mut self,
        device: &mut Device,
        command: u8,
        addressing: Addressing,
        data: &mut [u8],
    ) -> u16 {
        let is_hit = match addressing {
            Addressing::Position => self.place == 0,
            Addressing::Station => self.place == device.controller.station(),
            Addressing::Broadcast => true,
        };
        if addressing != Addressing::Station {
            self.place = self.place.wrapping_add(1);
        }
        if command >= 13 {
            // One device is read, and every other one is written with what it gave.
            let done = if is_hit {
                self.read(device, data, false)
            } else {
                device.write(self.offset, data, self.now)
            };
            return u16::from(done);
        }
        if !is_hit {
            return 0;
        }
        let outgoing = data.to_vec();
        let reads = matches!(command % 3, 1 | 0);
        let writes = matches!(command % 3, 2 | 0);
        let mut added = 0;
        if reads && self.read(device, data, addressing == Addressing::Broadcast) {
            added += 1;
        }
        if writes && device.write(self.offset, &outgoing, self.now) {
            added += if reads { 2 } else { 1 };
        }
        added
    }

    /// Reads a device; a broadcast gathers the bits of all of them.
    fn read(&self, device: &mut Device, data: &mut [u8], is_gathered: bool) -> bool {
        let mut own = vec![0; data.len()];
        let done = device.read(self.offset, &mut own, self.now);
        if done {
            for (byte, own) in data.iter_mut().zip(own) {
                *byte = if is_gathered { *byte | own } else { own };
            }
        }
        done
    }
}
