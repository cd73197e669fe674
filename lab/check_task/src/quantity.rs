//! What a field of a payload means, read from its name: the unit at its end and the terms of the
//! payloads of `signal`. Plausible values are drawn by it.

use core::f64::consts::PI;

use taktil_hal::fault::SplitMix;
use taktil_rtcore::payload::Field;

use crate::number::{Number, Place};
use crate::scenario::Scenario;

/// What a field means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Quantity {
    /// Angles of the joints.
    JointAngles,
    /// Speeds of the joints.
    JointSpeeds,
    /// Torques of the joints, up to half of the largest.
    JointTorques,
    /// A number of `taktil_signal::State`.
    State,
    /// A number of `taktil_rtcore::Mode`.
    Mode,
    /// Release at which the state was entered.
    EnteredAt,
    /// An instant shortly before the release.
    RecentTime,
    /// A number that grows from job to job.
    Counter,
    /// 1 three times out of four, else 0.
    Flag,
    /// A set that is mostly empty.
    Faults,
    /// Always the same.
    Fixed(i128),
    /// A whole number below this.
    Code(usize),
    /// A number in this range.
    Within(f64, f64),
}

/// Ends of names, the longer one before the shorter, and the range of plausible values in that
/// unit.
const UNIT_RANGES: [(&str, f64, f64); 16] = [
    ("_rad_s2", -20.0, 20.0),
    ("_rad_s", -2.0, 2.0),
    ("_rad", -PI, PI),
    ("_deg", -180.0, 180.0),
    ("_nm", -2.0, 2.0),
    ("_n", -20.0, 20.0),
    ("_mm", -50.0, 50.0),
    ("_m_s", -0.5, 0.5),
    ("_m", -0.5, 0.5),
    ("_kpa", 0.0, 100.0),
    ("_share", 0.0, 1.0),
    ("_s", 0.0, 10.0),
    ("counts", 0.0, 4000.0),
    ("m0", 0.0, 4000.0),
    ("x_c", 1.0, 16.0),
    ("y_c", 1.0, 16.0),
];
/// Names of flags.
const FLAG_NAMES: [&str; 18] = [
    "valid",
    "calibrated",
    "done",
    "drive_power",
    "estop_a_closed",
    "estop_b_closed",
    "baseline_ready",
    "gate_open",
    "active",
    "paused",
    "moving",
    "trusted",
    "straight",
    "now",
    "stopped",
    "calibrate",
    "enabled",
    "at_work",
];
/// Names of numbers that grow.
const COUNTER_NAMES: [&str; 7] =
    ["sequence", "frames", "request", "received", "checked", "jobs", "samples"];
/// Names of numbers that stand for one of so many things.
const CODE_NAMES: [(&str, usize); 5] =
    [("verb", 12), ("kind", 7), ("frame", 4), ("obstacle", 8), ("defined", 8)];

/// The quantity of a field of a payload with these fields, for an arm of so many joints.
pub(crate) fn quantity(fields: &[Field], field: &Field, place: Place, joints: usize) -> Quantity {
    let of_joints = field.count == joints && field.array;
    if place.is_real() {
        return match field.name {
            "q_rad" if of_joints => Quantity::JointAngles,
            "qd_rad_s" if of_joints => Quantity::JointSpeeds,
            "tau_nm" if of_joints => Quantity::JointTorques,
            "error_rad" => Quantity::Within(-0.02, 0.02),
            name => {
                let unit = UNIT_RANGES.iter().find(|(end, ..)| name.ends_with(end));
                unit.map_or(Quantity::Within(-1.0, 1.0), |(_, low, high)| {
                    Quantity::Within(*low, *high)
                })
            }
        };
    }
    let count =
        |name: &str| fields.iter().find(|other| other.name == name).map(|other| other.count);
    let rows = count("row_offset_ns").unwrap_or(1).max(1);
    match field.name {
        "mode" => Quantity::Mode,
        "state" | "source" => Quantity::State,
        "entered_ns" => Quantity::EnteredAt,
        "faults" => Quantity::Faults,
        "rows" => Quantity::Fixed(rows as i128),
        "cols" => Quantity::Fixed((count("counts").unwrap_or(rows) / rows) as i128),
        "row_offset_ns" => Quantity::Within(0.0, 1e6),
        "counts" => Quantity::Within(-1e5, 1e5),
        "dac" => Quantity::Within(-2048.0, 2047.0),
        name if name.ends_with("_ns") => Quantity::RecentTime,
        name if FLAG_NAMES.contains(&name) => Quantity::Flag,
        name if COUNTER_NAMES.contains(&name) => Quantity::Counter,
        name => {
            let code = CODE_NAMES.iter().find(|(code, _)| *code == name);
            Quantity::Code(code.map_or(4, |(_, below)| *below))
        }
    }
}

impl Quantity {
    /// Whether the value follows the scenario from job to job; others stay for a while.
    pub(crate) fn follows(self) -> bool {
        use Quantity::{
            Code, Counter, EnteredAt, Faults, Fixed, Flag, JointAngles, JointSpeeds, JointTorques,
            Mode, RecentTime, State, Within,
        };
        match self {
            JointAngles | JointSpeeds | State | Mode | EnteredAt | RecentTime | Counter => true,
            JointTorques | Flag | Faults | Fixed(_) | Code(_) | Within(..) => false,
        }
    }

    /// Draws the value of an element.
    pub(crate) fn draw(self, element: usize, at: &Scenario, random: &mut SplitMix) -> Number {
        match self {
            Quantity::JointAngles => Number::Real(at.q_rad[element]),
            Quantity::JointSpeeds => Number::Real(at.qd_rad_s[element]),
            Quantity::JointTorques => {
                Number::Real((random.unit() - 0.5) * at.torque_max_nm[element])
            }
            Quantity::State => Number::Whole(at.state as i128),
            Quantity::Mode => Number::Whole(i128::from(at.mode.code())),
            Quantity::EnteredAt => Number::Whole(i128::from(at.entered.0)),
            Quantity::RecentTime => {
                Number::Whole(i128::from(at.release.0) - random.below(2_000_000) as i128)
            }
            Quantity::Counter => Number::Whole(i128::from(at.tick) + 1),
            Quantity::Flag => Number::Whole(i128::from(random.below(4) > 0)),
            Quantity::Faults => match random.below(8) {
                0 => Number::Whole(1 << random.below(32)),
                _ => Number::Whole(0),
            },
            Quantity::Fixed(number) => Number::Whole(number),
            Quantity::Code(below) => Number::Whole(random.below(below) as i128),
            Quantity::Within(low, high) => Number::Real(low + (high - low) * random.unit()),
        }
    }
}

#[cfg(test)]
mod tests {
    use taktil_rtcore::Payload;
    use taktil_signal::{ControlState, Desired, TactileImage};

    use super::*;
    use crate::number::places;

    fn meanings(fields: &[Field]) -> Vec<(&'static str, Quantity)> {
        let each = fields.iter().zip(places(fields));
        each.map(|(field, place)| (field.name, quantity(fields, field, place, 6))).collect()
    }

    #[test]
    fn names_are_understood() {
        let desired = meanings(<Desired>::FIELDS);
        assert_eq!(desired[0], ("q_rad", Quantity::JointAngles));
        assert_eq!(desired[1], ("qd_rad_s", Quantity::JointSpeeds));
        assert_eq!(desired[3], ("valid", Quantity::Flag));
        let control = meanings(ControlState::FIELDS);
        assert_eq!(control[0], ("entered_ns", Quantity::EnteredAt));
        assert_eq!(control[2], ("state", Quantity::State));
        let image = meanings(&taktil_rtcore::ArrayPayload::fields(&TactileImage::new(12, 16)));
        assert!(image.contains(&("rows", Quantity::Fixed(12))));
        assert!(image.contains(&("cols", Quantity::Fixed(16))));
        assert!(image.contains(&("valid", Quantity::Flag)));
    }
}
