//! Calc operation on bodies that are pressed and carried along: `contact_path_3d`. A body of any
//! shape on cells of one layer or several, step by step under Coulomb's friction.
//!
//! It refuses what the solvers refuse, more than one way to say a thing, and more cells in more
//! steps than there is time for. Heights given cell by cell stay on their cells however the body is
//! carried.

use taktil_mechanics::contact::Invalid;
use taktil_mechanics::contact::features::Part;
use taktil_mechanics::contact::layer::Layer;
use taktil_mechanics::contact::space::Drive;
use taktil_mechanics::contact::space::grip::{Carry, Grip, GripState};
use taktil_mechanics::contact::space::radial::Influence;
use taktil_mechanics::contact::space::shear::Shear;
use taktil_mechanics::contact::space::surface::{Cells, Surface};
use taktil_mechanics::contact::space::tactels::{Array, Fineness, Sampling, Shares};
use taktil_mechanics::contact::stack::Stack;

use super::Operation;
use super::answer::Answer;
use super::field::{Failure, Field, Kind, Need};
use super::request::Args;
use super::space::{
    COLS, PART, PITCH, RADIUS, ROT, ROWS, SAMPLING, SPHERE, TILT, X, Y, array_of, default,
    drive_of, features_of, number,
};

/// Most cells along a side.
const SIDE_MAX: usize = 512;
/// Most cells times steps, and most cells that rub.
const WORK_MAX: usize = 1 << 18;
const RUBBED_MAX: usize = 1 << 14;

const LENGTH: Field = number("length_mm", "mm", "Length along the axis.");
const CYLINDER: &[Field] = &[RADIUS, LENGTH, X, Y, ROT, TILT];
const BAR: &[Field] = &[number("width_mm", "mm", "Width."), LENGTH, X, Y, ROT, TILT];
const HEIGHTS: &[Field] = &[Field::new(
    "heights_mm",
    Kind::Numbers,
    "mm",
    Need::Required,
    "Of the face over its zero height, a cell, row by row; it stays on its cells.",
)];

const SHAPES: &[Field] = &[
    shape("sphere", SPHERE, "{radius_mm, x_mm, y_mm}."),
    shape("cylinder", CYLINDER, "Lying {radius_mm, length_mm, x_mm, y_mm, rot_rad, tilt_rad}."),
    shape("bar", BAR, "A flat face {width_mm, length_mm, x_mm, y_mm, rot_rad, tilt_rad}."),
    shape("heights", HEIGHTS, "Any face {heights_mm}."),
];

const LAYER: &[Field] = &[
    number("t_mm", "mm", "Thickness."),
    number("nu", "", "Poisson's ratio, in (-1, 0.5]."),
    Field::new("youngs_mpa", Kind::Number, "MPa", Need::Default("27.58"), "Young's modulus."),
];

const CELLS: &[Field] = &[
    Field::new("columns", Kind::Size(SIDE_MAX), "", Need::Default("48"), "Along x, 4 or more."),
    Field::new("rows", Kind::Size(SIDE_MAX), "", Need::Default("48"), "Along y, 4 or more."),
    number("spacing_mm", "mm", "Side of a cell, at most half the layer at the surface."),
];

const STEP: &[Field] = &[
    Field::new("force_n", Kind::Number, "N", Need::Optional, "This or `penetration_mm`."),
    Field::new("penetration_mm", Kind::Number, "mm", Need::Optional, "Of the zero height."),
    default("dx_mm", "mm", "Carry along x since the step before."),
    default("dy_mm", "mm", "Carry along y since the step before."),
    default("turn_rad", "rad", "Turn about z, through the middle of the cells."),
];

const fn shape(name: &'static str, fields: &'static [Field], doc: &'static str) -> Field {
    Field::new(name, Kind::Table(fields), "", Need::Optional, doc)
}

const FIELDS: &[Field] = &[
    Field::new("shape", Kind::Table(SHAPES), "", Need::Required, "Exactly one of its fields."),
    Field::new(
        "layers",
        Kind::Tables(LAYER),
        "",
        Need::Required,
        "One layer or several on each other, the one at the surface first.",
    ),
    Field::new("cells", Kind::Table(CELLS), "", Need::Required, "Of the surface, about x = y = 0."),
    Field::new(
        "friction",
        Kind::Number,
        "",
        Need::Default("0"),
        "Coulomb's coefficient; above 0 on at most 16384 cells.",
    ),
    Field::new("steps", Kind::Tables(STEP), "", Need::Required, "One after another."),
    ROWS,
    COLS,
    PITCH,
    SAMPLING,
    PART,
    Field::new(
        "show",
        Kind::Choice(&["image", "cells"]),
        "",
        Need::Default("\"image\""),
        "Whether the last step's pressures and tractions are listed cell by cell, too.",
    ),
];

/// What this subject offers.
pub(super) const OPERATIONS: &[Operation] = &[Operation {
    name: "contact_path_3d",
    doc: "A rigid body on cells of bonded layers over an array of tactels, pressed and carried \
          along step by step under Coulomb's friction; the force is 1e-3 or 2e-3 off with 16 cells \
          across the contact, falling as the spacing to 1.5.",
    fields: FIELDS,
    answers: &[
        ("image", "[rows*cols] MPa, szz at the base after the last step, as of contact_3d"),
        ("features", "of the image, as of contact_3d"),
        ("force_n", "[steps] N, into the layer"),
        ("along_n", "[steps][2] N, on the layer along x and y"),
        ("torque_n_mm", "[steps] N mm, on the layer about z through the middle of the cells"),
        ("delta_mm", "[steps] mm, penetration of the zero height"),
        ("sticks_mm2", "[steps] mm^2 that stick"),
        ("slides_mm2", "[steps] mm^2 that slide"),
        ("residual", "[steps] relative, the larger one of the shape's and friction's"),
        ("pressure_mpa", "[cells] MPa, with `show`"),
        ("traction_mpa", "[2][cells] MPa, on the layer along x and along y, with `show`"),
    ],
    run: contact_path_3d,
}];

/// A face over the cells.
enum Face {
    Sphere { radius: f64 },
    Cylinder { radius: f64, half_length: f64 },
    Bar { half_width: f64, half_length: f64 },
    Heights(Vec<f64>),
}

/// A face with where it is, mm and rad; the direction of its axis is (-sin, cos) of its turn.
struct Body {
    face: Face,
    place: [f64; 2],
    rot: f64,
    tilt: f64,
}

impl Body {
    fn of(args: &Args, cells: &Cells) -> Result<Self, Failure> {
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
                    let what = format!("`{place}` has {given} heights for {wanted} cells");
                    return Err(Failure::new("wrong_length", Some(place), what));
                }
                Face::Heights(heights.to_vec())
            }
        };
        let or_0 = |field: &str| if inner.has(field) { inner.number(field) } else { Ok(0.0) };
        let place = [or_0("x_mm")?, or_0("y_mm")?];
        Ok(Self { face, place, rot: or_0("rot_rad")?, tilt: or_0("tilt_rad")? })
    }

    /// Goes along with a carry, turned first.
    fn carried(&mut self, carry: &Carry) {
        let (s, c) = (libm::sin(carry.turn_rad), libm::cos(carry.turn_rad));
        let ([x, y], [dx, dy]) = (self.place, carry.shift_mm);
        self.place = [c * x - s * y + dx, s * x + c * y + dy];
        self.rot += carry.turn_rad;
    }

    /// Height over the zero height at a place; infinite where there is no face.
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

    fn heights(&self, cells: &Cells) -> Vec<f64> {
        match &self.face {
            Face::Heights(heights) => heights.clone(),
            _ => (0..cells.columns * cells.rows).map(|n| self.height(cells.place_mm(n))).collect(),
        }
    }
}

/// What the body stands on.
enum Rubber {
    Layer(Layer),
    Stack(Stack),
}

impl Rubber {
    fn of(args: &Args) -> Result<Self, Failure> {
        let mut layers = Vec::new();
        for (i, table) in args.tables("layers")?.iter().enumerate() {
            let layer = Layer {
                thickness_mm: table.number("t_mm")?,
                youngs_mpa: table.number("youngs_mpa")?,
                poisson: table.number("nu")?,
            };
            layer.check().map_err(|invalid| in_layer(i, &invalid))?;
            layers.push(layer);
        }
        match layers.as_slice() {
            [layer] => Ok(Self::Layer(*layer)),
            _ => Ok(Self::Stack(Stack::new(&layers).map_err(|invalid| failure(&invalid))?)),
        }
    }

    fn influence(&self) -> Result<Influence, Invalid> {
        match self {
            Self::Layer(layer) => Influence::new(layer),
            Self::Stack(stack) => Influence::of_stack(stack),
        }
    }

    fn shear(&self) -> Result<Shear, Invalid> {
        match self {
            Self::Layer(layer) => Shear::new(layer),
            Self::Stack(stack) => Shear::of_stack(stack),
        }
    }
}

/// The solver, with friction or without.
#[derive(Clone)]
enum Solver {
    Smooth(Box<Surface>),
    Rough(Box<Grip>),
}

impl Solver {
    fn step(
        &mut self,
        heights: &[f64],
        (drive, carry): &(Drive, Carry),
    ) -> Result<GripState, Invalid> {
        match self {
            Self::Smooth(surface) => {
                let pressed = surface.press(heights, *drive)?;
                let area_mm2 = [0.0, pressed.area_mm2];
                Ok(GripState { pressed, area_mm2, ..GripState::default() })
            }
            Self::Rough(grip) => grip.step(heights, *drive, carry),
        }
    }

    fn pressure(&self) -> &[f64] {
        match self {
            Self::Smooth(surface) => surface.pressure_mpa(),
            Self::Rough(grip) => grip.pressure_mpa(),
        }
    }
}

/// What makes the image.
struct Seen {
    array: Array,
    normal: Shares,
    /// Of the array and of its mirror.
    sheared: Option<[Shares; 2]>,
}

impl Seen {
    fn image(&self, solver: &Solver) -> Result<Vec<f64>, Invalid> {
        let mut image = vec![0.0; self.array.len()];
        match (solver, &self.sheared) {
            (Solver::Rough(grip), Some([along, across])) => {
                grip.image(&self.normal, [along, across], [0.0; 2], &mut image)?;
            }
            (Solver::Rough(_), None) => {}
            (Solver::Smooth(surface), _) => surface.image(&self.normal, [0.0; 2], &mut image),
        }
        Ok(image)
    }
}

/// The steps of a path.
fn steps_of(args: &Args) -> Result<Vec<(Drive, Carry)>, Failure> {
    let one = |(i, step): (usize, &Args)| -> Result<(Drive, Carry), Failure> {
        let drive = drive_of(step).map_err(|failure| in_step(i, failure))?;
        let shift_mm = [step.number("dx_mm")?, step.number("dy_mm")?];
        Ok((drive, Carry { shift_mm, turn_rad: step.number("turn_rad")? }))
    };
    let steps = args.tables("steps")?.iter().enumerate().map(one).collect::<Result<Vec<_>, _>>()?;
    if steps.is_empty() {
        let what = "`steps` is empty: give at least one {force_n} or {penetration_mm}";
        return Err(Failure::range("steps", what));
    }
    Ok(steps)
}

fn cells_of(args: &Args, steps: usize, friction: f64) -> Result<Cells, Failure> {
    let Some(table) = args.table("cells") else {
        return Err(Failure::new("missing_field", Some("cells"), "`cells` is missing"));
    };
    let (columns, rows) = (table.size("columns")?, table.size("rows")?);
    let cells = Cells { columns, rows, spacing_mm: table.number("spacing_mm")? };
    let count = columns * rows;
    if friction > 0.0 && count > RUBBED_MAX {
        let what = format!("`cells`: {count} that rub; give at most {RUBBED_MAX}");
        return Err(Failure::range("cells", what));
    }
    if count.saturating_mul(steps) > WORK_MAX {
        let what =
            format!("`steps`: {steps} on {count} cells; cells times steps is {WORK_MAX} at most");
        return Err(Failure::range("steps", what));
    }
    Ok(cells)
}

/// The tables of an array.
fn seen(
    influence: &Influence,
    shear: Option<&Shear>,
    (array, sampling): (Array, Sampling),
) -> Result<Seen, Invalid> {
    let normal = Shares::new(influence, &array, sampling, Fineness::DEFAULT)?;
    let mirror = Array { rows: array.cols, cols: array.rows, ..array };
    let of =
        |shear: &Shear, array: &Array| Shares::sheared(shear, array, sampling, Fineness::DEFAULT);
    let sheared = match shear {
        Some(shear) => Some([of(shear, &array)?, of(shear, &mirror)?]),
        None => None,
    };
    Ok(Seen { array, normal, sheared })
}

fn contact_path_3d(args: &Args) -> Result<Answer, Failure> {
    let steps = steps_of(args)?;
    let friction = args.number("friction")?;
    let cells = cells_of(args, steps.len(), friction)?;
    let body = |cells| Body::of(args, cells);
    body(&cells)?;
    let rubber = Rubber::of(args)?;
    let refused = |invalid: Invalid| failure(&invalid);
    let influence = rubber.influence().map_err(refused)?;
    let surface = Surface::new(&influence, &cells).map_err(|invalid| in_cells(&invalid))?;
    let shear = if friction == 0.0 { None } else { Some(rubber.shear().map_err(refused)?) };
    let solver = match &shear {
        Some(shear) => {
            Solver::Rough(Box::new(Grip::new(surface, shear, friction).map_err(refused)?))
        }
        None => Solver::Smooth(Box::new(surface)),
    };
    let seen = seen(&influence, shear.as_ref(), array_of(args)?).map_err(refused)?;
    let walked = args.timed(|| -> Result<(Solver, Vec<GripState>), Failure> {
        let (mut solver, mut body) = (solver.clone(), body(&cells)?);
        let mut states = Vec::with_capacity(steps.len());
        for (i, step) in steps.iter().enumerate() {
            body.carried(&step.1);
            let heights = body.heights(&cells);
            if heights.iter().all(|height| height.is_infinite()) {
                let what = format!(
                    "step {i}: no cell's middle lies under the body: put it over the cells, or \
                     make them smaller"
                );
                return Err(Failure::range("shape", what));
            }
            let state = solver.step(&heights, step);
            states.push(state.map_err(|invalid| in_step(i, in_cells(&invalid)))?);
        }
        Ok((solver, states))
    });
    let (solver, states) = walked?;
    let mut image = seen.image(&solver).map_err(refused)?;
    let features = features_of(&seen.array, &image).map_err(refused)?;
    if args.choice("part")? == "compressive" {
        Part::Compressive.keep(&mut image);
    }
    let mut out = Answer::new();
    out.list("image", &image);
    out.value("features", features);
    told(&mut out, &states);
    if args.choice("show")? == "cells" {
        out.list("pressure_mpa", solver.pressure());
        let none = vec![0.0; solver.pressure().len()];
        let traction = match &solver {
            Solver::Rough(grip) => grip.traction_mpa(),
            Solver::Smooth(_) => [none.as_slice(); 2],
        };
        out.rows("traction_mpa", traction);
    }
    Ok(out)
}

/// Every step's answers.
fn told(out: &mut Answer, states: &[GripState]) {
    let mut list = |name, of: fn(&GripState) -> f64| {
        let values: Vec<f64> = states.iter().map(of).collect();
        out.list(name, &values);
    };
    list("force_n", |state| state.pressed.force_n);
    list("torque_n_mm", |state| state.torque_n_mm);
    list("delta_mm", |state| state.pressed.penetration_mm);
    list("sticks_mm2", |state| state.area_mm2[0]);
    list("slides_mm2", |state| state.area_mm2[1]);
    list("residual", |state| state.residual.max(state.pressed.residual));
    out.rows("along_n", states.iter().map(|state| &state.force_n));
}

fn failure(invalid: &Invalid) -> Failure {
    told_of(&invalid.place, invalid)
}

fn told_of(field: &str, invalid: &Invalid) -> Failure {
    Failure::range(field, format!("`{field}`: {}; {}", invalid.what, invalid.remedy))
}

fn in_layer(i: usize, invalid: &Invalid) -> Failure {
    let field = match invalid.place.as_str() {
        "thickness_mm" => "t_mm",
        "poisson" => "nu",
        other => other,
    };
    told_of(&format!("layers[{i}].{field}"), invalid)
}

/// What a grid of cells refuses is told of its own fields.
fn in_cells(invalid: &Invalid) -> Failure {
    let field = match invalid.place.as_str() {
        inner @ ("columns" | "rows" | "spacing_mm") => format!("cells.{inner}"),
        other => other.to_owned(),
    };
    told_of(&field, invalid)
}

/// The same failure of one step.
fn in_step(i: usize, failure: Failure) -> Failure {
    let Failure { code, field, message } = failure;
    let field = match field.as_deref() {
        Some("shift_mm") => Some(format!("steps[{i}].dx_mm")),
        Some(inner @ ("force_n" | "penetration_mm" | "turn_rad")) => {
            Some(format!("steps[{i}].{inner}"))
        }
        _ => field,
    };
    Failure { code, field, message: format!("step {i}: {message}") }
}
