//! Derivatives of the features of a contact on cells or nodes, by differences of two solutions,
//! with their errors. What the solver reports as an error next to the contact is an error here.

use taktil_contact::plane::frictional::{ContactStatus, FrictionalContact, LoadStep};
use taktil_contact::plane::rates;

use super::column::Column;
use super::field::Failure;
use super::refusal::refusal_failure;

/// Step of the differences, as a fraction of the descent and of the contact's slope.
const STEP_SHARE: f64 = 1e-4;
/// Largest number of doublings of the step, until another cell or node makes contact, sticks or
/// slips.
const DOUBLINGS_MAX: i32 = 12;
/// Smallest number of cells or nodes in contact from which an error is estimated.
const TOUCHING_PLACES_MIN: usize = 3;

/// Central differences about a contact on cells or nodes. The error has two parts. The first is
/// half the difference of the two one-sided slopes: where the contact sticks in one direction and
/// slips in the other, no single derivative exists. The second is the difference from the slopes at
/// a slightly larger and a slightly smaller descent, where one more or one fewer cell takes part,
/// because the edge of the contact is known only to one cell.
pub(super) fn differences(
    grip: &FrictionalContact,
    motion: rates::Motion,
    measure: impl Fn(&FrictionalContact) -> Result<Vec<Option<f64>>, Failure>,
) -> Result<Column, Failure> {
    let [less, more] = one_sided_slopes(grip, motion, &measure)?;
    let mut column = Column::default();
    for (less, more) in less.iter().zip(&more) {
        let both = (*less).zip(*more);
        column.values.push(both.map(|(a, b)| 0.5 * (a + b)));
        column.errors.push(both.map(|(a, b)| 0.5 * (a - b).abs()));
    }
    let touching = grip.status().iter().filter(|status| **status != ContactStatus::Apart);
    if touching.count() < TOUCHING_PLACES_MIN {
        column.errors.fill(None);
        return Ok(column);
    }
    for side in [-1.0, 1.0] {
        let Some(beside) = neighbouring_contact(grip, side) else { continue };
        // A contact that cannot be moved further yields no error estimate.
        let Ok([less, more]) = one_sided_slopes(&beside, motion, &measure) else { continue };
        for (i, error) in column.errors.iter_mut().enumerate() {
            let (Some(known), Some(value)) = (error.as_mut(), column.values[i]) else { continue };
            if let (Some(a), Some(b)) = (less[i], more[i]) {
                *known = known.max((0.5 * (a + b) - value).abs());
            }
        }
    }
    Ok(column)
}

/// Slopes of the features in the negative and in the positive direction of a motion.
fn one_sided_slopes(
    grip: &FrictionalContact,
    motion: rates::Motion,
    measure: &impl Fn(&FrictionalContact) -> Result<Vec<Option<f64>>, Failure>,
) -> Result<[Vec<Option<f64>>; 2], Failure> {
    let [dz, slope, dx] = grip.rigid();
    let span = grip.compliance().x_mm.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    let step = match motion {
        rates::Motion::RotY => STEP_SHARE * dz.abs() / span,
        rates::Motion::X | rates::Motion::Z => STEP_SHARE * dz.abs(),
    };
    let at = |amount: f64| {
        let mut grip = grip.clone();
        let [z, turn, x] = match motion {
            rates::Motion::X => [0.0, 0.0, amount],
            rates::Motion::Z => [amount, 0.0, 0.0],
            rates::Motion::RotY => [0.0, amount, 0.0],
        };
        let pose = LoadStep::Pose { dz_mm: dz + z, slope: slope + turn, dx_mm: dx + x };
        grip.step(&pose).map_err(refusal_failure)?;
        measure(&grip)
    };
    let (less, here, more) = (at(-step)?, at(0.0)?, at(step)?);
    let slopes = |from: &[Option<f64>], to: &[Option<f64>]| {
        let pairs = from.iter().zip(to);
        pairs.map(|(a, b)| (*a).zip(*b).map(|(a, b)| (b - a) / step)).collect()
    };
    Ok([slopes(&less, &here), slopes(&here, &more)])
}

/// The contact at the nearest descent at which other cells take part, searched in doubling steps.
fn neighbouring_contact(grip: &FrictionalContact, side: f64) -> Option<FrictionalContact> {
    let [dz, slope, dx] = grip.rigid();
    let mut step = side * STEP_SHARE * dz.abs();
    for _ in 0..DOUBLINGS_MAX {
        step *= 2.0;
        let mut moved = grip.clone();
        let pose = LoadStep::Pose { dz_mm: dz + step, slope, dx_mm: dx };
        if moved.step(&pose).is_err() {
            return None;
        }
        if moved.status() != grip.status() {
            return Some(moved);
        }
    }
    None
}
