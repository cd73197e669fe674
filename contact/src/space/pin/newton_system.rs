//! The linearised problem of a contact's widths: the pressure of all slices in contact, the rates
//! of the errors at their edges by their widths, and the damped least-squares step that reduces
//! them.

use super::dense::Carried;
use super::row::SliceRow;
use super::state::ContactState;
use crate::numeric::cholesky::{dot, factor, solve, solve_from};
use core::f64::consts::PI;

/// Damping of the first step, beside squared rates of about 1.
pub(super) const INITIAL_DAMPING: f64 = 1e-2;
/// Factor of the damping after a step that increased the error, and the largest damping.
pub(super) const DAMPING_INCREASE: f64 = 10.0;
pub(super) const DAMPING_MAX: f64 = 1e4;
/// Part of a penetration by which it is moved to differentiate by it.
const DIFFERENCE_PART: f64 = 1e-4;

/// Memory of the whole systems of the pressure and of the widths.
#[derive(Clone, Debug)]
pub(super) struct NewtonSystem {
    /// Most unknowns of the pressure, and most slices.
    unknowns: usize,
    slices: usize,
    /// The slices in contact.
    pub(super) active: Vec<usize>,
    /// Lower triangle of the pressure's system, row by row.
    matrix: Vec<f64>,
    /// The pressure, its rate by the penetration, and the sensitivity of each edge to all right
    /// sides.
    pub(super) sides: Vec<f64>,
    /// Mode amplitudes of each slice, and the response of one slice to them.
    spectra: Vec<f64>,
    response: Vec<f64>,
    /// Transforms of a slice at a width below and above its own, of which the second becomes the
    /// rate; the same of its row of the strip table.
    transforms: [Vec<f64>; 2],
    rows: [Vec<f64>; 2],
    /// Rate of the pressure's right side by the width of one slice.
    rate: Vec<f64>,
    /// Rates of the edges' strengths by the penetrations of the widths, edge after edge.
    pub(super) jacobian: Vec<f64>,
    /// Strengths of the singularities at the edges.
    pub(super) strengths: Vec<f64>,
    /// The normal equations: matrix, right side and damping.
    normal: Vec<f64>,
    gradient: Vec<f64>,
    pub(super) damping: f64,
    /// The penetrations that the widths belong to, and the step from them.
    pub(super) from: Vec<f64>,
    pub(super) step: Vec<f64>,
}

impl NewtonSystem {
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
            response: vec![0.0; modes],
            transforms: [vec![0.0; transform], vec![0.0; transform]],
            rows: [vec![0.0; row], vec![0.0; row]],
            rate: vec![0.0; unknowns],
            jacobian: vec![0.0; slices * slices],
            strengths: vec![0.0; slices],
            normal: vec![0.0; slices * slices],
            gradient: vec![0.0; slices],
            damping: INITIAL_DAMPING,
            from: vec![0.0; slices],
            step: vec![0.0; slices],
        }
    }
}

impl NewtonSystem {
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
                        let value_sum = weight * value;
                        let entries = &mut self.matrix[start + k * size..start + k * size + n];
                        for (entry, other) in entries.iter_mut().zip(other) {
                            *entry += value_sum * other;
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

    /// Differentiates the strengths at all edges by the penetration of each slice's width, at a
    /// given force or at a given penetration.
    pub(super) fn differentiate(
        &mut self,
        row: &SliceRow,
        state: &ContactState,
        force_rate: Option<f64>,
    ) {
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

    /// Writes the rate of the right side of the whole system by the width of one slice; returns the
    /// relative rate of the strength of that slice's punch.
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
            row.coupling.transform(b, &mut self.transforms[side][..per]);
        }
        let over = 1.0 / (reach[1] - reach[0]);
        let [below, above] = &mut self.rows;
        above.iter_mut().zip(&*below).for_each(|(a, b)| *a = over * (*a - b));
        let [low, high] = &mut self.transforms;
        high.iter_mut().zip(&*low).for_each(|(a, b)| *a = over * (*a - b));
        // The response at this slice to the pressures of all slices.
        self.response[..modes].fill(0.0);
        for (q, &j) in self.active.iter().enumerate() {
            let weights = row.coupling.weights_of(i.abs_diff(j));
            let spectra = &self.spectra[q * modes..(q + 1) * modes];
            let value_sum = self.response[..modes].iter_mut().zip(weights.iter().zip(spectra));
            value_sum.for_each(|(sum, (weight, spectrum))| *sum += weight * spectrum);
        }
        self.rate[..self.active.len() * n].fill(0.0);
        for (q, &j) in self.active.iter().enumerate() {
            let out = &mut self.rate[q * n..(q + 1) * n];
            let weights = row.coupling.weights_of(i.abs_diff(j));
            let transform = state.transforms[j * per..(j + 1) * per].chunks_exact(n);
            for ((weight, values), moved) in weights.iter().zip(transform).zip(high.chunks_exact(n))
            {
                let value_sum = weight * dot(moved, own);
                out.iter_mut().zip(values).for_each(|(sum, value)| *sum -= value_sum * value);
            }
        }
        let out = &mut self.rate[p * n..(p + 1) * n];
        for (value_sum, moved) in self.response[..modes].iter().zip(high.chunks_exact(n)) {
            out.iter_mut().zip(moved).for_each(|(sum, value)| *sum -= value_sum * value);
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

impl NewtonSystem {
    /// Writes the normal equations: the products of the rates, and the rates times the errors.
    pub(super) fn update_normal_equations(&mut self) {
        let count = self.active.len();
        let (rates, left) = (&self.jacobian[..count * count], &self.strengths[..count]);
        for p in 0..count {
            let (squares, slope) =
                (&mut self.normal[p * count..(p + 1) * count], &mut self.gradient);
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

    /// Solves for the damped least-squares step; the damping shortens the step in directions in
    /// which the errors hardly change.
    pub(super) fn solve_step(&mut self) {
        let count = self.active.len();
        let (damped, step) = (&mut self.jacobian[..count * count], &mut self.step[..count]);
        loop {
            damped.copy_from_slice(&self.normal[..count * count]);
            for p in 0..count {
                damped[p * count + p] += self.damping;
            }
            step.copy_from_slice(&self.gradient[..count]);
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
