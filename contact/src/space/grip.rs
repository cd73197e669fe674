//! Solves contact with Coulomb friction in three dimensions: a rigid body on cells of the bonded
//! layer sticks where it can and slides where its traction reaches the coefficient of friction
//! times the pressure.
//!
//! A step presses the body and moves it along the surface. The slip of a cell is the displacement
//! of the body minus that of the layer's surface since the previous step. A cell that enters the
//! contact therefore does so at the place to which pressure and friction have moved it. The
//! tractions of a step minimise half of their own work minus their work on the prescribed
//! displacement, each within the circle of its limit (Kalker, Three-Dimensional Elastic Bodies in
//! Rolling Contact, 1990, chapter 4). The minimum is found by accelerated gradients with restarts
//! (Beck and Teboulle, 2009; O'Donoghue and Candes, 2015). Pressure and traction are coupled, on a
//! layer even at nu = 0.5, and are solved alternately.
//!
//! The frame is that of [`super`]; tractions are those on the layer. The coefficient of friction
//! does not depend on the sliding. After an error the state is that of the previous step.

use super::super::{Invalid, finite};
use super::Prescribed;
use super::fourier::Convolution;
use super::shear::Shear;
use super::surface::{Cells, Surface, SurfaceState};
use super::tactels::Shares;

/// Most alternations between pressure and traction.
const ITERATIONS_MAX: usize = 60;
/// Change of the normal displacement, over the penetration, at which the alternation ends.
const CHANGE_TOLERANCE: f64 = 1e-7;
/// Most gradient steps for one set of tractions.
const GRADIENT_STEPS_MAX: usize = 4000;
/// Remaining slip, over the largest prescribed displacement, at which the gradient steps end.
const SLIP_TOLERANCE: f64 = 1e-7;
/// Looser tolerance of the slip while the normal displacement still changes: this factor on that
/// change, and this at most.
const LOOSE_SLIP_TOLERANCE: f64 = 1e-3;
/// A cell whose traction is within this part of its limit slides.
const STICK_MARGIN: f64 = 1e-6;

/// The rigid motion of a body along the surface from one step to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BodyMotion {
    /// Displacement along x and y, mm.
    pub shift_mm: [f64; 2],
    /// Rotation about z through the grid's centre, rad.
    pub turn_rad: f64,
}

/// Contact status of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// No pressure.
    Apart,
    /// It moves with the body.
    Sticks,
    /// Its traction is at the limit.
    Slides,
}

/// Forces, areas and accuracy of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GripState {
    /// State of the normal contact.
    pub pressed: SurfaceState,
    /// Force on the layer along x and y, N.
    pub force_n: [f64; 2],
    /// Torque on the layer about z through the grid's middle, N mm.
    pub torque_n_mm: f64,
    /// Area that sticks, and area that slides, mm^2.
    pub area_mm2: [f64; 2],
    /// Error of the friction law as a slip, over the largest prescribed displacement.
    pub residual: f64,
    /// Alternations between pressure and traction.
    pub turns: usize,
}

/// Tractions along x and y, or displacements.
type Field = [Vec<f64>; 2];

/// A body in frictional contact with the layer, with the memory of its previous step.
#[derive(Clone, Debug)]
pub struct Grip {
    cells: Cells,
    surface: Surface,
    friction: f64,
    /// Displacement along x per traction along x, and along y per traction along y.
    direct: [Convolution; 2],
    /// Displacement along one axis per traction along the other.
    cross: Convolution,
    /// Downward displacement per traction along x and along y.
    normal_kernels: [Convolution; 2],
    /// Upper bound of the largest eigenvalue of the compliance: the inverse of the gradient step.
    compliance_max: f64,
    traction: Field,
    /// Displacement of the surface after the last step.
    displacement: Field,
    state: GripState,
}

impl Grip {
    /// A body that is not in contact. Tabulates the influence of tractions; allocates.
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
        // Cells are squares: the influence of a traction along y is that of one along x with the
        // axes exchanged.
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

    /// Presses the body, whose face is at `heights_mm` as in [`Surface::press`], after moving it by
    /// `motion` from its place at the last step. Allocates.
    ///
    /// # Errors
    /// The errors of [`Surface::press`], a motion that is not finite, and pressure and friction
    /// that do not converge. The step is then not taken.
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
            // `zip` below would drop surplus heights; pressing them reports the wrong count.
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
            // A body off the surface counts as apart only when the tractions have changed nothing:
            // it may touch again when the displacement by friction is gone.
            let apart = pressed.force_n == 0.0 && change == 0.0;
            if settled || apart {
                let mut state = self.grip_state(&traction, pressed);
                (state.residual, state.turns) = (residual, turn);
                if residual > 1e3 * SLIP_TOLERANCE || residual.is_nan() {
                    let what = format!(
                        "after the last iteration the slip still has an error of {residual:e}"
                    );
                    return Err(Invalid::new(
                        "friction",
                        what,
                        "move the body by a smaller distance in one step",
                    ));
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
        let what = format!("pressure and friction do not converge for {}", self.friction);
        Err(Invalid::new("friction", what, "give a smaller coefficient of friction"))
    }

    /// Displacement of the surface along itself under tangential tractions.
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

    /// Downward displacement of the surface under tangential tractions.
    fn normal_displacement(&mut self, traction: &Field) -> Vec<f64> {
        let [mut x, mut y] = traction.clone();
        self.normal_kernels[0].apply(&mut x);
        self.normal_kernels[1].apply(&mut y);
        x.iter_mut().zip(y).for_each(|(w, more)| *w += more);
        x
    }

    /// Displacement of the surface along itself under the pressure. By reciprocity its kernels are
    /// those of the downward displacement with the opposite sign.
    fn pressure_displacement(&mut self) -> Field {
        let pressure = self.surface.pressure_mpa();
        let mut displacement = [pressure.to_vec(), pressure.to_vec()];
        for (part, kernel) in displacement.iter_mut().zip(&mut self.normal_kernels) {
            kernel.apply(part);
            part.iter_mut().for_each(|u| *u = -*u);
        }
        displacement
    }

    /// Finds the tractions within their limits that displace the surface as `wanted` where they
    /// can. Returns the error of the friction law as a slip, over the largest displacement wanted.
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
            // Steps against the last change mean that the momentum overshoots: restart without it.
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

    /// Status of the cells, row by row.
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

    /// Adds the image of pressure and tractions to `image`, in MPa; the grid's centre is at
    /// `place_mm`. `sheared` is [`Shares::sheared`] of the array and of the array with rows and
    /// columns exchanged (for a square array twice the same). Allocates.
    ///
    /// # Errors
    /// An image of another length; a second array that is not the first one with rows and columns
    /// exchanged.
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
        // A load along y is a load along x once the axes are exchanged.
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

/// Status of a cell with a pressure and a traction.
fn status(pressure: f64, [x, y]: [f64; 2], friction: f64) -> Status {
    let limit = friction * pressure;
    match (x * x + y * y).sqrt() {
        _ if pressure <= 0.0 => Status::Apart,
        size if size < (1.0 - STICK_MARGIN) * limit => Status::Sticks,
        _ => Status::Slides,
    }
}
