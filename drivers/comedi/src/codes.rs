//! Computes codes about zero volts from samples and back, and counts from counters of limited
//! width. Volts and radians belong to whoever knows what is wired.

use crate::board::Range;
use crate::uapi::{EXTERNAL_REFERENCE_FLAG, UNIT_MASK_BITS, VOLTS_UNIT};

/// Narrowest and widest counter in bits: [`taktil_hal::Counts`] has 32, and one of fewer than 8
/// would wrap within a cycle.
pub(crate) const COUNTER_BITS_BOUNDS: [u32; 2] = [8, 32];
/// How far a wanted voltage may lie outside a range in which it fits: rounding of decimals (V).
const SPAN_TOLERANCE_V: f64 = 1e-6;

/// How the samples of one converter's channel become codes, and how its calibration corrects them.
///
/// `nominal voltage = min + sample x (max - min) / maxdata`; code 0 is the sample nearest to zero
/// volts, the upper one of two, and a code is a sample's distance from there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scale {
    zero: i64,
    maxdata: u32,
    gain: f64,
    offset_codes: f64,
    /// What one code is worth (V).
    pub(crate) volts_per_code: f64,
}

impl Scale {
    /// The scale of a range of volts, ends in order; `None` when its codes do not fit 32 bits.
    pub(crate) fn new(range: Range, maxdata: u32, gain: f64, offset_codes: f64) -> Option<Scale> {
        let (min, max) = (i128::from(range.min_millionths), i128::from(range.max_millionths));
        let span = max - min;
        if span <= 0 || maxdata == 0 {
            return None;
        }
        let zero = (-min * i128::from(maxdata) * 2 + span).div_euclid(2 * span);
        let zero = i64::try_from(zero).ok()?;
        let ends = [-zero, i64::from(maxdata) - zero];
        let fits = ends.iter().all(|end| i32::try_from(*end).is_ok());
        let volts_per_code = span as f64 * 1e-6 / f64::from(maxdata);
        fits.then_some(Scale { zero, maxdata, gain, offset_codes, volts_per_code })
    }

    /// The lowest code.
    pub(crate) fn low(self) -> i32 {
        // `new` has seen to it that both ends fit.
        -self.zero as i32
    }

    /// The highest code.
    pub(crate) fn high(self) -> i32 {
        (i64::from(self.maxdata) - self.zero) as i32
    }

    /// Whether zero volts lie in the range.
    pub(crate) fn has_zero(self) -> bool {
        self.low() <= 0 && self.high() >= 0
    }

    fn corrected(self, code: i32) -> i32 {
        let exact = f64::from(code) * self.gain + self.offset_codes;
        // The ends of the range bound what calibration makes of a code; a cast saturates.
        (exact.round() as i32).clamp(self.low(), self.high())
    }

    /// The code of a sample; `None` above the largest sample.
    pub(crate) fn code(self, sample: u32) -> Option<i32> {
        let nominal = (i64::from(sample) - self.zero) as i32;
        (sample <= self.maxdata).then(|| self.corrected(nominal))
    }

    /// Whether a sample stands at an end of the converter's range, or beyond it.
    pub(crate) fn is_at_end(self, sample: u32) -> bool {
        sample == 0 || sample >= self.maxdata
    }

    /// The sample of a code in the range.
    pub(crate) fn sample(self, code: i32) -> u32 {
        let nominal = self.corrected(code.clamp(self.low(), self.high()));
        (i64::from(nominal) + self.zero) as u32
    }
}

/// The smallest range of volts in which both voltages fit; its number and itself.
pub(crate) fn fitting_range(ranges: &[Range], low_v: f64, high_v: f64) -> Option<(u8, Range)> {
    let volts = |millionths: i32| f64::from(millionths) * 1e-6;
    let fits = |range: &Range| {
        range.flags & UNIT_MASK_BITS == VOLTS_UNIT
            && range.flags & EXTERNAL_REFERENCE_FLAG == 0
            && volts(range.min_millionths) <= low_v + SPAN_TOLERANCE_V
            && volts(range.max_millionths) >= high_v - SPAN_TOLERANCE_V
    };
    let span = |range: &Range| i64::from(range.max_millionths) - i64::from(range.min_millionths);
    let numbered = (0u8..=u8::MAX).zip(ranges.iter().copied());
    numbered.filter(|(_, range)| fits(range)).min_by_key(|(_, range)| span(range))
}

/// The width of a counter with this largest sample; `None` when it does not count in powers of two
/// or is too narrow.
pub(crate) fn counter_bits(maxdata: u32) -> Option<u32> {
    let bits = maxdata.count_ones();
    let whole = u64::from(maxdata) + 1 == 1 << bits;
    let [low, high] = COUNTER_BITS_BOUNDS;
    (whole && (low..=high).contains(&bits)).then_some(bits)
}

/// The count of a counter that is `bits` wide (8 to 32) and reads `raw`: the count nearest to
/// `last` that has this raw value. It is right as long as the counter moves less than half its
/// range between two calls.
pub(crate) fn unfolded_count(last: i32, raw: u32, bits: u32) -> i32 {
    let shift = 32 - bits;
    let step = (raw << shift).wrapping_sub(last.cast_unsigned() << shift).cast_signed() >> shift;
    last.wrapping_add(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(min_v: f64, max_v: f64) -> Range {
        let millionths = |volts: f64| (volts * 1e6) as i32;
        Range { min_millionths: millionths(min_v), max_millionths: millionths(max_v), flags: 0 }
    }

    #[test]
    fn codes_are_signed_about_zero_volts() {
        let scale = Scale::new(range(-10.0, 10.0), 0xffff, 1.0, 0.0).unwrap();
        assert_eq!((scale.low(), scale.high()), (-32768, 32767));
        assert_eq!([0, 32768, 65535].map(|s| scale.code(s)), [Some(-32768), Some(0), Some(32767)]);
        assert_eq!(scale.code(65536), None);
        assert_eq!([-32768, 0, 32767].map(|code| scale.sample(code)), [0, 32768, 65535]);
        assert!((scale.volts_per_code - 20.0 / 65535.0).abs() < 1e-15);
        let unipolar = Scale::new(range(0.0, 5.0), 4095, 1.0, 0.0).unwrap();
        assert_eq!((unipolar.low(), unipolar.high()), (0, 4095));
        let above = Scale::new(range(1.0, 5.0), 4000, 1.0, 0.0).unwrap();
        assert_eq!((above.low(), above.high(), above.has_zero()), (1000, 5000, false));
    }

    #[test]
    fn scales_that_mean_nothing_are_none() {
        assert_eq!(Scale::new(range(5.0, 5.0), 4095, 1.0, 0.0), None);
        assert_eq!(Scale::new(range(5.0, -5.0), 4095, 1.0, 0.0), None);
        assert_eq!(Scale::new(range(-5.0, 5.0), 0, 1.0, 0.0), None);
        assert_eq!(Scale::new(range(0.0, 5.0), u32::MAX, 1.0, 0.0), None);
        assert!(Scale::new(range(-5.0, 5.0), u32::MAX, 1.0, 0.0).is_some());
    }

    #[test]
    fn calibration_corrects_and_stays_inside() {
        let scale = Scale::new(range(-10.0, 10.0), 0xffff, 1.01, -3.0).unwrap();
        assert_eq!(scale.code(32768), Some(-3));
        assert_eq!(scale.code(32768 + 1000), Some(1007));
        assert_eq!(scale.code(65535), Some(32767));
        assert_eq!(scale.sample(0), 32765);
        assert_eq!(scale.sample(-32768), 0);
    }

    #[test]
    fn the_smallest_range_that_fits_is_taken() {
        let external = Range { flags: EXTERNAL_REFERENCE_FLAG, ..range(-6.0, 6.0) };
        let current = Range { flags: 1, ..range(-6.0, 6.0) };
        let ranges = [range(-10.0, 10.0), external, current, range(-5.0, 5.0), range(0.0, 10.0)];
        let number = |low, high| fitting_range(&ranges, low, high).map(|(number, _)| number);
        assert_eq!(number(-10.0, 10.0), Some(0));
        assert_eq!(number(-5.0, 5.0), Some(3));
        assert_eq!(number(-1.0, 5.5), Some(0));
        assert_eq!(number(0.0, 6.0), Some(4));
        assert_eq!(number(-11.0, 0.0), None);
    }

    #[test]
    fn widths_of_counters_come_from_their_largest_sample() {
        let due = [Some(16), Some(24), Some(32), None, None, None];
        let maxdata = [0xffff, 0xff_ffff, u32::MAX, 0x7f, 0xfffe, 0];
        assert_eq!(maxdata.map(counter_bits), due);
    }

    #[test]
    fn counters_are_carried_across_their_wrap() {
        assert_eq!(unfolded_count(0, 0xffff, 16), -1);
        assert_eq!(unfolded_count(32_767, 0x8000, 16), 32_768);
        assert_eq!(unfolded_count(-1, 0, 24), 0);
        assert_eq!(unfolded_count(0x7f_ffff, 0x80_0000, 24), 0x80_0000);
        assert_eq!(unfolded_count(i32::MAX, 0x8000_0000, 32), i32::MIN);
    }
}
