//! `[tactile_servo.model]`: the parameters of the law `model`.

use serde::Deserialize;
use taktil_rtcore::Invalid;

/// Number of the latest jobs whose commands the law remembers: when an image arrives, no more of
/// them may be in transit.
pub const COMMANDS_REMEMBERED: usize = 32;
const _: () = assert!(COMMANDS_REMEMBERED == 32, "what `ModelParameters::delay_ms` says");

taktil_rtcore::explained! {
    /// `[tactile_servo.model]`
    #[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ModelParameters {
        /// Gains of (x, z, theta_x, theta_z) on the way left (1/s). Default (20, 25, 12, 8).
        pub gain_per_s: [f64; 4],
        /// Largest speeds of (x, z, theta_x, theta_z) (mm/s, mm/s, mrad/s, mrad/s). Default (12,
        /// 15, 300, 500).
        pub speed: [f64; 4],
        /// Largest change of the speed of rolling (mm/s^2). Default 100.
        pub roll_mm_s2: f64,
        /// How fast the finger gives way to what pushes it along the pin, which touch cannot see
        /// (1/s). Default 8; 0 stands still there.
        pub compliance_per_s: f64,
        /// From a command to the motion of the finger (ms), with the age of an image at most 32
        /// jobs. Default 7.5.
        pub delay_ms: f64,
        /// Process noise of the rates of the table along and about (x, z, theta_x, theta_z): how
        /// fast they are believed to change (mm/s/sqrt s, mrad/s/sqrt s). Default (20, 4, 60, 60).
        pub table_rate: [f64; 4],
        /// Process noise of the slopes of the table, the way along and about (z, theta_x, theta_z)
        /// that comes with each millimetre of rolling (mm/mm/sqrt s, mrad/mm/sqrt s). Default
        /// (0.05, 0.5, 0.5).
        pub table_slope: [f64; 3],
        /// Standard deviation of a tactel (counts) where none was measured with the baseline.
        /// Default 50.
        pub noise_counts: f64,
        /// Counts that a newton makes. Default 4095/4.
        pub counts_per_n: f64,
        /// Radius of the pin that the contact is solved for (mm). Default 23.
        pub pin_radius_mm: f64,
        /// Thickness of the pad's rubber (mm). Default 0.8.
        pub pad_thickness_mm: f64,
        /// Young's modulus of the pad's rubber (MPa). Default 2.
        pub pad_mpa: f64,
        /// Poisson's ratio of the pad's rubber. Default 0.49.
        pub pad_poisson: f64,
        /// Stiffness of what lies behind pad and pin, arm and table, along z (N/mm). Default 14.
        pub support_n_mm: f64,
        /// Stiffness of what lies behind pad and pin about x (N m/rad). Default 20.
        pub support_nm_rad: f64,
    }
}

impl Default for ModelParameters {
    fn default() -> ModelParameters {
        ModelParameters {
            gain_per_s: [20.0, 25.0, 12.0, 8.0],
            speed: [12.0, 15.0, 300.0, 500.0],
            roll_mm_s2: 100.0,
            compliance_per_s: 8.0,
            delay_ms: 7.5,
            table_rate: [20.0, 4.0, 60.0, 60.0],
            table_slope: [0.05, 0.5, 0.5],
            noise_counts: 50.0,
            counts_per_n: 4095.0 / 4.0,
            pin_radius_mm: 23.0,
            pad_thickness_mm: 0.8,
            pad_mpa: 2.0,
            pad_poisson: 0.49,
            support_n_mm: 14.0,
            support_nm_rad: 20.0,
        }
    }
}

impl ModelParameters {
    /// # Errors
    /// A value outside the range that its message states; NaN is outside every range.
    pub fn check(&self) -> Result<(), Invalid> {
        let within = |place: String, value: f64, low: f64, high: f64| {
            if low <= value && value <= high {
                return Ok(());
            }
            Err(Invalid::new(place, format!("is {value}"), format!("give {low} to {high}")))
        };
        for i in 0..4 {
            within(format!("gain_per_s[{i}]"), self.gain_per_s[i], 0.0, 200.0)?;
            within(format!("speed[{i}]"), self.speed[i], 1e-3, 3_000.0)?;
            within(format!("table_rate[{i}]"), self.table_rate[i], 0.0, 1e4)?;
        }
        for (i, value) in self.table_slope.iter().enumerate() {
            within(format!("table_slope[{i}]"), *value, 0.0, 1e3)?;
        }
        let rows = [
            ("roll_mm_s2", self.roll_mm_s2, 1.0, 1e5),
            ("compliance_per_s", self.compliance_per_s, 0.0, 100.0),
            ("delay_ms", self.delay_ms, 0.0, 40.0),
            ("noise_counts", self.noise_counts, 0.1, 1e4),
            ("counts_per_n", self.counts_per_n, 1e-3, 1e6),
            ("pin_radius_mm", self.pin_radius_mm, 1.0, 500.0),
            ("pad_thickness_mm", self.pad_thickness_mm, 0.05, 100.0),
            ("pad_mpa", self.pad_mpa, 0.01, 1e3),
            ("pad_poisson", self.pad_poisson, 0.0, 0.4999),
            ("support_n_mm", self.support_n_mm, 1e-3, 1e6),
            ("support_nm_rad", self.support_nm_rad, 1e-3, 1e6),
        ];
        for (place, value, low, high) in rows {
            within(place.to_owned(), value, low, high)?;
        }
        Ok(())
    }

    /// Checks that all commands in transit at an image are remembered, with jobs `dt_s` apart and
    /// an image that is one or, when it is late, two image periods old.
    ///
    /// # Errors
    /// A delay of more jobs than [`COMMANDS_REMEMBERED`]; the place is `delay_ms`.
    pub fn check_period(&self, dt_s: f64, image_s: f64) -> Result<(), Invalid> {
        let most_ms = 1e3 * (COMMANDS_REMEMBERED as f64 * dt_s - 2.0 * image_s);
        if self.delay_ms <= most_ms + 1e-9 {
            return Ok(());
        }
        let (job_ms, image_ms) = (1e3 * dt_s, 1e3 * image_s);
        Err(Invalid::new(
            "delay_ms",
            format!(
                "{} ms and an image that is two of {image_ms} ms old are more than the \
                 {COMMANDS_REMEMBERED} jobs of {job_ms} ms whose commands the law remembers",
                self.delay_ms
            ),
            format!("give at most {} ms, or a lane with a longer period", most_ms.max(0.0)),
        ))
    }
}
