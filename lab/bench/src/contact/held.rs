//! The thesis's figures of the cylinder held without slip (4.16 to 4.18) and of superposition (4.19
//! to 4.21), on the exact layer. Refuses what the contact modules refuse.

use taktil_contact::plane::features::moments;
use taktil_contact::plane::noslip::NoSlip;
use taktil_contact::plane::{Shape, Spectrum};

use super::chapter3::places;
use super::chapter4::{THICK, bar_kpa, pounds};
use super::curves::{Chart, Curve, stacked};
use super::statements::layer;
use taktil_lab_plot::svg::Figure;

/// The thesis's cylinder.
const ROLL: Shape = Shape::Cylinder { radius_mm: 22.9 };

/// Every figure with the name of its file.
pub(super) fn all() -> anyhow::Result<Vec<(&'static str, Figure)>> {
    Ok(vec![
        ("fig-4-16-cylinder-normal.svg", pressed()?.figure()),
        ("fig-4-17-cylinder-moved.svg", moved()?),
        ("fig-4-18-cylinder-moments.svg", cylinder_moments()?),
        ("fig-4-19-normal-and-tangential.svg", parts()?.figure()),
        ("fig-4-20-superposition.svg", superposition()?),
        ("fig-4-21-superposition-fails.svg", fails()?.figure()),
    ])
}

/// The cylinder at a descent.
pub(super) fn descended(dz_mm: f64) -> anyhow::Result<NoSlip> {
    NoSlip::descend(&layer(THICK, 0.49)?, ROLL, dz_mm).map_err(|e| anyhow::anyhow!("{e:?}"))
}

fn kpa(held: &NoSlip, dx_mm: f64, x: &[f64]) -> Vec<f64> {
    let stress = Spectrum::new(held.layer(), &held.point_forces(dx_mm), THICK, 20.0);
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

const SZZ: &str = "base s_zz (kPa)";

fn pressed() -> anyhow::Result<Chart> {
    let x = places(6.0, 400);
    let mut curves = Vec::new();
    for dz in [0.01, 0.02, 0.03, 0.04] {
        curves.push(Curve::new(format!("dz = {dz} mm"), &x, kpa(&descended(dz)?, 0.0, &x)));
    }
    Ok(chart(
        "Cylinder R = 22.9 mm without slip, pressed straight in",
        SZZ,
        curves,
        &["thesis: symmetric, the peak grows with the displacement: so it is"],
    ))
}

fn moved() -> anyhow::Result<Figure> {
    let x = places(6.0, 400);
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for dz in [0.01, 0.02, 0.03, 0.04] {
        a.push(Curve::new(format!("dz = {dz} mm"), &x, kpa(&descended(dz)?, 0.01, &x)));
    }
    let held = descended(0.03)?;
    for dx in [0.0, 0.005, 0.01, 0.02] {
        b.push(Curve::new(format!("dx = {dx} mm"), &x, kpa(&held, dx, &x)));
    }
    let charts = [
        chart("(a) Cylinder without slip, moved by dx = 0.01 mm: dz varies", SZZ, a, &[]),
        chart(
            "(b) Cylinder without slip, dz = 0.03 mm: dx varies",
            SZZ,
            b,
            &["thesis: skewed by dx, the peak does not follow it: so it is to first order in dx"],
        ),
    ];
    Ok(stacked("Cylinder moved along the layer", &charts))
}

/// Descents, and the cylinder at each.
pub(super) fn descents() -> anyhow::Result<Vec<(f64, NoSlip)>> {
    (1..=20).map(|k| 0.0025 * f64::from(k)).map(|dz| Ok((dz, descended(dz)?))).collect()
}

fn cylinder_moments() -> anyhow::Result<Figure> {
    let rows = descents()?;
    let dz: Vec<f64> = rows.iter().map(|(dz, _)| *dz).collect();
    let (mut zeroth, mut first) = (Vec::new(), Vec::new());
    for dx in [0.0, 0.005, 0.01, 0.02] {
        let of = |order: usize| {
            let value =
                |held: &NoSlip| moments(held.layer(), &held.point_forces(dx), THICK).m[order];
            rows.iter().map(|(_, held)| value(held)).collect::<Vec<f64>>()
        };
        let label = format!("dx = {dx} mm");
        let zero = Curve::new(label.clone(), &dz, of(0));
        zeroth.push(if dx > 0.0 { zero.dashed() } else { zero });
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
    Ok(stacked("Moments of the cylinder", &charts))
}

/// The thesis's own differences: P alone and Q alone, out of cases that have both.
fn differences(x: &[f64]) -> anyhow::Result<[Vec<f64>; 2]> {
    let at = |i: f64, j: f64| bar_kpa(12.7, 6.35, [pounds(i), pounds(0.05 * j)], x);
    let less = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(b).map(|(a, b)| a - b).collect();
    Ok([less(at(3.0, 1.0)?, at(2.0, 1.0)?), less(at(3.0, 2.0)?, at(3.0, 1.0)?)])
}

fn parts() -> anyhow::Result<Chart> {
    let x = places(12.7, 500);
    let [normal, tangential] = differences(&x)?;
    Ok(chart(
        "Bar 12.7 mm wide, h = 6.35 mm: what 0.175 of P and 0.00876 N/mm of Q bring",
        SZZ,
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

/// The sum of the parts against the solution.
fn against(name: &str, p: f64, q: f64, remark: &str) -> anyhow::Result<Chart> {
    let x = places(12.7, 500);
    let [normal, tangential] = differences(&x)?;
    let (a, b) = (p / pounds(1.0), q / pounds(0.05));
    let sum: Vec<f64> = normal.iter().zip(&tangential).map(|(n, t)| a * n + b * t).collect();
    let real = bar_kpa(12.7, 6.35, [p, q], &x)?;
    let peak = real.iter().fold(0.0_f64, |most, s| most.max(-s));
    let off = real.iter().zip(&sum).map(|(r, s)| (r - s).abs()).fold(0.0, f64::max);
    let found = format!("largest difference here {:.0} % of the peak", 1e2 * off / peak);
    Ok(chart(
        &format!("{name}Bar, (P, Q) = ({p}, {q}) N/mm: superposition and solution"),
        SZZ,
        vec![Curve::new("solution", &x, real), Curve::new("superposition", &x, sum).dashed()],
        &[&format!("thesis: {remark}; {found}")],
    ))
}

fn superposition() -> anyhow::Result<Figure> {
    let charts = [
        against("(a) ", 0.53, 0.09, "the difference is small")?,
        against("(b) ", 0.53, 0.16, "some disagreement")?,
    ];
    Ok(stacked("Superposition", &charts))
}

fn fails() -> anyhow::Result<Chart> {
    against("", 0.18, 0.14, "superposition does not apply")
}
