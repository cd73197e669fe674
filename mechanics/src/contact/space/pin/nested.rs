//! Contacts of a bar without a search for their pressure. A bar's slices are all of one width, and
//! what touches of a tilted one is its deeper end: the first m slices of its row, for some m. Their
//! systems are nested, so one factor of the whole row solves them all, once, for a unit of
//! penetration and for a unit of slope. A contact is then the largest m whose last slice is
//! pressed, found by halving, and a sum of two tabulated pressures; it remembers nothing.
//!
//! It refuses rows whose solutions would not fit, and contacts of which slices further in are
//! pulled: those are left to the search (`solve`).

use super::row::Row;
use super::strip::Strips;
use super::triangle::dot;
use core::f64::consts::PI;

/// Most numbers of a row's solutions.
const SOLUTIONS_MAX: usize = 1 << 21;
/// Penetration and slope.
const SIDES: usize = 2;

/// Solutions of the first 1, 2 ... slices of a row, from its deeper end.
#[derive(Clone, Debug)]
pub(super) struct Nested {
    cosines: usize,
    /// By m: force over the slices' length, and mean pressure of the last slice.
    forces: Vec<[f64; SIDES]>,
    last: Vec<[f64; SIDES]>,
    /// Cosines slice after slice, for m = 1, then 2 ...
    pressures: [Vec<f64>; SIDES],
}

impl Nested {
    /// Of equal slices at places `along` the row, deepest last, `between` being what two of them do
    /// to each other; absent when there are too many or their system is not positive.
    pub(super) fn new(strips: &Strips, between: &[f64], along: &[f64]) -> Option<Self> {
        let (places, slices) = (strips.places, along.len());
        let n = places.cosines;
        if slices * (slices + 1) / 2 * n * SIDES > SOLUTIONS_MAX {
            return None;
        }
        let mut own = vec![0.0; places.len()];
        strips.row(strips.widest(), &mut own);
        let entry = |i: usize, j: usize| {
            let (k, l, apart) = (i % n, j % n, i / n - j / n);
            let felt = between.get(apart * n * n + k * n + l).copied().unwrap_or(0.0);
            let plane = if apart == 0 { own[places.matrix(k.max(l), k.min(l))] } else { 0.0 };
            felt + plane
        };
        let band = (between.len() / (n * n)).min(slices);
        let factor = Band::new(slices * n, band * n, entry)?;
        let mut sides = [vec![0.0; slices * n], vec![0.0; slices * n]];
        for (p, place) in along.iter().rev().enumerate() {
            (sides[0][p * n], sides[1][p * n]) = (PI, PI * place);
        }
        sides.iter_mut().for_each(|side| factor.forward(side));
        let mut found = Self {
            cosines: n,
            forces: vec![[0.0; SIDES]; slices],
            last: vec![[0.0; SIDES]; slices],
            pressures: [Vec::new(), Vec::new()],
        };
        for m in 1..=slices {
            for (at, side) in sides.iter().enumerate() {
                let mut pressure = side[..m * n].to_vec();
                factor.backward(&mut pressure);
                found.forces[m - 1][at] = PI * pressure.iter().step_by(n).sum::<f64>();
                found.last[m - 1][at] = pressure[(m - 1) * n];
                found.pressures[at].extend_from_slice(&pressure);
            }
        }
        Some(found)
    }

    /// How many slices touch, and the penetration at the origin: the given one, or that of a force
    /// (over the slices' length, in units of the kernels).
    pub(super) fn touching(
        &self,
        (wanted, penetration): (Option<f64>, f64),
        slope: f64,
    ) -> (usize, f64) {
        let deep = |m: usize| {
            let [by_depth, by_slope] = self.forces[m - 1];
            wanted.map_or(penetration, |force| (force - slope * by_slope) / by_depth)
        };
        let pressed = |m: usize| {
            let [by_depth, by_slope] = self.last[m - 1];
            deep(m) * by_depth + slope * by_slope > 0.0
        };
        let (mut low, mut high) = (0, self.last.len() + 1);
        while high - low > 1 {
            let middle = usize::midpoint(low, high);
            if pressed(middle) { low = middle } else { high = middle }
        }
        (low, if low == 0 { penetration } else { deep(low) })
    }

    /// Writes the cosines of the first m slices, slice after slice backwards from the end of `out`;
    /// false when one of them is pulled.
    pub(super) fn write(
        &self,
        m: usize,
        (penetration, slope): (f64, f64),
        out: &mut [f64],
    ) -> bool {
        let n = self.cosines;
        let from = m.saturating_sub(1) * m / 2 * n;
        let [by_depth, by_slope] = [0, 1].map(|at| &self.pressures[at][from..from + m * n]);
        let parts = by_depth.chunks_exact(n).zip(by_slope.chunks_exact(n));
        let mut pressed = true;
        out.fill(0.0);
        for (own, (by_depth, by_slope)) in out.chunks_exact_mut(n).rev().zip(parts) {
            for (value, (a, b)) in own.iter_mut().zip(by_depth.iter().zip(by_slope)) {
                *value = penetration * a + slope * b;
            }
            pressed &= own[0] > 0.0;
        }
        pressed
    }
}

impl Row {
    /// The contact of a bar from its table; its penetration at the origin.
    pub(super) fn look_up(
        &mut self,
        wanted: Option<f64>,
        penetration: f64,
        slope: f64,
    ) -> Option<f64> {
        let (nested, work) = (self.nested.as_ref()?, &mut self.work);
        let over_length = wanted.map(|force| force / self.h);
        let (touching, penetration) = nested.touching((over_length, penetration), slope);
        let found = nested.write(touching, (penetration, slope), &mut work.a);
        if !found {
            work.clear();
            return None;
        }
        let n = work.places.cosines;
        work.widths.fill(self.strips.widest());
        for (j, v) in self.along.iter().enumerate() {
            work.given[j] = penetration + slope * v;
            work.effective[j] = work.a[j * n];
            work.active[j] = work.a[j * n] > 0.0;
        }
        Some(penetration)
    }
}

/// Cholesky's factor of a matrix with entries on `band` places left of the diagonal, it included.
struct Band {
    band: usize,
    rows: Vec<f64>,
}

impl Band {
    fn new(size: usize, band: usize, entry: impl Fn(usize, usize) -> f64) -> Option<Self> {
        let mut rows = vec![0.0; size * band];
        // Row i holds the columns i + 1 - band to i.
        for i in 0..size {
            let (above, row) = rows.split_at_mut(i * band);
            let left = (i + 1).saturating_sub(band);
            for j in left..=i {
                let (at, other) = (j + band - i - 1, &above[j.min(i.max(1) - 1) * band..]);
                let shared = j - left;
                let mine = &row[at - shared..at];
                if j == i {
                    let rest = entry(i, i) - dot(mine, mine);
                    if rest.is_nan() || rest <= 0.0 {
                        return None;
                    }
                    row[at] = rest.sqrt();
                } else {
                    let theirs = &other[band - 1 - shared..band - 1];
                    row[at] = (entry(i, j) - dot(mine, theirs)) / other[band - 1];
                }
            }
        }
        Some(Self { band, rows })
    }

    /// A row left of the diagonal, and the diagonal.
    fn row(&self, i: usize) -> (&[f64], f64) {
        let row = &self.rows[i * self.band..(i + 1) * self.band];
        (&row[(self.band - 1).saturating_sub(i)..self.band - 1], row[self.band - 1])
    }

    fn forward(&self, side: &mut [f64]) {
        for i in 0..side.len() {
            let (row, diagonal) = self.row(i);
            let known = &side[i - row.len()..i];
            side[i] = (side[i] - dot(row, known)) / diagonal;
        }
    }

    /// With the transposed factor of as many rows as the side has.
    fn backward(&self, side: &mut [f64]) {
        for i in (0..side.len()).rev() {
            let (row, diagonal) = self.row(i);
            let known = side[i] / diagonal;
            side[i] = known;
            for (value, entry) in side[i - row.len()..i].iter_mut().zip(row) {
                *value -= known * entry;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::layer::Layer;
    use super::super::super::{Drive, Level};
    use super::super::{Pin, Profile};

    /// The same slices by free-boundary steps and gradients, to those steps' tolerance.
    #[test]
    fn what_is_looked_up_is_what_a_search_finds() {
        for (nu, width_mm, tilt_rad) in
            [(0.5, 4.0, 0.004), (0.3, 0.5, 0.05), (0.0, 9.0, -0.01), (0.49, 2.0, 0.0)]
        {
            let layer = Layer::new(0.8, 27.58, nu).expect("a sound layer");
            let profile = Profile::Bar { width_mm };
            let made = Pin::new(&layer, profile, [-5.0, 5.0], 0.2, Level::Fast);
            let mut tabled = made.expect("a bar");
            let mut searched = tabled.clone();
            searched.rows.iter_mut().for_each(|row| {
                assert!(row.nested.take().is_some());
            });
            for depth_mm in [0.08, 0.03, 0.06] {
                let delta = depth_mm - 5.0 * libm::tan(tilt_rad).abs();
                let deep = Drive::PenetrationMm(delta);
                let a = tabled.press(deep, tilt_rad).expect("a contact");
                let b = searched.press(deep, tilt_rad).expect("a contact");
                let off = (a.force_n / b.force_n - 1.0).abs();
                assert!(off < 5e-3 && a.force_n > 0.0, "{nu} {width_mm}: {a:?} {b:?}");
                assert!((a.length_mm - b.length_mm).abs() < 0.5, "{nu} {width_mm}: {a:?} {b:?}");
                let loaded = Drive::ForceN(a.force_n);
                let again = tabled.press(loaded, tilt_rad).expect("a contact");
                assert!((again.penetration_mm - delta).abs() < 1e-3 * depth_mm, "{a:?} {again:?}");
            }
        }
    }
}
