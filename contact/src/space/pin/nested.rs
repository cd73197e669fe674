//! Contacts of a bar without a search for their pressure. A bar's slices are all of one width, and
//! what touches of a tilted one is its deeper end: the first m slices of its row, for some m. Their
//! systems are nested, and as two slices act on each other by their distance alone, Levinson's
//! recursion goes from one to the next: it solves them all, once, for a unit of penetration and for
//! a unit of slope. A contact is then the largest m whose last slice is pressed, found by halving,
//! and a sum of two tabulated pressures; it remembers nothing.
//!
//! It refuses rows whose solutions would not fit, and contacts of which slices further in are
//! pulled: those are left to the search (`solve`).

use super::row::Row;
use super::strip::Strips;
use crate::numeric::cholesky::{factor, solve};
use crate::numeric::product::dot;
use core::f64::consts::PI;

/// Most numbers of a row's solutions.
const SOLUTIONS_MAX: usize = 1 << 23;
/// Penetration and slope.
const SIDES: usize = 2;

/// Solutions of the first 1, 2 ... slices of a row, from its deeper end.
#[derive(Clone, Debug)]
pub(super) struct Nested {
    cosines: usize,
    /// By m: force over the slices' length, and mean pressure of the last slice.
    forces: Vec<[f64; SIDES]>,
    last: Vec<[f64; SIDES]>,
    /// Cosines slice after slice, for m = 1, then 2 ...
    pressures: [Vec<f64>; SIDES],
}

impl Nested {
    /// Of equal slices at places `along` the row, deepest last, `between` being what two of them do
    /// to each other; absent when there are too many or their system is not positive.
    pub(super) fn new(strips: &Strips, between: &[f64], along: &[f64]) -> Option<Self> {
        let (places, slices) = (strips.places, along.len());
        let n = places.cosines;
        if slices * (slices + 1) / 2 * n * SIDES > SOLUTIONS_MAX {
            return None;
        }
        let mut own = vec![0.0; places.len()];
        strips.row(strips.widest(), &mut own);
        // What a slice does to itself has the plane problem in it.
        let mut blocks = between.to_vec();
        for (at, entry) in blocks[..n * n].iter_mut().enumerate() {
            let (k, l) = (at / n, at % n);
            *entry += own[places.matrix(k.max(l), k.min(l))];
        }
        let mut found = Self {
            cosines: n,
            forces: Vec::with_capacity(slices),
            last: Vec::with_capacity(slices),
            pressures: [Vec::new(), Vec::new()],
        };
        let mut recursion = Levinson::new(&blocks, n, slices)?;
        let mut solved = [vec![0.0; slices * n], vec![0.0; slices * n]];
        for (m, place) in along.iter().rev().enumerate() {
            if m > 0 {
                recursion.grow()?;
            }
            let (mut force, mut last) = ([0.0; SIDES], [0.0; SIDES]);
            for (at, side) in [PI, PI * place].into_iter().enumerate() {
                let pressure = &mut solved[at][..(m + 1) * n];
                recursion.extend(pressure, side);
                force[at] = PI * pressure.iter().step_by(n).sum::<f64>();
                last[at] = pressure[m * n];
                found.pressures[at].extend_from_slice(pressure);
            }
            found.forces.push(force);
            found.last.push(last);
        }
        Some(found)
    }

    /// How many slices touch, and the penetration at the origin: the given one, or that of a force
    /// (over the slices' length, in units of the kernels).
    pub(super) fn touching(
        &self,
        (wanted, penetration): (Option<f64>, f64),
        slope: f64,
    ) -> (usize, f64) {
        let deep = |m: usize| {
            let [by_depth, by_slope] = self.forces[m - 1];
            wanted.map_or(penetration, |force| (force - slope * by_slope) / by_depth)
        };
        let pressed = |m: usize| {
            let [by_depth, by_slope] = self.last[m - 1];
            deep(m) * by_depth + slope * by_slope > 0.0
        };
        let (mut low, mut high) = (0, self.last.len() + 1);
        while high - low > 1 {
            let middle = usize::midpoint(low, high);
            if pressed(middle) { low = middle } else { high = middle }
        }
        (low, if low == 0 { penetration } else { deep(low) })
    }

    /// Writes the cosines of the first m slices, slice after slice backwards from the end of `out`;
    /// false when one of them is pulled.
    pub(super) fn write(
        &self,
        m: usize,
        (penetration, slope): (f64, f64),
        out: &mut [f64],
    ) -> bool {
        let n = self.cosines;
        let from = m.saturating_sub(1) * m / 2 * n;
        let [by_depth, by_slope] = [0, 1].map(|at| &self.pressures[at][from..from + m * n]);
        let parts = by_depth.chunks_exact(n).zip(by_slope.chunks_exact(n));
        let mut pressed = true;
        out.fill(0.0);
        for (own, (by_depth, by_slope)) in out.chunks_exact_mut(n).rev().zip(parts) {
            for (value, (a, b)) in own.iter_mut().zip(by_depth.iter().zip(by_slope)) {
                *value = penetration * a + slope * b;
            }
            pressed &= own[0] > 0.0;
        }
        pressed
    }
}

impl Row {
    /// The contact of a bar from its table; its penetration at the origin.
    pub(super) fn look_up(
        &mut self,
        wanted: Option<f64>,
        penetration: f64,
        slope: f64,
    ) -> Option<f64> {
        let (nested, work) = (self.nested.as_ref()?, &mut self.work);
        let over_length = wanted.map(|force| force / self.h);
        let (touching, penetration) = nested.touching((over_length, penetration), slope);
        let found = nested.write(touching, (penetration, slope), &mut work.a);
        if !found {
            work.clear();
            return None;
        }
        let n = work.places.cosines;
        work.widths.fill(self.strips.widest());
        for (j, v) in self.along.iter().enumerate() {
            work.given[j] = penetration + slope * v;
            work.effective[j] = work.a[j * n];
            work.active[j] = work.a[j * n] > 0.0;
        }
        Some(penetration)
    }
}

/// Levinson's recursion for systems of 1, 2 ... slices whose blocks, symmetric each, follow from
/// the slices' distance (Whittle 1963, Wiggins and Robinson 1965, here with one predictor for both
/// ends: the system reads the same from either). Of m slices it keeps the pressures A_0 = 1, A_1
/// ... under which all but the first are left in peace, and what the first feels, E.
struct Levinson<'a> {
    cosines: usize,
    /// By distance, within reach.
    blocks: &'a [f64],
    /// A_0, A_1 ... of the slices so far, each row by row.
    ahead: Vec<f64>,
    slices: usize,
    /// E and its factor.
    error: Vec<f64>,
    factor: Vec<f64>,
    /// Blocks in passing.
    gap: Vec<f64>,
    turn: Vec<f64>,
    pair: [Vec<f64>; 2],
    felt: Vec<f64>,
}

impl<'a> Levinson<'a> {
    /// Of one slice, with room for some; absent when its block is not positive definite.
    fn new(blocks: &'a [f64], n: usize, room: usize) -> Option<Self> {
        let mut ahead = vec![0.0; room * n * n];
        ahead[..n * n].iter_mut().step_by(n + 1).for_each(|one| *one = 1.0);
        let block = || vec![0.0; n * n];
        let mut made = Self {
            cosines: n,
            blocks,
            ahead,
            slices: 1,
            error: blocks[..n * n].to_vec(),
            factor: block(),
            gap: block(),
            turn: block(),
            pair: [block(), block()],
            felt: vec![0.0; n],
        };
        made.factored().then_some(made)
    }

    fn factored(&mut self) -> bool {
        self.factor.copy_from_slice(&self.error);
        factor(&mut self.factor, self.cosines)
    }

    /// Takes one more slice in; absent when the system is not positive definite.
    fn grow(&mut self) -> Option<()> {
        let (n, m) = (self.cosines, self.slices);
        let size = n * n;
        // What the slice beyond the last one feels of A, and the first one of A turned round.
        self.gap.fill(0.0);
        let within = self.blocks.chunks_exact(size).take(m + 1).enumerate().skip(1);
        for (apart, block) in within {
            let from = (m - apart) * size;
            add_product(&mut self.gap, block, &self.ahead[from..from + size], n);
        }
        // E^-1 of the gap, which is symmetric: its rows give columns.
        for (k, row) in self.gap.chunks_exact(n).enumerate() {
            self.felt.copy_from_slice(row);
            solve(&self.factor, n, &mut self.felt);
            self.felt.iter().enumerate().for_each(|(l, value)| self.turn[l * n + k] = -value);
        }
        add_product(&mut self.error, &self.gap, &self.turn, n);
        for i in 1..=m / 2 {
            let places = [i * size, (m - i) * size];
            for (pair, from) in self.pair.iter_mut().zip(places) {
                pair.copy_from_slice(&self.ahead[from..from + size]);
            }
            let [low, high] = &self.pair;
            add_product(&mut self.ahead[places[0]..places[0] + size], high, &self.turn, n);
            if i != m - i {
                add_product(&mut self.ahead[places[1]..places[1] + size], low, &self.turn, n);
            }
        }
        self.ahead[m * size..(m + 1) * size].copy_from_slice(&self.turn);
        self.slices += 1;
        self.factored().then_some(())
    }

    /// Extends the pressures of one slice less by the last one, given a first cosine `side` there.
    fn extend(&mut self, pressure: &mut [f64], side: f64) {
        let (n, last) = (self.cosines, self.slices - 1);
        let (before, own) = pressure.split_at_mut(last * n);
        self.felt.fill(0.0);
        self.felt[0] = side;
        let within = self.blocks.chunks_exact(n * n).skip(1).zip(before.chunks_exact(n).rev());
        for (block, slice) in within {
            for (felt, row) in self.felt.iter_mut().zip(block.chunks_exact(n)) {
                *felt -= dot(row, slice);
            }
        }
        solve(&self.factor, n, &mut self.felt);
        own.copy_from_slice(&self.felt);
        let turned = self.ahead.chunks_exact(n * n).skip(1).zip(before.chunks_exact_mut(n).rev());
        for (block, slice) in turned {
            for (value, row) in slice.iter_mut().zip(block.chunks_exact(n)) {
                *value += dot(row, &self.felt);
            }
        }
    }
}

/// Adds the product of two square matrices, row by row, of `n` rows.
fn add_product(sum: &mut [f64], one: &[f64], other: &[f64], n: usize) {
    for (sum, row) in sum.chunks_exact_mut(n).zip(one.chunks_exact(n)) {
        for (factor, other) in row.iter().zip(other.chunks_exact(n)) {
            for (value, entry) in sum.iter_mut().zip(other) {
                *value += factor * entry;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::layer::Layer;
    use super::super::super::Drive;
    use super::super::{Pin, Profile};
    use super::{PI, Row};
    use crate::Accuracy;

    /// Every solution put back into its equations. Of a row that is short for its width, cosines
    /// and slices see nearly the same: its condition is 1e9 and more, and leaves so much.
    #[test]
    fn the_recursion_solves_systems_of_one_slice_and_more() {
        let layer = Layer::new(0.3, 27.58, 0.5).expect("a sound layer");
        for (width_mm, length_mm) in [(2.5, 6.0), (0.2, 0.9), (5.0, 0.05)] {
            let profile = Profile::Bar { width_mm };
            let made = Pin::new(&layer, profile, [0.0, length_mm], 0.1, Accuracy::Default);
            for row in &made.expect("a bar").rows {
                let bar = if row.length > 4.0 { 1e-11 } else { 1e-5 };
                for m in [1, 2, 7, row.along.len()] {
                    let left = left_over(row, m);
                    assert!(left < bar, "{width_mm} {} {m}: {left:e}", row.length);
                }
            }
        }
    }

    /// Largest residual of the first m slices under a penetration of 1, over that.
    fn left_over(row: &Row, m: usize) -> f64 {
        let (found, places) = (row.nested.as_ref().expect("a table"), row.work.places);
        let n = places.cosines;
        let mut own = vec![0.0; places.len()];
        row.strips.row(row.strips.widest(), &mut own);
        let pressure = &found.pressures[0][m * (m - 1) / 2 * n..][..m * n];
        let mut most: f64 = 0.0;
        for (i, k) in (0..m).flat_map(|i| (0..n).map(move |k| (i, k))) {
            let felt = |(at, a): (usize, &f64)| {
                let (j, l) = (at / n, at % n);
                let block = row.between.get(i.abs_diff(j) * n * n + k * n + l);
                let plane = own[places.matrix(k.max(l), k.min(l))];
                a * (block.unwrap_or(&0.0) + if i == j { plane } else { 0.0 })
            };
            let wanted = if k == 0 { PI } else { 0.0 };
            let left = pressure.iter().enumerate().map(felt).sum::<f64>() - wanted;
            most = most.max(left.abs() / PI);
        }
        most
    }

    /// The same slices by free-boundary steps and gradients, to those steps' tolerance.
    #[test]
    fn what_is_looked_up_is_what_a_search_finds() {
        for (nu, width_mm, tilt_rad) in
            [(0.5, 4.0, 0.004), (0.3, 0.5, 0.05), (0.0, 9.0, -0.01), (0.49, 2.0, 0.0)]
        {
            let layer = Layer::new(0.8, 27.58, nu).expect("a sound layer");
            let profile = Profile::Bar { width_mm };
            let made = Pin::new(&layer, profile, [-5.0, 5.0], 0.2, Accuracy::Fast);
            let mut tabled = made.expect("a bar");
            let mut searched = tabled.clone();
            searched.rows.iter_mut().for_each(|row| {
                assert!(row.nested.take().is_some());
            });
            for depth_mm in [0.08, 0.03, 0.06] {
                let delta = depth_mm - 5.0 * libm::tan(tilt_rad).abs();
                let deep = Drive::PenetrationMm(delta);
                let a = tabled.press(deep, tilt_rad).expect("a contact");
                let b = searched.press(deep, tilt_rad).expect("a contact");
                let off = (a.force_n / b.force_n - 1.0).abs();
                assert!(off < 5e-3 && a.force_n > 0.0, "{nu} {width_mm}: {a:?} {b:?}");
                assert!((a.length_mm - b.length_mm).abs() < 0.5, "{nu} {width_mm}: {a:?} {b:?}");
                let loaded = Drive::ForceN(a.force_n);
                let again = tabled.press(loaded, tilt_rad).expect("a contact");
                assert!((again.penetration_mm - delta).abs() < 1e-3 * depth_mm, "{a:?} {again:?}");
            }
        }
    }
}
