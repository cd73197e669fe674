//! Draws the figures of chapter 3 of the thesis on the exact layer: stress under a knife edge (3.3,
//! 3.4), under a flat bar (3.8, 3.9) and under a cylinder (3.10, 3.11) at several thicknesses.

use taktil_contact::Accuracy;
use taktil_contact::field::{LineLoad, LinePoint, line, line_half_plane};
use taktil_contact::half_plane::{
    cylinder_half_width_mm, cylinder_pressure_mpa, cylinder_stresses, punch_pressure_mpa,
    punch_stresses,
};
use taktil_contact::plane::{Friction, Indenter, Load, Shape, Spectrum};

use super::curves::{Chart, Curve, stacked_charts};
use super::statements::{LB_PER_IN, contact_error, thesis_layer};
use taktil_lab_plot::svg::Figure;

/// Depth at which the thesis compares thick layers with thin ones.
const DEPTH_MM: f64 = 0.8;

/// Equally spaced from -reach to reach.
pub(super) fn symmetric_grid(reach: f64, count: u32) -> Vec<f64> {
    (0..=count).map(|i| reach * (2.0 * f64::from(i) / f64::from(count) - 1.0)).collect()
}

/// Every figure with the name of its file.
pub(super) fn figures() -> anyhow::Result<Vec<(&'static str, Figure)>> {
    Ok(vec![
        ("fig-3-3-knife-thick.svg", knife_figure(25.4)?),
        ("fig-3-4-knife-thin.svg", knife_figure(0.8)?),
        ("fig-3-8-bar-surface.svg", bar_chart(true)?.figure()),
        ("fig-3-9-bar-below.svg", bar_chart(false)?.figure()),
        ("fig-3-10-cylinder-surface.svg", cylinder_chart(true)?.figure()),
        ("fig-3-11-cylinder-below.svg", cylinder_chart(false)?.figure()),
    ])
}

fn knife_figure(thickness_mm: f64) -> anyhow::Result<Figure> {
    let x = symmetric_grid(6.0, 480);
    let load = LineLoad { p_n_mm: 0.5 * LB_PER_IN, q_n_mm: 0.0 };
    let points =
        line(&thesis_layer(thickness_mm, 0.49)?, &load, DEPTH_MM, &x).map_err(contact_error)?;
    let half = line_half_plane(&load, DEPTH_MM, &x).map_err(contact_error)?;
    let thin = thickness_mm < 1.0;
    let chart =
        |name: &str, pick: fn(&LinePoint) -> Option<f64>, remark: &dyn Fn(&[Curve]) -> String| {
            let values = |points: &[LinePoint]| -> Vec<f64> {
                points.iter().map(|p| 1e3 * pick(p).unwrap_or(f64::NAN)).collect()
            };
            let curves = vec![
                Curve::new(format!("layer of {thickness_mm} mm"), &x, values(&points)),
                Curve::new("half plane", &x, values(&half)).with_dashes(),
            ];
            Chart {
                title: format!("{name}: knife edge, 0.0876 N/mm, at a depth of 0.8 mm"),
                x: "x (mm)",
                y: "stress (kPa)",
                remarks: vec![remark(&curves)],
                curves,
            }
        };
    let charts = [
        chart("(a) s_xx", |p| p.sxx_mpa, &|curves| sxx_remark(thin, curves)),
        chart("(b) s_zz", |p| p.szz_mpa, &|curves| szz_remark(thin, curves)),
    ];
    Ok(stacked_charts("Knife edge on a layer and on a half plane", &charts))
}

/// Remark on the stress along the layer; the curves are those of the layer and of the half plane.
fn sxx_remark(thin: bool, curves: &[Curve]) -> String {
    if !thin {
        let text =
            "thesis: similar in shape, the layer higher at the load and at the far ends: so it is";
        return text.to_owned();
    }
    format!(
        "thesis: half plane -18 kPa at +-0.8 mm, thin layer -90 at 0; here {:.1}, {:.1}",
        curves[1].minimum(),
        curves[0].minimum()
    )
}

/// Remark on the stress into the layer; the curves are those of the layer and of the half plane.
fn szz_remark(thin: bool, curves: &[Curve]) -> String {
    let [layer, half] = [&curves[0], &curves[1]];
    if !thin {
        let pairs = layer.points.iter().zip(&half.points);
        let off = pairs.map(|((_, a), (_, b))| (a - b).abs()).fold(0.0, f64::max);
        return format!("thesis: the two agree closely: they do to {off:.4} kPa");
    }
    let highest = layer.points.iter().fold(f64::NEG_INFINITY, |high, (_, s)| high.max(*s));
    let then = if highest > 0.0 { "so" } else { "never" };
    format!(
        "thesis: half plane -65, thin layer -100 kPa, then positive; here {:.1}, {:.1}, {then}",
        half.minimum(),
        layer.minimum()
    )
}

/// Normal stress in kPa at the surface or at the depth of the sensor.
fn normal_stress_kpa(
    t: f64,
    shape: Shape,
    p_n_mm: f64,
    x: &[f64],
    top: bool,
) -> anyhow::Result<Vec<f64>> {
    let layer = thesis_layer(t, 0.49)?;
    let mut body =
        Indenter::new(&layer, shape, Friction::None, Accuracy::Fine).map_err(contact_error)?;
    body.press(&Load { p_n_mm, q_n_mm: 0.0 })?;
    if top {
        return Ok(x.iter().map(|x| -1e3 * body.pressure_mpa(*x)).collect());
    }
    let stress = Spectrum::new(&layer, &body.point_forces(DEPTH_MM), DEPTH_MM, 40.0);
    Ok(x.iter().map(|x| 1e3 * stress.szz(*x)).collect())
}

fn bar_chart(top: bool) -> anyhow::Result<Chart> {
    let shape = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
    // The stress is infinite at the corners, so the places end 0.01 mm inside.
    let x = if top { symmetric_grid(6.34, 1268) } else { symmetric_grid(12.0, 480) };
    let mut curves = Vec::new();
    for t in [0.8, 12.7] {
        curves.push(Curve::new(
            format!("t = {t} mm"),
            &x,
            normal_stress_kpa(t, shape, 1.96, &x, top)?,
        ));
    }
    let half = |x: &f64| {
        if top {
            return -1e3 * punch_pressure_mpa(1.96, 6.35, *x);
        }
        1e3 * punch_stresses(1.96, 6.35, *x, DEPTH_MM).szz_mpa
    };
    curves.push(Curve::new("half plane", &x, x.iter().map(half)).with_dashes());
    let mut remarks = vec![
        "thesis: the thin layer highest at the centre, the thick one follows the half plane"
            .to_owned(),
    ];
    remarks.push(if top {
        format!(
            "here at the centre {:.1} (0.8 mm), {:.1} (12.7 mm), {:.1} kPa (half plane): so it is",
            curves[0].middle_value(),
            curves[1].middle_value(),
            curves[2].middle_value()
        )
    } else {
        "thesis: the half plane's oscillates near the edge: with A.17 corrected it does not"
            .to_owned()
    });
    if top {
        for curve in &mut curves {
            curve.points.iter_mut().for_each(|(_, s)| *s = s.max(-500.0));
        }
        remarks.push("below -500 kPa, at the corners, cut off".to_owned());
    }
    let place = if top { "at the surface" } else { "at a depth of 0.8 mm" };
    Ok(Chart {
        title: format!("Flat bar 12.7 mm wide, 1.96 N/mm: s_zz {place}"),
        x: "x (mm)",
        y: "stress (kPa)",
        curves,
        remarks,
    })
}

fn cylinder_chart(top: bool) -> anyhow::Result<Chart> {
    let x = symmetric_grid(if top { 2.0 } else { 4.0 }, 400);
    let (radius, p) = (25.4, 0.7);
    let shape = Shape::Cylinder { radius_mm: radius };
    let mut curves = Vec::new();
    for t in [0.8, 3.2, 12.8] {
        curves.push(Curve::new(
            format!("t = {t} mm"),
            &x,
            normal_stress_kpa(t, shape, p, &x, top)?,
        ));
    }
    let wide = cylinder_half_width_mm(&thesis_layer(1.0, 0.49)?, radius, p);
    let half = |x: &f64| {
        if top {
            return -1e3 * cylinder_pressure_mpa(p, wide, *x);
        }
        1e3 * cylinder_stresses(p, wide, *x, DEPTH_MM).szz_mpa
    };
    curves.push(Curve::new("half plane", &x, x.iter().map(half)).with_dashes());
    let place = if top { "at the surface" } else { "at a depth of 0.8 mm" };
    let peaks: Vec<String> = curves.iter().map(|curve| format!("{:.0}", curve.minimum())).collect();
    let [thin, mid, thick, half] = [&peaks[0], &peaks[1], &peaks[2], &peaks[3]];
    let found = format!("peaks here {thin}, {mid}, {thick}, half plane {half} kPa");
    Ok(Chart {
        title: format!("Cylinder R = 25.4 mm, 0.7 N/mm: s_zz {place}"),
        x: "x (mm)",
        y: "stress (kPa)",
        curves,
        remarks: vec![
            "thesis: 3.2 and 12.8 mm nearly the same, the thin layer higher: so it is".to_owned(),
            found,
        ],
    })
}
