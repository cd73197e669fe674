//! Contacts of a cylinder on its end whose widths are read from a table. The pressure is solved at
//! those widths, and the widths are then refined to the tolerance of the level.

use super::contact::{RowContact, shortest_row_for};
use super::dense::Carried;
use super::free_boundary::{edge_error, width_correction};
use super::pose::PinState;
use super::tables::end::{EndTable, WidthProfile};
use super::target::Target;

/// A slice whose width belongs to less than this part of the depth is out of contact.
const EFFECTIVE_DEPTH_MIN: f64 = 0.02;
/// Most solutions while slices in tension are released.
const RELEASE_SOLUTIONS_MAX: usize = 4;
/// Most refinements of widths that were read, and the refinement from which the level's residual
/// is enough: at ends the widths may oscillate about it.
const REFINEMENTS_MAX: usize = 8;
const STRICT_REFINEMENTS: usize = 3;
/// Part of the error that a refinement corrects in directions that no earlier refinement has
/// explored.
const REFINEMENT_PART: f64 = 0.5;
/// Limits of a refined penetration: factors of the penetration before, and the part of the largest
/// penetration that may be added.
const REFINEMENT_RANGE: [f64; 2] = [0.3, 2.0];
const REFINEMENT_MARGIN: f64 = 0.05;
/// Change of the depth, in parts of it, from which the widths are read again at the new depth, and
/// how often they are read at most.
const DEPTH_CHANGE_MAX: f64 = 0.02;
const READINGS_MAX: usize = 3;

/// Outcome of the solution at widths that were read from the table.
enum EndOutcome {
    /// The contact.
    Solved(PinState),
    /// The force belongs to the widths of another depth.
    OtherDepth(f64),
}

/// Sets the row's slices to widths that are read, of an end at `to`.
fn set_widths(contact: &mut RowContact, widths: &WidthProfile, to: f64, slope: f64) {
    let state = &mut contact.state;
    for (j, v) in contact.row.along.iter().enumerate() {
        state.given[j] = widths.depth - slope * (to - v);
        state.effective[j] = widths.at(to - v);
        state.active[j] = state.effective[j] > EFFECTIVE_DEPTH_MIN * widths.depth;
    }
}

/// Starts a search on the end at `to` from widths that are read; the penetration at the origin,
/// absent when the row is not touched.
pub(super) fn warm_start(
    contact: &mut RowContact,
    widths: &WidthProfile,
    to: f64,
    slope: f64,
) -> Option<f64> {
    contact.release();
    set_widths(contact, widths, to, slope);
    let RowContact { row, state, .. } = contact;
    let has_started = state.active.contains(&true) && state.update_slices(row, true).is_ok();
    (state.is_warm, state.has_warm_start) = (has_started, has_started);
    has_started.then_some(widths.depth - slope * to)
}

/// Updates the slices and solves for their pressure; absent beyond the tables, or where the system
/// is not positive definite.
fn solve_pressure(contact: &mut RowContact) -> Option<Carried> {
    let RowContact { row, state, linear, .. } = contact;
    let room = linear.dense.room;
    state.update_slices(row, false).ok().and_then(|()| linear.dense.solve(row, state, room))
}

/// Releases slices in tension; whether there were some.
fn release_tensile_slices(contact: &mut RowContact) -> bool {
    let (state, mut has_released) = (&mut contact.state, false);
    for j in 0..state.active.len() {
        if state.active[j] && state.a[j * state.layout.cosines] <= 0.0 {
            state.active[j] = false;
            has_released = true;
        }
    }
    has_released
}

/// Refines widths that were read as far as the level asks for, at a force or at the prescribed
/// penetration; the change of the penetration, absent when they do not converge.
fn refine_widths(
    contact: &mut RowContact,
    mut carried: Carried,
    wanted: Option<f64>,
) -> Option<f64> {
    let mut shift = 0.0;
    contact.nonlinear.anderson.restart();
    for refinement in 0..=REFINEMENTS_MAX {
        let RowContact { row, state, linear, tables, .. } = &mut *contact;
        if let Some(force) = wanted {
            let correction = tables.correction_force(row, state);
            let part = (force - correction.force - carried.force) / carried.rate;
            linear.dense.shift_penetration(state, part);
            shift += part;
        }
        let error = edge_error(row, state);
        let [strict, enough] = [row.resolution.read_tolerance, row.resolution.residual_max];
        if error <= if refinement < STRICT_REFINEMENTS { strict } else { enough } {
            return Some(shift);
        }
        if refinement == REFINEMENTS_MAX {
            return None;
        }
        step_widths(contact);
        carried = solve_pressure(contact)?;
    }
    None
}

/// Moves the widths of all slices in contact by the errors at their edges, accelerated by the
/// changes in the earlier steps.
fn step_widths(contact: &mut RowContact) {
    let RowContact { row, state, nonlinear, .. } = contact;
    let largest = state.penetration_scale(row.strips.is_free());
    let anderson = &mut nonlinear.anderson;
    for j in (0..row.along.len()).filter(|j| state.active[*j]) {
        anderson.add(state.effective[j], width_correction(state, j));
    }
    anderson.mix(REFINEMENT_PART);
    let active = (0..row.along.len()).filter(|j| state.active[*j]);
    for (j, change) in active.zip(&anderson.step) {
        let own = &mut state.effective[j];
        let [least, most] = REFINEMENT_RANGE;
        *own = (*own + change).clamp(least * *own, most * *own + REFINEMENT_MARGIN * largest);
    }
}

/// Whether the row's tables hold some widths.
fn holds_widths(contact: &RowContact, widths: &WidthProfile) -> bool {
    let most = widths.depth * widths.profile.iter().fold(0.0_f64, |most, part| most.max(*part));
    let row = &contact.row;
    row.strips.contains(most) && row.strips.half_width(most) <= row.widest
}

/// Solves the contact of the end at `to` at widths that are read from the table, by force or at
/// their depth. Absent when the contact needs other widths.
fn solve_at_widths(
    contact: &mut RowContact,
    widths: &WidthProfile,
    wanted: Option<f64>,
    slope: f64,
    to: f64,
) -> Option<EndOutcome> {
    let mut depth = widths.depth;
    set_widths(contact, widths, to, slope);
    let mut solved = solve_pressure(contact);
    for solution in 1..=RELEASE_SOLUTIONS_MAX {
        if solved.is_none() || !release_tensile_slices(contact) {
            break;
        }
        solved = if solution == RELEASE_SOLUTIONS_MAX {
            None
        } else {
            let RowContact { row, state, linear, .. } = &mut *contact;
            let shortened = linear.dense.solve_shortened(row, state);
            shortened.or_else(|| solve_pressure(contact))
        };
    }
    let missed = |c: Carried| wanted.map(|force| (force - c.force) / c.rate);
    let change = solved.and_then(missed).filter(|part| part.abs() > DEPTH_CHANGE_MAX * depth);
    if let Some(part) = change {
        // The depth has changed so much that other widths belong to it, so the search starts anew.
        contact.release();
        return Some(EndOutcome::OtherDepth(depth + part));
    }
    let Some(shift) = solved.and_then(|solved| refine_widths(contact, solved, wanted)) else {
        contact.release();
        return None;
    };
    depth += shift;
    if contact.state.active[0] || !(depth > 0.0 && depth < 1.0) {
        contact.release();
        return None;
    }
    let error = edge_error(&contact.row, &contact.state);
    Some(EndOutcome::Solved(contact.pin_state(depth - slope * to, error, 1)))
}

/// Solves the contact of the end at `to` by the table, on the shortest row that holds it. The
/// target's penetration is the depth of the end. The row's index and its state; absent outside the
/// table.
pub(super) fn look_up_end(
    table: &EndTable,
    rows: &mut [RowContact],
    target: Target,
    slope: f64,
    to: f64,
) -> Option<(usize, PinState)> {
    let mut depth = match target.force {
        Some(force) => table.depth_of(force, slope)?,
        None => target.penetration,
    };
    for _ in 0..READINGS_MAX {
        let widths = table.widths(depth, slope)?;
        let mut at = shortest_row_for(rows, widths.reach).max(1);
        while at > 1 && !holds_widths(&rows[at], &widths) {
            at -= 1;
        }
        match solve_at_widths(&mut rows[at], &widths, target.force, slope, to)? {
            EndOutcome::Solved(state) => return Some((at, state)),
            EndOutcome::OtherDepth(other) => depth = other,
        }
    }
    None
}
