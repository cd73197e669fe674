//! Recovers load or width of a flat bar from two moments of the stress that it makes: the thesis's
//! four cases (section 4.3.2), on the exact layer instead of a regression.
//!
//! Moments are those of s_zz over the base, tension counted, about an origin `origin_mm` to the
//! left of the bar's middle (the sensor's end, say). Statics gives the first one exactly,
//! M1 = -l Q - c P, the lever l being h + t, or h where no shear enters the layer; the second,
//! M2 = M2' - 2 c l Q - c^2 P, holds the width in M2', the moment about the middle, which the
//! contact solver gives, lifted edges included.
//!
//! No contact may make exactly the measured moments, because of their noise. Up to
//! [`MISFIT_MAX_SIGMAS`] standard deviations the result is then the nearest contact, which is the
//! estimate of maximum likelihood, with its misses. Uncertainties follow from those of the moments.
//! Those of loads are propagated to first order; that of a width is its change when M2 changes by
//! one standard deviation in the worse direction, because M2 hardly depends on a narrow bar's
//! width. A width whose uncertainty is a large part of it is too large in the mean, because no
//! width below the narrowest is returned. If two contacts make the same moments (the origin is near
//! a bar on thick rubber), the more upright one is returned.
//!
//! These are errors: moments further away; an origin under the bar when forces are recovered,
//! because M1 hardly depends on P there; and a bar of no height without friction, whose moments do
//! not depend on Q. The recovery allocates.

use super::features::moments;
use super::{Friction, Indenter, Load, Refusal, Shape};
use crate::Accuracy;
use crate::layer::Layer;
use crate::{Invalid, finite, positive};

/// Most steps of a root search.
const ROOT_ITERATIONS_MAX: usize = 100;
/// Narrowest and widest bar that is searched, in mm.
pub const WIDTHS_MM: [f64; 2] = [0.2, 25.4];
/// How far, in standard deviations, moments may lie beyond those of every contact.
pub const MISFIT_MAX_SIGMAS: f64 = 5.0;
/// Largest Q/P that is searched.
pub const LOAD_RATIO_MAX: f64 = 30.0;
/// Cells of Q/P in each of which a load ratio is searched.
const LOAD_RATIO_CELLS: i32 = 32;
/// Distance from toppling, relative, at which the search of load ratios and widths ends.
const TOPPLING_MARGIN: f64 = 1e-6;
/// Steps of the golden-section search, and the part of the interval that each removes.
const GOLDEN_SECTION_STEPS: usize = 40;
const GOLDEN_SECTION: f64 = 0.381_966_011_250_105_1;
/// Smallest standard deviation by which a miss is divided.
const SIGMA_MIN: f64 = 1e-300;
/// Noise of a moment that rounding and the solver's error make, relative to it.
const RELATIVE_NOISE: f64 = 1e-6;

/// The bar and the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BarOverSensor {
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
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Recovered loads in N/mm and width in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Recovery {
    /// Normal load.
    pub p: Estimate,
    /// Tangential load.
    pub q: Estimate,
    /// Width.
    pub width: Estimate,
    /// Moments that the contact would make less the measured ones.
    pub misses: [f64; 2],
}

/// Why no load or width was recovered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RecoveryError {
    /// A parameter.
    Invalid(Invalid),
    /// No contact makes these moments.
    NoContact,
}

impl From<Invalid> for RecoveryError {
    fn from(invalid: Invalid) -> Self {
        Self::Invalid(invalid)
    }
}

impl From<Refusal> for RecoveryError {
    fn from(_: Refusal) -> Self {
        Self::NoContact
    }
}

impl BarOverSensor {
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
    pub fn moments(&self, width_mm: f64, load: &Load) -> Result<[f64; 2], RecoveryError> {
        self.moments_of(&self.template()?, width_mm, load)
    }

    /// The bar that is reshaped for each width: its kernels are tabulated once.
    fn template(&self) -> Result<Indenter, RecoveryError> {
        self.check()?;
        let shape = Shape::Flat { width_mm: self.layer.thickness_mm, height_mm: self.height_mm };
        Ok(Indenter::new(&self.layer, shape, self.friction, Accuracy::Default)?)
    }

    fn moments_of(
        &self,
        bar: &Indenter,
        width_mm: f64,
        load: &Load,
    ) -> Result<[f64; 2], RecoveryError> {
        let about_middle = self.about_middle(bar, width_mm, load)?;
        let c = self.origin_mm;
        let first = -self.lever() * load.q_n_mm;
        let total = -load.p_n_mm;
        Ok([first + c * total, about_middle + 2.0 * c * first + c * c * total])
    }

    /// Second moment about the bar's middle.
    fn about_middle(
        &self,
        bar: &Indenter,
        width_mm: f64,
        load: &Load,
    ) -> Result<f64, RecoveryError> {
        let mut bar = bar.with_shape(Shape::Flat { width_mm, height_mm: self.height_mm })?;
        bar.press_one_interval(load)?;
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
    /// See [`RecoveryError`].
    pub fn loads(&self, width_mm: f64, m: [Estimate; 2]) -> Result<Recovery, RecoveryError> {
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
        let steepest =
            (0.5 * width_mm / self.height_mm).min(LOAD_RATIO_MAX) * (1.0 - TOPPLING_MARGIN);
        let load_ratio = self.load_ratio(&bar, width_mm, steepest, m)?;
        let made = self.unit_moments(&bar, width_mm, load_ratio)?;
        let (p, off) = nearest(made, m, weights_of(m));
        if p == 0.0 || off > MISFIT_MAX_SIGMAS {
            return Err(RecoveryError::NoContact);
        }
        let misses = [0, 1].map(|k| p * made[k] - m[k].value);
        // The moments of P and Q = `load_ratio` P are P times those of a unit P.
        let step = 1e-4 * steepest;
        let ends = [-step, step].map(|d| (load_ratio + d).clamp(-steepest, steepest));
        let [less, more] = [
            self.unit_moments(&bar, width_mm, ends[0])?,
            self.unit_moments(&bar, width_mm, ends[1])?,
        ];
        let per_q = [0, 1].map(|k| (more[k] - less[k]) / (ends[1] - ends[0]));
        let per_p = [0, 1].map(|k| made[k] - load_ratio * per_q[k]);
        let det = per_p[0] * per_q[1] - per_p[1] * per_q[0];
        let sigma = |row: [f64; 2]| libm::hypot(row[1] * m[0].sigma, row[0] * m[1].sigma);
        Ok(Recovery {
            p: Estimate { value: p, sigma: sigma(per_q) / det.abs() },
            q: Estimate { value: load_ratio * p, sigma: sigma(per_p) / det.abs() },
            width: Estimate { value: width_mm, sigma: 0.0 },
            misses,
        })
    }

    /// Both moments about the origin of a unit P with Q = `load_ratio`; the contact's form depends
    /// on their ratio alone.
    fn unit_moments(
        &self,
        bar: &Indenter,
        width_mm: f64,
        load_ratio: f64,
    ) -> Result<[f64; 2], RecoveryError> {
        self.moments_of(bar, width_mm, &Load { p_n_mm: 1.0, q_n_mm: load_ratio })
    }

    /// Q/P of the contact whose moments are in the ratio of the measured ones, or of the nearest.
    fn load_ratio(
        &self,
        bar: &Indenter,
        width_mm: f64,
        steepest: f64,
        m: [Estimate; 2],
    ) -> Result<f64, RecoveryError> {
        let across = |made: [f64; 2]| made[0] * m[1].value - made[1] * m[0].value;
        let miss = |load_ratio: f64| Ok(across(self.unit_moments(bar, width_mm, load_ratio)?));
        let weights = weights_of(m);
        let off = |load_ratio: f64| {
            Ok::<_, RecoveryError>(
                nearest(self.unit_moments(bar, width_mm, load_ratio)?, m, weights).1,
            )
        };
        let mut near = (f64::INFINITY, 0.0);
        let along = |made: [f64; 2]| made[0] * m[0].value + made[1] * m[1].value > 0.0;
        let mut found: Option<f64> = None;
        let mut before: Option<(f64, [f64; 2])> = None;
        for i in -LOAD_RATIO_CELLS / 2..=LOAD_RATIO_CELLS / 2 {
            let load_ratio = steepest * f64::from(2 * i) / f64::from(LOAD_RATIO_CELLS);
            let made = self.unit_moments(bar, width_mm, load_ratio)?;
            let (_, far) = nearest(made, m, weights);
            if far < near.0 {
                near = (far, load_ratio);
            }
            if let Some((last, other)) = before
                && (across(other) < 0.0) != (across(made) < 0.0)
                && along(made)
            {
                let zero = root(miss, last, load_ratio)?;
                // If two contacts make these moments, the more upright one is given.
                found = Some(found.map_or(zero, |f| if f.abs() <= zero.abs() { f } else { zero }));
            }
            before = Some((load_ratio, made));
        }
        if let Some(load_ratio) = found {
            return Ok(load_ratio);
        }
        // The nearest ratio is first found among those tried, and then between its neighbours.
        let cell = 2.0 * steepest / f64::from(LOAD_RATIO_CELLS);
        let (mut low, mut high) = (near.1 - cell, near.1 + cell);
        for _ in 0..GOLDEN_SECTION_STEPS {
            let inner = [low + GOLDEN_SECTION * (high - low), high - GOLDEN_SECTION * (high - low)]
                .map(|load_ratio| load_ratio.clamp(-steepest, steepest));
            let [a, b] = [off(inner[0])?, off(inner[1])?];
            (low, high) = if a < b { (low, inner[1]) } else { (inner[0], high) };
        }
        Ok((0.5 * (low + high)).clamp(-steepest, steepest))
    }

    /// Case II: the loads are known, the width is not. M1 does not depend on the width.
    ///
    /// # Errors
    /// See [`RecoveryError`].
    pub fn width(&self, load: &Load, m: [Estimate; 2]) -> Result<Recovery, RecoveryError> {
        self.check()?;
        check(&m)?;
        positive("p_n_mm", load.p_n_mm)?;
        finite("q_n_mm", load.q_n_mm)?;
        let bar = self.template()?;
        let second = |width: f64| -> Result<f64, RecoveryError> {
            Ok(self.moments_of(&bar, width, load)?[1])
        };
        let narrow =
            2.0 * load.q_n_mm.abs() * self.height_mm / load.p_n_mm * (1.0 + TOPPLING_MARGIN);
        let least = WIDTHS_MM[0].max(narrow);
        let most = self.width_max(&bar);
        if least >= most {
            return Err(RecoveryError::NoContact);
        }
        // The second moment falls as the width grows.
        let (narrowest, widest) = (second(least)?, second(most)?);
        if narrowest.partial_cmp(&widest) != Some(core::cmp::Ordering::Greater) {
            // On a thick layer the moment no longer depends on the width.
            return Err(RecoveryError::NoContact);
        }
        let reached = m[1].value.clamp(widest, narrowest);
        let slack = MISFIT_MAX_SIGMAS * m[1].sigma + RELATIVE_NOISE * m[1].value.abs();
        if (reached - m[1].value).abs() > slack {
            return Err(RecoveryError::NoContact);
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
        Ok(Recovery {
            p: Estimate { value: load.p_n_mm, sigma: 0.0 },
            q: Estimate { value: load.q_n_mm, sigma: 0.0 },
            width: Estimate { value: width, sigma },
            misses: [found[0] - m[0].value, found[1] - m[1].value],
        })
    }

    /// The widest bar that is searched and for which the solver has enough points.
    fn width_max(&self, bar: &Indenter) -> f64 {
        let mut most = WIDTHS_MM[1];
        let shape = |width_mm| Shape::Flat { width_mm, height_mm: self.height_mm };
        while most > WIDTHS_MM[0] && bar.with_shape(shape(most)).is_err() {
            most *= 0.9;
        }
        most
    }

    /// Case III: both are known; the moments are redundant and check them.
    ///
    /// # Errors
    /// See [`RecoveryError`].
    pub fn check_consistency(
        &self,
        width_mm: f64,
        load: &Load,
        m: [Estimate; 2],
    ) -> Result<Recovery, RecoveryError> {
        check(&m)?;
        let found = self.moments(width_mm, load)?;
        let known = |value: f64| Estimate { value, sigma: 0.0 };
        Ok(Recovery {
            p: known(load.p_n_mm),
            q: known(load.q_n_mm),
            width: known(width_mm),
            misses: [found[0] - m[0].value, found[1] - m[1].value],
        })
    }

    /// Case IV: neither is known. What remains is the constraint c P + l Q = -M1, returned as [c,
    /// l, -M1]; the last has the uncertainty of M1.
    ///
    /// # Errors
    /// See [`RecoveryError`].
    pub fn constraint(&self, m: [Estimate; 2]) -> Result<[f64; 3], RecoveryError> {
        self.check()?;
        check(&m)?;
        Ok([self.origin_mm, self.lever(), -m[0].value])
    }
}

/// Weights of the misses.
fn weights_of(m: [Estimate; 2]) -> [f64; 2] {
    m.map(|m| 1.0 / m.sigma.max(RELATIVE_NOISE * m.value.abs()).max(SIGMA_MIN))
}

/// The load P, 0 or above, whose moments are nearest to the measured ones, and their distance in
/// standard deviations; `made` are the moments of a unit P.
fn nearest(made: [f64; 2], m: [Estimate; 2], weights: [f64; 2]) -> (f64, f64) {
    let [a, b] = [0, 1].map(|k| made[k] * weights[k]);
    let [x, y] = [0, 1].map(|k| m[k].value * weights[k]);
    let p = ((a * x + b * y) / (a * a + b * b)).max(0.0);
    (p, libm::hypot(p * a - x, p * b - y))
}

fn check(m: &[Estimate; 2]) -> Result<(), Invalid> {
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
    f: impl Fn(f64) -> Result<f64, RecoveryError>,
    from: f64,
    to: f64,
) -> Result<f64, RecoveryError> {
    let (mut a, mut b) = (from, to);
    let (mut fa, mut fb) = (f(a)?, f(b)?);
    if (fa < 0.0) == (fb < 0.0) {
        return Err(RecoveryError::NoContact);
    }
    for _ in 0..ROOT_ITERATIONS_MAX {
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
