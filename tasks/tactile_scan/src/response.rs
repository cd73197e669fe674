//! Inverts the response of a tactel: from its counts to those of an ideal tactel whose counts are
//! proportional to the load. A force-sensing resistor's conductance follows a power of its load
//! above a threshold (Yaniger, "Force sensing resistors: a review of the technology", Electro
//! 1991); with the calibrated curve taken out, sums of counts are forces again. A curve that maps a
//! reading to more than eight times full scale is an error.
//!
//! ```text
//! c >= knee:   L = T + (F - T) (c / F)^(1/p)        F full, T threshold, p exponent
//! |c| < knee:  L = c L(knee) / knee                 odd: noise about rest keeps its mean of zero
//! c <= -knee:  L = -L(-c)
//! ```
//! Near zero the slope of the curve is zero or unbounded, and noise puts the readings on both sides
//! of zero. There the curve is replaced by a chord.

use serde::Deserialize;
use taktil_rtcore::Invalid;

/// Standard deviations of the noise below which the chord stands for the curve.
const KNEE_SIGMAS: f64 = 3.0;
/// Smallest knee (counts).
const KNEE_MIN_COUNTS: f64 = 1.0;
/// Full scale grows by this factor at most; small loads of a steep curve may grow by more.
const FULL_SCALE_GROWTH_MAX: f64 = 8.0;

taktil_rtcore::explained! {
    /// `[tactile_scan.response]`: the array's calibrated curve, the same for each tactel.
    #[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Response {
        /// Exponent of the counts over the load: 0.2 to 2. 1 is an array in proportion.
        pub exponent: f64,
        /// Counts above the rest level at which counts are taken for the load as they are: those of
        /// the load that the scale from newtons to counts is stated for.
        pub full_counts: f64,
        /// Load below which a tactel conducts nothing, in counts of an array in proportion. Default
        /// 0.
        #[serde(default)]
        pub threshold_counts: f64,
    }
}

impl Response {
    /// # Errors
    /// A value outside the range that its message states; NaN is outside every range.
    pub fn check(&self, full_scale: u16) -> Result<(), Invalid> {
        let full = f64::from(full_scale);
        let rows = [
            ("exponent", self.exponent, 0.2, 2.0),
            ("full_counts", self.full_counts, 16.0, 65_535.0),
            ("threshold_counts", self.threshold_counts, 0.0, 0.5 * self.full_counts),
        ];
        for (place, value, low, high) in rows {
            if !(low <= value && value <= high) {
                let remedy = format!("give {low} to {high}");
                return Err(Invalid::new(place, format!("is {value}"), remedy));
            }
        }
        let most = self.load(full);
        if most > FULL_SCALE_GROWTH_MAX * full {
            let what = format!("makes {most:.0} counts of the converter's {full}");
            let remedy = "give the counts at which the scale is stated: near full scale";
            return Err(Invalid::new("full_counts", what, remedy));
        }
        Ok(())
    }

    /// The load of a reading above the knee (counts).
    fn load(&self, counts: f64) -> f64 {
        let span = self.full_counts - self.threshold_counts;
        self.threshold_counts + span * libm::pow(counts / self.full_counts, 1.0 / self.exponent)
    }

    /// The curve for an array with this noise on a tactel (counts).
    #[must_use]
    pub fn curve(&self, noise_counts: f64) -> Curve {
        let knee = (KNEE_SIGMAS * noise_counts).clamp(KNEE_MIN_COUNTS, self.full_counts);
        Curve { response: *self, knee, chord: self.load(knee) / knee }
    }
}

/// A response with its knee.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve {
    response: Response,
    knee: f64,
    /// Slope below the knee.
    chord: f64,
}

impl Curve {
    /// The reading of an array that is proportional to the load (counts above the rest level).
    #[must_use]
    pub fn linearised_counts(&self, counts: f64) -> f64 {
        let size = counts.abs();
        if size < self.knee {
            return counts * self.chord;
        }
        self.response.load(size).copysign(counts)
    }

    /// Noise of a free tactel once its readings are linear (counts).
    #[must_use]
    pub fn noise(&self, noise_counts: f64) -> f64 {
        noise_counts * self.chord
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn response(exponent: f64, full_counts: f64, threshold_counts: f64) -> Response {
        Response { exponent, full_counts, threshold_counts }
    }

    #[test]
    fn what_the_sensor_did_to_a_load_is_undone() {
        for (p, threshold) in [(0.95, 2.0), (0.6, 0.0), (1.4, 40.0), (1.0, 0.0)] {
            let curve = response(p, 4095.0, threshold).curve(1.0);
            for share in [0.02, 0.1, 0.5, 0.9, 1.0] {
                let load = 4095.0 * share;
                let part = (load - threshold) / (4095.0 - threshold);
                let read = 4095.0 * libm::pow(part, p);
                let found = curve.linearised_counts(read);
                assert!((found - load).abs() < 1e-8 * 4095.0, "{p}: {load} was {found}");
            }
        }
    }

    #[test]
    fn it_is_odd_grows_and_does_not_jump() {
        for p in [0.2, 0.5, 0.95, 1.0, 1.7, 2.0] {
            let curve = response(p, 4095.0, 5.0).curve(50.0);
            let mut before = curve.linearised_counts(-4095.0);
            for counts in -4094..=4095 {
                let now = curve.linearised_counts(f64::from(counts));
                assert!(now > before, "{p} at {counts}: {before} to {now}");
                // The steepest place: the chord or full scale.
                assert!(now - before < 6.0 * 5.0, "{p} at {counts}: {before} to {now}");
                assert_eq!(now, -curve.linearised_counts(-f64::from(counts)), "{p} at {counts}");
                before = now;
            }
        }
        let none = response(1.0, 4095.0, 0.0).curve(50.0);
        assert!(
            (none.linearised_counts(150.0) - 150.0).abs() < 1e-9
                && none.linearised_counts(37.0) == 37.0
        );
        assert!((none.noise(50.0) - 50.0).abs() < 1e-9);
    }

    #[test]
    fn noise_about_rest_keeps_its_mean_whatever_the_exponent() {
        for p in [0.4, 0.95, 1.8] {
            let curve = response(p, 4095.0, 0.0).curve(50.0);
            let sum: f64 = (-150..=150).map(|c| curve.linearised_counts(f64::from(c))).sum();
            assert!(sum.abs() < 1e-6, "{p}: {sum}");
        }
    }

    #[test]
    fn numbers_that_no_array_can_mean_are_refused_with_their_place() {
        let place = |r: Response| r.check(4095).map_err(|bad| bad.place);
        assert_eq!(place(response(0.95, 4095.0, 2.0)), Ok(()));
        for bad in [f64::NAN, f64::INFINITY, -1.0, 0.0, 0.19, 2.1, 1e300] {
            assert_eq!(place(response(bad, 4095.0, 0.0)), Err("exponent".into()), "{bad}");
        }
        for bad in [f64::NAN, f64::INFINITY, -4095.0, 0.0, 15.0, 65_536.0] {
            assert_eq!(place(response(0.9, bad, 0.0)), Err("full_counts".into()), "{bad}");
        }
        for bad in [f64::NAN, -1.0, 2048.0, 4095.0] {
            let found = place(response(0.9, 4095.0, bad));
            assert_eq!(found, Err("threshold_counts".into()), "{bad}");
        }
        // With a small full scale, ordinary readings would become extremely large loads.
        assert_eq!(place(response(0.2, 400.0, 0.0)), Err("full_counts".into()));
    }
}
