//! Projector and PID (Q. Li, C. Schuermann, R. Haschke, H. Ritter, "A control framework for tactile
//! servoing", Robotics: Science and Systems 2013): `dX = J^-1 P (Kp e + Ki int e + Kd de/dt)`, with
//! a projector `P` of 0 and 1 that selects the features of the task. It does not move on an invalid
//! image, resets its integral when contact is lost, and gives no output for a feature that the
//! image does not define.
//!
//! Here for F = (x_c, M0, M_x, theta_z); `J` is diagonal, as theirs is in the contact's frame. The
//! output is a velocity limited component by component, as in their implementation; the integral
//! stands still while its output is at its limit (conditional integration), which theirs lacks.

use taktil_rtcore::{Fold, StateHash};

use super::{JACOBIAN_SIGNS, Law, Observation};
use crate::config::Config;
use crate::perception::TouchFeatures;

/// The state of the law: integrals of the errors and the last errors, in motion units (mm s, mrad
/// s; mm, mrad).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PidState {
    integral: [f64; 4],
    last: Option<[f64; 4]>,
}

impl Fold for PidState {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.integral[..]).add(&self.last.is_some());
        if let Some(last) = &self.last {
            hash.add(&last[..]);
        }
    }
}

/// The displacement for one new image towards column `x_c_desired`, `period_s` after the one
/// before, and the state after it.
#[must_use]
pub fn displacement(
    config: &Config,
    state: &PidState,
    touch: &TouchFeatures,
    x_c_desired: f64,
    period_s: f64,
) -> ([f64; 4], PidState) {
    let gains = &config.projector_pid;
    if !touch.trusted {
        return ([0.0; 4], *state);
    }
    if !touch.contact {
        return ([0.0, config.seek_mm_s * period_s, 0.0, 0.0], PidState::default());
    }
    let rolls = touch.m0 >= config.roll_min_counts;
    let feature = [
        touch.x_c.filter(|_| rolls).map(|x_c| x_c_desired - x_c),
        Some(config.m0_counts - touch.m0),
        Some(config.m_x_counts - touch.m_x),
        touch.theta_z_rad.map(|theta_z| config.theta_z_mrad - 1e3 * theta_z),
    ];
    let limits = [config.roll_mm_s, config.press_mm_s, config.tilt_mrad_s, config.turn_mrad_s];
    let (mut out, mut next) = ([0.0; 4], *state);
    let mut errors = [0.0; 4];
    for i in 0..4 {
        let Some(error) = feature[i].filter(|_| gains.projector[i] == 1) else { continue };
        let error = error / (JACOBIAN_SIGNS[i] * gains.jacobian[i]);
        errors[i] = error;
        let rate = state.last.map_or(0.0, |last| (error - last[i]) / period_s);
        let integral = state.integral[i] + error * period_s;
        let wanted = gains.kp_per_s[i] * error + gains.ki_per_s2[i] * integral + gains.kd[i] * rate;
        let speed = wanted.clamp(-limits[i], limits[i]);
        // At the limit the integral may only change towards smaller values.
        if speed == wanted || wanted * error < 0.0 {
            next.integral[i] = integral;
        }
        out[i] = speed * period_s;
    }
    next.last = Some(errors);
    (out, next)
}

/// The law of the module with its state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProjectorPidLaw {
    state: PidState,
}

impl Fold for ProjectorPidLaw {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.state);
    }
}

impl Law for ProjectorPidLaw {
    fn reset(&mut self, _config: &Config) {
        self.state = PidState::default();
    }

    fn observe(
        &mut self,
        config: &Config,
        observation: &Observation<'_>,
        x_c_desired: f64,
    ) -> Option<[f64; 4]> {
        let period_s = config.image_period_ms * 1e-3;
        let features = observation.features;
        let (step, next) = displacement(config, &self.state, features, x_c_desired, period_s);
        self.state = next;
        Some(step)
    }
}
