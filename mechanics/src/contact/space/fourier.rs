//! Convolution of real fields with a kernel that is even or odd along each axis, by Fourier
//! transforms on a padded grid. Sizes are powers of two. Transforming neither allocates nor panics;
//! the same input gives the same bits on every machine.

use core::f64::consts::PI;

/// A complex number.
type Complex = [f64; 2];

/// Transforms of one length, in place, forwards (exponent -i).
#[derive(Clone, Debug)]
struct Line {
    length: usize,
    twiddles: Vec<Complex>,
}

impl Line {
    fn new(length: usize) -> Self {
        let twiddle = |k: usize| {
            let angle = -2.0 * PI * k as f64 / length as f64;
            [libm::cos(angle), libm::sin(angle)]
        };
        Self { length, twiddles: (0..length / 2).map(twiddle).collect() }
    }

    /// Decimation in frequency: the result is in bit-reversed order.
    fn forward(&self, x: &mut [Complex]) {
        let mut span = self.length;
        while span > 1 {
            let (half, stride) = (span / 2, self.length / span);
            for chunk in x.chunks_exact_mut(span) {
                let (low, high) = chunk.split_at_mut(half);
                let factors = self.twiddles.iter().step_by(stride);
                for ((a, b), w) in low.iter_mut().zip(high).zip(factors) {
                    let (sum, rest) = ([a[0] + b[0], a[1] + b[1]], [a[0] - b[0], a[1] - b[1]]);
                    *a = sum;
                    *b = [rest[0] * w[0] - rest[1] * w[1], rest[0] * w[1] + rest[1] * w[0]];
                }
            }
            span = half;
        }
    }

    /// Undoes [`Line::forward`], but for the factor of the length.
    fn backward(&self, x: &mut [Complex]) {
        let mut span = 2;
        while span <= self.length {
            let (half, stride) = (span / 2, self.length / span);
            for chunk in x.chunks_exact_mut(span) {
                let (low, high) = chunk.split_at_mut(half);
                let factors = self.twiddles.iter().step_by(stride);
                for ((a, b), w) in low.iter_mut().zip(high).zip(factors) {
                    let turned = [b[0] * w[0] + b[1] * w[1], b[1] * w[0] - b[0] * w[1]];
                    (*a, *b) = (
                        [a[0] + turned[0], a[1] + turned[1]],
                        [a[0] - turned[0], a[1] - turned[1]],
                    );
                }
            }
            span *= 2;
        }
    }
}

/// A kernel that is even or odd along each axis, ready to be convolved with fields of one size.
#[derive(Clone, Debug)]
pub(crate) struct Convolution {
    columns: usize,
    rows: usize,
    across: Line,
    along: Line,
    /// The kernel's transform, real or imaginary throughout, in the order of the transforms, with
    /// the normalisation.
    spectrum: Vec<f64>,
    imaginary: bool,
    grid: Vec<Complex>,
    column: Vec<Complex>,
}

impl Convolution {
    /// Takes an even kernel at offsets (i, j), 0 <= i < columns, 0 <= j < rows.
    pub(crate) fn new(columns: usize, rows: usize, kernel: impl Fn(usize, usize) -> f64) -> Self {
        Self::of([columns, rows], [false; 2], kernel)
    }

    /// The same of a kernel that is odd along the axes named so.
    pub(crate) fn of(
        [columns, rows]: [usize; 2],
        odd: [bool; 2],
        kernel: impl Fn(usize, usize) -> f64,
    ) -> Self {
        let length = |n: usize| (2 * n).next_power_of_two();
        let (across, along) = (Line::new(length(columns)), Line::new(length(rows)));
        let (width, height) = (across.length, along.length);
        let mut made = Self {
            columns,
            rows,
            across,
            along,
            spectrum: vec![0.0; width * height],
            imaginary: odd[0] != odd[1],
            grid: vec![[0.0; 2]; width * height],
            column: vec![[0.0; 2]; height],
        };
        for (n, value) in made.grid.iter_mut().enumerate() {
            let (at, of) = (n % width, n / width);
            let (i, j) = (at.min(width - at), of.min(height - of));
            if i < columns && j < rows {
                let turned = (odd[0] && i != at) != (odd[1] && j != of);
                *value = [if turned { -kernel(i, j) } else { kernel(i, j) }, 0.0];
            }
        }
        made.rows_forward(height);
        for i in 0..width {
            made.load_column(i);
            made.along.forward(&mut made.column);
            for (j, value) in made.column.iter().enumerate() {
                let part = value[usize::from(made.imaginary)];
                made.spectrum[i * height + j] = part / (width * height) as f64;
            }
        }
        made
    }

    /// Convolves two fields at once, row by row; both are replaced by the results.
    pub(crate) fn apply(&mut self, first: &mut [f64], second: Option<&mut [f64]>) {
        let (width, height) = (self.across.length, self.along.length);
        let columns = self.columns;
        self.grid.fill([0.0; 2]);
        for (row, values) in first.chunks_exact(columns).enumerate() {
            for (target, value) in self.grid[row * width..].iter_mut().zip(values) {
                target[0] = *value;
            }
        }
        if let Some(second) = &second {
            for (row, values) in second.chunks_exact(columns).enumerate() {
                for (target, value) in self.grid[row * width..].iter_mut().zip(values.iter()) {
                    target[1] = *value;
                }
            }
        }
        self.rows_forward(self.rows);
        for i in 0..width {
            self.load_column(i);
            self.along.forward(&mut self.column);
            let spectrum = &self.spectrum[i * height..(i + 1) * height];
            for (value, factor) in self.column.iter_mut().zip(spectrum) {
                *value = [value[0] * factor, value[1] * factor];
                if self.imaginary {
                    *value = [-value[1], value[0]];
                }
            }
            self.along.backward(&mut self.column);
            for (j, value) in self.column[..self.rows].iter().enumerate() {
                self.grid[j * width + i] = *value;
            }
        }
        for row in self.grid.chunks_exact_mut(width).take(self.rows) {
            self.across.backward(row);
        }
        for (row, values) in first.chunks_exact_mut(columns).enumerate() {
            for (value, source) in values.iter_mut().zip(&self.grid[row * width..]) {
                *value = source[0];
            }
        }
        if let Some(second) = second {
            for (row, values) in second.chunks_exact_mut(columns).enumerate() {
                for (value, source) in values.iter_mut().zip(&self.grid[row * width..]) {
                    *value = source[1];
                }
            }
        }
    }

    fn rows_forward(&mut self, count: usize) {
        for row in self.grid.chunks_exact_mut(self.across.length).take(count) {
            self.across.forward(row);
        }
    }

    fn load_column(&mut self, i: usize) {
        let width = self.across.length;
        for (j, value) in self.column.iter_mut().enumerate() {
            *value = self.grid[j * width + i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_convolution_is_the_double_sum() {
        for odd in [[false, false], [true, false], [false, true], [true, true]] {
            check(odd);
        }
    }

    fn check(odd: [bool; 2]) {
        let (columns, rows) = (5, 3);
        let kernel = |i: usize, j: usize| {
            let nothing = (odd[0] && i == 0) || (odd[1] && j == 0);
            if nothing { 0.0 } else { 1.0 / (1.0 + i as f64 + 2.5 * (j * j) as f64) }
        };
        let mut convolution = Convolution::of([columns, rows], odd, kernel);
        let field = |seed: f64| -> Vec<f64> {
            (0..columns * rows).map(|n| libm::sin(seed * (n + 1) as f64)).collect()
        };
        let (mut first, mut second) = (field(1.3), field(0.7));
        let expected = |field: &[f64], n: usize| -> f64 {
            let term = |(m, value): (usize, &f64)| {
                let [(i, k), (j, l)] = [(n % columns, m % columns), (n / columns, m / columns)];
                let turned = (odd[0] && i < k) != (odd[1] && j < l);
                let size = kernel(i.abs_diff(k), j.abs_diff(l)) * value;
                if turned { -size } else { size }
            };
            field.iter().enumerate().map(term).sum()
        };
        let wanted: Vec<[f64; 2]> =
            (0..columns * rows).map(|n| [expected(&first, n), expected(&second, n)]).collect();
        convolution.apply(&mut first, Some(&mut second));
        for (n, [a, b]) in wanted.iter().enumerate() {
            assert!((first[n] - a).abs() < 1e-13, "{n}: {} {a}", first[n]);
            assert!((second[n] - b).abs() < 1e-13, "{n}: {} {b}", second[n]);
        }
    }
}
