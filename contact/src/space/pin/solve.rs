//! The contact of a pin: free-boundary steps around the pressures of the coupled slices, which
//! `gradients` and `direct` find.

use super::PinState;
use super::edge::edge;
use super::row::{FITS, Row};
use super::work::Trouble;
use core::f64::consts::PI;

/// Tolerance of the gradients over the level's, and weight of the force's error.
const TIGHTEST: f64 = 0.1;
const FORCE: f64 = 2.0;
/// A change of the penetration (in depths) tells the force's rate if it is more than this part of
/// what is left at the edges.
const NOISE: f64 = 0.3;
/// Steps after which a contact that fills a part of the pin is given up for a longer part.
const FULL: usize = 4;
/// A penetration that turned back more often than this changes by half.
const SWINGS: usize = 8;
/// Steps that each width takes by itself before all are settled together, where they can be.
const ALONE: usize = 6;
/// So many times the level's steps, for a contact of which more than that is left.
const MORE: usize = 4;

/// Where a contact's steps have come to.
#[derive(Default)]
struct Search {
    wanted: Option<f64>,
    penetration: f64,
    /// Change of the penetration that the next step begins with, and how often it turned back.
    shift: f64,
    swings: usize,
    shifted: f64,
    /// Force of the step before, and its penetration.
    known: Option<(f64, f64)>,
    left: f64,
}

impl Search {
    /// A change of the penetration, half of it where the changes turn back and forth.
    fn turned(&mut self, shift: f64) -> f64 {
        self.swings += usize::from(shift * self.shifted < 0.0);
        self.shifted = if self.swings > SWINGS { 0.5 * shift } else { shift };
        self.shifted
    }
}

impl Row {
    /// Presses to a force in units of the kernels or, without one, to a penetration at the origin;
    /// with a force the penetration is a guess.
    pub(super) fn press(
        &mut self,
        (wanted, penetration): (Option<f64>, f64),
        slope: f64,
    ) -> Result<PinState, Trouble> {
        let (penetration, residual, steps) = self.carried(wanted, penetration, slope)?;
        if residual.is_nan() || residual > self.fineness.settled {
            return Err(Trouble::Unsettled(residual));
        }
        // By penetration this was refused before.
        if wanted.is_some() && self.work.given.iter().any(|given| *given >= 1.0) {
            return Err(Trouble::Beyond);
        }
        Ok(self.told(penetration, residual, steps))
    }

    /// The contact as it stands.
    pub(super) fn told(&mut self, penetration: f64, residual: f64, steps: usize) -> PinState {
        let (t, n) = (self.layer.thickness_mm, self.work.places.cosines);
        let scale = self.modulus_mpa() * t * t;
        let penetration_mm = penetration * t;
        let mut state = PinState { penetration_mm, residual, steps, ..PinState::default() };
        for (j, v) in self.along.iter().enumerate() {
            if self.work.active[j] {
                let force = PI * self.work.a[j * n] * self.h * scale;
                state.force_n += force;
                state.moment_n_mm += force * v * t;
                state.half_width_mm = state.half_width_mm.max(self.work.widths[j] * t);
                state.length_mm += self.h * t;
            }
        }
        let [force, moment] = self.left_over_force();
        state.force_n += force * scale;
        state.moment_n_mm += moment * scale * t;
        self.work.warm = state.force_n > 0.0;
        state
    }

    /// The contact by free-boundary steps, from the one before if it leads there.
    pub(super) fn search(
        &mut self,
        wanted: Option<f64>,
        penetration: f64,
        slope: f64,
    ) -> Result<(f64, f64, usize), Trouble> {
        let warm = self.work.warm;
        let known = warm && wanted.is_some();
        let start = if known { self.turned_about_its_load(slope) } else { penetration };
        let mut outcome = self.iterate(start, slope, wanted);
        let settled =
            outcome.as_ref().is_ok_and(|(_, residual, _)| *residual <= self.fineness.settled);
        if warm && !self.work.begun && !settled && !self.is_full() {
            // The contact before is too far from this one to begin with.
            self.work.clear();
            outcome = self.iterate(penetration, slope, wanted);
        }
        outcome
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
            // What was lifted stays so until it is reached.
            work.effective[j] = match (work.warm, work.active[j]) {
                (true, true) => work.effective[j] + given - work.given[j],
                (true, false) => 0.0,
                (false, _) => given,
            };
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
    ) -> Result<(f64, f64, usize), Trouble> {
        let warm = self.work.warm;
        if self.place(start, slope) <= 0.0 && wanted.is_none() {
            self.work.clear();
            return Ok((start, 0.0, 0));
        }
        let mut search =
            Search { penetration: start, left: f64::INFINITY, wanted, ..Search::default() };
        let (mut fresh, mut step, mut asked) = (!warm, 0, false);
        self.work.let_back();
        // A contact that is no answer yet gets more steps.
        let steps = self.fineness.steps;
        while step < steps || (search.left > self.fineness.settled && step < MORE * steps) {
            step += 1;
            if step > FULL && self.is_full() {
                return Err(Trouble::Filled(search.penetration));
            }
            for given in &mut self.work.given {
                *given += search.shift;
            }
            self.prepare(fresh)?;
            fresh = false;
            self.work.shifted = core::mem::take(&mut search.shift).abs();
            let swings = self.work.relaxed != 0.0 && step > ALONE;
            if (self.work.begun || swings)
                && let Some(found) = self.settle_all(wanted)?
            {
                search.penetration += found.sunk;
                search.left = found.left;
                step += found.steps - 1;
                break;
            }
            match self.direct(self.work.dense.most) {
                Some(carried) => self.exactly(&mut search, carried, step == 1),
                None => self.loosely(&mut search, warm, step == 1)?,
            }
            if wanted.is_some() && !warm && step > 1 && self.leaves(search.penetration / slope) {
                return Err(Trouble::Filled(search.penetration));
            }
            if search.left <= self.fineness.tolerance {
                // Slices may have been let go of at another penetration.
                if !core::mem::replace(&mut asked, true) && self.work.let_back() {
                    search.left = f64::INFINITY;
                    continue;
                }
                break;
            }
        }
        self.unshift(&mut search);
        Ok((search.penetration, search.left, step))
    }

    /// Takes back what no further step was pressed by.
    fn unshift(&mut self, search: &mut Search) {
        search.penetration -= search.shift;
        let slices = self.work.effective.iter_mut().zip(&self.work.active);
        slices.filter(|(_, active)| **active).for_each(|(own, _)| *own -= search.shift);
        search.shift = 0.0;
    }

    /// One step from a pressure without error, of which the force is known, and its rate.
    fn exactly(&mut self, search: &mut Search, (carried, rate): (f64, f64), first: bool) {
        let deepest = self.work.deepest();
        let mut off: f64 = 0.0;
        if let Some(force) = search.wanted {
            let [over, _] = self.left_over_force();
            let whole = (force - over - carried) / rate;
            let part = search.turned(whole.clamp(-0.5 * deepest, 0.5 * deepest + 1e-6));
            self.sink(part);
            search.penetration += part;
            off = (whole - part).abs();
        }
        let change = self.adjust(first);
        search.left = (change / self.largest()).max(off / deepest.max(f64::MIN_POSITIVE));
    }

    /// A step by gradients, loose while the widths are wrong, accepted at the last tolerance only.
    fn loosely(&mut self, search: &mut Search, warm: bool, first: bool) -> Result<(), Trouble> {
        let tolerance = self.fineness.tolerance;
        let tightest = TIGHTEST * tolerance;
        let loosest = if warm || !self.strips.is_free() { tightest } else { 0.03 };
        let limit = (0.1 * search.left).min(loosest).max(tightest);
        let deepest = self.work.deepest();
        let unsolved = self.gradients(limit)?;
        search.left = (self.adjust(first) / self.largest()).max(unsolved);
        if let Some(force) = search.wanted {
            let (carried, own) = self.totals();
            let rate = own * self.stiffness(search, (carried, own), deepest);
            let carried = carried + self.left_over_force()[0];
            search.left = search.left.max(FORCE * (carried / force - 1.0).abs());
            if search.left > tolerance {
                let shift = (force - carried) / rate.max(f64::MIN_POSITIVE);
                let shift = search.turned(shift.clamp(-0.5 * deepest, 0.5 * deepest + 1e-6));
                search.shift = shift;
                search.penetration += shift;
                self.foresee(shift);
            }
        }
        if limit > tolerance {
            search.left = search.left.max(limit);
        }
        Ok(())
    }

    /// Rate of the force over that of independent slices, from the last two steps where they tell
    /// it: widths that are not found yet change the force, too, and on a short row as much as the
    /// penetration does.
    fn stiffness(&mut self, search: &mut Search, (carried, own): (f64, f64), deepest: f64) -> f64 {
        let at = search.penetration;
        let least = match (self.strips.is_free(), self.work.relaxed == 0.0) {
            (false, _) => 0.0,
            (true, true) => NOISE * search.left * deepest,
            (true, false) => f64::INFINITY,
        };
        let before = search.known.replace((carried, at));
        let tells = |(_, other): &(f64, f64)| own > 0.0 && (at - other).abs() > least;
        if let Some((force, other)) = before.filter(tells) {
            let stiffest = if self.work.relaxed == 0.0 { 2.0 } else { 8.0 };
            self.work.stiffness = ((carried - force) / (at - other) / own).clamp(0.5, stiffest);
        } else if self.work.stiffness <= 0.0 {
            self.work.stiffness = 1.0;
        }
        self.work.stiffness
    }

    /// Widths and pressures after a change of the penetration, each free slice's as the plane one's
    /// at the rate of the whole.
    fn foresee(&mut self, shift: f64) {
        let work = &mut self.work;
        let (places, n) = (work.places, work.places.cosines);
        let rise = if self.strips.is_free() { shift * work.stiffness } else { 0.0 };
        for j in (0..self.along.len()).filter(|j| work.active[*j]) {
            work.effective[j] += shift;
            let punch = j * places.len() + places.punch(0);
            let own = work.a[j * n..(j + 1) * n].iter_mut();
            own.zip(&work.rows[punch..punch + n]).for_each(|(a, punch)| *a += rise * punch);
        }
    }

    /// What changes are measured by: the largest penetration that a slice is given or that its
    /// width belongs to.
    pub(super) fn largest(&self) -> f64 {
        let given = self.work.deepest().max(f64::MIN_POSITIVE);
        if !self.strips.is_free() {
            return given;
        }
        let slices = self.work.effective.iter().zip(&self.work.active);
        slices.filter(|(_, active)| **active).fold(given, |most, (own, _)| most.max(*own))
    }

    /// Whether a contact that the rigid pin enters so far from the origin leaves the row for a
    /// longer one. On a short row the penetration is not known until the widths are.
    fn leaves(&self, from: f64) -> bool {
        self.part && self.work.relaxed == 0.0 && from + self.ends[1] > FITS * self.length
    }

    /// Whether the contact fills a row that is not the whole pin.
    fn is_full(&self) -> bool {
        self.part && self.work.active[0]
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
    pub(super) fn prepare(&mut self, fresh: bool) -> Result<(), Trouble> {
        let work = &mut self.work;
        let (places, n) = (work.places, work.places.cosines);
        for j in 0..self.along.len() {
            if !work.active[j] || work.effective[j] <= 0.0 {
                work.active[j] = false;
                work.a[j * n..(j + 1) * n].fill(0.0);
                continue;
            }
            let b = self.strips.half_width(work.effective[j]);
            if !self.strips.reaches(work.effective[j]) || b > self.widest {
                return Err(Trouble::Beyond);
            }
            let started = fresh || work.a[j * n] == 0.0;
            let row = &mut work.rows[j * places.len()..(j + 1) * places.len()];
            let transform = &mut work.transforms[j * work.transform..(j + 1) * work.transform];
            if b != work.widths[j] || started || work.read {
                work.widths[j] = b;
                self.strips.row(b, row);
                self.coupling.transform(b, transform);
            }
            if started {
                let rest = work.effective[j] - row[places.penetration()];
                for k in 0..n {
                    work.a[j * n + k] = row[places.contact(k)] + rest * row[places.punch(k)];
                }
            }
        }
        work.read = false;
        Ok(())
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
            let new =
                if free { row[places.penetration()] + edge(places, row, own) } else { own[0] };
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
            let part = work.parts.get(j).copied().unwrap_or(part);
            let new = if part == 1.0 { whole } else { work.effective[j] + part * change };
            if free || new <= 0.0 {
                largest = largest.max(change.abs());
            }
            work.effective[j] = new;
            if new <= 0.0 {
                work.active[j] = false;
                work.dropped[j] = work.dropped[j].saturating_add(u8::from(!free));
            }
        }
        if opened { largest.max(self.wake()) } else { largest }
    }
}
