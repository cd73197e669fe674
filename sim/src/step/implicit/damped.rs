//! Damped Newton iterations for a stage that did not converge and whose step is not halved any
//! more: each iteration is shortened until it helps. The iterations cannot diverge: the residual at
//! the end is never larger than at the start of the stage.

use super::{Plant, Residual, SPEED_TOLERANCE_M_S, Stage, StageResult, speeds};

/// Iterations of such a stage at most.
const DAMPED_STEPS_MAX: usize = 24;
/// How often one iteration is halved at most.
const STEP_HALVINGS_MAX: usize = 8;
/// Share of the predicted decrease of the residual that a shortened iteration has to reach (Armijo
/// 1966).
const ARMIJO_FACTOR: f64 = 0.1;

impl<const J: usize, const U: usize> Plant<J, U> {
    /// Solves a stage by damped Newton iterations. The residual is measured as the kinetic energy
    /// that it would give the bodies. The iteration starts from the best of three guesses: the
    /// present speeds, the guess of the stage, and the speeds at its start. Returns the last change
    /// (m/s), infinite when the iteration did not converge, and the number of iterations.
    pub(super) fn solve_damped(
        &mut self,
        stage: &Stage<'_, J>,
        present: [f64; U],
        guess: &[f64; U],
    ) -> StageResult<U> {
        let mass = self.newton_matrix(stage, &Residual::default()).factorise();
        let energy = |residual: &Residual<J, U>| -> f64 {
            let speeds = mass.solve(&residual.momentum);
            speeds.iter().zip(&residual.momentum).map(|(speed, momentum)| speed * momentum).sum()
        };
        let (mut least, mut u) = (f64::INFINITY, present);
        for from in [present, *guess, speeds::<J, U>(&stage.start.state)] {
            let energy_here = energy(&self.evaluate(stage, &from));
            if energy_here < least {
                (least, u) = (energy_here, from);
            }
        }
        for count in 1..=DAMPED_STEPS_MAX {
            let residual = self.evaluate(stage, &u);
            let change = self.newton_matrix(stage, &residual).factorise().solve(&residual.momentum);
            let (mut part, mut is_taken) = (1.0, false);
            for _ in 0..STEP_HALVINGS_MAX {
                let next: [f64; U] = core::array::from_fn(|i| u[i] + part * change[i]);
                let energy_there = energy(&self.evaluate(stage, &next));
                is_taken = energy_there <= (1.0 - ARMIJO_FACTOR * part) * least;
                if is_taken {
                    (least, u) = (energy_there, next);
                    break;
                }
                part *= 0.5;
            }
            let size = self.largest_speed(&change);
            let iterations = count as u32;
            if size < SPEED_TOLERANCE_M_S {
                return StageResult { last_change_m_s: size, iterations, speeds: u };
            }
            if !is_taken {
                // Evaluates the contacts once more, at the speeds that are kept.
                self.evaluate(stage, &u);
                return StageResult { last_change_m_s: f64::INFINITY, iterations, speeds: u };
            }
        }
        let iterations = DAMPED_STEPS_MAX as u32;
        StageResult { last_change_m_s: f64::INFINITY, iterations, speeds: u }
    }
}
