//! A rigid cylinder on the bonded layer, per unit length of the contact line.
//!
//! The normal problem is frictionless: the pressure vanishes at both edges of the contact and the
//! surface inside has the shape of the exact circle. It is solved for a grid of penetrations when a
//! [`LineContact`] is made; reading it afterwards neither allocates nor panics and costs tens of
//! nanoseconds. Between the grid's points the load is the cubic with the exact loads and the exact
//! stiffnesses (that of the flat punch of the same width), so load and stiffness belong to one
//! potential energy. Beyond the largest penetration the load goes on linearly with the last
//! stiffness, while width, base share and tangential stiffness stay as they were there.
//!
//! Measured against exact solutions (t = 0.8 to 12.8, nu = 0.3 to 0.5, R = 23 to 25.4): load, width
//! and penetration 2e-6, stiffness 2e-5 and tangential stiffness 1e-4 relative, base stress 2e-4 of
//! its peak, base share 5e-5. Below 2e-5 of the largest penetration they are coarser.
//!
//! Refused are penetrations of the layer's thickness or more, contacts wider than 0.95 of the
//! cylinder's diameter, and contacts more than 80 times as wide as the layer is thick.

use super::collocation::{Collocation, points_for};
use super::kernel::{BaseKernel, SurfaceKernel};
use super::layer::Layer;
use super::numeric::cubic_hermite::{catmull_rom, hermite, hermite_slope, monotone_cubic};
pub use super::share::BaseShares;
use super::share::{ShareTable, StripPressure};
use super::sticking_strip::StickingStrip;
use super::{Invalid, positive};
use core::f64::consts::PI;

/// Grid cells over penetration; point i stands at ((i + GRID_SHIFT)^4 - GRID_SHIFT^4) of a scale.
const PENETRATION_CELLS: usize = 96;
/// Shift of the grid that keeps each of the first cells from being many times wider than the one
/// before.
const GRID_SHIFT: f64 = 3.0;
/// The tangential stiffness is solved at each multiple of this number of grid points; it divides
/// the number of cells.
const TANGENTIAL_STRIDE: usize = 4;
/// Largest half-width of a contact in thicknesses.
const HALF_WIDTH_MAX_THICKNESSES: f64 = 40.0;
/// Largest half-width of a contact in radii.
const HALF_WIDTH_MAX_RADII: f64 = 0.95;
/// Most contacts that the search for one half-width solves.
const WIDTH_ITERATIONS_MAX: usize = 30;

/// A frictionless rigid cylinder pressed into a [`Layer`], solved once and tabulated.
#[derive(Clone, Debug)]
pub struct LineContact {
    penetration_max_mm: f64,
    delta_mm: Vec<f64>,
    /// Load and stiffness at the grid's points.
    load: Vec<[f64; 2]>,
    load_index: LoadIndex,
    /// Half-width over the root of the penetration's part of the largest.
    width_mm: Vec<f64>,
    tangential: Vec<f64>,
    share: ShareTable,
}

impl LineContact {
    /// Solves the contact for penetrations up to `penetration_max_mm`; allocates.
    ///
    /// # Errors
    /// A layer that [`Layer::check`] refuses; a radius or penetration that is not finite and above
    /// zero; geometry outside the bounds of this module.
    pub fn new(layer: &Layer, radius_mm: f64, penetration_max_mm: f64) -> Result<Self, Invalid> {
        Self::solve_all(layer, radius_mm, penetration_max_mm, true)
    }

    /// The same at a third of the cost, without what the base carries: the base shares are those of
    /// a load that stays right under its line.
    ///
    /// # Errors
    /// As [`LineContact::new`].
    pub fn without_base(
        layer: &Layer,
        radius_mm: f64,
        penetration_max_mm: f64,
    ) -> Result<Self, Invalid> {
        Self::solve_all(layer, radius_mm, penetration_max_mm, false)
    }

    fn solve_all(
        layer: &Layer,
        radius_mm: f64,
        penetration_max_mm: f64,
        based: bool,
    ) -> Result<Self, Invalid> {
        layer.check()?;
        positive("radius_mm", radius_mm)?;
        positive("penetration_max_mm", penetration_max_mm)?;
        if penetration_max_mm >= layer.thickness_mm {
            let what = format!("{penetration_max_mm} mm is the layer's thickness or more");
            return Err(Invalid::new("penetration_max_mm", what, "give less than the thickness"));
        }
        let problem = Problem::new(layer, radius_mm);
        let mut solved = Vec::with_capacity(PENETRATION_CELLS);
        let mut guess = (1.5 * radius_mm * penetration_max_mm).sqrt() / layer.thickness_mm;
        for i in (1..=PENETRATION_CELLS).rev() {
            let solution =
                problem.solve_for_penetration(guess, grid_fraction(i) * penetration_max_mm)?;
            let step = grid_fraction(i - 1) / grid_fraction(i);
            guess = solution.half_width * step.sqrt();
            solved.push(solution);
        }
        solved.reverse();
        let share = if based { share_table(layer, &solved) } else { ShareTable::step() };
        Ok(Self::tabulate(layer, &problem, &solved, (penetration_max_mm, share)))
    }

    fn tabulate(
        layer: &Layer,
        problem: &Problem,
        solved: &[Solution],
        (max_mm, share): (f64, ShareTable),
    ) -> Self {
        let t = layer.thickness_mm;
        let stick = StickingStrip::new(&layer.transfer(), &problem.normal);
        let mut contact = Self {
            penetration_max_mm: max_mm,
            delta_mm: (0..=PENETRATION_CELLS).map(|i| grid_fraction(i) * max_mm).collect(),
            load: vec![[0.0, 0.0]],
            load_index: LoadIndex::default(),
            width_mm: vec![0.0],
            tangential: vec![0.0],
            share,
        };
        for (i, solution) in solved.iter().enumerate() {
            contact.load.push([solution.load_n_mm, solution.stiffness_n_mm2]);
            contact.width_mm.push(solution.half_width * t / grid_fraction(i + 1).sqrt());
            if (i + 1) % TANGENTIAL_STRIDE == 0 {
                let stiffness = stick.stiffness(solution.half_width);
                contact.tangential.push(stiffness * problem.modulus_mpa);
            }
        }
        contact.width_mm[0] = contact.width_mm[1];
        // In the first cell, 2e-6 of the whole, the exact stiffness falls to 0 like 1/ln: take it
        // as linear with the exact mean, so that it stays monotone.
        let [load, stiffness] = contact.load[1];
        contact.load[0][1] = (2.0 * load / contact.delta_mm[1] - stiffness).max(0.0);
        contact.load_index = LoadIndex::new(&contact.load);
        contact
    }

    /// Place of a penetration on the grid, 0 to `PENETRATION_CELLS`; 0 for NaN.
    fn index(&self, delta_mm: f64) -> f64 {
        let part = self.penetration_fraction(delta_mm);
        (part * grid_scale() + fourth_power(GRID_SHIFT)).sqrt().sqrt() - GRID_SHIFT
    }

    /// Part of the largest penetration, 0 to 1; 0 for NaN.
    fn penetration_fraction(&self, delta_mm: f64) -> f64 {
        if delta_mm > 0.0 { (delta_mm / self.penetration_max_mm).min(1.0) } else { 0.0 }
    }

    /// The grid cell of a penetration, the load and slope per cell at its ends, the place in it and
    /// its width.
    fn cell(&self, delta_mm: f64) -> ([f64; 2], [f64; 2], f64, f64) {
        let i = (self.index(delta_mm) as usize).min(PENETRATION_CELLS - 1);
        let width = self.delta_mm[i + 1] - self.delta_mm[i];
        let end = |k: usize| [self.load[k][0], self.load[k][1] * width];
        (end(i), end(i + 1), (delta_mm - self.delta_mm[i]) / width, width)
    }

    /// Largest penetration of the solution; beyond it the load is linear.
    #[must_use]
    pub fn penetration_max_mm(&self) -> f64 {
        self.penetration_max_mm
    }

    /// Line load in N/mm at a penetration of the cylinder's lowest point; 0 at and below 0, and for
    /// NaN.
    #[must_use]
    pub fn load_n_mm(&self, delta_mm: f64) -> f64 {
        if delta_mm > self.penetration_max_mm {
            let [load, stiffness] = self.load[PENETRATION_CELLS];
            return load + stiffness * (delta_mm - self.penetration_max_mm);
        }
        if delta_mm > 0.0 {
            let (left, right, s, _) = self.cell(delta_mm);
            hermite(left, right, s)
        } else {
            0.0
        }
    }

    /// Derivative of [`Self::load_n_mm`], N/mm per mm; 0 at and below 0, and for NaN.
    #[must_use]
    pub fn stiffness_n_mm2(&self, delta_mm: f64) -> f64 {
        if delta_mm > self.penetration_max_mm {
            return self.load[PENETRATION_CELLS][1];
        }
        if delta_mm > 0.0 {
            let (left, right, s, width) = self.cell(delta_mm);
            hermite_slope(left, right, s) / width
        } else {
            0.0
        }
    }

    /// Half the width of the contact in mm; 0 at and below 0, and for NaN.
    #[must_use]
    pub fn half_width_mm(&self, delta_mm: f64) -> f64 {
        self.penetration_fraction(delta_mm).sqrt()
            * catmull_rom(&self.width_mm, self.index(delta_mm))
    }

    /// Penetration in mm under a line load: the inverse of [`Self::load_n_mm`]; 0 at and below 0,
    /// and for NaN.
    #[must_use]
    pub fn penetration_mm(&self, load_n_mm: f64) -> f64 {
        let [last, stiffness] = self.load[PENETRATION_CELLS];
        if load_n_mm >= last {
            return self.penetration_max_mm + (load_n_mm - last) / stiffness;
        }
        if load_n_mm > 0.0 { self.invert(load_n_mm) } else { 0.0 }
    }

    /// Newton's method on one cell's cubic, kept in a bracket; the load rises strictly. It starts
    /// from the cubic of the inverse function through the same ends. Convergence is quadratic, so
    /// that a step below the root of the rounding error is the last one.
    fn invert(&self, load_n_mm: f64) -> f64 {
        let above = self.load_index.first_above(&self.load, load_n_mm);
        let (start, width) =
            (self.delta_mm[above - 1], self.delta_mm[above] - self.delta_mm[above - 1]);
        let end = |k: usize| [self.load[k][0], self.load[k][1] * width];
        let (left, right) = (end(above - 1), end(above));
        let rise = right[0] - left[0];
        let (mut low, mut high) = (0.0, 1.0);
        let mut s = (load_n_mm - left[0]) / rise;
        if left[1] > 0.5 * rise {
            s = hermite([0.0, rise / left[1]], [1.0, rise / right[1]], s);
        }
        for _ in 0..60 {
            let excess = hermite(left, right, s) - load_n_mm;
            if excess > 0.0 {
                high = s
            } else {
                low = s
            }
            let newton = s - excess / hermite_slope(left, right, s);
            let next = if newton >= low && newton <= high { newton } else { 0.5 * (low + high) };
            let step = (next - s).abs();
            s = next;
            if step <= 1e-9 * s {
                break;
            }
        }
        start + s * width
    }

    /// Part of the line load that the base carries left of `u_mm` from the contact line: 0 far to
    /// the left, 1 far to the right, both exactly beyond 20 thicknesses from the contact. It falls
    /// slightly where the base is in tension. At and below zero penetration, and for a NaN one, it
    /// is the share of a line load; NaN for a NaN place.
    #[must_use]
    pub fn base_share(&self, delta_mm: f64, u_mm: f64) -> f64 {
        self.base_shares(delta_mm).left_of(u_mm)
    }

    /// [`Self::base_share`] at one penetration for many places: faster than one by one.
    #[must_use]
    pub fn base_shares(&self, delta_mm: f64) -> BaseShares<'_> {
        self.share.row(self.index(delta_mm))
    }

    /// Tangential stiffness dQ/dx in N/mm per mm of a contact that sticks over its whole width; 0
    /// at and below 0, and for NaN. Both tractions act, with the surface inside the contact moved
    /// along x alone; the width is that of the frictionless contact.
    #[must_use]
    pub fn tangential_stiffness_n_mm2(&self, delta_mm: f64) -> f64 {
        monotone_cubic(&self.tangential, self.index(delta_mm) / TANGENTIAL_STRIDE as f64)
    }
}

/// Finds the cell of a load in the table without a search: the load's binary exponent and the first
/// four bits of its mantissa number the sixteenths of an octave, and each knows its first cell.
#[derive(Clone, Debug, Default)]
struct LoadIndex {
    /// Sixteenth of an octave of the first place, the one below the first load above 0.
    first: u64,
    /// First point of the table above each place's least load.
    above: Vec<u8>,
}

impl LoadIndex {
    /// The index of loads that increase strictly from 0.
    fn new(load: &[[f64; 2]]) -> Self {
        let first = octave_sixteenth(load[1][0]) - 1;
        let least = |place: u64| f64::from_bits(place << OCTAVE_SIXTEENTH_BITS);
        let above = |place| load.partition_point(|[load, _]| *load <= least(place)) as u8;
        Self {
            first,
            above: (first..=octave_sixteenth(load[PENETRATION_CELLS][0])).map(above).collect(),
        }
    }

    /// The first point above a load, which must not be NaN, 1 at least and the last one at most.
    fn first_above(&self, load: &[[f64; 2]], load_n_mm: f64) -> usize {
        let place = octave_sixteenth(load_n_mm).saturating_sub(self.first) as usize;
        let mut above =
            self.above.get(place).map_or(PENETRATION_CELLS, |above| usize::from(*above)).max(1);
        while above < PENETRATION_CELLS && load[above][0] <= load_n_mm {
            above += 1;
        }
        above
    }
}

/// Bits of a number's mantissa below its first four, which tell the sixteenth of its octave.
const OCTAVE_SIXTEENTH_BITS: u32 = 48;

/// Number of the sixteenth of an octave in which a number above 0 lies.
fn octave_sixteenth(x: f64) -> u64 {
    x.to_bits() >> OCTAVE_SIXTEENTH_BITS
}

fn fourth_power(x: f64) -> f64 {
    x * x * (x * x)
}

fn grid_scale() -> f64 {
    fourth_power(PENETRATION_CELLS as f64 + GRID_SHIFT) - fourth_power(GRID_SHIFT)
}

/// Part of the largest penetration at grid point i.
fn grid_fraction(i: usize) -> f64 {
    (fourth_power(i as f64 + GRID_SHIFT) - fourth_power(GRID_SHIFT)) / grid_scale()
}

/// Shares of the load that the base carries under each of the solutions, and under a line load.
fn share_table(layer: &Layer, solved: &[Solution]) -> ShareTable {
    let (t, base) = (layer.thickness_mm, BaseKernel::new(&layer.transfer()));
    let mut table = ShareTable::new();
    table.push(&base, &StripPressure { half_width: 0.0, places: &[0.0], weights: &[1.0] }, t);
    for Solution { half_width, places, weights, .. } in solved {
        table.push(&base, &StripPressure { half_width: *half_width, places, weights }, t);
    }
    table
}

/// One solved contact; half-width and places in thicknesses.
struct Solution {
    half_width: f64,
    delta_mm: f64,
    load_n_mm: f64,
    stiffness_n_mm2: f64,
    places: Vec<f64>,
    weights: Vec<f64>,
}

/// Layer and cylinder, lengths in thicknesses.
struct Problem {
    thickness_mm: f64,
    radius: f64,
    /// pi G/(1 - nu) in MPa: traction per unit of the kernels.
    modulus_mpa: f64,
    normal: SurfaceKernel,
}

impl Problem {
    fn new(layer: &Layer, radius_mm: f64) -> Self {
        let transfer = layer.transfer();
        Self {
            thickness_mm: layer.thickness_mm,
            radius: radius_mm / layer.thickness_mm,
            modulus_mpa: PI * layer.shear_mpa() / (1.0 - layer.poisson),
            normal: SurfaceKernel::new(|a| transfer.normal_compliance(a)),
        }
    }

    /// Contact of half-width `b`.
    fn solve(&self, b: f64) -> Solution {
        let points = Collocation::new(points_for(b));
        let places: Vec<f64> = points.cosines.iter().map(|c| b * c).collect();
        let r = self.radius;
        let height = |x: &f64| x * x / (r + (r * r - x * x).sqrt());
        let mut sides = [vec![1.0; places.len()], places.iter().map(height).collect()];
        points.even_matrix(&self.normal, b).solve(&mut sides);
        let [punch, shape] = &sides;
        let delta = points.edge(shape) / points.edge(punch);
        let phi: Vec<f64> = punch.iter().zip(shape).map(|(p, s)| delta * p - s).collect();
        let sum: f64 = phi.iter().sum();
        Solution {
            half_width: b,
            delta_mm: delta * self.thickness_mm,
            load_n_mm: points.total(&phi) * self.modulus_mpa * self.thickness_mm,
            stiffness_n_mm2: points.total(punch) * self.modulus_mpa,
            places,
            weights: phi.iter().map(|p| p / sum).collect(),
        }
    }

    /// Contact of penetration `delta_mm`, from a guess of its half-width.
    fn solve_for_penetration(&self, guess: f64, delta_mm: f64) -> Result<Solution, Invalid> {
        let widest = HALF_WIDTH_MAX_THICKNESSES.min(HALF_WIDTH_MAX_RADII * self.radius);
        let mut b = guess.min(widest);
        let mut slope = 2.0;
        let mut before: Option<(f64, f64)> = None;
        for _ in 0..WIDTH_ITERATIONS_MAX {
            let mut solution = self.solve(b);
            let miss = libm::log(solution.delta_mm / delta_mm);
            if let Some((b_before, miss_before)) = before {
                let run = libm::log(b / b_before);
                if run != 0.0 {
                    slope = ((miss - miss_before) / run).clamp(0.7, 6.0);
                }
            }
            if miss.abs() < 1e-6 {
                // After this correction the error is of second order in the miss.
                let rest = delta_mm - solution.delta_mm;
                solution.load_n_mm += solution.stiffness_n_mm2 * rest;
                solution.half_width *= libm::exp(-miss / slope);
                solution.delta_mm = delta_mm;
                return Ok(solution);
            }
            if miss < 0.0 && b >= widest {
                break;
            }
            before = Some((b, miss));
            b = (b * libm::exp(-miss / slope)).min(widest);
        }
        let what = format!("{delta_mm} mm needs a contact too wide for the layer or the cylinder");
        Err(Invalid::new("penetration_max_mm", what, "give a smaller penetration"))
    }
}
