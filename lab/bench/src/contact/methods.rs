//! Measures one method of contact in the plane on the thesis' layer: the error of the base stress
//! against a reference, and the times of a warm step, of a cold step and of the tables. The tables
//! of the bar and of the cylinder are made of these figures.

use std::hint::black_box;

use taktil_contact::Accuracy;
use taktil_contact::fem::{Elements, Kind, Mesh};
use taktil_contact::layer::Layer;
use taktil_contact::plane::compliance::SurfaceCompliance;
use taktil_contact::plane::frictional::{FrictionLaw, FrictionalContact, LoadStep};
use taktil_contact::plane::{Friction, Indenter, Load, PointForce, Shape, Spectrum};

use super::statements::{contact_error, thesis_layer};
use crate::measure::Stopwatch;

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

/// Time (us) of one of many calls, in the fastest of several runs.
pub(super) fn fastest_call_us(mut call: impl FnMut(u32)) -> f64 {
    /// Calls of one timed run, since a single call is shorter than the clock resolves.
    const CALLS_PER_RUN: u32 = 1000;
    fastest_run_us(50, |_| (0..CALLS_PER_RUN).for_each(&mut call)) / f64::from(CALLS_PER_RUN)
}

/// Base stress of the finest level at places along the layer, with which methods are compared.
pub(super) struct ReferenceStress {
    pub(super) x: Vec<f64>,
    szz: Vec<f64>,
    pub(super) peak: f64,
}

/// Error of a method and its times.
pub(super) struct MethodFigures {
    /// Largest error of the base stress, over the peak.
    pub(super) error: f64,
    /// Time of a step from the contact before (us).
    pub(super) warm_us: f64,
    /// Time of a step from no contact (us).
    pub(super) cold_us: f64,
    /// Time in which the method's tables are made (us).
    pub(super) tables_us: f64,
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

    /// Largest difference of a stress from the reference, over its peak.
    pub(super) fn error(&self, of: impl Fn(f64) -> f64) -> f64 {
        let off = self.x.iter().zip(&self.szz).map(|(x, s)| (of(*x) - s).abs());
        off.fold(0.0, f64::max) / self.peak
    }

    /// The same for the stress at each of the reference's places.
    pub(super) fn error_of_values(&self, szz: &[f64]) -> f64 {
        let off = szz.iter().zip(&self.szz).map(|(a, b)| (a - b).abs());
        off.fold(0.0, f64::max) / self.peak
    }
}

/// Figures of the spectral method for a shape on the thesis' layer, and the right edge of the
/// contact under `load` (mm). Times are those of other loads: a contact that is already solved
/// costs nothing.
pub(super) fn spectral_figures(
    shape: Shape,
    level: Accuracy,
    load: &Load,
    perturbed_load: fn(u32) -> Load,
    truth: &ReferenceStress,
) -> anyhow::Result<(MethodFigures, f64)> {
    let layer = thesis_layer(0.8, 0.49)?;
    let tables_us = fastest_run_us(3, |_| {
        black_box(Indenter::new(&layer, shape, Friction::None, level).is_ok());
    });
    let mut body = Indenter::new(&layer, shape, Friction::None, level).map_err(contact_error)?;
    let x_right_mm = body.press(load)?.x_right_mm;
    let stress = Spectrum::new(&layer, &body.point_forces(0.8), 0.8, 30.0);
    let error = truth.error(|x| stress.szz(x));
    let warm_us = fastest_run_us(200, |round| {
        black_box(body.press(&perturbed_load(round)).is_ok());
    });
    let cold_us = fastest_run_us(100, |round| {
        body.forget();
        black_box(body.press(&perturbed_load(round)).is_ok());
    });
    Ok((MethodFigures { error, warm_us, cold_us, tables_us }, x_right_mm))
}

/// Figures of the contact of a profile on cells of the thesis' layer, and the forces of the last
/// step.
pub(super) fn cell_figures(
    edges_mm: &[f64],
    height_mm: impl Fn(f64) -> f64,
    drive: impl Fn(Option<u32>) -> LoadStep,
    truth: &ReferenceStress,
) -> anyhow::Result<(MethodFigures, Vec<PointForce>)> {
    let layer = thesis_layer(0.8, 0.49)?;
    let tables_us = fastest_run_us(2, |_| {
        black_box(SurfaceCompliance::of_layer(&layer, edges_mm).is_ok());
    });
    let bed = SurfaceCompliance::of_layer(&layer, edges_mm).map_err(contact_error)?;
    let mut grip = grip_on(bed, height_mm)?;
    let [warm_us, cold_us] = step_times_us(&mut grip, drive)?;
    let forces: Vec<PointForce> =
        grip.compliance().x_mm.iter().zip(grip.normal_n_mm()).map(|(x, p)| [*x, *p, 0.0]).collect();
    let stress = Spectrum::new(&layer, &forces, 0.8, 30.0);
    let error = truth.error(|x| stress.szz(x));
    Ok((MethodFigures { error, warm_us, cold_us, tables_us }, forces))
}

/// The contact of a profile on a bed, before it is pressed.
fn grip_on(
    bed: SurfaceCompliance,
    height_mm: impl Fn(f64) -> f64,
) -> anyhow::Result<FrictionalContact> {
    let heights = bed.x_mm.iter().map(|x| height_mm(*x)).collect();
    FrictionalContact::new(bed, heights, FrictionLaw::Free).map_err(contact_error)
}

/// Times (us) of a step from the contact before and from none. The last step is that of
/// `drive(None)`.
fn step_times_us(
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

/// Finite elements of a layer 25.4 mm wide.
pub(super) struct MeshedLayer {
    pub(super) name: String,
    pub(super) body: Elements,
    /// Factor and compliances of the surface.
    tables_us: f64,
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

    /// Figures of the contact of a profile on this layer, and the contact after the last step.
    pub(super) fn figures(
        &self,
        height_mm: impl Fn(f64) -> f64,
        drive: impl Fn(Option<u32>) -> LoadStep,
        truth: &ReferenceStress,
    ) -> anyhow::Result<(MethodFigures, FrictionalContact)> {
        let mut grip = grip_on(self.body.compliance().map_err(contact_error)?, height_mm)?;
        let [warm_us, cold_us] = step_times_us(&mut grip, drive)?;
        let error = self.error(&grip, truth)?;
        let figures = MethodFigures { error, warm_us, cold_us, tables_us: self.tables_us };
        Ok((figures, grip))
    }

    /// Error of the base stress under the forces of a grip, over the peak.
    fn error(&self, grip: &FrictionalContact, truth: &ReferenceStress) -> anyhow::Result<f64> {
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
