//! The contact of a pin: free-boundary steps around conjugate gradients on the coupled slices.

use super::super::super::Invalid;
use super::super::quadrature::{factor, solve};
use super::PinState;
use super::row::Row;
use super::strip::Places;
use core::f64::consts::PI;

/// Least and largest part of a change that a short row takes.
const RELAXED: [f64; 2] = [0.15, 1.5];
/// Most iterations of conjugate gradients in one step.
const GRADIENTS_MAX: usize = 200;
/// Part of the penetration that may be left when the steps are used up; more is no answer.
const UNSETTLED: f64 = 0.1;
/// So many times the level's steps, for a contact of which more than that is left.
const MORE: usize = 4;

/// Memory of the solver; everything is slice after slice.
#[derive(Clone, Debug)]
pub(crate) struct Work {
    places: Places,
    transform: usize,
    /// Penetration that each slice's width belongs to; 0 or less: no contact.
    effective: Vec<f64>,
    /// Penetration of the rigid pin.
    given: Vec<f64>,
    widths: Vec<f64>,
    active: Vec<bool>,
    rows: Vec<f64>,
    transforms: Vec<f64>,
    blocks: Vec<f64>,
    /// Cosines of the pressure, and the vectors of conjugate gradients.
    a: Vec<f64>,
    residual: Vec<f64>,
    cured: Vec<f64>,
    direction: Vec<f64>,
    image: Vec<f64>,
    warm: bool,
    /// Changes of the widths' penetrations, this step's and the last one's, and the part of them
    /// that is taken; 0 where all of it always is.
    moves: [Vec<f64>; 2],
    relaxed: f64,
}

impl Work {
    pub(crate) fn new(slices: usize, places: Places, transform: usize) -> Self {
        let n = places.cosines;
        let per = |count: usize| vec![0.0; slices * count];
        Self {
            places,
            transform,
            effective: per(1),
            given: per(1),
            widths: per(1),
            active: vec![false; slices],
            rows: per(places.len()),
            transforms: per(transform),
            blocks: per(n * n),
            a: per(n),
            residual: per(n),
            cured: per(n),
            direction: per(n),
            image: per(n),
            warm: false,
            moves: [per(1), per(1)],
            relaxed: 0.0,
        }
    }

    /// On a row that is short the slices do not respond as plane ones: the part of a change that is
    /// taken then follows from the last two (Aitken's rule).
    pub(crate) fn relax(&mut self) {
        self.relaxed = 1.0;
    }

    fn relaxation(&mut self, first: bool) -> f64 {
        if self.relaxed == 0.0 {
            return 1.0;
        }
        if first {
            self.relaxed = 1.0;
            return 1.0;
        }
        let (mut along, mut size) = (0.0, 0.0);
        let [now, before] = &self.moves;
        for (now, before) in now.iter().zip(before) {
            along += before * (now - before);
            size += (now - before) * (now - before);
        }
        if size > 0.0 {
            self.relaxed = (-self.relaxed * along / size).clamp(RELAXED[0], RELAXED[1]);
        }
        self.relaxed
    }

    /// Prescribes a descent on some slices, where they touch whatever comes.
    pub(crate) fn hold(&mut self, descent: impl Fn(usize) -> Option<f64>) {
        for j in 0..self.active.len() {
            let held = descent(j);
            self.active[j] = held.is_some();
            self.given[j] = held.unwrap_or(0.0);
            self.effective[j] = self.given[j];
        }
    }

    pub(crate) fn clear(&mut self) {
        self.warm = false;
        self.active.fill(false);
        self.a.fill(0.0);
    }

    pub(crate) fn is_warm(&self) -> bool {
        self.warm
    }

    pub(crate) fn touches(&self, slice: usize) -> bool {
        self.active[slice]
    }

    /// Half-width in thicknesses and cosines of a slice.
    pub(crate) fn slice(&self, slice: usize) -> (f64, &[f64]) {
        let n = self.places.cosines;
        (self.widths[slice], &self.a[slice * n..(slice + 1) * n])
    }

    fn row(&self, slice: usize) -> &[f64] {
        let width = self.places.len();
        &self.rows[slice * width..(slice + 1) * width]
    }
}

impl Row {
    /// Presses to a force in units of the kernels or, without one, to a penetration at the origin;
    /// with a force the penetration is a guess.
    pub(super) fn press(
        &mut self,
        (wanted, penetration): (Option<f64>, f64),
        slope: f64,
    ) -> Result<PinState, Invalid> {
        let t = self.layer.thickness_mm;
        let scale = self.modulus_mpa() * t * t;
        let warm = self.work.warm;
        let known = warm && wanted.is_some();
        let start = if known { self.turned_about_its_load(slope) } else { penetration };
        let mut outcome = self.iterate(start, slope, wanted);
        if warm && !outcome.as_ref().is_ok_and(|(_, residual, _)| *residual <= UNSETTLED) {
            // The contact before is too far from this one to begin with.
            self.work.clear();
            outcome = self.iterate(penetration, slope, wanted);
        }
        let (penetration, residual, steps) = outcome?;
        if residual > UNSETTLED {
            return Err(unsettled(residual));
        }
        // By penetration this was refused before.
        if wanted.is_some() && self.work.given.iter().any(|given| *given >= 1.0) {
            return Err(unreached());
        }
        let n = self.work.places.cosines;
        let mut state =
            PinState { penetration_mm: penetration * t, residual, steps, ..PinState::default() };
        for (j, v) in self.along.iter().enumerate() {
            if self.work.active[j] {
                let force = PI * self.work.a[j * n] * self.h * scale;
                state.force_n += force;
                state.moment_n_mm += force * v * t;
                state.half_width_mm = state.half_width_mm.max(self.work.widths[j] * t);
                state.length_mm += self.h * t;
            }
        }
        self.work.warm = state.force_n > 0.0;
        Ok(state)
    }

    /// Penetration at the origin when the last contact turns about its resultant to a slope, which
    /// changes its force least.
    fn turned_about_its_load(&self, slope: f64) -> f64 {
        let (n, last) = (self.work.places.cosines, self.along.len() - 1);
        let (mut force, mut moment) = (0.0, 0.0);
        for (j, v) in self.along.iter().enumerate() {
            force += self.work.a[j * n];
            moment += self.work.a[j * n] * v;
        }
        let (from, to) = (self.along[0], self.along[last]);
        let place = (moment / force).clamp(from, to);
        let given = &self.work.given;
        let before = if last == 0 { 0.0 } else { (given[last] - given[0]) / (to - from) };
        given[0] + before * (place - from) - slope * place
    }

    /// Lays the slices at a penetration of the origin under a slope, from the contact before if it
    /// is known; the deepest of them.
    fn place(&mut self, penetration: f64, slope: f64) -> f64 {
        let mut deepest: f64 = 0.0;
        for (j, v) in self.along.iter().enumerate() {
            let given = penetration + slope * v;
            let work = &mut self.work;
            let keep = work.warm && work.active[j];
            work.effective[j] =
                if keep { work.effective[j] + given - work.given[j] } else { given };
            work.active[j] = work.effective[j] > 0.0;
            work.given[j] = given;
            deepest = deepest.max(given);
        }
        deepest
    }

    /// Free-boundary steps; the penetration at the origin, what is left, and the number of steps.
    fn iterate(
        &mut self,
        start: f64,
        slope: f64,
        wanted: Option<f64>,
    ) -> Result<(f64, f64, usize), Invalid> {
        let mut penetration = start;
        let mut shift = 0.0;
        let warm = self.work.warm;
        if self.place(penetration, slope) <= 0.0 && wanted.is_none() {
            self.work.clear();
            return Ok((penetration, 0.0, 0));
        }
        let mut known: Option<(f64, f64)> = None;
        let mut left = f64::INFINITY;
        let mut fresh = !warm;
        let stiffest = if self.work.relaxed == 0.0 { 2.0 } else { 8.0 };
        let mut step = 0;
        // A contact that is no answer yet gets more steps.
        while step < self.fineness.steps || (left > UNSETTLED && step < MORE * self.fineness.steps)
        {
            step += 1;
            for given in &mut self.work.given {
                *given += shift;
            }
            self.prepare(fresh)?;
            fresh = false;
            // Loose while the widths are wrong; nothing is accepted but at the last tolerance.
            let tightest = 0.2 * self.fineness.tolerance;
            let loosest = if warm || !self.strips.is_free() { tightest } else { 0.03 };
            let limit = (0.1 * left).min(loosest).max(tightest);
            self.gradients(limit);
            let deepest = self.work.given.iter().fold(0.0_f64, |most, given| most.max(*given));
            left = self.adjust(step == 1) / deepest.max(f64::MIN_POSITIVE);
            shift = 0.0;
            if let Some(force) = wanted {
                let (carried, own) = self.totals();
                let stiffness = match known.filter(|(_, at)| *at != penetration) {
                    Some((before, at)) => {
                        ((carried - before) / (penetration - at)).clamp(0.5 * own, stiffest * own)
                    }
                    None => own,
                };
                known = Some((carried, penetration));
                left = left.max((carried / force - 1.0).abs());
                if left > self.fineness.tolerance {
                    shift = (force - carried) / stiffness.max(f64::MIN_POSITIVE);
                    shift = shift.clamp(-0.5 * deepest, 0.5 * deepest + 1e-6);
                    penetration += shift;
                    for j in 0..self.along.len() {
                        if self.work.active[j] {
                            self.work.effective[j] += shift;
                        }
                    }
                }
            }
            if left <= self.fineness.tolerance && limit <= self.fineness.tolerance {
                return Ok((penetration, left, step));
            }
        }
        Ok((penetration, left, step))
    }

    /// Force in units of the kernels, and what independent slices would add per penetration.
    fn totals(&self) -> (f64, f64) {
        let places = self.work.places;
        let (mut force, mut stiffness) = (0.0, 0.0);
        for j in 0..self.along.len() {
            if self.work.active[j] {
                force += PI * self.h * self.work.a[j * places.cosines];
                stiffness += PI * self.h * self.work.row(j)[places.punch(0)];
            }
        }
        (force, stiffness)
    }

    /// Widths, tables and blocks of all slices; `fresh` starts from the plane contacts.
    pub(super) fn prepare(&mut self, fresh: bool) -> Result<(), Invalid> {
        let work = &mut self.work;
        let (places, n) = (work.places, work.places.cosines);
        for j in 0..self.along.len() {
            if !work.active[j] || work.effective[j] <= 0.0 {
                work.active[j] = false;
                work.a[j * n..(j + 1) * n].fill(0.0);
                continue;
            }
            if !self.strips.reaches(work.effective[j]) {
                return Err(unreached());
            }
            let b = self.strips.half_width(work.effective[j]);
            let started = fresh || work.a[j * n] == 0.0;
            let row = &mut work.rows[j * places.len()..(j + 1) * places.len()];
            let transform = &mut work.transforms[j * work.transform..(j + 1) * work.transform];
            let block = &mut work.blocks[j * n * n..(j + 1) * n * n];
            if b != work.widths[j] || started {
                work.widths[j] = b;
                self.strips.row(b, row);
                self.coupling.transform(b, transform);
                for k in 0..n {
                    for l in 0..=k {
                        block[k * n + l] = row[places.matrix(k, l)];
                    }
                }
                self.coupling.add_block(transform, block);
                if !factor(block, n) {
                    let what = "the slices' system is not positive".to_owned();
                    return Err(Invalid::new("penetration_mm", what, "press less"));
                }
            }
            if started {
                let rest = work.effective[j] - row[places.penetration()];
                for k in 0..n {
                    work.a[j * n + k] = row[places.contact(k)] + rest * row[places.punch(k)];
                }
            }
        }
        Ok(())
    }

    /// out = the exact layer's matrix times input, on the active slices.
    fn apply(&mut self, of_direction: bool) {
        let work = &mut self.work;
        let (places, n) = (work.places, work.places.cosines);
        let input = if of_direction { &work.direction } else { &work.a };
        work.image.fill(0.0);
        self.coupling.act(&work.transforms, input, &mut work.image);
        for j in 0..work.active.len() {
            let out = &mut work.image[j * n..(j + 1) * n];
            if !work.active[j] {
                out.fill(0.0);
                continue;
            }
            let row = &work.rows[j * places.len()..(j + 1) * places.len()];
            let own = &input[j * n..(j + 1) * n];
            for k in 0..n {
                out[k] += row[places.matrix(k, k)] * own[k];
                for l in 0..k {
                    let entry = row[places.matrix(k, l)];
                    out[k] += entry * own[l];
                    out[l] += entry * own[k];
                }
            }
        }
    }

    /// Preconditioned conjugate gradients for the pressure at the present widths.
    pub(super) fn gradients(&mut self, tolerance: f64) {
        let (places, n) = (self.work.places, self.work.places.cosines);
        self.apply(false);
        let work = &mut self.work;
        let mut size = 0.0;
        for j in 0..work.active.len() {
            let span = j * n..(j + 1) * n;
            if !work.active[j] {
                work.residual[span].fill(0.0);
                continue;
            }
            let row = &work.rows[j * places.len()..(j + 1) * places.len()];
            for k in 0..n {
                let given = if k == 0 { PI * work.given[j] } else { 0.0 };
                work.residual[j * n + k] = given - row[places.shape(k)] - work.image[j * n + k];
            }
            size += (PI * work.given[j]) * work.a[j * n];
        }
        let limit = (tolerance * tolerance * size).abs();
        let mut before = self.cure();
        self.work.direction.copy_from_slice(&self.work.cured);
        for _ in 0..GRADIENTS_MAX {
            if before <= limit {
                return;
            }
            self.apply(true);
            let work = &mut self.work;
            let curvature: f64 = work.direction.iter().zip(&work.image).map(|(a, b)| a * b).sum();
            if curvature.is_nan() || curvature <= 0.0 {
                return;
            }
            let length = before / curvature;
            for (a, d) in work.a.iter_mut().zip(&work.direction) {
                *a += length * d;
            }
            for (r, i) in work.residual.iter_mut().zip(&work.image) {
                *r -= length * i;
            }
            let after = self.cure();
            let factor = after / before;
            let work = &mut self.work;
            for (d, z) in work.direction.iter_mut().zip(&work.cured) {
                *d = z + factor * *d;
            }
            before = after;
        }
    }

    /// Solves each slice alone for the residual; the residual's size in that norm.
    fn cure(&mut self) -> f64 {
        let work = &mut self.work;
        let n = work.places.cosines;
        work.cured.copy_from_slice(&work.residual);
        for j in 0..work.active.len() {
            if work.active[j] {
                let block = &work.blocks[j * n * n..(j + 1) * n * n];
                solve(block, n, &mut work.cured[j * n..(j + 1) * n]);
            }
        }
        work.cured.iter().zip(&work.residual).map(|(a, b)| a * b).sum()
    }

    /// New penetrations of the slices' widths from what the pressure leaves at their edges; the
    /// largest change.
    fn adjust(&mut self, first: bool) -> f64 {
        let slices = self.along.len();
        let free = self.strips.is_free();
        let work = &mut self.work;
        let (places, n) = (work.places, work.places.cosines);
        let mut largest: f64 = 0.0;
        let mut opened = false;
        work.moves.swap(0, 1);
        for j in 0..slices {
            work.moves[0][j] = 0.0;
            if !work.active[j] {
                opened = true;
                continue;
            }
            let row = &work.rows[j * places.len()..(j + 1) * places.len()];
            let own = &work.a[j * n..(j + 1) * n];
            let edge: f64 = own.iter().sum();
            let new =
                if free { row[places.penetration()] + edge / row[places.edge()] } else { own[0] };
            work.moves[0][j] = new - work.effective[j];
            work.cured[j] = new;
        }
        let part = if free { work.relaxation(first) } else { 1.0 };
        for j in 0..slices {
            if !work.active[j] {
                continue;
            }
            let change = work.moves[0][j];
            let whole = work.cured[j];
            let new = if part == 1.0 { whole } else { work.effective[j] + part * change };
            if free || new <= 0.0 {
                largest = largest.max(change.abs());
            }
            work.effective[j] = new;
            if new <= 0.0 {
                work.active[j] = false;
            }
        }
        if opened {
            // The layer's shape under lifted slices; those that it reaches come back.
            self.coupling.act(&self.work.transforms, &self.work.a, &mut self.work.image);
            for j in 0..slices {
                let work = &mut self.work;
                if !work.active[j] && work.a[j * n] == 0.0 {
                    let gap = work.given[j] - self.coupling.middle(j, slices);
                    if gap > 0.0 {
                        work.active[j] = true;
                        work.effective[j] = gap;
                        largest = largest.max(gap);
                    }
                }
            }
        }
        largest
    }
}

/// What is left is no contact.
fn unsettled(residual: f64) -> Invalid {
    let what = format!("its contact does not settle: {residual:.1e} of the penetration is left");
    Invalid::new("length_mm", what, "take a finer level, or a pin longer than the layer is thick")
}

fn unreached() -> Invalid {
    let what = super::super::BEYOND_TABLE.to_owned();
    Invalid::new("force_n", what, "press less, or tabulate a larger penetration")
}
