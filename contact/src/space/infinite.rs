//! A rigid cylinder or flat bar without ends on the bonded layer, in any direction over the array:
//! the plane contact and its base stress, integrated over each tactel in closed form.
//!
//! A tactel's square, seen along the axis, is the convolution of two boxes, so its mean is a second
//! difference of the pressure's second integral, whatever its direction (`across.rs`).
//!
//! Measured against exact solutions: 1e-6 of the peak or better, means over tactels under a quarter
//! of the thickness 5e-6. Forces are N per mm of length. It refuses penetrations of the thickness
//! or more, contacts wider than 0.95 of the diameter or 80 thicknesses, and forces beyond the
//! largest tabulated penetration.

use super::super::kernel::{BASE_CUTOFF, SurfaceKernel, TransferSamples};
use super::super::layer::{Layer, Transfer};
use super::super::{Invalid, finite, positive};
use super::across::Across;
use super::pin::strip::{Section, StripTable};
use super::pin::{PlanarPose, Profile};
use super::table::Even;
use super::tactels::{Array, Sampling};
use super::{Prescribed, Refusal, Why};
use crate::numeric::cholesky::{factor, solve};
use crate::wave_grid::FIELD_REACH;
use core::f64::consts::PI;

/// Table points per thickness.
const POINTS_PER_THICKNESS: f64 = 32.0;
/// Half-width of the narrowest contact that is read from the tables, in parts of the widest one
/// and at most in thicknesses: of narrower ones the rows know less than the half plane does.
const TABLE_WIDTH_MIN: (f64, f64) = (0.01, 0.02);
/// Solutions that one search may take.
const SOLUTIONS_MAX: usize = 40;
/// Penetrations beyond so many loads are of wider contacts for certain.
const DEPTH_PER_LOAD_MAX: f64 = 50.0;

/// What a pressed indenter says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineState {
    /// Load per mm of length, N/mm.
    pub force_n_mm: f64,
    /// Penetration of the lowest line, mm.
    pub penetration_mm: f64,
    /// Half the width of the contact, mm.
    pub half_width_mm: f64,
    /// Strength of the singularity left at the edges, over that of a flat punch; 0 for a bar.
    pub residual: f64,
}

/// The solver of one indenter on one layer, with its memory.
#[derive(Clone, Debug)]
pub struct InfiniteIndenter {
    layer: Layer,
    section: Section,
    strips: StripTable,
    density: Even,
    across: Across,
    row: Vec<f64>,
    matrix: Vec<f64>,
    sides: [Vec<f64>; 2],
    /// Place (thicknesses) and load (N/mm) of the pairs of lines that stand for the pressure.
    lines: Vec<[f64; 2]>,
    /// What the other line of a pair carries of the first one's load: 1, or -1 for a roll.
    mirror: f64,
    state: LineState,
}

/// A contact found, in thicknesses: the pressure of half-width `b` and penetration `delta` in a
/// part of its size, `wide` and `depth` deep then.
struct Found {
    b: f64,
    wide: f64,
    delta: f64,
    part: f64,
    depth: f64,
}

impl Found {
    fn whole(b: f64, delta: f64) -> Self {
        Self { b, wide: b, delta, part: 1.0, depth: delta }
    }
}

impl InfiniteIndenter {
    /// Tabulates contacts up to a penetration; allocates.
    ///
    /// # Errors
    /// A layer that [`Layer::check`] refuses, a size or penetration that is not finite and above
    /// zero, and what this module refuses.
    pub fn new(layer: &Layer, profile: Profile, penetration_max_mm: f64) -> Result<Self, Invalid> {
        layer.check()?;
        let section = profile.section(layer.thickness_mm)?;
        positive("penetration_max_mm", penetration_max_mm)?;
        let t = layer.thickness_mm;
        if penetration_max_mm >= t {
            let what = format!("{penetration_max_mm} mm is the layer's thickness or more");
            return Err(Invalid::new("penetration_max_mm", what, "give less than the thickness"));
        }
        let transfer = layer.transfer();
        let count = |b: f64| 10 + libm::ceil(1.5 * b) as usize;
        let kernel = SurfaceKernel::new(|a| transfer.normal_compliance(a));
        let strips = StripTable::new(&kernel, section, penetration_max_mm / t, count)?;
        let n = strips.layout.cosines;
        let lines = pairs(strips.widest());
        Ok(Self {
            layer: *layer,
            section,
            density: density(&transfer),
            across: Across::new(&transfer, strips.widest()),
            row: vec![0.0; strips.layout.len()],
            matrix: vec![0.0; n * n],
            sides: [vec![0.0; n], vec![0.0; n]],
            lines: vec![[0.0; 2]; lines],
            mirror: 1.0,
            state: LineState::default(),
            strips,
        })
    }

    /// Presses the indenter to a load per mm or a penetration; penetrations of 0 or less are no
    /// contact.
    ///
    /// # Errors
    /// What is not finite, a load below 0, and what the tables do not reach. The state is then that
    /// of no contact.
    pub fn press(&mut self, prescribed: Prescribed) -> Result<LineState, Refusal> {
        self.state = LineState::default();
        let t = self.layer.thickness_mm;
        let target = prescribed.check(t)?;
        if target <= 0.0 {
            return Ok(self.state);
        }
        let modulus = PI * self.layer.shear_mpa() / (1.0 - self.layer.poisson);
        let (by_force, wanted) = match prescribed {
            Prescribed::ForceN(force) => (true, force / (modulus * t)),
            Prescribed::PenetrationMm(delta) => (false, delta / t),
        };
        let Found { b, wide, delta, part, depth } = self.search(by_force, wanted, prescribed)?;
        let [punch, shape] = &mut self.sides;
        let mut edges = [0.0; 2];
        for (p, s) in punch.iter_mut().zip(shape) {
            *s = part * (delta * *p - *s);
            edges[0] += part * *p;
            edges[1] += *s;
        }
        let psi = &self.sides[1];
        let first = psi[0];
        let count = pairs(b).min(self.lines.capacity());
        self.lines.resize(count, [0.0; 2]);
        lay(&mut self.lines, psi, [b, modulus * t], 0.0);
        self.across.carry(&self.lines, self.mirror);
        self.state = LineState {
            force_n_mm: PI * first * modulus * t,
            penetration_mm: depth * t,
            half_width_mm: wide * t,
            residual: if self.strips.is_free() {
                (edges[1] / (delta * edges[0])).abs()
            } else {
                0.0
            },
        };
        Ok(self.state)
    }

    /// The rate of the last contact per rad of roll that lowers the side towards +u: its image is
    /// the image's rate. None for a cylinder and without contact.
    #[must_use]
    pub fn roll(&self) -> Option<Self> {
        if self.strips.is_free() || self.state.force_n_mm == 0.0 {
            return None;
        }
        let half = self.strips.widest();
        let strips = StripTable::odd(&self.layer.transfer(), half, self.strips.layout.cosines)?;
        let mut rate = Self { strips, mirror: -1.0, ..self.clone() };
        let layout = rate.strips.layout;
        rate.strips.row(half, &mut rate.row);
        // The descent b cos(theta) of a unit slope has the one moment b pi/2.
        let a = rate.row[layout.punch(0)..layout.penetration()].iter().map(|a| 0.5 * half * a);
        let a: Vec<f64> = a.collect();
        let modulus = PI * self.layer.shear_mpa() / (1.0 - self.layer.poisson);
        lay(&mut rate.lines, &a, [half, modulus * self.layer.thickness_mm], 1.0);
        rate.across.carry(&rate.lines, rate.mirror);
        Some(rate)
    }

    /// Lifts the indenter off.
    pub fn release(&mut self) {
        self.state = LineState::default();
    }

    /// The contact last solved.
    #[must_use]
    pub fn state(&self) -> LineState {
        self.state
    }

    /// The contact of a cylinder that is narrower than what is read, if it is: on a half plane
    /// the load is b^2/(2 R) and goes with a penetration of load (1/k + 1/2), k the stiffness of a
    /// punch as wide, whose inverse goes with the logarithm of the width.
    fn narrow(&mut self, by_force: bool, wanted: f64) -> Option<Found> {
        let Section::Circle(radius) = self.section else { return None };
        let b = TABLE_WIDTH_MIN.1.min(TABLE_WIDTH_MIN.0 * self.strips.widest());
        let largest = 0.5 * b * b / radius;
        // A penetration is some times its load, by a logarithm.
        if wanted > DEPTH_PER_LOAD_MAX * largest {
            return None;
        }
        let (delta, load, stiffness) = self.plane(b)?;
        let depth = |force: f64| force * (1.0 / stiffness + 0.5 - 0.5 * libm::log(force / largest));
        if wanted >= if by_force { largest } else { depth(largest) } {
            return None;
        }
        let mut force = if by_force { wanted } else { wanted * largest / depth(largest) };
        if !by_force {
            for _ in 0..SOLUTIONS_MAX {
                force *= wanted / depth(force);
            }
        }
        let wide = (2.0 * radius * force).sqrt();
        Some(Found { b, wide, delta, part: force / load, depth: depth(force) })
    }

    /// The contact wanted; its punch and shape are in `sides`.
    fn search(
        &mut self,
        by_force: bool,
        wanted: f64,
        prescribed: Prescribed,
    ) -> Result<Found, Refusal> {
        let widest = self.strips.widest();
        if !self.strips.is_free() {
            let stiffness = self.plane(widest).map_or(f64::NAN, |(_, _, stiffness)| stiffness);
            let delta = if by_force { wanted / stiffness } else { wanted };
            if delta < 1.0 {
                return Ok(Found::whole(widest, delta));
            }
            let deep_mm = delta * self.layer.thickness_mm;
            return Err(Refusal::new(prescribed.place(), Why::Thickness(deep_mm)));
        }
        if let Some(found) = self.narrow(by_force, wanted) {
            return Ok(found);
        }
        let start = if by_force { wanted.sqrt() } else { self.strips.half_width(wanted) };
        let (mut b, mut slope) = (start.min(widest), 2.0);
        let mut before: Option<(f64, f64)> = None;
        for _ in 0..SOLUTIONS_MAX {
            let Some((delta, load, stiffness)) = self.plane(b) else { break };
            let miss = libm::log(if by_force { load } else { delta } / wanted);
            if let Some((b_before, miss_before)) = before {
                let run = libm::log(b / b_before);
                if run != 0.0 {
                    slope = ((miss - miss_before) / run).clamp(0.7, 8.0);
                }
            }
            if miss.abs() < 1e-8 {
                let change = if by_force { (wanted - load) / stiffness } else { wanted - delta };
                return Ok(Found::whole(b, delta + change));
            }
            if miss < 0.0 && b >= widest {
                break;
            }
            before = Some((b, miss));
            b = (b * libm::exp((-miss / slope).clamp(-2.0, 2.0))).min(widest);
        }
        Err(Refusal::new(prescribed.place(), Why::BeyondTable))
    }

    /// Penetration, load and stiffness of the contact of half-width `b`.
    fn plane(&mut self, b: f64) -> Option<(f64, f64, f64)> {
        let (layout, n) = (self.strips.layout, self.strips.layout.cosines);
        self.strips.row(b, &mut self.row);
        for k in 0..n {
            for l in 0..=k {
                self.matrix[k * n + l] = self.row[layout.matrix(k, l)];
            }
        }
        if !factor(&mut self.matrix, n) {
            return None;
        }
        let [punch, shape] = &mut self.sides;
        punch.fill(0.0);
        punch[0] = PI;
        shape.copy_from_slice(&self.row[layout.shape(0)..layout.shape(n)]);
        solve(&self.matrix, n, punch);
        solve(&self.matrix, n, shape);
        let delta = shape.iter().sum::<f64>() / punch.iter().sum::<f64>();
        Some((delta, PI * (delta * punch[0] - shape[0]), PI * punch[0]))
    }

    /// Normal stress at the base (MPa, negative) at `u_mm` across from the axis.
    #[must_use]
    pub fn base_szz_mpa(&self, u_mm: f64) -> f64 {
        if self.state.force_n_mm == 0.0 {
            return 0.0;
        }
        let t = self.layer.thickness_mm;
        let u = u_mm / t;
        let at = |x: f64| self.density.at(x.abs());
        let pair = |x: f64| at(u - x) + self.mirror * at(u + x);
        -self.lines.iter().map(|[x, load]| load * pair(*x)).sum::<f64>() / t
    }

    /// Writes the image, row by row (row = y, column = x, both ascending), stresses in MPa.
    ///
    /// # Errors
    /// An array that [`Array::check`] refuses or an image of another length, a stand that is not
    /// finite.
    pub fn image(
        &self,
        array: &Array,
        sampling: Sampling,
        planar: PlanarPose,
        image: &mut [f64],
    ) -> Result<(), Invalid> {
        array.fits(image)?;
        finite("x_mm", planar.x_mm)?;
        finite("y_mm", planar.y_mm)?;
        finite("rot_rad", planar.rot_rad)?;
        image.fill(0.0);
        if self.state.force_n_mm == 0.0 {
            return Ok(());
        }
        let t = self.layer.thickness_mm;
        let (s, c) = (libm::sin(planar.rot_rad), libm::cos(planar.rot_rad));
        let half = 0.5 * array.pitch_mm / t;
        let (p, q) = (half * c.abs(), half * s.abs());
        let (wide, narrow) = (p.max(q), p.min(q));
        let reach = FIELD_REACH + self.state.half_width_mm / t;
        for (n, value) in image.iter_mut().enumerate() {
            let x = array.x_mm(n % array.cols) - planar.x_mm;
            let y = array.y_mm(n / array.cols) - planar.y_mm;
            let u = (x * c + y * s) / t;
            *value = if u.abs() > reach + 2.0 * half {
                0.0
            } else if sampling == Sampling::Centre {
                self.base_szz_mpa(u * t)
            } else {
                -self.across.mean(u, wide, narrow) / t
            };
        }
        Ok(())
    }
}

/// Pairs of lines for a half-width of `b` thicknesses: the base function dies as exp(-k) at a wave
/// number k, so Gauss and Chebyshev's rule with 2 n lines leaves J_4n(k b), under 1e-8 in all.
fn pairs(b: f64) -> usize {
    6 + libm::ceil(4.5 * b) as usize
}

/// Pairs of lines that stand for psi = sum a_k cos((2 k + `odd`) theta) on a half-width.
fn lay(lines: &mut [[f64; 2]], a: &[f64], [half, scale]: [f64; 2], odd: f64) {
    let count = lines.len();
    for (i, line) in lines.iter_mut().enumerate() {
        let angle = PI * (2 * i + 1) as f64 / (4 * count) as f64;
        let term = |(k, a): (usize, &f64)| a * libm::cos((2.0 * k as f64 + odd) * angle);
        let value: f64 = a.iter().enumerate().map(term).sum();
        *line = [half * libm::cos(angle), 0.5 * PI / count as f64 * scale * value];
    }
}

/// The base pressure of a unit line load, in thicknesses.
fn density(transfer: &Transfer) -> Even {
    let count = (FIELD_REACH * POINTS_PER_THICKNESS) as usize + 8;
    let samples = TransferSamples::new(|a| transfer.base_normal(a), FIELD_REACH, BASE_CUTOFF);
    let values: Vec<f64> =
        (0..count).map(|i| samples.cosine(i as f64 / POINTS_PER_THICKNESS)).collect();
    Even::new(&values, POINTS_PER_THICKNESS)
}
