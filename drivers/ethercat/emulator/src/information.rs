//! The image of a device's information memory (SII): header with identity and mailboxes, then the
//! categories with names, FMMUs, sync managers and process data.

use crate::description::{
    Description, MAILBOX_BYTES, MAILBOX_IN_ADDRESS, MAILBOX_OUT_ADDRESS, Pdo, Purpose,
};

/// Bytes of the memory.
const MEMORY_BYTES: usize = 2_048;
/// Bytes of the header, behind which the categories begin.
const HEADER_BYTES: usize = 128;
/// The mailbox speaks CoE.
const COE_PROTOCOL_BIT: u16 = 4;
/// SDO, SDO information, assignment and configuration of process data.
const COE_DETAILS: u8 = 0x0f;

/// The bytes of the memory.
pub(crate) fn image(device: &Description) -> Vec<u8> {
    let mut bytes = header(device);
    let name = format!("{} (emulated)", device.order);
    let mut strings = vec![2];
    for text in [device.order, &name] {
        strings.push(text.len() as u8);
        strings.extend(text.as_bytes());
    }
    push(&mut bytes, 10, strings);
    let mut general = vec![0; 32];
    (general[2], general[3]) = (1, 2);
    general[5] = if device.has_mailbox { COE_DETAILS } else { 0 };
    general[12..14].copy_from_slice(&120_i16.to_le_bytes());
    general[14] = 0x33;
    push(&mut bytes, 30, general);
    if !device.sync_managers.is_empty() {
        push(&mut bytes, 40, fmmus(device));
        push(&mut bytes, 41, sync_managers(device));
    }
    for (category, purpose, pdos) in
        [(50, Purpose::Inputs, &device.inputs), (51, Purpose::Outputs, &device.outputs)]
    {
        let manager = device.sync_managers.iter().position(|one| one.purpose == purpose);
        if let Some(manager) = manager.filter(|_| !pdos.is_empty()) {
            push(&mut bytes, category, process_data(pdos, manager as u8));
        }
    }
    bytes.extend([0xff; 4]);
    bytes.resize(MEMORY_BYTES, 0xff);
    bytes
}

fn header(device: &Description) -> Vec<u8> {
    let mut bytes = vec![0; HEADER_BYTES];
    let mut put = |word: usize, value: u16| {
        bytes[2 * word..2 * word + 2].copy_from_slice(&value.to_le_bytes());
    };
    put(0, 5);
    put(4, device.alias);
    for (word, value) in [(8, device.vendor), (0xa, device.product), (0xc, device.revision)] {
        put(word, value as u16);
        put(word + 1, (value >> 16) as u16);
    }
    if device.has_mailbox {
        put(0x18, MAILBOX_OUT_ADDRESS);
        put(0x19, MAILBOX_BYTES);
        put(0x1a, MAILBOX_IN_ADDRESS);
        put(0x1b, MAILBOX_BYTES);
        put(0x1c, COE_PROTOCOL_BIT);
    }
    put(0x3e, 15);
    put(0x3f, 1);
    bytes[14] = check_sum(&bytes[..14]);
    bytes
}

/// The check sum of the first words: CRC-8 with the polynomial 7, which begins with all bits set.
fn check_sum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0xff, |sum, byte| {
        (0..8).fold(sum ^ byte, |sum: u8, _| if sum & 0x80 == 0 { sum << 1 } else { sum << 1 ^ 7 })
    })
}

fn push(bytes: &mut Vec<u8>, category: u16, mut body: Vec<u8>) {
    if body.len() % 2 == 1 {
        body.push(0xff);
    }
    bytes.extend(category.to_le_bytes());
    bytes.extend((body.len() as u16 / 2).to_le_bytes());
    bytes.extend(body);
}

fn fmmus(device: &Description) -> Vec<u8> {
    if device.has_mailbox {
        return vec![1, 2, 3, 0];
    }
    let usage = |purpose| if purpose == Purpose::Outputs { 1 } else { 2 };
    device.sync_managers.iter().map(|one| usage(one.purpose)).collect()
}

fn sync_managers(device: &Description) -> Vec<u8> {
    let mut bytes = Vec::new();
    for one in &device.sync_managers {
        bytes.extend(one.address.to_le_bytes());
        bytes.extend(one.length.to_le_bytes());
        let is_mailbox = matches!(one.purpose, Purpose::MailboxOut | Purpose::MailboxIn);
        let enabled = u8::from(is_mailbox || one.length > 0);
        bytes.extend([one.control, 0, enabled, one.purpose as u8]);
    }
    bytes
}

fn process_data(pdos: &[Pdo], manager: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    for pdo in pdos {
        bytes.extend(pdo.index.to_le_bytes());
        bytes.extend([pdo.entries.len() as u8, manager, 0, 0, 0, 0]);
        for entry in &pdo.entries {
            let data_type = match entry.bits {
                1 => 1,
                8 => 5,
                16 => 6,
                32 => 7,
                _ => 0,
            };
            bytes.extend(entry.index.to_le_bytes());
            bytes.extend([entry.subindex, 0, data_type, entry.bits, 0, 0]);
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::description::Model;

    #[test]
    fn identity_stands_at_its_words_and_categories_end() {
        let bytes = image(&Description::from(Model::AnalogOutput).with_alias(7));
        assert_eq!(bytes.len(), MEMORY_BYTES);
        assert_eq!(bytes[16..24], [2, 0, 0, 0, 0x52, 0x30, 0x26, 0x10]);
        assert_eq!(bytes[8], 7);
        let mut at = HEADER_BYTES;
        let mut seen = Vec::new();
        loop {
            let word = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
            if word(at) == 0xffff {
                break;
            }
            seen.push(word(at));
            at += 4 + 2 * usize::from(word(at + 2));
        }
        assert_eq!(seen, [10, 30, 40, 41, 51]);
    }

    #[test]
    fn the_check_sum_is_that_of_a_known_header() {
        // CRC-8 of polynomial 7 over the digits 1 to 9 is 0xf4 from zero and 0xfb from all ones.
        assert_eq!(check_sum(b"123456789"), 0xfb);
    }
}
