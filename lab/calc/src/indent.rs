//! The methods by which `contact_2d` solves: a line load in closed form, the spectral solver,
//! growth of the contact without slip, and the general solver on cells or on finite elements. A
//! combination that no method supports, and a request that states one quantity twice, are errors.

use taktil_contact::layer::Layer;
use taktil_contact::plane::frictional::FrictionLaw;
use taktil_contact::plane::noslip::{NoSlip, NoSlipError};
use taktil_contact::plane::{Contact, Friction, Indenter, LOAD_MIN, Load, Mode, Refusal, Shape};

use super::cells::solve_on_cells;
use super::field::Failure;
use super::indenter::{IndenterShape, Prescribed, prescribed_from_args, shape_from_args};
use super::meshed;
use super::refusal::{SPLIT_CONTACT_CODE, failure, refusal_failure};
use super::request::{Args, format_count};
use super::solved::{
    ContactSolution, SolverState, StressSource, contact_without_motion, level_from_args,
    solve_knife,
};

/// Ratio of the starting contact of a warm start to the requested one.
const WARM_START_FACTOR: f64 = 1.01;
/// Largest move, mm.
const MOVE_MAX_MM: f64 = 1e30;
/// Largest slope of a bar to which small strain applies: at this slope its corner penetrates by the
/// bar's width.
const BAR_SLOPE_MAX: f64 = 1.0;
/// Notes that `--list` prints below the fields of `contact_2d`.
pub(super) const NOTES: &[&str] = &[
    "`level` is read with `method` \"layer\" alone, `mesh` with \"fem\" alone.",
    "`mesh` is [along, down]: along 2 to 512, down 1 to 512, and along x along x down x the lesser \
     of both at most 268435456 ([512, 32]), which is some seconds of work. On it a contact is \
     known to a node: its edges lie midway between nodes, at most at the ends of the face and of \
     the layer. It knows szz at the base alone.",
    "\"stick\" and {coulomb} follow a path of 64 steps, a `move` along x goes down in the first 32 \
     of them and along in the others. A place that sticks keeps what the surface had moved when a \
     step first found it touching, so the answer depends on the steps: a load turned into its \
     `delta_mm` and back is up to 0.3 % off on the mesh [64, 4] and on finer ones.",
    "A `move` along x needs \"stick\" or {coulomb}; \"prop\" needs a `load`.",
];

/// Solves the request; the number of cells, or of elements along each side, is halved `halved`
/// times.
pub(super) fn solve(
    args: &Args,
    layer: &Layer,
    depth: f64,
    x_mm: &[f64],
    halved: u32,
) -> Result<ContactSolution, Failure> {
    refuse_ambiguity(args)?;
    let (drive, shape) = (prescribed_from_args(args)?, shape_from_args(args)?);
    let law = match args.table("friction") {
        Some(table) => Some(FrictionLaw::Coulomb(table.number("coulomb")?)),
        None => None,
    };
    let named = |failure| with_field_name(drive, failure);
    let text = if law.is_none() { args.choice("friction")? } else { "coulomb" };
    refuse_uncarried_load(&shape, text, drive)?;
    if let (Prescribed::Move { dx, .. }, IndenterShape::Rigid(_) | IndenterShape::Profile(..)) =
        (drive, &shape)
        && (text == "prop" || (text == "none" && dx != 0.0))
    {
        let what = "`move`: a tangential move needs \"stick\" or {\"coulomb\"}, \"prop\" a `load`";
        return Err(Failure::new("unreachable", Some("move"), what));
    }
    if args.choice("method")? == "fem" {
        let solved = meshed::solve_on_elements(args, (layer, depth), x_mm, &shape, drive, halved);
        return solved.and_then(|solved| refuse_excess_depth(layer, solved)).map_err(named);
    }
    let solved = match (shape, text) {
        (IndenterShape::Knife, _) => solve_knife(drive, x_mm),
        (
            IndenterShape::Rigid(shape @ (Shape::Cylinder { .. } | Shape::Parabola { .. })),
            "stick",
        ) => solve_no_slip(args, layer, shape, drive, x_mm),
        (IndenterShape::Rigid(shape), "prop") => {
            let friction = Friction::Proportional;
            match (SpectralProblem { args, layer, shape, friction, drive }.solve(depth, x_mm)) {
                // A contact in two pieces is left to the solver on cells.
                Err(parted) if parted.code == SPLIT_CONTACT_CODE => {
                    solve_on_cells(args, layer, x_mm, &IndenterShape::Rigid(shape), drive, halved)
                }
                solved => solved,
            }
        }
        (IndenterShape::Rigid(shape), "none") => {
            SpectralProblem { args, layer, shape, friction: Friction::None, drive }
                .solve(depth, x_mm)
        }
        (shape, _) => solve_on_cells(args, layer, x_mm, &shape, drive, halved),
    };
    let solved = solved.and_then(|solved| refuse_excess_depth(layer, solved)).map_err(named)?;
    refuse_unresolved_depth(depth, &solved)?;
    Ok(solved)
}

/// A load along x without a reaction is an error. Without friction a bar still takes the moment of
/// the load; a round indenter, or a profile that is held upright, takes nothing.
fn refuse_uncarried_load(
    shape: &IndenterShape,
    friction: &str,
    drive: Prescribed,
) -> Result<(), Failure> {
    let Prescribed::Load(Load { q_n_mm, .. }) = drive else { return Ok(()) };
    let feels = matches!(shape, IndenterShape::Knife | IndenterShape::Rigid(Shape::Flat { .. }));
    if friction != "none" || feels || q_n_mm == 0.0 {
        return Ok(());
    }
    let what = format!(
        "`load.q_n_mm` is {q_n_mm}, and without `friction` a cylinder or a profile carries none: \
         leave it out, or give \"prop\", \"stick\" or {{\"coulomb\"}}"
    );
    Err(Failure::new("slides", Some("load.q_n_mm"), what))
}

/// Both a load and a move, and a profile whose positions do not ascend, are errors.
fn refuse_ambiguity(args: &Args) -> Result<(), Failure> {
    if args.has("load") && args.has("move") {
        let what = "`load` and `move` are both given: leave one of them out";
        return Err(Failure::new("conflict", Some("load"), what));
    }
    let Some(profile) = args.table("shape").and_then(|shape| shape.table("profile")) else {
        return Ok(());
    };
    let x = profile.numbers("x_mm")?;
    let Some(i) = x.windows(2).position(|pair| pair[0] >= pair[1]) else { return Ok(()) };
    let field = format!("shape.profile.x_mm[{}]", i + 1);
    let what = format!(
        "`{field}` is {:?}, after {:?}: sort the places, each once, with their `z_mm`",
        x[i + 1],
        x[i]
    );
    Err(Failure::new("not_ascending", Some(&field), what))
}

/// A solver's message names the load; when the request gave a move, the message names the move
/// instead.
fn with_field_name(drive: Prescribed, failure: Failure) -> Failure {
    let field = match (drive, failure.field) {
        (Prescribed::Move { .. }, Some(field)) if field == "load" => Some("move".to_owned()),
        (_, field) => field,
    };
    let told = field.as_ref().is_none_or(|f| failure.message.contains(&format!("`{f}`")));
    let name = field.as_ref().filter(|_| !told).map(|field| format!("`{field}`: "));
    let message = format!("{}{}", name.unwrap_or_default(), failure.message);
    Failure { code: failure.code, field, message }
}

/// A depth so small that the stress shows the discretisation of the traction is an error.
fn refuse_unresolved_depth(depth: f64, solved: &ContactSolution) -> Result<(), Failure> {
    if depth < solved.shallowest_mm {
        let what = format!(
            "`depth_mm` is {depth:?}; the points of this contact are told apart above {:?}: give \
             more, or read `pressure`",
            solved.shallowest_mm
        );
        return Err(Failure::range("depth_mm", what));
    }
    Ok(())
}

/// The contact, or an error when the indenter would reach the base or a bar would lean down to it.
fn refuse_excess_depth(layer: &Layer, solved: ContactSolution) -> Result<ContactSolution, Failure> {
    let Contact { delta_mm, slope, x_left_mm, x_right_mm, .. } = solved.contact;
    let deepest = delta_mm + slope.abs() * x_left_mm.abs().max(x_right_mm.abs());
    if slope.abs() >= BAR_SLOPE_MAX {
        let what = format!(
            "the bar would lean on its corner with a slope of {slope:.3}, and small strain means \
             far less than {BAR_SLOPE_MAX}: take less Q, or a lower bar"
        );
        return Err(Failure::new("unreachable", Some("load"), what));
    }
    if !solved.descends || deepest < layer.thickness_mm {
        return Ok(solved);
    }
    let what = format!(
        "the indenter would go {} mm down in {} mm of rubber: press less",
        format_count(deepest),
        layer.thickness_mm
    );
    Err(Failure::new("unreachable", Some("load"), what))
}

struct SpectralProblem<'a> {
    args: &'a Args,
    layer: &'a Layer,
    shape: Shape,
    friction: Friction,
    drive: Prescribed,
}

impl SpectralProblem<'_> {
    fn solve(&self, depth: f64, x_mm: &[f64]) -> Result<ContactSolution, Failure> {
        let Self { args, layer, shape, friction, drive } = *self;
        let mut indenter = Indenter::new(layer, shape, friction, level_from_args(args)?)
            .map_err(|invalid| failure(&invalid))?;
        let run = |indenter: &mut Indenter, factor: f64| match drive {
            Prescribed::Load(Load { p_n_mm, q_n_mm }) => {
                let (p_n_mm, q_n_mm) = (factor * p_n_mm, factor * q_n_mm);
                indenter.press(&Load { p_n_mm, q_n_mm })
            }
            Prescribed::Move { dz, .. } => indenter.descend(factor * dz),
        };
        let warm = args.choice("start")? == "warm" && args.has("timing");
        let prepare = |indenter: &mut Indenter| {
            indenter.forget();
            // A failure of the neighbouring contact is ignored here; the contact itself reports it.
            if warm && run(indenter, WARM_START_FACTOR).is_err() {
                indenter.forget();
            }
        };
        let solution = args.timed_with_setup(&mut indenter, prepare, |indenter| run(indenter, 1.0));
        let contact = solution.map_err(refusal_failure)?;
        let pressure = |x: &f64| Some(indenter.pressure_mpa(*x)).filter(|p| p.is_finite());
        Ok(ContactSolution {
            contact,
            descends: true,
            stress: StressSource::Points(indenter.point_forces(depth)),
            pressure: x_mm.iter().map(pressure).collect(),
            shallowest_mm: indenter.shallowest_mm(),
            symmetric: contact.q_n_mm == 0.0,
            pull_n_mm: 0.0,
            solver_state: SolverState::Spectral(Box::new(indenter)),
        })
    }
}

fn solve_no_slip(
    args: &Args,
    layer: &Layer,
    shape: Shape,
    drive: Prescribed,
    x_mm: &[f64],
) -> Result<ContactSolution, Failure> {
    if let Prescribed::Move { dx, .. } = drive
        && dx.abs() > MOVE_MAX_MM
    {
        return Err(refusal_failure(Refusal::NotFinite));
    }
    let open = match drive {
        Prescribed::Load(load) => !load.is_pressing().map_err(refusal_failure)?,
        Prescribed::Move { dz, .. } => dz < LOAD_MIN,
    };
    if open {
        return Ok(ContactSolution {
            contact: contact_without_motion(0.0, 0.0, Mode::Open),
            descends: true,
            stress: StressSource::Points(Vec::new()),
            pressure: vec![Some(0.0); x_mm.len()],
            shallowest_mm: 0.0,
            symmetric: true,
            pull_n_mm: 0.0,
            solver_state: SolverState::Line,
        });
    }
    let grown = args.timed(|| match drive {
        Prescribed::Load(load) => NoSlip::press(layer, shape, load.p_n_mm),
        Prescribed::Move { dz, .. } => NoSlip::descend(layer, shape, dz),
    });
    let held = grown.map_err(|error| match error {
        NoSlipError::Invalid(invalid) => failure(&invalid),
        NoSlipError::Refusal(refusal) => refusal_failure(refusal),
        NoSlipError::Flat => Failure::new("internal", Some("shape"), "a bar does not grow"),
    })?;
    let dx = match drive {
        Prescribed::Load(load) => load.q_n_mm / held.tangential_n_mm2,
        Prescribed::Move { dx, .. } => dx,
    };
    let contact = Contact {
        delta_mm: held.delta_mm,
        x_left_mm: -held.half_width_mm,
        x_right_mm: held.half_width_mm,
        ..contact_without_motion(held.p_n_mm, dx * held.tangential_n_mm2, Mode::Free)
    };
    Ok(ContactSolution {
        contact,
        descends: true,
        stress: StressSource::Points(held.point_forces(dx)),
        pressure: vec![None; x_mm.len()],
        shallowest_mm: held.shallowest_mm(),
        symmetric: dx == 0.0,
        pull_n_mm: held.pull_n_mm(dx),
        solver_state: SolverState::Glued(Box::new(held), shape, dx),
    })
}
