//! Force control at the wrist, for comparison with touch: the wrench says how hard the finger
//! presses and where the centre of pressure lies, and the gains of [`projector_pid`] do the rest.
//! It does not act before the wrench's baseline is known, nor while a gauge is out of its range.
//! The direction of the pin is left uncontrolled, because a wrench does not determine it.
//!
//! A pin that presses with a force F at (x, y, 0) on the face makes the moment (y Fz, -x Fz, ..)
//! about the tool point, so the centre of pressure is (-My/Fz, Mx/Fz) (J. K. Salisbury,
//! "Interpretation of contact geometries from force measurements", ICRA 1984); forces are
//! controlled where the contact constrains and motion where it does not (M. H. Raibert, J. J.
//! Craig, "Hybrid position/force control of manipulators", 1981). Under the name
//! `hybrid-force-touch` the centre of pressure and the direction come from the image and the force
//! from the wrist, as in hybrid control at the centre of pressure (Kleff, Joseph and Padois 2026).
//!
//! [`projector_pid`]: super::projector_pid

use taktil_rtcore::{Fold, StateHash};
use taktil_signal::Wrench;

use super::projector_pid::{PidState, displacement};
use super::{Law, Observation};
use crate::config::Config;
use crate::config::law_name::LawName;
use crate::perception::TouchFeatures;

/// The wrench as tactile features: force in counts, centre of pressure in columns and rows. When
/// the load is too small for contact neither is defined, and outside the face there is no centre.
#[must_use]
pub fn wrench_features(
    config: &Config,
    wrench: Option<&Wrench>,
    touch: &TouchFeatures,
) -> TouchFeatures {
    let Some(wrench) = wrench.filter(|wrench| wrench.is_known()) else {
        return TouchFeatures::default();
    };
    let press_n = -wrench.force_n[2];
    let m0 = press_n * config.model.counts_per_n;
    if !m0.is_finite() {
        return TouchFeatures::default();
    }
    let contact = m0 > config.contact_counts;
    if !contact {
        return TouchFeatures { trusted: true, m0, ..TouchFeatures::default() };
    }
    let array = &config.array;
    let (middle_column, middle_row) = (array.middle_column(), array.middle_row());
    let place = |along_m: f64, middle: f64, pitch_mm: f64| {
        Some(middle + along_m * (1e3 / pitch_mm)).filter(|at| at.is_finite())
    };
    let inside = |at: &f64, middle: f64, count: u32| (at - middle).abs() <= 0.5 * f64::from(count);
    let [moment_x, moment_y, _] = wrench.moment_nm;
    let x_c = place(moment_y / press_n, middle_column, array.pitch_x_mm);
    let y_c = place(-moment_x / press_n, middle_row, array.pitch_y_mm);
    let by_wrist = TouchFeatures {
        trusted: true,
        contact,
        m0,
        m_x: y_c.map_or(0.0, |y_c| (y_c - middle_row) * m0),
        x_c: x_c.filter(|at| inside(at, middle_column, array.cols)),
        y_c: y_c.filter(|at| inside(at, middle_row, array.rows)),
        theta_z_rad: None,
    };
    if config.law != LawName::HybridForceTouch {
        return by_wrist;
    }
    if !touch.contact {
        return TouchFeatures { x_c: None, y_c: None, m_x: 0.0, ..by_wrist };
    }
    TouchFeatures {
        trusted: touch.trusted,
        m_x: touch.y_c.map_or(by_wrist.m_x, |y_c| (y_c - middle_row) * m0),
        x_c: touch.x_c,
        y_c: touch.y_c,
        theta_z_rad: touch.theta_z_rad,
        ..by_wrist
    }
}

/// The law of the module: the features that the wrench gives, and the state of their PID.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HybridForceLaw {
    features: TouchFeatures,
    state: PidState,
}

impl Fold for HybridForceLaw {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.features).add(&self.state);
    }
}

impl Law for HybridForceLaw {
    fn reset(&mut self, _config: &Config) {
        *self = HybridForceLaw::default();
    }

    fn observe(
        &mut self,
        _config: &Config,
        _observation: &Observation<'_>,
        _x_c_desired: f64,
    ) -> Option<[f64; 4]> {
        None
    }

    fn observe_wrench(
        &mut self,
        config: &Config,
        wrench: Option<&Wrench>,
        image: &TouchFeatures,
    ) -> Option<TouchFeatures> {
        self.features = wrench_features(config, wrench, image);
        if self.features.trusted && !self.features.contact {
            // The task does not ask for a command without contact, so the PID would not see the
            // loss.
            self.state = PidState::default();
        }
        Some(self.features)
    }

    fn command(&mut self, config: &Config, x_c_desired: f64, dt_s: f64) -> Option<[f64; 4]> {
        let (step, next) = displacement(config, &self.state, &self.features, x_c_desired, dt_s);
        self.state = next;
        Some(step)
    }

    fn column(&self, _features: &TouchFeatures) -> Option<f64> {
        self.features.x_c
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_rtcore::Payload;
    use taktil_signal::{WRENCH_OVER_RANGE, WRENCH_SATURATED};

    /// The wrench of a pin that presses with `force_n` at (x, y) mm.
    fn pressed(force_n: f64, x_mm: f64, y_mm: f64) -> Wrench {
        let fz = -force_n;
        Wrench {
            force_n: [1.0, 0.0, fz],
            moment_nm: [1e-3 * y_mm * fz, -1e-3 * x_mm * fz, 0.0],
            baseline_ready: 1,
            ..Wrench::ZERO
        }
    }

    #[test]
    fn the_wrench_determines_force_and_place_but_not_direction() {
        let config = Config::default();
        let seen = wrench_features(
            &config,
            Some(&pressed(14.65, 3.175, -1.5875)),
            &TouchFeatures::default(),
        );
        assert!((seen.m0 - 15_000.0).abs() < 5.0 && seen.contact && seen.trusted, "{seen:?}");
        assert!((seen.x_c.unwrap() - 10.5).abs() < 1e-9 && (seen.y_c.unwrap() - 7.5).abs() < 1e-9);
        assert!((seen.m_x + seen.m0).abs() < 1e-6 && seen.theta_z_rad.is_none());
        let beside =
            wrench_features(&config, Some(&pressed(14.65, 30.0, 0.0)), &TouchFeatures::default());
        assert!(beside.x_c.is_none() && beside.contact, "no pin touches beside the face");
    }

    #[test]
    fn with_touch_the_image_determines_place_and_direction() {
        let config = Config { law: LawName::HybridForceTouch, ..Config::default() };
        let image = TouchFeatures {
            trusted: true,
            contact: true,
            m0: 13_000.0,
            x_c: Some(5.0),
            y_c: Some(9.5),
            theta_z_rad: Some(0.1),
            ..TouchFeatures::default()
        };
        let seen = wrench_features(&config, Some(&pressed(14.65, 0.0, 0.0)), &image);
        assert_eq!((seen.x_c, seen.theta_z_rad), (Some(5.0), Some(0.1)));
        assert!((seen.m0 - 15_000.0).abs() < 5.0 && (seen.m_x - seen.m0).abs() < 1e-9);
    }

    #[test]
    fn without_a_baseline_or_with_nan_nothing_is_trusted() {
        let config = Config::default();
        assert_eq!(
            wrench_features(&config, None, &TouchFeatures::default()),
            TouchFeatures::default()
        );
        for unknown in [0, WRENCH_OVER_RANGE, WRENCH_SATURATED] {
            let raw = Wrench { baseline_ready: unknown, ..pressed(10.0, 0.0, 0.0) };
            assert_eq!(
                wrench_features(&config, Some(&raw), &TouchFeatures::default()),
                TouchFeatures::default()
            );
        }
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let odd = Wrench { force_n: [bad; 3], moment_nm: [bad; 3], ..pressed(1.0, 0.0, 0.0) };
            let seen = wrench_features(&config, Some(&odd), &TouchFeatures::default());
            assert_eq!(seen, TouchFeatures::default(), "{bad}");
        }
    }
}
