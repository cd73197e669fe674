//! `[tactile_scan]`: baseline, dead tactels, time limits. Numbers that make no sense for an array
//! are errors.

use serde::Deserialize;
use taktil_rtcore::{Invalid, Nanos};

use crate::response::Response;

taktil_rtcore::explained! {
    /// Every key has a default.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// New frames whose mean is the rest level; the finger must be free while they come.
        /// Default 40: 0.2 s at 200 Hz.
        pub baseline_frames: u32,
        /// As long as nothing touches, frames that come later are averaged too, up to so many in
        /// all: the newest 16 to 32 of them wait until the finger proves to have been free after
        /// them, and the first that differs from rest level ends it. Default 400: 2 s at 200 Hz; no
        /// more than `baseline_frames` averages those alone.
        pub baseline_frames_max: u32,
        /// Dead tactels as [row, column], numbers from 1. Default none.
        pub dead_tactels: Vec<[u16; 2]>,
        /// A tactel whose rest level is below this is stuck low (counts). Default 1; 0 switches it
        /// off.
        pub rest_min_counts: f64,
        /// A tactel whose rest level is above this share of the full scale is stuck high or was
        /// pressed while the baseline was taken. Default 0.5.
        pub rest_max_ratio: f64,
        /// Without a new frame for longer than this the array counts as stale (ms). Default 20:
        /// four scans.
        pub stale_ms: f64,
        /// The tactels' calibrated response, which is taken out of the readings. Default none:
        /// counts are passed on as they are.
        pub response: Option<Response>,
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            baseline_frames: 40,
            baseline_frames_max: 400,
            dead_tactels: Vec::new(),
            rest_min_counts: 1.0,
            rest_max_ratio: 0.5,
            stale_ms: 20.0,
            response: None,
        }
    }
}

/// Most frames of a baseline: 50 s at 200 Hz.
const FRAMES_MAX: u32 = 10_000;

impl Config {
    /// # Errors
    /// A number of frames of 0 or above 10 000, or of most frames above 10 000, a share outside 0
    /// to 1, a time or level that is
    /// negative or not finite.
    pub fn check(&self) -> Result<(), Invalid> {
        if self.baseline_frames == 0 || self.baseline_frames > FRAMES_MAX {
            return Err(Invalid::new(
                "baseline_frames",
                format!("{} frames make no baseline", self.baseline_frames),
                format!("give 1 to {FRAMES_MAX}"),
            ));
        }
        if self.baseline_frames_max > FRAMES_MAX {
            return Err(Invalid::new(
                "baseline_frames_max",
                format!("{} frames are more than a baseline takes", self.baseline_frames_max),
                format!("give at most {FRAMES_MAX}"),
            ));
        }
        if !(self.rest_min_counts >= 0.0 && self.rest_min_counts <= 65_535.0) {
            return Err(Invalid::new(
                "rest_min_counts",
                format!("{} is no reading", self.rest_min_counts),
                "give 0 to 65535 counts",
            ));
        }
        if !(self.rest_max_ratio > 0.0 && self.rest_max_ratio <= 1.0) {
            return Err(Invalid::new(
                "rest_max_ratio",
                format!("{} is no share of the full scale", self.rest_max_ratio),
                "give more than 0 and at most 1",
            ));
        }
        if !(self.stale_ms > 0.0 && self.stale_ms <= 10_000.0) {
            return Err(Invalid::new(
                "stale_ms",
                format!("{} ms is no limit", self.stale_ms),
                "give more than 0 and at most 10000 ms",
            ));
        }
        Ok(())
    }

    /// The dead tactels of an array of `rows` by `cols`, by index.
    ///
    /// # Errors
    /// A row or column that the array does not have.
    pub fn dead_mask(&self, rows: usize, cols: usize) -> Result<Box<[bool]>, Invalid> {
        let mut mask: Box<[bool]> = vec![false; rows * cols].into();
        for (entry, [row, col]) in self.dead_tactels.iter().enumerate() {
            let (r, c) = (usize::from(*row), usize::from(*col));
            if !(1..=rows).contains(&r) || !(1..=cols).contains(&c) {
                return Err(Invalid::new(
                    format!("dead_tactels[{entry}]"),
                    format!("the array of {rows} x {cols} has no tactel [{row}, {col}]"),
                    "give [row, column] counted from 1",
                ));
            }
            mask[(r - 1) * cols + c - 1] = true;
        }
        Ok(mask)
    }

    /// The limit of staleness.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "checked to be at most 10 s")]
    pub fn stale_after(&self) -> Nanos {
        Nanos((self.stale_ms * 1e6).round() as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_numbers_are_refused_with_their_place() {
        let place = |change: fn(&mut Config)| {
            let mut config = Config::default();
            change(&mut config);
            config.check().unwrap_err().place
        };
        assert_eq!(Config::default().check(), Ok(()));
        assert_eq!(place(|c| c.baseline_frames = 0), "baseline_frames");
        assert_eq!(place(|c| c.baseline_frames = u32::MAX), "baseline_frames");
        assert_eq!(place(|c| c.baseline_frames_max = 10_001), "baseline_frames_max");
        assert_eq!(place(|c| c.rest_min_counts = -1.0), "rest_min_counts");
        assert_eq!(place(|c| c.rest_min_counts = f64::NAN), "rest_min_counts");
        assert_eq!(place(|c| c.rest_max_ratio = 0.0), "rest_max_ratio");
        assert_eq!(place(|c| c.rest_max_ratio = 1.1), "rest_max_ratio");
        assert_eq!(place(|c| c.stale_ms = 0.0), "stale_ms");
        assert_eq!(place(|c| c.stale_ms = f64::INFINITY), "stale_ms");
    }

    #[test]
    fn dead_tactels_are_counted_from_one() {
        let mut config =
            Config { dead_tactels: vec![[1, 1], [2, 3], [16, 16]], ..Config::default() };
        let mask = config.dead_mask(16, 16).unwrap();
        assert!(mask[0] && mask[18] && mask[255]);
        assert_eq!(mask.iter().filter(|dead| **dead).count(), 3);
        for absent in [[0, 1], [1, 0], [17, 1], [1, 17]] {
            config.dead_tactels[1] = absent;
            assert_eq!(config.dead_mask(16, 16).unwrap_err().place, "dead_tactels[1]");
        }
    }
}
