//! Seeded random numbers: one stream of ChaCha8 for each subsystem, so that a new consumer never
//! shifts the numbers of another one. This module has its own maps to uniform and normal numbers,
//! because those of a library may change between releases. The simulation uses no other source of
//! randomness.
//!
//! Normal numbers come from Marsaglia and Tsang's ziggurat (2000) with layer, sign and place from
//! different bits (Doornik 2005): 256 layers of equal area under `exp(-x^2/2)`, of which 98.8 % of
//! the draws need one word, one multiplication and one comparison.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::hash::Hash;

/// The consumers of random numbers; each has a stream of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub(crate) enum Stream {
    /// Noise of the tactile array.
    TactileNoise = 1,
    /// Gains of the tactels, drawn once.
    TactelGains = 2,
    /// Noise of the wrist's gauges.
    WristNoise = 3,
    /// Losses of frames.
    LostFrames = 4,
    /// Noise of the opposed fingertip's array.
    OpposedNoise = 5,
    /// Gains of the opposed fingertip's tactels, drawn once.
    OpposedGains = 6,
    /// Noise of the array on a hand's third finger.
    ThirdNoise = 7,
    /// Gains of the tactels of a hand's third finger, drawn once.
    ThirdGains = 8,
}

/// The random numbers of one subsystem.
#[derive(Clone, Debug)]
pub(crate) struct Prng {
    chacha: ChaCha8Rng,
    layers: Box<ZigguratLayers>,
}

/// Distance between neighbouring uniform numbers: 53 bits.
#[expect(clippy::cast_precision_loss, reason = "a power of two is exact")]
const UNIFORM_STEP: f64 = 1.0 / (1_u64 << 53) as f64;
/// Number of layers of the ziggurat.
const LAYER_COUNT: usize = 256;
/// Place at which the tail begins, and the area of every layer; the lowest layer includes the tail.
const TAIL_START: f64 = 3.654_152_885_361_009;
const LAYER_AREA: f64 = 0.004_928_673_233_974_655;

/// Edges of the layers from the lowest up, of which the last one is 0, and the height of the
/// density there. The first edge is that of a box with the lowest layer's area.
#[derive(Debug, Clone)]
struct ZigguratLayers {
    x: [f64; LAYER_COUNT + 1],
    y: [f64; LAYER_COUNT + 1],
}

fn gaussian(x: f64) -> f64 {
    libm::exp(-0.5 * x * x)
}

impl ZigguratLayers {
    fn new() -> ZigguratLayers {
        let (mut x, mut y) = ([0.0; LAYER_COUNT + 1], [1.0; LAYER_COUNT + 1]);
        (x[0], x[1]) = (LAYER_AREA / gaussian(TAIL_START), TAIL_START);
        for i in 1..LAYER_COUNT {
            y[i] = gaussian(x[i]);
            if i + 1 < LAYER_COUNT {
                x[i + 1] = (-2.0 * libm::log(LAYER_AREA / x[i] + y[i])).sqrt();
            }
        }
        y[0] = gaussian(x[0]);
        ZigguratLayers { x, y }
    }
}

impl Prng {
    /// The stream of one subsystem under a run's seed.
    #[must_use]
    pub(crate) fn new(seed: u64, stream: Stream) -> Prng {
        let mut chacha = ChaCha8Rng::seed_from_u64(seed);
        chacha.set_stream(stream as u64);
        Prng { chacha, layers: Box::new(ZigguratLayers::new()) }
    }

    /// A uniform number in `(0, 1]` with 53 bits.
    #[expect(clippy::cast_precision_loss, reason = "the integer has 53 bits")]
    pub(crate) fn uniform(&mut self) -> f64 {
        ((self.chacha.next_u64() >> 11) + 1) as f64 * UNIFORM_STEP
    }

    /// A normal number with mean 0 and standard deviation 1.
    #[expect(clippy::cast_precision_loss, reason = "the integer has 53 bits")]
    pub(crate) fn normal(&mut self) -> f64 {
        loop {
            // Bits 0 to 7 choose the layer, bit 8 the sign, bits 11 to 63 the place.
            let word = self.chacha.next_u64();
            let layer = (word & 0xFF) as usize;
            let signed = |x: f64| f64::from_bits(x.to_bits() ^ (word & 0x100) << 55);
            // A signed integer is converted to a float by a single instruction.
            let x = (word >> 11).cast_signed() as f64 * UNIFORM_STEP * self.layers.x[layer];
            if x < self.layers.x[layer + 1] {
                return signed(x);
            }
            if layer == 0 {
                return signed(self.tail());
            }
            let (low, high) = (self.layers.y[layer], self.layers.y[layer + 1]);
            if low + (high - low) * self.uniform() < gaussian(x) {
                return signed(x);
            }
        }
    }

    /// A normal number on the condition that it lies in the tail (Marsaglia 1964).
    fn tail(&mut self) -> f64 {
        loop {
            let x = -libm::log(self.uniform()) / TAIL_START;
            let y = -libm::log(self.uniform());
            if 2.0 * y > x * x {
                return TAIL_START + x;
            }
        }
    }

    /// Adds the seed and the position in the stream.
    pub(crate) fn digest(&self, hash: &mut Hash) {
        for byte in self.chacha.get_seed() {
            hash.word(u64::from(byte));
        }
        hash.word(self.chacha.get_stream());
        hash.word(self.chacha.get_word_pos() as u64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_the_moments_of_the_normal_distribution() {
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
    fn layers_have_equal_areas_and_close_at_the_top() {
        let layers = ZigguratLayers::new();
        for i in 1..LAYER_COUNT {
            let area = layers.x[i] * (layers.y[i + 1] - layers.y[i]);
            assert!((area - LAYER_AREA).abs() < 1e-14, "layer {i}: {area}");
            assert!(layers.x[i] > layers.x[i + 1]);
        }
        // The box and its tail: the tail's area by the error function.
        let tail = (0.5 * core::f64::consts::PI).sqrt() * libm::erfc(TAIL_START / 2f64.sqrt());
        let lowest = TAIL_START * layers.y[1] + tail;
        assert!((lowest - LAYER_AREA).abs() < 1e-14, "{lowest}");
    }

    #[test]
    fn normal_numbers_follow_the_distribution_in_the_tails_too() {
        let mut prng = Prng::new(11, Stream::WristNoise);
        let n = 1_000_000;
        let edges: [f64; 10] = [-4.0, -3.66, -3.0, -2.0, -0.5, 0.1, 1.0, 2.5, 3.66, 4.2];
        let mut below = [0_u32; 10];
        for _ in 0..n {
            let x = prng.normal();
            for (count, edge) in below.iter_mut().zip(edges) {
                *count += u32::from(x < edge);
            }
        }
        for (count, edge) in below.into_iter().zip(edges) {
            let due = 0.5 * libm::erfc(-edge / 2f64.sqrt());
            let deviation = (due * (1.0 - due) / f64::from(n)).sqrt();
            let got = f64::from(count) / f64::from(n);
            assert!((got - due).abs() < 4.0 * deviation, "{edge}: {got} {due}");
        }
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
