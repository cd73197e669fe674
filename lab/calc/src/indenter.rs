//! What a `contact_2d` request prescribes: the shape of the indenter, its load or move, and the
//! layer with the positions and the depth at which the stress is wanted.

use taktil_contact::layer::Layer;
use taktil_contact::plane::{Load, Shape};

use super::field::Failure;
use super::refusal::failure;
use super::request::Args;

/// Largest number of positions in one request.
const POINTS_MAX: usize = 100_000;
/// Smallest depth of the stress, as a fraction of the thickness.
const DEPTH_SHARE_MIN: f64 = 1e-12;
/// Largest coordinate of a profile, mm.
const PROFILE_COORDINATE_MAX_MM: f64 = 1e30;

/// The shape of the indenter.
pub(super) enum IndenterShape {
    Knife,
    Rigid(Shape),
    /// Positions and heights of a profile.
    Profile(Vec<f64>, Vec<f64>),
}

pub(super) fn shape_from_args(args: &Args) -> Result<IndenterShape, Failure> {
    let table = args.table("shape").ok_or_else(bad_shape)?;
    let mut shapes = Vec::new();
    if table.table("knife").is_some() {
        shapes.push(IndenterShape::Knife);
    }
    if let Some(flat) = table.table("flat") {
        let (width_mm, height_mm) = (flat.number("width_mm")?, flat.number("height_mm")?);
        shapes.push(IndenterShape::Rigid(Shape::Flat { width_mm, height_mm }));
    }
    if let Some(cylinder) = table.table("cylinder") {
        let radius_mm = cylinder.number("radius_mm")?;
        shapes.push(IndenterShape::Rigid(Shape::Cylinder { radius_mm }));
    }
    if let Some(profile) = table.table("profile") {
        let (x, z) = (profile.numbers("x_mm")?, profile.numbers("z_mm")?);
        if x.len() < 2 || x.len() != z.len() || !x.windows(2).all(|w| w[0] < w[1]) {
            let what = "`shape.profile` has two or more `x_mm`, ascending, and as many `z_mm`";
            return Err(Failure::new("wrong_length", Some("shape.profile"), what));
        }
        for (name, list) in [("x_mm", x), ("z_mm", z)] {
            if let Some(i) = list.iter().position(|place| place.abs() > PROFILE_COORDINATE_MAX_MM) {
                let field = format!("shape.profile.{name}[{i}]");
                let what = format!("`{field}` is {:e}; give at most 1e30", list[i]);
                return Err(Failure::range(&field, what));
            }
        }
        shapes.push(IndenterShape::Profile(x.to_vec(), z.to_vec()));
    }
    if let Some(IndenterShape::Rigid(shape)) = shapes.last() {
        shape.check().map_err(|invalid| failure(&invalid))?;
    }
    match shapes.pop() {
        Some(shape) if shapes.is_empty() => Ok(shape),
        _ => Err(bad_shape()),
    }
}

fn bad_shape() -> Failure {
    let what = "`shape` has exactly one of the fields knife, flat, cylinder, profile";
    Failure::new("wrong_type", Some("shape"), what)
}

/// The prescribed load or move.
#[derive(Clone, Copy)]
pub(super) enum Prescribed {
    Load(Load),
    Move { dz: f64, dx: f64 },
}

pub(super) fn prescribed_from_args(args: &Args) -> Result<Prescribed, Failure> {
    match (args.table("load"), args.table("move")) {
        (Some(load), None) => {
            let (p, q) = (load.number("p_n_mm")?, load.number("q_n_mm")?);
            Ok(Prescribed::Load(Load { p_n_mm: p, q_n_mm: q }))
        }
        (None, Some(motion)) => {
            Ok(Prescribed::Move { dz: motion.number("dz_mm")?, dx: motion.number("dx_mm")? })
        }
        _ => {
            let what = "give either `load` {p_n_mm, q_n_mm} or `move` {dz_mm, dx_mm}";
            Err(Failure::new("missing_field", Some("load"), what))
        }
    }
}

/// Layer, positions and depth of a request.
pub(super) fn layer_and_depth(args: &Args) -> Result<(Layer, &[f64], f64), Failure> {
    let (thickness_mm, youngs_mpa) = (args.number("t_mm")?, args.number("youngs_mpa")?);
    let layer = Layer::new(thickness_mm, youngs_mpa, args.number("nu")?)
        .map_err(|invalid| failure(&invalid))?;
    let x_mm = args.numbers("x_mm")?;
    if x_mm.len() > POINTS_MAX {
        let what = format!("`x_mm` has {} places; at most {POINTS_MAX} are taken", x_mm.len());
        return Err(Failure::new("wrong_length", Some("x_mm"), what));
    }
    let depth = if args.has("depth_mm") { args.positive("depth_mm")? } else { thickness_mm };
    if depth > thickness_mm {
        let what = format!("`depth_mm` is {depth}; the layer ends at {thickness_mm}");
        return Err(Failure::range("depth_mm", what));
    }
    if depth < DEPTH_SHARE_MIN * thickness_mm {
        let least = DEPTH_SHARE_MIN;
        let what = format!("`depth_mm` is {depth:e}; give at least {least:e} of `t_mm`");
        return Err(Failure::range("depth_mm", what));
    }
    Ok((layer, x_mm, depth))
}
