//! Numbers for tests that try many cases: the sequence repeats, its quality does not matter. Where
//! it does, use `rand_chacha`.

/// A linear congruential generator (Knuth's MMIX), of which the upper bits are used.
#[derive(Clone, Debug)]
pub struct Dice(u64);

impl Dice {
    /// The same seed gives the same numbers, on any machine.
    #[must_use]
    pub const fn new(seed: u64) -> Dice {
        Dice(seed)
    }

    /// A number from 0 up to, and without, `sides`.
    pub fn roll(&mut self, sides: u64) -> u64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % sides
    }

    /// A number from `low` up to, and without, `high`, in steps of 2^-31 of the range.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        const RANGE_PARTS: u32 = 1 << 31;
        let part = u32::try_from(self.roll(RANGE_PARTS.into())).unwrap_or(0);
        low + (high - low) * f64::from(part) / f64::from(RANGE_PARTS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_repeats_and_every_side_comes_up() {
        let rolls = |seed| {
            let mut dice = Dice::new(seed);
            (0..600).map(|_| dice.roll(6)).collect::<Vec<u64>>()
        };
        assert_eq!(rolls(3), rolls(3));
        assert_ne!(rolls(3), rolls(4));
        for side in 0..6 {
            let count = rolls(3).iter().filter(|roll| **roll == side).count();
            assert!((70..130).contains(&count), "{side}: {count}");
        }
        let mut dice = Dice::new(1);
        assert!((0..1000).all(|_| (-2.0..3.0).contains(&dice.between(-2.0, 3.0))));
    }
}
