//! Solves `contact_2d` at discrete points: any profile, with Coulomb's law or without slip, on
//! cells of the exact layer or on the nodes of a mesh. The cells cover the region in contact, not
//! the whole shape. The region is extended until the contact ends inside it. What the solver
//! reports as an error is an error here.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::plane::compliance::{CELLS_MAX, SurfaceCompliance};
use taktil_contact::plane::frictional::{ContactStatus, FrictionLaw, FrictionalContact, LoadStep};
use taktil_contact::plane::{Contact, Friction, Indenter, Load, Mode, Refusal, Shape};

use super::field::Failure;
use super::indenter::{IndenterShape, Prescribed};
use super::refusal::{failure, refusal_failure};
use super::request::Args;
use super::runs::{
    GAP_CELL_WIDTH_MAX, Runs, cell_edges, cells_over, is_cut, merge_runs, snapped_run,
    total_length, with_margins,
};
use super::solved::{
    ContactSolution, SolverState, StressSource, contact_without_motion, level_from_args,
};

/// Number of load steps of a path with stick.
const PATH_STEPS: u32 = 64;
/// Largest number of times that the cells are adapted to the contact.
const REFINEMENTS_MAX: usize = 12;
/// Smallest share of the cells that the contact with its margins covers: in the search without
/// stick, and in the final solution.
const COVERAGE_SHARES_MIN: [f64; 2] = [0.8, 0.5];
/// Length by which the cells are extended beside a contact that they cut off, as a share of its
/// length.
const EXTENSION_SHARE: f64 = 0.3;
/// Width of the first cells, as a multiple of the contact width of a round indenter without
/// friction.
const INITIAL_WIDTH_FACTOR: f64 = 1.15;
/// Widest cell in a contact, in thicknesses. The stress at the base does not distinguish the
/// pressure of narrower cells from a continuous one.
const CELL_WIDTH_MAX: f64 = 0.6;
/// How much wider than [`CELL_WIDTH_MAX`] the cells of a search may be.
const COARSE_CELL_FACTOR: f64 = 4.0;
/// Depth, in widths of a cell, from which on the stress does not show single cells.
const RESOLVED_DEPTH_FACTOR: f64 = 1.65;

/// The friction law that the general solver uses for this request.
pub(super) fn law_from_args(args: &Args, drive: Prescribed) -> Result<FrictionLaw, Failure> {
    if let Some(table) = args.table("friction") {
        return Ok(FrictionLaw::Coulomb(table.number("coulomb")?));
    }
    Ok(match (args.choice("friction")?, drive) {
        ("stick", _) => FrictionLaw::Coulomb(f64::INFINITY),
        ("prop", Prescribed::Load(load)) if load.p_n_mm > 0.0 => {
            FrictionLaw::Proportional(load.q_n_mm / load.p_n_mm)
        }
        _ => FrictionLaw::Free,
    })
}

/// Height of a profile's lowest point.
fn lowest_point(heights: &[f64]) -> f64 {
    heights.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Height of the profile at a position.
fn profile_height(shape: &IndenterShape, x: f64) -> f64 {
    match shape {
        IndenterShape::Knife => f64::INFINITY,
        IndenterShape::Rigid(Shape::Flat { width_mm, .. }) => {
            if x.abs() <= 0.5 * width_mm * (1.0 + 1e-9) { 0.0 } else { f64::INFINITY }
        }
        IndenterShape::Rigid(Shape::Cylinder { radius_mm: r }) => {
            if x.abs() < *r {
                x * x / (r + (r * r - x * x).sqrt())
            } else {
                f64::INFINITY
            }
        }
        IndenterShape::Rigid(Shape::Parabola { radius_mm }) => 0.5 * x * x / radius_mm,
        IndenterShape::Profile(places, heights) => {
            let lowest = lowest_point(heights);
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

/// Number of cells at the requested level, after it was halved `halved` times.
fn cell_count(args: &Args, halved: u32) -> Result<u32, Failure> {
    let cells = match level_from_args(args)? {
        Accuracy::Fast => 48,
        Accuracy::Default => 96,
        Accuracy::Fine => 192,
    };
    Ok(cells >> halved)
}

/// Lowest height of a shape between two positions, its kinks included.
fn lowest_height(shape: &IndenterShape, from: f64, to: f64) -> f64 {
    let ends = profile_height(shape, from).min(profile_height(shape, to));
    let IndenterShape::Profile(x, z) = shape else { return ends };
    let kinks = &z[x.partition_point(|x| *x < from)..x.partition_point(|x| *x < to)];
    let bottom = lowest_point(z);
    kinks.iter().fold(ends, |low, z| low.min(z - bottom))
}

/// The extent of the whole shape, and the part of it that is searched first for the contact.
fn search_window(
    layer: &Layer,
    shape: &IndenterShape,
    drive: Prescribed,
) -> Result<([f64; 2], Runs), Failure> {
    let IndenterShape::Profile(x, z) = shape else {
        let IndenterShape::Rigid(round) = shape else {
            return Ok(([-1.0, 1.0], vec![[-1.0, 1.0]]));
        };
        let mut free = Indenter::new(layer, *round, Friction::None, Accuracy::Default)
            .map_err(|invalid| failure(&invalid))?;
        let contact = match drive {
            Prescribed::Load(Load { p_n_mm, .. }) => free.press(&Load { p_n_mm, q_n_mm: 0.0 }),
            Prescribed::Move { dz, .. } => free.descend(dz),
        };
        let end = match round {
            Shape::Cylinder { radius_mm } => radius_mm * (1.0 - 1e-12),
            _ => f64::MAX,
        };
        let half = (INITIAL_WIDTH_FACTOR * contact.map_err(refusal_failure)?.x_right_mm.max(1e-3))
            .min(end);
        return Ok(([-end, end], vec![[-half, half]]));
    };
    let whole = [x[0], x[x.len() - 1]];
    if let Prescribed::Move { dz, .. } = drive {
        // The window holds the part below the surface and the bulge beside it.
        let bottom = lowest_point(z);
        let below = |i: &usize| z[*i].min(z[i + 1]) - bottom < dz;
        let pieces = 0..x.len() - 1;
        let reach = |i: usize| submerged_part(shape, &x[i..=i + 1], dz);
        if let (Some(first), Some(last)) = (pieces.clone().find(below), pieces.rev().find(below)) {
            let [from, to] = [reach(first)[0], reach(last)[1]];
            let run = snapped_run([from, to], 0.5 * (to - from) + layer.thickness_mm, whole);
            return Ok((whole, vec![run]));
        }
    }
    Ok((whole, vec![whole]))
}

/// The regions in contact under a law without stick, each with a margin, found in a single load
/// step.
fn runs_without_stick(
    layer: &Layer,
    shape: &IndenterShape,
    drive: Prescribed,
    law: FrictionLaw,
    n: u32,
    (whole, mut runs): ([f64; 2], Runs),
) -> Result<Runs, Failure> {
    for _ in 0..REFINEMENTS_MAX {
        // A profile that is far away is searched on coarse cells first.
        let even = total_length(&runs) / (0.9 * CELLS_MAX as f64 * layer.thickness_mm);
        let edges = cell_edges(
            &runs,
            n,
            layer.thickness_mm,
            even.clamp(CELL_WIDTH_MAX, COARSE_CELL_FACTOR * CELL_WIDTH_MAX),
        );
        let bed = bed_on_cells(layer, &edges)?;
        let heights = edges.windows(2).map(|w| lowest_height(shape, w[0], w[1])).collect();
        let mut grip =
            FrictionalContact::new(bed, heights, law).map_err(|invalid| failure(&invalid))?;
        grip.step(&partial_drive(drive, shape, 1.0)).map_err(refusal_failure)?;
        let next = with_margins(&touching_runs(&edges, grip.status()), &edges, whole);
        let within =
            |[from, to]: &[f64; 2]| runs.iter().any(|run| run[0] <= *from && *to <= run[1]);
        let fits = next.iter().all(within)
            && total_length(&next) >= COVERAGE_SHARES_MIN[0] * total_length(&runs);
        if next.is_empty() || fits {
            return Ok(runs);
        }
        runs = next;
    }
    Ok(runs)
}

/// The surface compliance of the cells; too many cells are an error.
fn bed_on_cells(layer: &Layer, edges: &[f64]) -> Result<SurfaceCompliance, Failure> {
    if edges.len() > CELLS_MAX + 1 {
        let what = format!(
            "`shape` would touch over more than {CELLS_MAX} cells of {CELL_WIDTH_MAX} thicknesses \
             or, where it leaves gaps, {GAP_CELL_WIDTH_MAX}: give a smaller one, press less, or \
             take a thicker layer"
        );
        return Err(Failure::range("shape", what));
    }
    SurfaceCompliance::of_layer(layer, edges).map_err(|invalid| failure(&invalid))
}

/// The part of a straight piece of the profile that is less than `dz` above the lowest point.
fn submerged_part(shape: &IndenterShape, piece: &[f64], dz: f64) -> [f64; 2] {
    let [a, b] = [profile_height(shape, piece[0]), profile_height(shape, piece[1])];
    let cut = piece[0] + (piece[1] - piece[0]) * ((dz - a) / (b - a));
    [if a < dz { piece[0] } else { cut }, if b < dz { piece[1] } else { cut }]
}

/// The regions in contact, as runs.
fn touching_runs(edges: &[f64], status: &[ContactStatus]) -> Runs {
    let mut bare: Runs = Vec::new();
    for (cell, _) in
        edges.windows(2).zip(status).filter(|(_, status)| **status != ContactStatus::Apart)
    {
        match bare.last_mut() {
            // Coarse cells alternate between contact and no contact, so short gaps are closed.
            Some(run) if cell[0] - run[1] <= 2.5 * (cell[1] - cell[0]) => run[1] = cell[1],
            _ => bare.push([cell[0], cell[1]]),
        }
    }
    bare
}

/// Edges of the cells under a bar, denser at its corners.
fn bar_edges(width_mm: f64, n: u32, layer: &Layer) -> Vec<f64> {
    let widest = CELL_WIDTH_MAX * layer.thickness_mm;
    let n = n.max(cells_over(0.5 * core::f64::consts::PI * width_mm, widest));
    let angle = |i: u32| core::f64::consts::PI * (f64::from(i) / f64::from(n));
    (0..=n).map(|i| -0.5 * width_mm * libm::cos(angle(i))).collect()
}

/// The load step at the fraction `f` of the way to the load or the move.
fn partial_drive(drive: Prescribed, shape: &IndenterShape, f: f64) -> LoadStep {
    match (drive, shape) {
        (Prescribed::Load(load), shape) => {
            let load = Load { p_n_mm: f * load.p_n_mm, q_n_mm: f * load.q_n_mm };
            match shape {
                IndenterShape::Rigid(Shape::Flat { height_mm, .. }) => {
                    LoadStep::Loads { load, height_mm: *height_mm }
                }
                _ => LoadStep::Upright(load),
            }
        }
        (Prescribed::Move { dz, dx: 0.0 }, _) => LoadStep::Move { dz_mm: dz * f, dx_mm: 0.0 },
        (Prescribed::Move { dz, dx }, _) => {
            // The descent comes first, the move along x after it.
            LoadStep::Move { dz_mm: dz * (2.0 * f).min(1.0), dx_mm: dx * (2.0 * f - 1.0).max(0.0) }
        }
    }
}

/// A bar that topples under the load, however it is supported, is an error.
fn refuse_toppling(shape: &IndenterShape, drive: Prescribed) -> Result<(), Failure> {
    let IndenterShape::Rigid(Shape::Flat { width_mm, height_mm }) = shape else { return Ok(()) };
    let Prescribed::Load(Load { p_n_mm: p, q_n_mm: q }) = drive else { return Ok(()) };
    if p > 0.0 && q.abs() * height_mm >= p * 0.5 * width_mm {
        return Err(refusal_failure(Refusal::Toppling));
    }
    Ok(())
}

/// The failure of a solution on cells. A bar that the solver reports as toppling does not topple in
/// theory: its load acts beyond the middle of the outermost cell.
fn place_failure(shape: &IndenterShape, refusal: Refusal) -> Failure {
    match (shape, refusal) {
        (IndenterShape::Rigid(Shape::Flat { .. }), Refusal::Toppling) => {
            refusal_failure(Refusal::OnLastNode)
        }
        _ => refusal_failure(refusal),
    }
}

/// Follows the path to the load or the move in steps.
fn follow_path(
    args: &Args,
    grip: &mut FrictionalContact,
    shape: &IndenterShape,
    law: FrictionLaw,
    drive: Prescribed,
) -> Result<(), Failure> {
    let steps = if matches!(law, FrictionLaw::Coulomb(_)) { PATH_STEPS } else { 1 };
    let fresh = grip.clone();
    args.timed(|| {
        *grip = fresh.clone();
        (1..=steps).try_for_each(|k| {
            grip.step(&partial_drive(drive, shape, f64::from(k) / f64::from(steps)))
        })
    })
    .map_err(|refusal| place_failure(shape, refusal))
}

/// The contact of a shape on a bed, with the features of its friction mode.
pub(super) fn solve_on_bed(
    args: &Args,
    bed: SurfaceCompliance,
    shape: &IndenterShape,
    drive: Prescribed,
) -> Result<(FrictionalContact, Contact), Failure> {
    let law = law_from_args(args, drive)?;
    let heights = bed.x_mm.iter().map(|x| profile_height(shape, *x)).collect();
    let mut grip =
        FrictionalContact::new(bed, heights, law).map_err(|invalid| failure(&invalid))?;
    refuse_toppling(shape, drive)?;
    follow_path(args, &mut grip, shape, law, drive)?;
    let bed = grip.compliance();
    let touching = |i: &usize| grip.status()[*i] != ContactStatus::Apart;
    let under = |i: &usize| profile_height(shape, bed.x_mm[*i]).is_finite();
    let (first, last) = ((0..bed.count()).find(touching), (0..bed.count()).rev().find(touching));
    let ends = ((0..bed.count()).find(under), (0..bed.count()).rev().find(under));
    let flat = matches!(shape, IndenterShape::Rigid(Shape::Flat { .. }));
    let mode = match (first, first == ends.0, last == ends.1) {
        (None, ..) => Mode::Open,
        _ if !flat => Mode::Free,
        (_, true, true) => Mode::Full,
        (_, false, true) => Mode::LeftLifted,
        (_, true, false) => Mode::RightLifted,
        _ => Mode::Free,
    };
    let [delta_mm, slope, _] = grip.rigid();
    let load = grip.load();
    // When the law takes no force along x, the load Q enters by its moment alone.
    let q = match (law_from_args(args, drive)?, drive) {
        (FrictionLaw::Free, Prescribed::Load(wanted)) => wanted.q_n_mm,
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
        ..contact_without_motion(load.p_n_mm, q, mode)
    };
    Ok((grip, contact))
}

/// Pressure at the cell or node nearest to each x: its force over the length that it represents.
pub(super) fn pressures(grip: &FrictionalContact, x_mm: &[f64]) -> Vec<Option<f64>> {
    let bed = grip.compliance();
    let at = |x: &f64| {
        let inside = |i: &usize| (x - bed.x_mm[*i]).abs() <= 0.5 * bed.width_mm[*i];
        let i = (0..bed.count()).find(inside);
        Some(i.map_or(0.0, |i| grip.normal_n_mm()[i] / bed.width_mm[i]))
    };
    x_mm.iter().map(at).collect()
}

/// The contact on the exact layer. The cells are extended over more of the shape until the contact
/// ends inside them, or at the end of the shape.
fn solve_on_adapted_cells(
    args: &Args,
    layer: &Layer,
    shape: &IndenterShape,
    drive: Prescribed,
    halved: u32,
) -> Result<(FrictionalContact, Contact), Failure> {
    let n = cell_count(args, halved)?;
    if let IndenterShape::Rigid(Shape::Flat { width_mm, .. }) = shape {
        return solve_on_bed(
            args,
            bed_on_cells(layer, &bar_edges(*width_mm, n, layer))?,
            shape,
            drive,
        );
    }
    let start = search_window(layer, shape, drive)?;
    let whole = start.0;
    let look = |law| runs_without_stick(layer, shape, drive, law, n, start.clone());
    let mut runs = match drive {
        // The search assumes slip everywhere; a contact with stick is smaller.
        Prescribed::Load(Load { p_n_mm: p, q_n_mm: q }) if p > 0.0 && q != 0.0 => {
            look(FrictionLaw::Proportional(q / p)).or_else(|_| look(FrictionLaw::Free))?
        }
        _ => look(FrictionLaw::Free)?,
    };
    let mut whole_one = None;
    for _ in 0..REFINEMENTS_MAX {
        let edges = cell_edges(&runs, n, layer.thickness_mm, CELL_WIDTH_MAX);
        let found = solve_on_bed(args, bed_on_cells(layer, &edges)?, shape, drive)?;
        let bare = touching_runs(&edges, found.0.status());
        let next = with_margins(&bare, &edges, whole);
        if is_cut(&bare, &runs, whole) {
            let more = next.iter().map(|[from, to]| {
                let more = EXTENSION_SHARE * (to - from);
                [(from - more).max(whole[0]), (to + more).min(whole[1])]
            });
            let wider = merge_runs(runs.iter().copied().chain(more).collect());
            if wider == runs {
                break;
            }
            runs = wider;
            continue;
        }
        // After a move along x, the contact may have passed cells outside the final region.
        let moved = matches!(drive, Prescribed::Move { .. });
        if next.is_empty()
            || moved
            || total_length(&next) >= COVERAGE_SHARES_MIN[1] * total_length(&runs)
        {
            return Ok(found);
        }
        (whole_one, runs) = (Some(found), next);
    }
    whole_one.ok_or_else(|| {
        let what = "the contact does not end inside the cells that it is solved on, however wide: \
                    take less Q, or press less";
        Failure::new("unreachable", Some("load"), what)
    })
}

pub(super) fn solve_on_cells(
    args: &Args,
    layer: &Layer,
    x_mm: &[f64],
    shape: &IndenterShape,
    drive: Prescribed,
    halved: u32,
) -> Result<ContactSolution, Failure> {
    let (grip, contact) = solve_on_adapted_cells(args, layer, shape, drive, halved)?;
    let places = grip.compliance().x_mm.iter().zip(grip.normal_n_mm()).zip(grip.tangential_n_mm());
    let forces = places.map(|((x, p), q)| [*x, *p, *q]).collect();
    let touching =
        grip.compliance().width_mm.iter().zip(grip.normal_n_mm()).filter(|(_, p)| **p != 0.0);
    let widest = touching.fold(0.0, |most: f64, (width, _)| most.max(*width));
    Ok(ContactSolution {
        contact,
        descends: true,
        stress: StressSource::Points(forces),
        pressure: pressures(&grip, x_mm),
        shallowest_mm: RESOLVED_DEPTH_FACTOR * widest,
        symmetric: false,
        pull_n_mm: 0.0,
        solver_state: SolverState::Cells(Box::new(grip), law_from_args(args, drive)?),
    })
}
