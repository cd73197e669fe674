//! Decodes the kernel's input events from the bytes of an event device or of a pipe. Once the
//! kernel reports lost events, the events up to the end of that report are dropped, and the device
//! has to be asked which keys are held.

/// `struct input_event` of a 64-bit kernel: seconds and microseconds (8 bytes each), type (2), code
/// (2), value (4).
pub const EVENT_BYTES: usize = 24;

const EV_SYN: u16 = 0;
const EV_KEY: u16 = 1;
const EV_ABS: u16 = 3;
const SYN_REPORT: u16 = 0;
const SYN_DROPPED: u16 = 3;
/// Value of a key event that is a repeat.
const KEY_REPEAT_VALUE: i32 = 2;

/// An input event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputEvent {
    /// A key was pressed (true) or released (false).
    Key(u16, bool),
    /// The kernel repeats a key, which is therefore held.
    KeyRepeat(u16),
    /// The position of a stick, in its own units.
    Stick(u16, i32),
    /// Events were lost, so the state of the keys is unknown.
    EventsLost,
    /// The device may now be asked which keys are held.
    Resynchronise,
}

/// Assembles events from chunks of any length.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    piece: Vec<u8>,
    /// True from the event that reports a loss to the end of that report.
    lost: bool,
}

impl Decoder {
    /// Appends bytes and returns the complete events in order.
    pub fn feed(&mut self, bytes: &[u8]) -> Vec<InputEvent> {
        self.piece.extend_from_slice(bytes);
        let whole = self.piece.len() / EVENT_BYTES * EVENT_BYTES;
        let events: Vec<u8> = self.piece.drain(..whole).collect();
        events.chunks_exact(EVENT_BYTES).filter_map(|event| self.event(event)).collect()
    }

    fn event(&mut self, event: &[u8]) -> Option<InputEvent> {
        let short = |at: usize| u16::from_ne_bytes([event[at], event[at + 1]]);
        let (kind, code) = (short(16), short(18));
        let value = i32::from_ne_bytes([event[20], event[21], event[22], event[23]]);
        match (kind, code) {
            (EV_SYN, SYN_DROPPED) => {
                self.lost = true;
                Some(InputEvent::EventsLost)
            }
            (EV_SYN, SYN_REPORT) if self.lost => {
                self.lost = false;
                Some(InputEvent::Resynchronise)
            }
            _ if self.lost => None,
            (EV_KEY, code) if value == KEY_REPEAT_VALUE => Some(InputEvent::KeyRepeat(code)),
            (EV_KEY, code) => Some(InputEvent::Key(code, value != 0)),
            (EV_ABS, code) => Some(InputEvent::Stick(code, value)),
            _ => None,
        }
    }
}

/// An event in the kernel's format, with time zero.
#[must_use]
pub fn bytes(kind: u16, code: u16, value: i32) -> [u8; EVENT_BYTES] {
    let mut event = [0; EVENT_BYTES];
    event[16..18].copy_from_slice(&kind.to_ne_bytes());
    event[18..20].copy_from_slice(&code.to_ne_bytes());
    event[20..].copy_from_slice(&value.to_ne_bytes());
    event
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_are_whole_however_they_come() {
        let stream: Vec<u8> = [
            bytes(EV_KEY, 30, 1),
            bytes(EV_SYN, SYN_REPORT, 0),
            bytes(4, 4, 458_756), // a scan code says nothing here
            bytes(EV_ABS, 1, -7),
            bytes(EV_KEY, 30, 2),
            bytes(EV_KEY, 30, 0),
        ]
        .concat();
        let due = [
            InputEvent::Key(30, true),
            InputEvent::Stick(1, -7),
            InputEvent::KeyRepeat(30),
            InputEvent::Key(30, false),
        ];
        for size in [1, 5, 23, 24, 25, 1000] {
            let mut decoder = Decoder::default();
            let found: Vec<_> = stream.chunks(size).flat_map(|part| decoder.feed(part)).collect();
            assert_eq!(found, due, "{size}");
        }
        assert_eq!(bytes(1, 30, 1).len(), size_of::<nix::libc::input_event>());
    }

    #[test]
    fn the_layout_is_the_kernel_s() {
        use core::mem::offset_of;
        type Event = nix::libc::input_event;
        let places = [offset_of!(Event, type_), offset_of!(Event, code), offset_of!(Event, value)];
        assert_eq!((size_of::<Event>(), places), (EVENT_BYTES, [16, 18, 20]));
    }

    /// Bytes of a device's dump, with its time stamps, from a little-endian host.
    #[cfg(target_endian = "little")]
    fn parse_dump(text: &str) -> Vec<u8> {
        let byte = |two: &str| u8::from_str_radix(two, 16).unwrap();
        text.split_ascii_whitespace().map(byte).collect()
    }

    /// A USB keyboard sends a scan code before each key and a report after it; a held key repeats
    /// with a report of value 1.
    #[test]
    #[cfg(target_endian = "little")]
    fn a_keyboard_s_bytes_are_read_with_their_stamps() {
        let stream = parse_dump(
            "15 87 FC 5D 00 00 00 00 40 CA 07 00 00 00 00 00 04 00 04 00 08 00 07 00 \
             15 87 FC 5D 00 00 00 00 40 CA 07 00 00 00 00 00 01 00 12 00 01 00 00 00 \
             15 87 FC 5D 00 00 00 00 40 CA 07 00 00 00 00 00 00 00 00 00 00 00 00 00 \
             15 87 FC 5D 00 00 00 00 D0 9A 0B 00 00 00 00 00 01 00 12 00 02 00 00 00 \
             15 87 FC 5D 00 00 00 00 D0 9A 0B 00 00 00 00 00 00 00 00 00 01 00 00 00 \
             16 87 FC 5D 00 00 00 00 3E C4 08 00 00 00 00 00 04 00 04 00 08 00 07 00 \
             16 87 FC 5D 00 00 00 00 3E C4 08 00 00 00 00 00 01 00 12 00 00 00 00 00 \
             16 87 FC 5D 00 00 00 00 3E C4 08 00 00 00 00 00 00 00 00 00 00 00 00 00",
        );
        assert_eq!(stream.len(), 8 * EVENT_BYTES);
        let e = evdev::KeyCode::KEY_E.0;
        let due = [InputEvent::Key(e, true), InputEvent::KeyRepeat(e), InputEvent::Key(e, false)];
        assert_eq!(Decoder::default().feed(&stream), due);
    }

    /// A gamepad with its left shoulder down and two sticks in one report, then a buffer that ran
    /// over while both were let go.
    #[test]
    #[cfg(target_endian = "little")]
    fn a_gamepad_s_bytes_are_read_across_an_overflow() {
        let stream = parse_dump(
            "C0 0C 1F 65 00 00 00 00 11 22 03 00 00 00 00 00 01 00 36 01 01 00 00 00 \
             C0 0C 1F 65 00 00 00 00 11 22 03 00 00 00 00 00 03 00 00 00 00 80 FF FF \
             C0 0C 1F 65 00 00 00 00 11 22 03 00 00 00 00 00 03 00 04 00 FF 7F 00 00 \
             C0 0C 1F 65 00 00 00 00 11 22 03 00 00 00 00 00 00 00 00 00 00 00 00 00 \
             C1 0C 1F 65 00 00 00 00 00 00 00 00 00 00 00 00 00 00 03 00 00 00 00 00 \
             C1 0C 1F 65 00 00 00 00 01 00 00 00 00 00 00 00 03 00 00 00 10 00 00 00 \
             C1 0C 1F 65 00 00 00 00 01 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00",
        );
        let (left, x, ry) = (evdev::KeyCode::BTN_TL.0, 0, evdev::AbsoluteAxisCode::ABS_RY.0);
        let due = [
            InputEvent::Key(left, true),
            InputEvent::Stick(x, -32_768),
            InputEvent::Stick(ry, 32_767),
            InputEvent::EventsLost,
            InputEvent::Resynchronise,
        ];
        for size in [1, 24, 31, 1000] {
            let mut decoder = Decoder::default();
            let found: Vec<_> = stream.chunks(size).flat_map(|part| decoder.feed(part)).collect();
            assert_eq!(found, due, "{size}");
        }
    }

    #[test]
    fn events_after_a_loss_are_dropped_until_the_report_ends() {
        let mut decoder = Decoder::default();
        let stream = [
            bytes(EV_KEY, 30, 1),
            bytes(EV_SYN, SYN_DROPPED, 0),
            bytes(EV_KEY, 31, 1),
            bytes(EV_SYN, SYN_REPORT, 0),
            bytes(EV_KEY, 32, 1),
        ]
        .concat();
        let due = [
            InputEvent::Key(30, true),
            InputEvent::EventsLost,
            InputEvent::Resynchronise,
            InputEvent::Key(32, true),
        ];
        assert_eq!(decoder.feed(&stream), due);
    }

    #[test]
    fn any_bytes_are_decoded_without_a_panic() {
        let mut decoder = Decoder::default();
        let noise: Vec<u8> =
            (0..10_000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        assert!(decoder.feed(&noise).len() <= 10_000 / EVENT_BYTES);
    }
}
