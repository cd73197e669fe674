//! `[tactile_servo.task_frame]`: a task that the scene describes. A Jacobian that is not square or
//! not well conditioned is refused, and so are motions that are named twice, or servoed and fed at
//! once.

use nalgebra::Matrix6;
use serde::Deserialize;
use taktil_rtcore::Invalid;

use super::array::Array;
use crate::perception::M0_MAX_COUNTS;

/// Largest number of motions of the sensor, and of features.
pub const MOTIONS_MAX: usize = 6;
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
    /// Range of set points that the array can reach.
    fn range(self, array: &Array) -> (f64, f64) {
        match self {
            Feature::M0 => (1.0, M0_MAX_COUNTS),
            Feature::XC => (1.0, f64::from(array.cols)),
            Feature::YC => (1.0, f64::from(array.rows)),
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
    pub struct ServoedFeature {
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
        /// Motion fed in while the finger presses with `roll_min_counts` at least: along x, y, z
        /// and about them (mm/s, mrad/s). Default none.
        pub feed_per_s: [f64; MOTIONS_MAX],
        /// Time from rest to the limit of speed, for every motion but z (s). Default 0.2; 0 lets
        /// speeds step.
        pub slew_s: f64,
        /// The features. Default `m0` alone, by 14000 counts/mm with Kp 8 and Ki 10.
        pub feature: Vec<ServoedFeature>,
    }
}

impl Default for TaskFrame {
    fn default() -> TaskFrame {
        let press = ServoedFeature {
            name: Feature::M0,
            desired: None,
            jacobian: vec![14_000.0],
            kp_per_s: 8.0,
            ki_per_s2: 10.0,
        };
        TaskFrame {
            state: vec![Motion::Z],
            feed_per_s: [0.0; MOTIONS_MAX],
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
    /// A description for this array with the faults that this module names, and numbers that are
    /// not finite or out of the range that the message states.
    pub fn check(&self, array: &Array) -> Result<(), Invalid> {
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
            feature.check(i, self.state.len(), array)?;
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
        let columns: [f64; MOTIONS_MAX] =
            core::array::from_fn(|j| largest(matrix.column(j).into_owned()));
        let mut scaled = Matrix6::from_fn(|i, j| matrix[(i, j)] / columns[j]);
        for i in 0..MOTIONS_MAX {
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

impl ServoedFeature {
    fn check(&self, index: usize, motions: usize, array: &Array) -> Result<(), Invalid> {
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
        let (low, high) = self.name.range(array);
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
