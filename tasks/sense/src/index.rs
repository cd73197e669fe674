//! Finds the encoder counts of the home pose from the index pulses. There is one pulse per motor
//! turn, so the pulse gives the count up to whole turns, and a calibration by eye only has to find
//! the right turn. A joint that has passed no pulse is an error, and so is a home pose so far from
//! the nearest pulse that the turn may be the wrong one.

use serde::Deserialize;
use taktil_hal::{Counts, IndexPulses};
use taktil_mechanics::transmission::Transmission;
use taktil_rtcore::{FaultCode, Invalid};
use taktil_signal::per_joint;

taktil_rtcore::explained! {
    /// Settings of the search for the nearest index pulse; of no meaning on a board without pulses.
    #[derive(Clone, Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    pub struct IndexConfig {
        /// Leaves the pulses alone: the home pose is where the operator says. Default: false.
        pub ignore: bool,
        /// How many counts past an index pulse each joint's motor stands in the home pose, found
        /// when the robot was set up. Default: 0, the home pose is that of the pulses.
        pub home_counts: Option<Vec<f64>>,
        /// Farthest distance of a motor from its home count at a calibration, in parts of a turn,
        /// below 0.5: farther means that the neighbouring turn may be the right one. Default: 0.25.
        pub distance_max_rev: f64,
    }
}

impl Default for IndexConfig {
    fn default() -> IndexConfig {
        IndexConfig { ignore: false, home_counts: None, distance_max_rev: 0.25 }
    }
}

/// Largest distance from a pulse that may be given (counts).
const COUNTS_MAX: f64 = 1e6;

impl IndexConfig {
    /// Refuses counts that are no whole numbers of sensible size and distances outside 0 to 0.5.
    ///
    /// # Errors
    /// The place, what is wrong there, and the way out.
    pub fn check(&self) -> Result<(), Invalid> {
        for (i, counts) in self.home_counts.iter().flatten().enumerate() {
            if counts.fract() != 0.0 || !(-COUNTS_MAX..=COUNTS_MAX).contains(counts) {
                return Err(Invalid::new(
                    format!("home_counts[{i}]"),
                    format!("{counts} is not a number of counts"),
                    "give a whole number, within +-1000000",
                ));
            }
        }
        if !(self.distance_max_rev > 0.0 && self.distance_max_rev < 0.5) {
            return Err(Invalid::new(
                "distance_max_rev",
                format!("{} of a turn does not tell one turn from the next", self.distance_max_rev),
                "give a number above 0 and below 0.5; 0.25 is usual",
            ));
        }
        Ok(())
    }
}

/// The pulses of an arm.
#[derive(Clone, Copy, Debug)]
pub struct Index<const N: usize = 6> {
    home: [i32; N],
    turn: [i32; N],
    distance_max_rev: f64,
}

/// The offset from the home pose according to the pulses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IndexOffset<const N: usize = 6> {
    /// Counts of each motor past the home pose; 0 for motors that have not passed a pulse.
    pub off: [i32; N],
    /// The first motor for which the calibration is refused, and the reason.
    pub refused: Option<(usize, FaultCode)>,
}

impl<const N: usize> Index<N> {
    /// The pulses for the gears of an arm. The count of a pulse is right up to `reach` counts from
    /// the encoder's present count ([`taktil_hal::Encoders::index_pulse_reach`]).
    ///
    /// # Errors
    /// What [`IndexConfig::check`] refuses, a list of another length, encoders that have no whole
    /// number of counts in a motor turn, and turns longer than `reach`: the newest pulse may be a
    /// whole turn away.
    pub fn new(
        config: &IndexConfig,
        gears: &Transmission<N>,
        reach: i32,
    ) -> Result<Index<N>, Invalid> {
        config.check()?;
        let home = match &config.home_counts {
            Some(list) => per_joint("home_counts", list)?,
            None => [0.0; N],
        };
        let per_rev = gears.counts_per_revolution();
        let mut turn = [0; N];
        for (i, turn) in turn.iter_mut().enumerate() {
            // The conversion through counts per radian leaves a rounding error.
            *turn = nearest_integer(per_rev[i]).abs();
            let near = (per_rev[i].abs() - f64::from(*turn)).abs() < 1e-6;
            if *turn < 2 || !near {
                return Err(Invalid::new(
                    "",
                    format!("motor {} has {} counts in a turn", i + 1, per_rev[i]),
                    "index pulses need a whole number of counts in a turn; else say ignore = true",
                ));
            }
            if *turn > reach {
                return Err(Invalid::new(
                    "",
                    format!(
                        "motor {} has {turn} counts in a turn, the board's counters are too narrow \
                         to place an index pulse more than {reach} counts away",
                        i + 1
                    ),
                    "wire a board with wider counters; else say ignore = true",
                ));
            }
        }
        Ok(Index {
            home: home.map(nearest_integer),
            turn,
            distance_max_rev: config.distance_max_rev,
        })
    }

    /// Distance of these counts from the nearest home pose according to the pulses.
    #[must_use]
    pub fn offset_from_home(&self, counts: &[i32; N], marks: &IndexPulses) -> IndexOffset<N> {
        let mut found = IndexOffset { off: [0; N], refused: None };
        for (i, (count, off)) in counts.iter().zip(&mut found.off).enumerate() {
            let Some(Counts(mark)) = marks.get(i).copied().flatten() else {
                found.refused.get_or_insert((i, FaultCode::IndexMissing));
                continue;
            };
            // Wrapping differences are right also after a counter has wrapped.
            let past = count.wrapping_sub(mark).wrapping_sub(self.home[i]);
            let above = past.rem_euclid(self.turn[i]);
            *off = if above > self.turn[i] / 2 { above - self.turn[i] } else { above };
            let far = self.distance_max_rev * f64::from(self.turn[i]);
            if f64::from(*off).abs() > far {
                found.refused.get_or_insert((i, FaultCode::IndexFar));
            }
        }
        found
    }
}

/// A checked number as an integer.
#[expect(clippy::cast_possible_truncation, reason = "whole and of checked size, else saturated")]
fn nearest_integer(x: f64) -> i32 {
    x.round() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_hal::CHANNELS;

    fn index(home: [f64; 6]) -> Index {
        let config = IndexConfig { home_counts: Some(home.to_vec()), ..IndexConfig::default() };
        Index::new(&config, &Transmission::reference(), i32::MAX).unwrap()
    }

    #[test]
    fn the_nearest_home_is_found_on_either_side_and_across_turns() {
        let index = index([40.0, 0.0, -30.0, 0.0, 0.0, 799.0]);
        let marks = [Some(Counts(100)); CHANNELS];
        // Home counts of motor 1: 140 + 1000 k; of 6: 899 + 800 k, that is 99 + 800 k.
        let found = index
            .offset_from_home(&[143, 2090, 70 - 3000 - 249, 100, 100 + 8 * 800 - 200, 100], &marks);
        assert_eq!(found, IndexOffset { off: [3, -10, -249, 0, -200, 1], refused: None });
    }

    #[test]
    fn far_and_missing_pulses_are_refused_and_the_first_is_named() {
        let index = index([0.0; 6]);
        let mut marks = [Some(Counts(0)); CHANNELS];
        let found = index.offset_from_home(&[0, 250, 251, 0, -201, 0], &marks);
        assert_eq!(found.refused, Some((2, FaultCode::IndexFar)));
        assert_eq!(found.off, [0, 250, 251, 0, -201, 0]);
        marks[1] = None;
        let found = index.offset_from_home(&[0, 250, 251, 0, 0, 0], &marks);
        assert_eq!((found.refused, found.off[1]), (Some((1, FaultCode::IndexMissing)), 0));
    }

    #[test]
    fn counters_may_wrap_between_pulse_and_home() {
        let index = index([0.0; 6]);
        let marks = [Some(Counts(i32::MAX - 10)); CHANNELS];
        let found = index.offset_from_home(&[i32::MIN + 989; 6], &marks);
        assert_eq!((found.off[0], found.refused), (0, None));
        let found = index.offset_from_home(&[i32::MIN; 6], &[Some(Counts(i32::MAX)); CHANNELS]);
        assert_eq!(found.off, [1; 6]);
    }

    #[test]
    fn unusable_settings_are_refused_with_their_place() {
        for bad in [f64::NAN, f64::INFINITY, 0.5, 2e6, -2e6] {
            let list = Some(vec![0.0, 0.0, bad, 0.0, 0.0, 0.0]);
            let config = IndexConfig { home_counts: list, ..IndexConfig::default() };
            assert_eq!(config.check().unwrap_err().place, "home_counts[2]", "{bad}");
        }
        for bad in [f64::NAN, f64::INFINITY, 0.0, -0.1, 0.5] {
            let config = IndexConfig { distance_max_rev: bad, ..IndexConfig::default() };
            assert_eq!(config.check().unwrap_err().place, "distance_max_rev", "{bad}");
        }
        let short = IndexConfig { home_counts: Some(vec![0.0; 5]), ..IndexConfig::default() };
        let bad = Index::new(&short, &Transmission::reference(), i32::MAX).unwrap_err();
        assert_eq!(bad.place, "home_counts");
    }

    #[test]
    fn counters_too_narrow_for_a_turn_are_refused_and_just_wide_enough_are_not() {
        let narrow = |reach| Index::new(&IndexConfig::default(), &Transmission::reference(), reach);
        // Turns of 1000 and 800 counts: ten bits reach 511 counts, eleven 1023.
        let bad = narrow(511).unwrap_err();
        assert!(bad.what.starts_with("motor 1 has 1000 counts"), "{bad}");
        assert!(bad.remedy.contains("ignore = true"), "{bad}");
        assert!(narrow(999).is_err() && narrow(1000).is_ok() && narrow(1023).is_ok());
    }
}
