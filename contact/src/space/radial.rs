//! Computes what a normal point load does to the bonded layer, or to a stack of layers: the
//! displacement of the surface and the normal stress at the base, as functions of the distance.
//!
//! Both are Hankel transforms of the layer's transfer functions of k = |k|: w_hat = (1 - nu)/(G k)
//! M(k t) p_hat and szz_hat = -B(k t) p_hat with B = F/E of [`super::super::layer`]. A radial
//! function is the inverse Abel transform of its projection, and the projection's transform is that
//! of the plane problem; so both tables come from cosine sums of even analytic functions and one
//! trapezoidal rule along the line of sight in the variable whose sinh is the place on it, all
//! exponentially convergent. The singular part of the displacement, 1/r and its images
//! 2 (-1)^n/sqrt(r^2 + 4 n^2 t^2) (those of tanh(k t)/k), is taken exactly.
//!
//! Over cells of constant pressure the singular part is integrated in closed form (Love, 1929), the
//! rest by Gauss's rule. nu = 0.5 needs no special case. Far away both functions decay at least as
//! exp(-0.739 r/t). The singular part of a stack is that of its surface layer; lengths are in
//! thicknesses of that layer.

use super::super::Invalid;
use super::super::layer::Layer;
use super::super::stack::Stack;
use super::ground::{Ground, Sizes, tanh_over};
use super::table::Even;
use core::f64::consts::PI;

/// Table points per thickness.
const POINTS_PER_THICKNESS: f64 = 32.0;
/// Step of the variable whose sinh is the place on the line of sight. The integrands are singular
/// on the imaginary axis only and decay within 45 degrees about the real one, so the error of the
/// trapezoidal rule is exp(-2 pi (pi/4)/0.125).
const SINH_STEP: f64 = 0.125;
/// Image terms summed one by one before the tail is averaged.
const IMAGE_TERMS: usize = 56;

/// The grid of a kernel's table: the distance at which the kernel has decayed, in thicknesses, and
/// the points per thickness.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    pub(super) reach: f64,
    pub(super) density: f64,
}

impl Grid {
    /// Number of points.
    pub(super) fn count(&self) -> usize {
        (self.reach * self.density) as usize + 8
    }
}

/// The two kernels, lengths in thicknesses (of the layer at the surface).
#[derive(Clone, Debug)]
pub(crate) struct Radial {
    /// integral of (M(a) - 1) J0(a r) over a from 0.
    rest: Even,
    /// (1/2 pi) integral of a B(a) J0(a r) over a from 0.
    base: Even,
    /// integral of B(a) a^2 sinc(a x) over a from 0.
    base_slope: Even,
}

impl Radial {
    /// Tabulates both kernels: a few milliseconds for a layer, up to half a second for a stack.
    pub(super) fn new(ground: &Ground) -> Self {
        let grid = Grid { reach: ground.reach, density: POINTS_PER_THICKNESS };
        let cutoffs = ground.cutoffs();
        let slope = slopes(|a| ground.base(a), cutoffs[0], grid);
        let base = line_of_sight(&slope, grid);
        let compliance = |a: f64| ground.normal(a) - tanh_over(a);
        let remainder = line_of_sight(&slopes(compliance, cutoffs[1], grid), grid);
        let rest = |i: usize| images(i as f64 / POINTS_PER_THICKNESS) + 2.0 * remainder[i];
        let rest: Vec<f64> = (0..grid.count()).map(rest).collect();
        let base: Vec<f64> = base.iter().map(|b| b / PI).collect();
        Self {
            rest: Even::new(&rest, POINTS_PER_THICKNESS),
            base: Even::new(&base, POINTS_PER_THICKNESS),
            base_slope: slope,
        }
    }

    /// The displacement's kernel less 1/r.
    pub(crate) fn rest(&self, r: f64) -> f64 {
        if r < self.rest.end() { self.rest.at(r) } else { -1.0 / r }
    }

    /// Base pressure under a unit load, per square thickness.
    pub(crate) fn base(&self, r: f64) -> f64 {
        self.base.at(r)
    }

    /// Slope of the base pressure under a unit line load at `x` >= 0, times -pi/x.
    pub(crate) fn base_slope(&self) -> &Even {
        &self.base_slope
    }
}

/// 2 sum over n >= 1 of (-1)^n/sqrt(r^2 + 4 n^2).
pub(super) fn images(r: f64) -> f64 {
    alternating_sum(|n2| 2.0 / (r * r + n2 * n2).sqrt())
}

/// (1/r^2) integral of s [`images`]\(s) from 0 to r.
pub(super) fn images_mean(r: f64) -> f64 {
    alternating_sum(|n2| 2.0 / ((r * r + n2 * n2).sqrt() + n2))
}

/// Sum over n >= 1 of (-1)^n times a smooth function of 2 n. The last partial sums are averaged in
/// pairs again and again (Euler's transformation), which makes the series converge quickly.
fn alternating_sum(of: impl Fn(f64) -> f64) -> f64 {
    let term = |n: usize| {
        let size = of((2 * n) as f64);
        if n.is_multiple_of(2) { size } else { -size }
    };
    let mut sum: f64 = (1..IMAGE_TERMS).map(term).sum();
    let mut last = [0.0; 10];
    for (i, slot) in last.iter_mut().enumerate() {
        sum += term(IMAGE_TERMS + i);
        *slot = sum;
    }
    for width in (1..last.len()).rev() {
        for i in 0..width {
            last[i] = 0.5 * (last[i] + last[i + 1]);
        }
    }
    last[0]
}

/// q(x) = integral over a from 0 of g(a) a^2 sinc(a x), for an even g that decays exponentially.
pub(super) fn slopes(g: impl Fn(f64) -> f64, cutoff: f64, grid: Grid) -> Even {
    let (count, density) = (grid.count(), grid.density);
    let period = 2.2 * grid.reach;
    let step = 2.0 * PI / period;
    let samples = libm::ceil(cutoff / step) as usize;
    let mut q = vec![0.0; count];
    for k in 1..=samples {
        let a = k as f64 * step;
        let weight = step * a * g(a);
        let (sine, cosine) = (libm::sin(a / density), libm::cos(a / density));
        let (mut s, mut c) = (0.0, 1.0);
        for (i, value) in q.iter_mut().enumerate() {
            *value += if i == 0 { weight * a } else { weight * s * density / i as f64 };
            (s, c) = (s * cosine + c * sine, c * cosine - s * sine);
        }
    }
    Even::new(&q, density)
}

/// (1/r) integral over a from 0 of g(a) J1(a r) at the table's points, for an even g that decays
/// exponentially. It is the slope of a transform of order 0. The derivative is taken before the
/// integral along the line of sight, so that the relative error stays small far out. The value of g
/// at 0 is taken out by a Gaussian, whose transform is known.
pub(super) fn means(g: impl Fn(f64) -> f64, cutoff: f64, grid: Grid) -> Vec<f64> {
    let step = 2.0 * PI / (2.2 * grid.reach);
    let samples = libm::ceil(cutoff / step) as usize;
    let level = g(0.0);
    let mut slope = vec![0.0; grid.count()];
    for k in 1..=samples {
        let a = k as f64 * step;
        let weight = step * a * a * (g(a) - level * libm::exp(-a * a));
        let (sine, cosine) = (libm::sin(a / grid.density), libm::cos(a / grid.density));
        let (mut s, mut c) = (0.0, 1.0);
        for (i, value) in slope.iter_mut().enumerate() {
            *value += weight * bessel_1_over_y(a * i as f64 / grid.density, [s, c]);
            (s, c) = (s * cosine + c * sine, c * cosine - s * sine);
        }
    }
    let seen = line_of_sight(&Even::new(&slope, grid.density), grid);
    let gaussian = |r: f64| if r > 0.0 { -libm::expm1(-0.25 * r * r) / (r * r) } else { 0.25 };
    let mean = |(i, seen): (usize, f64)| 2.0 * seen + level * gaussian(i as f64 / grid.density);
    seen.into_iter().enumerate().map(mean).collect()
}

/// j1(y)/y = (sin y - y cos y)/y^3 with the spherical Bessel function j1, given sin y and cos y.
fn bessel_1_over_y(y: f64, [sine, cosine]: [f64; 2]) -> f64 {
    let s = y * y;
    // The difference would lose its digits near 0: the Taylor series takes its place.
    if y < 0.5 {
        let inner = 1.0 - s / 88.0 * (1.0 - s / 130.0);
        return 1.0 / 3.0 - s / 30.0 * (1.0 - s / 28.0 * (1.0 - s / 54.0 * inner));
    }
    (sine - y * cosine) / (s * y)
}

/// (1/pi) integral over v from 0 of q(sqrt(r^2 + v^2)) at r = 0, 1, 2 ... table spacings. With q of
/// [`slopes`] it is half the integral of a g(a) J0(a r).
pub(super) fn line_of_sight(q: &Even, grid: Grid) -> Vec<f64> {
    let steps = libm::ceil(libm::asinh(grid.reach) / SINH_STEP) as usize;
    let angle = |k: usize| k as f64 * SINH_STEP;
    let stretch = |k: usize| [libm::sinh(angle(k)), libm::cosh(angle(k))];
    let stretches: Vec<[f64; 2]> = (0..=steps).map(stretch).collect();
    let along = |i: usize| {
        let r = i as f64 / grid.density;
        // The distance to the nearest singularity of the integrand sets the scale of the points.
        let scale = (r * r + 1.0).sqrt();
        let mut sum = 0.5 * q.at(r);
        for [sinh, cosh] in &stretches[1..] {
            let v = scale * sinh;
            if v > grid.reach {
                break;
            }
            sum += cosh * q.at((r * r + v * v).sqrt());
        }
        SINH_STEP / PI * scale * sum
    };
    (0..grid.count()).map(along).collect()
}

/// Points and weights of Gauss's rule with three points on (-1, 1).
pub(super) const GAUSS_POINTS_3: [(f64, f64); 3] =
    [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];

/// Influence of normal loads on a [`Layer`] or a [`Stack`] in three dimensions, in mm, N and MPa.
#[derive(Clone, Debug)]
pub struct Influence {
    sizes: Sizes,
    radial: Radial,
}

impl Influence {
    /// Tabulates the kernels of a layer; allocates.
    ///
    /// # Errors
    /// A layer that [`Layer::check`] refuses.
    pub fn new(layer: &Layer) -> Result<Self, Invalid> {
        Ok(Self::of(&Ground::layer(layer)?))
    }

    /// Tabulates the kernels of several layers: up to half a second; allocates.
    ///
    /// # Errors
    /// A surface layer too thin against the distance at which the stack's fields die.
    pub fn of_stack(stack: &Stack) -> Result<Self, Invalid> {
        Ok(Self::of(&Ground::stack(stack)?))
    }

    fn of(ground: &Ground) -> Self {
        Self { sizes: ground.sizes, radial: Radial::new(ground) }
    }

    /// The layer at the surface.
    #[must_use]
    pub fn layer(&self) -> &Layer {
        &self.sizes.surface
    }

    /// From the surface to the base, mm.
    #[must_use]
    pub fn thickness_mm(&self) -> f64 {
        self.sizes.thickness_mm
    }

    /// Decay length of the fields along the surface, mm: one thickness for a single layer.
    #[must_use]
    pub fn spread_mm(&self) -> f64 {
        self.sizes.spread_mm
    }

    /// Thickness and decay length of the layer or stack.
    pub(super) fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// (1 - nu)/(2 pi G) in 1/MPa: a half space's displacement times distance per load.
    fn compliance(&self) -> f64 {
        (1.0 - self.layer().poisson) / (2.0 * PI * self.layer().shear_mpa())
    }

    /// Downward displacement of the surface per unit point load, mm/N, at a distance above 0;
    /// infinite at 0 and NaN for NaN.
    #[must_use]
    pub fn surface_point(&self, r_mm: f64) -> f64 {
        let t = self.layer().thickness_mm;
        let r = r_mm.abs() / t;
        self.compliance() / t * (1.0 / r + self.radial.rest(r))
    }

    /// Normal stress at the base per unit point load, 1/mm^2, negative under the load; 0 for NaN.
    #[must_use]
    pub fn base_point(&self, r_mm: f64) -> f64 {
        let t = self.layer().thickness_mm;
        -self.radial.base(r_mm.abs() / t) / (t * t)
    }

    /// Downward displacement at (x, y) per unit pressure on a rectangle of half-sides `half_mm`
    /// about the origin, mm/MPa.
    #[must_use]
    pub fn surface_cell(&self, [x, y]: [f64; 2], [a, b]: [f64; 2]) -> f64 {
        let t = self.layer().thickness_mm;
        let rest = self.over([x, y], [a, b], |r| self.radial.rest(r));
        self.compliance() * (love([x, y], [a, b]) + rest / t)
    }

    /// Normal stress at the base under (x, y) per unit pressure on a rectangle of half-sides
    /// `half_mm` about the origin; negative.
    #[must_use]
    pub fn base_cell(&self, place: [f64; 2], half_mm: [f64; 2]) -> f64 {
        let t = self.layer().thickness_mm;
        -self.over(place, half_mm, |r| self.radial.base(r)) / (t * t)
    }

    /// Integral of a smooth kernel of the distance over the rectangle, in mm^2.
    fn over(&self, place: [f64; 2], half_mm: [f64; 2], of: impl Fn(f64) -> f64) -> f64 {
        let t = self.layer().thickness_mm;
        over_cell(place, half_mm, 4.0, t, |[u, v]| of((u * u + v * v).sqrt() / t))
    }
}

/// Integral of a smooth kernel over a rectangle of half-sides (a, b), seen from (x, y), in mm^2.
/// The rectangle is divided into parts, `points_per_thickness` of them to a half-side of the
/// thickness `t`, with Gauss's rule of 3 by 3 points on each.
pub(super) fn over_cell(
    [x, y]: [f64; 2],
    [a, b]: [f64; 2],
    points_per_thickness: f64,
    t: f64,
    of: impl Fn([f64; 2]) -> f64,
) -> f64 {
    let parts = |half: f64| libm::ceil(points_per_thickness * half / t).clamp(1.0, 1000.0);
    let (nx, ny) = (parts(a), parts(b));
    let (hx, hy) = (a / nx, b / ny);
    let mut sum = 0.0;
    for i in 0..nx as usize {
        for j in 0..ny as usize {
            let middle = [x - a + hx * (2 * i + 1) as f64, y - b + hy * (2 * j + 1) as f64];
            for (gx, wx) in GAUSS_POINTS_3 {
                for (gy, wy) in GAUSS_POINTS_3 {
                    sum += wx * wy * of([middle[0] + gx * hx, middle[1] + gy * hy]);
                }
            }
        }
    }
    sum * hx * hy
}

/// Integral of 1/r over a rectangle of half-sides (a, b) about the origin, seen from (x, y), in mm:
/// Love's closed form.
#[must_use]
pub(crate) fn love([x, y]: [f64; 2], [a, b]: [f64; 2]) -> f64 {
    // The antiderivative u asinh(v/|u|) + v asinh(u/|v|) is odd in both.
    let corner = |u: f64, v: f64| {
        let part = |p: f64, q: f64| if p == 0.0 { 0.0 } else { p * libm::asinh(q / p.abs()) };
        part(u, v) + part(v, u)
    };
    corner(x + a, y + b) - corner(x - a, y + b) - corner(x + a, y - b) + corner(x - a, y - b)
}
