//! Solves the contact of a rigid cylinder that is pressed on without slip: each point of the
//! surface sticks to the place of the cylinder that first touches it. (This is the limit, for small
//! steps, of the algorithm that fixes the surface nodes found inside the indenter in each step.)
//!
//! A growing contact is then a superposition of glued flat punches, load dP(b') each; that the
//! surface just outside b meets the profile there is a Volterra equation for dP/db'. It is solved
//! by collocation, P'(b)/b being a polynomial. A small tangential move at fixed contact is the
//! glued strip's own problem. Bars and contacts that are too wide are refused. Solving allocates.

mod tangential;

use super::glued::{Chebyshev, Tractions};
use super::rates::{Motion, TractionRate};
use super::spectrum::PointForce;
use super::surface_kernels::SurfaceKernels;
use super::{Contact, Friction, Indenter, Load, Refusal, Shape};
use crate::Accuracy;
use crate::Invalid;
use crate::layer::Layer;
use crate::numeric::elimination::LuMatrix;
use crate::numeric::quadrature::legendre_array;
use crate::wave_grid::GAUSS_POINTS;
use core::f64::consts::PI;

/// Degree of the polynomial P'(b)/b, number of half-widths solved and of panels of the quadrature
/// over them. Each grows by [`EXTRA_PER_THICKNESS`] for each thickness of half-width beyond
/// [`EXTRA_FROM_THICKNESSES`], since a nearly incompressible layer stiffens with the cube of it.
const POLYNOMIAL_DEGREE: usize = 12;
const WIDTH_COUNT: usize = 20;
const PANEL_COUNT: usize = 2;
const EXTRA_PER_THICKNESS: [f64; 3] = [0.8, 1.2, 0.2];
const EXTRA_FROM_THICKNESSES: f64 = 3.0;
/// Points of a strip that is moved along x, in multiples of those of a pressed strip, up to a
/// largest number: its tractions oscillate at the edges, and the error that the series makes there
/// falls with the number of points.
const MOVED_POINT_FACTOR: usize = 3;
const MOVED_POINTS_MAX: usize = 400;
/// Largest half-width of a contact in thicknesses, and in radii of the circle.
const HALF_WIDTH_MAX_THICKNESSES: f64 = 30.0;
const HALF_WIDTH_MAX_RADII: f64 = 0.95;
/// Half-width up to which a contact is searched, in parts of the one without friction, under the
/// same load and at the same descent: contacts have been found 3e-4 and 3 % wider at most.
const WIDENING_MAX: [f64; 2] = [1.02, 1.1];

/// A solved contact without slip.
#[derive(Clone, Debug)]
pub struct NoSlip {
    layer: Layer,
    /// Half the contact's width in mm.
    pub half_width_mm: f64,
    /// Load in N/mm.
    pub p_n_mm: f64,
    /// Descent of the lowest point in mm.
    pub delta_mm: f64,
    /// Tangential stiffness dQ/dx at fixed contact in N/mm per mm.
    pub tangential_n_mm2: f64,
    /// dM1/dx of the base stress at fixed contact in N/mm.
    pub first_moment_n_mm: f64,
    /// Rate of the half-width by the descent.
    widening: f64,
    normal: Vec<PointForce>,
    tangential: Vec<PointForce>,
}

/// Glued punches of unit load over half-widths, ready to be interpolated.
struct PunchFamily {
    points: Chebyshev,
    widths: Vec<f64>,
    barycentric: Vec<f64>,
    /// phi of both tractions per unit load, and the descent plus ln b.
    tractions: Vec<Tractions>,
    descent: Vec<f64>,
}

impl PunchFamily {
    fn new(kernels: &SurfaceKernels, widest: f64) -> Self {
        let points = Chebyshev::new(2 * (30 + libm::ceil(4.0 * widest) as usize));
        let count = count_for_width(WIDTH_COUNT, EXTRA_PER_THICKNESS[1], widest);
        let angle = |k: usize| PI * (2 * k + 1) as f64 / (2 * count) as f64;
        let widths: Vec<f64> =
            (0..count).map(|k| 0.5 * widest * (1.0 + libm::cos(angle(k)))).collect();
        let sign = |k: usize| if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        let barycentric = (0..count).map(|k| sign(k) * libm::sin(angle(k))).collect();
        let mut family =
            Self { points, widths, barycentric, tractions: Vec::new(), descent: Vec::new() };
        for k in 0..count {
            let b = family.widths[k];
            let system = family.points.system(kernels, b);
            let mut punch = family.points.solve(&system, |_| 1.0, |_| 0.0);
            let force = family.points.total(&punch.p);
            punch.p.iter_mut().chain(&mut punch.q).for_each(|phi| *phi /= force);
            family.tractions.push(punch);
            family.descent.push(1.0 / force + libm::log(b));
        }
        family
    }

    /// Tractions and descent of a unit load on half-width `b`.
    fn at(&self, b: f64) -> (Tractions, f64) {
        let mut weights: Vec<f64> = Vec::with_capacity(self.widths.len());
        for (k, width) in self.widths.iter().enumerate() {
            if b == *width {
                return (self.tractions[k].clone(), self.descent[k] - libm::log(b));
            }
            weights.push(self.barycentric[k] / (b - width));
        }
        let sum: f64 = weights.iter().sum();
        let n = self.points.count();
        let mut mean = Tractions { p: vec![0.0; n], q: vec![0.0; n] };
        let mut descent = 0.0;
        for (k, weight) in weights.iter().enumerate() {
            let weight = weight / sum;
            for j in 0..n {
                mean.p[j] += weight * self.tractions[k].p[j];
                mean.q[j] += weight * self.tractions[k].q[j];
            }
            descent += weight * self.descent[k];
        }
        (mean, descent - libm::log(b))
    }
}

/// `few`, plus `more` for each thickness of half-width beyond [`EXTRA_FROM_THICKNESSES`], rounded
/// up.
fn count_for_width(few: usize, more: f64, half: f64) -> usize {
    few + libm::ceil(more * (half - EXTRA_FROM_THICKNESSES).max(0.0)) as usize
}

/// Half-widths and weights of the integral over the growth from 0 to b, gathered at both ends.
fn growth_rule(b: f64) -> Vec<[f64; 2]> {
    let panels = count_for_width(PANEL_COUNT, EXTRA_PER_THICKNESS[2], b);
    let mut rule = Vec::with_capacity(panels * GAUSS_POINTS);
    for panel in 0..panels {
        for [u, w] in legendre_array::<GAUSS_POINTS>() {
            let s = (panel as f64 + 0.5 * (1.0 + u)) / panels as f64;
            let v = s * (2.0 - s);
            let slope = 4.0 * v * (1.0 - s);
            rule.push([b * (1.0 - v * v), 0.5 * w / panels as f64 * b * slope]);
        }
    }
    rule
}

/// Chebyshev polynomial k at x.
fn chebyshev_polynomial(k: usize, x: f64) -> f64 {
    let (mut before, mut here) = (1.0, x);
    if k == 0 {
        return 1.0;
    }
    for _ in 1..k {
        (before, here) = (here, 2.0 * x * here - before);
    }
    here
}

/// The load as a function of the half-width: P'(b) = b sum c_k T_k(2 b/widest - 1).
struct GrowthLaw {
    family: PunchFamily,
    widest: f64,
    coefficients: Vec<f64>,
}

impl GrowthLaw {
    fn new(kernels: &SurfaceKernels, widest: f64, profile: &dyn Fn(f64) -> f64) -> Self {
        let family = PunchFamily::new(kernels, widest);
        let degree = count_for_width(POLYNOMIAL_DEGREE, EXTRA_PER_THICKNESS[0], widest);
        let mut dense = LuMatrix::with_capacity(degree);
        dense.reset(degree);
        let mut side = Vec::with_capacity(degree);
        for i in 0..degree {
            let angle = PI * (2 * i + 1) as f64 / (4 * degree) as f64;
            // From near 0 up to the widest, denser there.
            let b = widest * libm::cos(angle) * libm::cos(angle);
            for [narrow, weight] in growth_rule(b) {
                let (tractions, descent) = family.at(narrow);
                let series = family.points.series(&tractions.p);
                let outside =
                    family.points.descent_outside(kernels, narrow, b, &tractions, &series);
                let gap = weight * narrow * (descent - outside);
                for (k, entry) in dense.row_mut(i).iter_mut().enumerate() {
                    *entry += gap * chebyshev_polynomial(k, 2.0 * narrow / widest - 1.0);
                }
            }
            let scale = 1.0 / profile(b);
            dense.row_mut(i).iter_mut().for_each(|entry| *entry *= scale);
            side.push(1.0);
        }
        dense.factor();
        dense.solve(&mut side);
        Self { family, widest, coefficients: side }
    }

    fn rate(&self, b: f64) -> f64 {
        let x = 2.0 * b / self.widest - 1.0;
        let terms = self.coefficients.iter().enumerate();
        b * terms.map(|(k, c)| c * chebyshev_polynomial(k, x)).sum::<f64>()
    }

    fn load(&self, b: f64) -> f64 {
        growth_rule(b).iter().map(|[narrow, weight]| weight * self.rate(*narrow)).sum()
    }

    fn descent(&self, b: f64) -> f64 {
        let part =
            |[narrow, weight]: &[f64; 2]| weight * self.rate(*narrow) * self.family.at(*narrow).1;
        growth_rule(b).iter().map(part).sum()
    }
}

impl NoSlip {
    /// The cylinder under a load P > 0.
    ///
    /// # Errors
    /// A layer or shape that their checks refuse, a bar; a load that is not above 0, or that needs
    /// a contact too wide.
    pub fn press(layer: &Layer, shape: Shape, p_n_mm: f64) -> Result<Self, NoSlipError> {
        let mut free = Indenter::new(layer, shape, Friction::None, Accuracy::Default)?;
        let contact = free.press(&Load { p_n_mm, q_n_mm: 0.0 });
        let widest = search_half_width_mm(layer, shape, contact, WIDENING_MAX[0])?;
        Self::grow(layer, shape, widest, Some(p_n_mm), None)
    }

    /// The cylinder at a descent of its lowest point.
    ///
    /// # Errors
    /// As [`Self::press`].
    pub fn descend(layer: &Layer, shape: Shape, dz_mm: f64) -> Result<Self, NoSlipError> {
        let mut free = Indenter::new(layer, shape, Friction::None, Accuracy::Default)?;
        let contact = free.descend(dz_mm);
        let widest = search_half_width_mm(layer, shape, contact, WIDENING_MAX[1])?;
        Self::grow(layer, shape, widest, None, Some(dz_mm))
    }

    /// The cylinder at the load under which its contact has a half-width.
    ///
    /// # Errors
    /// As [`Self::press`].
    pub fn widen(layer: &Layer, shape: Shape, b_mm: f64) -> Result<Self, NoSlipError> {
        super::positive("half_width_mm", b_mm)?;
        Self::grow(layer, shape, b_mm, None, None)
    }

    fn grow(
        layer: &Layer,
        shape: Shape,
        widest_mm: f64,
        p_n_mm: Option<f64>,
        dz_mm: Option<f64>,
    ) -> Result<Self, NoSlipError> {
        layer.check()?;
        shape.check()?;
        let t = layer.thickness_mm;
        let radius = match shape {
            Shape::Cylinder { radius_mm } => radius_mm,
            Shape::Parabola { radius_mm } => radius_mm,
            Shape::Flat { .. } => return Err(NoSlipError::Flat),
        };
        let round = matches!(shape, Shape::Cylinder { .. });
        let widest = widest_mm / t;
        // Without a contact (zero load) the width is 0.
        if widest <= 0.0 {
            return Err(Refusal::Tension.into());
        }
        if widest_mm > half_width_max_mm(layer, shape) {
            return Err(Refusal::TooWide.into());
        }
        let kernels = SurfaceKernels::new(&layer.transfer());
        let r = radius / t;
        let profile = |x: f64| {
            if round { x * x / (r + (r * r - x * x).sqrt()) } else { 0.5 * x * x / r }
        };
        let law = GrowthLaw::new(&kernels, widest, &profile);
        let modulus = PI * layer.shear_mpa() / (1.0 - layer.poisson);
        let b = match (p_n_mm, dz_mm) {
            (Some(p), _) => half_width_reaching(&|b| law.load(b), p / (modulus * t), widest)?,
            (None, Some(dz)) => half_width_reaching(&|b| law.descent(b), dz / t, widest)?,
            (None, None) => widest,
        };
        Ok(Self::assemble(layer, &kernels, &law, b))
    }

    fn assemble(layer: &Layer, kernels: &SurfaceKernels, law: &GrowthLaw, b: f64) -> Self {
        let t = layer.thickness_mm;
        let modulus = PI * layer.shear_mpa() / (1.0 - layer.poisson);
        let points = &law.family.points;
        let over = PI / points.count() as f64;
        let mut normal = Vec::new();
        for [narrow, weight] in growth_rule(b) {
            let (tractions, _) = law.family.at(narrow);
            let scale = modulus * t * over * weight * law.rate(narrow);
            for (j, c) in points.cosines.iter().enumerate() {
                normal.push([narrow * c * t, scale * tractions.p[j], scale * tractions.q[j]]);
            }
        }
        let tangential = tangential::unit_move_forces(layer, kernels, b, moved_points(b));
        let stiffness = tangential.iter().map(|f| f[2]).sum::<f64>();
        let moment = tangential.iter().map(|f| -f[0] * f[1]).sum::<f64>() - t * stiffness;
        Self {
            layer: *layer,
            half_width_mm: b * t,
            p_n_mm: law.load(b) * modulus * t,
            delta_mm: law.descent(b) * t,
            tangential_n_mm2: stiffness,
            first_moment_n_mm: moment,
            widening: 1.0 / (law.rate(b) * law.family.at(b).1),
            normal,
            tangential,
        }
    }

    /// The layer underneath.
    #[must_use]
    pub fn layer(&self) -> &Layer {
        &self.layer
    }

    /// The rate of both tractions under a motion at the present width, the contact glued: the edges
    /// of a growing contact carry nothing that a step could leave behind. A cylinder rolls about
    /// its own axis. `more` times as many points as the contact itself was solved with tell the
    /// error.
    #[must_use]
    pub fn rate(&self, shape: Shape, motion: Motion, more: usize) -> TractionRate {
        let t = self.layer.thickness_mm;
        let b = self.half_width_mm / t;
        let kernels = SurfaceKernels::new(&self.layer.transfer());
        let strip = Chebyshev::new(more.max(1) * moved_points(b));
        let system = strip.system(&kernels, b);
        let (radius, round) = match shape {
            Shape::Cylinder { radius_mm } => (radius_mm / t, true),
            Shape::Parabola { radius_mm } => (radius_mm / t, false),
            Shape::Flat { .. } => (0.0, false),
        };
        let arm = |x: f64| if round { (radius * radius - x * x).max(0.0).sqrt() } else { radius };
        let (moved, scale) = match motion {
            Motion::X => (strip.solve(&system, |_| 0.0, |_| 1.0), 1.0 / t),
            Motion::Z => (strip.solve(&system, |_| 1.0, |_| 0.0), 1.0 / t),
            Motion::RotY => (strip.solve(&system, |xi| b * xi, |xi| -arm(b * xi)), 1.0),
        };
        let modulus = PI * self.layer.shear_mpa() / (1.0 - self.layer.poisson);
        let scale = scale * t * modulus * PI / strip.count() as f64;
        let force = |(j, c): (usize, &f64)| [b * c * t, scale * moved.p[j], scale * moved.q[j]];
        TractionRate { forces: strip.cosines.iter().enumerate().map(force).collect(), shift: 0.0 }
    }

    /// Least depth at which the stress of [`Self::point_forces`] is right to about 1e-4.
    #[must_use]
    pub fn shallowest_mm(&self) -> f64 {
        // The punches have fewer points than the strip that is moved along x.
        let b = self.half_width_mm / self.layer.thickness_mm;
        2.0 * PI * self.half_width_mm / strip_points(b) as f64
    }

    /// Both tractions as concentrated forces, after a small tangential move of `dx_mm` at fixed
    /// contact.
    #[must_use]
    pub fn point_forces(&self, dx_mm: f64) -> Vec<PointForce> {
        let mut forces = self.normal.clone();
        if dx_mm != 0.0 {
            forces.extend(self.tangential.iter().map(|f| [f[0], dx_mm * f[1], dx_mm * f[2]]));
        }
        forces
    }
}

/// Why there is no contact without slip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NoSlipError {
    /// A parameter.
    Invalid(Invalid),
    /// A load.
    Refusal(Refusal),
    /// A bar: its edges do not grow.
    Flat,
}

impl From<Invalid> for NoSlipError {
    fn from(invalid: Invalid) -> Self {
        Self::Invalid(invalid)
    }
}

impl From<Refusal> for NoSlipError {
    fn from(refusal: Refusal) -> Self {
        Self::Refusal(refusal)
    }
}

/// Points of a strip of half-width `b` thicknesses.
fn strip_points(b: f64) -> usize {
    2 * (30 + libm::ceil(4.0 * b) as usize)
}

/// Points of the strip that is moved along.
fn moved_points(b: f64) -> usize {
    let points = strip_points(b);
    (MOVED_POINT_FACTOR * points).min(MOVED_POINTS_MAX).max(points)
}

/// Half the widest contact that is solved, in mm.
fn half_width_max_mm(layer: &Layer, shape: Shape) -> f64 {
    let thick = HALF_WIDTH_MAX_THICKNESSES * layer.thickness_mm;
    if let Shape::Cylinder { radius_mm } = shape {
        thick.min(HALF_WIDTH_MAX_RADII * radius_mm)
    } else {
        thick
    }
}

/// Half-width up to which a contact is searched, estimated from the contact without friction.
fn search_half_width_mm(
    layer: &Layer,
    shape: Shape,
    free: Result<Contact, Refusal>,
    beyond: f64,
) -> Result<f64, Refusal> {
    let widest = half_width_max_mm(layer, shape);
    match free {
        Ok(contact) => Ok((beyond * contact.x_right_mm).min(widest)),
        // The frictionless contact is too wide, but the glued one may be narrower, so the whole
        // range is searched.
        Err(Refusal::TooWide) => Ok(widest),
        Err(refusal) => Err(refusal),
    }
}

/// The half-width at which a rising function reaches a value.
fn half_width_reaching(of: &dyn Fn(f64) -> f64, value: f64, widest: f64) -> Result<f64, Refusal> {
    let (mut low, mut high) = (0.0, widest);
    if of(widest) < value * (1.0 - 1e-9) {
        return Err(Refusal::TooWide);
    }
    let mut b = 0.9 * widest;
    for _ in 0..80 {
        let miss = of(b) - value;
        if miss > 0.0 {
            high = b
        } else {
            low = b
        }
        let step = 1e-6 * widest;
        let slope = (of(b + step) - of(b - step)) / (2.0 * step);
        let newton = b - miss / slope;
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - b).abs() < 1e-13 * widest {
            return Ok(next);
        }
        b = next;
    }
    Ok(b)
}
