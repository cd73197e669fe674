//! How the slices of a pin act on each other through the layer: cosine modes across the pin, a
//! convolution along it.
//!
//! A slice is a strip of constant pressure over a length h. Across the pin its pressure has the
//! transform sum a_k pi (-1)^k J_2k(kappa b), J_2k+1 where it is odd. For each wave number kappa
//! the slices couple through c(m) = h integral over q from 0 of f(sqrt(kappa^2 + q^2)) sinc^2(q
//! h/2) cos(q m h), f = M/k, of which the plane problem, pi f(kappa) at m = 0, is taken out: it is
//! solved exactly elsewhere, and what is left falls off as kappa^-3. Lengths are in thicknesses.
//! Acting neither allocates nor panics.

use super::super::super::layer::Transfer;
use super::strip::cubic;
use core::f64::consts::PI;

/// Table points per unit of the Bessel functions' argument.
const BESSEL_DENSITY: f64 = 8.0;
/// The integral along the pin is cut at this over h; the tail is added in closed form.
const CUT: f64 = 120.0;

/// How finely the coupling is resolved.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Modes {
    /// Room between the pin and its images across, thicknesses.
    pub(crate) margin: f64,
    /// Largest wave number across.
    pub(crate) cutoff: f64,
    /// Slices further apart than this do not act on each other.
    pub(crate) reach: f64,
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
    band: usize,
    step: f64,
    /// Weight of each mode in a scalar product.
    weights: Vec<f64>,
    /// c(m) without the plane problem, mode after mode, m = 0..=band.
    along: Vec<f64>,
    /// pi (-1)^k J_2k(z) on a grid over z, k fastest.
    bessel: Vec<f64>,
    /// Sums across each slice, mode after mode.
    spectra: Vec<f64>,
    acted: Vec<f64>,
}

impl Coupling {
    /// Tables for slices of length `h`, at most `slices` of them, half-widths up to `widest`.
    pub(crate) fn new(
        transfer: &Transfer,
        (fineness, parity): (Modes, Parity),
        (cosines, widest): (usize, f64),
        (slices, h): (usize, f64),
    ) -> Self {
        let period = 2.0 * widest + fineness.margin;
        let step = 2.0 * PI / period;
        let modes = libm::ceil(fineness.cutoff / step) as usize + 1;
        let band = (libm::ceil(fineness.reach / h) as usize).min(slices.saturating_sub(1));
        let mut along = Vec::with_capacity(modes * (band + 1));
        for n in 0..modes {
            push_row(&mut along, transfer, n as f64 * step, h, band);
        }
        let points = libm::ceil(modes as f64 * step * widest * BESSEL_DENSITY) as usize + 4;
        let mut bessel = Vec::with_capacity(points * cosines);
        for i in 0..points {
            // One point before 0, for the cubic.
            let z = (i as f64 - 1.0) / BESSEL_DENSITY;
            for k in 0..cosines {
                let sign = if k.is_multiple_of(2) { PI } else { -PI };
                bessel.push(sign * libm::jn(2 * k as i32 + i32::from(parity == Parity::Odd), z));
            }
        }
        let weight = |n: usize| if n == 0 { 1.0 / period } else { 2.0 / period };
        Self {
            cosines,
            modes,
            band,
            step,
            weights: (0..modes).map(weight).collect(),
            along,
            bessel,
            spectra: vec![0.0; modes * slices],
            acted: vec![0.0; modes * slices],
        }
    }

    /// Numbers that [`Coupling::transform`] writes for one slice.
    pub(crate) fn transform_len(&self) -> usize {
        self.modes * self.cosines
    }

    /// Transforms of the cosines of a strip of half-width `b`, mode after mode.
    pub(crate) fn transform(&self, b: f64, out: &mut [f64]) {
        let n = self.cosines;
        for (mode, values) in out.chunks_exact_mut(n).enumerate() {
            let place = mode as f64 * self.step * b * BESSEL_DENSITY;
            let cell = (place as usize).min(self.bessel.len() / n - 4);
            let w = cubic(place - cell as f64);
            let v = &self.bessel[cell * n..(cell + 4) * n];
            for (k, value) in values.iter_mut().enumerate() {
                *value = w[0] * v[k] + w[1] * v[n + k] + w[2] * v[2 * n + k] + w[3] * v[3 * n + k];
            }
        }
    }

    /// Adds the coupling's part of the diagonal block of a slice to the lower triangle `block`.
    pub(crate) fn add_block(&self, transform: &[f64], block: &mut [f64]) {
        let n = self.cosines;
        for (mode, values) in transform.chunks_exact(n).enumerate() {
            let weight = self.weights[mode] * self.along[mode * (self.band + 1)];
            for k in 0..n {
                for l in 0..=k {
                    block[k * n + l] += weight * values[k] * values[l];
                }
            }
        }
    }

    /// Adds what all slices do to each one: `out` and `input` hold the cosines slice after slice.
    pub(crate) fn act(&mut self, transforms: &[f64], input: &[f64], out: &mut [f64]) {
        let slices = input.len() / self.cosines;
        self.convolve(transforms, input);
        let per_slice = self.modes * self.cosines;
        for (j, sums) in out.chunks_exact_mut(self.cosines).enumerate() {
            let transform = &transforms[j * per_slice..(j + 1) * per_slice];
            for (mode, values) in transform.chunks_exact(self.cosines).enumerate() {
                let felt = self.weights[mode] * self.acted[mode * slices + j];
                for (sum, value) in sums.iter_mut().zip(values) {
                    *sum += felt * value;
                }
            }
        }
    }

    fn convolve(&mut self, transforms: &[f64], input: &[f64]) {
        let (n, slices) = (self.cosines, input.len() / self.cosines);
        let per_slice = self.modes * n;
        for (j, a) in input.chunks_exact(n).enumerate() {
            let transform = &transforms[j * per_slice..(j + 1) * per_slice];
            for (mode, values) in transform.chunks_exact(n).enumerate() {
                let sum: f64 = values.iter().zip(a).map(|(x, y)| x * y).sum();
                self.spectra[mode * slices + j] = sum;
            }
        }
        for mode in 0..self.modes {
            let kernel = &self.along[mode * (self.band + 1)..(mode + 1) * (self.band + 1)];
            let from = &self.spectra[mode * slices..(mode + 1) * slices];
            let to = &mut self.acted[mode * slices..(mode + 1) * slices];
            for (value, own) in to.iter_mut().zip(from) {
                *value = kernel[0] * own;
            }
            for (m, c) in kernel.iter().enumerate().skip(1) {
                if m >= slices {
                    break;
                }
                for (value, other) in to[m..].iter_mut().zip(from) {
                    *value += c * other;
                }
                for (value, other) in to.iter_mut().zip(&from[m..]) {
                    *value += c * other;
                }
            }
        }
    }

    /// Displacement on the middle line of a slice that carries nothing, from the last
    /// [`Coupling::act`].
    pub(crate) fn middle(&self, slice: usize, slices: usize) -> f64 {
        let felt = self.acted.iter().skip(slice).step_by(slices);
        self.weights.iter().zip(felt).map(|(w, a)| w * a).sum()
    }
}

/// Appends c(m), m = 0..=band, of the wave number `kappa` across.
fn push_row(out: &mut Vec<f64>, transfer: &Transfer, kappa: f64, h: f64, band: usize) {
    let period = 2.0 * (band as f64 * h + 20.0);
    let step = 2.0 * PI / period;
    let count = libm::ceil(CUT / h / step) as usize;
    let start = out.len();
    out.resize(start + band + 1, 0.0);
    let row = &mut out[start..];
    let compliance = |a: f64| if a > 30.0 { 1.0 / a } else { transfer.normal_compliance(a) };
    for i in 0..=count {
        let q = i as f64 * step;
        let half = 0.5 * q * h;
        let sinc = if i == 0 { 1.0 } else { libm::sin(half) / half };
        let weight = if i == 0 { 0.5 * step } else { step };
        let value = h * weight * sinc * sinc * compliance((kappa * kappa + q * q).sqrt());
        // cos(q m h) by its recurrence.
        let c = libm::cos(q * h);
        let (mut now, mut next) = (1.0, c);
        for entry in row.iter_mut() {
            *entry += value * now;
            (now, next) = (next, 2.0 * c * next - now);
        }
    }
    // Beyond the cut the integrand is 2 (1 - cos(q h)) cos(q m h)/(q^3 h).
    let tail = h / (CUT * CUT);
    row[0] += tail;
    if band > 0 {
        row[1] -= 0.5 * tail;
    }
    row[0] -= PI * compliance(kappa);
}
