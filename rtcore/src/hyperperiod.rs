//! The releases of all lanes until their pattern repeats, as a table for people and for checks that
//! must look at every job. A table with more than [`RELEASES_MAX`] releases, which nobody could
//! read, is refused with the numbers.

use taktil_hal::{Invalid, Nanos};

use crate::schedule::LaneSpec;

/// Most releases in one table.
pub const RELEASES_MAX: i64 = 4096;

/// One release.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Release {
    /// Since the start of the table.
    pub at: Nanos,
    /// Number of the lane, in the order given.
    pub lane: usize,
    /// Which job of the lane in this table, from 0.
    pub job: u64,
}

/// All releases over one hyperperiod, counted from instant 0 of the machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    /// After this the pattern repeats.
    pub length: Nanos,
    /// By time; at one instant the higher priority first, then the order of the lanes.
    pub releases: Vec<Release>,
}

/// The least common multiple of periods; `None` for no periods, one that is not positive, or when
/// it does not fit an `i64` of nanoseconds.
#[must_use]
pub fn length(periods: impl IntoIterator<Item = Nanos>) -> Option<Nanos> {
    let mut all: Option<i64> = None;
    for Nanos(period) in periods {
        if period <= 0 {
            return None;
        }
        let so_far = all.unwrap_or(1);
        all = Some(so_far.checked_mul(period / common_divisor(so_far, period))?);
    }
    all.map(Nanos)
}

/// Euclid's algorithm on positive numbers; ends because the second number shrinks.
fn common_divisor(mut a: i64, mut b: i64) -> i64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// How many jobs lanes of these periods release in `length`; saturates.
pub(crate) fn release_count(length: Nanos, periods: impl IntoIterator<Item = Nanos>) -> i64 {
    periods.into_iter().fold(0, |sum, period| sum.saturating_add(length.0 / period.0.max(1)))
}

/// The table of a machine's lanes.
///
/// # Errors
/// No lane, a hyperperiod that does not fit, more than [`RELEASES_MAX`] releases. The place is
/// `lane`.
pub fn table(lanes: &[&LaneSpec]) -> Result<Table, Invalid> {
    let periods = || lanes.iter().map(|lane| lane.period);
    let listed = || {
        let each: Vec<String> =
            lanes.iter().map(|lane| format!("{} {}", lane.name, lane.period)).collect();
        each.join(", ")
    };
    let remedy = "give the lanes periods that divide each other";
    let length = length(periods()).ok_or_else(|| {
        Invalid::new("lane", format!("the periods never meet again: {}", listed()), remedy)
    })?;
    let releases = release_count(length, periods());
    if releases > RELEASES_MAX {
        let what = format!(
            "the periods meet after {length}, {releases} releases (at most {RELEASES_MAX}): {}",
            listed()
        );
        return Err(Invalid::new("lane", what, remedy));
    }
    let mut all = Vec::new();
    for (lane, spec) in lanes.iter().enumerate() {
        for job in 0..spec.jobs_before(length) {
            all.push(Release { at: spec.release(job), lane, job });
        }
    }
    all.sort_by_key(|r| (r.at, core::cmp::Reverse(lanes[r.lane].priority), r.lane));
    Ok(Table { length, releases: all })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lane(name: &str, period_us: i64, phase_us: i64, priority: u8) -> LaneSpec {
        let mut lane = LaneSpec::new(name, Nanos::from_micros(period_us), priority);
        lane.phase = Nanos::from_micros(phase_us);
        lane
    }

    #[test]
    fn the_rolling_machine_repeats_after_five_milliseconds() {
        let (servo, touch, world) =
            (lane("servo", 2500, 0, 80), lane("touch", 5000, 0, 75), lane("world", 2500, 1250, 70));
        let table = table(&[&touch, &servo, &world]).unwrap();
        assert_eq!(table.length, Nanos::from_millis(5));
        let seen: Vec<(i64, usize, u64)> =
            table.releases.iter().map(|r| (r.at.0 / 1000, r.lane, r.job)).collect();
        // At one instant the servo, lane 1, comes before the touch lane: priority 80 over 75.
        assert_eq!(seen, [(0, 1, 0), (0, 0, 0), (1250, 2, 0), (2500, 1, 1), (3750, 2, 1)]);
    }

    #[test]
    fn absurd_tables_are_refused_with_their_numbers() {
        let (a, b) = (lane("a", 1001, 0, 2), lane("b", 9973, 0, 1));
        let refused = table(&[&a, &b]).unwrap_err();
        assert!(refused.what.contains("9982973 us, 10974 releases"), "{refused}");
        let mut primes: Vec<LaneSpec> = Vec::new();
        for period in [9_999_999_967, 9_999_999_943, 9_999_999_929] {
            primes.push(LaneSpec::new("p", Nanos(period), 1));
        }
        let primes: Vec<&LaneSpec> = primes.iter().collect();
        assert!(table(&primes).unwrap_err().what.contains("never meet"));
        assert!(table(&[]).is_err());
    }

    #[test]
    fn lengths_of_nothing_and_of_nonsense_do_not_exist() {
        assert_eq!(length([]), None);
        assert_eq!(length([Nanos(5), Nanos(0)]), None);
        assert_eq!(length([Nanos(-5)]), None);
        assert_eq!(length([Nanos(7)]), Some(Nanos(7)));
        assert_eq!(length([Nanos(4), Nanos(6), Nanos(10)]), Some(Nanos(60)));
        assert_eq!(length([Nanos(i64::MAX), Nanos(i64::MAX - 1)]), None);
    }
}
