//! Pulse-width modulators: magnitude in bits 27 to 16, sign in bit 31, and a mode that gives width
//! and direction pin. Source: `pwmpdmgenh.vhd`, `pwmgen.c` for the rate.

/// Register: magnitude and sign.
pub(crate) const VALUE_REGISTER: u32 = 0;
/// Register: mode.
pub(crate) const MODE_REGISTER: u32 = 1;
/// Register: rate of all modulators.
pub(crate) const RATE_REGISTER: u32 = 2;
/// Register: a bit for each modulator that is switched on.
pub(crate) const ENABLE_REGISTER: u32 = 4;

/// Widths of a modulator (bits).
const WIDTHS_BITS: [u32; 4] = [12, 11, 10, 9];
/// Mode: a new value takes effect at the end of a period of the modulation.
const DOUBLE_BUFFERED: u32 = 1 << 5;
/// Word for nothing at all.
pub(crate) const ZERO_WORD: u32 = 0;

/// How the modulators run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Modulation {
    /// Width of a value.
    pub(crate) bits: u32,
    /// Word of the rate register.
    pub(crate) rate: u32,
}

impl Modulation {
    /// The widest modulation at this frequency; `None` where the clock is too slow for any.
    pub(crate) fn at(frequency_hz: u32, clock_hz: u32) -> Option<Modulation> {
        WIDTHS_BITS.into_iter().find_map(|bits| {
            let rate = (u64::from(frequency_hz) << (16 + bits)) / u64::from(clock_hz.max(1));
            (1..=0xffff).contains(&rate).then_some(Modulation { bits, rate: rate as u32 })
        })
    }

    /// The largest code.
    pub(crate) const fn code_max(self) -> i32 {
        (1 << self.bits) - 1
    }

    /// The word of a code in range.
    pub(crate) const fn word(self, code: i32) -> u32 {
        let sign = if code < 0 { 1 << 31 } else { 0 };
        sign | (code.unsigned_abs() << 16)
    }

    /// The word of the mode register: magnitude and direction.
    pub(crate) const fn mode_word(self) -> u32 {
        DOUBLE_BUFFERED | (self.bits - 9)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_widest_modulation_that_the_clock_allows_is_taken() {
        let bits = |hz| Modulation::at(hz, 200_000_000).map(|modulation| modulation.bits);
        assert_eq!([20_000, 50_000, 100_000, 200_000].map(bits), [12, 11, 10, 9].map(Some));
        assert_eq!(bits(1_000_000), None);
        let modulation = Modulation::at(20_000, 200_000_000).unwrap();
        assert_eq!(modulation.rate, (20_000_u64 * 65_536 * 4_096 / 200_000_000) as u32);
        assert_eq!(modulation.code_max(), 4_095);
        assert_eq!(modulation.word(-4_095), 0x8fff_0000);
        assert_eq!(modulation.word(1), 0x0001_0000);
        assert_eq!(modulation.mode_word(), 0x23);
    }
}
