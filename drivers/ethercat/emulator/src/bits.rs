//! Reads and writes fields of bits within bytes, the lowest bit first.

/// Bytes that a field of 64 bits touches when it does not begin with one.
const BYTES_MAX: usize = 9;

/// The field of `count` bits, at most 64, that begins at bit `first`; what lies behind the bytes
/// reads as 0.
pub(crate) fn field(bytes: &[u8], first: usize, count: u8) -> u64 {
    let mut touched = [0; 16];
    let present = bytes.get(first / 8..).unwrap_or(&[]);
    let length = present.len().min(BYTES_MAX);
    touched[..length].copy_from_slice(&present[..length]);
    (u128::from_le_bytes(touched) >> (first % 8) & mask(count)) as u64
}

/// Writes such a field; bits behind the bytes are dropped.
pub(crate) fn set_field(bytes: &mut [u8], first: usize, count: u8, value: u64) {
    let mask = mask(count) << (first % 8);
    let value = u128::from(value) << (first % 8) & mask;
    let present = bytes.get_mut(first / 8..).unwrap_or(&mut []);
    let new = mask.to_le_bytes().into_iter().zip(value.to_le_bytes()).take(BYTES_MAX);
    for (byte, (mask, value)) in present.iter_mut().zip(new) {
        *byte = *byte & !mask | value;
    }
}

/// The lowest bits of a field, at most 64.
fn mask(count: u8) -> u128 {
    (1 << count.min(64)) - 1
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

    /// Bit by bit, as the fields are defined.
    fn bit(bytes: &[u8], at: usize) -> u64 {
        bytes.get(at / 8).map_or(0, |byte| u64::from(byte >> (at % 8) & 1))
    }

    #[test]
    fn every_width_at_every_place_is_the_same_as_bit_by_bit() {
        let before: [u8; 12] = std::array::from_fn(|at| (at as u8).wrapping_mul(0x9d) ^ 0x5a);
        for (first, count) in (0..104).flat_map(|first| (0..=64).map(move |count| (first, count))) {
            let bits = usize::from(count);
            let wanted = (0..bits).fold(0, |all, at| all | bit(&before, first + at) << at);
            assert_eq!(field(&before, first, count), wanted, "{count} bits at {first}");
            let mut bytes = before;
            let value = 0x6996_c33c_a55a_0ff1_u64;
            set_field(&mut bytes, first, count, value);
            for at in 0..8 * bytes.len() {
                let is_own = (first..first + bits).contains(&at);
                let wanted = if is_own { value >> (at - first) & 1 } else { bit(&before, at) };
                assert_eq!(bit(&bytes, at), wanted, "bit {at} of {count} at {first}");
            }
        }
    }

    #[test]
    fn signs_are_extended() {
        assert_eq!((signed(0xffff, 16), signed(0x7fff, 16), signed(1, 1)), (-1, 32_767, -1));
    }
}
