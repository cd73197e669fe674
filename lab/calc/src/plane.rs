//! Calc operation on plane contact: `contact_2d`. Unknown shapes, loads without an equilibrium, and
//! methods that do not support a shape or a friction law are errors.

use serde_json::{Value, json};
use taktil_contact::plane::features::{Compressive, Moments, compressive, moments};
use taktil_contact::plane::{Contact, Mode, Spectrum};

use super::Operation;
use super::answer::Answer;
use super::field::{Failure, Field, Kind, Presence, number};
use super::indent;
use super::indenter::layer_and_depth;
use super::nodes::NodalStress;
use super::request::Args;
use super::solved::StressSource;

const fn optional(name: &'static str, kind: Kind, doc: &'static str) -> Field {
    Field::new(name, kind, "", Presence::Optional, doc)
}

const fn choice(
    name: &'static str,
    texts: &'static [&'static str],
    default: &'static str,
    doc: &'static str,
) -> Field {
    Field::new(name, Kind::Choice(texts), "", Presence::Default(default), doc)
}

const FLAT: &[Field] = &[
    number("width_mm", "mm", "Width."),
    Field::new("height_mm", Kind::Number, "mm", Presence::Default("6.35"), "Height of the loads."),
];
const CYLINDER: &[Field] = &[number("radius_mm", "mm", "Radius of the exact circle.")];
const PROFILE: &[Field] = &[
    Field::new("x_mm", Kind::Numbers, "mm", Presence::Required, "Places, ascending."),
    Field::new("z_mm", Kind::Numbers, "mm", Presence::Required, "Heights of the lower face, up."),
];
const SHAPES: &[Field] = &[
    optional("knife", Kind::Table(&[]), "A line load; Q acts whatever the friction."),
    optional("flat", Kind::Table(FLAT), "A bar {width_mm, height_mm}."),
    optional("cylinder", Kind::Table(CYLINDER), "A circle {radius_mm}."),
    optional("profile", Kind::Table(PROFILE), "Straight between {x_mm, z_mm}, held upright."),
];
const LOAD: &[Field] = &[
    number("p_n_mm", "N/mm", "Normal load, positive into the layer."),
    Field::new("q_n_mm", Kind::Number, "N/mm", Presence::Default("0"), "Tangential load."),
];
const MOVE: &[Field] = &[
    number("dz_mm", "mm", "Descent, upright."),
    Field::new("dx_mm", Kind::Number, "mm", Presence::Default("0"), "Then a move along x."),
];
const COULOMB: &[Field] = &[number("coulomb", "", "Coefficient of friction.")];

/// Fields of a contact.
pub(super) const CONTACT: &[Field] = &[
    Field::new("shape", Kind::Table(SHAPES), "", Presence::Required, "One of its fields."),
    number("t_mm", "mm", "Thickness of the layer."),
    number("nu", "", "Poisson's ratio, in (-1, 0.5]."),
    Field::new("youngs_mpa", Kind::Number, "MPa", Presence::Default("27.58"), "Young's modulus."),
    optional("load", Kind::Table(LOAD), "Loads, N/mm; this or `move`."),
    optional("move", Kind::Table(MOVE), "Descent and tangential move, mm."),
    Field::new(
        "friction",
        Kind::ChoiceOrTable(&["none", "prop", "stick"], COULOMB),
        "",
        Presence::Default("\"none\""),
        "No shear; shear in proportion to pressure; no slip; or {coulomb}. \"none\": of Q a bar \
         feels its moment, others refuse it. \"stick\": what is touched stays where it is on the \
         indenter. A cylinder grows so in endless small steps of P, symmetric, then moves along by \
         Q or dx with its contact glued, which neither grows nor parts: linear, `pull_n_mm` says \
         what its edge pulls. Bars and profiles are pressed on in 64 steps with Q beside P (by \
         `move`: down, then along), and part and touch as they must; a circle's peak by P alone \
         differs by up to 0.3 % between the two. {coulomb}: in the same 64 steps, with slip.",
    ),
    choice(
        "method",
        &["layer", "fem"],
        "\"layer\"",
        "The exact infinite layer, or elements over 25.4 mm with free ends.",
    ),
    choice(
        "level",
        &["fast", "default", "fine"],
        "\"default\"",
        "Error of about 1e-3, 1e-5, 1e-8 of the peak; with cells (profile, coulomb, a bar's stick) \
         48, 96, 192 of them: 2e-3, 6e-4, 2e-4 under sharp corners, less elsewhere. A cylinder's \
         \"stick\" has one level of all, 1e-4.",
    ),
    Field::new("mesh", Kind::Vector(2), "", Presence::Default("[64, 4]"), "Elements, for `fem`."),
    choice(
        "start",
        &["warm", "cold"],
        "\"warm\"",
        "With `timing`: from a contact of 1 % more, or from nothing; tables are built.",
    ),
    Field::new("depth_mm", Kind::Number, "mm", Presence::Optional, "Depth of szz; t when absent."),
    Field::new("x_mm", Kind::Numbers, "mm", Presence::Default("[]"), "Places, from its centre."),
    Field::new(
        "threshold_mpa",
        Kind::Numbers,
        "MPa",
        Presence::Default("[]"),
        "For widths, 0 or more.",
    ),
];

/// The operations of this subject.
pub(super) const OPERATIONS: &[Operation] = &[Operation {
    name: "contact_2d",
    doc: "A rigid indenter on a bonded layer in plane strain, by load or by move.",
    fields: CONTACT,
    answers: &[
        ("p_n_mm", "N/mm"),
        ("q_n_mm", "N/mm"),
        ("delta_mm", "mm, null for a knife"),
        ("slope", ""),
        ("x_left_mm", "mm"),
        ("x_right_mm", "mm"),
        (
            "pull_n_mm",
            "N/mm, what the edge of a glued cylinder pulls, on either side the more; 0 of all that \
             may part",
        ),
        ("mode", "open, full, left or right (edge lifted), free"),
        ("pressure", "[n] MPa, null where infinite or not resolved"),
        ("szz", "[n] MPa"),
        (
            "features",
            "{full, compressive}; full over the infinite layer, compressive of min(szz, 0) over \
             |x| <= 12.7 mm, as wide as the array, and so are its x_peak and szz_peak: where \
             x_peak is an end of it, the largest may lie beyond",
        ),
        ("residual", "of the load"),
        ("ns", "with `timing`: of the contact's solution, without profile and features"),
    ],
    run: contact_2d,
}];

fn contact_2d(args: &Args) -> Result<Answer, Failure> {
    let (layer, x_mm, depth) = layer_and_depth(args)?;
    let thickness_mm = layer.thickness_mm;
    let thresholds = thresholds(args)?;
    let solved = indent::solve(args, &layer, depth, x_mm, 0)?;
    let mut out = Answer::new();
    push_contact(&mut out, &solved.contact, solved.descends);
    out.number("pull_n_mm", solved.pull_n_mm);
    out.optional_numbers("pressure", solved.pressure.iter().copied());
    let (szz, full, part) = match &solved.stress {
        StressSource::Points(forces) => {
            let far = forces.iter().map(|f| f[0].abs()).fold(12.7, f64::max);
            let reach = x_mm.iter().fold(far, |most, x| most.max(x.abs())) + 20.0 * thickness_mm;
            let stress = Spectrum::new(&layer, forces, depth, reach);
            let szz: Vec<f64> = x_mm.iter().map(|x| stress.szz(*x)).collect();
            let full = moments(&layer, forces, depth);
            (szz, full, compressive(&stress, solved.symmetric, thresholds))
        }
        StressSource::NodalStress(nodes) => nodal_features(nodes, x_mm, thresholds),
    };
    out.number_list("szz", &szz);
    out.value("features", features_as_json(&full, &part));
    out.number("residual", solved.contact.residual);
    Ok(out)
}

fn thresholds(args: &Args) -> Result<&[f64], Failure> {
    let thresholds = args.numbers("threshold_mpa")?;
    if let Some(i) = thresholds.iter().position(|threshold| *threshold < 0.0) {
        let field = format!("threshold_mpa[{i}]");
        let what = format!("`{field}` is {}; give 0 or more: of compression", thresholds[i]);
        return Err(Failure::range(&field, what));
    }
    Ok(thresholds)
}

fn push_contact(out: &mut Answer, contact: &Contact, descends: bool) {
    out.number("p_n_mm", contact.p_n_mm);
    out.number("q_n_mm", contact.q_n_mm);
    out.optional_number("delta_mm", descends.then_some(contact.delta_mm));
    out.number("slope", contact.slope);
    out.number("x_left_mm", contact.x_left_mm);
    out.number("x_right_mm", contact.x_right_mm);
    let mode = match contact.mode {
        Mode::Open => "open",
        Mode::Full => "full",
        Mode::LeftLifted => "left",
        Mode::RightLifted => "right",
        Mode::Free => "free",
    };
    out.value("mode", Value::from(mode));
}

fn nodal_features(
    nodes: &NodalStress,
    x: &[f64],
    thresholds: &[f64],
) -> (Vec<f64>, Moments, Compressive) {
    let szz = x.iter().map(|x| nodes.szz(*x)).collect();
    (szz, nodes.moments(false), nodes.compressive(thresholds))
}

fn features_as_json(full: &Moments, part: &Compressive) -> Value {
    let shown = |m: &Moments| {
        let c = m.centroid_mm();
        json!({"m0": m.m[0], "m1": m.m[1], "m2": m.m[2], "m3": m.m[3], "x_c": c})
    };
    let mut compressed = shown(&part.moments);
    compressed["x_peak"] = json!(part.x_peak_mm);
    compressed["szz_peak"] = json!(part.szz_peak_mpa);
    compressed["widths_mm"] = json!(part.widths_mm);
    json!({"full": shown(full), "compressive": compressed})
}
