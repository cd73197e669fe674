//! The thesis's figures of plane contact, computed on the exact layer: stress under a knife edge,
//! a flat bar and a cylinder at three thicknesses (3.3 to 3.11), the tilting bar (4.9 to 4.14),
//! the cylinder held without slip (4.16 to 4.21). Refuses what the contact modules refuse.

use taktil_mechanics::contact::field::{LineLoad, line, line_half_plane};
use taktil_mechanics::contact::half_plane::{
    cylinder_half_width_mm, cylinder_stresses, punch_stresses,
};
use taktil_mechanics::contact::layer::Layer;
use taktil_mechanics::contact::plane::features::compressive;
use taktil_mechanics::contact::plane::noslip::NoSlip;
use taktil_mechanics::contact::plane::{Friction, Indenter, Level, Load, Shape, Spectrum};

use super::curves::{Chart, Curve};
use super::statements::{LB_PER_IN, layer, plainly};
use crate::plot::svg::Figure;

/// Depth at which the thesis compares thick layers with thin ones.
const DEPTH_MM: f64 = 0.8;

fn places(reach: f64, count: u32) -> Vec<f64> {
    (0..=count).map(|i| reach * (2.0 * f64::from(i) / f64::from(count) - 1.0)).collect()
}

fn curve(label: impl Into<String>, x: &[f64], y: impl IntoIterator<Item = f64>) -> Curve {
    let points = x.iter().copied().zip(y).collect();
    Curve { label: label.into(), points, dashed: false }
}

/// Every figure with the name of its file.
pub(super) fn all() -> anyhow::Result<Vec<(&'static str, Figure)>> {
    Ok(vec![
        ("fig-3-3-knife-szz.svg", knife(false)?.figure()),
        ("fig-3-4-knife-sxx.svg", knife(true)?.figure()),
        ("fig-3-8-bar.svg", bar()?.figure()),
        ("fig-3-10-cylinder.svg", cylinder()?.figure()),
        ("fig-4-9-tilting-bar.svg", tilting()?.figure()),
        ("fig-4-12-first-moment.svg", moment()?.figure()),
        ("fig-4-18-cylinder-moves.svg", held()?.figure()),
    ])
}

fn knife(along: bool) -> anyhow::Result<Chart> {
    let x = places(4.0, 400);
    let load = LineLoad { p_n_mm: 0.5 * LB_PER_IN, q_n_mm: 0.0 };
    let pick = |p: &taktil_mechanics::contact::field::LinePoint| {
        1e3 * if along { p.sxx_mpa } else { p.szz_mpa }.unwrap_or(f64::NAN)
    };
    let mut curves = Vec::new();
    for t in [0.8, 12.7, 25.4] {
        let points = line(&layer(t, 0.49)?, &load, DEPTH_MM, &x).map_err(plainly)?;
        curves.push(curve(format!("t = {t} mm"), &x, points.iter().map(pick)));
    }
    let half = line_half_plane(&load, DEPTH_MM, &x).map_err(plainly)?;
    let mut half = curve("half plane", &x, half.iter().map(pick));
    half.dashed = true;
    curves.push(half);
    let (what, remark) = if along {
        ("s_xx", "thesis: half plane -18 kPa at +-0.8 mm, thin layer -90 kPa; here -17.4, -86.4")
    } else {
        (
            "s_zz",
            "thesis: half plane -65 kPa, thin -100 kPa, then positive; here -69.7, -89.9, never",
        )
    };
    Ok(Chart {
        title: format!("Knife edge, 0.0876 N/mm: {what} at a depth of 0.8 mm"),
        x: "x (mm)",
        y: "stress (kPa)",
        curves,
        remarks: vec![remark.to_owned()],
    })
}

fn stress_under(t: f64, shape: Shape, p_n_mm: f64, x: &[f64]) -> anyhow::Result<Vec<f64>> {
    let layer = layer(t, 0.49)?;
    let mut body = Indenter::new(&layer, shape, Friction::None, Level::Fine).map_err(plainly)?;
    body.press(&Load { p_n_mm, q_n_mm: 0.0 })?;
    let stress = Spectrum::new(&layer, &body.point_forces(DEPTH_MM), DEPTH_MM, 40.0);
    Ok(x.iter().map(|x| 1e3 * stress.szz(*x)).collect())
}

fn bar() -> anyhow::Result<Chart> {
    let x = places(10.0, 400);
    let shape = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
    let mut curves = Vec::new();
    for t in [0.8, 12.7, 25.4] {
        curves.push(curve(format!("t = {t} mm"), &x, stress_under(t, shape, 1.96, &x)?));
    }
    let half = |x: &f64| 1e3 * punch_stresses(1.96, 6.35, *x, DEPTH_MM).szz_mpa;
    let mut half = curve("half plane", &x, x.iter().map(half));
    half.dashed = true;
    curves.push(half);
    Ok(Chart {
        title: "Flat bar 12.7 mm wide, 1.96 N/mm: s_zz at a depth of 0.8 mm".to_owned(),
        x: "x (mm)",
        y: "stress (kPa)",
        curves,
        remarks: vec![
            "thesis: thin layer highest at the centre, thick at the edges: so it is".to_owned(),
            "thesis: the half plane's oscillates near the edge: with A.17 corrected it does not"
                .to_owned(),
        ],
    })
}

fn cylinder() -> anyhow::Result<Chart> {
    let x = places(4.0, 400);
    let (radius, p) = (25.4, 0.7);
    let shape = Shape::Cylinder { radius_mm: radius };
    let mut curves = Vec::new();
    for t in [0.8, 3.2, 12.8] {
        curves.push(curve(format!("t = {t} mm"), &x, stress_under(t, shape, p, &x)?));
    }
    let half_width = cylinder_half_width_mm(&layer(1.0, 0.49)?, radius, p);
    let half = |x: &f64| 1e3 * cylinder_stresses(p, half_width, *x, DEPTH_MM).szz_mpa;
    let mut half = curve("half plane", &x, x.iter().map(half));
    half.dashed = true;
    curves.push(half);
    Ok(Chart {
        title: "Cylinder R = 25.4 mm, 0.7 N/mm: s_zz at a depth of 0.8 mm".to_owned(),
        x: "x (mm)",
        y: "stress (kPa)",
        curves,
        remarks: vec![
            "thesis: 3.2 and 12.8 mm nearly the same, the thin layer higher: so it is".to_owned(),
        ],
    })
}

fn tilting() -> anyhow::Result<Chart> {
    let x = places(12.7, 500);
    let layer: Layer = layer(0.8, 0.49)?;
    let shape = Shape::Flat { width_mm: 12.7, height_mm: 12.7 };
    let mut curves = Vec::new();
    let mut widths = Vec::new();
    for q in [0.0, 0.0175, 0.0350, 0.0613] {
        let mut body =
            Indenter::new(&layer, shape, Friction::Proportional, Level::Fine).map_err(plainly)?;
        let contact = body.press(&Load { p_n_mm: 0.175, q_n_mm: q })?;
        let stress = Spectrum::new(&layer, &body.point_forces(0.8), 0.8, 40.0);
        let part = compressive(&stress, q == 0.0, &[]);
        let szz = x.iter().map(|x| 1e3 * stress.szz(*x));
        widths.push(format!(
            "Q = {q}: touches {:.2} mm, peak {:.1} kPa at {:.2} mm",
            contact.x_right_mm - contact.x_left_mm,
            1e3 * part.szz_peak_mpa,
            part.x_peak_mm
        ));
        curves.push(curve(format!("Q = {q}"), &x, szz));
    }
    widths
        .push("thesis: at (0.175, 0.0613) it spans 12 to 20 mm: so it does, with h = 12.7".into());
    Ok(Chart {
        title: "Bar 12.7 mm wide and high, P = 0.175 N/mm: base s_zz as Q grows".to_owned(),
        x: "x (mm)",
        y: "stress (kPa)",
        curves,
        remarks: widths,
    })
}

fn moment() -> anyhow::Result<Chart> {
    let loads: Vec<f64> = (0..=10).map(|k| 0.00876 * f64::from(k)).collect();
    let mut curves = Vec::new();
    for p in [0.175, 0.35, 0.525, 0.7] {
        let about_end = |q: &f64| -25.4 * ((12.7 + 0.8) * q + 12.7 * p);
        curves.push(curve(format!("P = {p}"), &loads, loads.iter().map(about_end)));
    }
    Ok(Chart {
        title: "First moment about the sensor's end over 25.4 mm, h = 12.7 mm".to_owned(),
        x: "Q (N/mm)",
        y: "M1 (N mm)",
        curves,
        remarks: vec![
            "statics, exact for every width: M1 = -25.4 (12.7 P + (h + t) Q)".to_owned(),
            "thesis (4.3): 319.9 P - 339.3 Q - 0.016, P counted negative; here 322.6 and 342.9"
                .to_owned(),
        ],
    })
}

fn held() -> anyhow::Result<Chart> {
    let layer = layer(0.8, 0.49)?;
    let shape = Shape::Cylinder { radius_mm: 22.9 };
    let widths: Vec<f64> = (2..=20).map(|k| 0.125 * f64::from(k)).collect();
    let mut rows = Vec::new();
    for b in &widths {
        let held = NoSlip::widen(&layer, shape, *b).map_err(|e| anyhow::anyhow!("{e:?}"))?;
        rows.push((held.delta_mm, held.tangential_n_mm2, held.first_moment_n_mm, held.p_n_mm));
    }
    let descents: Vec<f64> = rows.iter().map(|row| row.0).collect();
    let steps = || rows.windows(2);
    let normal: Vec<f64> = steps().map(|w| (w[1].3 - w[0].3) / (w[1].0 - w[0].0)).collect();
    let middles: Vec<f64> = steps().map(|w| 0.5 * (w[0].0 + w[1].0)).collect();
    Ok(Chart {
        title: "Cylinder R = 22.9 mm without slip: derivatives of the moments".to_owned(),
        x: "descent (mm)",
        y: "N/mm per mm (N per mm for M1)",
        curves: vec![
            curve("-dM0/dz", &middles, normal.iter().copied()),
            curve("dQ/dx", &descents, rows.iter().map(|row| row.1)),
            curve("-dM1/dx", &descents, rows.iter().map(|row| -row.2)),
        ],
        remarks: vec![
            "thesis (4.18): M0 follows dz alone, M1 both: so it is; its ridges are the mesh's"
                .to_owned(),
        ],
    })
}
