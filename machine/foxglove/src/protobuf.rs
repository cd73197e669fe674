//! Encodes messages in the wire format of Protocol Buffers: fields as pairs of number and value,
//! messages within messages with their length in front.

/// How the value of a field is encoded (the wire type of the format).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum WireType {
    Varint = 0,
    Fixed64 = 1,
    LengthDelimited = 2,
    Fixed32 = 5,
}

/// A message that is being encoded.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Message {
    bytes: Vec<u8>,
}

impl Message {
    /// The encoded message.
    pub(crate) fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Appends an integer in groups of seven bits, the lowest first.
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value.to_le_bytes()[0] | 0x80);
            value >>= 7;
        }
        self.bytes.push(value.to_le_bytes()[0]);
    }

    fn key(&mut self, field: u32, wire: WireType) {
        self.varint(u64::from(field) << 3 | wire as u64);
    }

    /// Appends a field with an integer, a truth value or an enumeration.
    #[must_use]
    pub(crate) fn integer(mut self, field: u32, value: u64) -> Message {
        self.key(field, WireType::Varint);
        self.varint(value);
        self
    }

    /// Appends a field of the type `fixed32`.
    #[must_use]
    pub(crate) fn fixed32(mut self, field: u32, value: u32) -> Message {
        self.key(field, WireType::Fixed32);
        self.bytes.extend_from_slice(&value.to_le_bytes());
        self
    }

    /// Appends a field of the type `double`.
    #[must_use]
    pub(crate) fn double(mut self, field: u32, value: f64) -> Message {
        self.key(field, WireType::Fixed64);
        self.bytes.extend_from_slice(&value.to_le_bytes());
        self
    }

    /// Appends a field with bytes or text.
    #[must_use]
    pub(crate) fn bytes(mut self, field: u32, value: impl AsRef<[u8]>) -> Message {
        let value = value.as_ref();
        self.key(field, WireType::LengthDelimited);
        self.varint(value.len() as u64);
        self.bytes.extend_from_slice(value);
        self
    }

    /// Appends a field with a message.
    #[must_use]
    pub(crate) fn message(self, field: u32, value: Message) -> Message {
        self.bytes(field, value.bytes)
    }

    /// Appends a field once for each message.
    #[must_use]
    pub(crate) fn repeated(self, field: u32, values: impl IntoIterator<Item = Message>) -> Message {
        values.into_iter().fold(self, |message, value| message.message(field, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The examples of the format's own documentation: 150 in field 1, "testing" in field 2, the
    /// former within field 3.
    #[test]
    fn fields_are_encoded_as_the_format_shows() {
        let inner = || Message::default().integer(1, 150);
        assert_eq!(inner().into_bytes(), [0x08, 0x96, 0x01]);
        let text = Message::default().bytes(2, "testing").into_bytes();
        assert_eq!(text, [0x12, 0x07, 0x74, 0x65, 0x73, 0x74, 0x69, 0x6e, 0x67]);
        let outer = Message::default().message(3, inner()).into_bytes();
        assert_eq!(outer, [0x1a, 0x03, 0x08, 0x96, 0x01]);
        let numbers = Message::default().fixed32(2, 16).double(1, 1.0).into_bytes();
        assert_eq!(numbers, [0x15, 16, 0, 0, 0, 0x09, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f]);
        assert_eq!(Message::default().integer(16, u64::MAX).into_bytes().len(), 12);
    }
}
