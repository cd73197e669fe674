//! What can be told of a contact from two moments of the stress it makes: the thesis's four cases
//! for a flat bar (section 4.3.2), on the exact layer instead of a regression.
//!
//! Moments are those of s_zz over the base, tension counted, about an origin `origin_mm` to the
//! left of the bar's middle (the sensor's end, say). Statics gives the first one exactly,
//! M1 = -(h + t) Q - c P; the second, M2 = M2' - 2 c (h + t) Q - c^2 P, holds the width in M2', the
//! moment about the middle, which the contact solver gives, lifted edges included.
//!
//! It refuses what [`Indenter::new`] refuses, moments that no contact makes, and an origin at the
//! middle where force is wanted: there M1 does not feel P. Uncertainties are those of the
//! moments, carried through to first order. It allocates.

use super::features::moments;
use super::{Friction, Indenter, Level, Load, Refusal, Shape};
use crate::contact::layer::Layer;
use crate::contact::{Invalid, finite, positive};

/// Steps of a root search.
const STEPS: usize = 100;
/// Narrowest and widest bar looked for, in mm.
pub const WIDTHS_MM: [f64; 2] = [0.2, 25.4];

/// The bar and the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// The layer.
    pub layer: Layer,
    /// Height of the loads over the surface in mm.
    pub height_mm: f64,
    /// Place of the bar's middle from the origin of the moments in mm.
    pub origin_mm: f64,
    /// Shear under the bar.
    pub friction: Friction,
}

/// A number and its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// What was recovered; loads in N/mm, width in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Recovered {
    /// Normal load.
    pub p: Measured,
    /// Tangential load.
    pub q: Measured,
    /// Width.
    pub width: Measured,
    /// Moments that the contact would make less the measured ones.
    pub misses: [f64; 2],
}

/// Why nothing was recovered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Unrecovered {
    /// A parameter.
    Invalid(Invalid),
    /// No contact makes these moments.
    NoContact,
}

impl From<Invalid> for Unrecovered {
    fn from(invalid: Invalid) -> Self {
        Self::Invalid(invalid)
    }
}

impl From<Refusal> for Unrecovered {
    fn from(_: Refusal) -> Self {
        Self::NoContact
    }
}

impl Setting {
    /// # Errors
    /// Constants that the layer's check refuses, a height below 0, an origin that is not finite.
    pub fn check(&self) -> Result<(), Invalid> {
        self.layer.check()?;
        finite("origin_mm", self.origin_mm)?;
        if self.height_mm == 0.0 { Ok(()) } else { positive("height_mm", self.height_mm) }
    }

    /// Both moments of a contact about the origin.
    ///
    /// # Errors
    /// A setting or width that is refused; a load without an equilibrium.
    pub fn moments(&self, width_mm: f64, load: &Load) -> Result<[f64; 2], Unrecovered> {
        self.moments_of(&self.template()?, width_mm, load)
    }

    /// A bar to be reshaped: its kernels are tabulated once.
    fn template(&self) -> Result<Indenter, Unrecovered> {
        self.check()?;
        let shape = Shape::Flat { width_mm: 1.0, height_mm: self.height_mm };
        Ok(Indenter::new(&self.layer, shape, self.friction, Level::Default)?)
    }

    fn moments_of(
        &self,
        bar: &Indenter,
        width_mm: f64,
        load: &Load,
    ) -> Result<[f64; 2], Unrecovered> {
        let about_middle = self.about_middle(bar, width_mm, load)?;
        let (c, lever) = (self.origin_mm, self.height_mm + self.layer.thickness_mm);
        let first = -lever * load.q_n_mm;
        let total = -load.p_n_mm;
        Ok([first + c * total, about_middle + 2.0 * c * first + c * c * total])
    }

    /// Second moment about the bar's middle.
    fn about_middle(&self, bar: &Indenter, width_mm: f64, load: &Load) -> Result<f64, Unrecovered> {
        let mut bar = bar.reshaped(Shape::Flat { width_mm, height_mm: self.height_mm })?;
        bar.press(load)?;
        let t = self.layer.thickness_mm;
        Ok(moments(&self.layer, &bar.point_forces(t), t).m[2])
    }

    /// Q for a P, from the first moment.
    fn shear(&self, p_n_mm: f64, m1: f64) -> f64 {
        -(m1 + self.origin_mm * p_n_mm) / (self.height_mm + self.layer.thickness_mm)
    }

    /// Case I: the width is known, the loads are not.
    ///
    /// # Errors
    /// See [`Unrecovered`].
    pub fn loads(&self, width_mm: f64, m: [Measured; 2]) -> Result<Recovered, Unrecovered> {
        self.check()?;
        positive("width_mm", width_mm)?;
        check(&m)?;
        if self.origin_mm.abs() <= 0.5 * width_mm {
            let what = format!("{} is under the bar", self.origin_mm);
            let remedy = "take moments about a place beside the bar: there they tell P from Q";
            return Err(Invalid::new("origin_mm", what, remedy).into());
        }
        let bar = self.template()?;
        let [p, q] = self.solve_loads(&bar, width_mm, [m[0].value, m[1].value])?;
        let mut variance = [0.0; 2];
        for k in 0..2 {
            let step = m[k].sigma.max(1e-6 * m[k].value.abs());
            let shifted = |sign: f64| {
                let mut moved = [m[0].value, m[1].value];
                moved[k] += sign * 1e-3 * step;
                self.solve_loads(&bar, width_mm, moved)
            };
            let (up, down) = (shifted(1.0)?, shifted(-1.0)?);
            for (variance, (up, down)) in variance.iter_mut().zip(up.iter().zip(down)) {
                let slope = (up - down) / (2e-3 * step);
                *variance += slope * slope * m[k].sigma * m[k].sigma;
            }
        }
        Ok(Recovered {
            p: Measured { value: p, sigma: variance[0].sqrt() },
            q: Measured { value: q, sigma: variance[1].sqrt() },
            width: Measured { value: width_mm, sigma: 0.0 },
            misses: [0.0; 2],
        })
    }

    fn solve_loads(
        &self,
        bar: &Indenter,
        width_mm: f64,
        m: [f64; 2],
    ) -> Result<[f64; 2], Unrecovered> {
        let c = self.origin_mm;
        // M2 = M2' + 2 c M1 + c^2 P; M2' is about -P W^2/12 and always above -P (W/2 + 2 t)^2.
        let rest = m[1] - 2.0 * c * m[0];
        let miss = |p: f64| -> Result<f64, Unrecovered> {
            let load = Load { p_n_mm: p, q_n_mm: self.shear(p, m[0]) };
            Ok(self.about_middle(bar, width_mm, &load)? + c * c * p - rest)
        };
        // Loads at which the bar does not topple: |Q| h < P W/2.
        let lever = self.height_mm / (self.height_mm + self.layer.thickness_mm);
        let edge = |side: f64| -lever * m[0] / (lever * c + side * 0.5 * width_mm);
        let (low, high) = (edge(1.0).min(edge(-1.0)), edge(1.0).max(edge(-1.0)));
        if !(low.is_finite() && high > 0.0) {
            return Err(Unrecovered::NoContact);
        }
        let inset = 1e-6 * (high - low);
        let p = root(miss, (low + inset).max(1e-12), high - inset)?;
        Ok([p, self.shear(p, m[0])])
    }

    /// Case II: the loads are known, the width is not.
    ///
    /// # Errors
    /// See [`Unrecovered`].
    pub fn width(&self, load: &Load, m: [Measured; 2]) -> Result<Recovered, Unrecovered> {
        self.check()?;
        check(&m)?;
        positive("p_n_mm", load.p_n_mm)?;
        finite("q_n_mm", load.q_n_mm)?;
        let bar = self.template()?;
        let miss = |width: f64| -> Result<f64, Unrecovered> {
            Ok(m[1].value - self.moments_of(&bar, width, load)?[1])
        };
        let narrow = 2.0 * load.q_n_mm.abs() * self.height_mm / load.p_n_mm * (1.0 + 1e-6);
        let [least, most] = WIDTHS_MM;
        if narrow >= most {
            return Err(Unrecovered::NoContact);
        }
        let width = root(miss, least.max(narrow), most)?;
        let h = 1e-3 * width;
        let inner = (width - h).max(narrow);
        let slope = (miss(width + h)? - miss(inner)?) / (width + h - inner);
        let found = self.moments_of(&bar, width, load)?;
        Ok(Recovered {
            p: Measured { value: load.p_n_mm, sigma: 0.0 },
            q: Measured { value: load.q_n_mm, sigma: 0.0 },
            width: Measured { value: width, sigma: m[1].sigma / slope.abs() },
            misses: [found[0] - m[0].value, found[1] - m[1].value],
        })
    }

    /// Case III: both are known; the moments are redundant and check them.
    ///
    /// # Errors
    /// See [`Unrecovered`].
    pub fn check_all(
        &self,
        width_mm: f64,
        load: &Load,
        m: [Measured; 2],
    ) -> Result<Recovered, Unrecovered> {
        check(&m)?;
        let found = self.moments(width_mm, load)?;
        let known = |value: f64| Measured { value, sigma: 0.0 };
        Ok(Recovered {
            p: known(load.p_n_mm),
            q: known(load.q_n_mm),
            width: known(width_mm),
            misses: [found[0] - m[0].value, found[1] - m[1].value],
        })
    }

    /// Case IV: neither is known: c P + (h + t) Q = -M1 is what remains, as [c, h + t, -M1].
    ///
    /// # Errors
    /// See [`Unrecovered`].
    pub fn constraint(&self, m: [Measured; 2]) -> Result<[f64; 3], Unrecovered> {
        self.check()?;
        check(&m)?;
        Ok([self.origin_mm, self.height_mm + self.layer.thickness_mm, -m[0].value])
    }
}

fn check(m: &[Measured; 2]) -> Result<(), Invalid> {
    for (name, m) in ["m1", "m2"].into_iter().zip(m) {
        finite(name, m.value)?;
        if m.sigma != 0.0 {
            positive(&format!("{name}_sigma"), m.sigma)?;
        }
    }
    Ok(())
}

/// A zero between two places of opposite sign.
fn root(
    f: impl Fn(f64) -> Result<f64, Unrecovered>,
    from: f64,
    to: f64,
) -> Result<f64, Unrecovered> {
    let (mut a, mut b) = (from, to);
    let (mut fa, mut fb) = (f(a)?, f(b)?);
    if (fa < 0.0) == (fb < 0.0) {
        return Err(Unrecovered::NoContact);
    }
    for _ in 0..STEPS {
        if fb == 0.0 || (b - a).abs() < 1e-12 * b.abs() {
            break;
        }
        let secant = b - fb * (b - a) / (fb - fa);
        let inside = secant > a.min(b) && secant < a.max(b);
        let c = if inside { secant } else { 0.5 * (a + b) };
        let fc = f(c)?;
        if (fc < 0.0) == (fb < 0.0) {
            fa *= 0.5;
        } else {
            (a, fa) = (b, fb);
        }
        (b, fb) = (c, fc);
    }
    Ok(b)
}
