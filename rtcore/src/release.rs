//! Waiting for a release: sleep, or sleep a little less and spin the rest. The margin of the guard
//! is learnt from the lane's own wake latency and bounded by the share of a processor that the
//! lane may burn. Refuses to release early, and to spin longer than the bound.

use taktil_hal::{Clock, Invalid, Nanos};

/// Most of a period that a lane may be allowed to spin.
pub const LARGEST_SHARE: f64 = 0.5;
/// Share of a processor that a guard may burn which nobody asked for; half of it where a schedule
/// bears only that.
pub const DEFAULT_SHARE: f64 = 0.2;

/// The release guard of a lane: wake early by a learnt margin, then spin to the release.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Guard {
    /// Longest spin in front of one release; its ratio to the period is the CPU share at most.
    pub spin_max: Nanos,
    /// When the lane gets it.
    pub given: GuardCondition,
}

/// When a lane gets its guard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GuardCondition {
    /// Always; a schedule that does not bear it is refused.
    Always,
    /// On a CPU that the lane names, where every lane still meets its deadline and the kernel
    /// granted a fixed priority; without it the lane sleeps to its release.
    WhenSchedulable,
}

impl Guard {
    /// The guard of a lane that asks for none: [`DEFAULT_SHARE`] of each period, where it is borne.
    #[must_use]
    pub fn where_borne(period: Nanos) -> Guard {
        let spin_max = Guard::of_share(DEFAULT_SHARE, period).map_or(Nanos::ZERO, |g| g.spin_max);
        Guard { spin_max, given: GuardCondition::WhenSchedulable }
    }

    /// A guard that spins at most `cpu_share_max` of each period.
    ///
    /// # Errors
    /// A share that is not above 0 and at most [`LARGEST_SHARE`]. The place is `cpu_share_max`.
    pub fn of_share(cpu_share_max: f64, period: Nanos) -> Result<Guard, Invalid> {
        if !(cpu_share_max > 0.0 && cpu_share_max <= LARGEST_SHARE) {
            return Err(Invalid::new(
                "cpu_share_max",
                format!("a guard cannot burn {cpu_share_max} of a processor"),
                format!("give more than 0 and at most {LARGEST_SHARE}, such as 0.1"),
            ));
        }
        #[expect(clippy::cast_precision_loss, reason = "a period is at most 1e10 ns")]
        let spin = cpu_share_max * period.0 as f64;
        #[expect(clippy::cast_possible_truncation, reason = "at most half a period")]
        let spin_max = Nanos(spin as i64);
        Ok(Guard { spin_max, given: GuardCondition::Always })
    }
}

/// Classes of latency per factor of two.
const PER_OCTAVE: usize = 4;
/// Upper edge of the first class.
const FIRST: Nanos = Nanos::from_micros(1);
/// 1 us to 2^14 us in quarters of an octave.
const CLASSES: usize = 14 * PER_OCTAVE + 1;
/// Above this many latencies all counts are halved: what is older weighs less.
const MEMORY: u32 = 4096;
/// Until so many latencies were seen the margin is its bound.
const ENOUGH: u32 = 64;
/// The margin covers all but one in this many of the latencies that it may cover.
const ONE_IN: u32 = 1024;
/// From the return of the sleep to the first look at the clock, and the grain of the classes.
const SLACK: Nanos = Nanos::from_micros(2);

/// Learns how early a lane has to be woken: a high percentile of its wake latency, in classes of
/// a quarter octave, with counts that are halved from time to time.
#[derive(Clone, Debug)]
pub struct WakeMargin {
    bound: Nanos,
    edges: [i64; CLASSES],
    counts: [u32; CLASSES],
    total: u32,
    margin: Nanos,
}

impl WakeMargin {
    /// A margin that never exceeds `bound`.
    #[must_use]
    pub fn new(bound: Nanos) -> WakeMargin {
        let mut edges = [0; CLASSES];
        for (class, edge) in edges.iter_mut().enumerate() {
            // 2^(1/4), 2^(2/4), 2^(3/4) in thousandths: edges need no more.
            let step = [1000, 1189, 1414, 1682][class % PER_OCTAVE];
            *edge = (FIRST.0 << (class / PER_OCTAVE)) * step / 1000;
        }
        let bound = Nanos(bound.0.max(0));
        WakeMargin { bound, edges, counts: [0; CLASSES], total: 0, margin: bound }
    }

    /// How early to wake.
    #[must_use]
    pub fn get(&self) -> Nanos {
        self.margin
    }

    /// Takes in how late a wake was. A latency beyond the bound says nothing about a margin within
    /// it and is left out; else a few stalls of a host would hold the margin at its bound in vain.
    pub fn learn(&mut self, latency: Nanos) {
        if latency < Nanos::ZERO || latency > self.bound {
            return;
        }
        let class = self.edges.partition_point(|edge| *edge < latency.0).min(CLASSES - 1);
        self.counts[class] += 1;
        self.total += 1;
        if self.total >= MEMORY {
            self.total = 0;
            for count in &mut self.counts {
                *count /= 2;
                self.total += *count;
            }
        }
        if self.total < ENOUGH {
            return;
        }
        let mut beyond = self.total / ONE_IN;
        let mut class = CLASSES - 1;
        // From the top: the first class that holds more than may lie beyond the margin.
        while class > 0 && self.counts[class] <= beyond {
            beyond -= self.counts[class];
            class -= 1;
        }
        self.margin = (Nanos(self.edges[class]) + SLACK).min(self.bound);
    }
}

/// How the guard of a lane went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GuardFigures {
    /// Time spent spinning in all.
    pub spun: Nanos,
    /// From the first wait to the last begin: the time of which `spun` is a share.
    pub over: Nanos,
    /// How early the lane is woken now.
    pub margin: Nanos,
    /// Jobs begun before their release: always 0.
    pub early: u64,
}

impl GuardFigures {
    /// Share of one processor that was spent spinning.
    #[must_use]
    pub fn share(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "a share of a run, for people")]
        let share = self.spun.0 as f64 / self.over.0.max(1) as f64;
        share
    }
}

/// How one wait went. All instants on the given clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wait {
    /// The release on the wall: the logical one and the slip.
    pub release: Nanos,
    /// When the wait began.
    pub entered: Nanos,
    /// The instant that ends it, never before `release`.
    pub begin: Nanos,
    /// Times that the thread went to sleep.
    pub sleeps: u32,
    /// Time spent spinning.
    pub spun: Nanos,
    /// How late the last sleep ended; none when there was no time to sleep.
    pub latency: Option<Nanos>,
}

/// Waits until logical `release` plus `slip`, also when the slip grows meanwhile: sleeps until
/// `margin` before it and spins the rest. Spins at most `margin` for each value of the slip.
pub fn wait(clock: &impl Clock, release: Nanos, margin: Nanos, slip: impl Fn() -> Nanos) -> Wait {
    let entered = clock.now();
    let mut wait =
        Wait { release, entered, begin: entered, sleeps: 0, spun: Nanos::ZERO, latency: None };
    loop {
        wait.release = release + slip();
        let target = wait.release - margin;
        if wait.begin < target {
            clock.sleep_until(target);
            wait.sleeps += 1;
            wait.begin = clock.now();
            wait.latency = Some(wait.begin - target);
        }
        let woke = wait.begin;
        while wait.begin < wait.release {
            core::hint::spin_loop();
            wait.begin = clock.now();
        }
        wait.spun += wait.begin - woke;
        if release + slip() == wait.release {
            return wait;
        }
    }
}

#[cfg(test)]
mod tests {
    use core::cell::Cell;

    use super::*;

    fn us(us: i64) -> Nanos {
        Nanos::from_micros(us)
    }

    #[test]
    fn a_share_that_is_none_is_refused() {
        let period = us(2500);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -0.1, 0.0, 0.51] {
            let invalid = Guard::of_share(bad, period).unwrap_err();
            assert_eq!(invalid.place, "cpu_share_max", "{bad}");
        }
        assert_eq!(Guard::of_share(0.1, period).unwrap().spin_max, us(250));
        assert_eq!(Guard::of_share(LARGEST_SHARE, period).unwrap().spin_max, us(1250));
    }

    #[test]
    fn the_margin_starts_at_its_bound_and_comes_down_to_what_was_seen() {
        let mut margin = WakeMargin::new(us(250));
        assert_eq!(margin.get(), us(250));
        for _ in 0..ENOUGH - 1 {
            margin.learn(us(20));
            assert_eq!(margin.get(), us(250), "too little was seen");
        }
        margin.learn(us(20));
        assert!(margin.get() >= us(20) && margin.get() <= us(26), "{}", margin.get());
    }

    #[test]
    fn the_margin_covers_a_high_percentile_and_not_the_rarest() {
        let mut margin = WakeMargin::new(us(250));
        for n in 0..2000 {
            margin.learn(if n % 50 == 0 { us(100) } else { us(20) });
        }
        assert!(margin.get() >= us(100) && margin.get() <= us(125), "2 % are covered");
        let mut margin = WakeMargin::new(us(250));
        for n in 0..2000 {
            margin.learn(if n == 1500 { us(100) } else { us(20) });
        }
        assert!(margin.get() <= us(26), "0.05 % are not: {}", margin.get());
    }

    #[test]
    fn what_no_margin_may_cover_moves_nothing() {
        let mut margin = WakeMargin::new(us(250));
        for n in 0..2000 {
            margin.learn(if n % 10 == 0 { us(5000) } else { us(20) });
            margin.learn(Nanos::MAX);
            margin.learn(Nanos(-1));
        }
        assert!(margin.get() <= us(26), "{}", margin.get());
    }

    #[test]
    fn the_margin_never_exceeds_its_bound_and_forgets() {
        let mut margin = WakeMargin::new(us(60));
        for _ in 0..500 {
            margin.learn(us(60));
            assert!(margin.get() <= us(60));
        }
        for _ in 0..6 * MEMORY {
            margin.learn(us(3));
        }
        assert!(margin.get() <= us(6), "{}", margin.get());
        let mut none = WakeMargin::new(Nanos(-5));
        none.learn(Nanos::ZERO);
        assert_eq!(none.get(), Nanos::ZERO);
        let mut wide = WakeMargin::new(Nanos::from_secs(5));
        for _ in 0..ENOUGH {
            wide.learn(Nanos::from_secs(1));
        }
        assert!(wide.get() <= Nanos::from_secs(5), "the last class takes what is longer");
    }

    #[test]
    fn edges_ascend() {
        let margin = WakeMargin::new(us(1));
        assert!(margin.edges.windows(2).all(|pair| pair[0] < pair[1]), "{:?}", margin.edges);
    }

    /// A clock that wakes sleepers late and takes some time to be read.
    struct LateClock {
        now: Cell<Nanos>,
        latency: Nanos,
        read: Nanos,
        sleeps: Cell<u32>,
    }

    impl LateClock {
        fn new(now: Nanos, latency: Nanos) -> LateClock {
            LateClock { now: Cell::new(now), latency, read: Nanos(40), sleeps: Cell::new(0) }
        }
    }

    impl Clock for LateClock {
        fn now(&self) -> Nanos {
            let now = self.now.get();
            self.now.set(now + self.read);
            now
        }

        fn sleep_until(&self, instant: Nanos) {
            self.sleeps.set(self.sleeps.get() + 1);
            if instant > self.now.get() {
                self.now.set(instant + self.latency);
            }
        }
    }

    fn still() -> Nanos {
        Nanos::ZERO
    }

    #[test]
    fn without_a_margin_the_wake_latency_is_the_lateness() {
        let clock = LateClock::new(Nanos::ZERO, us(30));
        let wait = wait(&clock, us(1000), Nanos::ZERO, still);
        assert_eq!(wait.begin, us(1030));
        assert_eq!((wait.sleeps, wait.spun, wait.latency), (1, Nanos::ZERO, Some(us(30))));
    }

    #[test]
    fn a_margin_swallows_the_latency_and_never_releases_early() {
        for latency in [0, 1, 20, 49, 50, 51, 300] {
            let clock = LateClock::new(Nanos::ZERO, us(latency));
            let wait = wait(&clock, us(1000), us(50), still);
            assert!(wait.begin >= us(1000), "{latency}: {}", wait.begin);
            let late = (wait.begin - us(1000)).0;
            assert!(late <= us(latency - 50).0.max(40), "{latency}: {late}");
            assert!(wait.spun <= us(50) + Nanos(40), "{}", wait.spun);
            assert_eq!(wait.latency, Some(us(latency)));
        }
    }

    #[test]
    fn too_late_to_sleep_spins_the_rest_only() {
        let clock = LateClock::new(us(980), us(30));
        let found = wait(&clock, us(1000), us(50), still);
        assert_eq!((found.sleeps, found.latency), (0, None));
        assert!(found.begin >= us(1000) && found.spun <= us(20) + Nanos(40));
        let clock = LateClock::new(us(1700), us(30));
        let found = wait(&clock, us(1000), us(50), still);
        assert_eq!((found.begin, found.spun), (us(1700), Nanos::ZERO));
        assert_eq!(clock.sleeps.get(), 0);
    }

    #[test]
    fn a_slip_during_the_wait_is_waited_for() {
        let clock = LateClock::new(Nanos::ZERO, us(30));
        let asked = Cell::new(0);
        // Another lane reports a stall of 4 ms after the first sleep.
        let slip = || {
            asked.set(asked.get() + 1);
            if asked.get() > 1 { us(4000) } else { Nanos::ZERO }
        };
        let found = wait(&clock, us(1000), us(50), slip);
        assert_eq!(found.release, us(5000));
        assert!(found.begin >= us(5000) && found.begin < us(5001), "{}", found.begin);
        assert_eq!(found.sleeps, 2);
        assert!(found.spun <= us(100) + Nanos(80));
    }
}
