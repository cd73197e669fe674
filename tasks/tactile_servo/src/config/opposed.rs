//! `[tactile_servo.opposed]`: the second fingertip, which touches the pin from the other side.

use serde::Deserialize;
use taktil_rtcore::Invalid;

use super::array::Array;
use super::units::absent;

taktil_rtcore::explained! {
    /// `[tactile_servo.opposed]`: the other fingertip, which stands still or is moved by others.
    #[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct OpposedFingertip {
        /// Turn of the other fingertip's frame about z0: at 0, the default, its x axis lies along
        /// x0 (deg).
        pub yaw_deg: f64,
        /// Standard deviation of `yaw_deg`, as far as it is known (deg). Default 0.2.
        pub yaw_std_dev_deg: f64,
        /// Rows, columns and pitches of the other fingertip's array. Default 16 by 16 of 1.5875 mm.
        pub array: Array,
        /// The column where the pin lies on the other fingertip when it lies in the middle of the
        /// finger's columns. Default the middle, 8.5 of 16.
        #[serde(default = "absent")]
        pub x_c: f64,
        /// Thickness of the other fingertip's rubber (mm). Default 3.
        pub pad_thickness_mm: f64,
        /// Young's modulus of the other fingertip's rubber (MPa). Default 0.6.
        pub pad_mpa: f64,
        /// Poisson's ratio of the other fingertip's rubber. Default 0.49.
        pub pad_poisson: f64,
        /// Weight of the pin that lay on the other fingertip while its rest level was taken (N).
        /// Default 0: none did.
        pub pin_weight_n: f64,
    }
}

impl Default for OpposedFingertip {
    fn default() -> OpposedFingertip {
        OpposedFingertip {
            yaw_deg: 0.0,
            yaw_std_dev_deg: 0.2,
            array: Array::default(),
            x_c: 8.5,
            pad_thickness_mm: 3.0,
            pad_mpa: 0.6,
            pad_poisson: 0.49,
            pin_weight_n: 0.0,
        }
    }
}

impl OpposedFingertip {
    /// # Errors
    /// A value outside the range that its message states; NaN is outside every range.
    pub fn check(&self) -> Result<(), Invalid> {
        self.array.check().map_err(|bad| bad.within("array"))?;
        let rows = [
            ("yaw_deg", self.yaw_deg, -180.0, 180.0),
            ("yaw_std_dev_deg", self.yaw_std_dev_deg, 0.0, 180.0),
            ("x_c", self.x_c, 1.0, f64::from(self.array.cols)),
            ("pad_thickness_mm", self.pad_thickness_mm, 0.05, 100.0),
            ("pad_mpa", self.pad_mpa, 0.01, 1e3),
            ("pad_poisson", self.pad_poisson, 0.0, 0.4999),
            ("pin_weight_n", self.pin_weight_n, 0.0, 1e3),
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
