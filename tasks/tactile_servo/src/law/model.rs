//! The law `model`: the errors of the features, taken through the inverse of the coupled feature
//! Jacobian that the contact's model gives for the image at hand ([`jacobian`]), are watched by an
//! observer for each axis ([`observer`]) that knows the delay, the commands under way and the
//! motion of the table; every job of the servo gets a velocity from it, between images too. It does
//! not act on an invalid image, forgets its state when contact is lost, and stops after a short
//! time without a usable image.
//!
//! ```text
//! image -> e = (J'WJ + P)^-1 J'W (F_d - F_a) -> observer: e, d, b of each axis
//! job   -> v_x = k_x e_x, limited in speed and in change
//!          v_i = k_i e_i + d_i + b_i v_x     (z, theta_x, theta_z), limited
//! ```
//! Sum and moment of the load are computed with weights from the profile that the contact's model
//! gives for a row's load ([`crate::perception::line::LoadProfile`]), which reduces their noise.
//! They are scaled by the mean ratio, over a second, of the plain sums to the weighted ones, so
//! that the error of the profile cancels.
//!
//! The disturbance d is the integral action: a table that turns or rises at an even rate is
//! followed without lag. The slope b makes the answer to a tilted table change sign with the
//! direction of rolling at once.

pub mod jacobian;
pub mod observer;
pub mod opposed;

use taktil_mechanics::Pose;
use taktil_rtcore::{Fold, Invalid, StateHash};
use taktil_signal::TactileImage;

use super::{Fingertip, Law, Observation};
use crate::config::Config;
use crate::config::array::Array;
use crate::config::model::{COMMANDS_REMEMBERED, ModelParameters};
use crate::encoder_hold::{EncoderMotions, UnfeltMotion};
use crate::perception::TouchFeatures;
use crate::perception::line::{Line, LineFinder, LineParameters};
use jacobian::{ContactModel, FeatureMeasurement, displacement};
use observer::{AxisObserver, CommandsInTransit, ProcessNoise};

/// The pin is rolled only while the load's centre lies within this part of the array's length of
/// the middle: 3.5 of 16 rows.
const ROLLING_OFFSET_SHARE_MAX: f64 = 0.21875;
/// Time without a usable image after which the law stops (s), and the number of images that it
/// spans at least.
const IMAGE_TIMEOUT_S: f64 = 0.05;
const IMAGE_TIMEOUT_IMAGES: f64 = 5.0;

/// Time without a usable image after which the law stops (s).
fn image_timeout_s(config: &Config) -> f64 {
    IMAGE_TIMEOUT_S.max(IMAGE_TIMEOUT_IMAGES * 1e-3 * config.image_period_ms)
}

/// The process noise that the observer of axis `i` assumes.
fn process_noise(parameters: &ModelParameters, i: usize) -> ProcessNoise {
    let displacement = [0.5, 0.02, 2.0, 2.0][i];
    let slope = if i == 0 { 0.0 } else { parameters.table_slope[i - 1] };
    let model = [0.05, 0.02, 0.3, 2.0][i];
    let bounds = [parameters.speed[i], [1e-9, 0.5, 20.0, 20.0][i]];
    ProcessNoise { displacement, rate: parameters.table_rate[i], slope, bounds, model }
}

/// Images over which sum and weighted sum are compared: 1 s at 200 Hz.
const COMPARED_IMAGES_MAX: f64 = 200.0;

/// Means of the plain and of the weighted sum of a line (counts), and the number of images: the
/// ratio of the means is the error of the profile.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct SumRatio {
    sum: f64,
    weighted: f64,
    images: f64,
}

impl SumRatio {
    /// The means with one more image.
    fn with(&self, line: &Line) -> SumRatio {
        let images = (self.images + 1.0).min(COMPARED_IMAGES_MAX);
        SumRatio {
            sum: self.sum + (line.features[1] - self.sum) / images,
            weighted: self.weighted + (line.weighted[0] - self.weighted) / images,
            images,
        }
    }

    /// The line with weighted sum and moment, scaled by the mean ratio.
    fn line(&self, line: &Line) -> Line {
        let by = self.sum / self.weighted;
        let mut out = *line;
        if by > 0.5 && by < 2.0 {
            for i in [0, 1] {
                out.features[i + 1] = by * line.weighted[i];
                out.variance[i + 1] = by * by * line.weighted_variance[i];
            }
        }
        out
    }
}

/// The state of the law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelState {
    axes: [AxisObserver; 4],
    scale: SumRatio,
    /// Commands of the latest jobs, newest at `newest`.
    commands: [[f64; 4]; COMMANDS_REMEMBERED],
    newest: usize,
    speed_x_mm_s: f64,
    /// Images seen of this contact.
    images: u32,
    rolls: bool,
    /// Time since the last usable image (s).
    blind_s: f64,
}

impl Fold for ModelState {
    fn fold(&self, hash: &mut StateHash) {
        for axis in &self.axes {
            hash.add(axis);
        }
        hash.add(&self.scale.sum).add(&self.scale.weighted).add(&self.scale.images);
        for command in &self.commands {
            hash.add(&command[..]);
        }
        hash.add(&self.newest).add(&self.speed_x_mm_s).add(&self.images).add(&self.rolls);
        hash.add(&self.blind_s);
    }
}

impl ModelState {
    /// The state without any observation.
    #[must_use]
    pub fn new(model: &ModelParameters) -> ModelState {
        ModelState {
            axes: core::array::from_fn(|i| AxisObserver::new(&process_noise(model, i))),
            scale: SumRatio::default(),
            commands: [[0.0; 4]; COMMANDS_REMEMBERED],
            newest: 0,
            speed_x_mm_s: 0.0,
            images: 0,
            rolls: false,
            blind_s: 0.0,
        }
    }

    /// Speed of the line over the columns (columns/s).
    #[must_use]
    pub fn line_speed_cols_s(&self, array: &Array) -> f64 {
        -0.5 * self.speed_x_mm_s / array.pitch_x_mm
    }

    /// There is an image of this contact.
    #[must_use]
    pub fn has_image(&self) -> bool {
        self.images > 0
    }

    /// The column where the contact will be once the commands so far are carried out.
    #[must_use]
    pub fn column(&self, array: &Array) -> Option<f64> {
        let way_mm = self.axes[0].state[0];
        self.has_image().then(|| array.middle_column() + 0.5 / array.pitch_x_mm * way_mm)
    }

    /// Commands of the last `jobs` jobs.
    fn commands_of_last(&self, jobs: usize) -> [f64; 4] {
        let mut sum = [0.0; 4];
        for back in 0..jobs.min(COMMANDS_REMEMBERED) {
            let command =
                &self.commands[(self.newest + COMMANDS_REMEMBERED - back) % COMMANDS_REMEMBERED];
            for (total, part) in sum.iter_mut().zip(command) {
                *total += part;
            }
        }
        sum
    }
}

/// Takes in an image that is `age_s` old; jobs are `dt_s` apart. A second fingertip adds
/// `opposed`: what it measured at this image, given the finger's line and Jacobian.
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most 32")]
pub fn observe(
    config: &Config,
    contact: &ContactModel,
    state: &ModelState,
    observation: &Observation<'_>,
) -> ModelState {
    let Observation { features: touch, line, opposed, age_s, dt_s } = *observation;
    let model = &config.model;
    if !touch.trusted || age_s > image_timeout_s(config) {
        return *state;
    }
    if !touch.contact {
        return ModelState::new(model);
    }
    // A load that does not lie along a line does not determine the four motions.
    let Some(line) = line else { return *state };
    let middle = config.array.middle_column();
    let wanted = [middle, config.m0_counts, config.m_x_counts, config.theta_z_mrad];
    let scale = state.scale.with(line);
    let line = &scale.line(line);
    let [x_c, m0, m_x, theta_z] = line.features;
    let found = [x_c, m0, m_x, 1e3 * theta_z];
    let error: [f64; 4] = core::array::from_fn(|i| wanted[i] - found[i]);
    let mut variance = line.variance;
    variance[3] *= 1e6;
    let delay_s = age_s + 1e-3 * model.delay_ms;
    let jobs = (delay_s / dt_s.max(1e-6)).round();
    // The image is older than the remembered commands, so the commands in transit at that time are
    // not known.
    if !(0.0..=COMMANDS_REMEMBERED as f64).contains(&jobs) {
        return *state;
    }
    let jobs = jobs as usize;
    let jacobian = contact.jacobian(line);
    let own = FeatureMeasurement { jacobian, error, variance };
    let other = opposed
        .map(|seen| opposed::measurement(seen.fingertip, config, seen.line, &jacobian, seen.tool));
    let (left, left_variance) = displacement(core::iter::once(&own).chain(&other));
    let sums = state.commands_of_last(jobs);
    let mut next = ModelState { scale, ..*state };
    for (i, axis) in next.axes.iter_mut().enumerate() {
        let roll_mm = if i == 0 { 0.0 } else { sums[0] };
        let in_transit = CommandsInTransit { step: sums[i], roll_mm, delay_s };
        axis.observe(&process_noise(model, i), left[i], left_variance[i], in_transit);
    }
    next.images = next.images.saturating_add(1);
    let offset_max_rows = ROLLING_OFFSET_SHARE_MAX * f64::from(config.array.rows);
    next.rolls = m0 >= config.roll_min_counts && m_x.abs() < offset_max_rows * m0;
    next.blind_s = 0.0;
    next
}

/// The displacement for a job of `dt_s`, towards column `x_c_desired`; nothing before the first
/// image of a contact.
#[must_use]
pub fn job_displacement(
    config: &Config,
    state: &ModelState,
    x_c_desired: f64,
    dt_s: f64,
) -> [f64; 4] {
    let model = &config.model;
    if !state.has_image() || state.blind_s > image_timeout_s(config) {
        return [0.0; 4];
    }
    let limited = |i: usize, speed: f64| speed.clamp(-model.speed[i], model.speed[i]);
    let array = &config.array;
    let target_mm = (array.middle_column() - x_c_desired) * 2.0 * array.pitch_x_mm;
    let left = state.axes[0].state[0] + target_mm;
    let wanted = if state.rolls {
        limited(0, model.gain_per_s[0] * left + state.axes[0].state[1])
    } else {
        0.0
    };
    let change = model.roll_mm_s2 * dt_s;
    let roll = state.speed_x_mm_s + (wanted - state.speed_x_mm_s).clamp(-change, change);
    let mut out = [roll * dt_s, 0.0, 0.0, 0.0];
    for (i, part) in out.iter_mut().enumerate().skip(1) {
        let [e, d, b] = state.axes[i].state;
        *part = limited(i, model.gain_per_s[i] * e + d + b * roll) * dt_s;
    }
    out
}

/// The state after a job in which `displacement` was carried out.
#[must_use]
pub fn state_after_job(
    model: &ModelParameters,
    state: &ModelState,
    displacement: &[f64; 4],
    dt_s: f64,
) -> ModelState {
    let mut next = *state;
    next.newest = (state.newest + 1) % COMMANDS_REMEMBERED;
    next.commands[next.newest] = *displacement;
    if !state.has_image() {
        return next;
    }
    next.blind_s += dt_s;
    next.speed_x_mm_s = if dt_s > 0.0 { displacement[0] / dt_s } else { 0.0 };
    for (i, axis) in next.axes.iter_mut().enumerate() {
        let roll_mm = if i == 0 { 0.0 } else { displacement[0] };
        axis.advance(&process_noise(model, i), displacement[i], roll_mm, dt_s);
    }
    next
}

/// The law of the module: the model of the contact, and the state of the observers.
#[derive(Clone, Debug)]
pub struct ModelLaw {
    contact: ContactModel,
    array: Array,
    /// What finds the line in an image of the finger, and of the fingertip opposed to it.
    finders: [LineFinder; 2],
    state: ModelState,
}

impl ModelLaw {
    /// Solves the nominal contact; allocates.
    ///
    /// # Errors
    /// A layer or radius that the theory of contact cannot take.
    pub fn new(config: &Config) -> Result<ModelLaw, Invalid> {
        Ok(ModelLaw {
            contact: ContactModel::new(&config.model, &config.array, config.m0_counts)?,
            array: config.array,
            finders: [
                LineFinder::new(&config.array),
                LineFinder::new(&config.opposed.map_or(config.array, |opposed| opposed.array)),
            ],
            state: ModelState::new(&config.model),
        })
    }
}

impl Fold for ModelLaw {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.state);
    }
}

impl Law for ModelLaw {
    fn retune(&mut self, config: &Config) {
        self.contact.set_m0_counts(config.m0_counts);
    }

    fn reset(&mut self, config: &Config) {
        self.state = ModelState::new(&config.model);
    }

    fn observe(
        &mut self,
        config: &Config,
        observation: &Observation<'_>,
        _x_c_desired: f64,
    ) -> Option<[f64; 4]> {
        self.state = observe(config, &self.contact, &self.state, observation);
        None
    }

    fn command(&mut self, config: &Config, x_c_desired: f64, dt_s: f64) -> Option<[f64; 4]> {
        Some(job_displacement(config, &self.state, x_c_desired, dt_s))
    }

    fn record_executed(&mut self, config: &Config, displacement: &[f64; 4], dt_s: f64) {
        self.state = state_after_job(&config.model, &self.state, displacement, dt_s);
    }

    fn line(
        &mut self,
        config: &Config,
        image: &TactileImage,
        features: &TouchFeatures,
        fingertip: Fingertip,
    ) -> Option<Line> {
        let parameters = LineParameters {
            profile: self.contact.profile(),
            noise_counts: match f64::from(image.noise_counts) {
                measured if measured > 0.0 => measured,
                _ => config.model.noise_counts,
            },
            speed_cols_s: self.state.line_speed_cols_s(&self.array),
        };
        let [carried, opposed] = &mut self.finders;
        let (finder, scale) = match fingertip {
            Fingertip::Carried => (carried, self.contact.band_correction()),
            Fingertip::Opposed => (opposed, 1.0),
        };
        finder.line(image, features, &parameters).map(|line| line.scaled(scale))
    }

    fn column(&self, _features: &TouchFeatures) -> Option<f64> {
        self.state.column(&self.array)
    }

    /// Lets the finger give way along the pin.
    fn encoder_motions(&mut self, config: &Config, _tool: &Pose, _span_s: f64) -> EncoderMotions {
        EncoderMotions {
            y: UnfeltMotion::Yielding(config.model.compliance_per_s),
            ..EncoderMotions::default()
        }
    }
}
