//! Fields of a device's process data: where an object lies, and its number there.

/// A field of at most 32 bits within the inputs or the outputs of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Field {
    /// Position of the device on the segment.
    pub(crate) device: usize,
    /// Its first bit.
    pub(crate) bit: usize,
    /// How many bits it has, 1 to 32.
    pub(crate) bits: u8,
}

impl Field {
    /// The number, as it stands in the bytes of the device; what lies behind them reads as 0.
    pub(crate) fn raw(self, bytes: &[u8]) -> u32 {
        if let Some(range) = self.whole_bytes() {
            return match *bytes.get(range).unwrap_or(&[]) {
                [a] => u32::from(a),
                [a, b] => u32::from_le_bytes([a, b, 0, 0]),
                [a, b, c] => u32::from_le_bytes([a, b, c, 0]),
                [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
                _ => 0,
            };
        }
        (0..usize::from(self.bits.min(32))).fold(0, |value, offset| {
            let at = self.bit + offset;
            let byte = bytes.get(at / 8).copied().unwrap_or(0);
            value | u32::from(byte >> (at % 8) & 1) << offset
        })
    }

    /// The bytes that the field fills, when it fills whole ones, as nearly all fields do.
    fn whole_bytes(self) -> Option<core::ops::Range<usize>> {
        let is_whole = self.bit.is_multiple_of(8) && self.bits.is_multiple_of(8) && self.bits <= 32;
        let first = self.bit / 8;
        is_whole.then(|| first..first + usize::from(self.bits / 8))
    }

    /// The number in two's complement.
    pub(crate) fn signed(self, bytes: &[u8]) -> i32 {
        let shift = 32 - u32::from(self.bits.clamp(1, 32));
        (self.raw(bytes) << shift).cast_signed() >> shift
    }

    /// Writes the low bits of a number; bits behind the bytes of the device are dropped.
    pub(crate) fn set(self, bytes: &mut [u8], value: u32) {
        if let Some(whole) = self.whole_bytes().and_then(|range| bytes.get_mut(range)) {
            let own = value.to_le_bytes();
            whole.iter_mut().zip(own).for_each(|(byte, own)| *byte = own);
            return;
        }
        for offset in 0..usize::from(self.bits.min(32)) {
            let at = self.bit + offset;
            if let Some(byte) = bytes.get_mut(at / 8) {
                *byte = *byte & !(1 << (at % 8)) | ((value >> offset & 1) as u8) << (at % 8);
            }
        }
    }
}

/// An object within process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MappedObject {
    pub(crate) index: u16,
    pub(crate) subindex: u8,
    pub(crate) bit: usize,
    pub(crate) bits: u8,
}

/// The process data of one device.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct ProcessData {
    pub(crate) outputs: Vec<MappedObject>,
    pub(crate) inputs: Vec<MappedObject>,
}

/// The first of some objects that is mapped, as a field of a device.
pub(crate) fn find(
    device: usize,
    mapped: &[MappedObject],
    alternatives: &[(u16, u8)],
) -> Option<Field> {
    alternatives.iter().find_map(|(index, subindex)| {
        let fits = |one: &&MappedObject| one.index == *index && one.subindex == *subindex;
        let found = mapped.iter().find(fits)?;
        (1..=32).contains(&found.bits).then_some(Field { device, bit: found.bit, bits: found.bits })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_number_is_signed_by_its_width() {
        let field = Field { device: 0, bit: 4, bits: 16 };
        let mut bytes = [0xff; 4];
        field.set(&mut bytes, 0x8000);
        assert_eq!((field.raw(&bytes), field.signed(&bytes)), (0x8000, -32_768));
        assert_eq!((bytes[0], bytes[3]), (0x0f, 0xff));
        assert_eq!(Field { device: 0, bit: 100, bits: 32 }.raw(&bytes), 0);
    }

    #[test]
    fn the_first_alternative_that_is_mapped_is_taken() {
        let mapped = [(0x6000, 2, 8, 16), (0x6010, 0x11, 24, 32)];
        let mapped =
            mapped.map(|(index, subindex, bit, bits)| MappedObject { index, subindex, bit, bits });
        let found = find(3, &mapped, &[(0x6010, 0x11), (0x6000, 2)]);
        assert_eq!(found, Some(Field { device: 3, bit: 24, bits: 32 }));
        assert_eq!(find(3, &mapped, &[(0x6000, 1)]), None);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            bit in 0_usize..80,
            bits in 1_u8..=32,
            value in any::<u32>(),
            is_whole in any::<bool>(),
            mut bytes in proptest::collection::vec(any::<u8>(), 0..16),
        ) {
            let whole = (bit / 8 * 8, bits.div_ceil(8) * 8);
            let (bit, bits) = if is_whole { whole } else { (bit, bits) };
            let field = Field { device: 0, bit, bits };
            let before = bytes.clone();
            field.set(&mut bytes, value);
            let inside = |at: usize| at >= bit / 8 && at < (bit + usize::from(bits)).div_ceil(8);
            for at in (0..bytes.len()).filter(|at| !inside(*at)) {
                prop_assert_eq!(bytes[at], before[at]);
            }
            if bit + usize::from(bits) <= 8 * bytes.len() {
                let mask = u32::MAX >> (32 - u32::from(bits));
                prop_assert_eq!(field.raw(&bytes), value & mask);
            }
        }
    }
}
