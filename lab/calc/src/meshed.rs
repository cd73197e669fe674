//! How `contact_2d` solves on finite elements over 25.4 mm with free ends. Refuses meshes on which
//! an answer would take longer than some seconds, before anything is made of them; other depths
//! than the base; loads with nothing over the layer.

use taktil_contact::fem::{Elements, Kind, Mesh};
use taktil_contact::layer::Layer;
use taktil_contact::plane::frictional::{ContactStatus, FrictionalContact};
use taktil_contact::plane::{Contact, Mode, Shape};

use super::cells::{gripped, law_of};
use super::field::Failure;
use super::indenter::{Indented, Prescribed};
use super::nodes::Nodes;
use super::refusal::{failure, refused};
use super::request::{Args, counted};
use super::solved::{Held, Solved, Stress, knife, plain};

/// Width of the layer.
const WIDTH_MM: f64 = 25.4;
/// Most elements along, and down: the contact's own equations, two a node, are solved anew each
/// round.
const SIDE_MAX: f64 = 512.0;
/// Most of along x along x down x the lesser of both: each node of the surface is two loads on all
/// unknowns, each coupled to a band of the shorter side. Two seconds of work, at a ratio of 0.5,
/// where pressures are found in steps, some thirteen.
const WORK_MAX: f64 = 268_435_456.0;

pub(super) fn elements(
    args: &Args,
    (layer, depth): (&Layer, f64),
    x_mm: &[f64],
    shape: &Indented,
    drive: Prescribed,
    halved: u32,
) -> Result<Solved, Failure> {
    if depth != layer.thickness_mm {
        let what = "`fem` knows szz at the base alone: leave `depth_mm` out";
        return Err(Failure::range("depth_mm", what));
    }
    let [nx, nz] = counts(args)?.map(|n| (n >> halved).max(1));
    let body = Mesh::uniform(WIDTH_MM, layer.thickness_mm, nx, nz)
        .and_then(|mesh| Elements::new(layer, mesh, Kind::MeanDilatation))
        .map_err(|invalid| failure(&invalid))?;
    if let Indented::Knife = shape {
        return line(&body, x_mm, drive);
    }
    if past(shape) {
        return beside(&body, x_mm, drive);
    }
    stands(shape, &body.mesh().row_mm(nz))?;
    let bed = body.compliance().map_err(|invalid| failure(&invalid))?;
    let (grip, mut contact) = gripped(args, bed, shape, drive)?;
    if contact.mode != Mode::Open {
        [contact.x_left_mm, contact.x_right_mm] = edges(&grip, shape);
    }
    let nodes = base(&body, grip.normal_n_mm(), grip.tangential_n_mm())?;
    Ok(Solved {
        contact,
        descends: true,
        stress: Stress::Nodes(nodes),
        pressure: x_mm.iter().map(|x| Some(pressure(&grip, shape, *x))).collect(),
        shallowest_mm: 0.0,
        symmetric: false,
        pull_n_mm: 0.0,
        held: Held::Mesh(Box::new((grip, body)), law_of(args, drive)?),
    })
}

/// Elements along and down, the one limit of all: decided before any work.
fn counts(args: &Args) -> Result<[usize; 2], Failure> {
    let [nx, nz] = args.array::<2>("mesh")?;
    let whole = |n: f64, least: f64| (least..=SIDE_MAX).contains(&n) && n == n.floor();
    if whole(nx, 2.0) && whole(nz, 1.0) && nx * nx * nz * nx.min(nz) <= WORK_MAX {
        return Ok([nx as usize, nz as usize]);
    }
    let what = format!(
        "`mesh` is [{}, {}]; wanted: whole numbers, along 2 to {SIDE_MAX}, down 1 to {SIDE_MAX}, \
         and along x along x down x the lesser of both at most {WORK_MAX}, as [512, 32] or \
         [128, 128]",
        counted(nx),
        counted(nz)
    );
    Err(Failure::range("mesh", what))
}

/// The load on the node in the middle, or shared by the two beside it.
fn line(body: &Elements, x_mm: &[f64], drive: Prescribed) -> Result<Solved, Failure> {
    let solved = knife(drive, x_mm)?;
    let places = body.mesh().row_mm(0);
    let (mut p, mut q) = (vec![0.0; places.len()], vec![0.0; places.len()]);
    let nearest = places.iter().fold(f64::INFINITY, |least, x| least.min(x.abs()));
    let beside = |x: &&f64| x.abs() < nearest + 1e-9;
    let share = 1.0 / places.iter().filter(beside).count() as f64;
    for (i, _) in places.iter().enumerate().filter(|(_, x)| beside(x)) {
        (p[i], q[i]) = (share * solved.contact.p_n_mm, share * solved.contact.q_n_mm);
    }
    let stress = Stress::Nodes(base(body, &p, &q)?);
    Ok(Solved { stress, symmetric: false, held: Held::MeshLine, ..solved })
}

/// First and last place of the indenter's face.
fn face(shape: &Indented) -> [f64; 2] {
    match shape {
        Indented::Knife => [0.0; 2],
        Indented::Rigid(Shape::Flat { width_mm, .. }) => [-0.5 * width_mm, 0.5 * width_mm],
        Indented::Rigid(Shape::Cylinder { radius_mm }) => [-radius_mm, *radius_mm],
        Indented::Rigid(Shape::Parabola { .. }) => [f64::NEG_INFINITY, f64::INFINITY],
        Indented::Profile(x, _) => [x[0], x[x.len() - 1]],
    }
}

fn past(shape: &Indented) -> bool {
    let [low, high] = face(shape);
    low > 0.5 * WIDTH_MM || high < -0.5 * WIDTH_MM
}

/// An indenter that is not over the layer: it touches nothing, and carries nothing.
fn beside(body: &Elements, x_mm: &[f64], drive: Prescribed) -> Result<Solved, Failure> {
    let dz = match drive {
        Prescribed::Move { dz, .. } => dz,
        Prescribed::Load(load) if !load.is_pressing().map_err(refused)? => 0.0,
        Prescribed::Load(_) => {
            let what = "`load`: nothing of the indenter is over the layer, which ends at x = -12.7 \
                        and 12.7 mm: give a profile over it";
            return Err(Failure::new("unreachable", Some("load"), what));
        }
    };
    let none = vec![0.0; body.mesh().columns()];
    Ok(Solved {
        contact: Contact { delta_mm: dz, ..plain(0.0, 0.0, Mode::Open) },
        descends: true,
        stress: Stress::Nodes(base(body, &none, &none)?),
        pressure: vec![Some(0.0); x_mm.len()],
        shallowest_mm: 0.0,
        symmetric: false,
        pull_n_mm: 0.0,
        held: Held::MeshLine,
    })
}

/// Refuses a bar of which one node at most would carry all, and a profile between two nodes.
fn stands(shape: &Indented, places: &[f64]) -> Result<(), Failure> {
    let [low, high] = face(shape).map(|end| end * (1.0 + 1e-9));
    let under = places.iter().filter(|x| (low..=high).contains(*x)).count();
    let what = match shape {
        Indented::Rigid(Shape::Flat { width_mm, .. }) if under < 2 => format!(
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

/// Where what a node stands for begins and ends: midway to its neighbours, at most at the layer's
/// and the face's ends.
fn part(grip: &FrictionalContact, shape: &Indented, node: usize) -> [f64; 2] {
    let (x, [low, high]) = (&grip.compliance().x_mm, face(shape));
    let middle = |other: Option<&f64>| other.map_or(x[node], |other| 0.5 * (x[node] + other));
    let left = middle(node.checked_sub(1).and_then(|i| x.get(i)));
    [left.max(low), middle(x.get(node + 1)).min(high)]
}

/// First and last place that touch.
fn edges(grip: &FrictionalContact, shape: &Indented) -> [f64; 2] {
    let touching = |i: &usize| grip.status()[*i] != ContactStatus::Apart;
    let mut nodes = (0..grip.status().len()).filter(touching);
    let Some(first) = nodes.next() else { return [0.0; 2] };
    [part(grip, shape, first)[0], part(grip, shape, nodes.next_back().unwrap_or(first))[1]]
}

/// Pressure of the node nearest to a place, over what it stands for; none beside the face.
fn pressure(grip: &FrictionalContact, shape: &Indented, x: f64) -> f64 {
    let inside = |i: &usize| {
        let [left, right] = part(grip, shape, *i);
        left <= x && x <= right
    };
    let node = (0..grip.compliance().count()).find(inside);
    node.map_or(0.0, |i| grip.normal_n_mm()[i] / grip.compliance().width_mm[i])
}

/// Base stress of forces on the surface of a mesh.
pub(super) fn base(body: &Elements, p: &[f64], q: &[f64]) -> Result<Nodes, Failure> {
    let response = body.response_to_contact(p, q).map_err(|invalid| failure(&invalid))?;
    let szz = body.base_szz_mpa(&response);
    Ok(Nodes { x: body.mesh().row_mm(0), width: body.mesh().widths_mm(0), szz })
}
