//! The law of a task that the scene describes: the motions of the sensor that it may use, the
//! features that it servoes by them, the Jacobian of the features, and a motion that is fed forward
//! (Li, Schuermann, Haschke, Ritter, "A control framework for tactile servoing", Robotics: Science
//! and Systems 2013, with a full Jacobian in the place of their diagonal one; the frame in which
//! some directions are servoed and others fed is Mason's, IEEE Trans. SMC 11, 1981):
//!
//! ```text
//! dX = J^-1 (Kp e + Ki int e) dt + feed dt,   F - F_0 = J (X - X_0)
//! ```
//!
//! A Jacobian that is not square or not well conditioned, and motions that are named twice or both
//! servoed and fed, are errors. The law does not move on images that are not trusted. The integral
//! stops while a motion is at its limit, and is reset when contact is lost. A feature that the
//! image does not define causes no motion. The acceleration of all motions but z is bounded: a
//! rotation about the pad moves the wrist, which is far from it, so that a step of its speed would
//! act on the contact like an impact.

#[cfg(test)]
mod tests;

use glam::DMat3;
use nalgebra::Matrix6;
use taktil_mechanics::Pose;
use taktil_rtcore::{Fold, Invalid, StateHash};

use super::{Law, Observation};
use crate::config::Config;
use crate::config::array::Array;
use crate::config::task_frame::{Feature, MOTIONS_MAX, Motion, TaskFrame};
use crate::encoder_hold::{Drift, EncoderMotions, UnfeltMotion};
use crate::perception::TouchFeatures;

/// The law of a checked description.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskFrameGains {
    count: usize,
    motions: [usize; MOTIONS_MAX],
    features: [Option<(Feature, Option<f64>)>; MOTIONS_MAX],
    kp_per_s: [f64; MOTIONS_MAX],
    ki_per_s2: [f64; MOTIONS_MAX],
    inverse: Matrix6<f64>,
    feed_per_s: [f64; MOTIONS_MAX],
    slew_s: f64,
}

/// The state of the law: integrals of the errors (feature x s).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TaskFrameState {
    integral: [f64; MOTIONS_MAX],
    /// The last answer's motion along y and about it (mm, mrad).
    pub(crate) commanded_y: [f64; 2],
    /// Drift along x.
    drift: Drift,
    /// Speeds of the last answer (mm/s, mrad/s).
    speed: [f64; MOTIONS_MAX],
}

impl TaskFrameState {
    /// Begins with other features: integrals go on only where they are `same`.
    pub(crate) fn begin_phase(&mut self, same: bool) {
        if !same {
            self.integral = [0.0; MOTIONS_MAX];
        }
        self.commanded_y = [0.0; 2];
    }

    /// Rests without features; only the drift goes on.
    pub(crate) fn begin_rest(&mut self) {
        *self = TaskFrameState { drift: self.drift, ..TaskFrameState::default() };
    }

    /// Measures the drift of the tool along its x.
    pub(crate) fn drift_along_x(&mut self, tool: &Pose) -> &Drift {
        // [`Drift`] measures along and about y, so the axes are permuted such that x takes the
        // place of y.
        let r = &tool.rotation;
        let turned = DMat3::from_cols(r.y_axis, r.x_axis, -r.z_axis);
        self.drift.update(&Pose::new(turned, tool.translation));
        &self.drift
    }
}

impl Fold for TaskFrameState {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.integral[..]).add(&self.commanded_y[..]).add(&self.drift);
        hash.add(&self.speed[..]);
    }
}

impl TaskFrameGains {
    /// # Errors
    /// What [`TaskFrame::check`] refuses.
    pub fn new(task: &TaskFrame, array: &Array) -> Result<TaskFrameGains, Invalid> {
        task.check(array)?;
        let mut gains = TaskFrameGains {
            count: task.feature.len(),
            motions: [0; MOTIONS_MAX],
            features: [None; MOTIONS_MAX],
            kp_per_s: [0.0; MOTIONS_MAX],
            ki_per_s2: [0.0; MOTIONS_MAX],
            inverse: task.inverse()?.0,
            feed_per_s: task.feed_per_s,
            slew_s: task.slew_s,
        };
        for (i, (motion, feature)) in task.state.iter().zip(&task.feature).enumerate() {
            gains.motions[i] = *motion as usize;
            gains.features[i] = Some((feature.name, feature.desired));
            gains.kp_per_s[i] = feature.kp_per_s;
            gains.ki_per_s2[i] = feature.ki_per_s2;
        }
        Ok(gains)
    }

    /// The features in their order.
    #[must_use]
    pub fn feature_names(&self) -> [Option<Feature>; MOTIONS_MAX] {
        self.features.map(|feature| feature.map(|(name, _)| name))
    }

    /// Whether the task moves the sensor along x, along y and about y; what it does not, encoders
    /// hold.
    #[must_use]
    pub fn is_moved(&self) -> [bool; 3] {
        let moves = |motion: Motion| {
            let index = motion as usize;
            self.feed_per_s[index] != 0.0 || self.motions[..self.count].contains(&index)
        };
        [moves(Motion::X), moves(Motion::Y), moves(Motion::ThetaY)]
    }
}

/// How far a feature is from its set point; absent where the image does not define it.
fn feature_error(
    config: &Config,
    touch: &TouchFeatures,
    feature: Feature,
    desired: Option<f64>,
) -> Option<f64> {
    match feature {
        Feature::M0 => Some(desired.unwrap_or(config.m0_counts) - touch.m0),
        Feature::XC => touch.x_c.map(|x_c| desired.unwrap_or(config.array.middle_column()) - x_c),
        Feature::YC => touch.y_c.map(|y_c| desired.unwrap_or(config.array.middle_row()) - y_c),
        Feature::MX => Some(desired.unwrap_or(config.m_x_counts) - touch.m_x),
        Feature::ThetaZ => {
            touch.theta_z_rad.map(|theta| desired.unwrap_or(config.theta_z_mrad) - 1e3 * theta)
        }
    }
}

/// The displacement (x, y, z, theta_x, theta_y, theta_z) of the sensor for one new image (mm, mrad)
/// and the state afterwards.
#[must_use]
pub fn displacement(
    config: &Config,
    gains: &TaskFrameGains,
    state: &TaskFrameState,
    touch: &TouchFeatures,
) -> ([f64; MOTIONS_MAX], TaskFrameState) {
    let period_s = config.image_period_ms * 1e-3;
    if !touch.trusted {
        let still = TaskFrameState { commanded_y: [0.0; 2], speed: [0.0; MOTIONS_MAX], ..*state };
        return ([0.0; MOTIONS_MAX], still);
    }
    if !touch.contact {
        let fresh = TaskFrameState { drift: state.drift, ..TaskFrameState::default() };
        return ([0.0, 0.0, config.seek_mm_s * period_s, 0.0, 0.0, 0.0], fresh);
    }
    let mut integral = state.integral;
    let mut wanted = nalgebra::Vector6::zeros();
    for i in 0..gains.count {
        let found =
            gains.features[i].and_then(|(name, due)| feature_error(config, touch, name, due));
        let Some(error) = found else { continue };
        integral[i] += error * period_s;
        wanted[i] = gains.kp_per_s[i] * error + gains.ki_per_s2[i] * integral[i];
    }
    let rates = gains.inverse * wanted;
    let limits = [
        config.roll_mm_s,
        config.roll_mm_s,
        config.press_mm_s,
        config.tilt_mrad_s,
        config.tilt_mrad_s,
        config.turn_mrad_s,
    ];
    let mut speed = [0.0; MOTIONS_MAX];
    if touch.m0 >= config.roll_min_counts {
        speed = core::array::from_fn(|i| gains.feed_per_s[i].clamp(-limits[i], limits[i]));
    }
    let mut limited = false;
    for i in 0..gains.count {
        let motion = gains.motions[i];
        speed[motion] = rates[i].clamp(-limits[motion], limits[motion]);
        limited |= speed[motion] != rates[i];
    }
    for (i, speed) in speed.iter_mut().enumerate() {
        if i != Motion::Z as usize && gains.slew_s > 0.0 {
            let most = limits[i] * period_s / gains.slew_s;
            *speed = speed.clamp(state.speed[i] - most, state.speed[i] + most);
        }
    }
    let step = speed.map(|speed| speed * period_s);
    let integral = if limited { state.integral } else { integral };
    (step, TaskFrameState { integral, commanded_y: [step[1], step[4]], speed, ..*state })
}

/// The law of the module: the task that it carries out, and its state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskFrameLaw {
    gains: TaskFrameGains,
    state: TaskFrameState,
}

impl TaskFrameLaw {
    /// The law at rest.
    ///
    /// # Errors
    /// What [`TaskFrame::check`] refuses.
    pub fn new(config: &Config) -> Result<TaskFrameLaw, Invalid> {
        let gains = TaskFrameGains::new(&config.task_frame, &config.array);
        let gains = gains.map_err(|bad| bad.within("task_frame"))?;
        Ok(TaskFrameLaw { gains, state: TaskFrameState::default() })
    }
}

impl Fold for TaskFrameLaw {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.state);
    }
}

impl Law for TaskFrameLaw {
    fn reset(&mut self, _config: &Config) {
        self.state = TaskFrameState::default();
    }

    fn observe(
        &mut self,
        config: &Config,
        observation: &Observation<'_>,
        _x_c_desired: f64,
    ) -> Option<[f64; 4]> {
        let ([x, _, z, theta_x, _, theta_z], next) =
            displacement(config, &self.gains, &self.state, observation.features);
        self.state = next;
        Some([x, z, theta_x, theta_z])
    }

    /// Leaves to the encoders what the task does not move.
    fn encoder_motions(&mut self, config: &Config, tool: &Pose, span_s: f64) -> EncoderMotions {
        let drift = self.state.drift_along_x(tool);
        let hold_x_m = drift.correction(config.drift_correction_per_s, span_s).0;
        let [x, y, theta_y] = self.gains.is_moved();
        let commanded = self.state.commanded_y.map(|part| 1e-3 * part);
        let motion = |moved: bool, commanded: f64| {
            if moved { UnfeltMotion::Commanded(commanded) } else { UnfeltMotion::Held }
        };
        EncoderMotions {
            x_m: (!x).then_some(hold_x_m),
            y: motion(y, commanded[0]),
            theta_y: motion(theta_y, commanded[1]),
        }
    }
}
