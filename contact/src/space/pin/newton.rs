//! The widths of all slices settled together. Along a contact each slice's width settles by itself;
//! where the contact's edge runs across the slices at a small angle, as it does on a cylinder that
//! stands on its end, it does not: one slice swings after the other. Here what is left at all edges
//! is differentiated by all widths, the pressure that follows them included, and steps of least
//! squares (Levenberg and Marquardt's) take it to nothing.
//!
//! It refuses nothing: a contact that is too large for its memory is left to the steps of
//! [`super::solve`], and what does not settle says so.

use super::row::Row;
use super::work::Trouble;
use crate::numeric::cholesky::{dot, factor, solve, solve_from};
use core::f64::consts::PI;

/// Most steps.
const STEPS: usize = 80;
/// Damping of the steps, beside rates of about 1: to begin with, after a step that leaves more or
/// less than there was, most and least.
const BEGUN: f64 = 1e-2;
const HARDER: f64 = 10.0;
const SOFTER: f64 = 0.1;
const STIFFEST: f64 = 1e4;
const SOFTEST: f64 = 1e-12;
/// What a step may make of a penetration: this part of it at least, so many times it at most, and
/// this part of the largest more.
const STEP: [f64; 2] = [0.3, 2.0];
const WIDER: f64 = 0.05;
/// A slice lets go whose width belongs to less than this part of the largest penetration.
const TIP: f64 = 1e-3;
/// A slice that lets go and is reached in turns, more often than this, hardly touches: what is left
/// of the largest penetration is then enough.
const TURNS: usize = 2;
const HARDLY: f64 = 1e-4;
/// Part of a penetration by which it is moved to differentiate.
const APART: f64 = 1e-4;

/// Memory of the whole systems of the pressure and of the widths.
#[derive(Clone, Debug)]
pub(super) struct Newton {
    /// Most unknowns of the pressure, and most slices.
    unknowns: usize,
    slices: usize,
    active: Vec<usize>,
    /// Lower triangle, row by row.
    matrix: Vec<f64>,
    /// The pressure, what a unit of penetration adds to it, and what an edge takes from all of it.
    sides: Vec<f64>,
    /// Sums across each slice, and what one slice feels of them.
    spectra: Vec<f64>,
    felt: Vec<f64>,
    /// Transforms and plane problem of a slice that is moved: before and after, then before and
    /// the rate; what the whole system is put off by.
    moved: [Vec<f64>; 2],
    rows: [Vec<f64>; 2],
    rate: Vec<f64>,
    /// Rates of what is left, edge after edge.
    jacobian: Vec<f64>,
    /// What is left at the edges; squares of the rates, what is left by them, and their damping.
    strengths: Vec<f64>,
    squares: Vec<f64>,
    slope: Vec<f64>,
    damping: f64,
    /// The penetrations that the widths belong to, and the step from them.
    from: Vec<f64>,
    step: Vec<f64>,
}

/// What a step has come to.
pub(super) struct Found {
    /// Sum of what the penetration was changed by.
    pub(super) sunk: f64,
    pub(super) left: f64,
    pub(super) steps: usize,
}

impl Newton {
    /// For the contacts of rows, up to so many unknowns; allocates.
    pub(super) fn new(rows: &[Row], most: usize) -> Self {
        let largest = |of: &dyn Fn(&Row) -> usize| rows.iter().map(of).max().unwrap_or(0);
        let slices = largest(&|row| row.along.len().min(most / row.work.places.cosines));
        let unknowns = largest(&|row| row.along.len() * row.work.places.cosines).min(most);
        let transform = largest(&|row| row.work.transform);
        let modes = largest(&|row| row.work.transform / row.work.places.cosines);
        let row = largest(&|row| row.work.places.len());
        Self {
            unknowns,
            slices,
            active: Vec::with_capacity(slices),
            matrix: vec![0.0; unknowns * unknowns],
            sides: vec![0.0; unknowns * (slices + 2)],
            spectra: vec![0.0; modes * slices],
            felt: vec![0.0; modes],
            moved: [vec![0.0; transform], vec![0.0; transform]],
            rows: [vec![0.0; row], vec![0.0; row]],
            rate: vec![0.0; unknowns],
            jacobian: vec![0.0; slices * slices],
            strengths: vec![0.0; slices],
            squares: vec![0.0; slices * slices],
            slope: vec![0.0; slices],
            damping: BEGUN,
            from: vec![0.0; slices],
            step: vec![0.0; slices],
        }
    }
}

impl Newton {
    /// Writes the system of the slices that touch, factored, and the two pressures; the force over
    /// the slices' length and its rate.
    fn pressures(&mut self, row: &Row) -> Option<(f64, f64)> {
        let (work, n) = (&row.work, row.work.places.cosines);
        let places = work.places;
        self.active.clear();
        self.active.extend((0..row.along.len()).filter(|j| work.active[*j]));
        let size = self.active.len() * n;
        if size == 0 || size > self.unknowns || self.active.len() > self.slices {
            return None;
        }
        let of = |j: usize| &work.transforms[j * work.transform..(j + 1) * work.transform];
        for (p, &j) in self.active.iter().enumerate() {
            let plane = work.row(j);
            for (q, &i) in self.active[..=p].iter().enumerate() {
                let start = p * n * size + q * n;
                for k in 0..n {
                    let entries = &mut self.matrix[start + k * size..start + k * size + n];
                    for (l, entry) in entries.iter_mut().enumerate() {
                        let own = plane[places.matrix(k.max(l), k.min(l))];
                        *entry = if p == q { own } else { 0.0 };
                    }
                }
                let weights = row.coupling.weights_of(j - i).iter();
                let both = of(j).chunks_exact(n).zip(of(i).chunks_exact(n));
                for (weight, (one, other)) in weights.zip(both) {
                    for (k, value) in one.iter().enumerate() {
                        let felt = weight * value;
                        let entries = &mut self.matrix[start + k * size..start + k * size + n];
                        for (entry, other) in entries.iter_mut().zip(other) {
                            *entry += felt * other;
                        }
                    }
                }
            }
        }
        if !factor(&mut self.matrix[..size * size], size) {
            return None;
        }
        let (pressure, rest) = self.sides.split_at_mut(size);
        let rise = &mut rest[..size];
        for (p, &j) in self.active.iter().enumerate() {
            let plane = work.row(j);
            for k in 0..n {
                let (given, one) = if k == 0 { (PI * work.given[j], PI) } else { (0.0, 0.0) };
                pressure[p * n + k] = given - plane[places.shape(k)];
                rise[p * n + k] = one;
            }
        }
        solve(&self.matrix, size, pressure);
        solve(&self.matrix, size, rise);
        let total = |side: &[f64]| PI * side.iter().step_by(n).sum::<f64>();
        Some((total(pressure), total(rise)))
    }

    /// What all edges' strengths change by with the penetration of each slice's width, at a given
    /// force or at a given penetration.
    fn differentiate(&mut self, row: &Row, (by_force, rate): (bool, f64)) {
        let (work, n, per) = (&row.work, row.work.places.cosines, row.work.transform);
        let (places, count) = (work.places, self.active.len());
        let size = count * n;
        for (p, &j) in self.active.iter().enumerate() {
            let side = &mut self.sides[(p + 2) * size..(p + 3) * size];
            side.fill(0.0);
            side[p * n..(p + 1) * n].fill(1.0 / work.row(j)[places.edge()]);
            solve_from(&self.matrix, size, side, p * n);
        }
        let modes = per / n;
        for (p, &j) in self.active.iter().enumerate() {
            let transform = work.transforms[j * per..(j + 1) * per].chunks_exact(n);
            let sums = self.spectra[p * modes..(p + 1) * modes].iter_mut();
            let own = &work.a[j * n..(j + 1) * n];
            sums.zip(transform).for_each(|(sum, values)| *sum = dot(values, own));
        }
        for p in 0..count {
            let edge_rate = self.moved(row, p, modes);
            let (rise, fixed) = self.sides[size..(count + 2) * size].split_at(size);
            let carried = dot(rise, &self.rate[..size]);
            for q in 0..count {
                let edges = &fixed[q * size..(q + 1) * size];
                let mut change = dot(edges, &self.rate[..size]);
                if q == p {
                    change -= self.strengths[p] * edge_rate;
                }
                if by_force {
                    let j = self.active[q];
                    let risen: f64 = rise[q * n..(q + 1) * n].iter().sum();
                    change -= risen / work.row(j)[places.edge()] * carried / rate;
                }
                self.jacobian[q * count + p] = change;
            }
        }
    }

    /// Writes how the whole system is put off when one slice's width moves; the relative rate of
    /// its punch's strength.
    fn moved(&mut self, row: &Row, p: usize, modes: usize) -> f64 {
        let (work, n, per) = (&row.work, row.work.places.cosines, row.work.transform);
        let (places, i) = (work.places, self.active[p]);
        let own = &work.a[i * n..(i + 1) * n];
        let e = work.effective[i];
        let reach = [e * (1.0 - APART), (e * (1.0 + APART)).min(row.strips.deepest())];
        for (side, at) in reach.iter().enumerate() {
            let b = row.strips.half_width(*at).min(row.widest);
            row.strips.row(b, &mut self.rows[side][..places.len()]);
            row.coupling.transform(b, &mut self.moved[side][..per]);
        }
        let over = 1.0 / (reach[1] - reach[0]);
        let [below, above] = &mut self.rows;
        above.iter_mut().zip(&*below).for_each(|(a, b)| *a = over * (*a - b));
        let [low, high] = &mut self.moved;
        high.iter_mut().zip(&*low).for_each(|(a, b)| *a = over * (*a - b));
        // What this slice feels of all.
        self.felt[..modes].fill(0.0);
        for (q, &j) in self.active.iter().enumerate() {
            let weights = row.coupling.weights_of(i.abs_diff(j));
            let spectra = &self.spectra[q * modes..(q + 1) * modes];
            let felt = self.felt[..modes].iter_mut().zip(weights.iter().zip(spectra));
            felt.for_each(|(sum, (weight, spectrum))| *sum += weight * spectrum);
        }
        self.rate[..self.active.len() * n].fill(0.0);
        for (q, &j) in self.active.iter().enumerate() {
            let out = &mut self.rate[q * n..(q + 1) * n];
            let weights = row.coupling.weights_of(i.abs_diff(j));
            let transform = work.transforms[j * per..(j + 1) * per].chunks_exact(n);
            for ((weight, values), moved) in weights.iter().zip(transform).zip(high.chunks_exact(n))
            {
                let felt = weight * dot(moved, own);
                out.iter_mut().zip(values).for_each(|(sum, value)| *sum -= felt * value);
            }
        }
        let out = &mut self.rate[p * n..(p + 1) * n];
        for (felt, moved) in self.felt[..modes].iter().zip(high.chunks_exact(n)) {
            out.iter_mut().zip(moved).for_each(|(sum, value)| *sum -= felt * value);
        }
        for k in 0..n {
            out[k] -= above[places.shape(k)];
            for l in 0..n {
                out[k] -= above[places.matrix(k.max(l), k.min(l))] * own[l];
            }
        }
        above[places.edge()] / work.row(i)[places.edge()]
    }
}

impl Newton {
    /// Writes the squares of the rates, and what is left by them.
    fn square(&mut self) {
        let count = self.active.len();
        let (rates, left) = (&self.jacobian[..count * count], &self.strengths[..count]);
        for p in 0..count {
            let (squares, slope) = (&mut self.squares[p * count..(p + 1) * count], &mut self.slope);
            squares.fill(0.0);
            slope[p] = 0.0;
            for (row, left) in rates.chunks_exact(count).zip(left) {
                for (sum, rate) in squares[..=p].iter_mut().zip(row) {
                    *sum += row[p] * rate;
                }
                slope[p] -= row[p] * left;
            }
        }
    }

    /// The step that leaves least, as short as it is damped: more so where it is not known.
    fn solve(&mut self) {
        let count = self.active.len();
        let (damped, step) = (&mut self.jacobian[..count * count], &mut self.step[..count]);
        loop {
            damped.copy_from_slice(&self.squares[..count * count]);
            for p in 0..count {
                damped[p * count + p] += self.damping;
            }
            step.copy_from_slice(&self.slope[..count]);
            if factor(damped, count) {
                return solve(damped, count, step);
            }
            if self.damping >= STIFFEST {
                return step.fill(0.0);
            }
            self.damping *= HARDER;
        }
    }
}

impl Row {
    /// Settles all widths together, where there is memory for that.
    pub(super) fn settle_all(&mut self, wanted: Option<f64>) -> Result<Option<Found>, Trouble> {
        let Some(mut tool) = self.newton.take() else { return Ok(None) };
        let outcome = self.together(&mut tool, wanted);
        self.newton = Some(tool);
        outcome
    }

    /// Settles all widths together from where they are; absent when that is too large.
    fn together(
        &mut self,
        tool: &mut Newton,
        wanted: Option<f64>,
    ) -> Result<Option<Found>, Trouble> {
        let n = self.work.places.cosines;
        let mut found = Found { sunk: 0.0, left: f64::INFINITY, steps: 0 };
        let (mut least, mut lost) = (f64::INFINITY, 0);
        tool.damping = BEGUN;
        while found.steps < STEPS {
            found.steps += 1;
            self.prepare(false)?;
            let Some((carried, rate)) = tool.pressures(self) else { return Ok(None) };
            let size = tool.active.len() * n;
            let [over, _] = self.left_over_force();
            let part = wanted.map_or(0.0, |force| ((force - over) / self.h - carried) / rate);
            found.sunk += part;
            self.work.given.iter_mut().for_each(|given| *given += part);
            for (p, &j) in tool.active.iter().enumerate() {
                for k in p * n..(p + 1) * n {
                    self.work.a[j * n + k - p * n] = tool.sides[k] + part * tool.sides[size + k];
                }
            }
            let size = self.strengths(tool);
            if size > least && tool.damping < STIFFEST {
                tool.damping *= HARDER;
                tool.solve();
                self.stride(tool);
                continue;
            }
            if size <= least {
                tool.damping = (tool.damping * SOFTER).max(SOFTEST);
            }
            least = size;
            found.left = self.left_at_edges();
            let woken = self.wake();
            self.extend(tool);
            found.left = found.left.max(woken / self.largest());
            let enough = if lost > TURNS { HARDLY } else { 0.0 };
            if found.left <= enough.max(self.fineness.tolerance) {
                self.drop_unpressed();
                break;
            }
            if woken > 0.0 {
                least = f64::INFINITY;
                continue;
            }
            tool.differentiate(self, (wanted.is_some(), rate));
            for (from, &j) in tool.from.iter_mut().zip(&tool.active) {
                *from = self.work.effective[j];
            }
            tool.square();
            tool.solve();
            if self.stride(tool) {
                least = f64::INFINITY;
                lost += 1;
            }
        }
        Ok(Some(found))
    }

    /// Widens slices that were reached to what their neighbours lead to.
    fn extend(&mut self, tool: &Newton) {
        let work = &mut self.work;
        let Some((&first, rest)) = tool.active.split_first() else { return };
        if first > 0 && work.active[first - 1] && rest.first() == Some(&(first + 1)) {
            let led = 2.0 * work.effective[first] - work.effective[first + 1];
            work.effective[first - 1] = work.effective[first - 1].max(led);
        }
    }

    /// Leaves slices in the air that were reached and carry nothing.
    fn drop_unpressed(&mut self) {
        let work = &mut self.work;
        for (j, carried) in work.a.iter().step_by(work.places.cosines).enumerate() {
            if *carried == 0.0 {
                (work.active[j], work.effective[j]) = (false, 0.0);
            }
        }
    }

    /// Takes the step; whether a slice let go.
    fn stride(&mut self, tool: &Newton) -> bool {
        let largest = self.largest();
        let mut lost = false;
        for ((step, from), &j) in tool.step.iter().zip(&tool.from).zip(&tool.active) {
            let new = (from + step).clamp(STEP[0] * from, STEP[1] * from + WIDER * largest);
            if from + step <= 0.0 && new < TIP * largest {
                self.work.active[j] = false;
                self.work.effective[j] = 0.0;
                self.work.a[j * self.work.places.cosines..][..self.work.places.cosines].fill(0.0);
                lost = true;
            } else {
                self.work.effective[j] = new;
            }
        }
        lost
    }

    /// Writes what each edge is left with; the size of it.
    fn strengths(&self, tool: &mut Newton) -> f64 {
        let n = self.work.places.cosines;
        let mut size = 0.0;
        for (left, &j) in tool.strengths.iter_mut().zip(&tool.active) {
            let edge = self.work.row(j)[self.work.places.edge()];
            *left = self.work.a[j * n..(j + 1) * n].iter().sum::<f64>() / edge;
            size += *left * *left;
        }
        size
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Drive, Pin, Profile};
    use super::Row;
    use crate::{Accuracy, layer::Layer};

    /// What is left at the edges of a contact on an end, by their rates and by differences.
    #[test]
    fn rates_are_those_of_differences() {
        let layer = Layer::new(0.8, 27.58, 0.3).expect("a sound layer");
        let profile = Profile::Cylinder { radius_mm: 10.0 };
        let mut pin = Pin::new(&layer, profile, [-4.0, 4.0], 0.1, Accuracy::Fine).expect("a pin");
        let deep = Drive::PenetrationMm(0.05 - 4.0 * libm::tan(0.06));
        pin.press(deep, 0.06).expect("a contact");
        let mut tool = pin.newton.take().expect("memory");
        let row = &mut pin.rows[pin.at];
        for by_force in [false, true] {
            let mut left = |row: &mut Row| {
                row.prepare(false).expect("widths within the tables");
                let (carried, rate) = tool.pressures(row).expect("few enough");
                let (n, size) = (row.work.places.cosines, tool.active.len());
                let part = if by_force { (0.3 - carried) / rate } else { 0.0 };
                let size = size * n;
                for (p, &j) in tool.active.iter().enumerate() {
                    for k in 0..n {
                        let at = p * n + k;
                        row.work.a[j * n + k] = tool.sides[at] + part * tool.sides[size + at];
                    }
                }
                row.strengths(&mut tool);
                tool.differentiate(row, (by_force, rate));
                (tool.strengths.clone(), tool.jacobian.clone(), tool.active.clone())
            };
            let (_, rates, active) = left(row);
            let p = active.len() / 2;
            let own = row.work.effective[active[p]];
            let mut moved = |part: f64| {
                row.work.effective[active[p]] = own * part;
                left(row).0
            };
            let (below, above) = (moved(1.0 - 2e-4), moved(1.0 + 2e-4));
            moved(1.0);
            let own_rate = rates[p * active.len() + p];
            for q in 0..active.len() {
                let found = (above[q] - below[q]) / (4e-4 * own);
                let rate = rates[q * active.len() + p];
                assert!((found - rate).abs() < 1e-3 * own_rate.abs(), "{q}: {found} {rate}");
            }
        }
    }

    /// Every contact on an end settles, by penetration and by the force of that, which other slices
    /// may carry.
    #[test]
    fn ends_settle_at_the_fine_level() {
        for (nu, radius_mm) in [(0.5, 4.0), (0.1, 40.0)] {
            let layer = Layer::new(0.8, 27.58, nu).expect("a sound layer");
            let profile = Profile::Cylinder { radius_mm };
            let made = Pin::new(&layer, profile, [-5.0, 5.0], 0.12, Accuracy::Fine);
            let mut pin = made.expect("a pin");
            for (depth_mm, tilt_rad) in [(0.02, 0.19), (0.08, 0.15), (0.05, -0.1), (0.06, 0.04)] {
                let delta_mm = depth_mm - 5.0 * libm::tan(tilt_rad).abs();
                let deep = pin.press(Drive::PenetrationMm(delta_mm), tilt_rad);
                let deep = deep.expect("a contact");
                assert!(deep.residual <= 1e-6 && deep.force_n > 0.0, "{nu} {depth_mm}: {deep:?}");
                let loaded = pin.press(Drive::ForceN(deep.force_n), tilt_rad);
                let loaded = loaded.expect("a contact");
                assert!(loaded.residual <= 1e-6, "{nu} {depth_mm}: {loaded:?}");
                let off = (loaded.penetration_mm - delta_mm).abs();
                assert!(off < 1e-4 * depth_mm, "{nu} {depth_mm}: {deep:?} {loaded:?}");
            }
        }
    }

    /// A slice that is reached by a few millionths of the depth and, pressed, lets go again.
    #[test]
    fn a_slice_that_hardly_touches_is_left_in_the_air() {
        let layer = Layer::new(1.0086519245058296, 27.58, 0.5).expect("a sound layer");
        let profile = Profile::Cylinder { radius_mm: 27.46021746378392 };
        let ends = [2.761653, 7.197372368536891];
        let made = Pin::new(&layer, profile, ends, 0.10590090088330013, Accuracy::Fine);
        let deep = Drive::PenetrationMm(-0.10273535404149037);
        let state = made.expect("a pin").press(deep, 0.0216275498468856).expect("a contact");
        assert!(state.residual < 1e-5 && state.length_mm < 2.55, "{state:?}");
    }
}
