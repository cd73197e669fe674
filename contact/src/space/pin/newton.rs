//! Newton's method for the widths of all slices together. Along a contact each slice's width
//! converges by itself. Where the contact's edge runs across the slices at a small angle, as it
//! does on a cylinder that stands on its end, it does not: neighbouring slices oscillate against
//! each other. Here the errors at all edges are differentiated by all widths, including the
//! pressure that follows from them, and damped least-squares steps (Levenberg and Marquardt)
//! reduce them.
//!
//! A contact that is too large for the memory is left to the iterative steps.

use super::super::super::triangle::{dot, factor, solve, solve_from};
use super::dense::Carried;
use super::failure::SolveFailure;
use super::free_boundary::{NonlinearSolver, edge_error, reactivate_slices};
use super::linear::LinearSolver;
use super::row::SliceRow;
use super::state::ContactState;
use super::tables::ContactTables;
use core::f64::consts::PI;

/// Most steps of one contact.
const NEWTON_STEPS_MAX: usize = 80;
/// Damping of the steps, beside squared rates of about 1: at the first step, its factors after a
/// step that increased the error and after one that did not, and its limits.
const INITIAL_DAMPING: f64 = 1e-2;
const DAMPING_INCREASE: f64 = 10.0;
const DAMPING_DECREASE: f64 = 0.1;
const DAMPING_MAX: f64 = 1e4;
const DAMPING_MIN: f64 = 1e-12;
/// Limits of a penetration after a step: factors of the penetration before, and the part of the
/// largest penetration that may be added.
const STEP_RANGE: [f64; 2] = [0.3, 2.0];
const STEP_MARGIN: f64 = 0.05;
/// A slice whose step ends below zero is released if its penetration is less than this part of the
/// largest.
const RELEASE_DEPTH: f64 = 1e-3;
/// A contact in which slices leave the contact more than `TOGGLES_MAX` times is accepted at the
/// looser `TOGGLING_TOLERANCE`, an error over the largest penetration.
const TOGGLES_MAX: usize = 2;
const TOGGLING_TOLERANCE: f64 = 1e-4;
/// Part of a penetration by which it is moved to differentiate by it.
const DIFFERENCE_PART: f64 = 1e-4;

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

impl Newton {
    /// Memory for the contacts of rows, up to so many unknowns; allocates.
    pub(super) fn new<'a>(rows: impl Iterator<Item = &'a SliceRow> + Clone, most: usize) -> Self {
        let largest = |of: &dyn Fn(&SliceRow) -> usize| rows.clone().map(of).max().unwrap_or(0);
        let cosines = |row: &SliceRow| row.strips.layout.cosines;
        let slices = largest(&|row| row.along.len().min(most / cosines(row)));
        let unknowns = largest(&|row| row.along.len() * cosines(row)).min(most);
        let transform = largest(&|row| row.coupling.transform_len());
        let modes = largest(&|row| row.coupling.transform_len() / cosines(row));
        let row = largest(&|row| row.strips.layout.len());
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
            damping: INITIAL_DAMPING,
            from: vec![0.0; slices],
            step: vec![0.0; slices],
        }
    }
}

impl Newton {
    /// Writes the system of the slices that touch, factored, and the two pressures; the force over
    /// the slices' length and its rate.
    pub(super) fn solve_pressures(
        &mut self,
        row: &SliceRow,
        state: &ContactState,
    ) -> Option<Carried> {
        let (layout, n) = (state.layout, state.layout.cosines);
        self.active.clear();
        self.active.extend((0..row.along.len()).filter(|j| state.active[*j]));
        let size = self.active.len() * n;
        if size == 0 || size > self.unknowns || self.active.len() > self.slices {
            return None;
        }
        let of =
            |j: usize| &state.transforms[j * state.transform_len..(j + 1) * state.transform_len];
        for (p, &j) in self.active.iter().enumerate() {
            let plane = state.row(j);
            for (q, &i) in self.active[..=p].iter().enumerate() {
                let start = p * n * size + q * n;
                for k in 0..n {
                    let entries = &mut self.matrix[start + k * size..start + k * size + n];
                    for (l, entry) in entries.iter_mut().enumerate() {
                        let own = plane[layout.matrix(k.max(l), k.min(l))];
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
            let plane = state.row(j);
            for k in 0..n {
                let (given, one) = if k == 0 { (PI * state.given[j], PI) } else { (0.0, 0.0) };
                pressure[p * n + k] = given - plane[layout.shape(k)];
                rise[p * n + k] = one;
            }
        }
        solve(&self.matrix, size, pressure);
        solve(&self.matrix, size, rise);
        let total = |side: &[f64]| PI * side.iter().step_by(n).sum::<f64>();
        Some(Carried { force: total(pressure), rate: total(rise) })
    }

    /// What all edges' strengths change by with the penetration of each slice's width, at a given
    /// force or at a given penetration.
    fn differentiate(&mut self, row: &SliceRow, state: &ContactState, force_rate: Option<f64>) {
        let (layout, n, per) = (state.layout, state.layout.cosines, state.transform_len);
        let count = self.active.len();
        let size = count * n;
        for (p, &j) in self.active.iter().enumerate() {
            let side = &mut self.sides[(p + 2) * size..(p + 3) * size];
            side.fill(0.0);
            side[p * n..(p + 1) * n].fill(1.0 / state.row(j)[layout.edge()]);
            solve_from(&self.matrix, size, side, p * n);
        }
        let modes = per / n;
        for (p, &j) in self.active.iter().enumerate() {
            let transform = state.transforms[j * per..(j + 1) * per].chunks_exact(n);
            let sums = self.spectra[p * modes..(p + 1) * modes].iter_mut();
            let own = &state.a[j * n..(j + 1) * n];
            sums.zip(transform).for_each(|(sum, values)| *sum = dot(values, own));
        }
        for p in 0..count {
            let edge_rate = self.move_width(row, state, p, modes);
            let (rise, fixed) = self.sides[size..(count + 2) * size].split_at(size);
            let carried = dot(rise, &self.rate[..size]);
            for q in 0..count {
                let edges = &fixed[q * size..(q + 1) * size];
                let mut change = dot(edges, &self.rate[..size]);
                if q == p {
                    change -= self.strengths[p] * edge_rate;
                }
                if let Some(rate) = force_rate {
                    let j = self.active[q];
                    let risen: f64 = rise[q * n..(q + 1) * n].iter().sum();
                    change -= risen / state.row(j)[layout.edge()] * carried / rate;
                }
                self.jacobian[q * count + p] = change;
            }
        }
    }

    /// Writes how the whole system is put off when one slice's width moves; the relative rate of
    /// its punch's strength.
    fn move_width(&mut self, row: &SliceRow, state: &ContactState, p: usize, modes: usize) -> f64 {
        let (layout, n, per) = (state.layout, state.layout.cosines, state.transform_len);
        let i = self.active[p];
        let own = &state.a[i * n..(i + 1) * n];
        let e = state.effective[i];
        let reach =
            [e * (1.0 - DIFFERENCE_PART), (e * (1.0 + DIFFERENCE_PART)).min(row.strips.deepest())];
        for (side, at) in reach.iter().enumerate() {
            let b = row.strips.half_width(*at).min(row.widest);
            row.strips.row(b, &mut self.rows[side][..layout.len()]);
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
            let transform = state.transforms[j * per..(j + 1) * per].chunks_exact(n);
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
            out[k] -= above[layout.shape(k)];
            for l in 0..n {
                out[k] -= above[layout.matrix(k.max(l), k.min(l))] * own[l];
            }
        }
        above[layout.edge()] / state.row(i)[layout.edge()]
    }
}

impl Newton {
    /// Writes the squares of the rates, and what is left by them.
    fn update_normal_equations(&mut self) {
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
    fn solve_step(&mut self) {
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
            if self.damping >= DAMPING_MAX {
                return step.fill(0.0);
            }
            self.damping *= DAMPING_INCREASE;
        }
    }
}

/// What the steps have come to.
pub(super) struct NewtonResult {
    /// Sum of the changes of the penetration.
    pub(super) shift: f64,
    /// Error over the largest penetration.
    pub(super) error: f64,
    pub(super) steps: usize,
}

/// Row, state and solvers that the steps work on.
pub(super) struct NewtonContact<'a> {
    pub(super) row: &'a SliceRow,
    pub(super) state: &'a mut ContactState,
    pub(super) nonlinear: &'a NonlinearSolver,
    pub(super) linear: &'a mut LinearSolver,
    pub(super) tables: &'a ContactTables,
}

impl Newton {
    /// Solves for the widths of all slices together, from where they are, at a force in units of
    /// the kernels or at the prescribed penetration; absent when there are too many unknowns.
    ///
    /// # Errors
    /// A width beyond the row's tables.
    pub(super) fn solve_widths(
        &mut self,
        contact: NewtonContact<'_>,
        wanted: Option<f64>,
    ) -> Result<Option<NewtonResult>, SolveFailure> {
        let NewtonContact { row, state, nonlinear, linear, tables } = contact;
        let is_free = row.strips.is_free();
        let mut found = NewtonResult { shift: 0.0, error: f64::INFINITY, steps: 0 };
        let (mut least, mut toggles) = (f64::INFINITY, 0);
        self.damping = INITIAL_DAMPING;
        while found.steps < NEWTON_STEPS_MAX {
            found.steps += 1;
            state.update_slices(row, false)?;
            let Some(carried) = self.solve_pressures(row, state) else { return Ok(None) };
            let correction = tables.correction_force(row, state).force;
            let part = wanted
                .map_or(0.0, |force| ((force - correction) / row.h - carried.force) / carried.rate);
            found.shift += part;
            self.apply_pressures(state, part);
            let size = self.update_strengths(state);
            // A step that increased the error is repeated with more damping.
            if size > least && self.damping < DAMPING_MAX {
                self.damping *= DAMPING_INCREASE;
                self.solve_step();
                self.apply_step(state, is_free);
                continue;
            }
            if size <= least {
                self.damping = (self.damping * DAMPING_DECREASE).max(DAMPING_MIN);
            }
            least = size;
            found.error = edge_error(row, state);
            let reached = reactivate_slices(row, state, nonlinear, linear);
            self.extrapolate_first_width(state);
            found.error = found.error.max(reached / state.penetration_scale(is_free));
            let enough = if toggles > TOGGLES_MAX { TOGGLING_TOLERANCE } else { 0.0 };
            if found.error <= enough.max(nonlinear.limits.tolerance) {
                release_unloaded_slices(state);
                break;
            }
            // The slices in contact have changed, so the error is not comparable.
            if reached > 0.0 {
                least = f64::INFINITY;
                continue;
            }
            self.differentiate(row, state, wanted.map(|_| carried.rate));
            for (from, &j) in self.from.iter_mut().zip(&self.active) {
                *from = state.effective[j];
            }
            self.update_normal_equations();
            self.solve_step();
            if self.apply_step(state, is_free) {
                least = f64::INFINITY;
                toggles += 1;
            }
        }
        Ok(Some(found))
    }

    /// Copies the pressure into the contact's state, the penetration changed by `part`.
    pub(super) fn apply_pressures(&self, state: &mut ContactState, part: f64) {
        let n = state.layout.cosines;
        let size = self.active.len() * n;
        state.given.iter_mut().for_each(|given| *given += part);
        for (p, &j) in self.active.iter().enumerate() {
            for k in p * n..(p + 1) * n {
                state.a[j * n + k - p * n] = self.sides[k] + part * self.sides[size + k];
            }
        }
    }

    /// Widens the slice before the first one, where it has just come into contact, to the width
    /// that its neighbours extrapolate to.
    fn extrapolate_first_width(&self, state: &mut ContactState) {
        let Some((&first, rest)) = self.active.split_first() else { return };
        if first > 0 && state.active[first - 1] && rest.first() == Some(&(first + 1)) {
            let linear = 2.0 * state.effective[first] - state.effective[first + 1];
            state.effective[first - 1] = state.effective[first - 1].max(linear);
        }
    }

    /// Takes the step; whether a slice left the contact.
    fn apply_step(&self, state: &mut ContactState, is_free: bool) -> bool {
        let largest = state.penetration_scale(is_free);
        let n = state.layout.cosines;
        let mut has_released = false;
        for ((step, from), &j) in self.step.iter().zip(&self.from).zip(&self.active) {
            let [least, most] = STEP_RANGE;
            let new = (from + step).clamp(least * from, most * from + STEP_MARGIN * largest);
            if from + step <= 0.0 && new < RELEASE_DEPTH * largest {
                state.active[j] = false;
                state.effective[j] = 0.0;
                state.a[j * n..][..n].fill(0.0);
                has_released = true;
            } else {
                state.effective[j] = new;
            }
        }
        has_released
    }

    /// Writes the strength of the singularity at each edge; the sum of their squares.
    pub(super) fn update_strengths(&mut self, state: &ContactState) -> f64 {
        let n = state.layout.cosines;
        let mut size = 0.0;
        for (left, &j) in self.strengths.iter_mut().zip(&self.active) {
            let edge = state.row(j)[state.layout.edge()];
            *left = state.a[j * n..(j + 1) * n].iter().sum::<f64>() / edge;
            size += *left * *left;
        }
        size
    }
}

/// Releases slices that came into contact and carry nothing.
fn release_unloaded_slices(state: &mut ContactState) {
    for (j, carried) in state.a.iter().step_by(state.layout.cosines).enumerate() {
        if *carried == 0.0 {
            (state.active[j], state.effective[j]) = (false, 0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::layer::Layer;
    use super::super::super::{Level, Prescribed};
    use super::super::contact::RowContact;
    use super::super::row_search::PinRows;
    use super::super::{Pin, Profile};

    /// What is left at the edges of a contact on an end, by their rates and by differences.
    #[test]
    fn rates_are_those_of_differences() {
        let layer = Layer::new(0.8, 27.58, 0.3).expect("a sound layer");
        let profile = Profile::Cylinder { radius_mm: 10.0 };
        let mut pin = Pin::new(&layer, profile, [-4.0, 4.0], 0.1, Level::Fine).expect("a pin");
        let deep = Prescribed::PenetrationMm(0.05 - 4.0 * libm::tan(0.06));
        pin.press(deep, 0.06).expect("a contact");
        let used = pin.rows().used;
        let PinRows { rows, newton, .. } = pin.rows_mut();
        let tool = newton.as_mut().expect("memory");
        let contact = &mut rows[used];
        for by_force in [false, true] {
            let mut left = |contact: &mut RowContact| {
                let RowContact { row, state, .. } = contact;
                state.update_slices(row, false).expect("widths within the tables");
                let carried = tool.solve_pressures(row, state).expect("few enough");
                let (n, size) = (state.layout.cosines, tool.active.len());
                let part = if by_force { (0.3 - carried.force) / carried.rate } else { 0.0 };
                let size = size * n;
                for (p, &j) in tool.active.iter().enumerate() {
                    for k in 0..n {
                        let at = p * n + k;
                        state.a[j * n + k] = tool.sides[at] + part * tool.sides[size + at];
                    }
                }
                tool.update_strengths(state);
                tool.differentiate(row, state, by_force.then_some(carried.rate));
                (tool.strengths.clone(), tool.jacobian.clone(), tool.active.clone())
            };
            let (_, rates, active) = left(contact);
            let p = active.len() / 2;
            let own = contact.state.effective[active[p]];
            let mut moved = |part: f64| {
                contact.state.effective[active[p]] = own * part;
                left(contact).0
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
            let made = Pin::new(&layer, profile, [-5.0, 5.0], 0.12, Level::Fine);
            let mut pin = made.expect("a pin");
            for (depth_mm, tilt_rad) in [(0.02, 0.19), (0.08, 0.15), (0.05, -0.1), (0.06, 0.04)] {
                let delta_mm = depth_mm - 5.0 * libm::tan(tilt_rad).abs();
                let deep = pin.press(Prescribed::PenetrationMm(delta_mm), tilt_rad);
                let deep = deep.expect("a contact");
                assert!(deep.residual <= 1e-6 && deep.force_n > 0.0, "{nu} {depth_mm}: {deep:?}");
                let loaded = pin.press(Prescribed::ForceN(deep.force_n), tilt_rad);
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
        let made = Pin::new(&layer, profile, ends, 0.10590090088330013, Level::Fine);
        let deep = Prescribed::PenetrationMm(-0.10273535404149037);
        let state = made.expect("a pin").press(deep, 0.0216275498468856).expect("a contact");
        assert!(state.residual < 1e-5 && state.length_mm < 2.55, "{state:?}");
    }
}
