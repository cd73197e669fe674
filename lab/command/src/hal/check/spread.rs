//! Distributions of what was measured: times in bins that grow by a constant factor, and mean and
//! standard deviation of values.

use taktil_hal::Nanos;

/// Bins in a factor of ten.
const BINS_PER_DECADE: f64 = 10.0;
/// Upper edge of the first bin (us).
const FIRST_EDGE_US: f64 = 0.1;
/// Bins: up to 100 s.
const BIN_COUNT: usize = 91;

/// Counts of times in bins.
#[derive(Clone, Debug)]
pub(super) struct LogCounts {
    bins: Vec<u64>,
    pub(super) total: u64,
    pub(super) longest: Nanos,
}

impl Default for LogCounts {
    fn default() -> LogCounts {
        LogCounts { bins: vec![0; BIN_COUNT], total: 0, longest: Nanos::ZERO }
    }
}

/// Upper edge of a bin (us).
fn edge_us(bin: usize) -> f64 {
    FIRST_EDGE_US * libm::pow(10.0, bin as f64 / BINS_PER_DECADE)
}

impl LogCounts {
    pub(super) fn add(&mut self, time: Nanos) {
        let place = libm::ceil(BINS_PER_DECADE * libm::log10(time.as_micros_f64() / FIRST_EDGE_US));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let bin = if place > 0.0 { place as usize } else { 0 };
        self.bins[bin.min(BIN_COUNT - 1)] += 1;
        self.total += 1;
        self.longest = self.longest.max(time);
    }

    /// Upper edge of the bin below which this share of all times lies (us); 0 without times. The
    /// longest time bounds it.
    pub(super) fn quantile_us(&self, share: f64) -> f64 {
        let wanted = share * self.total as f64;
        let mut below = 0;
        for (bin, count) in self.bins.iter().enumerate() {
            below += count;
            if *count > 0 && below as f64 >= wanted {
                return edge_us(bin).min(self.longest.as_micros_f64());
            }
        }
        0.0
    }

    /// The share of times in bins that lie wholly above a limit.
    pub(super) fn share_above(&self, limit: Nanos) -> f64 {
        if self.total == 0 {
            return 0.0;
        }
        let limit_us = limit.as_micros_f64();
        let above = self.bins.iter().enumerate().skip(1);
        let above: u64 =
            above.filter(|(bin, _)| edge_us(bin - 1) >= limit_us).map(|(_, count)| count).sum();
        above as f64 / self.total as f64
    }

    /// Upper edges (us) and counts, from the first to the last bin with a time.
    pub(super) fn bins(&self) -> Vec<(f64, f64)> {
        let first = self.bins.iter().position(|count| *count > 0).unwrap_or(0);
        let last = self.bins.iter().rposition(|count| *count > 0).unwrap_or(0);
        (first..=last).map(|bin| (edge_us(bin), self.bins[bin] as f64)).collect()
    }
}

/// Mean, spread and ends of values.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Spread {
    pub(super) count: u64,
    pub(super) mean: f64,
    squares: f64,
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Spread {
    /// Adds a value (Welford 1962: neither sum loses digits).
    pub(super) fn add(&mut self, value: f64) {
        if self.count == 0 {
            (self.low, self.high) = (value, value);
        }
        self.count += 1;
        let before = value - self.mean;
        self.mean += before / self.count as f64;
        self.squares += before * (value - self.mean);
        (self.low, self.high) = (self.low.min(value), self.high.max(value));
    }

    /// The standard deviation; 0 for fewer than two values.
    pub(super) fn deviation(&self) -> f64 {
        if self.count < 2 { 0.0 } else { (self.squares / (self.count - 1) as f64).sqrt() }
    }
}

/// A point of a straight line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// What was put out.
    pub(super) put: f64,
    /// What was read.
    pub(super) read: f64,
}

/// A straight line through points by least squares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    pub(super) slope: f64,
    pub(super) offset: f64,
}

impl Fit {
    /// `None` for fewer than two different abscissas.
    pub(super) fn new(points: &[Sample]) -> Option<Fit> {
        let count = points.len() as f64;
        let mean = |part: fn(&Sample) -> f64| points.iter().map(part).sum::<f64>() / count;
        let (x, y) = (mean(|point| point.put), mean(|point| point.read));
        let square: f64 = points.iter().map(|point| (point.put - x) * (point.put - x)).sum();
        let product: f64 = points.iter().map(|point| (point.put - x) * (point.read - y)).sum();
        (points.len() > 1 && square > 0.0).then(|| {
            let slope = product / square;
            Fit { slope, offset: y - slope * x }
        })
    }

    /// What a point is above the line.
    pub(super) fn residual(&self, point: &Sample) -> f64 {
        point.read - self.offset - self.slope * point.put
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_counted_in_their_bins() {
        let mut times = LogCounts::default();
        for us in [1, 1, 1, 1, 1, 1, 1, 1, 1, 5_000] {
            times.add(Nanos::from_micros(us));
        }
        times.add(Nanos(-5));
        assert!((times.quantile_us(0.5) - 1.0).abs() < 0.3);
        assert!((times.quantile_us(1.0) - 5_000.0).abs() < 1e-9);
        assert!((times.share_above(Nanos::from_millis(1)) - 1.0 / 11.0).abs() < 1e-12);
        assert!(times.share_above(Nanos::from_millis(6)) < 1e-12);
        assert!((LogCounts::default().quantile_us(0.9)).abs() < 1e-12);
        times.add(Nanos::MAX);
        assert_eq!(times.total, 12);
    }

    #[test]
    fn a_spread_is_that_of_its_values() {
        let mut spread = Spread::default();
        for value in [1e9 + 1.0, 1e9 + 2.0, 1e9 + 3.0] {
            spread.add(value);
        }
        assert!((spread.deviation() - 1.0).abs() < 1e-9);
        assert!((spread.high - spread.low - 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_line_goes_through_its_points() {
        let at = |put: f64, read: f64| Sample { put, read };
        let fit = Fit::new(&[at(0.0, 1.0), at(2.0, -3.0)]).unwrap();
        assert_eq!(fit, Fit { slope: -2.0, offset: 1.0 });
        assert!(fit.residual(&at(1.0, 0.0)) > 0.99);
        assert_eq!(Fit::new(&[at(1.0, 1.0), at(1.0, 2.0)]), None);
    }
}
