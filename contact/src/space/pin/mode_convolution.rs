//! The sums that take most of the time of a row's coupling: the convolution of all slices along the
//! pin, with several modes side by side, and the integral along the pin, with several points side
//! by side.

use crate::numeric::wide::wide;

/// Modes that are summed side by side: with fewer an addition waits for the one before it.
pub(super) const CHUNK_LEN: usize = 16;
/// Points of the sum along the pin that are taken side by side.
pub(super) const POINT_LANES: usize = 8;

/// Weights of the modes by distance.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChunkWeights<'a> {
    /// Weights at the distances 0, 1 ... slices, chunk after chunk.
    pub(super) weights: &'a [[f64; CHUNK_LEN]],
    /// Largest distance in slices at which each chunk still acts.
    pub(super) lasting: &'a [usize],
}

/// Weights of all distances chunk after chunk, each up to the largest distance at which it acts.
pub(super) fn weights_by_chunk(weighted: &[f64], lasting: &[usize]) -> Vec<[f64; CHUNK_LEN]> {
    let (all, count) = (weighted.as_chunks().0, lasting.len());
    let chunks = lasting
        .iter()
        .enumerate()
        .flat_map(|(c, lasting)| all[c..].iter().step_by(count).take(lasting + 1).copied());
    chunks.collect()
}

wide! {
    /// Writes the response at each of so many slices, slice after slice, to the amplitudes of all
    /// slices, chunk after chunk.
    pub(super) fn convolve_modes(
        weights: ChunkWeights<'_>,
        spectra: &[[f64; CHUNK_LEN]],
        slices: usize,
        response: &mut [[f64; CHUNK_LEN]],
    ) = convolve_modes_narrow;

    /// Adds c(m), m = 0, 1 ..., of some points side by side: each one's value times cos(q m h).
    pub(super) fn add_points(
        row: &mut [f64],
        values: &[f64; POINT_LANES],
        cosines: &[f64; POINT_LANES],
    )
        = add_points_narrow;
}

#[inline(always)]
fn convolve_modes_narrow(
    weights: ChunkWeights<'_>,
    spectra: &[[f64; CHUNK_LEN]],
    slices: usize,
    response: &mut [[f64; CHUNK_LEN]],
) {
    let ChunkWeights { mut weights, lasting } = weights;
    let columns = spectra.chunks_exact(slices.max(1));
    for (c, (column, last)) in columns.zip(lasting).enumerate() {
        let (own, rest) = weights.split_at(last + 1);
        weights = rest;
        for j in 0..slices {
            let (before, from) = column.split_at(j);
            response[j * lasting.len() + c] = slice_response(own, before, from);
        }
    }
}

/// Each cosine follows from its recurrence; the points are summed one after the other.
#[inline(always)]
fn add_points_narrow(row: &mut [f64], values: &[f64; POINT_LANES], cosines: &[f64; POINT_LANES]) {
    let (mut now, mut next, mut twice) = ([1.0; POINT_LANES], *cosines, *cosines);
    twice.iter_mut().for_each(|cosine| *cosine *= 2.0);
    for entry in row {
        for lane in 0..POINT_LANES {
            *entry += values[lane] * now[lane];
            let after = twice[lane] * next[lane] - now[lane];
            (now[lane], next[lane]) = (next[lane], after);
        }
    }
}

/// Response at a slice to the slices before it, to itself and to the slices after it, by the
/// weights of the distances 0, 1 ... slices.
#[inline(always)]
fn slice_response(
    weights: &[[f64; CHUNK_LEN]],
    before: &[[f64; CHUNK_LEN]],
    from: &[[f64; CHUNK_LEN]],
) -> [f64; CHUNK_LEN] {
    let mut sum = [0.0; CHUNK_LEN];
    let ([own, after @ ..], [first, away @ ..]) = (from, weights) else { return sum };
    add(&mut sum, first, own);
    let both = before.len().min(after.len()).min(away.len());
    let (near, far) = away.split_at(both);
    for ((weights, one), other) in near.iter().zip(before.iter().rev()).zip(after) {
        add_both(&mut sum, weights, one, other);
    }
    // At distances beyond the shorter side only the longer side has slices.
    let (before, after) = (before[..before.len() - both].iter().rev(), after[both..].iter());
    far.iter().zip(before).for_each(|(weights, of)| add(&mut sum, weights, of));
    far.iter().zip(after).for_each(|(weights, of)| add(&mut sum, weights, of));
    sum
}

/// Adds the weighted amplitudes of one slice.
#[inline(always)]
fn add(to: &mut [f64; CHUNK_LEN], weights: &[f64; CHUNK_LEN], of: &[f64; CHUNK_LEN]) {
    for ((value, weight), of) in to.iter_mut().zip(weights).zip(of) {
        *value += weight * of;
    }
}

/// Adds the weighted amplitudes of two slices at the same distance.
#[inline(always)]
fn add_both(
    to: &mut [f64; CHUNK_LEN],
    weights: &[f64; CHUNK_LEN],
    one: &[f64; CHUNK_LEN],
    other: &[f64; CHUNK_LEN],
) {
    for (((value, weight), one), other) in to.iter_mut().zip(weights).zip(one).zip(other) {
        *value += weight * (one + other);
    }
}

#[cfg(test)]
mod tests {
    use super::super::cosine_sums::tests::numbers;
    use super::*;

    fn chunks(count: usize, from: f64) -> Vec<[f64; CHUNK_LEN]> {
        numbers(count * CHUNK_LEN, from).as_chunks().0.to_vec()
    }

    /// For several reaches, compares the response with plain sums, and with those in narrow
    /// registers to the last bit.
    #[test]
    fn slices_are_reached_by_all_that_are_near() {
        let lasting = [6, 3, 0, 9];
        let weights = chunks(lasting.iter().map(|last| last + 1).sum(), 0.3);
        for slices in [1, 2, 5, 8, 13] {
            let spectra = chunks(lasting.len() * slices, 2.0);
            let mut wide = vec![[0.0; CHUNK_LEN]; lasting.len() * slices];
            let mut narrow = wide.clone();
            let own = ChunkWeights { weights: &weights, lasting: &lasting };
            convolve_modes(own, &spectra, slices, &mut wide);
            convolve_modes_narrow(own, &spectra, slices, &mut narrow);
            assert_eq!(wide, narrow);
            let mut first = 0;
            for (c, last) in lasting.iter().enumerate() {
                for j in 0..slices {
                    for k in 0..CHUNK_LEN {
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
        let [mut values, mut cosines] = [[0.0; POINT_LANES]; 2];
        for lane in 0..POINT_LANES {
            (values[lane], cosines[lane]) = (0.3 + lane as f64, libm::cos(0.1 + lane as f64));
        }
        let (mut wide, mut narrow) = (vec![0.5; 23], vec![0.5; 23]);
        add_points(&mut wide, &values, &cosines);
        add_points_narrow(&mut narrow, &values, &cosines);
        assert_eq!(wide, narrow);
        for (m, found) in wide.iter().enumerate() {
            let terms =
                (0..POINT_LANES).map(|l| values[l] * libm::cos(m as f64 * (0.1 + l as f64)));
            let off = found - 0.5 - terms.sum::<f64>();
            assert!(off.abs() < 1e-12, "{m}: {off:e}");
        }
    }
}
