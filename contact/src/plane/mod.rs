//! Plane contact of rigid indenters with the bonded layer: a flat bar that may tilt and lift off,
//! or a cylinder (exact circle or parabola), frictionless or with a tangential traction in
//! proportion to the pressure. Force or displacement is prescribed. The solution is spectral, and
//! only the construction allocates.
//!
//! x is measured from the indenter's centre line. Loads act at the top centre of a bar, `height_mm`
//! above the layer, and on the axis of a cylinder; a line load P > 0 presses, Q > 0 pushes the
//! layer along +x. Inside the contact the surface goes down by delta + slope x less the profile.
//!
//! These are errors: loads that pull, a bar that topples, a contact as wide as the cylinder or too
//! wide for the points that it may use, a bar from which friction of several times the pressure
//! pulls the layer off between its edges, and numbers that are not finite. An error is a plain
//! value without text ([`Refusal`]), because the solver runs inside control periods. Free ends of
//! the layer are not modelled. Stick and slip are in [`frictional`], contacts without slip in
//! [`noslip`], feature Jacobians in [`rates`], and the table of a bar's contacts in
//! [`contact_table`].

mod bar;
mod coarse_kernels;
pub mod compliance;
pub mod contact_table;
mod cylinder;
pub mod features;
pub mod frictional;
mod glued;
mod interval;
mod load_step;
pub mod noslip;
mod point_count;
pub mod rates;
pub mod recovery;
mod refusal;
pub mod spectrum;
mod surface_kernels;

use super::layer::Layer;
use super::numeric::jacobi;
use super::stack::Stack;
use super::{Invalid, positive};
use crate::Accuracy;
use core::f64::consts::PI;
use interval::Interval;
use point_count::PointCounts;
pub use refusal::Refusal;
pub use spectrum::{PointForce, Spectrum};
use surface_kernels::SurfaceKernels;

/// Shape of the rigid indenter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A flat bar with sharp corners.
    Flat {
        /// Width in mm.
        width_mm: f64,
        /// Height of the loads above the layer in mm, 0 or more.
        height_mm: f64,
    },
    /// A circular cylinder, R - sqrt(R^2 - x^2).
    Cylinder {
        /// Radius in mm.
        radius_mm: f64,
    },
    /// Its parabola, x^2/(2R).
    Parabola {
        /// Radius of curvature in mm.
        radius_mm: f64,
    },
}

impl Shape {
    /// # Errors
    /// Sizes that are not finite and above 0 (a height may be 0).
    pub fn check(&self) -> Result<(), Invalid> {
        match *self {
            Self::Flat { width_mm, height_mm } => {
                positive("width_mm", width_mm)?;
                if height_mm == 0.0 { Ok(()) } else { positive("height_mm", height_mm) }
            }
            Self::Cylinder { radius_mm } | Self::Parabola { radius_mm } => {
                positive("radius_mm", radius_mm)
            }
        }
    }
}

/// The tangential traction that the tangential load makes on the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Friction {
    /// No tangential traction: of the load Q only its moment about the surface acts.
    None,
    /// q(x) = (Q/P) p(x), with its whole effect on the pressure.
    Proportional,
}

/// Most concentrated forces into which a traction is divided.
const POINT_FORCES_MAX: f64 = 4000.0;
/// Loads in N/mm and descents in mm below this count as none, since their powers underflow.
pub const LOAD_MIN: f64 = 1e-100;

/// Line loads in N/mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Normal load P, 0 or above; below [`LOAD_MIN`] it is none.
    pub p_n_mm: f64,
    /// Tangential load Q.
    pub q_n_mm: f64,
}

impl Load {
    /// Whether the load presses the indenter on the layer, so that there is a contact to solve.
    ///
    /// # Errors
    /// A load that is not finite, or beyond 1e30; one that pulls, or slides without pressing.
    pub fn is_pressing(&self) -> Result<bool, Refusal> {
        let Self { p_n_mm: p, q_n_mm: q } = *self;
        if !(is_in_range(p) && is_in_range(q)) {
            return Err(Refusal::NotFinite);
        }
        if p < 0.0 || (p < LOAD_MIN && q != 0.0) {
            return Err(Refusal::Tension);
        }
        Ok(p >= LOAD_MIN)
    }
}

/// The part of the indenter that touches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Nothing: no load.
    Open,
    /// The whole bar.
    Full,
    /// The bar's left edge is lifted.
    LeftLifted,
    /// The bar's right edge is lifted.
    RightLifted,
    /// An interval between two free edges.
    Free,
}

/// A solved contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Normal load in N/mm.
    pub p_n_mm: f64,
    /// Tangential load in N/mm.
    pub q_n_mm: f64,
    /// Descent of the indenter at x = 0 in mm.
    pub delta_mm: f64,
    /// Tilt: further descent per mm of x.
    pub slope: f64,
    /// Left end of the contact in mm.
    pub x_left_mm: f64,
    /// Right end of the contact in mm.
    pub x_right_mm: f64,
    /// Which part touches.
    pub mode: Mode,
    /// Largest violation of equilibrium and of a vanishing pressure at free edges, relative to the
    /// load and the mean pressure.
    pub residual: f64,
}

/// A rigid indenter over a layer. Kernels are tabulated once, storage is kept, and the last contact
/// is the initial guess for the next one.
#[derive(Clone, Debug)]
pub struct Indenter {
    layer: Layer,
    shape: Shape,
    friction: Friction,
    accuracy: Accuracy,
    kernels: SurfaceKernels,
    interval: Interval,
    point_counts: PointCounts,
    /// Pressure of the last solution over its singular weight, and working storage.
    phi: Vec<f64>,
    work: [Vec<f64>; 2],
    contact: Contact,
    /// Logarithm of the last interval's half-width in thicknesses, and how the load followed it.
    guess: Option<[f64; 2]>,
    /// Place of the loads, and logarithm of the half-width, of the last two lifted bars: older,
    /// newer.
    edge_history: [Option<[f64; 2]>; 2],
}

const NO_CONTACT: Contact = Contact {
    p_n_mm: 0.0,
    q_n_mm: 0.0,
    delta_mm: 0.0,
    slope: 0.0,
    x_left_mm: 0.0,
    x_right_mm: 0.0,
    mode: Mode::Open,
    residual: 0.0,
};

/// Whether a load or move is finite and within [`MAGNITUDE_MAX`](super::MAGNITUDE_MAX).
fn is_in_range(value: f64) -> bool {
    value.abs() <= super::MAGNITUDE_MAX
}

impl Indenter {
    /// Tabulates the layer's kernels (milliseconds) and makes room; allocates.
    ///
    /// # Errors
    /// A layer or a shape that their checks refuse; a bar too wide for the points.
    pub fn new(
        layer: &Layer,
        shape: Shape,
        friction: Friction,
        accuracy: Accuracy,
    ) -> Result<Self, Invalid> {
        layer.check()?;
        Self::from_kernels(layer, shape, friction, accuracy, SurfaceKernels::new(&layer.transfer()))
    }

    /// The same over several bonded layers; lengths of the contact are resolved against the surface
    /// layer's thickness. Up to a second; allocates.
    ///
    /// # Errors
    /// As [`Self::new`]; a surface layer too thin for the stack below it. Stress and moments are
    /// those of [`Spectrum::of_stack`] and [`features::stack_moments`].
    pub fn on_stack(
        stack: &Stack,
        shape: Shape,
        friction: Friction,
        accuracy: Accuracy,
    ) -> Result<Self, Invalid> {
        let kernels = SurfaceKernels::of_stack(stack)?;
        Self::from_kernels(stack.surface_layer(), shape, friction, accuracy, kernels)
    }

    /// Another shape over the same layer, with the kernels of this one; allocates.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_shape(&self, shape: Shape) -> Result<Self, Invalid> {
        Self::from_kernels(&self.layer, shape, self.friction, self.accuracy, self.kernels.clone())
    }

    /// The same indenter solved with another accuracy, with the kernels of this one; allocates.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_accuracy(&self, accuracy: Accuracy) -> Result<Self, Invalid> {
        Self::from_kernels(&self.layer, self.shape, self.friction, accuracy, self.kernels.clone())
    }

    /// The accuracy with which it solves.
    #[must_use]
    pub fn accuracy(&self) -> Accuracy {
        self.accuracy
    }

    fn from_kernels(
        layer: &Layer,
        shape: Shape,
        friction: Friction,
        accuracy: Accuracy,
        kernels: SurfaceKernels,
    ) -> Result<Self, Invalid> {
        shape.check()?;
        let point_counts =
            PointCounts::new(accuracy, &kernels.transfer, shape, layer.thickness_mm)?;
        let capacity = point_counts.capacity();
        let room = || Vec::with_capacity(capacity);
        Ok(Self {
            layer: *layer,
            shape,
            friction,
            accuracy,
            kernels,
            interval: if accuracy == Accuracy::Fast {
                Interval::coarse(capacity)
            } else {
                Interval::with_capacity(capacity)
            },
            point_counts,
            phi: room(),
            work: [room(), room()],
            contact: NO_CONTACT,
            guess: None,
            edge_history: [None; 2],
        })
    }

    /// The layer underneath.
    #[must_use]
    pub fn layer(&self) -> &Layer {
        &self.layer
    }

    /// The last solution; [`Mode::Open`] before the first and after a refusal.
    #[must_use]
    pub fn contact(&self) -> &Contact {
        &self.contact
    }

    /// Forgets the last solution, so that the next one starts cold.
    pub fn forget(&mut self) {
        (self.guess, self.edge_history) = (None, [None; 2]);
        self.contact = NO_CONTACT;
        self.phi.clear();
    }

    /// The contact under a load; starts from the last one. Does not allocate.
    ///
    /// # Errors
    /// See [`Refusal`]; the next solution then starts cold.
    pub fn press(&mut self, load: &Load) -> Result<Contact, Refusal> {
        let contact = self.press_one_interval(load)?;
        if self.has_tension() { self.store(Err(Refusal::SplitContact)) } else { Ok(contact) }
    }

    /// As [`Self::press`], but a solution with tension between a bar's edges is accepted too.
    fn press_one_interval(&mut self, load: &Load) -> Result<Contact, Refusal> {
        let outcome = self.equilibrium(load);
        self.store(outcome)
    }

    /// The contact at a descent of the indenter by `dz_mm`, a bar held upright. Does not allocate.
    /// Under friction in proportion use [`Self::press`]: no load, no ratio.
    ///
    /// # Errors
    /// See [`Refusal`]; proportional friction is taken as [`Friction::None`].
    pub fn descend(&mut self, dz_mm: f64) -> Result<Contact, Refusal> {
        let outcome = if !is_in_range(dz_mm) {
            Err(Refusal::NotFinite)
        } else if dz_mm < LOAD_MIN {
            Ok(NO_CONTACT)
        } else {
            match self.shape {
                Shape::Flat { width_mm, .. } => self.solve_bar_descent(width_mm, dz_mm),
                _ => self.solve_cylinder_descent(dz_mm),
            }
        };
        self.store(outcome)
    }

    fn store(&mut self, outcome: Result<Contact, Refusal>) -> Result<Contact, Refusal> {
        match outcome {
            Ok(contact) => self.contact = contact,
            Err(_) => self.forget(),
        }
        if self.contact.mode == Mode::Open {
            self.phi.clear();
        }
        outcome
    }

    fn equilibrium(&mut self, load: &Load) -> Result<Contact, Refusal> {
        if !load.is_pressing()? {
            return Ok(NO_CONTACT);
        }
        match self.shape {
            Shape::Flat { width_mm, height_mm } => self.solve_bar(width_mm, height_mm, load),
            _ => self.solve_cylinder(load),
        }
    }

    /// pi G/(1 - nu), the unit of tractions.
    fn modulus_mpa(&self) -> f64 {
        PI * self.layer.shear_mpa() / (1.0 - self.layer.poisson)
    }

    /// Ratio of the tangential traction to the pressure.
    fn ratio(&self, load: &Load) -> f64 {
        match self.friction {
            Friction::None => 0.0,
            Friction::Proportional => load.q_n_mm / load.p_n_mm,
        }
    }

    fn assemble(&mut self, half: f64, ratio: f64) -> Result<(), Refusal> {
        let count = self.point_counts.points(half);
        if count > self.point_counts.capacity() || !half.is_finite() {
            return Err(Refusal::TooWide);
        }
        let coupling = ratio / self.kernels.transfer.m;
        self.interval.assemble(&self.kernels, count, half, coupling);
        Ok(())
    }

    /// Pressure in MPa at `x_mm` of the last solution; 0 outside the contact, infinite at a bar's
    /// corner.
    #[must_use]
    pub fn pressure_mpa(&self, x_mm: f64) -> f64 {
        let Contact { x_left_mm: left, x_right_mm: right, .. } = self.contact;
        if self.phi.is_empty() || !(x_mm >= left && x_mm <= right) {
            return 0.0;
        }
        let xi = (2.0 * x_mm - left - right) / (right - left);
        // The place is the corner itself, up to rounding.
        if xi.abs() >= 1.0 - 1e-13 {
            let pinned = match self.contact.mode {
                Mode::Full => true,
                Mode::LeftLifted => xi > 0.0,
                Mode::RightLifted => xi < 0.0,
                Mode::Open | Mode::Free => false,
            };
            return if pinned { f64::INFINITY } else { 0.0 };
        }
        self.modulus_mpa() * self.interval.pressure(&self.phi, xi)
    }

    /// Strength of the pressure's singularity at the corner: p goes as K/sqrt(2 (1 - x/a)) towards
    /// a frictionless edge at x = a, a being half the contact's width. Left, then right, in MPa.
    #[must_use]
    pub fn edge_strengths_mpa(&self) -> [f64; 2] {
        if self.phi.is_empty() {
            return [0.0; 2];
        }
        let at = |xi: f64| self.modulus_mpa() * self.interval.at(&self.phi, xi);
        [at(-1.0), at(1.0)]
    }

    /// The traction as concentrated forces whose stress at `depth_mm` and below is right to about
    /// the solution's own error, down to [`Self::shallowest_mm`]. Allocates.
    #[must_use]
    pub fn point_forces(&self, depth_mm: f64) -> Vec<PointForce> {
        let Contact { p_n_mm: p, q_n_mm: q, .. } = self.contact;
        if self.phi.is_empty() {
            return Vec::new();
        }
        let ratio = if self.friction == Friction::None { 0.0 } else { q / p };
        self.forces_of(&self.phi, ratio, depth_mm)
    }

    /// Least depth for which there are points enough.
    #[must_use]
    pub fn shallowest_mm(&self) -> f64 {
        let Contact { x_left_mm: left, x_right_mm: right, .. } = self.contact;
        let digits = match self.accuracy {
            Accuracy::Fast => 5.1,
            Accuracy::Default => 7.8,
            Accuracy::Fine => 11.3,
        };
        digits * 0.5 * (right - left) / POINT_FORCES_MAX
    }

    /// The traction of any `phi` on the last contact's interval.
    fn forces_of(&self, phi: &[f64], ratio: f64, depth_mm: f64) -> Vec<PointForce> {
        let Contact { x_left_mm: left, x_right_mm: right, .. } = self.contact;
        let half = 0.5 * (right - left);
        let middle = 0.5 * (right + left);
        let width = half / depth_mm.min(self.layer.thickness_mm);
        // A Gauss rule of n points misses a pole at a distance d by exp(-2 n d/half).
        let digits = if self.accuracy == Accuracy::Fine { 13.0 } else { 11.0 };
        let count = (24.0 + digits * width).min(POINT_FORCES_MAX) as usize;
        let alpha = self.interval.alpha();
        let mut rule = jacobi::JacobiRule::with_capacity(count);
        rule.fill(count, alpha, -1.0 - alpha);
        let scale = self.modulus_mpa() * half;
        let force = |xi: &f64, weight: &f64| {
            let normal = scale * weight * self.interval.at(phi, *xi);
            [middle + half * xi, normal, ratio * normal]
        };
        rule.nodes.iter().zip(&rule.weights).map(|(xi, weight)| force(xi, weight)).collect()
    }
}
