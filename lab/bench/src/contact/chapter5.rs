//! Draws the figures of chapter 5 of the thesis: feature Jacobians of a line contact (5.1 to 5.4)
//! and of the cylinder (5.10 to 5.13), and features of the image against loads (5.14). The images
//! under each motion (5.6 to 5.9) are drawn by the benchmark of contact in space.

use core::f64::consts::PI;

use taktil_contact::Accuracy;
use taktil_contact::features::{Part, image_features};
use taktil_contact::plane::compliance::SurfaceCompliance;
use taktil_contact::plane::features::moments;
use taktil_contact::plane::frictional::{FrictionLaw, FrictionalContact, LoadStep};
use taktil_contact::plane::noslip::NoSlip;
use taktil_contact::space::Prescribed;
use taktil_contact::space::pin::PlanarPose;
use taktil_contact::space::scene::{Pose, Scene, Shape};
use taktil_contact::space::tactels::{Array, Sampling};

use super::chapter4::THICKNESS_MM;
use super::curves::{Chart, Curve, stacked_charts};
use super::no_slip::{cylinder_at_descent, cylinder_descents};
use super::statements::{contact_error, thesis_layer};
use taktil_lab_plot::svg::Figure;

/// Step of the cylinder's derivatives, as a fraction of its descent.
const DERIVATIVE_STEP_SHARE: f64 = 0.01;
/// Radius of the pin, and height above the layer at which the force along it acts, in mm.
const PIN_RADIUS_MM: f64 = 23.0;

/// Every figure with the name of its file.
pub(super) fn figures() -> anyhow::Result<Vec<(&'static str, Figure)>> {
    Ok(vec![
        ("fig-5-1-to-5-4-line.svg", edge_chart()?.figure()),
        ("fig-5-10-to-5-13-cylinder.svg", cylinder_figure()?),
        ("fig-5-14-image.svg", image_figure()?),
    ])
}

fn chart(
    title: &str,
    x: &'static str,
    y: &'static str,
    curves: Vec<Curve>,
    remarks: &[&str],
) -> Chart {
    Chart {
        title: title.to_owned(),
        x,
        y,
        curves,
        remarks: remarks.iter().map(|&r| r.to_owned()).collect(),
    }
}

/// dM0/dz, dM0/dx, dM1/dz, dM1/dx of a strip of this width that sticks to the layer.
fn strip_jacobian(width_mm: f64) -> anyhow::Result<[f64; 4]> {
    let layer = thesis_layer(THICKNESS_MM, 0.49)?;
    let cells = 32_u32;
    let edge = |i: u32| -0.5 * width_mm * libm::cos(PI * f64::from(i) / f64::from(cells));
    let edges: Vec<f64> = (0..=cells).map(edge).collect();
    let bed = SurfaceCompliance::of_layer(&layer, &edges).map_err(contact_error)?;
    let law = FrictionLaw::Coulomb(f64::INFINITY);
    let mut grip =
        FrictionalContact::new(bed, vec![0.0; cells as usize], law).map_err(contact_error)?;
    let mut at = |dz_mm: f64, dx_mm: f64| -> anyhow::Result<[f64; 2]> {
        grip.step(&LoadStep::Move { dz_mm, dx_mm })?;
        let parts = grip.normal_n_mm().iter().zip(grip.tangential_n_mm());
        let places = grip.compliance().x_mm.iter().zip(parts);
        let forces: Vec<[f64; 3]> = places.map(|(x, (p, q))| [*x, *p, *q]).collect();
        let m = moments(&layer, &forces, THICKNESS_MM).m;
        Ok([m[0], m[1]])
    };
    // The problem is linear, because the contact of a flat strip does not change.
    let (one, two, along) = (at(0.01, 0.0)?, at(0.02, 0.0)?, at(0.02, 0.001)?);
    Ok([
        (two[0] - one[0]) / 0.01,
        (along[0] - two[0]) / 0.001,
        (two[1] - one[1]) / 0.01,
        (along[1] - two[1]) / 0.001,
    ])
}

fn edge_chart() -> anyhow::Result<Chart> {
    let widths: Vec<f64> = (1..=20).map(|k| 0.05 * f64::from(k)).collect();
    let mut rows: [Vec<f64>; 4] = Default::default();
    for width in &widths {
        for (row, value) in rows.iter_mut().zip(strip_jacobian(*width)?) {
            row.push(-value);
        }
    }
    let [dm0_dz, dm0_dx, dm1_dz, dm1_dx] = rows;
    Ok(chart(
        "Line contact: the feature Jacobian, by the width of the edge's tip",
        "width of the tip (mm)",
        "-dM0 (N/mm^2), -dM1 (N/mm)",
        vec![
            Curve::new("-dM0/dz", &widths, dm0_dz),
            Curve::new("-dM1/dx", &widths, dm1_dx),
            Curve::new("-dM0/dx", &widths, dm0_dx),
            Curve::new("-dM1/dz", &widths, dm1_dz).with_dashes(),
        ],
        &[
            "thesis (5.1 to 5.4): not diagonal, diagonal elements large; here it is diagonal",
            "and the same at every (dx, dz). A tip without width sinks for ever;",
            "the thesis's was one element of its mesh wide, 0.4 mm",
        ],
    ))
}

fn cylinder_figure() -> anyhow::Result<Figure> {
    let rows = cylinder_descents()?;
    let dz: Vec<f64> = rows.iter().map(|(dz, _)| *dz).collect();
    // Slightly smaller and larger descents, for derivatives at the descents themselves.
    let near = |dz: &f64| {
        Ok([
            cylinder_at_descent((1.0 - DERIVATIVE_STEP_SHARE) * dz)?,
            cylinder_at_descent((1.0 + DERIVATIVE_STEP_SHARE) * dz)?,
        ])
    };
    let near: Vec<[NoSlip; 2]> = dz.iter().map(near).collect::<anyhow::Result<_>>()?;
    let slope = |of: fn(&NoSlip) -> f64| -> Vec<f64> {
        let one = |([less, more], dz): (&[NoSlip; 2], &f64)| {
            (of(more) - of(less)) / (2.0 * DERIVATIVE_STEP_SHARE * dz)
        };
        near.iter().zip(&dz).map(one).collect()
    };
    let steep = slope(|held| held.p_n_mm);
    let zero: Vec<f64> = rows
        .iter()
        .map(|(_, held)| {
            let at = |dx: f64| moments(held.layer(), &held.point_forces(dx), THICKNESS_MM).m[0];
            -(at(1e-3) - at(0.0)) / 1e-3
        })
        .collect();
    let along: Vec<f64> = rows.iter().map(|(_, held)| -held.first_moment_n_mm).collect();
    let bent = slope(|held| -held.first_moment_n_mm);
    let cross = [0.0, 0.005, 0.01, 0.02].map(|dx| {
        let values = bent.iter().map(|slope| dx * slope);
        Curve::new(format!("-dM1/dz at dx = {dx} mm"), &dz, values)
    });
    let limit = |k: &usize| format!("{:.2}", along[*k] / (bent[*k] * dz[*k]));
    let at = [1, 3, 7, 11, 19];
    let limits: Vec<String> = at.iter().map(limit).collect();
    let depths: Vec<String> = at.iter().map(|k| format!("{:.3}", dz[*k])).collect();
    let dominant =
        format!("as long as dx is below {} dz at dz = {} mm", limits.join(", "), depths.join(", "));
    let charts = [
        chart(
            "(5.10, 5.11) Cylinder R = 22.9 mm without slip: zeroth moment",
            "dz (mm)",
            "-dM0 (N/mm^2)",
            vec![Curve::new("-dM0/dz", &dz, steep), Curve::new("-dM0/dx", &dz, zero)],
            &["thesis: ridges and lone peaks: of its mesh; the exact derivatives are smooth"],
        ),
        chart(
            "(5.13) Cylinder: first moment along x",
            "dz (mm)",
            "-dM1/dx (N/mm)",
            vec![Curve::new("-dM1/dx, at every dx", &dz, along.clone())],
            &[],
        ),
        chart(
            "(5.12) Cylinder: first moment into the layer",
            "dz (mm)",
            "-dM1/dz (N/mm)",
            cross.into(),
            &[
                "thesis: not diagonal, diagonally dominant: here -dM1/dx is above -dM1/dz",
                &dominant,
            ],
        ),
    ];
    Ok(stacked_charts("Feature Jacobian of the cylinder", &charts))
}

fn image_figure() -> anyhow::Result<Figure> {
    let array = Array::THESIS;
    let pin = Shape::Cylinder { radius_mm: PIN_RADIUS_MM, length_mm: Some(20.0) };
    let mut scene = Scene::new(
        &thesis_layer(THICKNESS_MM, 0.49)?,
        pin,
        &array,
        Sampling::Area,
        Accuracy::Default,
    )?;
    let mut picture = vec![0.0; array.len()];
    let mut at = |force: f64, tilt_rad: f64| -> anyhow::Result<[f64; 2]> {
        let pose = Pose { planar: PlanarPose::default(), tilt_rad };
        scene.press(Prescribed::ForceN(force), pose)?;
        scene.image(&mut picture)?;
        let found = image_features(&array, &picture, Part::Compressive)?;
        Ok([found.m0, found.mx])
    };
    let forces: Vec<f64> = (1..=20).map(|k| 2.0 * f64::from(k)).collect();
    let tilts: Vec<f64> = (0..=12).map(|k| 0.2 * f64::from(k)).collect();
    let (mut zeroth, mut first) = (Vec::new(), Vec::new());
    for force in &forces {
        zeroth.push(at(*force, 0.0)?[0]);
    }
    for tilt in &tilts {
        first.push(at(20.0, 1e-3 * tilt)?[1]);
    }
    let along: Vec<f64> = first.iter().map(|mx| -mx / PIN_RADIUS_MM).collect();
    let charts = [
        chart(
            "(a) Pin R = 23, L = 20 mm: zeroth moment of the image, compressive part",
            "force (N)",
            "M0 (N)",
            vec![Curve::new("M0", &forces, zeroth)],
            &["thesis: measured in counts, monotonic: so it is, M0 = -F but for tension"],
        ),
        chart(
            "(b) The same pin under 20 N, and a tangential force along it at its axis, 23 mm up",
            "tangential force (N)",
            "M_x, first moment along it (N mm)",
            vec![Curve::new("M_x", &along, first.clone())],
            &[
                "thesis: monotonic, nearly linear until its sensors saturate; here it is statics,",
                "-23 mm times the force, until the pin topples at 20 N times 10 mm / 23 mm: 8.7 N",
            ],
        ),
        chart(
            "(b) The same over the tilt that the tangential force brings",
            "tilt (mrad)",
            "M_x (N mm)",
            vec![Curve::new("M_x", &tilts, first)],
            &["not in the thesis: it levels off as one end of the pin lifts"],
        ),
    ];
    Ok(stacked_charts("Features of the image", &charts))
}
