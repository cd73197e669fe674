//! A 64-bit digest of the world's state (FNV-1a over the bits of every number), so that two runs
//! can be compared instant by instant. Refuses to be cryptographic.

use glam::DVec3;

/// Collects numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hash(u64);

impl Default for Hash {
    fn default() -> Hash {
        Hash(0xcbf2_9ce4_8422_2325)
    }
}

impl Hash {
    /// Adds a word.
    pub(crate) fn word(&mut self, word: u64) {
        for byte in word.to_le_bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
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

    /// What has been collected so far.
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
    }
}
