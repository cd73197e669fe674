//! Newton's matrix of a stage: how the balance of momentum depends on the speeds, and what of the
//! contacts it was made for. Refuses to be trusted once they have let go: a matrix far stiffer than
//! what is there calls anything settled.

use glam::DVec3;
use taktil_mechanics::spatial::spatial_vector;

use super::{Plant, Residual, StagePredictor};
use crate::contact::{ContactLine, Tangent};
use crate::rolling::RollingPin;
use crate::scene::OBJECTS_MAX;
use crate::step::matrix::{Factors, Matrix12, UNKNOWN_COUNT};
use crate::surroundings::Surroundings;

/// Numbers of what resists motion: see [`Plant::holds`].
const RESISTANCE_COUNT: usize = 12 + 3 * OBJECTS_MAX;
/// Part of it below which Newton's matrix is made anew before a stage is called settled.
const SOFTENING_RATIO: f64 = 0.5;

/// Newton's matrix as it is held on to.
pub(super) struct FactoredMatrix {
    pub(super) factors: Factors,
    /// What resisted motion then.
    holds: [f64; RESISTANCE_COUNT],
}

impl Plant {
    /// Newton's matrix of a balance, factored.
    pub(super) fn factorise(
        &self,
        predictor: &StagePredictor,
        residual: &Residual,
        tau: f64,
    ) -> FactoredMatrix {
        let factors = self.newton_matrix(predictor, residual, tau).factorise();
        FactoredMatrix { factors, holds: self.resistances(residual) }
    }

    /// What resists motion where the balance was evaluated last: the pin's contacts, in three
    /// directions against moving and against turning, and the objects.
    fn resistances(&self, residual: &Residual) -> [f64; RESISTANCE_COUNT] {
        let mut holds = [0.0; RESISTANCE_COUNT];
        if let Some(contacts) = &residual.touch {
            for (i, contact) in [&contacts.finger, &contacts.table].into_iter().enumerate() {
                let Some((_, tangent)) = contact else { continue };
                for (j, [w0, w1, w2]) in tangent.weights.into_iter().enumerate() {
                    let at = 6 * i + 2 * j;
                    holds[at] = w0;
                    holds[at + 1] = if w0 > 0.0 { (w2 - w1 * w1 / w0).max(0.0) } else { 0.0 };
                }
            }
        }
        if let (Some(objects), true) = (&self.objects, residual.pressed) {
            objects.resistances(&mut holds[12..]);
        }
        holds
    }

    /// Whether something resists by far less than when the factors were made.
    pub(super) fn has_softened(&self, residual: &Residual, held: &FactoredMatrix) -> bool {
        let now = self.resistances(residual);
        now.iter().zip(&held.holds).any(|(now, then)| *now < SOFTENING_RATIO * then)
    }

    /// Newton's matrix where the balance was evaluated last.
    pub(super) fn newton_matrix(
        &self,
        predictor: &StagePredictor,
        residual: &Residual,
        tau: f64,
    ) -> Matrix12 {
        let mut matrix = Matrix12::identity();
        for (i, slope) in residual.slopes.iter().enumerate().take(predictor.degrees_of_freedom) {
            for j in 0..=i {
                matrix.set(i, j, predictor.inertia[(i, j)]);
            }
            matrix.add(i, i, tau * slope);
        }
        if let (Some(objects), Some(surroundings), true) =
            (&self.objects, &residual.surroundings, residual.pressed)
        {
            objects.for_each_tangent(&surroundings.pad, &predictor.jacobian, |weight, part| {
                let mut row = [0.0; UNKNOWN_COUNT];
                row[..predictor.degrees_of_freedom]
                    .copy_from_slice(&part.as_slice()[..predictor.degrees_of_freedom]);
                matrix.add_outer(tau * weight, &row);
            });
        }
        let (Some(rolling), Some(surroundings), Some(contacts)) =
            (&self.rolling, &residual.surroundings, &residual.touch)
        else {
            return matrix;
        };
        let inertia = rolling.pin.inertia_tensor();
        for i in 0..3 {
            matrix.set(6 + i, 6 + i, rolling.pin.mass_kg);
            for j in 0..=i {
                matrix.set(9 + i, 9 + j, inertia.col(j)[i]);
            }
        }
        rolling.add_fixture_tangent(surroundings, tau, &mut matrix);
        if let Some((line, tangent)) = &contacts.table {
            add_contact(&mut matrix, line, tangent, tau, None);
        }
        if let Some((line, tangent)) = &contacts.finger {
            add_contact(
                &mut matrix,
                line,
                tangent,
                tau,
                Some((predictor, surroundings.finger.origin)),
            );
        }
        matrix
    }
}

/// Adds how a contact's force depends on the speeds.
fn add_contact(
    matrix: &mut Matrix12,
    line: &ContactLine,
    tangent: &Tangent,
    tau: f64,
    finger: Option<(&StagePredictor, DVec3)>,
) {
    let directions = [line.normal, line.across, line.along];
    for (direction, weights) in directions.into_iter().zip(&tangent.weights) {
        let [w0, w1, w2] = *weights;
        if w0 <= 0.0 {
            continue;
        }
        // w (v0 + s v1)^2 summed is w0 (v0 + m v1)^2 + rest v1^2 about the mean place m.
        let mean = w1 / w0;
        let spread = (w2 - w1 * mean).max(0.0);
        let turn = line.axis.cross(direction);
        let lever = line.radius.cross(direction) + mean * turn;
        let (mut at_mean, mut load_factor) = ([0.0; UNKNOWN_COUNT], [0.0; UNKNOWN_COUNT]);
        at_mean[6..9].copy_from_slice(&direction.to_array());
        at_mean[9..].copy_from_slice(&lever.to_array());
        load_factor[9..].copy_from_slice(&turn.to_array());
        if let Some((predictor, tool)) = finger {
            let lever = (line.foot - tool).cross(direction) + mean * turn;
            let at_tool = predictor.jacobian.tr_mul(&stack(direction, lever));
            let turned = predictor.jacobian.tr_mul(&stack(DVec3::ZERO, turn));
            for i in 0..predictor.degrees_of_freedom {
                (at_mean[i], load_factor[i]) = (-at_tool[i], -turned[i]);
            }
        }
        if finger.is_some() {
            matrix.add_outer(tau * w0, &at_mean);
            matrix.add_outer(tau * spread, &load_factor);
        } else {
            matrix.add_outer_of_pin(tau * w0, &at_mean);
            matrix.add_outer_of_pin(tau * spread, &load_factor);
        }
    }
    if tangent.rolling > 0.0 {
        let mut row = [0.0; UNKNOWN_COUNT];
        row[9..].copy_from_slice(&line.along.to_array());
        matrix.add_outer_of_pin(tau * tangent.rolling, &row);
    }
}

impl RollingPin {
    /// Adds how the hand's grip depends on the pin's speeds.
    fn add_fixture_tangent(&self, surroundings: &Surroundings, tau: f64, matrix: &mut Matrix12) {
        if !self.fixture.holding {
            return;
        }
        let (along_m, about) = self.fixture.tangent(&self.pin, tau);
        let n = surroundings.table.normal;
        let across = self.pin.axis().cross(n).normalize_or_zero();
        for i in 0..3 {
            for j in 0..=i {
                let unit = if i == j { 1.0 } else { 0.0 };
                matrix.add(6 + i, 6 + j, tau * along_m * (unit - n[i] * n[j]));
                matrix.add(9 + i, 9 + j, tau * about * (unit - across[i] * across[j]));
            }
        }
    }
}
