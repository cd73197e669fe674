//! Fourier integrals of the layer's transfer functions and tables of their kernels in real space.
//! Lengths are in layer thicknesses here.

use super::layer::Transfer;
use super::numeric::interpolation::{Stencil, six_point};
use super::wave_grid::{FIELD_REACH, trapezoidal_grid};

/// Where the base functions (about a exp(-a)) have fallen under 1e-15.
pub(crate) const BASE_CUTOFF: f64 = 40.0;
/// Where the remainders at the surface (about a^2 exp(-2a)) have fallen under 1e-15.
pub(crate) const SURFACE_CUTOFF: f64 = 21.0;
/// Table points per thickness.
const POINTS_PER_THICKNESS: f64 = 32.0;

/// A transfer function sampled for the trapezoidal rule: (a, weight times value).
pub(crate) struct TransferSamples {
    samples: Vec<(f64, f64)>,
}

impl TransferSamples {
    /// Samples `transfer` for points up to `reach` thicknesses from the origin.
    pub(crate) fn new(transfer: impl Fn(f64) -> f64, reach: f64, cutoff: f64) -> Self {
        let grid = trapezoidal_grid(reach, FIELD_REACH, cutoff);
        let sample = |[a, weight]: [f64; 2]| (a, weight * transfer(a));
        Self { samples: grid.into_iter().map(sample).collect() }
    }

    /// (1/pi) times the integral of f(a) cos(a x) over a from 0.
    pub(crate) fn cosine(&self, x: f64) -> f64 {
        let sum: f64 = self.samples.iter().map(|(a, f)| f * libm::cos(a * x)).sum();
        sum / core::f64::consts::PI
    }

    /// (1/pi) times the integrals of f cos(a x) and of f sin(a x)/a at x = 0, 1, 2 ... `spacing`.
    fn tabulate(&self, spacing: f64, count: usize) -> Vec<[f64; 2]> {
        let mut table = vec![[0.0, 0.0]; count];
        for &(a, f) in &self.samples {
            let (sine, cosine) = (libm::sin(a * spacing), libm::cos(a * spacing));
            let (mut s, mut c) = (0.0, 1.0);
            let over = if a > 0.0 { 1.0 / a } else { 0.0 };
            for (i, entry) in table.iter_mut().enumerate() {
                entry[0] += f * c;
                entry[1] += f * if a > 0.0 { s * over } else { i as f64 * spacing };
                (s, c) = (s * cosine + c * sine, c * cosine - s * sine);
            }
        }
        let scale = 1.0 / core::f64::consts::PI;
        table.iter().map(|[c, s]| [c * scale, s * scale]).collect()
    }
}

/// (1/pi) times the integral of f(a) cos(a x) over a from 0.
pub(crate) fn cosine_integral(f: impl Fn(f64) -> f64, x: f64, cutoff: f64) -> f64 {
    // Beyond the reach the field is under the error of the sum.
    if x > 2.0 * FIELD_REACH { 0.0 } else { TransferSamples::new(f, x, cutoff).cosine(x) }
}

/// A function on a uniform grid from 0, read by six-point interpolation.
struct UniformTable {
    /// Values at -2, -1, 0, 1 ... grid spacings.
    values: Vec<f64>,
}

impl UniformTable {
    /// `values` at 0, 1, 2 ... spacings of a function with f(-x) = `parity` f(x).
    fn new(values: impl Iterator<Item = f64> + Clone, parity: f64) -> Self {
        let mirrored: Vec<f64> = values.clone().skip(1).take(2).map(|v| parity * v).collect();
        Self { values: mirrored.iter().rev().copied().chain(values).collect() }
    }

    /// The function at `place` grid spacings from 0; the caller stays inside the table.
    fn at(&self, place: f64) -> f64 {
        six_point(&self.values, place)
    }
}

/// The logarithmic kernel of a surface displacement, K(x) = integral of f(a) cos(a x) over a from 0
/// with a f(a) going to 1: kept as S(x) = K(x) + ln x, which is smooth and even.
pub(crate) struct SurfaceKernel {
    smooth: UniformTable,
}

impl SurfaceKernel {
    /// Tabulates the kernel of a compliance f(a).
    pub(crate) fn new(compliance: impl Fn(f64) -> f64) -> Self {
        // The integral of tanh(a)/a cos(a x) is ln coth(pi x/4); the rest dies as exp(-2a).
        let rest = |a: f64| {
            let tanh_over = if a > 0.0 { libm::tanh(a) / a } else { 1.0 };
            core::f64::consts::PI * (compliance(a) - tanh_over)
        };
        let count = (FIELD_REACH * POINTS_PER_THICKNESS) as usize + 8;
        let table = TransferSamples::new(rest, FIELD_REACH, SURFACE_CUTOFF)
            .tabulate(1.0 / POINTS_PER_THICKNESS, count);
        let values = table.iter().enumerate().map(|(i, [cosine, _])| {
            let y = core::f64::consts::FRAC_PI_4 * i as f64 / POINTS_PER_THICKNESS;
            let scaled = if y < 1e-4 { 1.0 - y * y / 3.0 } else { libm::tanh(y) / y };
            cosine - libm::log(core::f64::consts::FRAC_PI_4 * scaled)
        });
        let values: Vec<f64> = values.collect();
        Self { smooth: UniformTable::new(values.iter().copied(), 1.0) }
    }

    /// S at a distance of `x` >= 0 thicknesses.
    pub(crate) fn smooth(&self, x: f64) -> f64 {
        if x >= FIELD_REACH { libm::log(x) } else { self.smooth.at(x * POINTS_PER_THICKNESS) }
    }
}

/// The odd kernel that couples the two surface displacements, integral of N(a) sin(a x)/a over a
/// from 0, kept without its step (n pi/2) sign(x).
pub(crate) struct CouplingKernel {
    smooth: UniformTable,
    far: f64,
}

impl CouplingKernel {
    /// Tabulates the kernel.
    pub(crate) fn new(transfer: &Transfer) -> Self {
        let rest = |a: f64| core::f64::consts::PI * (transfer.coupling(a) - transfer.n);
        let count = (FIELD_REACH * POINTS_PER_THICKNESS) as usize + 8;
        let table = TransferSamples::new(rest, FIELD_REACH, SURFACE_CUTOFF)
            .tabulate(1.0 / POINTS_PER_THICKNESS, count);
        let far = -transfer.n * core::f64::consts::FRAC_PI_2;
        Self { smooth: UniformTable::new(table.iter().map(|entry| entry[1]), -1.0), far }
    }

    /// The kernel less its step at `x` thicknesses, of either sign.
    pub(crate) fn smooth(&self, x: f64) -> f64 {
        let distance = x.abs();
        let value = if distance >= FIELD_REACH {
            self.far
        } else {
            self.smooth.at(distance * POINTS_PER_THICKNESS)
        };
        if x < 0.0 { -value } else { value }
    }
}

/// The part of a unit normal line load at 0 that the base carries left of x, and its density there.
pub(crate) struct BaseKernel {
    density: UniformTable,
    half_share: UniformTable,
}

impl BaseKernel {
    /// Tabulates the kernel.
    pub(crate) fn new(transfer: &Transfer) -> Self {
        let count = (FIELD_REACH * POINTS_PER_THICKNESS) as usize + 8;
        let sampled = TransferSamples::new(|a| transfer.base_normal(a), FIELD_REACH, BASE_CUTOFF);
        let table = sampled.tabulate(1.0 / POINTS_PER_THICKNESS, count);
        let density = UniformTable::new(table.iter().map(|entry| entry[0]), 1.0);
        Self { density, half_share: UniformTable::new(table.iter().map(|entry| entry[1]), -1.0) }
    }

    /// Part of the load carried left of `x` thicknesses, and load per thickness of the base there.
    pub(crate) fn share_and_density(&self, x: f64) -> [f64; 2] {
        let distance = x.abs();
        let [half, density] = if distance >= FIELD_REACH {
            [0.5, 0.0]
        } else {
            let at = Stencil::new(self.density.values.len(), distance * POINTS_PER_THICKNESS);
            [at.of(&self.half_share.values), at.of(&self.density.values)]
        };
        [if x < 0.0 { 0.5 - half } else { 0.5 + half }, density]
    }
}
