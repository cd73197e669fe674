//! The coupled feature Jacobian of a pin under a rubber pad, scheduled on the image, and its
//! inverse: from an error of the features to a displacement with its covariance. Where
//! a direction cannot be seen, the answer is small and its variance is large.
//!
//! Each row of tactels is a spring that only pushes, with the law of a rigid cylinder on a bonded
//! layer ([`taktil_contact::cylinder`]); behind them lies the compliance of what holds
//! finger and pin, diagonal in z and theta_x. Sum and moment of the load say how deep the pin lies
//! in the pad along the rows, a straight line (Newton on a convex energy); each row's stiffness is
//! then that of the chord from its depth to the even one wanted. So J times the displacement is the
//! change of the features for the whole way and not only for the first step of it: a pin that
//! touches with one row is turned away there and pressed elsewhere, by rows that carry nothing
//! yet. At the set point the chord is the tangent.
//!
//! With K = sum k_r [1 y; y y^2] over the rows, (M0, M_x) answers (z, theta_x) with
//! (K^-1 + C)^-1. A roll by dx moves the line by -dx/2; a turn moves the image the other way about
//! the sensor's centre; a tilt moves the centroid along a line that lies askew.
//!
//! The inverse is that of weighted least squares with a prior, `(J' W J + P)^-1 J' W`, with W the
//! inverse variances of the features: the posterior of a Gaussian estimate, so its covariance comes
//! with it and no singularity of J can make it large.

use nalgebra::{Matrix4, Vector4};
use taktil_contact::cylinder::LineContact;
use taktil_contact::layer::Layer;
use taktil_contact::solved::line_contact;
use taktil_rtcore::Invalid;

use crate::config::array::{Array, ROWS_MAX};
use crate::config::model::ModelParameters;
use crate::perception::line::{Line, LoadProfile};

/// Places of the table of load over depth.
const TABLE_POINTS: usize = 129;
/// A sum below this share of the desired one counts as this share, because a very light contact
/// does not determine the shape of the load.
const LOAD_SHARE_MIN: f64 = 0.02;
/// A row that should carry at least half of an even load and carries less than this share of its
/// expected load does not lie on the pin.
const ROW_LOAD_SHARE_MIN: f64 = 0.2;
/// Least number of rows that have to be on the pin.
const ROWS_MIN: usize = 3;
/// Steps of Newton's method, and the part of the deepest penetration that one may go.
const NEWTON_STEPS_MAX: u32 = 16;
const NEWTON_STEP_SHARE_MAX: f64 = 0.25;
/// Prior standard deviations of a displacement (mm, mm, mrad, mrad).
const PRIOR_DEVIATIONS: [f64; 4] = [30.0, 3.0, 100.0, 400.0];

/// The load of a row over its depth, and the compliance of arm and table.
#[derive(Clone, Debug)]
pub struct ContactModel {
    /// Counts of a row at depths of 0 to `deepest_mm`, evenly spaced.
    load: [f64; TABLE_POINTS],
    deepest_mm: f64,
    m0_counts: f64,
    array: Array,
    /// mm per count, mrad per count row.
    compliance: [f64; 2],
    /// Whole load over the load in the band about the line.
    band_correction: f64,
    /// How an even load spreads over the columns.
    profile: LoadProfile,
}

/// Part of an even load that the base carries within the band about its line, in the mean over the
/// places of the line between two columns.
fn band_share(line: &LineContact, depth_mm: f64, array: &Array) -> f64 {
    let (half, pitch_mm) = (array.band_half_columns(), array.pitch_x_mm);
    const OFFSET_SAMPLES: u32 = 16;
    let shares = line.base_shares(depth_mm);
    let one = |place: u32| {
        let off = (f64::from(place) + 0.5) / f64::from(OFFSET_SAMPLES) - 0.5;
        shares.left_of((half - off) * pitch_mm) - shares.left_of((-half - off) * pitch_mm)
    };
    (0..OFFSET_SAMPLES).map(one).sum::<f64>() / f64::from(OFFSET_SAMPLES)
}

/// Penetration of the pin into the pad: at the middle (mm), its change from row to row, and which
/// rows are on the pin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Depths {
    /// Under the middle of the rows (mm).
    pub middle_mm: f64,
    /// More with each row (mm).
    pub per_row_mm: f64,
    /// Rows of the array.
    pub count: usize,
    /// Rows that lie on the pin; none beyond those of the array.
    pub present: [bool; ROWS_MAX],
}

impl Depths {
    /// Distance of a row from the middle (rows).
    fn row_offset(&self, index: usize) -> f64 {
        index as f64 - 0.5 * (self.count as f64 - 1.0)
    }

    fn at_row(&self, index: usize) -> f64 {
        self.middle_mm + self.per_row_mm * self.row_offset(index)
    }

    fn rows(&self) -> usize {
        self.present[..self.count].iter().filter(|on| **on).count()
    }
}

impl ContactModel {
    /// Solves the contact of the nominal pin and pad; allocates.
    ///
    /// # Errors
    /// A layer or radius that the theory of contact cannot take.
    pub fn new(
        model: &ModelParameters,
        array: &Array,
        m0_counts: f64,
    ) -> Result<ContactModel, Invalid> {
        let Array { pitch_x_mm, pitch_y_mm, .. } = *array;
        let layer = Layer::new(model.pad_thickness_mm, model.pad_mpa, model.pad_poisson)
            .map_err(|bad| Invalid::new("model.pad_mpa", bad.what, bad.remedy))?;
        let deepest_mm = (0.2 * model.pad_thickness_mm).min(0.2 * model.pin_radius_mm);
        let line = line_contact(&layer, model.pin_radius_mm, deepest_mm, true)
            .map_err(|bad| Invalid::new("model.pin_radius_mm", bad.what, bad.remedy))?;
        let per_row = pitch_y_mm * model.counts_per_n;
        let load = core::array::from_fn(|place| {
            line.load_n_mm(deepest_mm * place as f64 / (TABLE_POINTS - 1) as f64) * per_row
        });
        let per_mrad = 1e-3 * model.support_nm_rad * 1e3 * model.counts_per_n / pitch_y_mm;
        let compliance = [1.0 / (model.support_n_mm * model.counts_per_n), 1.0 / per_mrad];
        let even_mm = line.penetration_mm(m0_counts / f64::from(array.rows) / per_row);
        let band_correction = 1.0 / band_share(&line, even_mm, array).clamp(0.5, 1.5);
        let shares = line.base_shares(even_mm);
        let profile = LoadProfile::new(array.band_half_columns(), |away| {
            shares.left_of((away + 0.5) * pitch_x_mm) - shares.left_of((away - 0.5) * pitch_x_mm)
        });
        let array = *array;
        Ok(ContactModel {
            load,
            deepest_mm,
            m0_counts,
            array,
            compliance,
            band_correction,
            profile,
        })
    }

    /// How the wanted load spreads over the columns.
    #[must_use]
    pub fn profile(&self) -> LoadProfile {
        self.profile
    }

    /// Whole load over the load in the band about the line: tails of the pressure under the layer
    /// reach further, and beyond them the base is in tension.
    #[must_use]
    pub fn band_correction(&self) -> f64 {
        self.band_correction
    }

    /// Sets another desired sum.
    pub fn set_m0_counts(&mut self, m0_counts: f64) {
        self.m0_counts = m0_counts;
    }

    /// Load (counts) and stiffness (counts/mm) of a row at a depth (mm); a straight line on from
    /// the deepest one.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    fn row_load(&self, depth_mm: f64) -> (f64, f64) {
        if depth_mm <= 0.0 || depth_mm.is_nan() {
            return (0.0, 0.0);
        }
        let per_mm = (TABLE_POINTS - 1) as f64 / self.deepest_mm;
        let place = depth_mm * per_mm;
        let below = (place.min(TABLE_POINTS as f64) as usize).min(TABLE_POINTS - 2);
        let rise = self.load[below + 1] - self.load[below];
        (self.load[below] + rise * (place - below as f64), rise * per_mm)
    }

    /// Depth (mm) of a row with this load.
    fn depth_mm(&self, counts: f64) -> f64 {
        let above = self.load.partition_point(|load| *load < counts).clamp(1, TABLE_POINTS - 1);
        let rise = (self.load[above] - self.load[above - 1]).max(1e-9);
        let place = (above - 1) as f64 + (counts - self.load[above - 1]) / rise;
        self.deepest_mm * place / (TABLE_POINTS - 1) as f64
    }

    /// How deep the pin lies, by the sum and the moment of the load.
    #[must_use]
    pub fn depths(&self, line: &Line) -> Depths {
        let [_, m0, m_x, _] = line.features;
        let m0 = m0.max(LOAD_SHARE_MIN * self.m0_counts);
        let count = self.array.row_count();
        let mut present = [false; ROWS_MAX];
        present[..count].fill(true);
        let whole = self.depths_of_rows(present, m0, m_x);
        let even = self.m0_counts / count as f64;
        for (index, on) in present[..count].iter_mut().enumerate() {
            let due = self.row_load(whole.at_row(index)).0;
            *on = due < 0.5 * even || line.rows[index] > ROW_LOAD_SHARE_MIN * due;
        }
        let missing = present[..count].iter().any(|on| !on);
        let some = Depths { present, ..whole };
        if missing && some.rows() >= ROWS_MIN {
            self.depths_of_rows(present, m0, m_x)
        } else {
            whole
        }
    }

    fn depths_of_rows(&self, present: [bool; ROWS_MAX], m0: f64, m_x: f64) -> Depths {
        let count = self.array.row_count();
        let mut found = Depths { middle_mm: 0.0, per_row_mm: 0.0, count, present };
        let ends = |index: Option<usize>| index.map_or(0.0, |index| found.row_offset(index));
        let low = ends(present.iter().position(|on| *on)) + 0.4;
        let high = ends(present.iter().rposition(|on| *on)) - 0.4;
        let m_x = m_x.clamp(low.min(high) * m0, high.max(low) * m0);
        found.middle_mm = self.depth_mm(m0 / found.rows().max(1) as f64);
        let half = 0.5 * count as f64;
        let stride = NEWTON_STEP_SHARE_MAX * self.deepest_mm;
        for _ in 0..NEWTON_STEPS_MAX {
            let [mut f0, mut f1, mut k0, mut k1, mut k2] = [-m0, -m_x, 0.0, 0.0, 0.0];
            for index in (0..count).filter(|index| present[*index]) {
                let (y, (load, k)) = (found.row_offset(index), self.row_load(found.at_row(index)));
                f0 += load;
                f1 += y * load;
                k0 += k;
                k1 += k * y;
                k2 += k * y * y;
            }
            if f0.abs() < 1e-4 * m0 && f1.abs() < 1e-3 * m0 {
                break;
            }
            // One row alone does not determine a direction, so a small part of its stiffness is
            // added on the diagonal.
            let (a, b, d) = (1.001 * k0 + 1e-9, k1, k2 + 0.01 * k0 + 1e-9);
            let scale = 1.0 / (a * d - b * b).max(1e-18);
            let step = [-(d * f0 - b * f1) * scale, -(a * f1 - b * f0) * scale];
            let size = step[0].abs().max(half * step[1].abs());
            let part = if size > stride { stride / size } else { 1.0 };
            found.middle_mm += part * step[0];
            found.per_row_mm += part * step[1];
        }
        found
    }

    /// Sums of k, k y and k y^2 over the rows, of the chords from where they are to the even depth.
    fn chord_stiffness_sums(&self, depths: &Depths) -> [f64; 3] {
        let even = self.m0_counts / depths.rows().max(1) as f64;
        let due_mm = self.depth_mm(even);
        let mut sums = [0.0; 3];
        for index in (0..depths.count).filter(|index| depths.present[*index]) {
            let depth_mm = depths.at_row(index);
            let left_mm = due_mm - depth_mm;
            let k = if left_mm.abs() < 0.02 * due_mm {
                self.row_load(due_mm).1
            } else {
                (even - self.row_load(depth_mm).0) / left_mm
            };
            let y = depths.row_offset(index);
            sums = [sums[0] + k, sums[1] + k * y, sums[2] + k * y * y];
        }
        sums
    }

    /// dF/dX from an image to the set point: F = (x_c columns, M0 counts, M_x counts x rows,
    /// theta_z mrad) over X = (x mm, z mm, theta_x mrad, theta_z mrad).
    #[must_use]
    pub fn jacobian(&self, line: &Line) -> Matrix4<f64> {
        let middle = self.array.middle_row();
        let rows_per_column = self.array.rows_per_column();
        let [k0, k1, k2] = self.chord_stiffness_sums(&self.depths(line));
        // A turn by 1 mrad lowers row y by y x pitch x 1e-3 mm.
        let lever = 1e-3 * self.array.pitch_y_mm;
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
        let m0 = line.features[1].max(LOAD_SHARE_MIN * self.m0_counts);
        let y_c = line.y_c - middle;
        // In columns a row, as is the centroid's way with a turn.
        let slope = -libm::tan(line.features[3]) * rows_per_column;
        // The centroid's way along y with the tilt, times the line's slope.
        let x_t = slope * (mx_t - y_c * m0_t) / m0;
        let x_z = slope * (mx_z - y_c * m0_z) / m0;
        Matrix4::new(
            -0.5 / self.array.pitch_x_mm,
            x_z,
            x_t,
            1e-3 * y_c * rows_per_column, //
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

/// The features of one fingertip as a measurement of the four motions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureMeasurement {
    /// Its features over the motions: see [`ContactModel::jacobian`].
    pub jacobian: Matrix4<f64>,
    /// Features wanted minus found.
    pub error: [f64; 4],
    /// Variance of each feature.
    pub variance: [f64; 4],
}

/// The displacement that corrects the errors of all fingertips that touch the pin, combined in the
/// order given, and its variances.
#[must_use]
pub fn displacement<'a>(
    felt: impl IntoIterator<Item = &'a FeatureMeasurement>,
) -> ([f64; 4], [f64; 4]) {
    let mut normal = Matrix4::zeros();
    let mut right = Vector4::zeros();
    for FeatureMeasurement { jacobian, error, variance } in felt {
        for f in 0..4 {
            let weight = 1.0 / variance[f].max(1e-12);
            for i in 0..4 {
                right[i] += jacobian[(f, i)] * weight * error[f];
                for j in 0..4 {
                    normal[(i, j)] += jacobian[(f, i)] * weight * jacobian[(f, j)];
                }
            }
        }
    }
    for i in 0..4 {
        normal[(i, i)] += 1.0 / (PRIOR_DEVIATIONS[i] * PRIOR_DEVIATIONS[i]);
    }
    let Some(factor) = normal.cholesky() else {
        return ([0.0; 4], PRIOR_DEVIATIONS.map(|p| p * p));
    };
    let step = factor.solve(&right);
    let covariance = factor.inverse();
    (step.into(), core::array::from_fn(|i| covariance[(i, i)]))
}
