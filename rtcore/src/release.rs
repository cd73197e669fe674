//! Waits for a release: sleeps, or sleeps a little less and spins the rest. The margin of the guard
//! is learnt from the lane's own wake latency and bounded by the share of a processor that the lane
//! may spin. A lane is never released early and never spins for longer than the bound.

use taktil_hal::{Clock, Invalid, Nanos};

/// Largest share of a period that a lane may be allowed to spin.
pub const CPU_SHARE_MAX: f64 = 0.5;
/// Share of a processor that a guard spins at most unless the configuration states one; half of it
/// where the lanes are schedulable only then.
pub const DEFAULT_CPU_SHARE: f64 = 0.2;

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
    /// Always; a schedule that cannot hold with it is refused.
    Always,
    /// On a CPU that the lane names, where every lane still meets its deadline and the kernel
    /// granted a fixed priority; without it the lane sleeps to its release.
    WhenSchedulable,
}

impl Guard {
    /// The guard of a lane whose configuration asks for none: [`DEFAULT_CPU_SHARE`] of each period,
    /// where the lanes are schedulable with it.
    #[must_use]
    pub fn when_schedulable(period: Nanos) -> Guard {
        let spin_max =
            Guard::from_cpu_share(DEFAULT_CPU_SHARE, period).map_or(Nanos::ZERO, |g| g.spin_max);
        Guard { spin_max, given: GuardCondition::WhenSchedulable }
    }

    /// A guard that spins at most `cpu_share_max` of each period.
    ///
    /// # Errors
    /// A share that is not above 0 and at most [`CPU_SHARE_MAX`]. The place is `cpu_share_max`.
    pub fn from_cpu_share(cpu_share_max: f64, period: Nanos) -> Result<Guard, Invalid> {
        if !(cpu_share_max > 0.0 && cpu_share_max <= CPU_SHARE_MAX) {
            return Err(Invalid::new(
                "cpu_share_max",
                format!("a guard cannot burn {cpu_share_max} of a processor"),
                format!("give more than 0 and at most {CPU_SHARE_MAX}, such as 0.1"),
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
const CLASSES_PER_OCTAVE: usize = 4;
/// Upper edge of the first class of latencies.
const FIRST_CLASS_EDGE: Nanos = Nanos::from_micros(1);
/// Number of classes: 1 us to 2^14 us in quarters of an octave.
const LATENCY_CLASSES: usize = 14 * CLASSES_PER_OCTAVE + 1;
/// Above this many latencies all counts are halved: what is older weighs less.
const SAMPLES_MAX: u32 = 4096;
/// Until this many latencies were seen the margin is its bound.
const SAMPLES_MIN: u32 = 64;
/// The margin covers all but one in this many of the latencies that it may cover.
const SAMPLES_PER_EXCEPTION: u32 = 1024;
/// Added to the margin: the time from the return of the sleep to the first reading of the clock,
/// and the width of the classes.
const MARGIN_SLACK: Nanos = Nanos::from_micros(2);

/// Learns how early a lane has to be woken: a high percentile of its wake latency, in classes of
/// a quarter octave, with counts that are halved from time to time.
#[derive(Clone, Debug)]
pub struct WakeMargin {
    bound: Nanos,
    edges: [i64; LATENCY_CLASSES],
    counts: [u32; LATENCY_CLASSES],
    total: u32,
    margin: Nanos,
}

impl WakeMargin {
    /// A margin that never exceeds `bound`.
    #[must_use]
    pub fn new(bound: Nanos) -> WakeMargin {
        let mut edges = [0; LATENCY_CLASSES];
        for (class, edge) in edges.iter_mut().enumerate() {
            // 2^(1/4), 2^(2/4), 2^(3/4) in thousandths: edges need no more.
            let step = [1000, 1189, 1414, 1682][class % CLASSES_PER_OCTAVE];
            *edge = (FIRST_CLASS_EDGE.0 << (class / CLASSES_PER_OCTAVE)) * step / 1000;
        }
        let bound = Nanos(bound.0.max(0));
        WakeMargin { bound, edges, counts: [0; LATENCY_CLASSES], total: 0, margin: bound }
    }

    /// How early to wake.
    #[must_use]
    pub fn get(&self) -> Nanos {
        self.margin
    }

    /// Adds the latency of one wake. A latency beyond the bound carries no information about a
    /// margin within it and is ignored; otherwise a few stalls of a host would keep the margin at
    /// its bound without benefit.
    pub fn learn(&mut self, latency: Nanos) {
        if latency < Nanos::ZERO || latency > self.bound {
            return;
        }
        let class = self.edges.partition_point(|edge| *edge < latency.0).min(LATENCY_CLASSES - 1);
        self.counts[class] += 1;
        self.total += 1;
        if self.total >= SAMPLES_MAX {
            self.total = 0;
            for count in &mut self.counts {
                *count /= 2;
                self.total += *count;
            }
        }
        if self.total < SAMPLES_MIN {
            return;
        }
        let mut beyond = self.total / SAMPLES_PER_EXCEPTION;
        let mut class = LATENCY_CLASSES - 1;
        // From the top: the first class that holds more than may lie beyond the margin.
        while class > 0 && self.counts[class] <= beyond {
            beyond -= self.counts[class];
            class -= 1;
        }
        self.margin = (Nanos(self.edges[class]) + MARGIN_SLACK).min(self.bound);
    }
}

/// Figures of the guard of a lane.
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

/// The result of one wait. All instants are on the given clock.
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
    fn an_invalid_share_is_refused() {
        let period = us(2500);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -0.1, 0.0, 0.51] {
            let invalid = Guard::from_cpu_share(bad, period).unwrap_err();
            assert_eq!(invalid.place, "cpu_share_max", "{bad}");
        }
        assert_eq!(Guard::from_cpu_share(0.1, period).unwrap().spin_max, us(250));
        assert_eq!(Guard::from_cpu_share(CPU_SHARE_MAX, period).unwrap().spin_max, us(1250));
    }

    #[test]
    fn the_margin_starts_at_its_bound_and_comes_down_to_what_was_seen() {
        let mut margin = WakeMargin::new(us(250));
        assert_eq!(margin.get(), us(250));
        for _ in 0..SAMPLES_MIN - 1 {
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
        for _ in 0..6 * SAMPLES_MAX {
            margin.learn(us(3));
        }
        assert!(margin.get() <= us(6), "{}", margin.get());
        let mut none = WakeMargin::new(Nanos(-5));
        none.learn(Nanos::ZERO);
        assert_eq!(none.get(), Nanos::ZERO);
        let mut wide = WakeMargin::new(Nanos::from_secs(5));
        for _ in 0..SAMPLES_MIN {
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
