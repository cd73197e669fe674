//! Checks each value of a description against its bounds, and computes where the registers of a
//! value stand.

use std::fmt::Display;
use std::ops::RangeInclusive;

use taktil_hal::{Invalid, MAX_ROWS};

use super::ByteOrder;
use super::{
    BUSY_POLLS_MAX, Description, EncoderBank, Hold, InputBank, InputLines, OutputBank, OutputLines,
    StartBy, StrobeKind, TactileBank, Watchdog, WordOrder,
};
use crate::codes::Codec;

/// The most channels that a bank may have; a half carries [`taktil_hal::CHANNELS`] of them.
pub const CHANNELS_MAX: usize = 64;
/// The largest window on the bus: 16 MB, the short and standard address spaces of VME.
pub const WINDOW_BYTES_MAX: usize = 1 << 24;
/// The most bits of a value with those below it.
pub const REGISTER_BITS_MAX: u32 = 32;
/// The largest voltage of a converter, either way (V).
pub const SPAN_MAX_V: f64 = 1000.0;

/// Widths of converters (bits).
const CONVERTER_BITS: RangeInclusive<u32> = 2..=31;
/// Widths of counters (bits).
const COUNTER_BITS: RangeInclusive<u32> = 8..=32;
/// Widths of a tactel's count (bits).
const TACTEL_BITS: RangeInclusive<u32> = 2..=16;
/// Largest time of a tactile scan, and largest unit of a watchdog (us).
const TIME_MAX_US: u32 = 1_000_000;

impl Description {
    /// The bytes of a register; 1 for a width that is refused.
    pub(crate) fn bus_bytes(&self) -> usize {
        match self.bus_bits {
            16 => 2,
            32 => 4,
            _ => 1,
        }
    }

    /// From a register to the next one, in bytes.
    pub(crate) fn stride(&self) -> usize {
        self.stride_bytes.unwrap_or_else(|| self.bus_bytes())
    }

    /// All bits of a register.
    pub(crate) fn bus_mask(&self) -> u32 {
        u32::MAX >> (32 - 8 * self.bus_bytes() as u32)
    }

    /// Which register of a value stands first.
    pub(crate) fn words_in_order(&self) -> WordOrder {
        self.word_order.unwrap_or(match self.byte_order {
            ByteOrder::Big => WordOrder::HighFirst,
            ByteOrder::Little => WordOrder::LowFirst,
        })
    }

    /// How many registers a value of `bits` takes that stands above `shift` others.
    pub(crate) fn words(&self, bits: u32, shift: u32) -> usize {
        (bits.saturating_add(shift) as usize).div_ceil(8 * self.bus_bytes())
    }

    /// How many registers a count takes.
    pub(crate) fn count_words(&self, part: &EncoderBank) -> usize {
        part.words.unwrap_or_else(|| self.words(part.bits, part.shift))
    }

    /// From a channel to the next one of a bank whose values take `words` registers.
    pub(crate) fn channel_stride(&self, stride_bytes: Option<usize>, words: usize) -> usize {
        stride_bytes.unwrap_or_else(|| words.saturating_mul(self.stride()))
    }

    /// Checks everything that the description states, also against each other.
    ///
    /// # Errors
    /// The first value that is out of bounds, stands outside the window or overlaps another one.
    pub fn check(&self) -> Result<(), Invalid> {
        self.check_bus()?;
        for (at, expected) in self.identity.iter().chain(&self.presence).enumerate() {
            let place = if at < self.identity.len() {
                format!("identity[{at}]")
            } else {
                "presence".to_owned()
            };
            let mask = self.check_mask(&place, "mask", expected.mask)?;
            self.check_value(&place, "value", expected.value, mask)?;
        }
        for (at, written) in self.setup.iter().enumerate() {
            let place = format!("setup[{at}]");
            self.check_value(&place, "value", written.value, self.bus_mask())?;
        }
        let checks = [
            self.watchdog.as_ref().map(|part| self.check_watchdog(part)),
            self.encoders.as_ref().map(|part| self.check_encoders(part)),
            self.analog_out.as_ref().map(|part| self.check_outputs(part)),
            self.analog_in.as_ref().map(|part| self.check_inputs("analog_in", part)),
            self.force_torque.as_ref().map(|part| self.check_inputs("force_torque", part)),
            self.tactile.as_ref().map(check_tactile),
            self.digital_in.as_ref().map(|part| self.check_lines_in(part)),
            self.digital_out.as_ref().map(|part| self.check_lines_out(part)),
            self.index.as_ref().map(|_| self.check_index()),
        ];
        checks.into_iter().flatten().collect::<Result<(), Invalid>>()?;
        self.check_registers()
    }

    fn check_bus(&self) -> Result<(), Invalid> {
        if self.name.trim().is_empty() {
            return Err(Invalid::new("name", "is empty", "name the board, for messages"));
        }
        if ![8, 16, 32].contains(&self.bus_bits) {
            let what = format!("{} is no width of a bus", self.bus_bits);
            return Err(Invalid::new("bus_bits", what, "give 8, 16 or 32"));
        }
        let bytes = self.bus_bytes();
        within("length_bytes", self.length_bytes, bytes..=WINDOW_BYTES_MAX)?;
        within("stride_bytes", self.stride(), bytes..=WINDOW_BYTES_MAX)?;
        if !self.stride().is_multiple_of(bytes) {
            let what = format!("{} is no multiple of the bus's {bytes} bytes", self.stride());
            return Err(Invalid::new("stride_bytes", what, "give a multiple, or leave it out"));
        }
        Ok(())
    }

    /// A mask, which has at least one bit and none beyond the bus.
    fn check_mask(&self, place: &str, key: &str, mask: Option<u32>) -> Result<u32, Invalid> {
        let mask = mask.unwrap_or_else(|| self.bus_mask());
        if mask == 0 {
            let remedy = "give the bits that count, or leave it out";
            return Err(Invalid::new(format!("{place}.{key}"), "has no bit", remedy));
        }
        self.check_value(place, key, mask, self.bus_mask())?;
        Ok(mask)
    }

    /// A value that has no bit outside `mask`.
    fn check_value(&self, place: &str, key: &str, value: u32, mask: u32) -> Result<(), Invalid> {
        if value & !mask == 0 {
            return Ok(());
        }
        let what = format!("{value:#x} has bits outside {mask:#x}");
        let remedy = format!("registers have {} bits; correct value or mask", self.bus_bits);
        Err(Invalid::new(format!("{place}.{key}"), what, remedy))
    }

    fn check_bit(&self, place: &str, bit: u32) -> Result<(), Invalid> {
        within(place, bit, 0..=self.bus_bits - 1)
    }

    /// Width and place of a code or count inside its registers.
    fn check_bits(
        &self,
        place: &str,
        bits: u32,
        allowed: RangeInclusive<u32>,
        shift: u32,
    ) -> Result<(), Invalid> {
        within(&format!("{place}.bits"), bits, allowed)?;
        let room = REGISTER_BITS_MAX - bits;
        within(&format!("{place}.shift"), shift, 0..=room)
    }

    fn check_busy(
        &self,
        place: &str,
        [mask, value]: [Option<u32>; 2],
        offset: Option<usize>,
        polls: u32,
    ) -> Result<(), Invalid> {
        let bits = self.check_mask(place, "busy_mask", mask)?;
        self.check_value(place, "busy_value", value.unwrap_or(bits), bits)?;
        if offset.is_none() && (mask.is_some() || value.is_some()) {
            let remedy = "give `busy_offset`, or leave `busy_mask` and `busy_value` out";
            return Err(Invalid::new(format!("{place}.busy_offset"), "is missing", remedy));
        }
        within(&format!("{place}.polls"), polls, 1..=BUSY_POLLS_MAX)
    }

    fn check_watchdog(&self, part: &Watchdog) -> Result<(), Invalid> {
        within("watchdog.unit_us", part.unit_us, 1..=TIME_MAX_US)?;
        self.check_value("watchdog", "kick_value", part.kick_value, self.bus_mask())?;
        let strobed = self.analog_out.as_ref().is_none_or(|bank| bank.strobe_offset.is_some());
        if strobed || part.kick_offset.is_some() {
            return Ok(());
        }
        let remedy = "give `watchdog.kick_offset` or `analog_out.strobe_offset`";
        Err(Invalid::new("watchdog.kick_offset", "nothing is its sign of life", remedy))
    }

    fn check_encoders(&self, part: &EncoderBank) -> Result<(), Invalid> {
        within("encoders.channels", part.channels, 1..=CHANNELS_MAX)?;
        self.check_bits("encoders", part.bits, COUNTER_BITS, part.shift)?;
        let room = REGISTER_BITS_MAX as usize / (8 * self.bus_bytes());
        let needed = self.words(part.bits, part.shift);
        within("encoders.words", self.count_words(part), needed..=room)?;
        self.check_value("encoders", "latch_value", part.latch_value, self.bus_mask())?;
        let busy = [part.busy_mask, part.busy_value];
        self.check_busy("encoders", busy, part.busy_offset, part.polls)?;
        within("encoders.step_max_counts", part.step_max_counts, 0..=i32::MAX.unsigned_abs())?;
        numbers("encoders", part.begin_offset, part.end_offset)?;
        if part.latch_offset.is_some() {
            return Ok(());
        }
        let (key, what) = if part.hold == Hold::Latch {
            ("encoders.hold", "is `latch` without a latch")
        } else if part.latch == StrobeKind::Count {
            ("encoders.latch", "is `count` without a latch")
        } else if part.busy_offset.is_some() {
            ("encoders.busy_offset", "shows the state of a latch that is not there")
        } else {
            return Ok(());
        };
        Err(Invalid::new(key, what, "give `encoders.latch_offset`, or leave this out"))
    }

    fn check_index(&self) -> Result<(), Invalid> {
        let Some(part) = &self.index else { return Ok(()) };
        numbers("index", part.begin_offset, part.end_offset)?;
        self.check_mask("index", "feature_mask", Some(part.feature_mask))?;
        match &self.encoders {
            Some(encoders) => {
                within("encoders.channels", encoders.channels, 1..=self.bus_bits as usize)
            }
            None => {
                let remedy = "describe `encoders`, or leave `index` out";
                Err(Invalid::new("index", "has no encoders to belong to", remedy))
            }
        }
    }

    fn check_outputs(&self, part: &OutputBank) -> Result<(), Invalid> {
        within("analog_out.channels", part.channels, 1..=CHANNELS_MAX)?;
        self.check_bits("analog_out", part.bits, CONVERTER_BITS, part.shift)?;
        check_span("analog_out", part.low_v, part.high_v)?;
        self.check_value("analog_out", "strobe_value", part.strobe_value, self.bus_mask())?;
        let (low, high) = Codec::new(part.format, part.bits, part.inverted).range();
        within("analog_out.safe_code", part.safe_code, low..=high)?;
        if part.strobe == StrobeKind::Count && part.strobe_offset.is_none() {
            let remedy = "give `analog_out.strobe_offset`, or leave this out";
            return Err(Invalid::new("analog_out.strobe", "is `count` without a strobe", remedy));
        }
        Ok(())
    }

    fn check_inputs(&self, place: &str, part: &InputBank) -> Result<(), Invalid> {
        let channels = if place == "force_torque" { 6..=6 } else { 1..=CHANNELS_MAX };
        within(&format!("{place}.channels"), part.channels, channels)?;
        self.check_bits(place, part.bits, CONVERTER_BITS, part.shift)?;
        check_span(place, part.low_v, part.high_v)?;
        self.check_value(place, "start_value", part.start_value, self.bus_mask())?;
        let busy = [part.busy_mask, part.busy_value];
        self.check_busy(place, busy, part.busy_offset, part.polls)?;
        numbers(place, part.begin_offset, part.end_offset)?;
        if part.start_by != StartBy::Encoders {
            return Ok(());
        }
        let (key, remedy) = if part.start_offset.is_none() {
            ("start_offset", "give the register that starts a conversion")
        } else if self.encoders.is_none() {
            ("start_by", "describe `encoders`, or take `sample`")
        } else {
            return Ok(());
        };
        let what = "encoders cannot start a conversion here";
        Err(Invalid::new(format!("{place}.{key}"), what, remedy))
    }

    fn check_lines_in(&self, part: &InputLines) -> Result<(), Invalid> {
        let bits = [part.drive_power_bit, part.estop_a_bit, part.estop_b_bit];
        self.check_line_bits(
            "digital_in",
            ["drive_power_bit", "estop_a_bit", "estop_b_bit"],
            bits,
            part.inverted_mask,
        )?;
        self.check_value("digital_in", "zero_mask", part.zero_mask, self.bus_mask())?;
        let lines = bits.iter().fold(0, |mask, bit| mask | 1u32 << bit);
        self.check_value("digital_in", "zero_mask", part.zero_mask, !lines)?;
        let Some(shift) = part.beat_shift else { return Ok(()) };
        within("digital_in.beat_bits", part.beat_bits, 1..=self.bus_bits)?;
        within("digital_in.beat_shift", shift, 0..=self.bus_bits - part.beat_bits)?;
        let beat = (u32::MAX >> (32 - part.beat_bits)) << shift;
        if beat & (lines | part.zero_mask) == 0 {
            return Ok(());
        }
        let remedy = "the number, the lines and `zero_mask` have bits of their own";
        Err(Invalid::new("digital_in.beat_shift", "covers another bit", remedy))
    }

    fn check_lines_out(&self, part: &OutputLines) -> Result<(), Invalid> {
        self.check_line_bits(
            "digital_out",
            ["enable_bit", "brake_release_bit", "watchdog_feed_bit"],
            [part.enable_bit, part.brake_release_bit, part.watchdog_feed_bit],
            part.inverted_mask,
        )
    }

    fn check_line_bits(
        &self,
        place: &str,
        keys: [&str; 3],
        bits: [u32; 3],
        inverted: u32,
    ) -> Result<(), Invalid> {
        for (at, (key, bit)) in keys.iter().zip(bits).enumerate() {
            self.check_bit(&format!("{place}.{key}"), bit)?;
            if let Some(other) = bits[..at].iter().position(|other| *other == bit) {
                let what = format!("bit {bit} is `{}` already", keys[other]);
                return Err(Invalid::new(format!("{place}.{key}"), what, "give another bit"));
            }
        }
        self.check_value(place, "inverted_mask", inverted, self.bus_mask())
    }
}

fn check_tactile(part: &TactileBank) -> Result<(), Invalid> {
    within("tactile.rows", part.rows, 1..=MAX_ROWS)?;
    within("tactile.cols", part.cols, 1..=MAX_ROWS)?;
    within("tactile.bits", part.bits, TACTEL_BITS)?;
    within("tactile.scan_us", part.scan_us, 1..=TIME_MAX_US)
}

/// Both registers of a number, or none.
fn numbers(place: &str, begin: Option<usize>, end: Option<usize>) -> Result<(), Invalid> {
    let missing = match (begin, end) {
        (Some(_), None) => "end_offset",
        (None, Some(_)) => "begin_offset",
        _ => return Ok(()),
    };
    let remedy = "a number stands before and after the values: give both registers, or none";
    Err(Invalid::new(format!("{place}.{missing}"), "is missing", remedy))
}

fn check_span(place: &str, low_v: f64, high_v: f64) -> Result<(), Invalid> {
    within(&format!("{place}.low_v"), low_v, -SPAN_MAX_V..=SPAN_MAX_V)?;
    within(&format!("{place}.high_v"), high_v, -SPAN_MAX_V..=SPAN_MAX_V)?;
    if low_v < high_v {
        return Ok(());
    }
    let what = format!("{low_v} V is not below `high_v`, {high_v} V");
    Err(Invalid::new(format!("{place}.low_v"), what, "give the lower end"))
}

/// Refuses a value outside a range; a number that is none is outside.
pub(crate) fn within<T>(place: &str, value: T, range: RangeInclusive<T>) -> Result<(), Invalid>
where
    T: PartialOrd + Display,
{
    if range.contains(&value) {
        return Ok(());
    }
    let (lowest, highest) = (range.start(), range.end());
    let what = format!("{value} is out of bounds");
    let remedy = if lowest == highest {
        format!("give {lowest}")
    } else {
        format!("give {lowest} to {highest}")
    };
    Err(Invalid::new(place, what, remedy))
}

impl InputBank {
    /// The code of its fields.
    pub(crate) fn codec(&self) -> Codec {
        Codec::new(self.format, self.bits, self.inverted)
    }
}

impl OutputBank {
    /// The code of its fields.
    pub(crate) fn codec(&self) -> Codec {
        Codec::new(self.format, self.bits, self.inverted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_is_out_of_bounds() {
        assert!(within("low_v", f64::NAN, -1.0..=1.0).is_err());
        assert!(check_span("x", -1.0, f64::INFINITY).is_err());
        assert!(check_span("x", 1.0, 1.0).is_err());
        assert!(check_span("x", -1.0, 1.0).is_ok());
    }

    #[test]
    fn a_number_has_both_its_registers_or_none() {
        assert!(numbers("x", None, None).is_ok());
        assert_eq!(numbers("x", Some(0), None).unwrap_err().place, "x.end_offset");
        assert_eq!(numbers("x", None, Some(0)).unwrap_err().place, "x.begin_offset");
    }
}
