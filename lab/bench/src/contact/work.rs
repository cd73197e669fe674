//! Measures work against precision of the base stress under a tilted bar, by every method. Times
//! differ from run to run, so the table is no test.

use std::fmt::Write;
use std::hint::black_box;

use taktil_contact::Accuracy;
use taktil_contact::fem::{Elements, Kind, Mesh};
use taktil_contact::layer::Layer;
use taktil_contact::plane::compliance::SurfaceCompliance;
use taktil_contact::plane::contact_table::ContactTable;
use taktil_contact::plane::features::moments;
use taktil_contact::plane::frictional::{FrictionLaw, FrictionalContact, LoadStep};
use taktil_contact::plane::{Friction, Indenter, Load, PointForce, Shape, Spectrum};

use super::statements::{contact_error, thesis_layer};
use crate::measure::Stopwatch;

/// Width of the bar.
const BAR_WIDTH_MM: f64 = 12.7;
const SHAPE: Shape = Shape::Flat { width_mm: BAR_WIDTH_MM, height_mm: 6.35 };
const LOAD: Load = Load { p_n_mm: 0.7, q_n_mm: 0.25 };

/// Time (us) of the fastest of several calls.
pub(super) fn fastest_run_us(rounds: u32, mut call: impl FnMut(u32)) -> f64 {
    let mut best = f64::INFINITY;
    for round in 0..rounds {
        let mut watch = Stopwatch::default();
        watch.lap(true);
        call(round);
        watch.lap(false);
        best = best.min(watch.total().0 as f64 * 1e-3);
    }
    best
}

/// Base stress of the finest level at places along the layer, with which methods are compared.
pub(super) struct ReferenceStress {
    pub(super) x: Vec<f64>,
    szz: Vec<f64>,
    pub(super) peak: f64,
}

impl ReferenceStress {
    /// Base stress under point forces on a layer, at places from -10 to 10 mm.
    pub(super) fn under_forces(layer: &Layer, forces: &[PointForce]) -> Self {
        let stress = Spectrum::new(layer, forces, 0.8, 30.0);
        let x: Vec<f64> = (-80..=80).map(|i| 0.125 * f64::from(i)).collect();
        let szz: Vec<f64> = x.iter().map(|x| stress.szz(*x)).collect();
        let peak = szz.iter().fold(0.0_f64, |most, s| most.max(-s));
        Self { x, szz, peak }
    }

    /// Largest difference to the reference, over its peak.
    pub(super) fn error(&self, of: impl Fn(f64) -> f64) -> f64 {
        let off = self.x.iter().zip(&self.szz).map(|(x, s)| (of(*x) - s).abs());
        off.fold(0.0, f64::max) / self.peak
    }
}

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
        spectral_row(&mut out, level, &truth)?;
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

fn spectral_row(out: &mut String, level: Accuracy, truth: &ReferenceStress) -> anyhow::Result<()> {
    let layer = thesis_layer(0.8, 0.49)?;
    let tables = fastest_run_us(3, |_| {
        black_box(Indenter::new(&layer, SHAPE, Friction::None, level).is_ok());
    });
    let mut body = Indenter::new(&layer, SHAPE, Friction::None, level).map_err(contact_error)?;
    body.press(&LOAD)?;
    let stress = Spectrum::new(&layer, &body.point_forces(0.8), 0.8, 30.0);
    let error = truth.error(|x| stress.szz(x));
    let warm = fastest_run_us(200, |round| {
        black_box(body.press(&perturbed_load(round)).is_ok());
    });
    let cold = fastest_run_us(50, |round| {
        body.forget();
        black_box(body.press(&perturbed_load(round)).is_ok());
    });
    writeln!(out, "spectral {level:?} | {error:.1e} | {warm:.1} | {cold:.1} | {tables:.0}")?;
    Ok(())
}

/// Row of the bar's chart. It has neither warm nor cold start, so there is one time, and a second
/// one with the stress at all places.
fn chart_row(out: &mut String, truth: &ReferenceStress) -> anyhow::Result<()> {
    /// Calls of one timed run, since a single call is shorter than the clock resolves.
    const CALLS_PER_RUN: u32 = 1000;
    let layer = thesis_layer(0.8, 0.49)?;
    let make = |x: &[f64]| ContactTable::new(&layer, BAR_WIDTH_MM, 6.35, Friction::None, x);
    let tables = fastest_run_us(1, |_| {
        black_box(make(&truth.x).is_ok());
    });
    let mut chart = make(&truth.x).map_err(contact_error)?;
    chart.press(&LOAD)?;
    let mut szz = vec![0.0; truth.x.len()];
    chart.base_szz_mpa(&mut szz);
    let off = szz.iter().zip(&truth.szz).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let error = off / truth.peak;
    let mut many = |stress: bool| {
        let whole = fastest_run_us(50, |_| {
            for round in 0..CALLS_PER_RUN {
                black_box(chart.press(&perturbed_load(round)).is_ok());
                if stress {
                    chart.base_szz_mpa(black_box(&mut szz));
                }
            }
        });
        whole / f64::from(CALLS_PER_RUN)
    };
    let (alone, all) = (many(false), many(true));
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

/// The contact of a profile on a bed, before it is pressed.
pub(super) fn grip_on(
    bed: SurfaceCompliance,
    height_mm: impl Fn(f64) -> f64,
) -> anyhow::Result<FrictionalContact> {
    let heights = bed.x_mm.iter().map(|x| height_mm(*x)).collect();
    FrictionalContact::new(bed, heights, FrictionLaw::Free).map_err(contact_error)
}

/// Times (us) of a step from the contact before and from none. The last step is that of
/// `drive(None)`.
pub(super) fn step_times_us(
    grip: &mut FrictionalContact,
    drive: impl Fn(Option<u32>) -> LoadStep,
) -> anyhow::Result<[f64; 2]> {
    let fresh = grip.clone();
    let cold = fastest_run_us(3, |_| {
        let mut grip = fresh.clone();
        black_box(grip.step(&drive(None)).is_ok());
    });
    grip.step(&drive(None))?;
    let warm = fastest_run_us(10, |round| {
        black_box(grip.step(&drive(Some(round))).is_ok());
    });
    grip.step(&drive(None))?;
    Ok([warm, cold])
}

fn drive_of_round(round: Option<u32>) -> LoadStep {
    LoadStep::Loads { load: round.map_or(LOAD, perturbed_load), height_mm: 6.35 }
}

fn cells_row(out: &mut String, n: u32, truth: &ReferenceStress) -> anyhow::Result<()> {
    let layer = thesis_layer(0.8, 0.49)?;
    let angle = |i: u32| core::f64::consts::PI * f64::from(i) / f64::from(n);
    let edges: Vec<f64> = (0..=n).map(|i| -0.5 * BAR_WIDTH_MM * libm::cos(angle(i))).collect();
    let tables = fastest_run_us(2, |_| {
        black_box(SurfaceCompliance::of_layer(&layer, &edges).is_ok());
    });
    let mut grip = grip_on(
        SurfaceCompliance::of_layer(&layer, &edges).map_err(contact_error)?,
        bar_height_mm,
    )?;
    let [warm, cold] = step_times_us(&mut grip, drive_of_round)?;
    let forces: Vec<[f64; 3]> =
        grip.compliance().x_mm.iter().zip(grip.normal_n_mm()).map(|(x, p)| [*x, *p, 0.0]).collect();
    let stress = Spectrum::new(&layer, &forces, 0.8, 30.0);
    let error = truth.error(|x| stress.szz(x));
    let m1 = moments(&layer, &forces, 0.8).m[1] + 6.35 * LOAD.q_n_mm;
    writeln!(
        out,
        "cells {n} | {error:.1e} (M1 off {m1:.0e}) | {warm:.0} | {cold:.0} | {tables:.0}"
    )?;
    Ok(())
}

fn mesh_row(out: &mut String, cut: [usize; 3], truth: &ReferenceStress) -> anyhow::Result<()> {
    let meshed = MeshedLayer::new(cut)?;
    let mut grip = grip_on(meshed.body.compliance().map_err(contact_error)?, bar_height_mm)?;
    let [warm, cold] = step_times_us(&mut grip, drive_of_round)?;
    let error = meshed.error(&grip, truth)?;
    let forces = vec![[0.0, -0.01]; meshed.body.mesh().columns()];
    let mut again = meshed.body.response();
    let load = fastest_run_us(50, |_| meshed.body.solve(black_box(&forces), &mut again));
    let (name, tables) = (meshed.name, meshed.tables_us);
    writeln!(
        out,
        "{name} | {error:.1e} | {warm:.0} | {cold:.0} | {tables:.0} (one load, factored: \
         {load:.1})"
    )?;
    Ok(())
}

/// Finite elements of a layer 25.4 mm wide.
pub(super) struct MeshedLayer {
    pub(super) name: String,
    pub(super) body: Elements,
    /// Factor and compliances of the surface.
    pub(super) tables_us: f64,
}

impl MeshedLayer {
    pub(super) fn new([nx, nz, order]: [usize; 3]) -> anyhow::Result<Self> {
        let layer = thesis_layer(0.8, 0.49)?;
        let equal = Mesh::uniform(25.4, 0.8, nx, nz).map_err(contact_error)?;
        let mesh = Mesh::from_edges([&equal.line_mm(0), &equal.line_mm(1)], order)
            .map_err(contact_error)?;
        let kind = Kind::MeanDilatation;
        let body = Elements::new(&layer, mesh.clone(), kind).map_err(contact_error)?;
        let tables_us = fastest_run_us(1, |_| {
            let made = Elements::new(&layer, mesh.clone(), kind).and_then(|body| body.compliance());
            black_box(made.is_ok());
        });
        let name = format!("elements {nx} x {nz}, order {order}");
        Ok(Self { name, body, tables_us })
    }

    /// Error of the base stress under the forces of a grip, over the peak.
    pub(super) fn error(
        &self,
        grip: &FrictionalContact,
        truth: &ReferenceStress,
    ) -> anyhow::Result<f64> {
        let forces = (grip.normal_n_mm(), grip.tangential_n_mm());
        let response = self.body.response_to_contact(forces.0, forces.1).map_err(contact_error)?;
        let (places, szz) = (self.body.mesh().row_mm(0), self.body.base_szz_mpa(&response));
        Ok(truth.error(|x| {
            let right = places.partition_point(|place| *place < x).clamp(1, places.len() - 1);
            let s = (x - places[right - 1]) / (places[right] - places[right - 1]);
            szz[right - 1] * (1.0 - s) + szz[right] * s
        }))
    }
}
