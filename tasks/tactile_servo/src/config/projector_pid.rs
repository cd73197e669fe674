//! `[tactile_servo.projector_pid]`: the gains of the law `projector-pid`.

use serde::Deserialize;
use taktil_rtcore::Invalid;

use super::units::absent_diagonal;

taktil_rtcore::explained! {
    /// `[tactile_servo.projector_pid]`; features in the order (x_c, M0, M_x, theta_z).
    #[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Gains {
        /// 1 for a feature that is servoed, 0 for one that is not, in the order (x_c, M0, M_x,
        /// theta_z). Default all.
        pub projector: [u8; 4],
        /// Sizes of the diagonal of J: change of (x_c, M0, M_x, theta_z) with its motion in
        /// columns/mm, counts/mm, counts x rows/mrad, mrad/mrad. Default those of the rolling
        /// task's contact, (0.315, 14000, 2000, 1).
        #[serde(default = "absent_diagonal")]
        pub jacobian: [f64; 4],
        /// The same in mm/mm, N/mm, N mm/mrad, mrad/mrad, in the place of `jacobian`; it does not
        /// depend on the array. The rolling task's contact has (0.5, 13.7, 3.1, 1).
        pub jacobian_n_mm: Option<[f64; 4]>,
        /// Gains on the errors of (x_c, M0, M_x, theta_z), Kp (1/s). Default (4, 12, 8, 4).
        pub kp_per_s: [f64; 4],
        /// Gains on their integrals, Ki (1/s^2). Default (0, 20, 8, 4).
        pub ki_per_s2: [f64; 4],
        /// Gains on their rates, Kd (1). Default 0: at the thesis's noise they only amplify.
        pub kd: [f64; 4],
    }
}

impl Default for Gains {
    fn default() -> Gains {
        Gains {
            projector: [1; 4],
            jacobian: [0.315, 14_000.0, 2_000.0, 1.0],
            jacobian_n_mm: None,
            kp_per_s: [4.0, 12.0, 8.0, 4.0],
            ki_per_s2: [0.0, 20.0, 8.0, 4.0],
            kd: [0.0; 4],
        }
    }
}

impl Gains {
    /// # Errors
    /// A projector other than 0 and 1; a Jacobian that is not positive; a gain that is negative,
    /// huge or not finite.
    pub fn check(&self) -> Result<(), Invalid> {
        if let Some(i) = self.projector.iter().position(|p| *p > 1) {
            let what = format!("is {}", self.projector[i]);
            return Err(Invalid::new(format!("projector[{i}]"), what, "give 0 or 1"));
        }
        let rows = [
            ("jacobian", &self.jacobian, 1e-6, 1e9),
            ("kp_per_s", &self.kp_per_s, 0.0, 1e3),
            ("ki_per_s2", &self.ki_per_s2, 0.0, 1e4),
            ("kd", &self.kd, 0.0, 10.0),
        ];
        for (place, values, low, high) in rows {
            for (i, value) in values.iter().enumerate() {
                if !(low <= *value && *value <= high) {
                    let remedy = format!("give {low} to {high}");
                    return Err(Invalid::new(
                        format!("{place}[{i}]"),
                        format!("is {value}"),
                        remedy,
                    ));
                }
            }
        }
        Ok(())
    }
}
