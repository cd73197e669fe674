//! Solves a short pin on slices of a row's length and on much shorter ones. The difference of the
//! two is the correction at an end.

use super::super::super::super::kernel::SurfaceKernel;
use super::super::super::super::layer::Layer;
use super::super::contact::RowContact;
use super::super::end_loss::end_loss;
use super::super::resolution::{Resolution, SliceSpacing};
use super::super::row::{RowPlan, SliceRow};
use super::super::solve::solve;
use super::super::spread_loads::end_spread;
use super::super::strip::StripTable;
use super::super::tables::end_correction::{
    DepthCorrection, EndCorrection, HALVED_SLICE_LENGTH, LOADS_BEYOND_END,
};
use super::super::target::Target;
use crate::numeric::interpolation::cubic;
use core::f64::consts::PI;

/// Half the length of the short pin, thicknesses.
const HALF_LENGTH: f64 = 5.0;
/// Slices up to this length (thicknesses) need no correction in an image.
const EXACT_SLICE_LENGTH: f64 = 0.12;
/// Length of the shorter slices (thicknesses), and fewest and most of them to one slice.
const SHORT_SLICE_LENGTH: f64 = 0.1;
const SHORT_SLICES_RANGE: [f64; 2] = [2.0, 4.0];
/// Depths that a cylinder's end is solved at, and the ratio of each to the next.
const DEPTH_COUNT: usize = 5;
const DEPTH_RATIO: f64 = 2.0;
/// Error over the largest penetration at which the steps of the short pin end, and their largest
/// number.
const STEP_TOLERANCE: f64 = 1e-6;
const STEPS_MAX: usize = 60;
/// Largest distance of the loads along the pin, thicknesses.
const SPACING_MAX: f64 = 0.31;
/// Slices longer than this (thicknesses) have three loads each.
const THREE_LOADS_SLICE_LENGTH: f64 = 0.4;
/// A difference counts in full up to the first distance (thicknesses) from the end, and not at all
/// beyond the second.
const COUNTED_DISTANCES: [f64; 2] = [1.0, 4.2];
/// Rise of the leaning short pin, in parts of its end's depth per thickness, and the index of the
/// depth at which it is solved.
const LEANING_RISE: f64 = 0.1;
const LEANING_DEPTH: usize = 1;

/// A short pin on slices of a row's length and on shorter ones.
struct ShortPins {
    coarse: RowContact,
    fine: RowContact,
}

/// Solves the correction of a row's slices, down from the deepest end; allocates. Absent where
/// slices are short, and where the short pin has no solution.
pub(in super::super) fn end_correction(
    layer: &Layer,
    kernel: &SurfaceKernel,
    strips: &StripTable,
    deepest: f64,
    of: &SliceRow,
) -> Option<EndCorrection> {
    let (h, resolution) = (of.h, of.resolution);
    if h < EXACT_SLICE_LENGTH {
        return None;
    }
    let lost = end_loss(&layer.transfer(), kernel, h);
    let slices = libm::ceil(2.0 * HALF_LENGTH / h);
    let length = h * (slices - 2.0 * lost);
    let row = |slices: f64| {
        let whole = SliceSpacing { fewest: slices, slice: length, enough: slices, longest: length };
        let (tolerance, steps) = (STEP_TOLERANCE, STEPS_MAX);
        let resolution = Resolution { whole, tolerance, steps, bar: None, ..resolution };
        let (strips, ends) = (strips.clone(), [0.0, length]);
        RowContact::new(RowPlan { layer, kernel, strips, is_whole: true, ends, resolution }).ok()
    };
    let [fewest, most] = SHORT_SLICES_RANGE;
    let shorter = libm::ceil(h / SHORT_SLICE_LENGTH).clamp(fewest, most);
    let mut pins = ShortPins { coarse: row(slices)?, fine: row(shorter * slices)? };
    let depths = if strips.is_free() { DEPTH_COUNT } else { 1 };
    let mut solved = Vec::with_capacity(depths);
    let (mut depth, mut leaning) = (deepest, None);
    for at in 0..depths {
        let found = pins.correction(depth);
        if let Some(found) = found.as_ref().filter(|_| at == LEANING_DEPTH.min(depths - 1)) {
            leaning = pins.leaning(found);
        }
        solved.extend(found);
        depth /= DEPTH_RATIO;
    }
    let loads = solved.first()?.loads.len();
    Some(EndCorrection {
        cosines: strips.layout.cosines,
        spacing: load_spacing(pins.coarse.row.h),
        leaning: leaning.unwrap_or_else(|| vec![0.0; loads]),
        solved,
    })
}

impl ShortPins {
    /// The correction at a depth.
    fn correction(&mut self, depth: f64) -> Option<DepthCorrection> {
        self.coarse.release();
        self.fine.release();
        self.press(depth, 0.0)?;
        // The loads have the largest width, because cosines that are moved to a narrower width do
        // not converge.
        let end = self.coarse.state.end_width();
        let widths = self.fine.state.widths.iter().chain(&self.coarse.state.widths);
        let width_ratio = widths.fold(end, |w, b| w.max(*b)) / end;
        let loads = self.difference(width_ratio)?;
        Some(DepthCorrection { depth, width_ratio, loads })
    }

    /// The change of the loads where the pin leans, after the contact of `upright`; absent where
    /// the short pins do not converge.
    fn leaning(&mut self, upright: &DepthCorrection) -> Option<Vec<f64>> {
        self.press(upright.depth, LEANING_RISE * upright.depth)?;
        let loads = self.difference(upright.width_ratio)?;
        Some(loads.iter().zip(&upright.loads).map(|(b, a)| (b - a) / LEANING_RISE).collect())
    }

    /// Presses both pins to `depth` at their far end; the penetration rises by `rise` per thickness
    /// towards it.
    fn press(&mut self, depth: f64, rise: f64) -> Option<()> {
        for contact in [&mut self.coarse, &mut self.fine] {
            let target = Target::at_penetration(depth - rise * contact.row.ends[1]);
            solve(contact, None, target, rise).ok()?;
        }
        Some(())
    }

    /// The difference of the two pins near the far end, as loads over a half-width `width_ratio`
    /// times the last slice's, relative to the last slice's mean pressure.
    fn difference(&self, width_ratio: f64) -> Option<Vec<f64>> {
        let (coarse, n) = (&self.coarse, self.coarse.state.layout.cosines);
        let spacing = load_spacing(coarse.row.h);
        let count = libm::ceil(COUNTED_DISTANCES[1] / spacing) as usize + LOADS_BEYOND_END + 2;
        let mut loads = vec![0.0; count * n];
        let width = width_ratio * coarse.state.end_width();
        add_loads(coarse, -1.0, spacing, width, &mut loads);
        add_loads(&self.fine, 1.0, spacing, width, &mut loads);
        let last = coarse.state.a[(coarse.row.along.len() - 1) * n];
        loads.iter_mut().for_each(|load| *load /= last);
        (last > 0.0 && loads.iter().all(|load| load.is_finite())).then_some(loads)
    }
}

/// Adds `part` times the pressure near the far end to loads, cosine after cosine, each to the four
/// loads around it by cubics.
fn add_loads(contact: &RowContact, part: f64, spacing: f64, width: f64, loads: &mut [f64]) {
    let (row, state) = (&contact.row, &contact.state);
    let n = state.layout.cosines;
    let mut moved = vec![0.0; n];
    for (j, v) in row.along.iter().enumerate() {
        let (b, own) = state.slice(j);
        move_to_width(own, b / width, &mut moved);
        for (place, share) in end_spread(*v, row.h) {
            let s = row.length - place;
            let counts = counted_part(s);
            if counts == 0.0 {
                continue;
            }
            let at = s / spacing + LOADS_BEYOND_END as f64;
            let first = (libm::floor(at) - 1.0).clamp(0.0, (loads.len() / n - 4) as f64);
            let weights = cubic(at - first - 1.0);
            for (i, weight) in (first as usize..).zip(weights) {
                let factor = part * share * counts * weight * row.h;
                let load = &mut loads[i * n..(i + 1) * n];
                load.iter_mut().zip(&moved).for_each(|(sum, a)| *sum += factor * a);
            }
        }
    }
}

/// Distance of the loads of the correction of slices of length `h`: a third or a half of it, a
/// quarter where there are loads between slices, or a whole multiple. With this spacing the loads
/// lie in the same way in every slice.
fn load_spacing(h: f64) -> f64 {
    match h {
        h if h > HALVED_SLICE_LENGTH => 0.25 * h,
        h if h > THREE_LOADS_SLICE_LENGTH => h / 3.0,
        h if h > SPACING_MAX => 0.5 * h,
        h => h * libm::floor(SPACING_MAX / h),
    }
}

/// Writes the cosines of a pressure on another half-width, of which the pressure's own is `ratio`
/// times as large. The moments of the pressure across the pin are kept.
fn move_to_width(own: &[f64], ratio: f64, out: &mut [f64]) {
    let points = own.len() + 2;
    out.fill(0.0);
    for i in 0..points {
        let angle = PI * (2 * i + 1) as f64 / (4 * points) as f64;
        let psi = |(k, a): (usize, &f64)| a * libm::cos(2.0 * k as f64 * angle);
        let psi = own.iter().enumerate().map(psi).sum::<f64>() / points as f64;
        let z = ratio * libm::cos(angle);
        // Chebyshev's polynomials by their recurrence.
        let (mut now, mut next) = (1.0, 2.0 * z * z - 1.0);
        let double = 2.0 * next;
        for (k, value) in out.iter_mut().enumerate() {
            *value += if k == 0 { psi } else { 2.0 * psi * now };
            (now, next) = (next, double * next - now);
        }
    }
}

/// Part of a difference at a distance from the end that counts.
fn counted_part(s: f64) -> f64 {
    let [all, none] = COUNTED_DISTANCES;
    let part = ((s - all) / (none - all)).clamp(0.0, 1.0);
    0.5 * (1.0 + libm::cos(PI * part))
}
