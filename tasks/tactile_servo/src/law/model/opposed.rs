//! What a fingertip on the other side of the pin says of the motions of the finger that the arm
//! carries, so that both are one hand: its features, their Jacobian over the same four motions, and
//! its frame. Refuses to know where the pin is: only that it lies between both.
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
use serde::Deserialize;
use taktil_contact::cylinder::{BaseShares, LineContact};
use taktil_contact::layer::Layer;
use taktil_mechanics::Pose;
use taktil_rtcore::Invalid;

use super::Model;
use super::jacobian::{Felt, PITCH_MM};
use crate::config::Config;
use crate::perception::line::{BAND, Line, SIDE};

taktil_rtcore::explained! {
    /// `[tactile_servo.opposed]`: the other fingertip, which stands still or is moved by others.
    #[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Opposed {
        /// Turn of the other fingertip's frame about z0: at 0, the default, its x axis lies along
        /// x0 (deg).
        pub yaw_deg: f64,
        /// Standard deviation of `yaw_deg`, as far as it is known (deg). Default 0.2.
        pub yaw_known_deg: f64,
        /// The column where the pin lies on the other fingertip when it lies in the middle of the
        /// finger's columns. Default 8.5.
        pub x_c: f64,
        /// Thickness of the other fingertip's rubber (mm). Default 3.
        pub pad_thickness_mm: f64,
        /// Young's modulus of the other fingertip's rubber (MPa). Default 0.6.
        pub pad_mpa: f64,
        /// Poisson's ratio of the other fingertip's rubber. Default 0.49.
        pub pad_poisson: f64,
        /// Weight of the pin that lay on the other fingertip while its rest level was taken (N).
        /// Default 0: none did.
        pub carries_n: f64,
    }
}

/// Columns by which the pin may have slid on either, or the place of both be known wrong: one
/// standard deviation. Without it a slide would be taken for a turn.
const SLID: f64 = 0.5;
/// Places of a [`Sight`]'s tables: columns 1 to 16, or as many columns' distance, by eighths.
const PLACES: usize = 121;

/// What the array of a fingertip feels of a pin's load over the columns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Part of the load in the band about its line, with the line at a column: near the array's end
    /// a part falls beside it.
    inside: [f64; PLACES],
    /// Part of a rest level's hollow in the band, with the line so many columns away from it.
    hollow: [f64; PLACES],
    /// The weight that made the hollow.
    carries_counts: f64,
}

impl Sight {
    fn column(place: usize) -> f64 {
        1.0 + place as f64 / 8.0
    }

    /// Part of a load, which lies `away` columns beside the line, in the band about the line as far
    /// as there are columns; in the mean over the places of the line between two columns.
    fn part(shares: &BaseShares<'_>, away: f64, (low, high): (f64, f64)) -> f64 {
        const OFFS: u32 = 16;
        let one = |place: u32| {
            let off = (f64::from(place) + 0.5) / f64::from(OFFS) - 0.5;
            let (from, to) = ((-BAND - off).max(low), (BAND - off).min(high));
            shares.left_of((to + away) * PITCH_MM) - shares.left_of((from + away) * PITCH_MM)
        };
        (0..OFFS).map(one).sum::<f64>() / f64::from(OFFS)
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    fn at(table: &[f64; PLACES], column: f64) -> f64 {
        let place = (8.0 * (column - 1.0)).clamp(0.0, (PLACES - 1) as f64);
        let below = (place as usize).min(PLACES - 2);
        table[below] + (table[below + 1] - table[below]) * (place - below as f64)
    }

    /// The line with the loads that squeeze the pin: what the band does not show of them is put
    /// to, and the pin's weight, which the rest level hides where the pin `lay`, taken off.
    #[must_use]
    pub fn squeeze(&self, line: &Line, lay: f64) -> Line {
        let x_c = line.features[0];
        let hidden = Sight::at(&self.hollow, 1.0 + (x_c - lay).abs());
        let whole = 1.0 / Sight::at(&self.inside, x_c);
        let mut out = line.scaled(whole);
        let weight = self.carries_counts * (1.0 - hidden * whole.min(1.0));
        let before = out.features[1].max(1.0);
        // As the load, the weight lies along the whole line.
        let left = ((before - weight) / before).max(0.0);
        out.features[1] *= left;
        out.features[2] *= left;
        out
    }
}

impl Default for Opposed {
    fn default() -> Opposed {
        Opposed {
            yaw_deg: 0.0,
            yaw_known_deg: 0.2,
            x_c: 8.5,
            pad_thickness_mm: 3.0,
            pad_mpa: 0.6,
            pad_poisson: 0.49,
            carries_n: 0.0,
        }
    }
}

impl Opposed {
    /// # Errors
    /// A value outside the range that its message states; NaN is outside every range.
    pub fn check(&self) -> Result<(), Invalid> {
        let rows = [
            ("yaw_deg", self.yaw_deg, -180.0, 180.0),
            ("yaw_known_deg", self.yaw_known_deg, 0.0, 180.0),
            ("x_c", self.x_c, 1.0, 16.0),
            ("pad_thickness_mm", self.pad_thickness_mm, 0.05, 100.0),
            ("pad_mpa", self.pad_mpa, 0.01, 1e3),
            ("pad_poisson", self.pad_poisson, 0.0, 0.4999),
            ("carries_n", self.carries_n, 0.0, 1e3),
        ];
        for (place, value, low, high) in rows {
            if !(low <= value && value <= high) {
                let remedy = format!("give {low} to {high}");
                return Err(Invalid::new(place, format!("is {value}"), remedy));
            }
        }
        Ok(())
    }

    /// What its array feels of such a pin under such a load; allocates.
    ///
    /// # Errors
    /// A layer or radius that the theory of contact cannot take.
    pub fn sight(&self, model: &Model, m0_counts: f64) -> Result<Sight, Invalid> {
        let layer = Layer::new(self.pad_thickness_mm, self.pad_mpa, self.pad_poisson)
            .map_err(|bad| Invalid::new("pad_mpa", bad.what, bad.remedy))?;
        let deepest_mm = (0.2 * self.pad_thickness_mm).min(0.2 * model.pin_radius_mm);
        let line = LineContact::new(&layer, model.pin_radius_mm, deepest_mm)
            .map_err(|bad| Invalid::new("pad_thickness_mm", bad.what, bad.remedy))?;
        let length_mm = SIDE as f64 * PITCH_MM;
        let depth = |newton: f64| line.penetration_mm(newton / length_mm).max(1e-6);
        let even = depth(m0_counts / model.counts_per_n + self.carries_n);
        let (even, rest) = (line.base_shares(even), line.base_shares(depth(self.carries_n)));
        let inside = |place: usize| {
            let x = Sight::column(place);
            Sight::part(&even, 0.0, (0.5 - x, SIDE as f64 + 0.5 - x))
        };
        let hollow = |place: usize| {
            Sight::part(&rest, Sight::column(place) - 1.0, (f64::NEG_INFINITY, f64::INFINITY))
        };
        Ok(Sight {
            inside: core::array::from_fn(|place| inside(place).clamp(0.2, 1.5)),
            hollow: core::array::from_fn(hollow),
            carries_counts: self.carries_n * model.counts_per_n,
        })
    }

    /// Direction of the pin in the finger's sensor (rad) by `line` in this one, with the finger at
    /// `tool` (base frame).
    #[must_use]
    pub fn theta_z_rad(&self, line: &Line, tool: &Pose) -> f64 {
        let x = tool.rotation.x_axis;
        let turn = libm::atan2(-x.y, -x.x) - self.yaw_deg.to_radians();
        let theta = turn - line.features[3];
        theta - core::f64::consts::TAU * (theta / core::f64::consts::TAU).round()
    }

    /// What `line` in this fingertip's image says, with the finger's Jacobian at the same instant
    /// and the finger at `tool`.
    #[must_use]
    pub fn felt(&self, config: &Config, line: &Line, jacobian: &Matrix4<f64>, tool: &Pose) -> Felt {
        let [x_c, m0, m_x, theta_z] = line.features;
        let by_both = 1e3 * self.theta_z_rad(line, tool);
        let wanted = [self.x_c, config.m0_counts, config.m_x_counts, config.theta_z_mrad];
        let found = [x_c, m0, m_x, by_both];
        let mut variance = line.variance;
        let known = 1e3 * self.yaw_known_deg.to_radians();
        variance[3] = 1e6 * variance[3] + known * known;
        variance[0] += SLID * SLID;
        // The load's place along the pin moves with the tilt, and with it the centroid along a line
        // that lies askew.
        let middle = 0.5 * (SIDE as f64 + 1.0);
        let along = (line.y_c - middle, -libm::tan(theta_z) / m0.max(1.0));
        let shift = |i: usize| along.1 * (jacobian[(2, i)] - along.0 * jacobian[(1, i)]);
        let mut own = *jacobian;
        own.set_row(0, &nalgebra::RowVector4::new(-0.5 / PITCH_MM, shift(1), shift(2), 0.0));
        Felt { jacobian: own, error: core::array::from_fn(|i| wanted[i] - found[i]), variance }
    }
}

#[cfg(test)]
mod tests;
