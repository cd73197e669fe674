//! Converts the bits of a register to numbers: codes of converters in every format, and counters of
//! limited width. Volts and radians belong to the software that knows the wiring.

use crate::description::Format;

/// The code of a converter in a field of bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Codec {
    /// All bits of the field.
    mask: u32,
    /// Bits that are turned over to get two's complement, or an unsigned number.
    flipped: u32,
    /// The sign in two's complement; 0 for an unsigned code.
    sign: u32,
}

impl Codec {
    /// A format of `bits`, which are 2 to 31, checked with the description. All bits of the field
    /// are inverted on the bus where `inverted` says so.
    pub(crate) const fn new(format: Format, bits: u32, inverted: bool) -> Codec {
        let mask = u32::MAX >> (32 - bits);
        let top = 1 << (bits - 1);
        let (flipped, sign) = match format {
            Format::OffsetBinary => (top, top),
            Format::TwosComplement => (0, top),
            Format::StraightBinary => (0, 0),
        };
        Codec { mask, flipped: if inverted { flipped ^ mask } else { flipped }, sign }
    }

    /// Offset binary of a width that is 2 to 31.
    pub(crate) const fn offset_binary(bits: u32) -> Codec {
        Codec::new(Format::OffsetBinary, bits, false)
    }

    /// Lowest and highest code.
    pub(crate) const fn range(self) -> (i32, i32) {
        let sign = self.sign.cast_signed();
        (-sign, self.mask.cast_signed() - sign)
    }

    /// The field of a code; `None` outside the range.
    pub(crate) fn field(self, code: i32) -> Option<u32> {
        let (low, high) = self.range();
        (low..=high).contains(&code).then(|| self.saturating_field(code))
    }

    /// The field of the code in range that is nearest to this one.
    pub(crate) fn saturating_field(self, code: i32) -> u32 {
        let (low, high) = self.range();
        (code.clamp(low, high).cast_unsigned() & self.mask) ^ self.flipped
    }

    /// The code of a field, of which the bits beyond the width are not looked at.
    pub(crate) fn code(self, field: u32) -> i32 {
        let bits = (field ^ self.flipped) & self.mask;
        // The sign bit is worth minus its place.
        (bits ^ self.sign).wrapping_sub(self.sign).cast_signed()
    }
}

/// The count of a counter that is `bits` wide (8 to 32) and reads `raw`: the count nearest to
/// `last` that has this raw value. It is right as long as the counter moves less than half its
/// range between two calls.
pub(crate) fn unwrap_count(last: i32, raw: u32, bits: u32) -> i32 {
    let shift = 32 - bits;
    let step = (raw << shift).wrapping_sub(last.cast_unsigned() << shift).cast_signed() >> shift;
    last.wrapping_add(step)
}

/// The largest distance from `last`, either way, at which [`unwrap_count`] finds a count with
/// certainty.
pub(crate) fn unwrap_reach(bits: u32) -> i32 {
    i32::MAX >> (32 - bits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FORMATS: [Format; 3] =
        [Format::OffsetBinary, Format::TwosComplement, Format::StraightBinary];

    #[test]
    fn offset_binary_at_its_corners() {
        let twelve = Codec::offset_binary(12);
        assert_eq!(twelve.range(), (-2048, 2047));
        let words =
            [-2049, -2048, -1, 0, 1, 2047, 2048, i32::MIN, i32::MAX].map(|c| twelve.field(c));
        let due = [None, Some(0), Some(2047), Some(2048), Some(2049), Some(4095), None, None, None];
        assert_eq!(words, due);
        assert_eq!([0, 2048, 4095].map(|w| twelve.code(w)), [-2048, 0, 2047]);
        let sixteen = Codec::offset_binary(16);
        assert_eq!(sixteen.code(0xffff), 32767);
        assert_eq!(sixteen.field(-32768), Some(0));
        assert_eq!([-40_000, 40_000].map(|code| sixteen.saturating_field(code)), [0, 0xffff]);
    }

    #[test]
    fn every_format_at_the_figures_of_data_sheets() {
        // Twelve bits: most negative, minus one, zero, one, most positive; as converters' data
        // sheets print them.
        let of = |format, inverted| {
            let codec = Codec::new(format, 12, inverted);
            [-2048, -1, 0, 1, 2047].map(|code| codec.field(code))
        };
        let some = |fields: [u32; 5]| fields.map(Some);
        assert_eq!(of(Format::OffsetBinary, false), some([0x000, 0x7ff, 0x800, 0x801, 0xfff]));
        assert_eq!(of(Format::OffsetBinary, true), some([0xfff, 0x800, 0x7ff, 0x7fe, 0x000]));
        assert_eq!(of(Format::TwosComplement, false), some([0x800, 0xfff, 0x000, 0x001, 0x7ff]));
        assert_eq!(of(Format::TwosComplement, true), some([0x7ff, 0x000, 0xfff, 0xffe, 0x800]));
        let straight = Codec::new(Format::StraightBinary, 12, false);
        assert_eq!(straight.range(), (0, 4095));
        assert_eq!(
            [-1, 0, 4095, 4096].map(|c| straight.field(c)),
            [None, Some(0), Some(4095), None]
        );
        let straight = Codec::new(Format::StraightBinary, 12, true);
        assert_eq!([0, 4095].map(|c| straight.field(c)), [Some(4095), Some(0)]);
    }

    #[test]
    fn codes_rise_over_the_whole_range_of_every_format_and_width() {
        for (bits, format) in (2..=31).flat_map(|bits| FORMATS.map(|format| (bits, format))) {
            for inverted in [false, true] {
                let codec = Codec::new(format, bits, inverted);
                let (low, high) = codec.range();
                assert_eq!(i64::from(high) - i64::from(low) + 1, 1 << bits, "{bits} {format:?}");
                let zero = codec.field(0).unwrap();
                assert_eq!(codec.code(zero), 0);
                for code in [low, low + 1, 0, high - 1, high] {
                    let field = codec.field(code).unwrap();
                    assert!(u64::from(field) < 1 << bits);
                    assert_eq!(codec.code(field), code, "{bits} {format:?} {inverted}");
                }
                assert_eq!(codec.field(low - 1), None);
                assert_eq!(high.checked_add(1).and_then(|code| codec.field(code)), None);
            }
        }
    }

    proptest! {
        #[test]
        fn every_code_survives_and_every_field_means_one_code(
            bits in 2_u32..=31,
            format in 0_usize..3,
            inverted: bool,
            word: u32,
        ) {
            let codec = Codec::new(FORMATS[format], bits, inverted);
            let field = word & (u32::MAX >> (32 - bits));
            let code = codec.code(field);
            let (low, high) = codec.range();
            prop_assert!((low..=high).contains(&code));
            prop_assert_eq!(codec.field(code), Some(field));
            prop_assert_eq!(codec.code(word), code, "bits beyond the width do not count");
            let value = word.cast_signed();
            let clamped = value.clamp(low, high);
            prop_assert_eq!(codec.code(codec.saturating_field(value)), clamped);
            prop_assert_eq!(codec.field(value).is_some(), clamped == value);
        }

        #[test]
        fn a_counter_of_any_width_follows_any_step_within_reach(
            bits in 8_u32..=32,
            last: i32,
            step: i32,
        ) {
            let reach = unwrap_reach(bits);
            let step = if bits == 32 { step } else { step % (reach + 1) };
            let to = last.wrapping_add(step);
            let raw = to.cast_unsigned() & (u32::MAX >> (32 - bits));
            prop_assert_eq!(unwrap_count(last, raw, bits), to);
        }
    }

    #[test]
    fn counters_are_carried_across_their_wrap() {
        assert_eq!(unwrap_count(0, 0xffff, 16), -1);
        assert_eq!(unwrap_count(32_767, 0x8000, 16), 32_768);
        assert_eq!(unwrap_count(32_768 + 65_536, 0x7fff, 16), 32_767 + 65_536);
        assert_eq!(unwrap_count(-1, 0x000000, 24), 0);
        assert_eq!(unwrap_count(0x7f_ffff, 0x80_0000, 24), 0x80_0000);
        assert_eq!(unwrap_count(i32::MAX, 0x8000_0000, 32), i32::MIN);
        assert_eq!(unwrap_count(i32::MIN, 0x7fff_ffff, 32), i32::MAX);
        assert_eq!(unwrap_count(123, 0xffff_fff0, 32), -16);
    }

    #[test]
    fn what_is_within_reach_is_found_and_the_next_count_is_not() {
        for bits in 8..=32 {
            let (mask, far) = (u32::MAX >> (32 - bits), unwrap_reach(bits));
            let found =
                |to: i32| unwrap_count(5, 5i32.wrapping_add(to).cast_unsigned() & mask, bits);
            for to in [-far, -1, 0, 1, far] {
                assert_eq!(found(to), 5i32.wrapping_add(to), "{bits} bits, {to}");
            }
            let beyond = far.wrapping_add(1);
            assert!(bits == 32 || found(beyond) != 5 + beyond, "{bits} bits");
        }
    }

    #[test]
    fn a_long_run_in_one_direction_is_counted_whole() {
        let mut count = 0;
        for step in 1..=1_000u32 {
            count = unwrap_count(count, (step * 30_000) & 0xffff, 16);
        }
        assert_eq!(count, 30_000_000);
    }
}
