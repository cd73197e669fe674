//! `[tactile]`: the array under the fingertip's rubber and the electronics behind it. Refuses rest
//! levels at which noise would be clipped.

use super::section::{Agree, inside, section};
use super::{Invalid, invalid};

section! {
    /// `[tactile]`
    #[derive(Copy)]
    #[serde(default)]
    pub struct TactileConfig {
        /// Converter width, 8 to 16. Default 12.
        bits: u32 [8.0, 16.0],
        /// Standard deviation of the noise on each tactel (counts). Default 50: it reproduces the
        /// thesis's +-5 deg on the pin's direction.
        noise_counts: f64 [0.0, 13107.0],
        /// Reading without load (counts), at least five standard deviations. Default 300.
        rest_counts: f64 [0.0, 32767.0],
        /// Force on one tactel that would span the whole converter (N). Default 4.
        full_scale_n: f64 [1e-3, 1e3],
    }
}

impl TactileConfig {
    /// The largest reading (counts).
    #[must_use]
    pub fn full_counts(&self) -> u16 {
        u16::try_from((1_u32 << self.bits.min(16)) - 1).unwrap_or(u16::MAX)
    }
}

impl Agree for TactileConfig {
    fn agree(&self, place: &str) -> Result<(), Invalid> {
        let full = f64::from(self.full_counts());
        for (key, counts, most) in [
            ("noise_counts", self.noise_counts, full / 5.0),
            ("rest_counts", self.rest_counts, full / 2.0),
        ] {
            if counts > most {
                let remedy = format!("give at most {most} with {} bits", self.bits);
                return Err(invalid(&inside(place, key), format!("is {counts}"), &remedy));
            }
        }
        if self.rest_counts < 5.0 * self.noise_counts {
            let what = format!(
                "is {}, less than 5 x noise_counts = {}: clipping at zero would bias every sum",
                self.rest_counts,
                5.0 * self.noise_counts
            );
            return Err(invalid(
                &inside(place, "rest_counts"),
                what,
                "raise it or lower the noise",
            ));
        }
        Ok(())
    }
}

impl Default for TactileConfig {
    fn default() -> TactileConfig {
        TactileConfig { noise_counts: 50.0, rest_counts: 300.0, bits: 12, full_scale_n: 4.0 }
    }
}
