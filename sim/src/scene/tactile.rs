//! `[tactile]`: the array under the fingertip's rubber and the electronics behind it. A rest level
//! at which noise would be clipped and a tactel that does not exist are errors.

use serde::Deserialize;

use super::section::{Consistency, inside, names, section};
use super::{Invalid, invalid};
use crate::geometry::ArrayGeometry;

taktil_hal::explained! {
    /// How much of the electronics is simulated; each value includes all values before it.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Electronics {
        /// Counts in proportion to the force on each tactel.
        #[default]
        Ideal,
        /// Gains that differ from tactel to tactel, a threshold and a power law.
        Response,
        /// Hysteresis and creep.
        Memory,
        /// Crosstalk through the network of rows and columns.
        Network,
    }
}

taktil_hal::explained! {
    /// The kind of a defect of a tactel.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum DefectKind {
        /// Reads the rest level under any load.
        Dead,
        /// Reads `counts` under any load.
        Stuck,
        /// Reads `counts` in every second half of `period_s`.
        Blinking,
    }
}

taktil_hal::explained! {
    /// The instant with which a frame is stamped.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum ScanStamp {
        /// When the last row was read.
        #[default]
        Scanned,
        /// When the board delivered it: the age of the frame is then unknown.
        Delivered,
    }
}

names!(Electronics, DefectKind, ScanStamp);

section! {
    /// `[tactile]`
    #[serde(default)]
    pub struct TactileConfig {
        /// Whether there is an array; without one no image is made and no noise drawn. Default
        /// true.
        present: bool,
        /// Number of rows, counted along the sensor's y. Default 16.
        rows: u32 [1.0, 64.0],
        /// Number of columns, counted along its x. Default 16.
        cols: u32 [1.0, 64.0],
        /// Distance of neighbouring columns (mm). With the number of columns it gives the pad's
        /// width: the fingertip's rubber bears on the tactels and not beside them. Default 1.5875:
        /// 16 on an inch.
        pitch_x_mm: f64 [0.2, 20.0],
        /// Distance of neighbouring rows (mm), as above. Default 1.5875.
        pitch_y_mm: f64 [0.2, 20.0],
        /// Converter width: 8 to 16. Default 12.
        bits: u32 [8.0, 16.0],
        /// Standard deviation of the noise on each tactel (counts). Default 50: it reproduces the
        /// thesis's +-5 deg on the pin's direction.
        noise_counts: f64 [0.0, 13107.0],
        /// Reading without load (counts), at least five standard deviations. Default 300.
        rest_counts: f64 [0.0, 32767.0],
        /// Force on one tactel that would span the whole converter (N): the scale from newtons to
        /// counts. Default 4.
        full_scale_n: f64 [1e-3, 1e3],
        /// Time from one row's reading to the next one's (us); the last row is read when the scan
        /// is complete. Default 0: all at once.
        row_us: f64 [0.0, 62500.0],
        /// Delay, in scan periods, with which a complete scan reaches the controller. Default 0.
        delay_scans: u32 [0.0, 30.0],
        /// The instant with which a scan is stamped: `scanned` (default), or `delivered`, with
        /// which the delay is hidden.
        stamp: ScanStamp,
        /// The simulated electronics: `ideal` (default), `response`, `memory` or `network`.
        electronics: Electronics,
        /// From `response` on: spread of the tactels' gains, one standard deviation. Default 0.06:
        /// part to part in a batch.
        gain_spread: f64 [0.0, 0.3],
        /// From `response` on: force below which a tactel conducts nothing (N). Default 0.002: the
        /// turn-on of a force-sensing resistor, 0.1 N, by area.
        threshold_n: f64 [0.0, 10.0],
        /// From `response` on: exponent of conductance over force; the reading at `full_scale_n`
        /// does not depend on it. Default 0.95.
        exponent: f64 [0.2, 2.0],
        /// From `memory` on: hysteresis; a decreasing load reads higher by this part than an
        /// increasing one. Default 0.1.
        hysteresis: f64 [0.0, 1.0],
        /// From `memory` on: growth of the reading under a constant load in each tenfold of time
        /// from 0.1 s to 1000 s. Default 0.05.
        creep_per_decade: f64 [0.0, 1.0],
        /// With `network`: resistance of a tactel at `full_scale_n` (ohm). Default 5000.
        full_scale_ohm: f64 [1.0, 1e9],
        /// With `network`: resistance of each row's driver and each column's input (ohm). Default
        /// 50.
        driver_ohm: f64 [0.0, 1e6],
        /// Tactels that are broken. Default none.
        defect: Vec<Defect>,
    }
}

section! {
    /// `[[tactile.defect]]`: a tactel, or a whole row or column of them.
    pub struct Defect {
        /// `dead`, `stuck` or `blinking`.
        kind: DefectKind,
        /// Row, from 0 and below `rows`; all of them when absent.
        row: Option<u32> [0.0, 63.0],
        /// Column, from 0 and below `cols`; all of them when absent.
        column: Option<u32> [0.0, 63.0],
        /// What a stuck or blinking tactel reads (counts). Default 0.
        #[serde(default)]
        counts: u32 [0.0, 65535.0],
        /// Period of a blinking one (s). Default 0.1.
        #[serde(default = "blink_s")]
        period_s: f64 [1e-3, 1e3],
        /// Begin of the defect (s). Default 0.
        #[serde(default)]
        from_s: f64 [0.0, 1e6],
    }
}

fn blink_s() -> f64 {
    0.1
}

impl Consistency for Defect {
    fn check_consistency(&self, place: &str) -> Result<(), Invalid> {
        if self.kind == DefectKind::Dead && self.counts != 0 {
            let what = "is not for dead tactels, which read the rest level".to_owned();
            return Err(invalid(&inside(place, "counts"), what, "leave it out, or say stuck"));
        }
        Ok(())
    }
}

impl TactileConfig {
    /// Rows, columns and pitches.
    #[must_use]
    pub fn geometry(&self) -> ArrayGeometry {
        ArrayGeometry {
            rows: self.rows as usize,
            cols: self.cols as usize,
            pitch_x_m: 1e-3 * self.pitch_x_mm,
            pitch_y_m: 1e-3 * self.pitch_y_mm,
        }
    }

    /// The largest reading (counts).
    #[must_use]
    pub fn full_counts(&self) -> u16 {
        u16::try_from((1_u32 << self.bits.min(16)) - 1).unwrap_or(u16::MAX)
    }
}

impl Consistency for TactileConfig {
    fn check_consistency(&self, place: &str) -> Result<(), Invalid> {
        let full = f64::from(self.full_counts());
        let most = [
            ("noise_counts", self.noise_counts, full / 5.0),
            ("rest_counts", self.rest_counts, full / 2.0),
        ];
        for (key, counts, most) in most {
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
        if self.electronics >= Electronics::Response && self.threshold_n >= self.full_scale_n {
            let what = format!("is {}, not below full_scale_n", self.threshold_n);
            return Err(invalid(&inside(place, "threshold_n"), what, "lower it"));
        }
        for (i, defect) in self.defect.iter().enumerate() {
            if f64::from(defect.counts) > full {
                let what = format!("is {}, above the converter's {full}", defect.counts);
                let place = inside(place, &format!("defect[{i}].counts"));
                return Err(invalid(&place, what, "lower it"));
            }
            for (key, index, count) in
                [("row", defect.row, self.rows), ("column", defect.column, self.cols)]
            {
                if let Some(index) = index.filter(|index| *index >= count) {
                    let place = inside(place, &format!("defect[{i}].{key}"));
                    let what = format!("is {index}, but the array has {count} of them");
                    return Err(invalid(&place, what, &format!("give 0 to {}", count - 1)));
                }
            }
        }
        Ok(())
    }
}

impl Default for TactileConfig {
    fn default() -> TactileConfig {
        TactileConfig {
            present: true,
            rows: 16,
            cols: 16,
            pitch_x_mm: 1.5875,
            pitch_y_mm: 1.5875,
            bits: 12,
            noise_counts: 50.0,
            rest_counts: 300.0,
            full_scale_n: 4.0,
            row_us: 0.0,
            delay_scans: 0,
            stamp: ScanStamp::Scanned,
            electronics: Electronics::Ideal,
            gain_spread: 0.06,
            threshold_n: 0.002,
            exponent: 0.95,
            hysteresis: 0.1,
            creep_per_decade: 0.05,
            full_scale_ohm: 5000.0,
            driver_ohm: 50.0,
            defect: Vec::new(),
        }
    }
}
