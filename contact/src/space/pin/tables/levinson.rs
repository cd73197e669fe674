//! The table of all contacts of a bar. A bar's slices are all of one width, and a tilted bar
//! touches with its deeper end: the first m slices of its row, for some m. The systems of these
//! slices are nested, and two slices act on each other by their distance alone. Therefore
//! Levinson's recursion leads from one system to the next: it solves them all once, for a unit of
//! penetration and for a unit of slope. A contact is then the largest m whose last slice is in
//! compression, found by bisection, and a sum of two tabulated pressures.
//!
//! Rows whose solutions would not fit have no table, and contacts with slices in tension are left
//! to the iterative solution.

use super::super::strip::StripTable;
use super::super::target::Target;
use crate::numeric::cholesky::{dot, factor, solve};
use core::f64::consts::PI;

/// Most numbers of a row's solutions; the table of a row takes 64 MB at most.
const SOLUTIONS_MAX: usize = 1 << 23;
/// Right sides: a unit of penetration and a unit of slope.
const RIGHT_SIDES: usize = 2;

/// Solutions of the first 1, 2 ... slices of a row, from its deeper end.
#[derive(Clone, Debug)]
pub(crate) struct LevinsonTable {
    cosines: usize,
    /// By m: force over the slices' length, and mean pressure of the last slice.
    forces: Vec<[f64; RIGHT_SIDES]>,
    last: Vec<[f64; RIGHT_SIDES]>,
    /// Cosines slice after slice, for m = 1, then 2 ...
    pressures: [Vec<f64>; RIGHT_SIDES],
}

impl LevinsonTable {
    /// Solves the systems of equal slices at places `along` the row, deepest last, with the
    /// coupling blocks of two slices by their distance; allocates. Absent when there are too many
    /// slices or their system is not positive definite.
    pub(crate) fn new(strips: &StripTable, pair_blocks: &[f64], along: &[f64]) -> Option<Self> {
        let (places, slices) = (strips.layout, along.len());
        let n = places.cosines;
        if slices * (slices + 1) / 2 * n * RIGHT_SIDES > SOLUTIONS_MAX {
            return None;
        }
        let mut own = vec![0.0; places.len()];
        strips.row(strips.widest(), &mut own);
        // The diagonal block also contains the plane problem of the slice itself.
        let mut blocks = pair_blocks.to_vec();
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
                recursion.append()?;
            }
            let (mut force, mut last) = ([0.0; RIGHT_SIDES], [0.0; RIGHT_SIDES]);
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
    pub(crate) fn contact_length(&self, target: Target, slope: f64) -> (usize, f64) {
        let Target { force, penetration } = target;
        let deep = |m: usize| {
            let [by_depth, by_slope] = self.forces[m - 1];
            force.map_or(penetration, |force| (force - slope * by_slope) / by_depth)
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
    /// false when one of them is in tension.
    pub(crate) fn pressures(
        &self,
        m: usize,
        penetration: f64,
        slope: f64,
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

/// Levinson's recursion for systems of 1, 2 ... slices whose blocks, symmetric each, follow from
/// the slices' distance (Whittle 1963, Wiggins and Robinson 1965, here with one predictor for both
/// ends: the system reads the same from either). For m slices it keeps the predictor A_0 = 1, A_1
/// ... (the pressures that displace none of the slices but the first) and the prediction error E
/// (the displacement of the first slice).
struct Levinson<'a> {
    cosines: usize,
    /// By distance, within reach.
    blocks: &'a [f64],
    /// A_0, A_1 ... of the slices so far, each row by row.
    predictor: Vec<f64>,
    slices: usize,
    /// E and its factor.
    error: Vec<f64>,
    factor: Vec<f64>,
    /// Working storage for the mismatch of the new slice.
    mismatch: Vec<f64>,
    reflection: Vec<f64>,
    swapped: [Vec<f64>; 2],
    side: Vec<f64>,
}

impl<'a> Levinson<'a> {
    /// The recursion at one slice, with memory for some; absent when its block is not positive
    /// definite.
    fn new(blocks: &'a [f64], n: usize, room: usize) -> Option<Self> {
        let mut predictor = vec![0.0; room * n * n];
        predictor[..n * n].iter_mut().step_by(n + 1).for_each(|one| *one = 1.0);
        let block = || vec![0.0; n * n];
        let mut recursion = Self {
            cosines: n,
            blocks,
            predictor,
            slices: 1,
            error: blocks[..n * n].to_vec(),
            factor: block(),
            mismatch: block(),
            reflection: block(),
            swapped: [block(), block()],
            side: vec![0.0; n],
        };
        recursion.refactor().then_some(recursion)
    }

    /// Factors the prediction error; false when it is not positive definite.
    fn refactor(&mut self) -> bool {
        self.factor.copy_from_slice(&self.error);
        factor(&mut self.factor, self.cosines)
    }

    /// Extends the predictor by one slice; absent when the system is not positive definite.
    fn append(&mut self) -> Option<()> {
        let (n, m) = (self.cosines, self.slices);
        let size = n * n;
        // The displacement of the slice beyond the last one under A, which is also that of the
        // first one under A in reverse order.
        self.mismatch.fill(0.0);
        let within = self.blocks.chunks_exact(size).take(m + 1).enumerate().skip(1);
        for (apart, block) in within {
            let from = (m - apart) * size;
            add_product(&mut self.mismatch, block, &self.predictor[from..from + size], n);
        }
        // E^-1 times the mismatch. The mismatch is symmetric, so its rows serve as columns.
        for (k, row) in self.mismatch.chunks_exact(n).enumerate() {
            self.side.copy_from_slice(row);
            solve(&self.factor, n, &mut self.side);
            self.side.iter().enumerate().for_each(|(l, value)| self.reflection[l * n + k] = -value);
        }
        add_product(&mut self.error, &self.mismatch, &self.reflection, n);
        for i in 1..=m / 2 {
            let places = [i * size, (m - i) * size];
            for (swapped, from) in self.swapped.iter_mut().zip(places) {
                swapped.copy_from_slice(&self.predictor[from..from + size]);
            }
            let [low, high] = &self.swapped;
            add_product(
                &mut self.predictor[places[0]..places[0] + size],
                high,
                &self.reflection,
                n,
            );
            if i != m - i {
                add_product(
                    &mut self.predictor[places[1]..places[1] + size],
                    low,
                    &self.reflection,
                    n,
                );
            }
        }
        self.predictor[m * size..(m + 1) * size].copy_from_slice(&self.reflection);
        self.slices += 1;
        self.refactor().then_some(())
    }

    /// Extends the pressures of one slice less by the last one, given a right side whose first
    /// cosine is `first` there.
    fn extend(&mut self, pressure: &mut [f64], first: f64) {
        let (n, last) = (self.cosines, self.slices - 1);
        let (before, own) = pressure.split_at_mut(last * n);
        self.side.fill(0.0);
        self.side[0] = first;
        let within = self.blocks.chunks_exact(n * n).skip(1).zip(before.chunks_exact(n).rev());
        for (block, slice) in within {
            for (value, row) in self.side.iter_mut().zip(block.chunks_exact(n)) {
                *value -= dot(row, slice);
            }
        }
        solve(&self.factor, n, &mut self.side);
        own.copy_from_slice(&self.side);
        let turned =
            self.predictor.chunks_exact(n * n).skip(1).zip(before.chunks_exact_mut(n).rev());
        for (block, slice) in turned {
            for (value, row) in slice.iter_mut().zip(block.chunks_exact(n)) {
                *value += dot(row, &self.side);
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
    use super::super::super::super::super::layer::Layer;
    use super::super::super::super::{Accuracy, Prescribed};
    use super::super::super::contact::RowContact;
    use super::super::super::{Pin, Profile};
    use super::PI;

    /// Puts every solution back into its equations. On a row that is short for its width the
    /// cosines and slices are nearly dependent: the condition number is 1e9 and more, which
    /// explains the larger residuals there.
    #[test]
    fn the_recursion_solves_systems_of_one_slice_and_more() {
        let layer = Layer::new(0.3, 27.58, 0.5).expect("a sound layer");
        for (width_mm, length_mm) in [(2.5, 6.0), (0.2, 0.9), (5.0, 0.05)] {
            let profile = Profile::Bar { width_mm };
            let made = Pin::new(&layer, profile, [0.0, length_mm], 0.1, Accuracy::Default);
            for contact in &made.expect("a bar").rows().rows {
                let row = &contact.row;
                let bar = if row.length > 4.0 { 1e-11 } else { 1e-5 };
                for m in [1, 2, 7, row.along.len()] {
                    let left = residual(contact, m);
                    assert!(left < bar, "{width_mm} {} {m}: {left:e}", row.length);
                }
            }
        }
    }

    /// Largest residual of the first m slices under a penetration of 1, relative to that
    /// penetration.
    fn residual(contact: &RowContact, m: usize) -> f64 {
        let (row, layout) = (&contact.row, contact.state.layout);
        let found = contact.tables.levinson.as_ref().expect("a table");
        let n = layout.cosines;
        let mut own = vec![0.0; layout.len()];
        row.strips.row(row.strips.widest(), &mut own);
        let pressure = &found.pressures[0][m * (m - 1) / 2 * n..][..m * n];
        let mut most: f64 = 0.0;
        for (i, k) in (0..m).flat_map(|i| (0..n).map(move |k| (i, k))) {
            let side = |(at, a): (usize, &f64)| {
                let (j, l) = (at / n, at % n);
                let block = row.pair_blocks.get(i.abs_diff(j) * n * n + k * n + l);
                let plane = own[layout.matrix(k.max(l), k.min(l))];
                a * (block.unwrap_or(&0.0) + if i == j { plane } else { 0.0 })
            };
            let wanted = if k == 0 { PI } else { 0.0 };
            let left = pressure.iter().enumerate().map(side).sum::<f64>() - wanted;
            most = most.max(left.abs() / PI);
        }
        most
    }

    /// Compares contacts from the table with free-boundary steps and conjugate gradients on the
    /// same slices, to the tolerance of those steps.
    #[test]
    fn contacts_from_the_table_equal_those_of_a_search() {
        for (nu, width_mm, tilt_rad) in
            [(0.5, 4.0, 0.004), (0.3, 0.5, 0.05), (0.0, 9.0, -0.01), (0.49, 2.0, 0.0)]
        {
            let layer = Layer::new(0.8, 27.58, nu).expect("a sound layer");
            let profile = Profile::Bar { width_mm };
            let made = Pin::new(&layer, profile, [-5.0, 5.0], 0.2, Accuracy::Fast);
            let mut tabled = made.expect("a bar");
            let mut searched = tabled.clone();
            searched.rows_mut().rows.iter_mut().for_each(|contact| {
                assert!(contact.tables.levinson.take().is_some());
            });
            for depth_mm in [0.08, 0.03, 0.06] {
                let delta = depth_mm - 5.0 * libm::tan(tilt_rad).abs();
                let deep = Prescribed::PenetrationMm(delta);
                let a = tabled.press(deep, tilt_rad).expect("a contact");
                let b = searched.press(deep, tilt_rad).expect("a contact");
                let off = (a.force_n / b.force_n - 1.0).abs();
                assert!(off < 5e-3 && a.force_n > 0.0, "{nu} {width_mm}: {a:?} {b:?}");
                assert!((a.length_mm - b.length_mm).abs() < 0.5, "{nu} {width_mm}: {a:?} {b:?}");
                let loaded = Prescribed::ForceN(a.force_n);
                let again = tabled.press(loaded, tilt_rad).expect("a contact");
                assert!((again.penetration_mm - delta).abs() < 1e-3 * depth_mm, "{a:?} {again:?}");
            }
        }
    }
}
