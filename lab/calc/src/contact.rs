//! Calc operations on one elastic layer and on several: `layer_line` and `layer_point`. Values
//! outside the theory's range are errors under the request's own field names.

use taktil_contact::Invalid;
use taktil_contact::field::{LineLoad, LinePoint, line, line_half_plane};
use taktil_contact::layer::Layer;
use taktil_contact::space::field::{PointLoad, point};
use taktil_contact::stack::Stack;

use super::Operation;
use super::answer::Answer;
use super::field::{Failure, Field, Kind, Presence, number};
use super::request::Args;

/// Most points of one request.
const POINTS_MAX: usize = 100_000;

/// Fields of one of several layers.
const LAYER: &[Field] = &[
    number("t_mm", "mm", "Thickness."),
    number("nu", "", "Poisson's ratio, in (-1, 0.5]."),
    Field::new("youngs_mpa", Kind::Number, "MPa", Presence::Default("27.58"), "Young's modulus."),
];

/// Layers of a request.
pub(super) const LAYERS: Field = Field::new(
    "layers",
    Kind::Tables(LAYER),
    "",
    Presence::Required,
    "One layer or several on each other, the one at the surface first.",
);

/// The layers of a request after each was checked.
pub(super) fn layers_from_args(args: &Args) -> Result<Stack, Failure> {
    let mut layers = Vec::new();
    for (i, table) in args.tables("layers")?.iter().enumerate() {
        let layer = Layer {
            thickness_mm: table.number("t_mm")?,
            youngs_mpa: table.number("youngs_mpa")?,
            poisson: table.number("nu")?,
        };
        layer.check().map_err(|invalid| {
            let place = format!("layers[{i}].{}", request_field(&invalid.place));
            let what = format!("`{place}`: {}; {}", invalid.what, invalid.remedy);
            Failure::range(&place, what)
        })?;
        layers.push(layer);
    }
    Stack::new(&layers).map_err(|invalid| failure(&invalid))
}

/// The operations of this subject.
pub(super) const OPERATIONS: &[Operation] = &[LINE, POINT];

const POINT: Operation = Operation {
    name: "layer_point",
    doc: "Stresses and displacements under a point load on bonded layers, at any depth.",
    fields: &[
        LAYERS,
        number("p_n", "N", "Normal load, positive into the layers."),
        Field::new("q_n", Kind::Number, "N", Presence::Default("0"), "Tangential load along x."),
        number("depth_mm", "mm", "Depth under the surface, above 0."),
        Field::new("x_mm", Kind::Numbers, "mm", Presence::Required, "Places, from the load."),
        Field::new("y_mm", Kind::Numbers, "mm", Presence::Required, "Their y, as many."),
    ],
    answers: &[
        ("stress", "[n][6] MPa, xx yy zz yz xz xy, z up"),
        ("displacement_mm", "[n][3] mm, along x, y and z"),
    ],
    run: layer_point,
};

const LINE: Operation = Operation {
    name: "layer_line",
    doc: "Stresses and displacements under a line load on a bonded layer or a half plane.",
    fields: &[
        Field::new(
            "t_mm",
            Kind::NumberOrInfinity,
            "mm",
            Presence::Required,
            "Thickness of the layer; \"inf\" for the half plane.",
        ),
        number("nu", "", "Poisson's ratio, in (-1, 0.5]."),
        number("p_n_mm", "N/mm", "Normal load, positive into the layer."),
        number("q_n_mm", "N/mm", "Tangential load, positive along x."),
        number("depth_mm", "mm", "Depth under the surface."),
        Field::new("x_mm", Kind::Numbers, "mm", Presence::Required, "Places, from the load."),
        Field::new(
            "youngs_mpa",
            Kind::Number,
            "MPa",
            Presence::Default("27.58"),
            "Young's modulus.",
        ),
    ],
    answers: &[
        ("szz", "[n] MPa"),
        ("sxx", "[n] MPa"),
        ("sxz", "[n] MPa"),
        ("uz_mm", "[n] mm"),
        ("ux_mm", "[n] mm, null where infinite or undetermined"),
    ],
    run: layer_line,
};

/// The field of the request that holds a layer's constant.
fn request_field(place: &str) -> &str {
    match place {
        "thickness_mm" => "t_mm",
        "poisson" => "nu",
        other => other,
    }
}

fn failure(invalid: &Invalid) -> Failure {
    let field = request_field(&invalid.place);
    Failure::range(field, format!("`{field}`: {}; {}", invalid.what, invalid.remedy))
}

fn layer_line(args: &Args) -> Result<Answer, Failure> {
    let layer = Layer {
        thickness_mm: args.number("t_mm")?,
        youngs_mpa: args.number("youngs_mpa")?,
        poisson: args.number("nu")?,
    };
    let load = LineLoad { p_n_mm: args.number("p_n_mm")?, q_n_mm: args.number("q_n_mm")? };
    let depth = args.number("depth_mm")?;
    let x_mm = args.numbers("x_mm")?;
    if x_mm.len() > POINTS_MAX {
        let what = format!("`x_mm` has {} places; at most {POINTS_MAX} are taken", x_mm.len());
        return Err(Failure::new("wrong_length", Some("x_mm"), what));
    }
    let half_plane = layer.thickness_mm.is_infinite();
    // The stresses of the half plane do not depend on the constants, but wrong constants are errors
    // here too.
    let constants =
        Layer { thickness_mm: if half_plane { 1.0 } else { layer.thickness_mm }, ..layer };
    constants.check().map_err(|invalid| failure(&invalid))?;
    let points = args
        .timed(|| {
            if half_plane {
                line_half_plane(&load, depth, x_mm)
            } else {
                line(&layer, &load, depth, x_mm)
            }
        })
        .map_err(|invalid| failure(&invalid))?;
    let mut out = Answer::new();
    let column = |of: fn(&LinePoint) -> Option<f64>| points.iter().map(of).collect::<Vec<_>>();
    out.optional_numbers("szz", column(|p| p.szz_mpa));
    out.optional_numbers("sxx", column(|p| p.sxx_mpa));
    out.optional_numbers("sxz", column(|p| p.sxz_mpa));
    out.optional_numbers("uz_mm", column(|p| p.uz_mm));
    out.optional_numbers("ux_mm", column(|p| p.ux_mm));
    Ok(out)
}

fn layer_point(args: &Args) -> Result<Answer, Failure> {
    let stack = layers_from_args(args)?;
    let load = PointLoad { p_n: args.number("p_n")?, q_n: args.number("q_n")? };
    let depth = args.number("depth_mm")?;
    let [x, y] = [args.numbers("x_mm")?, args.numbers("y_mm")?];
    if x.len() != y.len() || x.len() > POINTS_MAX {
        let what = format!(
            "`y_mm` has {} places for {} of `x_mm`: give as many, and at most {POINTS_MAX}",
            y.len(),
            x.len()
        );
        return Err(Failure::new("wrong_length", Some("y_mm"), what));
    }
    let places: Vec<[f64; 2]> = x.iter().zip(y).map(|(x, y)| [*x, *y]).collect();
    let fields =
        args.timed(|| point(&stack, &load, depth, &places)).map_err(|invalid| failure(&invalid))?;
    let mut out = Answer::new();
    out.number_rows("stress", fields.iter().map(|field| &field.stress_mpa));
    out.number_rows("displacement_mm", fields.iter().map(|field| &field.moved_mm));
    Ok(out)
}
