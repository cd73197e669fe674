//! Calc operation on the elastic layer: `layer_line`. Refuses what the theory refuses, with the
//! request's own field names.

use taktil_mechanics::contact::Invalid;
use taktil_mechanics::contact::field::{LineLoad, LinePoint, line, line_half_plane};
use taktil_mechanics::contact::layer::Layer;

use super::Operation;
use super::answer::Answer;
use super::field::{Failure, Field, Kind, Need};
use super::request::Args;

/// Most points of one request.
const POINTS_MAX: usize = 100_000;

const fn number(name: &'static str, unit: &'static str, doc: &'static str) -> Field {
    Field::new(name, Kind::Number, unit, Need::Required, doc)
}

/// What this subject offers.
pub(super) const OPERATIONS: &[Operation] = &[Operation {
    name: "layer_line",
    doc: "Stresses and displacements under a line load on a bonded layer or a half plane.",
    fields: &[
        Field::new(
            "t_mm",
            Kind::NumberOrInfinity,
            "mm",
            Need::Required,
            "Thickness of the layer; \"inf\" for the half plane.",
        ),
        number("nu", "", "Poisson's ratio, in (-1, 0.5]."),
        number("p_n_mm", "N/mm", "Normal load, positive into the layer."),
        number("q_n_mm", "N/mm", "Tangential load, positive along x."),
        number("depth_mm", "mm", "Depth under the surface."),
        Field::new("x_mm", Kind::Numbers, "mm", Need::Required, "Places, from the load."),
        Field::new("youngs_mpa", Kind::Number, "MPa", Need::Default("27.58"), "Young's modulus."),
    ],
    answers: &[
        ("szz", "[n] MPa"),
        ("sxx", "[n] MPa"),
        ("sxz", "[n] MPa"),
        ("uz_mm", "[n] mm"),
        ("ux_mm", "[n] mm, null where infinite or undetermined"),
    ],
    run: layer_line,
}];

fn failure(invalid: &Invalid) -> Failure {
    let field = match invalid.place.as_str() {
        "thickness_mm" => "t_mm",
        "poisson" => "nu",
        other => other,
    };
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
    // The half plane's stresses do not ask for the constants; wrong ones are refused all the same.
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
    out.gaps("szz", column(|p| p.szz_mpa));
    out.gaps("sxx", column(|p| p.sxx_mpa));
    out.gaps("sxz", column(|p| p.sxz_mpa));
    out.gaps("uz_mm", column(|p| p.uz_mm));
    out.gaps("ux_mm", column(|p| p.ux_mm));
    Ok(out)
}
