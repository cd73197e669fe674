//! A rigid sphere on the bonded layer: the exact circle, frictionless.
//!
//! The pressure is the Abel transform of a function phi that solves a Fredholm equation of the
//! second kind on (0, a) (Lebedev and Ufliand, 1958): (pi/2) phi(x) less the integral of
//! (K(x - s) + K(x + s)) phi(s)/2 is G/(1 - nu) (delta - x atanh(x/R)), K the cosine transform of
//! 1 - M; phi vanishes at the edge of the contact. Gauss's rule converges exponentially. The base
//! pressure is the inverse Abel transform of a plane problem's. A tactel's mean is the flux of the
//! radial field whose divergence is that pressure. Therefore the image of a sphere well inside the
//! array sums to the force, except for the flux beyond the table: 9e-4 of the force at
//! [`Accuracy::Fast`], 9e-6 at [`Accuracy::Default`].
//!
//! Measured against exact solutions: force and penetration 1e-6, image 5e-6 of the peak at
//! [`Accuracy::Default`], 1e-8 at [`Accuracy::Fine`]. A solved contact is the guess of the next
//! one; solving allocates nothing. [`Accuracy::Fast`] solves a chart of contacts when the sphere is
//! made (`chart.rs`) and reads it afterwards: force, penetration and radius to 1e-5, images, by
//! cubics over the distance from the axis, to 6e-4 of the peak.
//!
//! Penetrations of the thickness or more, contacts wider than 0.95 of the diameter or with a radius
//! above 120 thicknesses, and forces that would need such contacts are errors.

mod base;
mod chart;
mod image;
mod kernel;

use super::super::layer::Layer;
use super::super::{Invalid, MAGNITUDE_MAX, positive};
use super::ground::Ground;
use super::radial::Radial;
use super::table::{Even, Pieces};
use super::{Accuracy, Prescribed, Refusal, Why};
use crate::numeric::cholesky::{factor, solve};
use crate::numeric::quadrature::legendre;
use base::Line;
use chart::Chart;
use core::f64::consts::PI;
use kernel::Kernel;

/// Largest contact radius in radii of the sphere.
const RADIUS_RATIO_MAX: f64 = 0.95;
/// Largest contact radius in thicknesses.
const RADIUS_MAX: f64 = 120.0;
/// Forces (N) and penetrations (mm) below this are no contact.
const CONTACT_MIN: f64 = 1.0 / MAGNITUDE_MAX;
/// Solutions that one search may take.
const SOLUTIONS_MAX: usize = 60;
/// Largest contact radius, in thicknesses, that a search from no contact begins with: a wide
/// contact on a layer carries its force on far less than on a half space.
const START_RADIUS_MAX: f64 = 16.0;
/// The search ends at this relative error, which is then corrected to second order.
const MISS_TOLERANCE: f64 = 1e-7;
/// Points of a contact's quadrature rule: a least number, and additional ones for each thickness of
/// its radius. A search from no contact uses a rougher rule until its error is below
/// [`ROUGH_MISS`].
const RULE_POINTS: [f64; 2] = [12.0, 3.0];
const ROUGH_RULE_POINTS: [f64; 2] = [12.0, 2.0];
const ROUGH_MISS: f64 = 1e-3;
/// Most steps with the rougher rule: where the number of points changes with the radius they could
/// cycle.
const ROUGH_STEPS: usize = 8;
/// Points of the Gauss rules that are kept.
const RULE_SIZES: [usize; 16] =
    [16, 20, 24, 32, 40, 48, 56, 64, 80, 96, 128, 160, 192, 256, 320, 384];

/// State of a pressed sphere.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SphereState {
    /// Normal force, N.
    pub force_n: f64,
    /// Penetration of the lowest point, mm.
    pub penetration_mm: f64,
    /// Radius of the contact, mm.
    pub contact_radius_mm: f64,
    /// Strength of the pressure's singularity that is left at the contact's edge, in parts of that
    /// of a flat punch with this force. For a contact that is read from the chart it is the largest
    /// error of the force half way between tabulated contacts.
    pub residual: f64,
}

/// Accuracy against time.
#[derive(Clone, Copy, Debug)]
struct Grid {
    per_thickness: f64,
    /// Length of the grid beyond the contact's edge, in thicknesses.
    reach: f64,
    sight_step: f64,
    panel: f64,
    points: usize,
}

impl Grid {
    fn of(level: Accuracy) -> Self {
        match level {
            Accuracy::Fast => {
                Self { per_thickness: 8.0, reach: 9.0, sight_step: 0.33, panel: 2.0, points: 4 }
            }
            Accuracy::Default => {
                Self { per_thickness: 16.0, reach: 16.0, sight_step: 0.33, panel: 1.5, points: 6 }
            }
            Accuracy::Fine => {
                Self { per_thickness: 32.0, reach: 32.0, sight_step: 0.25, panel: 1.0, points: 8 }
            }
        }
    }

    /// Number of places from the axis to where the base pressure of a contact of radius `a` has
    /// decayed.
    fn count(&self, a: f64) -> usize {
        ((a + self.reach) * self.per_thickness) as usize + 8
    }
}

/// The solver of one sphere on one layer, with its memory.
#[derive(Clone, Debug)]
pub struct Sphere {
    layer: Layer,
    radius_mm: f64,
    grid: Grid,
    line: Line,
    kernel: Kernel,
    rules: Vec<Vec<(f64, f64)>>,
    edge: Vec<(f64, f64)>,
    matrix: Vec<f64>,
    /// phi of the flat punch and of the sphere's shape, at the points.
    sides: [Vec<f64>; 2],
    /// Place and weight of each point, its weight times phi.
    points: Vec<[f64; 3]>,
    used: usize,
    /// Projected slope, base pressure and flux of the contact last solved.
    tables: [Even; 3],
    /// Sums of the loads' slopes on the tables' grid.
    sums: Vec<f64>,
    /// Base pressure and flux as piecewise cubics, at the fast level.
    pieces: Option<Box<[Pieces; 2]>>,
    /// Contact radius in thicknesses.
    a: f64,
    state: SphereState,
    /// The chart of the fast level; contacts beyond it are solved.
    chart: Option<Box<Chart>>,
}

/// One solution for a contact radius, in thicknesses and G/(1 - nu).
struct Solution {
    delta: f64,
    force: f64,
    stiffness: f64,
    punch_edge: f64,
    rule: usize,
}

impl Sphere {
    /// Tabulates the kernels and takes all memory.
    ///
    /// # Errors
    /// A layer that [`Layer::check`] refuses; a radius that is not finite and above zero.
    pub fn new(layer: &Layer, radius_mm: f64, level: Accuracy) -> Result<Self, Invalid> {
        layer.check()?;
        positive("radius_mm", radius_mm)?;
        let transfer = layer.transfer();
        let (grid, widest) =
            (Grid::of(level), RADIUS_MAX.min(RADIUS_RATIO_MAX * radius_mm / layer.thickness_mm));
        let most = rule_for(widest, RULE_POINTS);
        let n = RULE_SIZES[most];
        let room = ((widest + grid.reach) * grid.per_thickness) as usize + 16;
        let mut sphere = Self {
            layer: *layer,
            radius_mm,
            grid,
            line: Line::new(&Radial::new(&Ground::layer(layer)?), grid.per_thickness),
            kernel: Kernel::new(&transfer),
            rules: RULE_SIZES[..=most].iter().map(|n| legendre(*n)).collect(),
            edge: legendre(grid.points),
            matrix: vec![0.0; n * n],
            sides: [vec![0.0; n], vec![0.0; n]],
            points: vec![[0.0; 3]; n],
            used: 0,
            tables: [Even::with_room(room), Even::with_room(room), Even::with_room(room)],
            sums: vec![0.0; room],
            pieces: None,
            a: 0.0,
            state: SphereState::default(),
            chart: None,
        };
        if level == Accuracy::Fast {
            sphere.chart = Chart::new(&mut sphere).ok().map(Box::new);
            let pieces = || Pieces::with_room(room);
            sphere.pieces = Some(Box::new([pieces(), pieces()]));
        }
        Ok(sphere)
    }

    /// Presses the sphere to a force or a penetration; forces and penetrations below
    /// 1e-30 are no contact.
    ///
    /// # Errors
    /// A value that is not finite, a force below 0, and contacts beyond the bounds of this module.
    /// The state is then that of no contact.
    pub fn press(&mut self, prescribed: Prescribed) -> Result<SphereState, Refusal> {
        if !self.look_up(prescribed) {
            self.press_solved(prescribed)?;
        }
        Ok(self.state)
    }

    /// Reads a contact of the chart; whether there is one.
    fn look_up(&mut self, prescribed: Prescribed) -> bool {
        let Some(chart) = &self.chart else { return false };
        let t = self.layer.thickness_mm;
        let unit_n = self.modulus() * t * t;
        let read = match prescribed {
            Prescribed::ForceN(force) if force >= CONTACT_MIN => chart.under_force(force / unit_n),
            Prescribed::PenetrationMm(delta) if delta >= CONTACT_MIN => chart.at_depth(delta / t),
            _ => None,
        };
        let Some(read) = read else { return false };
        let density = self.grid.per_thickness;
        let count = self.grid.count(read.radius);
        let [_, pressure, flux] = &mut self.tables;
        pressure.refill(count, density, chart.field(&read, 0));
        flux.refill(count, density, chart.field(&read, 1));
        self.refill_pieces();
        (self.used, self.a) = (1, read.radius);
        self.state = SphereState {
            force_n: read.force * unit_n,
            penetration_mm: read.root * read.root * t,
            contact_radius_mm: read.radius * t,
            residual: read.residual,
        };
        true
    }

    /// Solves a contact; its stiffness in units of G/(1 - nu) and the thickness.
    fn press_solved(&mut self, prescribed: Prescribed) -> Result<f64, Refusal> {
        let guess = self.a;
        self.release();
        let target = prescribed.check(self.layer.thickness_mm)?;
        if target < CONTACT_MIN {
            return Ok(0.0);
        }
        let (t, modulus) = (self.layer.thickness_mm, self.modulus());
        let radius = self.radius_mm / t;
        let (by_force, wanted) = match prescribed {
            Prescribed::ForceN(force) => (true, force / (modulus * t * t)),
            Prescribed::PenetrationMm(delta) => (false, delta / t),
        };
        // Hertz: F = (8/3) a^3/R and delta = a^2/R, in these units.
        let hertz =
            if by_force { libm::cbrt(0.375 * wanted * radius) } else { (wanted * radius).sqrt() };
        let start = if guess > 0.0 { guess } else { hertz.min(START_RADIUS_MAX) };
        let widest = self.widest();
        let (a, solved, miss) = self.search(start.min(widest), guess == 0.0, by_force, wanted)?;
        // The remaining error is corrected by a flat punch, to second order.
        let change = if by_force {
            (wanted - solved.force) / solved.stiffness
        } else {
            wanted - solved.delta
        };
        let delta = solved.delta + change;
        let force = solved.force + change * solved.stiffness;
        if delta >= 1.0 {
            return Err(Refusal::new(prescribed.place(), Why::Thickness(delta * t)));
        }
        self.store_pressure(a, delta, &solved);
        self.a = a * (1.0 - miss / 3.0);
        self.state = SphereState {
            force_n: force * modulus * t * t,
            penetration_mm: delta * t,
            contact_radius_mm: self.a * t,
            residual: (change * solved.punch_edge * 2.0 * PI * a / force).abs(),
        };
        self.tabulate(a);
        self.refill_pieces();
        Ok(solved.stiffness)
    }

    /// Base pressure and flux in pieces, where the level reads those.
    fn refill_pieces(&mut self) {
        let [_, pressure, flux] = &self.tables;
        if let Some(pieces) = &mut self.pieces {
            pieces[0].refill(pressure);
            pieces[1].refill(flux);
        }
    }

    /// The contact with so little force that it is a point, as fields of a force of 2 pi units.
    fn set_point_contact(&mut self) {
        self.release();
        self.points[0] = [0.0, 0.0, self.modulus()];
        self.used = 1;
        self.tabulate(0.0);
    }

    /// Base pressure and flux at a point of their grid; beyond its end all of the force is inside.
    fn fields(&self, place: usize) -> [f64; 2] {
        let [_, pressure, flux] = &self.tables;
        if place <= flux.last() {
            return [pressure.sample(place), flux.sample(place)];
        }
        let r = place as f64 / self.grid.per_thickness;
        [0.0, self.total_inside() / (r * r)]
    }

    /// G/(1 - nu), MPa.
    fn modulus(&self) -> f64 {
        self.layer.shear_mpa() / (1.0 - self.layer.poisson)
    }

    /// Largest contact radius in thicknesses.
    fn widest(&self) -> f64 {
        RADIUS_MAX.min(RADIUS_RATIO_MAX * self.radius_mm / self.layer.thickness_mm)
    }

    /// Lifts the sphere off.
    pub fn release(&mut self) {
        self.used = 0;
        self.a = 0.0;
        self.state = SphereState::default();
    }

    /// The contact last solved.
    #[must_use]
    pub fn state(&self) -> SphereState {
        self.state
    }

    /// Secant steps on the logarithm of the contact radius.
    fn search(
        &mut self,
        start: f64,
        cold: bool,
        by_force: bool,
        wanted: f64,
    ) -> Result<(f64, Solution, f64), Refusal> {
        let widest = self.widest();
        let (mut a, mut slope) = (start, if by_force { 3.2 } else { 2.0 });
        let mut before: Option<(f64, f64)> = None;
        // The first steps from no contact are long, and few points are enough for their direction.
        let mut rough = cold;
        for step in 0..SOLUTIONS_MAX {
            let points = if rough { ROUGH_RULE_POINTS } else { RULE_POINTS };
            let Some(solved) = self.solve(a, rule_for(a, points)) else {
                if !rough {
                    break;
                }
                (rough, before) = (false, None);
                continue;
            };
            let reached = if by_force { solved.force } else { solved.delta };
            let miss = libm::log(reached / wanted);
            if let Some((a_before, miss_before)) = before {
                let run = libm::log(a / a_before);
                if run != 0.0 {
                    slope = ((miss - miss_before) / run).clamp(1.0, 8.0);
                }
            }
            if !rough && miss.abs() < MISS_TOLERANCE {
                return Ok((a, solved, miss));
            }
            let out_of_reach = miss < 0.0 && a >= widest;
            if out_of_reach && !rough {
                break;
            }
            before = Some((a, miss));
            let led = out_of_reach || miss.abs() < ROUGH_MISS || step == ROUGH_STEPS;
            if rough && led {
                (rough, before) = (false, None);
            }
            a = (a * libm::exp((-miss / slope).clamp(-1.5, 1.5))).min(widest);
        }
        let place = if by_force { "force_n" } else { "penetration_mm" };
        Err(Refusal::new(place, Why::Unreachable))
    }

    /// Contact of radius `a` thicknesses; `None` when the system cannot be solved.
    fn solve(&mut self, a: f64, rule: usize) -> Option<Solution> {
        let n = RULE_SIZES[rule];
        for (point, (x, w)) in self.points.iter_mut().zip(&self.rules[rule]) {
            *point = [0.5 * a * (1.0 + x), 0.5 * a * w, 0.0];
        }
        let radius = self.radius_mm / self.layer.thickness_mm;
        // Symmetric in the unknowns sqrt(weight) phi.
        for i in 0..n {
            let [x, w, _] = self.points[i];
            for j in 0..=i {
                let [s, v, _] = self.points[j];
                let kernel = self.kernel.at(x - s) + self.kernel.at(x + s);
                let own = if i == j { 0.5 * PI } else { 0.0 };
                self.matrix[i * n + j] = own - 0.5 * kernel * (w * v).sqrt();
            }
            self.sides[0][i] = w.sqrt();
            self.sides[1][i] = w.sqrt() * x * libm::atanh(x / radius);
        }
        if !factor(&mut self.matrix[..n * n], n) {
            return None;
        }
        let mut edge = [1.0, a * libm::atanh(a / radius)];
        let mut total = [0.0; 2];
        for (k, side) in self.sides.iter_mut().enumerate() {
            solve(&self.matrix[..n * n], n, &mut side[..n]);
            for (value, [s, w, _]) in side.iter_mut().zip(&self.points[..n]) {
                // From sqrt(weight) phi to weight phi.
                *value *= w.sqrt();
                total[k] += *value;
                edge[k] += 0.5 * *value * (self.kernel.at(a - s) + self.kernel.at(a + s));
            }
        }
        let delta = edge[1] / edge[0];
        let [punch, shape] = total;
        Some(Solution {
            delta,
            force: 2.0 * PI * (delta * punch - shape),
            stiffness: 2.0 * PI * punch,
            punch_edge: edge[0] / punch / PI,
            rule,
        })
    }

    /// Keeps phi of the solution.
    fn store_pressure(&mut self, a: f64, delta: f64, solved: &Solution) {
        self.used = RULE_SIZES[solved.rule];
        let scale = self.modulus();
        let rule = &self.rules[solved.rule];
        for (i, point) in self.points[..self.used].iter_mut().enumerate() {
            let phi = delta * self.sides[0][i] - self.sides[1][i];
            *point = [0.5 * a * (1.0 + rule[i].0), 0.5 * a * rule[i].1, scale * phi];
        }
    }
}

/// The rule for a contact of radius `a`, by the points that it has at least and those that each
/// thickness adds.
fn rule_for(a: f64, [least, each]: [f64; 2]) -> usize {
    let wanted = least + each * a;
    RULE_SIZES.iter().position(|n| *n as f64 >= wanted).unwrap_or(RULE_SIZES.len() - 1)
}
