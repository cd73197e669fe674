//! Newton's matrix of a stage: the derivative of the balance of momentum with respect to the
//! speeds, and the stiffness of the contacts for which it was made. The matrix is invalid once a
//! contact has been released, because with a matrix far stiffer than the present contacts any
//! speeds seem to have converged.

use glam::DVec3;
use taktil_mechanics::spatial::spatial_vector;

use super::{Plant, Residual, Stage, StagePredictor};
use crate::contact::{ContactLine, Tangent};
use crate::rolling::RollingPin;
use crate::scene::OBJECTS_MAX;
use crate::step::matrix::{Factors, SpeedMatrix};
use crate::surroundings::Surroundings;

/// How many resistances are compared: see [`Plant::resistances`].
const RESISTANCE_COUNT: usize = 12 + 3 * OBJECTS_MAX;
/// Ratio of a resistance to its earlier value below which Newton's matrix is made anew before a
/// stage counts as converged.
const SOFTENING_RATIO: f64 = 0.5;

/// A factorised Newton matrix.
pub(super) struct FactoredMatrix<const U: usize> {
    pub(super) factors: Factors<U>,
    /// The resistances for which it was made.
    resistances: [f64; RESISTANCE_COUNT],
}

impl<const J: usize, const U: usize> Plant<J, U> {
    /// Makes and factorises Newton's matrix.
    pub(super) fn factorise(
        &self,
        stage: &Stage<'_, J>,
        residual: &Residual<J, U>,
    ) -> FactoredMatrix<U> {
        let factors = self.newton_matrix(stage, residual).factorise();
        FactoredMatrix { factors, resistances: self.resistances(residual) }
    }

    /// Resistances to motion at the latest evaluation: those of the pin's contacts, in three
    /// directions against translation and against rotation, and those of the objects.
    fn resistances(&self, residual: &Residual<J, U>) -> [f64; RESISTANCE_COUNT] {
        let mut resistances = [0.0; RESISTANCE_COUNT];
        if let Some(contacts) = &residual.contacts {
            for (i, contact) in [&contacts.finger, &contacts.table].into_iter().enumerate() {
                let Some((_, tangent)) = contact else { continue };
                for (j, [w0, w1, w2]) in tangent.weights.into_iter().enumerate() {
                    let at = 6 * i + 2 * j;
                    resistances[at] = w0;
                    resistances[at + 1] = if w0 > 0.0 { (w2 - w1 * w1 / w0).max(0.0) } else { 0.0 };
                }
            }
        }
        if let (Some(objects), true) = (&self.objects, residual.touches_objects) {
            objects.resistances(&mut resistances[12..]);
        }
        resistances
    }

    /// Whether a resistance is far smaller than when the factors were made.
    pub(super) fn has_softened(
        &self,
        residual: &Residual<J, U>,
        matrix: &FactoredMatrix<U>,
    ) -> bool {
        let now = self.resistances(residual);
        now.iter().zip(&matrix.resistances).any(|(now, then)| *now < SOFTENING_RATIO * then)
    }

    /// Newton's matrix at the latest evaluation of the balance.
    pub(super) fn newton_matrix(
        &self,
        stage: &Stage<'_, J>,
        residual: &Residual<J, U>,
    ) -> SpeedMatrix<J, U> {
        let (predictor, tau) = (&stage.predictor, stage.tau);
        let mut matrix = SpeedMatrix::identity();
        for (i, slope) in residual.slopes.iter().enumerate().take(predictor.degrees_of_freedom) {
            for j in 0..=i {
                matrix.set(i, j, predictor.inertia[(i, j)]);
            }
            matrix.add(i, i, tau * slope);
        }
        if let (Some(objects), Some(surroundings), true) =
            (&self.objects, &residual.surroundings, residual.touches_objects)
        {
            objects.for_each_tangent(&surroundings.pad, &predictor.jacobian, |weight, part| {
                let mut row = [0.0; U];
                row[..predictor.degrees_of_freedom]
                    .copy_from_slice(&part.as_slice()[..predictor.degrees_of_freedom]);
                matrix.add_outer(tau * weight, &row);
            });
        }
        let (Some(rolling), Some(surroundings), Some(contacts)) =
            (&self.rolling, &residual.surroundings, &residual.contacts)
        else {
            return matrix;
        };
        let inertia = rolling.pin.inertia_tensor();
        for i in 0..3 {
            matrix.set(J + i, J + i, rolling.pin.mass_kg);
            for j in 0..=i {
                matrix.set(J + 3 + i, J + 3 + j, inertia.col(j)[i]);
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

/// Adds the derivative of a contact's force with respect to the speeds.
fn add_contact<const J: usize, const U: usize>(
    matrix: &mut SpeedMatrix<J, U>,
    line: &ContactLine,
    tangent: &Tangent,
    tau: f64,
    finger: Option<(&StagePredictor<J>, DVec3)>,
) {
    let directions = [line.normal, line.across, line.along];
    for (direction, weights) in directions.into_iter().zip(&tangent.weights) {
        let [w0, w1, w2] = *weights;
        if w0 <= 0.0 {
            continue;
        }
        // The sum of w (v0 + s v1)^2 is w0 (v0 + m v1)^2 + spread v1^2 about the mean place m.
        let mean = w1 / w0;
        let spread = (w2 - w1 * mean).max(0.0);
        let turn = line.axis.cross(direction);
        let lever = line.radius.cross(direction) + mean * turn;
        let (mut at_mean, mut load_factor) = ([0.0; U], [0.0; U]);
        at_mean[J..J + 3].copy_from_slice(&direction.to_array());
        at_mean[J + 3..].copy_from_slice(&lever.to_array());
        load_factor[J + 3..].copy_from_slice(&turn.to_array());
        if let Some((predictor, tool)) = finger {
            let lever = (line.foot - tool).cross(direction) + mean * turn;
            let at_tool = predictor.jacobian.tr_mul(&spatial_vector(direction, lever));
            let turned = predictor.jacobian.tr_mul(&spatial_vector(DVec3::ZERO, turn));
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
        let mut row = [0.0; U];
        row[J + 3..].copy_from_slice(&line.along.to_array());
        matrix.add_outer_of_pin(tau * tangent.rolling, &row);
    }
}

impl RollingPin {
    /// Adds the derivative of the fixture's forces with respect to the pin's speeds.
    fn add_fixture_tangent<const J: usize, const U: usize>(
        &self,
        surroundings: &Surroundings,
        tau: f64,
        matrix: &mut SpeedMatrix<J, U>,
    ) {
        if !self.fixture.holding {
            return;
        }
        let (along_m, about) = self.fixture.tangent(&self.pin, tau);
        let n = surroundings.table.normal;
        let across = self.pin.axis().cross(n).normalize_or_zero();
        for i in 0..3 {
            for j in 0..=i {
                let unit = if i == j { 1.0 } else { 0.0 };
                matrix.add(J + i, J + j, tau * along_m * (unit - n[i] * n[j]));
                matrix.add(J + 3 + i, J + 3 + j, tau * about * (unit - across[i] * across[j]));
            }
        }
    }
}
