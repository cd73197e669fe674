//! What slices leave over at a sharp end of a pin. In the middle of a pin equal slices give the
//! pressure of a smooth contact without error; at an end, where it rises without bound, they miss
//! some of it, and stand it a little off its place, and wider: together up to 7e-3 of the peak of
//! an image right over the end, for slices half as long as the layer is thick. How much follows
//! from the end alone, so it is found when tables are made, from a short pin on slices of this
//! length and on much shorter ones, cosine by cosine: the moments of the difference along the
//! pin. The image gets them back. A cylinder's are taken at some depths of its end; a bar's go
//! with it. Where the pin leans, what is left over changes in proportion, which a second contact
//! of the short pin tells.
//!
//! It refuses nothing: an end whose short pin has no solution keeps what its slices say.

use super::super::super::kernel::SurfaceKernel;
use super::super::super::layer::Layer;
use super::ends::loss;
use super::fineness::{Fineness, Laid};
use super::row::Row;
use super::spread::{LONG as HALVED, stood};
use super::strip::{COSINES_MAX, Strips};
use super::work::Trouble;
use crate::numeric::interpolation::cubic;
use core::f64::consts::PI;

/// Half the length of the short pin, thicknesses.
const REACH: f64 = 5.0;
/// Slices longer than this (thicknesses) leave something over that an image shows.
const LONG: f64 = 0.12;
/// Length of the shorter slices (thicknesses), and fewest and most of them to one.
const SHORT: f64 = 0.1;
const SHORTER: [f64; 2] = [2.0, 4.0];
/// Depths that a cylinder's end is solved at, and each so many times the next one.
const DEPTHS: usize = 5;
const SHALLOWER: f64 = 2.0;
/// When the short pin's steps end.
const TOLERANCE: f64 = 1e-6;
const STEPS: usize = 60;
/// Loads that stand for it along the pin, so far apart (thicknesses) at most, so many of
/// them beyond the end.
const APART: f64 = 0.31;
/// Slices longer than this (thicknesses) have three loads each.
const LONGER: f64 = 0.4;
const BEYOND: usize = 2;
/// Up to the first distance (thicknesses) from the end all of a difference counts, beyond the
/// second none.
const COUNTED: [f64; 2] = [1.0, 4.2];

/// Part of an end's depth that a thickness of the short pin rises by where it leans, the number of
/// the depth at which it does, and the most of it that a contact is taken to lean by.
const LEANING: f64 = 0.1;
const LEANS: usize = 1;
const STEEPEST: f64 = 0.5;

/// Force of what is left over from which a force is searched for again, in tolerances.
const OVER: f64 = 0.5;

/// The leftover of an end at one depth.
#[derive(Clone, Debug)]
struct Solved {
    depth: f64,
    /// Half-width that the loads are over, in the last slice's.
    wider: f64,
    /// Cosines of each load: what has to be added, over the last slice's mean pressure.
    loads: Vec<f64>,
}

/// An end that touches.
#[derive(Clone, Copy, Debug)]
struct End {
    depth: f64,
    /// Part of the depth that a thickness inwards rises by.
    rise: f64,
    /// Mean pressure of the last slice.
    last: f64,
}

/// The leftover of an end, from the deepest to the shallowest.
#[derive(Clone, Debug)]
pub(super) struct Leftover {
    cosines: usize,
    /// Distance of the loads, thicknesses.
    apart: f64,
    solved: Vec<Solved>,
    /// What the loads change by where the pin rises by all of the depth in a thickness; so little
    /// that it is found at one depth.
    leaning: Vec<f64>,
}

impl Leftover {
    /// Of a row's slices, down from the deepest end; allocates.
    pub(super) fn new(
        (layer, kernel): (&Layer, &SurfaceKernel),
        (strips, deepest): (&Strips, f64),
        slices: &Row,
    ) -> Option<Self> {
        let (h, fineness) = (slices.h, slices.fineness);
        if h < LONG {
            return None;
        }
        let lost = loss(&layer.transfer(), kernel, h);
        let slices = libm::ceil(2.0 * REACH / h);
        let length = h * (slices - 2.0 * lost);
        let row = |slices: f64| {
            let laid = Laid { fewest: slices, slice: length, enough: slices, longest: length };
            let fineness = Fineness {
                whole: laid,
                tolerance: TOLERANCE,
                steps: STEPS,
                nested: None,
                ..fineness
            };
            Row::new((layer, kernel), (strips.clone(), true), [0.0, length], fineness).ok()
        };
        let [fewest, most] = SHORTER;
        let shorter = libm::ceil(h / SHORT).clamp(fewest, most);
        let (mut coarse, mut fine) = (row(slices)?, row(shorter * slices)?);
        let depths = if strips.is_free() { DEPTHS } else { 1 };
        let mut solved = Vec::with_capacity(depths);
        let (mut depth, mut leaning) = (deepest, None);
        for at in 0..depths {
            let level = Solved::of(&mut coarse, &mut fine, depth);
            if let Some(level) = level.as_ref().filter(|_| at == LEANS.min(depths - 1)) {
                leaning = level.leaning(&mut coarse, &mut fine);
            }
            solved.extend(level);
            depth /= SHALLOWER;
        }
        let loads = solved.first()?.loads.len();
        Some(Self {
            cosines: strips.places.cosines,
            apart: apart(coarse.h),
            leaning: leaning.unwrap_or_else(|| vec![0.0; loads]),
            solved,
        })
    }

    /// Calls with the cosines (times thickness), the half-width over the last slice's and the place
    /// inwards from the end of what is to be added at an end.
    fn at(&self, end: End, mut of: impl FnMut(&[f64], (f64, f64))) {
        let End { depth, rise, last } = end;
        let after = self.solved.iter().position(|solved| solved.depth <= depth);
        let after = after.unwrap_or(self.solved.len() - 1);
        let (a, b) = (&self.solved[after.saturating_sub(1)], &self.solved[after]);
        let apart = a.depth - b.depth;
        let part = if apart > 0.0 { ((a.depth - depth) / apart).clamp(0.0, 1.0) } else { 1.0 };
        let wider = a.wider + part * (b.wider - a.wider);
        let n = self.cosines;
        let mut sum = [0.0; COSINES_MAX];
        for i in 0..a.loads.len() / n {
            let stretch = i * n..(i + 1) * n;
            let lists = [&a.loads, &b.loads, &self.leaning];
            let [a, b, leaning] = lists.map(|list| &list[stretch.clone()]);
            for (k, value) in sum[..n].iter_mut().enumerate() {
                *value = last * (a[k] + part * (b[k] - a[k]) + rise * leaning[k]);
            }
            of(&sum[..n], (wider, self.apart * (i as f64 - BEYOND as f64)));
        }
    }
}

impl Solved {
    fn of(coarse: &mut Row, fine: &mut Row, depth: f64) -> Option<Self> {
        coarse.release();
        fine.release();
        press_both(coarse, fine, (depth, 0.0))?;
        // The widest: what is carried to a narrower one does not converge.
        let end = coarse.end_width();
        let width = fine.work.widths.iter().chain(&coarse.work.widths).fold(end, |w, b| w.max(*b));
        let wider = width / end;
        let loads = difference(coarse, fine, wider)?;
        Some(Self { depth, wider, loads })
    }

    /// What the loads change by where the pin leans, after the contact of this depth; nothing where
    /// the short pins do not settle.
    fn leaning(&self, coarse: &mut Row, fine: &mut Row) -> Option<Vec<f64>> {
        press_both(coarse, fine, (self.depth, LEANING * self.depth))?;
        let loads = difference(coarse, fine, self.wider)?;
        Some(loads.iter().zip(&self.loads).map(|(b, a)| (b - a) / LEANING).collect())
    }
}

/// Presses both short pins so deep at their far end, rising so much in a thickness from there.
fn press_both(coarse: &mut Row, fine: &mut Row, (depth, rise): (f64, f64)) -> Option<()> {
    for row in [coarse, fine] {
        row.press((None, depth - rise * row.ends[1]), rise).ok()?;
    }
    Some(())
}

/// What the longer slices leave over near the far end, over the last one's mean pressure, as loads
/// over a half-width so many times the last one's.
fn difference(coarse: &Row, fine: &Row, wider: f64) -> Option<Vec<f64>> {
    let n = coarse.work.places.cosines;
    let apart = apart(coarse.h);
    let count = libm::ceil(COUNTED[1] / apart) as usize + BEYOND + 2;
    let mut loads = vec![0.0; count * n];
    let width = wider * coarse.end_width();
    coarse.deposit((-1.0, apart), width, &mut loads);
    fine.deposit((1.0, apart), width, &mut loads);
    let last = coarse.work.a[(coarse.along.len() - 1) * n];
    loads.iter_mut().for_each(|load| *load /= last);
    (last > 0.0 && loads.iter().all(|load| load.is_finite())).then_some(loads)
}

impl Row {
    /// The contact of a force, what the slices leave over included, or of a penetration: that of
    /// the origin, what is left, and the number of steps.
    pub(super) fn carried(
        &mut self,
        wanted: Option<f64>,
        penetration: f64,
        slope: f64,
    ) -> Result<(f64, f64, usize), Trouble> {
        let Some(found) = self.look_up(wanted, penetration, slope) else {
            // Steps to a force count what is left over as they go.
            return self.search(wanted, penetration, slope);
        };
        let [over, _] = self.left_over_force();
        let Some(force) = wanted.filter(|w| over.abs() > OVER * self.fineness.tolerance * w) else {
            return Ok((found, 0.0, 1));
        };
        self.work.warm = true;
        match self.look_up(Some(force - over), found, slope) {
            Some(again) => Ok((again, 0.0, 2)),
            None => self.search(wanted, found, slope),
        }
    }

    /// Calls with the half-width and the place along of what the slices leave over at the ends that
    /// touch, and its cosines, times thickness.
    pub(super) fn left_over(&self, mut of: impl FnMut((f64, f64), &[f64])) {
        let Some(leftover) = &self.leftover else { return };
        let [near, far] = self.ends;
        let last = self.along.len() - 1;
        let given = &self.work.given;
        let slope = (given[last] - given[0]) / (self.along[last] - self.along[0]).max(self.h);
        for (j, place, inwards) in [(last, far, -1.0), (0, near, 1.0)] {
            // A row over an end has one.
            if self.work.touches(j) && !(self.part && j == 0) {
                let (b, own) = self.work.slice(j);
                let rise = (-inwards * slope / given[j]).clamp(-STEEPEST, STEEPEST);
                let end = End { depth: given[j], rise, last: own[0] };
                leftover.at(end, |cosines, (wider, away)| {
                    of((wider * b, place + inwards * away), cosines);
                });
            }
        }
    }

    /// Half-width of the last slice.
    fn end_width(&self) -> f64 {
        self.work.widths[self.along.len() - 1]
    }

    /// Force of what the slices leave over, in units of the kernels, and its moment about the
    /// origin.
    pub(super) fn left_over_force(&self) -> [f64; 2] {
        let (mut force, mut moment) = (0.0, 0.0);
        self.left_over(|(_, v), cosines| {
            force += PI * cosines[0];
            moment += PI * cosines[0] * v;
        });
        [force, moment]
    }

    /// Adds what stands for the pressure near the end at its last slice to loads, cosine after
    /// cosine, `part` times; each to the four loads around it as cubics have it.
    fn deposit(&self, (part, apart): (f64, f64), width: f64, loads: &mut [f64]) {
        let n = self.work.places.cosines;
        let mut carried = vec![0.0; n];
        for (j, v) in self.along.iter().enumerate() {
            let (b, own) = self.work.slice(j);
            carry(own, b / width, &mut carried);
            for (place, stands) in stood(*v, self.h) {
                let s = self.length - place;
                let counts = counted(s);
                if counts == 0.0 {
                    continue;
                }
                let at = s / apart + BEYOND as f64;
                let first = (libm::floor(at) - 1.0).clamp(0.0, (loads.len() / n - 4) as f64);
                let weights = cubic(at - first - 1.0);
                for (i, weight) in (first as usize..).zip(weights) {
                    let felt = part * stands * counts * weight * self.h;
                    let load = &mut loads[i * n..(i + 1) * n];
                    load.iter_mut().zip(&carried).for_each(|(sum, a)| *sum += felt * a);
                }
            }
        }
    }
}

/// Distance of the loads that stand for what slices of length `h` leave over: a third or a half of
/// it, a quarter where there are loads between slices, or a whole multiple; so all loads of the
/// slices lie alike among them.
fn apart(h: f64) -> f64 {
    match h {
        h if h > HALVED => 0.25 * h,
        h if h > LONGER => h / 3.0,
        h if h > APART => 0.5 * h,
        h => h * libm::floor(APART / h),
    }
}

/// Writes the cosines of a pressure on a half-width `wider` times as large: its moments across.
fn carry(own: &[f64], wider: f64, out: &mut [f64]) {
    let points = own.len() + 2;
    out.fill(0.0);
    for i in 0..points {
        let angle = PI * (2 * i + 1) as f64 / (4 * points) as f64;
        let psi = |(k, a): (usize, &f64)| a * libm::cos(2.0 * k as f64 * angle);
        let psi = own.iter().enumerate().map(psi).sum::<f64>() / points as f64;
        let z = wider * libm::cos(angle);
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
fn counted(s: f64) -> f64 {
    let [all, none] = COUNTED;
    let part = ((s - all) / (none - all)).clamp(0.0, 1.0);
    0.5 * (1.0 + libm::cos(PI * part))
}
