//! The coupled feature Jacobian of a pin under a rubber pad, scheduled on the image, and its
//! inverse: from an error of the features to a displacement with its covariance. Refuses nothing:
//! where a direction cannot be seen, the answer is small and its variance says so.
//!
//! Each row of tactels is a spring whose stiffness is that of a rigid cylinder on a bonded layer
//! under the row's load ([`taktil_mechanics::contact::cylinder`]); behind them lies the compliance
//! of what holds finger and pin, diagonal in z and theta_x. With K = sum k_r [1 y; y y^2] over the
//! rows, (M0, M_x) answers (z, theta_x) with (K^-1 + C)^-1. A roll by dx moves the line by -dx/2; a
//! turn moves the image the other way about the sensor's centre; a tilt moves the centroid along a
//! line that lies askew.
//!
//! The inverse is that of weighted least squares with a prior, `(J' W J + P)^-1 J' W`, with W the
//! inverse variances of the features: the posterior of a Gaussian estimate, so its covariance comes
//! with it and no singularity of J can make it large.

use nalgebra::{Matrix4, Vector4};
use taktil_mechanics::contact::cylinder::LineContact;
use taktil_mechanics::contact::layer::Layer;
use taktil_rtcore::Invalid;

use super::Model;
use crate::perception::line::{Line, SIDE};

/// Distance between tactels (mm).
pub const PITCH_MM: f64 = 1.5875;
/// Places of the table of stiffness over load.
const PLACES: usize = 65;
/// A row counts as pressed with at least this share of an even load, so that the first touch is not
/// infinitely soft.
const LEAST: f64 = 0.1;
/// Prior standard deviations of a displacement (mm, mm, mrad, mrad).
const PRIOR: [f64; 4] = [30.0, 3.0, 100.0, 400.0];

/// Stiffness of a row over its load, and what the machine adds.
#[derive(Clone, Debug)]
pub struct Contact {
    /// Counts/mm of a row at loads of 0 to `heaviest` counts, evenly spaced.
    stiffness: [f64; PLACES],
    heaviest: f64,
    least: f64,
    /// mm per count, mrad per count row.
    compliance: [f64; 2],
}

impl Contact {
    /// Solves the contact of the nominal pin and pad; allocates.
    ///
    /// # Errors
    /// A layer or radius that the theory of contact cannot take.
    pub fn new(model: &Model, m0_counts: f64) -> Result<Contact, Invalid> {
        let layer = Layer::new(model.pad_thickness_mm, model.pad_mpa, model.pad_poisson)
            .map_err(|bad| Invalid::new("model.pad_mpa", bad.what, bad.remedy))?;
        let deepest = 0.2 * model.pad_thickness_mm;
        let line = LineContact::new(&layer, model.pin_radius_mm, deepest)
            .map_err(|bad| Invalid::new("model.pin_radius_mm", bad.what, bad.remedy))?;
        let even = m0_counts / SIDE as f64;
        let heaviest = 4.0 * even;
        let per_row = PITCH_MM * model.counts_per_n;
        let stiffness = core::array::from_fn(|place| {
            let counts = heaviest * place as f64 / (PLACES - 1) as f64;
            let load_n_mm = counts.max(LEAST * even) / per_row;
            line.stiffness_n_mm2(line.penetration_mm(load_n_mm)) * per_row
        });
        let per_mrad = 1e-3 * model.support_nm_rad * 1e3 * model.counts_per_n / PITCH_MM;
        Ok(Contact {
            stiffness,
            heaviest,
            least: LEAST * even,
            compliance: [1.0 / (model.support_n_mm * model.counts_per_n), 1.0 / per_mrad],
        })
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    fn row(&self, counts: f64) -> f64 {
        if counts < self.least {
            // Rows off the pin are no springs.
            return self.stiffness[0] * (counts / self.least).max(0.0);
        }
        let place = (counts / self.heaviest).clamp(0.0, 1.0) * (PLACES - 1) as f64;
        let below = (place as usize).min(PLACES - 2);
        let share = place - below as f64;
        self.stiffness[below] * (1.0 - share) + self.stiffness[below + 1] * share
    }

    /// dF/dX at an image: F = (x_c columns, M0 counts, M_x counts x rows, theta_z mrad) over X = (x
    /// mm, z mm, theta_x mrad, theta_z mrad).
    #[must_use]
    pub fn jacobian(&self, line: &Line) -> Matrix4<f64> {
        let middle = 0.5 * (SIDE as f64 + 1.0);
        let [mut k0, mut k1, mut k2] = [0.0; 3];
        for (index, counts) in line.rows.iter().enumerate() {
            let y = (index + 1) as f64 - middle;
            let k = self.row(*counts);
            k0 += k;
            k1 += k * y;
            k2 += k * y * y;
        }
        // A turn by 1 mrad lowers row y by y x pitch x 1e-3 mm.
        let lever = 1e-3 * PITCH_MM;
        let [c_z, c_t] = self.compliance;
        let (a, b, d) = (k0, k1 * lever, k2 * lever);
        // (1 + K C)^-1 K with K = [a b; k1 d].
        let (m00, m01) = (1.0 + a * c_z, b * c_t);
        let (m10, m11) = (k1 * c_z, 1.0 + d * c_t);
        let inverse = 1.0 / (m00 * m11 - m01 * m10).max(1e-9);
        let m0_z = inverse * (m11 * a - m01 * k1);
        let m0_t = inverse * (m11 * b - m01 * d);
        let mx_z = inverse * (m00 * k1 - m10 * a);
        let mx_t = inverse * (m00 * d - m10 * b);
        let m0 = line.features[1].max(self.least);
        let y_c = line.y_c - middle;
        let slope = -libm::tan(line.features[3]);
        // The centroid's way along y with the tilt, times the line's slope.
        let x_t = slope * (mx_t - y_c * m0_t) / m0;
        let x_z = slope * (mx_z - y_c * m0_z) / m0;
        Matrix4::new(
            -0.5 / PITCH_MM,
            x_z,
            x_t,
            1e-3 * y_c, //
            0.0,
            m0_z,
            m0_t,
            0.0, //
            0.0,
            mx_z,
            mx_t,
            0.0, //
            0.0,
            0.0,
            0.0,
            -1.0,
        )
    }
}

/// The displacement that makes up for `error` (features wanted minus found), and its variances.
#[must_use]
pub fn displacement(
    jacobian: &Matrix4<f64>,
    error: &[f64; 4],
    variance: &[f64; 4],
) -> ([f64; 4], [f64; 4]) {
    let mut normal = Matrix4::zeros();
    let mut right = Vector4::zeros();
    for f in 0..4 {
        let weight = 1.0 / variance[f].max(1e-12);
        for i in 0..4 {
            right[i] += jacobian[(f, i)] * weight * error[f];
            for j in 0..4 {
                normal[(i, j)] += jacobian[(f, i)] * weight * jacobian[(f, j)];
            }
        }
    }
    for i in 0..4 {
        normal[(i, i)] += 1.0 / (PRIOR[i] * PRIOR[i]);
    }
    let Some(factor) = normal.cholesky() else { return ([0.0; 4], PRIOR.map(|p| p * p)) };
    let step = factor.solve(&right);
    let covariance = factor.inverse();
    (step.into(), core::array::from_fn(|i| covariance[(i, i)]))
}
