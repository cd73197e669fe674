//! Measures work against precision of the base stress under a cylinder in the plane, by every
//! method. Times differ from run to run, so the table is no test.

use std::fmt::Write;
use std::hint::black_box;

use taktil_contact::Accuracy;
use taktil_contact::cylinder::LineContact;
use taktil_contact::plane::compliance::SurfaceCompliance;
use taktil_contact::plane::frictional::LoadStep;
use taktil_contact::plane::{Friction, Indenter, Load, Shape, Spectrum};

use super::statements::{contact_error, thesis_layer};
use super::work::{MeshedLayer, ReferenceStress, fastest_run_us, grip_on, step_times_us};

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
        spectral_row(out, level, (&truth, exact))?;
    }
    table_row(out, &Spectrum::new(&layer, &forces, 0.8, 30.0), truth.peak, exact)?;
    for cells in [48, 96, 192] {
        cells_row(out, cells, (&truth, exact))?;
    }
    for cut in [[64, 4, 1], [128, 8, 1], [256, 16, 1], [64, 4, 2], [128, 8, 2], [400, 8, 2]] {
        mesh_row(out, cut, (&truth, exact))?;
    }
    Ok(())
}

/// A load that differs from the one before and from [`LOAD`], so that no result is reused.
fn perturbed_load(round: u32) -> Load {
    Load { p_n_mm: 2.02 + 0.02 * f64::from(round % 5), ..LOAD }
}

fn spectral_row(
    out: &mut String,
    level: Accuracy,
    (truth, exact): (&ReferenceStress, f64),
) -> anyhow::Result<()> {
    let layer = thesis_layer(0.8, 0.49)?;
    let tables = fastest_run_us(3, |_| {
        black_box(Indenter::new(&layer, CYLINDER, Friction::None, level).is_ok());
    });
    let mut roll = Indenter::new(&layer, CYLINDER, Friction::None, level).map_err(contact_error)?;
    let miss = (roll.press(&LOAD)?.x_right_mm / exact - 1.0).abs();
    let stress = Spectrum::new(&layer, &roll.point_forces(0.8), 0.8, 30.0);
    let error = truth.error(|x| stress.szz(x));
    let warm = fastest_run_us(200, |round| {
        black_box(roll.press(&perturbed_load(round)).is_ok());
    });
    let cold = fastest_run_us(100, |round| {
        roll.forget();
        black_box(roll.press(&perturbed_load(round)).is_ok());
    });
    writeln!(
        out,
        "spectral {level:?} | {error:.1e} | {miss:.1e} | {warm:.1} | {cold:.1} | {tables:.0}"
    )?;
    Ok(())
}

/// Row of the table over depth. It has neither warm nor cold start, so there is one time, for
/// penetration and width at a load, and a second one with the loads of all cells.
fn table_row(out: &mut String, stress: &Spectrum, peak: f64, exact: f64) -> anyhow::Result<()> {
    /// Calls of one timed run, since a single call is shorter than the clock resolves.
    const CALLS_PER_RUN: u32 = 1000;
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
    let many = |cells: bool| {
        let whole = fastest_run_us(50, |_| {
            for round in 0..CALLS_PER_RUN {
                let depth = line.penetration_mm(perturbed_load(round).p_n_mm);
                black_box(line.half_width_mm(depth));
                if cells {
                    let shares = line.base_shares(depth);
                    black_box(edges.iter().map(|x| shares.left_of(*x)).sum::<f64>());
                }
            }
        });
        whole / f64::from(CALLS_PER_RUN)
    };
    let (alone, all) = (many(false), many(true));
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

fn cells_row(
    out: &mut String,
    n: u32,
    (truth, exact): (&ReferenceStress, f64),
) -> anyhow::Result<()> {
    let layer = thesis_layer(0.8, 0.49)?;
    let edges: Vec<f64> =
        (0..=n).map(|i| 1.5 * exact * (2.0 * f64::from(i) / f64::from(n) - 1.0)).collect();
    let tables = fastest_run_us(2, |_| {
        black_box(SurfaceCompliance::of_layer(&layer, &edges).is_ok());
    });
    let mut grip = grip_on(
        SurfaceCompliance::of_layer(&layer, &edges).map_err(contact_error)?,
        circle_height_mm,
    )?;
    let [warm, cold] = step_times_us(&mut grip, drive_of_round)?;
    let forces: Vec<[f64; 3]> =
        grip.compliance().x_mm.iter().zip(grip.normal_n_mm()).map(|(x, p)| [*x, *p, 0.0]).collect();
    let stress = Spectrum::new(&layer, &forces, 0.8, 30.0);
    let error = truth.error(|x| stress.szz(x));
    writeln!(out, "cells {n} | {error:.1e} | | {warm:.0} | {cold:.0} | {tables:.0}")?;
    Ok(())
}

fn mesh_row(
    out: &mut String,
    cut: [usize; 3],
    (truth, exact): (&ReferenceStress, f64),
) -> anyhow::Result<()> {
    let meshed = MeshedLayer::new(cut)?;
    let mut grip = grip_on(meshed.body.compliance().map_err(contact_error)?, circle_height_mm)?;
    let [warm, cold] = step_times_us(&mut grip, drive_of_round)?;
    let error = meshed.error(&grip, truth)?;
    let touching = grip.compliance().x_mm.iter().zip(grip.normal_n_mm()).filter(|(_, p)| **p > 0.0);
    let b = touching.fold(0.0_f64, |most, (x, _)| most.max(*x));
    let (miss, tables) = ((b / exact - 1.0).abs(), meshed.tables_us);
    let name = &meshed.name;
    writeln!(out, "{name} | {error:.1e} | {miss:.1e} | {warm:.0} | {cold:.0} | {tables:.0}")?;
    Ok(())
}
