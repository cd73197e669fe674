//! Calc operation `contact_path_3d`: a body of any shape is pressed on cells of one layer or
//! several and moved along, step by step, under Coulomb friction.
//!
//! Errors of the solvers, a quantity that is stated twice, and more cells times steps than
//! [`WORK_MAX`] are errors. Heights given for each cell stay on their cells however the body moves.
//! A body that does not touch moves freely.

use taktil_contact::Invalid;
use taktil_contact::features::Part;
use taktil_contact::space::Prescribed;
use taktil_contact::space::grip::{BodyMotion, Grip, GripState};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::shear::Shear;
use taktil_contact::space::surface::{Cells, Surface};
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};
use taktil_contact::stack::Stack;

use super::Operation;
use super::answer::Answer;
use super::body::{Body, COORDINATE_MAX, SHAPES};
use super::contact::{LAYERS, layers_from_args};
use super::field::{Failure, Field, Kind, Presence, number};
use super::request::Args;
use super::space::{
    COLS, PART, PITCH, ROWS, SAMPLING, array_from_args, default, drive_from_args, features_as_json,
};

/// Largest number of cells along a side.
const SIDE_MAX: usize = 512;
/// Largest product of the number of cells and the number of steps.
const WORK_MAX: usize = 1 << 18;
/// The same limit for a path with friction.
const FRICTION_WORK_MAX: usize = 1 << 16;
/// Largest number of cells with friction.
const FRICTION_CELLS_MAX: usize = 1 << 14;
/// Smallest force that counts as a load, as a fraction of Young's modulus times the square of the
/// surface layer's thickness.
const FORCE_SHARE_MIN: f64 = 1e-12;

const CELLS: &[Field] = &[
    Field::new("columns", Kind::Size(SIDE_MAX), "", Presence::Default("48"), "Along x, 4 or more."),
    Field::new("rows", Kind::Size(SIDE_MAX), "", Presence::Default("48"), "Along y, 4 or more."),
    number("spacing_mm", "mm", "Side of a cell, at most half the layer at the surface."),
];

const STEP: &[Field] = &[
    Field::new("force_n", Kind::Number, "N", Presence::Optional, "This or `penetration_mm`."),
    Field::new("penetration_mm", Kind::Number, "mm", Presence::Optional, "Of the zero height."),
    default("dx_mm", "mm", "Carry along x since the step before; in the air unless that touched."),
    default("dy_mm", "mm", "The same along y."),
    default("turn_rad", "rad", "Turn about z, through the middle of the cells; the same."),
];

const FIELDS: &[Field] = &[
    Field::new("shape", Kind::Table(SHAPES), "", Presence::Required, "Exactly one of its fields."),
    LAYERS,
    Field::new(
        "cells",
        Kind::Table(CELLS),
        "",
        Presence::Required,
        "Of the surface, about x = y = 0.",
    ),
    Field::new(
        "friction",
        Kind::Number,
        "",
        Presence::Default("0"),
        "Coulomb's coefficient; above 0 on at most 16384 cells, and 65536 times steps.",
    ),
    Field::new("steps", Kind::Tables(STEP), "", Presence::Required, "One after another."),
    ROWS,
    COLS,
    PITCH,
    SAMPLING,
    PART,
    Field::new(
        "show",
        Kind::Choice(&["image", "cells"]),
        "",
        Presence::Default("\"image\""),
        "Whether the last step's pressures and tractions are listed cell by cell, too.",
    ),
];

/// The operations of this subject.
pub(super) const OPERATIONS: &[Operation] = &[Operation {
    name: "contact_path_3d",
    doc: "A rigid body on cells of bonded layers over an array of tactels, pressed and carried \
          along step by step under Coulomb's friction; the force of a round body is 1e-3 or 2e-3 \
          off with 16 cells across the contact, falling as the spacing to 1.5; a face is as wide \
          and long as the cells whose middles it covers, and 3e-2 off with 16 across, falling as \
          the spacing.",
    fields: FIELDS,
    answers: &[
        ("image", "[rows*cols] MPa, szz at the base after the last step, as of contact_3d"),
        ("features", "of the image, as of contact_3d"),
        ("force_n", "[steps] N, into the layer"),
        ("along_n", "[steps][2] N, on the layer along x and y"),
        ("torque_n_mm", "[steps] N mm, on the layer about z through the middle of the cells"),
        ("delta_mm", "[steps] mm, penetration of the zero height"),
        ("stick_area_mm2", "[steps] mm^2 that stick"),
        ("slip_area_mm2", "[steps] mm^2 that slide"),
        ("residual", "[steps] relative, the larger one of the shape's and friction's"),
        ("pressure_mpa", "[cells] MPa, with `show`"),
        ("traction_mpa", "[2][cells] MPa, on the layer along x and along y, with `show`"),
    ],
    run: contact_path_3d,
}];

/// Force below which a load counts as zero.
fn force_min_n(stack: &Stack) -> f64 {
    let layer = stack.surface_layer();
    FORCE_SHARE_MIN * layer.youngs_mpa * layer.thickness_mm * layer.thickness_mm
}

/// The solver, with friction or without.
#[derive(Clone)]
enum Solver {
    Frictionless(Box<Surface>),
    Frictional(Box<Grip>),
}

impl Solver {
    fn step(
        &mut self,
        heights: &[f64],
        (drive, carry): &(Prescribed, BodyMotion),
    ) -> Result<GripState, Invalid> {
        match self {
            Self::Frictionless(surface) => {
                let pressed = surface.press(heights, *drive)?;
                let area_mm2 = [0.0, pressed.area_mm2];
                Ok(GripState { pressed, area_mm2, ..GripState::default() })
            }
            Self::Frictional(grip) => grip.step(heights, *drive, carry),
        }
    }

    fn pressure(&self) -> &[f64] {
        match self {
            Self::Frictionless(surface) => surface.pressure_mpa(),
            Self::Frictional(grip) => grip.pressure_mpa(),
        }
    }
}

/// The model that computes the image.
struct ImageModel {
    array: Array,
    sampling: Sampling,
    normal: Shares,
    /// Shares of the shear stress: of the array, and of the array with rows and columns exchanged.
    shear_shares: Option<[Shares; 2]>,
}

impl ImageModel {
    /// The model with the tables for shear stress.
    fn with_shear(mut self, shear: &Shear, fineness: Fineness) -> Result<Self, Failure> {
        let mirror = Array { rows: self.array.cols, cols: self.array.rows, ..self.array };
        let of = |array: &Array| {
            Shares::sheared(shear, array, self.sampling, fineness).map_err(|i| array_failure(&i))
        };
        self.shear_shares = Some([of(&self.array)?, of(&mirror)?]);
        Ok(self)
    }

    fn image(&self, solver: &Solver) -> Result<Vec<f64>, Invalid> {
        let mut image = vec![0.0; self.array.len()];
        match (solver, &self.shear_shares) {
            (Solver::Frictional(grip), Some([along, across])) => {
                grip.image(&self.normal, [along, across], [0.0; 2], &mut image)?;
            }
            (Solver::Frictional(_), None) => {}
            (Solver::Frictionless(surface), _) => surface.image(&self.normal, [0.0; 2], &mut image),
        }
        Ok(image)
    }
}

/// The steps of a path.
fn steps_from_args(
    args: &Args,
    force_min_n: f64,
) -> Result<Vec<(Prescribed, BodyMotion)>, Failure> {
    let one = |(i, step): (usize, &Args)| -> Result<(Prescribed, BodyMotion), Failure> {
        let drive = drive_from_args(step).map_err(|failure| step_failure(i, failure))?;
        if let Prescribed::ForceN(force) = drive
            && force > 0.0
            && force < force_min_n
        {
            let what = format!(
                "`force_n`: {force:e} N cannot be told from none on this rubber; give more, or 0"
            );
            return Err(step_failure(i, Failure::new("unreachable", Some("force_n"), what)));
        }
        let carried = |name: &str| -> Result<f64, Failure> {
            let value = step.number(name)?;
            if value.abs() <= COORDINATE_MAX {
                return Ok(value);
            }
            let what =
                format!("`{name}`: {value:e} is beyond sense; give at most {COORDINATE_MAX:e}");
            Err(step_failure(i, Failure::range(name, what)))
        };
        let shift_mm = [carried("dx_mm")?, carried("dy_mm")?];
        Ok((drive, BodyMotion { shift_mm, turn_rad: carried("turn_rad")? }))
    };
    let steps = args.tables("steps")?.iter().enumerate().map(one).collect::<Result<Vec<_>, _>>()?;
    if steps.is_empty() {
        let what = "`steps` is empty: give at least one {force_n} or {penetration_mm}";
        return Err(Failure::range("steps", what));
    }
    Ok(steps)
}

fn cells_from_args(args: &Args, steps: usize, friction: f64) -> Result<Cells, Failure> {
    let Some(table) = args.table("cells") else {
        return Err(Failure::new("missing_field", Some("cells"), "`cells` is missing"));
    };
    let (columns, rows) = (table.size("columns")?, table.size("rows")?);
    let cells = Cells { columns, rows, spacing_mm: table.number("spacing_mm")? };
    let count = columns * rows;
    if friction > 0.0 && count > FRICTION_CELLS_MAX {
        let what = format!("`cells`: {count} that rub; give at most {FRICTION_CELLS_MAX}");
        return Err(Failure::range("cells", what));
    }
    let most = if friction > 0.0 { FRICTION_WORK_MAX } else { WORK_MAX };
    if count.saturating_mul(steps) > most {
        let what =
            format!("`steps`: {steps} on {count} cells; give {most} cells times steps at most");
        return Err(Failure::range("steps", what));
    }
    Ok(cells)
}

/// The image model, with tables that reach as far as the array and the cells can be apart.
fn image_model(
    influence: &Influence,
    cells: &Cells,
    (array, sampling): (Array, Sampling),
) -> Result<(ImageModel, Fineness), Failure> {
    array.check().map_err(|invalid| failure(&invalid))?;
    let [x, y] = array.half_sides_mm();
    let half = |count: usize| 0.5 * count as f64 * cells.spacing_mm;
    let apart_mm = (x + half(cells.columns)).max(y + half(cells.rows)) + 2.0 * array.pitch_mm;
    let reach = Fineness::DEFAULT.reach.min(apart_mm / influence.spread_mm());
    let fineness = Fineness { reach, ..Fineness::DEFAULT };
    let normal =
        Shares::new(influence, &array, sampling, fineness).map_err(|i| array_failure(&i))?;
    Ok((ImageModel { array, sampling, normal, shear_shares: None }, fineness))
}

fn contact_path_3d(args: &Args) -> Result<Answer, Failure> {
    let stack = layers_from_args(args)?;
    let steps = steps_from_args(args, force_min_n(&stack))?;
    let friction = args.number("friction")?;
    let cells = cells_from_args(args, steps.len(), friction)?;
    let body = Body::from_args(args, &cells)?;
    let refused = |invalid: Invalid| failure(&invalid);
    let influence = Influence::of_stack(&stack).map_err(refused)?;
    let surface = Surface::new(&influence, &cells).map_err(|invalid| cells_failure(&invalid))?;
    let (seen, fineness) = image_model(&influence, &cells, array_from_args(args)?)?;
    let (solver, seen) = if friction == 0.0 {
        (Solver::Frictionless(Box::new(surface)), seen)
    } else {
        let shear = Shear::of_stack(&stack).map_err(refused)?;
        let grip = Grip::new(surface, &shear, friction).map_err(refused)?;
        (Solver::Frictional(Box::new(grip)), seen.with_shear(&shear, fineness)?)
    };
    let walked = args.timed(|| follow_path(solver.clone(), body.clone(), &cells, &steps));
    let (solver, states) = walked?;
    let mut image = seen.image(&solver).map_err(refused)?;
    let features = features_as_json(&seen.array, &image).map_err(refused)?;
    if args.choice("part")? == "compressive" {
        Part::Compressive.apply_to(&mut image);
    }
    let mut out = Answer::new();
    out.number_list("image", &image);
    out.value("features", features);
    push_states(&mut out, &states);
    if args.choice("show")? == "cells" {
        out.number_list("pressure_mpa", solver.pressure());
        let none = vec![0.0; solver.pressure().len()];
        let traction = match &solver {
            Solver::Frictional(grip) => grip.traction_mpa(),
            Solver::Frictionless(_) => [none.as_slice(); 2],
        };
        out.number_rows("traction_mpa", traction);
    }
    Ok(out)
}

/// Follows the steps of the path.
fn follow_path(
    mut solver: Solver,
    mut body: Body,
    cells: &Cells,
    steps: &[(Prescribed, BodyMotion)],
) -> Result<(Solver, Vec<GripState>), Failure> {
    let mut states: Vec<GripState> = Vec::with_capacity(steps.len());
    for (i, (drive, carry)) in steps.iter().enumerate() {
        body.carry(carry);
        let heights = body.heights(cells).map_err(|failure| step_failure(i, failure))?;
        // A body that does not touch moves without a contact solution.
        let touched = states.last().is_some_and(|state| state.pressed.force_n > 0.0);
        let carry = if touched { *carry } else { BodyMotion::default() };
        let step = solver.step(&heights, &(*drive, carry));
        let mut state = step.map_err(|invalid| step_failure(i, cells_failure(&invalid)))?;
        if let Prescribed::PenetrationMm(wanted) = drive {
            state.pressed.penetration_mm = *wanted;
        }
        states.push(state);
    }
    Ok((solver, states))
}

/// Adds the results of every step.
fn push_states(out: &mut Answer, states: &[GripState]) {
    let mut list = |name, of: fn(&GripState) -> f64| {
        let values: Vec<f64> = states.iter().map(of).collect();
        out.number_list(name, &values);
    };
    list("force_n", |state| state.pressed.force_n);
    list("torque_n_mm", |state| state.torque_n_mm);
    list("delta_mm", |state| state.pressed.penetration_mm);
    list("stick_area_mm2", |state| state.area_mm2[0]);
    list("slip_area_mm2", |state| state.area_mm2[1]);
    list("residual", |state| state.residual.max(state.pressed.residual));
    out.number_rows("along_n", states.iter().map(|state| &state.force_n));
}

fn failure(invalid: &Invalid) -> Failure {
    failure_at(&invalid.place, invalid)
}

/// The failure of an array that is incompatible with the layers.
fn array_failure(invalid: &Invalid) -> Failure {
    let field = if invalid.place == "thickness_mm" { "layers" } else { invalid.place.as_str() };
    let what = format!(
        "`{field}`: {}; give tactels nearer to the thickness, or layers less unlike each other",
        invalid.what
    );
    Failure::range(field, what)
}

fn failure_at(field: &str, invalid: &Invalid) -> Failure {
    Failure::range(field, format!("`{field}`: {}; {}", invalid.what, invalid.remedy))
}

/// The failure of a grid of cells, under the fields of the request.
fn cells_failure(invalid: &Invalid) -> Failure {
    let field = match invalid.place.as_str() {
        inner @ ("columns" | "rows" | "spacing_mm") => format!("cells.{inner}"),
        other => other.to_owned(),
    };
    failure_at(&field, invalid)
}

/// The failure with the number of the step.
fn step_failure(i: usize, failure: Failure) -> Failure {
    let Failure { code, field, message } = failure;
    let field = match field.as_deref() {
        Some(inner @ ("force_n" | "penetration_mm" | "dx_mm" | "dy_mm" | "turn_rad")) => {
            Some(format!("steps[{i}].{inner}"))
        }
        _ => field,
    };
    Failure { code, field, message: format!("step {i}: {message}") }
}
