//! The ways in which `contact_2d` solves: a line load in closed form, the spectral solver, growth
//! without slip, and the general solver on cells or on finite elements. Refuses combinations that
//! none of them knows.

use taktil_mechanics::contact::Invalid;
use taktil_mechanics::contact::fem::{Elements, Kind, Mesh};
use taktil_mechanics::contact::layer::Layer;
use taktil_mechanics::contact::plane::bed::Bed;
use taktil_mechanics::contact::plane::grip::{Drive, Grip, Law, Status};
use taktil_mechanics::contact::plane::noslip::{NoSlip, NoSlipRefusal};
use taktil_mechanics::contact::plane::{
    Contact, Friction, Indenter, Level, Load, Mode, PointForce, Refusal, Shape,
};

use super::field::Failure;
use super::nodes::Nodes;
use super::plane::{Indented, Prescribed, prescribed, shape_of};
use super::request::Args;

/// How far before the wanted load the contact stands from which a warm solution starts.
const NEIGHBOUR: f64 = 1.01;
/// Width of the finite element layer.
const WIDTH_MM: f64 = 25.4;
/// Steps of a path with stick.
const STEPS: u32 = 16;

/// What every way of solving hands to the answer.
pub(super) struct Solved {
    pub(super) contact: Contact,
    /// Whether `delta_mm` means anything.
    pub(super) descends: bool,
    pub(super) stress: Stress,
    pub(super) pressure: Vec<Option<f64>>,
    /// Whether the stress is even in x.
    pub(super) symmetric: bool,
    pub(super) held: Held,
}

/// What was solved, to be moved on.
pub(super) enum Held {
    /// A line load, or nothing.
    Line,
    Spectral(Box<Indenter>),
    Glued(Box<NoSlip>, Shape),
    Cells(Box<Grip>, Law),
    Mesh(Box<(Grip, Elements)>, Law),
    /// A line load on elements.
    MeshLine,
}

/// Where the stress comes from.
pub(super) enum Stress {
    Points(Vec<PointForce>),
    Nodes(Nodes),
}

pub(super) fn failure(invalid: &Invalid) -> Failure {
    let field = match invalid.place.as_str() {
        "thickness_mm" => "t_mm",
        "poisson" => "nu",
        "width_mm" => "shape.flat.width_mm",
        "height_mm" => "shape.flat.height_mm",
        "radius_mm" => "shape.cylinder.radius_mm",
        "coulomb" => "friction.coulomb",
        "edges_mm" => "shape",
        other => other,
    };
    Failure::range(field, format!("`{field}`: {}; {}", invalid.what, invalid.remedy))
}

pub(super) fn refused(refusal: Refusal) -> Failure {
    let code = match refusal {
        Refusal::Topples => "topples",
        Refusal::Slides => "slides",
        Refusal::Pulls | Refusal::NotFinite => "out_of_range",
        Refusal::TooWide | Refusal::OffChart => "unreachable",
        Refusal::Unsettled | Refusal::Tears => "unsettled",
    };
    Failure::new(code, Some("load"), refusal.to_string())
}

pub(super) fn solve(
    args: &Args,
    layer: &Layer,
    depth: f64,
    x_mm: &[f64],
) -> Result<Solved, Failure> {
    let (drive, shape) = (prescribed(args)?, shape_of(args)?);
    let law = match args.table("friction") {
        Some(table) => Some(Law::Coulomb(table.number("coulomb")?)),
        None => None,
    };
    let text = if law.is_none() { args.choice("friction")? } else { "coulomb" };
    if args.choice("method")? == "fem" {
        return elements(args, layer, depth, x_mm, &shape, drive);
    }
    match (shape, text) {
        (Indented::Knife, _) => knife(drive, x_mm),
        (Indented::Rigid(shape @ (Shape::Cylinder { .. } | Shape::Parabola { .. })), "stick") => {
            no_slip(args, layer, shape, drive, x_mm)
        }
        (Indented::Rigid(shape), "prop") => {
            let friction = Friction::Proportional;
            Spectral { args, layer, shape, friction, drive }.solve(depth, x_mm)
        }
        (Indented::Rigid(shape), "none") => {
            Spectral { args, layer, shape, friction: Friction::None, drive }.solve(depth, x_mm)
        }
        (shape, _) => cells(args, layer, x_mm, &shape, drive),
    }
}

fn knife(drive: Prescribed, x_mm: &[f64]) -> Result<Solved, Failure> {
    let Prescribed::Load(load) = drive else {
        let what = "a knife edge goes down by an infinite length under any load: give `load`";
        return Err(Failure::new("unreachable", Some("move"), what));
    };
    if load.p_n_mm < 0.0 || (load.p_n_mm == 0.0 && load.q_n_mm != 0.0) {
        return Err(refused(Refusal::Pulls));
    }
    let mode = if load.p_n_mm > 0.0 { Mode::Full } else { Mode::Open };
    let forces = vec![[0.0, load.p_n_mm, load.q_n_mm]];
    Ok(Solved {
        contact: plain(load.p_n_mm, load.q_n_mm, mode),
        descends: false,
        stress: Stress::Points(forces),
        pressure: x_mm.iter().map(|x| (*x != 0.0).then_some(0.0)).collect(),
        symmetric: load.q_n_mm == 0.0,
        held: Held::Line,
    })
}

fn plain(p_n_mm: f64, q_n_mm: f64, mode: Mode) -> Contact {
    Contact {
        p_n_mm,
        q_n_mm,
        delta_mm: 0.0,
        slope: 0.0,
        x_left_mm: 0.0,
        x_right_mm: 0.0,
        mode,
        residual: 0.0,
    }
}

fn level_of(args: &Args) -> Result<Level, Failure> {
    Ok(match args.choice("level")? {
        "fast" => Level::Fast,
        "fine" => Level::Fine,
        _ => Level::Default,
    })
}

struct Spectral<'a> {
    args: &'a Args,
    layer: &'a Layer,
    shape: Shape,
    friction: Friction,
    drive: Prescribed,
}

impl Spectral<'_> {
    fn solve(&self, depth: f64, x_mm: &[f64]) -> Result<Solved, Failure> {
        let Self { args, layer, shape, friction, drive } = *self;
        if let Prescribed::Move { dx, .. } = drive
            && (friction == Friction::Proportional || dx != 0.0)
        {
            let what = "a tangential move needs \"stick\" or {\"coulomb\"}, \"prop\" a `load`";
            return Err(Failure::new("unreachable", Some("move"), what));
        }
        let mut indenter = Indenter::new(layer, shape, friction, level_of(args)?)
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
            // What the neighbour refuses, the contact itself will say.
            if warm && run(indenter, NEIGHBOUR).is_err() {
                indenter.forget();
            }
        };
        let solution = args.timed_after(&mut indenter, prepare, |indenter| run(indenter, 1.0));
        let contact = solution.map_err(refused)?;
        let pressure = |x: &f64| Some(indenter.pressure_mpa(*x)).filter(|p| p.is_finite());
        Ok(Solved {
            contact,
            descends: true,
            stress: Stress::Points(indenter.point_forces(depth)),
            pressure: x_mm.iter().map(pressure).collect(),
            symmetric: contact.q_n_mm == 0.0,
            held: Held::Spectral(Box::new(indenter)),
        })
    }
}

fn no_slip(
    args: &Args,
    layer: &Layer,
    shape: Shape,
    drive: Prescribed,
    x_mm: &[f64],
) -> Result<Solved, Failure> {
    let open = match drive {
        Prescribed::Load(load) => load == Load::default(),
        Prescribed::Move { dz, .. } => dz <= 0.0,
    };
    if open {
        return Ok(Solved {
            contact: plain(0.0, 0.0, Mode::Open),
            descends: true,
            stress: Stress::Points(Vec::new()),
            pressure: vec![Some(0.0); x_mm.len()],
            symmetric: true,
            held: Held::Line,
        });
    }
    let grown = args.timed(|| match drive {
        Prescribed::Load(load) => NoSlip::press(layer, shape, load.p_n_mm),
        Prescribed::Move { dz, .. } => NoSlip::descend(layer, shape, dz),
    });
    let held = grown.map_err(|error| match error {
        NoSlipRefusal::Invalid(invalid) => failure(&invalid),
        NoSlipRefusal::Refusal(refusal) => refused(refusal),
        NoSlipRefusal::Flat => Failure::new("internal", Some("shape"), "a bar does not grow"),
    })?;
    let dx = match drive {
        Prescribed::Load(load) => load.q_n_mm / held.tangential_n_mm2,
        Prescribed::Move { dx, .. } => dx,
    };
    let contact = Contact {
        delta_mm: held.delta_mm,
        x_left_mm: -held.half_width_mm,
        x_right_mm: held.half_width_mm,
        ..plain(held.p_n_mm, dx * held.tangential_n_mm2, Mode::Free)
    };
    Ok(Solved {
        contact,
        descends: true,
        stress: Stress::Points(held.point_forces(dx)),
        pressure: vec![None; x_mm.len()],
        symmetric: dx == 0.0,
        held: Held::Glued(Box::new(held), shape),
    })
}

/// The law that the general solver takes.
fn law_of(args: &Args, drive: Prescribed) -> Result<Law, Failure> {
    if let Some(table) = args.table("friction") {
        return Ok(Law::Coulomb(table.number("coulomb")?));
    }
    Ok(match (args.choice("friction")?, drive) {
        ("stick", _) => Law::Coulomb(f64::INFINITY),
        ("prop", Prescribed::Load(load)) if load.p_n_mm > 0.0 => {
            Law::Proportional(load.q_n_mm / load.p_n_mm)
        }
        _ => Law::Free,
    })
}

/// The profile over a place.
fn height(shape: &Indented, x: f64) -> f64 {
    match shape {
        Indented::Knife => f64::INFINITY,
        Indented::Rigid(Shape::Flat { width_mm, .. }) => {
            if x.abs() <= 0.5 * width_mm * (1.0 + 1e-9) { 0.0 } else { f64::INFINITY }
        }
        Indented::Rigid(Shape::Cylinder { radius_mm: r }) => {
            if x.abs() < *r {
                x * x / (r + (r * r - x * x).sqrt())
            } else {
                f64::INFINITY
            }
        }
        Indented::Rigid(Shape::Parabola { radius_mm }) => 0.5 * x * x / radius_mm,
        Indented::Profile(places, heights) => {
            let lowest = heights.iter().copied().fold(f64::INFINITY, f64::min);
            let right = places.partition_point(|place| *place < x);
            match right {
                0 if places[0] == x => heights[0] - lowest,
                0 => f64::INFINITY,
                _ if right == places.len() => f64::INFINITY,
                _ => {
                    let s = (x - places[right - 1]) / (places[right] - places[right - 1]);
                    heights[right - 1] * (1.0 - s) + heights[right] * s - lowest
                }
            }
        }
    }
}

/// Edges of the cells on the exact layer.
fn edges(
    args: &Args,
    layer: &Layer,
    shape: &Indented,
    drive: Prescribed,
) -> Result<Vec<f64>, Failure> {
    let n: u32 = match level_of(args)? {
        Level::Fast => 48,
        Level::Default => 96,
        Level::Fine => 192,
    };
    let part = |i: u32| f64::from(i) / f64::from(n);
    let (low, high) = match shape {
        Indented::Rigid(Shape::Flat { width_mm, .. }) => {
            // Gathered at the corners.
            let angle = |i: u32| core::f64::consts::PI * part(i);
            return Ok((0..=n).map(|i| -0.5 * width_mm * libm::cos(angle(i))).collect());
        }
        Indented::Profile(x, _) => (x[0], x[x.len() - 1]),
        Indented::Rigid(shape) => {
            let mut free = Indenter::new(layer, *shape, Friction::None, Level::Default)
                .map_err(|invalid| failure(&invalid))?;
            let contact = match drive {
                Prescribed::Load(Load { p_n_mm, .. }) => free.press(&Load { p_n_mm, q_n_mm: 0.0 }),
                Prescribed::Move { dz, .. } => free.descend(dz),
            };
            let half = 1.1 * contact.map_err(refused)?.x_right_mm.max(1e-3);
            (-half, half)
        }
        Indented::Knife => (-1.0, 1.0),
    };
    Ok((0..=n).map(|i| low + (high - low) * part(i)).collect())
}

/// Follows the path to the load or the move.
fn follow(
    args: &Args,
    grip: &mut Grip,
    shape: &Indented,
    law: Law,
    drive: Prescribed,
) -> Result<(), Failure> {
    let steps = if matches!(law, Law::Coulomb(_)) { STEPS } else { 1 };
    let target = |f: f64| match (drive, shape) {
        (Prescribed::Load(load), shape) => {
            let load = Load { p_n_mm: f * load.p_n_mm, q_n_mm: f * load.q_n_mm };
            match shape {
                Indented::Rigid(Shape::Flat { height_mm, .. }) => {
                    Drive::Loads { load, height_mm: *height_mm }
                }
                _ => Drive::Upright(load),
            }
        }
        (Prescribed::Move { dz, dx }, _) => {
            // Down first, then along.
            Drive::Move { dz_mm: dz * (2.0 * f).min(1.0), dx_mm: dx * (2.0 * f - 1.0).max(0.0) }
        }
    };
    let fresh = grip.clone();
    args.timed(|| {
        *grip = fresh.clone();
        (1..=steps).try_for_each(|k| grip.step(&target(f64::from(k) / f64::from(steps))))
    })
    .map_err(refused)
}

fn gripped(
    args: &Args,
    bed: Bed,
    shape: &Indented,
    drive: Prescribed,
) -> Result<(Grip, Contact), Failure> {
    let law = law_of(args, drive)?;
    let heights = bed.x_mm.iter().map(|x| height(shape, *x)).collect();
    let mut grip = Grip::new(bed, heights, law).map_err(|invalid| failure(&invalid))?;
    follow(args, &mut grip, shape, law, drive)?;
    let bed = grip.bed();
    let touching = |i: &usize| grip.status()[*i] != Status::Apart;
    let under = |i: &usize| height(shape, bed.x_mm[*i]).is_finite();
    let (first, last) = ((0..bed.count()).find(touching), (0..bed.count()).rev().find(touching));
    let ends = ((0..bed.count()).find(under), (0..bed.count()).rev().find(under));
    let flat = matches!(shape, Indented::Rigid(Shape::Flat { .. }));
    let mode = match (first, first == ends.0, last == ends.1) {
        (None, ..) => Mode::Open,
        _ if !flat => Mode::Free,
        (_, true, true) => Mode::Full,
        (_, false, true) => Mode::Left,
        (_, true, false) => Mode::Right,
        _ => Mode::Free,
    };
    let [delta_mm, slope, _] = grip.rigid();
    let load = grip.load();
    // Without a law along x the load Q is taken by its moment alone.
    let q = match (law_of(args, drive)?, drive) {
        (Law::Free, Prescribed::Load(wanted)) => wanted.q_n_mm,
        _ => load.q_n_mm,
    };
    let edge =
        |i: Option<usize>, side: f64| i.map_or(0.0, |i| bed.x_mm[i] + side * 0.5 * bed.width_mm[i]);
    let contact = Contact {
        delta_mm,
        slope,
        x_left_mm: edge(first, -1.0),
        x_right_mm: edge(last, 1.0),
        residual: grip.residual(),
        ..plain(load.p_n_mm, q, mode)
    };
    Ok((grip, contact))
}

/// Pressure of the place nearest to each x, over what it stands for.
fn pressures(grip: &Grip, x_mm: &[f64]) -> Vec<Option<f64>> {
    let bed = grip.bed();
    let at = |x: &f64| {
        let inside = |i: &usize| (x - bed.x_mm[*i]).abs() <= 0.5 * bed.width_mm[*i];
        let i = (0..bed.count()).find(inside);
        Some(i.map_or(0.0, |i| grip.normal_n_mm()[i] / bed.width_mm[i]))
    };
    x_mm.iter().map(at).collect()
}

fn cells(
    args: &Args,
    layer: &Layer,
    x_mm: &[f64],
    shape: &Indented,
    drive: Prescribed,
) -> Result<Solved, Failure> {
    let edges = edges(args, layer, shape, drive)?;
    let bed = Bed::of_layer(layer, &edges).map_err(|invalid| failure(&invalid))?;
    let (grip, contact) = gripped(args, bed, shape, drive)?;
    let places = grip.bed().x_mm.iter().zip(grip.normal_n_mm()).zip(grip.tangential_n_mm());
    let forces = places.map(|((x, p), q)| [*x, *p, *q]).collect();
    Ok(Solved {
        contact,
        descends: true,
        stress: Stress::Points(forces),
        pressure: pressures(&grip, x_mm),
        symmetric: false,
        held: Held::Cells(Box::new(grip), law_of(args, drive)?),
    })
}

fn elements(
    args: &Args,
    layer: &Layer,
    depth: f64,
    x_mm: &[f64],
    shape: &Indented,
    drive: Prescribed,
) -> Result<Solved, Failure> {
    if depth != layer.thickness_mm {
        let what = "`fem` knows szz at the base alone: leave `depth_mm` out";
        return Err(Failure::range("depth_mm", what));
    }
    let [nx, nz] = args.array::<2>("mesh")?;
    let whole = |n: f64| (1.0..=2048.0).contains(&n) && n == n.floor();
    if !(whole(nx) && whole(nz)) || nx * nz > 100_000.0 {
        let what =
            format!("`mesh` is [{nx}, {nz}]; wanted: whole numbers, at most 100000 elements");
        return Err(Failure::range("mesh", what));
    }
    let body = Mesh::uniform(WIDTH_MM, layer.thickness_mm, nx as usize, nz as usize)
        .and_then(|mesh| Elements::new(layer, mesh, Kind::MeanDilatation))
        .map_err(|invalid| failure(&invalid))?;
    let places = body.mesh().row_mm(nz as usize);
    let mut grip = None;
    let (contact, normal, tangential, pressure) = if let Indented::Knife = shape {
        let solved = knife(drive, x_mm)?;
        let (mut p, mut q) = (vec![0.0; places.len()], vec![0.0; places.len()]);
        // The load on the node in the middle, or shared by the two beside it.
        let nearest = places.iter().fold(f64::INFINITY, |least, x| least.min(x.abs()));
        let beside = |x: &&f64| x.abs() < nearest + 1e-9;
        let share = 1.0 / places.iter().filter(beside).count() as f64;
        for (i, _) in places.iter().enumerate().filter(|(_, x)| beside(x)) {
            (p[i], q[i]) = (share * solved.contact.p_n_mm, share * solved.contact.q_n_mm);
        }
        (solved.contact, p, q, solved.pressure)
    } else {
        let bed = body.bed().map_err(|invalid| failure(&invalid))?;
        let (solved, contact) = gripped(args, bed, shape, drive)?;
        let pressure = pressures(&solved, x_mm);
        let (p, q) = (solved.normal_n_mm().to_vec(), solved.tangential_n_mm().to_vec());
        grip = Some(solved);
        (contact, p, q, pressure)
    };
    let nodes = base(&body, &normal, &tangential)?;
    let descends = !matches!(shape, Indented::Knife);
    let held = match grip {
        Some(grip) => Held::Mesh(Box::new((grip, body)), law_of(args, drive)?),
        None => Held::MeshLine,
    };
    Ok(Solved { contact, descends, stress: Stress::Nodes(nodes), pressure, symmetric: false, held })
}

/// Base stress of forces on the surface of a mesh.
pub(super) fn base(body: &Elements, p: &[f64], q: &[f64]) -> Result<Nodes, Failure> {
    let response = body.under(p, q).map_err(|invalid| failure(&invalid))?;
    let szz = body.base_szz_mpa(&response);
    Ok(Nodes { x: body.mesh().row_mm(0), width: body.mesh().widths_mm(0), szz })
}
