//! Solves the contacts of a cylinder that touches on a good part of its length.

use super::super::contact::RowContact;
use super::super::free_boundary::StepLimits;
use super::super::pose::PinState;
use super::super::row::TILT_MAX_RAD;
use super::super::solve::solve;
use super::super::strip::COSINES_MAX;
use super::super::tables::full_length::{
    DEPTH_COUNT, DEPTH_RATIO, END_ROW_FALLS, FullLengthTable, NEIGHBOUR_COUNT, REFERENCE_DEPTH_MIN,
    WHOLE_ROW_FALLS,
};
use super::super::target::Target;

/// Steepest slope of a tabulated contact over that of the steepest tilt.
const SLOPE_FACTOR: f64 = 1.02;
/// Limits of the steps of a tabulated contact, the largest residual that it may have, and how often
/// the steps are repeated for one that exceeds it.
const LIMITS: StepLimits = StepLimits { tolerance: 3e-4, steps: 40 };
const RESIDUAL_MAX: f64 = 1e-2;
const ATTEMPTS_MAX: usize = 3;
/// Fewest slices of a tabulated contact, and fewest falls of a tabulated depth.
const SLICES_MIN: usize = 4;
const FALLS_MIN: usize = 3;

/// Solves the contacts of a row that ends at `to`, for depths from the deepest; allocates. Absent
/// when too few have a solution.
pub(in super::super) fn full_length_table(
    contact: &mut RowContact,
    to: f64,
    deepest: f64,
) -> Option<FullLengthTable> {
    let falls: &'static [f64] =
        if contact.row.is_partial { &END_ROW_FALLS } else { &WHOLE_ROW_FALLS };
    let (slices, width) = (contact.row.along.len(), 1 + contact.state.layout.cosines);
    let mut table = FullLengthTable {
        depths: Vec::with_capacity(DEPTH_COUNT),
        falls,
        solved: Vec::with_capacity(DEPTH_COUNT),
        forces: Vec::with_capacity(DEPTH_COUNT * falls.len()),
        residual: 0.0,
        differences: Vec::new(),
        interpolated: vec![0.0; slices * width],
    };
    let limits = core::mem::replace(&mut contact.nonlinear.limits, LIMITS);
    let relaxation = core::mem::replace(&mut contact.nonlinear.relaxation, 1.0);
    let mut depth = deepest;
    for _ in 0..DEPTH_COUNT {
        contact.release();
        if !append_depth(&mut table, contact, to, depth) {
            break;
        }
        depth /= DEPTH_RATIO;
    }
    contact.nonlinear.limits = limits;
    contact.nonlinear.relaxation = relaxation;
    contact.release();
    (table.depths.len() >= NEIGHBOUR_COUNT).then_some(table)
}

/// Solves the contact of a row at a penetration of the origin under a slope, starting from the last
/// contact.
fn converged_contact(contact: &mut RowContact, penetration: f64, slope: f64) -> Option<PinState> {
    for _ in 0..ATTEMPTS_MAX {
        match solve(contact, None, Target::at_penetration(penetration), slope) {
            Ok(state) if state.residual > RESIDUAL_MAX => {}
            Ok(state) => return Some(state),
            Err(_) => break,
        }
    }
    contact.release();
    None
}

/// Solves the contacts of a depth and appends them; a depth with too few solutions is left out.
/// Whether shallower depths may follow.
fn append_depth(
    table: &mut FullLengthTable,
    contact: &mut RowContact,
    to: f64,
    depth: f64,
) -> bool {
    let (forces, differences) = (table.forces.len(), table.differences.len());
    let (falls, per) = (table.falls, table.interpolated.len());
    let mut solved = [0, 0];
    for (i, fall) in falls.iter().enumerate() {
        let slope = fall * depth / contact.row.length;
        let state = if slope > SLOPE_FACTOR * libm::tan(TILT_MAX_RAD) {
            None
        } else {
            converged_contact(contact, depth - slope * to, slope)
        };
        let state = state.filter(|state| is_tabulated(contact, state));
        if state.is_none() && solved[0] < solved[1] {
            // All further falls are steeper, so none of them has a solution either.
            table.forces.resize(forces + falls.len(), 0.0);
            table.differences.resize(differences + falls.len() * per, 0.0);
            break;
        }
        let Some(state) = state else {
            solved = [i + 1, i + 1];
            table.forces.push(0.0);
            table.differences.resize(table.differences.len() + per, 0.0);
            continue;
        };
        solved[1] = i + 1;
        let t = contact.row.layer.thickness_mm;
        table.forces.push(libm::log(state.force_n / (contact.row.modulus_mpa() * t * t)));
        table.residual = table.residual.max(state.residual);
        append_differences(table, contact, depth);
    }
    if solved[1] - solved[0] >= FALLS_MIN {
        table.depths.push(libm::log(depth));
        table.solved.push(solved);
        return true;
    }
    table.forces.truncate(forces);
    table.differences.truncate(differences);
    table.depths.is_empty()
}

/// Whether a contact can stand in the table: it has enough slices, and its row holds it.
fn is_tabulated(contact: &RowContact, state: &PinState) -> bool {
    let slices = contact.row.along.len();
    let touching = (0..slices).filter(|j| contact.state.touches(*j)).count();
    let is_full = contact.row.is_partial && contact.state.touches(0);
    !is_full && touching >= SLICES_MIN && state.force_n > 0.0
}

/// Appends the differences of the row's contact from plane slices.
fn append_differences(table: &mut FullLengthTable, contact: &RowContact, depth: f64) {
    let (row, state) = (&contact.row, &contact.state);
    let n = state.layout.cosines;
    let mut plane = [0.0; COSINES_MAX];
    let start = table.differences.len();
    table.differences.resize(start + table.interpolated.len(), 0.0);
    let appended = &mut table.differences[start..];
    let (mut off, mut rate) = (0.0, 0.0);
    let mut own = [0.0; COSINES_MAX];
    // From the deeper end; beyond the contact the differences are extrapolated.
    for (j, differences) in appended.chunks_exact_mut(n + 1).enumerate().rev() {
        if state.touches(j) {
            let now = (state.effective[j] - state.given[j]) / depth;
            rate = if j + 1 < state.active.len() { now - off } else { 0.0 };
            off = now;
            let effective = state.effective[j];
            let half_width = row.strips.half_width(effective);
            let least = REFERENCE_DEPTH_MIN * depth;
            let scale = row.strips.plane_pressure(effective, half_width, least, &mut plane[..n]);
            let pressure = state.a[j * n..(j + 1) * n].iter().zip(&plane);
            own.iter_mut().zip(pressure).for_each(|(own, (a, p))| *own = (a - p) / scale);
        } else {
            off += rate;
        }
        differences[0] = off;
        differences[1..].copy_from_slice(&own[..n]);
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::super::layer::Layer;
    use super::super::super::super::{Accuracy, Prescribed};
    use super::super::super::{Pin, Profile};
    use super::StepLimits;

    /// Compares contacts from the table with free-boundary steps on the same slices, and checks
    /// that no contact depends on earlier ones.
    #[test]
    fn contacts_from_the_table_equal_those_of_a_search() {
        let mut read = 0;
        for (t, nu, radius_mm, half_mm) in [
            (0.8, 0.5, 4.0, 6.0),
            (0.8, 0.49, 23.0, 12.5),
            (1.6, 0.0, 40.0, 3.0),
            (2.2, 0.3, 9.0, 2.0),
            (0.4, 0.45, 30.0, 15.0),
        ] {
            let layer = Layer::new(t, 27.58, nu).expect("a sound layer");
            let profile = Profile::Cylinder { radius_mm };
            let made = Pin::new(&layer, profile, [-half_mm, half_mm], 0.2 * t, Accuracy::Fast);
            let mut tabled = made.expect("a pin");
            tabled.rows_mut().end_table = None;
            let mut searched = tabled.clone();
            for contact in &mut searched.rows_mut().rows {
                assert!(contact.tables.full_length.take().is_some() || contact.row.length < 6.0);
                contact.nonlinear.limits = StepLimits { tolerance: 1e-4, steps: 60 };
                contact.nonlinear.enable_relaxation();
            }
            for (depth, fall) in [0.17, 0.11, 0.06, 0.02, 0.01]
                .into_iter()
                .flat_map(|depth| [0.0, 0.11, 0.43, 0.97, 1.29, 2.4, 5.2].map(|fall| (depth, fall)))
            {
                let slope = fall * depth * t / (2.0 * half_mm);
                let deep = Prescribed::PenetrationMm(depth * t - slope * half_mm);
                let tilt_rad = -libm::atan(slope);
                searched.release();
                tabled.release();
                if slope > 0.2 {
                    continue;
                }
                let a = tabled.press(deep, tilt_rad).expect("a contact");
                if a.steps > 1 {
                    continue;
                }
                read += 1;
                let b = searched.press(deep, tilt_rad).expect("a contact");
                let off = (a.force_n / b.force_n - 1.0).abs();
                assert!(off < 4e-3 && a.force_n > 0.0, "{t} {depth} {fall}: {a:?} {b:?}");
                let arm = (a.moment_n_mm / a.force_n - b.moment_n_mm / b.force_n).abs();
                assert!(arm < 0.008, "{t} {depth} {fall}: {a:?} {b:?}");
                let loaded = Prescribed::ForceN(a.force_n);
                let again = tabled.press(loaded, tilt_rad).expect("a contact");
                let back = (again.penetration_mm - a.penetration_mm).abs();
                assert!(back < 4e-3 * depth * t, "{t} {depth} {fall}: {a:?} {again:?}");
                tabled.press(Prescribed::ForceN(5.0), 0.001).expect("another contact");
                assert_eq!(tabled.press(deep, tilt_rad).expect("a contact"), a);
            }
        }
        assert!(read > 140, "{read}");
    }

    /// A depth at which some contacts have no solution does not prevent those of other depths from
    /// being found.
    #[test]
    fn a_force_is_found_though_a_shallow_depth_lacks_flat_contacts() {
        let layer = Layer::new(1.5347918953746555, 27.58, 0.5).expect("a sound layer");
        let profile = Profile::Cylinder { radius_mm: 7.9562116879969835 };
        let half = 14.528183864429593;
        let made = Pin::new(&layer, profile, [-half, half], 0.2550155, Accuracy::Fast);
        let mut pin = made.expect("a pin");
        let table = pin.rows_mut().rows[0].tables.full_length.as_mut().expect("tables");
        table.solved[8][0] = 2;
        for (delta, tilt_rad) in [(0.107, -0.0014), (0.05, 0.0), (0.02, 0.0011), (0.004, 0.001)] {
            let deep = pin.press(Prescribed::PenetrationMm(delta), tilt_rad).expect("a contact");
            let loaded = pin.press(Prescribed::ForceN(deep.force_n), tilt_rad).expect("a contact");
            assert_eq!([deep.steps, loaded.steps], [1, 1], "{delta}");
            let off = (loaded.penetration_mm - delta).abs();
            assert!(off < 3e-3 * (delta + half * tilt_rad.abs()), "{deep:?} {loaded:?}");
        }
    }
}
