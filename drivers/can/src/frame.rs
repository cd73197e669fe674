//! Frames of a CAN bus and their layout as the kernel passes them: 16 bytes for classic CAN, 72 for
//! CAN FD. Frames by which the controller reports an error are told apart by their classes.

/// Length of a classic frame as the kernel passes it (bytes).
pub const CLASSIC_BYTES: usize = 16;
/// Length of a frame of CAN FD as the kernel passes it (bytes).
pub const FLEXIBLE_BYTES: usize = 72;
/// Most data bytes of a frame of CAN FD.
pub const DATA_BYTES_MAX: usize = 64;
/// Most data bytes of a classic frame.
const CLASSIC_DATA_BYTES_MAX: usize = 8;
/// Where data begin in both layouts.
const DATA_OFFSET: usize = 8;
/// Lengths that a frame of CAN FD can have above 8.
const FLEXIBLE_LENGTHS: [u8; 7] = [12, 16, 20, 24, 32, 48, 64];
/// Bit 31 of the word of the identifier: 29 bits long.
const EXTENDED_BIT: u32 = 1 << 31;
/// Bit 30: a request without data.
const REMOTE_BIT: u32 = 1 << 30;
/// Bit 29: a report of the controller.
const ERROR_BIT: u32 = 1 << 29;
/// Bit of the flags: data are sent at the higher rate.
const RATE_SWITCH_BIT: u8 = 1;
/// Bit of the flags: a frame of CAN FD.
const FLEXIBLE_BIT: u8 = 4;

/// A frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Identifier, 11 or 29 bits; the class of an error.
    pub id: u32,
    /// Whether the identifier has 29 bits.
    pub is_extended: bool,
    /// Whether it asks for a frame instead of carrying data.
    pub is_remote: bool,
    /// Whether the controller reports an error by it.
    pub is_error: bool,
    /// Whether it is a frame of CAN FD, which then also switches its rate.
    pub is_flexible: bool,
    length: u8,
    data: [u8; DATA_BYTES_MAX],
}

impl Frame {
    /// A classic frame with an identifier of 11 bits; data beyond 8 bytes are cut off.
    #[must_use]
    pub fn classic(id: u16, data: &[u8]) -> Frame {
        Frame::with_data(u32::from(id & 0x7ff), false, data, CLASSIC_DATA_BYTES_MAX)
    }

    /// A request for the data of an identifier of 11 bits.
    #[must_use]
    pub fn remote(id: u16) -> Frame {
        Frame { is_remote: true, ..Frame::classic(id, &[]) }
    }

    /// A frame of CAN FD that switches its rate. It is filled with `padding` up to a length that a
    /// frame can have; data beyond 64 bytes are cut off. The identifier has 29 bits when it does
    /// not fit into 11.
    #[must_use]
    pub fn flexible(id: u32, data: &[u8], padding: u8) -> Frame {
        let mut frame = Frame::with_data(id, true, data, DATA_BYTES_MAX);
        let length = usize::from(frame.length);
        if let Some(longer) = FLEXIBLE_LENGTHS.into_iter().find(|longer| length <= (*longer).into())
            && length > CLASSIC_DATA_BYTES_MAX
        {
            frame.data[length..usize::from(longer)].fill(padding);
            frame.length = longer;
        }
        frame
    }

    fn with_data(id: u32, is_flexible: bool, data: &[u8], longest: usize) -> Frame {
        let length = data.len().min(longest);
        let mut all = [0; DATA_BYTES_MAX];
        all[..length].copy_from_slice(&data[..length]);
        Frame {
            id: id & !(EXTENDED_BIT | REMOTE_BIT | ERROR_BIT),
            is_extended: id > 0x7ff,
            is_remote: false,
            is_error: false,
            is_flexible,
            length: length as u8,
            data: all,
        }
    }

    /// The data.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        &self.data[..usize::from(self.length)]
    }

    /// Writes the frame as the kernel takes it; the number of bytes.
    pub fn write(&self, bytes: &mut [u8; FLEXIBLE_BYTES]) -> usize {
        let flag = |is_set: bool, bit: u32| if is_set { bit } else { 0 };
        let word = self.id
            | flag(self.is_extended, EXTENDED_BIT)
            | flag(self.is_remote, REMOTE_BIT)
            | flag(self.is_error, ERROR_BIT);
        bytes.fill(0);
        bytes[..4].copy_from_slice(&word.to_ne_bytes());
        bytes[4] = self.length;
        if self.is_flexible {
            bytes[5] = RATE_SWITCH_BIT | FLEXIBLE_BIT;
        }
        bytes[DATA_OFFSET..].copy_from_slice(&self.data);
        if self.is_flexible { FLEXIBLE_BYTES } else { CLASSIC_BYTES }
    }

    /// Reads a frame as the kernel passes it; `None` for bytes that are none.
    #[must_use]
    pub fn read(bytes: &[u8]) -> Option<Frame> {
        let is_flexible = match bytes.len() {
            CLASSIC_BYTES => false,
            FLEXIBLE_BYTES => true,
            _ => return None,
        };
        let word = u32::from_ne_bytes(bytes.get(..4)?.try_into().ok()?);
        let length = *bytes.get(4)?;
        let data = bytes.get(DATA_OFFSET..DATA_OFFSET + usize::from(length))?;
        let is_extended = word & EXTENDED_BIT != 0;
        let mask = if is_extended { 0x1fff_ffff } else { 0x7ff };
        let is_error = word & ERROR_BIT != 0;
        let mut frame = Frame::with_data(0, is_flexible, data, DATA_BYTES_MAX);
        frame.id = if is_error { word & 0x1fff_ffff } else { word & mask };
        (frame.is_extended, frame.is_error) = (is_extended, is_error);
        frame.is_remote = word & REMOTE_BIT != 0;
        Some(frame)
    }
}

/// What the controller reports by an error frame: a set of classes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorClass(u32);

impl ErrorClass {
    /// The classes of a frame; `None` for one that is no report.
    #[must_use]
    pub const fn of(frame: &Frame) -> Option<ErrorClass> {
        if !frame.is_error {
            return None;
        }
        // The state of the controller stands in the second data byte.
        let is_passive = frame.id & 0x04 != 0 && frame.data[1] & 0x30 != 0;
        Some(ErrorClass(frame.id & 0x1ff | if is_passive { PASSIVE_BIT } else { 0 }))
    }

    /// The controller is off the bus and hears and says nothing.
    #[must_use]
    pub const fn is_bus_off(self) -> bool {
        self.0 & 0x40 != 0
    }

    /// The controller has had so many errors that it no longer disturbs others with its own.
    #[must_use]
    pub const fn is_passive(self) -> bool {
        self.0 & PASSIVE_BIT != 0
    }

    /// Nobody acknowledged a frame: the cable is off, or every other node is.
    #[must_use]
    pub const fn has_no_acknowledge(self) -> bool {
        self.0 & 0x20 != 0
    }

    /// The controller was restarted after it had been off the bus.
    #[must_use]
    pub const fn is_restart(self) -> bool {
        self.0 & 0x100 != 0
    }
}

/// A bit beside those of the kernel's classes.
const PASSIVE_BIT: u32 = 1 << 31;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_written_and_read_is_the_same() {
        for frame in [
            Frame::classic(0x205, &[0x0f, 0, 0xa0, 0x86, 1, 0]),
            Frame::classic(0x80, &[]),
            Frame::remote(0x069),
            Frame::flexible(0x8001, &[1, 0, 10], 0x50),
            Frame::flexible(0x100, &[7; 9], 0x50),
            Frame::flexible(0x100, &[7; 64], 0x50),
        ] {
            let mut bytes = [0; FLEXIBLE_BYTES];
            let count = frame.write(&mut bytes);
            assert_eq!(Frame::read(&bytes[..count]), Some(frame));
        }
    }

    #[test]
    fn a_flexible_frame_is_filled_up_to_a_length_that_exists() {
        let lengths = [0, 8, 9, 12, 13, 22, 33, 49, 64, 70]
            .map(|count| Frame::flexible(1, &[0; 70][..count], 0x50).data().len());
        assert_eq!(lengths, [0, 8, 12, 12, 16, 24, 48, 64, 64, 64]);
        assert_eq!(Frame::flexible(1, &[1; 9], 0x50).data()[8..], [1, 0x50, 0x50, 0x50]);
    }

    #[test]
    fn an_identifier_of_more_than_eleven_bits_is_extended() {
        assert!(!Frame::flexible(0x7ff, &[], 0).is_extended);
        assert!(Frame::flexible(0x8001, &[], 0).is_extended);
    }

    #[test]
    fn bytes_of_another_length_are_no_frame() {
        assert_eq!([0, 8, 15, 17, 71, 73].map(|count| Frame::read(&[0; 80][..count])), [None; 6]);
        let mut long = [0; CLASSIC_BYTES];
        long[4] = 9;
        assert_eq!(Frame::read(&long), None, "nine data bytes do not fit");
    }

    #[test]
    fn errors_are_told_apart_by_class() {
        let report = |id: u32, state: u8| {
            let mut bytes = [0; CLASSIC_BYTES];
            bytes[..4].copy_from_slice(&(id | ERROR_BIT).to_ne_bytes());
            (bytes[4], bytes[9]) = (8, state);
            let class = ErrorClass::of(&Frame::read(&bytes).unwrap()).unwrap();
            let (off, passive) = (class.is_bus_off(), class.is_passive());
            (off, passive, class.has_no_acknowledge(), class.is_restart())
        };
        assert_eq!(report(0x40, 0), (true, false, false, false));
        assert_eq!(report(0x04, 0x20), (false, true, false, false));
        assert_eq!(report(0x04, 0x08), (false, false, false, false));
        assert_eq!(report(0x20, 0x10), (false, false, true, false));
        assert_eq!(report(0x100, 0), (false, false, false, true));
        assert_eq!(ErrorClass::of(&Frame::classic(0x40, &[])), None);
    }
}
