//! Accelerated fixed-point steps of many variables at once (Anderson 1965): each variable has a
//! residual, and the step is chosen so that, by the changes of the last steps, the residuals become
//! least. A step of each variable by its own residual oscillates where neighbouring variables act
//! on each other, and is too short where all of them change alike; the changes of the last steps
//! show both. Memory is allocated when the struct is made.

use crate::numeric::cholesky::{factor, solve};

/// Number of earlier steps that are kept.
const HISTORY_LEN: usize = 4;
/// Relative increase of the diagonal of the normal equations, so that two equal changes do not make
/// them singular.
const DIAGONAL_INCREASE: f64 = 1e-6;

/// Memory of the accelerated steps.
#[derive(Clone, Debug, Default)]
pub(super) struct AndersonMixing {
    /// Variables and their residuals, now and one step before.
    now: [Vec<f64>; 2],
    before: [Vec<f64>; 2],
    /// Changes of variables and residuals in the earlier steps, the latest first.
    changes: Vec<[Vec<f64>; 2]>,
    known: usize,
    /// The step found.
    pub(super) step: Vec<f64>,
}

impl AndersonMixing {
    /// Memory for at most `most` variables; allocates.
    pub(super) fn new(most: usize) -> Self {
        let room = || Vec::with_capacity(most);
        let pair = || [room(), room()];
        let changes = (0..HISTORY_LEN).map(|_| pair()).collect();
        Self { now: pair(), before: pair(), changes, known: 0, step: room() }
    }

    /// Forgets all earlier steps.
    pub(super) fn restart(&mut self) {
        self.known = 0;
        self.now.iter_mut().chain(&mut self.before).for_each(Vec::clear);
    }

    /// Adds a variable: its value and its residual.
    pub(super) fn add(&mut self, place: f64, left: f64) {
        self.now[0].push(place);
        self.now[1].push(left);
    }

    /// Writes the step for the variables that were added since the last one. In directions that no
    /// earlier step has explored the step is `part` of the residual.
    pub(super) fn mix(&mut self, part: f64) {
        if self.before[0].len() == self.now[0].len() {
            self.changes.rotate_right(1);
            for (change, (now, before)) in
                self.changes[0].iter_mut().zip(self.now.iter().zip(&self.before))
            {
                change.clear();
                change.extend(now.iter().zip(before).map(|(now, before)| now - before));
            }
            self.known = (self.known + 1).min(HISTORY_LEN);
        } else {
            self.known = 0;
        }
        let left = &self.now[1];
        self.step.clear();
        self.step.extend(left.iter().map(|left| part * left));
        let known = &self.changes[..self.known];
        let mut squares = [0.0; HISTORY_LEN * HISTORY_LEN];
        let mut parts = [0.0; HISTORY_LEN];
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let n = known.len();
        for (i, [_, one]) in known.iter().enumerate() {
            for (j, [_, other]) in known[..=i].iter().enumerate() {
                squares[i * n + j] = dot(one, other);
            }
            squares[i * n + i] *= 1.0 + DIAGONAL_INCREASE;
            parts[i] = dot(one, left);
        }
        if factor(&mut squares[..n * n], n) {
            solve(&squares[..n * n], n, &mut parts[..n]);
            for (weight, [places, lefts]) in parts.iter().zip(known) {
                for (step, (place, left)) in self.step.iter_mut().zip(places.iter().zip(lefts)) {
                    *step -= weight * (place + part * left);
                }
            }
        }
        core::mem::swap(&mut self.now, &mut self.before);
        self.now.iter_mut().for_each(Vec::clear);
    }
}

#[cfg(test)]
mod tests {
    use super::AndersonMixing;

    /// Neighbours act on each other so strongly that steps of each variable on its own would
    /// oscillate without end.
    #[test]
    fn accelerated_steps_converge() {
        let count = 9;
        let left = |x: &[f64]| -> Vec<f64> {
            let of = |i: usize| {
                let beside = |j: usize| x.get(j).copied().unwrap_or(0.0);
                1.0 - 2.0 * x[i] - 1.8 * (beside(i.wrapping_sub(1)) + beside(i + 1)) / 2.0
            };
            (0..count).map(of).collect()
        };
        let mut x = vec![0.0; count];
        let mut mixing = AndersonMixing::new(count);
        let size = |left: &[f64]| left.iter().fold(0.0_f64, |most, left| most.max(left.abs()));
        for _ in 0..12 {
            let left = left(&x);
            x.iter().zip(&left).for_each(|(x, left)| mixing.add(*x, *left));
            mixing.mix(0.7);
            x.iter_mut().zip(&mixing.step).for_each(|(x, step)| *x += step);
        }
        assert!(size(&left(&x)) < 1e-4, "{:?}", left(&x));
        let mut alone = vec![0.0; count];
        for _ in 0..12 {
            let left = left(&alone);
            alone.iter_mut().zip(&left).for_each(|(x, left)| *x += 0.7 * left);
        }
        assert!(size(&left(&alone)) > 1.0);
    }
}
