//! Measures work against precision of the base stress under a tilted bar, by every method. Times
//! differ from run to run, so the table is no test.

use std::fmt::Write;
use std::hint::black_box;

use taktil_contact::Accuracy;
use taktil_contact::plane::contact_table::ContactTable;
use taktil_contact::plane::features::moments;
use taktil_contact::plane::frictional::LoadStep;
use taktil_contact::plane::{Friction, Indenter, Load, Shape};

use super::methods::{
    MeshedLayer, MethodFigures, ReferenceStress, cell_figures, fastest_call_us, fastest_run_us,
    spectral_figures,
};
use super::statements::{contact_error, thesis_layer};

/// Width of the bar.
const BAR_WIDTH_MM: f64 = 12.7;
const SHAPE: Shape = Shape::Flat { width_mm: BAR_WIDTH_MM, height_mm: 6.35 };
const LOAD: Load = Load { p_n_mm: 0.7, q_n_mm: 0.25 };

/// The table.
///
/// # Errors
/// What the contact modules refuse: none of it with these numbers.
pub(super) fn table() -> anyhow::Result<String> {
    let mut out = String::from(
        "tilted bar W = 12.7, t = 0.8, nu = 0.49, (P, Q) = (0.7, 0.25), frictionless, base s_zz\n\
         method | error/peak | us warm | us cold | us tables\n",
    );
    let layer = thesis_layer(0.8, 0.49)?;
    let mut fine =
        Indenter::new(&layer, SHAPE, Friction::None, Accuracy::Fine).map_err(contact_error)?;
    fine.press(&LOAD)?;
    let truth = ReferenceStress::under_forces(&layer, &fine.point_forces(0.8));
    for level in [Accuracy::Fast, Accuracy::Default, Accuracy::Fine] {
        let (figures, _) = spectral_figures(SHAPE, level, &LOAD, perturbed_load, &truth)?;
        let MethodFigures { error, warm_us, cold_us, tables_us } = figures;
        writeln!(
            out,
            "spectral {level:?} | {error:.1e} | {warm_us:.1} | {cold_us:.1} | {tables_us:.0}"
        )?;
    }
    chart_row(&mut out, &truth)?;
    for cells in [48, 96, 192] {
        cells_row(&mut out, cells, &truth)?;
    }
    for (nx, nz, order) in
        [(64, 4, 1), (128, 8, 1), (256, 16, 1), (32, 2, 2), (64, 4, 2), (128, 8, 2), (400, 8, 2)]
    {
        mesh_row(&mut out, [nx, nz, order], &truth)?;
    }
    Ok(out)
}

/// A load that differs from the one before and from [`LOAD`]: a contact that is already solved
/// costs nothing and would falsify the time.
fn perturbed_load(round: u32) -> Load {
    let f = 1.002 + 0.002 * f64::from(round % 5);
    Load { p_n_mm: LOAD.p_n_mm, q_n_mm: LOAD.q_n_mm * f }
}

/// Row of the bar's chart. It has neither warm nor cold start, so there is one time, and a second
/// one with the stress at all places.
fn chart_row(out: &mut String, truth: &ReferenceStress) -> anyhow::Result<()> {
    let layer = thesis_layer(0.8, 0.49)?;
    let make = |x: &[f64]| ContactTable::new(&layer, BAR_WIDTH_MM, 6.35, Friction::None, x);
    let tables = fastest_run_us(1, |_| {
        black_box(make(&truth.x).is_ok());
    });
    let mut chart = make(&truth.x).map_err(contact_error)?;
    chart.press(&LOAD)?;
    let mut szz = vec![0.0; truth.x.len()];
    chart.base_szz_mpa(&mut szz);
    let error = truth.error_of_values(&szz);
    let mut fastest = |stress: bool| {
        fastest_call_us(|round| {
            black_box(chart.press(&perturbed_load(round)).is_ok());
            if stress {
                chart.base_szz_mpa(black_box(&mut szz));
            }
        })
    };
    let (alone, all) = (fastest(false), fastest(true));
    writeln!(
        out,
        "chart | {error:.1e} | {alone:.3} | {alone:.3} | {tables:.0} (with the stress at {} \
         places: {all:.2})",
        truth.x.len()
    )?;
    Ok(())
}

fn bar_height_mm(x: f64) -> f64 {
    if x.abs() < 0.5 * BAR_WIDTH_MM + 1e-6 { 0.0 } else { f64::INFINITY }
}

fn drive_of_round(round: Option<u32>) -> LoadStep {
    LoadStep::Loads { load: round.map_or(LOAD, perturbed_load), height_mm: 6.35 }
}

fn cells_row(out: &mut String, n: u32, truth: &ReferenceStress) -> anyhow::Result<()> {
    let layer = thesis_layer(0.8, 0.49)?;
    let angle = |i: u32| core::f64::consts::PI * f64::from(i) / f64::from(n);
    let edges: Vec<f64> = (0..=n).map(|i| -0.5 * BAR_WIDTH_MM * libm::cos(angle(i))).collect();
    let (figures, forces) = cell_figures(&edges, bar_height_mm, drive_of_round, truth)?;
    let MethodFigures { error, warm_us, cold_us, tables_us } = figures;
    let m1 = moments(&layer, &forces, 0.8).m[1] + 6.35 * LOAD.q_n_mm;
    writeln!(
        out,
        "cells {n} | {error:.1e} (M1 off {m1:.0e}) | {warm_us:.0} | {cold_us:.0} | {tables_us:.0}"
    )?;
    Ok(())
}

fn mesh_row(out: &mut String, cut: [usize; 3], truth: &ReferenceStress) -> anyhow::Result<()> {
    let meshed = MeshedLayer::new(cut)?;
    let (figures, _) = meshed.figures(bar_height_mm, drive_of_round, truth)?;
    let MethodFigures { error, warm_us, cold_us, tables_us } = figures;
    let forces = vec![[0.0, -0.01]; meshed.body.mesh().columns()];
    let mut again = meshed.body.response();
    let load = fastest_run_us(50, |_| meshed.body.solve(black_box(&forces), &mut again));
    let name = meshed.name;
    writeln!(
        out,
        "{name} | {error:.1e} | {warm_us:.0} | {cold_us:.0} | {tables_us:.0} (one load, factored: \
         {load:.1})"
    )?;
    Ok(())
}
