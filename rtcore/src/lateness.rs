//! How late the jobs of a lane began, counted while it runs for observers on other threads: one
//! bin for each doubling of a microsecond. A job costs one addition, whether anybody looks or not.
//! It orders no other memory accesses, so it must not guard values.

use core::sync::atomic::{AtomicU64, Ordering};

use taktil_hal::Nanos;

/// Number of bins; the last one counts everything from a quarter of a second on.
pub const LATENESS_BINS: usize = 20;
/// Nanoseconds in a microsecond, the upper edge of the first bin.
const FIRST_EDGE_NS: u64 = 1000;

/// The upper edge of each bin but the last, which has none: 1 us, 2 us, 4 us and so on.
#[must_use]
pub fn lateness_edges() -> [Nanos; LATENESS_BINS - 1] {
    core::array::from_fn(|bin| Nanos::from_micros(1 << bin))
}

/// The lateness of a lane's jobs so far.
#[derive(Debug, Default)]
pub struct LatenessCounts {
    bins: [AtomicU64; LATENESS_BINS],
    most_ns: AtomicU64,
}

impl LatenessCounts {
    /// Counts a job that began so late; only the lane's own thread does.
    pub(crate) fn count(&self, lateness_ns: u64) {
        let micros = lateness_ns / FIRST_EDGE_NS;
        let bin = (u64::BITS - micros.leading_zeros()) as usize;
        let count = &self.bins[bin.min(LATENESS_BINS - 1)];
        // Relaxed, as all here: there is one writer, and a reader wants numbers, no order.
        count.store(count.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
        if lateness_ns > self.most_ns.load(Ordering::Relaxed) {
            self.most_ns.store(lateness_ns, Ordering::Relaxed);
        }
    }

    /// Jobs in each bin.
    #[must_use]
    pub fn counts(&self) -> [u64; LATENESS_BINS] {
        core::array::from_fn(|bin| self.bins[bin].load(Ordering::Relaxed))
    }

    /// The latest begin so far.
    #[must_use]
    pub fn most(&self) -> Nanos {
        Nanos(i64::try_from(self.most_ns.load(Ordering::Relaxed)).unwrap_or(i64::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_is_counted_in_the_bin_below_whose_edge_it_began() {
        let counts = LatenessCounts::default();
        for late in [0, 999, 1000, 1999, 2000, 3999, 4000, 300_000_000, u64::MAX] {
            counts.count(late);
        }
        let bins = counts.counts();
        assert_eq!(bins[..4], [2, 2, 2, 1]);
        assert_eq!(bins[LATENESS_BINS - 1], 2);
        assert_eq!(bins.iter().sum::<u64>(), 9);
        assert_eq!(counts.most(), Nanos(i64::MAX));
        let edges = lateness_edges();
        assert_eq!((edges[0], edges[18]), (Nanos::from_micros(1), Nanos::from_micros(262_144)));
    }
}
