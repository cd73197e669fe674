//! Presses a rigid cylinder or flat bar of infinite length on the bonded layer, in any direction
//! over the array: the plane contact and its base stress, integrated over each tactel in closed
//! form.
//!
//! Projected along the axis, the square of a tactel is the convolution of two boxes. Its mean is
//! therefore a second difference of the second integral of the pressure, in any direction
//! (`across.rs`).
//!
//! Measured against exact solutions the error is 1e-6 of the peak or better; for means over tactels
//! smaller than a quarter of the thickness it is 5e-6. Forces are N per mm of length. Penetrations
//! of the thickness or more, contacts wider than 0.95 of the diameter or 80 thicknesses, and forces
//! beyond the largest tabulated penetration are errors.

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
/// Half-width of the narrowest contact that is read from the tables, as a part of the widest one.
/// Narrower contacts follow the half plane's law, which is then more exact than the tables.
const TABLE_WIDTH_RATIO_MIN: f64 = 0.01;
/// Upper bound of that half-width, thicknesses.
const TABLE_WIDTH_MIN: f64 = 0.02;
/// Most plane problems that one search solves.
const SOLUTIONS_MAX: usize = 40;
/// A penetration of more than this times the load of the narrowest tabulated contact (both without
/// unit) certainly belongs to a wider contact.
const DEPTH_PER_LOAD_MAX: f64 = 50.0;

/// Load, penetration and width of a contact, and how well they were solved.
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
    /// Place (thicknesses) and load (N/mm) of the pairs of line loads that represent the pressure.
    lines: Vec<[f64; 2]>,
    /// Load of a pair's second line over that of its first: 1, or -1 for a roll.
    mirror: f64,
    state: LineState,
}

/// The solution of a plane contact, in thicknesses. A contact too narrow for the tables is the
/// smallest tabulated one with its pressure scaled down.
struct PlaneContact {
    /// Half-width of the tabulated pressure.
    table_half_width: f64,
    /// Penetration of the tabulated pressure.
    table_penetration: f64,
    /// Factor on the tabulated pressure.
    pressure_scale: f64,
    half_width: f64,
    penetration: f64,
}

impl PlaneContact {
    /// A contact whose pressure is the tabulated one.
    fn from_table(half_width: f64, penetration: f64) -> Self {
        Self {
            table_half_width: half_width,
            table_penetration: penetration,
            pressure_scale: 1.0,
            half_width,
            penetration,
        }
    }
}

impl InfiniteIndenter {
    /// Tabulates contacts up to a penetration; allocates.
    ///
    /// # Errors
    /// A layer that [`Layer::check`] refuses, a size or penetration that is not finite and above
    /// zero, and a penetration of the thickness or more or whose contact is too wide.
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
        let lines = line_pair_count(strips.widest());
        Ok(Self {
            layer: *layer,
            section,
            density: line_base_pressure(&transfer),
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
    /// A target that is not finite, a load below 0, and a contact beyond the tables. The state is
    /// then that of no contact.
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
        let contact = self.search(by_force, wanted, prescribed)?;
        let (b, delta) = (contact.table_half_width, contact.table_penetration);
        let part = contact.pressure_scale;
        let [punch, shape] = &mut self.sides;
        let mut edges = [0.0; 2];
        for (p, s) in punch.iter_mut().zip(shape) {
            *s = part * (delta * *p - *s);
            edges[0] += part * *p;
            edges[1] += *s;
        }
        let psi = &self.sides[1];
        let first = psi[0];
        let count = line_pair_count(b).min(self.lines.capacity());
        self.lines.resize(count, [0.0; 2]);
        write_line_loads(&mut self.lines, psi, b, modulus * t, 0.0);
        self.across.set_lines(&self.lines, self.mirror);
        self.state = LineState {
            force_n_mm: PI * first * modulus * t,
            penetration_mm: contact.penetration * t,
            half_width_mm: contact.half_width * t,
            residual: if self.strips.is_free() {
                (edges[1] / (delta * edges[0])).abs()
            } else {
                0.0
            },
        };
        Ok(self.state)
    }

    /// The derivative of the last contact by the roll, per rad, where a positive roll lowers the
    /// side towards +u. Its image is the derivative of the image. None for a cylinder and without
    /// contact.
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
        // Only the first moment, b pi/2, of the displacement b cos(theta) of a unit slope is not 0.
        let a = rate.row[layout.punch(0)..layout.penetration()].iter().map(|a| 0.5 * half * a);
        let a: Vec<f64> = a.collect();
        let modulus = PI * self.layer.shear_mpa() / (1.0 - self.layer.poisson);
        write_line_loads(&mut rate.lines, &a, half, modulus * self.layer.thickness_mm, 1.0);
        rate.across.set_lines(&rate.lines, rate.mirror);
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

    /// The contact of a cylinder, if it is narrower than the tables. On a half plane the load is
    /// b^2/(2 R) and the penetration load (1/k + 1/2), where k is the stiffness of a punch of the
    /// same width; 1/k is linear in the logarithm of the width.
    fn narrow_contact(&mut self, by_force: bool, wanted: f64) -> Option<PlaneContact> {
        let Section::Circle(radius) = self.section else { return None };
        let b = TABLE_WIDTH_MIN.min(TABLE_WIDTH_RATIO_MIN * self.strips.widest());
        let largest = 0.5 * b * b / radius;
        // The ratio of penetration to load grows only as a logarithm, so this bound is safe and
        // saves the solution below for deep contacts.
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
        Some(PlaneContact {
            table_half_width: b,
            table_penetration: delta,
            pressure_scale: force / load,
            half_width: (2.0 * radius * force).sqrt(),
            penetration: depth(force),
        })
    }

    /// Finds the contact of a load or penetration by a secant method on the logarithm of the
    /// half-width. The solutions of its punch and shape are left in `sides`.
    fn search(
        &mut self,
        by_force: bool,
        wanted: f64,
        prescribed: Prescribed,
    ) -> Result<PlaneContact, Refusal> {
        let widest = self.strips.widest();
        // The width of a bar is given, so the contact is linear.
        if !self.strips.is_free() {
            let stiffness = self.plane(widest).map_or(f64::NAN, |(_, _, stiffness)| stiffness);
            let delta = if by_force { wanted / stiffness } else { wanted };
            if delta < 1.0 {
                return Ok(PlaneContact::from_table(widest, delta));
            }
            let deep_mm = delta * self.layer.thickness_mm;
            return Err(Refusal::new(prescribed.place(), Why::Thickness(deep_mm)));
        }
        if let Some(contact) = self.narrow_contact(by_force, wanted) {
            return Ok(contact);
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
                // One linear step removes what is left of the error.
                return Ok(PlaneContact::from_table(b, delta + change));
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
    /// An array that [`Array::check`] refuses, an image of another length, or a pose that is not
    /// finite.
    pub fn image(
        &self,
        array: &Array,
        sampling: Sampling,
        planar: PlanarPose,
        image: &mut [f64],
    ) -> Result<(), Invalid> {
        array.check_image(image)?;
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

/// Pairs of line loads for a half-width of `b` thicknesses. The base function decays as exp(-k)
/// with the wave number k, and the Gauss-Chebyshev rule with 2 n lines has the error J_4n(k b):
/// less than 1e-8 in all.
fn line_pair_count(b: f64) -> usize {
    6 + libm::ceil(4.5 * b) as usize
}

/// Writes the pairs of line loads that represent `scale` times psi = sum a_k cos((2 k + `odd`)
/// theta) on a strip of half-width `half`.
fn write_line_loads(lines: &mut [[f64; 2]], a: &[f64], half: f64, scale: f64, odd: f64) {
    let count = lines.len();
    for (i, line) in lines.iter_mut().enumerate() {
        let angle = PI * (2 * i + 1) as f64 / (4 * count) as f64;
        let term = |(k, a): (usize, &f64)| a * libm::cos((2.0 * k as f64 + odd) * angle);
        let value: f64 = a.iter().enumerate().map(term).sum();
        *line = [half * libm::cos(angle), 0.5 * PI / count as f64 * scale * value];
    }
}

/// The base pressure of a unit line load over the distance, in thicknesses.
fn line_base_pressure(transfer: &Transfer) -> Even {
    let count = (FIELD_REACH * POINTS_PER_THICKNESS) as usize + 8;
    let samples = TransferSamples::new(|a| transfer.base_normal(a), FIELD_REACH, BASE_CUTOFF);
    let values: Vec<f64> =
        (0..count).map(|i| samples.cosine(i as f64 / POINTS_PER_THICKNESS)).collect();
    Even::new(&values, POINTS_PER_THICKNESS)
}
