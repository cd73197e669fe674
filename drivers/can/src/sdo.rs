//! Service data objects of CANopen as the client of a node: expedited reading and writing of up to
//! four bytes.

use crate::frame::Frame;

/// What a node answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The value of an object, its unused bytes 0.
    Value(u32),
    /// The object was written.
    Written,
    /// The node refused, with the number of the reason.
    Abort(u32),
}

/// The request to read an object of a node.
#[must_use]
pub fn upload(node: u8, index: u16, sub: u8) -> Frame {
    let [low, high] = index.to_le_bytes();
    Frame::classic(0x600 + u16::from(node), &[0x40, low, high, sub, 0, 0, 0, 0])
}

/// The request to write `bits` of a value, 8 to 32, to an object of a node.
#[must_use]
pub fn download(node: u8, index: u16, sub: u8, bits: u8, value: u32) -> Frame {
    let unused = 4 - (bits / 8).clamp(1, 4);
    let [low, high] = index.to_le_bytes();
    let [a, b, c, d] = value.to_le_bytes();
    let command = 0x23 | (unused << 2);
    Frame::classic(0x600 + u16::from(node), &[command, low, high, sub, a, b, c, d])
}

/// What a frame answers to a request for an object of a node; `None` for one that does not.
#[must_use]
pub fn answer(frame: &Frame, node: u8, index: u16, sub: u8) -> Option<Answer> {
    if frame.id != 0x580 + u32::from(node) || frame.is_remote || frame.is_error {
        return None;
    }
    let [command, low, high, at, a, b, c, d] = *frame.data() else { return None };
    if u16::from_le_bytes([low, high]) != index || at != sub {
        return None;
    }
    let value = u32::from_le_bytes([a, b, c, d]);
    match command {
        0x60 => Some(Answer::Written),
        0x80 => Some(Answer::Abort(value)),
        // Expedited, with the number of unused bytes where it is said.
        command if command & 0xe2 == 0x42 => {
            let unused = if command & 1 != 0 { u32::from((command >> 2) & 3) } else { 0 };
            Some(Answer::Value(value & (u32::MAX >> (8 * unused))))
        }
        _ => None,
    }
}

/// The reason of a refusal, for people.
#[must_use]
pub const fn abort_text(reason: u32) -> &'static str {
    match reason {
        0x0503_0000 => "toggle bit not alternated",
        0x0504_0000 => "protocol timed out",
        0x0504_0001 => "command unknown",
        0x0601_0000 => "access not supported",
        0x0601_0001 => "object can only be written",
        0x0601_0002 => "object can only be read",
        0x0602_0000 => "there is no such object",
        0x0604_0041 => "object cannot be mapped",
        0x0604_0042 => "PDO would be too long",
        0x0604_0043 => "parameters do not fit",
        0x0606_0000 => "hardware error",
        0x0607_0010 => "length does not fit",
        0x0609_0011 => "there is no such sub-index",
        0x0609_0030 => "value out of range",
        0x0609_0031 => "value too high",
        0x0609_0032 => "value too low",
        0x0800_0020 => "value cannot be stored",
        0x0800_0021 => "value cannot be stored because of local control",
        0x0800_0022 => "value cannot be stored in this state",
        _ => "reason unknown to the standard",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_every_length_are_read() {
        let read = |bytes: [u8; 8]| answer(&Frame::classic(0x585, &bytes), 5, 0x6076, 0);
        assert_eq!(read([0x43, 0x76, 0x60, 0, 1, 2, 3, 4]), Some(Answer::Value(0x0403_0201)));
        assert_eq!(read([0x4b, 0x76, 0x60, 0, 1, 2, 3, 4]), Some(Answer::Value(0x0201)));
        assert_eq!(read([0x4f, 0x76, 0x60, 0, 1, 2, 3, 4]), Some(Answer::Value(1)));
        assert_eq!(read([0x42, 0x76, 0x60, 0, 1, 2, 3, 4]), Some(Answer::Value(0x0403_0201)));
        assert_eq!(read([0x60, 0x76, 0x60, 0, 0, 0, 0, 0]), Some(Answer::Written));
        assert_eq!(read([0x80, 0x76, 0x60, 0, 0, 0, 2, 6]), Some(Answer::Abort(0x0602_0000)));
        assert_eq!(read([0x43, 0x76, 0x60, 1, 1, 2, 3, 4]), None, "another sub-index");
        assert_eq!(read([0x41, 0x76, 0x60, 0, 9, 0, 0, 0]), None, "in segments");
        assert_eq!(answer(&Frame::classic(0x586, &[0x60; 8]), 5, 0x6060, 0x60), None);
        assert_eq!(answer(&Frame::classic(0x585, &[0x60; 7]), 5, 0x6060, 0x60), None);
    }
}
