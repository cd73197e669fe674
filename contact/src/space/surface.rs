//! Presses a rigid body of any shape on the bonded layer. The surface is divided into equal cells
//! of constant pressure; the influence coefficients are integrated over the cells; a conjugate
//! gradient method keeps the pressures positive (Polonsky and Keer, Wear 231, 1999); the
//! convolutions are done by Fourier transforms.
//!
//! On a round body the error of the force falls as the spacing to the power 1.5: about 2e-3 with 16
//! cells across the contact. A face with edges is as wide as the cells whose centres it covers, and
//! its pressure is infinite at the edges: if they lie on edges of cells, the error is of first
//! order, 3e-2 with 16 cells across a bar. Each contact starts from the previous one. Pressing
//! allocates nothing, whether it succeeds or not.
//!
//! Cells wider than half a thickness of the surface layer are an error, because such cells make the
//! layer too stiff; so are grids of more than 512 cells a side and contacts that reach the border
//! of the grid.

use super::super::{Invalid, positive};
use super::fourier::Convolution;
use super::radial::Influence;
use super::tactels::Shares;
use super::{Prescribed, Refusal, Why};

/// Most cells along a side of the grid.
const SIDE_MAX: usize = 512;
/// Widest cell in thicknesses.
const CELL_MAX: f64 = 0.5;
/// Most iterations.
const ITERATIONS_MAX: usize = 400;
/// The iterations end when no cell misses the shape by more than this part of the penetration.
const MISS_TOLERANCE: f64 = 1e-6;

/// A grid of cells on the layer's surface, centred on its own origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cells {
    /// Cells along x.
    pub columns: usize,
    /// Cells along y.
    pub rows: usize,
    /// Side of a cell, mm.
    pub spacing_mm: f64,
}

impl Cells {
    /// Centre of a cell, row by row, mm.
    #[must_use]
    pub fn place_mm(&self, cell: usize) -> [f64; 2] {
        let along = |i: usize, n: usize| (i as f64 - 0.5 * (n as f64 - 1.0)) * self.spacing_mm;
        [along(cell % self.columns, self.columns), along(cell / self.columns, self.rows)]
    }

    /// Replaces cells of constant traction by point loads in their centres, exact to fourth order,
    /// and calls `each` with the place (mm) and the load (N) of every load that is not zero.
    pub(super) fn loads(&self, traction_mpa: &[f64], mut each: impl FnMut([f64; 2], f64)) {
        let Self { columns, rows, spacing_mm } = *self;
        let at = |i: usize, j: usize| {
            // An index below 0 wraps to a huge number, which is beyond the grid as well.
            if i < columns && j < rows { traction_mpa[j * columns + i] } else { 0.0 }
        };
        for cell in 0..columns * rows {
            let (i, j) = (cell % columns, cell / columns);
            let around = at(i.wrapping_sub(1), j) + at(i + 1, j) + at(i, j.wrapping_sub(1));
            let load = (20.0 * at(i, j) + around + at(i, j + 1)) / 24.0;
            if load != 0.0 {
                each(self.place_mm(cell), load * spacing_mm * spacing_mm);
            }
        }
    }
}

/// Force, penetration and area of a contact, and how well they were solved.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfaceState {
    /// Normal force, N.
    pub force_n: f64,
    /// Penetration of the body's zero height, mm.
    pub penetration_mm: f64,
    /// Area of the cells that carry pressure, mm^2.
    pub area_mm2: f64,
    /// Largest error of the shape over the penetration: a gap or overlap where there is pressure,
    /// an overlap where there is none.
    pub residual: f64,
    /// Iterations taken.
    pub iterations: usize,
}

/// The solver of one grid on one layer, with its memory.
#[derive(Clone, Debug)]
pub struct Surface {
    cells: Cells,
    convolution: Convolution,
    /// Displacement of a cell per pressure on itself, mm/MPa: the scale of the first guess.
    compliance: f64,
    thickness_mm: f64,
    pressure: Vec<f64>,
    miss: Vec<f64>,
    direction: Vec<f64>,
    image_of_direction: Vec<f64>,
    state: SurfaceState,
}

impl Surface {
    /// Tabulates the influence of the cells on each other; allocates.
    ///
    /// # Errors
    /// A spacing that is not finite and above 0 or wider than half a thickness of the surface
    /// layer, and a grid that has not 4 to 512 cells a side.
    pub fn new(influence: &Influence, cells: &Cells) -> Result<Self, Invalid> {
        positive("spacing_mm", cells.spacing_mm)?;
        let t = influence.layer().thickness_mm;
        if cells.spacing_mm > CELL_MAX * t {
            let what = format!("{} mm on a layer of {t} mm", cells.spacing_mm);
            return Err(Invalid::new("spacing_mm", what, "give at most half the thickness"));
        }
        for (place, count) in [("columns", cells.columns), ("rows", cells.rows)] {
            if !(4..=SIDE_MAX).contains(&count) {
                return Err(Invalid::new(place, format!("{count} cells"), "give 4 to 512"));
            }
        }
        let h = cells.spacing_mm;
        let kernel =
            |i: usize, j: usize| influence.surface_cell([i as f64 * h, j as f64 * h], [0.5 * h; 2]);
        let count = cells.columns * cells.rows;
        Ok(Self {
            cells: *cells,
            convolution: Convolution::new(cells.columns, cells.rows, kernel),
            compliance: kernel(0, 0),
            thickness_mm: influence.thickness_mm(),
            pressure: vec![0.0; count],
            miss: vec![0.0; count],
            direction: vec![0.0; count],
            image_of_direction: vec![0.0; count],
            state: SurfaceState::default(),
        })
    }

    /// The grid.
    #[must_use]
    pub fn cells(&self) -> &Cells {
        &self.cells
    }

    /// Lifts the body off and forgets the contact.
    pub fn release(&mut self) {
        self.pressure.fill(0.0);
        self.state = SurfaceState::default();
    }

    /// Presses a body whose face stands `heights_mm` above its zero height at the cells' centres
    /// (infinite: no body there), to a force or a penetration of the zero height.
    ///
    /// # Errors
    /// Heights that are NaN, are not one per cell or are all infinite; a pull; a force or
    /// penetration that is not finite; a contact that reaches the grid's border; no convergence.
    /// The state is then that of no contact.
    pub fn press(
        &mut self,
        heights_mm: &[f64],
        prescribed: Prescribed,
    ) -> Result<SurfaceState, Refusal> {
        let outcome = self.try_press(heights_mm, prescribed);
        if outcome.is_err() {
            self.release();
        }
        outcome
    }

    fn try_press(
        &mut self,
        heights: &[f64],
        prescribed: Prescribed,
    ) -> Result<SurfaceState, Refusal> {
        let target = prescribed.check(self.thickness_mm)?;
        if heights.len() != self.pressure.len() || heights.iter().any(|h| h.is_nan()) {
            let why = Why::HeightCount { given: heights.len(), cells: self.pressure.len() };
            return Err(Refusal::new("heights_mm", why));
        }
        let lowest = heights.iter().fold(f64::INFINITY, |least, h| least.min(*h));
        Refusal::finite("heights_mm", lowest)?;
        let by_force = matches!(prescribed, Prescribed::ForceN(_));
        let none = if by_force { target == 0.0 } else { target <= lowest };
        if none {
            self.release();
            return Ok(self.state);
        }
        let area = self.cells.spacing_mm * self.cells.spacing_mm;
        let start = if by_force { lowest + 1e-3 * self.thickness_mm } else { target };
        self.guess(heights, start, by_force.then_some(target / area));
        let state = self.iterate(heights, by_force, target, area);
        if state.residual > 1e3 * MISS_TOLERANCE || state.residual.is_nan() {
            return Err(Refusal::new(prescribed.place(), Why::MissedSurface(state.residual)));
        }
        self.check_border()?;
        self.state = state;
        Ok(state)
    }

    /// Writes the initial pressures: those of the last contact where the body still is, or those of
    /// a foundation of springs if there was none. They are scaled to `sum` if one is given.
    fn guess(&mut self, heights: &[f64], penetration: f64, sum: Option<f64>) {
        for (p, h) in self.pressure.iter_mut().zip(heights) {
            if h.is_infinite() {
                *p = 0.0;
            }
        }
        let mut total: f64 = self.pressure.iter().sum();
        if total <= 0.0 {
            for (p, h) in self.pressure.iter_mut().zip(heights) {
                *p = (penetration - h).max(0.0) / self.compliance * 0.1;
                total += *p;
            }
        }
        if let Some(sum) = sum {
            for p in &mut self.pressure {
                *p *= sum / total;
            }
        }
    }

    fn iterate(&mut self, heights: &[f64], by_force: bool, target: f64, area: f64) -> SurfaceState {
        let mut state = SurfaceState::default();
        let (mut before, mut restart) = (1.0, true);
        let mut penetration = target;
        for iteration in 1..=ITERATIONS_MAX {
            self.miss.copy_from_slice(&self.pressure);
            self.convolution.apply(&mut self.miss);
            if by_force {
                penetration = self.mean_penetration(heights);
            }
            let (mut size, mut worst) = (0.0, 0.0_f64);
            for ((m, p), h) in self.miss.iter_mut().zip(&self.pressure).zip(heights) {
                *m = penetration - h - *m;
                let missed = if *p > 0.0 { m.abs() } else { *m };
                size += if *p > 0.0 { *m * *m } else { 0.0 };
                // `f64::max` would drop a NaN; the worst error must keep it.
                worst = if missed.is_nan() { missed } else { worst.max(missed) };
                if worst.is_nan() {
                    break;
                }
            }
            let lowest = heights.iter().fold(f64::INFINITY, |least, h| least.min(*h));
            state.residual = worst / (penetration - lowest).abs();
            state.iterations = iteration;
            if state.residual <= MISS_TOLERANCE {
                break;
            }
            let keep = if restart { 0.0 } else { size / before };
            before = size.max(f64::MIN_POSITIVE);
            let cells = self.direction.iter_mut().zip(&self.miss).zip(&self.pressure);
            for ((d, m), p) in cells {
                *d = if *p > 0.0 { m + keep * *d } else { 0.0 };
            }
            restart = self.step(by_force.then_some(target / area));
        }
        let sum: f64 = self.pressure.iter().sum();
        let carrying = self.pressure.iter().filter(|p| **p > 0.0).count();
        state.force_n = sum * area;
        state.penetration_mm = penetration;
        state.area_mm2 = carrying as f64 * area;
        state
    }

    /// Penetration at which the mean error over the contact is zero.
    fn mean_penetration(&self, heights: &[f64]) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for ((m, p), h) in self.miss.iter().zip(&self.pressure).zip(heights) {
            if *p > 0.0 {
                sum += m + h;
                count += 1.0;
            }
        }
        sum / count
    }

    /// Takes one step along the direction. True when cells entered or left the contact: the next
    /// direction must then not be conjugate to this one.
    fn step(&mut self, sum: Option<f64>) -> bool {
        self.image_of_direction.copy_from_slice(&self.direction);
        self.convolution.apply(&mut self.image_of_direction);
        let (mut mean, mut count) = (0.0, 0.0);
        if sum.is_some() {
            for (m, p) in self.image_of_direction.iter().zip(&self.pressure) {
                if *p > 0.0 {
                    mean += m;
                    count += 1.0;
                }
            }
            mean /= count;
        }
        let (mut up, mut down) = (0.0, 0.0);
        for (((m, p), r), d) in
            self.image_of_direction.iter().zip(&self.pressure).zip(&self.miss).zip(&self.direction)
        {
            if *p > 0.0 {
                up += r * d;
                down += (m - mean) * d;
            }
        }
        let length = if down > 0.0 { up / down } else { 0.0 };
        let mut changed = length == 0.0;
        for ((p, d), r) in self.pressure.iter_mut().zip(&self.direction).zip(&self.miss) {
            if *p > 0.0 {
                *p += length * d;
                if *p <= 0.0 {
                    *p = 0.0;
                    changed = true;
                }
            } else if *r > 0.0 {
                // A cell without pressure that overlaps the body enters the contact.
                *p = length.max(1e-3 / self.compliance) * r;
                changed = true;
            }
        }
        if let Some(sum) = sum {
            let total: f64 = self.pressure.iter().sum();
            if total > 0.0 {
                for p in &mut self.pressure {
                    *p *= sum / total;
                }
            }
        }
        changed
    }

    fn check_border(&self) -> Result<(), Refusal> {
        let Cells { columns, rows, .. } = self.cells;
        let border = |cell: usize| {
            let (i, j) = (cell % columns, cell / columns);
            i == 0 || j == 0 || i == columns - 1 || j == rows - 1
        };
        match self.pressure.iter().enumerate().find(|(cell, p)| **p > 0.0 && border(*cell)) {
            None => Ok(()),
            Some(_) => Err(Refusal::new("columns", Why::GridBorder)),
        }
    }

    /// Pressures of the cells, row by row, MPa.
    #[must_use]
    pub fn pressure_mpa(&self) -> &[f64] {
        &self.pressure
    }

    /// The contact last solved.
    #[must_use]
    pub fn state(&self) -> SurfaceState {
        self.state
    }

    /// Adds the image of the contact to `image`, the grid's centre standing at `place_mm`; stresses
    /// in MPa.
    pub fn image(&self, shares: &Shares, place_mm: [f64; 2], image: &mut [f64]) {
        self.image_of(shares, place_mm, 1.0, image);
    }

    /// Adds the image of `ratio` times the pressure; with [`Shares::sheared`] this is the image of
    /// a friction traction in proportion to the pressure.
    pub fn image_of(&self, shares: &Shares, place_mm: [f64; 2], ratio: f64, image: &mut [f64]) {
        self.cells.loads(&self.pressure, |[x, y], load| {
            shares.add(image, [place_mm[0] + x, place_mm[1] + y], ratio * load);
        });
    }
}
