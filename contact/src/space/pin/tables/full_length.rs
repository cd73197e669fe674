//! The table of the contacts of a cylinder that touches on a good part of its length. Two numbers
//! determine such a contact on a row of slices: the depth of the row's deeper end, and how much of
//! it the slope takes away along the row (the fall). The table holds contacts over both, each by
//! its difference from independent plane slices: a slice's width belongs to a penetration that
//! differs from the prescribed one, and its pressure differs from the plane contact's of that
//! width. Both differences are small away from ends and smooth in the two numbers, so a contact is
//! interpolated between tabulated ones.
//!
//! What lies outside the table is left to the iterative solution.

use super::light_load::{LogContact, light_load_force};

/// Depths in the table: at most so many, each the next one times the ratio.
pub(crate) const DEPTH_COUNT: usize = 11;
pub(crate) const DEPTH_RATIO: f64 = 2.4;
/// Shallowest depth that is extrapolated to, in parts of the shallowest depth in the table.
const EXTRAPOLATION_MIN: f64 = 0.005;
/// Falls in the table, in depths: over a whole pin, and over a row on its end.
pub(crate) const WHOLE_ROW_FALLS: [f64; 11] =
    [0.0, 0.15, 0.4, 0.65, 0.85, 0.98, 1.08, 1.2, 1.36, 1.58, 1.85];
pub(crate) const END_ROW_FALLS: [f64; 5] = [1.08, 1.2, 1.35, 1.55, 1.85];
/// Neighbours that are interpolated between, along the depths and along the falls; a table has at
/// least as many depths.
pub(crate) const NEIGHBOUR_COUNT: usize = 4;
/// The difference of a shallow slice's pressure is measured by the plane contact at this part of
/// the depth at least.
pub(crate) const REFERENCE_DEPTH_MIN: f64 = 0.05;
/// Most evaluations by which the depth of a force is found, and the error of the force's logarithm
/// at which they end.
const EVALUATIONS_MAX: usize = 40;
const LOG_FORCE_TOLERANCE: f64 = 1e-7;
/// Relative distance from the limits of a range of contacts at which its ends are evaluated.
const RANGE_MARGIN: f64 = 1e-12;

/// The slope of a row and its length, which turns a depth into a fall.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowSlope {
    /// Slope of the axis, at least 0.
    pub(crate) slope: f64,
    /// Length of the row in thicknesses.
    pub(crate) length: f64,
}

/// Tabulated contacts of one row.
#[derive(Clone, Debug)]
pub(crate) struct FullLengthTable {
    /// Logarithms of the tabulated depths, from the deepest.
    pub(crate) depths: Vec<f64>,
    pub(crate) falls: &'static [f64],
    /// The falls that have a solution, depth after depth: from, and one beyond the last.
    pub(crate) solved: Vec<[usize; 2]>,
    /// Logarithm of the force in units of the kernels, depth after depth.
    pub(crate) forces: Vec<f64>,
    /// Largest residual of the contacts.
    pub(crate) residual: f64,
    /// Difference of the penetrations over the depth, then of the cosines over the first one's,
    /// slice after slice, contact after contact.
    pub(crate) differences: Vec<f64>,
    /// Interpolated differences, slice after slice.
    pub(crate) interpolated: Vec<f64>,
}

/// A bracket of the depth of a force: the error of the force's logarithm is known at two depths.
#[derive(Clone, Copy, Debug)]
struct Bracket {
    /// Logarithm of a depth that carries less, and by how much its force misses.
    low: f64,
    below: f64,
    /// Logarithm of a depth that carries more, and by how much its force misses.
    high: f64,
    above: f64,
}

/// Contacts to interpolate between, and their weights.
struct Cell {
    first: usize,
    by_depth: [f64; NEIGHBOUR_COUNT],
    /// First fall and weights for each depth.
    by_fall: [(usize, [f64; NEIGHBOUR_COUNT]); NEIGHBOUR_COUNT],
}

/// Weights of the polynomial through values at some places, at most [`NEIGHBOUR_COUNT`] of them.
fn lagrange(places: &[f64], at: f64) -> [f64; NEIGHBOUR_COUNT] {
    let mut weights = [0.0; NEIGHBOUR_COUNT];
    for (i, weight) in weights.iter_mut().enumerate().take(places.len()) {
        let others = places.iter().enumerate().filter(|(j, _)| *j != i);
        *weight = others.map(|(_, other)| (at - other) / (places[i] - other)).product();
    }
    weights
}

/// Index of the first neighbour of a place among so many; two neighbours lie on each side where
/// there are as many.
fn first_neighbour(below: usize, count: usize) -> usize {
    below.saturating_sub(NEIGHBOUR_COUNT / 2 - 1).min(count.saturating_sub(NEIGHBOUR_COUNT))
}

impl FullLengthTable {
    /// The contacts around a logarithm of the depth and a fall; absent outside.
    fn cell(&self, depth: f64, fall: f64) -> Option<Cell> {
        let last = *self.depths.last()?;
        let all = self.depths.len() == DEPTH_COUNT;
        let near = all && depth < last && depth > last + libm::log(EXTRAPOLATION_MIN);
        let depth = if near { last } else { depth };
        if !(depth <= self.depths[0] && depth >= last) {
            return None;
        }
        let below = self.depths.iter().take_while(|known| **known >= depth).count() - 1;
        let first = first_neighbour(below, self.depths.len());
        let by_depth = lagrange(&self.depths[first..first + NEIGHBOUR_COUNT], depth);
        let mut by_fall = [(0, [0.0; NEIGHBOUR_COUNT]); NEIGHBOUR_COUNT];
        for (by_fall, [from, to]) in by_fall.iter_mut().zip(&self.solved[first..]) {
            let falls = &self.falls[*from..*to];
            if !(fall >= falls[0] && fall <= falls[falls.len() - 1]) {
                return None;
            }
            let below = falls.iter().take_while(|known| **known <= fall).count() - 1;
            let start = first_neighbour(below, falls.len());
            let end = (start + NEIGHBOUR_COUNT).min(falls.len());
            *by_fall = (from + start, lagrange(&falls[start..end], fall));
        }
        Some(Cell { first, by_depth, by_fall })
    }

    /// Calls with each contact of a cell and its weight.
    fn for_each(&self, cell: &Cell, mut of: impl FnMut(usize, f64)) {
        for (d, (by_depth, (start, weights))) in cell.by_depth.iter().zip(&cell.by_fall).enumerate()
        {
            let contacts = (cell.first + d) * self.falls.len() + start;
            for (f, weight) in weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
                of(contacts + f, by_depth * weight);
            }
        }
    }

    /// Logarithm of the force at a depth, below the shallowest contact as it falls off there;
    /// absent outside.
    fn force(&self, depth: f64, along: RowSlope) -> Option<f64> {
        let RowSlope { slope, length } = along;
        let (depth, fall) = (libm::log(depth), slope * length / depth);
        let at = |depth: f64| {
            let cell = self.cell(depth, fall)?;
            let mut sum = 0.0;
            self.for_each(&cell, |contact, weight| sum += weight * self.forces[contact]);
            Some(sum)
        };
        let [.., before, last] = self.depths[..] else { return None };
        let force = at(depth)?;
        if depth >= last {
            return Some(force);
        }
        let deeper = LogContact { depth: before, force: at(before)? };
        Some(light_load_force([deeper, LogContact { depth: last, force }], depth))
    }

    /// The depth at which a row carries a force (in units of the kernels) under a slope; absent
    /// outside the table.
    pub(crate) fn depth_of(&self, force: f64, along: RowSlope) -> Option<f64> {
        let wanted = libm::log(force);
        let Bracket { mut low, mut below, mut high, mut above } = self
            .bracket_within(wanted, self.common_range(along), along)
            .or_else(|| self.bracket_anywhere(wanted, along))?;
        // Regula falsi in logarithms; the error at the end that stays is halved (Illinois).
        for _ in 0..EVALUATIONS_MAX {
            let middle = (low * above - high * below) / (above - below);
            let miss = self.force(libm::exp(middle), along)? - wanted;
            if miss.abs() < LOG_FORCE_TOLERANCE || above <= below {
                return Some(libm::exp(middle));
            }
            if miss < 0.0 {
                (low, below, above) = (middle, miss, 0.5 * above);
            } else {
                (high, above, below) = (middle, miss, 0.5 * below);
            }
        }
        Some(0.5 * (libm::exp(low) + libm::exp(high)))
    }

    /// The bracket of the logarithm of a force between two depths, where the force lies there.
    fn bracket_within(
        &self,
        wanted: f64,
        [low, high]: [f64; 2],
        along: RowSlope,
    ) -> Option<Bracket> {
        let below = self.force(low, along)? - wanted;
        let above = self.force(high, along)? - wanted;
        let is_inside = below <= 0.0 && above >= 0.0;
        is_inside.then(|| Bracket { low: libm::log(low), below, high: libm::log(high), above })
    }

    /// Depths between which every tabulated depth has the fall of a slope among its contacts.
    fn common_range(&self, along: RowSlope) -> [f64; 2] {
        let RowSlope { slope, length } = along;
        let [least, most] = [self.depths[self.depths.len() - 1], self.depths[0]].map(libm::exp);
        let steepest = |[_, to]: &[usize; 2]| self.falls[to - 1];
        let flattest = |[from, _]: &[usize; 2]| self.falls[*from];
        let falls = self.solved.iter().map(steepest).fold(f64::INFINITY, f64::min);
        let flat = self.solved.iter().map(flattest).fold(0.0, f64::max);
        let low = (least * EXTRAPOLATION_MIN).max(slope * length / falls);
        let high = if flat > 0.0 { most.min(slope * length / flat) } else { most };
        [low * (1.0 + RANGE_MARGIN), high * (1.0 - RANGE_MARGIN)]
    }

    /// The bracket of a force where not every depth has the slope's fall. The tabulated depths, and
    /// the depths at which the contacts of each begin and end, divide all depths into intervals;
    /// within an interval all depths have the fall or none has it.
    fn bracket_anywhere(&self, wanted: f64, along: RowSlope) -> Option<Bracket> {
        let reach = along.slope * along.length;
        let mut places = [0.0; 3 * DEPTH_COUNT + 1];
        places[3 * DEPTH_COUNT] =
            EXTRAPOLATION_MIN * self.depths.last().map_or(0.0, |last| libm::exp(*last));
        for (places, (depth, [from, to])) in
            places.chunks_exact_mut(3).zip(self.depths.iter().zip(&self.solved))
        {
            let ends = [*from, to - 1].map(|fall| reach / self.falls[fall]);
            places.copy_from_slice(&[libm::exp(*depth), ends[0], ends[1]]);
        }
        places.sort_unstable_by(|a, b| b.total_cmp(a));
        let neighbours = places
            .windows(2)
            .map(|two| [two[1] * (1.0 + RANGE_MARGIN), two[0] * (1.0 - RANGE_MARGIN)]);
        let sound = |[low, high]: &[f64; 2]| *low > 0.0 && low < high && *high < f64::INFINITY;
        neighbours.filter(sound).find_map(|range| self.bracket_within(wanted, range, along))
    }

    /// Interpolates the differences of a contact at a depth and a fall; absent outside the table.
    pub(crate) fn interpolate(&mut self, depth: f64, fall: f64) -> Option<()> {
        let cell = self.cell(libm::log(depth), fall)?;
        let mut found = core::mem::take(&mut self.interpolated);
        found.fill(0.0);
        let per = found.len();
        self.for_each(&cell, |contact, weight| {
            let own = &self.differences[contact * per..(contact + 1) * per];
            found.iter_mut().zip(own).for_each(|(sum, value)| *sum += weight * value);
        });
        self.interpolated = found;
        Some(())
    }
}
