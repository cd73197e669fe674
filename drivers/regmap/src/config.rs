//! The configuration of a register-file board as a machine file states it. Signs and scales are not
//! part of it: they belong to the software that knows the wiring.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use serde::Deserialize;
use taktil_hal::Invalid;

use crate::codes::{CONVERTER_BITS, COUNTER_BITS};
use crate::registers::{BLOCK_BYTES, BOARD_CHANNELS};

/// A register-file board. Only `path` has no default.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// A UIO device such as `/dev/uio0`, or a plain file that a model of the board serves.
    pub path: PathBuf,
    /// Which of a UIO device's memory maps holds the block; 0 for a plain file. Default 0.
    pub map: u8,
    /// Where the block starts in the map or file, in bytes, even. Default 0.
    pub offset_bytes: usize,
    /// How many bytes to map from there, at least and by default [`BLOCK_BYTES`].
    pub length_bytes: usize,
    /// Encoders wired, 1 to 8. Default 6.
    pub joints: usize,
    /// D/A channels wired, 1 to 8. Default 8.
    pub dac_channels: usize,
    /// A/D channels wired, 1 to 8. Default 8.
    pub adc_channels: usize,
    /// Width of the D/A converters, 2 to 16 bits. Default 12.
    pub dac_bits: u32,
    /// Width of the A/D converters, 2 to 16 bits. Default 12.
    pub adc_bits: u32,
    /// Width of the force/torque gauges' converters, 2 to 16 bits. Default 12.
    pub gauge_bits: u32,
    /// Width of the encoder counters, 8 to 32 bits; narrower ones are carried across their wrap.
    /// Default 32.
    pub counter_bits: u32,
    /// Width of a tactel's count, 2 to 16 bits. Default 12.
    pub tactile_bits: u32,
    /// How long a scan of the tactile array takes, in microseconds, 1 to 1 000 000: the rows of a
    /// frame are stamped evenly over it. Default 5000.
    pub tactile_scan_us: u32,
    /// After how long without a commit (D/A) or a change of the feed line (digital lines) the board
    /// goes safe by itself, in milliseconds, 1 to 10 000. Default 10: four cycles of 2.5 ms.
    pub watchdog_ms: u16,
    /// After how long without a new number on a block its readings count as stale, in milliseconds,
    /// 1 to 10 000. Default 10.
    pub stale_ms: u16,
}

impl Default for Config {
    fn default() -> Config {
        Config {
            path: PathBuf::new(),
            map: 0,
            offset_bytes: 0,
            length_bytes: BLOCK_BYTES,
            joints: 6,
            dac_channels: BOARD_CHANNELS,
            adc_channels: BOARD_CHANNELS,
            dac_bits: 12,
            adc_bits: 12,
            gauge_bits: 12,
            counter_bits: 32,
            tactile_bits: 12,
            tactile_scan_us: 5_000,
            watchdog_ms: 10,
            stale_ms: 10,
        }
    }
}

/// The longest watchdog time and the longest staleness (ms).
const WATCHDOG_MAX_MS: u16 = 10_000;
/// The longest scan of the tactile array (us).
const TACTILE_SCAN_MAX_US: u32 = 1_000_000;

impl Config {
    /// Checks every field against the bounds that it states.
    ///
    /// # Errors
    /// The first value that is outside the bounds its field states.
    pub fn check(&self) -> Result<(), Invalid> {
        if self.path.as_os_str().is_empty() {
            let remedy = "name a UIO device such as /dev/uio0, or a file";
            return Err(Invalid::new("path", "no path is given", remedy));
        }
        self.check_window()?;
        self.check_board()
    }

    /// Checks everything but where the board is.
    pub(crate) fn check_board(&self) -> Result<(), Invalid> {
        require_within("joints", self.joints, 1..=BOARD_CHANNELS)?;
        require_within("dac_channels", self.dac_channels, 1..=BOARD_CHANNELS)?;
        require_within("adc_channels", self.adc_channels, 1..=BOARD_CHANNELS)?;
        require_within("dac_bits", self.dac_bits, CONVERTER_BITS)?;
        require_within("adc_bits", self.adc_bits, CONVERTER_BITS)?;
        require_within("gauge_bits", self.gauge_bits, CONVERTER_BITS)?;
        require_within("tactile_bits", self.tactile_bits, CONVERTER_BITS)?;
        require_within("counter_bits", self.counter_bits, COUNTER_BITS)?;
        require_within("tactile_scan_us", self.tactile_scan_us, 1..=TACTILE_SCAN_MAX_US)?;
        require_within("watchdog_ms", self.watchdog_ms, 1..=WATCHDOG_MAX_MS)?;
        require_within("stale_ms", self.stale_ms, 1..=WATCHDOG_MAX_MS)
    }

    fn check_window(&self) -> Result<(), Invalid> {
        require_within(
            "length_bytes",
            self.length_bytes,
            BLOCK_BYTES..=isize::MAX.cast_unsigned(),
        )?;
        if !self.offset_bytes.is_multiple_of(2) {
            let what = format!("{} is odd", self.offset_bytes);
            let remedy = "registers are 16-bit words: give an even offset";
            return Err(Invalid::new("offset_bytes", what, remedy));
        }
        require_within(
            "offset_bytes",
            self.offset_bytes,
            0..=isize::MAX as usize - self.length_bytes,
        )
    }
}

fn require_within<T>(place: &str, value: T, range: RangeInclusive<T>) -> Result<(), Invalid>
where
    T: PartialOrd + std::fmt::Display,
{
    if range.contains(&value) {
        return Ok(());
    }
    let (lowest, highest) = (range.start(), range.end());
    let what = format!("{value} is out of bounds");
    Err(Invalid::new(place, what, format!("give {lowest} to {highest}")))
}
