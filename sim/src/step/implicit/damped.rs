//! What is done with a stage whose iteration did not settle and whose step is not halved any more:
//! iterations that are shortened until they help. Refuses to run away: what it leaves of the
//! balance is never more than was left where the stage began.

use glam::DMat3;

use super::{Plant, Residual, SPEED_TOLERANCE_M_S, Speeds, StagePredictor, StageStart, speeds};
use crate::contact::Surface;

/// Iterations at most of a stage that did not settle and is not halved any more.
const DAMPED_STEPS_MAX: usize = 24;
/// Times that such an iteration is shortened at most, by half.
const STEP_HALVINGS_MAX: usize = 8;
/// An iteration over a part of its length has to take this share of that part off what is left of
/// the balance (Armijo 1966).
const ARMIJO_FACTOR: f64 = 0.1;

impl Plant {
    /// Newton's method by steps that are shortened until less of the balance is left, measured as
    /// the energy of motion of what is left: it cannot run away. Begins where least is left, of
    /// where it stands, where the stage began, and standing still with the speeds as they were.
    /// Gives the last change (m/s), infinite when it did not settle, and the iterations.
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
                // The contacts are left as they are at the speeds that are kept.
                self.evaluate(base, predictor, u, tau, table);
                return (f64::INFINITY, count as u32);
            }
        }
        (f64::INFINITY, DAMPED_STEPS_MAX as u32)
    }
}
