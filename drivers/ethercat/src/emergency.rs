//! Finds emergency messages of CoE in frames that come back from mailboxes.

/// Headers of Ethernet and EtherCAT.
const FRAME_HEADER_BYTES: usize = 16;
/// Header and working counter of a datagram.
const DATAGRAM_OVERHEAD_BYTES: usize = 12;
/// Mailboxes lie in the process memory of a device.
const PROCESS_MEMORY_ADDRESS: u16 = 0x1000;
/// Reads the device at a station address.
const READ_COMMAND: u8 = 4;
/// Bytes of a mailbox's header, CoE's and the message.
const EMERGENCY_BYTES: usize = 16;
/// CoE in the type of a mailbox message.
const COE_TYPE: u8 = 3;

/// The code of the first emergency message that a frame carries.
pub(crate) fn emergency_code(frame: &[u8]) -> Option<u16> {
    let mut rest = frame.get(FRAME_HEADER_BYTES..)?;
    while rest.len() >= DATAGRAM_OVERHEAD_BYTES {
        let flags = u16::from_le_bytes([rest[6], rest[7]]);
        let count = usize::from(flags & 0x07ff);
        let data = rest.get(10..10 + count)?;
        let address = u16::from_le_bytes([rest[4], rest[5]]);
        let is_answered = rest.get(10 + count..12 + count)? != [0, 0];
        let is_mailbox = rest[0] == READ_COMMAND && address >= PROCESS_MEMORY_ADDRESS;
        if is_mailbox && is_answered && is_emergency(data) {
            return Some(u16::from_le_bytes([data[8], data[9]]));
        }
        if flags & 0x8000 == 0 {
            return None;
        }
        rest = rest.get(DATAGRAM_OVERHEAD_BYTES + count..)?;
    }
    None
}

fn is_emergency(mailbox: &[u8]) -> bool {
    if mailbox.len() < EMERGENCY_BYTES {
        return false;
    }
    let length = u16::from_le_bytes([mailbox[0], mailbox[1]]);
    let service = u16::from_le_bytes([mailbox[6], mailbox[7]]);
    length == 10 && mailbox[5] & 0x0f == COE_TYPE && service == 0x1000
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame(command: u8, address: u16, data: &[u8], counter: u16) -> Vec<u8> {
        let mut frame = vec![0; FRAME_HEADER_BYTES];
        frame.extend([command, 0, 1, 0x10]);
        frame.extend(address.to_le_bytes());
        frame.extend((data.len() as u16).to_le_bytes());
        frame.extend([0, 0]);
        frame.extend(data);
        frame.extend(counter.to_le_bytes());
        frame
    }

    #[test]
    fn an_emergency_in_a_mailbox_is_seen_and_nothing_else() {
        let mut mailbox = vec![10, 0, 0, 0, 0, 0x13, 0, 0x10, 0x30, 0x81, 0x11];
        mailbox.resize(128, 0);
        assert_eq!(emergency_code(&frame(4, 0x1080, &mailbox, 1)), Some(0x8130));
        assert_eq!(emergency_code(&frame(4, 0x1080, &mailbox, 0)), None, "nobody answered");
        assert_eq!(emergency_code(&frame(4, 0x0600, &mailbox, 1)), None, "registers");
        assert_eq!(emergency_code(&frame(5, 0x1080, &mailbox, 1)), None, "a write");
        mailbox[7] = 0x30;
        assert_eq!(emergency_code(&frame(4, 0x1080, &mailbox, 1)), None, "an SDO's answer");
    }

    proptest! {
        #[test]
        fn no_frame_makes_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = emergency_code(&bytes);
        }
    }
}
