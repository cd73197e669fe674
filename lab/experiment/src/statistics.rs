//! Compares two laws on the same seeds: paired differences with intervals by the bootstrap.
//!
//! The interval is that of Efron, Better bootstrap confidence intervals, Journal of the American
//! Statistical Association 82 (1987): percentiles of resampled means, corrected for bias and for
//! skewness (BCa).

use taktil_hal::fault::SplitMix;

/// Means of resampled differences from which an interval is read.
const RESAMPLES_COUNT: usize = 4_000;
/// Seed of the resampling: the same data give the same interval.
const RESAMPLING_SEED: u64 = 1987;
/// Fewest pairs for an interval: with three or fewer the resampled means are a handful of values.
const PAIRS_MIN: usize = 4;
/// Probability outside the interval, half of it on each side.
const OUTSIDE_SHARE: f64 = 0.05;

/// A mean with its interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanInterval {
    /// Mean of the differences.
    pub mean: f64,
    /// Ends of the interval of 95 %; `None` with fewer than four pairs.
    pub interval: Option<[f64; 2]>,
    /// Number of pairs.
    pub pairs: usize,
}

impl MeanInterval {
    /// The mean of `differences`, finite numbers; `None` without any.
    #[must_use]
    pub fn of(differences: &[f64]) -> Option<MeanInterval> {
        let pairs = differences.len();
        if pairs == 0 || differences.iter().any(|d| !d.is_finite()) {
            return None;
        }
        let mean = mean(differences);
        let interval = (pairs >= PAIRS_MIN).then(|| bootstrap_interval(differences, mean));
        Some(MeanInterval { mean, interval, pairs })
    }

    /// Whether the interval excludes zero.
    #[must_use]
    pub fn is_significant(&self) -> bool {
        self.interval.is_some_and(|[low, high]| low > 0.0 || high < 0.0)
    }
}

/// The median of some numbers; `None` without any.
#[must_use]
pub fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    let upper = sorted.get(middle)?;
    Some(if sorted.len() % 2 == 1 { *upper } else { (sorted[middle - 1] + upper) / 2.0 })
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The BCa interval of the mean of at least two numbers.
fn bootstrap_interval(values: &[f64], mean_of_all: f64) -> [f64; 2] {
    let count = values.len();
    let mut random = SplitMix::new(RESAMPLING_SEED);
    let mut means: Vec<f64> = (0..RESAMPLES_COUNT)
        .map(|_| {
            let drawn = (0..count).map(|_| values[random.below(count)]);
            drawn.sum::<f64>() / count as f64
        })
        .collect();
    means.sort_by(f64::total_cmp);
    if means[0] == means[RESAMPLES_COUNT - 1] {
        return [mean_of_all; 2];
    }
    // Means at the estimate itself count half: with few different values they are many.
    let below = means.partition_point(|m| *m < mean_of_all);
    let up_to = means.partition_point(|m| *m <= mean_of_all);
    let share = (below + up_to) as f64 / (2 * RESAMPLES_COUNT) as f64;
    let bias = normal_quantile(share);
    let skew = acceleration(values);
    [OUTSIDE_SHARE / 2.0, 1.0 - OUTSIDE_SHARE / 2.0].map(|share| {
        let shifted = bias + normal_quantile(share);
        let level = normal_share(bias + shifted / (1.0 - skew * shifted));
        let place = level * (RESAMPLES_COUNT - 1) as f64;
        #[expect(clippy::cast_sign_loss, clippy::cast_possible_truncation, reason = "within 0..n")]
        let place = place.clamp(0.0, (RESAMPLES_COUNT - 1) as f64).round() as usize;
        means[place]
    })
}

/// Efron's acceleration for a mean: a sixth of the skewness of the means with one value left out
/// (his equation 6.6).
fn acceleration(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    let sum: f64 = values.iter().sum();
    let left_out: Vec<f64> = values.iter().map(|v| (sum - v) / (count - 1.0)).collect();
    let centre = mean(&left_out);
    let distances = || left_out.iter().map(|m| centre - m);
    let spread: f64 = distances().map(|d| d * d).sum();
    let skew: f64 = distances().map(|d| d * d * d).sum();
    if spread > 0.0 { skew / (6.0 * spread * spread.sqrt()) } else { 0.0 }
}

/// The share of a normal distribution below `x`.
fn normal_share(x: f64) -> f64 {
    0.5 * libm::erfc(-x / std::f64::consts::SQRT_2)
}

/// The inverse of [`normal_share`], by bisection between -8 and 8.
fn normal_quantile(share: f64) -> f64 {
    let (mut low, mut high) = (-8.0, 8.0);
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        if normal_share(middle) < share {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_tables() {
        for (share, z) in [(0.5, 0.0), (0.975, 1.959_964), (0.05, -1.644_854)] {
            assert!((normal_quantile(share) - z).abs() < 1e-6, "{share}");
        }
        assert_eq!(median(&[3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), Some(2.5));
        assert_eq!(median(&[]), None);
    }

    #[test]
    fn few_pairs_have_a_mean_and_no_interval() {
        assert_eq!(MeanInterval::of(&[]), None);
        assert_eq!(MeanInterval::of(&[1.0, f64::NAN]), None);
        let two = MeanInterval::of(&[1.0, 3.0]).unwrap();
        assert_eq!((two.mean, two.interval, two.pairs), (2.0, None, 2));
        let equal = MeanInterval::of(&[0.5; 6]).unwrap();
        assert_eq!(equal.interval, Some([0.5; 2]));
        assert!(equal.is_significant());
    }

    /// Means of 20 numbers from a skewed distribution with mean 1: an interval of 95 % holds the
    /// truth in about that share of trials. The normal interval of such samples holds it in 91 to
    /// 92 %, the percentiles without correction in as few; 90 to 98 % allow for 300 trials.
    #[test]
    fn intervals_hold_the_truth_as_often_as_they_say() {
        let mut random = SplitMix::new(7);
        let mut exponential = || {
            // One less the number is never zero.
            -libm::log(1.0 - random.unit())
        };
        let holds = (0..300).filter(|_| {
            let sample: Vec<f64> = (0..20).map(|_| exponential()).collect();
            let [low, high] = MeanInterval::of(&sample).unwrap().interval.unwrap();
            low <= 1.0 && 1.0 <= high
        });
        let share = holds.count() as f64 / 300.0;
        assert!((0.90..=0.98).contains(&share), "{share}");
    }
}
