//! General plane contact on a [`Bed`]: any profile, with stick and slip by Coulomb's law, step by
//! step along a path of loads. An active set: each place is apart, sticking or slipping, the linear
//! system of that guess is solved, and places that break their own rule change; it ends when none
//! does, so complementarity holds to the solver's rounding.
//!
//! A place that sticks keeps its distance along x from the indenter since the last step; small
//! steps follow the path, one large one is the answer to a single proportionate load. It refuses
//! loads that slide, topple or pull. It allocates when made, not in a step.

use super::bed::Bed;
pub use super::path::{Drive, Law, Status};
use super::path::{between, entering, stands};
use super::{Load, Refusal, is_sane};
use crate::numeric::elimination::LuMatrix;
use crate::{Invalid, finite};

/// Rounds of the active set, and of a last search that has the time.
const ROUNDS: [usize; 2] = [120, 1500];
/// Rounds that may change many places at once; from when on the first may be chosen (Murty's rule).
const BOLD: usize = 40;
const MURTY: usize = 500;
/// Parts of a step that does not settle at once.
const SHORTER: [u32; 4] = [2, 5, 13, 40];
/// What is tried last: parts, rounds, and whether nothing touches at first.
const PATIENT: [(u32, usize, bool); 5] = [
    (1, ROUNDS[1], false),
    (1, ROUNDS[1], true),
    (3, ROUNDS[1], false),
    (31, ROUNDS[1], true),
    (150, ROUNDS[1], false),
];
/// Most systems that one step may solve, all attempts at it together; fewer of more places than
/// this, in proportion.
const SOLVES: usize = 6000;
const PLACES: usize = 128;
/// What counts as a violation, in parts of the largest force and of the descent; at last more, for
/// places that all but touch.
const SLACK: [f64; 2] = [1e-11, 5e-10];

/// A rigid profile over a bed, and the state of each place.
#[derive(Clone, Debug)]
pub struct Grip {
    bed: Bed,
    /// Height of the profile over its lowest point at each place; infinite where there is none.
    height_mm: Vec<f64>,
    law: Law,
    status: Vec<Status>,
    p: Vec<f64>,
    q: Vec<f64>,
    /// Displacement along x less the indenter's, after the last step.
    held: Vec<f64>,
    rigid: [f64; 3],
    dense: LuMatrix,
    side: Vec<f64>,
    touching: Vec<usize>,
    sticking: Vec<usize>,
    residual: f64,
    /// Systems solved in this step.
    solves: usize,
    /// Status, and forces and places along x, of the last step.
    saved: (Vec<Status>, [Vec<f64>; 3]),
    saved_rigid: ([f64; 3], f64),
    next: Vec<Status>,
    last: Option<Drive>,
}

impl Grip {
    /// A profile over a bed, nothing touching.
    ///
    /// # Errors
    /// A bed that its check refuses; heights of another number, NaN or negative; a coefficient that
    /// is negative or NaN.
    pub fn new(bed: Bed, height_mm: Vec<f64>, law: Law) -> Result<Self, Invalid> {
        bed.check()?;
        let n = bed.count();
        if height_mm.len() != n || height_mm.iter().any(|h| h.is_nan() || *h < 0.0) {
            let what = format!("{} heights for {n} places, or one below 0", height_mm.len());
            return Err(Invalid::new("height_mm", what, "give one height, 0 or more, a place"));
        }
        match law {
            Law::Proportional(factor) => finite("friction", factor)?,
            Law::Coulomb(mu) if mu.is_nan() || mu < 0.0 => {
                let what = format!("{mu} is below 0");
                return Err(Invalid::new("coulomb", what, "give a coefficient of 0 or more"));
            }
            Law::Free | Law::Coulomb(_) => {}
        }
        Ok(Self {
            height_mm,
            law,
            status: vec![Status::Apart; n],
            p: vec![0.0; n],
            q: vec![0.0; n],
            held: vec![0.0; n],
            rigid: [0.0; 3],
            dense: LuMatrix::with_capacity(2 * n + 3),
            side: Vec::with_capacity(2 * n + 3),
            touching: Vec::with_capacity(n),
            sticking: Vec::with_capacity(n),
            residual: 0.0,
            solves: 0,
            saved: (vec![Status::Apart; n], [0; 3].map(|_| vec![0.0; n])),
            saved_rigid: ([0.0; 3], 0.0),
            next: vec![Status::Apart; n],
            last: None,
            bed,
        })
    }

    /// The bed.
    #[must_use]
    pub fn bed(&self) -> &Bed {
        &self.bed
    }

    /// What each place does.
    #[must_use]
    pub fn status(&self) -> &[Status] {
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

    /// Largest violation of a rule in the last step, over the largest force and the descent.
    #[must_use]
    pub fn residual(&self) -> f64 {
        self.residual
    }

    /// The load carried.
    #[must_use]
    pub fn load(&self) -> Load {
        Load { p_n_mm: self.p.iter().sum(), q_n_mm: self.q.iter().sum() }
    }

    /// The next step of the path. Does not allocate.
    ///
    /// # Errors
    /// See [`Refusal`]; the state stays that of the last step.
    pub fn step(&mut self, drive: &Drive) -> Result<(), Refusal> {
        let load = match *drive {
            Drive::Loads { load, height_mm } if is_sane(height_mm) => load,
            Drive::Upright(load) => load,
            Drive::Loads { .. } => return Err(Refusal::NotFinite),
            Drive::Move { .. } | Drive::Pose { .. } => Load { p_n_mm: 1.0, q_n_mm: 0.0 },
        };
        let pose = drive.pose();
        if !pose.is_none_or(|pose| pose.iter().all(|v| is_sane(*v))) {
            return Err(Refusal::NotFinite);
        }
        let pressed = load.presses()?;
        if let Law::Coulomb(mu) = self.law
            && load.q_n_mm.abs() > mu * load.p_n_mm * (1.0 - 1e-9)
            && load.q_n_mm != 0.0
        {
            return Err(Refusal::Slides);
        }
        stands(drive, &self.bed, &self.height_mm)?;
        let lifted = |pose: [f64; 3]| pose[1] == 0.0 && pose[0] <= 0.0;
        let open = !pressed || pose.is_some_and(lifted);
        if open {
            self.open(drive);
            self.last = Some(*drive);
            return Ok(());
        }
        self.save();
        self.solves = 0;
        let mut outcome = self.search(drive, ROUNDS[0]);
        // Where the active set goes round in circles, shorter steps help, then patience.
        let never_slips = self.law == Law::Coulomb(f64::INFINITY);
        let patient = PATIENT.into_iter().take(if never_slips { 2 } else { PATIENT.len() });
        let attempts = SHORTER.map(|parts| (parts, ROUNDS[0], false)).into_iter();
        for (parts, rounds, afresh) in attempts.chain(patient) {
            if outcome != Err(Refusal::Unsettled) || self.solves >= self.budget() {
                break;
            }
            self.restore();
            if afresh {
                self.status.fill(Status::Apart);
            }
            outcome = self.follow(drive, parts, rounds);
        }
        match outcome {
            Ok(()) => self.last = Some(*drive),
            Err(_) => self.restore(),
        }
        match outcome {
            Err(Refusal::Unsettled) if never_slips => Err(Refusal::Tears),
            _ => outcome,
        }
    }

    /// Systems solved in the last step.
    #[must_use]
    pub fn solves(&self) -> usize {
        self.solves
    }

    fn budget(&self) -> usize {
        SOLVES * PLACES / self.bed.count().max(PLACES)
    }

    fn save(&mut self) {
        self.saved.0.copy_from_slice(&self.status);
        for (to, from) in self.saved.1.iter_mut().zip([&self.p, &self.q, &self.held]) {
            to.copy_from_slice(from);
        }
        self.saved_rigid = (self.rigid, self.residual);
    }

    fn restore(&mut self) {
        self.status.copy_from_slice(&self.saved.0);
        let own = [&mut self.p, &mut self.q, &mut self.held];
        for (to, from) in own.into_iter().zip(&self.saved.1) {
            to.copy_from_slice(from);
        }
        (self.rigid, self.residual) = self.saved_rigid;
    }

    /// The straight path from the last step to this one in so many parts.
    fn follow(&mut self, drive: &Drive, parts: u32, rounds: usize) -> Result<(), Refusal> {
        let start = self.last;
        for k in 1..=parts {
            let f = f64::from(k) / f64::from(parts);
            self.search(&between(start, drive, f), rounds)?;
        }
        Ok(())
    }

    fn open(&mut self, drive: &Drive) {
        self.status.fill(Status::Apart);
        self.p.fill(0.0);
        self.q.fill(0.0);
        self.rigid = drive.pose().unwrap_or_default();
        let place = self.rigid[2];
        self.held.fill(-place);
        self.residual = 0.0;
    }

    /// The active set, from the last state.
    fn search(&mut self, drive: &Drive, rounds: usize) -> Result<(), Refusal> {
        if self.status.iter().all(|s| *s == Status::Apart) {
            // Start with everything near the lowest point, or the whole face.
            let deepest = self.height_mm.iter().copied().fold(f64::INFINITY, f64::min);
            let span = self.bed.x_mm[self.bed.count() - 1] - self.bed.x_mm[0];
            for (status, height) in self.status.iter_mut().zip(&self.height_mm) {
                if *height <= deepest + 1e-3 * span {
                    *status = Status::Stick;
                }
            }
        }
        for round in 0..rounds {
            if self.solves >= self.budget() {
                break;
            }
            self.solves += 1;
            self.solve(drive)?;
            if self.revise(round) == 0 {
                self.accept();
                return Ok(());
            }
            if drive.pose().is_none() && self.status.iter().all(|s| *s == Status::Apart) {
                // Lost everything: take the deepest place again.
                let lowest =
                    |a: &usize, b: &usize| self.height_mm[*a].total_cmp(&self.height_mm[*b]);
                if let Some(i) = (0..self.bed.count()).min_by(lowest) {
                    self.status[i] = Status::Stick;
                }
            }
        }
        Err(Refusal::Unsettled)
    }

    /// Forces and rigid motion for the present guess.
    fn solve(&mut self, drive: &Drive) -> Result<(), Refusal> {
        let n = self.bed.count();
        self.touching.clear();
        self.sticking.clear();
        for (i, status) in self.status.iter().enumerate() {
            if *status != Status::Apart {
                self.touching.push(i);
            }
            if *status == Status::Stick && matches!(self.law, Law::Coulomb(_)) {
                self.sticking.push(i);
            }
        }
        let (c, s) = (self.touching.len(), self.sticking.len());
        let size = c + s + 3;
        self.dense.reset(size);
        self.side.clear();
        for (r, &i) in self.touching.iter().enumerate() {
            let (down, cross) = (&self.bed.down_per_p[i * n..], &self.bed.down_per_q[i * n..]);
            let row = self.dense.row_mut(r);
            for (k, &j) in self.touching.iter().enumerate() {
                row[k] = down[j];
            }
            for (k, &j) in self.sticking.iter().enumerate() {
                row[c + k] = cross[j];
            }
            row[c + s] = -1.0;
            row[c + s + 1] = -self.bed.x_mm[i];
            self.side.push(-self.height_mm[i]);
        }
        for (r, &i) in self.sticking.iter().enumerate() {
            let (cross, along) = (&self.bed.along_per_p[i * n..], &self.bed.along_per_q[i * n..]);
            let row = self.dense.row_mut(c + r);
            for (k, &j) in self.touching.iter().enumerate() {
                row[k] = cross[j];
            }
            for (k, &j) in self.sticking.iter().enumerate() {
                row[c + k] = along[j];
            }
            row[c + s + 2] = -1.0;
            self.side.push(self.held[i]);
        }
        self.add_slip(c, s);
        self.add_drive(drive, c, s);
        self.dense.factor();
        self.dense.solve(&mut self.side);
        if !self.side.iter().all(|v| v.is_finite()) {
            return Err(Refusal::Unsettled);
        }
        self.p.fill(0.0);
        self.q.fill(0.0);
        for (k, &i) in self.touching.iter().enumerate() {
            self.p[i] = self.side[k];
            self.q[i] = self.law.shear(self.status[i]) * self.side[k];
        }
        for (k, &i) in self.sticking.iter().enumerate() {
            self.q[i] = self.side[c + k];
        }
        self.rigid.copy_from_slice(&self.side[c + s..]);
        Ok(())
    }

    /// Shear in proportion to pressure acts through the columns of the pressure.
    fn add_slip(&mut self, c: usize, s: usize) {
        let n = self.bed.count();
        for k in 0..c {
            let j = self.touching[k];
            let factor = self.law.shear(self.status[j]);
            if factor == 0.0 {
                continue;
            }
            for r in 0..c {
                let i = self.touching[r];
                self.dense.row_mut(r)[k] += factor * self.bed.down_per_q[i * n + j];
            }
            for r in 0..s {
                let i = self.sticking[r];
                self.dense.row_mut(c + r)[k] += factor * self.bed.along_per_q[i * n + j];
            }
        }
    }

    /// The last three equations: balance, or the motion prescribed.
    fn add_drive(&mut self, drive: &Drive, c: usize, s: usize) {
        let (wanted, force, tilts) = match *drive {
            Drive::Loads { load, height_mm } => {
                ([load.p_n_mm, load.q_n_mm * height_mm, load.q_n_mm], true, true)
            }
            Drive::Upright(load) => ([load.p_n_mm, 0.0, load.q_n_mm], true, false),
            Drive::Move { .. } | Drive::Pose { .. } => {
                (drive.pose().unwrap_or_default(), false, false)
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
                        1 => self.bed.x_mm[j],
                        _ => match (self.law, self.status[j]) {
                            (Law::Coulomb(mu), Status::SlipForward) => mu,
                            (Law::Coulomb(mu), Status::SlipBack) => -mu,
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

    /// Changes the status of places that break their rule; how many did.
    fn revise(&mut self, round: usize) -> usize {
        let n = self.bed.count();
        let largest = self.p.iter().fold(0.0_f64, |most, p| most.max(p.abs()));
        let [descent, tilt, place] = self.rigid;
        let depth = descent.abs() + tilt.abs() * self.bed.x_mm[n - 1].abs();
        let (mut changed, mut worst) = (0, 0.0_f64);
        let slack = SLACK[usize::from(round >= 2 * MURTY)];
        for i in 0..n {
            let was = self.status[i];
            let sum = |a: &[f64], b: &[f64]| -> f64 {
                let forces = self.p.iter().zip(&self.q);
                let pairs = a[i * n..][..n].iter().zip(&b[i * n..][..n]);
                pairs.zip(forces).map(|((a, b), (p, q))| a * p + b * q).sum()
            };
            let now = if was == Status::Apart {
                let surface = sum(&self.bed.down_per_p, &self.bed.down_per_q);
                let gap = self.height_mm[i] - descent - tilt * self.bed.x_mm[i] + surface;
                worst = worst.max(-gap / depth.max(f64::MIN_POSITIVE));
                if gap < -slack * depth { entering(&self.status, i) } else { was }
            } else if self.p[i] < -slack * largest {
                worst = worst.max(-self.p[i] / largest);
                Status::Apart
            } else if let Law::Coulomb(mu) = self.law {
                let limit = mu * self.p[i].max(0.0);
                if was == Status::Stick {
                    let over = self.q[i].abs() - limit;
                    worst = worst.max(over / largest);
                    match over > slack * largest {
                        true if self.q[i] > 0.0 => Status::SlipForward,
                        true => Status::SlipBack,
                        false => was,
                    }
                } else {
                    let along = sum(&self.bed.along_per_p, &self.bed.along_per_q);
                    let moved = along - place - self.held[i];
                    let wrong = if was == Status::SlipForward { moved } else { -moved };
                    if wrong > slack * depth { Status::Stick } else { was }
                }
            } else {
                was
            };
            changed += usize::from(now != was);
            self.next[i] = now;
        }
        // First who touches, then who slips: the two at once go round in circles.
        let turns = |(a, b): (&Status, &Status)| (*a == Status::Apart) != (*b == Status::Apart);
        let normal = self.status.iter().zip(&self.next).any(turns);
        // Late rounds change one place at a time, drawn, at last every other time the first.
        if round < BOLD || changed == 0 {
            for (was, now) in self.status.iter_mut().zip(&self.next) {
                if !normal || turns((was, now)) {
                    *was = *now;
                }
            }
        } else {
            let drawn = (round as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40;
            let first = round >= MURTY && round.is_multiple_of(2);
            let chosen = if first { 0 } else { drawn as usize % changed };
            let pairs = self.status.iter_mut().zip(&self.next);
            if let Some((was, now)) = pairs.filter(|(was, now)| was != now).nth(chosen) {
                *was = *now;
            }
        }
        self.residual = worst.max(0.0);
        changed
    }

    /// Keeps the relative places along x for the next step.
    fn accept(&mut self) {
        let n = self.bed.count();
        let place = self.rigid[2];
        for i in 0..n {
            let row = self.bed.along_per_p[i * n..].iter().zip(&self.bed.along_per_q[i * n..]);
            let forces = self.p.iter().zip(&self.q);
            let along: f64 = row.zip(forces).map(|((a, b), (p, q))| a * p + b * q).sum();
            self.held[i] = along - place;
        }
    }
}
