//! Computes the statistics that a summary holds: percentiles and bins of measured times, and
//! numbers as JSON can hold them.

use hdrhistogram::Histogram;
use taktil_record::summary::Percentiles;

/// Bins of a histogram for one doubling of the time.
const BINS_PER_OCTAVE: u32 = 2;
/// Upper edge of a histogram's first bin (ns).
const FIRST_EDGE_NS: f64 = 100.0;
/// Upper edge beyond which a histogram is cut off (ns).
const LAST_EDGE_NS: f64 = 2e9;

/// A number that JSON can hold: `None` for NaN and infinity.
pub(super) fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// Percentiles (us) of a histogram of nanoseconds.
pub(super) fn percentiles_us(histogram: &Histogram<u64>) -> Percentiles {
    let at = |quantile: f64| micros(histogram.value_at_quantile(quantile));
    Percentiles {
        p50: at(0.5),
        p90: at(0.9),
        p99: at(0.99),
        p99_9: at(0.999),
        max: micros(histogram.max()),
    }
}

#[expect(clippy::cast_precision_loss, reason = "nanoseconds of a job")]
fn micros(ns: u64) -> f64 {
    ns as f64 / 1000.0
}

/// Upper edges (us) and counts of bins that grow by a constant factor, for a picture.
pub(super) fn bins_us(histogram: &Histogram<u64>) -> Vec<(f64, u64)> {
    let mut bins = Vec::new();
    let mut below = 0;
    let mut edge = FIRST_EDGE_NS;
    let factor = libm::exp2(1.0 / f64::from(BINS_PER_OCTAVE));
    while below < histogram.len() {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive ns")]
        let upper = edge as u64;
        let count = histogram.count_between(0, upper).saturating_sub(below);
        bins.push((micros(upper), count));
        below += count;
        edge *= factor;
        if edge > LAST_EDGE_NS {
            break;
        }
    }
    bins
}
