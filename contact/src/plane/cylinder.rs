//! Solves the cylinder and its parabola, whose two free edges are found from a pressure that
//! vanishes at both.

use super::{Contact, Indenter, Load, Mode, Refusal, Shape};
use crate::Accuracy;
use crate::numeric::roots::BracketedSearch;

/// Most solutions of the search for the half-width and, under friction, for the offset.
const WIDTH_ITERATIONS_MAX: usize = 60;
const OFFSET_ITERATIONS_MAX: usize = 30;
/// Widest contact in radii of the circle.
const HALF_WIDTH_MAX_RADII: f64 = 0.98;

/// The profile in thicknesses.
#[derive(Clone, Copy)]
struct Profile {
    radius: f64,
    round: bool,
}

impl Profile {
    fn height(&self, x: f64) -> f64 {
        if !self.round {
            return 0.5 * x * x / self.radius;
        }
        x * x / (self.radius + (self.radius * self.radius - x * x).max(0.0).sqrt())
    }

    fn slope(&self, x: f64) -> f64 {
        if !self.round {
            return x / self.radius;
        }
        x / ((self.radius - x) * (self.radius + x)).max(f64::MIN_POSITIVE).sqrt()
    }
}

/// The prescribed quantity, in units of the solver.
#[derive(Clone, Copy)]
enum Target {
    Force(f64),
    Descent(f64),
}

/// The contact of a half-width that the search tries.
struct Trial {
    force: f64,
    descent: f64,
    /// Middle of the contact from the cylinder's lowest point.
    centre: f64,
    edge: f64,
}

impl Indenter {
    fn profile(&self) -> Profile {
        let t = self.layer.thickness_mm;
        match self.shape {
            Shape::Cylinder { radius_mm } => Profile { radius: radius_mm / t, round: true },
            Shape::Parabola { radius_mm } => Profile { radius: radius_mm / t, round: false },
            Shape::Flat { width_mm, .. } => Profile { radius: width_mm / t, round: false },
        }
    }

    pub(super) fn solve_cylinder(&mut self, load: &Load) -> Result<Contact, Refusal> {
        let force = load.p_n_mm / (self.modulus_mpa() * self.layer.thickness_mm);
        let ratio = self.ratio(load);
        let radius = self.profile().radius;
        // Hertz: a^2 = 2 P R/pi in these units.
        let cold = 0.5 * libm::log(2.0 * force * radius);
        let trial = self.find_half_width(Target::Force(force), ratio, cold)?;
        Ok(self.cylinder_contact(load, &trial))
    }

    pub(super) fn solve_cylinder_descent(&mut self, dz_mm: f64) -> Result<Contact, Refusal> {
        let t = self.layer.thickness_mm;
        let cold = 0.5 * libm::log(1.5 * self.profile().radius * dz_mm / t);
        let trial = self.find_half_width(Target::Descent(dz_mm / t), 0.0, cold)?;
        let load = Load { p_n_mm: trial.force * self.modulus_mpa() * t, q_n_mm: 0.0 };
        Ok(self.cylinder_contact(&load, &trial))
    }

    fn cylinder_contact(&self, load: &Load, trial: &Trial) -> Contact {
        let t = self.layer.thickness_mm;
        let half = self.interval.half();
        let force = load.p_n_mm / (self.modulus_mpa() * t);
        let balance = (self.interval.total(&self.phi) / force - 1.0).abs();
        Contact {
            p_n_mm: load.p_n_mm,
            q_n_mm: load.q_n_mm,
            delta_mm: trial.descent * t,
            slope: 0.0,
            x_left_mm: (trial.centre - half) * t,
            x_right_mm: (trial.centre + half) * t,
            mode: Mode::Free,
            residual: balance.max(trial.edge),
        }
    }

    fn find_half_width(&mut self, target: Target, ratio: f64, cold: f64) -> Result<Trial, Refusal> {
        let profile = self.profile();
        let steepest =
            if profile.round { HALF_WIDTH_MAX_RADII * profile.radius } else { f64::INFINITY };
        let widest = libm::log(self.point_counts.half_width_max().min(steepest));
        let [mut y, mut slope] = self.guess.unwrap_or([cold.min(widest), 2.0]);
        let tolerance = match self.accuracy {
            Accuracy::Fast => 1e-4,
            Accuracy::Default => 1e-8,
            Accuracy::Fine => 1e-12,
        };
        let mut search = BracketedSearch::new();
        let mut before: Option<[f64; 2]> = None;
        for _ in 0..WIDTH_ITERATIONS_MAX {
            let mut trial =
                self.solve_half_width(libm::exp(y), ratio, matches!(target, Target::Descent(_)))?;
            let miss = match target {
                Target::Force(force) => libm::log(trial.force / force),
                Target::Descent(descent) => libm::log(trial.descent / descent),
            };
            if !miss.is_finite() {
                return Err(Refusal::NotConverged);
            }
            if let Some([y0, miss0]) = before
                && (y - y0).abs() > 1e-13
            {
                slope = ((miss - miss0) / (y - y0)).clamp(0.5, 8.0);
            }
            let stuck = before.is_some_and(|[y0, _]| (y - y0).abs() <= 2e-15 * y.abs().max(1.0));
            if miss.abs() < tolerance || stuck {
                self.guess = Some([y, slope]);
                if let Target::Force(force) = target {
                    // The remaining error of the force, within the tolerance, scales the pressure.
                    self.phi.iter_mut().for_each(|p| *p *= force / trial.force);
                    trial.descent = self.descent(&profile, &trial);
                }
                return Ok(trial);
            }
            if y >= widest && miss < 0.0 {
                return Err(Refusal::TooWide);
            }
            before = Some([y, miss]);
            y = search.next(y, miss, (y - miss / slope).clamp(y - 2.0, y + 2.0)).min(widest);
        }
        Err(Refusal::NotConverged)
    }

    /// The contact of a half-width in thicknesses.
    fn solve_half_width(&mut self, half: f64, ratio: f64, descend: bool) -> Result<Trial, Refusal> {
        let profile = self.profile();
        self.assemble(half, ratio)?;
        let (interval, [punch, tilted]) = (&self.interval, &mut self.work);
        interval.solve(1.0, |_| 0.0, punch);
        let ends = [-1.0, 1.0].map(|xi| interval.at(punch, xi));
        let mut centre = 0.0;
        let (mut before, mut force) = (None, 0.0);
        for _ in 0..OFFSET_ITERATIONS_MAX {
            interval.solve(0.0, |xi| -profile.slope(centre + half * xi), &mut self.phi);
            let shape = [-1.0, 1.0].map(|xi| interval.at(&self.phi, xi));
            // The force at which the strengths of both edges cancel, and the strength then left at
            // the left edge, which the offset has to remove.
            force = -(shape[0] + shape[1]) / (ends[0] + ends[1]);
            let rest = shape[0] + force * ends[0];
            if ratio == 0.0 {
                break;
            }
            let slope = match before {
                Some((c, r)) if c != centre => (rest - r) / (centre - c),
                _ => {
                    // The parabola: moving it by one tilts by 1/R.
                    interval.solve(0.0, |_| -1.0 / profile.radius, tilted);
                    let tilt = [-1.0, 1.0].map(|xi| interval.at(tilted, xi));
                    tilt[0] - (tilt[0] + tilt[1]) / (ends[0] + ends[1]) * ends[0]
                }
            };
            let step = -rest / slope;
            if step.abs() < 1e-14 * half || !step.is_finite() {
                break;
            }
            before = Some((centre, rest));
            centre += step;
            if profile.round {
                centre = centre.clamp(half - profile.radius, profile.radius - half);
            }
        }
        for (p, unit) in self.phi.iter_mut().zip(punch.iter()) {
            *p += force * unit;
        }
        let mean = force / (core::f64::consts::PI * half);
        let edge = [-1.0, 1.0].map(|xi| (self.interval.at(&self.phi, xi) / mean).abs());
        let mut trial = Trial { force, descent: 0.0, centre, edge: edge[0].max(edge[1]) };
        if descend {
            trial.descent = self.descent(&profile, &trial);
        }
        Ok(trial)
    }

    /// Descent of the lowest point.
    fn descent(&mut self, profile: &Profile, trial: &Trial) -> f64 {
        let half = self.interval.half();
        let height = self.interval.mean(|xi| profile.height(trial.centre + half * xi));
        self.interval.mean_descent(&self.kernels, &self.phi) + height
    }
}
