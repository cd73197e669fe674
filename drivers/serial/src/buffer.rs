//! A fixed buffer of received bytes, and the search for a header in it.

/// Bytes that were received and belong to no message yet.
#[derive(Debug)]
pub(crate) struct ByteBuffer {
    bytes: Box<[u8]>,
    start: usize,
    end: usize,
}

impl ByteBuffer {
    /// A buffer in which messages of up to `message_bytes_max` can be completed.
    pub(crate) fn new(message_bytes_max: usize) -> ByteBuffer {
        ByteBuffer { bytes: vec![0; 2 * message_bytes_max + 64].into(), start: 0, end: 0 }
    }

    /// Takes as many bytes as there is room for; what was there is moved to the front when needed.
    pub(crate) fn append(&mut self, bytes: &[u8]) -> usize {
        if self.start == self.end {
            (self.start, self.end) = (0, 0);
        } else if self.end + bytes.len() > self.bytes.len() {
            self.bytes.copy_within(self.start..self.end, 0);
            (self.start, self.end) = (0, self.end - self.start);
        }
        let count = bytes.len().min(self.bytes.len() - self.end);
        self.bytes[self.end..self.end + count].copy_from_slice(&bytes[..count]);
        self.end += count;
        count
    }

    pub(crate) fn unread(&self) -> &[u8] {
        &self.bytes[self.start..self.end]
    }

    pub(crate) fn consume(&mut self, count: usize) {
        self.start = (self.start + count).min(self.end);
    }

    pub(crate) fn clear(&mut self) {
        (self.start, self.end) = (0, 0);
    }
}

/// Where `byte` stands first, eight bytes at a time.
fn position(bytes: &[u8], byte: u8) -> Option<usize> {
    const LOW_BITS: u64 = 0x0101_0101_0101_0101;
    let (words, rest) = bytes.as_chunks::<8>();
    for (index, word) in words.iter().enumerate() {
        let differing = u64::from_le_bytes(*word) ^ (LOW_BITS * u64::from(byte));
        // The lowest set bit marks the first zero byte; higher marks may be false.
        let zeros = differing.wrapping_sub(LOW_BITS) & !differing & (LOW_BITS << 7);
        if zeros != 0 {
            return Some(8 * index + zeros.trailing_zeros() as usize / 8);
        }
    }
    let tail = 8 * words.len();
    rest.iter().position(|other| *other == byte).map(|at| tail + at)
}

/// Bytes in front of the first header, whole or begun at the end; all of them when there is none.
pub(crate) fn bytes_before<const N: usize>(bytes: &[u8], header: [u8; N]) -> usize {
    let mut from = 0;
    while let Some(at) = position(&bytes[from..], header[0]) {
        let begin = from + at;
        let seen = &bytes[begin..bytes.len().min(begin + N)];
        if header.starts_with(seen) {
            return begin;
        }
        from = begin + 1;
    }
    bytes.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_found_whole_and_begun() {
        assert_eq!(bytes_before(&[1, 2, 0xaa, 0x55, 3], [0xaa, 0x55]), 2);
        assert_eq!(bytes_before(&[1; 20], [0xaa, 0x55]), 20);
        assert_eq!(bytes_before(&[1, 2, 3, 4, 5, 6, 7, 8, 9, 0xaa], [0xaa, 0x55]), 9);
        assert_eq!(bytes_before(&[0xaa, 0xaa, 0x55], [0xaa, 0x55]), 1);
        assert_eq!(bytes_before(&[], [0xaa, 0x55]), 0);
    }

    #[test]
    fn every_position_is_that_of_a_plain_search() {
        for length in 0..40 {
            for at in 0..length {
                let mut bytes = vec![0x54; length];
                bytes[at] = 0x55;
                assert_eq!(position(&bytes, 0x55), Some(at));
            }
            assert_eq!(position(&vec![0x56; length], 0x55), None);
        }
    }

    #[test]
    fn what_does_not_fit_is_left_to_the_caller() {
        let mut buffer = ByteBuffer::new(8);
        assert_eq!(buffer.append(&[7; 100]), 80);
        buffer.consume(79);
        assert_eq!(buffer.append(&[8; 10]), 10);
        assert_eq!(buffer.unread(), [7, 8, 8, 8, 8, 8, 8, 8, 8, 8, 8]);
    }
}
