//! A solved `contact_2d` request: the contact, its stress and its pressure, and the solver's state
//! from which derivatives start.

use taktil_contact::Accuracy;
use taktil_contact::fem::Elements;
use taktil_contact::plane::frictional::{FrictionLaw, FrictionalContact};
use taktil_contact::plane::noslip::NoSlip;
use taktil_contact::plane::{Contact, Indenter, Mode, PointForce, Shape};

use super::field::Failure;
use super::indenter::Prescribed;
use super::nodes::Nodes;
use super::refusal::refused;
use super::request::Args;

/// What every way of solving hands to the answer.
pub(super) struct Solved {
    pub(super) contact: Contact,
    /// Whether `delta_mm` means anything.
    pub(super) descends: bool,
    pub(super) stress: Stress,
    pub(super) pressure: Vec<Option<f64>>,
    /// Least depth at which the stress is that of the pressure, not of the points it is given in.
    pub(super) shallowest_mm: f64,
    /// Whether the stress is even in x.
    pub(super) symmetric: bool,
    /// What glued edges pull, which a contact that may part would not.
    pub(super) pull_n_mm: f64,
    pub(super) held: Held,
}

/// What was solved, to be moved on.
pub(super) enum Held {
    /// A line load, or nothing.
    Line,
    Spectral(Box<Indenter>),
    /// With its shape and how far it was moved along x.
    Glued(Box<NoSlip>, Shape, f64),
    Cells(Box<FrictionalContact>, FrictionLaw),
    Mesh(Box<(FrictionalContact, Elements)>, FrictionLaw),
    /// A line load on elements.
    MeshLine,
}

/// Where the stress comes from.
pub(super) enum Stress {
    Points(Vec<PointForce>),
    Nodes(Nodes),
}

/// A line load, whose stress is known in closed form.
pub(super) fn knife(drive: Prescribed, x_mm: &[f64]) -> Result<Solved, Failure> {
    let Prescribed::Load(load) = drive else {
        let what = "a knife edge goes down by an infinite length under any load: give `load`";
        return Err(Failure::new("unreachable", Some("move"), what));
    };
    let mode = if load.is_pressing().map_err(refused)? { Mode::Full } else { Mode::Open };
    let forces = vec![[0.0, load.p_n_mm, load.q_n_mm]];
    Ok(Solved {
        contact: plain(load.p_n_mm, load.q_n_mm, mode),
        descends: false,
        stress: Stress::Points(forces),
        pressure: x_mm.iter().map(|x| (*x != 0.0).then_some(0.0)).collect(),
        shallowest_mm: 0.0,
        symmetric: load.q_n_mm == 0.0,
        pull_n_mm: 0.0,
        held: Held::Line,
    })
}

/// A contact with these loads, all else 0.
pub(super) fn plain(p_n_mm: f64, q_n_mm: f64, mode: Mode) -> Contact {
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

/// The accuracy that the request's `level` names.
pub(super) fn level_of(args: &Args) -> Result<Accuracy, Failure> {
    Ok(match args.choice("level")? {
        "fast" => Accuracy::Fast,
        "fine" => Accuracy::Fine,
        _ => Accuracy::Default,
    })
}
