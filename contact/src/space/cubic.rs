//! What a load leaves on the tactels about it, read by cubics between blocks that are tabulated
//! over the load's place within its own tactel. Reading neither allocates nor panics.

use crate::numeric::interpolation::cubic;
use crate::numeric::wide::wide;
use core::ops::Range;

/// Blocks of no more tactels along each axis are read whole.
const SIDE_AT_ONCE: usize = 11;

/// Shares of one load, read by cubics.
#[derive(Clone, Debug)]
pub(super) struct CubicShares {
    /// Grid points across one tactel.
    phases: usize,
    /// Tactels of a block along each axis, an odd number; the load lies in the middle one.
    side: usize,
    /// Offset blocks by the phase along y, then along x; within a block rows along y.
    blocks: Vec<f64>,
}

impl CubicShares {
    /// Tables for so many grid points across a tactel and tactels on each side of a load's own,
    /// from the share at an offset in grid points along x and y.
    pub(super) fn new(phases: usize, half: usize, share: impl Fn(isize, isize) -> f64) -> Self {
        let (side, stride) = (2 * half + 1, phases + 3);
        let mut blocks = Vec::with_capacity(stride * stride * side * side);
        // Phase p is the place (p - 1)/phases of the load in its tactel, from its left edge.
        let along = |index: usize, phase: usize| {
            let tactels = index as isize - half as isize;
            let (n, p) = (phases as isize, phase as isize - 1);
            tactels * n + n / 2 - p
        };
        for p_y in 0..stride {
            for p_x in 0..stride {
                for row in 0..side {
                    let y = along(row, p_y);
                    blocks.extend((0..side).map(|column| share(along(column, p_x), y)));
                }
            }
        }
        Self { phases, side, blocks }
    }

    /// Tactels of a block along each axis.
    pub(super) fn side(&self) -> usize {
        self.side
    }

    /// Adds the shares of a load of `force` at a place in tactels from the lower left corner of an
    /// array of `cols` columns.
    pub(super) fn add(&self, image: (&mut [f64], usize), place: [f64; 2], force: f64) {
        add(self, image, place, force);
    }

    #[inline(always)]
    fn add_load(&self, (image, cols): (&mut [f64], usize), [u, v]: [f64; 2], force: f64) {
        let (half, rows) = ((self.side / 2) as f64, image.len() / cols);
        let near = |place: f64, count: usize| place > -half && place < count as f64 + half;
        if !(near(u, cols) && near(v, rows)) {
            return;
        }
        let first = |place: f64| libm::floor(place) as isize - self.side as isize / 2;
        let (left, low) = (first(u), first(v));
        let span = |first: isize, count: usize| {
            let from = (-first).clamp(0, self.side as isize);
            let to = (count as isize - first).clamp(from, self.side as isize);
            (from as usize, to as usize)
        };
        let ((from_x, to_x), (from_y, to_y)) = (span(left, cols), span(low, rows));
        let mut weights = [(0, 0.0); 16];
        self.weights([u - libm::floor(u), v - libm::floor(v)], &mut weights);
        let target = |row: usize| {
            let start = (low + row as isize) as usize * cols + (left + from_x as isize) as usize;
            start..start + to_x - from_x
        };
        let mut sums = [0.0; SIDE_AT_ONCE * SIDE_AT_ONCE];
        let rows = from_y * self.side..to_y * self.side;
        let Some(sums) = sums.get_mut(..rows.len()).filter(|_| self.side <= SIDE_AT_ONCE) else {
            for row in from_y..to_y {
                let span = row * self.side + from_x..row * self.side + to_x;
                self.read_share(&weights, force, span, &mut image[target(row)]);
            }
            return;
        };
        // Rows of a small block lie side by side.
        self.read_share(&weights, force, rows, sums);
        for (row, sums) in (from_y..to_y).zip(sums.chunks_exact(self.side)) {
            let seen = image[target(row)].iter_mut().zip(&sums[from_x..to_x]);
            seen.for_each(|(value, sum)| *value += sum);
        }
    }

    /// Adds a span of the weighted blocks, four at a time.
    #[inline(always)]
    fn read_share(
        &self,
        weights: &[(usize, f64); 16],
        force: f64,
        span: Range<usize>,
        out: &mut [f64],
    ) {
        for four in weights.as_chunks::<4>().0 {
            let [(a, wa), (b, wb), (c, wc), (d, wd)] = four;
            let block = |start: &usize| &self.blocks[start + span.start..start + span.end];
            let [a, b, c, d] = [block(a), block(b), block(c), block(d)];
            let [wa, wb, wc, wd] = [force * wa, force * wb, force * wc, force * wd];
            let sources = a.iter().zip(b).zip(c.iter().zip(d));
            for (value, ((a, b), (c, d))) in out.iter_mut().zip(sources) {
                *value += (wa * a + wb * b) + (wc * c + wd * d);
            }
        }
    }

    /// Starts of the blocks that a load at a place within its tactel is read from, and their
    /// weights.
    #[inline(always)]
    fn weights(&self, place: [f64; 2], out: &mut [(usize, f64); 16]) {
        let [(cell_x, w_x), (cell_y, w_y)] = place.map(|part| {
            let p = part * self.phases as f64;
            let cell = (p as usize).min(self.phases - 1);
            (cell, cubic(p - cell as f64))
        });
        let (area, stride) = (self.side * self.side, self.phases + 3);
        for (at, out) in out.iter_mut().enumerate() {
            let (i, j) = (at % 4, at / 4);
            *out = (((cell_y + j) * stride + cell_x + i) * area, w_x[i] * w_y[j]);
        }
    }
}

wide! {
    fn add(to: &CubicShares, image: (&mut [f64], usize), place: [f64; 2], force: f64)
        = CubicShares::add_load;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks that are read whole and row by row, over the array's edges too.
    #[test]
    fn loads_are_added_alike_in_wide_and_narrow_registers() {
        let share = |i: isize, j: isize| 1.0 / (3.0 + (i * i) as f64 + 0.7 * (j * j) as f64);
        for half in [0, 1, 4, 7] {
            let cubic = CubicShares::new(4, half, share);
            let [mut wide, mut narrow] = [vec![0.0; 11 * 13], vec![0.0; 11 * 13]];
            for n in -20..40 {
                let place = [0.37, 0.43].map(|part| part * f64::from(n));
                cubic.add((&mut wide, 13), place, 0.7);
                cubic.add_load((&mut narrow, 13), place, 0.7);
            }
            assert!(wide == narrow && wide.iter().any(|value| *value > 0.0), "{half}");
        }
    }
}
