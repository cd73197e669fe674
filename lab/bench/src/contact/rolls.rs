//! Work against precision: base stress under a cylinder in the plane, by every method, time beside
//! error. Refuses to be a gate: times differ from run to run.

use std::fmt::Write;
use std::hint::black_box;

use taktil_contact::Accuracy;
use taktil_contact::cylinder::LineContact;
use taktil_contact::plane::compliance::SurfaceCompliance;
use taktil_contact::plane::frictional::LoadStep;
use taktil_contact::plane::{Friction, Indenter, Load, Shape, Spectrum};

use super::statements::{layer, plainly};
use super::work::{Meshed, Truth, best_us, grip_of, timed};

const RADIUS: f64 = 23.0;
const ROLL: Shape = Shape::Cylinder { radius_mm: RADIUS };
const LOAD: Load = Load { p_n_mm: 2.0, q_n_mm: 0.0 };
/// Deepest penetration of the table (mm).
const DEEPEST: f64 = 0.1;
/// Width over which the table's stress is a mean (mm).
const CELL: f64 = 0.25;

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
    let layer = layer(0.8, 0.49)?;
    let mut fine = Indenter::new(&layer, ROLL, Friction::None, Accuracy::Fine).map_err(plainly)?;
    let exact = fine.press(&LOAD)?.x_right_mm;
    let forces = fine.point_forces(0.8);
    let truth = Truth::of(&layer, &forces);
    for level in [Accuracy::Fast, Accuracy::Default, Accuracy::Fine] {
        spectral(out, level, (&truth, exact))?;
    }
    tabled(out, &Spectrum::new(&layer, &forces, 0.8, 30.0), (truth.peak, exact))?;
    for cells in [48, 96, 192] {
        on_cells(out, cells, (&truth, exact))?;
    }
    for cut in [[64, 4, 1], [128, 8, 1], [256, 16, 1], [64, 4, 2], [128, 8, 2], [400, 8, 2]] {
        on_mesh(out, cut, (&truth, exact))?;
    }
    Ok(())
}

/// Never twice the same load, and never that of the table.
fn near(round: u32) -> Load {
    Load { p_n_mm: 2.02 + 0.02 * f64::from(round % 5), ..LOAD }
}

fn spectral(
    out: &mut String,
    level: Accuracy,
    (truth, exact): (&Truth, f64),
) -> anyhow::Result<()> {
    let layer = layer(0.8, 0.49)?;
    let tables = best_us(3, |_| {
        black_box(Indenter::new(&layer, ROLL, Friction::None, level).is_ok());
    });
    let mut roll = Indenter::new(&layer, ROLL, Friction::None, level).map_err(plainly)?;
    let miss = (roll.press(&LOAD)?.x_right_mm / exact - 1.0).abs();
    let stress = Spectrum::new(&layer, &roll.point_forces(0.8), 0.8, 30.0);
    let error = truth.error(|x| stress.szz(x));
    let warm = best_us(200, |round| {
        black_box(roll.press(&near(round)).is_ok());
    });
    let cold = best_us(100, |round| {
        roll.forget();
        black_box(roll.press(&near(round)).is_ok());
    });
    writeln!(
        out,
        "spectral {level:?} | {error:.1e} | {miss:.1e} | {warm:.1} | {cold:.1} | {tables:.0}"
    )?;
    Ok(())
}

/// The table of a cylinder over its depth: no warm and no cold start, so one time, of penetration
/// and width by the load; then with the loads of all cells.
fn tabled(out: &mut String, stress: &Spectrum, (peak, exact): (f64, f64)) -> anyhow::Result<()> {
    const CALLS: u32 = 1000;
    let layer = layer(0.8, 0.49)?;
    let make = || LineContact::new(&layer, RADIUS, DEEPEST);
    let tables = best_us(1, |_| {
        black_box(make().is_ok());
    });
    let line = make().map_err(plainly)?;
    let depth = line.penetration_mm(LOAD.p_n_mm);
    let miss = (line.half_width_mm(depth) / exact - 1.0).abs();
    let edges: Vec<f64> = (-40..=40).map(|i| CELL * f64::from(i)).collect();
    let shares = line.base_shares(depth);
    let off = edges.windows(2).map(|ends| {
        let by_table = -LOAD.p_n_mm * (shares.left_of(ends[1]) - shares.left_of(ends[0])) / CELL;
        let mean = (0..8).map(|i| stress.szz(ends[0] + CELL * (f64::from(i) + 0.5) / 8.0));
        (by_table - mean.sum::<f64>() / 8.0).abs()
    });
    let error = off.fold(0.0, f64::max) / peak;
    let many = |cells: bool| {
        let whole = best_us(50, |_| {
            for round in 0..CALLS {
                let depth = line.penetration_mm(near(round).p_n_mm);
                black_box(line.half_width_mm(depth));
                if cells {
                    let shares = line.base_shares(depth);
                    black_box(edges.iter().map(|x| shares.left_of(*x)).sum::<f64>());
                }
            }
        });
        whole / f64::from(CALLS)
    };
    let (alone, all) = (many(false), many(true));
    writeln!(
        out,
        "table over depth | {error:.1e} (means over {CELL} mm) | {miss:.1e} | {alone:.3} | \
         {alone:.3} | {tables:.0} (with the loads of {} cells: {all:.2})",
        edges.len() - 1
    )?;
    Ok(())
}

fn circle(x: f64) -> f64 {
    if x.abs() < RADIUS {
        x * x / (RADIUS + (RADIUS * RADIUS - x * x).sqrt())
    } else {
        f64::INFINITY
    }
}

fn pressed(round: Option<u32>) -> LoadStep {
    LoadStep::Upright(round.map_or(LOAD, near))
}

fn on_cells(out: &mut String, n: u32, (truth, exact): (&Truth, f64)) -> anyhow::Result<()> {
    let layer = layer(0.8, 0.49)?;
    let edges: Vec<f64> =
        (0..=n).map(|i| 1.5 * exact * (2.0 * f64::from(i) / f64::from(n) - 1.0)).collect();
    let tables = best_us(2, |_| {
        black_box(SurfaceCompliance::of_layer(&layer, &edges).is_ok());
    });
    let mut grip = grip_of(SurfaceCompliance::of_layer(&layer, &edges).map_err(plainly)?, circle)?;
    let [warm, cold] = timed(&mut grip, pressed)?;
    let forces: Vec<[f64; 3]> =
        grip.compliance().x_mm.iter().zip(grip.normal_n_mm()).map(|(x, p)| [*x, *p, 0.0]).collect();
    let stress = Spectrum::new(&layer, &forces, 0.8, 30.0);
    let error = truth.error(|x| stress.szz(x));
    writeln!(out, "cells {n} | {error:.1e} | | {warm:.0} | {cold:.0} | {tables:.0}")?;
    Ok(())
}

fn on_mesh(out: &mut String, cut: [usize; 3], (truth, exact): (&Truth, f64)) -> anyhow::Result<()> {
    let meshed = Meshed::new(cut)?;
    let mut grip = grip_of(meshed.body.compliance().map_err(plainly)?, circle)?;
    let [warm, cold] = timed(&mut grip, pressed)?;
    let error = meshed.error(&grip, truth)?;
    let touching = grip.compliance().x_mm.iter().zip(grip.normal_n_mm()).filter(|(_, p)| **p > 0.0);
    let b = touching.fold(0.0_f64, |most, (x, _)| most.max(*x));
    let (miss, tables) = ((b / exact - 1.0).abs(), meshed.tables_us);
    let name = &meshed.name;
    writeln!(out, "{name} | {error:.1e} | {miss:.1e} | {warm:.0} | {cold:.0} | {tables:.0}")?;
    Ok(())
}
