//! `[wrist]`: the force/torque sensor. Gauges that do not determine the wrench are an error.

use taktil_mechanics::Matrix6;

use super::section::{Consistency, inside, section};
use super::{Invalid, invalid};

/// Codes of a gauge per newton, unless a scene gives a matrix.
pub const GAUGE_CODES_PER_N: f64 = 20.0;
/// Codes of a gauge per newton metre, unless a scene gives a matrix.
pub const GAUGE_CODES_PER_NM: f64 = 1000.0;

section! {
    /// `[wrist]`
    #[derive(Copy)]
    #[serde(default)]
    pub struct WristConfig {
        /// Whether there is a sensor; without one its gauges stay silent. Default true.
        present: bool,
        /// Codes of each gauge (row) for each component of the wrench on the tool in tool axes (Fx,
        /// Fy, Fz per N, Mx, My, Mz per N m). Default: 20 and 1000 on the diagonal.
        codes_per_n_nm: Option<[[f64; 6]; 6]> [-1e6, 1e6],
        /// Reading of each gauge without load (codes). Default 0.
        bias_codes: [f64; 6] [-2048.0, 2047.0],
        /// Standard deviation of the noise on each gauge (codes). Default 0.
        noise_codes: f64 [0.0, 500.0],
    }
}

/// Smallest determinant, with rows scaled to length 1, of a matrix that counts as invertible.
const DETERMINANT_MIN: f64 = 1e-6;

impl WristConfig {
    /// Matrix from the wrench (N, N m) to the gauge codes.
    #[must_use]
    pub fn matrix(&self) -> Matrix6 {
        match &self.codes_per_n_nm {
            Some(rows) => Matrix6::from_fn(|i, j| rows[i][j]),
            None => Matrix6::from_fn(|i, j| match (i == j, i < 3) {
                (false, _) => 0.0,
                (true, true) => GAUGE_CODES_PER_N,
                (true, false) => GAUGE_CODES_PER_NM,
            }),
        }
    }
}

impl Consistency for WristConfig {
    fn check_consistency(&self, place: &str) -> Result<(), Invalid> {
        // Moments are measured in codes per 20 mm, so that both halves of a row have a similar
        // size.
        let even = |i: usize, m: &Matrix6, j: usize| m[(i, j)] * if j < 3 { 1.0 } else { 0.02 };
        let matrix = self.matrix();
        let scaled = Matrix6::from_fn(|i, j| {
            let square: f64 = (0..6).map(|k| even(i, &matrix, k) * even(i, &matrix, k)).sum();
            if square > 0.0 { even(i, &matrix, j) / square.sqrt() } else { 0.0 }
        });
        if scaled.determinant().abs() < DETERMINANT_MIN {
            let what =
                "cannot be inverted: two gauges see the same, or one sees nothing".to_owned();
            let remedy = "give six rows that differ, as the maker's sheet does";
            return Err(invalid(&inside(place, "codes_per_n_nm"), what, remedy));
        }
        Ok(())
    }
}

impl Default for WristConfig {
    fn default() -> WristConfig {
        WristConfig { present: true, codes_per_n_nm: None, bias_codes: [0.0; 6], noise_codes: 0.0 }
    }
}
