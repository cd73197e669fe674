//! Coulomb's friction in space: a rigid body on cells of the bonded layer that sticks where it can
//! and slides where its traction reaches the coefficient of friction times the pressure.
//!
//! A step presses the body and carries it along the surface. A cell's slip is what the body moves
//! by less what the layer's surface moves by since the step before, wherever it was then; so what
//! is touched first is touched where pressure and friction have brought it. The tractions of a step
//! make half of their own work least less the work on what they should move the surface by, each
//! within the circle of its limit (Kalker, Three-Dimensional Elastic Bodies in Rolling Contact,
//! 1990, chapter 4): accelerated gradients with restarts (Beck and Teboulle, 2009; O'Donoghue and
//! Candes, 2015). Pressure and traction move each other, also at nu = 0.5 on a layer, and are found
//! in turns.
//!
//! Frame as in [`super`]; tractions are those on the layer. It refuses what [`Surface::press`]
//! refuses, a carry that is not finite, a negative coefficient of friction, and turns that do not
//! settle; the state is then that of the step before. Friction does not fall with sliding.

use super::super::{Invalid, finite};
use super::Prescribed;
use super::fourier::Convolution;
use super::shear::Shear;
use super::surface::{Cells, Surface, SurfaceState};
use super::tactels::Shares;

/// Turns of pressure and traction, and the change of the sinking at which they end, over the
/// penetration.
const ITERATIONS_MAX: usize = 60;
const CHANGE_TOLERANCE: f64 = 1e-7;
/// Most gradients in a turn, and the slip left at which they end, over the largest displacement
/// asked for.
const GRADIENT_STEPS_MAX: usize = 4000;
const SLIP_TOLERANCE: f64 = 1e-7;
/// The same while the sinking still changes: this part of its change, or this at the loosest.
const LOOSE_SLIP_TOLERANCE: f64 = 1e-3;
/// A cell of which less of the limit is free slides.
const STICK_MARGIN: f64 = 1e-6;

/// How a body is carried along the surface from one step to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BodyMotion {
    /// Along x and y, mm.
    pub shift_mm: [f64; 2],
    /// About z through the grid's middle, rad.
    pub turn_rad: f64,
}

/// What a cell does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// No pressure.
    Apart,
    /// It moves with the body.
    Sticks,
    /// Its traction is at the limit.
    Slides,
}

/// What a step says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GripState {
    /// Pressure's part.
    pub pressed: SurfaceState,
    /// Force on the layer along x and y, N.
    pub force_n: [f64; 2],
    /// Torque on the layer about z through the grid's middle, N mm.
    pub torque_n_mm: f64,
    /// Area that sticks, and area that slides, mm^2.
    pub area_mm2: [f64; 2],
    /// What the rule of friction is missed by as slip, over the largest displacement asked for.
    pub residual: f64,
    /// Turns of pressure and traction taken.
    pub turns: usize,
}

/// Tractions along x and y, or displacements.
type Field = [Vec<f64>; 2];

/// A body that grips the layer, with its memory of the step before.
#[derive(Clone, Debug)]
pub struct Grip {
    cells: Cells,
    surface: Surface,
    friction: f64,
    /// Displacement along x per traction along x, along y per y, and along one per the other.
    direct: [Convolution; 2],
    cross: Convolution,
    /// Downward displacement per traction along x and along y.
    normal_kernels: [Convolution; 2],
    /// No displacement is more times a traction of the same size.
    compliance_max: f64,
    traction: Field,
    /// Displacement of the surface after the last step.
    displacement: Field,
    state: GripState,
}

impl Grip {
    /// A body that does not touch. Tabulates the influence of tractions; allocates.
    ///
    /// # Errors
    /// A coefficient of friction that is negative or not finite.
    pub fn new(surface: Surface, shear: &Shear, friction: f64) -> Result<Self, Invalid> {
        finite("friction", friction)?;
        if friction < 0.0 {
            return Err(Invalid::new("friction", format!("{friction}"), "give 0 or more"));
        }
        let cells = *surface.cells();
        let (size, h) = ([cells.columns, cells.rows], cells.spacing_mm);
        let count = cells.columns * cells.rows;
        let place = |n: usize| [(n % cells.columns) as f64 * h, (n / cells.columns) as f64 * h];
        // Cells are squares: what a traction along y does is what one along x does, mirrored.
        let along: Vec<[f64; 3]> =
            (0..count).map(|n| shear.surface_cell(place(n), [0.5 * h; 2])).collect();
        let mirrored = |n: usize| {
            let [x, y] = place(n);
            shear.surface_cell([y, x], [0.5 * h; 2])
        };
        let across: Vec<[f64; 3]> = (0..count).map(mirrored).collect();
        let kernel = |odd: [bool; 2], of: &[[f64; 3]], which: usize| {
            Convolution::with_parity(size, odd, |i, j| of[j * cells.columns + i][which])
        };
        let reach = |of: &[[f64; 3]]| -> f64 {
            let sides = |n: usize| place(n).map(|at| if at > 0.0 { 2.0 } else { 1.0 });
            let size = |(n, u): (usize, &[f64; 3])| {
                sides(n).iter().product::<f64>() * (u[0].abs() + u[1].abs())
            };
            of.iter().enumerate().map(size).sum()
        };
        let field = || [vec![0.0; count], vec![0.0; count]];
        Ok(Self {
            cells,
            surface,
            friction,
            direct: [kernel([false; 2], &along, 0), kernel([false; 2], &across, 0)],
            cross: kernel([true; 2], &along, 1),
            normal_kernels: [kernel([true, false], &along, 2), kernel([false, true], &across, 2)],
            compliance_max: reach(&along).max(reach(&across)),
            traction: field(),
            displacement: field(),
            state: GripState::default(),
        })
    }

    /// Lifts the body off: the layer is as it was.
    pub fn release(&mut self) {
        self.surface.release();
        self.traction.iter_mut().chain(&mut self.displacement).for_each(|part| part.fill(0.0));
        self.state = GripState::default();
    }

    /// Presses the body, its face at `heights_mm` as [`Surface::press`] has them, and carries it
    /// along from where it was at the last step. Allocates.
    ///
    /// # Errors
    /// What this module refuses; the step is then not taken.
    pub fn step(
        &mut self,
        heights_mm: &[f64],
        prescribed: Prescribed,
        motion: &BodyMotion,
    ) -> Result<GripState, Invalid> {
        finite("shift_mm", motion.shift_mm[0])?;
        finite("shift_mm", motion.shift_mm[1])?;
        finite("turn_rad", motion.turn_rad)?;
        let before = self.surface.clone();
        let outcome = self.try_step(heights_mm, prescribed, motion);
        match outcome {
            Ok(state) => self.state = state,
            Err(_) => self.surface = before,
        }
        outcome
    }

    fn try_step(
        &mut self,
        heights: &[f64],
        prescribed: Prescribed,
        motion: &BodyMotion,
    ) -> Result<GripState, Invalid> {
        let mut traction = self.traction.clone();
        let mut normal_displacement = self.normal_displacement(&traction);
        let mut tolerance = LOOSE_SLIP_TOLERANCE;
        for turn in 1..=ITERATIONS_MAX {
            // Before heights that are too many are left out.
            if heights.len() != normal_displacement.len() {
                self.surface.press(heights, prescribed)?;
            }
            let raised: Vec<f64> =
                heights.iter().zip(&normal_displacement).map(|(h, s)| h + s).collect();
            let pressed = self.surface.press(&raised, prescribed)?;
            let (pressure_displacement, mut wanted) =
                (self.pressure_displacement(), self.displacement.clone());
            for (n, [x, y]) in (0..normal_displacement.len()).map(|n| (n, self.cells.place_mm(n))) {
                wanted[0][n] +=
                    motion.shift_mm[0] - motion.turn_rad * y - pressure_displacement[0][n];
                wanted[1][n] +=
                    motion.shift_mm[1] + motion.turn_rad * x - pressure_displacement[1][n];
            }
            let residual = self.solve_traction(&wanted, &mut traction, tolerance);
            let new_displacement = self.normal_displacement(&traction);
            let change = new_displacement
                .iter()
                .zip(&normal_displacement)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max);
            normal_displacement = new_displacement;
            let change = change / pressed.penetration_mm.abs().max(f64::MIN_POSITIVE);
            let settled = change <= CHANGE_TOLERANCE && tolerance <= SLIP_TOLERANCE;
            // Off the surface as friction left it the body may touch again once that is gone.
            let apart = pressed.force_n == 0.0 && change == 0.0;
            if settled || apart {
                let mut state = self.grip_state(&traction, pressed);
                (state.residual, state.turns) = (residual, turn);
                if residual > 1e3 * SLIP_TOLERANCE || residual.is_nan() {
                    let what = format!("friction leaves {residual:e} of the way after its steps");
                    return Err(Invalid::new("friction", what, "motion the body less far a step"));
                }
                self.displacement = pressure_displacement;
                let tangential_displacement = self.tangential_displacement(&traction);
                for (part, more) in self.displacement.iter_mut().zip(tangential_displacement) {
                    part.iter_mut().zip(more).for_each(|(u, more)| *u += more);
                }
                self.traction = traction;
                return Ok(state);
            }
            tolerance = (LOOSE_SLIP_TOLERANCE * change).clamp(SLIP_TOLERANCE, LOOSE_SLIP_TOLERANCE);
        }
        let what = format!("pressure and friction of {} do not settle", self.friction);
        Err(Invalid::new("friction", what, "give less friction"))
    }

    /// What tractions along the surface move it by.
    fn tangential_displacement(&mut self, traction: &Field) -> Field {
        let [mut along, mut across] = traction.clone();
        let [mut x, mut y] = traction.clone();
        self.direct[0].apply(&mut x);
        self.direct[1].apply(&mut y);
        self.cross.apply(&mut along);
        self.cross.apply(&mut across);
        x.iter_mut().zip(&across).for_each(|(u, more)| *u += more);
        y.iter_mut().zip(&along).for_each(|(u, more)| *u += more);
        [x, y]
    }

    /// What they make it sink by.
    fn normal_displacement(&mut self, traction: &Field) -> Vec<f64> {
        let [mut x, mut y] = traction.clone();
        self.normal_kernels[0].apply(&mut x);
        self.normal_kernels[1].apply(&mut y);
        x.iter_mut().zip(y).for_each(|(w, more)| *w += more);
        x
    }

    /// What the pressure moves the surface by along itself: by reciprocity the sinking's kernels
    /// from the other side.
    fn pressure_displacement(&mut self) -> Field {
        let pressure = self.surface.pressure_mpa();
        let mut displacement = [pressure.to_vec(), pressure.to_vec()];
        for (part, kernel) in displacement.iter_mut().zip(&mut self.normal_kernels) {
            kernel.apply(part);
            part.iter_mut().for_each(|u| *u = -*u);
        }
        displacement
    }

    /// Tractions within their limits that move the surface as wanted where they can; the slip that
    /// is left against the rule, over the largest displacement wanted.
    fn solve_traction(&mut self, wanted: &Field, traction: &mut Field, tolerance: f64) -> f64 {
        let pressure = self.surface.pressure_mpa();
        let limits: Vec<f64> = pressure.iter().map(|p| self.friction * p).collect();
        let loaded = || limits.iter().enumerate().filter(|(_, limit)| **limit > 0.0);
        let way = |n: usize| wanted[0][n].abs().max(wanted[1][n].abs());
        let largest = loaded().map(|(n, _)| way(n)).fold(0.0, f64::max);
        let within = |at: [f64; 2], limit: f64| {
            let size = (at[0] * at[0] + at[1] * at[1]).sqrt();
            if size > limit { at.map(|q| q * (limit / size)) } else { at }
        };
        for n in 0..limits.len() {
            let at = within([traction[0][n], traction[1][n]], limits[n]);
            (traction[0][n], traction[1][n]) = (at[0], at[1]);
        }
        if largest == 0.0 {
            return 0.0;
        }
        let step = 1.0 / self.compliance_max;
        let (mut extrapolated, mut momentum, mut left) = (traction.clone(), 1.0_f64, f64::INFINITY);
        for _ in 0..GRADIENT_STEPS_MAX {
            let displacement = self.tangential_displacement(&extrapolated);
            let (mut turned, mut worst) = (0.0, 0.0_f64);
            let mut change = [vec![0.0; limits.len()], vec![0.0; limits.len()]];
            for (n, limit) in limits.iter().enumerate().filter(|(_, limit)| **limit > 0.0) {
                let from = [extrapolated[0][n], extrapolated[1][n]];
                let to = [0, 1].map(|k| from[k] + step * (wanted[k][n] - displacement[k][n]));
                let to = within(to, *limit);
                for k in 0..2 {
                    worst = worst.max((to[k] - from[k]).abs());
                    change[k][n] = to[k] - traction[k][n];
                    turned += (from[k] - to[k]) * change[k][n];
                    traction[k][n] = to[k];
                }
            }
            left = worst * self.compliance_max / largest;
            if left <= tolerance || left.is_nan() {
                break;
            }
            let next = 0.5 + (0.25 + momentum * momentum).sqrt();
            let ahead = if turned > 0.0 { 0.0 } else { (momentum - 1.0) / next };
            momentum = if turned > 0.0 { 1.0 } else { next };
            for k in 0..2 {
                for (n, extrapolated) in extrapolated[k].iter_mut().enumerate() {
                    *extrapolated = traction[k][n] + ahead * change[k][n];
                }
            }
        }
        left
    }

    fn grip_state(&self, traction: &Field, pressed: SurfaceState) -> GripState {
        let area = self.cells.spacing_mm * self.cells.spacing_mm;
        let mut state = GripState { pressed, ..GripState::default() };
        for (n, p) in self.surface.pressure_mpa().iter().enumerate() {
            let ([x, y], q) = (self.cells.place_mm(n), [traction[0][n], traction[1][n]]);
            state.force_n[0] += area * q[0];
            state.force_n[1] += area * q[1];
            state.torque_n_mm += area * (x * q[1] - y * q[0]);
            match status(*p, q, self.friction) {
                Status::Apart => {}
                Status::Sticks => state.area_mm2[0] += area,
                Status::Slides => state.area_mm2[1] += area,
            }
        }
        state
    }

    /// The last step's state.
    #[must_use]
    pub fn state(&self) -> GripState {
        self.state
    }

    /// What a cell does, row by row.
    pub fn status(&self) -> impl Iterator<Item = Status> + '_ {
        let pressure = self.surface.pressure_mpa().iter().enumerate();
        pressure.map(|(n, p)| status(*p, [0, 1].map(|k| self.traction[k][n]), self.friction))
    }

    /// Pressures of the cells, row by row, MPa.
    #[must_use]
    pub fn pressure_mpa(&self) -> &[f64] {
        self.surface.pressure_mpa()
    }

    /// Tractions on the layer along x and along y, row by row, MPa.
    #[must_use]
    pub fn traction_mpa(&self) -> [&[f64]; 2] {
        [&self.traction[0], &self.traction[1]]
    }

    /// Displacement of the layer's surface along x and along y, row by row, mm.
    #[must_use]
    pub fn displacement_mm(&self) -> [&[f64]; 2] {
        [&self.displacement[0], &self.displacement[1]]
    }

    /// Adds the image of pressure and tractions to `image`, the grid's middle at `place_mm`; MPa.
    /// `sheared` is [`Shares::sheared`] of the array and of the one with rows for columns (of a
    /// square array twice the same). Allocates.
    ///
    /// # Errors
    /// An image of another length; a second array that is not the first one with rows for columns.
    pub fn image(
        &self,
        normal: &Shares,
        sheared: [&Shares; 2],
        place_mm: [f64; 2],
        image: &mut [f64],
    ) -> Result<(), Invalid> {
        let [array, turned] = sheared.map(Shares::array);
        normal.array().check_image(image)?;
        let fits = |one: &super::tactels::Array, rows: usize, cols: usize| {
            [one.rows, one.cols] == [rows, cols] && one.pitch_mm == normal.array().pitch_mm
        };
        let (rows, cols) = (normal.array().rows, normal.array().cols);
        if !fits(array, rows, cols) || !fits(turned, cols, rows) {
            let what = format!("shares of an array other than {rows} x {cols} and its mirror");
            return Err(Invalid::new("sheared", what, "give the array's and its mirror's"));
        }
        self.surface.image(normal, place_mm, image);
        let [u, v] = place_mm;
        self.cells.loads(&self.traction[0], |[x, y], load| {
            sheared[0].add(image, [u + x, v + y], load);
        });
        // A load along y is one along x in a mirror that swaps both.
        let mut mirrored = vec![0.0; image.len()];
        self.cells.loads(&self.traction[1], |[x, y], load| {
            sheared[1].add(&mut mirrored, [v + y, u + x], load);
        });
        for (n, value) in image.iter_mut().enumerate() {
            *value += mirrored[(n % cols) * rows + n / cols];
        }
        Ok(())
    }
}

/// What a cell with a pressure and a traction does.
fn status(pressure: f64, [x, y]: [f64; 2], friction: f64) -> Status {
    let limit = friction * pressure;
    match (x * x + y * y).sqrt() {
        _ if pressure <= 0.0 => Status::Apart,
        size if size < (1.0 - STICK_MARGIN) * limit => Status::Sticks,
        _ => Status::Slides,
    }
}
