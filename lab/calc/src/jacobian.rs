//! Calc operation `feature_jacobian`: derivatives of a contact's features with respect to motions
//! of the indenter, at a `contact_2d` or a `contact_3d` request. A feature that exists only for the
//! other of the two requests is an error, and so is every error of the contact itself. An undefined
//! derivative is null.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::plane::frictional::{FrictionLaw, FrictionalContact};
use taktil_contact::plane::rates::{self, StressFeatures, TractionRate};
use taktil_contact::plane::{Indenter, Load, Mode};
use taktil_contact::space::jacobian::{Feature, Motion, condition, feature_jacobian as in_space};

use super::answer::Answer;
use super::column::Column;
use super::differences::differences;
use super::field::{Failure, Field, Kind, Presence};
use super::indent;
use super::nodes::NodalStress;
use super::refusal::{failure, refusal_failure};
use super::request::Args;
use super::solved::{ContactSolution, SolverState, StressSource};
use super::{Operation, indenter, meshed, plane, space};

/// Names of the features in three dimensions: the thesis's features and those that this program
/// adds.
const SPACE: &[(&str, Feature)] = &[
    ("M0", Feature::M0),
    ("m0", Feature::M0),
    ("My", Feature::My),
    ("m_y", Feature::My),
    ("Mx", Feature::Mx),
    ("m_x", Feature::Mx),
    ("xc", Feature::Xc),
    ("x_c", Feature::Xc),
    ("yc", Feature::Yc),
    ("y_c", Feature::Yc),
    ("mu_xx", Feature::MuXx),
    ("mu_xy", Feature::MuXy),
    ("mu_yy", Feature::MuYy),
    ("theta_long_rad", Feature::ThetaLong),
    ("theta_z", Feature::ThetaLong),
];

/// Names of the features in plane strain; those that end in `_c` are taken of the compressive part.
const PLANE: &[(&str, rates::Feature)] = &[
    ("m0", rates::Feature::Moment(0)),
    ("M0", rates::Feature::Moment(0)),
    ("m1", rates::Feature::Moment(1)),
    ("m2", rates::Feature::Moment(2)),
    ("m3", rates::Feature::Moment(3)),
    ("x_c", rates::Feature::Centroid),
    ("xc", rates::Feature::Centroid),
    ("m0_c", rates::Feature::CompressiveMoment(0)),
    ("m1_c", rates::Feature::CompressiveMoment(1)),
    ("m2_c", rates::Feature::CompressiveMoment(2)),
    ("m3_c", rates::Feature::CompressiveMoment(3)),
    ("x_c_c", rates::Feature::CompressiveCentroid),
    ("xc_c", rates::Feature::CompressiveCentroid),
    ("x_peak", rates::Feature::PeakPlace),
    ("szz_peak", rates::Feature::PeakStress),
];

const FEATURES: &[&str] = &[
    "M0",
    "My",
    "Mx",
    "xc",
    "yc",
    "mu_xx",
    "mu_xy",
    "mu_yy",
    "theta_long_rad",
    "m0",
    "m_y",
    "m_x",
    "x_c",
    "y_c",
    "theta_z",
    "m1",
    "m2",
    "m3",
    "m0_c",
    "m1_c",
    "m2_c",
    "m3_c",
    "x_c_c",
    "xc_c",
    "x_peak",
    "szz_peak",
];
const MOTIONS: &[&str] = &["dx", "dy", "dz", "rx", "ry", "rz"];

/// The operations of this subject.
pub(super) const OPERATIONS: &[Operation] = &[Operation {
    name: "feature_jacobian",
    doc: "Derivatives of a contact's features with respect to motions of the indenter, the other \
          motions held, at a `contact_2d` or a `contact_3d` request. In plane strain they are \
          exact; on cells and elements (a profile, {coulomb}, a bar's stick, fem) differences. \
          Where it slides freely (none, prop) dx takes the contact along over the layer; where it \
          is held (stick, {coulomb}) dx shears it, at fixed contact if it is a glued cylinder, \
          whose dz is that of `contact_2d` by `move`: pressed deeper, then moved along by the \
          same dx. Under {coulomb} and on profiles dz goes on from the contact as it is.",
    fields: &[
        Field::new(
            "contact",
            Kind::Request,
            "",
            Presence::Required,
            "A contact_2d or contact_3d request; without `op` a contact_3d.",
        ),
        Field::new(
            "features",
            Kind::Names(FEATURES),
            "",
            Presence::Optional,
            "Rows; names of the thesis mean the same. Absent: m0, m1; in 3-D xc, M0, Mx, \
             theta_long_rad.",
        ),
        Field::new(
            "motions",
            Kind::Names(MOTIONS),
            "mm, rad",
            Presence::Optional,
            "Columns: dx, dy along the array, dz into the layer, turns about x, y, z (up) through \
             the indenter's origin, a round one's about its own axis. Absent: dx, dz; in 3-D dx, \
             dz, rx, rz.",
        ),
    ],
    answers: &[
        ("j", "[features*motions] row by row; null where undefined"),
        ("condition", "largest over smallest singular value, or null"),
        (
            "error_estimate",
            "[features*motions] what the entry may be off by: in plane strain its difference to \
             another level or to more points; on cells and elements the largest of twice its \
             difference to half as many, of that to the entry where one place more, or less, \
             touches or sticks (the edge is known to one place), and of half of what both sides of \
             the difference differ by; null as in `j`, or not known, as on one or two places",
        ),
        ("p_n_mm, q_n_mm", "N/mm, of a contact_2d"),
        ("force_n", "N, or N/mm without ends, of a contact_3d"),
        ("delta_mm", "mm, null for an edge"),
    ],
    run: jacobian,
}];

fn in_contact(failure: Failure) -> Failure {
    Failure { field: failure.field.map(|field| format!("contact.{field}")), ..failure }
}

/// The requested rows or columns, or the default when none are requested.
fn named_values<T: Copy>(
    args: &Args,
    list: &str,
    known: &[(&'static str, T)],
    absent: &[&str],
) -> Result<Vec<T>, Failure> {
    let names = if args.has(list) { args.names(list)? } else { absent };
    if names.is_empty() {
        let what = format!("`{list}`: the list is empty; name at least one");
        return Err(Failure::range(list, what));
    }
    let one = |(i, name): (usize, &&str)| {
        let found = known.iter().find(|(known, _)| known == name);
        found.map(|(_, value)| *value).ok_or_else(|| {
            let place = format!("{list}[{i}]");
            let all: Vec<&str> = known.iter().map(|(known, _)| *known).collect();
            let what = format!("`{place}` is \"{name}\"; this contact has: {}", all.join(", "));
            Failure::new("unknown_value", Some(&place), what)
        })
    };
    names.iter().enumerate().map(one).collect()
}

const SPACE_MOTIONS: [(&str, Motion); 6] = [
    ("dx", Motion::X),
    ("dy", Motion::Y),
    ("dz", Motion::Z),
    ("rx", Motion::RotX),
    ("ry", Motion::RotY),
    ("rz", Motion::RotZ),
];

fn jacobian(args: &Args) -> Result<Answer, Failure> {
    let known = [("contact_3d", space::CONTACT), ("contact_2d", plane::CONTACT)];
    let (op, contact) = args.request("contact", &known)?;
    if op == "contact_2d" {
        return plane_jacobian(args, &contact);
    }
    let features = named_values(args, "features", SPACE, &["xc", "M0", "Mx", "theta_long_rad"])?;
    let motions = named_values(args, "motions", &SPACE_MOTIONS, &["dx", "dz", "rx", "rz"])?;
    let space::ContactRequest { mut scene, drive, pose, shape } =
        space::ContactRequest::from_args(&contact).map_err(in_contact)?;
    let found = args
        .timed(|| in_space(&mut scene, drive, pose, &features, &motions))
        .map_err(|invalid| in_contact(space::failure(&invalid, shape)))?;
    let mut out = Answer::new();
    out.optional_numbers("j", found.values);
    out.optional_number("condition", found.condition);
    out.optional_numbers("error_estimate", found.errors);
    out.number("force_n", found.state.force_n);
    out.optional_number("delta_mm", found.state.penetration_mm);
    Ok(out)
}

fn plane_jacobian(args: &Args, contact: &Args) -> Result<Answer, Failure> {
    let features = named_values(args, "features", PLANE, &["m0", "m1"])?;
    let motions = named_values(args, "motions", &SPACE_MOTIONS, &["dx", "dz"])?;
    let (layer, _, depth) = indenter::layer_and_depth(contact).map_err(in_contact)?;
    let at = |halved: u32| indent::solve(contact, &layer, depth, &[], halved);
    let solved = at(0).map_err(in_contact)?;
    let found = (solved.contact, solved.descends);
    let on_places = matches!(
        solved.solver_state,
        SolverState::Cells(..) | SolverState::Mesh(..) | SolverState::MeshLine
    );
    let moved = |solved| MovableContact { layer, depth, features: &features, solved };
    let mut coarser = if on_places { at(1).ok().map(moved) } else { None };
    let mut moved = moved(solved);
    let mut column = |motion: Motion| {
        let column = moved.column(motion)?;
        if !on_places {
            return Ok(column);
        }
        let other = coarser.as_mut().and_then(|coarser| coarser.column(motion).ok());
        Ok(column.with_coarser(other.as_ref()))
    };
    let columns = args
        .timed(|| motions.iter().map(|motion| column(*motion)).collect::<Result<Vec<_>, _>>())
        .map_err(in_contact)?;
    let flat = |of: fn(&Column) -> &Vec<Option<f64>>| -> Vec<Option<f64>> {
        let row = |row: usize| columns.iter().map(move |column| of(column)[row]);
        (0..features.len()).flat_map(row).collect()
    };
    let values = flat(|column| &column.values);
    let mut out = Answer::new();
    out.optional_number("condition", condition(&values, motions.len()));
    out.optional_numbers("j", values);
    out.optional_numbers("error_estimate", flat(|column| &column.errors));
    out.number("p_n_mm", found.0.p_n_mm);
    out.number("q_n_mm", found.0.q_n_mm);
    out.optional_number("delta_mm", found.1.then_some(found.0.delta_mm));
    Ok(out)
}

/// A contact in plane strain that can be displaced by small motions.
struct MovableContact<'a> {
    layer: Layer,
    depth: f64,
    features: &'a [rates::Feature],
    solved: ContactSolution,
}

impl MovableContact<'_> {
    fn column(&mut self, motion: Motion) -> Result<Column, Failure> {
        let none = Column::undefined(self.features.len());
        if self.solved.contact.mode == Mode::Open {
            return Ok(none);
        }
        let motion = match motion {
            Motion::X => rates::Motion::X,
            Motion::Z => rates::Motion::Z,
            Motion::RotY => rates::Motion::RotY,
            // In plane strain the motion along y changes nothing, and the turns about x and z do
            // not exist.
            Motion::Y => return Ok(Column::exact(self.zero_derivatives())),
            Motion::RotX | Motion::RotZ => return Ok(none),
        };
        let slide = motion == rates::Motion::X;
        let symmetric = self.solved.symmetric;
        let (layer, depth, features) = (self.layer, self.depth, self.features);
        let image = |forces: &[[f64; 3]]| StressFeatures::new(&layer, forces, depth, symmetric);
        let shift = TractionRate { forces: Vec::new(), shift: 1.0 };
        match (&mut self.solved.solver_state, &self.solved.stress) {
            (SolverState::Line | SolverState::MeshLine, _) if !slide => Ok(none),
            (SolverState::Spectral(indenter), _) => {
                spectral_column(indenter, motion, features, depth, symmetric)
            }
            (SolverState::Glued(held, shape, dx), StressSource::Points(forces)) => {
                let image = image(forces);
                let rate = |more| held.rate_moved(*shape, motion, *dx, more);
                let [some, more] = [1, 2].map(|n| image.derivatives(&rate(n), features));
                Ok(Column::with_comparison(some, &more))
            }
            (
                SolverState::Cells(_, FrictionLaw::Free | FrictionLaw::Proportional(_))
                | SolverState::Line,
                stress,
            ) if slide => {
                let StressSource::Points(forces) = stress else { return Ok(none) };
                Ok(Column::exact(image(forces).derivatives(&shift, features)))
            }
            (
                SolverState::Mesh(_, FrictionLaw::Free | FrictionLaw::Proportional(_))
                | SolverState::MeshLine,
                stress,
            ) if slide => {
                let StressSource::NodalStress(nodes) = stress else { return Ok(none) };
                Ok(Column::exact(slide_derivatives(nodes, features)))
            }
            (SolverState::Cells(grip, _), _) => {
                let measure =
                    |grip: &FrictionalContact| Ok(image(&point_forces(grip)).features(features));
                differences(grip, motion, measure)
            }
            (SolverState::Mesh(both, _), _) => {
                let (grip, body) = &**both;
                let measure = |grip: &FrictionalContact| {
                    let nodes =
                        meshed::base_stress(body, grip.normal_n_mm(), grip.tangential_n_mm())?;
                    Ok(node_features(&nodes, features))
                };
                differences(grip, motion, measure)
            }
            _ => Ok(none),
        }
    }

    /// Derivatives of a motion that changes nothing: zero for each feature that is defined.
    fn zero_derivatives(&self) -> Vec<Option<f64>> {
        let features = match &self.solved.stress {
            StressSource::Points(forces) => {
                StressFeatures::new(&self.layer, forces, self.depth, false).features(self.features)
            }
            StressSource::NodalStress(nodes) => node_features(nodes, self.features),
        };
        features.iter().map(|feature| feature.map(|_| 0.0)).collect()
    }
}

/// Exact derivatives; their error is the difference from the derivatives of another level.
fn spectral_column(
    indenter: &mut Indenter,
    motion: rates::Motion,
    features: &[rates::Feature],
    depth: f64,
    symmetric: bool,
) -> Result<Column, Failure> {
    let contact = *indenter.contact();
    let other =
        if indenter.accuracy() == Accuracy::Default { Accuracy::Fine } else { Accuracy::Default };
    let mut beside = indenter.with_accuracy(other).map_err(|invalid| failure(&invalid))?;
    let load = Load { p_n_mm: contact.p_n_mm, q_n_mm: contact.q_n_mm };
    beside.press(&load).map_err(refusal_failure)?;
    let of = |indenter: &mut Indenter| {
        let forces = indenter.point_forces(depth);
        let image = StressFeatures::new(indenter.layer(), &forces, depth, symmetric);
        let rate = indenter.rate(motion, depth).map_err(refusal_failure)?;
        Ok(match rate {
            Some(rate) => image.derivatives(&rate, features),
            None => vec![None; features.len()],
        })
    };
    let values = of(indenter)?;
    let other = of(&mut beside)?;
    Ok(Column::with_comparison(values, &other))
}

fn point_forces(grip: &FrictionalContact) -> Vec<[f64; 3]> {
    let places = grip.compliance().x_mm.iter().zip(grip.normal_n_mm()).zip(grip.tangential_n_mm());
    places.map(|((x, p), q)| [*x, *p, *q]).collect()
}

fn node_features(nodes: &NodalStress, features: &[rates::Feature]) -> Vec<Option<f64>> {
    let (full, part) = (nodes.moments(false), nodes.compressive(&[]));
    let one = |feature: &rates::Feature| match *feature {
        rates::Feature::Moment(order) => full.m.get(order).copied(),
        rates::Feature::Centroid => full.centroid_mm(),
        rates::Feature::CompressiveMoment(order) => part.moments.m.get(order).copied(),
        rates::Feature::CompressiveCentroid => part.moments.centroid_mm(),
        rates::Feature::PeakPlace => Some(part.x_peak_mm),
        rates::Feature::PeakStress => Some(part.szz_peak_mpa),
    };
    features.iter().map(one).collect()
}

/// A slide along a mesh, with the derivatives of a slide along an infinite layer.
fn slide_derivatives(nodes: &NodalStress, features: &[rates::Feature]) -> Vec<Option<f64>> {
    let (full, part) = (nodes.moments(false).m, nodes.compressive(&[]).moments.m);
    let power = |m: &[f64; 4], order: usize| match order {
        0 => Some(0.0),
        _ => m.get(order - 1).map(|below| order as f64 * below),
    };
    let one = |feature: &rates::Feature| match *feature {
        rates::Feature::Moment(order) => power(&full, order),
        rates::Feature::CompressiveMoment(order) => power(&part, order),
        rates::Feature::PeakStress => Some(0.0),
        _ => Some(1.0),
    };
    features.iter().map(one).collect()
}
