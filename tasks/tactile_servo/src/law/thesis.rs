//! The law of the thesis (P. Sikka, *The Role of Tactile Sensing in Robot Manipulation*, University
//! of Alberta, 1994, section 5.2 and figure 6.4): `dX = J_s^-1 (F_d - F_a)` with a diagonal `J_s`,
//! for F = (x_c, M0, M_x, theta_z) and X = (x, z, theta_x, theta_z) of the sensor frame. It does
//! not move while the image is invalid, nor along a component whose feature the image does not
//! define.
//!
//! The thesis gives `J_s = diag(20, 20000, 200000, 1000)`, found by trial, without units or signs.
//! Taken here, as an assumption: X in (mm, mm, mrad, mrad), theta_z in mrad, x_c in columns, M_x in
//! counts x rows about the middle line. In millimetres its 20000 counts/mm is near the stiffness of
//! the position servo at the finger, and its 1000 makes the turn follow with a time constant of 5
//! s, which is the weak loop that the thesis reports. Signs are [`JACOBIAN_SIGNS`].

use taktil_rtcore::{Fold, StateHash};

use super::{JACOBIAN_SIGNS, Law, Observation};
use crate::config::Config;
use crate::perception::TouchFeatures;

/// The law; it has no state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThesisLaw {
    /// Desired M0, M_x (counts, counts x rows) and theta_z (mrad).
    desired: [f64; 3],
    /// Diagonal of the feature Jacobian with its signs.
    jacobian: [f64; 4],
    /// Largest displacement for one image (mm, mm, mrad, mrad).
    limits: [f64; 4],
    roll_min_counts: f64,
    seek_mm: f64,
}

impl ThesisLaw {
    /// The law of a checked table.
    #[must_use]
    pub fn new(config: &Config) -> ThesisLaw {
        let period_s = config.image_period_ms * 1e-3;
        let mut jacobian = config.feature_jacobian;
        for (size, sign) in jacobian.iter_mut().zip(JACOBIAN_SIGNS) {
            *size *= sign;
        }
        let speeds = [config.roll_mm_s, config.press_mm_s, config.tilt_mrad_s, config.turn_mrad_s];
        ThesisLaw {
            desired: [config.m0_counts, config.m_x_counts, config.theta_z_mrad],
            jacobian,
            limits: speeds.map(|speed| speed * period_s),
            roll_min_counts: config.roll_min_counts,
            seek_mm: config.seek_mm_s * period_s,
        }
    }

    /// The displacement (dx, dz, dtheta_x, dtheta_z) of the sensor for one new image (mm, mm, mrad,
    /// mrad), towards column `x_c_desired`.
    ///
    /// Each component is limited separately. Without contact only z moves, towards the surface; on
    /// an image that is not trusted nothing moves.
    #[must_use]
    pub fn displacement(&self, touch: &TouchFeatures, x_c_desired: f64) -> [f64; 4] {
        if !touch.trusted {
            return [0.0; 4];
        }
        if !touch.contact {
            return [0.0, self.seek_mm, 0.0, 0.0];
        }
        let [m0, m_x, theta_z_mrad] = self.desired;
        let rolls = touch.m0 >= self.roll_min_counts;
        let error = [
            touch.x_c.filter(|_| rolls).map_or(0.0, |x_c| x_c_desired - x_c),
            m0 - touch.m0,
            m_x - touch.m_x,
            touch.theta_z_rad.map_or(0.0, |theta_z| theta_z_mrad - 1e3 * theta_z),
        ];
        let mut step = [0.0; 4];
        for i in 0..4 {
            step[i] = (error[i] / self.jacobian[i]).clamp(-self.limits[i], self.limits[i]);
        }
        step
    }
}

impl Fold for ThesisLaw {
    fn fold(&self, _hash: &mut StateHash) {}
}

impl Law for ThesisLaw {
    fn retune(&mut self, config: &Config) {
        *self = ThesisLaw::new(config);
    }

    fn reset(&mut self, _config: &Config) {}

    fn observe(
        &mut self,
        _config: &Config,
        observation: &Observation<'_>,
        x_c_desired: f64,
    ) -> Option<[f64; 4]> {
        Some(self.displacement(observation.features, x_c_desired))
    }
}
