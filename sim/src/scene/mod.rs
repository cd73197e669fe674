//! The description of a simulated bench as text files state it: lengths in millimetres, angles in
//! degrees, each key with its unit. Every number that has no physical meaning is an error with its
//! place and a remedy: a number that is not finite, a size that is negative, zero or huge, a range
//! whose ends are reversed.

use taktil_hal::Nanos;

mod arm;
mod fault;
pub mod fidelity;
mod hand;
mod object;
mod opposed;
mod rolling;
pub mod section;
mod table;
mod tactile;
mod wrist;

pub use arm::ArmConfig;
pub use fault::{FAULTS_MAX, Fault, FaultKind};
pub use hand::{HandConfig, HeldShape, PUSHES_MAX, PushConfig};
pub use object::{EdgeProfile, OBJECTS_MAX, ObjectConfig, ObjectKind};
pub use opposed::OpposedConfig;
pub use rolling::{FingerConfig, PinConfig, RubberConfig};
pub use table::{Axis, MOTIONS_MAX, Motion, MotionKind, POINTS_MAX, STEP_DURATION_S, TableConfig};
pub use tactile::{Defect, DefectKind, Electronics, ScanStamp, TactileConfig};
pub use taktil_hal::Invalid;
pub use wrist::{GAUGE_CODES_PER_N, GAUGE_CODES_PER_NM, WristConfig};

use fidelity::FidelityConfig;
use section::{Consistency, Value, section};

/// Periods and delays that the world shares with its driver; all periods must be positive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// Encoders, A/D, force/torque and lines are latched at multiples of this.
    pub control_period: Nanos,
    /// Delay between the release of a command and its effect (zero is allowed).
    pub actuation_delay: Nanos,
    /// A tactile scan is complete at multiples of this.
    pub scan_period: Nanos,
}

impl Default for Timing {
    /// Control at 400 Hz, scans at 200 Hz, commands act after half a control period.
    fn default() -> Timing {
        Timing {
            control_period: Nanos::from_micros(2_500),
            actuation_delay: Nanos::from_micros(1_250),
            scan_period: Nanos::from_micros(5_000),
        }
    }
}

impl Timing {
    /// # Errors
    /// A period that is not positive or above 1 s, a delay that is negative or above 1 s.
    pub fn check(&self) -> Result<(), Invalid> {
        let second = Nanos::from_secs(1);
        for (place, span) in
            [("control_period", self.control_period), ("scan_period", self.scan_period)]
        {
            if span <= Nanos::ZERO || span > second {
                return Err(invalid(place, format!("is {span}"), "give more than 0 and up to 1 s"));
            }
        }
        if self.actuation_delay < Nanos::ZERO || self.actuation_delay > second {
            let what = format!("is {}", self.actuation_delay);
            return Err(invalid("actuation_delay", what, "give 0 to 1 s"));
        }
        Ok(())
    }
}

section! {
    /// The whole bench. Every key has a default: an empty table is the level rolling scene.
    #[serde(default)]
    pub struct WorldConfig {
        /// The arm and its start.
        arm: ArmConfig,
        /// The fingertip's rubber.
        finger: FingerConfig,
        /// The pin that is rolled.
        pin: PinConfig,
        /// A second fingertip under the pin, in the table's place.
        opposed: OpposedConfig,
        /// Bodies fixed to the table that the finger may touch. Default none; at most 4.
        object: Vec<ObjectConfig>,
        /// The pan-tilt-slide table under it.
        table: TableConfig,
        /// The tactile array's electronics.
        tactile: TactileConfig,
        /// The force/torque sensor behind the finger.
        wrist: WristConfig,
        /// What a hand finds between its fingers; only for a machine that is a hand.
        hand: HandConfig,
        /// The faults of the bench. Default none; at most 32.
        fault: Vec<Fault>,
        /// The fidelity of each part of the physics.
        fidelity: FidelityConfig,
        /// Longest integration step (us); each interval between two events is divided evenly into
        /// steps no longer than this. Default 1250.
        substep_us: f64 [1.0, 1e5],
        /// Number of steps of the integrator `euler` between two evaluations of inertia, bias
        /// torques and Jacobian of the arm. Default 4.
        arm_refresh_steps: u32 [1.0, 64.0],
    }
}

/// Largest angle between a pin and the columns of an opposed fingertip at the start (deg); a pin
/// across the columns would meet no row.
const OPPOSED_YAW_MAX_DEG: f64 = 70.0;

impl Consistency for WorldConfig {
    fn check_consistency(&self, _place: &str) -> Result<(), Invalid> {
        let opposed = |fault: &Fault| fault.opposed == Some(true);
        if let Some(i) = self.fault.iter().position(opposed).filter(|_| !self.opposed.present) {
            let what = "is true, but there is no opposed fingertip".to_owned();
            let remedy = "say opposed.present = true, or leave it out";
            return Err(invalid(&format!("fault[{i}].opposed"), what, remedy));
        }
        if self.opposed.present && !self.pin.present {
            let what = "is true, but there is no pin to roll".to_owned();
            return Err(invalid("opposed.present", what, "say pin.present = true, or false here"));
        }
        let turned = self.opposed.yaw_deg - self.pin.yaw_deg;
        let turned = turned - 180.0 * (turned / 180.0).round();
        if self.opposed.present && turned.abs() > OPPOSED_YAW_MAX_DEG {
            let what =
                format!("turns its rows {turned} deg away from the pin, which is to cross them");
            let remedy = format!("stay within {OPPOSED_YAW_MAX_DEG} deg of pin.yaw_deg");
            return Err(invalid("opposed.yaw_deg", what, &remedy));
        }
        if self.object.len() > OBJECTS_MAX {
            let what = format!("has {} objects", self.object.len());
            return Err(invalid("object", what, &format!("give at most {OBJECTS_MAX}")));
        }
        if self.fault.len() > FAULTS_MAX {
            let what = format!("has {} faults", self.fault.len());
            return Err(invalid("fault", what, &format!("give at most {FAULTS_MAX}")));
        }
        Ok(())
    }
}

impl Default for WorldConfig {
    fn default() -> WorldConfig {
        WorldConfig {
            arm: ArmConfig::default(),
            finger: FingerConfig::default(),
            pin: PinConfig::default(),
            opposed: OpposedConfig::default(),
            object: Vec::new(),
            table: TableConfig::default(),
            tactile: TactileConfig::default(),
            wrist: WristConfig::default(),
            hand: HandConfig::default(),
            fault: Vec::new(),
            fidelity: FidelityConfig::default(),
            substep_us: 1250.0,
            arm_refresh_steps: 4,
        }
    }
}

/// Height at which the top of the pin stands by default (mm, base frame): the thesis's p_z in
/// contact.
pub const PIN_TOP_MM: f64 = -149.0;

impl WorldConfig {
    /// Height of the table's surface at its pivot (mm, base frame), also when the scene gives none.
    #[must_use]
    pub fn table_height_mm(&self) -> f64 {
        self.table.height_mm.unwrap_or(PIN_TOP_MM - 2.0 * self.pin.radius_mm)
    }

    /// Checks the whole description.
    ///
    /// # Errors
    /// The first key, in the order of the fields, that is not finite, out of its stated range or in
    /// contradiction with another one. [`build`](crate::build) checks whether the integration step
    /// suits the stiffness, because it solves the contact first.
    pub fn check(&self) -> Result<(), Invalid> {
        Value::check(self, "", None)
    }
}

/// Makes an [`Invalid`] of its three parts.
pub(crate) fn invalid(place: &str, what: String, remedy: &str) -> Invalid {
    Invalid::new(place, what, remedy)
}
