//! The configuration of a Net F/T sensor as a machine file states it.

use std::net::SocketAddr;
use std::ops::RangeInclusive;

use serde::Deserialize;
use taktil_hal::{Invalid, Nanos};

taktil_hal::explained! {
    /// An ATI Net F/T sensor over UDP. Only `address` has no default.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// Address and port of the box, such as `192.168.1.1:49152`, which it has as delivered.
        pub address: String,
        /// Whether the load at the opening becomes the sensor's zero. Nothing may touch the finger
        /// then. Default false.
        pub bias: bool,
        /// Records a second that the box sends, as its configuration page says (Hz). Default 7000.
        pub rate_hz: u32 [1.0, 7000.0],
        /// Counts of a force at the end of the sensor's range, from which on it is over range; 0
        /// when it is not judged. Default 0.
        pub force_range_counts: u32 [0.0, 2147483647.0],
        /// Counts of a torque at the end of the sensor's range; 0 when it is not judged. Default 0.
        pub torque_range_counts: u32 [0.0, 2147483647.0],
        /// Without a valid record for longer than this the sensor is stale (ms). Default 20.
        pub stale_ms: u32 [1.0, 10000.0],
        /// How often a silent box is asked to start again (ms). Default 100.
        pub ask_again_ms: u32 [10.0, 10000.0],
        /// How long the opening waits for a record (ms). Default 500.
        pub open_wait_ms: u32 [1.0, 10000.0],
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            address: String::new(),
            bias: false,
            rate_hz: 7_000,
            force_range_counts: 0,
            torque_range_counts: 0,
            stale_ms: 20,
            ask_again_ms: 100,
            open_wait_ms: 500,
        }
    }
}

/// Times in milliseconds that the config takes.
const TIMES_MS: RangeInclusive<u32> = 1..=10_000;
/// Counts of a component that the config takes.
const RANGE_COUNTS: RangeInclusive<u32> = 0..=0x7fff_ffff;

impl Config {
    /// Checks every field against the bounds that it states.
    ///
    /// # Errors
    /// The first value that is outside the bounds its field states.
    pub fn check(&self) -> Result<(), Invalid> {
        if self.address.parse::<SocketAddr>().is_err() {
            let what = format!("`{}` is no address with a port", self.address);
            let remedy = "write the box's address such as 192.168.1.1:49152";
            return Err(Invalid::new("address", what, remedy));
        }
        within("rate_hz", self.rate_hz, 1..=7_000)?;
        within("force_range_counts", self.force_range_counts, RANGE_COUNTS)?;
        within("torque_range_counts", self.torque_range_counts, RANGE_COUNTS)?;
        within("stale_ms", self.stale_ms, TIMES_MS)?;
        within("ask_again_ms", self.ask_again_ms, 10..=10_000)?;
        within("open_wait_ms", self.open_wait_ms, TIMES_MS)?;
        if u64::from(self.stale_ms) * u64::from(self.rate_hz) < 1_000 {
            let what = format!("{} ms is less than a record takes", self.stale_ms);
            let remedy = format!("give more than a period of {} Hz", self.rate_hz);
            return Err(Invalid::new("stale_ms", what, remedy));
        }
        Ok(())
    }

    /// From one record to the next.
    pub(crate) fn record_period(&self) -> Nanos {
        Nanos(1_000_000_000 / i64::from(self.rate_hz.max(1)))
    }
}

fn within(place: &str, value: u32, range: RangeInclusive<u32>) -> Result<(), Invalid> {
    if range.contains(&value) {
        return Ok(());
    }
    let what = format!("{value} is out of bounds");
    Err(Invalid::new(place, what, format!("give {} to {}", range.start(), range.end())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bound_is_checked_and_named() {
        let good = Config { address: "127.0.0.1:49152".to_owned(), ..Config::default() };
        assert_eq!(good.check(), Ok(()));
        for (place, bad) in [
            ("address", Config::default()),
            ("address", Config { address: "192.168.1.1".to_owned(), ..good.clone() }),
            ("rate_hz", Config { rate_hz: 0, ..good.clone() }),
            ("rate_hz", Config { rate_hz: 7_001, ..good.clone() }),
            ("force_range_counts", Config { force_range_counts: 1 << 31, ..good.clone() }),
            ("torque_range_counts", Config { torque_range_counts: u32::MAX, ..good.clone() }),
            ("stale_ms", Config { stale_ms: 0, ..good.clone() }),
            ("stale_ms", Config { stale_ms: 9, rate_hz: 100, ..good.clone() }),
            ("ask_again_ms", Config { ask_again_ms: 9, ..good.clone() }),
            ("open_wait_ms", Config { open_wait_ms: 10_001, ..good.clone() }),
        ] {
            assert_eq!(bad.check().unwrap_err().place, place, "{bad:?}");
        }
    }

    #[test]
    fn a_section_is_read_and_strange_keys_are_refused() {
        let text = "address = '192.168.1.1:49152'\nrate_hz = 1000\nbias = true";
        let config: Config = toml::from_str(text).unwrap();
        assert_eq!((config.rate_hz, config.bias, config.stale_ms), (1000, true, 20));
        assert!(toml::from_str::<Config>("port = 49152").is_err());
    }
}
