//! What a simulated bench consists of, as text files state it: lengths in millimetres, angles in
//! degrees, each key with its unit. Refuses, with the place and the remedy, every number that
//! physics cannot use: not finite, negative where size is meant, zero, huge, reversed.

use core::fmt;

use serde::Deserialize;
use taktil_hal::Nanos;

use crate::fidelity::FidelityConfig;

/// A value that cannot be simulated: where it stands, what is wrong, what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Invalid {
    /// Dotted path inside [`WorldConfig`], such as `pin.radius_mm`.
    pub place: String,
    /// What is wrong, with the offending figure.
    pub what: String,
    /// What to write instead.
    pub remedy: String,
}

impl fmt::Display for Invalid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.place, self.what, self.remedy)
    }
}

impl std::error::Error for Invalid {}

/// Instants that the world shares with whoever drives it; all must be positive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// Encoders, A/D, force/torque and lines are latched at multiples of this.
    pub control_period: Nanos,
    /// A word committed at a release acts this much later (zero allowed).
    pub actuation_delay: Nanos,
    /// A tactile scan is complete at multiples of this.
    pub scan_period: Nanos,
}

impl Default for Timing {
    /// 400 Hz control, 200 Hz scans, words act after half a control period.
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

/// The whole bench. Every key has a default: an empty table is the level rolling scene.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorldConfig {
    /// The arm and its start.
    pub arm: ArmConfig,
    /// The fingertip's rubber.
    pub finger: FingerConfig,
    /// The pin that is rolled.
    pub pin: PinConfig,
    /// The pan-tilt-slide table under it.
    pub table: TableConfig,
    /// The tactile array's electronics.
    pub tactile: TactileConfig,
    /// How faithful each part is.
    pub fidelity: FidelityConfig,
    /// Longest integration step (us); each interval between two events is divided evenly into
    /// steps no longer than this. Default 1250.
    pub substep_us: f64,
    /// With the integrator `euler`, inertia, bias torques and Jacobian of the arm are evaluated
    /// every so many steps. Default 4.
    pub arm_every: u32,
}

/// `[arm]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArmConfig {
    /// Joint angles at power-up (deg), where the incremental encoders read zero. The default puts
    /// the finger, pointing straight down, at (325, -127, -134) mm, 15 mm above the default pin.
    pub home_deg: [f64; 6],
    /// Factor on the joints' Coulomb friction, 0 takes it away. Default 1.
    pub coulomb_scale: f64,
    /// Factor on the joints' viscous friction. Default 1.
    pub viscous_scale: f64,
    /// When the drives' supply comes on (s after the start). Default 0.
    pub power_on_s: f64,
}

/// A rubber layer bonded to a rigid base.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RubberConfig {
    /// Thickness (mm).
    pub thickness_mm: f64,
    /// Young's modulus (MPa).
    pub youngs_mpa: f64,
    /// Poisson's ratio, below 0.5.
    pub poisson: f64,
    /// Kelvin-Voigt relaxation time: damping = stiffness x this (ms). Default 0.3.
    #[serde(default = "relaxation_ms_default")]
    pub relaxation_ms: f64,
}

fn relaxation_ms_default() -> f64 {
    0.3
}

/// `[finger]`
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FingerConfig {
    /// Layer over the tactels. Default 0.8 mm, 2 MPa, 0.49. The thesis's finite elements use
    /// 27.58 MPa (4000 psi), ten times a rubber that one would put on a fingertip: 15 N would press
    /// a 23 mm pin in by 7 um only, and steps would have to be much shorter. That value is allowed,
    /// with a heavier pin or a shorter step.
    pub rubber: RubberConfig,
    /// Coulomb coefficient against the pin. Default 0.8.
    pub friction: f64,
}

/// `[pin]`
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PinConfig {
    /// Whether there is a pin. Default true.
    pub present: bool,
    /// Radius (mm). Default 23.
    pub radius_mm: f64,
    /// Length (mm). Default 80.
    pub length_mm: f64,
    /// Mass (kg), as a solid cylinder. Default 0.2: a plastic bar of the default size.
    pub mass_kg: f64,
    /// Start of the pin's centre along x0, counted from the finger's start (mm). Default 0.
    pub x_mm: f64,
    /// Start along y0, counted from the finger's start (mm). Default 0.
    pub y_mm: f64,
    /// Start of the axis about the table's normal, from the table's y axis (deg). Default 0.
    pub yaw_deg: f64,
    /// A hand holds the pin to its place on the table (spring and damper in the table's plane and
    /// against rolling) until the finger has first pressed with `steady_until_n`. Default true.
    pub steadied: bool,
    /// The finger's normal force at which the hand lets go for good (N). Default 5.
    pub steady_until_n: f64,
    /// Rolling resistance: moment = this x normal force, on either side (mm). Default 0.
    pub rolling_resistance_mm: f64,
}

/// `[table]`. Pose: the surface turns about the pivot, first about its own x axis, then y, then
/// about z0; a positive `tilt_y_deg` raises the side towards +x, a positive `tilt_x_deg` the side
/// towards +y, a positive `pan_deg` turns x towards y.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TableConfig {
    /// Height of the surface at the pivot (mm, base frame). Default: [`PIN_TOP_MM`] less the pin's
    /// diameter, so that a pin of any radius meets the finger where the thesis's did.
    pub height_mm: Option<f64>,
    /// Turn about x (deg). Default 0.
    pub tilt_x_deg: f64,
    /// Tilt about y (deg): the surface rises towards +x. Default 0.
    pub tilt_y_deg: f64,
    /// Turn about z0 (deg). Default 0.
    pub pan_deg: f64,
    /// Displacement along x0 (mm). Default 0.
    pub slide_mm: f64,
    /// Pivot along x0 without slide (mm). Default 325.
    pub pivot_x_mm: f64,
    /// Pivot along y0 (mm). Default -127.
    pub pivot_y_mm: f64,
    /// Layer on the table. Default 6 mm, 0.6 MPa, 0.49, 0.7 ms: soft enough that a position servo
    /// at 400 Hz is stable in contact, which is why the thesis put rubber there.
    pub rubber: RubberConfig,
    /// Coulomb coefficient against the pin. Default 0.8.
    pub friction: f64,
    /// Linear ramps, added to the values above. Default none; at most 16.
    pub motion: Vec<Ramp>,
}

/// What a ramp moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    /// `tilt_x_deg`
    TiltX,
    /// `tilt_y_deg`
    TiltY,
    /// `pan_deg`
    Pan,
    /// `slide_mm`
    Slide,
    /// `height_mm`
    Height,
}

/// `[[table.motion]]`: a constant rate from one instant to another.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ramp {
    /// What moves: `tilt_x`, `tilt_y`, `pan`, `slide` or `height`.
    pub axis: Axis,
    /// Rate of an angle (deg/s).
    pub rate_deg_s: Option<f64>,
    /// Rate of `slide` or `height` (mm/s).
    pub rate_mm_s: Option<f64>,
    /// Start (s).
    pub from_s: f64,
    /// End (s).
    pub to_s: f64,
}

impl Ramp {
    /// Degrees or millimetres per second, whichever the axis has.
    #[must_use]
    pub fn rate(&self) -> Option<f64> {
        match self.axis {
            Axis::Slide | Axis::Height => self.rate_mm_s,
            Axis::TiltX | Axis::TiltY | Axis::Pan => self.rate_deg_s,
        }
    }
}

/// `[tactile]`
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TactileConfig {
    /// Standard deviation of the noise on each tactel (counts). Default 50: it reproduces the
    /// thesis's +-5 deg on the pin's direction.
    pub noise_counts: f64,
    /// Reading without load (counts), at least five standard deviations. Default 300.
    pub rest_counts: f64,
    /// Converter width, 8 to 16. Default 12.
    pub bits: u32,
    /// Force on one tactel that would span the whole converter (N). Default 4.
    pub full_scale_n: f64,
}

impl Default for WorldConfig {
    fn default() -> WorldConfig {
        WorldConfig {
            arm: ArmConfig::default(),
            finger: FingerConfig::default(),
            pin: PinConfig::default(),
            table: TableConfig::default(),
            tactile: TactileConfig::default(),
            fidelity: FidelityConfig::default(),
            substep_us: 1250.0,
            arm_every: 4,
        }
    }
}

impl Default for ArmConfig {
    fn default() -> ArmConfig {
        ArmConfig {
            home_deg: [0.0, 46.790197, -160.621702, -180.0, 66.168495, 180.0],
            coulomb_scale: 1.0,
            viscous_scale: 1.0,
            power_on_s: 0.0,
        }
    }
}

impl Default for FingerConfig {
    fn default() -> FingerConfig {
        let rubber =
            RubberConfig { thickness_mm: 0.8, youngs_mpa: 2.0, poisson: 0.49, relaxation_ms: 0.3 };
        FingerConfig { rubber, friction: 0.8 }
    }
}

impl Default for PinConfig {
    fn default() -> PinConfig {
        PinConfig {
            present: true,
            radius_mm: 23.0,
            length_mm: 80.0,
            mass_kg: 0.2,
            x_mm: 0.0,
            y_mm: 0.0,
            yaw_deg: 0.0,
            steadied: true,
            steady_until_n: 5.0,
            rolling_resistance_mm: 0.0,
        }
    }
}

impl Default for TableConfig {
    fn default() -> TableConfig {
        TableConfig {
            height_mm: None,
            tilt_x_deg: 0.0,
            tilt_y_deg: 0.0,
            pan_deg: 0.0,
            slide_mm: 0.0,
            pivot_x_mm: 325.0,
            pivot_y_mm: -127.0,
            rubber: RubberConfig {
                thickness_mm: 6.0,
                youngs_mpa: 0.6,
                poisson: 0.49,
                relaxation_ms: 0.7,
            },
            friction: 0.8,
            motion: Vec::new(),
        }
    }
}

impl Default for TactileConfig {
    fn default() -> TactileConfig {
        TactileConfig { noise_counts: 50.0, rest_counts: 300.0, bits: 12, full_scale_n: 4.0 }
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
}

/// An [`Invalid`] of its three parts.
pub(crate) fn invalid(place: &str, what: String, remedy: &str) -> Invalid {
    Invalid { place: place.to_owned(), what, remedy: remedy.to_owned() }
}

/// Refuses NaN, infinities and everything outside `low..=high`.
fn within(place: &str, value: f64, low: f64, high: f64) -> Result<(), Invalid> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(invalid(place, format!("is {value}"), &format!("give a number from {low} to {high}")))
}

impl WorldConfig {
    /// Refuses what cannot be simulated.
    ///
    /// # Errors
    /// The first key, in the order of the fields, that is not finite, out of its stated range or at
    /// odds with another one. Whether the integration step suits the stiffness is seen by
    /// [`build`](crate::build), which solves the contact first.
    pub fn check(&self) -> Result<(), Invalid> {
        self.arm.check()?;
        self.finger.rubber.check("finger.rubber")?;
        within("finger.friction", self.finger.friction, 0.0, 5.0)?;
        self.pin.check()?;
        self.table.check()?;
        self.tactile.check()?;
        within("substep_us", self.substep_us, 1.0, 1e5)?;
        within("arm_every", f64::from(self.arm_every), 1.0, 64.0)
    }
}

impl ArmConfig {
    fn check(&self) -> Result<(), Invalid> {
        for (i, angle) in self.home_deg.iter().enumerate() {
            within(&format!("arm.home_deg[{i}]"), *angle, -720.0, 720.0)?;
        }
        within("arm.coulomb_scale", self.coulomb_scale, 0.0, 10.0)?;
        within("arm.viscous_scale", self.viscous_scale, 0.0, 100.0)?;
        within("arm.power_on_s", self.power_on_s, 0.0, 1e6)
    }
}

impl RubberConfig {
    fn check(&self, place: &str) -> Result<(), Invalid> {
        within(&format!("{place}.thickness_mm"), self.thickness_mm, 0.05, 100.0)?;
        within(&format!("{place}.youngs_mpa"), self.youngs_mpa, 0.01, 1000.0)?;
        within(&format!("{place}.poisson"), self.poisson, 0.0, 0.4999)?;
        within(&format!("{place}.relaxation_ms"), self.relaxation_ms, 0.0, 100.0)
    }
}

impl PinConfig {
    fn check(&self) -> Result<(), Invalid> {
        within("pin.radius_mm", self.radius_mm, 1.0, 500.0)?;
        within("pin.length_mm", self.length_mm, 1.0, 1000.0)?;
        within("pin.mass_kg", self.mass_kg, 1e-3, 100.0)?;
        within("pin.x_mm", self.x_mm, -1000.0, 1000.0)?;
        within("pin.y_mm", self.y_mm, -1000.0, 1000.0)?;
        within("pin.yaw_deg", self.yaw_deg, -70.0, 70.0)?;
        within("pin.steady_until_n", self.steady_until_n, 1e-3, 1000.0)?;
        within("pin.rolling_resistance_mm", self.rolling_resistance_mm, 0.0, 1.0)
    }
}

impl TableConfig {
    fn check(&self) -> Result<(), Invalid> {
        if let Some(height_mm) = self.height_mm {
            within("table.height_mm", height_mm, -2000.0, 2000.0)?;
        }
        within("table.tilt_x_deg", self.tilt_x_deg, -60.0, 60.0)?;
        within("table.tilt_y_deg", self.tilt_y_deg, -60.0, 60.0)?;
        within("table.pan_deg", self.pan_deg, -180.0, 180.0)?;
        within("table.slide_mm", self.slide_mm, -2000.0, 2000.0)?;
        within("table.pivot_x_mm", self.pivot_x_mm, -2000.0, 2000.0)?;
        within("table.pivot_y_mm", self.pivot_y_mm, -2000.0, 2000.0)?;
        self.rubber.check("table.rubber")?;
        within("table.friction", self.friction, 0.0, 5.0)?;
        if self.motion.len() > MOTIONS_MAX {
            let what = format!("has {} ramps", self.motion.len());
            return Err(invalid("table.motion", what, "give at most 16"));
        }
        for (i, ramp) in self.motion.iter().enumerate() {
            ramp.check(&format!("table.motion[{i}]"))?;
        }
        Ok(())
    }
}

/// The most ramps that a table takes.
pub const MOTIONS_MAX: usize = 16;

impl Ramp {
    fn check(&self, place: &str) -> Result<(), Invalid> {
        let length = matches!(self.axis, Axis::Slide | Axis::Height);
        let (key, other) =
            if length { ("rate_mm_s", "rate_deg_s") } else { ("rate_deg_s", "rate_mm_s") };
        let foreign = if length { self.rate_deg_s } else { self.rate_mm_s };
        if foreign.is_some() {
            let what = "does not fit the axis".to_owned();
            return Err(invalid(&format!("{place}.{other}"), what, &format!("use {key}")));
        }
        let Some(rate) = self.rate() else {
            return Err(invalid(place, format!("has no {key}"), "state the rate"));
        };
        within(&format!("{place}.{key}"), rate, -1000.0, 1000.0)?;
        within(&format!("{place}.from_s"), self.from_s, 0.0, 1e6)?;
        within(&format!("{place}.to_s"), self.to_s, 0.0, 1e6)?;
        if self.to_s <= self.from_s {
            let what = format!("is {}, not after from_s = {}", self.to_s, self.from_s);
            return Err(invalid(&format!("{place}.to_s"), what, "end after the start"));
        }
        Ok(())
    }
}

impl TactileConfig {
    fn check(&self) -> Result<(), Invalid> {
        within("tactile.bits", f64::from(self.bits), 8.0, 16.0)?;
        let full = f64::from((1_u32 << self.bits) - 1);
        within("tactile.noise_counts", self.noise_counts, 0.0, full / 5.0)?;
        within("tactile.rest_counts", self.rest_counts, 0.0, full / 2.0)?;
        within("tactile.full_scale_n", self.full_scale_n, 1e-3, 1e3)?;
        if self.rest_counts < 5.0 * self.noise_counts {
            let what = format!(
                "is {}, less than 5 x noise_counts = {}: clipping at zero would bias every sum",
                self.rest_counts,
                5.0 * self.noise_counts
            );
            return Err(invalid("tactile.rest_counts", what, "raise it or lower the noise"));
        }
        Ok(())
    }
}
