//! A 64-bit digest of the world's state, word by word over the bits of every number, so that two
//! runs can be compared instant by instant at little cost: one multiplication for each word. Each
//! step is a bijection of the word and of the earlier digest, so that one changed word always
//! changes the digest. It is not a cryptographic digest.

use glam::DVec3;

/// A digest in progress.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hash(u64);

/// Initial value: the fractional part of the golden ratio times 2^64.
const INITIAL_VALUE: u64 = 0x9E37_79B9_7F4A_7C15;
/// Knuth's multiplier of MMIX, which is odd and has well-mixed bits.
const MMIX_MULTIPLIER: u64 = 0x5851_F42D_4C95_7F2D;

impl Default for Hash {
    fn default() -> Hash {
        Hash(INITIAL_VALUE)
    }
}

impl Hash {
    /// Adds a word.
    pub(crate) fn word(&mut self, word: u64) {
        let product = (self.0.rotate_left(23) ^ word).wrapping_mul(MMIX_MULTIPLIER);
        self.0 = product ^ (product >> 32);
    }

    /// Adds a number by its bits.
    pub(crate) fn number(&mut self, x: f64) {
        self.word(x.to_bits());
    }

    /// Adds several numbers.
    pub(crate) fn numbers(&mut self, xs: &[f64]) {
        for x in xs {
            self.number(*x);
        }
    }

    /// Adds a vector.
    pub(crate) fn vector(&mut self, v: DVec3) {
        self.numbers(&v.to_array());
    }

    /// The digest of all words so far.
    #[must_use]
    pub(crate) fn value(&self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_counts() {
        let digest = |x: f64| {
            let mut hash = Hash::default();
            hash.number(x);
            hash.value()
        };
        assert_ne!(digest(0.0), digest(-0.0));
        assert_ne!(digest(1.0), digest(1.0 + f64::EPSILON));
        assert_eq!(digest(1.0), digest(1.0));
        for bit in 0..64 {
            let (mut a, mut b) = (Hash::default(), Hash::default());
            a.word(5);
            b.word(5 ^ (1 << bit));
            for word in 0..300 {
                a.word(word);
                b.word(word);
                assert_ne!(a.value(), b.value());
            }
        }
    }
}
