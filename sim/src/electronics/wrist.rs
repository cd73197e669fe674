//! The force/torque sensor at the wrist: six gauges that respond to all components of the wrench
//! through a matrix that the maker states. A matrix that cannot be inverted is an error, because
//! such gauges do not determine the wrench.

use taktil_hal::{AdcCode, FORCE_TORQUE_CHANNELS};
use taktil_mechanics::{Joints, Matrix6};

use super::saturate;
use crate::hash::Hash;
use crate::prng::{Prng, Stream};
use crate::scene::WristConfig;

/// The sensor with its noise.
#[derive(Clone, Debug)]
pub(crate) struct Wrist {
    matrix: Matrix6,
    bias: Joints,
    noise: f64,
    prng: Prng,
}

impl Wrist {
    pub(crate) fn new(config: &WristConfig, seed: u64) -> Wrist {
        Wrist {
            matrix: config.matrix(),
            bias: Joints::from(config.bias_codes),
            noise: config.noise_codes,
            prng: Prng::new(seed, Stream::WristNoise),
        }
    }

    /// Gauge codes of a wrench on the tool in tool axes (N, N m).
    pub(crate) fn read(&mut self, wrench: &Joints) -> [AdcCode; FORCE_TORQUE_CHANNELS] {
        let mut codes = [AdcCode(0); FORCE_TORQUE_CHANNELS];
        for (i, code) in codes.iter_mut().enumerate() {
            let mut sum = self.bias[i];
            for j in 0..FORCE_TORQUE_CHANNELS {
                let share = self.matrix[(i, j)];
                if share != 0.0 {
                    sum += share * wrench[j];
                }
            }
            if self.noise > 0.0 {
                sum += self.noise * self.prng.normal();
            }
            *code = AdcCode(saturate(sum));
        }
        codes
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        if self.noise > 0.0 {
            self.prng.digest(hash);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauges_saturate_and_accept_numbers_that_are_not_finite() {
        let wrench = Joints::new(1.0, -1.0, 1e9, 0.5, f64::NAN, -1e9);
        let mut wrist = Wrist::new(&WristConfig::default(), 1);
        let codes = wrist.read(&wrench).map(|c| c.0);
        assert_eq!(codes, [20, -20, 2047, 500, 0, -2048]);
    }

    #[test]
    fn a_matrix_couples_and_its_inverse_gives_the_wrench_back() {
        let mut config = WristConfig::default();
        let mut rows = [[0.0; 6]; 6];
        for (i, row) in rows.iter_mut().enumerate() {
            for (j, entry) in row.iter_mut().enumerate() {
                let (size, other) = if j < 3 { (20.0, 2.0) } else { (1000.0, 40.0) };
                *entry = if i == j { size } else { other * (1.0 - 0.1 * (i + j) as f64) };
            }
        }
        config.codes_per_n_nm = Some(rows);
        config.bias_codes = [3.0, -4.0, 5.0, 0.0, 0.0, 1.0];
        let wrench = Joints::new(5.0, -3.0, 12.0, 0.1, -0.2, 0.05);
        let codes = Wrist::new(&config, 1).read(&wrench);
        let raw = Joints::from_fn(|i, _| f64::from(codes[i].0) - config.bias_codes[i]);
        let back = config.matrix().try_inverse().unwrap() * raw;
        for i in 0..6 {
            let fair = if i < 3 { 0.1 } else { 2e-3 };
            assert!((back[i] - wrench[i]).abs() < fair, "{i}: {back} {wrench}");
        }
    }

    #[test]
    fn noise_has_its_size_and_its_seed() {
        let config = WristConfig { noise_codes: 3.0, ..WristConfig::default() };
        let draw = |seed| {
            let mut wrist = Wrist::new(&config, seed);
            (0..500).map(|_| wrist.read(&Joints::zeros())[2].0).collect::<Vec<_>>()
        };
        let codes = draw(1);
        let square = codes.iter().map(|c| f64::from(c * c)).sum::<f64>() / 500.0;
        assert!((square.sqrt() - 3.0).abs() < 0.4, "{}", square.sqrt());
        assert_eq!(codes, draw(1));
        assert_ne!(codes, draw(2));
    }
}
