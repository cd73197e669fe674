//! Convolves real fields with a kernel that is even or odd along each axis, by Fourier transforms
//! on a padded grid (realfft). Convolving neither allocates nor panics. The transforms use whatever
//! vector instructions the processor has, so results differ in their last bits between machines:
//! nothing that is hashed may come from here.

use core::fmt;
use realfft::num_complex::Complex64;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

const ZERO: Complex64 = Complex64::new(0.0, 0.0);

/// Transforms of the real rows (along x) and of the complex columns (along y).
#[derive(Clone)]
struct Plans {
    row: Arc<dyn RealToComplex<f64>>,
    row_back: Arc<dyn ComplexToReal<f64>>,
    column: Arc<dyn Fft<f64>>,
    column_back: Arc<dyn Fft<f64>>,
}

/// A kernel that is even or odd along each axis, ready to be convolved with fields of one size.
#[derive(Clone)]
pub(crate) struct Convolution {
    columns: usize,
    rows: usize,
    plans: Plans,
    /// Transform of the kernel, column by column, including the normalisation of the transforms.
    /// By symmetry it is either purely real or purely imaginary; only that part is stored.
    spectrum: Vec<f64>,
    /// Whether the transform of the kernel is imaginary.
    imaginary: bool,
    /// The transformed rows.
    grid: Vec<Complex64>,
    /// Workspace for one column.
    column: Vec<Complex64>,
    /// Workspace for one row.
    row: Vec<f64>,
    scratch: Vec<Complex64>,
}

impl fmt::Debug for Convolution {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { columns, rows, .. } = self;
        write!(f, "Convolution of {columns} x {rows}")
    }
}

/// The smallest even number, at least `least`, whose prime factors are 2, 3 and 5 only: transforms
/// of such lengths are fast.
fn transform_length(least: usize) -> usize {
    let is_smooth = |n: &usize| {
        let cofactor = [2, 3, 5].iter().fold(*n, |mut cofactor, prime| {
            while cofactor.is_multiple_of(*prime) {
                cofactor /= prime;
            }
            cofactor
        });
        cofactor == 1
    };
    (least.next_multiple_of(2)..).step_by(2).find(is_smooth).unwrap_or(least)
}

impl Convolution {
    /// Takes an even kernel at offsets (i, j), 0 <= i < columns, 0 <= j < rows.
    pub(crate) fn new(columns: usize, rows: usize, kernel: impl Fn(usize, usize) -> f64) -> Self {
        Self::with_parity([columns, rows], [false; 2], kernel)
    }

    /// Takes a kernel that is odd along x where `odd[0]` is true and along y where `odd[1]` is, and
    /// even otherwise.
    pub(crate) fn with_parity(
        [columns, rows]: [usize; 2],
        odd: [bool; 2],
        kernel: impl Fn(usize, usize) -> f64,
    ) -> Self {
        let [width, height] = [columns, rows].map(|n| transform_length(2 * n));
        let (mut real, mut complex) = (RealFftPlanner::new(), FftPlanner::new());
        let plans = Plans {
            row: real.plan_fft_forward(width),
            row_back: real.plan_fft_inverse(width),
            column: complex.plan_fft_forward(height),
            column_back: complex.plan_fft_inverse(height),
        };
        let scratch = [
            plans.row.get_scratch_len(),
            plans.row_back.get_scratch_len(),
            plans.column.get_inplace_scratch_len(),
            plans.column_back.get_inplace_scratch_len(),
        ];
        let half = width / 2 + 1;
        let mut convolution = Self {
            columns,
            rows,
            plans,
            spectrum: vec![0.0; half * height],
            imaginary: odd[0] != odd[1],
            grid: vec![ZERO; half * height],
            column: vec![ZERO; height],
            row: vec![0.0; width],
            scratch: vec![ZERO; scratch.into_iter().max().unwrap_or(0)],
        };
        for y in 0..height {
            let j = y.min(height - y);
            for x in 0..width {
                let i = x.min(width - x);
                // Indices beyond the middle stand for negative offsets, where an odd kernel has
                // the opposite sign.
                let negative = (odd[0] && i != x) != (odd[1] && j != y);
                let value = if i < columns && j < rows { kernel(i, j) } else { 0.0 };
                convolution.row[x] = if negative { -value } else { value };
            }
            convolution.row_forward(y);
        }
        let scale = 1.0 / (width * height) as f64;
        for i in 0..half {
            convolution.column_forward(i, height);
            for (j, value) in convolution.column.iter().enumerate() {
                let part = if convolution.imaginary { value.im } else { value.re };
                convolution.spectrum[i * height + j] = scale * part;
            }
        }
        convolution
    }

    /// Replaces a field, stored row by row, by its convolution with the kernel.
    pub(crate) fn apply(&mut self, field: &mut [f64]) {
        let (columns, rows) = (self.columns, self.rows);
        let (height, half) = (self.column.len(), self.row.len() / 2 + 1);
        for (j, values) in field.chunks_exact(columns).enumerate() {
            self.row[..columns].copy_from_slice(values);
            self.row[columns..].fill(0.0);
            self.row_forward(j);
        }
        for i in 0..half {
            self.column_forward(i, rows);
            let spectrum = &self.spectrum[i * height..(i + 1) * height];
            for (value, factor) in self.column.iter_mut().zip(spectrum) {
                let [re, im] = [value.re * factor, value.im * factor];
                *value =
                    if self.imaginary { Complex64::new(-im, re) } else { Complex64::new(re, im) };
            }
            self.plans.column_back.process_with_scratch(&mut self.column, &mut self.scratch);
            for (j, value) in self.column[..rows].iter().enumerate() {
                self.grid[j * half + i] = *value;
            }
        }
        for (values, from) in field.chunks_exact_mut(columns).zip(self.grid.chunks_exact_mut(half))
        {
            // The first and the last coefficient of a real row's transform are real; rounding
            // errors in them would make the inverse transform fail.
            (from[0].im, from[half - 1].im) = (0.0, 0.0);
            let back = &self.plans.row_back;
            let done = back.process_with_scratch(from, &mut self.row, &mut self.scratch);
            debug_assert!(done.is_ok(), "the lengths are the plan's");
            values.copy_from_slice(&self.row[..columns]);
        }
    }

    /// Transforms the workspace row into row `j` of the grid.
    fn row_forward(&mut self, j: usize) {
        let half = self.row.len() / 2 + 1;
        let to = &mut self.grid[j * half..(j + 1) * half];
        let done = self.plans.row.process_with_scratch(&mut self.row, to, &mut self.scratch);
        debug_assert!(done.is_ok(), "the lengths are the plan's");
    }

    /// Transforms column `i` of the grid, of which only the first `rows` are not zero.
    fn column_forward(&mut self, i: usize, rows: usize) {
        let half = self.row.len() / 2 + 1;
        for (value, from) in self.column[..rows].iter_mut().zip(self.grid.chunks_exact(half)) {
            *value = from[i];
        }
        self.column[rows..].fill(ZERO);
        self.plans.column.process_with_scratch(&mut self.column, &mut self.scratch);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_even_and_smooth() {
        let lengths = [1, 2, 7, 10, 14, 33, 96, 97, 512, 1022].map(transform_length);
        assert_eq!(lengths, [2, 2, 8, 10, 16, 36, 96, 100, 512, 1024]);
    }

    #[test]
    fn a_convolution_is_the_double_sum() {
        for odd in [[false, false], [true, false], [false, true], [true, true]] {
            for size in [[5, 3], [4, 4], [1, 1], [7, 13]] {
                check(size, odd);
            }
        }
    }

    fn check([columns, rows]: [usize; 2], odd: [bool; 2]) {
        let kernel = |i: usize, j: usize| {
            // An odd kernel is zero on its axis.
            let is_zero = (odd[0] && i == 0) || (odd[1] && j == 0);
            if is_zero { 0.0 } else { 1.0 / (1.0 + i as f64 + 2.5 * (j * j) as f64) }
        };
        let mut convolution = Convolution::with_parity([columns, rows], odd, kernel);
        let expected = |field: &[f64], n: usize| -> f64 {
            let term = |(m, value): (usize, &f64)| {
                let [(i, k), (j, l)] = [(n % columns, m % columns), (n / columns, m / columns)];
                let negative = (odd[0] && i < k) != (odd[1] && j < l);
                let size = kernel(i.abs_diff(k), j.abs_diff(l)) * value;
                if negative { -size } else { size }
            };
            field.iter().enumerate().map(term).sum()
        };
        // The second field shows that the first one leaves nothing behind in the workspace.
        for seed in [1.3, 0.7] {
            let mut field: Vec<f64> =
                (0..columns * rows).map(|n| libm::sin(seed * (n + 1) as f64)).collect();
            let wanted: Vec<f64> = (0..columns * rows).map(|n| expected(&field, n)).collect();
            convolution.apply(&mut field);
            for (n, (found, wanted)) in field.iter().zip(&wanted).enumerate() {
                assert!((found - wanted).abs() < 1e-13, "{n}: {found} {wanted}");
            }
        }
    }
}
