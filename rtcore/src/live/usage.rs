//! Reads what the kernel counted for a lane's thread. It does so seldom, because two system calls a
//! job would cost more than all other work of the executor. Counts are read every few jobs, after a
//! job that took unusually long, and after a miss. The usage of the ordinary jobs since the last
//! reading is known from the clock and subtracted, so that a job is not judged by what happened
//! long before it. The caller passes the function that reads the counts.

use taktil_hal::Nanos;

use crate::linux::{ThreadCounters, thread_counters, thread_cpu_time};
use crate::release::Wait;

/// What the kernel counted for this thread up to an instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ThreadUsage {
    pub(super) counters: ThreadCounters,
    pub(super) cpu: Nanos,
}

impl ThreadUsage {
    /// Reads both; two system calls.
    pub(super) fn read() -> ThreadUsage {
        ThreadUsage { counters: thread_counters(), cpu: thread_cpu_time() }
    }
}

/// The largest number of jobs between two readings.
const JOBS_PER_READING_MAX: u32 = 16;
/// Counts are read after a job that took longer than one and a half times the typical time and
/// this: it was held up.
const UNUSUAL_EXCESS: Nanos = Nanos::from_micros(20);
/// The typical time follows each job by one part in this many.
const TYPICAL_TIME_JOBS: i64 = 8;

/// Samples the usage of one lane's thread.
#[derive(Clone, Debug)]
pub(super) struct UsageSampler {
    last: ThreadUsage,
    /// Page faults since the first reading.
    page_faults: u64,
    /// Jobs since the last reading, their own included.
    jobs: u32,
    /// Sleeps that were meant and time that was spun since then.
    sleeps: u64,
    spun: Nanos,
    /// Awake time of whole cycles since then, on the clock.
    awake: Nanos,
    /// What a job typically takes, on the clock.
    typical: Nanos,
    /// Processor time of a cycle that its awake time does not show: falling asleep and waking.
    uncounted_cpu: Nanos,
}

impl UsageSampler {
    pub(super) fn new(now: ThreadUsage) -> UsageSampler {
        UsageSampler {
            last: now,
            page_faults: 0,
            jobs: 0,
            sleeps: 0,
            spun: Nanos::ZERO,
            awake: Nanos::ZERO,
            typical: Nanos::ZERO,
            uncounted_cpu: Nanos::ZERO,
        }
    }

    /// Takes in how long a cycle kept the thread awake, from waking to the next sleep. True when a
    /// reading was taken in it.
    pub(super) fn end_cycle(&mut self, awake: Nanos) -> bool {
        // The cycle in which the reading was taken is over with it.
        let read = self.jobs == 0;
        if !read {
            self.awake += awake;
        }
        read
    }

    /// Takes in a job that took `took` after `wait`. Returns, when it `missed` its deadline, what
    /// was counted for it alone, as far as that can be told.
    pub(super) fn end_job(
        &mut self,
        wait: &Wait,
        took: Nanos,
        missed: bool,
        read: impl FnOnce() -> ThreadUsage,
    ) -> Option<ThreadUsage> {
        self.jobs += 1;
        self.sleeps += u64::from(wait.sleeps);
        self.spun += wait.spun;
        let unusual = took > self.typical + Nanos(self.typical.0 / 2) + UNUSUAL_EXCESS;
        self.typical += Nanos((took - self.typical).0 / TYPICAL_TIME_JOBS);
        if !(missed || unusual || self.jobs >= JOBS_PER_READING_MAX) {
            return None;
        }
        let now = read();
        let (new, old) = (now.counters, self.last.counters);
        let page_faults = new.page_faults - old.page_faults;
        self.page_faults += page_faults;
        // All jobs since the last reading but the last, which is the one in question.
        let others = self.awake + self.spun + self.uncounted_cpu * i64::from(self.jobs);
        let cpu = now.cpu - self.last.cpu - others;
        let found = ThreadUsage {
            counters: ThreadCounters {
                page_faults,
                disk_faults: new.disk_faults - old.disk_faults,
                preemptions: new.preemptions - old.preemptions,
                waits: (new.waits - old.waits).saturating_sub(self.sleeps),
            },
            cpu: cpu.max(Nanos::ZERO).min(took),
        };
        if !unusual && !missed {
            let extra = cpu - took + self.uncounted_cpu * i64::from(self.jobs);
            self.uncounted_cpu = Nanos(extra.0 / i64::from(self.jobs)).max(Nanos::ZERO);
        }
        (self.last, self.jobs, self.sleeps) = (now, 0, 0);
        (self.spun, self.awake) = (Nanos::ZERO, Nanos::ZERO);
        missed.then_some(found)
    }

    /// Page faults in all, up to now.
    pub(super) fn page_faults(&self, now: ThreadUsage) -> u64 {
        self.page_faults + now.counters.page_faults - self.last.counters.page_faults
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(us: i64) -> Nanos {
        Nanos::from_micros(us)
    }

    fn wait(spun: Nanos) -> Wait {
        let zero = Nanos::ZERO;
        Wait { release: zero, entered: zero, begin: zero, sleeps: 1, spun, latency: None }
    }

    /// A kernel: what a thread has used, told when asked.
    struct Thread {
        now: ThreadUsage,
        reads: u32,
    }

    impl Thread {
        fn new() -> Thread {
            Thread {
                now: ThreadUsage { counters: ThreadCounters::default(), cpu: Nanos(77) },
                reads: 0,
            }
        }

        /// One cycle: a job, 2 us of accounting, 3 us to fall asleep and wake that no clock shows.
        fn cycle(
            &mut self,
            usage: &mut UsageSampler,
            took: Nanos,
            cpu: Nanos,
            missed: bool,
            spun: Nanos,
        ) -> Option<ThreadUsage> {
            self.now.counters.waits += 1;
            self.now.cpu += spun + cpu;
            let mut read = 0;
            let now = self.now;
            let found = usage.end_job(&wait(spun), took, missed, || {
                read += 1;
                now
            });
            self.reads += read;
            self.now.cpu += us(5);
            usage.end_cycle(took + us(2));
            found
        }
    }

    #[test]
    fn ordinary_jobs_are_read_once_in_sixteen() {
        let mut thread = Thread::new();
        let mut usage = UsageSampler::new(thread.now);
        for _ in 0..1600 {
            assert_eq!(thread.cycle(&mut usage, us(10), us(10), false, us(0)), None);
        }
        assert_eq!(thread.reads, 100);
    }

    #[test]
    fn a_miss_is_judged_by_its_own_time_wherever_it_falls_between_two_readings() {
        for ordinary in 0..40 {
            for spun in [us(0), us(150)] {
                let mut thread = Thread::new();
                let mut usage = UsageSampler::new(thread.now);
                for _ in 0..64 + ordinary {
                    thread.cycle(&mut usage, us(30), us(30), false, spun);
                }
                // Half of the time on the processor, once taken away, once gave it up.
                thread.now.counters.preemptions += 1;
                thread.now.counters.waits += 1;
                let found = thread.cycle(&mut usage, us(3000), us(1500), true, spun).unwrap();
                assert_eq!((found.counters.preemptions, found.counters.waits), (1, 1));
                let error = (found.cpu - us(1500)).0.abs();
                assert!(error <= us(16).0, "{ordinary}: {error} ns");
            }
        }
    }

    #[test]
    fn a_job_that_was_held_up_does_not_burden_the_next() {
        let mut thread = Thread::new();
        let mut usage = UsageSampler::new(thread.now);
        for _ in 0..50 {
            thread.cycle(&mut usage, us(30), us(30), false, us(0));
        }
        thread.now.counters.preemptions += 3;
        thread.now.counters.page_faults += 2;
        thread.cycle(&mut usage, us(900), us(30), false, us(0));
        let found = thread.cycle(&mut usage, us(3000), us(2990), true, us(0)).unwrap();
        assert_eq!(found.counters, ThreadCounters::default());
        assert!((found.cpu - us(2990)).0.abs() <= us(16).0, "{}", found.cpu);
        assert_eq!(usage.page_faults(thread.now), 2, "counted in all");
    }

    #[test]
    fn the_first_job_can_be_judged() {
        let mut thread = Thread::new();
        let mut usage = UsageSampler::new(thread.now);
        thread.now.counters.page_faults += 9;
        let found = thread.cycle(&mut usage, us(3000), us(2000), true, us(0)).unwrap();
        assert_eq!((found.counters.page_faults, found.cpu), (9, us(2000)));
    }
}
