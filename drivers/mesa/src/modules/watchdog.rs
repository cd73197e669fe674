//! The FPGA's watchdog: a timer in cycles of the low clock that counts down and, at the change of
//! its sign, makes every pin an input. Nothing else is forgotten then: what the modules were told
//! before comes out again as soon as the directions are written. Source: `watchdog.vhd` and
//! `wordpr.vhd`.

/// Register: the timer and what a sign of life loads into it.
pub(crate) const TIME_REGISTER: u32 = 0;
/// Register: bit 0 says that it has bitten; written 0 to clear.
pub(crate) const STATUS_REGISTER: u32 = 1;
/// Register: a sign of life.
pub(crate) const FEED_REGISTER: u32 = 2;

/// The sign of life stands in the top byte.
pub(crate) const FEED_WORD: u32 = 0x5a00_0000;
/// A word that is no sign of life.
pub(crate) const NO_FEED_WORD: u32 = 0;
/// A negative timer: the watchdog is off.
pub(crate) const OFF_WORD: u32 = 0x8000_0000;
/// The shortest time: the watchdog bites at once.
pub(crate) const BITE_WORD: u32 = 1;

/// The timer's word for a time.
pub(crate) fn time_word(time_ms: u32, clock_hz: u32) -> u32 {
    let cycles = u64::from(time_ms) * u64::from(clock_hz) / 1_000;
    cycles.clamp(2, u64::from(OFF_WORD) - 1) as u32 - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_counted_in_the_low_clock_and_never_negative() {
        assert_eq!(time_word(25, 100_000_000), 2_499_999);
        assert_eq!(time_word(10_000, u32::MAX), OFF_WORD - 2);
        assert_eq!(time_word(1, 1), 1);
    }
}
