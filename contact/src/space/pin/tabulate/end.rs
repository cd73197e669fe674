//! Solves the contacts of a cylinder on its end.

use super::super::contact::{ROW_FILL_MIN, RowContact, shortest_row_for};
use super::super::end_contact::warm_start;
use super::super::solve::solve;
use super::super::tables::end::{
    EndContact, EndTable, OVERLAP_MIN, OVERLAP_PART, OVERLAP_RATIO, PROFILE_PLACES, ROW_LENGTH_MAX,
    SLOPE_MAX, SLOPE_RATIO, WidthProfile,
};
use super::super::target::Target;

/// Depths of tabulated contacts, in parts of the deepest penetration asked for.
const DEPTH_RANGE: [f64; 2] = [0.001, 1.6];
/// Fewest slices of a tabulated contact, its largest residual, and most rows tried for it.
const SLICES_MIN: usize = 4;
const RESIDUAL_MAX: f64 = 1e-2;
const ROWS_MAX: usize = 4;

/// Overlap and slope that determine a contact on an end.
#[derive(Clone, Copy, Debug)]
struct EndPose {
    /// Length in thicknesses on which the rigid pin overlaps the layer.
    overlap: f64,
    slope: f64,
}

/// Solves the contacts of rows that end at `to`, the whole pin first and each shorter than the one
/// before; allocates. Absent when no row is short enough.
pub(in super::super) fn end_table(
    rows: &mut [RowContact],
    to: f64,
    deepest: f64,
) -> Option<EndTable> {
    let lengths = rows[1..].iter().map(|contact| contact.row.length);
    let longest = OVERLAP_PART * { lengths }.find(|length| *length <= ROW_LENGTH_MAX)?;
    let count = |from: f64, to: f64, step: f64| {
        libm::ceil(libm::log(from / to) / libm::log(step)).max(1.0) as usize + 1
    };
    let [least, most] = DEPTH_RANGE.map(|part| part * deepest);
    let overlaps = count(longest, OVERLAP_MIN, OVERLAP_RATIO);
    let slopes = count(SLOPE_MAX, least / longest, SLOPE_RATIO);
    let mut solved: Vec<Option<EndContact>> = Vec::with_capacity(overlaps * slopes);
    for r in 0..overlaps {
        let overlap = longest * libm::pow(OVERLAP_RATIO, -(r as f64));
        for q in 0..slopes {
            let slope = SLOPE_MAX * libm::pow(SLOPE_RATIO, -(q as f64));
            let is_wanted = (least..=most).contains(&(overlap * slope));
            // The contact of the same slope at the next longer overlap, whose depth is the same
            // part of its overlap.
            let near = r.checked_sub(1).and_then(|r| solved[r * slopes + q]);
            let pose = EndPose { overlap, slope };
            solved.push(if is_wanted { end_contact(rows, pose, to, near) } else { None });
        }
    }
    rows.iter_mut().for_each(RowContact::release);
    Some(EndTable { longest, slopes, solved })
}

/// The contact of the end at `to`, found by the search on a row that suits it; a contact nearby
/// tells which, and gives the widths to start from.
fn end_contact(
    rows: &mut [RowContact],
    pose: EndPose,
    to: f64,
    near: Option<EndContact>,
) -> Option<EndContact> {
    let EndPose { overlap, slope } = pose;
    let near = near.map(|near| WidthProfile {
        reach: near.reach * overlap,
        depth: overlap * slope,
        profile: near.profile,
    });
    let length = near.map_or(overlap, |near| near.reach);
    let mut at = shortest_row_for(rows, length).max(1);
    let mut found = None;
    for _ in 0..ROWS_MAX {
        rows[at].release();
        let Some(solved) = contact_on_row(&mut rows[at], pose, to, near.as_ref()) else {
            if found.is_some() || at == 1 {
                break;
            }
            at -= 1;
            continue;
        };
        let length = solved.reach * overlap;
        found = Some(solved);
        let shorter = shortest_row_for(rows, length);
        if length >= ROW_FILL_MIN * rows[at].row.length || shorter <= at {
            break;
        }
        at = shorter;
    }
    found
}

/// The contact on one row; absent where it has no solution or does not fit the table.
fn contact_on_row(
    contact: &mut RowContact,
    pose: EndPose,
    to: f64,
    near: Option<&WidthProfile>,
) -> Option<EndContact> {
    let EndPose { overlap, slope } = pose;
    let depth = slope * overlap;
    let target = Target::at_penetration(depth - slope * to);
    if let Some(near) = near {
        warm_start(contact, near, to, slope);
    }
    let state = match solve(contact, None, target, slope) {
        Err(_) if near.is_some() => {
            contact.release();
            solve(contact, None, target, slope)
        }
        outcome => outcome,
    };
    let state = state.ok()?;
    let (row, slices) = (&contact.row, &contact.state);
    let touching: Vec<SliceWidth> = (0..row.along.len())
        .rev()
        .filter(|j| slices.touches(*j))
        .map(|j| SliceWidth {
            distance: to - row.along[j],
            penetration: slices.effective[j] / depth,
        })
        .collect();
    let is_unfit = slices.touches(0) || touching.len() < SLICES_MIN;
    if is_unfit || state.residual > RESIDUAL_MAX || state.force_n <= 0.0 {
        return None;
    }
    let (reach, profile) = width_profile(&touching, row.h)?;
    let t = row.layer.thickness_mm;
    let force = libm::log(state.force_n / (row.modulus_mpa() * t * t));
    Some(EndContact { force, reach: reach / overlap, profile })
}

/// Width of a slice in contact.
#[derive(Clone, Copy, Debug)]
struct SliceWidth {
    /// Distance from the end, thicknesses.
    distance: f64,
    /// Penetration that the width belongs to, in depths.
    penetration: f64,
}

/// The length of a contact and its profile of widths, from its slices of length `h`.
fn width_profile(touching: &[SliceWidth], h: f64) -> Option<(f64, [f64; PROFILE_PLACES])> {
    // It ends where the penetrations of the last slices extrapolate to zero.
    let [.., before, last] = *touching else { return None };
    let fall = (before.penetration - last.penetration) / (last.distance - before.distance);
    let reach = last.distance + (last.penetration / fall.max(f64::MIN_POSITIVE)).clamp(0.3 * h, h);
    let mut profile = [0.0; PROFILE_PLACES];
    for (p, value) in profile[..PROFILE_PLACES - 1].iter_mut().enumerate() {
        let distance = reach * p as f64 / (PROFILE_PLACES - 1) as f64;
        let after = touching.iter().position(|slice| slice.distance > distance);
        let (a, b) = match after.unwrap_or(touching.len()) {
            0 => (touching[0], touching[1]),
            n if n == touching.len() => {
                (touching[n - 1], SliceWidth { distance: reach, penetration: 0.0 })
            }
            n => (touching[n - 1], touching[n]),
        };
        let part = (b.penetration - a.penetration) * (distance - a.distance);
        *value = (a.penetration + part / (b.distance - a.distance)).max(0.0);
    }
    Some((reach, profile))
}

#[cfg(test)]
mod tests {
    use super::super::super::super::super::layer::Layer;
    use super::super::super::super::{Accuracy, Prescribed};
    use super::super::super::{Pin, Profile};

    /// Compares contacts whose widths are read with free-boundary steps on the same slices, and
    /// checks that no contact depends on earlier ones. Returns how many contacts were read.
    fn compare(nu: f64, radius_mm: f64, level: Accuracy, poses: &[(f64, f64)]) -> usize {
        let layer = Layer::new(0.8, 27.58, nu).expect("a sound layer");
        let profile = Profile::Cylinder { radius_mm };
        let mut tabled = Pin::new(&layer, profile, [-8.0, 8.0], 0.2, level).expect("a pin");
        let mut searched = tabled.clone();
        assert!(searched.rows_mut().end_table.take().is_some());
        let mut read = 0;
        for (depth_mm, tilt_rad) in poses {
            let delta = depth_mm - 8.0 * libm::tan(*tilt_rad).abs();
            let deep = Prescribed::PenetrationMm(delta);
            searched.release();
            let a = tabled.press(deep, *tilt_rad).expect("a contact");
            let b = searched.press(deep, *tilt_rad).expect("a contact");
            let off = (a.force_n / b.force_n - 1.0).abs();
            assert!(off < 5e-3 && a.force_n > 0.0, "{nu} {depth_mm}: {a:?} {b:?}");
            let arm = (a.moment_n_mm / a.force_n - b.moment_n_mm / b.force_n).abs();
            assert!(arm < 0.005, "{nu} {depth_mm}: {a:?} {b:?}");
            let loaded = Prescribed::ForceN(a.force_n);
            let again = tabled.press(loaded, *tilt_rad).expect("a contact");
            assert!((again.penetration_mm - delta).abs() < 4e-3 * depth_mm, "{a:?} {again:?}");
            tabled.press(Prescribed::ForceN(5.0), 0.001).expect("another contact");
            assert_eq!(tabled.press(deep, *tilt_rad).expect("a contact"), a);
            read += usize::from(a.steps == 1);
        }
        read
    }

    #[test]
    fn contacts_from_the_table_equal_those_of_a_search() {
        let poses = [(0.06, 0.19), (0.02, -0.11), (0.1, 0.05), (0.03, 0.02), (0.05, -0.016)];
        for (nu, radius_mm) in [(0.5, 4.0), (0.49, 23.0), (0.0, 40.0)] {
            assert_eq!(compare(nu, radius_mm, Accuracy::Fast, &poses), 5, "{nu} {radius_mm}");
        }
    }

    /// The default level reads the widths of the coarse slices and solves the pressure on its fine
    /// slices.
    #[test]
    fn the_default_level_reads_them_too() {
        let poses = [(0.06, 0.19), (0.02, -0.11)];
        assert_eq!(compare(0.49, 23.0, Accuracy::Default, &poses), 2);
    }
}
