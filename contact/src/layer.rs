//! The elastic layer bonded to a rigid base, and the exact transfer functions of line loads between
//! its surface and its base.
//!
//! With wave number k and a = k t, the Airy function that vanishes with its displacements at the
//! base has the determinant E(a) = a^2 + m^2 + kap sinh^2 a, m = 2(1 - nu), n = 1 - 2 nu,
//! kap = 3 - 4 nu. It has no real zero, its first zero is imaginary (0.748 i at nu = 0.49), so
//! every field dies at least as exp(-0.739 |x|/t) along the layer. Numerators and E are both taken
//! times exp(-2a): nothing overflows, and nu = 0.5 is an ordinary value.
//!
//! Stresses and displacements at any depth are in [`super::field`].

use super::numeric::wide::detect_wide_registers;
use super::{Invalid, finite, positive};

/// A homogeneous isotropic layer, bonded to a rigid base, infinite along its surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layer {
    /// Thickness t in mm.
    pub thickness_mm: f64,
    /// Young's modulus E in MPa.
    pub youngs_mpa: f64,
    /// Poisson's ratio, above -1 up to and including 0.5.
    pub poisson: f64,
}

impl Layer {
    /// Keeps the three constants after [`Layer::check`].
    ///
    /// # Errors
    /// NaN, infinity, zero or less in thickness or modulus, and a Poisson's ratio outside
    /// (-1, 0.5], where no stable material is.
    pub fn new(thickness_mm: f64, youngs_mpa: f64, poisson: f64) -> Result<Self, Invalid> {
        let layer = Self { thickness_mm, youngs_mpa, poisson };
        layer.check()?;
        Ok(layer)
    }

    /// The checks of [`Layer::new`], for a layer whose fields were set directly.
    ///
    /// # Errors
    /// As [`Layer::new`].
    pub fn check(&self) -> Result<(), Invalid> {
        positive("thickness_mm", self.thickness_mm)?;
        positive("youngs_mpa", self.youngs_mpa)?;
        finite("poisson", self.poisson)?;
        if self.poisson > -1.0 && self.poisson <= 0.5 {
            return Ok(());
        }
        let side = if self.poisson > 0.5 { "above 0.5" } else { "not above -1" };
        let what = format!("{} is {side}", self.poisson);
        Err(Invalid::new("poisson", what, "give a ratio in (-1, 0.5]; rubber has 0.49"))
    }

    /// Shear modulus G = E/(2(1 + nu)) in MPa.
    #[must_use]
    pub fn shear_mpa(&self) -> f64 {
        self.youngs_mpa / (2.0 * (1.0 + self.poisson))
    }

    /// The transfer functions of this layer.
    #[must_use]
    pub fn transfer(&self) -> Transfer {
        Transfer::new(self.poisson)
    }
}

/// The layer's transfer functions; they depend on Poisson's ratio alone, and on the wave number
/// through a = k t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transfer {
    /// m = 2(1 - nu).
    pub m: f64,
    /// n = 1 - 2 nu.
    pub n: f64,
    /// kap = 3 - 4 nu.
    pub kap: f64,
}

impl Transfer {
    /// Constants for a Poisson's ratio.
    #[must_use]
    pub fn new(poisson: f64) -> Self {
        // All contacts on the layer are made of it, before a lane presses them.
        detect_wide_registers();
        Self { m: 2.0 * (1.0 - poisson), n: 1.0 - 2.0 * poisson, kap: 3.0 - 4.0 * poisson }
    }

    /// E(a) exp(-2a).
    #[must_use]
    pub fn determinant_scaled(&self, a: f64) -> f64 {
        let rise = -libm::expm1(-2.0 * a);
        (a * a + self.m * self.m) * libm::exp(-2.0 * a) + 0.25 * self.kap * rise * rise
    }

    /// Base normal stress per normal traction, sign changed: m (a sinh a + m cosh a)/E; 1 at a = 0.
    #[must_use]
    pub fn base_normal(&self, a: f64) -> f64 {
        let q = libm::exp(-2.0 * a);
        let numerator = a * -libm::expm1(-2.0 * a) + self.m * (1.0 + q);
        0.5 * self.m * libm::exp(-a) * numerator / self.determinant_scaled(a)
    }

    /// Base normal stress per tangential traction, divided by i: m (a cosh a + n sinh a)/E.
    #[must_use]
    pub fn base_normal_from_tangential(&self, a: f64) -> f64 {
        let q = libm::exp(-2.0 * a);
        let numerator = a * (1.0 + q) - self.n * libm::expm1(-2.0 * a);
        0.5 * self.m * libm::exp(-a) * numerator / self.determinant_scaled(a)
    }

    /// M(a)/a with M = (kap sinh 2a - 2a)/(2E): downward surface displacement per pressure is
    /// (1 - nu) t/G times this. Goes to (kap - 1)/m^2 at a = 0 and to 1/a far out.
    #[must_use]
    pub fn normal_compliance(&self, a: f64) -> f64 {
        if a < 0.25 {
            let numerator = (self.kap - 1.0) * sinh_over(2.0 * a) + sinh_excess(2.0 * a);
            return numerator * libm::exp(-2.0 * a) / self.determinant_scaled(a);
        }
        let q = libm::exp(-2.0 * a);
        let numerator = 0.5 * self.kap * (1.0 - q * q) - 2.0 * a * q;
        numerator / (2.0 * a * self.determinant_scaled(a))
    }

    /// T(a)/a with T = (kap sinh 2a + 2a)/(2E): surface displacement along x per tangential
    /// traction is (1 - nu) t/G times this.
    #[must_use]
    pub fn tangential_compliance(&self, a: f64) -> f64 {
        let numerator = if a < 0.25 {
            (self.kap * sinh_over(2.0 * a) + 1.0) * libm::exp(-2.0 * a)
        } else {
            let q = libm::exp(-2.0 * a);
            (0.5 * self.kap * (1.0 - q * q) + 2.0 * a * q) / (2.0 * a)
        };
        numerator / self.determinant_scaled(a)
    }

    /// N(a) = (n kap sinh^2 a - a^2)/E: the coupling of the two; N goes to n far out. Downward
    /// displacement per tangential traction is -i t/(2 G a) N, displacement along x per pressure
    /// +i t/(2 G a) N.
    #[must_use]
    pub fn coupling(&self, a: f64) -> f64 {
        let rise = -libm::expm1(-2.0 * a);
        let numerator = 0.25 * self.n * self.kap * rise * rise - a * a * libm::exp(-2.0 * a);
        numerator / self.determinant_scaled(a)
    }
}

/// sinh(y)/y for 0 <= y <= 0.5.
fn sinh_over(y: f64) -> f64 {
    1.0 + sinh_excess(y)
}

/// sinh(y)/y - 1 for 0 <= y <= 0.5, by its series.
fn sinh_excess(y: f64) -> f64 {
    let s = y * y;
    let inner = 1.0 + s / 72.0 * (1.0 + s / 110.0 * (1.0 + s / 156.0));
    s / 6.0 * (1.0 + s / 20.0 * (1.0 + s / 42.0 * inner))
}
