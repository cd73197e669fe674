//! Plane contact with friction of any profile on a [`SurfaceCompliance`]: stick and slip by
//! Coulomb's law, step by step along a path of loads. An active-set method: each place is apart,
//! sticking or slipping; the linear system of that guess is solved, and places that violate the
//! condition of their status change it. The method ends when none does, so that complementarity
//! holds to the solver's rounding.
//!
//! A place that sticks keeps its distance along x from the indenter since the last step. Small
//! steps follow the path of the loads; one large step is the solution of a single proportional
//! load. Loads under which the indenter slides, topples or is pulled off are refused. Steps do not
//! allocate.

mod status_update;

use super::compliance::SurfaceCompliance;
pub use super::load_step::{ContactStatus, FrictionLaw, LoadStep};
use super::load_step::{check_resultant, interpolate};
use super::{Load, Refusal, is_in_range};
use crate::numeric::elimination::LuMatrix;
use crate::{Invalid, finite};

/// Most rounds of the active set, first in an ordinary attempt, then in one of the last attempts.
const ROUNDS_MAX: [usize; 2] = [120, 1500];
/// Numbers of substeps into which a step is divided that does not converge at once.
const SUBSTEP_COUNTS: [u32; 4] = [2, 5, 13, 40];
/// The attempts that follow if no number of substeps converges: more rounds, from the last state or
/// from one in which no place touches.
const LAST_ATTEMPTS: [Attempt; 5] = [
    Attempt { substeps: 1, rounds: ROUNDS_MAX[1], from_separation: false },
    Attempt { substeps: 1, rounds: ROUNDS_MAX[1], from_separation: true },
    Attempt { substeps: 3, rounds: ROUNDS_MAX[1], from_separation: false },
    Attempt { substeps: 31, rounds: ROUNDS_MAX[1], from_separation: true },
    Attempt { substeps: 150, rounds: ROUNDS_MAX[1], from_separation: false },
];
/// Most linear systems that one step solves in all its attempts, for up to so many places; with
/// more places proportionally fewer.
const SOLVES_MAX: usize = 6000;
const REFERENCE_PLACES: usize = 128;
/// One attempt at a step.
#[derive(Clone, Copy)]
struct Attempt {
    substeps: u32,
    rounds: usize,
    /// Whether no place touches at first.
    from_separation: bool,
}

/// A rigid profile over the surface, and the status of each place.
#[derive(Clone, Debug)]
pub struct FrictionalContact {
    compliance: SurfaceCompliance,
    /// Height of the profile over its lowest point at each place; infinite where there is none.
    height_mm: Vec<f64>,
    law: FrictionLaw,
    status: Vec<ContactStatus>,
    p: Vec<f64>,
    q: Vec<f64>,
    /// Displacement along x less the indenter's, after the last step.
    stick_offset: Vec<f64>,
    rigid: [f64; 3],
    dense: LuMatrix,
    side: Vec<f64>,
    touching: Vec<usize>,
    sticking: Vec<usize>,
    residual: f64,
    /// Systems solved in this step.
    solves: usize,
    /// Status, forces and displacements along x of all places in the last step.
    saved: (Vec<ContactStatus>, [Vec<f64>; 3]),
    saved_rigid: ([f64; 3], f64),
    next: Vec<ContactStatus>,
    last: Option<LoadStep>,
}

impl FrictionalContact {
    /// A profile over the surface, with no place in contact.
    ///
    /// # Errors
    /// Compliances that their check refuses; heights of another number, NaN or negative; a
    /// coefficient that is negative or NaN.
    pub fn new(
        compliance: SurfaceCompliance,
        height_mm: Vec<f64>,
        law: FrictionLaw,
    ) -> Result<Self, Invalid> {
        compliance.check()?;
        let n = compliance.count();
        if height_mm.len() != n || height_mm.iter().any(|h| h.is_nan() || *h < 0.0) {
            let what = format!("{} heights for {n} places, or one below 0", height_mm.len());
            return Err(Invalid::new("height_mm", what, "give one height, 0 or more, a place"));
        }
        match law {
            FrictionLaw::Proportional(factor) => finite("friction", factor)?,
            FrictionLaw::Coulomb(mu) if mu.is_nan() || mu < 0.0 => {
                let what = format!("{mu} is below 0");
                return Err(Invalid::new("coulomb", what, "give a coefficient of 0 or more"));
            }
            FrictionLaw::Free | FrictionLaw::Coulomb(_) => {}
        }
        Ok(Self {
            height_mm,
            law,
            status: vec![ContactStatus::Apart; n],
            p: vec![0.0; n],
            q: vec![0.0; n],
            stick_offset: vec![0.0; n],
            rigid: [0.0; 3],
            dense: LuMatrix::with_capacity(2 * n + 3),
            side: Vec::with_capacity(2 * n + 3),
            touching: Vec::with_capacity(n),
            sticking: Vec::with_capacity(n),
            residual: 0.0,
            solves: 0,
            saved: (vec![ContactStatus::Apart; n], [0; 3].map(|_| vec![0.0; n])),
            saved_rigid: ([0.0; 3], 0.0),
            next: vec![ContactStatus::Apart; n],
            last: None,
            compliance,
        })
    }

    /// The compliances of the surface.
    #[must_use]
    pub fn compliance(&self) -> &SurfaceCompliance {
        &self.compliance
    }

    /// Status of each place.
    #[must_use]
    pub fn status(&self) -> &[ContactStatus] {
        &self.status
    }

    /// Normal forces on the layer in N/mm, one a place.
    #[must_use]
    pub fn normal_n_mm(&self) -> &[f64] {
        &self.p
    }

    /// Tangential forces on the layer in N/mm.
    #[must_use]
    pub fn tangential_n_mm(&self) -> &[f64] {
        &self.q
    }

    /// Descent at x = 0 (mm), tilt, and place along x (mm) of the indenter.
    #[must_use]
    pub fn rigid(&self) -> [f64; 3] {
        self.rigid
    }

    /// Largest violation of a contact condition in the last step, relative to the largest force or
    /// the descent.
    #[must_use]
    pub fn residual(&self) -> f64 {
        self.residual
    }

    /// The load that the contact carries.
    #[must_use]
    pub fn load(&self) -> Load {
        Load { p_n_mm: self.p.iter().sum(), q_n_mm: self.q.iter().sum() }
    }

    /// The next step of the path. Does not allocate.
    ///
    /// # Errors
    /// See [`Refusal`]; the state stays that of the last step.
    pub fn step(&mut self, step: &LoadStep) -> Result<(), Refusal> {
        let load = match *step {
            LoadStep::Loads { load, height_mm } if is_in_range(height_mm) => load,
            LoadStep::Upright(load) => load,
            LoadStep::Loads { .. } => return Err(Refusal::NotFinite),
            LoadStep::Move { .. } | LoadStep::Pose { .. } => Load { p_n_mm: 1.0, q_n_mm: 0.0 },
        };
        let pose = step.pose();
        if !pose.is_none_or(|pose| pose.iter().all(|v| is_in_range(*v))) {
            return Err(Refusal::NotFinite);
        }
        let pressed = load.is_pressing()?;
        if let FrictionLaw::Coulomb(mu) = self.law
            && load.q_n_mm.abs() > mu * load.p_n_mm * (1.0 - 1e-9)
            && load.q_n_mm != 0.0
        {
            return Err(Refusal::Sliding);
        }
        check_resultant(step, &self.compliance, &self.height_mm)?;
        let lifted = |pose: [f64; 3]| pose[1] == 0.0 && pose[0] <= 0.0;
        let open = !pressed || pose.is_some_and(lifted);
        if open {
            self.separate(step);
            self.last = Some(*step);
            return Ok(());
        }
        self.save();
        self.solves = 0;
        let mut outcome = self.find_active_set(step, ROUNDS_MAX[0]);
        // If the active set cycles, shorter steps are tried first, and then more rounds.
        let never_slips = self.law == FrictionLaw::Coulomb(f64::INFINITY);
        let last =
            LAST_ATTEMPTS.into_iter().take(if never_slips { 2 } else { LAST_ATTEMPTS.len() });
        let attempt =
            |substeps| Attempt { substeps, rounds: ROUNDS_MAX[0], from_separation: false };
        for Attempt { substeps, rounds, from_separation } in
            SUBSTEP_COUNTS.map(attempt).into_iter().chain(last)
        {
            if outcome != Err(Refusal::NotConverged) || self.solves >= self.budget() {
                break;
            }
            self.restore();
            if from_separation {
                self.status.fill(ContactStatus::Apart);
            }
            outcome = self.follow_path(step, substeps, rounds);
        }
        match outcome {
            Ok(()) => self.last = Some(*step),
            Err(_) => self.restore(),
        }
        match outcome {
            Err(Refusal::NotConverged) if never_slips => Err(Refusal::EdgeSeparation),
            _ => outcome,
        }
    }

    /// Systems solved in the last step.
    #[must_use]
    pub fn solves(&self) -> usize {
        self.solves
    }

    fn budget(&self) -> usize {
        SOLVES_MAX * REFERENCE_PLACES / self.compliance.count().max(REFERENCE_PLACES)
    }

    fn save(&mut self) {
        self.saved.0.copy_from_slice(&self.status);
        for (to, from) in self.saved.1.iter_mut().zip([&self.p, &self.q, &self.stick_offset]) {
            to.copy_from_slice(from);
        }
        self.saved_rigid = (self.rigid, self.residual);
    }

    fn restore(&mut self) {
        self.status.copy_from_slice(&self.saved.0);
        let own = [&mut self.p, &mut self.q, &mut self.stick_offset];
        for (to, from) in own.into_iter().zip(&self.saved.1) {
            to.copy_from_slice(from);
        }
        (self.rigid, self.residual) = self.saved_rigid;
    }

    /// Follows the straight path from the last step to this one in equal parts.
    fn follow_path(&mut self, step: &LoadStep, parts: u32, rounds: usize) -> Result<(), Refusal> {
        let start = self.last;
        for k in 1..=parts {
            let f = f64::from(k) / f64::from(parts);
            self.find_active_set(&interpolate(start, step, f), rounds)?;
        }
        Ok(())
    }

    fn separate(&mut self, step: &LoadStep) {
        self.status.fill(ContactStatus::Apart);
        self.p.fill(0.0);
        self.q.fill(0.0);
        self.rigid = step.pose().unwrap_or_default();
        let place = self.rigid[2];
        self.stick_offset.fill(-place);
        self.residual = 0.0;
    }

    /// Iterates the active set from the last state.
    fn find_active_set(&mut self, step: &LoadStep, rounds: usize) -> Result<(), Refusal> {
        if self.status.iter().all(|s| *s == ContactStatus::Apart) {
            // Start with everything near the lowest point, or the whole face.
            let deepest = self.height_mm.iter().copied().fold(f64::INFINITY, f64::min);
            let span = self.compliance.x_mm[self.compliance.count() - 1] - self.compliance.x_mm[0];
            for (status, height) in self.status.iter_mut().zip(&self.height_mm) {
                if *height <= deepest + 1e-3 * span {
                    *status = ContactStatus::Stick;
                }
            }
        }
        for round in 0..rounds {
            if self.solves >= self.budget() {
                break;
            }
            self.solves += 1;
            self.solve_status(step)?;
            if self.update_status(round) == 0 {
                self.store_offsets();
                return Ok(());
            }
            if step.pose().is_none() && self.status.iter().all(|s| *s == ContactStatus::Apart) {
                // Without a place in contact no load can be carried, so the deepest place comes
                // into contact again.
                let lowest =
                    |a: &usize, b: &usize| self.height_mm[*a].total_cmp(&self.height_mm[*b]);
                if let Some(i) = (0..self.compliance.count()).min_by(lowest) {
                    self.status[i] = ContactStatus::Stick;
                }
            }
        }
        Err(Refusal::NotConverged)
    }

    /// Solves for forces and rigid motion with the present status of the places.
    fn solve_status(&mut self, step: &LoadStep) -> Result<(), Refusal> {
        let n = self.compliance.count();
        self.touching.clear();
        self.sticking.clear();
        for (i, status) in self.status.iter().enumerate() {
            if *status != ContactStatus::Apart {
                self.touching.push(i);
            }
            if *status == ContactStatus::Stick && matches!(self.law, FrictionLaw::Coulomb(_)) {
                self.sticking.push(i);
            }
        }
        let (c, s) = (self.touching.len(), self.sticking.len());
        let size = c + s + 3;
        self.dense.reset(size);
        self.side.clear();
        for (r, &i) in self.touching.iter().enumerate() {
            let (down, cross) =
                (&self.compliance.down_per_p[i * n..], &self.compliance.down_per_q[i * n..]);
            let row = self.dense.row_mut(r);
            for (k, &j) in self.touching.iter().enumerate() {
                row[k] = down[j];
            }
            for (k, &j) in self.sticking.iter().enumerate() {
                row[c + k] = cross[j];
            }
            row[c + s] = -1.0;
            row[c + s + 1] = -self.compliance.x_mm[i];
            self.side.push(-self.height_mm[i]);
        }
        for (r, &i) in self.sticking.iter().enumerate() {
            let (cross, along) =
                (&self.compliance.along_per_p[i * n..], &self.compliance.along_per_q[i * n..]);
            let row = self.dense.row_mut(c + r);
            for (k, &j) in self.touching.iter().enumerate() {
                row[k] = cross[j];
            }
            for (k, &j) in self.sticking.iter().enumerate() {
                row[c + k] = along[j];
            }
            row[c + s + 2] = -1.0;
            self.side.push(self.stick_offset[i]);
        }
        self.add_slip(c, s);
        self.add_load_step(step, c, s);
        self.dense.factor();
        self.dense.solve(&mut self.side);
        if !self.side.iter().all(|v| v.is_finite()) {
            return Err(Refusal::NotConverged);
        }
        self.p.fill(0.0);
        self.q.fill(0.0);
        for (k, &i) in self.touching.iter().enumerate() {
            self.p[i] = self.side[k];
            self.q[i] = self.law.shear_ratio(self.status[i]) * self.side[k];
        }
        for (k, &i) in self.sticking.iter().enumerate() {
            self.q[i] = self.side[c + k];
        }
        self.rigid.copy_from_slice(&self.side[c + s..]);
        Ok(())
    }

    /// Shear in proportion to pressure acts through the columns of the pressure.
    fn add_slip(&mut self, c: usize, s: usize) {
        let n = self.compliance.count();
        for k in 0..c {
            let j = self.touching[k];
            let factor = self.law.shear_ratio(self.status[j]);
            if factor == 0.0 {
                continue;
            }
            for r in 0..c {
                let i = self.touching[r];
                self.dense.row_mut(r)[k] += factor * self.compliance.down_per_q[i * n + j];
            }
            for r in 0..s {
                let i = self.sticking[r];
                self.dense.row_mut(c + r)[k] += factor * self.compliance.along_per_q[i * n + j];
            }
        }
    }

    /// Adds the last three equations: the balance of the loads, or the prescribed motion.
    fn add_load_step(&mut self, step: &LoadStep, c: usize, s: usize) {
        let (wanted, force, tilts) = match *step {
            LoadStep::Loads { load, height_mm } => {
                ([load.p_n_mm, load.q_n_mm * height_mm, load.q_n_mm], true, true)
            }
            LoadStep::Upright(load) => ([load.p_n_mm, 0.0, load.q_n_mm], true, false),
            LoadStep::Move { .. } | LoadStep::Pose { .. } => {
                (step.pose().unwrap_or_default(), false, false)
            }
        };
        for (equation, value) in wanted.into_iter().enumerate() {
            let balances = match equation {
                0 => force,
                1 => tilts,
                _ => force && s > 0,
            };
            let row = self.dense.row_mut(c + s + equation);
            if balances {
                for (k, &j) in self.touching.iter().enumerate() {
                    row[k] = match equation {
                        0 => 1.0,
                        1 => self.compliance.x_mm[j],
                        _ => match (self.law, self.status[j]) {
                            (FrictionLaw::Coulomb(mu), ContactStatus::SlipForward) => mu,
                            (FrictionLaw::Coulomb(mu), ContactStatus::SlipBack) => -mu,
                            _ => 0.0,
                        },
                    };
                }
                if equation == 2 {
                    row[c..c + s].fill(1.0);
                }
                self.side.push(value);
            } else {
                row[c + s + equation] = 1.0;
                self.side.push(if force { 0.0 } else { value });
            }
        }
    }

    /// Stores the displacements relative to the indenter for the next step.
    fn store_offsets(&mut self) {
        let n = self.compliance.count();
        let place = self.rigid[2];
        for i in 0..n {
            let row = self.compliance.along_per_p[i * n..]
                .iter()
                .zip(&self.compliance.along_per_q[i * n..]);
            let forces = self.p.iter().zip(&self.q);
            let along: f64 = row.zip(forces).map(|((a, b), (p, q))| a * p + b * q).sum();
            self.stick_offset[i] = along - place;
        }
    }
}
