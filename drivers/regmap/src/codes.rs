//! Converts the bits of a register to numbers: offset binary and counters of limited width. The
//! conversion to volts and radians belongs to the software that knows the wiring.

use std::ops::RangeInclusive;

/// Widths that a converter's word may have, in bits: a register has 16.
pub(crate) const CONVERTER_BITS: RangeInclusive<u32> = 2..=16;
/// Widths that a counter may have, in bits: [`taktil_hal::Counts`] has 32.
pub(crate) const COUNTER_BITS: RangeInclusive<u32> = 8..=32;

/// Offset binary of a given width: 0 is the most negative code, half scale is code 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct OffsetBinary {
    half: i32,
}

impl OffsetBinary {
    /// `bits` is 2 to 16, checked with the config.
    pub(crate) const fn new(bits: u32) -> OffsetBinary {
        OffsetBinary { half: 1 << (bits - 1) }
    }

    /// Lowest and highest code.
    pub(crate) const fn range(self) -> (i32, i32) {
        (-self.half, self.half - 1)
    }

    /// The word of a code; `None` outside the range.
    pub(crate) fn word(self, code: i32) -> Option<u16> {
        let (low, high) = self.range();
        (low..=high).contains(&code).then(|| self.saturating_word(code))
    }

    /// The word of the code in range that is nearest to this one.
    pub(crate) fn saturating_word(self, code: i32) -> u16 {
        let (low, high) = self.range();
        // 0 to 2 x half - 1, which 16 bits hold.
        (code.clamp(low, high) + self.half) as u16
    }

    /// The word of code 0: no volts. A word of 0 would be full negative scale.
    pub(crate) const fn zero(self) -> u16 {
        self.half as u16
    }

    /// The code of a word; `None` when bits above the converter's width are set.
    pub(crate) fn code(self, word: u16) -> Option<i32> {
        let code = i32::from(word) - self.half;
        if code <= self.range().1 { Some(code) } else { None }
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

    #[test]
    fn offset_binary_at_its_corners() {
        let twelve = OffsetBinary::new(12);
        assert_eq!(twelve.range(), (-2048, 2047));
        let words =
            [-2049, -2048, -1, 0, 1, 2047, 2048, i32::MIN, i32::MAX].map(|c| twelve.word(c));
        let due = [None, Some(0), Some(2047), Some(2048), Some(2049), Some(4095), None, None, None];
        assert_eq!(words, due);
        assert_eq!([0, 2048, 4095].map(|w| twelve.code(w)), [Some(-2048), Some(0), Some(2047)]);
        assert_eq!([4096, u16::MAX].map(|w| twelve.code(w)), [None, None]);
        let sixteen = OffsetBinary::new(16);
        assert_eq!(sixteen.code(u16::MAX), Some(32767));
        assert_eq!(sixteen.word(-32768), Some(0));
        assert_eq!([-40_000, 40_000].map(|code| sixteen.saturating_word(code)), [0, u16::MAX]);
        for bits in CONVERTER_BITS {
            let coding = OffsetBinary::new(bits);
            assert_eq!(coding.word(0), Some(coding.zero()), "{bits}");
        }
    }

    #[test]
    fn every_word_survives_the_round_trip() {
        for bits in CONVERTER_BITS {
            let coding = OffsetBinary::new(bits);
            for code in coding.range().0..=coding.range().1 {
                assert_eq!(coding.word(code).and_then(|word| coding.code(word)), Some(code));
            }
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
        for bits in COUNTER_BITS {
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
