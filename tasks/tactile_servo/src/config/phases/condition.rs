//! `until`: the conditions that end a phase. A condition that no image of the array can meet, that
//! the phase's own set point keeps from being met, or that contradicts another one is refused.

use serde::Deserialize;
use taktil_rtcore::Invalid;

use super::super::Config;
use super::super::task_frame::Feature;
use super::{PhaseConfig, PhaseKind};

/// Largest force of the wrist that a condition may name (N).
const FORCE_MAX_N: f64 = 1e3;
/// Largest speed of slip that a condition may name (mm/s).
const SLIP_MAX_MM_S: f64 = 1e3;
/// Longest way and longest time that a condition may name (mm, s).
const WAY_MAX_MM: f64 = 500.0;
const TIME_MAX_S: f64 = 86_400.0;

taktil_rtcore::explained! {
    /// What a condition compares.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Quantity {
        /// Sum of the image (counts).
        M0,
        /// Centroid (column number).
        XC,
        /// Centroid (row number).
        YC,
        /// First moment about the middle line (counts x rows).
        MX,
        /// Direction of the long axis (mrad).
        ThetaZ,
        /// Whether there is contact; needs no number.
        Contact,
        /// Speed of slip (mm/s), 0 while none is detected; without a number: slip is detected.
        Slip,
        /// Force along the finger's z by the wrist (N), positive when it is pressed.
        WristForce,
        /// Way of the finger in this phase (mm).
        Way,
        /// Time in this phase (s).
        Time,
    }
}

taktil_rtcore::explained! {
    /// `until`: a quantity and what it is compared with: `above`, `below`, or `near` and `within`.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Condition {
        /// `m0`, `x_c`, `y_c`, `m_x`, `theta_z`, `contact`, `slip`, `wrist_force`, `way` or `time`.
        pub quantity: Quantity,
        /// It has to be larger than this.
        pub above: Option<f64>,
        /// It has to be smaller than this.
        pub below: Option<f64>,
        /// It has to be within `within` of this.
        pub near: Option<f64>,
        /// How near.
        pub within: Option<f64>,
    }
}

impl Quantity {
    fn feature(self) -> Option<Feature> {
        match self {
            Quantity::M0 => Some(Feature::M0),
            Quantity::XC => Some(Feature::XC),
            Quantity::YC => Some(Feature::YC),
            Quantity::MX => Some(Feature::MX),
            Quantity::ThetaZ => Some(Feature::ThetaZ),
            _ => None,
        }
    }
}

impl Condition {
    /// The open interval in which the quantity has to lie; everything for a condition without a
    /// number, which asks whether there is any.
    #[must_use]
    pub fn interval(&self) -> (f64, f64) {
        match (self.above, self.below, self.near, self.within) {
            (_, _, Some(near), Some(within)) => (near - within, near + within),
            (None, None, _, _) => (0.0, f64::INFINITY),
            (above, below, _, _) => {
                (above.unwrap_or(f64::NEG_INFINITY), below.unwrap_or(f64::INFINITY))
            }
        }
    }

    fn check_form(&self) -> Result<(), Invalid> {
        let rows = [
            ("above", self.above),
            ("below", self.below),
            ("near", self.near),
            ("within", self.within),
        ];
        for (key, value) in rows {
            if value.is_some_and(|value| !value.is_finite()) {
                let what = format!("is {}", value.unwrap_or(f64::NAN));
                return Err(Invalid::new(key, what, "give a finite number"));
            }
        }
        let whole = matches!(self.quantity, Quantity::Contact | Quantity::Slip);
        match (self.above, self.below, self.near, self.within) {
            (None, None, None, None) if whole => Ok(()),
            (_, _, None, None) if self.quantity == Quantity::Contact => {
                let remedy = "leave the number out";
                Err(Invalid::new("quantity", "`contact` is compared with nothing", remedy))
            }
            (None, None, None, None) => {
                let what = "is compared with nothing";
                Err(Invalid::new("quantity", what, "give above, below, or near and within"))
            }
            (None, None, Some(_), Some(within)) if within > 0.0 => Ok(()),
            (None, None, Some(_), Some(within)) => {
                Err(Invalid::new("within", format!("is {within}"), "give more than 0"))
            }
            (Some(above), Some(below), None, None) if above >= below => {
                let what = format!("is {above}, not below {below}");
                Err(Invalid::new("above", what, "no number is above the one and below the other"))
            }
            (_, _, None, None) => Ok(()),
            _ => {
                let what = "has neither one of above and below nor near with within";
                Err(Invalid::new("", what, "give above, below, or near and within"))
            }
        }
    }
}

/// The values that a quantity can have, and why.
fn range(quantity: Quantity, phase: &PhaseConfig, servo: &Config) -> (f64, f64, &'static str) {
    let array = &servo.array;
    let overload = servo.overload_ratio * servo.load_counts();
    match quantity {
        Quantity::M0 => (0.0, overload, "a larger load for 40 ms stops the machine (Overload)"),
        Quantity::XC => (1.0, f64::from(array.cols), "the array has no other columns"),
        Quantity::YC => (1.0, f64::from(array.rows), "the array has no other rows"),
        Quantity::MX => (-1e7, 1e7, "no image has such a moment"),
        Quantity::ThetaZ => (-1570.0, 1571.0, "a direction is within a quarter turn"),
        Quantity::Contact => (0.0, 1.0, "there is contact or not"),
        Quantity::Slip => (0.0, SLIP_MAX_MM_S, "nothing slides that fast"),
        Quantity::WristForce => (-FORCE_MAX_N, FORCE_MAX_N, "no finger bears such a force"),
        Quantity::Way => {
            (0.0, phase.within_mm.unwrap_or(WAY_MAX_MM), "the phase fails after within_mm")
        }
        Quantity::Time => (0.0, phase.within_s.unwrap_or(TIME_MAX_S), "it fails after within_s"),
    }
}

/// The set point that the phase holds the feature at.
fn set_point(feature: Feature, phase: &PhaseConfig, servo: &Config) -> Option<f64> {
    let servoed = phase.feature.iter().find(|servoed| servoed.name == feature)?;
    Some(servoed.desired.unwrap_or(match feature {
        Feature::M0 => servo.m0_counts,
        Feature::XC => servo.array.middle_column(),
        Feature::YC => servo.array.middle_row(),
        Feature::MX => servo.m_x_counts,
        Feature::ThetaZ => servo.theta_z_mrad,
    }))
}

fn check_one(condition: &Condition, phase: &PhaseConfig, servo: &Config) -> Result<(), Invalid> {
    condition.check_form()?;
    let quantity = condition.quantity;
    let never = |why: String, remedy: &str| {
        Err(Invalid::new("", format!("is never met: {why}"), remedy.to_owned()))
    };
    if quantity == Quantity::Slip && servo.slip.is_none() {
        return never("slip is not observed".to_owned(), "add [tactile_servo.slip]");
    }
    let flat = servo.array.rows < 2 && matches!(quantity, Quantity::ThetaZ | Quantity::YC);
    if flat {
        return never("a single row does not show it".to_owned(), "take another feature");
    }
    if quantity == Quantity::Way && phase.does == PhaseKind::Hold {
        return never("the finger stands still".to_owned(), "take `time`, or let it move");
    }
    let (low, high) = condition.interval();
    let (least, most, why) = range(quantity, phase, servo);
    if low >= most || high <= least {
        let remedy = format!("name something between {least} and {most}");
        return never(format!("its quantity is {least} to {most}, as {why}"), &remedy);
    }
    let held = quantity.feature().and_then(|feature| set_point(feature, phase, servo));
    if let Some(held) = held.filter(|held| !(low < *held && *held < high)) {
        let remedy = "ask for what the set point is, or change the set point";
        return never(format!("the phase itself holds the feature at {held}"), remedy);
    }
    Ok(())
}

/// Checks the conditions of a phase.
///
/// # Errors
/// The faults that this module names.
pub(super) fn check(phase: &PhaseConfig, servo: &Config) -> Result<(), Invalid> {
    for (i, condition) in phase.until.iter().enumerate() {
        let within = |bad: Invalid| bad.within(&format!("until[{i}]"));
        check_one(condition, phase, servo).map_err(within)?;
        let (low, high) = condition.interval();
        for earlier in &phase.until[..i] {
            let (low, high) = (low.max(earlier.interval().0), high.min(earlier.interval().1));
            if earlier.quantity == condition.quantity && low >= high {
                let what = "is never met together with one before it";
                return Err(within(Invalid::new("", what, "leave one of them out")));
            }
        }
    }
    Ok(())
}
