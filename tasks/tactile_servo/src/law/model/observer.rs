//! A Kalman filter for one axis of the sensor. Its state is the remaining distance `e`, the speed
//! `d` at which the table moves the pin away, and the distance `b` per millimetre of rolling (the
//! slope). Commands still under way are taken into account: a delayed image is compared with the
//! prediction for the instant at which it was taken (O. J. M. Smith 1957; R. E. Kalman 1960).
//!
//! ```text
//! e' = e - u + d dt + b r        u, r: steps commanded along this axis and along x
//! z  = e + U - d T - b R         U, R: commands under way at the image, T: its age and the delay
//! ```
//! `e` is what will be left once the commands so far are carried out; its integral action is `d`,
//! and it cannot wind up because it is told the commands after their limits.

use taktil_rtcore::{Fold, StateHash};

/// What the filter assumes of one axis (unit of the axis: mm or mrad).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProcessNoise {
    /// Process noise of e (unit/sqrt s).
    pub displacement: f64,
    /// Process noise of d (unit/s/sqrt s).
    pub rate: f64,
    /// Process noise of b (unit/mm/sqrt s).
    pub slope: f64,
    /// Bounds of the magnitudes of d and b (unit/s, unit/mm).
    pub bounds: [f64; 2],
    /// Standard deviation of the error that the contact model adds to a measurement (unit).
    pub model: f64,
}

/// The steps that were commanded but not yet carried out when an image was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandsInTransit {
    /// Along the axis (unit).
    pub step: f64,
    /// Along x (mm).
    pub roll_mm: f64,
    /// Time until the last of them is carried out (s).
    pub delay_s: f64,
}

/// The Kalman filter of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisObserver {
    /// e, d, b.
    pub state: [f64; 3],
    /// Their covariance.
    cov: [[f64; 3]; 3],
}

impl Fold for AxisObserver {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.state[..]);
        for row in &self.cov {
            hash.add(&row[..]);
        }
    }
}

impl AxisObserver {
    /// The initial state, in which only the bounds of the quantities are known.
    #[must_use]
    pub fn new(noise: &ProcessNoise) -> AxisObserver {
        let [rate, slope] = noise.bounds;
        let mut cov = [[0.0; 3]; 3];
        cov[0][0] = 1e4;
        cov[1][1] = 0.05 * rate * rate;
        cov[2][2] = 0.01 * slope * slope;
        AxisObserver { state: [0.0; 3], cov }
    }

    /// One job of `dt_s` in which `step` was commanded along the axis and `roll_mm` along x.
    pub fn advance(&mut self, noise: &ProcessNoise, step: f64, roll_mm: f64, dt_s: f64) {
        let [e, d, b] = self.state;
        self.state[0] = e - step + d * dt_s + b * roll_mm;
        let f = [1.0, dt_s, roll_mm];
        let p = self.cov;
        // F P F' with F = [1 dt r; 0 1 0; 0 0 1].
        let row: [f64; 3] = core::array::from_fn(|j| (0..3).map(|k| f[k] * p[k][j]).sum());
        self.cov[0][0] = (0..3).map(|k| row[k] * f[k]).sum::<f64>()
            + noise.displacement * noise.displacement * dt_s;
        for (j, value) in row.iter().enumerate().skip(1) {
            self.cov[0][j] = *value;
            self.cov[j][0] = *value;
        }
        self.cov[1][1] += noise.rate * noise.rate * dt_s;
        self.cov[2][2] += noise.slope * noise.slope * dt_s;
        let [rate, slope] = noise.bounds;
        self.cov[1][1] = self.cov[1][1].min(rate * rate);
        self.cov[2][2] = self.cov[2][2].min(slope * slope);
    }

    /// Updates the state with a measurement of the remaining distance, `measured`, and its
    /// variance, taken when the commands `in_transit` had not been carried out.
    pub fn observe(
        &mut self,
        noise: &ProcessNoise,
        measured: f64,
        variance: f64,
        in_transit: CommandsInTransit,
    ) {
        let CommandsInTransit { step, roll_mm, delay_s } = in_transit;
        let h = [1.0, -delay_s, -roll_mm];
        let p = self.cov;
        let gain: [f64; 3] = core::array::from_fn(|i| (0..3).map(|j| p[i][j] * h[j]).sum());
        let innovation_variance: f64 =
            (0..3).map(|i| h[i] * gain[i]).sum::<f64>() + variance + noise.model * noise.model;
        let [e, d, b] = self.state;
        let innovation = measured - (e + step - d * delay_s - b * roll_mm);
        if !(innovation.is_finite() && innovation_variance > 0.0) {
            return;
        }
        for i in 0..3 {
            self.state[i] += gain[i] / innovation_variance * innovation;
            for j in 0..3 {
                self.cov[i][j] = p[i][j] - gain[i] * gain[j] / innovation_variance;
            }
        }
        for (value, bound) in self.state[1..].iter_mut().zip(noise.bounds) {
            *value = value.clamp(-bound, bound);
        }
    }
}
