//! The surface kernels of a layer as piecewise polynomials, right to about 1e-14, for the contact
//! solvers of this folder. Lengths are in layer thicknesses, displacements in units of pi G/(1 -
//! nu).
//!
//! A pressure makes the surface go down by the integral of K(x - s) p(s), a tangential traction q
//! by 1/m times that of J(x - s) q(s): K(X) = int M(a)/a cos(a X) da = S(X) - ln|X|, J(X) = int
//! N(a)/a sin(a X) da = J0(X) + n pi/2 sign X. S, S', J0 and J0' are smooth and are tabulated.

use super::coarse_kernels::CoarseKernels;
use crate::Invalid;
use crate::kernel::SURFACE_CUTOFF;
use crate::layer::Transfer;
use crate::stack::Stack;
use crate::wave_grid::FIELD_REACH;
use core::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Width of a panel, and the coefficients in each: nearest singularities at +-2i, so the
/// interpolation's error is under (1/64)^9.
const PANELS_PER_THICKNESS: f64 = 8.0;
const COEFFICIENT_COUNT: usize = 9;

/// A function from 0 on as a polynomial in the place inside each panel (-1 to 1).
#[derive(Clone, Debug)]
pub(crate) struct PiecewisePolynomial {
    coefficients: Vec<[f64; COEFFICIENT_COUNT]>,
}

impl PiecewisePolynomial {
    fn new(count: usize, value: impl Fn(usize, usize) -> f64) -> Self {
        let inverse = Vandermonde::new();
        let panel = |i: usize| inverse.coefficients(core::array::from_fn(|j| value(i, j)));
        Self { coefficients: (0..count).map(panel).collect() }
    }

    /// The function at 0 <= x inside the table.
    #[inline]
    fn at(&self, x: f64) -> f64 {
        let (panel, u) = self.place(x);
        Self::polynomial(&self.coefficients[panel], u)
    }

    #[inline]
    fn place(&self, x: f64) -> (usize, f64) {
        let place = x * PANELS_PER_THICKNESS;
        let panel = (place as usize).min(self.coefficients.len() - 1);
        (panel, 2.0 * (place - panel as f64) - 1.0)
    }

    #[inline]
    fn polynomial(c: &[f64; COEFFICIENT_COUNT], u: f64) -> f64 {
        let (u2, u4) = (u * u, u * u * (u * u));
        let low = (c[0] + c[1] * u) + (c[2] + c[3] * u) * u2;
        let high = (c[4] + c[5] * u) + (c[6] + c[7] * u) * u2;
        low + (high + c[8] * u4) * u4
    }
}

/// From values at Chebyshev points of (-1, 1) to coefficients of powers.
struct Vandermonde {
    points: [f64; COEFFICIENT_COUNT],
}

impl Vandermonde {
    fn new() -> Self {
        let angle = |j: usize| PI * (2 * j + 1) as f64 / (2 * COEFFICIENT_COUNT) as f64;
        Self { points: core::array::from_fn(|j| libm::cos(angle(j))) }
    }

    fn coefficients(&self, mut values: [f64; COEFFICIENT_COUNT]) -> [f64; COEFFICIENT_COUNT] {
        // Newton's divided differences, then their product form multiplied out.
        for order in 1..COEFFICIENT_COUNT {
            for j in (order..COEFFICIENT_COUNT).rev() {
                let run = self.points[j] - self.points[j - order];
                values[j] = (values[j] - values[j - 1]) / run;
            }
        }
        let mut powers = [0.0; COEFFICIENT_COUNT];
        for j in (0..COEFFICIENT_COUNT).rev() {
            for k in (1..COEFFICIENT_COUNT).rev() {
                powers[k] = powers[k - 1] - self.points[j] * powers[k];
            }
            powers[0] = values[j] - self.points[j] * powers[0];
        }
        powers
    }
}

/// The four smooth parts.
#[derive(Clone, Debug)]
pub(crate) struct SurfaceKernels {
    normal: PiecewisePolynomial,
    normal_slope: PiecewisePolynomial,
    along: PiecewisePolynomial,
    coupling: PiecewisePolynomial,
    coupling_slope: PiecewisePolynomial,
    /// Where the tables end.
    reach: f64,
    pub(crate) transfer: Transfer,
    /// The same kernels as coarse cubics, for fast solutions.
    pub(crate) coarse: CoarseKernels,
}

impl SurfaceKernels {
    /// Tabulates the kernels; some milliseconds.
    pub(crate) fn new(transfer: &Transfer) -> Self {
        let functions = |a: f64| {
            let normal = transfer.normal_compliance(a);
            [normal, transfer.tangential_compliance(a), transfer.coupling(a)]
        };
        Self::tabulate(transfer, &functions, FIELD_REACH)
    }

    /// The kernels of a stack, in units of its surface layer: up to a second.
    ///
    /// # Errors
    /// A surface layer too thin against the distance at which the stack's fields die.
    pub(crate) fn of_stack(stack: &Stack) -> Result<Self, Invalid> {
        let (transfer, reach) = (stack.surface_layer().transfer(), stack.reach()?);
        Ok(Self::tabulate(&transfer, &|a| stack.surface_compliances(a), reach))
    }

    /// From normal and tangential compliance and their coupling at each wave number.
    fn tabulate(transfer: &Transfer, functions: &dyn Fn(f64) -> [f64; 3], reach: f64) -> Self {
        let count = (reach * PANELS_PER_THICKNESS) as usize;
        let points = Vandermonde::new().points;
        let sums = FourierSums::new(transfer, functions, count, &points);
        let x = |i: usize, j: usize| (i as f64 + 0.5 * (1.0 + points[j])) / PANELS_PER_THICKNESS;
        let log_part = |x: f64| {
            // ln coth(pi x/4) + ln x, the integral of tanh(a)/a cos(a x) with its logarithm out.
            let y = FRAC_PI_4 * x;
            let scaled = if y < 1e-4 { 1.0 - y * y / 3.0 } else { libm::tanh(y) / y };
            -libm::log(FRAC_PI_4 * scaled)
        };
        let slope_part = |x: f64| {
            let y = FRAC_PI_2 * x;
            // 1/x - (pi/2)/sinh(pi x/2). For small arguments the two terms cancel, so the series is
            // used.
            if y < 0.3 {
                let s = y * y;
                FRAC_PI_2
                    * y
                    * (1.0 / 6.0
                        - s * (7.0 / 360.0
                            - s * (31.0 / 15120.0
                                - s * (127.0 / 604_800.0
                                    - s * (73.0 / 3_421_440.0
                                        - s * 1_414_477.0 / 653_837_184_000.0)))))
            } else {
                1.0 / x - FRAC_PI_2 / libm::sinh(y)
            }
        };
        let at = |i: usize, j: usize| &sums.values[i * COEFFICIENT_COUNT + j];
        let normal = PiecewisePolynomial::new(count, |i, j| at(i, j)[0] + log_part(x(i, j)));
        let normal_slope =
            PiecewisePolynomial::new(count, |i, j| at(i, j)[1] + slope_part(x(i, j)));
        let coupling = PiecewisePolynomial::new(count, |i, j| at(i, j)[2]);
        let coupling_slope = PiecewisePolynomial::new(count, |i, j| at(i, j)[3]);
        let odd = |x: f64, value: f64| if x < 0.0 { -value } else { value };
        let coarse = CoarseKernels::new(
            FIELD_REACH.min(reach),
            [
                &|x| odd(x, normal_slope.at(x.abs())),
                &|x| coupling_slope.at(x.abs()),
                &|x| normal.at(x.abs()),
                &|x| odd(x, coupling.at(x.abs())),
            ],
        );
        let along = PiecewisePolynomial::new(count, |i, j| at(i, j)[4] + log_part(x(i, j)));
        let transfer = *transfer;
        Self { normal, normal_slope, along, coupling, coupling_slope, reach, transfer, coarse }
    }

    /// S at a distance of either sign.
    #[inline]
    pub(crate) fn normal(&self, x: f64) -> f64 {
        let distance = x.abs();
        if distance < self.reach { self.normal.at(distance) } else { libm::log(distance) }
    }

    /// S' at a distance of either sign; odd.
    #[inline]
    pub(crate) fn normal_slope(&self, x: f64) -> f64 {
        let distance = x.abs();
        let slope =
            if distance < self.reach { self.normal_slope.at(distance) } else { 1.0 / distance };
        if x < 0.0 { -slope } else { slope }
    }

    /// S of the tangential displacement per tangential traction, at a distance of either sign.
    #[inline]
    pub(crate) fn along(&self, x: f64) -> f64 {
        let distance = x.abs();
        if distance < self.reach { self.along.at(distance) } else { libm::log(distance) }
    }

    /// J0 at a distance of either sign; odd.
    #[inline]
    pub(crate) fn coupling(&self, x: f64) -> f64 {
        let distance = x.abs();
        let far = -self.transfer.n * FRAC_PI_2;
        let value = if distance < self.reach { self.coupling.at(distance) } else { far };
        if x < 0.0 { -value } else { value }
    }

    /// S + g J0 at a distance of either sign.
    #[inline]
    pub(crate) fn descents(&self, x: f64, g: f64) -> f64 {
        let distance = x.abs();
        if distance >= self.reach {
            return self.normal(x) + g * self.coupling(x);
        }
        let (panel, u) = self.normal.place(distance);
        let g = if x < 0.0 { -g } else { g };
        let (normal, coupling) = (&self.normal.coefficients, &self.coupling.coefficients);
        PiecewisePolynomial::polynomial(&normal[panel], u)
            + g * PiecewisePolynomial::polynomial(&coupling[panel], u)
    }

    /// S' + g J0' at a distance of either sign.
    #[inline]
    pub(crate) fn slopes(&self, x: f64, g: f64) -> f64 {
        let distance = x.abs();
        if distance >= self.reach {
            return 1.0 / x;
        }
        let (panel, u) = self.normal_slope.place(distance);
        let slope = PiecewisePolynomial::polynomial(&self.normal_slope.coefficients[panel], u);
        let coupled = PiecewisePolynomial::polynomial(&self.coupling_slope.coefficients[panel], u);
        g * coupled + if x < 0.0 { -slope } else { slope }
    }
}

/// The five Fourier integrals at every point of every panel.
struct FourierSums {
    values: Vec<[f64; 5]>,
}

impl FourierSums {
    fn new(
        transfer: &Transfer,
        functions: &dyn Fn(f64) -> [f64; 3],
        count: usize,
        points: &[f64; COEFFICIENT_COUNT],
    ) -> Self {
        let step = 2.0 * PI / (2.2 * count as f64 / PANELS_PER_THICKNESS);
        let waves = libm::ceil(SURFACE_CUTOFF / step) as usize;
        let mut values = vec![[0.0; 5]; count * COEFFICIENT_COUNT];
        let width = 1.0 / PANELS_PER_THICKNESS;
        for wave in 0..=waves {
            let a = wave as f64 * step;
            let weight = if wave == 0 { 0.5 * step } else { step };
            let tanh_over = if a > 0.0 { libm::tanh(a) / a } else { 1.0 };
            let [normal, along, coupling] = functions(a);
            let normal = weight * (normal - tanh_over);
            let along = weight * (along - tanh_over);
            let coupling = weight * (coupling - transfer.n);
            let turn = [libm::sin(a * width), libm::cos(a * width)];
            for (j, point) in points.iter().enumerate() {
                let start = 0.5 * width * (1.0 + point);
                let (mut s, mut c) = (libm::sin(a * start), libm::cos(a * start));
                for panel in 0..count {
                    let x = panel as f64 * width + start;
                    let over = if a > 0.0 { s / a } else { x };
                    let sums = &mut values[panel * COEFFICIENT_COUNT + j];
                    sums[0] += normal * c;
                    sums[1] -= normal * a * s;
                    sums[2] += coupling * over;
                    sums[3] += coupling * c;
                    sums[4] += along * c;
                    (s, c) = (s * turn[1] + c * turn[0], c * turn[1] - s * turn[0]);
                }
            }
        }
        Self { values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::{CouplingKernel, SurfaceKernel};

    #[test]
    fn the_panels_join_and_their_slopes_are_slopes() {
        for nu in [0.3, 0.49, 0.5] {
            let kernels = SurfaceKernels::new(&Transfer::new(nu));
            for i in 0..400 {
                let x = 0.013 + 0.0999 * f64::from(i);
                let h = 1e-4;
                let s = (kernels.normal(x + h) - kernels.normal(x - h)) / (2.0 * h);
                assert!((s - kernels.normal_slope(x)).abs() < 1e-8, "{nu} {x}");
                let j = (kernels.coupling(x + h) - kernels.coupling(x - h)) / (2.0 * h);
                let slope = kernels.slopes(x, 1.0) - kernels.normal_slope(x);
                assert!((j - slope).abs() < 1e-8, "{nu} {x}");
            }
            for i in 1..320 {
                let x = 0.125 * f64::from(i);
                let gap = |f: &dyn Fn(f64) -> f64| (f(x) - f(x * (1.0 - 1e-15))).abs();
                assert!(
                    gap(&|x| kernels.normal(x)) < 3e-14,
                    "{nu} {x} {:e}",
                    gap(&|x| kernels.normal(x))
                );
                assert!(
                    gap(&|x| kernels.normal_slope(x)) < 3e-14,
                    "{nu} {x} {:e}",
                    gap(&|x| kernels.normal_slope(x))
                );
                assert!(gap(&|x| kernels.slopes(x, 1.0)) < 6e-14, "{nu} {x}");
            }
        }
    }

    #[test]
    fn they_agree_with_the_interpolated_tables() {
        let transfer = Transfer::new(0.45);
        let kernels = SurfaceKernels::new(&transfer);
        let table = SurfaceKernel::new(|a| transfer.normal_compliance(a));
        let along = SurfaceKernel::new(|a| transfer.tangential_compliance(a));
        let coupling = CouplingKernel::new(&transfer);
        for i in 0..500 {
            let x = 0.0917 * f64::from(i);
            assert!((kernels.normal(x) - table.smooth(x)).abs() < 1e-9, "{x}");
            assert!((kernels.along(x) - along.smooth(x)).abs() < 1e-9, "{x}");
            assert!((kernels.coupling(-x) - coupling.smooth(-x)).abs() < 1e-9, "{x}");
        }
    }

    /// A constant in a kernel would change its integral, which is pi times the compliance at the
    /// wave number 0: int K dX = pi f(0).
    #[test]
    fn the_kernels_carry_no_constant() {
        for nu in [0.3, 0.49, 0.5] {
            let transfer = Transfer::new(nu);
            let kernels = SurfaceKernels::new(&transfer);
            let rule = crate::numeric::quadrature::legendre_array::<10>();
            let integral = |kernel: &dyn Fn(f64) -> f64| -> f64 {
                let cells = (0..320).flat_map(|i| {
                    rule.map(|[x, w]| {
                        let x = (f64::from(i) + 0.5 * (1.0 + x)) * 0.125;
                        kernel(x) * 0.5 * w * 0.125
                    })
                });
                // The logarithm over (0, 40) in closed form.
                2.0 * (cells.sum::<f64>() - 40.0 * (libm::log(40.0) - 1.0))
            };
            let normal = integral(&|x| kernels.normal(x)) - PI * transfer.normal_compliance(0.0);
            let along = integral(&|x| kernels.along(x)) - PI * transfer.tangential_compliance(0.0);
            println!("{nu} {normal:e} {along:e}");
            assert!(normal.abs() < 1e-11 && along.abs() < 1e-11, "{nu}: {normal:e} {along:e}");
        }
    }
}
