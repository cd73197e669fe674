//! What `contact_2d` solves on places: any profile, Coulomb's law and no slip, on cells of the
//! exact layer or on a mesh's nodes. Cells are laid over what touches, not over all of a shape, and
//! over more of it until the contact ends inside them. Refuses what the solver refuses.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::plane::compliance::{CELLS_MAX, SurfaceCompliance};
use taktil_contact::plane::frictional::{ContactStatus, FrictionLaw, FrictionalContact, LoadStep};
use taktil_contact::plane::{Contact, Friction, Indenter, Load, Mode, Refusal, Shape};

use super::field::Failure;
use super::indenter::{Indented, Prescribed};
use super::refusal::{failure, refused};
use super::request::Args;
use super::solved::{Held, Solved, Stress, level_of, plain};

/// Steps of a path with stick.
const STEPS: u32 = 64;
/// How often cells are laid over less, or more, of a profile.
const LAID: usize = 12;
/// Cells fit a contact that with what is beside it covers this part of them: where it touches
/// without stick, and at last.
const FITS: [f64; 2] = [0.8, 0.5];
/// How far cells go on beside what touches, in parts of it; beside what they cut off; and beside
/// half of a round indenter's contact without friction.
const BESIDE: f64 = 0.06;
const BEYOND: f64 = 0.3;
const AROUND: f64 = 1.15;
/// Widest cell between two places that touch, in thicknesses.
const GAP: f64 = 10.0;
/// Widest cell where something touches, in thicknesses: the base does not tell such cells from
/// their pressure spread out.
const WIDEST: f64 = 0.6;
/// How much wider cells may be that a contact is only looked for on.
const ROUGH: f64 = 4.0;
/// Depth in widths of a cell from which on that is so.
const BLURRED: f64 = 1.65;

/// Stretches of the surface in mm, ascending.
type Runs = Vec<[f64; 2]>;

/// The law that the general solver takes.
pub(super) fn law_of(args: &Args, drive: Prescribed) -> Result<FrictionLaw, Failure> {
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
fn bottom(heights: &[f64]) -> f64 {
    heights.iter().copied().fold(f64::INFINITY, f64::min)
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
            let lowest = bottom(heights);
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

/// Cells of a level, so often halved.
fn count(args: &Args, halved: u32) -> Result<u32, Failure> {
    let cells = match level_of(args)? {
        Accuracy::Fast => 48,
        Accuracy::Default => 96,
        Accuracy::Fine => 192,
    };
    Ok(cells >> halved)
}

/// Edges of `n` cells of one width.
fn even([low, high]: [f64; 2], n: u32) -> Vec<f64> {
    (0..=n).map(|i| low + (high - low) * (f64::from(i) / f64::from(n))).collect()
}

/// Cells of at most a width over a length; more than a bed takes where they would be too many.
fn at_least(length: f64, width: f64) -> u32 {
    (length / width).ceil().min(CELLS_MAX as f64 + 1.0) as u32
}

/// Edges of about `n` cells in `runs`, none wider than `widest` thicknesses, with wide ones between
/// them; more than a bed takes where they would be too many.
fn laid(runs: &[[f64; 2]], n: u32, thickness_mm: f64, widest: f64) -> Vec<f64> {
    let total: f64 = runs.iter().map(|[from, to]| to - from).sum();
    let mut edges: Vec<f64> = Vec::new();
    for [from, to] in runs {
        if let Some(&last) = edges.last() {
            let between = even([last, *from], at_least(from - last, GAP * thickness_mm));
            edges.extend(&between[1..between.len() - 1]);
        }
        let share = (f64::from(n) * ((to - from) / total)).max(8.0) as u32;
        edges.extend(even([*from, *to], share.max(at_least(to - from, widest * thickness_mm))));
    }
    edges
}

/// Lowest height of a shape between two places; kinks are not missed.
fn lowest(shape: &Indented, from: f64, to: f64) -> f64 {
    let ends = height(shape, from).min(height(shape, to));
    let Indented::Profile(x, z) = shape else { return ends };
    let kinks = &z[x.partition_point(|x| *x < from)..x.partition_point(|x| *x < to)];
    let bottom = bottom(z);
    kinks.iter().fold(ends, |low, z| low.min(z - bottom))
}

/// All of a shape, and where to look first for what touches.
fn window(layer: &Layer, shape: &Indented, drive: Prescribed) -> Result<([f64; 2], Runs), Failure> {
    let Indented::Profile(x, z) = shape else {
        let Indented::Rigid(round) = shape else { return Ok(([-1.0, 1.0], vec![[-1.0, 1.0]])) };
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
        let half = (AROUND * contact.map_err(refused)?.x_right_mm.max(1e-3)).min(end);
        return Ok(([-end, end], vec![[-half, half]]));
    };
    let whole = [x[0], x[x.len() - 1]];
    if let Prescribed::Move { dz, .. } = drive {
        // What is below the surface, and the bulge beside it.
        let bottom = bottom(z);
        let below = |i: &usize| z[*i].min(z[i + 1]) - bottom < dz;
        let pieces = 0..x.len() - 1;
        let reach = |i: usize| sunk(shape, &x[i..=i + 1], dz);
        if let (Some(first), Some(last)) = (pieces.clone().find(below), pieces.rev().find(below)) {
            let [from, to] = [reach(first)[0], reach(last)[1]];
            let run = roughly([from, to], 0.5 * (to - from) + layer.thickness_mm, whole);
            return Ok((whole, vec![run]));
        }
    }
    Ok((whole, vec![whole]))
}

/// Where a shape touches under a law without stick, and a bit beside that, found in one step.
fn touched(
    layer: &Layer,
    shape: &Indented,
    drive: Prescribed,
    law: FrictionLaw,
    n: u32,
    (whole, mut runs): ([f64; 2], Runs),
) -> Result<Runs, Failure> {
    for _ in 0..LAID {
        // A far profile is looked at roughly at first.
        let even = length(&runs) / (0.9 * CELLS_MAX as f64 * layer.thickness_mm);
        let edges = laid(&runs, n, layer.thickness_mm, even.clamp(WIDEST, ROUGH * WIDEST));
        let bed = bed_of(layer, &edges)?;
        let heights = edges.windows(2).map(|w| lowest(shape, w[0], w[1])).collect();
        let mut grip =
            FrictionalContact::new(bed, heights, law).map_err(|invalid| failure(&invalid))?;
        grip.step(&part_of(drive, shape, 1.0)).map_err(refused)?;
        let next = beside(&bare(&edges, grip.status()), &edges, whole);
        let within =
            |[from, to]: &[f64; 2]| runs.iter().any(|run| run[0] <= *from && *to <= run[1]);
        let fits = next.iter().all(within) && length(&next) >= FITS[0] * length(&runs);
        if next.is_empty() || fits {
            return Ok(runs);
        }
        runs = next;
    }
    Ok(runs)
}

fn length(runs: &[[f64; 2]]) -> f64 {
    runs.iter().map(|[from, to]| to - from).sum()
}

/// The bed of cells, unless they are too many.
fn bed_of(layer: &Layer, edges: &[f64]) -> Result<SurfaceCompliance, Failure> {
    if edges.len() > CELLS_MAX + 1 {
        let what = format!(
            "`shape` would touch over more than {CELLS_MAX} cells of {WIDEST} thicknesses or, \
             where it leaves gaps, {GAP}: give a smaller one, press less, or take a thicker layer"
        );
        return Err(Failure::range("shape", what));
    }
    SurfaceCompliance::of_layer(layer, edges).map_err(|invalid| failure(&invalid))
}

/// A run with what is beside it, on a grid of the whole: a contact that is moved by little keeps
/// its cells, so that answers can be told from each other.
fn roughly([from, to]: [f64; 2], beside: f64, whole: [f64; 2]) -> [f64; 2] {
    let mut step = whole[1] - whole[0];
    if !step.is_finite() {
        return whole;
    }
    while step > 0.1 * (to - from + beside) {
        step *= 0.5;
    }
    let down = ((from - beside - whole[0]) / step).floor() * step + whole[0];
    let up = ((to + beside - whole[0]) / step).ceil() * step + whole[0];
    [down.max(whole[0]), up.min(whole[1])]
}

/// The part of a straight piece that is less than `dz` above the lowest point.
fn sunk(shape: &Indented, piece: &[f64], dz: f64) -> [f64; 2] {
    let [a, b] = [height(shape, piece[0]), height(shape, piece[1])];
    let cut = piece[0] + (piece[1] - piece[0]) * ((dz - a) / (b - a));
    [if a < dz { piece[0] } else { cut }, if b < dz { piece[1] } else { cut }]
}

/// What touches, in runs.
fn bare(edges: &[f64], status: &[ContactStatus]) -> Runs {
    let mut bare: Runs = Vec::new();
    for (cell, _) in
        edges.windows(2).zip(status).filter(|(_, status)| **status != ContactStatus::Apart)
    {
        match bare.last_mut() {
            // Rough cells touch and do not by turns.
            Some(run) if cell[0] - run[1] <= 2.5 * (cell[1] - cell[0]) => run[1] = cell[1],
            _ => bare.push([cell[0], cell[1]]),
        }
    }
    bare
}

/// What touches with a bit beside each run.
fn beside(bare: &[[f64; 2]], edges: &[f64], whole: [f64; 2]) -> Runs {
    let mut runs: Runs = Vec::new();
    for &[from, to] in bare {
        let after = edges.partition_point(|edge| *edge <= from);
        let beside = (edges[after] - edges[after - 1]).max(BESIDE * (to - from));
        runs.push([(from - beside).max(whole[0]), (to + beside).min(whole[1])]);
    }
    merged(runs)
}

/// Runs in order, those that meet as one.
fn merged(mut runs: Runs) -> Runs {
    runs.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut apart: Runs = Vec::new();
    for run in runs {
        match apart.last_mut() {
            Some(last) if run[0] <= last[1] => last[1] = last[1].max(run[1]),
            _ => apart.push(run),
        }
    }
    apart
}

/// Whether what touches ends where its run of cells does, and not with the shape itself: it would
/// go on, and what is solved is cut off.
fn is_cut(bare: &[[f64; 2]], runs: &[[f64; 2]], whole: [f64; 2]) -> bool {
    let free = |[from, to]: &[f64; 2]| {
        runs.iter().any(|run| {
            let slack = 1e-9 * (run[1] - run[0]);
            let left = *from > run[0] + slack || run[0] <= whole[0];
            let right = *to < run[1] - slack || run[1] >= whole[1];
            left && right && *from >= run[0] - slack && *to <= run[1] + slack
        })
    };
    !bare.iter().all(free)
}

/// Edges of the cells under a bar, gathered at its corners.
fn under_bar(width_mm: f64, n: u32, layer: &Layer) -> Vec<f64> {
    let widest = WIDEST * layer.thickness_mm;
    let n = n.max(at_least(0.5 * core::f64::consts::PI * width_mm, widest));
    let angle = |i: u32| core::f64::consts::PI * (f64::from(i) / f64::from(n));
    (0..=n).map(|i| -0.5 * width_mm * libm::cos(angle(i))).collect()
}

/// A part of the way to the load or the move.
fn part_of(drive: Prescribed, shape: &Indented, f: f64) -> LoadStep {
    match (drive, shape) {
        (Prescribed::Load(load), shape) => {
            let load = Load { p_n_mm: f * load.p_n_mm, q_n_mm: f * load.q_n_mm };
            match shape {
                Indented::Rigid(Shape::Flat { height_mm, .. }) => {
                    LoadStep::Loads { load, height_mm: *height_mm }
                }
                _ => LoadStep::Upright(load),
            }
        }
        (Prescribed::Move { dz, dx: 0.0 }, _) => LoadStep::Move { dz_mm: dz * f, dx_mm: 0.0 },
        (Prescribed::Move { dz, dx }, _) => {
            // Down first, then along.
            LoadStep::Move { dz_mm: dz * (2.0 * f).min(1.0), dx_mm: dx * (2.0 * f - 1.0).max(0.0) }
        }
    }
}

/// Refuses a bar that topples whatever carries it.
fn stands(shape: &Indented, drive: Prescribed) -> Result<(), Failure> {
    let Indented::Rigid(Shape::Flat { width_mm, height_mm }) = shape else { return Ok(()) };
    let Prescribed::Load(Load { p_n_mm: p, q_n_mm: q }) = drive else { return Ok(()) };
    if p > 0.0 && q.abs() * height_mm >= p * 0.5 * width_mm {
        return Err(refused(Refusal::Toppling));
    }
    Ok(())
}

/// Of a bar that does not topple, but beyond the middle of its last place.
fn on_places(shape: &Indented, refusal: Refusal) -> Failure {
    match (shape, refusal) {
        (Indented::Rigid(Shape::Flat { .. }), Refusal::Toppling) => refused(Refusal::OnLastNode),
        _ => refused(refusal),
    }
}

/// Follows the path to the load or the move.
fn follow(
    args: &Args,
    grip: &mut FrictionalContact,
    shape: &Indented,
    law: FrictionLaw,
    drive: Prescribed,
) -> Result<(), Failure> {
    let steps = if matches!(law, FrictionLaw::Coulomb(_)) { STEPS } else { 1 };
    let fresh = grip.clone();
    args.timed(|| {
        *grip = fresh.clone();
        (1..=steps)
            .try_for_each(|k| grip.step(&part_of(drive, shape, f64::from(k) / f64::from(steps))))
    })
    .map_err(|refusal| on_places(shape, refusal))
}

/// The contact of a shape on a bed, with the features of its mode.
pub(super) fn gripped(
    args: &Args,
    bed: SurfaceCompliance,
    shape: &Indented,
    drive: Prescribed,
) -> Result<(FrictionalContact, Contact), Failure> {
    let law = law_of(args, drive)?;
    let heights = bed.x_mm.iter().map(|x| height(shape, *x)).collect();
    let mut grip =
        FrictionalContact::new(bed, heights, law).map_err(|invalid| failure(&invalid))?;
    stands(shape, drive)?;
    follow(args, &mut grip, shape, law, drive)?;
    let bed = grip.compliance();
    let touching = |i: &usize| grip.status()[*i] != ContactStatus::Apart;
    let under = |i: &usize| height(shape, bed.x_mm[*i]).is_finite();
    let (first, last) = ((0..bed.count()).find(touching), (0..bed.count()).rev().find(touching));
    let ends = ((0..bed.count()).find(under), (0..bed.count()).rev().find(under));
    let flat = matches!(shape, Indented::Rigid(Shape::Flat { .. }));
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
    // Without a law along x the load Q is taken by its moment alone.
    let q = match (law_of(args, drive)?, drive) {
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
        ..plain(load.p_n_mm, q, mode)
    };
    Ok((grip, contact))
}

/// Pressure of the place nearest to each x, over what it stands for.
pub(super) fn pressures(grip: &FrictionalContact, x_mm: &[f64]) -> Vec<Option<f64>> {
    let bed = grip.compliance();
    let at = |x: &f64| {
        let inside = |i: &usize| (x - bed.x_mm[*i]).abs() <= 0.5 * bed.width_mm[*i];
        let i = (0..bed.count()).find(inside);
        Some(i.map_or(0.0, |i| grip.normal_n_mm()[i] / bed.width_mm[i]))
    };
    x_mm.iter().map(at).collect()
}

/// The contact on the exact layer, on cells that are laid over more of the shape until it ends
/// inside them, or with the shape.
fn laid_over(
    args: &Args,
    layer: &Layer,
    shape: &Indented,
    drive: Prescribed,
    halved: u32,
) -> Result<(FrictionalContact, Contact), Failure> {
    let n = count(args, halved)?;
    if let Indented::Rigid(Shape::Flat { width_mm, .. }) = shape {
        return gripped(args, bed_of(layer, &under_bar(*width_mm, n, layer))?, shape, drive);
    }
    let start = window(layer, shape, drive)?;
    let whole = start.0;
    let look = |law| touched(layer, shape, drive, law, n, start.clone());
    let mut runs = match drive {
        // As if all slipped: stick takes less room.
        Prescribed::Load(Load { p_n_mm: p, q_n_mm: q }) if p > 0.0 && q != 0.0 => {
            look(FrictionLaw::Proportional(q / p)).or_else(|_| look(FrictionLaw::Free))?
        }
        _ => look(FrictionLaw::Free)?,
    };
    let mut whole_one = None;
    for _ in 0..LAID {
        let edges = laid(&runs, n, layer.thickness_mm, WIDEST);
        let found = gripped(args, bed_of(layer, &edges)?, shape, drive)?;
        let bare = bare(&edges, found.0.status());
        let next = beside(&bare, &edges, whole);
        if is_cut(&bare, &runs, whole) {
            let more = next.iter().map(|[from, to]| {
                let more = BEYOND * (to - from);
                [(from - more).max(whole[0]), (to + more).min(whole[1])]
            });
            let wider = merged(runs.iter().copied().chain(more).collect());
            if wider == runs {
                break;
            }
            runs = wider;
            continue;
        }
        // A move along x may have gone over more than is left.
        let moved = matches!(drive, Prescribed::Move { .. });
        if next.is_empty() || moved || length(&next) >= FITS[1] * length(&runs) {
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

pub(super) fn cells(
    args: &Args,
    layer: &Layer,
    x_mm: &[f64],
    shape: &Indented,
    drive: Prescribed,
    halved: u32,
) -> Result<Solved, Failure> {
    let (grip, contact) = laid_over(args, layer, shape, drive, halved)?;
    let places = grip.compliance().x_mm.iter().zip(grip.normal_n_mm()).zip(grip.tangential_n_mm());
    let forces = places.map(|((x, p), q)| [*x, *p, *q]).collect();
    let touching =
        grip.compliance().width_mm.iter().zip(grip.normal_n_mm()).filter(|(_, p)| **p != 0.0);
    let widest = touching.fold(0.0, |most: f64, (width, _)| most.max(*width));
    Ok(Solved {
        contact,
        descends: true,
        stress: Stress::Points(forces),
        pressure: pressures(&grip, x_mm),
        shallowest_mm: BLURRED * widest,
        symmetric: false,
        pull_n_mm: 0.0,
        held: Held::Cells(Box::new(grip), law_of(args, drive)?),
    })
}
