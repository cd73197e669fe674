//! A task that the scene describes: which motions of the sensor it may make, which features it
//! servoes by them, how the features depend on the motions, and a motion that is fed in beside
//! (Li, Schuermann, Haschke, Ritter, "A control framework for tactile servoing", Robotics: Science
//! and Systems 2013, with a full Jacobian in the place of their diagonal one; the frame in which
//! some directions are servoed and others fed is Mason's, IEEE Trans. SMC 11, 1981):
//!
//! ```text
//! dX = J^-1 (Kp e + Ki int e) dt + feed dt,   F - F_0 = J (X - X_0)
//! ```
//!
//! Refuses a Jacobian that is not square or not well conditioned, motions that are named twice or
//! servoed and fed at once, and to move on images that cannot be believed. The integral stands
//! still while a motion is at its limit, and is forgotten when contact is lost. A feature that the
//! image does not define asks for nothing. Motions across the face and turns gather speed no faster
//! than the arm can without throwing the finger off: a turn about the pad moves the wrist, a hand's
//! length away, and a step of its speed is felt at the pad as a blow.

#[cfg(test)]
mod tests;

use glam::DMat3;
use nalgebra::Matrix6;
use serde::Deserialize;
use taktil_mechanics::Pose;
use taktil_rtcore::{Fold, Invalid, StateHash};

use crate::config::{Config, M0_MAX};
use crate::perception::Touch;
use crate::unfelt::Drift;

/// Motions of the sensor, and features, at most.
const MOST: usize = 6;
/// Largest condition number of a Jacobian with rows and columns scaled to their largest entry.
const CONDITION_MAX: f64 = 1e3;

taktil_rtcore::explained! {
    /// A motion of the sensor in its own frame (mm, mrad).
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Motion {
        /// Along x, across the rows.
        X,
        /// Along y, along the columns.
        Y,
        /// Along z, out of the face: presses.
        Z,
        /// About x.
        ThetaX,
        /// About y.
        ThetaY,
        /// About z.
        ThetaZ,
    }
}

taktil_rtcore::explained! {
    /// A feature of the image.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Feature {
        /// Sum (counts).
        M0,
        /// Centroid (column number).
        XC,
        /// Centroid (row number).
        YC,
        /// First moment about the middle line (counts x rows).
        MX,
        /// Direction of the long axis (mrad).
        ThetaZ,
    }
}

impl Feature {
    /// What it can be brought to on the array.
    const fn range(self) -> (f64, f64) {
        match self {
            Feature::M0 => (1.0, M0_MAX),
            Feature::XC | Feature::YC => (1.0, 16.0),
            Feature::MX => (-1e7, 1e7),
            // A quarter turn.
            Feature::ThetaZ => (-1570.0, 1570.0),
        }
    }
}

taktil_rtcore::explained! {
    /// `[[tactile_servo.task_frame.feature]]`: one feature that is servoed.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Servoed {
        /// `m0`, `x_c`, `y_c`, `m_x` or `theta_z`.
        pub name: Feature,
        /// Set point: counts, column or row number, counts x rows, mrad. Default `m0_counts` for
        /// `m0`, the middle of the array for centroids, 0 for the others.
        pub desired: Option<f64>,
        /// Change of the feature with each motion of `state`, in their order: per mm or per mrad.
        pub jacobian: Vec<f64>,
        /// Gain on the error, Kp (1/s).
        pub kp_per_s: f64,
        /// Gain on its integral, Ki (1/s^2). Default 0.
        #[serde(default)]
        pub ki_per_s2: f64,
    }
}

taktil_rtcore::explained! {
    /// `[tactile_servo.task_frame]`. Default: a finger that presses with `m0_counts` and does
    /// nothing else.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct TaskFrame {
        /// The state vector: motions by which features are servoed, as many as there are features.
        /// Default `z`.
        pub state: Vec<Motion>,
        /// Motion fed in while the finger presses with `roll_from_counts` at least: along x, y, z
        /// and about them (mm/s, mrad/s). Default none.
        pub feed_per_s: [f64; MOST],
        /// Time from rest to the limit of speed, for every motion but z (s). Default 0.2; 0 lets
        /// speeds step.
        pub slew_s: f64,
        /// The features. Default `m0` alone, by 14000 counts/mm with Kp 8 and Ki 10.
        pub feature: Vec<Servoed>,
    }
}

impl Default for TaskFrame {
    fn default() -> TaskFrame {
        let press = Servoed {
            name: Feature::M0,
            desired: None,
            jacobian: vec![14_000.0],
            kp_per_s: 8.0,
            ki_per_s2: 10.0,
        };
        TaskFrame {
            state: vec![Motion::Z],
            feed_per_s: [0.0; MOST],
            slew_s: 0.2,
            feature: vec![press],
        }
    }
}

fn place(index: usize, key: &str) -> String {
    format!("feature[{index}].{key}")
}

impl TaskFrame {
    /// # Errors
    /// What this module refuses of a description, and numbers that are not finite or out of the
    /// range that the message states.
    pub fn check(&self) -> Result<(), Invalid> {
        for (i, motion) in self.state.iter().enumerate() {
            if self.state[..i].contains(motion) {
                let what = format!("names {motion:?} twice");
                return Err(Invalid::new(format!("state[{i}]"), what, "leave one out"));
            }
            if self.feed_per_s[*motion as usize] != 0.0 {
                let what = format!("feeds {motion:?}, by which features are servoed");
                let remedy = "feed another motion, or take it out of the state";
                return Err(Invalid::new(
                    format!("feed_per_s[{}]", *motion as usize),
                    what,
                    remedy,
                ));
            }
        }
        for (i, feed) in self.feed_per_s.iter().enumerate() {
            if !(-500.0..=500.0).contains(feed) {
                let what = format!("is {feed}");
                return Err(Invalid::new(format!("feed_per_s[{i}]"), what, "give -500 to 500"));
            }
        }
        if !(0.0..=10.0).contains(&self.slew_s) {
            let what = format!("is {}", self.slew_s);
            return Err(Invalid::new("slew_s", what, "give 0 to 10 s"));
        }
        for (i, feature) in self.feature.iter().enumerate() {
            if self.feature[..i].iter().any(|other| other.name == feature.name) {
                let what = format!("is {:?} once more", feature.name);
                return Err(Invalid::new(place(i, "name"), what, "leave one out"));
            }
            feature.check(i, self.state.len())?;
        }
        if self.feature.len() != self.state.len() {
            let what = format!("has {} motions", self.state.len());
            let remedy = format!("name as many as features: {}", self.feature.len());
            return Err(Invalid::new("state", what, remedy));
        }
        self.inverse().map(|_| ())
    }

    /// The inverse of the Jacobian, padded by ones, and its condition number after scaling.
    ///
    /// # Errors
    /// A Jacobian that is singular or nearly so: its features do not tell the motions apart.
    pub fn inverse(&self) -> Result<(Matrix6<f64>, f64), Invalid> {
        let mut matrix = Matrix6::identity();
        for (i, feature) in self.feature.iter().enumerate() {
            for (j, entry) in feature.jacobian.iter().enumerate() {
                matrix[(i, j)] = *entry;
            }
        }
        let largest = |values: nalgebra::Vector6<f64>| values.amax().max(f64::MIN_POSITIVE);
        let columns: [f64; MOST] = core::array::from_fn(|j| largest(matrix.column(j).into_owned()));
        let mut scaled = Matrix6::from_fn(|i, j| matrix[(i, j)] / columns[j]);
        for i in 0..MOST {
            let row = largest(scaled.row(i).transpose());
            scaled.row_mut(i).unscale_mut(row);
        }
        let condition =
            scaled.try_inverse().map_or(f64::INFINITY, |back| scaled.norm() * back.norm());
        match matrix.try_inverse() {
            Some(back) if condition <= CONDITION_MAX => Ok((back, condition)),
            _ => {
                let what = format!(
                    "has a Jacobian of condition number {condition:.3e}: the features do not tell \
                     the motions of the state apart"
                );
                Err(Invalid::new("feature", what, "take other features, or fewer motions"))
            }
        }
    }
}

impl Servoed {
    fn check(&self, index: usize, motions: usize) -> Result<(), Invalid> {
        if self.jacobian.len() != motions {
            let what = format!("has {} numbers", self.jacobian.len());
            let remedy = format!("give one for each motion of the state: {motions}");
            return Err(Invalid::new(place(index, "jacobian"), what, remedy));
        }
        for (j, entry) in self.jacobian.iter().enumerate() {
            if !entry.is_finite() || entry.abs() > 1e9 {
                let what = format!("is {entry}");
                let key = format!("jacobian[{j}]");
                return Err(Invalid::new(place(index, &key), what, "give -1e9 to 1e9"));
            }
        }
        let (low, high) = self.name.range();
        let rows = [
            ("kp_per_s", Some(self.kp_per_s), 0.0, 1e3),
            ("ki_per_s2", Some(self.ki_per_s2), 0.0, 1e4),
            ("desired", self.desired, low, high),
        ];
        for (key, value, low, high) in rows {
            let Some(value) = value else { continue };
            if !(low <= value && value <= high) {
                let remedy = format!("give {low} to {high}");
                return Err(Invalid::new(place(index, key), format!("is {value}"), remedy));
            }
        }
        Ok(())
    }
}

/// The law of a checked description.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    count: usize,
    motions: [usize; MOST],
    features: [Option<(Feature, Option<f64>)>; MOST],
    kp_per_s: [f64; MOST],
    ki_per_s2: [f64; MOST],
    inverse: Matrix6<f64>,
    feed_per_s: [f64; MOST],
    slew_s: f64,
}

/// What the law remembers: integrals of the errors (feature x s).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Memory {
    integral: [f64; MOST],
    /// The last answer's motion along y and about it (mm, mrad).
    pub(crate) others: [f64; 2],
    /// Drift along x.
    drift: Drift,
    /// Speeds of the last answer (mm/s, mrad/s).
    speed: [f64; MOST],
}

impl Memory {
    /// Watches the tool for drift along its x.
    pub(crate) fn across(&mut self, tool: &Pose) -> &Drift {
        // Drift is watched along and about y: x takes its place.
        let r = &tool.rotation;
        let turned = DMat3::from_cols(r.y_axis, r.x_axis, -r.z_axis);
        self.drift.watch(&Pose::new(turned, tool.translation));
        &self.drift
    }
}

impl Fold for Memory {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.integral[..]).add(&self.others[..]).add(&self.drift);
        hash.add(&self.speed[..]);
    }
}

impl Law {
    /// # Errors
    /// What [`TaskFrame::check`] refuses.
    pub fn new(task: &TaskFrame) -> Result<Law, Invalid> {
        task.check()?;
        let mut law = Law {
            count: task.feature.len(),
            motions: [0; MOST],
            features: [None; MOST],
            kp_per_s: [0.0; MOST],
            ki_per_s2: [0.0; MOST],
            inverse: task.inverse()?.0,
            feed_per_s: task.feed_per_s,
            slew_s: task.slew_s,
        };
        for (i, (motion, feature)) in task.state.iter().zip(&task.feature).enumerate() {
            law.motions[i] = *motion as usize;
            law.features[i] = Some((feature.name, feature.desired));
            law.kp_per_s[i] = feature.kp_per_s;
            law.ki_per_s2[i] = feature.ki_per_s2;
        }
        Ok(law)
    }

    /// Whether the task moves the sensor along x, along y and about y; what it does not, encoders
    /// hold.
    #[must_use]
    pub fn moves(&self) -> [bool; 3] {
        let moves = |motion: Motion| {
            let index = motion as usize;
            self.feed_per_s[index] != 0.0 || self.motions[..self.count].contains(&index)
        };
        [moves(Motion::X), moves(Motion::Y), moves(Motion::ThetaY)]
    }
}

/// How far a feature is from its set point; absent where the image does not define it.
fn error(config: &Config, touch: &Touch, feature: Feature, desired: Option<f64>) -> Option<f64> {
    const MIDDLE: f64 = 8.5;
    match feature {
        Feature::M0 => Some(desired.unwrap_or(config.m0_counts) - touch.m0),
        Feature::XC => touch.x_c.map(|x_c| desired.unwrap_or(MIDDLE) - x_c),
        Feature::YC => touch.y_c.map(|y_c| desired.unwrap_or(MIDDLE) - y_c),
        Feature::MX => Some(desired.unwrap_or(config.m_x_counts) - touch.m_x),
        Feature::ThetaZ => {
            touch.theta_z_rad.map(|theta| desired.unwrap_or(config.theta_z_mrad) - 1e3 * theta)
        }
    }
}

/// The displacement (x, y, z, theta_x, theta_y, theta_z) of the sensor for one new image (mm, mrad)
/// and the memory afterwards.
#[must_use]
pub fn displacement(
    config: &Config,
    law: &Law,
    memory: &Memory,
    touch: &Touch,
) -> ([f64; MOST], Memory) {
    let period_s = config.image_period_ms * 1e-3;
    if !touch.trusted {
        let still = Memory { others: [0.0; 2], speed: [0.0; MOST], ..*memory };
        return ([0.0; MOST], still);
    }
    if !touch.contact {
        let fresh = Memory { drift: memory.drift, ..Memory::default() };
        return ([0.0, 0.0, config.seek_mm_s * period_s, 0.0, 0.0, 0.0], fresh);
    }
    let mut integral = memory.integral;
    let mut wanted = nalgebra::Vector6::zeros();
    for i in 0..law.count {
        let found = law.features[i].and_then(|(name, due)| error(config, touch, name, due));
        let Some(error) = found else { continue };
        integral[i] += error * period_s;
        wanted[i] = law.kp_per_s[i] * error + law.ki_per_s2[i] * integral[i];
    }
    let rates = law.inverse * wanted;
    let limits = [
        config.roll_mm_s,
        config.roll_mm_s,
        config.press_mm_s,
        config.tilt_mrad_s,
        config.tilt_mrad_s,
        config.turn_mrad_s,
    ];
    let mut speed = [0.0; MOST];
    if touch.m0 >= config.roll_from_counts {
        speed = core::array::from_fn(|i| law.feed_per_s[i].clamp(-limits[i], limits[i]));
    }
    let mut limited = false;
    for i in 0..law.count {
        let motion = law.motions[i];
        speed[motion] = rates[i].clamp(-limits[motion], limits[motion]);
        limited |= speed[motion] != rates[i];
    }
    for (i, speed) in speed.iter_mut().enumerate() {
        if i != Motion::Z as usize && law.slew_s > 0.0 {
            let most = limits[i] * period_s / law.slew_s;
            *speed = speed.clamp(memory.speed[i] - most, memory.speed[i] + most);
        }
    }
    let step = speed.map(|speed| speed * period_s);
    let integral = if limited { memory.integral } else { integral };
    (step, Memory { integral, others: [step[1], step[4]], speed, ..*memory })
}
