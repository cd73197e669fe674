//! The hash of a task's state: one number a job, so that two runs can be compared where no port
//! shows a difference yet. It folds the bits of numbers, in order, and nothing else: it is no
//! checksum of files and no hash of tables.

use taktil_hal::Nanos;

use crate::fault::{FaultCode, FaultSet};
use crate::mode::Mode;

/// Start of every fold: the fractional part of the golden ratio times 2^64.
const HASH_SEED: u64 = 0x9E37_79B9_7F4A_7C15;
/// An odd multiplier with well-mixed bits: that of Knuth's MMIX generator.
const HASH_MULTIPLIER: u64 = 0x5851_F42D_4C95_7F2D;

/// A fold of numbers into 64 bits.
///
/// For each word w: h = (rotl(h, 23) xor w) x 0x5851F42D4C957F2D, then h = h xor (h >> 32).
/// For a given h this is a bijection of w, and for a given w a bijection of h: two folds that
/// differ in one word only always differ at the end. Numbers are folded by their bits, so that
/// -0.0 is not 0.0 and one NaN is not another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateHash(u64);

impl Default for StateHash {
    fn default() -> StateHash {
        StateHash::new()
    }
}

impl StateHash {
    /// Nothing folded yet.
    #[must_use]
    pub const fn new() -> StateHash {
        StateHash(HASH_SEED)
    }

    /// A fold that stands at `value`.
    pub(crate) const fn from_value(value: u64) -> StateHash {
        StateHash(value)
    }

    /// Folds one word.
    #[inline]
    pub fn word(&mut self, word: u64) -> &mut StateHash {
        let product = (self.0.rotate_left(23) ^ word).wrapping_mul(HASH_MULTIPLIER);
        self.0 = product ^ (product >> 32);
        self
    }

    /// Folds a value, field by field.
    #[inline]
    pub fn add<T: Fold + ?Sized>(&mut self, value: &T) -> &mut StateHash {
        value.fold(self);
        self
    }

    /// What was folded so far.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0
    }
}

/// Something whose bits can be folded. [`payload!`](macro@crate::payload) implements it.
pub trait Fold {
    /// Folds every number of it, in a fixed order.
    fn fold(&self, hash: &mut StateHash);
}

macro_rules! numbers {
    ($($ty:ty => |$v:ident| $word:expr;)*) => {$(
        // Called for each number of a state from other crates.
        impl Fold for $ty {
            #[inline]
            fn fold(&self, hash: &mut StateHash) {
                let $v = *self;
                hash.word($word);
            }
        }
    )*};
}

numbers! {
    f64 => |v| v.to_bits();
    f32 => |v| u64::from(v.to_bits());
    i64 => |v| v.cast_unsigned();
    u64 => |v| v;
    usize => |v| v as u64;
    i32 => |v| u64::from(v.cast_unsigned());
    u32 => |v| u64::from(v);
    i16 => |v| u64::from(v.cast_unsigned());
    u16 => |v| u64::from(v);
    u8 => |v| u64::from(v);
    bool => |v| u64::from(v);
    Nanos => |v| v.0.cast_unsigned();
    FaultSet => |v| v.0;
    FaultCode => |v| u64::from(v as u16);
    Mode => |v| u64::from(v as u8);
}

impl<T: Fold> Fold for [T] {
    #[inline]
    fn fold(&self, hash: &mut StateHash) {
        for value in self {
            value.fold(hash);
        }
    }
}

impl<T: Fold, const N: usize> Fold for [T; N] {
    #[inline]
    fn fold(&self, hash: &mut StateHash) {
        self.as_slice().fold(hash);
    }
}

impl<T: Fold> Fold for Option<T> {
    #[inline]
    fn fold(&self, hash: &mut StateHash) {
        hash.word(u64::from(self.is_some()));
        if let Some(value) = self {
            value.fold(hash);
        }
    }
}

impl<A: Fold, B: Fold> Fold for (A, B) {
    #[inline]
    fn fold(&self, hash: &mut StateHash) {
        self.0.fold(hash);
        self.1.fold(hash);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of<T: Fold>(value: T) -> u64 {
        StateHash::new().add(&value).value()
    }

    #[test]
    fn the_fold_is_the_documented_one() {
        let by_hand = (HASH_SEED.rotate_left(23) ^ 1).wrapping_mul(0x5851_F42D_4C95_7F2D);
        assert_eq!(of(1u64), by_hand ^ (by_hand >> 32));
        assert_eq!(StateHash::new().value(), HASH_SEED);
        // Pinned: a hash that stands in a log must mean the same next year.
        assert_eq!(of([1.0, -2.5, 3.25e-3]), 0x742c_eb83_46b2_59b4);
    }

    #[test]
    fn every_bit_order_and_presence_counts() {
        let base = of([1.0, 2.0, 0.0]);
        for other in [[2.0, 1.0, 0.0], [1.0, 2.0, -0.0], [1.0, f64::from_bits(2), 0.0]] {
            assert_ne!(base, of(other), "{other:?}");
        }
        assert_ne!(of(f64::NAN), of(f64::from_bits(f64::NAN.to_bits() ^ 1)));
        assert_ne!(of(None::<u32>), of(Some(0u32)));
        assert_ne!(of((1u32, 2u32)), of((2u32, 1u32)));
        assert_ne!(of(true), of(false));
        assert_ne!(of(Nanos(-1)), of(Nanos(1)));
    }

    #[test]
    fn one_changed_word_is_always_found() {
        // Whatever follows, the difference cannot vanish: each step is a bijection.
        for bit in 0..64 {
            let (mut a, mut b) = (StateHash::new(), StateHash::new());
            a.word(5);
            b.word(5 ^ (1 << bit));
            for word in 0..1000u64 {
                a.word(word.wrapping_mul(HASH_MULTIPLIER));
                b.word(word.wrapping_mul(HASH_MULTIPLIER));
                assert_ne!(a, b);
            }
        }
    }
}
