//! Adds the readings of a second fingertip on the other side of the pin to the model: its features,
//! their Jacobian with respect to the same four motions of the finger on the arm, and its frame.
//! The model only assumes that the pin lies between both fingertips.
//!
//! ```text
//! x_c'     falls by 1/2 of a roll by +dx, as x_c: its x axis looks the other way, and the pin's
//!          middle goes half of the finger's way
//! M0', M_x' grow as M0 and M_x: what squeezes the pin on one side is borne on the other, at the
//!          same place of its length; the pin's weight is no part of it
//! theta_z' stays while the finger turns; with the turn of the finger against this one, which the
//!          arm's joints tell, it is one more reading of theta_z: theta_z = turn - theta_z'
//! ```
//! Its sensor's y axis lies along the finger's y axis, its x axis against the finger's x axis, as
//! two palms face each other.

use nalgebra::Matrix4;
use taktil_contact::cylinder::BaseShares;
use taktil_contact::layer::Layer;
use taktil_contact::solved::line_contact;
use taktil_mechanics::Pose;
use taktil_rtcore::Invalid;

use super::jacobian::FeatureMeasurement;
use crate::config::Config;
use crate::config::array::Array;
use crate::config::model::ModelParameters;
use crate::config::opposed::OpposedFingertip;
use crate::perception::line::Line;

/// Standard deviation (columns) of the pin's position on either fingertip, because it may have slid
/// or the places of the fingertips may not be known exactly. Without it sliding would be taken for
/// a rotation.
const SLIDE_DEVIATION_COLUMNS: f64 = 0.5;
/// Places of a [`ArrayResponse`]'s tables in each column: they go from the first column to the
/// last, or over as many columns' distance.
const POINTS_PER_COLUMN: usize = 8;

/// The response of a fingertip's array to the load of a pin, over the columns.
#[derive(Clone, Debug, PartialEq)]
pub struct ArrayResponse {
    /// Part of the load in the band about its line, for each column of the line: near the edge of
    /// the array a part of the band lies outside.
    band_share: Box<[f64]>,
    /// Part of the pin's weight that the baseline hides in the band, with the line this many
    /// columns away from where the pin lay.
    baseline_share: Box<[f64]>,
    /// Weight of the pin on this fingertip while the baseline was taken.
    baseline_weight_counts: f64,
}

impl ArrayResponse {
    /// Computes the response for a pin under the desired load; allocates.
    ///
    /// # Errors
    /// A layer or radius that the theory of contact cannot take.
    pub fn new(
        fingertip: &OpposedFingertip,
        model: &ModelParameters,
        m0_counts: f64,
    ) -> Result<ArrayResponse, Invalid> {
        let layer =
            Layer::new(fingertip.pad_thickness_mm, fingertip.pad_mpa, fingertip.pad_poisson)
                .map_err(|bad| Invalid::new("pad_mpa", bad.what, bad.remedy))?;
        let deepest_mm = (0.2 * fingertip.pad_thickness_mm).min(0.2 * model.pin_radius_mm);
        let line = line_contact(&layer, model.pin_radius_mm, deepest_mm, true)
            .map_err(|bad| Invalid::new("pad_thickness_mm", bad.what, bad.remedy))?;
        let (array, cols) = (&fingertip.array, f64::from(fingertip.array.cols));
        let length_mm = f64::from(fingertip.array.rows) * fingertip.array.pitch_y_mm;
        let depth = |newton: f64| line.penetration_mm(newton / length_mm).max(1e-6);
        let even = depth(m0_counts / model.counts_per_n + fingertip.pin_weight_n);
        let (even, rest) =
            (line.base_shares(even), line.base_shares(depth(fingertip.pin_weight_n)));
        let band_share = |place: usize| {
            let x = ArrayResponse::column(place);
            ArrayResponse::part(&even, 0.0, &(0.5 - x..cols + 0.5 - x), array)
        };
        let baseline_share = |place: usize| {
            ArrayResponse::part(
                &rest,
                ArrayResponse::column(place) - 1.0,
                &(f64::NEG_INFINITY..f64::INFINITY),
                array,
            )
        };
        let points = (fingertip.array.col_count() - 1) * POINTS_PER_COLUMN + 1;
        Ok(ArrayResponse {
            band_share: (0..points).map(|place| band_share(place).clamp(0.2, 1.5)).collect(),
            baseline_share: (0..points).map(baseline_share).collect(),
            baseline_weight_counts: fingertip.pin_weight_n * model.counts_per_n,
        })
    }

    fn column(place: usize) -> f64 {
        1.0 + place as f64 / POINTS_PER_COLUMN as f64
    }

    /// Part of a load, which lies `away` columns beside the line, in the band about the line as far
    /// as there are columns; in the mean over the places of the line between two columns.
    fn part(
        shares: &BaseShares<'_>,
        away: f64,
        columns: &core::ops::Range<f64>,
        array: &Array,
    ) -> f64 {
        let (half, pitch_mm) = (array.band_half_columns(), array.pitch_x_mm);
        const OFFSET_SAMPLES: u32 = 16;
        let one = |place: u32| {
            let off = (f64::from(place) + 0.5) / f64::from(OFFSET_SAMPLES) - 0.5;
            let (from, to) = ((-half - off).max(columns.start), (half - off).min(columns.end));
            shares.left_of((to + away) * pitch_mm) - shares.left_of((from + away) * pitch_mm)
        };
        (0..OFFSET_SAMPLES).map(one).sum::<f64>() / f64::from(OFFSET_SAMPLES)
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    fn at(table: &[f64], column: f64) -> f64 {
        let last = table.len() - 1;
        let place = (POINTS_PER_COLUMN as f64 * (column - 1.0)).clamp(0.0, last as f64);
        let below = (place as usize).min(last - 1);
        table[below] + (table[below + 1] - table[below]) * (place - below as f64)
    }

    /// The line with the loads that squeeze the pin: the part of the load outside the band is
    /// added, and the weight of the pin, which the baseline hides at the column where the pin
    /// `lay`, is subtracted.
    #[must_use]
    pub fn squeezing_line(&self, line: &Line, lay: f64) -> Line {
        let x_c = line.features[0];
        let hidden = ArrayResponse::at(&self.baseline_share, 1.0 + (x_c - lay).abs());
        let whole = 1.0 / ArrayResponse::at(&self.band_share, x_c);
        let mut out = line.scaled(whole);
        let weight = self.baseline_weight_counts * (1.0 - hidden * whole.min(1.0));
        let before = out.features[1].max(1.0);
        // The weight is distributed along the whole line, as the load is.
        let left = ((before - weight) / before).max(0.0);
        out.features[1] *= left;
        out.features[2] *= left;
        out
    }
}

/// Direction of the pin in the finger's sensor (rad) by `line` in this one, with the finger at
/// `tool` (base frame).
#[must_use]
pub fn theta_z_rad(fingertip: &OpposedFingertip, line: &Line, tool: &Pose) -> f64 {
    let x = tool.rotation.x_axis;
    let turn = libm::atan2(-x.y, -x.x) - fingertip.yaw_deg.to_radians();
    let theta = turn - line.features[3];
    theta - core::f64::consts::TAU * (theta / core::f64::consts::TAU).round()
}

/// What `line` in this fingertip's image says, with the finger's Jacobian at the same instant
/// and the finger at `tool`.
#[must_use]
pub fn measurement(
    fingertip: &OpposedFingertip,
    config: &Config,
    line: &Line,
    jacobian: &Matrix4<f64>,
    tool: &Pose,
) -> FeatureMeasurement {
    let [x_c, m0, m_x, theta_z] = line.features;
    let by_both = 1e3 * theta_z_rad(fingertip, line, tool);
    let m_x_wanted = config.m_x_counts * (config.array.pitch_y_mm / fingertip.array.pitch_y_mm);
    let wanted = [fingertip.x_c, config.m0_counts, m_x_wanted, config.theta_z_mrad];
    let found = [x_c, m0, m_x, by_both];
    let mut variance = line.variance;
    let known = 1e3 * fingertip.yaw_std_dev_deg.to_radians();
    variance[3] = 1e6 * variance[3] + known * known;
    variance[0] += SLIDE_DEVIATION_COLUMNS * SLIDE_DEVIATION_COLUMNS;
    // The load's place along the pin moves with the tilt, and with it the centroid along a line
    // that lies askew.
    // Its rows may lie farther apart or closer than the finger's, in which the Jacobian counts.
    let (array, carried) = (&fingertip.array, &config.array);
    let slope = -libm::tan(theta_z) * array.rows_per_column();
    let along = (line.y_c - array.middle_row(), slope / m0.max(1.0));
    let mut moments = *jacobian;
    let rows = carried.pitch_y_mm / array.pitch_y_mm;
    moments.row_mut(2).scale_mut(rows);
    let shift = |i: usize| along.1 * (moments[(2, i)] - along.0 * moments[(1, i)]);
    let mut own = moments;
    let rolled = -0.5 / array.pitch_x_mm;
    own.set_row(0, &nalgebra::RowVector4::new(rolled, shift(1), shift(2), 0.0));
    FeatureMeasurement {
        jacobian: own,
        error: core::array::from_fn(|i| wanted[i] - found[i]),
        variance,
    }
}

#[cfg(test)]
mod tests;
