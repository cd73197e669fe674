//! What can be told of a contact from two moments of the stress it makes: the thesis's four cases
//! for a flat bar (section 4.3.2), on the exact layer instead of a regression.
//!
//! Moments are those of s_zz over the base, tension counted, about an origin `origin_mm` to the
//! left of the bar's middle (the sensor's end, say). Statics gives the first one exactly,
//! M1 = -l Q - c P, the lever l being h + t, or h where no shear enters the layer; the second,
//! M2 = M2' - 2 c l Q - c^2 P, holds the width in M2', the moment about the middle, which the
//! contact solver gives, lifted edges included.
//!
//! Moments that only noise can have put beyond every contact, up to [`BEYOND`] standard deviations,
//! are answered by the nearest contact and told by their misses: estimates are those of largest
//! likelihood, for which that nearest one stands. Uncertainties are those of the moments. Those of
//! loads are carried through to first order; that of a width is how far it moves when M2 does by
//! one standard deviation to the worse side, since M2 hardly feels a narrow bar's width. Where its
//! uncertainty is a large part of it a width is too large in the mean: none comes out below the
//! narrowest. Of two contacts that make the same moments, which there are where the origin is near
//! a bar on thick rubber, the more upright is given.
//!
//! It refuses what [`Indenter::new`] refuses, moments further away, an origin under the bar where
//! force is wanted, since M1 hardly feels P there, and a bar of no height without friction, whose
//! moments do not feel Q. It allocates.

use super::features::moments;
use super::{Friction, Indenter, Load, Refusal, Shape};
use crate::Accuracy;
use crate::layer::Layer;
use crate::{Invalid, finite, positive};

/// Steps of a root search.
const STEPS: usize = 100;
/// Narrowest and widest bar looked for, in mm.
pub const WIDTHS_MM: [f64; 2] = [0.2, 25.4];
/// How far, in standard deviations, moments may lie beyond those of every contact.
pub const BEYOND: f64 = 5.0;
/// Largest Q/P looked for.
pub const STEEPEST: f64 = 30.0;
/// Cells of Q/P in which loads are looked for.
const CELLS: i32 = 32;
/// How near to toppling, and to the narrowest bar that stands, loads and widths are looked for.
const STANDS: f64 = 1e-6;
/// Narrowings of the place of a smallest value, and what each takes away.
const NARROWINGS: usize = 40;
const GOLDEN: f64 = 0.381_966_011_250_105_1;
/// A weight's smallest divisor.
const TINY: f64 = 1e-300;
/// Noise that rounding and the solver's error make, as a part of a moment.
const ROUNDING: f64 = 1e-6;

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
        let shape = Shape::Flat { width_mm: self.layer.thickness_mm, height_mm: self.height_mm };
        Ok(Indenter::new(&self.layer, shape, self.friction, Accuracy::Default)?)
    }

    fn moments_of(
        &self,
        bar: &Indenter,
        width_mm: f64,
        load: &Load,
    ) -> Result<[f64; 2], Unrecovered> {
        let about_middle = self.about_middle(bar, width_mm, load)?;
        let c = self.origin_mm;
        let first = -self.lever() * load.q_n_mm;
        let total = -load.p_n_mm;
        Ok([first + c * total, about_middle + 2.0 * c * first + c * c * total])
    }

    /// Second moment about the bar's middle.
    fn about_middle(&self, bar: &Indenter, width_mm: f64, load: &Load) -> Result<f64, Unrecovered> {
        let mut bar = bar.reshaped(Shape::Flat { width_mm, height_mm: self.height_mm })?;
        bar.press_whole(load)?;
        let t = self.layer.thickness_mm;
        Ok(moments(&self.layer, &bar.point_forces(t), t).m[2])
    }

    /// Lever of Q over the base: a shear traction adds the layer's thickness.
    fn lever(&self) -> f64 {
        match self.friction {
            Friction::None => self.height_mm,
            Friction::Proportional => self.height_mm + self.layer.thickness_mm,
        }
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
        if self.lever() == 0.0 {
            let what = "a bar of no height without friction".to_owned();
            let remedy = "give a height, or friction: these moments do not feel Q";
            return Err(Invalid::new("height_mm", what, remedy).into());
        }
        let bar = self.template()?;
        let steepest = (0.5 * width_mm / self.height_mm).min(STEEPEST) * (1.0 - STANDS);
        let slant = self.slant(&bar, width_mm, steepest, m)?;
        let made = self.per_load(&bar, width_mm, slant)?;
        let (p, off) = nearest(made, m, weights_of(m));
        if p == 0.0 || off > BEYOND {
            return Err(Unrecovered::NoContact);
        }
        let misses = [0, 1].map(|k| p * made[k] - m[k].value);
        // Moments of P and Q = slant P are P times those of the slant.
        let step = 1e-4 * steepest;
        let ends = [-step, step].map(|d| (slant + d).clamp(-steepest, steepest));
        let [less, more] =
            [self.per_load(&bar, width_mm, ends[0])?, self.per_load(&bar, width_mm, ends[1])?];
        let per_q = [0, 1].map(|k| (more[k] - less[k]) / (ends[1] - ends[0]));
        let per_p = [0, 1].map(|k| made[k] - slant * per_q[k]);
        let det = per_p[0] * per_q[1] - per_p[1] * per_q[0];
        let sigma = |row: [f64; 2]| libm::hypot(row[1] * m[0].sigma, row[0] * m[1].sigma);
        Ok(Recovered {
            p: Measured { value: p, sigma: sigma(per_q) / det.abs() },
            q: Measured { value: slant * p, sigma: sigma(per_p) / det.abs() },
            width: Measured { value: width_mm, sigma: 0.0 },
            misses,
        })
    }

    /// Both moments about the origin of a unit P with Q = `slant`; the contact's form depends on
    /// their ratio alone.
    fn per_load(&self, bar: &Indenter, width_mm: f64, slant: f64) -> Result<[f64; 2], Unrecovered> {
        self.moments_of(bar, width_mm, &Load { p_n_mm: 1.0, q_n_mm: slant })
    }

    /// Q/P of the contact whose moments are in the ratio of the measured ones, or of the nearest.
    fn slant(
        &self,
        bar: &Indenter,
        width_mm: f64,
        steepest: f64,
        m: [Measured; 2],
    ) -> Result<f64, Unrecovered> {
        let across = |made: [f64; 2]| made[0] * m[1].value - made[1] * m[0].value;
        let miss = |slant: f64| Ok(across(self.per_load(bar, width_mm, slant)?));
        let weights = weights_of(m);
        let off = |slant: f64| {
            Ok::<_, Unrecovered>(nearest(self.per_load(bar, width_mm, slant)?, m, weights).1)
        };
        let mut near = (f64::INFINITY, 0.0);
        let along = |made: [f64; 2]| made[0] * m[0].value + made[1] * m[1].value > 0.0;
        let mut found: Option<f64> = None;
        let mut before: Option<(f64, [f64; 2])> = None;
        for i in -CELLS / 2..=CELLS / 2 {
            let slant = steepest * f64::from(2 * i) / f64::from(CELLS);
            let made = self.per_load(bar, width_mm, slant)?;
            let (_, far) = nearest(made, m, weights);
            if far < near.0 {
                near = (far, slant);
            }
            if let Some((last, other)) = before
                && (across(other) < 0.0) != (across(made) < 0.0)
                && along(made)
            {
                let zero = root(miss, last, slant)?;
                // Of two the one that stands more upright.
                found = Some(found.map_or(zero, |f| if f.abs() <= zero.abs() { f } else { zero }));
            }
            before = Some((slant, made));
        }
        if let Some(slant) = found {
            return Ok(slant);
        }
        // The nearest: of the slants tried, then between its neighbours.
        let cell = 2.0 * steepest / f64::from(CELLS);
        let (mut low, mut high) = (near.1 - cell, near.1 + cell);
        for _ in 0..NARROWINGS {
            let inner = [low + GOLDEN * (high - low), high - GOLDEN * (high - low)]
                .map(|slant| slant.clamp(-steepest, steepest));
            let [a, b] = [off(inner[0])?, off(inner[1])?];
            (low, high) = if a < b { (low, inner[1]) } else { (inner[0], high) };
        }
        Ok((0.5 * (low + high)).clamp(-steepest, steepest))
    }

    /// Case II: the loads are known, the width is not. M1 does not feel it.
    ///
    /// # Errors
    /// See [`Unrecovered`].
    pub fn width(&self, load: &Load, m: [Measured; 2]) -> Result<Recovered, Unrecovered> {
        self.check()?;
        check(&m)?;
        positive("p_n_mm", load.p_n_mm)?;
        finite("q_n_mm", load.q_n_mm)?;
        let bar = self.template()?;
        let second =
            |width: f64| -> Result<f64, Unrecovered> { Ok(self.moments_of(&bar, width, load)?[1]) };
        let narrow = 2.0 * load.q_n_mm.abs() * self.height_mm / load.p_n_mm * (1.0 + STANDS);
        let least = WIDTHS_MM[0].max(narrow);
        let most = self.widest(&bar);
        if least >= most {
            return Err(Unrecovered::NoContact);
        }
        // It falls with the width.
        let (narrowest, widest) = (second(least)?, second(most)?);
        if narrowest.partial_cmp(&widest) != Some(core::cmp::Ordering::Greater) {
            // On a layer so thick nothing is left of the width.
            return Err(Unrecovered::NoContact);
        }
        let reached = m[1].value.clamp(widest, narrowest);
        let slack = BEYOND * m[1].sigma + ROUNDING * m[1].value.abs();
        if (reached - m[1].value).abs() > slack {
            return Err(Unrecovered::NoContact);
        }
        let of = |moment: f64| match moment {
            m if m >= narrowest => Ok(least),
            m if m <= widest => Ok(most),
            m => root(|width| Ok(m - second(width)?), least, most),
        };
        let width = of(reached)?;
        let (up, down) = (of(reached + m[1].sigma)?, of(reached - m[1].sigma)?);
        let sigma = (up - width).abs().max((down - width).abs());
        let found = self.moments_of(&bar, width, load)?;
        Ok(Recovered {
            p: Measured { value: load.p_n_mm, sigma: 0.0 },
            q: Measured { value: load.q_n_mm, sigma: 0.0 },
            width: Measured { value: width, sigma },
            misses: [found[0] - m[0].value, found[1] - m[1].value],
        })
    }

    /// The widest bar looked for that the solver's points are enough for.
    fn widest(&self, bar: &Indenter) -> f64 {
        let mut most = WIDTHS_MM[1];
        let shape = |width_mm| Shape::Flat { width_mm, height_mm: self.height_mm };
        while most > WIDTHS_MM[0] && bar.reshaped(shape(most)).is_err() {
            most *= 0.9;
        }
        most
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

    /// Case IV: neither is known: c P + l Q = -M1 is what remains, as [c, l, -M1]; the last is as
    /// uncertain as M1.
    ///
    /// # Errors
    /// See [`Unrecovered`].
    pub fn constraint(&self, m: [Measured; 2]) -> Result<[f64; 3], Unrecovered> {
        self.check()?;
        check(&m)?;
        Ok([self.origin_mm, self.lever(), -m[0].value])
    }
}

/// What misses are weighed by.
fn weights_of(m: [Measured; 2]) -> [f64; 2] {
    m.map(|m| 1.0 / m.sigma.max(ROUNDING * m.value.abs()).max(TINY))
}

/// The P from 0 on whose moments are nearest to the measured ones, and how far they then are, in
/// standard deviations; `made` are those of a unit P.
fn nearest(made: [f64; 2], m: [Measured; 2], weights: [f64; 2]) -> (f64, f64) {
    let [a, b] = [0, 1].map(|k| made[k] * weights[k]);
    let [x, y] = [0, 1].map(|k| m[k].value * weights[k]);
    let p = ((a * x + b * y) / (a * a + b * b)).max(0.0);
    (p, libm::hypot(p * a - x, p * b - y))
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
