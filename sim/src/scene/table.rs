//! `[table]`: place and motions of the surface under the pin. A motion whose unit does not fit its
//! axis, that runs backwards in time or that lacks a key of its kind is an error.

use serde::Deserialize;

use super::rolling::RubberConfig;
use super::section::{Consistency, inside, names, section};
use super::{Invalid, invalid};

section! {
    /// `[table]`. Pose: the surface turns about the pivot, first about its own x axis, then y, then
    /// about z0; a positive `tilt_y_deg` raises the side towards +x, a positive `tilt_x_deg` the
    /// side towards +y, a positive `pan_deg` turns x towards y.
    #[serde(default)]
    pub struct TableConfig {
        /// Height of the surface at the pivot (mm, base frame). Default: the pin's top, whatever
        /// its radius, where the thesis's finger met it (-149 mm).
        height_mm: Option<f64> [-2000.0, 2000.0],
        /// Turn about x (deg). Default 0.
        tilt_x_deg: f64 [-60.0, 60.0],
        /// Tilt about y (deg): the surface rises towards +x. Default 0.
        tilt_y_deg: f64 [-60.0, 60.0],
        /// Turn about z0 (deg). Default 0.
        pan_deg: f64 [-180.0, 180.0],
        /// Displacement along x0 (mm). Default 0.
        slide_mm: f64 [-2000.0, 2000.0],
        /// Pivot along x0 without slide (mm): the axes of pan and tilts pass through it. Default
        /// 325.
        pivot_x_mm: f64 [-2000.0, 2000.0],
        /// Pivot along y0 (mm). Default -127.
        pivot_y_mm: f64 [-2000.0, 2000.0],
        /// Layer on the table. Default 6 mm, 0.6 MPa, 0.49, 0.7 ms: soft enough that a position
        /// servo at 400 Hz is stable in contact, which is why the thesis put rubber there.
        rubber: RubberConfig,
        /// Coulomb coefficient against the pin. Default 0.8.
        friction: f64 [0.0, 5.0],
        /// Motions, added to the values above and to each other. Default none; at most 16.
        motion: Vec<Motion>,
    }
}

/// Largest number of motions of a table.
pub const MOTIONS_MAX: usize = 16;
/// Largest number of points of one motion: half an hour at 50 Hz.
pub const POINTS_MAX: usize = 100_000;
/// Duration of a step whose description states none (s): a table has mass.
pub const STEP_DURATION_S: f64 = 0.05;

impl Consistency for TableConfig {
    fn check_consistency(&self, place: &str) -> Result<(), Invalid> {
        if self.motion.len() > MOTIONS_MAX {
            let what = format!("has {} motions", self.motion.len());
            let remedy = format!("give at most {MOTIONS_MAX}");
            return Err(invalid(&inside(place, "motion"), what, &remedy));
        }
        Ok(())
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

taktil_hal::explained! {
    /// The coordinate of the table that a motion moves.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Axis {
        /// Turn about the table's x, on top of `tilt_x_deg`.
        TiltX,
        /// Turn about the table's y, on top of `tilt_y_deg`.
        TiltY,
        /// Turn about z0, on top of `pan_deg`.
        Pan,
        /// Displacement along x0, on top of `slide_mm`.
        Slide,
        /// Rise, on top of `height_mm`.
        Height,
    }
}

impl Axis {
    /// Unit of the axis: `mm` or `deg`.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Axis::Slide | Axis::Height => "mm",
            Axis::TiltX | Axis::TiltY | Axis::Pan => "deg",
        }
    }
}

taktil_hal::explained! {
    /// The profile of a motion.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum MotionKind {
        /// A rate from `from_s` to `to_s`, reached and left within `blend_s`.
        #[default]
        Ramp,
        /// A change from `from_s` on, as a minimum-jerk move that ends at `to_s` or 0.05 s later.
        Step,
        /// An oscillation from `from_s` on, to `to_s` if that is given.
        Sine,
        /// Values at instants after `from_s`, written here or recorded in a file.
        Points,
    }
}

names!(Axis, MotionKind);

section! {
    /// `[[table.motion]]`: one coordinate of the table over time. Its `kind` determines the keys
    /// that it needs; lengths are in mm and angles in deg, as the names of the keys say.
    pub struct Motion {
        /// The coordinate: `tilt_x`, `tilt_y`, `pan`, `slide` or `height`.
        axis: Axis,
        /// The profile: `ramp` (default), `step`, `sine` or `points`.
        #[serde(default)]
        kind: MotionKind,
        /// Start (s). Default 0.
        #[serde(default)]
        from_s: f64 [0.0, 1e6],
        /// End (s). A ramp needs it.
        to_s: Option<f64> [0.0, 1e6],
        /// Ramp: rate of an angle (deg/s).
        rate_deg_s: Option<f64> [-1000.0, 1000.0],
        /// Ramp: rate of `slide` or `height` (mm/s).
        rate_mm_s: Option<f64> [-1000.0, 1000.0],
        /// Ramp: time in which the rate rises after `from_s` and falls before `to_s` (s). Default
        /// 0.
        blend_s: Option<f64> [0.0, 1e6],
        /// Step: change of an angle (deg).
        by_deg: Option<f64> [-180.0, 180.0],
        /// Step: change of a length (mm).
        by_mm: Option<f64> [-2000.0, 2000.0],
        /// Sine: amplitude of an angle (deg).
        amplitude_deg: Option<f64> [0.0, 90.0],
        /// Sine: amplitude of a length (mm).
        amplitude_mm: Option<f64> [0.0, 1000.0],
        /// Sine: cycles in a second.
        frequency_hz: Option<f64> [1e-3, 200.0],
        /// Points: `[seconds after from_s, deg]`, in order of time.
        points_deg: Option<Vec<[f64; 2]>> [-1e6, 1e6],
        /// Points: `[seconds after from_s, mm]`, in order of time.
        points_mm: Option<Vec<[f64; 2]>> [-1e6, 1e6],
        /// Points: a CSV file beside the scene, first column `t_s`, second a name that ends in
        /// `_deg` or `_mm`, as the axis has it.
        file: Option<String>,
    }
}

impl Motion {
    /// A motion without any values but its axis and its kind, for the caller to complete.
    #[must_use]
    pub fn of(axis: Axis, kind: MotionKind) -> Motion {
        Motion {
            axis,
            kind,
            from_s: 0.0,
            to_s: None,
            rate_deg_s: None,
            rate_mm_s: None,
            blend_s: None,
            by_deg: None,
            by_mm: None,
            amplitude_deg: None,
            amplitude_mm: None,
            frequency_hz: None,
            points_deg: None,
            points_mm: None,
            file: None,
        }
    }

    /// A constant rate (deg/s or mm/s, whichever the axis has) between two instants (s).
    #[must_use]
    pub fn ramp(axis: Axis, rate: f64, from_s: f64, to_s: f64) -> Motion {
        let (deg, mm) = if axis.unit() == "deg" { (Some(rate), None) } else { (None, Some(rate)) };
        Motion {
            from_s,
            to_s: Some(to_s),
            rate_deg_s: deg,
            rate_mm_s: mm,
            ..Motion::of(axis, MotionKind::Ramp)
        }
    }

    /// The value whose unit fits the axis.
    pub(crate) fn by_unit<T>(&self, deg: T, mm: T) -> T {
        if self.axis.unit() == "deg" { deg } else { mm }
    }

    /// The keys that belong to one kind only: name, whether it is given, and that kind.
    fn kind_specific_keys(&self) -> [(&'static str, bool, MotionKind); 11] {
        [
            ("rate_deg_s", self.rate_deg_s.is_some(), MotionKind::Ramp),
            ("rate_mm_s", self.rate_mm_s.is_some(), MotionKind::Ramp),
            ("blend_s", self.blend_s.is_some(), MotionKind::Ramp),
            ("by_deg", self.by_deg.is_some(), MotionKind::Step),
            ("by_mm", self.by_mm.is_some(), MotionKind::Step),
            ("amplitude_deg", self.amplitude_deg.is_some(), MotionKind::Sine),
            ("amplitude_mm", self.amplitude_mm.is_some(), MotionKind::Sine),
            ("frequency_hz", self.frequency_hz.is_some(), MotionKind::Sine),
            ("points_deg", self.points_deg.is_some(), MotionKind::Points),
            ("points_mm", self.points_mm.is_some(), MotionKind::Points),
            ("file", self.file.is_some(), MotionKind::Points),
        ]
    }

    fn check_keys(&self, place: &str) -> Result<(), Invalid> {
        let wrong_unit = if self.axis.unit() == "deg" { "_mm" } else { "_deg" };
        for (key, _, kind) in self.kind_specific_keys().into_iter().filter(|(_, given, _)| *given) {
            if kind != self.kind {
                let (what, due) = (format!("belongs to kind {kind:?}"), format!("{:?}", self.kind));
                let remedy = format!("leave it out or say which kind this is ({due})");
                return Err(invalid(
                    &inside(place, key),
                    what.to_lowercase(),
                    &remedy.to_lowercase(),
                ));
            }
            if key.ends_with(wrong_unit) || key.contains(&format!("{wrong_unit}_")) {
                let what = "does not fit the axis".to_owned();
                let remedy =
                    format!("use {}", key.replace(wrong_unit, &format!("_{}", self.axis.unit())));
                return Err(invalid(&inside(place, key), what, &remedy));
            }
        }
        Ok(())
    }

    /// Refuses a motion that lacks a key of its kind.
    fn check_complete(&self, place: &str) -> Result<(), Invalid> {
        let unit = self.axis.unit();
        let lacks = |key: String| {
            Err(invalid(place, format!("has no {key}"), "state it, or another kind of motion"))
        };
        let value = match self.kind {
            MotionKind::Ramp => (self.rate_deg_s.or(self.rate_mm_s), format!("rate_{unit}_s")),
            MotionKind::Step => (self.by_deg.or(self.by_mm), format!("by_{unit}")),
            MotionKind::Sine => {
                (self.amplitude_deg.or(self.amplitude_mm), format!("amplitude_{unit}"))
            }
            MotionKind::Points => return self.check_points(place),
        };
        if value.0.is_none() {
            return lacks(value.1);
        }
        if self.kind == MotionKind::Sine && self.frequency_hz.is_none() {
            return lacks("frequency_hz".to_owned());
        }
        match self.to_s {
            None if self.kind == MotionKind::Ramp => lacks("to_s".to_owned()),
            Some(to_s) if to_s <= self.from_s => {
                let what = format!("is {to_s}, not after from_s = {}", self.from_s);
                Err(invalid(&inside(place, "to_s"), what, "end after the start"))
            }
            Some(to_s) if 2.0 * self.blend_s.unwrap_or(0.0) > to_s - self.from_s => {
                let what = "is longer than half of the ramp".to_owned();
                Err(invalid(&inside(place, "blend_s"), what, "shorten it or end later"))
            }
            _ => Ok(()),
        }
    }

    fn check_points(&self, place: &str) -> Result<(), Invalid> {
        let key = format!("points_{}", self.axis.unit());
        if self.to_s.is_some() {
            let what = "is not for points, which bring their times".to_owned();
            return Err(invalid(&inside(place, "to_s"), what, "leave it out"));
        }
        let points = match (self.by_unit(&self.points_deg, &self.points_mm), &self.file) {
            (Some(points), _) => points,
            (None, None) => {
                return Err(invalid(place, format!("has no {key}"), "give points or a file"));
            }
            (None, Some(name)) => {
                let what = format!("`{name}` was not read");
                return Err(invalid(&inside(place, "file"), what, "let the program read it"));
            }
        };
        let place = inside(place, &key);
        if !(2..=POINTS_MAX).contains(&points.len()) {
            let what = format!("has {} points", points.len());
            return Err(invalid(&place, what, &format!("give 2 to {POINTS_MAX}")));
        }
        if points[0][0] < 0.0 {
            let what = format!("is {}, before from_s", points[0][0]);
            return Err(invalid(&format!("{place}[0][0]"), what, "start at 0 or later"));
        }
        for (i, pair) in points.windows(2).enumerate() {
            if pair[1][0] <= pair[0][0] {
                let what = format!("is {}, not after {}", pair[1][0], pair[0][0]);
                let place = format!("{place}[{}][0]", i + 1);
                return Err(invalid(&place, what, "put the points in order of time"));
            }
        }
        Ok(())
    }
}

impl Consistency for Motion {
    fn check_consistency(&self, place: &str) -> Result<(), Invalid> {
        self.check_keys(place)?;
        self.check_complete(place)
    }
}
