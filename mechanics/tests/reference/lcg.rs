//! Repeatable random joint vectors from a linear congruential generator. Its quality is enough to
//! spread test poses.

use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;

/// A linear congruential generator, constants of Knuth's MMIX.
pub(crate) struct Lcg(u64);

impl Lcg {
    pub(crate) fn new(seed: u64) -> Lcg {
        Lcg(seed)
    }

    /// Uniform in [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        #[expect(clippy::cast_precision_loss, reason = "53 bits fit")]
        let bits = (self.0 >> 11) as f64;
        bits / 9_007_199_254_740_992.0
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Joints inside the limits of the arm.
    pub(crate) fn joints(&mut self, arm: &Puma260) -> Joints {
        Joints::from_fn(|i, _| self.between(arm.q_min_rad[i], arm.q_max_rad[i]))
    }

    pub(crate) fn six(&mut self, size: f64) -> Joints {
        Joints::from_fn(|_, _| self.between(-size, size))
    }
}
