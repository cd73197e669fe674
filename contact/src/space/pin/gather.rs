//! The sums of a row's coupling that take most of its time: what reaches each slice of all, some
//! waves side by side, and the sum along the pin, some points side by side. They refuse nothing.

use crate::numeric::wide::wide;

/// Modes that are summed side by side: with fewer an addition waits for the one before it.
pub(super) const CHUNK: usize = 16;
/// Points of the sum along the pin that are taken side by side.
pub(super) const LANES: usize = 8;

/// Weights of all distances chunk after chunk, each as far as some of its modes are left.
pub(super) fn by_chunk(weighted: &[f64], lasting: &[usize]) -> Vec<[f64; CHUNK]> {
    let (all, count) = (weighted.as_chunks().0, lasting.len());
    let chunks = lasting
        .iter()
        .enumerate()
        .flat_map(|(c, lasting)| all[c..].iter().step_by(count).take(lasting + 1).copied());
    chunks.collect()
}

wide! {
    /// Writes what reaches each slice, slice after slice, of the sums across all of them, by the
    /// weights of each chunk as far as they last.
    pub(super) fn gather(
        weights: (&[[f64; CHUNK]], &[usize]),
        spectra: (&[[f64; CHUNK]], usize),
        acted: &mut [[f64; CHUNK]],
    ) = gathered;

    /// Adds c(m), m = 0, 1 ..., of some points side by side: each one's value times cos(q m h).
    pub(super) fn add_points(row: &mut [f64], values: &[f64; LANES], cosines: &[f64; LANES])
        = points_added;
}

#[inline(always)]
fn gathered(
    (mut weights, lasting): (&[[f64; CHUNK]], &[usize]),
    (spectra, slices): (&[[f64; CHUNK]], usize),
    acted: &mut [[f64; CHUNK]],
) {
    let columns = spectra.chunks_exact(slices.max(1));
    for (c, (column, last)) in columns.zip(lasting).enumerate() {
        let (own, rest) = weights.split_at(last + 1);
        weights = rest;
        for j in 0..slices {
            acted[j * lasting.len() + c] = reached(own, column.split_at(j));
        }
    }
}

/// By its recurrence each cosine; the points are summed one after the other.
#[inline(always)]
fn points_added(row: &mut [f64], values: &[f64; LANES], cosines: &[f64; LANES]) {
    let (mut now, mut next, mut twice) = ([1.0; LANES], *cosines, *cosines);
    twice.iter_mut().for_each(|cosine| *cosine *= 2.0);
    for entry in row {
        for lane in 0..LANES {
            *entry += values[lane] * now[lane];
            let after = twice[lane] * next[lane] - now[lane];
            (now[lane], next[lane]) = (next[lane], after);
        }
    }
}

/// What reaches a slice of those before it and of those from it on, by weights of 0, 1 ... slices'
/// distance.
#[inline(always)]
fn reached(
    weights: &[[f64; CHUNK]],
    (before, from): (&[[f64; CHUNK]], &[[f64; CHUNK]]),
) -> [f64; CHUNK] {
    let mut sum = [0.0; CHUNK];
    let ([own, after @ ..], [first, away @ ..]) = (from, weights) else { return sum };
    add(&mut sum, first, own);
    let both = before.len().min(after.len()).min(away.len());
    let (near, far) = away.split_at(both);
    for ((weights, one), other) in near.iter().zip(before.iter().rev()).zip(after) {
        add_both(&mut sum, weights, one, other);
    }
    // One side ends.
    let (before, after) = (before[..before.len() - both].iter().rev(), after[both..].iter());
    far.iter().zip(before).for_each(|(weights, of)| add(&mut sum, weights, of));
    far.iter().zip(after).for_each(|(weights, of)| add(&mut sum, weights, of));
    sum
}

/// Adds to each mode of a chunk what a slice does to it.
#[inline(always)]
fn add(to: &mut [f64; CHUNK], weights: &[f64; CHUNK], of: &[f64; CHUNK]) {
    for ((value, weight), of) in to.iter_mut().zip(weights).zip(of) {
        *value += weight * of;
    }
}

/// The same for two slices equally far away.
#[inline(always)]
fn add_both(
    to: &mut [f64; CHUNK],
    weights: &[f64; CHUNK],
    one: &[f64; CHUNK],
    other: &[f64; CHUNK],
) {
    for (((value, weight), one), other) in to.iter_mut().zip(weights).zip(one).zip(other) {
        *value += weight * (one + other);
    }
}

#[cfg(test)]
mod tests {
    use super::super::cosines::tests::numbers;
    use super::*;

    fn chunks(count: usize, from: f64) -> Vec<[f64; CHUNK]> {
        numbers(count * CHUNK, from).as_chunks().0.to_vec()
    }

    /// Slices that reach each other for several distances, against the sums as they are written and
    /// to the last bit against those in narrow registers.
    #[test]
    fn slices_are_reached_by_all_that_are_near() {
        let lasting = [6, 3, 0, 9];
        let weights = chunks(lasting.iter().map(|last| last + 1).sum(), 0.3);
        for slices in [1, 2, 5, 8, 13] {
            let spectra = chunks(lasting.len() * slices, 2.0);
            let mut wide = vec![[0.0; CHUNK]; lasting.len() * slices];
            let mut narrow = wide.clone();
            gather((&weights, &lasting), (&spectra, slices), &mut wide);
            gathered((&weights, &lasting), (&spectra, slices), &mut narrow);
            assert_eq!(wide, narrow);
            let mut first = 0;
            for (c, last) in lasting.iter().enumerate() {
                for j in 0..slices {
                    for k in 0..CHUNK {
                        let felt = |i: usize| weights[first + i.abs_diff(j)][k];
                        let near = (0..slices).filter(|i| i.abs_diff(j) <= *last);
                        let exact: f64 = near.map(|i| felt(i) * spectra[c * slices + i][k]).sum();
                        let off = wide[j * lasting.len() + c][k] - exact;
                        assert!(off.abs() < 1e-14, "{slices} {c} {j} {k}: {off:e}");
                    }
                }
                first += last + 1;
            }
        }
    }

    #[test]
    fn points_are_added_alike_in_wide_and_narrow_registers() {
        let [mut values, mut cosines] = [[0.0; LANES]; 2];
        for lane in 0..LANES {
            (values[lane], cosines[lane]) = (0.3 + lane as f64, libm::cos(0.1 + lane as f64));
        }
        let (mut wide, mut narrow) = (vec![0.5; 23], vec![0.5; 23]);
        add_points(&mut wide, &values, &cosines);
        points_added(&mut narrow, &values, &cosines);
        assert_eq!(wide, narrow);
        for (m, found) in wide.iter().enumerate() {
            let terms = (0..LANES).map(|l| values[l] * libm::cos(m as f64 * (0.1 + l as f64)));
            let off = found - 0.5 - terms.sum::<f64>();
            assert!(off.abs() < 1e-12, "{m}: {off:e}");
        }
    }
}
