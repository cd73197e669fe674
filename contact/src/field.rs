//! Stresses and displacements of a line load on the bonded layer or on a half plane, at any depth.
//!
//! For the layer: the ten closed transfer functions, free of cancellation, summed by the
//! trapezoidal rule in the wave number, which converges exponentially here. Close under the surface
//! that sum would get long: there the half plane's part is taken out in closed form, and the rest,
//! which dies as exp(-2a + k d), is summed by Gauss's rule. For the half plane: Flamant's solution,
//! whose displacements are undetermined (they hold an arbitrary length). Depths outside the
//! layer are refused.

use super::kernel::{BASE_CUTOFF, SURFACE_CUTOFF, cosine_integral};
use super::layer::{Layer, Transfer};
use super::wave_grid::{DECAY_EXPONENT, FIELD_REACH, gauss_grid, trapezoidal_grid};
use super::{Invalid, number};
use core::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Above this depth, in thicknesses, the half plane is taken out.
const SHALLOW_DEPTH_MAX: f64 = 0.05;

/// A load on a line across the layer, per unit length of the line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineLoad {
    /// Normal load P in N/mm, above 0 when it pushes into the layer.
    pub p_n_mm: f64,
    /// Tangential load Q in N/mm, above 0 along +x.
    pub q_n_mm: f64,
}

/// The state at a point; `None` is infinite or undetermined there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinePoint {
    /// Normal stress along z in MPa.
    pub szz_mpa: Option<f64>,
    /// Normal stress along x in MPa.
    pub sxx_mpa: Option<f64>,
    /// Shear stress in MPa, z up.
    pub sxz_mpa: Option<f64>,
    /// Displacement along z (up) in mm.
    pub uz_mm: Option<f64>,
    /// Displacement along x in mm.
    pub ux_mm: Option<f64>,
}

/// Stresses and displacements at `depth_mm` under the surface and `x_mm` from the line, one for
/// each x. Allocates; the error is about 1e-13 of 1/t per unit load, and close under the surface
/// 1e-15 of the half plane's own stress.
///
/// # Errors
/// A layer that [`Layer::check`] refuses; anything not finite; a depth below 0 or above the
/// thickness.
pub fn line(
    layer: &Layer,
    load: &LineLoad,
    depth_mm: f64,
    x_mm: &[f64],
) -> Result<Vec<LinePoint>, Invalid> {
    layer.check()?;
    check(load, depth_mm, x_mm)?;
    let depth = depth_mm / layer.thickness_mm;
    if depth > 1.0 {
        let what = format!("{depth_mm:?} is outside the layer");
        return Err(Invalid::new("depth_mm", what, "give 0 to the layer's thickness"));
    }
    let nearest = |x: &f64| (x / layer.thickness_mm).abs();
    let reach = x_mm.iter().map(nearest).filter(|x| *x <= 2.0 * FIELD_REACH).fold(0.0, f64::max);
    let transfer = layer.transfer();
    let modes = if depth >= SHALLOW_DEPTH_MAX {
        TransferSamples::inside(&transfer, depth, reach)
    } else if depth > 0.0 {
        TransferSamples::shallow(&transfer, depth, reach)
    } else {
        TransferSamples::surface(&transfer, reach)
    };
    Ok(x_mm.iter().map(|x| modes.point(layer, load, x / layer.thickness_mm)).collect())
}

impl Layer {
    /// Normal stress at the base per unit normal line load (1/mm, negative under the load) at
    /// `x_mm` from the line, exact to about 1e-14; NaN for NaN. A Fourier sum of several hundred
    /// terms.
    #[must_use]
    pub fn base_szz_line(&self, x_mm: f64) -> f64 {
        let transfer = self.transfer();
        let x = (x_mm / self.thickness_mm).abs();
        -cosine_integral(|a| transfer.base_normal(a), x, BASE_CUTOFF) / self.thickness_mm
    }
}

/// [`line`](fn@line) for the half plane: stresses only.
///
/// # Errors
/// Anything not finite; a depth below 0.
pub fn line_half_plane(
    load: &LineLoad,
    depth_mm: f64,
    x_mm: &[f64],
) -> Result<Vec<LinePoint>, Invalid> {
    check(load, depth_mm, x_mm)?;
    Ok(x_mm.iter().map(|x| flamant(load, depth_mm, *x)).collect())
}

fn check(load: &LineLoad, depth_mm: f64, x_mm: &[f64]) -> Result<(), Invalid> {
    number("p_n_mm", load.p_n_mm)?;
    number("q_n_mm", load.q_n_mm)?;
    number("depth_mm", depth_mm)?;
    if depth_mm < 0.0 {
        let what = format!("{depth_mm} is above the surface");
        return Err(Invalid::new("depth_mm", what, "give 0 or more"));
    }
    x_mm.iter().try_for_each(|x| number("x_mm", *x))
}

fn flamant(load: &LineLoad, d: f64, x: f64) -> LinePoint {
    let r2 = x * x + d * d;
    if r2 == 0.0 {
        return LinePoint::default();
    }
    // Radial stress along the ray; P d + Q x is the load's part along it.
    let radial = -2.0 / PI * (load.p_n_mm * d + load.q_n_mm * x) / r2;
    LinePoint {
        szz_mpa: Some(radial * d * d / r2),
        sxx_mpa: Some(radial * x * x / r2),
        sxz_mpa: Some(-radial * x * d / r2),
        uz_mm: None,
        ux_mm: None,
    }
}

/// The ten sums at one point, per unit load, lengths in thicknesses, displacements times 2G.
#[derive(Clone, Copy, Default)]
struct Sums {
    szz: [f64; 2],
    sxx: [f64; 2],
    sxz: [f64; 2],
    uz: [f64; 2],
    ux: [f64; 2],
}

/// Transfer functions at one wave number, each divided by E; the factor of the cosine comes first.
#[derive(Clone, Copy)]
struct TransferValues {
    a: f64,
    /// F, F', F'' for P.
    f: [f64; 3],
    /// H, H', H'' for Q.
    h: [f64; 3],
    /// A and D over a, for cos(a x); B and C, for sin(a x)/a.
    u: [f64; 4],
}

/// The part that a sum leaves out, which is added in closed form.
#[derive(Clone, Copy, PartialEq)]
enum SeparatePart {
    Nothing,
    /// The part that does not die with the wave number at the surface.
    Surface,
    /// The half plane's part at this depth.
    HalfPlane(f64),
}

struct TransferSamples {
    /// Weights over pi, and the functions.
    modes: Vec<(f64, TransferValues)>,
    transfer: Transfer,
    separate: SeparatePart,
}

impl TransferSamples {
    fn inside(transfer: &Transfer, depth: f64, reach: f64) -> Self {
        let grid = trapezoidal_grid(reach, FIELD_REACH, DECAY_EXPONENT / depth);
        Self::sample(&grid, *transfer, SeparatePart::Nothing, |a| {
            TransferValues::inside(transfer, a, depth)
        })
    }

    fn shallow(transfer: &Transfer, depth: f64, reach: f64) -> Self {
        let grid = gauss_grid(reach, depth);
        let rest =
            |a| TransferValues::inside(transfer, a, depth).without_half_plane(transfer, depth);
        Self::sample(&grid, *transfer, SeparatePart::HalfPlane(depth), rest)
    }

    fn surface(transfer: &Transfer, reach: f64) -> Self {
        let grid = trapezoidal_grid(reach, FIELD_REACH, SURFACE_CUTOFF);
        Self::sample(&grid, *transfer, SeparatePart::Surface, |a| {
            TransferValues::surface(transfer, a)
        })
    }

    fn sample(
        grid: &[[f64; 2]],
        transfer: Transfer,
        separate: SeparatePart,
        mode: impl Fn(f64) -> TransferValues,
    ) -> Self {
        let modes = grid.iter().map(|[a, weight]| (weight / PI, mode(*a))).collect();
        Self { modes, transfer, separate }
    }

    fn point(&self, layer: &Layer, load: &LineLoad, x: f64) -> LinePoint {
        let depth = if let SeparatePart::HalfPlane(depth) = self.separate { depth } else { 0.0 };
        if self.separate != SeparatePart::Nothing && x * x + depth * depth == 0.0 {
            return LinePoint::default();
        }
        let near = x.abs() <= 2.0 * FIELD_REACH;
        let mut sums = if near { self.sums(x) } else { Sums::default() };
        match self.separate {
            SeparatePart::Nothing => {}
            SeparatePart::Surface => self.add_singular(&mut sums, x),
            SeparatePart::HalfPlane(depth) if near => self.add_half_plane(&mut sums, x, depth),
            SeparatePart::HalfPlane(_) => {}
        }
        let of = |pair: [f64; 2]| load.p_n_mm * pair[0] + load.q_n_mm * pair[1];
        let (t, g2) = (layer.thickness_mm, 2.0 * layer.shear_mpa());
        LinePoint {
            szz_mpa: Some(of(sums.szz) / t),
            sxx_mpa: Some(of(sums.sxx) / t),
            sxz_mpa: Some(of(sums.sxz) / t),
            uz_mm: Some(of(sums.uz) / g2),
            ux_mm: Some(of(sums.ux) / g2),
        }
    }

    fn sums(&self, x: f64) -> Sums {
        let mut sums = Sums::default();
        for (weight, mode) in &self.modes {
            let (sine, cosine) = (libm::sin(mode.a * x), libm::cos(mode.a * x));
            let (c, s) = (weight * cosine, weight * sine);
            let s_over = if mode.a > 0.0 { s / mode.a } else { weight * x };
            sums.szz[0] -= mode.f[0] * c;
            sums.szz[1] += mode.h[0] * s;
            sums.sxz[0] += mode.f[1] * s;
            sums.sxz[1] += mode.h[1] * c;
            sums.sxx[0] += mode.f[2] * c;
            sums.sxx[1] -= mode.h[2] * s;
            sums.uz[0] += mode.u[0] * c;
            sums.uz[1] -= mode.u[2] * s_over;
            sums.ux[0] += mode.u[3] * s_over;
            sums.ux[1] += mode.u[1] * c;
        }
        sums
    }

    /// The parts that [`TransferValues::without_half_plane`] leaves out: Flamant's stresses, and
    /// displacements whose logarithm is that of the ratio of the distances from the line and
    /// from a line 2 t above it.
    fn add_half_plane(&self, sums: &mut Sums, x: f64, d: f64) {
        let Transfer { m, n, .. } = self.transfer;
        let r2 = x * x + d * d;
        for (load, along) in [d, x].into_iter().enumerate() {
            let radial = -2.0 / PI * along / r2;
            sums.szz[load] += radial * d * d / r2;
            sums.sxx[load] += radial * x * x / r2;
            sums.sxz[load] -= radial * x * d / r2;
        }
        let logarithm = 0.5 * libm::log((4.0 + x * x) / r2);
        let angle = n * libm::atan2(x, d);
        sums.uz[0] -= (d * d / r2 + m * logarithm) / PI;
        sums.ux[1] -= (d * d / r2 - m * logarithm) / PI;
        sums.uz[1] -= (d * x / r2 + angle) / PI;
        sums.ux[0] += (d * x / r2 - angle) / PI;
    }

    /// The parts that [`TransferValues::surface`] leaves out, in closed form.
    fn add_singular(&self, sums: &mut Sums, x: f64) {
        let Transfer { m, n, .. } = self.transfer;
        // Integral of tanh(a)/a cos(a x): ln coth(pi |x|/4); of tanh(a) sin(a x): its slope.
        let logarithm = -libm::log(libm::tanh(FRAC_PI_4 * x.abs()));
        sums.uz[0] -= m / PI * logarithm;
        sums.ux[1] += m / PI * logarithm;
        if x.abs() <= 2.0 * FIELD_REACH {
            let jump = n * FRAC_PI_2.copysign(x) / PI;
            sums.uz[1] -= jump;
            sums.ux[0] -= jump;
            sums.sxx[1] -= 1.0 / libm::sinh(FRAC_PI_2 * x);
        }
    }
}

impl TransferValues {
    fn inside(transfer: &Transfer, a: f64, depth: f64) -> Self {
        let Transfer { m, n, kap } = *transfer;
        let (dl, e) = (a * depth, a * (1.0 - depth));
        let mu = m * m + n * n;
        // cosh and sinh of a + e and of a - e = dl, times exp(-2a), over E exp(-2a).
        let over = 0.5 / transfer.determinant_scaled(a);
        let (large, small) = (libm::exp(-dl), libm::exp(dl - 4.0 * a));
        let (near, far) = (libm::exp(dl - 2.0 * a), libm::exp(-dl - 2.0 * a));
        let (cp, sp) = (over * (large + small), over * (large - small));
        let (cm, sm) = (over * (near + far), over * (near - far));
        let f = [
            a * e * cm + 0.5 * (kap * dl * sp + (a + e) * sm + kap * cp + mu * cm),
            0.5 * (dl * (cm + kap * cp) + (1.0 - mu) * sm) - a * e * sm,
            0.5 * (dl * (kap * sp - sm) - (cm + kap * cp) - (1.0 - mu) * cm) - a * sm + a * e * cm,
        ];
        let aemn = a * e + m * n;
        let h = [
            -aemn * sm - 0.5 * dl * (kap * cp + cm),
            -a * sm + aemn * cm + 0.5 * (kap * cp + cm) - 0.5 * dl * (kap * sp - sm),
            2.0 * a * cm - aemn * sm + (kap * sp - sm) - 0.5 * dl * (kap * cp + cm),
        ];
        let u = if a == 0.0 {
            let height = (1.0 - depth) / m;
            [height * (1.0 - kap), height * (1.0 + kap), 0.0, 0.0]
        } else {
            let even = 0.5 * ((kap * a + e) * cm - kap * dl * cp);
            let odd = 0.5 * (kap * dl * sp - (kap * a - e) * sm);
            let (sines, cosines) = (0.5 * m * kap * (sp - sm), 0.5 * n * kap * (cp - cm));
            [
                (a * e * sm + even - sines) / a,
                (-a * e * sm + even + sines) / a,
                -a * e * cm + odd + cosines,
                a * e * cm + odd - cosines,
            ]
        };
        Self { a, f, h, u }
    }

    /// Less the half plane's part, with exp(-k d) - exp(-2a) over a for its 1/a.
    fn without_half_plane(mut self, transfer: &Transfer, depth: f64) -> Self {
        let Transfer { m, n, .. } = *transfer;
        let (a, y) = (self.a, self.a * depth);
        let decay = libm::exp(-y);
        for (f, less) in self.f.iter_mut().zip([1.0 + y, y, y - 1.0]) {
            *f -= less * decay;
        }
        for (h, less) in self.h.iter_mut().zip([-y, 1.0 - y, 2.0 - y]) {
            *h -= less * decay;
        }
        let slow = m * libm::exp(-2.0 * a) * libm::expm1(2.0 * a - y) / a;
        let straight = depth * decay;
        self.u[0] += straight + slow;
        self.u[1] += straight - slow;
        self.u[2] -= (y + n) * decay;
        self.u[3] -= (y - n) * decay;
        self
    }

    /// At depth 0 without the load itself (a concentrated stress) and without the parts
    /// that do not die with a: 2 tanh a in sxx per Q, tanh(a)/a and n in the coupled displacements.
    fn surface(transfer: &Transfer, a: f64) -> Self {
        let Transfer { m, n, kap } = *transfer;
        let q = libm::exp(-2.0 * a);
        let over = 1.0 / transfer.determinant_scaled(a);
        let (cosh2, sinh2) = (0.5 * (1.0 + q * q), 0.5 * (1.0 - q * q));
        let mu = m * m + n * n;
        let sxx_p = (q * (a * a - 1.0 + 0.5 * mu) - 0.5 * kap * cosh2) * over + 1.0;
        let tanh = libm::tanh(a);
        let sxx_q = (2.0 * a * q + kap * sinh2) * over - 2.0 * tanh;
        let tanh_over = if a > 0.0 { tanh / a } else { 1.0 };
        let coupling = transfer.coupling(a) - n;
        let down = m * (transfer.normal_compliance(a) - tanh_over);
        let along = m * (transfer.tangential_compliance(a) - tanh_over);
        let (f, h) = ([0.0, 0.0, sxx_p], [0.0, 0.0, sxx_q]);
        Self { a, f, h, u: [-down, along, coupling, -coupling] }
    }
}
