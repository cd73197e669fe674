//! Solves `contact_2d` on finite elements over 25.4 mm with free ends. A mesh that would take more
//! than some seconds is an error before any of it is built. Depths other than the base, and a load
//! with nothing below it, are errors.

use taktil_contact::fem::{Elements, Kind, Mesh};
use taktil_contact::layer::Layer;
use taktil_contact::plane::frictional::{ContactStatus, FrictionalContact};
use taktil_contact::plane::{Contact, Mode, Shape};

use super::cells::{law_from_args, solve_on_bed};
use super::field::Failure;
use super::indenter::{IndenterShape, Prescribed};
use super::nodes::NodalStress;
use super::refusal::{failure, refusal_failure};
use super::request::{Args, format_count};
use super::solved::{
    ContactSolution, SolverState, StressSource, contact_without_motion, solve_knife,
};

/// Width of the layer (mm).
const WIDTH_MM: f64 = 25.4;
/// Largest number of elements along the layer, and through it. The equations of the contact, two
/// for each node, are solved again in each iteration.
const SIDE_MAX: f64 = 512.0;
/// Largest product of the number of elements along the layer squared, the number through it, and
/// the lesser of both. Each node of the surface is a load case in two directions on all unknowns,
/// and each unknown is coupled to a band as wide as the shorter side. The limit corresponds to two
/// seconds of work at a ratio of 0.5, or about thirteen seconds where the pressures are found in
/// steps.
const WORK_MAX: f64 = 268_435_456.0;

pub(super) fn solve_on_elements(
    args: &Args,
    (layer, depth): (&Layer, f64),
    x_mm: &[f64],
    shape: &IndenterShape,
    drive: Prescribed,
    halved: u32,
) -> Result<ContactSolution, Failure> {
    if depth != layer.thickness_mm {
        let what = "`fem` knows szz at the base alone: leave `depth_mm` out";
        return Err(Failure::range("depth_mm", what));
    }
    let [nx, nz] = element_counts(args)?.map(|n| (n >> halved).max(1));
    let body = Mesh::uniform(WIDTH_MM, layer.thickness_mm, nx, nz)
        .and_then(|mesh| Elements::new(layer, mesh, Kind::MeanDilatation))
        .map_err(|invalid| failure(&invalid))?;
    if let IndenterShape::Knife = shape {
        return solve_line_load(&body, x_mm, drive);
    }
    if is_past_layer(shape) {
        return solve_past_layer(&body, x_mm, drive);
    }
    refuse_too_few_nodes(shape, &body.mesh().row_mm(nz))?;
    let bed = body.compliance().map_err(|invalid| failure(&invalid))?;
    let (grip, mut contact) = solve_on_bed(args, bed, shape, drive)?;
    if contact.mode != Mode::Open {
        [contact.x_left_mm, contact.x_right_mm] = contact_edges(&grip, shape);
    }
    let nodes = base_stress(&body, grip.normal_n_mm(), grip.tangential_n_mm())?;
    Ok(ContactSolution {
        contact,
        descends: true,
        stress: StressSource::NodalStress(nodes),
        pressure: x_mm.iter().map(|x| Some(nodal_pressure(&grip, shape, *x))).collect(),
        shallowest_mm: 0.0,
        symmetric: false,
        pull_n_mm: 0.0,
        solver_state: SolverState::Mesh(Box::new((grip, body)), law_from_args(args, drive)?),
    })
}

/// Numbers of elements along and through the layer; the limits are checked before any work is done.
fn element_counts(args: &Args) -> Result<[usize; 2], Failure> {
    let [nx, nz] = args.array::<2>("mesh")?;
    let whole = |n: f64, least: f64| (least..=SIDE_MAX).contains(&n) && n == n.floor();
    if whole(nx, 2.0) && whole(nz, 1.0) && nx * nx * nz * nx.min(nz) <= WORK_MAX {
        return Ok([nx as usize, nz as usize]);
    }
    let what = format!(
        "`mesh` is [{}, {}]; wanted: whole numbers, along 2 to {SIDE_MAX}, down 1 to {SIDE_MAX}, \
         and along x along x down x the lesser of both at most {WORK_MAX}, as [512, 32] or \
         [128, 128]",
        format_count(nx),
        format_count(nz)
    );
    Err(Failure::range("mesh", what))
}

/// Puts the load on the node in the middle, or on the two nodes beside the middle.
fn solve_line_load(
    body: &Elements,
    x_mm: &[f64],
    drive: Prescribed,
) -> Result<ContactSolution, Failure> {
    let solved = solve_knife(drive, x_mm)?;
    let places = body.mesh().row_mm(0);
    let (mut p, mut q) = (vec![0.0; places.len()], vec![0.0; places.len()]);
    let nearest = places.iter().fold(f64::INFINITY, |least, x| least.min(x.abs()));
    let beside = |x: &&f64| x.abs() < nearest + 1e-9;
    let share = 1.0 / places.iter().filter(beside).count() as f64;
    for (i, _) in places.iter().enumerate().filter(|(_, x)| beside(x)) {
        (p[i], q[i]) = (share * solved.contact.p_n_mm, share * solved.contact.q_n_mm);
    }
    let stress = StressSource::NodalStress(base_stress(body, &p, &q)?);
    Ok(ContactSolution { stress, symmetric: false, solver_state: SolverState::MeshLine, ..solved })
}

/// First and last position of the indenter's face.
fn face_span(shape: &IndenterShape) -> [f64; 2] {
    match shape {
        IndenterShape::Knife => [0.0; 2],
        IndenterShape::Rigid(Shape::Flat { width_mm, .. }) => [-0.5 * width_mm, 0.5 * width_mm],
        IndenterShape::Rigid(Shape::Cylinder { radius_mm }) => [-radius_mm, *radius_mm],
        IndenterShape::Rigid(Shape::Parabola { .. }) => [f64::NEG_INFINITY, f64::INFINITY],
        IndenterShape::Profile(x, _) => [x[0], x[x.len() - 1]],
    }
}

fn is_past_layer(shape: &IndenterShape) -> bool {
    let [low, high] = face_span(shape);
    low > 0.5 * WIDTH_MM || high < -0.5 * WIDTH_MM
}

/// An indenter beside the layer: it touches nothing and carries no load.
fn solve_past_layer(
    body: &Elements,
    x_mm: &[f64],
    drive: Prescribed,
) -> Result<ContactSolution, Failure> {
    let dz = match drive {
        Prescribed::Move { dz, .. } => dz,
        Prescribed::Load(load) if !load.is_pressing().map_err(refusal_failure)? => 0.0,
        Prescribed::Load(_) => {
            let what = "`load`: nothing of the indenter is over the layer, which ends at x = -12.7 \
                        and 12.7 mm: give a profile over it";
            return Err(Failure::new("unreachable", Some("load"), what));
        }
    };
    let none = vec![0.0; body.mesh().columns()];
    Ok(ContactSolution {
        contact: Contact { delta_mm: dz, ..contact_without_motion(0.0, 0.0, Mode::Open) },
        descends: true,
        stress: StressSource::NodalStress(base_stress(body, &none, &none)?),
        pressure: vec![Some(0.0); x_mm.len()],
        shallowest_mm: 0.0,
        symmetric: false,
        pull_n_mm: 0.0,
        solver_state: SolverState::MeshLine,
    })
}

/// A bar of which at most one node would carry the load, and a profile that lies between two nodes,
/// are errors.
fn refuse_too_few_nodes(shape: &IndenterShape, places: &[f64]) -> Result<(), Failure> {
    let [low, high] = face_span(shape).map(|end| end * (1.0 + 1e-9));
    let under = places.iter().filter(|x| (low..=high).contains(*x)).count();
    let what = match shape {
        IndenterShape::Rigid(Shape::Flat { width_mm, .. }) if under < 2 => format!(
            "`mesh` has {under} nodes under a bar {width_mm} mm wide, and 2 at least carry it; \
             give more elements along, or a wider bar"
        ),
        _ if under == 0 => "`mesh` has no node under the profile; give more elements along, or a \
                            wider profile"
            .to_owned(),
        _ => return Ok(()),
    };
    Err(Failure::range("mesh", what))
}

/// Begin and end of the length that a node represents: midway to its neighbours, and at most to the
/// ends of the layer and of the face.
fn node_span(grip: &FrictionalContact, shape: &IndenterShape, node: usize) -> [f64; 2] {
    let (x, [low, high]) = (&grip.compliance().x_mm, face_span(shape));
    let middle = |other: Option<&f64>| other.map_or(x[node], |other| 0.5 * (x[node] + other));
    let left = middle(node.checked_sub(1).and_then(|i| x.get(i)));
    [left.max(low), middle(x.get(node + 1)).min(high)]
}

/// First and last position in contact.
fn contact_edges(grip: &FrictionalContact, shape: &IndenterShape) -> [f64; 2] {
    let touching = |i: &usize| grip.status()[*i] != ContactStatus::Apart;
    let mut nodes = (0..grip.status().len()).filter(touching);
    let Some(first) = nodes.next() else { return [0.0; 2] };
    [
        node_span(grip, shape, first)[0],
        node_span(grip, shape, nodes.next_back().unwrap_or(first))[1],
    ]
}

/// Pressure at the node nearest to x: its force over the length that it represents; zero beside the
/// face.
fn nodal_pressure(grip: &FrictionalContact, shape: &IndenterShape, x: f64) -> f64 {
    let inside = |i: &usize| {
        let [left, right] = node_span(grip, shape, *i);
        left <= x && x <= right
    };
    let node = (0..grip.compliance().count()).find(inside);
    node.map_or(0.0, |i| grip.normal_n_mm()[i] / grip.compliance().width_mm[i])
}

/// Base stress under forces on the surface of a mesh.
pub(super) fn base_stress(body: &Elements, p: &[f64], q: &[f64]) -> Result<NodalStress, Failure> {
    let response = body.response_to_contact(p, q).map_err(|invalid| failure(&invalid))?;
    let szz = body.base_szz_mpa(&response);
    Ok(NodalStress { x: body.mesh().row_mm(0), width: body.mesh().widths_mm(0), szz })
}
