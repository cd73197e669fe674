//! Sums over the cosines of one slice, wave after wave of its transform. Each usual number of
//! cosines has code of its own, so that the partial sums stay in registers. The results equal those
//! of plain sums to the last bit.

use crate::numeric::interpolation::cubic;
use crate::numeric::wide::wide;

/// Waves whose places in the table are found side by side.
const WAVE_LANES: usize = 4;

/// Calls `$of::<N>` if `$n` is a usual number of cosines, otherwise `$any`.
macro_rules! sized {
    ($n:expr, $of:ident($($with:expr),*), $any:expr) => {
        match $n {
            3 => $of::<3>($($with),*),
            4 => $of::<4>($($with),*),
            5 => $of::<5>($($with),*),
            6 => $of::<6>($($with),*),
            7 => $of::<7>($($with),*),
            8 => $of::<8>($($with),*),
            9 => $of::<9>($($with),*),
            10 => $of::<10>($($with),*),
            11 => $of::<11>($($with),*),
            12 => $of::<12>($($with),*),
            13 => $of::<13>($($with),*),
            14 => $of::<14>($($with),*),
            _ => $any,
        }
    };
}
pub(super) use sized;

wide! {
    /// Writes the amplitude of each wave of the transform: the sum of the cosines' coefficients
    /// times their transforms.
    pub(super) fn mode_amplitudes(transform: &[f64], cosines: &[f64], sums: &mut [f64])
        = mode_amplitudes_narrow;

    /// Adds to each cosine the sum over the waves of its transform times the wave's value.
    pub(super) fn add_cosines(transform: &[f64], waves: &[f64], sums: &mut [f64])
        = add_cosines_narrow;

    /// Adds to a lower triangle the sum over the waves of the products of two cosines' transforms,
    /// times the wave's weight.
    pub(super) fn add_squares(transform: &[f64], weights: &[f64], n: usize, block: &mut [f64])
        = add_squares_narrow;

    /// Writes the transform of `n` cosines, interpolated by cubics in a table. The place of a wave
    /// in the table is its wave number times two factors.
    pub(super) fn interpolate_transform(
        table: &[f64],
        n: usize,
        waves: &[f64],
        by: [f64; 2],
        out: &mut [f64],
    )
        = interpolate_narrow;
}

#[inline(always)]
fn mode_amplitudes_narrow(transform: &[f64], cosines: &[f64], sums: &mut [f64]) {
    sized!(cosines.len(), mode_amplitudes_sized(transform, cosines, sums), {
        for (sum, values) in sums.iter_mut().zip(transform.chunks_exact(cosines.len())) {
            *sum = values.iter().zip(cosines).map(|(x, y)| x * y).sum();
        }
    });
}

#[inline(always)]
fn mode_amplitudes_sized<const N: usize>(transform: &[f64], cosines: &[f64], sums: &mut [f64]) {
    let Some(own) = cosines.first_chunk::<N>() else { return };
    for (sum, values) in sums.iter_mut().zip(transform.as_chunks::<N>().0) {
        *sum = values.iter().zip(own).map(|(x, y)| x * y).sum();
    }
}

#[inline(always)]
fn add_cosines_narrow(transform: &[f64], waves: &[f64], sums: &mut [f64]) {
    sized!(sums.len(), add_cosines_sized(transform, waves, sums), {
        for (values, felt) in transform.chunks_exact(sums.len()).zip(waves) {
            sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += felt * value);
        }
    });
}

#[inline(always)]
fn add_cosines_sized<const N: usize>(transform: &[f64], waves: &[f64], sums: &mut [f64]) {
    let Some(to) = sums.first_chunk_mut::<N>() else { return };
    let mut own = *to;
    for (values, felt) in transform.as_chunks::<N>().0.iter().zip(waves) {
        own.iter_mut().zip(values).for_each(|(sum, value)| *sum += felt * value);
    }
    *to = own;
}

#[inline(always)]
fn add_squares_narrow(transform: &[f64], weights: &[f64], n: usize, block: &mut [f64]) {
    sized!(n, add_squares_sized(transform, weights, block), {
        for (values, weight) in transform.chunks_exact(n).zip(weights) {
            for k in 0..n {
                for l in 0..=k {
                    block[k * n + l] += weight * values[k] * values[l];
                }
            }
        }
    });
}

#[inline(always)]
fn add_squares_sized<const N: usize>(transform: &[f64], weights: &[f64], block: &mut [f64]) {
    let mut own = [[0.0; N]; N];
    for (own, row) in own.iter_mut().zip(block.as_chunks::<N>().0) {
        *own = *row;
    }
    for (values, weight) in transform.as_chunks::<N>().0.iter().zip(weights) {
        for (row, value) in own.iter_mut().zip(values) {
            let felt = weight * value;
            row.iter_mut().zip(values).for_each(|(sum, other)| *sum += felt * other);
        }
    }
    for ((k, row), own) in block.as_chunks_mut::<N>().0.iter_mut().enumerate().zip(&own) {
        row[..=k].copy_from_slice(&own[..=k]);
    }
}

#[inline(always)]
fn interpolate_narrow(table: &[f64], n: usize, waves: &[f64], by: [f64; 2], out: &mut [f64]) {
    sized!(n, interpolate_sized(table, waves, by, out), {
        for (waves, out) in waves.chunks(WAVE_LANES).zip(out.chunks_mut(WAVE_LANES * n)) {
            let (cells, weights) = places(waves, by, table.len() / n);
            for (lane, values) in out.chunks_exact_mut(n).enumerate() {
                let v = &table[cells[lane] * n..(cells[lane] + 4) * n];
                let [a, b, c, d] = &weights;
                let w = [a[lane], b[lane], c[lane], d[lane]];
                for (k, value) in values.iter_mut().enumerate() {
                    let [e, f] = [w[0] * v[k] + w[1] * v[n + k], w[2] * v[2 * n + k]];
                    *value = e + f + w[3] * v[3 * n + k];
                }
            }
        }
    });
}

#[inline(always)]
fn interpolate_sized<const N: usize>(table: &[f64], waves: &[f64], by: [f64; 2], out: &mut [f64]) {
    let (rows, out) = (table.as_chunks::<N>().0, out.as_chunks_mut::<N>().0);
    for (waves, out) in waves.chunks(WAVE_LANES).zip(out.chunks_mut(WAVE_LANES)) {
        let (cells, [wa, wb, wc, wd]) = places(waves, by, rows.len());
        for (lane, values) in out.iter_mut().enumerate() {
            if let [a, b, c, d] = &rows[cells[lane]..cells[lane] + 4] {
                for (k, value) in values.iter_mut().enumerate() {
                    let [e, f] = [wa[lane] * a[k] + wb[lane] * b[k], wc[lane] * c[k]];
                    *value = e + f + wd[lane] * d[k];
                }
            }
        }
    }
}

/// For some waves, the first of the four rows of the table between which each is interpolated, and
/// the weights of the rows, those of the first row first.
#[inline(always)]
fn places(
    waves: &[f64],
    by: [f64; 2],
    rows: usize,
) -> ([usize; WAVE_LANES], [[f64; WAVE_LANES]; 4]) {
    let (mut cells, mut rest, mut weights) =
        ([0; WAVE_LANES], [0.0; WAVE_LANES], [[0.0; WAVE_LANES]; 4]);
    for ((cell, rest), wave) in cells.iter_mut().zip(&mut rest).zip(waves) {
        let place = wave * by[0] * by[1];
        *cell = (place as usize).min(rows - 4);
        *rest = place - *cell as f64;
    }
    for lane in 0..WAVE_LANES {
        let [a, b, c, d] = cubic(rest[lane]);
        (weights[0][lane], weights[1][lane]) = (a, b);
        (weights[2][lane], weights[3][lane]) = (c, d);
    }
    (cells, weights)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Irregular numbers, whose sum changes in the last bits when the order of summation changes.
    pub(in super::super) fn numbers(count: usize, from: f64) -> Vec<f64> {
        (0..count).map(|i| libm::sin(from + 1.7 * i as f64) / 3.0).collect()
    }

    /// Compares the sums, for usual and other numbers of cosines, with plain loops.
    #[test]
    fn sums_are_the_same_to_the_last_bit() {
        const WAVE_COUNT: usize = 11;
        for n in 2..17 {
            let (transform, own) = (numbers(n * WAVE_COUNT, 0.3), numbers(n, 2.0));
            let weights = numbers(WAVE_COUNT, 5.0);
            let mut sums = vec![0.0; WAVE_COUNT];
            mode_amplitudes(&transform, &own, &mut sums);
            for (sum, values) in sums.iter().zip(transform.chunks_exact(n)) {
                let exact: f64 = values.iter().zip(&own).map(|(x, y)| x * y).sum();
                assert_eq!(*sum, exact, "{n}");
            }
            let (mut found, mut exact) = (own.clone(), own);
            add_cosines(&transform, &weights, &mut found);
            for (values, weight) in transform.chunks_exact(n).zip(&weights) {
                exact.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
            }
            assert_eq!(found, exact);
            let (mut found, mut exact) = (numbers(n * n, 1.0), numbers(n * n, 1.0));
            add_squares(&transform, &weights, n, &mut found);
            for (values, weight) in transform.chunks_exact(n).zip(&weights) {
                for at in (0..n * n).filter(|at| at % n <= at / n) {
                    exact[at] += weight * values[at / n] * values[at % n];
                }
            }
            assert_eq!(found, exact);
            let (mut found, mut narrow) = (vec![0.0; 4 * n], vec![0.0; 4 * n]);
            let (places, by) = ([0.0, 0.6, 3.7, 7.2], [0.5, 16.0]);
            let sparse = places.map(|place| place / 8.0);
            interpolate_transform(&transform, n, &sparse, by, &mut found);
            interpolate_narrow(&transform, n, &sparse, by, &mut narrow);
            assert_eq!(found, narrow);
            for (at, value) in found.iter().enumerate() {
                let cell = libm::floor(places[at / n]) as usize;
                let w = cubic(places[at / n] - cell as f64);
                let [a, b, c, d] = [0, 1, 2, 3].map(|i| transform[(cell + i) * n + at % n]);
                assert_eq!(*value, w[0] * a + w[1] * b + w[2] * c + w[3] * d, "{n}");
            }
        }
    }
}
