//! Reads and writes fields of bits within bytes, the lowest bit first.

/// The field of `count` bits, at most 64, that begins at bit `first`; what lies behind the bytes
/// reads as 0.
pub(crate) fn field(bytes: &[u8], first: usize, count: u8) -> u64 {
    (0..usize::from(count.min(64))).fold(0, |value, bit| {
        let at = first + bit;
        let byte = bytes.get(at / 8).copied().unwrap_or(0);
        value | u64::from(byte >> (at % 8) & 1) << bit
    })
}

/// Writes such a field; bits behind the bytes are dropped.
pub(crate) fn set_field(bytes: &mut [u8], first: usize, count: u8, value: u64) {
    for bit in 0..usize::from(count.min(64)) {
        let at = first + bit;
        if let Some(byte) = bytes.get_mut(at / 8) {
            *byte = *byte & !(1 << (at % 8)) | ((value >> bit & 1) as u8) << (at % 8);
        }
    }
}

/// The number that a field of `count` bits holds in two's complement.
pub(crate) fn signed(value: u64, count: u8) -> i64 {
    let shift = 64 - u32::from(count.clamp(1, 64));
    (value << shift).cast_signed() >> shift
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_across_bytes_comes_back_and_leaves_its_neighbours() {
        let mut bytes = [0xff; 4];
        set_field(&mut bytes, 5, 12, 0x0a5);
        assert_eq!(field(&bytes, 5, 12), 0x0a5);
        assert_eq!((field(&bytes, 0, 5), field(&bytes, 17, 15)), (0x1f, 0x7fff));
        set_field(&mut bytes, 30, 16, 0);
        assert_eq!(field(&bytes, 30, 16), 0);
    }

    #[test]
    fn signs_are_extended() {
        assert_eq!((signed(0xffff, 16), signed(0x7fff, 16), signed(1, 1)), (-1, 32_767, -1));
    }
}
