//! Newton's method for the widths of all slices together. Along a contact each slice's width
//! converges by itself. Where the contact's edge runs across the slices at a small angle, as it
//! does on a cylinder that stands on its end, it does not: neighbouring slices oscillate against
//! each other. Here the errors at all edges are differentiated by all widths, including the
//! pressure that follows from them, and damped least-squares steps (Levenberg and Marquardt)
//! reduce them.
//!
//! A contact that is too large for the memory is left to the iterative steps.

use super::failure::SolveFailure;
use super::free_boundary::{NonlinearSolver, edge_error, reactivate_slices};
use super::linear::LinearSolver;
use super::newton_system::{DAMPING_INCREASE, DAMPING_MAX, INITIAL_DAMPING, NewtonSystem};
use super::row::SliceRow;
use super::state::ContactState;
use super::tables::ContactTables;

/// Most steps of one contact.
const NEWTON_STEPS_MAX: usize = 80;
/// Factor of the damping after a step that did not increase the error, and the least damping.
const DAMPING_DECREASE: f64 = 0.1;
const DAMPING_MIN: f64 = 1e-12;
/// Limits of a penetration after a step: a smallest and a largest factor of the penetration before,
/// and the part of the largest penetration that may be added to the latter.
const STEP_RANGE: [f64; 2] = [0.3, 2.0];
const STEP_MARGIN: f64 = 0.05;
/// A slice whose step ends below zero is released if its penetration is less than this part of the
/// largest.
const RELEASE_DEPTH: f64 = 1e-3;
/// A contact in which slices leave the contact more than `TOGGLES_MAX` times is accepted at the
/// looser `TOGGLING_TOLERANCE`, an error over the largest penetration.
const TOGGLES_MAX: usize = 2;
const TOGGLING_TOLERANCE: f64 = 1e-4;
/// Result of the steps.
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

impl NewtonSystem {
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
    use super::super::super::{Accuracy, Prescribed};
    use super::super::contact::RowContact;
    use super::super::row_search::PinRows;
    use super::super::{Pin, Profile};

    /// Compares the rates of the edge errors of a contact on an end with differences.
    #[test]
    fn rates_are_those_of_differences() {
        let layer = Layer::new(0.8, 27.58, 0.3).expect("a sound layer");
        let profile = Profile::Cylinder { radius_mm: 10.0 };
        let mut pin = Pin::new(&layer, profile, [-4.0, 4.0], 0.1, Accuracy::Fine).expect("a pin");
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

    /// Every contact on an end converges, by penetration and by the force that belongs to it,
    /// although other slices may be in contact then.
    #[test]
    fn contacts_on_ends_converge_at_the_fine_level() {
        for (nu, radius_mm) in [(0.5, 4.0), (0.1, 40.0)] {
            let layer = Layer::new(0.8, 27.58, nu).expect("a sound layer");
            let profile = Profile::Cylinder { radius_mm };
            let made = Pin::new(&layer, profile, [-5.0, 5.0], 0.12, Accuracy::Fine);
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

    /// The layer reaches one slice by a few millionths of the depth, and as soon as that slice is
    /// in contact it is in tension.
    #[test]
    fn a_slice_with_almost_no_overlap_is_left_out_of_contact() {
        let layer = Layer::new(1.0086519245058296, 27.58, 0.5).expect("a sound layer");
        let profile = Profile::Cylinder { radius_mm: 27.46021746378392 };
        let ends = [2.761653, 7.197372368536891];
        let made = Pin::new(&layer, profile, ends, 0.10590090088330013, Accuracy::Fine);
        let deep = Prescribed::PenetrationMm(-0.10273535404149037);
        let state = made.expect("a pin").press(deep, 0.0216275498468856).expect("a contact");
        assert!(state.residual < 1e-5 && state.length_mm < 2.55, "{state:?}");
    }
}
