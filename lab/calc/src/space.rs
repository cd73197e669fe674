//! Calc operation on contact in three dimensions: `contact_3d`. Unknown shapes, errors of the
//! solvers, and forces that no penetration reaches are errors.

use serde_json::{Map, Value};
use taktil_contact::features::{ImageFeatures, Part, image_features};
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::pin::PlanarPose;
use taktil_contact::space::scene::{Pose, Scene, SceneState, Shape};
use taktil_contact::space::tactels::{Array, Sampling};
use taktil_contact::{Accuracy, Invalid};

use super::Operation;
use super::answer::Answer;
use super::field::{Failure, Field, Kind, Presence, number};
use super::request::Args;

/// Largest number of rows or columns.
const SIDE_MAX: usize = 1024;
/// Smallest force or penetration other than 0.
const MAGNITUDE_MIN: f64 = 1e-30;
/// Ratio of the starting contact of a warm start to the requested one.
const WARM_START_FACTOR: f64 = 1.01;

pub(super) const fn default(name: &'static str, unit: &'static str, doc: &'static str) -> Field {
    Field::new(name, Kind::Number, unit, Presence::Default("0"), doc)
}

pub(super) const X: Field = default("x_mm", "mm", "Place of its origin.");
pub(super) const Y: Field = default("y_mm", "mm", "Place of its origin.");
pub(super) const ROT: Field = default("rot_rad", "rad", "Direction of the axis: (-sin, cos).");
pub(super) const TILT: Field =
    default("tilt_rad", "rad", "Slope of the axis, deeper towards its end.");
const LENGTH: Field =
    Field::new("length_mm", Kind::Number, "mm", Presence::Optional, "Absent: without ends.");
pub(super) const RADIUS: Field = number("radius_mm", "mm", "Radius.");

pub(super) const SPHERE: &[Field] = &[RADIUS, X, Y];
const CYLINDER: &[Field] = &[RADIUS, LENGTH, X, Y, ROT, TILT];
const EDGE: &[Field] = &[LENGTH, X, Y, ROT];
const BAR: &[Field] = &[number("width_mm", "mm", "Width."), LENGTH, X, Y, ROT, TILT];

const SHAPES: &[Field] = &[
    Field::new(
        "sphere",
        Kind::Table(SPHERE),
        "",
        Presence::Optional,
        "The exact sphere {radius_mm, x_mm, y_mm}.",
    ),
    Field::new(
        "cylinder",
        Kind::Table(CYLINDER),
        "",
        Presence::Optional,
        "Lying, with flat ends {radius_mm, length_mm, x_mm, y_mm, rot_rad, tilt_rad}; without \
         `length_mm` endless, and cut at the array when tilted.",
    ),
    Field::new(
        "edge",
        Kind::Table(EDGE),
        "",
        Presence::Optional,
        "An even line load {length_mm, x_mm, y_mm, rot_rad}; by force only.",
    ),
    Field::new(
        "bar",
        Kind::Table(BAR),
        "",
        Presence::Optional,
        "A flat face {width_mm, length_mm, x_mm, y_mm, rot_rad, tilt_rad}.",
    ),
];

/// Fields of the array.
pub(super) const ROWS: Field =
    Field::new("rows", Kind::Size(SIDE_MAX), "", Presence::Default("16"), "Rows, along y.");
pub(super) const COLS: Field =
    Field::new("cols", Kind::Size(SIDE_MAX), "", Presence::Default("16"), "Columns, along x.");
pub(super) const PITCH: Field =
    Field::new("pitch_mm", Kind::Number, "mm", Presence::Default("1.5875"), "Side of a tactel.");
pub(super) const SAMPLING: Field = Field::new(
    "sampling",
    Kind::Choice(&["area", "centre"]),
    "",
    Presence::Default("\"area\""),
    "Mean over the tactel, or the value under its centre.",
);
/// The part of an image that is kept.
pub(super) const PART: Field = Field::new(
    "part",
    Kind::Choice(&["full", "compressive"]),
    "",
    Presence::Default("\"full\""),
    "What the image keeps; the features are always of both.",
);

/// Fields of a contact.
pub(super) const CONTACT: &[Field] = &[
    Field::new("shape", Kind::Table(SHAPES), "", Presence::Required, "Exactly one of its fields."),
    number("t_mm", "mm", "Thickness of the layer."),
    number("nu", "", "Poisson's ratio, in (-1, 0.5]."),
    Field::new("youngs_mpa", Kind::Number, "MPa", Presence::Default("27.58"), "Young's modulus."),
    Field::new(
        "force_n",
        Kind::Number,
        "N",
        Presence::Optional,
        "Force of the whole indenter (N/mm for one without ends; tilted that is cut at the array, \
         in N); this or `penetration_mm`.",
    ),
    Field::new("penetration_mm", Kind::Number, "mm", Presence::Optional, "At the origin."),
    ROWS,
    COLS,
    PITCH,
    SAMPLING,
    Field::new(
        "beyond",
        Kind::Choice(&["layer", "nothing"]),
        "",
        Presence::Default("\"layer\""),
        "What lies beside the array: the layer goes on, or nothing does, so that a cylinder or bar \
         with a length is cut along its axis where it leaves the array; one that hangs over a side \
         is refused. Free edges are left out.",
    ),
    PART,
    Field::new(
        "level",
        Kind::Choice(&["fast", "default", "fine"]),
        "",
        Presence::Default("\"default\""),
        "Error of about 1e-2, 1e-3, 6e-4 of the peak or better (fine: 1e-4 away from ends); of a \
         sphere: 6e-4, 1e-4, 2e-7; without ends 5e-6 at every level.",
    ),
    Field::new(
        "start",
        Kind::Choice(&["cold", "warm"]),
        "",
        Presence::Default("\"cold\""),
        "With `timing`: from nothing, or from a contact of 1 % more; tables are built.",
    ),
];

/// The operations of this subject.
pub(super) const OPERATIONS: &[Operation] = &[Operation {
    name: "contact_3d",
    doc: "A rigid indenter, without friction, on a bonded layer over an array of tactels.",
    fields: CONTACT,
    answers: &[
        ("image", "[rows*cols] MPa, szz at the base, row by row, x and y ascending"),
        ("force_n", "N, or N/mm without ends and tilt"),
        ("delta_mm", "mm, null for an edge"),
        (
            "features",
            "{M0, My, Mx, xc, yc, mu_xx, mu_xy, mu_yy, theta_long_rad, the same with _c of \
                 the compressive part}; null where undefined",
        ),
        ("residual", "relative"),
    ],
    run: contact_3d,
}];

/// A request in the form that the solvers take.
pub(super) struct ContactRequest {
    pub(super) scene: Scene,
    pub(super) drive: Prescribed,
    pub(super) pose: Pose,
    pub(super) shape: &'static str,
}

impl ContactRequest {
    pub(super) fn from_args(args: &Args) -> Result<Self, Failure> {
        let (name, shape, pose) = shape_from_args(args)?;
        let layer = Layer {
            thickness_mm: args.number("t_mm")?,
            youngs_mpa: args.number("youngs_mpa")?,
            poisson: args.number("nu")?,
        };
        let (array, sampling) = array_from_args(args)?;
        let level = match args.choice("level")? {
            "fast" => Accuracy::Fast,
            "fine" => Accuracy::Fine,
            _ => Accuracy::Default,
        };
        let drive = drive_from_args(args)?;
        let scene = Scene::new(&layer, shape, &array, sampling, level)
            .map_err(|invalid| failure(&invalid, name))?;
        let pad = args.choice("beyond")? == "nothing";
        let scene = if pad { scene.cut_at_array() } else { scene };
        Ok(Self { scene, drive, pose, shape: name })
    }
}

/// The array of a request and what its tactels report.
pub(super) fn array_from_args(args: &Args) -> Result<(Array, Sampling), Failure> {
    let array = Array {
        rows: args.size("rows")?,
        cols: args.size("cols")?,
        pitch_mm: args.number("pitch_mm")?,
    };
    let area = args.choice("sampling")? == "area";
    Ok((array, if area { Sampling::Area } else { Sampling::Centre }))
}

/// The force or the penetration of a request.
pub(super) fn drive_from_args(args: &Args) -> Result<Prescribed, Failure> {
    let drive = match (args.has("force_n"), args.has("penetration_mm")) {
        (true, false) => Prescribed::ForceN(args.number("force_n")?),
        (false, true) => Prescribed::PenetrationMm(args.number("penetration_mm")?),
        (true, true) => {
            let what = "`force_n` and `penetration_mm` are both given: leave one of them out";
            return Err(Failure::new("conflict", Some("force_n"), what));
        }
        (false, false) => {
            let what = "give either `force_n` or `penetration_mm`";
            return Err(Failure::new("missing_field", Some("force_n"), what));
        }
    };
    refuse_tiny(drive)?;
    Ok(drive)
}

/// A force or penetration that is not 0 and smaller than [`MAGNITUDE_MIN`] is an error.
fn refuse_tiny(drive: Prescribed) -> Result<(), Failure> {
    let (field, value) = match drive {
        Prescribed::ForceN(force) => ("force_n", force),
        Prescribed::PenetrationMm(depth) => ("penetration_mm", depth),
    };
    if value == 0.0 || value.abs() >= MAGNITUDE_MIN {
        return Ok(());
    }
    let what = format!("`{field}`: {value:e} is beyond sense; give 0, or at least 1e-30");
    Err(Failure::range(field, what))
}

fn shape_from_args(args: &Args) -> Result<(&'static str, Shape, Pose), Failure> {
    let bad = || {
        let what = "`shape` has exactly one of the fields sphere, cylinder, edge, bar";
        Failure::new("wrong_type", Some("shape"), what)
    };
    let table = args.table("shape").ok_or_else(bad)?;
    let mut given = ["sphere", "cylinder", "edge", "bar"]
        .into_iter()
        .filter_map(|name| table.table(name).map(|inner| (name, inner)));
    let (Some((name, inner)), None) = (given.next(), given.next()) else { return Err(bad()) };
    let length_mm = if inner.has("length_mm") { Some(inner.number("length_mm")?) } else { None };
    let shape = match name {
        "sphere" => Shape::Sphere { radius_mm: inner.number("radius_mm")? },
        "cylinder" => Shape::Cylinder { radius_mm: inner.number("radius_mm")?, length_mm },
        "edge" => Shape::Edge { length_mm },
        _ => Shape::Bar { width_mm: inner.number("width_mm")?, length_mm },
    };
    let angle = |name: &str| if inner.has(name) { inner.number(name) } else { Ok(0.0) };
    let stand = PlanarPose {
        x_mm: inner.number("x_mm")?,
        y_mm: inner.number("y_mm")?,
        rot_rad: angle("rot_rad")?,
    };
    Ok((name, shape, Pose { planar: stand, tilt_rad: angle("tilt_rad")? }))
}

pub(super) fn failure(invalid: &Invalid, shape: &str) -> Failure {
    let field = match invalid.place.as_str() {
        "thickness_mm" => "t_mm".to_owned(),
        "poisson" => "nu".to_owned(),
        "penetration_max_mm" => "penetration_mm".to_owned(),
        inner @ ("radius_mm" | "length_mm" | "width_mm" | "tilt_rad" | "rot_rad" | "x_mm"
        | "y_mm") => format!("shape.{shape}.{inner}"),
        other => other.to_owned(),
    };
    Failure::range(&field, format!("`{field}`: {}; {}", invalid.what, invalid.remedy))
}

fn contact_3d(args: &Args) -> Result<Answer, Failure> {
    let ContactRequest { scene, drive, pose, shape } = ContactRequest::from_args(args)?;
    let array = *scene.array();
    let mut state = (scene, vec![0.0; array.len()]);
    let refused = |invalid: Invalid| failure(&invalid, shape);
    // The tables are computed once before the time is measured.
    state.0.press(drive, pose).map_err(refused)?;
    let warm = args.choice("start")? == "warm";
    let neighbour = match drive {
        Prescribed::ForceN(force) => Prescribed::ForceN(WARM_START_FACTOR * force),
        Prescribed::PenetrationMm(delta) => Prescribed::PenetrationMm(WARM_START_FACTOR * delta),
    };
    let prepare = |(scene, _): &mut (Scene, Vec<f64>)| {
        // A failure of the neighbouring contact only means a cold start.
        if !warm || scene.press(neighbour, pose).is_err() {
            scene.release();
        }
    };
    let compute = |(scene, image): &mut (Scene, Vec<f64>)| -> Result<SceneState, Invalid> {
        let touch = scene.press(drive, pose)?;
        scene.image(image)?;
        Ok(touch)
    };
    let touch = args.timed_with_setup(&mut state, prepare, compute).map_err(refused)?;
    if let Prescribed::ForceN(force) = drive
        && force > 0.0
        && touch.force_n == 0.0
    {
        let what = format!(
            "`force_n`: {force:e} N is no more than a billionth of the Young's modulus on a square \
             of the thickness, which cannot be told from none; give more, or 0"
        );
        return Err(Failure::new("unreachable", Some("force_n"), what));
    }
    let mut image = state.1;
    let features = features_as_json(&array, &image).map_err(refused)?;
    if args.choice("part")? == "compressive" {
        Part::Compressive.apply_to(&mut image);
    }
    let mut out = Answer::new();
    out.number_list("image", &image);
    out.number("force_n", touch.force_n);
    out.optional_number("delta_mm", touch.penetration_mm);
    out.value("features", features);
    out.number("residual", touch.residual);
    Ok(out)
}

/// Features of an image and of its compressive part.
pub(super) fn features_as_json(array: &Array, image: &[f64]) -> Result<Value, Invalid> {
    let mut named = Map::new();
    for (part, ending) in [(Part::Full, ""), (Part::Compressive, "_c")] {
        push_features(&mut named, &image_features(array, image, part)?, ending);
    }
    Ok(Value::Object(named))
}

/// Features under the names of the reference data; they are finite because the image is.
fn push_features(out: &mut Map<String, Value>, f: &ImageFeatures, ending: &str) {
    let all = [
        ("M0", Some(f.m0)),
        ("My", Some(f.my)),
        ("Mx", Some(f.mx)),
        ("xc", f.xc),
        ("yc", f.yc),
        ("mu_xx", f.mu_xx),
        ("mu_xy", f.mu_xy),
        ("mu_yy", f.mu_yy),
        ("theta_long_rad", f.theta_long_rad),
    ];
    for (name, value) in all {
        out.insert(format!("{name}{ending}"), value.map_or(Value::Null, Value::from));
    }
}
