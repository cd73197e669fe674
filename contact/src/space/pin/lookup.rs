//! Contacts that are read from the tables of a row, without a search for their widths.

use super::contact::RowContact;
use super::pose::PinState;
use super::tables::full_length::{REFERENCE_DEPTH_MIN, RowSlope};
use super::target::Target;
use core::f64::consts::PI;

/// Reads the contact of a bar from its table, and makes it the row's contact; its penetration at
/// the origin, where the target's is. Absent without a table, and where a slice is in tension.
pub(super) fn look_up_bar(contact: &mut RowContact, target: Target, slope: f64) -> Option<f64> {
    let RowContact { row, state, tables, .. } = contact;
    let table = tables.levinson.as_ref()?;
    let per_length = Target { force: target.force.map(|force| force / row.h), ..target };
    let (touching, penetration) = table.contact_length(per_length, slope);
    if !table.pressures(touching, penetration, slope, &mut state.a) {
        contact.release();
        return None;
    }
    let n = state.layout.cosines;
    state.widths.fill(row.strips.widest());
    for (j, v) in row.along.iter().enumerate() {
        state.given[j] = penetration + slope * v;
        state.effective[j] = state.a[j * n];
        state.active[j] = state.a[j * n] > 0.0;
    }
    Some(penetration)
}

/// Reads the contact of a cylinder on a good part of its length from the row's table, and makes it
/// the row's contact. The target's penetration is the depth of the row's end at `to`. Absent
/// outside the table.
pub(super) fn look_up_full_length(
    contact: &mut RowContact,
    target: Target,
    slope: f64,
    to: f64,
) -> Option<PinState> {
    let table = contact.tables.full_length.as_mut()?;
    let length = contact.row.length;
    let depth = match target.force {
        Some(force) => table.depth_of(force, RowSlope { slope, length })?,
        None => target.penetration,
    };
    table.interpolate(depth, slope * length / depth)?;
    let residual = table.residual;
    let carried = apply_differences(contact, depth, slope, to);
    if let Some(force) = target.force {
        // The interpolation misses the force by a little.
        let more = force / carried;
        contact.state.a.iter_mut().for_each(|a| *a *= more);
    }
    Some(contact.pin_state(depth - slope * to, residual, 1))
}

/// Makes the contact of the interpolated differences the row's contact; its force in units of the
/// kernels.
fn apply_differences(contact: &mut RowContact, depth: f64, slope: f64, to: f64) -> f64 {
    let RowContact { row, state, tables, .. } = contact;
    let Some(table) = &tables.full_length else { return 0.0 };
    let n = state.layout.cosines;
    state.has_read_widths = true;
    let mut force = 0.0;
    for (j, differences) in table.interpolated.chunks_exact(n + 1).enumerate() {
        let given = depth - slope * (to - row.along[j]);
        let effective = given + depth * differences[0];
        let own = &mut state.a[j * n..(j + 1) * n];
        state.given[j] = given;
        state.active[j] = false;
        if effective > 0.0 {
            state.widths[j] = row.strips.half_width(effective);
            let least = REFERENCE_DEPTH_MIN * depth;
            let scale = row.strips.plane_pressure(effective, state.widths[j], least, own);
            let cosines = own.iter_mut().zip(&differences[1..]);
            cosines.for_each(|(a, difference)| *a += scale * difference);
            state.active[j] = own[0] > 0.0;
        }
        if state.active[j] {
            state.effective[j] = effective;
            force += PI * row.h * own[0];
        } else {
            state.effective[j] = 0.0;
            own.fill(0.0);
        }
    }
    force
}
