//! Solves the flat bar, whose whole face touches or one of whose corners is lifted, from the
//! equilibrium of forces and moments.

use super::{Contact, Friction, Indenter, Load, Mode, Refusal};
use crate::numeric::roots::BracketedSearch;

/// Most solutions of the search for a lifted edge.
const EDGE_ITERATIONS_MAX: usize = 60;
/// Tension inside a contact above which it counts as one, in parts of the mean pressure: the error
/// of each [`crate::Accuracy`].
const TENSION_TOLERANCE: [f64; 3] = [5e-3, 1e-5, 1e-8];
/// Farthest extrapolation of the edge, in steps between the last two loads.
const EXTRAPOLATION_STEPS_MAX: f64 = 4.0;

impl Indenter {
    pub(super) fn solve_bar(
        &mut self,
        width_mm: f64,
        height_mm: f64,
        load: &Load,
    ) -> Result<Contact, Refusal> {
        let t = self.layer.thickness_mm;
        let (half, unit) = (0.5 * width_mm / t, self.modulus_mpa() * t);
        let force = load.p_n_mm / unit;
        // Place of the pressure's resultant, which the moment of Q dictates.
        let place = load.q_n_mm * height_mm / load.p_n_mm / t;
        if place.abs() >= half {
            return Err(Refusal::Toppling);
        }
        let ratio = self.ratio(load);
        let lifted = self.guess.is_some_and(|guess| guess[0] < libm::log(half) - 1e-9);
        if !lifted {
            let ends = self.solve_face(half, 0.0, force, place, ratio)?;
            if ends[0] >= 0.0 && ends[1] >= 0.0 {
                self.guess = None;
                return Ok(self.bar_contact(load, half, 0.0, Mode::Full));
            }
        }
        self.solve_lifted_edge(load, half, force, place, ratio)
    }

    /// Whether the last contact would need tension between its edges.
    pub(super) fn has_tension(&self) -> bool {
        let Contact { p_n_mm, mode, .. } = self.contact;
        if self.friction == Friction::None || matches!(mode, Mode::Open | Mode::Free) {
            return false;
        }
        let force = p_n_mm / (self.modulus_mpa() * self.layer.thickness_mm);
        let mean = force / (core::f64::consts::PI * self.interval.half());
        let least = self.phi.iter().copied().fold(f64::INFINITY, f64::min);
        least < -TENSION_TOLERANCE[self.accuracy as usize] * mean
    }

    /// Solves on an interval for force and place of the resultant; gives the edges' strengths over
    /// the mean one, left and right. `phi` holds the pressure, `work[0]` that of a unit slope.
    fn solve_face(
        &mut self,
        half: f64,
        centre: f64,
        force: f64,
        place: f64,
        ratio: f64,
    ) -> Result<[f64; 2], Refusal> {
        self.assemble(half, ratio)?;
        let (interval, [tilt, _]) = (&self.interval, &mut self.work);
        interval.solve(force, |_| 0.0, &mut self.phi);
        interval.solve(0.0, |_| 1.0, tilt);
        let lever = force * (place - centre) - interval.moment(&self.phi);
        let slope = lever / interval.moment(tilt);
        for (p, t) in self.phi.iter_mut().zip(tilt.iter()) {
            *p += slope * t;
        }
        self.contact.slope = slope;
        let mean = force / (core::f64::consts::PI * half);
        let ends = [-1.0, 1.0].map(|xi| interval.at(&self.phi, xi) / mean);
        if ends.iter().all(|end| end.is_finite()) { Ok(ends) } else { Err(Refusal::NotConverged) }
    }

    /// One edge free: its place from a pressure that vanishes there.
    fn solve_lifted_edge(
        &mut self,
        load: &Load,
        half: f64,
        force: f64,
        place: f64,
        ratio: f64,
    ) -> Result<Contact, Refusal> {
        let side = if place > 0.0 { 1.0 } else { -1.0 };
        let free = if place > 0.0 { 0 } else { 1 };
        // In the half plane a narrow contact is 4 times as wide as the resultant's distance from
        // the corner; y is the logarithm of the half-width in thicknesses.
        let top = libm::log(half);
        let (mut y, mut slope) = match self.guess {
            Some([y, slope]) if y < top => {
                (self.extrapolated_edge(place, y).min(top - 1e-6), slope)
            }
            _ => ((libm::log(2.0 * (half - place.abs()))).min(top - 0.01), 2.0),
        };
        let tolerance = match self.accuracy {
            super::Accuracy::Fast => 2e-4,
            super::Accuracy::Default => 1e-9,
            super::Accuracy::Fine => 1e-12,
        };
        let mut search = BracketedSearch::new();
        let mut before: Option<[f64; 2]> = None;
        for _ in 0..EDGE_ITERATIONS_MAX {
            let h = libm::exp(y);
            let centre = side * (half - h);
            // A negative strength at the free edge means that the contact is narrower.
            let miss = -self.solve_face(h, centre, force, place, ratio)?[free];
            if let Some([y0, miss0]) = before
                && y != y0
            {
                slope = (miss - miss0) / (y - y0);
            }
            if !(slope.is_finite() && slope.abs() > 1e-3) {
                slope = 2.0;
            }
            let step = -miss / slope.abs();
            let settled = miss.abs() < tolerance || step.abs() < 1e-15 * y.abs().max(1.0);
            if settled && y <= top {
                if y >= top - 1e-12 {
                    self.guess = None;
                    return Ok(self.bar_contact(load, half, 0.0, Mode::Full));
                }
                self.guess = Some([y, slope]);
                self.record_edge(place, y);
                let mode = if free == 0 { Mode::LeftLifted } else { Mode::RightLifted };
                return Ok(self.bar_contact(load, h, centre, mode));
            }
            before = Some([y, miss]);
            y = search.next(y, miss, y + step.clamp(-2.0, 2.0));
            if y >= top {
                // The edge would lie beyond the bar's corner: the whole face may touch after all.
                let ends = self.solve_face(half, 0.0, force, place, ratio)?;
                if ends[free] >= 0.0 {
                    self.guess = None;
                    return Ok(self.bar_contact(load, half, 0.0, Mode::Full));
                }
                y = search.next(top, -ends[free], 0.5 * (top + before.map_or(top, |b| b[0])));
            }
        }
        Err(Refusal::NotConverged)
    }

    /// The edge at a place of the loads, along the line through the last two: it depends on that
    /// place alone, since the force scales everything and friction goes with the place.
    fn extrapolated_edge(&self, place: f64, y: f64) -> f64 {
        let [Some([older, low]), Some([newer, high])] = self.edge_history else { return y };
        let (run, step) = (newer - older, place - newer);
        if step.abs() <= 1e-13 * place.abs() || step.abs() > EXTRAPOLATION_STEPS_MAX * run.abs() {
            return y;
        }
        let ahead = step * (high - low) / run;
        if ahead.abs() < 0.3 { high + ahead } else { y }
    }

    /// Remembers where the edge was for a place of the loads; places too near each other to show a
    /// slope replace each other.
    fn record_edge(&mut self, place: f64, y: f64) {
        let near = |old: &[f64; 2]| (old[0] - place).abs() <= 1e-6 * place.abs();
        if !self.edge_history[1].as_ref().is_some_and(near) {
            self.edge_history[0] = self.edge_history[1];
        }
        self.edge_history[1] = Some([place, y]);
    }

    fn bar_contact(&mut self, load: &Load, half: f64, centre: f64, mode: Mode) -> Contact {
        let t = self.layer.thickness_mm;
        let slope = self.contact.slope;
        let descent = self.interval.mean_descent(&self.kernels, &self.phi);
        let mean_place = centre + half * self.interval.mean(|xi| xi);
        let force = load.p_n_mm / (self.modulus_mpa() * t);
        let mut residual = (self.interval.total(&self.phi) / force - 1.0).abs();
        let mean = force / (core::f64::consts::PI * half);
        let free = match mode {
            Mode::LeftLifted => self.interval.at(&self.phi, -1.0) / mean,
            Mode::RightLifted => self.interval.at(&self.phi, 1.0) / mean,
            Mode::Full | Mode::Free | Mode::Open => 0.0,
        };
        residual = residual.max(free.abs());
        Contact {
            p_n_mm: load.p_n_mm,
            q_n_mm: load.q_n_mm,
            delta_mm: (descent - slope * mean_place) * t,
            slope,
            x_left_mm: (centre - half) * t,
            x_right_mm: (centre + half) * t,
            mode,
            residual,
        }
    }

    /// The whole face at a descent, upright.
    pub(super) fn solve_bar_descent(
        &mut self,
        width_mm: f64,
        dz_mm: f64,
    ) -> Result<Contact, Refusal> {
        let t = self.layer.thickness_mm;
        let half = 0.5 * width_mm / t;
        self.assemble(half, 0.0)?;
        self.interval.solve(1.0, |_| 0.0, &mut self.phi);
        let per_force = self.interval.mean_descent(&self.kernels, &self.phi);
        let force = dz_mm / t / per_force;
        self.phi.iter_mut().for_each(|p| *p *= force);
        self.contact.slope = 0.0;
        let load = Load { p_n_mm: force * self.modulus_mpa() * t, q_n_mm: 0.0 };
        Ok(self.bar_contact(&load, half, 0.0, Mode::Full))
    }
}
