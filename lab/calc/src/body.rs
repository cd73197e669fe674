//! Rigid bodies over cells, for calc operations: a sphere, a cylinder with a horizontal axis, a
//! bar, or any face that is given by its heights. A size that is not positive, a tilt above
//! [`TILT_MAX_RAD`] and a body that covers no cell are errors.

use taktil_contact::space::grip::BodyMotion;
use taktil_contact::space::surface::Cells;

use super::field::{Failure, Field, Kind, Presence, number};
use super::request::Args;
use super::space::{RADIUS, ROT, SPHERE, TILT, X, Y};

/// Largest tilt, rad.
const TILT_MAX_RAD: f64 = 0.2;
/// Largest coordinate that a request may name, mm and rad; a larger one is an error.
pub(super) const COORDINATE_MAX: f64 = 1e30;

const LENGTH: Field = number("length_mm", "mm", "Length along the axis.");
const CYLINDER: &[Field] = &[RADIUS, LENGTH, X, Y, ROT, TILT];
const BAR: &[Field] = &[number("width_mm", "mm", "Width."), LENGTH, X, Y, ROT, TILT];
const HEIGHTS: &[Field] = &[Field::new(
    "heights_mm",
    Kind::Numbers,
    "mm",
    Presence::Required,
    "Of the face over its zero height, a cell, row by row; it stays on its cells.",
)];

/// The shapes of a request.
pub(super) const SHAPES: &[Field] = &[
    shape("sphere", SPHERE, "{radius_mm, x_mm, y_mm}."),
    shape("cylinder", CYLINDER, "Lying {radius_mm, length_mm, x_mm, y_mm, rot_rad, tilt_rad}."),
    shape("bar", BAR, "A flat face {width_mm, length_mm, x_mm, y_mm, rot_rad, tilt_rad}."),
    shape("heights", HEIGHTS, "Any face {heights_mm}."),
];

const fn shape(name: &'static str, fields: &'static [Field], doc: &'static str) -> Field {
    Field::new(name, Kind::Table(fields), "", Presence::Optional, doc)
}

/// The face of a body that is pressed on the cells.
#[derive(Clone)]
enum Face {
    Sphere { radius: f64 },
    Cylinder { radius: f64, half_length: f64 },
    Bar { half_width: f64, half_length: f64 },
    Heights(Vec<f64>),
}

/// A face with its position and rotation, mm and rad. The axis points along (-sin, cos) of the
/// rotation.
#[derive(Clone)]
pub(super) struct Body {
    /// Name of the shape's field in the request.
    name: &'static str,
    face: Face,
    place: [f64; 2],
    rot: f64,
    tilt: f64,
}

impl Body {
    pub(super) fn from_args(args: &Args, cells: &Cells) -> Result<Self, Failure> {
        let names = ["sphere", "cylinder", "bar", "heights"];
        let bad = || {
            let what = format!("`shape` has exactly one of the fields {}", names.join(", "));
            Failure::new("wrong_type", Some("shape"), what)
        };
        let table = args.table("shape").ok_or_else(bad)?;
        let mut given = names.into_iter().filter_map(|n| table.table(n).map(|inner| (n, inner)));
        let (Some((name, inner)), None) = (given.next(), given.next()) else { return Err(bad()) };
        let size = |field: &str| -> Result<f64, Failure> {
            let value = inner.number(field)?;
            if value > 0.0 {
                return Ok(value);
            }
            let place = format!("shape.{name}.{field}");
            Err(Failure::range(&place, format!("`{place}` is {value:?}; it has to be above 0")))
        };
        let half = |field: &str| size(field).map(|value| 0.5 * value);
        let face = match name {
            "sphere" => Face::Sphere { radius: size("radius_mm")? },
            "cylinder" => {
                Face::Cylinder { radius: size("radius_mm")?, half_length: half("length_mm")? }
            }
            "bar" => Face::Bar { half_width: half("width_mm")?, half_length: half("length_mm")? },
            _ => {
                let heights = inner.numbers("heights_mm")?;
                let (given, wanted) = (heights.len(), cells.columns * cells.rows);
                if given != wanted {
                    let place = "shape.heights.heights_mm";
                    let what = format!(
                        "`{place}` has {given} heights for {wanted} cells: give one a cell, row \
                         by row"
                    );
                    return Err(Failure::new("wrong_length", Some(place), what));
                }
                Face::Heights(heights.to_vec())
            }
        };
        let or_0 = |field: &str| if inner.has(field) { inner.number(field) } else { Ok(0.0) };
        let place = [or_0("x_mm")?, or_0("y_mm")?];
        let tilt = or_0("tilt_rad")?;
        if tilt.abs() > TILT_MAX_RAD {
            let field = format!("shape.{name}.tilt_rad");
            let what = format!("`{field}`: {tilt} rad; give at most {TILT_MAX_RAD} rad either way");
            return Err(Failure::range(&field, what));
        }
        Ok(Self { name, face, place, rot: or_0("rot_rad")?, tilt })
    }

    /// Moves the body along with a motion: the rotation comes before the translation.
    pub(super) fn carry(&mut self, carry: &BodyMotion) {
        let (s, c) = (libm::sin(carry.turn_rad), libm::cos(carry.turn_rad));
        let ([x, y], [dx, dy]) = (self.place, carry.shift_mm);
        self.place = [c * x - s * y + dx, s * x + c * y + dy];
        self.rot += carry.turn_rad;
    }

    /// Height of the face over the zero height at a position; infinite where there is no face.
    fn height(&self, [x, y]: [f64; 2]) -> f64 {
        let (x, y) = (x - self.place[0], y - self.place[1]);
        let (s, c) = (libm::sin(self.rot), libm::cos(self.rot));
        let (across, along) = (c * x + s * y, c * y - s * x);
        let round = |radius: f64, square: f64| {
            let left = radius * radius - square;
            if left < 0.0 { f64::INFINITY } else { square / (radius + left.sqrt()) }
        };
        let face = match &self.face {
            Face::Sphere { radius } => return round(*radius, x * x + y * y),
            Face::Heights(_) => return f64::INFINITY,
            Face::Cylinder { radius, half_length } if along.abs() <= *half_length => {
                round(*radius, across * across)
            }
            Face::Bar { half_width, half_length }
                if along.abs() <= *half_length && across.abs() <= *half_width =>
            {
                0.0
            }
            Face::Cylinder { .. } | Face::Bar { .. } => return f64::INFINITY,
        };
        face - self.tilt * along
    }

    /// Heights of the face over the centres of all cells.
    pub(super) fn heights(&self, cells: &Cells) -> Result<Vec<f64>, Failure> {
        let heights = match &self.face {
            Face::Heights(heights) => heights.clone(),
            _ => (0..cells.columns * cells.rows).map(|n| self.height(cells.place_mm(n))).collect(),
        };
        let place = match self.face {
            Face::Heights(_) => "shape.heights.heights_mm".to_owned(),
            _ => format!("shape.{}", self.name),
        };
        if heights.iter().all(|height| height.is_infinite()) {
            let what = format!(
                "no cell's middle lies under `{place}`: put it over the cells, or make them smaller"
            );
            return Err(Failure::range(&place, what));
        }
        let odd = |height: &&f64| {
            height.is_nan() || (height.is_finite() && height.abs() > COORDINATE_MAX)
        };
        if let Some(height) = heights.iter().find(odd) {
            let what = format!("`{place}` stands {height:e} mm over a cell: give sizes with sense");
            return Err(Failure::range(&place, what));
        }
        Ok(heights)
    }
}
