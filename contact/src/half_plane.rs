//! Closed forms for the half plane in plane strain: line load, flat punch, cylinder (Hertz), and
//! the loads recovered from the stress of a line load.
//!
//! The formulas are those that the thesis prints as A.11 to A.20, in corrected form. Each was
//! proven here, not taken over: displacements by differentiating them to strains, Hooke's law and
//! A.11-A.13; the stresses under punch and cylinder by quadrature of A.11-A.13 over the pressures
//! A.16 and A.18 (`contact/tests/half_plane.rs`). Corrections:
//!
//! - A.11-A.13: all three want a minus, compression being negative.
//! - A.14: the last term is + x^2/r^2 (times Q), not + z^2/r^2.
//! - A.15: with arccos(x/r) in the place of arctan(x/z) the sign of that term is minus.
//! - A.17: the last angle is t - 3/2 (t1 + t2), not t - 1/2 (t1 + t2), which is wrong by 1 % to
//!   160 %. It is evaluated here as a function of one complex variable, which has no doubt about
//!   branches: the stress is smooth and negative everywhere under the surface.
//! - A.20: a minus before the second term and no term in r cos t; with plus and -2 r cos t it is
//!   s_xx.
//! - 4.1, 4.2 (displacements of a thick layer's surface over a base at depth h, from the moments
//!   there): both are minus, since M0 = -P.
//!
//! Depths are positive downwards, s_xz is for z up as everywhere in [`super`]. On the
//! load itself the results are infinite or NaN, as the formulas are.

use super::field::LineLoad;
use super::layer::Layer;
use core::f64::consts::PI;

/// Stresses at a point in MPa.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stresses {
    /// Along z.
    pub szz_mpa: f64,
    /// Along x.
    pub sxx_mpa: f64,
    /// Shear, z up.
    pub sxz_mpa: f64,
}

/// Stresses of a line load (A.11 to A.13).
#[must_use]
pub fn line_stresses(load: &LineLoad, x_mm: f64, depth_mm: f64) -> Stresses {
    let (x, z) = (x_mm, depth_mm);
    let r2 = x * x + z * z;
    let radial = -2.0 / PI * (load.p_n_mm * z + load.q_n_mm * x) / (r2 * r2);
    Stresses { szz_mpa: radial * z * z, sxx_mpa: radial * x * x, sxz_mpa: -radial * x * z }
}

/// Displacements of a line load: along x (A.14), and down (A.15). They hold a length `datum_mm`
/// that no half plane determines: where the logarithm is 0.
#[must_use]
pub fn line_displacements(
    material: &Layer,
    load: &LineLoad,
    x_mm: f64,
    depth_mm: f64,
    datum_mm: f64,
) -> [f64; 2] {
    let (x, z, nu) = (x_mm, depth_mm, material.poisson);
    let r2 = x * x + z * z;
    let (m, n) = (2.0 * (1.0 - nu), 1.0 - 2.0 * nu);
    let scale = (1.0 + nu) / (PI * material.youngs_mpa);
    let logarithm = m * libm::log(datum_mm / r2.sqrt());
    let angle = n * libm::atan2(x, z);
    let LineLoad { p_n_mm: p, q_n_mm: q } = *load;
    [
        scale * (p * (x * z / r2 - angle) + q * (logarithm + x * x / r2)),
        scale * (p * (logarithm + z * z / r2) + q * (angle + x * z / r2)),
    ]
}

/// Pressure under a frictionless flat punch of half-width `a_mm` (A.16); 0 outside.
#[must_use]
pub fn punch_pressure_mpa(p_n_mm: f64, a_mm: f64, x_mm: f64) -> f64 {
    if x_mm.abs() > a_mm {
        return 0.0;
    }
    p_n_mm / (PI * ((a_mm - x_mm) * (a_mm + x_mm)).sqrt())
}

/// Stresses under a frictionless flat punch (A.17).
#[must_use]
pub fn punch_stresses(p_n_mm: f64, a_mm: f64, x_mm: f64, depth_mm: f64) -> Stresses {
    let zeta = Complex(x_mm, depth_mm);
    let root = root_above_surface(a_mm, zeta);
    let value = root.inverse();
    let slope = zeta.times(value.times(value).times(value));
    normal_stresses(value, slope, depth_mm).scaled(p_n_mm / PI)
}

/// Pressure under a frictionless cylinder of half-width `a_mm` of contact (A.18); 0 outside.
#[must_use]
pub fn cylinder_pressure_mpa(p_n_mm: f64, a_mm: f64, x_mm: f64) -> f64 {
    if x_mm.abs() > a_mm {
        return 0.0;
    }
    2.0 * p_n_mm / (PI * a_mm * a_mm) * ((a_mm - x_mm) * (a_mm + x_mm)).sqrt()
}

/// Half-width of the contact of a cylinder under a load (A.19).
#[must_use]
pub fn cylinder_half_width_mm(material: &Layer, radius_mm: f64, p_n_mm: f64) -> f64 {
    let plane = (1.0 - material.poisson * material.poisson) / material.youngs_mpa;
    (4.0 * p_n_mm * radius_mm * plane / PI).sqrt()
}

/// Stresses under a frictionless cylinder (A.20).
#[must_use]
pub fn cylinder_stresses(p_n_mm: f64, a_mm: f64, x_mm: f64, depth_mm: f64) -> Stresses {
    let zeta = Complex(x_mm, depth_mm);
    let root = root_above_surface(a_mm, zeta);
    // sqrt(a^2 - zeta^2) + i zeta, which dies far away; the sum as a quotient, without cancelling.
    let value = root.plus(Complex(depth_mm, -x_mm)).inverse().scaled(a_mm * a_mm);
    let slope = Complex(0.0, 1.0).plus(zeta.times(root.inverse()).scaled(-1.0));
    normal_stresses(value, slope, depth_mm).scaled(2.0 * p_n_mm / (PI * a_mm * a_mm))
}

/// Moments M0, M1 of s_zz at a depth under a line load: -P and -Q z.
#[must_use]
pub fn line_moments(load: &LineLoad, depth_mm: f64) -> [f64; 2] {
    [-load.p_n_mm, -load.q_n_mm * depth_mm]
}

/// Place of the largest compression at a depth under a line load with P > 0:
/// z (sqrt(4 P^2 + 3 Q^2) - 2 P)/(3 Q), written so that Q = 0 is an ordinary value.
#[must_use]
pub fn line_peak_mm(load: &LineLoad, depth_mm: f64) -> f64 {
    let LineLoad { p_n_mm: p, q_n_mm: q } = *load;
    depth_mm * q / ((4.0 * p * p + 3.0 * q * q).sqrt() + 2.0 * p)
}

/// Displacements of the surface above the moments M0, M1 measured at a depth h, incompressible
/// rubber: along x and down (4.1, 4.2), with the length that a half plane leaves open.
#[must_use]
pub fn displacements_from_moments(
    material: &Layer,
    moments: [f64; 2],
    depth_mm: f64,
    datum_mm: f64,
) -> [f64; 2] {
    let nu = material.poisson;
    let logarithm = 2.0 * (1.0 - nu * nu) * libm::log(datum_mm / depth_mm);
    let scale = -1.0 / (PI * material.youngs_mpa);
    [scale * logarithm * moments[1] / depth_mm, scale * (logarithm + 1.0 + nu) * moments[0]]
}

/// Stresses from a function whose real part on the surface is the pressure, and its derivative:
/// s_zz = -(Re h - z d/dz Re h), s_xx = -(Re h + z d/dz Re h), d/dz Re h = -Im h'.
fn normal_stresses(value: Complex, slope: Complex, z: f64) -> Stresses {
    Stresses {
        szz_mpa: -(value.0 + z * slope.1),
        sxx_mpa: -(value.0 - z * slope.1),
        sxz_mpa: -z * slope.0,
    }
}

impl Stresses {
    fn scaled(self, factor: f64) -> Self {
        Self {
            szz_mpa: factor * self.szz_mpa,
            sxx_mpa: factor * self.sxx_mpa,
            sxz_mpa: factor * self.sxz_mpa,
        }
    }
}

/// sqrt(a - zeta) sqrt(a + zeta): analytic in the upper half plane, where the body is.
fn root_above_surface(a: f64, zeta: Complex) -> Complex {
    let minus = Complex(a - zeta.0, -zeta.1);
    let plus = Complex(a + zeta.0, zeta.1);
    minus.root().times(plus.root())
}

/// Real and imaginary part.
#[derive(Clone, Copy)]
struct Complex(f64, f64);

impl Complex {
    fn plus(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }

    fn times(self, other: Self) -> Self {
        Self(self.0 * other.0 - self.1 * other.1, self.0 * other.1 + self.1 * other.0)
    }

    fn scaled(self, factor: f64) -> Self {
        Self(factor * self.0, factor * self.1)
    }

    fn inverse(self) -> Self {
        let square = self.0 * self.0 + self.1 * self.1;
        Self(self.0 / square, -self.1 / square)
    }

    /// The root with a real part of 0 or more; -0 counts as below the cut.
    fn root(self) -> Self {
        let size = libm::hypot(self.0, self.1);
        let large = (0.5 * (size + self.0.abs())).sqrt();
        if large == 0.0 {
            return Self(0.0, 0.0);
        }
        let small = 0.5 * self.1.abs() / large;
        let (re, im) = if self.0 >= 0.0 { (large, small) } else { (small, large) };
        Self(re, if self.1.is_sign_negative() { -im } else { im })
    }
}
