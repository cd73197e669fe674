//! Seeded random numbers: one stream of ChaCha8 for each subsystem, so that a new consumer never
//! shifts what another one draws. Owns its maps to uniform and normal numbers, because those of a
//! library may change between releases. Refuses any other source of chance.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::hash::Hash;

/// Who draws; each has numbers of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub(crate) enum Stream {
    /// Noise of the tactile array.
    TactileNoise = 1,
    /// Gains of the tactels, drawn once.
    TactelGains = 2,
    /// Noise of the wrist's gauges.
    WristNoise = 3,
    /// Which frames are lost.
    LostFrames = 4,
}

/// One subsystem's stream.
#[derive(Clone, Debug)]
pub(crate) struct Prng {
    chacha: ChaCha8Rng,
    spare: Option<f64>,
}

impl Prng {
    /// The stream of one subsystem under a run's seed.
    #[must_use]
    pub(crate) fn new(seed: u64, stream: Stream) -> Prng {
        let mut chacha = ChaCha8Rng::seed_from_u64(seed);
        chacha.set_stream(stream as u64);
        Prng { chacha, spare: None }
    }

    /// Uniform in `(0, 1]`, 53 bits.
    #[expect(clippy::cast_precision_loss, reason = "the integer has 53 bits")]
    pub(crate) fn uniform(&mut self) -> f64 {
        const STEP: f64 = 1.0 / (1_u64 << 53) as f64;
        ((self.chacha.next_u64() >> 11) + 1) as f64 * STEP
    }

    /// Normal with mean 0 and standard deviation 1 (Box and Muller 1958, both numbers used).
    pub(crate) fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let radius = (-2.0 * libm::log(self.uniform())).sqrt();
        let (sin, cos) = libm::sincos(core::f64::consts::TAU * self.uniform());
        self.spare = Some(radius * sin);
        radius * cos
    }

    /// Adds seed and place in the stream.
    pub(crate) fn digest(&self, hash: &mut Hash) {
        for byte in self.chacha.get_seed() {
            hash.word(u64::from(byte));
        }
        hash.word(self.chacha.get_stream());
        hash.word(self.chacha.get_word_pos() as u64);
        hash.number(self.spare.unwrap_or(f64::INFINITY));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_have_the_moments_of_the_bell() {
        let mut prng = Prng::new(7, Stream::TactileNoise);
        let (mut sums, n) = ([0.0; 4], 200_000);
        for _ in 0..n {
            let x = prng.normal();
            let mut power = 1.0;
            for sum in &mut sums {
                power *= x;
                *sum += power / f64::from(n);
            }
        }
        assert!(sums[0].abs() < 0.01, "mean {}", sums[0]);
        assert!((sums[1] - 1.0).abs() < 0.015, "variance {}", sums[1]);
        assert!(sums[2].abs() < 0.04, "skewness {}", sums[2]);
        assert!((sums[3] - 3.0).abs() < 0.1, "kurtosis {}", sums[3]);
    }

    #[test]
    fn uniform_numbers_never_give_an_infinite_normal() {
        let mut prng = Prng::new(0, Stream::TactileNoise);
        for _ in 0..100_000 {
            let u = prng.uniform();
            assert!(u > 0.0 && u <= 1.0);
        }
    }

    #[test]
    fn seeds_and_only_seeds_choose_the_numbers() {
        let draw = |seed| {
            let mut prng = Prng::new(seed, Stream::TactileNoise);
            [prng.normal(), prng.normal(), prng.normal()].map(f64::to_bits)
        };
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
    }
}
