//! Converts the codes of the gauges to a wrench: the maker's matrix, inverted once, and the
//! baseline of each gauge. A matrix that cannot be inverted is refused.

use taktil_mechanics::{Joints, Matrix6};
use taktil_rtcore::{Fold, Invalid, StateHash};

/// Largest condition number of a calibration, codes per N beside codes per N m.
const CONDITION_MAX: f64 = 1e6;

/// Newtons and newton metres that one code of each gauge stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    inverse: Matrix6,
}

impl Calibration {
    /// The calibration by a matrix of codes per (Fx, Fy, Fz in N, Mx, My, Mz in N m), one row a
    /// gauge.
    ///
    /// # Errors
    /// A matrix without an inverse.
    pub fn new(codes_per_n_nm: &[[f64; 6]; 6]) -> Result<Calibration, Invalid> {
        let matrix = Matrix6::from_fn(|i, j| codes_per_n_nm[i][j]);
        // A condition number that is NaN is not below the bound either.
        let inverse = matrix.lu().try_inverse();
        let inverse = inverse.filter(|inverse| inverse.norm() * matrix.norm() <= CONDITION_MAX);
        inverse.map(|inverse| Calibration { inverse }).ok_or_else(|| {
            let remedy = "give six rows that differ, as the maker's sheet does";
            Invalid::new("codes_per_n_nm", "cannot be inverted", remedy)
        })
    }

    /// The wrench on the tool in tool axes (N, N m) for codes above the baseline.
    #[must_use]
    pub fn wrench(&self, codes: &Joints) -> Joints {
        self.inverse * codes
    }
}

/// Mean of the first readings, exact in integers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Baseline {
    wanted: u32,
    seen: u32,
    sums: [i64; 6],
}

impl Fold for Baseline {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.seen).add(&self.sums[..]);
    }
}

impl Baseline {
    /// A baseline of this many readings, at least 1.
    #[must_use]
    pub fn new(readings: u32) -> Baseline {
        Baseline { wanted: readings.max(1), seen: 0, sums: [0; 6] }
    }

    /// Whether enough readings were seen.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.seen >= self.wanted
    }

    /// Takes one more reading; without effect once [`Baseline::is_ready`].
    pub fn add_reading(&mut self, codes: &[i32; 6]) {
        if self.is_ready() {
            return;
        }
        for (sum, code) in self.sums.iter_mut().zip(codes) {
            *sum += i64::from(*code);
        }
        self.seen += 1;
    }

    /// Rest level of each gauge (codes).
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "sums of 32-bit codes over 10 000 readings")]
    pub fn codes(&self) -> Joints {
        Joints::from_fn(|i, _| self.sums[i] as f64 / f64::from(self.seen.max(1)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_become_the_wrench_that_made_them() {
        let mut rows = [[0.0; 6]; 6];
        for (i, row) in rows.iter_mut().enumerate() {
            row[i] = if i < 3 { 20.0 } else { 1000.0 };
            row[(i + 1) % 6] = 3.0;
        }
        let calibration = Calibration::new(&rows).unwrap();
        let wrench = Joints::new(1.0, -2.0, 15.0, 0.1, -0.2, 0.05);
        let codes = Matrix6::from_fn(|i, j| rows[i][j]) * wrench;
        assert!((calibration.wrench(&codes) - wrench).amax() < 1e-12);
        rows[5] = rows[4];
        assert_eq!(Calibration::new(&rows).unwrap_err().place, "codes_per_n_nm");
        rows[5] = rows[4].map(|code| 0.1 * code);
        assert!(Calibration::new(&rows).is_err(), "the same direction, weaker");
        rows[5] = [f64::NAN; 6];
        assert!(Calibration::new(&rows).is_err());
    }

    #[test]
    fn the_baseline_is_a_mean_of_the_first_readings_only() {
        let mut baseline = Baseline::new(4);
        for code in [10, 11, 12, 13, 1000] {
            assert_eq!(baseline.is_ready(), code == 1000);
            baseline.add_reading(&[code, -code, 0, 1, i32::MAX, i32::MIN]);
        }
        let codes = baseline.codes();
        assert_eq!((codes[0], codes[1], codes[3]), (11.5, -11.5, 1.0));
        assert_eq!((codes[4], codes[5]), (f64::from(i32::MAX), f64::from(i32::MIN)));
    }
}
