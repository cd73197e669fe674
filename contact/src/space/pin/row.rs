//! A row of slices over a pin or over the end of it that touches: tables, places and memory of the
//! solver in [`super::solve`]. Its own axis runs along w, from the origin it was given.
//!
//! It refuses rows of more slices than it may have.

use super::super::super::Invalid;
use super::super::super::kernel::SurfaceKernel;
use super::super::super::layer::Layer;
use super::TILT_MAX;
use super::couple::{Coupling, Parity};
use super::ends::loss;
use super::fineness::{Fineness, Laid};
use super::leftover::Leftover;
use super::lines::{POINTS_MAX, Rule};
use super::lying::Lying;
use super::nested::Nested;
use super::newton::Newton;
use super::strip::Strips;
use super::work::Work;
use core::f64::consts::PI;

/// Rows shorter than this (thicknesses) respond otherwise than in the plane.
const SHORT: f64 = 6.0;
/// A whole pin shorter than this (thicknesses) is cut no finer than its end, where its image is
/// that of spread slices.
const FEW: f64 = 10.0;
/// Penetrations, in parts of the steepest slope's, that a row is made for, and one shorter than
/// this (thicknesses), where widths overshoot further; least, thicknesses.
const DEEPER: f64 = 1.8;
const STUBBY: f64 = 0.2;
const STUBBY_DEEPER: f64 = 2.8;
const SHALLOWEST: f64 = 0.01;
/// Half-width of a face (thicknesses) from which slices may be longer, and so many times.
const WIDE: f64 = 1.2;
const WIDER: f64 = 1.6;
/// Most slices of a row.
const SLICES_MAX: usize = 4096;

/// Part of a row that a contact is looked for on.
pub(super) const FITS: f64 = 0.92;

/// When the steps of a contact end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settled {
    pub(super) tolerance: f64,
    pub(super) steps: usize,
}

/// Slices of one length.
#[derive(Clone, Debug)]
pub(super) struct Row {
    pub(super) layer: Layer,
    pub(super) fineness: Fineness,
    pub(super) strips: Strips,
    pub(super) coupling: Coupling,
    /// Whole length, largest half-width, in thicknesses.
    pub(super) length: f64,
    pub(super) widest: f64,
    /// Its ends along the axis.
    pub(super) ends: [f64; 2],
    /// Whether it lies over an end only.
    pub(super) part: bool,
    /// What two slices do to each other, by their distance, when all are equally wide.
    pub(super) between: Vec<f64>,
    /// All contacts of a bar, where they were solved beforehand.
    pub(super) nested: Option<Nested>,
    /// Contacts of a cylinder on a good part of it, where they were solved beforehand.
    pub(super) lying: Option<Lying>,
    /// What its slices leave over at an end, where that is known.
    pub(super) leftover: Option<Leftover>,
    /// Memory to settle all widths together.
    pub(super) newton: Option<Box<Newton>>,
    /// Slice length and places along the axis from the origin, in thicknesses.
    pub(super) h: f64,
    pub(super) along: Vec<f64>,
    pub(super) work: Work,
    /// For 1, 2 ... points across half a slice.
    pub(super) rules: Vec<Rule>,
}

impl Row {
    /// Slices from end to end (thicknesses), at least `fewest`; allocates.
    ///
    /// # Errors
    /// More than 4096 slices.
    pub(super) fn new(
        (layer, kernel): (&Layer, &SurfaceKernel),
        (strips, whole): (Strips, bool),
        [from, to]: [f64; 2],
        fineness: Fineness,
    ) -> Result<Self, Invalid> {
        let length = to - from;
        // Where the contact is wide, its pressure varies less from slice to slice.
        let tabled = fineness.nested.filter(|_| !strips.is_free());
        let Fineness { whole: over, end, modes, .. } = fineness;
        let (over, end, modes) = tabled.map_or((over, end, modes), |t| (t.whole, t.end, t.modes));
        let few = !whole || (fineness.lines.is_none() && length < FEW);
        let room = if few && strips.is_free() { fineness.unknowns } else { 0 };
        let laid = if whole { over } else { end };
        let fewest = match room / strips.places.cosines {
            0 => laid.fewest,
            most => laid.fewest.min(most as f64),
        };
        let laid = Laid { fewest, ..laid };
        let wide = tabled.is_none() && !strips.is_free() && strips.widest() > WIDE;
        let wanted = libm::ceil(laid.count(length, if wide { WIDER } else { 1.0 }));
        if wanted > SLICES_MAX as f64 {
            let what = format!("{} mm is {length} thicknesses", length * layer.thickness_mm);
            return Err(Invalid::new("length_mm", what, "cut the pin at the array"));
        }
        let slices = wanted as usize;
        let transfer = layer.transfer();
        let lost = loss(&transfer, kernel, length / slices as f64);
        let h = length / (slices as f64 - 2.0 * lost);
        let middle = 0.5 * (from + to);
        let place = |i: usize| middle + (i as f64 - 0.5 * (slices as f64 - 1.0)) * h;
        let cosines = strips.places.cosines;
        // No tilt presses a row over an end deeper.
        let deeper = if length < STUBBY { STUBBY_DEEPER } else { DEEPER };
        let deepest = deeper * (TILT_MAX * length).max(SHALLOWEST);
        let widest = if whole { strips.widest() } else { strips.half_width(deepest) };
        let sizes = ((cosines, widest), (slices, h));
        let modes = modes.over(length, widest);
        let coupling = Coupling::new(&transfer, (modes, Parity::Even), sizes.0, sizes.1);
        let between = if strips.is_free() { Vec::new() } else { coupling.between(widest) };
        let along: Vec<f64> = (0..slices).map(place).collect();
        let nested = tabled.and_then(|_| Nested::new(&strips, &between, &along));
        let mut work = Work::new(slices, &strips, (coupling.transform_len(), room));
        let fineness = Fineness { modes, ..fineness };
        if fineness.each && strips.is_free() {
            work.relax_each();
        }
        let fineness = if length < SHORT { calmed(fineness, &mut work) } else { fineness };
        let finest = fineness.lines.unwrap_or(fineness.points);
        let most = points_for(finest, widest);
        Ok(Self {
            layer: *layer,
            fineness,
            strips,
            coupling,
            h,
            length,
            widest,
            ends: [from, to],
            part: !whole,
            between,
            nested,
            lying: None,
            leftover: None,
            newton: None,
            along,
            work,
            rules: (1..=most).map(|points| Rule::new(points, cosines)).collect(),
        })
    }

    /// Ends the steps otherwise; what ended them before.
    pub(super) fn settle(&mut self, settled: Settled) -> Settled {
        let Settled { tolerance, steps } = settled;
        let before = self.fineness;
        self.fineness = Fineness { tolerance, steps, ..before };
        Settled { tolerance: before.tolerance, steps: before.steps }
    }

    /// Lifts off and forgets the contact.
    pub(super) fn release(&mut self) {
        self.work.clear();
    }

    /// pi G/(1 - nu): pressure per unit of the kernels.
    pub(super) fn modulus_mpa(&self) -> f64 {
        PI * self.layer.shear_mpa() / (1.0 - self.layer.poisson)
    }
}

/// A short row's slices act on each other so much that they take more and smaller steps.
fn calmed(fineness: Fineness, work: &mut Work) -> Fineness {
    work.relax();
    Fineness { steps: 3 * fineness.steps, ..fineness }
}

/// The shortest row that holds a contact so long.
pub(super) fn holding(rows: &[Row], touched: f64) -> usize {
    let holds = |row: &&Row| touched < FITS * row.length;
    rows.iter().take_while(holds).count().saturating_sub(1)
}

/// How a row lies along the pin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lie {
    pub(super) turned: bool,
    pub(super) mirror_mm: f64,
}

impl Lie {
    /// Place along the pin of what is at `w_mm` along the row.
    pub(super) fn place(self, w_mm: f64) -> f64 {
        if self.turned { self.mirror_mm - w_mm } else { w_mm }
    }
}

/// Points across half a strip of half-width `b` that stand for wave numbers up to `cutoff`: the
/// error of Gauss and Chebyshev's rule with 2 n points is the Bessel function J_4n(cutoff b).
pub(super) fn points_for(cutoff: f64, b: f64) -> usize {
    (libm::ceil(0.25 * (cutoff * b + 0.5 * cutoff)) as usize).clamp(2, POINTS_MAX)
}
