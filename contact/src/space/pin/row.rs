//! A row of slices over a pin, or over the end of it that touches: its geometry and its tables. A
//! row's own axis runs along w, from the origin that the pin gives it.

use super::super::super::Invalid;
use super::super::super::kernel::SurfaceKernel;
use super::super::super::layer::Layer;
use super::coupling::{CoupledSlices, Coupling, Parity};
use super::end_loss::end_loss;
use super::point_rule::{PointRule, points_for};
use super::resolution::{Resolution, SliceSpacing};
use super::strip::StripTable;
use core::f64::consts::PI;

/// Steepest tilt in rad; the sections of a pin tilted further are not those of a cylinder.
pub(crate) const TILT_MAX_RAD: f64 = 0.2;
/// Length in thicknesses below which a whole pin is cut no finer than its end, where its image is
/// that of spread slices.
const COARSE_LENGTH_MAX: f64 = 10.0;
/// Deepest penetration that a row is made for, over that of the steepest slope: of most rows, and
/// of a row shorter than `STUBBY_LENGTH` thicknesses, where widths overshoot further.
const DEPTH_FACTOR: f64 = 1.8;
const STUBBY_LENGTH: f64 = 0.2;
const STUBBY_DEPTH_FACTOR: f64 = 2.8;
/// Least penetration that a row is made for, in parts of that factor, thicknesses.
const DEPTH_MIN: f64 = 0.01;
/// Half-width of a bar's face in thicknesses above which its slices are `WIDE_FACE_STRETCH` times
/// as long.
const WIDE_FACE: f64 = 1.2;
const WIDE_FACE_STRETCH: f64 = 1.6;
/// Most slices of a row.
const SLICES_MAX: usize = 4096;

/// What a row of slices is made from.
#[derive(Clone)]
pub(super) struct RowPlan<'a> {
    pub(super) layer: &'a Layer,
    pub(super) kernel: &'a SurfaceKernel,
    pub(super) strips: StripTable,
    /// Whether the row spans the whole pin; otherwise it lies over an end.
    pub(super) is_whole: bool,
    /// Ends along the axis from the origin, thicknesses.
    pub(super) ends: [f64; 2],
    pub(super) resolution: Resolution,
}

/// Slices of one length; lengths are in thicknesses.
#[derive(Clone, Debug)]
pub(super) struct SliceRow {
    pub(super) layer: Layer,
    pub(super) resolution: Resolution,
    pub(super) strips: StripTable,
    pub(super) coupling: Coupling,
    pub(super) length: f64,
    /// Largest half-width.
    pub(super) widest: f64,
    /// Ends along the axis from the origin.
    pub(super) ends: [f64; 2],
    /// Whether the row lies over an end only.
    pub(super) is_partial: bool,
    /// Coupling blocks of two slices by their distance, when all slices are equally wide.
    pub(super) pair_blocks: Vec<f64>,
    /// Slice length.
    pub(super) h: f64,
    /// Middles of the slices along the axis from the origin.
    pub(super) along: Vec<f64>,
    /// Rules of 1, 2 ... points across half a slice.
    pub(super) rules: Vec<PointRule>,
    /// Unknowns that a dense system has room for at least.
    pub(super) dense_unknowns: usize,
}

impl SliceRow {
    /// Cuts a row into slices and tabulates their coupling; allocates.
    ///
    /// # Errors
    /// More than 4096 slices.
    pub(super) fn new(plan: RowPlan<'_>) -> Result<Self, Invalid> {
        let RowPlan { layer, kernel, strips, is_whole, ends, resolution } = plan;
        let [from, to] = ends;
        let length = to - from;
        // Where the contact is wide, its pressure varies less from slice to slice.
        let bar = resolution.bar.filter(|_| !strips.is_free());
        let Resolution { whole, end, modes, .. } = resolution;
        let (whole, end, modes) = bar.map_or((whole, end, modes), |b| (b.whole, b.end, b.modes));
        let is_coarse = !is_whole || (resolution.lines.is_none() && length < COARSE_LENGTH_MAX);
        let unknowns = if is_coarse && strips.is_free() { resolution.dense_unknowns } else { 0 };
        let spacing = if is_whole { whole } else { end };
        let fewest = match unknowns / strips.layout.cosines {
            0 => spacing.fewest,
            most => spacing.fewest.min(most as f64),
        };
        let spacing = SliceSpacing { fewest, ..spacing };
        let has_wide_face = bar.is_none() && !strips.is_free() && strips.widest() > WIDE_FACE;
        let stretch = if has_wide_face { WIDE_FACE_STRETCH } else { 1.0 };
        let wanted = libm::ceil(spacing.count(length, stretch));
        if wanted > SLICES_MAX as f64 {
            let what = format!("{} mm is {length} thicknesses", length * layer.thickness_mm);
            return Err(Invalid::new("length_mm", what, "cut the pin at the array"));
        }
        let slices = wanted as usize;
        let transfer = layer.transfer();
        let lost = end_loss(&transfer, kernel, length / slices as f64);
        let h = length / (slices as f64 - 2.0 * lost);
        let middle = 0.5 * (from + to);
        let place = |i: usize| middle + (i as f64 - 0.5 * (slices as f64 - 1.0)) * h;
        let cosines = strips.layout.cosines;
        // No tilt presses a row over an end deeper.
        let factor = if length < STUBBY_LENGTH { STUBBY_DEPTH_FACTOR } else { DEPTH_FACTOR };
        let deepest = factor * (TILT_MAX_RAD * length).max(DEPTH_MIN);
        let widest = if is_whole { strips.widest() } else { strips.half_width(deepest) };
        let modes = modes.for_row(length, widest);
        let sizes = CoupledSlices { cosines, widest, slices, h };
        let coupling = Coupling::new(&transfer, modes, Parity::Even, sizes);
        let pair_blocks = if strips.is_free() { Vec::new() } else { coupling.pair_blocks(widest) };
        let resolution = Resolution { modes, ..resolution };
        let most = points_for(resolution.lines.unwrap_or(resolution.points), widest);
        Ok(Self {
            layer: *layer,
            resolution,
            strips,
            coupling,
            h,
            length,
            widest,
            ends,
            is_partial: !is_whole,
            pair_blocks,
            along: (0..slices).map(place).collect(),
            rules: (1..=most).map(|points| PointRule::new(points, cosines)).collect(),
            dense_unknowns: unknowns,
        })
    }

    /// pi G/(1 - nu): pressure per unit of the kernels, MPa.
    pub(super) fn modulus_mpa(&self) -> f64 {
        PI * self.layer.shear_mpa() / (1.0 - self.layer.poisson)
    }
}
