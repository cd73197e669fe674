//! The electronics between forces and counts: the tactile array's image, the wrist's gauges, the
//! echo of the motor currents. Each effect is in a file of its own and costs nothing unless a scene
//! names it. The electronics do not depend on where the forces come from.

mod array;
mod network;
mod response;
mod wrist;

pub(crate) use array::{Fingertip, TactileSensor};
pub use response::tactel_gains;
pub(crate) use wrist::Wrist;

use taktil_hal::{AdcCode, CHANNELS};

use crate::contact::Patch;
use crate::devices::ADC_MAX;
use crate::geometry::ArrayGeometry;

/// Distance from a line load beyond which its pressure at the base is neglected (m); the field
/// decays exponentially.
const BASE_FIELD_REACH_M: f64 = 12e-3;

/// Writes the normal force on each tactel at the rubber's base (N), row by row. Each row's load has
/// the distribution of the layer's base, integrated over the tactels' rectangles. Tangential loads
/// add their part when the rubber has that table. `across` is the cosine between the sensor's x and
/// the rolling direction.
pub(crate) fn tactel_forces(pad: &Patch, array: &ArrayGeometry, across: f64, forces: &mut [f64]) {
    forces.fill(0.0);
    let turned = across.abs();
    for (slice, row) in pad.slices.iter().zip(forces.chunks_exact_mut(array.cols)) {
        if slice.load_n <= 0.0 {
            continue;
        }
        let shares = pad.rubber.base_shares(slice.delta_m);
        let share = |edge: usize| {
            let u_m = array.column_m(edge) - 0.5 * array.pitch_x_m - slice.x_m;
            shares.left_of(1e3 * (turned * u_m).clamp(-BASE_FIELD_REACH_M, BASE_FIELD_REACH_M))
        };
        let mut left = share(0);
        for (column, force) in row.iter_mut().enumerate() {
            let right = share(column + 1);
            *force = slice.load_n * (right - left);
            left = right;
        }
    }
    add_tangential_image(forces, pad, array, across);
}

/// Adds the normal forces at the base that the rows' tangential loads cause, when the rubber has
/// that table.
pub(crate) fn add_tangential_image(
    forces: &mut [f64],
    pad: &Patch,
    array: &ArrayGeometry,
    across: f64,
) {
    let Some(influence) = pad.rubber.tangential_influence() else { return };
    for (slice, row) in pad.slices.iter().zip(forces.chunks_exact_mut(array.cols)) {
        if slice.load_n <= 0.0 {
            continue;
        }
        // This is the force of the bristles on the rubber along the rolling direction.
        let drag_n = slice.shear_n_m * slice.across_m;
        let half_width_m = pad.rubber.at(slice.delta_m).half_width_m;
        let part = |edge: usize| {
            let u_m = array.column_m(edge) - 0.5 * array.pitch_x_m - slice.x_m;
            influence.left_of(half_width_m, across * u_m)
        };
        let mut left = part(0);
        for (column, force) in row.iter_mut().enumerate() {
            let right = part(column + 1);
            // The rolling direction may run against the sensor's x.
            let signed = if across < 0.0 { left - right } else { right - left };
            *force += drag_n * signed;
            left = right;
        }
    }
}

/// Readings of the A/D converter for the motor currents.
pub(crate) fn currents(codes: &[i32; CHANNELS]) -> [AdcCode; CHANNELS] {
    codes.map(|code| AdcCode(code.clamp(-ADC_MAX - 1, ADC_MAX)))
}

pub(crate) fn saturate(x: f64) -> i32 {
    let max = f64::from(ADC_MAX);
    x.round().clamp(-max - 1.0, max) as i32
}
