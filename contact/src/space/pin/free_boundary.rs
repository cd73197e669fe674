//! The free boundary of a contact. The error of the pressure at the edge of a slice of free width
//! is expressed as the change of width that removes it; slices out of contact that the layer's
//! surface reaches come back into contact.

use super::anderson::AndersonMixing;
use super::linear::LinearSolver;
use super::row::SliceRow;
use super::state::ContactState;
use super::strip::StripLayout;

/// Smallest and largest ratio of the growth of a slice's contact to its growth in the plane.
const EDGE_GROWTH_RANGE: [f64; 2] = [0.3, 3.0];
/// Smallest and largest part of a change that a short row takes.
const RELAXATION_RANGE: [f64; 2] = [0.15, 1.5];
/// Smallest and largest part of its own change that a slice of a short row takes.
const SLICE_RELAXATION_RANGE: [f64; 2] = [0.02, 0.7];
/// Factors of a slice's part after a change of opposite sign and after one of the same sign.
const RELAXATION_DECREASE: f64 = 0.6;
const RELAXATION_INCREASE: f64 = 1.2;
/// On a row that is not short, a change of opposite sign counts as an oscillation if it exceeds
/// this part of the change before it.
const OSCILLATION_RATIO: f64 = 0.5;
/// A bar's slice that was released this many times stays out of contact.
const RELEASES_MAX: u8 = 2;

/// When the steps of a contact end.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepLimits {
    /// Error over the largest penetration at which the steps end.
    pub(super) tolerance: f64,
    /// Most steps.
    pub(super) steps: usize,
}

/// Memory of the free-boundary steps.
#[derive(Clone, Debug)]
pub(super) struct NonlinearSolver {
    pub(super) limits: StepLimits,
    /// Rate of the last contact's force over that of independent slices; 0 when not known.
    pub(super) stiffness: f64,
    /// Changes of the widths' penetrations in this step and in the last one, slice after slice.
    pub(super) moves: [Vec<f64>; 2],
    /// Penetrations of the widths that this step leads to, slice after slice.
    pub(super) proposed: Vec<f64>,
    /// Part of the changes that all slices take; 0 where they always take all of it.
    pub(super) relaxation: f64,
    /// Change of the penetration before this step; 0 where the step itself changes it.
    pub(super) shifted: f64,
    /// The part that each slice takes of its own change; empty where all take the same.
    pub(super) parts: Vec<f64>,
    /// How often each slice of a bar was released in this contact.
    pub(super) releases: Vec<u8>,
    /// Accelerated steps of all widths.
    pub(super) anderson: AndersonMixing,
}

impl NonlinearSolver {
    /// Memory for so many slices; allocates.
    pub(super) fn new(slices: usize, limits: StepLimits) -> Self {
        let zeros = || vec![0.0; slices];
        Self {
            limits,
            stiffness: 0.0,
            moves: [zeros(), zeros()],
            proposed: zeros(),
            relaxation: 0.0,
            shifted: 0.0,
            parts: Vec::new(),
            releases: vec![0; slices],
            anderson: AndersonMixing::new(slices),
        }
    }

    /// Turns on relaxation of all slices together. On a short row the slices do not respond like
    /// plane ones, so the part of a change that is taken follows from the last two changes
    /// (Aitken's rule).
    pub(super) fn enable_relaxation(&mut self) {
        self.relaxation = 1.0;
    }

    /// Turns on relaxation slice by slice: a slice takes less of a change that oscillates and more
    /// of one that does not.
    pub(super) fn enable_slice_relaxation(&mut self) {
        self.parts = vec![1.0; self.releases.len()];
    }

    /// The part of the changes that all slices take; 1 where each slice has its own part.
    fn relaxation_factor(&mut self, is_first: bool) -> f64 {
        if !self.parts.is_empty() {
            let (most, ratio, shifted) = if self.relaxation == 0.0 {
                (1.0, OSCILLATION_RATIO, self.shifted)
            } else {
                (SLICE_RELAXATION_RANGE[1], 0.0, 0.0)
            };
            let [now, before] = &self.moves;
            for (part, (now, before)) in self.parts.iter_mut().zip(now.iter().zip(before)) {
                // A change that follows from the shift of the penetration is no oscillation.
                let least = (ratio * before.abs()).max(shifted);
                let oscillates = now * before < 0.0 && now.abs() > least;
                let factor = if oscillates { RELAXATION_DECREASE } else { RELAXATION_INCREASE };
                *part = if is_first {
                    most
                } else {
                    (*part * factor).clamp(SLICE_RELAXATION_RANGE[0], most)
                };
            }
            return 1.0;
        }
        if self.relaxation == 0.0 {
            return 1.0;
        }
        if is_first {
            self.relaxation = 1.0;
            return 1.0;
        }
        let (mut along, mut size) = (0.0, 0.0);
        let [now, before] = &self.moves;
        for (now, before) in now.iter().zip(before) {
            along += before * (now - before);
            size += (now - before) * (now - before);
        }
        if size > 0.0 {
            self.relaxation =
                (-self.relaxation * along / size).clamp(RELAXATION_RANGE[0], RELAXATION_RANGE[1]);
        }
        self.relaxation
    }

    /// Whether a slice stays out of contact though the layer may reach its middle: beside a wide
    /// bar the rubber bulges there, while the slice as a whole was in tension whenever it touched.
    fn is_barred(&self, slice: usize) -> bool {
        self.releases[slice] >= RELEASES_MAX
    }

    /// Allows every slice to come back into contact; whether some slices could not.
    pub(super) fn readmit_slices(&mut self) -> bool {
        let some = (0..self.releases.len()).any(|slice| self.is_barred(slice));
        self.releases.fill(0);
        some
    }
}

/// Change of the penetration of a slice's width that removes the singularity that the pressure has
/// at its edge.
fn edge_correction(layout: StripLayout, row: &[f64], own: &[f64]) -> f64 {
    let strength = own.iter().sum::<f64>() / row[layout.edge()];
    strength * edge_growth(layout, row, own, strength)
}

/// Ratio of the growth of the slice's contact, per error at its edge, to the growth that it would
/// have on its own. At the right width the pressure ends as a square root. Moving the edge by db
/// leaves a singularity in proportion to db and to the factor of that root; widths do not act on
/// each other. The factor is taken from the pressure without its singularity, beside the plane
/// contact's of the same width.
fn edge_growth(layout: StripLayout, row: &[f64], own: &[f64], strength: f64) -> f64 {
    let (mut plane, mut found) = (0.0, 0.0);
    for (k, a) in own.iter().enumerate().skip(1) {
        let weight = (k * k) as f64;
        plane += weight * row[layout.contact(k)];
        found += weight * (a - strength * row[layout.punch(k)]);
    }
    let ratio = plane / found;
    if ratio > 0.0 { ratio.clamp(EDGE_GROWTH_RANGE[0], EDGE_GROWTH_RANGE[1]) } else { 1.0 }
}

/// Penetration interpolated at a slice out of contact between the nearest slices in contact on
/// both sides; absent where none touch on one side. The rubber rises between them, so the gap
/// alone would make the slice too wide, and it would leave the contact again.
fn interpolated_penetration(state: &ContactState, slice: usize) -> Option<f64> {
    let n = state.layout.cosines;
    let touches = |j: &usize| state.active[*j] && state.a[j * n] != 0.0;
    let before = (0..slice).rev().find(touches)?;
    let after = (slice + 1..state.active.len()).find(touches)?;
    let part = (slice - before) as f64 / (after - before) as f64;
    Some((1.0 - part) * state.effective[before] + part * state.effective[after])
}

/// Change of the penetration of its width that a slice on its own would take.
pub(super) fn width_correction(state: &ContactState, slice: usize) -> f64 {
    let n = state.layout.cosines;
    let own = &state.a[slice * n..(slice + 1) * n];
    edge_correction(state.layout, state.row(slice), own)
}

/// Largest change that a slice on its own would take, over the largest penetration.
pub(super) fn edge_error(row: &SliceRow, state: &ContactState) -> f64 {
    let touching = (0..row.along.len()).filter(|j| state.active[*j]);
    let most = touching.map(|j| width_correction(state, j).abs()).fold(0.0, f64::max);
    most / state.penetration_scale(row.strips.is_free())
}

/// Brings slices that the layer's surface reaches back into contact; the largest depth by which it
/// reaches one, in thicknesses.
pub(super) fn reactivate_slices(
    row: &SliceRow,
    state: &mut ContactState,
    nonlinear: &NonlinearSolver,
    linear: &mut LinearSolver,
) -> f64 {
    let (slices, n) = (row.along.len(), state.layout.cosines);
    let mut largest: f64 = 0.0;
    let sums = &mut linear.sums;
    row.coupling.convolve(sums, &state.transforms, &state.a);
    for j in 0..slices {
        if !state.active[j] && state.a[j * n] == 0.0 && !nonlinear.is_barred(j) {
            let gap = state.given[j] - row.coupling.middle(sums, j);
            if gap > 0.0 {
                let between =
                    if row.strips.is_free() { interpolated_penetration(state, j) } else { None };
                state.active[j] = true;
                state.effective[j] = between.map_or(gap, |between| gap.min(between));
                largest = largest.max(gap);
            }
        }
    }
    largest
}

/// Changes the penetrations of the slices' widths by what the pressure leaves at their edges; the
/// largest change.
pub(super) fn update_widths(
    row: &SliceRow,
    state: &mut ContactState,
    nonlinear: &mut NonlinearSolver,
    linear: &mut LinearSolver,
    is_first: bool,
) -> f64 {
    let slices = row.along.len();
    let is_free = row.strips.is_free();
    let (layout, n) = (state.layout, state.layout.cosines);
    let mut largest: f64 = 0.0;
    let mut has_gaps = false;
    nonlinear.moves.swap(0, 1);
    for j in 0..slices {
        nonlinear.moves[0][j] = 0.0;
        if !state.active[j] {
            has_gaps = true;
            continue;
        }
        let table = &state.rows[j * layout.len()..(j + 1) * layout.len()];
        let own = &state.a[j * n..(j + 1) * n];
        // The width of a bar's slice is fixed; its mean pressure says whether it stays in contact.
        let new = if is_free {
            table[layout.penetration()] + edge_correction(layout, table, own)
        } else {
            own[0]
        };
        nonlinear.moves[0][j] = new - state.effective[j];
        nonlinear.proposed[j] = new;
    }
    let part = if is_free { nonlinear.relaxation_factor(is_first) } else { 1.0 };
    for j in 0..slices {
        if !state.active[j] {
            continue;
        }
        let change = nonlinear.moves[0][j];
        let whole = nonlinear.proposed[j];
        let part = nonlinear.parts.get(j).copied().unwrap_or(part);
        let new = if part == 1.0 { whole } else { state.effective[j] + part * change };
        if is_free || new <= 0.0 {
            largest = largest.max(change.abs());
        }
        state.effective[j] = new;
        if new <= 0.0 {
            state.active[j] = false;
            nonlinear.releases[j] = nonlinear.releases[j].saturating_add(u8::from(!is_free));
        }
    }
    if has_gaps { largest.max(reactivate_slices(row, state, nonlinear, linear)) } else { largest }
}
