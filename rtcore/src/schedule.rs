//! When jobs are released, in whole nanoseconds. Job k of a lane is released at phase + k * period,
//! for ever. A schedule that cannot deliver values at their logical instants is refused.

use std::collections::{BTreeMap, BTreeSet};

use taktil_hal::{Invalid, Nanos};

use crate::misses::{LatePolicy, LeakyBucket};
use crate::release::Guard;

/// How a lane's thread is scheduled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Policy {
    /// `SCHED_FIFO` at the lane's priority.
    #[default]
    Fifo,
    /// `SCHED_DEADLINE`: the lane comes before all lanes of fixed priority, for the time that its
    /// tasks declare and no longer. The kernel refuses what it cannot keep.
    Deadline,
}

/// Processor time that the kernel keeps for a lane of [`Policy::Deadline`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reservation {
    /// Processor time in each period, and no more.
    pub runtime: Nanos,
    /// The processor time is given within this span after waking.
    pub deadline: Nanos,
    /// Time between two wakings at least.
    pub period: Nanos,
}

impl core::fmt::Display for Reservation {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Reservation { runtime, deadline, period } = self;
        write!(f, "{runtime} within {deadline} of every {period}")
    }
}

/// One lane: one thread, one rate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LaneSpec {
    /// Name, unique in the machine.
    pub name: String,
    /// Time between releases.
    pub period: Nanos,
    /// Release of job 0, less than one period.
    pub phase: Nanos,
    /// Values written by job k become visible to other lanes at its release plus this; more than
    /// zero, at most one period.
    pub delivery: Nanos,
    /// A job that ends later than its release plus this has missed; at most `delivery`.
    pub deadline: Nanos,
    /// How its thread is scheduled.
    pub policy: Policy,
    /// `SCHED_FIFO` priority, 1..=99; without meaning for [`Policy::Deadline`].
    pub priority: u8,
    /// CPU to run on; any when absent.
    pub cpu: Option<usize>,
    /// What to do when more than a period late.
    pub late: LatePolicy,
    /// How many misses the lane bears.
    pub misses: LeakyBucket,
    /// Standing still for longer than this, by another lane's progress and by the clock, means that
    /// the lane is silent.
    pub silent_after: Nanos,
    /// Longest processor time of one step of each task, by the task's name. All tasks or none: a
    /// lane with gaps is not analysed.
    pub budgets: BTreeMap<String, Nanos>,
    /// Wakes early and spins to the release; none sleeps to the release.
    pub guard: Option<Guard>,
}

/// Most lanes of a machine: what lanes say of each other is one bit a lane in a word of 32 bits.
pub const LANES_MAX: usize = 32;

/// Shortest period that is accepted: below it a general-purpose kernel cannot follow.
pub const PERIOD_MIN: Nanos = Nanos::from_micros(20);
/// Longest period that is accepted.
pub const PERIOD_MAX: Nanos = Nanos::from_secs(10);

/// Periods in which `SCHED_DEADLINE` reserves time: `sched_deadline_period_min_us`, `_max_us`.
const RESERVED_PERIODS: (Nanos, Nanos) = (Nanos::from_micros(100), Nanos::from_secs(4));
/// Less than 1024 ns cannot be reserved.
const RESERVATION_RUNTIME_MIN: Nanos = Nanos::from_micros(2);

/// Ten periods and at least 50 ms: how long a lane may stand still unless it is told otherwise.
#[must_use]
pub fn silent_after(period: Nanos) -> Nanos {
    (period * 10).max(Nanos::from_millis(50))
}

/// Longest time for which a lane may stand still unseen.
const SILENT_AFTER_MAX: Nanos = Nanos::from_secs(1000);

impl LaneSpec {
    /// A lane that starts at phase 0 and delivers after one period.
    pub fn new(name: impl Into<String>, period: Nanos, priority: u8) -> LaneSpec {
        LaneSpec {
            name: name.into(),
            period,
            phase: Nanos::ZERO,
            delivery: period,
            deadline: period,
            policy: Policy::Fifo,
            priority,
            cpu: None,
            late: LatePolicy::Skip,
            misses: LeakyBucket::default(),
            silent_after: silent_after(period),
            budgets: BTreeMap::new(),
            guard: None,
        }
    }

    /// The declared time of one job of these tasks; `None` when one of them declares none.
    pub fn budget<'a>(&self, tasks: impl IntoIterator<Item = &'a str>) -> Option<Nanos> {
        let mut sum = None;
        for task in tasks {
            sum = Some(sum.unwrap_or(Nanos::ZERO) + *self.budgets.get(task)?);
        }
        sum
    }

    /// Checks that every budget is that of a task of the lane. The place is `budget_us.TASK`.
    ///
    /// # Errors
    /// The first name that is not among `tasks`.
    pub fn check_budget_names(&self, tasks: &[&str]) -> Result<(), Invalid> {
        for name in self.budgets.keys() {
            if !tasks.contains(&name.as_str()) {
                return Err(Invalid::new(
                    format!("budget_us.{name}"),
                    format!("no task `{name}` stands in lane `{}`", self.name),
                    format!("tasks of this lane: {}", tasks.join(", ")),
                ));
            }
        }
        Ok(())
    }

    /// What a lane of [`Policy::Deadline`] has to be granted: its `budget`, `overhead` and the
    /// guard's longest spin within its deadline; none for other lanes.
    ///
    /// # Errors
    /// No budget, a period or a runtime that the kernel does not take. Places are relative to the
    /// lane.
    pub fn reservation(
        &self,
        budget: Option<Nanos>,
        overhead: Nanos,
    ) -> Result<Option<Reservation>, Invalid> {
        if self.policy == Policy::Fifo {
            return Ok(None);
        }
        let Some(budget) = budget else {
            let what = "a deadline lane without a budget for each task: nothing can be reserved";
            return Err(Invalid::new("budget_us", what, "declare them, or take policy = \"fifo\""));
        };
        let (shortest, longest) = RESERVED_PERIODS;
        if self.period < shortest || self.period > longest {
            let what = format!("no time can be reserved in periods of {}", self.period);
            return Err(Invalid::new("period_us", what, format!("give {shortest} to {longest}")));
        }
        let runtime = budget + overhead + self.guard.map_or(Nanos::ZERO, |guard| guard.spin_max);
        if runtime < RESERVATION_RUNTIME_MIN || runtime > self.deadline {
            let deadline = self.deadline;
            let what = format!("{runtime} cannot be reserved within a deadline of {deadline}");
            let remedy =
                format!("budgets, overhead and guard: {RESERVATION_RUNTIME_MIN} to {deadline}");
            return Err(Invalid::new("budget_us", what, remedy));
        }
        Ok(Some(Reservation { runtime, deadline: self.deadline, period: self.period }))
    }

    /// Checks that the lane's CPU is among `present`. The place is `cpu`.
    ///
    /// # Errors
    /// The CPU and those that there are.
    pub fn check_cpu(&self, present: &BTreeSet<usize>) -> Result<(), Invalid> {
        match self.cpu {
            Some(cpu) if !present.contains(&cpu) => {
                let there: Vec<String> = present.iter().map(ToString::to_string).collect();
                Err(Invalid::new(
                    "cpu",
                    format!("CPU {cpu} does not exist here or is offline"),
                    format!("CPUs of this machine: {}; or leave `cpu` out", there.join(", ")),
                ))
            }
            _ => Ok(()),
        }
    }

    /// Budgets are positive and leave the deadline possible.
    fn check_budgets(&self) -> Result<(), Invalid> {
        let mut sum = Nanos::ZERO;
        for (task, budget) in &self.budgets {
            if *budget <= Nanos::ZERO || *budget > self.deadline {
                return Err(Invalid::new(
                    format!("budget_us.{task}"),
                    format!("a budget of {budget} is not within the deadline of {}", self.deadline),
                    "give more than 0 and less than the deadline",
                ));
            }
            sum += *budget;
        }
        if sum > self.deadline {
            let (deadline, over) = (self.deadline, sum - self.deadline);
            return Err(Invalid::new(
                "budget_us",
                format!("the budgets are {sum} in all, and the deadline is {deadline}"),
                format!("take {over} out, or move a task to another lane"),
            ));
        }
        Ok(())
    }

    /// Release of job `tick`.
    #[must_use]
    pub fn release(&self, tick: u64) -> Nanos {
        self.phase + self.period * i64::try_from(tick).unwrap_or(i64::MAX / self.period.0.max(1))
    }

    /// Number of jobs released before `until`.
    #[must_use]
    pub fn jobs_before(&self, until: Nanos) -> u64 {
        let span = (until - self.phase).0;
        if span <= 0 { 0 } else { (span as u64).div_ceil(self.period.0 as u64) }
    }

    /// The newest job released at or before `now`; job 0 before the first release.
    #[must_use]
    pub fn newest_released(&self, now: Nanos) -> u64 {
        let span = (now - self.phase).0;
        if span <= 0 { 0 } else { span as u64 / self.period.0 as u64 }
    }

    /// Checks every field against its range. Places are relative to the lane.
    ///
    /// # Errors
    /// The first field that is out of its range.
    pub fn check(&self) -> Result<(), Invalid> {
        let bad =
            |place: &str, what: String, remedy: String| Err(Invalid::new(place, what, remedy));
        if self.name.is_empty()
            || !self.name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
        {
            return bad(
                "name",
                format!("`{}` is not a lane name", self.name),
                "use letters, digits and underscores".into(),
            );
        }
        if self.period < PERIOD_MIN || self.period > PERIOD_MAX {
            return bad(
                "period_us",
                format!("a period of {} is out of range", self.period),
                format!("give between {PERIOD_MIN} and {PERIOD_MAX}"),
            );
        }
        if self.phase < Nanos::ZERO || self.phase >= self.period {
            return bad(
                "phase_us",
                format!("a phase of {} does not lie in one period of {}", self.phase, self.period),
                "give 0 up to, not including, the period".into(),
            );
        }
        if self.delivery <= Nanos::ZERO || self.delivery > self.period {
            return bad(
                "delivery_us",
                format!(
                    "a delivery of {} is not within one period of {}",
                    self.delivery, self.period
                ),
                "give more than 0 and at most the period".into(),
            );
        }
        if self.deadline <= Nanos::ZERO || self.deadline > self.delivery {
            return bad(
                "deadline_us",
                format!(
                    "a deadline of {} lies after the delivery at {}",
                    self.deadline, self.delivery
                ),
                "give more than 0 and at most the delivery".into(),
            );
        }
        if !(1..=99).contains(&self.priority) {
            return bad(
                "priority",
                format!("{} is not a SCHED_FIFO priority", self.priority),
                "give 1 (lowest) to 99 (highest)".into(),
            );
        }
        if self.silent_after < self.period * 2 || self.silent_after > SILENT_AFTER_MAX {
            return bad(
                "stall_limit_us",
                format!(
                    "a lane with a period of {} is not silent by {}",
                    self.period, self.silent_after
                ),
                format!("give from two periods to {SILENT_AFTER_MAX}; ten periods are usual"),
            );
        }
        self.misses.check().map_err(|invalid| invalid.within("misses"))?;
        self.check_budgets()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn releases_are_exact_after_ten_million_jobs() {
        let mut lane = LaneSpec::new("servo", Nanos(2_500_001), 80);
        lane.phase = Nanos(7);
        assert_eq!(lane.release(10_000_000), Nanos(25_000_010_000_007));
        assert_eq!(lane.newest_released(Nanos(25_000_010_000_007)), 10_000_000);
        assert_eq!(lane.newest_released(Nanos(25_000_010_000_006)), 9_999_999);
        assert_eq!(lane.newest_released(Nanos(-5)), 0);
    }

    #[test]
    fn jobs_before_counts_half_open() {
        let lane = LaneSpec::new("servo", Nanos::from_micros(2500), 80);
        assert_eq!(lane.jobs_before(Nanos::from_secs(10)), 4000);
        assert_eq!(lane.jobs_before(Nanos(1)), 1);
        assert_eq!(lane.jobs_before(Nanos::ZERO), 0);
        assert_eq!(lane.jobs_before(Nanos(-1)), 0);
    }

    #[test]
    fn each_bad_field_is_named() {
        let good = LaneSpec::new("servo", Nanos::from_micros(2500), 80);
        assert_eq!(good.check(), Ok(()));
        let place = |change: &dyn Fn(&mut LaneSpec)| {
            let mut lane = good.clone();
            change(&mut lane);
            lane.check().unwrap_err().place
        };
        assert_eq!(place(&|l| l.name = "a b".into()), "name");
        assert_eq!(place(&|l| l.period = Nanos(-1)), "period_us");
        assert_eq!(place(&|l| l.period = Nanos::from_secs(11)), "period_us");
        assert_eq!(place(&|l| l.phase = l.period), "phase_us");
        assert_eq!(place(&|l| l.delivery = Nanos::ZERO), "delivery_us");
        assert_eq!(place(&|l| l.delivery = l.period + Nanos(1)), "delivery_us");
        assert_eq!(place(&|l| l.deadline = l.delivery + Nanos(1)), "deadline_us");
        assert_eq!(place(&|l| l.priority = 0), "priority");
        assert_eq!(place(&|l| l.priority = 100), "priority");
        let budget = |l: &mut LaneSpec, task: &str, us| {
            l.budgets.insert(task.into(), Nanos::from_micros(us));
        };
        assert_eq!(place(&|l| budget(l, "sense", 0)), "budget_us.sense");
        assert_eq!(place(&|l| budget(l, "sense", -1)), "budget_us.sense");
        assert_eq!(place(&|l| budget(l, "sense", 2501)), "budget_us.sense");
        let sum = |l: &mut LaneSpec| {
            budget(l, "sense", 1500);
            budget(l, "actuate", 1001);
        };
        assert_eq!(place(&sum), "budget_us");
        let mut lane = good;
        budget(&mut lane, "sense", 1500);
        budget(&mut lane, "actuate", 1000);
        assert_eq!(lane.check(), Ok(()), "budgets may fill the deadline");
        assert_eq!(lane.budget(["actuate", "sense"]), Some(Nanos::from_micros(2500)));
        assert_eq!(lane.budget(["actuate", "sense", "other"]), None, "a gap is no budget");
        assert_eq!(lane.budget([]), None);
        assert_eq!(lane.check_budget_names(&["sense", "actuate"]), Ok(()));
        let stranger = lane.check_budget_names(&["sense"]).unwrap_err();
        assert_eq!(stranger.place, "budget_us.actuate");
    }

    #[test]
    fn a_cpu_that_does_not_exist_is_refused_with_those_that_do() {
        let mut lane = LaneSpec::new("servo", Nanos::from_micros(2500), 80);
        let present = BTreeSet::from([0, 1, 5]);
        assert_eq!(lane.check_cpu(&present), Ok(()), "any CPU will do");
        lane.cpu = Some(5);
        assert_eq!(lane.check_cpu(&present), Ok(()));
        lane.cpu = Some(2);
        let refused = lane.check_cpu(&present).unwrap_err();
        assert_eq!(refused.place, "cpu");
        assert!(refused.what.contains("CPU 2") && refused.remedy.contains("0, 1, 5"), "{refused}");
    }
}
