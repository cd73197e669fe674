//! Contacts of a cylinder that lies on a good part of its length, without a search. What such a
//! contact looks like on a row of slices follows from two numbers: the depth of the row's deeper
//! end, and how much of it the slope takes away along the row. Contacts over both are solved when
//! tables are made, each as what sets it apart from independent plane slices: a slice's width
//! belongs to a penetration that differs from the given one, and its pressure differs from the
//! plane contact's of that width. Both are small away from ends and smooth in the two numbers, so
//! pressing reads them between solved contacts and is done; it remembers nothing.
//!
//! It refuses what lies outside its contacts, which is left to the search (`solve`).

use super::faint::fainter;
use super::row::{Row, Settled};
use super::strip::COSINES_MAX;
use super::{PinState, TILT_MAX};
use core::f64::consts::PI;

/// Depths that are tabulated: the deepest asked for, each so many times the next, so many.
const DEPTHS: usize = 11;
const SHALLOWER: f64 = 2.4;
/// Shallower contacts, down to this part of the shallowest, look like it.
const SHALLOWEST: f64 = 0.005;
/// What the slope takes away over the row, in depths: over a whole pin and over a row on its end.
const WHOLE: [f64; 11] = [0.0, 0.15, 0.4, 0.65, 0.85, 0.98, 1.08, 1.2, 1.36, 1.58, 1.85];
const END: [f64; 5] = [1.08, 1.2, 1.35, 1.55, 1.85];
/// Steepest slope over the steepest that is pressed.
const STEEPEST: f64 = 1.02;
/// Neighbours that are read, along the depths and along the falls; fewer falls are no table.
const READ: usize = 4;
const FEWEST: usize = 3;
/// Tolerance of the solved contacts, their steps, and what may be left of one.
const SETTLED: Settled = Settled { tolerance: 3e-4, steps: 40 };
const LEFT: f64 = 1e-2;
/// So many times the steps are taken for what is not settled.
const PRESSED: usize = 3;
/// Fewest slices of a contact.
const SLICES: usize = 4;
/// What the pressure's difference is measured by belongs to this part of the depth at least.
const LEAST: f64 = 0.05;
/// Evaluations by which the depth of a force is found, and how well, in its logarithm.
const EVALUATIONS: usize = 40;
const FOUND: f64 = 1e-7;
/// So far inside of a range of contacts, in parts, depths are taken for ones within it.
const INSIDE: f64 = 1e-12;

/// Solved contacts of one row.
#[derive(Clone, Debug)]
pub(super) struct Lying {
    /// Logarithms of the tabulated depths, from the deepest.
    depths: Vec<f64>,
    falls: &'static [f64],
    /// The falls that were solved, depth after depth: from, and one beyond the last.
    solved: Vec<[usize; 2]>,
    /// Logarithm of the force in units of the kernels, depth after depth.
    forces: Vec<f64>,
    left: f64,
    /// Difference of the penetrations over the depth, then of the cosines over the first one's,
    /// slice after slice, contact after contact.
    differences: Vec<f64>,
    /// Differences to press with.
    read: Vec<f64>,
}

/// Contacts to read, and their weights.
struct Cell {
    first: usize,
    by_depth: [f64; READ],
    /// First fall and weights for each depth.
    by_fall: [(usize, [f64; READ]); READ],
}

/// Weights of the polynomial through values at some places, at most [`READ`] of them.
fn lagrange(places: &[f64], at: f64) -> [f64; READ] {
    let mut weights = [0.0; READ];
    for (i, weight) in weights.iter_mut().enumerate().take(places.len()) {
        let others = places.iter().enumerate().filter(|(j, _)| *j != i);
        *weight = others.map(|(_, other)| (at - other) / (places[i] - other)).product();
    }
    weights
}

/// Where the neighbours of a place begin among so many, two on each side where there are.
fn neighbours(below: usize, count: usize) -> usize {
    below.saturating_sub(READ / 2 - 1).min(count.saturating_sub(READ))
}

/// The contact of a row at a penetration of the origin under a slope, from the one before.
fn pressed(row: &mut Row, penetration: f64, slope: f64) -> Option<PinState> {
    for _ in 0..PRESSED {
        match row.press((None, penetration), slope) {
            Ok(state) if state.residual > LEFT => {}
            Ok(state) => return Some(state),
            Err(_) => break,
        }
    }
    row.release();
    None
}

impl Lying {
    /// Solves the contacts of a row that ends at `to`; absent when too few have a solution.
    pub(super) fn new(row: &mut Row, to: f64, deepest: f64) -> Option<Self> {
        let falls: &'static [f64] = if row.part { &END } else { &WHOLE };
        let (slices, width) = (row.along.len(), 1 + row.work.places.cosines);
        let mut found = Self {
            depths: Vec::with_capacity(DEPTHS),
            falls,
            solved: Vec::with_capacity(DEPTHS),
            forces: Vec::with_capacity(DEPTHS * falls.len()),
            left: 0.0,
            differences: Vec::new(),
            read: vec![0.0; slices * width],
        };
        let before = row.settle(SETTLED);
        let relaxed = core::mem::replace(&mut row.work.relaxed, 1.0);
        let mut depth = deepest;
        for _ in 0..DEPTHS {
            row.release();
            if !found.solve(row, to, depth) {
                break;
            }
            depth /= SHALLOWER;
        }
        row.settle(before);
        row.work.relaxed = relaxed;
        row.release();
        (found.depths.len() >= READ).then_some(found)
    }

    /// Solves the contacts of a depth, which is left out when too few have a solution; whether
    /// shallower ones may follow.
    fn solve(&mut self, row: &mut Row, to: f64, depth: f64) -> bool {
        let (forces, differences) = (self.forces.len(), self.differences.len());
        let mut solved = [0, 0];
        for (i, fall) in self.falls.iter().enumerate() {
            let slope = fall * depth / row.length;
            let state = if slope > STEEPEST * libm::tan(TILT_MAX) {
                None
            } else {
                pressed(row, depth - slope * to, slope)
            };
            let sound = |state: &PinState| {
                let touching = (0..row.along.len()).filter(|j| row.work.touches(*j)).count();
                let full = row.part && row.work.touches(0);
                !full && touching >= SLICES && state.force_n > 0.0
            };
            let state = state.filter(sound);
            if state.is_none() && solved[0] < solved[1] {
                // What follows is steeper still.
                self.forces.resize(forces + self.falls.len(), 0.0);
                let per = self.read.len();
                self.differences.resize(differences + self.falls.len() * per, 0.0);
                break;
            }
            let Some(state) = state else {
                solved = [i + 1, i + 1];
                self.forces.push(0.0);
                self.differences.resize(self.differences.len() + self.read.len(), 0.0);
                continue;
            };
            solved[1] = i + 1;
            let t = row.layer.thickness_mm;
            self.forces.push(libm::log(state.force_n / (row.modulus_mpa() * t * t)));
            self.left = self.left.max(state.residual);
            self.keep(row, depth);
        }
        if solved[1] - solved[0] >= FEWEST {
            self.depths.push(libm::log(depth));
            self.solved.push(solved);
            return true;
        }
        self.forces.truncate(forces);
        self.differences.truncate(differences);
        self.depths.is_empty()
    }

    /// Keeps the differences of the contact that a row stands at.
    fn keep(&mut self, row: &Row, depth: f64) {
        let (work, n) = (&row.work, row.work.places.cosines);
        let mut plane = [0.0; COSINES_MAX];
        let start = self.differences.len();
        self.differences.resize(start + self.read.len(), 0.0);
        let kept = &mut self.differences[start..];
        let (mut off, mut rate) = (0.0, 0.0);
        let mut own = [0.0; COSINES_MAX];
        // From the deeper end; beyond the contact it goes on as it ended.
        for (j, kept) in kept.chunks_exact_mut(n + 1).enumerate().rev() {
            if work.touches(j) {
                let now = (work.effective[j] - work.given[j]) / depth;
                rate = if j + 1 < work.active.len() { now - off } else { 0.0 };
                off = now;
                let at = (work.effective[j], row.strips.half_width(work.effective[j]));
                let scale = row.strips.differs(at, LEAST * depth, &mut plane[..n]);
                let pressure = work.a[j * n..(j + 1) * n].iter().zip(&plane);
                own.iter_mut().zip(pressure).for_each(|(own, (a, p))| *own = (a - p) / scale);
            } else {
                off += rate;
            }
            kept[0] = off;
            kept[1..].copy_from_slice(&own[..n]);
        }
    }

    /// The contacts around a logarithm of the depth and a fall; absent outside.
    fn cell(&self, depth: f64, fall: f64) -> Option<Cell> {
        let last = *self.depths.last()?;
        let all = self.depths.len() == DEPTHS;
        let near = all && depth < last && depth > last + libm::log(SHALLOWEST);
        let depth = if near { last } else { depth };
        if !(depth <= self.depths[0] && depth >= last) {
            return None;
        }
        let below = self.depths.iter().take_while(|known| **known >= depth).count() - 1;
        let first = neighbours(below, self.depths.len());
        let by_depth = lagrange(&self.depths[first..first + READ], depth);
        let mut by_fall = [(0, [0.0; READ]); READ];
        for (by_fall, [from, to]) in by_fall.iter_mut().zip(&self.solved[first..]) {
            let falls = &self.falls[*from..*to];
            if !(fall >= falls[0] && fall <= falls[falls.len() - 1]) {
                return None;
            }
            let below = falls.iter().take_while(|known| **known <= fall).count() - 1;
            let start = neighbours(below, falls.len());
            let end = (start + READ).min(falls.len());
            *by_fall = (from + start, lagrange(&falls[start..end], fall));
        }
        Some(Cell { first, by_depth, by_fall })
    }

    /// Calls with each contact of a cell and its weight.
    fn each(&self, cell: &Cell, mut of: impl FnMut(usize, f64)) {
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
    fn force(&self, depth: f64, (slope, length): (f64, f64)) -> Option<f64> {
        let (depth, fall) = (libm::log(depth), slope * length / depth);
        let at = |depth: f64| {
            let cell = self.cell(depth, fall)?;
            let mut sum = 0.0;
            self.each(&cell, |contact, weight| sum += weight * self.forces[contact]);
            Some(sum)
        };
        let [.., before, last] = self.depths[..] else { return None };
        let force = at(depth)?;
        if depth >= last {
            return Some(force);
        }
        Some(fainter([(before, at(before)?), (last, force)], depth))
    }

    /// The depth at which a force (in units of the kernels) is carried under a slope, between two
    /// at which it is known to be less and more.
    fn depth_of(&self, force: f64, along: (f64, f64)) -> Option<f64> {
        let wanted = libm::log(force);
        let [(mut low, mut below), (mut high, mut above)] = self
            .between(wanted, self.whole_range(along), along)
            .or_else(|| self.any_range(wanted, along))?;
        // Regula falsi in logarithms, with the end that stays put counted half.
        for _ in 0..EVALUATIONS {
            let middle = (low * above - high * below) / (above - below);
            let miss = self.force(libm::exp(middle), along)? - wanted;
            if miss.abs() < FOUND || above <= below {
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

    /// Logarithms of two depths and by how much their forces miss one, where it lies between them.
    fn between(
        &self,
        wanted: f64,
        [low, high]: [f64; 2],
        along: (f64, f64),
    ) -> Option<[(f64, f64); 2]> {
        let below = self.force(low, along)? - wanted;
        let above = self.force(high, along)? - wanted;
        let inside = below <= 0.0 && above >= 0.0;
        inside.then(|| [(libm::log(low), below), (libm::log(high), above)])
    }

    /// Depths between which each has the fall of a slope among its contacts.
    fn whole_range(&self, (slope, length): (f64, f64)) -> [f64; 2] {
        let [least, most] = [self.depths[self.depths.len() - 1], self.depths[0]].map(libm::exp);
        let steepest = |[_, to]: &[usize; 2]| self.falls[to - 1];
        let flattest = |[from, _]: &[usize; 2]| self.falls[*from];
        let falls = self.solved.iter().map(steepest).fold(f64::INFINITY, f64::min);
        let flat = self.solved.iter().map(flattest).fold(0.0, f64::max);
        let low = (least * SHALLOWEST).max(slope * length / falls);
        let high = if flat > 0.0 { most.min(slope * length / flat) } else { most };
        [low * (1.0 + INSIDE), high * (1.0 - INSIDE)]
    }

    /// Two depths around a force where not every depth has that fall: between neighbours of the
    /// depths, and of those at which one's contacts begin and end, all or none have it.
    fn any_range(&self, wanted: f64, along: (f64, f64)) -> Option<[(f64, f64); 2]> {
        let reach = along.0 * along.1;
        let mut places = [0.0; 3 * DEPTHS + 1];
        places[3 * DEPTHS] = SHALLOWEST * self.depths.last().map_or(0.0, |last| libm::exp(*last));
        for (places, (depth, [from, to])) in
            places.chunks_exact_mut(3).zip(self.depths.iter().zip(&self.solved))
        {
            let ends = [*from, to - 1].map(|fall| reach / self.falls[fall]);
            places.copy_from_slice(&[libm::exp(*depth), ends[0], ends[1]]);
        }
        places.sort_unstable_by(|a, b| b.total_cmp(a));
        let neighbours =
            places.windows(2).map(|two| [two[1] * (1.0 + INSIDE), two[0] * (1.0 - INSIDE)]);
        let sound = |[low, high]: &[f64; 2]| *low > 0.0 && low < high && *high < f64::INFINITY;
        neighbours.filter(sound).find_map(|range| self.between(wanted, range, along))
    }

    /// Reads the differences of a contact.
    fn read(&mut self, depth: f64, fall: f64) -> Option<()> {
        let cell = self.cell(libm::log(depth), fall)?;
        let mut read = core::mem::take(&mut self.read);
        read.fill(0.0);
        let per = read.len();
        self.each(&cell, |contact, weight| {
            let kept = &self.differences[contact * per..(contact + 1) * per];
            read.iter_mut().zip(kept).for_each(|(sum, value)| *sum += weight * value);
        });
        self.read = read;
        Some(())
    }
}

impl Row {
    /// The contact of the end at `to` under a slope by what was solved beforehand, by force or
    /// depth; absent outside of that.
    pub(super) fn lie(
        &mut self,
        (wanted, depth): (Option<f64>, f64),
        (slope, to): (f64, f64),
    ) -> Option<PinState> {
        let mut lying = self.lying.take()?;
        let found = self.lie_by(&mut lying, (wanted, depth), (slope, to));
        self.lying = Some(lying);
        found
    }

    fn lie_by(
        &mut self,
        lying: &mut Lying,
        (wanted, depth): (Option<f64>, f64),
        (slope, to): (f64, f64),
    ) -> Option<PinState> {
        let depth = match wanted {
            Some(force) => lying.depth_of(force, (slope, self.length))?,
            None => depth,
        };
        lying.read(depth, slope * self.length / depth)?;
        let carried = self.spread(&lying.read, depth, (slope, to));
        if let Some(force) = wanted {
            // What reading between contacts leaves of it.
            let more = force / carried;
            self.work.a.iter_mut().for_each(|a| *a *= more);
        }
        Some(self.told(depth - slope * to, lying.left, 1))
    }

    /// Writes the contact of some differences; its force in units of the kernels.
    fn spread(&mut self, read: &[f64], depth: f64, (slope, to): (f64, f64)) -> f64 {
        let n = self.work.places.cosines;
        let work = &mut self.work;
        work.read = true;
        let mut force = 0.0;
        for (j, differences) in read.chunks_exact(n + 1).enumerate() {
            let given = depth - slope * (to - self.along[j]);
            let effective = given + depth * differences[0];
            let own = &mut work.a[j * n..(j + 1) * n];
            work.given[j] = given;
            work.active[j] = false;
            if effective > 0.0 {
                work.widths[j] = self.strips.half_width(effective);
                let at = (effective, work.widths[j]);
                let scale = self.strips.differs(at, LEAST * depth, own);
                let cosines = own.iter_mut().zip(&differences[1..]);
                cosines.for_each(|(a, difference)| *a += scale * difference);
                work.active[j] = own[0] > 0.0;
            }
            if work.active[j] {
                work.effective[j] = effective;
                force += PI * self.h * own[0];
            } else {
                work.effective[j] = 0.0;
                own.fill(0.0);
            }
        }
        force
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::layer::Layer;
    use super::super::super::Drive;
    use super::super::{Pin, Profile};
    use super::Settled;
    use crate::Accuracy;

    /// The same slices with widths found by free-boundary steps; and nothing is remembered.
    #[test]
    fn what_is_read_is_what_a_search_finds() {
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
            tabled.corner = None;
            let mut searched = tabled.clone();
            for row in &mut searched.rows {
                assert!(row.lying.take().is_some() || row.length < 6.0);
                row.settle(Settled { tolerance: 1e-4, steps: 60 });
                row.work.relax();
            }
            for (depth, fall) in [0.17, 0.11, 0.06, 0.02, 0.01]
                .into_iter()
                .flat_map(|depth| [0.0, 0.11, 0.43, 0.97, 1.29, 2.4, 5.2].map(|fall| (depth, fall)))
            {
                let slope = fall * depth * t / (2.0 * half_mm);
                let deep = Drive::PenetrationMm(depth * t - slope * half_mm);
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
                let loaded = Drive::ForceN(a.force_n);
                let again = tabled.press(loaded, tilt_rad).expect("a contact");
                let back = (again.penetration_mm - a.penetration_mm).abs();
                assert!(back < 4e-3 * depth * t, "{t} {depth} {fall}: {a:?} {again:?}");
                tabled.press(Drive::ForceN(5.0), 0.001).expect("another contact");
                assert_eq!(tabled.press(deep, tilt_rad).expect("a contact"), a);
            }
        }
        assert!(read > 140, "{read}");
    }

    /// A depth without all of its contacts does not keep the others' from being found.
    #[test]
    fn a_force_is_found_though_a_shallow_depth_lacks_flat_contacts() {
        let layer = Layer::new(1.5347918953746555, 27.58, 0.5).expect("a sound layer");
        let profile = Profile::Cylinder { radius_mm: 7.9562116879969835 };
        let half = 14.528183864429593;
        let made = Pin::new(&layer, profile, [-half, half], 0.2550155, Accuracy::Fast);
        let mut pin = made.expect("a pin");
        let lying = pin.rows[0].lying.as_mut().expect("tables");
        lying.solved[8][0] = 2;
        for (delta, tilt_rad) in [(0.107, -0.0014), (0.05, 0.0), (0.02, 0.0011), (0.004, 0.001)] {
            let deep = pin.press(Drive::PenetrationMm(delta), tilt_rad).expect("a contact");
            let loaded = pin.press(Drive::ForceN(deep.force_n), tilt_rad).expect("a contact");
            assert_eq!([deep.steps, loaded.steps], [1, 1], "{delta}");
            let off = (loaded.penetration_mm - delta).abs();
            assert!(off < 3e-3 * (delta + half * tilt_rad.abs()), "{deep:?} {loaded:?}");
        }
    }
}
