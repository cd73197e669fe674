//! The coupling of a pin's slices through the layer: cosine modes across the pin, a convolution
//! along it.
//!
//! A slice is a strip of constant pressure over a length h. Across the pin its pressure has the
//! transform sum a_k pi (-1)^k J_2k(kappa b), with J_2k+1 if the pressure is odd. For each wave
//! number kappa the slices are coupled through c(m) = h integral over q from 0 of f(sqrt(kappa^2 +
//! q^2)) sinc^2(q h/2) cos(q m h), f = M/k, from which the plane problem, pi f(kappa) at m = 0, is
//! subtracted: it is solved exactly elsewhere, and the rest decays as kappa^-3. Lengths are in
//! thicknesses. Applying the coupling neither allocates nor panics.

use super::super::super::layer::Transfer;
use super::cosine_sums;
use super::mode_convolution::{
    CHUNK_LEN, ChunkWeights, POINT_LANES, add_points, convolve_modes, weights_by_chunk,
};
use crate::numeric::bessel;
use crate::numeric::quadrature::legendre;
use core::f64::consts::PI;

/// Table points per unit of the Bessel functions' argument.
const BESSEL_POINTS_PER_UNIT: f64 = 8.0;
/// The integral along the pin is cut at this over h; the tail is added in closed form.
const CUTOFF_TIMES_H: f64 = 120.0;
/// The same for slices shorter than `PANEL_SLICE_MAX` thicknesses, whose integral is summed by
/// panels with `PANEL_POINTS` points each, over at most `PANEL_RADIANS` of the fastest cosine.
const PANEL_CUTOFF_TIMES_H: f64 = 40.0;
const PANEL_SLICE_MAX: f64 = 0.2;
const PANEL_POINTS: usize = 12;
const PANEL_RADIANS: f64 = 8.0;
/// A row shorter than this (thicknesses) needs shorter waves than its level has; the length counts
/// as `ROW_LENGTH_MIN` at least.
const SHORT_ROW_LENGTH: f64 = 2.4;
const ROW_LENGTH_MIN: f64 = 0.25;
/// A contact narrower than this half-width (thicknesses) needs shorter waves than its level has;
/// the half-width counts as `HALF_WIDTH_MIN` at least.
const NARROW_HALF_WIDTH: f64 = 0.6;
const HALF_WIDTH_MIN: f64 = 0.05;
/// A contact wider than this half-width (thicknesses) does not need waves as short as other
/// contacts do.
const BROAD_HALF_WIDTH: f64 = 6.0;
/// Distance between the pin and its periodic images for the shortest waves, thicknesses.
const SHORT_WAVE_MARGIN: f64 = 0.6;
/// Waves across the pin fall off along it by this exponent before they are left out.
const DECAY_EXPONENT_MAX: f64 = 18.0;
/// Wave number (times thickness) from which the compliance is 1/a.
const HALF_PLANE_WAVE_NUMBER: f64 = 30.0;
/// On rows shorter than this (thicknesses) the coupling is interpolated over the wave number.
/// Beside it stand the number of interpolation nodes and the distance from the real axis of the
/// compliance's nearest pole, for any Poisson's ratio.
const INTERPOLATED_LENGTH_MAX: f64 = 2.5;
const INTERPOLATION_NODES: usize = 64;
const COMPLIANCE_POLE: f64 = 0.7;

/// How finely the coupling is resolved.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ModeResolution {
    /// Distance between the pin and its periodic images across the axis, thicknesses.
    pub(crate) margin: f64,
    /// Largest wave number across, and the least that it is where contacts are wide.
    pub(crate) cutoff: f64,
    pub(crate) least: f64,
    /// Slices further apart than this do not act on each other.
    pub(crate) reach: f64,
    /// Growth of the steps between wave numbers: the length of a step is the square root of the sum
    /// of the squares of the first step and of `grade` times the wave number.
    pub(crate) grade: f64,
}

impl ModeResolution {
    /// The resolution adapted to a row of a length and a largest half-width: a short or narrow row
    /// needs shorter waves, and a wide row does not need waves as short. The periodic images of a
    /// short row must not come closer: the part that is solved elsewhere is the plane problem of
    /// endless strips, so the shorter a row is, the more of its response is left in the images.
    pub(crate) fn for_row(self, length: f64, widest: f64) -> Self {
        let shortest = (SHORT_ROW_LENGTH / length.max(ROW_LENGTH_MIN))
            .max(NARROW_HALF_WIDTH / widest.max(HALF_WIDTH_MIN));
        let cutoff = match shortest > 1.0 {
            true => self.cutoff * shortest,
            false => (self.cutoff * (BROAD_HALF_WIDTH / widest).min(1.0)).max(self.least),
        };
        Self { cutoff, ..self }
    }
}

/// Sizes of slices that are coupled.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CoupledSlices {
    /// Cosines of a slice's pressure.
    pub(crate) cosines: usize,
    /// Largest half-width in thicknesses.
    pub(crate) widest: f64,
    /// Number of slices.
    pub(crate) slices: usize,
    /// Length of a slice in thicknesses.
    pub(crate) h: f64,
}

/// Symmetry of the pressure across the pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Parity {
    Even,
    Odd,
}

/// The coupling of equal slices.
#[derive(Clone, Debug)]
pub(crate) struct Coupling {
    cosines: usize,
    modes: usize,
    /// Number of modes, rounded up to whole chunks; the additional ones are zero.
    stride: usize,
    band: usize,
    /// Wave number of each mode.
    waves: Vec<f64>,
    /// c(m) without the plane problem times the mode's weight in a scalar product, m = 0..=band,
    /// mode fastest.
    weighted: Vec<f64>,
    /// For each chunk, the largest distance in slices at which a mode of it still acts.
    lasting: Vec<usize>,
    /// pi (-1)^k J_2k(z) on a grid over z, k fastest.
    bessel: Vec<f64>,
    /// `weighted` chunk after chunk, each up to the largest distance at which it acts.
    near: Vec<[f64; CHUNK_LEN]>,
}

/// Memory of the convolution along the pin.
#[derive(Clone, Debug)]
pub(crate) struct ModeSums {
    /// Amplitudes of one slice, mode after mode.
    slice: Vec<f64>,
    /// Amplitudes of each slice, chunk after chunk.
    spectra: Vec<[f64; CHUNK_LEN]>,
    /// Response at each slice to the amplitudes of all, slice after slice.
    response: Vec<f64>,
}

impl Coupling {
    /// Tabulates the coupling of slices; allocates.
    pub(crate) fn new(
        transfer: &Transfer,
        resolution: ModeResolution,
        parity: Parity,
        sizes: CoupledSlices,
    ) -> Self {
        let CoupledSlices { cosines, widest, slices, h } = sizes;
        let [first, last] =
            [resolution.margin, SHORT_WAVE_MARGIN].map(|room| 2.0 * PI / (2.0 * widest + room));
        // Wave numbers sinh(u), u in equal steps.
        let grown = (last * last - first * first).max(0.0).sqrt() / resolution.cutoff;
        let grade = resolution.grade.min(grown).max(1e-3);
        let end = libm::asinh(grade * resolution.cutoff / first) / grade;
        let modes = libm::ceil(end) as usize + 1;
        let waves: Vec<f64> =
            (0..modes).map(|n| first / grade * libm::sinh(grade * n as f64)).collect();
        let weight = |n: usize| {
            let step = first * libm::cosh(grade * n as f64) / PI;
            if n == 0 { 0.5 * step } else { step }
        };
        let weights: Vec<f64> = (0..modes).map(weight).collect();
        let reach = libm::ceil(resolution.reach / h) as usize;
        let band = reach.min(slices.saturating_sub(1));
        let mut along = Vec::with_capacity(modes * (band + 1));
        let points = along_pin(h, band);
        if slices as f64 * h < INTERPOLATED_LENGTH_MAX && modes > 2 * INTERPOLATION_NODES {
            interpolate_rows(&mut along, transfer, &waves, (h, band), &points);
        } else {
            for wave in &waves {
                push_row(&mut along, transfer, *wave, (h, band), &points);
            }
        }
        for (row, wave) in along.chunks_exact_mut(band + 1).zip(&waves) {
            row[0] -= PI * compliance(transfer, *wave);
            if band == reach {
                close_sum(row);
            }
        }
        let stride = modes.next_multiple_of(CHUNK_LEN);
        let mut weighted = Vec::with_capacity(stride * (band + 1));
        let mut lasting = vec![0; stride / CHUNK_LEN];
        for m in 0..=band {
            let away = m.saturating_sub(1) as f64 * h;
            let left = waves.iter().take_while(|wave| *wave * away < DECAY_EXPONENT_MAX).count();
            weighted.extend((0..left).map(|n| weights[n] * along[n * (band + 1) + m]));
            weighted.resize((m + 1) * stride, 0.0);
            lasting[..left.div_ceil(CHUNK_LEN)].fill(m);
        }
        let points = libm::ceil(waves[modes - 1] * widest * BESSEL_POINTS_PER_UNIT) as usize + 5;
        let odd = usize::from(parity == Parity::Odd);
        let bessel = bessel::table(points, BESSEL_POINTS_PER_UNIT, cosines, odd);
        Self {
            cosines,
            modes,
            stride,
            band,
            waves,
            near: weights_by_chunk(&weighted, &lasting),
            weighted,
            lasting,
            bessel,
        }
    }

    /// Memory of the convolution for at most so many slices; allocates.
    pub(crate) fn sums(&self, slices: usize) -> ModeSums {
        ModeSums {
            slice: vec![0.0; self.stride],
            spectra: vec![[0.0; CHUNK_LEN]; self.stride / CHUNK_LEN * slices],
            response: vec![0.0; self.stride * slices],
        }
    }

    /// Coupling blocks of two slices of the same half-width, for each distance up to the band.
    pub(crate) fn pair_blocks(&self, half_width: f64) -> Vec<f64> {
        let n = self.cosines;
        let mut transform = vec![0.0; self.transform_len()];
        self.transform(half_width, &mut transform);
        let mut blocks = vec![0.0; (self.band + 1) * n * n];
        for (apart, block) in blocks.chunks_exact_mut(n * n).enumerate() {
            for (weight, values) in self.weights_of(apart).iter().zip(transform.chunks_exact(n)) {
                for (row, value) in block.chunks_exact_mut(n).zip(values) {
                    let felt = weight * value;
                    row.iter_mut().zip(values).for_each(|(entry, other)| *entry += felt * other);
                }
            }
        }
        blocks
    }

    /// Weights of the modes for two slices `apart` slice lengths from each other; empty beyond the
    /// reach.
    pub(crate) fn weights_of(&self, apart: usize) -> &[f64] {
        let from = apart * self.stride;
        self.weighted.get(from..from + self.modes).unwrap_or(&[])
    }

    /// Numbers that [`Coupling::transform`] writes for one slice.
    pub(crate) fn transform_len(&self) -> usize {
        self.modes * self.cosines
    }

    /// Transforms of the cosines of a strip of half-width `b`, mode after mode.
    pub(crate) fn transform(&self, b: f64, out: &mut [f64]) {
        cosine_sums::interpolate_transform(
            &self.bessel,
            self.cosines,
            &self.waves,
            [b, BESSEL_POINTS_PER_UNIT],
            out,
        );
    }

    /// Adds the coupling's part of the diagonal block of a slice to the lower triangle `block`.
    pub(crate) fn add_block(&self, transform: &[f64], block: &mut [f64]) {
        cosine_sums::add_squares(transform, &self.weighted, self.cosines, block);
    }

    /// Adds the response of each slice to the pressures of all: `out` and `input` hold the cosine
    /// coefficients slice after slice.
    pub(crate) fn apply(
        &self,
        sums: &mut ModeSums,
        transforms: &[f64],
        input: &[f64],
        out: &mut [f64],
    ) {
        self.convolve(sums, transforms, input);
        let per_slice = self.modes * self.cosines;
        let responses = sums.response.chunks_exact(self.stride);
        let slices = transforms.chunks_exact(per_slice).zip(responses);
        for (to, (transform, response)) in out.chunks_exact_mut(self.cosines).zip(slices) {
            cosine_sums::add_cosines(transform, response, to);
        }
    }

    /// Convolves the amplitudes of all slices along the pin, mode by mode, for
    /// [`Coupling::middle`].
    pub(crate) fn convolve(&self, sums: &mut ModeSums, transforms: &[f64], input: &[f64]) {
        let (n, modes, slices) = (self.cosines, self.modes, input.len() / self.cosines);
        let chunks = self.stride / CHUNK_LEN;
        let inputs = input.chunks_exact(n).zip(transforms.chunks_exact(modes * n));
        for (j, (a, transform)) in inputs.enumerate() {
            cosine_sums::mode_amplitudes(transform, a, &mut sums.slice[..modes]);
            let own = sums.slice.as_chunks().0.iter();
            own.enumerate().for_each(|(c, own)| sums.spectra[c * slices + j] = *own);
        }
        let weights = ChunkWeights { weights: &self.near, lasting: &self.lasting };
        let spectra = &sums.spectra[..chunks * slices];
        convolve_modes(weights, spectra, slices, sums.response.as_chunks_mut().0);
    }

    /// Displacement on the middle line of a slice that carries nothing, from the last
    /// [`Coupling::convolve`].
    pub(crate) fn middle(&self, sums: &ModeSums, slice: usize) -> f64 {
        sums.response[slice * self.stride..][..self.modes].iter().sum()
    }
}

/// Places q, weights that include h sinc^2(q h/2), and cos(q h) of the sum along the pin; also the
/// upper end of the sum.
///
/// Long slices use the trapezoidal rule. For short slices it would need hundreds of thousands of
/// points, so they use Gauss's rule on panels over which the transfer function and the cosines are
/// smooth.
fn along_pin(h: f64, band: usize) -> (Vec<[f64; 3]>, f64) {
    let point = |q: f64, weight: f64| {
        let half = 0.5 * q * h;
        let sinc = if q == 0.0 { 1.0 } else { libm::sin(half) / half };
        [q, h * weight * sinc * sinc, libm::cos(q * h)]
    };
    if h >= PANEL_SLICE_MAX {
        let step = 2.0 * PI / (2.0 * (band as f64 * h + 20.0));
        let count = libm::ceil(CUTOFF_TIMES_H / h / step) as usize;
        let weight = |i: usize| if i == 0 { 0.5 * step } else { step };
        return ((0..=count).map(|i| point(i as f64 * step, weight(i))).collect(), CUTOFF_TIMES_H);
    }
    let end = PANEL_CUTOFF_TIMES_H / h;
    let rule = legendre(PANEL_POINTS);
    let mut points = Vec::new();
    let mut from = 0.0;
    while from < end {
        let smooth = if from < HALF_PLANE_WAVE_NUMBER { 1.5 } else { 0.3 * from };
        let width = (PANEL_RADIANS / (band as f64 * h + h)).min(smooth).min(end - from);
        let panel = rule.iter().map(|(x, w)| (from + 0.5 * width * (1.0 + x), 0.5 * width * w));
        points.extend(panel.map(|(q, weight)| point(q, weight)));
        from += width;
    }
    (points, PANEL_CUTOFF_TIMES_H)
}

/// h times the integral of f(q) sinc^2(q h/2) cos(q m h) for m = 0..=band: the coupling of strips
/// in the plane problem.
pub(crate) fn strip_row(transfer: &Transfer, h: f64, band: usize) -> Vec<f64> {
    let mut row = Vec::with_capacity(band + 1);
    push_row(&mut row, transfer, 0.0, (h, band), &along_pin(h, band));
    row
}

/// The layer's compliance M/a. Waves that are too short to reach the base have the compliance of
/// the half plane.
fn compliance(transfer: &Transfer, a: f64) -> f64 {
    if a > HALF_PLANE_WAVE_NUMBER { 1.0 / a } else { transfer.normal_compliance(a) }
}

/// Appends the c(m) of all wave numbers, ascending from 0, of a short row. They are even functions
/// of the wave number, and their poles are no nearer to the real axis than those of the layer.
/// Therefore they are interpolated over the square of asinh.
fn interpolate_rows(
    out: &mut Vec<f64>,
    transfer: &Transfer,
    waves: &[f64],
    (h, band): (f64, usize),
    points: &(Vec<[f64; 3]>, f64),
) {
    let end = waves.last().map_or(0.0, |last| libm::asinh(last / COMPLIANCE_POLE));
    let angle = |i: usize| PI * (2 * i + 1) as f64 / (2 * INTERPOLATION_NODES) as f64;
    // The place in -1 to 1 is 2 (asinh/end)^2 - 1.
    let nodes: [f64; INTERPOLATION_NODES] = core::array::from_fn(|i| libm::cos(angle(i)));
    let mut rows = Vec::with_capacity(INTERPOLATION_NODES * (band + 1));
    for node in nodes {
        let wave = COMPLIANCE_POLE * libm::sinh(end * (0.5 * (1.0 + node)).sqrt());
        push_row(&mut rows, transfer, wave, (h, band), points);
    }
    for wave in waves {
        let part = libm::asinh(wave / COMPLIANCE_POLE) / end;
        let place = 2.0 * part * part - 1.0;
        let from = out.len();
        out.resize(from + band + 1, 0.0);
        // Lagrange's polynomial, its weights at Chebyshev's nodes (Berrut and Trefethen 2004, 5.2).
        let mut sum = 0.0;
        for (i, (node, row)) in nodes.iter().zip(rows.chunks_exact(band + 1)).enumerate() {
            let away = place - node;
            let sign = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
            let weight = sign * libm::sin(angle(i)) / if away == 0.0 { f64::EPSILON } else { away };
            sum += weight;
            out[from..].iter_mut().zip(row).for_each(|(entry, value)| *entry += weight * value);
        }
        out[from..].iter_mut().for_each(|entry| *entry /= sum);
    }
}

/// Appends c(m), m = 0..=band, of the wave number `kappa` across.
fn push_row(
    out: &mut Vec<f64>,
    transfer: &Transfer,
    kappa: f64,
    (h, band): (f64, usize),
    (points, cut): &(Vec<[f64; 3]>, f64),
) {
    let start = out.len();
    out.resize(start + band + 1, 0.0);
    let row = &mut out[start..];
    for points in points.chunks(POINT_LANES) {
        let (mut values, mut cosines) = ([0.0; POINT_LANES], [0.0; POINT_LANES]);
        for (lane, &[q, weight, c]) in points.iter().enumerate() {
            values[lane] = weight * compliance(transfer, (kappa * kappa + q * q).sqrt());
            cosines[lane] = c;
        }
        add_points(row, &values, &cosines);
    }
    // Beyond the cut the integrand is 2 (1 - cos(q h)) cos(q m h)/(q^3 h).
    let tail = h / (cut * cut);
    row[0] += tail;
    if band > 0 {
        row[1] -= 0.5 * tail;
    }
}

/// Adds the effect of the slices beyond the reach to that of the last slice within it: all slices
/// together must act as one endless strip, whose plane problem is solved elsewhere. This matters
/// for a confined layer that keeps its volume: its response decays only as exp(-0.74 x), and it
/// hardly gives way under a wide contact.
fn close_sum(along: &mut [f64]) {
    if let [own, others @ .., last] = along {
        *last = -0.5 * *own - others.iter().sum::<f64>();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waves_of_short_rows_are_read_between_others() {
        for (nu, h, band) in
            [(0.5, 0.035, 63), (0.3, 0.006, 40), (-0.4, 1.3e-4, 63), (0.0, 0.1, 23)]
        {
            let transfer = Transfer::new(nu);
            let points = along_pin(h, band);
            let waves: Vec<f64> = (0..=129).map(|n| 0.015 * f64::from(n) * f64::from(n)).collect();
            let (mut read, mut summed) = (Vec::new(), Vec::new());
            interpolate_rows(&mut read, &transfer, &waves, (h, band), &points);
            for wave in &waves {
                push_row(&mut summed, &transfer, *wave, (h, band), &points);
            }
            for (at, (read, summed)) in read.iter().zip(&summed).enumerate() {
                let scale = summed.abs().max(h);
                let off = (read - summed).abs();
                assert!(
                    off < 1e-8 * scale,
                    "{nu} {h} {} {}: {read} {summed}",
                    at / (band + 1),
                    at % (band + 1)
                );
            }
        }
    }

    #[test]
    fn panels_give_what_the_trapezoidal_rule_gives() {
        let transfer = Transfer::new(0.45);
        for (h, band) in [(0.19, 30), (0.05, 23), (0.02, 9)] {
            let step = 2.0 * PI / (2.0 * (band as f64 * h + 20.0));
            let count = libm::ceil(CUTOFF_TIMES_H / h / step) as usize;
            let long: Vec<[f64; 3]> = (0..=count)
                .map(|i| {
                    let (q, half) = (i as f64 * step, 0.5 * i as f64 * step * h);
                    let sinc = if i == 0 { 1.0 } else { libm::sin(half) / half };
                    let weight = if i == 0 { 0.5 * step } else { step };
                    [q, h * weight * sinc * sinc, libm::cos(q * h)]
                })
                .collect();
            for kappa in [0.0, 0.6, 5.0, 20.0] {
                let (mut a, mut b) = (Vec::new(), Vec::new());
                push_row(&mut a, &transfer, kappa, (h, band), &along_pin(h, band));
                push_row(&mut b, &transfer, kappa, (h, band), &(long.clone(), CUTOFF_TIMES_H));
                for (m, (a, b)) in a.iter().zip(&b).enumerate() {
                    assert!((a - b).abs() < 1e-4 * h, "{h} {kappa} {m}: {a} {b}");
                }
            }
        }
    }
}
