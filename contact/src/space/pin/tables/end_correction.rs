//! Correction of the pressure at a sharp end of a pin. In the middle of a pin equal slices give the
//! pressure of a smooth contact without error. At an end, where the pressure rises without bound,
//! they carry too little of it, slightly displaced and too wide: the error of an image right over
//! the end is up to 7e-3 of its peak, for slices half as long as the layer is thick. The error
//! depends on the end alone. It is tabulated cosine by cosine as loads near the end, and added to
//! force and image. A cylinder's correction is tabulated at some depths of its end; a bar's is
//! proportional to its pressure. Where the pin leans, the correction changes in proportion.

use super::super::row::SliceRow;
use super::super::state::ContactState;
use super::super::strip::COSINES_MAX;
use core::f64::consts::PI;

/// Loads of the correction that lie beyond the end.
pub(crate) const LOADS_BEYOND_END: usize = 2;
/// Largest rise of the penetration, in parts of an end's depth per thickness, that the correction
/// is extrapolated to.
const RISE_MAX: f64 = 0.5;
/// Slices longer than this (thicknesses) have loads between them, too.
pub(crate) const HALVED_SLICE_LENGTH: f64 = 0.5;

/// The correction of an end at one depth.
#[derive(Clone, Debug)]
pub(crate) struct DepthCorrection {
    pub(crate) depth: f64,
    /// Half-width over which the loads are spread, over that of the last slice.
    pub(crate) width_ratio: f64,
    /// Cosines of each load, over the last slice's mean pressure.
    pub(crate) loads: Vec<f64>,
}

/// An end in contact.
#[derive(Clone, Copy, Debug)]
struct ContactEnd {
    depth: f64,
    /// Change of the penetration per thickness inwards, in parts of the depth.
    rise: f64,
    /// Mean pressure of the last slice.
    last: f64,
}

/// Cosines of one load of the correction, times thickness.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CorrectionLoad<'a> {
    /// Half-width over which the load is spread, thicknesses.
    pub(crate) half_width: f64,
    /// Place along the row, thicknesses.
    pub(crate) along: f64,
    pub(crate) cosines: &'a [f64],
}

/// The correction of an end, from the deepest to the shallowest.
#[derive(Clone, Debug)]
pub(crate) struct EndCorrection {
    pub(crate) cosines: usize,
    /// Distance between two neighbouring loads, thicknesses.
    pub(crate) spacing: f64,
    pub(crate) solved: Vec<DepthCorrection>,
    /// Change of the loads where the penetration changes by the whole depth in a thickness; it is
    /// small, and found at one depth.
    pub(crate) leaning: Vec<f64>,
}

impl EndCorrection {
    /// Calls with the cosines (times thickness) of each load at an end, its half-width over the
    /// last slice's, and its place inwards from the end.
    fn for_end(&self, end: ContactEnd, mut of: impl FnMut(&[f64], f64, f64)) {
        let ContactEnd { depth, rise, last } = end;
        let after = self.solved.iter().position(|solved| solved.depth <= depth);
        let after = after.unwrap_or(self.solved.len() - 1);
        let (a, b) = (&self.solved[after.saturating_sub(1)], &self.solved[after]);
        let apart = a.depth - b.depth;
        let part = if apart > 0.0 { ((a.depth - depth) / apart).clamp(0.0, 1.0) } else { 1.0 };
        let width_ratio = a.width_ratio + part * (b.width_ratio - a.width_ratio);
        let n = self.cosines;
        let mut sum = [0.0; COSINES_MAX];
        for i in 0..a.loads.len() / n {
            let stretch = i * n..(i + 1) * n;
            let lists = [&a.loads, &b.loads, &self.leaning];
            let [a, b, leaning] = lists.map(|list| &list[stretch.clone()]);
            for (k, value) in sum[..n].iter_mut().enumerate() {
                *value = last * (a[k] + part * (b[k] - a[k]) + rise * leaning[k]);
            }
            of(&sum[..n], width_ratio, self.spacing * (i as f64 - LOADS_BEYOND_END as f64));
        }
    }

    /// Calls with each load at the ends that touch.
    pub(crate) fn for_each_load(
        &self,
        row: &SliceRow,
        state: &ContactState,
        mut of: impl FnMut(CorrectionLoad<'_>),
    ) {
        let [near, far] = row.ends;
        let last = row.along.len() - 1;
        let given = &state.given;
        let slope = (given[last] - given[0]) / (row.along[last] - row.along[0]).max(row.h);
        for (j, place, inwards) in [(last, far, -1.0), (0, near, 1.0)] {
            // A row over an end has only that end.
            if state.touches(j) && !(row.is_partial && j == 0) {
                let (b, own) = state.slice(j);
                let rise = (-inwards * slope / given[j]).clamp(-RISE_MAX, RISE_MAX);
                let end = ContactEnd { depth: given[j], rise, last: own[0] };
                self.for_end(end, |cosines, width_ratio, away| {
                    let (half_width, along) = (width_ratio * b, place + inwards * away);
                    of(CorrectionLoad { half_width, along, cosines });
                });
            }
        }
    }
}

/// Force of a correction in units of the kernels, and its moment about the origin.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct CorrectionForce {
    pub(crate) force: f64,
    pub(crate) moment: f64,
}

/// Force and moment of a row's correction; 0 where the row has none.
pub(crate) fn correction_force(
    correction: Option<&EndCorrection>,
    row: &SliceRow,
    state: &ContactState,
) -> CorrectionForce {
    let mut sum = CorrectionForce::default();
    if let Some(correction) = correction {
        correction.for_each_load(row, state, |load| {
            sum.force += PI * load.cosines[0];
            sum.moment += PI * load.cosines[0] * load.along;
        });
    }
    sum
}
