//! Compares two instruments in neighbouring slices of one run: ratios of adjacent pairs and their
//! medians, with cyclictest against itself as the control. Sums are not compared, because a single
//! slice in which the host takes the processor would decide them.
//!
//! Quantiles are counted from the latest job of a slice down, and refer to the number of periods in
//! a slice, not to the number of jobs: p99.9 of 2000 periods is the third latest job, on both
//! sides. Our executor leaves out the jobs that a stall has cost; cyclictest runs as many later.
//! Counted by jobs, the same stalls would be the second latest here and the third latest there, a
//! factor of 1.3 in a tail such as that of a virtual machine.

use hdrhistogram::Histogram;

use super::measure::{add_counts, histogram};

/// The compared quantiles with their names.
pub const QUANTILE_COLUMNS: [(&str, f64); 5] =
    [("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("p99.9", 0.999), ("max", 1.0)];

/// One ratio for each of [`QUANTILE_COLUMNS`].
pub type Ratios = [f64; 5];

/// The compared pairs of a run.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Periods in a slice.
    periods: u64,
    /// All latencies of cyclictest, ns.
    pub theirs: Histogram<u64>,
    /// Ratios of our latencies to cyclictest's, pair by pair.
    pub ratios: Vec<Ratios>,
    /// Ratios of cyclictest's latencies to its own in the previous slice.
    pub control: Vec<Ratios>,
    last: Option<Histogram<u64>>,
}

/// Median and quartiles of several ratios.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quartiles {
    /// Median.
    pub median: f64,
    /// First quartile.
    pub low: f64,
    /// Third quartile.
    pub high: f64,
}

impl Comparison {
    /// A comparison without pairs, for slices of this many periods.
    #[must_use]
    pub fn new(periods: u64) -> Comparison {
        let (ratios, control) = (Vec::new(), Vec::new());
        Comparison { periods, theirs: histogram(), ratios, control, last: None }
    }

    /// Adds a pair, ours and theirs. The slices run in the order ours, theirs, theirs, ours, so the
    /// slices of cyclictest in pairs 2k and 2k + 1 are neighbours.
    pub fn add_pair(&mut self, ours: &Histogram<u64>, theirs: &Histogram<u64>) {
        self.ratios.push(ratios(ours, theirs, self.periods));
        if let Some(before) = self.last.take() {
            self.control.push(ratios(theirs, &before, self.periods));
        } else {
            self.last = Some(theirs.clone());
        }
        add_counts(&mut self.theirs, theirs);
    }
}

fn ratios(over: &Histogram<u64>, under: &Histogram<u64>, periods: u64) -> Ratios {
    #[expect(clippy::cast_precision_loss, reason = "nanoseconds of a latency")]
    QUANTILE_COLUMNS.map(|(_, quantile)| {
        upper_quantile(over, quantile, periods) as f64
            / upper_quantile(under, quantile, periods).max(1) as f64
    })
}

/// The latency that at most `1 - quantile` of `periods` exceed, ns; 0 where fewer were counted.
fn upper_quantile(latencies: &Histogram<u64>, quantile: f64, periods: u64) -> u64 {
    #[expect(clippy::cast_precision_loss, reason = "far fewer than 2^53 periods")]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to periods")]
    let later = ((1.0 - quantile) * periods as f64).round() as u64;
    let all = latencies.len();
    let mut rest = all.saturating_sub(later);
    for step in latencies.iter_recorded() {
        let count = step.count_at_value();
        if rest <= count {
            return if rest == 0 { 0 } else { step.value_iterated_to() };
        }
        rest -= count;
    }
    0
}

/// Median and quartiles of one column of ratios; `None` for an empty list.
#[must_use]
pub fn quartiles(ratios: &[Ratios], column: usize) -> Option<Quartiles> {
    let mut values: Vec<f64> = ratios.iter().map(|row| row[column]).collect();
    values.sort_by(f64::total_cmp);
    let at = |quarters: usize| {
        // Interpolates linearly between the two neighbouring values.
        let place = (values.len() - 1) * quarters;
        let (index, rest) = (place / 4, (place % 4) as f64 / 4.0);
        let next = values[(index + 1).min(values.len() - 1)];
        values[index] + rest * (next - values[index])
    };
    (!values.is_empty()).then(|| Quartiles { median: at(2), low: at(1), high: at(3) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(value: u64) -> Histogram<u64> {
        let mut found = histogram();
        found.record_n(value, 100).unwrap();
        found
    }

    #[test]
    fn the_middle_is_between_its_neighbours() {
        let rows = |values: &[f64]| values.iter().map(|v| [*v; 5]).collect::<Vec<Ratios>>();
        assert_eq!(quartiles(&[], 0), None);
        let one = quartiles(&rows(&[2.0]), 4).unwrap();
        assert_eq!((one.median, one.low, one.high), (2.0, 2.0, 2.0));
        let two = quartiles(&rows(&[3.0, 1.0]), 0).unwrap();
        assert_eq!((two.median, two.low, two.high), (2.0, 1.5, 2.5));
        let five = quartiles(&rows(&[5.0, 1.0, 100.0, 2.0, 3.0]), 0).unwrap();
        assert_eq!((five.median, five.low, five.high), (3.0, 2.0, 5.0));
    }

    #[test]
    fn pairs_and_controls_are_neighbours_only() {
        let mut comparison = Comparison::new(100);
        // The machine becomes ten times slower between pair 1 and pair 2; no ratio is affected.
        for (ours, theirs) in [(100, 200), (110, 220), (1000, 2000), (1100, 2200)] {
            comparison.add_pair(&all(ours), &all(theirs));
        }
        assert_eq!(comparison.ratios.len(), 4);
        assert_eq!(comparison.control.len(), 2, "slices 0 and 1, 2 and 3");
        for row in comparison.ratios.iter().flatten() {
            assert!((row - 0.5).abs() < 0.01, "{row}");
        }
        for row in comparison.control.iter().flatten() {
            assert!((row - 1.1).abs() < 0.01, "{row}");
        }
        assert_eq!(comparison.theirs.len(), 400);
    }

    #[test]
    fn left_out_jobs_do_not_change_the_quantiles() {
        // In 2000 periods there are three stalls; they ran 2000 jobs, we left 40 out.
        let (mut theirs, mut ours) = (histogram(), histogram());
        for (found, jobs) in [(&mut theirs, 1997), (&mut ours, 1957)] {
            found.record_n(20_000, jobs).unwrap();
            for stall in [400_000, 900_000, 5_000_000] {
                found.record(stall).unwrap();
            }
        }
        assert!(ours.value_at_quantile(0.999) > 2 * theirs.value_at_quantile(0.999), "by jobs");
        let mut comparison = Comparison::new(2000);
        comparison.add_pair(&ours, &theirs);
        assert!(comparison.ratios[0].iter().all(|ratio| *ratio == 1.0), "{:?}", comparison.ratios);
        // The third latest of 2000, the latest, and the one in the middle.
        let at = |quantile| upper_quantile(&theirs, quantile, 2000);
        assert!(theirs.equivalent(at(0.999), 400_000) && theirs.equivalent(at(1.0), 5_000_000));
        assert!(theirs.equivalent(at(0.5), 20_000));
        assert_eq!(upper_quantile(&histogram(), 0.5, 2000), 0);
        assert_eq!(upper_quantile(&all(7), 0.5, 2000), 0, "fewer than lie above");
    }

    #[test]
    fn a_reference_of_zero_does_not_divide() {
        let mut comparison = Comparison::new(100);
        comparison.add_pair(&all(100), &histogram());
        assert!(comparison.ratios[0].iter().all(|ratio| ratio.is_finite()));
    }
}
