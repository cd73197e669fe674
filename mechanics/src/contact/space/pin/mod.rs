//! A rigid pin or bar of finite length, with flat ends, tilted along its axis: a reduced model of
//! slices. Each slice carries a plane contact's pressure (few cosines over the square root's
//! singularity), the slices couple through the layer. What is solved is Galerkin's form of the
//! exact problem: error falls with the slice length and the number of cosines, and force and image
//! are of second order in what is left.
//!
//! The free width of each slice is found by Newton's method: a width that is not the right one
//! leaves a punch's singularity at the edge, and the plane problem says which penetration cures
//! it. Lifted slices leave the contact and come back when the layer would touch them. A contact is
//! the guess of the next one; pressing allocates nothing.
//!
//! Ends: strips of constant pressure see an end inside of its place, by a fixed part of their
//! length (0.115 for a face of fixed width, which follows from the logarithmic kernel; 0.057 where
//! the width is free, measured by halving the strips). The slices are laid out for it.
//!
//! It refuses what its tables do not cover: see [`Pin::new`] and [`Pin::press`].

mod couple;
mod roll;
mod solve;
pub(super) mod strip;

use super::super::layer::Layer;
use super::super::{Invalid, finite, positive};
use super::tactels::Shares;
use super::{Drive, Level};
use core::f64::consts::PI;
use couple::{Coupling, Modes, Parity};
pub use roll::Roll;
use strip::{Section, Strips};

/// What the end of a row of strips of fixed and of free width loses, in strip lengths.
const ENDS: [f64; 2] = [0.115_052, 0.057];
/// Shortest pin in thicknesses.
const SHORTEST: f64 = 0.1;
/// Most points across half a slice in an image.
const POINTS_MAX: usize = 96;
/// Most slices of a pin.
const SLICES_MAX: usize = 4096;

/// Cross-section of an indenter that is long in one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Profile {
    /// A cylinder lying on the layer, the exact circle.
    Cylinder {
        /// Radius, mm.
        radius_mm: f64,
    },
    /// A bar with a flat face and sharp edges.
    Bar {
        /// Width of the face, mm.
        width_mm: f64,
    },
}

impl Profile {
    /// In thicknesses, checked.
    pub(super) fn section(self, thickness_mm: f64) -> Result<Section, Invalid> {
        match self {
            Self::Cylinder { radius_mm } => {
                positive("radius_mm", radius_mm)?;
                Ok(Section::Circle(radius_mm / thickness_mm))
            }
            Self::Bar { width_mm } => {
                positive("width_mm", width_mm)?;
                Ok(Section::Flat(0.5 * width_mm / thickness_mm))
            }
        }
    }
}

/// Where the pin stands over the array.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stand {
    /// x of the pin's origin, mm.
    pub x_mm: f64,
    /// y of the pin's origin, mm.
    pub y_mm: f64,
    /// Direction of the axis: (-sin, cos).
    pub rot_rad: f64,
}

/// What a pressed pin says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PinState {
    /// Normal force of the whole pin, N.
    pub force_n: f64,
    /// Moment of the pressure about the origin, across the axis: force times place along it, N mm.
    pub moment_n_mm: f64,
    /// Penetration of the lowest line at the origin, mm.
    pub penetration_mm: f64,
    /// Slope of the axis, rad.
    pub tilt_rad: f64,
    /// Largest half-width of the contact, mm.
    pub half_width_mm: f64,
    /// Length of the pin in contact, mm.
    pub length_mm: f64,
    /// Largest error of the penetration that a slice still sees, over the largest penetration.
    pub residual: f64,
    /// Free-boundary steps taken.
    pub steps: usize,
}

/// Accuracy against time, per [`Level`].
#[derive(Clone, Copy, Debug)]
struct Fineness {
    /// Longest slice in thicknesses.
    slice: f64,
    /// Fewest slices.
    fewest: f64,
    modes: Modes,
    /// Cosines at zero width, and more per thickness of half-width.
    cosines: (f64, f64),
    /// Wave number (times thickness) up to which the points of an image stand for the pressure.
    points: f64,
    tolerance: f64,
    steps: usize,
}

impl Fineness {
    fn of(level: Level) -> Self {
        let modes = |margin, cutoff, reach| Modes { margin, cutoff, reach };
        match level {
            Level::Fast => Self {
                slice: 1.0,
                fewest: 24.0,
                modes: modes(10.0, 5.0, 7.0),
                cosines: (3.0, 0.0),
                points: 5.0,
                tolerance: 3e-3,
                steps: 8,
            },
            Level::Default => Self {
                slice: 0.5,
                fewest: 96.0,
                modes: modes(12.0, 10.0, 12.0),
                cosines: (4.0, 0.5),
                points: 11.0,
                tolerance: 1e-4,
                steps: 25,
            },
            Level::Fine => Self {
                slice: 0.25,
                fewest: 100.0,
                modes: modes(18.0, 20.0, 16.0),
                cosines: (6.0, 1.0),
                points: 18.0,
                tolerance: 1e-6,
                steps: 60,
            },
        }
    }
}

/// The solver of one pin on one layer, with its memory.
#[derive(Clone, Debug)]
pub struct Pin {
    layer: Layer,
    fineness: Fineness,
    strips: Strips,
    coupling: Coupling,
    /// Slice length and places along the axis from the origin, in thicknesses.
    h: f64,
    along: Vec<f64>,
    work: solve::Work,
    /// For 1, 2 ... points across half a slice: cos(theta), then cos(2 k theta), point after point.
    rules: Vec<Vec<f64>>,
    state: PinState,
}

impl Pin {
    /// Tabulates a pin whose axis spans `ends_mm` from its origin, for penetrations of its deepest
    /// slice up to `penetration_max_mm`; allocates.
    ///
    /// # Errors
    /// A layer that [`Layer::check`] refuses, sizes that are not finite and above zero, ends that
    /// are reversed, a penetration of the thickness or more, contacts wider than 0.95 of the
    /// diameter or 80 thicknesses, pins longer than 4096 slices.
    pub fn new(
        layer: &Layer,
        profile: Profile,
        ends_mm: [f64; 2],
        penetration_max_mm: f64,
        level: Level,
    ) -> Result<Self, Invalid> {
        layer.check()?;
        let t = layer.thickness_mm;
        let section = profile.section(t)?;
        let [from, to] = ends_mm;
        finite("length_mm", from)?;
        finite("length_mm", to)?;
        positive("length_mm", to - from)?;
        positive("penetration_max_mm", penetration_max_mm)?;
        if penetration_max_mm >= t {
            let what = format!("{penetration_max_mm} mm is the layer's thickness or more");
            return Err(Invalid::new("penetration_max_mm", what, "give less than the thickness"));
        }
        let fineness = Fineness::of(level);
        let length = (to - from) / t;
        if length < SHORTEST {
            let what = format!("{} mm is {length} thicknesses", to - from);
            return Err(Invalid::new("length_mm", what, "give at least a tenth of the thickness"));
        }
        let wanted = libm::ceil(length / fineness.slice).max(fineness.fewest);
        if wanted > SLICES_MAX as f64 {
            let what = format!("{} mm is {length} thicknesses", to - from);
            return Err(Invalid::new("length_mm", what, "cut the pin at the array"));
        }
        let slices = wanted as usize;
        let end = ENDS[usize::from(matches!(section, Section::Circle(_)))];
        let h = length / (slices as f64 - 2.0 * end);
        let middle = 0.5 * (from + to) / t;
        let place = |i: usize| middle + (i as f64 - 0.5 * (slices as f64 - 1.0)) * h;
        let transfer = layer.transfer();
        let (least, more) = fineness.cosines;
        let count = |b: f64| {
            let flat = if matches!(section, Section::Flat(_)) { 2.0 * b } else { 0.0 };
            (least + more * b + flat) as usize
        };
        let strips = Strips::new(&transfer, section, penetration_max_mm / t, count)?;
        let cosines = strips.places.cosines;
        let sizes = ((cosines, strips.widest()), (slices, h));
        let coupling = Coupling::new(&transfer, (fineness.modes, Parity::Even), sizes.0, sizes.1);
        let work = solve::Work::new(slices, strips.places, coupling.transform_len());
        let most = points_for(fineness.points, strips.widest());
        Ok(Self {
            layer: *layer,
            fineness,
            strips,
            coupling,
            h,
            along: (0..slices).map(place).collect(),
            work,
            rules: (1..=most).map(|points| rule(points, cosines)).collect(),
            state: PinState::default(),
        })
    }

    /// Presses the pin with its axis sloping down towards +v by `tilt_rad`: the penetration at a
    /// place v along the axis is that at the origin plus v tan(tilt).
    ///
    /// # Errors
    /// What is not finite, a pull, a tilt beyond 0.2 rad, a penetration beyond the table, a force
    /// that no penetration of the table reaches. The state is then that of no contact.
    pub fn press(&mut self, drive: Drive, tilt_rad: f64) -> Result<PinState, Invalid> {
        self.state = PinState::default();
        let outcome = self.try_press(drive, tilt_rad);
        if outcome.is_err() {
            self.release();
        }
        outcome
    }

    /// Lifts the pin off and forgets the contact.
    pub fn release(&mut self) {
        self.work.clear();
        self.state = PinState::default();
    }

    /// The contact last solved.
    #[must_use]
    pub fn state(&self) -> PinState {
        self.state
    }

    /// Adds the image of the contact to `image`, stresses in MPa; nothing without contact, or when
    /// the stand is not finite.
    pub fn image(&self, shares: &Shares, stand: Stand, image: &mut [f64]) {
        let (s, c) = (libm::sin(stand.rot_rad), libm::cos(stand.rot_rad));
        self.loads(|[u, v], force| {
            shares.add(image, [stand.x_mm + u * c - v * s, stand.y_mm + u * s + v * c], force);
        });
    }

    /// Calls with place (across, along) in mm and force in N of point loads that stand for the
    /// contact.
    pub fn loads(&self, mut of: impl FnMut([f64; 2], f64)) {
        let t = self.layer.thickness_mm;
        let scale = 0.5 * PI * self.modulus_mpa() * t * t * self.h;
        for (j, v) in self.along.iter().enumerate() {
            if !self.work.touches(j) {
                continue;
            }
            let (b, a) = self.work.slice(j);
            let points = points_for(self.fineness.points, b).min(self.rules.len());
            for point in self.rules[points - 1].chunks_exact(a.len() + 1) {
                let psi: f64 = point[1..].iter().zip(a).map(|(x, y)| x * y).sum();
                let (u, force) = (b * point[0] * t, scale / points as f64 * psi);
                of([u, v * t], force);
                of([-u, v * t], force);
            }
        }
    }

    /// pi G/(1 - nu): pressure per unit of the kernels.
    fn modulus_mpa(&self) -> f64 {
        PI * self.layer.shear_mpa() / (1.0 - self.layer.poisson)
    }
}

/// Points across half a strip of half-width `b` that stand for wave numbers up to `cutoff`: the
/// error of Gauss and Chebyshev's rule with 2 n points is the Bessel function J_4n(cutoff b).
fn points_for(cutoff: f64, b: f64) -> usize {
    (libm::ceil(0.25 * (cutoff * b + 0.5 * cutoff)) as usize).clamp(2, POINTS_MAX)
}

/// cos(theta) and cos(2 k theta) at the points of half a strip.
fn rule(points: usize, cosines: usize) -> Vec<f64> {
    let mut out = Vec::with_capacity(points * (cosines + 1));
    for i in 0..points {
        let angle = PI * (2 * i + 1) as f64 / (4 * points) as f64;
        out.push(libm::cos(angle));
        out.extend((0..cosines).map(|k| libm::cos(2.0 * k as f64 * angle)));
    }
    out
}
