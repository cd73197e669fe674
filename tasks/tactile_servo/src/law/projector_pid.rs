//! Projector and PID (Q. Li, C. Schuermann, R. Haschke, H. Ritter, "A control framework for tactile
//! servoing", Robotics: Science and Systems 2013): `dX = J^-1 P (Kp e + Ki int e + Kd de/dt)`, with
//! a projector `P` of 0 and 1 that selects the features of the task. Refuses to move on an image
//! that cannot be believed; forgets its integral when contact is lost, and gives nothing for a
//! feature that the image does not define.
//!
//! Here for F = (x_c, M0, M_x, theta_z); `J` is diagonal, as theirs is in the contact's frame. The
//! output is a velocity limited component by component, as in their implementation; the integral
//! stands still while its output is at its limit (conditional integration), which theirs lacks.

use serde::Deserialize;
use taktil_rtcore::{Fold, Invalid, StateHash};

use super::SIGNS;
use crate::config::Config;
use crate::perception::Touch;

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
        pub jacobian: [f64; 4],
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

/// What the law remembers: integrals of the errors and the last errors, in motion units (mm s, mrad
/// s; mm, mrad).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Memory {
    integral: [f64; 4],
    last: Option<[f64; 4]>,
}

impl Fold for Memory {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.integral[..]).add(&self.last.is_some());
        if let Some(last) = &self.last {
            hash.add(&last[..]);
        }
    }
}

/// The displacement for one new image towards column `x_c_desired`, `period_s` after the one
/// before, and the memory afterwards.
#[must_use]
pub fn displacement(
    config: &Config,
    memory: &Memory,
    touch: &Touch,
    (x_c_desired, period_s): (f64, f64),
) -> ([f64; 4], Memory) {
    let gains = &config.projector_pid;
    if !touch.trusted {
        return ([0.0; 4], *memory);
    }
    if !touch.contact {
        return ([0.0, config.seek_mm_s * period_s, 0.0, 0.0], Memory::default());
    }
    let rolls = touch.m0 >= config.roll_from_counts;
    let feature = [
        touch.x_c.filter(|_| rolls).map(|x_c| x_c_desired - x_c),
        Some(config.m0_counts - touch.m0),
        Some(config.m_x_counts - touch.m_x),
        touch.theta_z_rad.map(|theta_z| config.theta_z_mrad - 1e3 * theta_z),
    ];
    let limits = [config.roll_mm_s, config.press_mm_s, config.tilt_mrad_s, config.turn_mrad_s];
    let (mut out, mut next) = ([0.0; 4], *memory);
    let mut errors = [0.0; 4];
    for i in 0..4 {
        let Some(error) = feature[i].filter(|_| gains.projector[i] == 1) else { continue };
        let error = error / (SIGNS[i] * gains.jacobian[i]);
        errors[i] = error;
        let rate = memory.last.map_or(0.0, |last| (error - last[i]) / period_s);
        let integral = memory.integral[i] + error * period_s;
        let wanted = gains.kp_per_s[i] * error + gains.ki_per_s2[i] * integral + gains.kd[i] * rate;
        let speed = wanted.clamp(-limits[i], limits[i]);
        // At the limit the integral may come back and not go on.
        if speed == wanted || wanted * error < 0.0 {
            next.integral[i] = integral;
        }
        out[i] = speed * period_s;
    }
    next.last = Some(errors);
    (out, next)
}
