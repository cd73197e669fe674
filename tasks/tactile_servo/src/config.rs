//! `[tactile_servo]`: set points, feature Jacobian, limits, and a table for each law below it. A
//! Jacobian or limit that is not positive and finite is refused, and so are set points outside the
//! array.

pub mod array;
pub mod contact_loss;
pub mod law_name;
pub mod model;
pub mod opposed;
pub mod phases;
pub mod projector_pid;
pub mod slip;
pub mod task_frame;
mod units;

use serde::Deserialize;
use taktil_rtcore::Invalid;

use crate::perception::{M0_MAX_COUNTS, noise_sum};
use array::Array;
use contact_loss::ContactLoss;
use law_name::LawName;
use model::ModelParameters;
use opposed::OpposedFingertip;
use phases::TouchTask;
use projector_pid::Gains;
use slip::SlipConfig;
use task_frame::{Feature, TaskFrame};
use units::{absent, absent_diagonal};

taktil_rtcore::explained! {
    /// Every key has a default: the rolling task of the thesis.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// The law that moves the finger: `thesis` (default), `projector-pid`, `model`,
        /// `hybrid-force`, `hybrid-force-touch`, `task-frame` or `phases`.
        pub law: LawName,
        /// Rows, columns and pitches of the array whose images the servo goes by.
        pub array: Array,
        /// The parameters of `projector-pid` and of the laws of the wrist.
        pub projector_pid: Gains,
        /// The parameters of `model`.
        pub model: ModelParameters,
        /// A second fingertip on the other side of the pin, whose image `opposed` the law `model`
        /// goes by as well. Default: none.
        pub opposed: Option<OpposedFingertip>,
        /// The task that `task-frame` carries out.
        pub task_frame: TaskFrame,
        /// The file with the task that `phases` carries out, by its path from the folder of the
        /// file in which this stands.
        pub task_file: Option<String>,
        /// The task itself, in the place of `task_file`.
        pub phases: Option<TouchTask>,
        /// Detection of slip, on the port `slip`. Default: none.
        pub slip: Option<SlipConfig>,
        /// What is done when contact is lost.
        pub contact_loss: ContactLoss,
        /// Lower turning point of the centroid (column number). Default 2; it is headed for first.
        #[serde(default = "absent")]
        pub x_c_low: f64,
        /// The same in mm from the middle of the array along x, in the place of `x_c_low`.
        pub x_low_mm: Option<f64>,
        /// Upper turning point of the centroid (column number). Default the last column but one:
        /// 15 of 16.
        #[serde(default = "absent")]
        pub x_c_high: f64,
        /// The same in mm from the middle of the array along x, in the place of `x_c_high`.
        pub x_high_mm: Option<f64>,
        /// A turning point of the centroid counts as reached within this (columns). Default 0.5.
        #[serde(default = "absent")]
        pub x_c_tolerance: f64,
        /// The same in mm, in the place of `x_c_tolerance`.
        pub x_tolerance_mm: Option<f64>,
        /// Desired sum of the counts. Default 15000, about 15 N at 4095 counts for 4 N.
        #[serde(default = "absent")]
        pub m0_counts: f64,
        /// Desired load (N), in the place of `m0_counts`: `model.counts_per_n` says how many
        /// counts a newton makes. With it, `contact_counts` and `roll_min_counts` default to a
        /// fifteenth and to two fifths of the load.
        pub m0_n: Option<f64>,
        /// Desired first moment about the middle line (counts x rows). Default 0.
        #[serde(default = "absent")]
        pub m_x_counts: f64,
        /// Desired moment about the middle line along x (N mm), in the place of `m_x_counts`.
        pub m_x_n_mm: Option<f64>,
        /// Desired direction of the pin's axis (mrad). Default 0.
        pub theta_z_mrad: f64,
        /// Sizes of the diagonal of the feature Jacobian, for (x_c, M0, M_x, theta_z) over (dx, dz,
        /// dtheta_x, dtheta_z) in columns/mm, counts/mm, counts x rows/mrad, mrad/mrad. Default the
        /// thesis's (20, 20000, 200000, 1000); the signs are the law's.
        #[serde(default = "absent_diagonal")]
        pub feature_jacobian: [f64; 4],
        /// The same in mm/mm, N/mm, N mm/mrad, mrad/mrad, in the place of `feature_jacobian`; it
        /// does not depend on the array.
        pub feature_jacobian_n_mm: Option<[f64; 4]>,
        /// Tactels below this count as 0 (counts). Default: three standard deviations of the noise
        /// that was measured with the baseline; 0 lets every value in, as the thesis did.
        pub threshold_counts: Option<f64>,
        /// There is contact when the sum of the counts is above this, and above what noise alone
        /// leaves of the sum with this threshold on the tactels. Default 1000.
        #[serde(default = "absent")]
        pub contact_counts: f64,
        /// The same in N, in the place of `contact_counts`.
        pub contact_n: Option<f64>,
        /// A load of more than so many times the set point that lasts for 40 ms takes the drives'
        /// power off (fault `Overload`): something is wrong with the arm. Default 2.5.
        pub overload_ratio: f64,
        /// The pin is rolled only while the sum of the counts is at least this: before, friction
        /// could not carry it. Default 6000; 0 rolls from first contact, as the thesis did.
        #[serde(default = "absent")]
        pub roll_min_counts: f64,
        /// The same in N, in the place of `roll_min_counts`.
        pub roll_min_n: Option<f64>,
        /// Largest speed along the sensor's x (mm/s). Default 11.
        pub roll_mm_s: f64,
        /// Largest speed along the sensor's z in contact (mm/s). Default 4.
        pub press_mm_s: f64,
        /// Largest turn about the sensor's x (mrad/s). Default 100.
        pub tilt_mrad_s: f64,
        /// Largest turn about the sensor's z (mrad/s). Default 100.
        pub turn_mrad_s: f64,
        /// Speed along the sensor's z while nothing is touched (mm/s). Default 6.
        pub seek_mm_s: f64,
        /// Without contact the finger stops after this way (mm). Default 60.
        pub seek_max_mm: f64,
        /// Rate at which drift along and about the sensor's y, which touch cannot see, is taken
        /// back by the encoders (1/s). Default 4; 0 leaves it, as the thesis did.
        pub drift_correction_per_s: f64,
        /// Rate at which an arm of more than six joints goes back to the joints at which the law
        /// took over, as far as the tool stays where it is (1/s). Default 2; 0 leaves them where
        /// the shortest steps lead. Without meaning for six joints.
        pub posture_per_s: f64,
        /// Time between two images (ms). Default 5.
        pub image_period_ms: f64,
        /// Smallest distance from a singularity, 0 to 1, at which the law acts. Default 0.05.
        pub singular_distance_min: f64,
        /// Most that a desired joint may be ahead of the measured one (deg). Default 3.
        pub max_lead_deg: f64,
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            law: LawName::Thesis,
            array: Array::default(),
            projector_pid: Gains::default(),
            model: ModelParameters::default(),
            opposed: None,
            task_frame: TaskFrame::default(),
            task_file: None,
            phases: None,
            slip: None,
            contact_loss: ContactLoss::default(),
            x_c_low: 2.0,
            x_low_mm: None,
            x_c_high: 15.0,
            x_high_mm: None,
            x_c_tolerance: 0.5,
            x_tolerance_mm: None,
            m0_counts: 15_000.0,
            m0_n: None,
            m_x_counts: 0.0,
            m_x_n_mm: None,
            theta_z_mrad: 0.0,
            feature_jacobian: [20.0, 20_000.0, 200_000.0, 1_000.0],
            feature_jacobian_n_mm: None,
            threshold_counts: None,
            contact_counts: 1_000.0,
            contact_n: None,
            overload_ratio: 2.5,
            roll_min_counts: 6_000.0,
            roll_min_n: None,
            roll_mm_s: 11.0,
            press_mm_s: 4.0,
            tilt_mrad_s: 100.0,
            turn_mrad_s: 100.0,
            seek_mm_s: 6.0,
            seek_max_mm: 60.0,
            drift_correction_per_s: 4.0,
            posture_per_s: 2.0,
            image_period_ms: 5.0,
            singular_distance_min: 0.05,
            max_lead_deg: 3.0,
        }
    }
}

/// Standard deviations of the noise below which a tactel counts as 0.
const TACTEL_SIGMAS: f64 = 3.0;
/// Standard deviations of the array's sum, free, by which a contact is above its mean.
const CONTACT_SIGMAS: f64 = 5.0;

impl Config {
    /// The load that the law is to hold (counts).
    pub(crate) fn load_counts(&self) -> f64 {
        let features = &self.task_frame.feature;
        let named = features.iter().find(|feature| feature.name == Feature::M0);
        match self.law {
            LawName::TaskFrame => named.and_then(|m0| m0.desired).unwrap_or(self.m0_counts),
            LawName::Phases => {
                let load = self.phases.as_ref().map(|task| task.load_counts(self.m0_counts));
                load.filter(|load| *load > 0.0).unwrap_or(self.m0_counts)
            }
            _ => self.m0_counts,
        }
    }

    /// The threshold for an image with this noise on a tactel (counts).
    #[must_use]
    pub fn threshold(&self, noise_counts: f32) -> f64 {
        self.threshold_counts.unwrap_or(TACTEL_SIGMAS * f64::from(noise_counts))
    }

    /// The sum above which an image of so many tactels with this noise on each shows contact
    /// (counts). Contact is gained when the sum exceeds `contact_counts` plus the mean and five
    /// standard deviations of the sum that noise alone leaves above the threshold. Once gained
    /// (`touched`) it is kept down to `contact_counts` plus that mean, because at the edge of the
    /// pad, where the sensor sees only a part of the load, the sum stays small for long. The part
    /// for noise is at most half of the load that is to be held.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "a number of tactels is small")]
    pub fn contact_limit_counts(&self, noise_counts: f32, tactels: usize, touched: bool) -> f64 {
        let threshold = self.threshold(noise_counts);
        let (mean, deviation) = noise_sum(tactels as f64, f64::from(noise_counts), threshold);
        let free = if touched { mean } else { mean + CONTACT_SIGMAS * deviation };
        self.contact_counts.max(free.min(0.5 * self.load_counts()))
    }

    /// Whether half of the load that is to be held may press on an array of this size, with this
    /// noise on a tactel (counts), and its image show no contact: a pin's load lies side by side on
    /// as many tactels as the longer side has, and each shows what exceeds the threshold.
    #[must_use]
    pub fn hides_load(&self, noise_counts: f32, rows: u16, cols: u16) -> bool {
        let cut = self.threshold(noise_counts) * f64::from(rows.max(cols));
        let tactels = usize::from(rows) * usize::from(cols);
        cut + self.contact_limit_counts(noise_counts, tactels, false) >= 0.5 * self.load_counts()
    }

    /// # Errors
    /// A value outside the range that its message states; NaN is outside every range.
    pub fn check(&self) -> Result<(), Invalid> {
        self.clone().resolved()?;
        let (counts, last) = (M0_MAX_COUNTS, f64::from(self.array.cols));
        let rows = [
            ("x_c_low", self.x_c_low, 1.0, last),
            ("x_c_high", self.x_c_high, 1.0, last),
            ("m0_counts", self.m0_counts, 1.0, counts),
            ("m_x_counts", self.m_x_counts, -1e7, 1e7),
            ("theta_z_mrad", self.theta_z_mrad, -1570.0, 1570.0),
            ("feature_jacobian[0]", self.feature_jacobian[0], 1e-6, 1e9),
            ("feature_jacobian[1]", self.feature_jacobian[1], 1e-6, 1e9),
            ("feature_jacobian[2]", self.feature_jacobian[2], 1e-6, 1e9),
            ("feature_jacobian[3]", self.feature_jacobian[3], 1e-6, 1e9),
            ("threshold_counts", self.threshold_counts.unwrap_or(0.0), 0.0, 65_535.0),
            ("contact_counts", self.contact_counts, 1.0, self.m0_counts),
            ("overload_ratio", self.overload_ratio, 1.1, 1_000.0),
            ("roll_min_counts", self.roll_min_counts, 0.0, self.m0_counts),
            ("roll_mm_s", self.roll_mm_s, 1e-3, 500.0),
            ("press_mm_s", self.press_mm_s, 1e-3, 100.0),
            ("tilt_mrad_s", self.tilt_mrad_s, 1e-3, 3_000.0),
            ("turn_mrad_s", self.turn_mrad_s, 1e-3, 3_000.0),
            ("seek_mm_s", self.seek_mm_s, 1e-3, 100.0),
            ("seek_max_mm", self.seek_max_mm, 1e-3, 500.0),
            ("drift_correction_per_s", self.drift_correction_per_s, 0.0, 50.0),
            ("posture_per_s", self.posture_per_s, 0.0, 50.0),
            ("image_period_ms", self.image_period_ms, 0.1, 1_000.0),
            ("singular_distance_min", self.singular_distance_min, 1e-3, 0.9),
            ("max_lead_deg", self.max_lead_deg, 1e-3, 45.0),
        ];
        for (place, value, low, high) in rows {
            if !(low <= value && value <= high) {
                let remedy = format!("give {low} to {high}");
                return Err(Invalid::new(place, format!("is {value}"), remedy));
            }
        }
        let stroke = self.x_c_high - self.x_c_low;
        if stroke <= 0.0 {
            let what = format!("is {}, below x_c_low {}", self.x_c_high, self.x_c_low);
            return Err(Invalid::new("x_c_high", what, "give the larger column number here"));
        }
        if !(self.x_c_tolerance > 0.0 && 2.0 * self.x_c_tolerance < stroke) {
            return Err(Invalid::new(
                "x_c_tolerance",
                format!("is {}", self.x_c_tolerance),
                format!("give more than 0 and less than half the stroke of {stroke}"),
            ));
        }
        if let Some(opposed) = &self.opposed {
            opposed.check().map_err(|bad| bad.within("opposed"))?;
        }
        self.contact_loss.check().map_err(|bad| bad.within("contact_loss"))?;
        self.projector_pid.check().map_err(|bad| bad.within("projector_pid"))?;
        self.model.check().map_err(|bad| bad.within("model"))?;
        self.task_frame.check(&self.array).map_err(|bad| bad.within("task_frame"))?;
        if let Some(slip) = &self.slip {
            slip.check().map_err(|bad| bad.within("slip"))?;
        }
        self.check_phases()
    }

    /// Checks that there is a task exactly where the law needs one, and the task.
    fn check_phases(&self) -> Result<(), Invalid> {
        let is_phases = self.law == LawName::Phases;
        let key = if self.task_file.is_some() { "task_file" } else { "phases" };
        match (&self.phases, &self.task_file) {
            (None, None) if is_phases => {
                let remedy = "name a file in task_file, or write [[tactile_servo.phases.phase]]";
                Err(Invalid::new("law", "is `phases`, but there is no task", remedy))
            }
            (None, Some(name)) => {
                let what = format!("`{name}` was not read");
                let remedy = "write the task under [tactile_servo.phases] instead";
                Err(Invalid::new("task_file", what, remedy))
            }
            (Some(_), _) if !is_phases => {
                let what = format!("is for the law `phases`, the law is `{}`", self.law.text());
                Err(Invalid::new(key, what, "say law = \"phases\", or leave it out"))
            }
            (Some(task), _) => task.check(self).map_err(|bad| bad.within("phases")),
            (None, None) => Ok(()),
        }
    }

    /// Whether the servo reads the port `wrench`.
    #[must_use]
    pub fn uses_wrench(&self) -> bool {
        self.law.uses_wrench() || self.phases.as_ref().is_some_and(TouchTask::uses_wrench)
    }

    /// Checks, if the law is `model`, that it remembers as many of its commands as may be in
    /// transit at an image, in a lane whose jobs are `dt_s` apart.
    ///
    /// # Errors
    /// A delay of more jobs than it remembers; the place is `model.delay_ms`.
    pub fn check_period(&self, dt_s: f64) -> Result<(), Invalid> {
        if self.law != LawName::Model {
            return Ok(());
        }
        self.model
            .check_period(dt_s, 1e-3 * self.image_period_ms)
            .map_err(|bad| bad.within("model"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_neither_gains_nor_keeps_a_contact_whatever_the_threshold() {
        let config = |threshold: f64| Config {
            threshold_counts: Some(threshold),
            law: LawName::TaskFrame,
            ..Config::default()
        };
        // By tables of the normal distribution: 2.2 deviations leave 454 +- 241 counts of 256
        // tactels, 3 leave 57 +- 97, none 0 +- 800.
        for (threshold, due) in [(110.0, 1658.0), (0.0, 4000.0), (150.0, 1000.0)] {
            let found = config(threshold).contact_limit_counts(50.0, 256, false);
            assert!((found - due).abs() < 0.004 * due, "{threshold}: {found}");
        }
        for threshold in [110.0, 0.0, 150.0] {
            let kept = config(threshold).contact_limit_counts(50.0, 256, true);
            assert_eq!(kept, 1000.0, "{threshold}");
        }
        // A threshold of one deviation: noise alone is 3097 counts and must not keep a contact.
        assert!((config(50.0).contact_limit_counts(50.0, 256, true) - 3097.0).abs() < 3.0);
        assert_eq!(
            config(0.0).contact_limit_counts(5000.0, 256, false),
            7500.0,
            "half of the load"
        );
        for odd in [0.0, f32::NAN, f32::INFINITY, -50.0] {
            assert_eq!(config(110.0).contact_limit_counts(odd, 256, false), 1000.0, "{odd}");
        }
    }

    #[test]
    fn noise_and_thresholds_hide_a_load_that_lies_along_the_array() {
        let by_noise = Config { law: LawName::TaskFrame, ..Config::default() };
        let hides = |config: &Config, noise| config.hides_load(noise, 16, 16);
        // Three deviations on each of 16 tactels, and the limit of a contact: 3400 of 7500 counts
        // at a noise of 50, 6000 at 100, 8800 at 150.
        let found = [0.0, 50.0, 100.0, 150.0, 250.0].map(|noise| hides(&by_noise, noise));
        assert_eq!(found, [false, false, false, true, true]);
        // A longer line has more tactels to hide on.
        assert!(by_noise.hides_load(100.0, 4, 32) && by_noise.hides_load(100.0, 32, 4));
        // Whatever the noise, a threshold hides what is below it, and a sum what noise makes of it.
        let of = |threshold| Config { threshold_counts: Some(threshold), ..by_noise.clone() };
        assert!(hides(&of(450.0), 0.0) && !hides(&of(350.0), 0.0));
        assert!(hides(&of(0.0), 5000.0) && !hides(&of(0.0), 50.0));
    }

    #[test]
    fn the_default_is_sound_and_bad_numbers_are_refused_with_their_place() {
        assert_eq!(Config::default().check(), Ok(()));
        let place = |change: &dyn Fn(&mut Config)| {
            let mut config = Config::default();
            change(&mut config);
            config.check().unwrap_err().place
        };
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            assert_eq!(place(&|c| c.feature_jacobian[2] = bad), "feature_jacobian[2]");
            assert_eq!(place(&|c| c.x_c_low = bad), "x_c_low");
            assert_eq!(place(&|c| c.threshold_counts = Some(bad)), "threshold_counts");
            assert_eq!(place(&|c| c.roll_mm_s = bad), "roll_mm_s");
            assert_eq!(place(&|c| c.max_lead_deg = bad), "max_lead_deg");
            assert_eq!(place(&|c| c.x_c_tolerance = bad), "x_c_tolerance");
        }
        assert_eq!(place(&|c| c.feature_jacobian[0] = 0.0), "feature_jacobian[0]");
        assert_eq!(place(&|c| c.contact_counts = 15_001.0), "contact_counts");
        assert_eq!(place(&|c| c.x_c_tolerance = 6.5), "x_c_tolerance");
        assert_eq!(place(&|c| (c.x_c_low, c.x_c_high) = (15.0, 2.0)), "x_c_high");
        assert_eq!(place(&|c| (c.x_c_low, c.x_c_high) = (3.0, 3.0)), "x_c_high");
    }
}
