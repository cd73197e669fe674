//! Check sums of the boards: exclusive-or over all bytes (AGNI), and the remainder of Weiss.

/// Exclusive-or of all bytes; 0 over a whole AGNI datagram.
pub(crate) fn xor(bytes: &[u8]) -> u8 {
    let (words, rest) = bytes.as_chunks::<8>();
    let wide = words.iter().fold(0, |sum, word| sum ^ u64::from_le_bytes(*word));
    let narrow = rest.iter().fold(0, |sum, byte| sum ^ byte);
    wide.to_le_bytes().iter().fold(narrow, |sum, byte| sum ^ byte)
}

/// Remainders of single bytes: polynomial 1021, most significant bit first.
const BYTE_REMAINDERS: [u16; 256] = {
    let mut table = [0_u16; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut word = (byte as u16) << 8;
        let mut bit = 0;
        while bit < 8 {
            word = if word & 0x8000 == 0 { word << 1 } else { (word << 1) ^ 0x1021 };
            bit += 1;
        }
        table[byte] = word;
        byte += 1;
    }
    table
};

/// The sum of Weiss: the table of one bit order, stepped in the other; no common name exists.
pub(crate) fn weiss(bytes: &[u8]) -> u16 {
    let step = |sum: u16, byte: &u8| {
        BYTE_REMAINDERS[usize::from((sum ^ u16::from(*byte)) & 0xff)] ^ (sum >> 8)
    };
    bytes.iter().fold(0xffff, step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_messages_have_their_sums() {
        let wts = |bytes: &[u8]| weiss(bytes).to_le_bytes();
        assert_eq!(wts(&[0xaa, 0xaa, 0xaa, 0x30, 0, 0]), [0xca, 0xcf]);
        assert_eq!(wts(&[0xaa, 0xaa, 0xaa, 0x21, 3, 0, 0, 5, 0]), [0xea, 0xb9]);
        assert_eq!(wts(&[0x03, 3, 0, 0x80, 0x1e, 0]), [0x8e, 0x1c]);
        assert_eq!(xor(&[0xf0, 0xc4, 0, 0xc0]), 0xf4);
        assert_eq!(xor(&[0xf0, 0xc4, 0x01, 0xd0, 0x02, 0, 0x32, 0]), 0xd5);
    }
}
