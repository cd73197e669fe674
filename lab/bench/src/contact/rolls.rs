//! Measures work against precision of the base stress under a cylinder in the plane, by every
//! method. Times differ from run to run, so the table is no test.

use std::fmt::Write;
use std::hint::black_box;

use taktil_contact::Accuracy;
use taktil_contact::cylinder::LineContact;
use taktil_contact::plane::frictional::LoadStep;
use taktil_contact::plane::{Friction, Indenter, Load, Shape, Spectrum};

use super::methods::{
    MeshedLayer, MethodFigures, ReferenceStress, cell_figures, fastest_call_us, fastest_run_us,
    spectral_figures,
};
use super::statements::{contact_error, thesis_layer};

/// Radius of the cylinder.
const CYLINDER_RADIUS_MM: f64 = 23.0;
const CYLINDER: Shape = Shape::Cylinder { radius_mm: CYLINDER_RADIUS_MM };
const LOAD: Load = Load { p_n_mm: 2.0, q_n_mm: 0.0 };
/// Largest penetration of the table.
const PENETRATION_MAX_MM: f64 = 0.1;
/// Width of the cells over which the table's stress is averaged.
const CELL_WIDTH_MM: f64 = 0.25;

/// Adds the table.
///
/// # Errors
/// What the contact modules refuse: none of it with these numbers.
pub(super) fn table(out: &mut String) -> anyhow::Result<()> {
    writeln!(
        out,
        "\ncylinder R = 23, t = 0.8, nu = 0.49, P = 2, frictionless: base s_zz, half-width b\n\
        method | error/peak | error of b | us warm | us cold | us tables"
    )?;
    let layer = thesis_layer(0.8, 0.49)?;
    let mut fine =
        Indenter::new(&layer, CYLINDER, Friction::None, Accuracy::Fine).map_err(contact_error)?;
    let exact = fine.press(&LOAD)?.x_right_mm;
    let forces = fine.point_forces(0.8);
    let truth = ReferenceStress::under_forces(&layer, &forces);
    for level in [Accuracy::Fast, Accuracy::Default, Accuracy::Fine] {
        let (figures, half_width_mm) =
            spectral_figures(CYLINDER, level, &LOAD, perturbed_load, &truth)?;
        let MethodFigures { error, warm_us, cold_us, tables_us } = figures;
        let miss = (half_width_mm / exact - 1.0).abs();
        writeln!(
            out,
            "spectral {level:?} | {error:.1e} | {miss:.1e} | {warm_us:.1} | {cold_us:.1} | \
             {tables_us:.0}"
        )?;
    }
    table_row(out, &Spectrum::new(&layer, &forces, 0.8, 30.0), truth.peak, exact)?;
    for cells in [48, 96, 192] {
        cells_row(out, cells, &truth, exact)?;
    }
    for cut in [[64, 4, 1], [128, 8, 1], [256, 16, 1], [64, 4, 2], [128, 8, 2], [400, 8, 2]] {
        mesh_row(out, cut, &truth, exact)?;
    }
    Ok(())
}

/// A load that differs from the one before and from [`LOAD`], so that no result is reused.
fn perturbed_load(round: u32) -> Load {
    Load { p_n_mm: 2.02 + 0.02 * f64::from(round % 5), ..LOAD }
}

/// Row of the table over depth. It has neither warm nor cold start, so there is one time, for
/// penetration and width at a load, and a second one with the loads of all cells.
fn table_row(out: &mut String, stress: &Spectrum, peak: f64, exact: f64) -> anyhow::Result<()> {
    let layer = thesis_layer(0.8, 0.49)?;
    let make = || LineContact::new(&layer, CYLINDER_RADIUS_MM, PENETRATION_MAX_MM);
    let tables = fastest_run_us(1, |_| {
        black_box(make().is_ok());
    });
    let line = make().map_err(contact_error)?;
    let depth = line.penetration_mm(LOAD.p_n_mm);
    let miss = (line.half_width_mm(depth) / exact - 1.0).abs();
    let edges: Vec<f64> = (-40..=40).map(|i| CELL_WIDTH_MM * f64::from(i)).collect();
    let shares = line.base_shares(depth);
    let off = edges.windows(2).map(|ends| {
        let by_table =
            -LOAD.p_n_mm * (shares.left_of(ends[1]) - shares.left_of(ends[0])) / CELL_WIDTH_MM;
        let mean = (0..8).map(|i| stress.szz(ends[0] + CELL_WIDTH_MM * (f64::from(i) + 0.5) / 8.0));
        (by_table - mean.sum::<f64>() / 8.0).abs()
    });
    let error = off.fold(0.0, f64::max) / peak;
    let fastest = |cells: bool| {
        fastest_call_us(|round| {
            let depth = line.penetration_mm(perturbed_load(round).p_n_mm);
            black_box(line.half_width_mm(depth));
            if cells {
                let shares = line.base_shares(depth);
                black_box(edges.iter().map(|x| shares.left_of(*x)).sum::<f64>());
            }
        })
    };
    let (alone, all) = (fastest(false), fastest(true));
    writeln!(
        out,
        "table over depth | {error:.1e} (means over {CELL_WIDTH_MM} mm) | {miss:.1e} | \
         {alone:.3} | {alone:.3} | {tables:.0} (with the loads of {} cells: {all:.2})",
        edges.len() - 1
    )?;
    Ok(())
}

fn circle_height_mm(x: f64) -> f64 {
    if x.abs() < CYLINDER_RADIUS_MM {
        x * x / (CYLINDER_RADIUS_MM + (CYLINDER_RADIUS_MM * CYLINDER_RADIUS_MM - x * x).sqrt())
    } else {
        f64::INFINITY
    }
}

fn drive_of_round(round: Option<u32>) -> LoadStep {
    LoadStep::Upright(round.map_or(LOAD, perturbed_load))
}

fn cells_row(out: &mut String, n: u32, truth: &ReferenceStress, exact: f64) -> anyhow::Result<()> {
    let edges: Vec<f64> =
        (0..=n).map(|i| 1.5 * exact * (2.0 * f64::from(i) / f64::from(n) - 1.0)).collect();
    let (figures, _) = cell_figures(&edges, circle_height_mm, drive_of_round, truth)?;
    let MethodFigures { error, warm_us, cold_us, tables_us } = figures;
    writeln!(out, "cells {n} | {error:.1e} | | {warm_us:.0} | {cold_us:.0} | {tables_us:.0}")?;
    Ok(())
}

fn mesh_row(
    out: &mut String,
    cut: [usize; 3],
    truth: &ReferenceStress,
    exact: f64,
) -> anyhow::Result<()> {
    let meshed = MeshedLayer::new(cut)?;
    let (figures, grip) = meshed.figures(circle_height_mm, drive_of_round, truth)?;
    let MethodFigures { error, warm_us, cold_us, tables_us } = figures;
    let touching = grip.compliance().x_mm.iter().zip(grip.normal_n_mm()).filter(|(_, p)| **p > 0.0);
    let b = touching.fold(0.0_f64, |most, (x, _)| most.max(*x));
    let (name, miss) = (meshed.name, (b / exact - 1.0).abs());
    writeln!(
        out,
        "{name} | {error:.1e} | {miss:.1e} | {warm_us:.0} | {cold_us:.0} | {tables_us:.0}"
    )?;
    Ok(())
}
