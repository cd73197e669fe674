//! The point loads that stand for a contact in the image of the fast level. They lie on lines
//! across the pin, at equal distances along it. Neighbouring lines hold alternate points of one
//! rule, so that half of the points suppress the ripple of their spacing at the base as well as all
//! points would. The force of a slice is spread over the lines in the way in which the slices act
//! on each other ([`super::spread_loads`]): a triangle of two lengths, put on the lines by weights
//! that keep its moments.

use super::contact::RowContact;
use super::point_rule::{POINTS_MAX, points_for};
use super::row::SliceRow;
use super::state::ContactState;
use super::strip::COSINES_MAX;
use core::f64::consts::PI;

/// Distance of two lines, times the wave number up to which they stand for the pressure.
const SPACING_TIMES_CUTOFF: f64 = 3.6;
/// Largest tactel (thicknesses) that resolves as short a wave as a point of the base does.
const POINT_TACTEL: f64 = 0.26;
/// Least wave number (times thickness) of an image's points.
const CUTOFF_MIN: f64 = 3.0;
/// Distance from the ends of the contact, in thicknesses, up to which lines hold all points.
const FULL_RULE_DISTANCE: f64 = 0.8;
/// Factor by which lines of two slices may exceed the wanted distance.
const PAIR_SPACING_FACTOR: f64 = 1.15;
/// Fewest lines in a pattern of one line per two slices.
const PAIR_LINES_MIN: usize = 24;

/// How lines lie among slices: their places, in slices from the middle of one; after how many
/// slices the pattern repeats; and the weight on a line of the slice at each distance from it.
struct LinePattern {
    step: usize,
    lines: &'static [(f64, &'static [(isize, f64)])],
    /// Number of slices beyond the ends of the contact that still have lines.
    beyond: isize,
}

impl LinePattern {
    /// Distance of neighbouring lines among slices of a length.
    fn spacing(&self, h: f64) -> f64 {
        h * self.step as f64 / self.lines.len() as f64
    }
}

/// A line for each slice.
const LINE_PER_SLICE: LinePattern = LinePattern {
    step: 1,
    lines: &[(0.0, &[(-1, 1.0 / 12.0), (0, 10.0 / 12.0), (1, 1.0 / 12.0)])],
    beyond: 1,
};
/// Two lines in each slice.
const TWO_LINES_PER_SLICE: LinePattern = LinePattern {
    step: 1,
    lines: &[
        (-0.25, &[(0, 19.0 / 48.0), (-1, 5.0 / 48.0)]),
        (0.25, &[(0, 19.0 / 48.0), (1, 5.0 / 48.0)]),
    ],
    beyond: 1,
};
/// A line for two slices, by cubics.
const LINE_PER_SLICE_PAIR: LinePattern = LinePattern {
    step: 2,
    lines: &[(
        0.0,
        &[
            (-3, -5.0 / 96.0),
            (-2, 1.0 / 48.0),
            (-1, 53.0 / 96.0),
            (0, 23.0 / 24.0),
            (1, 53.0 / 96.0),
            (2, 1.0 / 48.0),
            (3, -5.0 / 96.0),
        ],
    )],
    beyond: 3,
};

/// Calls with place (across, along) in mm and force in N of point loads that stand for the contact
/// up to a wave number (times thickness), line after line. Slices are left out that are not `seen`,
/// which is asked with their middle along the axis and their extent about it, mm.
pub(super) fn line_loads(
    contact: &RowContact,
    cutoff: f64,
    seen: impl Fn([f64; 2]) -> bool,
    mut of: impl FnMut([f64; 2], f64),
) {
    let (row, state) = (&contact.row, &contact.state);
    let (t, n) = (row.layer.thickness_mm, state.layout.cosines);
    let Some([first, last]) = state.contact_range() else { return };
    let pattern = line_pattern(row, cutoff, last - first + 1);
    let (from, to) = (first as isize - pattern.beyond, last as isize + pattern.beyond);
    let count = ((to - from) as usize / pattern.step + 1) * pattern.lines.len();
    // One rule for all lines: with different rules the points of neighbours could coincide.
    let widest = (first..=last).map(|j| state.slice(j).0).fold(0.0, f64::max);
    let rule = &row.rules[points_for(cutoff, widest).min(row.rules.len()) - 1];
    let points = rule.places.len();
    let each = 0.5 * PI * row.modulus_mpa() * t * t * row.h / points as f64;
    let spacing = pattern.spacing(row.h);
    let whole = libm::ceil(FULL_RULE_DISTANCE / spacing) as usize;
    let mut sum = [0.0; COSINES_MAX];
    let mut psi = [0.0; POINTS_MAX];
    for line in 0..count {
        let (place, weights) = pattern.lines[line % pattern.lines.len()];
        let slice = from + (line / pattern.lines.len() * pattern.step) as isize;
        let v = row.along[0] + row.h * (slice as f64 + place);
        let own = slice.clamp(first as isize, last as isize) as usize;
        let b = state.slice(own).0;
        if !seen([v * t, b * t]) || !sum_slices(state, slice, weights, &mut sum[..n]) {
            continue;
        }
        // Near an end a line holds all points, since the line beyond it is missing.
        let more = match line.min(count - 1 - line).saturating_sub(whole) {
            0 => 0.0,
            1 => 0.25,
            2 => 0.75,
            _ => 1.0,
        };
        let mut sides = if line % 2 == 0 { [b * t, -b * t] } else { [-b * t, b * t] };
        for (place, psi) in rule.at(&sum[..n], &mut psi) {
            of([sides[0] * place, v * t], (1.0 + more) * each * psi);
            if more < 1.0 {
                of([sides[1] * place, v * t], (1.0 - more) * each * psi);
            }
            sides.swap(0, 1);
        }
    }
}

/// Distance of neighbouring lines (thicknesses) that stand for wave numbers up to `cutoff`; 0
/// without contact.
pub(super) fn line_spacing(contact: &RowContact, cutoff: f64) -> f64 {
    let row = &contact.row;
    contact
        .state
        .contact_range()
        .map_or(0.0, |[first, last]| line_pattern(row, cutoff, last - first + 1).spacing(row.h))
}

/// The pattern of lines that stand for wave numbers up to `cutoff`, on so many slices in contact.
fn line_pattern(row: &SliceRow, cutoff: f64, slices: usize) -> &'static LinePattern {
    let wanted = SPACING_TIMES_CUTOFF / cutoff;
    if row.h > wanted {
        &TWO_LINES_PER_SLICE
    } else if 2.0 * row.h <= PAIR_SPACING_FACTOR * wanted && slices >= 2 * PAIR_LINES_MIN {
        &LINE_PER_SLICE_PAIR
    } else {
        &LINE_PER_SLICE
    }
}

/// Sums the weighted cosines of the slices around one; returns whether any of them is in contact.
fn sum_slices(
    state: &ContactState,
    slice: isize,
    weights: &[(isize, f64)],
    sum: &mut [f64],
) -> bool {
    sum.fill(0.0);
    let mut any = false;
    for (further, weight) in weights {
        let at = usize::try_from(slice + further);
        let at = at.ok().filter(|j| *j < state.active.len() && state.touches(*j));
        if let Some(j) = at {
            let (_, a) = state.slice(j);
            sum.iter_mut().zip(a).for_each(|(sum, a)| *sum += weight * a);
            any = true;
        }
    }
    any
}

/// Wave number (times thickness) up to which the points of an image stand for the pressure, for
/// tactels of `pitch_mm`; `finest` is that for a point of the base. A wave is attenuated at the
/// base the more the shorter it is, and the mean over a tactel attenuates it further.
pub(super) fn image_cutoff(row: &SliceRow, finest: f64, pitch_mm: Option<f64>) -> f64 {
    let tactel = pitch_mm.map_or(POINT_TACTEL, |pitch| pitch / row.layer.thickness_mm);
    (finest - libm::log(tactel.max(POINT_TACTEL) / POINT_TACTEL)).max(CUTOFF_MIN)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The loads of one slice on all lines sum to its force, have its middle as centroid, and have
    /// the second moment of a triangle of two slice lengths.
    #[test]
    fn patterns_keep_the_moments_of_a_slice() {
        for pattern in [&LINE_PER_SLICE, &TWO_LINES_PER_SLICE, &LINE_PER_SLICE_PAIR] {
            for slice in 0..pattern.step as isize {
                let mut moments = [0.0; 4];
                for base in (-12..=12).step_by(pattern.step) {
                    for (place, weights) in pattern.lines {
                        let at = base as f64 + place - slice as f64;
                        for (_, weight) in weights.iter().filter(|(k, _)| base + k == slice) {
                            for (power, moment) in moments.iter_mut().enumerate() {
                                *moment += weight * libm::pow(at, power as f64);
                            }
                        }
                    }
                }
                let exact = [1.0, 0.0, 1.0 / 6.0, 0.0];
                let off = moments.iter().zip(exact).map(|(a, b)| (a - b).abs());
                assert!(off.fold(0.0, f64::max) < 1e-12, "{}: {moments:?}", pattern.step);
                let further = pattern.lines.iter().flat_map(|(_, weights)| weights.iter());
                assert_eq!(further.map(|(k, _)| k.abs()).max(), Some(pattern.beyond));
            }
        }
    }
}
