//! Estimates when messages would have arrived without the host's delays. Delays are never negative,
//! so the lower envelope of arrival minus number times period is the best line (minimum-delay
//! filter, as in clock synchronisation over packet networks); its slope is the board's period.

use taktil_hal::Nanos;

/// Messages of the first block; each block is twice as long as the one before it.
const BLOCK_FIRST: u32 = 8;
/// Messages of the longest block.
const BLOCK_MAX: u32 = 64;
/// A gap counts as one more missing scan from this share of a period on.
const GAP_ROUNDING: f64 = 0.3;
/// The estimated period stays within the nominal one divided and multiplied by this.
const PERIOD_RATIO_MAX: f64 = 2.0;
/// Weight of a new slope once blocks are long: noise of single blocks averages out, and a board's
/// oscillator drifts slowly.
const SLOPE_WEIGHT: f64 = 0.25;
/// Gaps count as at most so many missing scans.
const MISSING_MAX: f64 = 1e6;

/// One arrival as estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Scans since the arrival before, at least 1; 1 for the first.
    pub advance: u32,
    /// When the message would have arrived without delay; never later than it did.
    pub undelayed: Nanos,
}

/// The envelope of the arrivals of a periodic stream.
#[derive(Clone, Debug)]
pub struct ArrivalEstimator {
    nominal_ns: f64,
    period_ns: f64,
    /// The last arrival and the value of the line there.
    last: Option<(Nanos, Nanos)>,
    block_length: u32,
    block_count: u32,
    number: i64,
    /// Number, arrival and excess of the least delayed message of this block.
    least: Option<(i64, Nanos, i64)>,
    /// Number and arrival of the least delayed message of the block before.
    anchor: Option<(i64, Nanos)>,
    excess_max: i64,
    spread: Nanos,
}

impl ArrivalEstimator {
    /// An estimator for a stream of about this period.
    #[must_use]
    pub fn new(nominal: Nanos) -> ArrivalEstimator {
        let nominal_ns = nominal.0.max(1) as f64;
        ArrivalEstimator {
            nominal_ns,
            period_ns: nominal_ns,
            last: None,
            block_length: BLOCK_FIRST,
            block_count: 0,
            number: 0,
            least: None,
            anchor: None,
            excess_max: 0,
            spread: Nanos::ZERO,
        }
    }

    /// Forgets the line, after a pause; the period stays.
    pub fn interrupt(&mut self) {
        self.last = None;
        self.least = None;
        self.anchor = None;
        self.block_count = 0;
        self.block_length = BLOCK_FIRST;
        self.excess_max = 0;
    }

    /// The period as estimated.
    #[must_use]
    pub fn period(&self) -> Nanos {
        Nanos(self.period_ns as i64)
    }

    /// Largest distance of an arrival from the line in the last whole block.
    #[must_use]
    pub fn spread(&self) -> Nanos {
        self.spread
    }

    /// Takes the arrival of a message; arrivals do not run backwards.
    pub fn observe(&mut self, arrival: Nanos) -> Arrival {
        let Some((last, line)) = self.last else {
            self.last = Some((arrival, arrival));
            self.least = Some((self.number, arrival, 0));
            return Arrival { advance: 1, undelayed: arrival };
        };
        let gap = (arrival.0 - last.0) as f64 / self.period_ns;
        let advance = (gap + GAP_ROUNDING).floor().clamp(1.0, MISSING_MAX);
        self.number += advance as i64;
        let mut undelayed = Nanos(line.0 + (advance * self.period_ns) as i64).min(arrival);
        if (arrival - undelayed).0 as f64 > 2.0 * self.period_ns {
            undelayed = arrival;
            self.anchor = None;
            self.least = None;
        }
        let excess = (arrival - undelayed).0;
        self.excess_max = self.excess_max.max(excess);
        if self.least.is_none_or(|(_, _, least)| excess <= least) {
            self.least = Some((self.number, arrival, excess));
        }
        self.last = Some((arrival, undelayed));
        self.block_count += 1;
        if self.block_count >= self.block_length {
            self.end_block();
        }
        Arrival { advance: advance as u32, undelayed }
    }

    /// Takes the slope between the least delayed messages of two blocks, and lifts the line to the
    /// second of them.
    fn end_block(&mut self) {
        if let Some((number, arrival, excess)) = self.least {
            if let Some((number_before, arrival_before)) = self.anchor
                && number > number_before
            {
                let slope = (arrival.0 - arrival_before.0) as f64 / (number - number_before) as f64;
                let (low, high) =
                    (self.nominal_ns / PERIOD_RATIO_MAX, self.nominal_ns * PERIOD_RATIO_MAX);
                // The first slopes are taken as they are: the nominal period may be far off.
                let settled = self.block_length >= BLOCK_MAX;
                let weight = if settled { SLOPE_WEIGHT } else { 1.0 };
                self.period_ns += weight * (slope.clamp(low, high) - self.period_ns);
            }
            if let Some((last, _)) = self.last {
                let since = ((self.number - number) as f64 * self.period_ns) as i64;
                self.last = Some((last, Nanos(arrival.0 + since).min(last)));
            }
            self.anchor = Some((number, arrival));
            self.spread = Nanos((self.excess_max - excess).max(0));
        }
        self.least = None;
        self.excess_max = 0;
        self.block_count = 0;
        self.block_length = (2 * self.block_length).min(BLOCK_MAX);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_hal::fault::SplitMix;

    #[test]
    fn delays_are_taken_off_and_reported() {
        // The board is one percent slower than its nominal rate, delays are 0 to 2 ms.
        let mut estimator = ArrivalEstimator::new(Nanos::from_micros(5_000));
        let mut random = SplitMix::new(3);
        for number in 0..2_000_i64 {
            let sent = number * 5_050_000;
            let arrival = Nanos(sent + (2e6 * random.unit()) as i64);
            let seen = estimator.observe(arrival);
            assert_eq!(seen.advance, 1, "at {number}");
            assert!(seen.undelayed <= arrival);
            if number > 500 {
                let error = seen.undelayed.0 - sent;
                assert!((-200_000..500_000).contains(&error), "{error} ns at {number}");
            }
        }
        let spread = estimator.spread().0;
        assert!((1_500_000..2_200_000).contains(&spread), "{spread} ns");
        assert!((estimator.period().0 - 5_050_000).abs() < 20_000);
    }

    #[test]
    fn gaps_are_counted_as_scans() {
        let mut estimator = ArrivalEstimator::new(Nanos::from_millis(10));
        let mut advances = Vec::new();
        for at in [0, 10, 20, 50, 60, 1_060, 1_070] {
            advances.push(estimator.observe(Nanos::from_millis(at)).advance);
        }
        assert_eq!(advances, [1, 1, 1, 3, 1, 100, 1]);
    }
}
