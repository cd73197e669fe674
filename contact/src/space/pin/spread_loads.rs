//! The point loads that stand for slices in images that have to be right to a part in a thousand.
//! The coupling of two slices is a mean over the length of both, as if the force of a slice were
//! spread over its length twice: a triangle of two slice lengths. A point load in the middle of the
//! slice would therefore misplace the ends of a pin by an error of the order of the square of the
//! slice length. The force of a slice is divided between its middle and the middles of its
//! neighbours, so that the loads have the moments of the triangle.

use super::contact::RowContact;
use super::point_rule::{POINTS_MAX, points_for};
use super::row::SliceRow;
use super::strip::COSINES_MAX;
use super::tables::end_correction::HALVED_SLICE_LENGTH;
use core::f64::consts::PI;

/// Near ends, slices longer than `HALVED_SLICE_LENGTH` have loads between their middles, too: with
/// all of their share up to the first distance from an end (thicknesses), with less and less of it
/// from there to the second.
const END_DISTANCES: [f64; 2] = [4.5, 9.5];
/// Away from ends, slices have loads between them if their wave number exceeds that of the image by
/// less than this.
const WAVE_NUMBER_MARGIN: f64 = 1.6;
/// Neighbours share their points if their half-widths (thicknesses) differ by less than this.
const SHARED_WIDTH_DIFFERENCE: f64 = 0.1;
/// Factor of the wave numbers for the points of an end correction, which is small.
const CORRECTION_CUTOFF_FACTOR: f64 = 0.7;

/// Parts of a slice's force on its middle, half way to each neighbour's, and on each of those: they
/// have the triangle's moments up to the third. Without loads half way (`halved` is 0) the loads
/// are a slice apart, and the image shows a wave of that length where slices are long. With them
/// (`halved` is 1) both halves have the same force, and that wave vanishes.
fn shares(halved: f64) -> [f64; 3] {
    [5.0 / 6.0 - 0.375 * halved, 0.25 * halved, 1.0 / 12.0 - 0.0625 * halved]
}

/// Places along the row of the loads that stand for a slice at `v` of length `h` near an end, and
/// the parts of its force there.
pub(super) fn end_spread(v: f64, h: f64) -> [(f64, f64); 5] {
    let [own, between, beside] = shares(if h > HALVED_SLICE_LENGTH { 1.0 } else { 0.0 });
    let half = 0.5 * h;
    [(v, own), (v - half, between), (v + half, between), (v - h, beside), (v + h, beside)]
}

/// Whether the points of a contact up to a wave number (times thickness) lie between slices, too,
/// away from ends.
pub(super) fn has_halved_spacing(row: &SliceRow, cutoff: f64) -> bool {
    row.h > HALVED_SLICE_LENGTH && 2.0 * PI / row.h < cutoff + WAVE_NUMBER_MARGIN
}

/// Calls with place (across, along) in mm and force in N of point loads that stand for the contact
/// up to a wave number (times thickness), slice after slice. Slices are left out that are not
/// `seen`, which is asked with their middle along the axis and their extent about it, mm.
pub(super) fn spread_loads(
    contact: &RowContact,
    cutoff: f64,
    seen: impl Fn([f64; 2]) -> bool,
    mut of: impl FnMut([f64; 2], f64),
) {
    let RowContact { row, state, tables, .. } = contact;
    let (t, n) = (row.layer.thickness_mm, state.layout.cosines);
    let mut room = [[0.0; COSINES_MAX]; 2];
    let [sum, joint] = room.each_mut().map(|room| &mut room[..n]);
    let slices = row.along.len();
    let strip = |half_width: f64, along: f64| StripPlace { half_width, along };
    for j in (0..slices).filter(|j| state.touches(*j)) {
        let (b, own) = state.slice(j);
        let v = row.along[j];
        if !seen([v * t, (b + row.h) * t]) {
            continue;
        }
        let [middle, between, beside] = slice_shares(row, j, cutoff);
        sum.iter_mut().zip(own).for_each(|(sum, a)| *sum = middle * a);
        let sides = [(j.checked_sub(1), -row.h), ((j + 1 < slices).then_some(j + 1), row.h)];
        for (neighbour, away) in sides {
            let touching = neighbour.filter(|i| state.touches(*i));
            let is_near = |i: &usize| (state.slice(*i).0 - b).abs() < SHARED_WIDTH_DIFFERENCE;
            let place = v + 0.5 * away;
            let Some(i) = touching.filter(is_near) else {
                strip_points(contact, strip(b, v + away), own, beside, cutoff, &mut of);
                if between > 0.0 {
                    strip_points(contact, strip(b, place), own, between, cutoff, &mut of);
                }
                continue;
            };
            let ((width, a), [_, half, part]) = (state.slice(i), slice_shares(row, i, cutoff));
            sum.iter_mut().zip(a).for_each(|(sum, a)| *sum += part * a);
            // The load between two slices stands for both, so it is added once.
            if i > j && between + half > 0.0 {
                let both = own.iter().zip(a).map(|(own, a)| between * own + half * a);
                joint.iter_mut().zip(both).for_each(|(joint, both)| *joint = both);
                let middle = strip(0.5 * (b + width), place);
                strip_points(contact, middle, joint, 1.0, cutoff, &mut of);
            }
        }
        strip_points(contact, strip(b, v), sum, 1.0, cutoff, &mut of);
    }
    if let Some(correction) = &tables.end_correction {
        let cutoff = CORRECTION_CUTOFF_FACTOR * cutoff;
        correction.for_each_load(row, state, |load| {
            let place = strip(load.half_width, load.along);
            strip_points(contact, place, load.cosines, 1.0 / row.h, cutoff, &mut of);
        });
    }
}

/// Shares of a slice in an image up to a wave number.
fn slice_shares(row: &SliceRow, slice: usize, cutoff: f64) -> [f64; 3] {
    let away = slice.min(row.along.len() - 1 - slice) as f64 * row.h;
    let [all, none] = END_DISTANCES;
    shares(match row.h > HALVED_SLICE_LENGTH {
        true if has_halved_spacing(row, cutoff) || away < all => 1.0,
        true if away < none => 0.5 + 0.5 * libm::cos(PI * (away - all) / (none - all)),
        _ => 0.0,
    })
}

/// Half-width of a strip and its place along the row, thicknesses.
#[derive(Clone, Copy, Debug)]
struct StripPlace {
    half_width: f64,
    along: f64,
}

/// Calls with the points that stand for a part of some cosines on a strip, up to a wave number.
fn strip_points(
    contact: &RowContact,
    place: StripPlace,
    cosines: &[f64],
    part: f64,
    cutoff: f64,
    of: &mut impl FnMut([f64; 2], f64),
) {
    let (row, StripPlace { half_width, along }) = (&contact.row, place);
    let t = row.layer.thickness_mm;
    let least = contact.state.layout.cosines / 2 + 1;
    let points = points_for(cutoff, half_width).max(least).min(row.rules.len());
    let scale = part * 0.5 * PI * row.modulus_mpa() * t * t * row.h / points as f64;
    let mut psi = [0.0; POINTS_MAX];
    for (place, psi) in row.rules[points - 1].at(cosines, &mut psi) {
        let (u, force) = (half_width * place * t, scale * psi);
        of([u, along * t], force);
        of([-u, along * t], force);
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::layer::Layer;
    use super::super::super::radial::Influence;
    use super::super::super::tactels::{Array, Fineness, Sampling, Shares};
    use super::super::super::{Accuracy, Prescribed};
    use super::super::{Pin, PlanarPose, Profile};

    /// Compares the image by fewer points, without loads far from the tactels, with the image by
    /// all points.
    #[test]
    fn large_tactels_need_fewer_points() {
        let mut fewest = 1.0_f64;
        for (t, nu, radius_mm, pitch_mm) in [
            (0.3, 0.5, 45.0, 1.5875),
            (0.8, 0.45, 45.0, 1.5875),
            (2.0, 0.49, 45.0, 1.5875),
            (0.8, 0.3, 10.0, 0.4),
            (2.0, 0.49, 10.0, 0.5),
        ] {
            let layer = Layer::new(t, 27.58, nu).expect("a sound layer");
            let influence = Influence::new(&layer).expect("a layer");
            let array = Array { rows: 16, cols: 16, pitch_mm };
            let shares = Shares::new(&influence, &array, Sampling::Area, Fineness::DEFAULT);
            let shares = shares.expect("tables");
            let profile = Profile::Cylinder { radius_mm };
            let half = 8.0 * pitch_mm + 15.0 * t;
            let made = Pin::new(&layer, profile, [-half, 0.3 * half], 0.25 * t, Accuracy::Default);
            let mut pin = made.expect("a pin");
            pin.press(Prescribed::PenetrationMm(0.2 * t), 0.0).expect("a contact");
            let pose = PlanarPose { x_mm: 0.1, y_mm: -0.2, rot_rad: 0.3 };
            let (s, c) = (libm::sin(pose.rot_rad), libm::cos(pose.rot_rad));
            let (mut image, mut exact) = (vec![0.0; 256], vec![0.0; 256]);
            let (mut seen, mut all) = (0, 0);
            pin.image(&shares, pose, &mut image);
            pin.seen_loads(&shares, pose, |_, _| seen += 1);
            pin.loads(|[u, v], force| {
                let place = [pose.x_mm + u * c - v * s, pose.y_mm + u * s + v * c];
                shares.add(&mut exact, place, force);
                all += 1;
            });
            let peak = exact.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
            for (a, b) in image.iter().zip(&exact) {
                assert!((a - b).abs() < 1.5e-4 * peak, "{t} {pitch_mm}: {a} {b}");
            }
            fewest = fewest.min(f64::from(seen) / f64::from(all));
        }
        assert!(fewest < 0.75, "{fewest}");
    }
}
