//! A rigid sphere on the bonded layer: the exact circle, frictionless.
//!
//! The pressure is the Abel transform of a function phi that solves a Fredholm equation of the
//! second kind on (0, a) (Lebedev and Ufliand, 1958): (pi/2) phi(x) less the integral of
//! (K(x - s) + K(x + s)) phi(s)/2 is G/(1 - nu) (delta - x atanh(x/R)), K the cosine transform of
//! 1 - M; phi vanishes at the edge of the contact. Gauss's rule converges exponentially. The base
//! pressure is the inverse Abel transform of a plane problem's. A tactel's mean is the flux of the
//! radial field whose divergence is that pressure, so the image of a sphere well inside the array
//! sums to the force exactly.
//!
//! Measured against exact solutions: force, penetration and image 1e-6 of the peak at
//! [`Level::Default`], 1e-8 at [`Level::Fine`]. A solved contact is the guess of the next one;
//! solving allocates nothing.
//!
//! It refuses penetrations of the thickness or more, contacts wider than 0.95 of the diameter or
//! with a radius above 120 thicknesses, and forces that would need those.

use super::super::layer::{Layer, Transfer};
use super::super::{Invalid, positive};
use super::quadrature::{factor, legendre, solve};
use super::radial::{REACH, Radial};
use super::table::Even;
use super::tactels::{Array, Sampling};
use super::{Drive, Level, Refusal, Why};
use core::f64::consts::PI;

/// Largest contact radius in radii of the sphere.
const STEEPEST: f64 = 0.95;
/// Largest contact radius in thicknesses.
const WIDEST: f64 = 120.0;
/// Solutions that one search may take.
const SEARCH: usize = 60;
/// The search ends at this relative miss; what is left is corrected to second order.
const MISS: f64 = 1e-7;
/// Points of the Gauss rules that are kept.
const RULES: [usize; 10] = [16, 20, 24, 32, 48, 64, 96, 160, 256, 384];
/// Points per thickness of the kernel's table.
const DENSITY: f64 = 32.0;

/// What a solved sphere says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SphereState {
    /// Normal force, N.
    pub force_n: f64,
    /// Penetration of the lowest point, mm.
    pub penetration_mm: f64,
    /// Radius of the contact, mm.
    pub contact_radius_mm: f64,
    /// Pressure left at the contact's edge, as part of that of a flat punch with this force.
    pub residual: f64,
}

/// Accuracy against time.
#[derive(Clone, Copy, Debug)]
struct Grid {
    per_thickness: f64,
    /// Beyond the contact's edge, in thicknesses.
    reach: f64,
    sight: f64,
    panel: f64,
    points: usize,
}

impl Grid {
    fn of(level: Level) -> Self {
        match level {
            Level::Fast => {
                Self { per_thickness: 8.0, reach: 9.0, sight: 0.5, panel: 2.0, points: 4 }
            }
            Level::Default => {
                Self { per_thickness: 16.0, reach: 16.0, sight: 0.33, panel: 1.5, points: 6 }
            }
            Level::Fine => {
                Self { per_thickness: 32.0, reach: 32.0, sight: 0.25, panel: 1.0, points: 8 }
            }
        }
    }
}

/// The solver of one sphere on one layer, with its memory.
#[derive(Clone, Debug)]
pub struct Sphere {
    layer: Layer,
    radius_mm: f64,
    grid: Grid,
    radial: Radial,
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
    /// Contact radius in thicknesses.
    a: f64,
    state: SphereState,
}

/// One solution for a contact radius, in thicknesses and G/(1 - nu).
struct Solved {
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
    pub fn new(layer: &Layer, radius_mm: f64, level: Level) -> Result<Self, Invalid> {
        layer.check()?;
        positive("radius_mm", radius_mm)?;
        let transfer = layer.transfer();
        let (grid, widest) =
            (Grid::of(level), WIDEST.min(STEEPEST * radius_mm / layer.thickness_mm));
        let most = rule_for(widest);
        let n = RULES[most];
        let room = ((widest + grid.reach) * grid.per_thickness) as usize + 16;
        Ok(Self {
            layer: *layer,
            radius_mm,
            grid,
            radial: Radial::new(&transfer),
            kernel: Kernel::new(&transfer),
            rules: RULES[..=most].iter().map(|n| legendre(*n)).collect(),
            edge: legendre(grid.points),
            matrix: vec![0.0; n * n],
            sides: [vec![0.0; n], vec![0.0; n]],
            points: vec![[0.0; 3]; n],
            used: 0,
            tables: [Even::with_room(room), Even::with_room(room), Even::with_room(room)],
            a: 0.0,
            state: SphereState::default(),
        })
    }

    /// Presses the sphere to a force or a penetration; penetrations of 0 or less are no contact.
    ///
    /// # Errors
    /// What is not finite, a force below 0, and what this module refuses. The state is then that of
    /// no contact.
    pub fn press(&mut self, drive: Drive) -> Result<SphereState, Refusal> {
        let guess = self.a;
        self.release();
        let target = drive.check(self.layer.thickness_mm)?;
        if target <= 0.0 {
            return Ok(self.state);
        }
        let t = self.layer.thickness_mm;
        let modulus = self.layer.shear_mpa() / (1.0 - self.layer.poisson);
        let radius = self.radius_mm / t;
        let (by_force, wanted) = match drive {
            Drive::ForceN(force) => (true, force / (modulus * t * t)),
            Drive::PenetrationMm(delta) => (false, delta / t),
        };
        // Hertz: F = (8/3) a^3/R and delta = a^2/R, in these units.
        let hertz =
            if by_force { libm::cbrt(0.375 * wanted * radius) } else { (wanted * radius).sqrt() };
        let start = if guess > 0.0 { guess } else { hertz };
        let widest = WIDEST.min(STEEPEST * radius);
        let (a, solved, miss) = self.search(start.min(widest), by_force, wanted, widest)?;
        // What is left of the miss is taken up by the punch, to second order.
        let change = if by_force {
            (wanted - solved.force) / solved.stiffness
        } else {
            wanted - solved.delta
        };
        let delta = solved.delta + change;
        let force = solved.force + change * solved.stiffness;
        if delta >= 1.0 {
            return Err(Refusal::new(drive.place(), Why::Thickness(delta * t)));
        }
        self.spread(a, delta, &solved);
        self.a = a * (1.0 - miss / 3.0);
        self.state = SphereState {
            force_n: force * modulus * t * t,
            penetration_mm: delta * t,
            contact_radius_mm: self.a * t,
            residual: (change * solved.punch_edge * 2.0 * PI * a / force).abs(),
        };
        self.tabulate(a);
        Ok(self.state)
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
        by_force: bool,
        wanted: f64,
        widest: f64,
    ) -> Result<(f64, Solved, f64), Refusal> {
        let (mut a, mut slope) = (start, if by_force { 3.2 } else { 2.0 });
        let mut before: Option<(f64, f64)> = None;
        for _ in 0..SEARCH {
            let Some(solved) = self.solve(a) else { break };
            let reached = if by_force { solved.force } else { solved.delta };
            let miss = libm::log(reached / wanted);
            if let Some((a_before, miss_before)) = before {
                let run = libm::log(a / a_before);
                if run != 0.0 {
                    slope = ((miss - miss_before) / run).clamp(1.0, 8.0);
                }
            }
            if miss.abs() < MISS {
                return Ok((a, solved, miss));
            }
            if miss < 0.0 && a >= widest {
                break;
            }
            before = Some((a, miss));
            a = (a * libm::exp((-miss / slope).clamp(-1.5, 1.5))).min(widest);
        }
        let place = if by_force { "force_n" } else { "penetration_mm" };
        Err(Refusal::new(place, Why::Unreached))
    }

    /// Contact of radius `a` thicknesses; `None` when the system cannot be solved.
    fn solve(&mut self, a: f64) -> Option<Solved> {
        let rule = rule_for(a).min(self.rules.len() - 1);
        let n = RULES[rule];
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
        Some(Solved {
            delta,
            force: 2.0 * PI * (delta * punch - shape),
            stiffness: 2.0 * PI * punch,
            punch_edge: edge[0] / punch / PI,
            rule,
        })
    }

    /// Keeps phi of the solution.
    fn spread(&mut self, a: f64, delta: f64, solved: &Solved) {
        self.used = RULES[solved.rule];
        let scale = self.layer.shear_mpa() / (1.0 - self.layer.poisson);
        let rule = &self.rules[solved.rule];
        for (i, point) in self.points[..self.used].iter_mut().enumerate() {
            let phi = delta * self.sides[0][i] - self.sides[1][i];
            *point = [0.5 * a * (1.0 + rule[i].0), 0.5 * a * rule[i].1, scale * phi];
        }
    }

    /// Base pressure and flux over the distance from the axis.
    fn tabulate(&mut self, a: f64) {
        let Grid { per_thickness: density, reach, sight, .. } = self.grid;
        let count = ((a + reach) * density) as usize + 8;
        let (points, radial) = (&self.points[..self.used], &self.radial);
        let slope = |x: f64| {
            let term = |[s, _, phi]: &[f64; 3]| {
                let (near, far) = (x - s, x + s);
                phi * (near * radial.base_slope(near.abs()) + far * radial.base_slope(far))
            };
            -points.iter().map(term).sum::<f64>() / x
        };
        let [projected, pressure, flux] = &mut self.tables;
        let h = 1.0 / density;
        // Even and smooth at 0: the value there from its neighbours.
        let middle = 1.5 * slope(h) - 0.6 * slope(2.0 * h) + 0.1 * slope(3.0 * h);
        projected.refill(count, density, |i| if i == 0 { middle } else { slope(i as f64 * h) });
        let end = projected.end();
        let along = |i: usize| {
            let r = i as f64 * h;
            let steps = libm::floor((end * end - r * r).max(0.0).sqrt() / sight) as usize;
            let mut sum = 0.5 * projected.at(r);
            for k in 1..=steps {
                let v = k as f64 * sight;
                sum += projected.at((r * r + v * v).sqrt());
            }
            -sight / PI * sum
        };
        pressure.refill(count, density, along);
        let mut inside = 0.0;
        let moment = |i: isize| pressure.sample(i.unsigned_abs()) * i as f64 * h;
        flux.refill(count, density, |_| 0.0);
        flux.set(0, 0.5 * pressure.sample(0));
        for i in 1..count {
            // The integral over one spacing by the polynomial through six values.
            let m = i as isize - 1;
            let right = (m + 3).min(count as isize - 1);
            let outer = moment(m - 2) + moment(right);
            let inner = moment(m - 1) + moment((m + 2).min(right));
            let middle = moment(m) + moment(m + 1);
            inside += h * (11.0 * outer - 93.0 * inner + 802.0 * middle) / 1440.0;
            let r = i as f64 * h;
            flux.set(i, inside / (r * r));
        }
        flux.mirror();
    }

    /// Normal stress at the base (MPa, negative) at `r_mm` from the axis.
    #[must_use]
    pub fn base_szz_mpa(&self, r_mm: f64) -> f64 {
        if self.used == 0 { 0.0 } else { -self.tables[1].at(r_mm.abs() / self.layer.thickness_mm) }
    }

    /// Writes the image of the sphere with its axis at `place_mm`, row by row (row = y, column = x,
    /// both ascending), stresses in MPa.
    ///
    /// # Errors
    /// An array that [`Array::check`] refuses or an image of another length, a place that is not
    /// finite.
    pub fn image(
        &self,
        array: &Array,
        sampling: Sampling,
        place_mm: [f64; 2],
        image: &mut [f64],
    ) -> Result<(), Invalid> {
        array.fits(image)?;
        super::super::finite("x_mm", place_mm[0])?;
        super::super::finite("y_mm", place_mm[1])?;
        image.fill(0.0);
        if self.used == 0 {
            return Ok(());
        }
        let [x0, y0] = place_mm;
        if sampling == Sampling::Centre {
            for (n, value) in image.iter_mut().enumerate() {
                let x = array.x_mm(n % array.cols) - x0;
                let y = array.y_mm(n / array.cols) - y0;
                *value = self.base_szz_mpa((x * x + y * y).sqrt());
            }
            return Ok(());
        }
        let t = self.layer.thickness_mm;
        let pitch = array.pitch_mm / t;
        let edge = |centre_mm: f64, at_mm: f64| (centre_mm - at_mm) / t - 0.5 * pitch;
        let scale = 1.0 / (pitch * pitch);
        for row in 0..=array.rows {
            let y = edge(array.y_mm(row), y0);
            for column in 0..=array.cols {
                let x = edge(array.x_mm(column), x0);
                // The edge to the right of this corner, and the one above it.
                if column < array.cols {
                    let through = scale * self.through(y, x, pitch);
                    if row > 0 {
                        image[(row - 1) * array.cols + column] -= through;
                    }
                    if row < array.rows {
                        image[row * array.cols + column] += through;
                    }
                }
                if row < array.rows {
                    let through = scale * self.through(x, y, pitch);
                    if column > 0 {
                        image[row * array.cols + column - 1] -= through;
                    }
                    if column < array.cols {
                        image[row * array.cols + column] += through;
                    }
                }
            }
        }
        Ok(())
    }

    /// Flux through the edge from `from` to `from + length` on a line at distance `level`.
    fn through(&self, level: f64, from: f64, length: f64) -> f64 {
        let flux = &self.tables[2];
        let (end, to) = (flux.end(), from + length);
        let nearest = if from > 0.0 { from } else { to.min(0.0) };
        let total = self.total_inside();
        if level * level + nearest * nearest >= end * end {
            // Everything lies inside: what is left is the angle under which the edge is seen.
            let angle = |y: f64| libm::atan2(y, level.abs());
            let seen = total * (angle(to) - angle(from));
            return if level < 0.0 { -seen } else { seen };
        }
        let panels = libm::ceil(length / self.grid.panel).max(1.0);
        let half = 0.5 * length / panels;
        let mut sum = 0.0;
        for panel in 0..panels as usize {
            let middle = from + half * (2 * panel + 1) as f64;
            for (g, w) in &self.edge {
                let y = middle + g * half;
                let r2 = level * level + y * y;
                let r = r2.sqrt();
                sum += w * if r < end { flux.at(r) } else { total / r2 };
            }
        }
        level * sum * half
    }

    /// The flux beyond the table times the square of the distance.
    fn total_inside(&self) -> f64 {
        let flux = &self.tables[2];
        let last = flux.last();
        let r = last as f64 / self.grid.per_thickness;
        flux.sample(last) * r * r
    }
}

fn rule_for(a: f64) -> usize {
    let wanted = 12.0 + 3.0 * a;
    RULES.iter().position(|n| *n as f64 >= wanted).unwrap_or(RULES.len() - 1)
}

/// Cosine transform of 1 - M, in thicknesses.
#[derive(Clone, Debug)]
struct Kernel {
    table: Even,
    /// Coefficients of 1/u^2 and 1/u^4 beyond the table.
    tail: [f64; 2],
}

impl Kernel {
    fn new(transfer: &Transfer) -> Self {
        let count = (REACH * DENSITY) as usize + 8;
        let rule = legendre(24);
        let mut values = vec![0.0; count];
        // Panels short enough for the fastest cosine of the table; 1 - M dies as exp(-2a).
        let (panels, half) = (42, 0.25);
        for panel in 0..panels {
            for (g, w) in &rule {
                let a = half * ((2 * panel + 1) as f64 + g);
                let weight = half * w * (1.0 - a * transfer.normal_compliance(a));
                let (sine, cosine) = (libm::sin(a / DENSITY), libm::cos(a / DENSITY));
                let (mut s, mut c) = (0.0, 1.0);
                for value in &mut values {
                    *value += weight * c;
                    (s, c) = (s * cosine + c * sine, c * cosine - s * sine);
                }
            }
        }
        let first = transfer.normal_compliance(0.0);
        let cubic = |a: f64| (transfer.normal_compliance(a) - first) / (a * a);
        let third = (4.0 * cubic(0.05) - cubic(0.1)) / 3.0;
        Self { table: Even::new(&values, DENSITY), tail: [first, -6.0 * third] }
    }

    fn at(&self, u: f64) -> f64 {
        let u = u.abs();
        if u < self.table.end() {
            return self.table.at(u);
        }
        let over = 1.0 / (u * u);
        over * (self.tail[0] + over * self.tail[1])
    }
}
