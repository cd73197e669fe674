//! `[tactile_servo.slip]`: whether what is touched slides over the pad. A share or a radius that no
//! contact has is refused, and a rate of false alarms that no noise can keep.

use serde::Deserialize;
use taktil_rtcore::Invalid;

taktil_rtcore::explained! {
    /// `[tactile_servo.slip]`: detection of slip from the images and the joints, on the port
    /// `slip`. The keys say how a contact that does not slide moves over the pad.
    #[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct SlipConfig {
        /// Part of the finger's own motion along x and y by which a contact that does not slide
        /// goes back over the pad: 0.5 for what is rolled on a table that stands still, 0 for what
        /// stands still or is carried. Default 0.5 along x, 0 along y.
        pub rolling_share: [f64; 2],
        /// Radius of what is touched about which the contact moves when the finger turns about y
        /// and about x (mm). Default 0: a point.
        pub radius_mm: [f64; 2],
        /// Most false alarms in an hour that the noise of the images may give. Default 1.
        pub false_alarms_per_h: f64,
        /// Speed that counts as creep and not as slip (mm/s). Default 0.4.
        pub tolerance_mm_s: f64,
        /// The test begins so long after the first touch (s): the finger straightens itself on what
        /// it has touched. Default 0.5.
        pub settling_s: f64,
    }
}

impl Default for SlipConfig {
    fn default() -> SlipConfig {
        SlipConfig {
            rolling_share: [0.5, 0.0],
            radius_mm: [0.0; 2],
            false_alarms_per_h: 1.0,
            tolerance_mm_s: 0.4,
            settling_s: 0.5,
        }
    }
}

impl SlipConfig {
    /// # Errors
    /// A number outside the range that its message states; NaN is outside every range.
    pub fn check(&self) -> Result<(), Invalid> {
        let rows = [
            ("rolling_share[0]", self.rolling_share[0], 0.0, 1.0),
            ("rolling_share[1]", self.rolling_share[1], 0.0, 1.0),
            ("radius_mm[0]", self.radius_mm[0], 0.0, 1_000.0),
            ("radius_mm[1]", self.radius_mm[1], 0.0, 1_000.0),
            ("false_alarms_per_h", self.false_alarms_per_h, 1e-9, 3_600.0),
            ("tolerance_mm_s", self.tolerance_mm_s, 0.0, 100.0),
            ("settling_s", self.settling_s, 0.0, 60.0),
        ];
        for (place, value, low, high) in rows {
            if !(low <= value && value <= high) {
                let remedy = format!("give {low} to {high}");
                return Err(Invalid::new(place, format!("is {value}"), remedy));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_numbers_are_refused_with_their_place() {
        assert_eq!(SlipConfig::default().check(), Ok(()));
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            let place = |change: fn(&mut SlipConfig, f64)| {
                let mut config = SlipConfig::default();
                change(&mut config, bad);
                config.check().unwrap_err().place
            };
            assert_eq!(place(|c, bad| c.rolling_share[1] = bad), "rolling_share[1]");
            assert_eq!(place(|c, bad| c.radius_mm[0] = bad), "radius_mm[0]");
            assert_eq!(place(|c, bad| c.false_alarms_per_h = bad), "false_alarms_per_h");
            assert_eq!(place(|c, bad| c.tolerance_mm_s = bad), "tolerance_mm_s");
        }
        let none = SlipConfig { false_alarms_per_h: 0.0, ..SlipConfig::default() };
        assert_eq!(none.check().unwrap_err().place, "false_alarms_per_h");
    }
}
