//! Shares a load among the tactels around it by bilinear interpolation in single precision. A block
//! of tactels is as wide as the reach. The force of tactels beyond the reach is added at the edge
//! of the block, so that the sum over the tactels is the load's force. Linear interpolation of a
//! curved function has an error of one sign; the values at the nodes are shifted by its mean.
//! Adding a load neither allocates nor panics.
//!
//! A tactel is divided into a grid of cells, and a load lies in one of them. Each cell has its own
//! block of tactels, which holds the value at the cell's lower left corner and the differences
//! along x, along y and along both: all that a load reads is contiguous in memory.

use super::array::Array;
use crate::numeric::wide::wide;

/// Rows of a block are padded with zeros to a multiple of this.
const ROW_ALIGNMENT: usize = 4;
/// Numbers per tactel and cell: the value at the corner and three differences.
const PARTS_PER_SHARE: usize = 4;
/// Tactels of a row that are summed in single precision before they are added.
const SUMMED_TACTELS: usize = 32;

/// Blocks over the cells of a load's place within its tactel.
#[derive(Clone, Debug)]
pub(super) struct LinearShares {
    /// Cells across one tactel, and in a millimetre.
    phases: usize,
    per_mm: f64,
    /// Tactels of a block along each axis, and numbers in a row of one part of it.
    side: usize,
    stride: usize,
    /// The blocks, ordered by the cell along y, then along x; within a block by row, then by part.
    blocks: Vec<f32>,
    /// Columns of the array, and the cells along x and y from which a load acts on it.
    cols: usize,
    axes: [Axis; 2],
}

/// The cells along an axis from which a load acts on the array.
#[derive(Clone, Debug)]
struct Axis {
    /// Centre of the array, in cells from the first one.
    middle: f64,
    cells: Vec<Cell>,
}

/// The part of the array that the block of a cell covers.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Number within the tactel.
    cell: usize,
    /// Tactel of the block's first row or column.
    first: isize,
    /// Rows or columns of the block that are on the array: the first, and one beyond the last.
    on: [usize; 2],
}

impl LinearShares {
    /// Tactels of a block along each axis for a reach in tactels.
    pub(super) fn side_for(reach: f64) -> usize {
        (libm::ceil(2.0 * reach) as usize).saturating_add(1).max(2)
    }

    /// Tactels of a block along each axis.
    pub(super) fn side(&self) -> usize {
        self.side
    }

    /// Numbers in all blocks together.
    pub(super) fn len(phases: usize, side: usize) -> usize {
        let stride = side.checked_next_multiple_of(ROW_ALIGNMENT).unwrap_or(usize::MAX);
        (phases * phases * PARTS_PER_SHARE).saturating_mul(side.saturating_mul(stride))
    }

    /// Tabulates `share`, the share of a tactel whose centre is at an offset from the load, in
    /// cells; a tactel has an even number of cells. `whole` is the sum of the shares over all
    /// tactels, which the blocks are to preserve if it is given.
    pub(super) fn new(
        array: &Array,
        phases: usize,
        side: usize,
        share: impl Fn([isize; 2]) -> f64,
        whole: Option<f64>,
    ) -> Self {
        let stride = side.next_multiple_of(ROW_ALIGNMENT);
        let mut shares = Self {
            phases,
            per_mm: phases as f64 / array.pitch_mm,
            side,
            stride,
            blocks: vec![0.0; Self::len(phases, side)],
            cols: array.cols,
            axes: [Axis::EMPTY, Axis::EMPTY],
        };
        shares.axes = [array.cols, array.rows].map(|count| shares.axis(count));
        let node = |[x, y]: [isize; 2]| {
            let middle = share([x, y]);
            // A twelfth of the second difference is the mean error of the linear interpolation.
            let across = share([x + 1, y]) + share([x - 1, y]);
            let along = share([x, y + 1]) + share([x, y - 1]);
            middle - (across + along - 4.0 * middle) / 12.0
        };
        let n = phases as isize;
        let mut corners = vec![[0.0; 4]; side * side];
        for at in 0..phases * phases {
            let cell = [at % phases, at / phases];
            let offset = |tactel: usize, cell: usize| {
                (shares.first(cell) + tactel as isize) * n + n / 2 - cell as isize
            };
            for (at, corners) in corners.iter_mut().enumerate() {
                let [x, y] = [offset(at % side, cell[0]), offset(at / side, cell[1])];
                *corners = [[x, y], [x - 1, y], [x, y - 1], [x - 1, y - 1]].map(node);
            }
            if let Some(whole) = whole {
                preserve_force(&mut corners, side, whole);
            }
            let block = &mut shares.blocks[at * PARTS_PER_SHARE * side * stride..];
            for (at, [a, b, c, d]) in corners.iter().enumerate() {
                let parts = [*a, b - a, c - a, (d - c) - (b - a)];
                let row = &mut block[at / side * PARTS_PER_SHARE * stride..];
                for (part, value) in parts.into_iter().enumerate() {
                    row[part * stride + at % side] = value as f32;
                }
            }
        }
        shares
    }

    /// First tactel of a cell's block, counted from the load's.
    fn first(&self, cell: usize) -> isize {
        let later = self.side.is_multiple_of(2) && 2 * cell >= self.phases;
        isize::from(later) - (self.side / 2) as isize
    }

    /// The cells along an axis of `count` tactels.
    fn axis(&self, count: usize) -> Axis {
        let (n, side) = (self.phases as isize, self.side as isize);
        let cell = |index: isize| {
            let cell = index.rem_euclid(n) as usize;
            let first = index.div_euclid(n) + self.first(cell);
            let [from, to] = [-first, count as isize - first].map(|i| i.clamp(0, side) as usize);
            Cell { cell, first, on: [from, to] }
        };
        let all = (-side * n..(count as isize + side) * n).map(|index| (index, cell(index)));
        let seen: Vec<(isize, Cell)> = all.filter(|(_, cell)| cell.on[0] < cell.on[1]).collect();
        let from = seen.first().map_or(0, |(index, _)| *index);
        let cells = seen.into_iter().map(|(_, cell)| cell).collect();
        Axis { middle: 0.5 * count as f64 * self.phases as f64 - from as f64, cells }
    }

    /// Adds the shares of a load of `force` at a place on an image of the array.
    #[inline]
    pub(super) fn add(&self, image: &mut [f64], place_mm: [f64; 2], force: f64) {
        add(self, image, place_mm, force);
    }

    #[inline(always)]
    fn add_load(&self, image: &mut [f64], place_mm: [f64; 2], force: f64) {
        let [across, along] = &self.axes;
        let [x, y] = [across.at(place_mm[0] * self.per_mm), along.at(place_mm[1] * self.per_mm)];
        let Some(((x, s), (y, t))) = x.zip(y) else { return };
        let weights = [s as f32, t as f32, (s * t) as f32];
        let (row, [low, high]) = (PARTS_PER_SHARE * self.stride, y.on);
        let start = (y.cell * self.phases + x.cell) * self.side * row;
        let block = &self.blocks[start + low * row..start + high * row];
        let from = (y.first + low as isize) as usize * self.cols;
        let image = &mut image[from..from + (high - low) * self.cols];
        match self.stride {
            4 => self.add_narrow::<4>(block, image, x, (weights, force)),
            8 => self.add_narrow::<8>(block, image, x, (weights, force)),
            12 => self.add_narrow::<12>(block, image, x, (weights, force)),
            16 => self.add_narrow::<16>(block, image, x, (weights, force)),
            _ => self.add_wide(block, image, x, (weights, force)),
        }
    }

    /// Adds the rows of a block of any width.
    #[inline(always)]
    fn add_wide(&self, block: &[f32], image: &mut [f64], x: Cell, (w, force): ([f32; 3], f64)) {
        let [from, to] = x.on;
        let mut start = (x.first + from as isize) as usize;
        let mut sums = [0.0_f32; SUMMED_TACTELS];
        for row in block.chunks_exact(PARTS_PER_SHARE * self.stride) {
            let part = |k: usize| &row[k * self.stride + from..k * self.stride + to];
            let parts = [part(0), part(1), part(2), part(3)];
            for (n, target) in
                image[start..start + to - from].chunks_mut(SUMMED_TACTELS).enumerate()
            {
                let sums = &mut sums[..target.len()];
                let part = |k: usize| &parts[k][n * SUMMED_TACTELS..][..target.len()];
                let [a, b, c, d] = [part(0), part(1), part(2), part(3)];
                let both = a.iter().zip(b).zip(c.iter().zip(d));
                for (sum, ((a, b), (c, d))) in sums.iter_mut().zip(both) {
                    *sum = (a + w[0] * b) + (w[1] * c + w[2] * d);
                }
                for (value, sum) in target.iter_mut().zip(&*sums) {
                    *value += force * f64::from(*sum);
                }
            }
            start += self.cols;
        }
    }

    /// Adds the rows of a block whose rows have `N` numbers.
    #[inline(always)]
    fn add_narrow<const N: usize>(
        &self,
        block: &[f32],
        image: &mut [f64],
        x: Cell,
        (w, force): ([f32; 3], f64),
    ) {
        let rows = block.as_chunks::<N>().0.as_chunks::<PARTS_PER_SHARE>().0;
        let [from, to] = x.on;
        if x.first >= 0 && x.first as usize + N <= self.cols {
            let mut start = x.first as usize;
            for row in rows {
                let mut sums = [0.0; N];
                sum(row, w, &mut sums);
                if let Some(target) = image[start..].first_chunk_mut::<N>() {
                    for (value, sum) in target.iter_mut().zip(&sums) {
                        *value += force * f64::from(*sum);
                    }
                }
                start += self.cols;
            }
        } else {
            // All sums are computed before the first one is read. A read at another alignment
            // right after a wide store makes the processor wait for the store.
            let mut sums = [[0.0; N]; N];
            for (row, sums) in rows.iter().zip(&mut sums) {
                sum(row, w, sums);
            }
            let mut start = (x.first + from as isize) as usize;
            for sums in &sums[..rows.len().min(N)] {
                let target = &mut image[start..start + to - from];
                for (value, sum) in target.iter_mut().zip(&sums[from..to]) {
                    *value += force * f64::from(*sum);
                }
                start += self.cols;
            }
        }
    }
}

impl Axis {
    const EMPTY: Self = Self { middle: 0.0, cells: Vec::new() };

    /// The cell at a place, given in cells from the array's centre, and the place within the cell,
    /// 0 to 1. Absent where a load does not act on the array, and for NaN.
    #[inline(always)]
    fn at(&self, place: f64) -> Option<(Cell, f64)> {
        /// 1.5 times 2^52: adding it rounds a number to an integer, which is then in the low bits.
        const ROUNDING_OFFSET: f64 = (3_u64 << 51) as f64;
        let shifted = place + self.middle;
        if !(shifted >= 0.0 && shifted < self.cells.len() as f64) {
            return None;
        }
        let whole = shifted - 0.5 + ROUNDING_OFFSET;
        let index = (whole.to_bits() & 0xffff_ffff) as usize;
        Some((*self.cells.get(index)?, shifted - (whole - ROUNDING_OFFSET)))
    }
}

wide! {
    fn add(to: &LinearShares, image: &mut [f64], place_mm: [f64; 2], force: f64)
        = LinearShares::add_load;
}

/// Interpolates the shares of `N` tactels from their parts.
#[inline(always)]
fn sum<const N: usize>(
    parts: &[[f32; N]; PARTS_PER_SHARE],
    [s, t, both]: [f32; 3],
    sums: &mut [f32; N],
) {
    let [a, b, c, d] = parts;
    for (k, sum) in sums.iter_mut().enumerate() {
        *sum = (a[k] + s * b[k]) + (t * c[k] + both * d[k]);
    }
}

/// Spreads the difference between `whole` and the sum over a block evenly over the tactels at its
/// edge, for each corner of a cell.
fn preserve_force(corners: &mut [[f64; 4]], side: usize, whole: f64) {
    let mut rest = [whole; 4];
    for corner in &*corners {
        rest.iter_mut().zip(corner).for_each(|(rest, value)| *rest -= value);
    }
    let rim = (4 * (side - 1)) as f64;
    for (at, corner) in corners.iter_mut().enumerate() {
        let (i, j) = (at % side, at / side);
        if i == 0 || j == 0 || i + 1 == side || j + 1 == side {
            corner.iter_mut().zip(rest).for_each(|(value, rest)| *value += rest / rim);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::layer::Layer;
    use super::super::radial::Influence;
    use super::super::shear::Shear;
    use super::super::tactels::{Array, Fineness, Sampling, Shares};
    use super::*;

    /// Loads on, beside and off arrays of several shapes, with narrow and wide blocks.
    #[test]
    fn linear_interpolation_agrees_with_cubic_and_preserves_the_force() {
        for (t, rows, cols, pitch_mm) in
            [(0.3, 16, 16, 1.5875), (0.8, 5, 9, 1.5875), (0.5, 30, 28, 1.0), (2.2, 40, 37, 1.0)]
        {
            let layer = Layer::new(t, 27.58, 0.5).expect("a sound layer");
            let influence = Influence::new(&layer).expect("a layer");
            let shear = Shear::new(&layer).expect("a layer");
            let array = Array { rows, cols, pitch_mm };
            let fine = Fineness { reach: 14.0, ..Fineness::FINE };
            let [quick, exact] = [Fineness::FAST, fine].map(|fineness| {
                let normal = Shares::new(&influence, &array, Sampling::Area, fineness);
                let sheared = Shares::sheared(&shear, &array, Sampling::Area, fineness);
                [normal.expect("tables"), sheared.expect("tables")]
            });
            let most = |image: &[f64]| image.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
            let whole = |image: &[f64]| image.iter().sum::<f64>() * pitch_mm * pitch_mm;
            for n in 0..60_u32 {
                // The places spiral from the centre outwards, beyond the edges too.
                let (turn, out) = (2.4 * f64::from(n), 0.02 * f64::from(n));
                let x = 0.5 * out * cols as f64 * pitch_mm * libm::cos(turn);
                let y = 0.5 * out * rows as f64 * pitch_mm * libm::sin(turn);
                for (n, (quick, exact)) in quick.iter().zip(&exact).enumerate() {
                    let [mut a, mut b] = [vec![0.0; array.len()], vec![0.0; array.len()]];
                    quick.add(&mut a, [x, y], 2.0);
                    exact.add(&mut b, [x, y], 2.0);
                    let largest = (0..12).fold(0.0_f64, |largest, part| {
                        let mut seen = vec![0.0; array.len()];
                        exact.add(
                            &mut seen,
                            [f64::from(part) / 12.0, 0.3].map(|p| p * pitch_mm),
                            2.0,
                        );
                        largest.max(most(&seen))
                    });
                    let off =
                        a.iter().zip(&b).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
                    assert!(off < 1e-2 * largest, "{t} {n} {x} {y}: {off}");
                    if n == 0 && out == 0.0 && t < 0.6 {
                        assert!((whole(&a) + 2.0).abs() < 1e-5, "{t}: {}", whole(&a));
                    }
                }
            }
            let mut image = vec![0.0; array.len()];
            for bad in [[f64::NAN, 0.0], [0.0, f64::INFINITY], [1e300, 0.0]] {
                quick[0].add(&mut image, bad, 1.0);
            }
            assert!(image.iter().all(|value| *value == 0.0));
        }
    }

    /// Blocks of all widths, some of them across the edges of the array.
    #[test]
    fn wide_and_narrow_registers_give_the_same_image() {
        let array = Array { rows: 11, cols: 13, pitch_mm: 1.5 };
        let share = |[i, j]: [isize; 2]| 1.0 / (3.0 + (i * i) as f64 + 0.7 * (j * j) as f64);
        for side in [2, 3, 4, 7, 10, 16, 17] {
            let straight = LinearShares::new(&array, 4, side, share, None);
            let [mut wide, mut narrow] = [vec![0.0; array.len()], vec![0.0; array.len()]];
            for n in -20..20 {
                let place = [0.71, -0.43].map(|part| part * f64::from(n));
                straight.add(&mut wide, place, 0.7);
                straight.add_load(&mut narrow, place, 0.7);
            }
            assert!(wide == narrow && wide.iter().any(|value| *value > 0.0), "{side}");
        }
    }
}
