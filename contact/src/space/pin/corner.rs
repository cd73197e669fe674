//! Contacts of a cylinder on its end without a search for their widths. What such a contact looks
//! like follows from two numbers, the depth of the end and the slope, as long as the other end is
//! in the air. Contacts over both are solved when tables are made: how far they reach, the
//! penetration that each place's width belongs to, the force. Pressing reads the widths from them
//! and solves the pressure once, exactly; force and image are of second order in what the widths
//! are off. It remembers nothing.
//!
//! Finer slices read the widths of coarser ones.
//!
//! It refuses what lies outside its contacts, and contacts of which slices are pulled: those are
//! left to the search (`solve`).

use super::PinState;
use super::row::{Row, holding};
use super::rows::KEPT;

/// Overlaps that are tabulated (thicknesses): up to this part of a row no longer than this, each so
/// many times as long as the next one, down to the shortest.
const LONGEST: f64 = 6.0;
const OVERLAP: f64 = 0.85;
const SHORTEST: f64 = 0.0025;
const LONGER: f64 = core::f64::consts::SQRT_2;
/// Slopes that are tabulated: the steepest that may be asked for, and each so many times the next.
const STEEPEST: f64 = 0.2035;
const STEEPER: f64 = 1.6;
/// Depths of tabulated contacts in parts of the deepest asked for.
const DEPTHS: [f64; 2] = [0.001, 1.6];
/// Places of a profile, from the end to where the contact ends.
const PLACES: usize = 13;
/// Fewest slices of a contact, most that may be left of it, and rows tried for it.
const FEWEST: usize = 4;
const LEFT: f64 = 1e-2;
const ROWS: usize = 4;
/// Slices whose width belongs to less than this part of the depth do not count, and those that are
/// pulled are let go so many times.
const TIP: f64 = 0.02;
const LIFTS: usize = 4;
/// So many times widths that were read are taken a part of the way to what they should be, each at
/// most to these parts of its penetration and this part of the largest more.
const TOUCHES: usize = 8;
/// From so many on, what the level settles for is enough: ends may swing about it.
const PATIENT: usize = 3;
const PART: f64 = 0.5;
const TOUCH: [f64; 2] = [0.3, 2.0];
const WIDER: f64 = 0.05;
/// Part of the depth by which the pressure may miss a force at the depth that was read; the widths
/// are read again for more, so many times.
const MISS: f64 = 0.02;
const READINGS: usize = 3;

/// A solved contact: everything over its depth or its overlap.
#[derive(Clone, Copy, Debug)]
struct Solved {
    /// Logarithm of the force in units of the kernels.
    force: f64,
    /// Where it ends, over the overlap.
    reach: f64,
    /// Penetration that the width belongs to, over the depth, from the end to the reach.
    profile: [f64; PLACES],
}

/// Contacts on an end, by overlap and slope.
#[derive(Clone, Debug)]
pub(super) struct Corner {
    /// The longest overlap.
    longest: f64,
    slopes: usize,
    /// Slope after slope from the steepest, overlap after overlap from the longest.
    solved: Vec<Option<Solved>>,
}

/// Widths to press with: profile over the distance from the end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Widths {
    /// Where the contact ends, thicknesses from the end.
    pub(super) reach: f64,
    depth: f64,
    profile: [f64; PLACES],
}

impl Widths {
    /// Penetration that the width at a distance from the end belongs to; 0 where nothing touches.
    fn at(&self, distance: f64) -> f64 {
        let place = distance / self.reach * (PLACES - 1) as f64;
        if place.is_nan() || place >= (PLACES - 1) as f64 {
            return 0.0;
        }
        let cell = place as usize;
        let part = place - cell as f64;
        self.depth * (self.profile[cell] * (1.0 - part) + self.profile[cell + 1] * part)
    }
}

impl Corner {
    /// Solves the contacts of rows that end at `to`, the whole pin first and each shorter than the
    /// one before; absent when none is short enough.
    pub(super) fn new(rows: &mut [Row], to: f64, deepest: f64) -> Option<Self> {
        let longest = OVERLAP * rows[1..].iter().map(|row| row.length).find(|l| *l <= LONGEST)?;
        let count = |from: f64, to: f64, step: f64| {
            libm::ceil(libm::log(from / to) / libm::log(step)).max(1.0) as usize + 1
        };
        let [least, most] = DEPTHS.map(|part| part * deepest);
        let overlaps = count(longest, SHORTEST, LONGER);
        let slopes = count(STEEPEST, least / longest, STEEPER);
        let mut solved = Vec::with_capacity(overlaps * slopes);
        for r in 0..overlaps {
            let overlap = longest * libm::pow(LONGER, -(r as f64));
            for q in 0..slopes {
                let slope = STEEPEST * libm::pow(STEEPER, -(q as f64));
                let fits = (least..=most).contains(&(overlap * slope));
                // As flat as the one before, and as deep in parts of its overlap.
                let near = r.checked_sub(1).and_then(|r| solved[r * slopes + q]);
                let mut solve = || Solved::of(rows, (overlap, slope), to, near);
                solved.push(if fits { solve() } else { None });
            }
        }
        rows.iter_mut().for_each(Row::release);
        Some(Self { longest, slopes, solved })
    }

    /// The longest overlap.
    pub(super) fn longest(&self) -> f64 {
        self.longest
    }

    /// The cell that a number lies in, counted from the largest, and the part of the way to the
    /// next one; absent outside.
    fn cell(value: f64, (largest, step): (f64, f64), count: usize) -> Option<(usize, f64)> {
        let place = libm::log(largest / value) / libm::log(step);
        let inside = place >= 0.0 && place <= (count - 1) as f64 && count > 1;
        let cell = (place as usize).min(count.saturating_sub(2));
        inside.then_some((cell, place - cell as f64))
    }

    /// The widths of a contact of a depth under a slope.
    pub(super) fn widths(&self, depth: f64, slope: f64) -> Option<Widths> {
        let (overlap, overlaps) = (depth / slope, self.solved.len() / self.slopes);
        let (r, across) = Self::cell(overlap, (self.longest, LONGER), overlaps)?;
        let (q, flatter) = Self::cell(slope, (STEEPEST, STEEPER), self.slopes)?;
        let mut found = Widths { reach: 0.0, depth, profile: [0.0; PLACES] };
        for (r, across) in [(r, 1.0 - across), (r + 1, across)] {
            for (q, along) in [(q, 1.0 - flatter), (q + 1, flatter)] {
                let solved = self.solved[r * self.slopes + q].as_ref()?;
                let weight = across * along;
                found.reach += weight * solved.reach * overlap;
                let places = found.profile.iter_mut().zip(&solved.profile);
                places.for_each(|(sum, value)| *sum += weight * value);
            }
        }
        Some(found)
    }

    /// The widths that a search begins with, by a force or a guessed depth.
    pub(super) fn begin(&self, (wanted, guess): (Option<f64>, f64), slope: f64) -> Option<Widths> {
        let depth = wanted.map_or(Some(guess), |force| self.depth_of(force, slope))?;
        self.widths(depth, slope)
    }

    /// The depth under a slope at which the contact carries a force in units of the kernels.
    pub(super) fn depth_of(&self, force: f64, slope: f64) -> Option<f64> {
        let (q, flatter) = Self::cell(slope, (STEEPEST, STEEPER), self.slopes)?;
        let wanted = libm::log(force);
        let mut above: Option<f64> = None;
        for (r, contacts) in self.solved.chunks_exact(self.slopes).enumerate() {
            let both = contacts[q].as_ref().zip(contacts[q + 1].as_ref());
            let carried = both.map(|(a, b)| a.force * (1.0 - flatter) + b.force * flatter);
            if let Some((above, below)) = above.zip(carried)
                && above >= wanted
                && wanted >= below
            {
                let part = if above > below { (above - wanted) / (above - below) } else { 0.0 };
                let shorter = (r - 1) as f64 + part;
                return Some(slope * self.longest * libm::pow(LONGER, -shorter));
            }
            above = carried;
        }
        None
    }
}

impl Solved {
    /// The contact of the end at `to`, found by the search on a row that suits it; one nearby tells
    /// which, and the widths to begin with.
    fn of(
        rows: &mut [Row],
        (overlap, slope): (f64, f64),
        to: f64,
        near: Option<Self>,
    ) -> Option<Self> {
        let near = near.map(|near: Self| Widths {
            reach: near.reach * overlap,
            depth: overlap * slope,
            profile: near.profile,
        });
        let touched = near.map_or(overlap, |near| near.reach);
        let mut at = holding(rows, touched).max(1);
        let mut found = None;
        for _ in 0..ROWS {
            rows[at].release();
            let solved = Self::on(&mut rows[at], (overlap, slope), to, near.as_ref());
            let Some(solved) = solved else {
                if found.is_some() || at == 1 {
                    break;
                }
                at -= 1;
                continue;
            };
            let touched = solved.reach * overlap;
            found = Some(solved);
            let shorter = holding(rows, touched);
            if touched >= KEPT * rows[at].length || shorter <= at {
                break;
            }
            at = shorter;
        }
        found
    }

    fn on(
        row: &mut Row,
        (overlap, slope): (f64, f64),
        to: f64,
        near: Option<&Widths>,
    ) -> Option<Self> {
        let depth = slope * overlap;
        if let Some(near) = near {
            row.begin(near, to, slope);
        }
        let state = match row.press((None, depth - slope * to), slope) {
            Err(_) if near.is_some() => {
                row.release();
                row.press((None, depth - slope * to), slope)
            }
            outcome => outcome,
        };
        let state = state.ok()?;
        let touching: Vec<[f64; 2]> = (0..row.along.len())
            .rev()
            .filter(|j| row.work.touches(*j))
            .map(|j| [to - row.along[j], row.work.effective[j] / depth])
            .collect();
        let whole = row.work.touches(0) || touching.len() < FEWEST;
        if whole || state.residual > LEFT || state.force_n <= 0.0 {
            return None;
        }
        // It ends where the penetrations of the last slices lead to nothing.
        let [.., before, last] = touching[..] else { return None };
        let fall = (before[1] - last[1]) / (last[0] - before[0]);
        let reach = last[0] + (last[1] / fall.max(f64::MIN_POSITIVE)).clamp(0.3 * row.h, row.h);
        let mut profile = [0.0; PLACES];
        for (p, value) in profile[..PLACES - 1].iter_mut().enumerate() {
            let distance = reach * p as f64 / (PLACES - 1) as f64;
            let after = touching.iter().position(|[x, _]| *x > distance);
            let (a, b) = match after.unwrap_or(touching.len()) {
                0 => (touching[0], touching[1]),
                n if n == touching.len() => (touching[n - 1], [reach, 0.0]),
                n => (touching[n - 1], touching[n]),
            };
            *value = (a[1] + (b[1] - a[1]) * (distance - a[0]) / (b[0] - a[0])).max(0.0);
        }
        let t = row.layer.thickness_mm;
        let force = libm::log(state.force_n / (row.modulus_mpa() * t * t));
        Some(Self { force, reach: reach / overlap, profile })
    }
}

impl Row {
    /// Lets go of slices that are pulled; whether there were some.
    fn lift(&mut self) -> bool {
        let (work, mut lifted) = (&mut self.work, false);
        for j in 0..work.active.len() {
            if work.active[j] && work.a[j * work.places.cosines] <= 0.0 {
                work.active[j] = false;
                lifted = true;
            }
        }
        lifted
    }

    /// Takes widths that were read to what they should be, as far as the level asks for, at a force
    /// or at the penetration given; what the penetration changed by, absent when they do not get
    /// there.
    fn touched_up(&mut self, mut solved: (f64, f64), wanted: Option<f64>) -> Option<f64> {
        let mut sunk = 0.0;
        self.work.mixed.restart();
        for touch in 0..=TOUCHES {
            if let Some(force) = wanted {
                let [over, _] = self.left_over_force();
                let part = (force - over - solved.0) / solved.1;
                self.sink(part);
                sunk += part;
            }
            let left = self.left_at_edges();
            let [wanted_left, settled] = [self.fineness.read, self.fineness.settled];
            if left <= if touch < PATIENT { wanted_left } else { settled } {
                return Some(sunk);
            }
            if touch == TOUCHES {
                return None;
            }
            self.touch();
            let room = self.work.dense.room;
            solved = self.prepare(false).ok().and_then(|()| self.direct(room))?;
        }
        None
    }

    /// Moves all widths that touch by what is left at their edges and by what that did before.
    fn touch(&mut self) {
        let largest = self.largest();
        let mut mixed = core::mem::take(&mut self.work.mixed);
        for j in (0..self.along.len()).filter(|j| self.work.active[*j]) {
            mixed.add(self.work.effective[j], self.change(j));
        }
        mixed.mix(PART);
        let active = (0..self.along.len()).filter(|j| self.work.active[*j]);
        for (j, change) in active.zip(&mixed.step) {
            let own = &mut self.work.effective[j];
            *own = (*own + change).clamp(TOUCH[0] * *own, TOUCH[1] * *own + WIDER * largest);
        }
        self.work.mixed = mixed;
    }

    /// Whether its tables are wide enough.
    fn bears(&self, widths: &Widths) -> bool {
        let most = widths.depth * widths.profile.iter().fold(0.0_f64, |most, part| most.max(*part));
        self.strips.reaches(most) && self.strips.half_width(most) <= self.widest
    }

    /// Begins a search on the end at `to` from widths that are read; the penetration at the origin,
    /// absent when it does not touch.
    pub(super) fn begin(&mut self, widths: &Widths, to: f64, slope: f64) -> Option<f64> {
        self.release();
        let depth = widths.depth;
        for (j, v) in self.along.iter().enumerate() {
            let work = &mut self.work;
            work.given[j] = depth - slope * (to - v);
            work.effective[j] = widths.at(to - v);
            work.active[j] = work.effective[j] > TIP * depth;
        }
        let begun = self.work.active.contains(&true) && self.prepare(true).is_ok();
        (self.work.warm, self.work.begun) = (begun, begun);
        begun.then_some(depth - slope * to)
    }

    /// The contact of the end at `to` under a slope, at widths that are read, by force or depth;
    /// the state, not there where widths of another depth have to be read, and the depth found.
    /// Absent when it is another contact than that.
    pub(super) fn press_with(
        &mut self,
        widths: &Widths,
        (wanted, to): (Option<f64>, f64),
        slope: f64,
    ) -> Option<(Option<PinState>, f64)> {
        let mut depth = widths.depth;
        for (j, v) in self.along.iter().enumerate() {
            let work = &mut self.work;
            work.given[j] = depth - slope * (to - v);
            work.effective[j] = widths.at(to - v);
            work.active[j] = work.effective[j] > TIP * depth;
        }
        let room = self.work.dense.room;
        let mut solved = self.prepare(false).ok().and_then(|()| self.direct(room));
        for lift in 1..=LIFTS {
            if solved.is_none() || !self.lift() {
                break;
            }
            solved = if lift == LIFTS {
                None
            } else {
                self.shortened()
                    .or_else(|| self.prepare(false).ok().and_then(|()| self.direct(room)))
            };
        }
        let missed = |(carried, rate): (f64, f64)| wanted.map(|force| (force - carried) / rate);
        if let Some(part) = solved.and_then(missed).filter(|part| part.abs() > MISS * depth) {
            // Other widths belong to that depth.
            self.work.clear();
            return Some((None, depth + part));
        }
        let Some(sunk) = solved.and_then(|solved| self.touched_up(solved, wanted)) else {
            self.work.clear();
            return None;
        };
        depth += sunk;
        if self.work.active[0] || !(depth > 0.0 && depth < 1.0) {
            self.work.clear();
            return None;
        }
        let left = self.left_at_edges();
        Some((Some(self.told(depth - slope * to, left, 1)), depth))
    }
}

/// Presses by what is read; the row used and its state.
pub(super) fn read(
    corner: &Corner,
    rows: &mut [Row],
    (wanted, guess): (Option<f64>, f64),
    (slope, to): (f64, f64),
) -> Option<(usize, PinState)> {
    let mut depth = match wanted {
        Some(force) => corner.depth_of(force, slope)?,
        None => guess,
    };
    for _ in 0..READINGS {
        let widths = corner.widths(depth, slope)?;
        let mut at = holding(rows, widths.reach).max(1);
        while at > 1 && !rows[at].bears(&widths) {
            at -= 1;
        }
        let (state, found) = rows[at].press_with(&widths, (wanted, to), slope)?;
        if let Some(state) = state {
            return Some((at, state));
        }
        depth = found;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::super::super::super::layer::Layer;
    use super::super::super::Drive;
    use super::super::{Pin, Profile};
    use crate::Accuracy;

    /// The same slices with widths found by free-boundary steps; and nothing is remembered. How
    /// many contacts were read.
    fn compare((nu, radius_mm): (f64, f64), level: Accuracy, poses: &[(f64, f64)]) -> usize {
        let layer = Layer::new(0.8, 27.58, nu).expect("a sound layer");
        let profile = Profile::Cylinder { radius_mm };
        let mut tabled = Pin::new(&layer, profile, [-8.0, 8.0], 0.2, level).expect("a pin");
        let mut searched = tabled.clone();
        assert!(searched.corner.take().is_some());
        let mut read = 0;
        for (depth_mm, tilt_rad) in poses {
            let delta = depth_mm - 8.0 * libm::tan(*tilt_rad).abs();
            let deep = Drive::PenetrationMm(delta);
            searched.release();
            let a = tabled.press(deep, *tilt_rad).expect("a contact");
            let b = searched.press(deep, *tilt_rad).expect("a contact");
            let off = (a.force_n / b.force_n - 1.0).abs();
            assert!(off < 5e-3 && a.force_n > 0.0, "{nu} {depth_mm}: {a:?} {b:?}");
            let arm = (a.moment_n_mm / a.force_n - b.moment_n_mm / b.force_n).abs();
            assert!(arm < 0.005, "{nu} {depth_mm}: {a:?} {b:?}");
            let loaded = Drive::ForceN(a.force_n);
            let again = tabled.press(loaded, *tilt_rad).expect("a contact");
            assert!((again.penetration_mm - delta).abs() < 4e-3 * depth_mm, "{a:?} {again:?}");
            tabled.press(Drive::ForceN(5.0), 0.001).expect("another contact");
            assert_eq!(tabled.press(deep, *tilt_rad).expect("a contact"), a);
            read += usize::from(a.steps == 1);
        }
        read
    }

    #[test]
    fn what_is_read_is_what_a_search_finds() {
        let poses = [(0.06, 0.19), (0.02, -0.11), (0.1, 0.05), (0.03, 0.02), (0.05, -0.016)];
        for pin in [(0.5, 4.0), (0.49, 23.0), (0.0, 40.0)] {
            assert_eq!(compare(pin, Accuracy::Fast, &poses), 5, "{pin:?}");
        }
    }

    /// Widths of the coarse slices, pressure of the fine ones.
    #[test]
    fn the_default_level_reads_them_too() {
        let poses = [(0.06, 0.19), (0.02, -0.11)];
        assert_eq!(compare((0.49, 23.0), Accuracy::Default, &poses), 2);
    }
}
