//! A solved `contact_2d` request: the contact, its stress and its pressure, and the solver's state
//! from which derivatives start.

use taktil_contact::Accuracy;
use taktil_contact::fem::Elements;
use taktil_contact::plane::frictional::{FrictionLaw, FrictionalContact};
use taktil_contact::plane::noslip::NoSlip;
use taktil_contact::plane::{Contact, Indenter, Mode, PointForce, Shape};

use super::field::Failure;
use super::indenter::Prescribed;
use super::nodes::NodalStress;
use super::refusal::refusal_failure;
use super::request::Args;

/// The solution of a contact, by any method.
pub(super) struct ContactSolution {
    pub(super) contact: Contact,
    /// True when `delta_mm` has a meaning.
    pub(super) descends: bool,
    pub(super) stress: StressSource,
    pub(super) pressure: Vec<Option<f64>>,
    /// Smallest depth at which the stress is that of the pressure and does not show the
    /// discretisation.
    pub(super) shallowest_mm: f64,
    /// True when the stress is even in x.
    pub(super) symmetric: bool,
    /// Tension at glued edges, which a contact that may separate would not have.
    pub(super) pull_n_mm: f64,
    pub(super) solver_state: SolverState,
}

/// The solver's state, from which derivatives start.
pub(super) enum SolverState {
    /// A line load, or no contact.
    Line,
    Spectral(Box<Indenter>),
    /// The contact with its shape and its displacement along x.
    Glued(Box<NoSlip>, Shape, f64),
    Cells(Box<FrictionalContact>, FrictionLaw),
    Mesh(Box<(FrictionalContact, Elements)>, FrictionLaw),
    /// A line load on elements.
    MeshLine,
}

/// The source of the stress.
pub(super) enum StressSource {
    Points(Vec<PointForce>),
    NodalStress(NodalStress),
}

/// Solves a line load, whose stress is known in closed form.
pub(super) fn solve_knife(drive: Prescribed, x_mm: &[f64]) -> Result<ContactSolution, Failure> {
    let Prescribed::Load(load) = drive else {
        let what = "a knife edge goes down by an infinite length under any load: give `load`";
        return Err(Failure::new("unreachable", Some("move"), what));
    };
    let mode = if load.is_pressing().map_err(refusal_failure)? { Mode::Full } else { Mode::Open };
    let forces = vec![[0.0, load.p_n_mm, load.q_n_mm]];
    Ok(ContactSolution {
        contact: contact_without_motion(load.p_n_mm, load.q_n_mm, mode),
        descends: false,
        stress: StressSource::Points(forces),
        pressure: x_mm.iter().map(|x| (*x != 0.0).then_some(0.0)).collect(),
        shallowest_mm: 0.0,
        symmetric: load.q_n_mm == 0.0,
        pull_n_mm: 0.0,
        solver_state: SolverState::Line,
    })
}

/// A contact with these loads and zero displacements.
pub(super) fn contact_without_motion(p_n_mm: f64, q_n_mm: f64, mode: Mode) -> Contact {
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
pub(super) fn level_from_args(args: &Args) -> Result<Accuracy, Failure> {
    Ok(match args.choice("level")? {
        "fast" => Accuracy::Fast,
        "fine" => Accuracy::Fine,
        _ => Accuracy::Default,
    })
}
