//! Base pressure and flux of a solved contact over the distance from the axis. The projection of
//! the base pressure on a plane is that of a plane problem, summed over line loads at the points of
//! the rule; the base pressure is its inverse Abel transform.

use super::super::radial::Radial;
use super::{Grid, Sphere};
use crate::numeric::interpolation::Stencil;
use crate::numeric::wide::wide;
use core::f64::consts::PI;

/// Number of neighbouring values that one interpolation reads.
const STENCIL_POINTS: usize = 6;

/// Slope of the base pressure under a unit line load, arranged for places on a sphere's grid. A
/// load may lie anywhere between the points of the table, but the distance between two places of
/// the grid is a whole number of table points. Therefore all places have the same interpolation
/// weights, and with every `stride`-th value of the table in one row their values form one
/// contiguous stretch of memory.
#[derive(Clone, Debug)]
pub(super) struct Line {
    /// Value `stride` i + j of the mirrored table in row j, at i.
    rows: Vec<Vec<f64>>,
    /// Values of the mirrored table.
    len: usize,
    /// Place of the distance 0 in the table, as [`Stencil`] counts.
    centre: f64,
    /// Table points in a thickness.
    density: f64,
}

impl Line {
    /// The table for a grid of `per_thickness` points a thickness, by which the table's own number
    /// is divisible.
    pub(super) fn new(radial: &Radial, per_thickness: f64) -> Self {
        let table = radial.base_slope();
        let density = table.density();
        let (last, stride) = (table.last(), (density / per_thickness) as usize);
        let centre = last - last % stride;
        let at = |i: usize| table.sample(i.abs_diff(centre));
        let row = |j: usize| (j..=2 * centre).step_by(stride).map(at).collect();
        Self {
            rows: (0..stride).map(row).collect(),
            len: 2 * centre + 1,
            // A stencil's places begin two points after its values.
            centre: centre as f64 - 2.0,
            density,
        }
    }

    /// Adds the effect of a load at `s` thicknesses from the axis to the grid: at each place,
    /// `load` times the distance from it times the kernel at that distance.
    fn add(&self, load: f64, s: f64, per_thickness: f64, sums: &mut [f64]) {
        let stride = self.rows.len();
        let start = self.centre - s * self.density;
        // Places before the table's first point, under loads further away than it reaches.
        let skipped = libm::ceil((-start / stride as f64).max(0.0)) as usize;
        let start = start + (skipped * stride) as f64;
        if skipped >= sums.len() || start > (self.len - STENCIL_POINTS) as f64 {
            return;
        }
        let stencil = Stencil::new(self.len, start);
        let taps = [0, 1, 2, 3, 4, 5].map(|k| {
            let at = stencil.first() + k;
            &self.rows[at % stride][at / stride..]
        });
        let h = 1.0 / per_thickness;
        let line = [load * (skipped as f64 * h - s), load * h];
        add_line(&mut sums[skipped..], line, taps, stencil.weights());
    }
}

wide! {
    /// Adds a straight line over the places times the weighted sum of what stands there.
    fn add_line(
        sums: &mut [f64],
        line: [f64; 2],
        taps: [&[f64]; STENCIL_POINTS],
        weights: [f64; STENCIL_POINTS],
    ) = line_added;
}

#[inline(always)]
fn line_added(
    sums: &mut [f64],
    line: [f64; 2],
    taps: [&[f64]; STENCIL_POINTS],
    weights: [f64; STENCIL_POINTS],
) {
    let count = taps.iter().map(|tap| tap.len()).fold(sums.len(), usize::min);
    let [a, b, c, d, e, f] = taps.map(|tap| &tap[..count]);
    let [u, v, w, x, y, z] = weights;
    for (i, sum) in sums[..count].iter_mut().enumerate() {
        let read = (u * a[i] + v * b[i] + w * c[i]) + (x * d[i] + y * e[i] + z * f[i]);
        *sum += (line[0] + line[1] * i as f64) * read;
    }
}

impl Sphere {
    /// Base pressure and flux over the distance from the axis.
    pub(super) fn tabulate(&mut self, a: f64) {
        let Grid { per_thickness: density, sight_step, .. } = self.grid;
        let count = self.grid.count(a);
        let h = 1.0 / density;
        let sums = &mut self.sums[..count];
        sums.fill(0.0);
        for &[s, _, phi] in &self.points[..self.used] {
            self.line.add(-phi, s, density, sums);
            self.line.add(-phi, -s, density, sums);
        }
        let slope = |i: usize| sums[i] / (i as f64 * h);
        let [projected, pressure, flux] = &mut self.tables;
        // Even and smooth at 0: the value there from its neighbours.
        let middle = 1.5 * slope(1) - 0.6 * slope(2) + 0.1 * slope(3);
        projected.refill(count, density, |i| if i == 0 { middle } else { slope(i) });
        let end = projected.end();
        let along = |i: usize| {
            let r = i as f64 * h;
            let steps = libm::floor((end * end - r * r).max(0.0).sqrt() / sight_step) as usize;
            let mut sum = 0.5 * projected.at(r);
            for k in 1..=steps {
                let v = k as f64 * sight_step;
                sum += projected.at((r * r + v * v).sqrt());
            }
            -sight_step / PI * sum
        };
        pressure.refill(count, density, along);
        let mut inside = 0.0;
        let moment = |i: isize| pressure.sample(i.unsigned_abs()) * i as f64 * h;
        flux.refill(count, density, |_| 0.0);
        flux.set(0, 0.5 * pressure.sample(0));
        for i in 1..count {
            // The integral over one spacing by the polynomial through six values.
            let m = i as isize - 1;
            let right = (m + 3).min(count as isize - 1);
            let outer = moment(m - 2) + moment(right);
            let inner = moment(m - 1) + moment((m + 2).min(right));
            let middle = moment(m) + moment(m + 1);
            inside += h * (11.0 * outer - 93.0 * inner + 802.0 * middle) / 1440.0;
            let r = i as f64 * h;
            flux.set(i, inside / (r * r));
        }
        flux.mirror();
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::layer::Layer;
    use super::super::super::ground::Ground;
    use super::*;

    /// Loads at any place, also far beyond the table, on grids as dense as the table and coarser
    /// ones.
    #[test]
    fn interpolated_places_agree_with_the_table() {
        let layer = Layer::new(1.0, 1.0, 0.5).expect("a layer");
        let radial = Radial::new(&Ground::layer(&layer).expect("a layer"));
        for density in [8.0, 16.0, 32.0] {
            let line = Line::new(&radial, density);
            for s in [0.0, 0.3, -0.3, 2.503_17, -2.503_17, 17.0, -17.9, 39.99, -39.99, 97.3, -97.3]
            {
                let mut sums = vec![0.0; 60 * density as usize];
                line.add(1.5, s, density, &mut sums);
                for (i, sum) in sums.iter().enumerate() {
                    let apart = i as f64 / density - s;
                    let wanted = 1.5 * apart * radial.base_slope().at(apart.abs());
                    assert!((sum - wanted).abs() < 2e-12, "{density} {s} {i}: {sum} {wanted}");
                }
            }
        }
    }

    #[test]
    fn registers_of_any_width_give_the_same_bits() {
        let taps: Vec<Vec<f64>> = (0..STENCIL_POINTS)
            .map(|k| (0..45).map(|i| libm::sin((7 * k + i) as f64)).collect())
            .collect();
        let taps: [&[f64]; STENCIL_POINTS] = core::array::from_fn(|k| &taps[k][k % 2..]);
        let weights = [0.01, -0.09, 0.58, 0.58, -0.09, 0.01];
        let (mut found, mut narrow) = ([0.5; 50], [0.5; 50]);
        add_line(&mut found, [0.3, -0.07], taps, weights);
        line_added(&mut narrow, [0.3, -0.07], taps, weights);
        assert!(found == narrow && found[43] != 0.5 && found[44] == 0.5);
    }
}
