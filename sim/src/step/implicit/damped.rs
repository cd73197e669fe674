//! Damped Newton iterations for a stage that did not converge and whose step is not halved any
//! more: each iteration is shortened until it helps. Refuses to run away: the residual at the end
//! is never larger than where the stage began.

use glam::DMat3;

use super::{Plant, Residual, SPEED_TOLERANCE_M_S, Speeds, StagePredictor, StageStart, speeds};
use crate::contact::Surface;

/// Iterations of such a stage at most.
const DAMPED_STEPS_MAX: usize = 24;
/// How often one iteration is halved at most.
const STEP_HALVINGS_MAX: usize = 8;
/// Share of the predicted decrease of the residual that a shortened iteration has to reach (Armijo
/// 1966).
const ARMIJO_FACTOR: f64 = 0.1;

impl Plant {
    /// Solves a stage by damped Newton iterations. The residual is measured as the kinetic energy
    /// that it would give the bodies. The iteration starts from the best of three guesses: the
    /// present speeds, the guess of the stage, and the speeds at its start. Returns the last change
    /// (m/s), infinite when the iteration did not converge, and the number of iterations.
    pub(super) fn solve_damped(
        &mut self,
        base: &StageStart,
        predictor: &StagePredictor,
        u: &mut Speeds,
        guess: &Speeds,
        tau: f64,
        table: (&Surface, &DMat3),
    ) -> (f64, u32) {
        let mass = self.newton_matrix(predictor, &Residual::default(), tau).factorise();
        let left = |residual: &Residual| -> f64 {
            let speeds = mass.solve(&residual.rest);
            speeds.iter().zip(&residual.rest).map(|(speed, rest)| speed * rest).sum()
        };
        let mut least = f64::INFINITY;
        for from in [*u, *guess, speeds(&base.arm, base.memory.as_ref())] {
            let here = left(&self.evaluate(base, predictor, &from, tau, table));
            if here < least {
                (least, *u) = (here, from);
            }
        }
        for count in 1..=DAMPED_STEPS_MAX {
            let residual = self.evaluate(base, predictor, u, tau, table);
            let change =
                self.newton_matrix(predictor, &residual, tau).factorise().solve(&residual.rest);
            let (mut part, mut taken) = (1.0, false);
            for _ in 0..STEP_HALVINGS_MAX {
                let next: Speeds = core::array::from_fn(|i| u[i] + part * change[i]);
                let there = left(&self.evaluate(base, predictor, &next, tau, table));
                taken = there <= (1.0 - ARMIJO_FACTOR * part) * least;
                if taken {
                    (least, *u) = (there, next);
                    break;
                }
                part *= 0.5;
            }
            let size = self.largest_speed(&change);
            if size < SPEED_TOLERANCE_M_S {
                return (size, count as u32);
            }
            if !taken {
                // Evaluates the contacts once more, at the speeds that are kept.
                self.evaluate(base, predictor, u, tau, table);
                return (f64::INFINITY, count as u32);
            }
        }
        (f64::INFINITY, DAMPED_STEPS_MAX as u32)
    }
}
