//! `[grasp]`: how a hand closes, how hard it grips, and what it does with the object. Lists of
//! another length than the hand and numbers without a meaning are errors.

use glam::DVec3;
use nalgebra::Vector3;
use serde::Deserialize;
use taktil_mechanics::hand::FINGER_JOINTS;
use taktil_rtcore::Invalid;

use crate::law::{PalmPlan, Plan, Tuning};
use crate::touch::TouchScale;

taktil_rtcore::explained! {
    /// Settings of [`Grasp`](crate::Grasp). Every key has a default.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// Speeds of the three joints of a finger while it closes, deg/s. Default 0, 8, -8: the
        /// fingertip moves inwards, does not turn, and does not bounce off what it meets.
        pub closing_deg_s: Vec<f64>,
        /// Load from which on a finger counts as touched, N. Default 0.3.
        pub touched_n: f64,
        /// Weakest grip, N: the load of a finger with a share of 1. Default 2.
        pub grip_min_n: f64,
        /// Strongest grip, N. Default 8.
        pub grip_max_n: f64,
        /// Load of each finger relative to the grip, for fingers whose loads have to balance.
        /// Default 1 for each: fingers at equal angles.
        pub share: Option<Vec<f64>>,
        /// Coefficient of friction between fingertips and object that the law counts on. Default
        /// 0.6.
        pub friction: f64,
        /// How much stronger the grip is than the friction cone asks for. Default 1.5.
        pub safety: f64,
        /// Speed at which the fingertips squeeze for each newton that lacks, mm/(N s). Default 4.
        pub squeeze_mm_n_s: f64,
        /// Farthest that the fingertips squeeze beyond where they touched, mm. Default 12.
        pub squeeze_max_mm: f64,
        /// Rate at which the object is brought back to its place, 1/s; 0 leaves it where pushes
        /// bring it. Default 4.
        pub correction_per_s: f64,
        /// Time constant with which the grip falls when less is needed, s. Default 1.
        pub grip_fall_s: f64,
        /// Time constant of the filter of the motors' torques, ms. Default 15.
        pub filter_ms: f64,
        /// Counts that one newton makes: the converter's full scale over the force that spans it.
        /// Default 1023.75: 4095 counts for 4 N.
        pub counts_per_n: f64,
        /// Distance of neighbouring columns and rows of the arrays, mm. Default 1.5875 both.
        pub pitch_mm: [f64; 2],
        /// Counts below which a tactel does not count for the place of the load, in standard
        /// deviations of its noise; at least two have to be above it. Default 4.
        pub threshold_sigmas: f64,
        /// How long the object is held before it is moved, s. Default 1.
        pub plan_after_s: f64,
        /// Displacement of the held object, mm, in the palm's frame, which is the base frame where
        /// the palm stands. Default none.
        pub shift_mm: [f64; 3],
        /// Speed of that displacement, mm/s. Default 10.
        pub shift_mm_s: f64,
        /// Turn of the held object by rolling between the fingertips, deg, as a rotation vector in
        /// the palm's frame. Default none.
        pub turn_deg: [f64; 3],
        /// Speed of that turn, deg/s. Default 10.
        pub turn_deg_s: f64,
        /// How long the object is held before the arm lifts the palm, s. Default 1.
        pub lift_after_s: f64,
        /// Displacement of the palm by the arm that carries it, mm, base frame; the fingers keep
        /// their grip. Default none.
        pub lift_mm: [f64; 3],
        /// Largest speed of that displacement, mm/s. Default 50.
        pub lift_mm_s: f64,
        /// Turn of the palm by the arm at the same time, deg, as a rotation vector in the base
        /// frame. Default none.
        pub tilt_deg: [f64; 3],
        /// Largest speed of that turn, deg/s. Default 15.
        pub tilt_deg_s: f64,
        /// How long the palm stays where the arm brought it before it goes back, s. Default none:
        /// it stays.
        pub lift_back_after_s: Option<f64>,
        /// Rate at which the arm's joints are brought to where the palm's path ends, 1/s, against
        /// friction of their gears and the object's weight; 0 leaves them where these stop them.
        /// Default 4.
        pub lift_correction_per_s: f64,
        /// How long the object is held before the fingers open again, s. Default none: they hold.
        pub open_after_s: Option<f64>,
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            closing_deg_s: vec![0.0, 8.0, -8.0],
            touched_n: 0.3,
            grip_min_n: 2.0,
            grip_max_n: 8.0,
            share: None,
            friction: 0.6,
            safety: 1.5,
            squeeze_mm_n_s: 4.0,
            squeeze_max_mm: 12.0,
            correction_per_s: 4.0,
            grip_fall_s: 1.0,
            filter_ms: 15.0,
            counts_per_n: 1023.75,
            pitch_mm: [1.5875; 2],
            threshold_sigmas: 4.0,
            plan_after_s: 1.0,
            shift_mm: [0.0; 3],
            shift_mm_s: 10.0,
            turn_deg: [0.0; 3],
            turn_deg_s: 10.0,
            lift_after_s: 1.0,
            lift_mm: [0.0; 3],
            lift_mm_s: 50.0,
            tilt_deg: [0.0; 3],
            tilt_deg_s: 15.0,
            lift_back_after_s: None,
            lift_correction_per_s: 4.0,
            open_after_s: None,
        }
    }
}

/// Refuses a number outside a range.
fn within(place: &str, value: f64, [low, high]: [f64; 2]) -> Result<(), Invalid> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(Invalid::new(place, format!("is {value}"), format!("give a number from {low} to {high}")))
}

impl Config {
    /// Refuses numbers that are not finite or out of their range, and a strongest grip below the
    /// weakest.
    ///
    /// # Errors
    /// The place, what is wrong there, and the way out.
    pub fn check(&self) -> Result<(), Invalid> {
        let numbers = [
            ("touched_n", self.touched_n, [1e-3, 100.0]),
            ("grip_min_n", self.grip_min_n, [1e-3, 1000.0]),
            ("grip_max_n", self.grip_max_n, [1e-3, 1000.0]),
            ("friction", self.friction, [0.01, 5.0]),
            ("safety", self.safety, [1.0, 10.0]),
            ("squeeze_mm_n_s", self.squeeze_mm_n_s, [0.0, 1000.0]),
            ("squeeze_max_mm", self.squeeze_max_mm, [0.0, 100.0]),
            ("correction_per_s", self.correction_per_s, [0.0, 100.0]),
            ("grip_fall_s", self.grip_fall_s, [1e-3, 100.0]),
            ("filter_ms", self.filter_ms, [0.0, 1000.0]),
            ("counts_per_n", self.counts_per_n, [1e-3, 1e6]),
            ("pitch_mm[0]", self.pitch_mm[0], [0.1, 50.0]),
            ("pitch_mm[1]", self.pitch_mm[1], [0.1, 50.0]),
            ("threshold_sigmas", self.threshold_sigmas, [0.0, 20.0]),
            ("plan_after_s", self.plan_after_s, [0.0, 1e6]),
            ("shift_mm_s", self.shift_mm_s, [1e-3, 1000.0]),
            ("turn_deg_s", self.turn_deg_s, [1e-3, 1000.0]),
            ("lift_after_s", self.lift_after_s, [0.0, 1e6]),
            ("lift_mm_s", self.lift_mm_s, [1e-3, 1000.0]),
            ("tilt_deg_s", self.tilt_deg_s, [1e-3, 1000.0]),
            ("lift_back_after_s", self.lift_back_after_s.unwrap_or(0.0), [0.0, 1e6]),
            ("lift_correction_per_s", self.lift_correction_per_s, [0.0, 20.0]),
            ("open_after_s", self.open_after_s.unwrap_or(0.0), [0.0, 1e6]),
        ];
        for (place, value, range) in numbers {
            within(place, value, range)?;
        }
        let lists: [(&str, &[f64], [f64; 2]); 5] = [
            ("shift_mm", &self.shift_mm, [-100.0, 100.0]),
            ("turn_deg", &self.turn_deg, [-90.0, 90.0]),
            ("lift_mm", &self.lift_mm, [-1000.0, 1000.0]),
            ("tilt_deg", &self.tilt_deg, [-180.0, 180.0]),
            ("closing_deg_s", &self.closing_deg_s, [-500.0, 500.0]),
        ];
        for (place, list, range) in lists {
            for (i, value) in list.iter().enumerate() {
                within(&format!("{place}[{i}]"), *value, range)?;
            }
        }
        if self.closing_deg_s.len() != FINGER_JOINTS {
            let what = format!("has {} numbers", self.closing_deg_s.len());
            let remedy = "give one speed for each of the three joints of a finger";
            return Err(Invalid::new("closing_deg_s", what, remedy));
        }
        for (i, share) in self.share.iter().flatten().enumerate() {
            within(&format!("share[{i}]"), *share, [0.01, 10.0])?;
        }
        if self.grip_max_n < self.grip_min_n {
            let what = format!("is {}, below grip_min_n = {}", self.grip_max_n, self.grip_min_n);
            return Err(Invalid::new("grip_max_n", what, "give at least grip_min_n"));
        }
        Ok(())
    }

    /// The law's numbers for a hand of `F` fingers.
    ///
    /// # Errors
    /// What [`Config::check`] refuses, and shares for another number of fingers.
    pub fn tuning<const F: usize>(&self) -> Result<Tuning<F>, Invalid> {
        self.check()?;
        let share = match &self.share {
            None => [1.0; F],
            Some(list) => <[f64; F]>::try_from(list.as_slice()).map_err(|_| {
                let what = format!("has {} numbers, the hand has {F} fingers", list.len());
                Invalid::new("share", what, "give one number for each finger")
            })?,
        };
        Ok(Tuning {
            closing_rad_s: Vector3::from_fn(|i, _| self.closing_deg_s[i].to_radians()),
            touched_n: self.touched_n,
            grip_min_n: self.grip_min_n,
            grip_max_n: self.grip_max_n,
            share,
            friction: self.friction,
            safety: self.safety,
            squeeze_m_n_s: 1e-3 * self.squeeze_mm_n_s,
            squeeze_max_m: 1e-3 * self.squeeze_max_mm,
            correction_per_s: self.correction_per_s,
            lift_correction_per_s: self.lift_correction_per_s,
            grip_fall_s: self.grip_fall_s,
            filter_s: 1e-3 * self.filter_ms,
            plan: Plan {
                after_s: self.plan_after_s,
                shift_m: DVec3::from_array(self.shift_mm) * 1e-3,
                shift_m_s: 1e-3 * self.shift_mm_s,
                turn_rad: DVec3::from_array(self.turn_deg.map(f64::to_radians)),
                turn_rad_s: self.turn_deg_s.to_radians(),
            },
            palm: PalmPlan {
                after_s: self.lift_after_s,
                shift_m: DVec3::from_array(self.lift_mm) * 1e-3,
                shift_m_s: 1e-3 * self.lift_mm_s,
                turn_rad: DVec3::from_array(self.tilt_deg.map(f64::to_radians)),
                turn_rad_s: self.tilt_deg_s.to_radians(),
                back_after_s: self.lift_back_after_s,
            },
            open_after_s: self.open_after_s,
        })
    }

    /// How the images are read.
    #[must_use]
    pub fn scale(&self) -> TouchScale {
        TouchScale {
            counts_per_n: self.counts_per_n,
            pitch_x_m: 1e-3 * self.pitch_mm[0],
            pitch_y_m: 1e-3 * self.pitch_mm[1],
            threshold_sigmas: self.threshold_sigmas,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_configuration_is_sound() {
        assert_eq!(Config::default().check(), Ok(()));
        assert_eq!(Config::default().tuning::<3>().unwrap().share, [1.0; 3]);
    }

    #[test]
    fn unusable_settings_are_refused_with_their_place() {
        type Set = fn(&mut Config, f64);
        let sets: [(&str, Set); 6] = [
            ("touched_n", |c, x| c.touched_n = x),
            ("friction", |c, x| c.friction = x),
            ("shift_mm[1]", |c, x| c.shift_mm[1] = x),
            ("closing_deg_s[2]", |c, x| c.closing_deg_s[2] = x),
            ("share[0]", |c, x| c.share = Some(vec![x, 1.0, 1.0])),
            ("counts_per_n", |c, x| c.counts_per_n = x),
        ];
        for (place, set) in sets {
            for bad in [f64::NAN, f64::INFINITY, -1e9] {
                let mut config = Config::default();
                set(&mut config, bad);
                assert_eq!(config.check().unwrap_err().place, place, "{bad}");
            }
        }
        let short = Config { closing_deg_s: vec![1.0], ..Config::default() };
        assert_eq!(short.check().unwrap_err().place, "closing_deg_s");
        let weak = Config { grip_max_n: 1.0, ..Config::default() };
        assert_eq!(weak.check().unwrap_err().place, "grip_max_n");
        let pair = Config { share: Some(vec![1.0; 2]), ..Config::default() };
        assert_eq!(pair.tuning::<3>().unwrap_err().place, "share");
    }
}
