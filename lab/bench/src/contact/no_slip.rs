//! Draws the figures of the thesis for the cylinder without slip (4.16 to 4.18) and for
//! superposition (4.19 to 4.21), on the exact layer.

use taktil_contact::plane::features::moments;
use taktil_contact::plane::noslip::NoSlip;
use taktil_contact::plane::{Shape, Spectrum};

use super::chapter3::symmetric_grid;
use super::chapter4::{THICKNESS_MM, bar_stress_kpa, load_n_mm};
use super::curves::{Chart, Curve, stacked_charts};
use super::statements::thesis_layer;
use taktil_lab_plot::svg::Figure;

/// The thesis's cylinder.
const CYLINDER: Shape = Shape::Cylinder { radius_mm: 22.9 };

/// Every figure with the name of its file.
pub(super) fn figures() -> anyhow::Result<Vec<(&'static str, Figure)>> {
    Ok(vec![
        ("fig-4-16-cylinder-normal.svg", normal_chart()?.figure()),
        ("fig-4-17-cylinder-moved.svg", tangential_figure()?),
        ("fig-4-18-cylinder-moments.svg", moment_figure()?),
        ("fig-4-19-normal-and-tangential.svg", superposition_parts_chart()?.figure()),
        ("fig-4-20-superposition.svg", superposition_figure()?),
        ("fig-4-21-superposition-fails.svg", failing_superposition_chart()?.figure()),
    ])
}

/// The cylinder at a descent.
pub(super) fn cylinder_at_descent(dz_mm: f64) -> anyhow::Result<NoSlip> {
    NoSlip::descend(&thesis_layer(THICKNESS_MM, 0.49)?, CYLINDER, dz_mm)
        .map_err(|e| anyhow::anyhow!("{e:?}"))
}

fn base_stress_kpa(held: &NoSlip, dx_mm: f64, x: &[f64]) -> Vec<f64> {
    let stress = Spectrum::new(held.layer(), &held.point_forces(dx_mm), THICKNESS_MM, 20.0);
    x.iter().map(|x| 1e3 * stress.szz(*x)).collect()
}

fn chart(title: &str, y: &'static str, curves: Vec<Curve>, remarks: &[&str]) -> Chart {
    Chart {
        title: title.to_owned(),
        x: "x (mm)",
        y,
        curves,
        remarks: remarks.iter().map(|&r| r.to_owned()).collect(),
    }
}

const SZZ_LABEL: &str = "base s_zz (kPa)";

fn normal_chart() -> anyhow::Result<Chart> {
    let x = symmetric_grid(6.0, 400);
    let mut curves = Vec::new();
    for dz in [0.01, 0.02, 0.03, 0.04] {
        curves.push(Curve::new(
            format!("dz = {dz} mm"),
            &x,
            base_stress_kpa(&cylinder_at_descent(dz)?, 0.0, &x),
        ));
    }
    Ok(chart(
        "Cylinder R = 22.9 mm without slip, pressed straight in",
        SZZ_LABEL,
        curves,
        &["thesis: symmetric, the peak grows with the displacement: so it is"],
    ))
}

fn tangential_figure() -> anyhow::Result<Figure> {
    let x = symmetric_grid(6.0, 400);
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for dz in [0.01, 0.02, 0.03, 0.04] {
        a.push(Curve::new(
            format!("dz = {dz} mm"),
            &x,
            base_stress_kpa(&cylinder_at_descent(dz)?, 0.01, &x),
        ));
    }
    let held = cylinder_at_descent(0.03)?;
    for dx in [0.0, 0.005, 0.01, 0.02] {
        b.push(Curve::new(format!("dx = {dx} mm"), &x, base_stress_kpa(&held, dx, &x)));
    }
    let charts = [
        chart("(a) Cylinder without slip, moved by dx = 0.01 mm: dz varies", SZZ_LABEL, a, &[]),
        chart(
            "(b) Cylinder without slip, dz = 0.03 mm: dx varies",
            SZZ_LABEL,
            b,
            &["thesis: skewed by dx, the peak does not follow it: so it is to first order in dx"],
        ),
    ];
    Ok(stacked_charts("Cylinder moved along the layer", &charts))
}

/// The descents, and the cylinder at each of them.
pub(super) fn cylinder_descents() -> anyhow::Result<Vec<(f64, NoSlip)>> {
    (1..=20).map(|k| 0.0025 * f64::from(k)).map(|dz| Ok((dz, cylinder_at_descent(dz)?))).collect()
}

fn moment_figure() -> anyhow::Result<Figure> {
    let rows = cylinder_descents()?;
    let dz: Vec<f64> = rows.iter().map(|(dz, _)| *dz).collect();
    let (mut zeroth, mut first) = (Vec::new(), Vec::new());
    for dx in [0.0, 0.005, 0.01, 0.02] {
        let of = |order: usize| {
            let value = |held: &NoSlip| {
                moments(held.layer(), &held.point_forces(dx), THICKNESS_MM).m[order]
            };
            rows.iter().map(|(_, held)| value(held)).collect::<Vec<f64>>()
        };
        let label = format!("dx = {dx} mm");
        let zero = Curve::new(label.clone(), &dz, of(0));
        zeroth.push(if dx > 0.0 { zero.with_dashes() } else { zero });
        first.push(Curve::new(label, &dz, of(1)));
    }
    let mut charts = [
        chart(
            "(a) Cylinder without slip: zeroth moment",
            "M0 (N/mm)",
            zeroth,
            &["thesis: follows dz alone, not linearly: so it is, the four curves are one"],
        ),
        chart(
            "(b) Cylinder without slip: first moment about the cylinder's axis",
            "M1 (N)",
            first,
            &["thesis: follows both: so it is, in proportion to dx at each dz"],
        ),
    ];
    charts.iter_mut().for_each(|chart| chart.x = "dz (mm)");
    Ok(stacked_charts("Moments of the cylinder", &charts))
}

/// The thesis's own differences: P alone and Q alone, from cases that have both.
fn load_differences(x: &[f64]) -> anyhow::Result<[Vec<f64>; 2]> {
    let at = |i: f64, j: f64| bar_stress_kpa(12.7, 6.35, [load_n_mm(i), load_n_mm(0.05 * j)], x);
    let less = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(b).map(|(a, b)| a - b).collect();
    Ok([less(at(3.0, 1.0)?, at(2.0, 1.0)?), less(at(3.0, 2.0)?, at(3.0, 1.0)?)])
}

fn superposition_parts_chart() -> anyhow::Result<Chart> {
    let x = symmetric_grid(12.7, 500);
    let [normal, tangential] = load_differences(&x)?;
    Ok(chart(
        "Bar 12.7 mm wide, h = 6.35 mm: what 0.175 of P and 0.00876 N/mm of Q bring",
        SZZ_LABEL,
        vec![
            Curve::new("P alone: (0.525, 0.0088) less (0.350, 0.0088)", &x, normal),
            Curve::new(
                "Q alone, times 10: (0.525, 0.0175) less (0.525, 0.0088)",
                &x,
                tangential.iter().map(|s| 10.0 * s),
            ),
        ],
        &["thesis: so the parts of its superposition are found"],
    ))
}

/// The sum of the parts compared with the solution.
fn superposition_chart(name: &str, p: f64, q: f64, remark: &str) -> anyhow::Result<Chart> {
    let x = symmetric_grid(12.7, 500);
    let [normal, tangential] = load_differences(&x)?;
    let (a, b) = (p / load_n_mm(1.0), q / load_n_mm(0.05));
    let sum: Vec<f64> = normal.iter().zip(&tangential).map(|(n, t)| a * n + b * t).collect();
    let real = bar_stress_kpa(12.7, 6.35, [p, q], &x)?;
    let peak = real.iter().fold(0.0_f64, |most, s| most.max(-s));
    let off = real.iter().zip(&sum).map(|(r, s)| (r - s).abs()).fold(0.0, f64::max);
    let found = format!("largest difference here {:.0} % of the peak", 1e2 * off / peak);
    Ok(chart(
        &format!("{name}Bar, (P, Q) = ({p}, {q}) N/mm: superposition and solution"),
        SZZ_LABEL,
        vec![Curve::new("solution", &x, real), Curve::new("superposition", &x, sum).with_dashes()],
        &[&format!("thesis: {remark}; {found}")],
    ))
}

fn superposition_figure() -> anyhow::Result<Figure> {
    let charts = [
        superposition_chart("(a) ", 0.53, 0.09, "the difference is small")?,
        superposition_chart("(b) ", 0.53, 0.16, "some disagreement")?,
    ];
    Ok(stacked_charts("Superposition", &charts))
}

fn failing_superposition_chart() -> anyhow::Result<Chart> {
    superposition_chart("", 0.18, 0.14, "superposition does not apply")
}
