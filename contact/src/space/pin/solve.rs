//! Solves the contact of a row, by the table of a bar or by free-boundary steps. In each step a
//! linear solver finds the pressure of the coupled slices at the present widths, and the widths are
//! corrected by the errors at the edges.

use super::contact::{ROW_FILL_MAX, RowContact};
use super::dense::Carried;
use super::failure::SolveFailure;
use super::free_boundary::update_widths;
use super::lookup::look_up_bar;
use super::newton::NewtonContact;
use super::newton_system::NewtonSystem;
use super::pose::PinState;
use super::target::Target;
use core::f64::consts::PI;

/// Tolerance of the gradients over the steps', and their loosest one while widths are searched for.
const GRADIENT_TOLERANCE: f64 = 0.1;
const LOOSE_GRADIENT_TOLERANCE: f64 = 0.03;
/// Weight of the relative error of the force, beside the error at the edges.
const FORCE_WEIGHT: f64 = 2.0;
/// A change of the penetration (in depths) determines the force's rate if it exceeds this part of
/// the error at the edges.
const NOISE_RATIO: f64 = 0.3;
/// Steps after which a contact that fills a part of the pin is given up for a longer part.
const FULL_ROW_STEPS: usize = 4;
/// Changes of the penetration are halved after more changes of sign than this.
const SIGN_CHANGES_MAX: usize = 8;
/// Steps in which each width changes by itself before Newton's method takes all of them.
const SINGLE_WIDTH_STEPS: usize = 6;
/// Factor of the level's steps for a contact whose error exceeds the level's residual.
const EXTRA_STEPS: usize = 4;
/// Largest change of the penetration in one step: this part of the depth, and a little that lets a
/// contact begin, thicknesses.
const SHIFT_MAX: f64 = 0.5;
const FIRST_SHIFT_MAX: f64 = 1e-6;
/// Force of the end correction, in tolerances, from which a bar's force is looked up again.
const CORRECTION_TOLERANCES: f64 = 0.5;

/// A solved contact.
#[derive(Clone, Copy, Debug)]
struct Solution {
    /// Penetration at the origin, thicknesses.
    penetration: f64,
    residual: f64,
    steps: usize,
}

/// State of the steps to a contact.
#[derive(Default)]
struct Progress {
    /// Force that is asked for.
    wanted: Option<f64>,
    /// Penetration at the origin.
    penetration: f64,
    /// Change of the penetration that the next step begins with.
    shift: f64,
    /// The last change of the penetration, and how often its sign changed.
    last_shift: f64,
    sign_changes: usize,
    /// Force and penetration of the step before.
    known: Option<KnownForce>,
    error: f64,
}

/// Force of a step.
#[derive(Clone, Copy, Debug)]
struct KnownForce {
    force: f64,
    penetration: f64,
}

impl Progress {
    /// A change of the penetration within its limits, halved where the changes oscillate.
    fn limited_shift(&mut self, shift: f64, deepest: f64) -> f64 {
        let shift = shift.clamp(-SHIFT_MAX * deepest, SHIFT_MAX * deepest + FIRST_SHIFT_MAX);
        self.sign_changes += usize::from(shift * self.last_shift < 0.0);
        let oscillates = self.sign_changes > SIGN_CHANGES_MAX;
        self.last_shift = if oscillates { 0.5 * shift } else { shift };
        self.last_shift
    }
}

/// Solves the contact of a row under a slope, at a force or at a penetration of the origin.
///
/// # Errors
/// See [`SolveFailure`].
pub(super) fn solve(
    contact: &mut RowContact,
    newton: Option<&mut NewtonSystem>,
    target: Target,
    slope: f64,
) -> Result<PinState, SolveFailure> {
    let Solution { penetration, residual, steps } = solution(contact, newton, target, slope)?;
    if residual.is_nan() || residual > contact.row.resolution.residual_max {
        return Err(SolveFailure::Unconverged(residual));
    }
    // A prescribed penetration through the base was refused before.
    if target.force.is_some() && contact.state.given.iter().any(|given| *given >= 1.0) {
        return Err(SolveFailure::BeyondTable);
    }
    Ok(contact.pin_state(penetration, residual, steps))
}

/// The contact by the table of a bar, where there is one, or by steps.
fn solution(
    contact: &mut RowContact,
    newton: Option<&mut NewtonSystem>,
    target: Target,
    slope: f64,
) -> Result<Solution, SolveFailure> {
    let Some(penetration) = look_up_bar(contact, target, slope) else {
        // Steps to a force count the end correction as they go.
        return search(contact, newton, target, slope);
    };
    let correction = contact.tables.correction_force(&contact.row, &contact.state).force;
    let least = CORRECTION_TOLERANCES * contact.nonlinear.limits.tolerance;
    let Some(force) = target.force.filter(|force| correction.abs() > least * force) else {
        return Ok(Solution { penetration, residual: 0.0, steps: 1 });
    };
    contact.state.is_warm = true;
    let slices = Target { force: Some(force - correction), penetration };
    match look_up_bar(contact, slices, slope) {
        Some(penetration) => Ok(Solution { penetration, residual: 0.0, steps: 2 }),
        None => search(contact, newton, Target { penetration, ..target }, slope),
    }
}

/// Finds the contact by free-boundary steps, first from the last contact and, if these do not
/// converge, from no contact.
fn search(
    contact: &mut RowContact,
    mut newton: Option<&mut NewtonSystem>,
    target: Target,
    slope: f64,
) -> Result<Solution, SolveFailure> {
    let Target { force: wanted, penetration } = target;
    let is_warm = contact.state.is_warm;
    let has_guess = is_warm && wanted.is_some();
    let start = if has_guess { penetration_about_resultant(contact, slope) } else { penetration };
    let mut outcome = iterate(contact, newton.as_deref_mut(), start, slope, wanted);
    let residual_max = contact.row.resolution.residual_max;
    let has_converged = outcome.as_ref().is_ok_and(|found| found.residual <= residual_max);
    if is_warm && !contact.state.has_warm_start && !has_converged && !contact.is_full() {
        // The contact before is too far from this one, so the search starts without it.
        contact.release();
        outcome = iterate(contact, newton, penetration, slope, wanted);
    }
    outcome
}

/// Penetration at the origin when the last contact turns about its resultant to a slope, which
/// changes its force least.
fn penetration_about_resultant(contact: &RowContact, slope: f64) -> f64 {
    let (along, state) = (&contact.row.along, &contact.state);
    let (n, last) = (state.layout.cosines, along.len() - 1);
    let (mut force, mut moment) = (0.0, 0.0);
    for (j, v) in along.iter().enumerate() {
        force += state.a[j * n];
        moment += state.a[j * n] * v;
    }
    let (from, to) = (along[0], along[last]);
    let place = (moment / force).clamp(from, to);
    let given = &state.given;
    let before = if last == 0 { 0.0 } else { (given[last] - given[0]) / (to - from) };
    given[0] + before * (place - from) - slope * place
}

/// Sets the penetrations of the slices, from the contact before if it is known; the deepest one.
fn set_penetrations(contact: &mut RowContact, penetration: f64, slope: f64) -> f64 {
    let RowContact { row, state, .. } = contact;
    let mut deepest: f64 = 0.0;
    for (j, v) in row.along.iter().enumerate() {
        let given = penetration + slope * v;
        // A slice out of contact stays so until the layer reaches it.
        state.effective[j] = match (state.is_warm, state.active[j]) {
            (true, true) => state.effective[j] + given - state.given[j],
            (true, false) => 0.0,
            (false, _) => given,
        };
        state.active[j] = state.effective[j] > 0.0;
        state.given[j] = given;
        deepest = deepest.max(given);
    }
    deepest
}

/// Takes free-boundary steps to the contact.
fn iterate(
    contact: &mut RowContact,
    mut newton: Option<&mut NewtonSystem>,
    start: f64,
    slope: f64,
    wanted: Option<f64>,
) -> Result<Solution, SolveFailure> {
    let was_warm = contact.state.is_warm;
    if set_penetrations(contact, start, slope) <= 0.0 && wanted.is_none() {
        contact.release();
        return Ok(Solution { penetration: start, residual: 0.0, steps: 0 });
    }
    let mut progress =
        Progress { penetration: start, error: f64::INFINITY, wanted, ..Progress::default() };
    let (mut step, mut has_readmitted) = (0, false);
    contact.nonlinear.readmit_slices();
    let (limits, residual_max) = (contact.nonlinear.limits, contact.row.resolution.residual_max);
    // A contact whose error exceeds the level's residual gets more steps.
    while step < limits.steps
        || (progress.error > residual_max && step < EXTRA_STEPS * limits.steps)
    {
        step += 1;
        if step > FULL_ROW_STEPS && contact.is_full() {
            return Err(SolveFailure::RowFilled(progress.penetration));
        }
        for given in &mut contact.state.given {
            *given += progress.shift;
        }
        contact.state.update_slices(&contact.row, !was_warm && step == 1)?;
        contact.nonlinear.shifted = core::mem::take(&mut progress.shift).abs();
        let may_oscillate = contact.nonlinear.relaxation != 0.0 && step > SINGLE_WIDTH_STEPS;
        if (contact.state.has_warm_start || may_oscillate)
            && let Some(newton) = newton.as_deref_mut()
        {
            let RowContact { row, state, linear, nonlinear, tables } = &mut *contact;
            let all = NewtonContact { row, state, nonlinear, linear, tables };
            if let Some(found) = newton.solve_widths(all, wanted)? {
                progress.penetration += found.shift;
                progress.error = found.error;
                step += found.steps - 1;
                break;
            }
        }
        let RowContact { row, state, linear, .. } = &mut *contact;
        let most = linear.dense.most;
        match linear.dense.solve(row, state, most) {
            Some(carried) => direct_step(contact, &mut progress, carried, step == 1),
            None => gradient_step(contact, &mut progress, was_warm, step == 1)?,
        }
        if wanted.is_some()
            && !was_warm
            && step > 1
            && leaves_row(contact, progress.penetration / slope)
        {
            return Err(SolveFailure::RowFilled(progress.penetration));
        }
        if progress.error <= limits.tolerance {
            // Slices may have been released at another penetration.
            if !core::mem::replace(&mut has_readmitted, true) && contact.nonlinear.readmit_slices()
            {
                progress.error = f64::INFINITY;
                continue;
            }
            break;
        }
    }
    revert_shift(contact, &mut progress);
    Ok(Solution { penetration: progress.penetration, residual: progress.error, steps: step })
}

/// Reverts a change of the penetration that no step was taken after.
fn revert_shift(contact: &mut RowContact, progress: &mut Progress) {
    progress.penetration -= progress.shift;
    let state = &mut contact.state;
    let slices = state.effective.iter_mut().zip(&state.active);
    slices.filter(|(_, active)| **active).for_each(|(own, _)| *own -= progress.shift);
    progress.shift = 0.0;
}

/// Takes one step from the pressure of the dense system, which is exact.
fn direct_step(
    contact: &mut RowContact,
    progress: &mut Progress,
    carried: Carried,
    is_first: bool,
) {
    let RowContact { row, state, linear, nonlinear, tables } = contact;
    let deepest = state.deepest();
    let mut off: f64 = 0.0;
    if let Some(force) = progress.wanted {
        let correction = tables.correction_force(row, state).force;
        let whole = (force - correction - carried.force) / carried.rate;
        let part = progress.limited_shift(whole, deepest);
        linear.dense.shift_penetration(state, part);
        progress.penetration += part;
        off = (whole - part).abs();
    }
    let change = update_widths(row, state, nonlinear, linear, is_first);
    let scale = state.penetration_scale(row.strips.is_free());
    progress.error = (change / scale).max(off / deepest.max(f64::MIN_POSITIVE));
}

/// Takes one step from a pressure by conjugate gradients. Their tolerance is loose while the widths
/// are wrong; only a pressure at the final tolerance is accepted.
fn gradient_step(
    contact: &mut RowContact,
    progress: &mut Progress,
    was_warm: bool,
    is_first: bool,
) -> Result<(), SolveFailure> {
    let RowContact { row, state, linear, nonlinear, .. } = &mut *contact;
    let is_free = row.strips.is_free();
    let tolerance = nonlinear.limits.tolerance;
    let tightest = GRADIENT_TOLERANCE * tolerance;
    let loosest = if was_warm || !is_free { tightest } else { LOOSE_GRADIENT_TOLERANCE };
    let limit = (0.1 * progress.error).min(loosest).max(tightest);
    let deepest = state.deepest();
    let unsolved = linear.gradients.solve(row, state, &mut linear.sums, limit)?;
    let change = update_widths(row, state, nonlinear, linear, is_first);
    progress.error = (change / state.penetration_scale(is_free)).max(unsolved);
    if let Some(force) = progress.wanted {
        let plane = plane_totals(contact);
        let rate = plane.rate * force_stiffness(contact, progress, plane, deepest);
        let RowContact { row, state, tables, .. } = &mut *contact;
        let carried = plane.force + tables.correction_force(row, state).force;
        progress.error = progress.error.max(FORCE_WEIGHT * (carried / force - 1.0).abs());
        if progress.error > tolerance {
            let shift = (force - carried) / rate.max(f64::MIN_POSITIVE);
            let shift = progress.limited_shift(shift, deepest);
            progress.shift = shift;
            progress.penetration += shift;
            predict_pressures(contact, shift);
        }
    }
    if limit > tolerance {
        progress.error = progress.error.max(limit);
    }
    Ok(())
}

/// Rate of the force over that of independent slices, from the last two steps where they determine
/// it: widths that have not converged change the force, too, and on a short row as much as the
/// penetration does.
fn force_stiffness(
    contact: &mut RowContact,
    progress: &mut Progress,
    plane: Carried,
    deepest: f64,
) -> f64 {
    let nonlinear = &mut contact.nonlinear;
    let at = progress.penetration;
    let has_relaxation = nonlinear.relaxation != 0.0;
    let least = match (contact.row.strips.is_free(), has_relaxation) {
        (false, _) => 0.0,
        (true, false) => NOISE_RATIO * progress.error * deepest,
        (true, true) => f64::INFINITY,
    };
    let now = KnownForce { force: plane.force, penetration: at };
    let before = progress.known.replace(now);
    let determines =
        |other: &KnownForce| plane.rate > 0.0 && (at - other.penetration).abs() > least;
    if let Some(other) = before.filter(determines) {
        let stiffest = if has_relaxation { 8.0 } else { 2.0 };
        let rate = (plane.force - other.force) / (at - other.penetration);
        nonlinear.stiffness = (rate / plane.rate).clamp(0.5, stiffest);
    } else if nonlinear.stiffness <= 0.0 {
        nonlinear.stiffness = 1.0;
    }
    nonlinear.stiffness
}

/// Predicts widths and pressures after a change of the penetration, each free slice's as the plane
/// one's at the rate of the whole.
fn predict_pressures(contact: &mut RowContact, shift: f64) {
    let RowContact { row, state, nonlinear, .. } = contact;
    let (layout, n) = (state.layout, state.layout.cosines);
    let rise = if row.strips.is_free() { shift * nonlinear.stiffness } else { 0.0 };
    for j in (0..row.along.len()).filter(|j| state.active[*j]) {
        state.effective[j] += shift;
        let punch = j * layout.len() + layout.punch(0);
        let own = state.a[j * n..(j + 1) * n].iter_mut();
        own.zip(&state.rows[punch..punch + n]).for_each(|(a, punch)| *a += rise * punch);
    }
}

/// Whether a contact, given where the rigid pin enters the layer, needs a longer row than this one.
/// On a short row the penetration is not known until the widths are.
fn leaves_row(contact: &RowContact, from: f64) -> bool {
    let row = &contact.row;
    let is_known = contact.nonlinear.relaxation == 0.0;
    row.is_partial && is_known && from + row.ends[1] > ROW_FILL_MAX * row.length
}

/// Force in units of the kernels, and the rate that independent slices would have.
fn plane_totals(contact: &RowContact) -> Carried {
    let (row, state) = (&contact.row, &contact.state);
    let layout = state.layout;
    let (mut force, mut rate) = (0.0, 0.0);
    for j in 0..row.along.len() {
        if state.active[j] {
            force += PI * row.h * state.a[j * layout.cosines];
            rate += PI * row.h * state.row(j)[layout.punch(0)];
        }
    }
    Carried { force, rate }
}
