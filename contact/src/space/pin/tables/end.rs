//! The table of the contacts of a cylinder on its end. As long as the other end is out of contact,
//! two numbers determine such a contact: the depth of the end and the slope. The table holds
//! contacts over both: their length, the penetration that the width at each place belongs to, and
//! the force. A contact is found by interpolating the widths and solving the pressure at them once;
//! force and image are of second order in the error of the widths. Finer slices read the widths of
//! coarser ones.
//!
//! What lies outside the table, and contacts with slices in tension, are left to the iterative
//! solution.

use super::super::target::Target;

/// Longest overlap in the table, thicknesses, as a part of a row no longer than this length.
pub(crate) const ROW_LENGTH_MAX: f64 = 6.0;
pub(crate) const OVERLAP_PART: f64 = 0.85;
/// Shortest overlap in the table, thicknesses, and the ratio of one overlap to the next.
pub(crate) const OVERLAP_MIN: f64 = 0.0025;
pub(crate) const OVERLAP_RATIO: f64 = core::f64::consts::SQRT_2;
/// Steepest slope in the table, a little above that of the steepest tilt, and the ratio of one
/// slope to the next.
pub(crate) const SLOPE_MAX: f64 = 0.2035;
pub(crate) const SLOPE_RATIO: f64 = 1.6;
/// Places of a width profile, from the end to where the contact ends.
pub(crate) const PROFILE_PLACES: usize = 13;

/// A tabulated contact, relative to its depth or its overlap.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EndContact {
    /// Logarithm of the force in units of the kernels.
    pub(crate) force: f64,
    /// Length of the contact over the overlap.
    pub(crate) reach: f64,
    /// Penetration that the width belongs to, over the depth, from the end to the reach.
    pub(crate) profile: [f64; PROFILE_PLACES],
}

/// Contacts on an end, by overlap and slope.
#[derive(Clone, Debug)]
pub(crate) struct EndTable {
    /// The longest overlap.
    pub(crate) longest: f64,
    pub(crate) slopes: usize,
    /// Slope after slope from the steepest, overlap after overlap from the longest.
    pub(crate) solved: Vec<Option<EndContact>>,
}

/// The profile of widths at which a contact is solved, over the distance from the end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WidthProfile {
    /// Where the contact ends, thicknesses from the end.
    pub(crate) reach: f64,
    pub(crate) depth: f64,
    pub(crate) profile: [f64; PROFILE_PLACES],
}

impl WidthProfile {
    /// Penetration that the width at a distance from the end belongs to; 0 where nothing touches.
    pub(crate) fn at(&self, distance: f64) -> f64 {
        let place = distance / self.reach * (PROFILE_PLACES - 1) as f64;
        if place.is_nan() || place >= (PROFILE_PLACES - 1) as f64 {
            return 0.0;
        }
        let cell = place as usize;
        let part = place - cell as f64;
        self.depth * (self.profile[cell] * (1.0 - part) + self.profile[cell + 1] * part)
    }
}

/// A geometric sequence of numbers, from the largest.
#[derive(Clone, Copy, Debug)]
struct Scale {
    largest: f64,
    /// Ratio of each number to the next one.
    ratio: f64,
}

const SLOPE_SCALE: Scale = Scale { largest: SLOPE_MAX, ratio: SLOPE_RATIO };

impl EndTable {
    fn overlap_scale(&self) -> Scale {
        Scale { largest: self.longest, ratio: OVERLAP_RATIO }
    }

    /// The cell that a number lies in, counted from the largest, and the part of the way to the
    /// next one; absent outside.
    fn cell(value: f64, scale: Scale, count: usize) -> Option<(usize, f64)> {
        let place = libm::log(scale.largest / value) / libm::log(scale.ratio);
        let inside = place >= 0.0 && place <= (count - 1) as f64 && count > 1;
        let cell = (place as usize).min(count.saturating_sub(2));
        inside.then_some((cell, place - cell as f64))
    }

    /// The widths of a contact of a depth under a slope.
    pub(crate) fn widths(&self, depth: f64, slope: f64) -> Option<WidthProfile> {
        let (overlap, overlaps) = (depth / slope, self.solved.len() / self.slopes);
        let (r, across) = Self::cell(overlap, self.overlap_scale(), overlaps)?;
        let (q, flatter) = Self::cell(slope, SLOPE_SCALE, self.slopes)?;
        let mut found = WidthProfile { reach: 0.0, depth, profile: [0.0; PROFILE_PLACES] };
        for (r, across) in [(r, 1.0 - across), (r + 1, across)] {
            for (q, along) in [(q, 1.0 - flatter), (q + 1, flatter)] {
                let solved = self.solved[r * self.slopes + q].as_ref()?;
                let weight = across * along;
                found.reach += weight * solved.reach * overlap;
                let places = found.profile.iter_mut().zip(&solved.profile);
                places.for_each(|(sum, value)| *sum += weight * value);
            }
        }
        Some(found)
    }

    /// The widths of the contact that a target asks for, its penetration being the depth of the
    /// end; a search may start from them.
    pub(crate) fn widths_for(&self, target: Target, slope: f64) -> Option<WidthProfile> {
        let depth = match target.force {
            Some(force) => self.depth_of(force, slope)?,
            None => target.penetration,
        };
        self.widths(depth, slope)
    }

    /// The depth under a slope at which the contact carries a force in units of the kernels.
    pub(crate) fn depth_of(&self, force: f64, slope: f64) -> Option<f64> {
        let (q, flatter) = Self::cell(slope, SLOPE_SCALE, self.slopes)?;
        let wanted = libm::log(force);
        let mut above: Option<f64> = None;
        for (r, contacts) in self.solved.chunks_exact(self.slopes).enumerate() {
            let both = contacts[q].as_ref().zip(contacts[q + 1].as_ref());
            let carried = both.map(|(a, b)| a.force * (1.0 - flatter) + b.force * flatter);
            if let Some((above, below)) = above.zip(carried)
                && above >= wanted
                && wanted >= below
            {
                let part = if above > below { (above - wanted) / (above - below) } else { 0.0 };
                let shorter = (r - 1) as f64 + part;
                return Some(slope * self.longest * libm::pow(OVERLAP_RATIO, -shorter));
            }
            above = carried;
        }
        None
    }
}
