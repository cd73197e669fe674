//! Jobs that end after their deadline: the cause, how many of them a lane tolerates, what it does
//! when it is late, and the notice for its next job. All functions are pure: measurements come in
//! as arguments. A lane keeps its phase: a job that is left out is left out whole.

use taktil_hal::{Invalid, Nanos};

use crate::fault::{FaultCode, FaultSet};

/// Why jobs ended after their deadline.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Misses {
    /// The thread was woken too late to make it.
    pub late_wake: u64,
    /// The job itself used more processor time than its deadline.
    pub overrun: u64,
    /// Another thread took the processor.
    pub preempted: u64,
    /// The job waited for something.
    pub blocked: u64,
    /// The job touched memory that was not there.
    pub page_fault: u64,
    /// The kernel took the processor because a quota was used up: that of all real-time threads,
    /// or that of the control group.
    pub throttled: u64,
    /// The thread kept its processor, and time passed: the host of this virtual machine took it.
    pub host: u64,
    /// As `host`, on a machine that is not virtual: firmware, a hot processor, or an unknown cause.
    pub unexplained: u64,
}

/// Why one job ended after its deadline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields of `Misses` say what they mean")]
pub enum Cause {
    LateWake,
    Overrun,
    Preempted,
    Blocked,
    PageFault,
    Throttled,
    Host,
    Unexplained,
}

impl Misses {
    /// Names and counts in a fixed order, for whoever shows or adds them.
    #[must_use]
    pub const fn rows(&self) -> [(&'static str, u64); 8] {
        [
            ("late_wake", self.late_wake),
            ("overrun", self.overrun),
            ("preempted", self.preempted),
            ("blocked", self.blocked),
            ("page_fault", self.page_fault),
            ("throttled", self.throttled),
            ("host", self.host),
            ("unexplained", self.unexplained),
        ]
    }

    /// All of them.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.rows().iter().map(|(_, count)| count).sum()
    }

    /// Counts one.
    pub fn add(&mut self, cause: Cause) {
        let count = match cause {
            Cause::LateWake => &mut self.late_wake,
            Cause::Overrun => &mut self.overrun,
            Cause::Preempted => &mut self.preempted,
            Cause::Blocked => &mut self.blocked,
            Cause::PageFault => &mut self.page_fault,
            Cause::Throttled => &mut self.throttled,
            Cause::Host => &mut self.host,
            Cause::Unexplained => &mut self.unexplained,
        };
        *count += 1;
    }

    /// Both together.
    #[must_use]
    pub fn plus(mut self, other: &Misses) -> Misses {
        self.late_wake += other.late_wake;
        self.overrun += other.overrun;
        self.preempted += other.preempted;
        self.blocked += other.blocked;
        self.page_fault += other.page_fault;
        self.throttled += other.throttled;
        self.host += other.host;
        self.unexplained += other.unexplained;
        self
    }
}

/// What was measured of one job that ended too late.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JobMeasurement {
    /// Release to begin on the clock.
    pub late: Nanos,
    /// Begin to end on the clock.
    pub took: Nanos,
    /// Processor time of the thread between them.
    pub cpu: Nanos,
    /// Page faults, with and without disk.
    pub page_faults: u64,
    /// Those that waited for a disk.
    pub disk_faults: u64,
    /// Times that the processor was taken away.
    pub preemptions: u64,
    /// Times that the thread gave it up to wait.
    pub waits: u64,
}

/// What the kernel may do to a lane's thread, and what it has done to its group.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MissContext {
    /// Lateness of a release that the schedule allows for: no cause by itself.
    pub release_jitter: Nanos,
    /// The part of each period for which real-time threads are throttled; none when they are not,
    /// or when the thread is not one of them.
    pub throttle_gap: Option<Nanos>,
    /// The control group's quota has run out since the last miss.
    pub quota_used: bool,
    /// There is a host that may take the processor unseen.
    pub virtual_machine: bool,
}

/// Processor time that a page fault without disk may take, entry and zeroing included: 1.8 us in a
/// virtual machine, more where the kernel's locks sleep. A huge page takes far longer and is told
/// as an overrun when nothing else is seen.
const PAGE_FAULT_COST: Nanos = Nanos::from_micros(4);

/// The cause that explains most of the miss. A late begin is the cause if the job alone would have
/// met its deadline, the begin was later than the schedule allows for, and the delay was no shorter
/// than the time that was taken from the job afterwards. Otherwise the job is judged by the time
/// that its begin left it.
#[must_use]
pub fn cause(deadline: Nanos, trace: &JobMeasurement, ground: &MissContext) -> Cause {
    let alone = trace.took <= deadline;
    if alone && trace.late > ground.release_jitter && trace.late >= trace.took - trace.cpu {
        return Cause::LateWake;
    }
    let deadline = if alone { deadline - trace.late } else { deadline };
    let in_faults =
        PAGE_FAULT_COST * i64::try_from(trace.page_faults).unwrap_or(i64::MAX / 1_000_000);
    if trace.cpu > deadline {
        let without = trace.cpu - in_faults;
        return if without <= deadline { Cause::PageFault } else { Cause::Overrun };
    }
    if trace.disk_faults > 0 {
        return Cause::PageFault;
    }
    let away = trace.took - trace.cpu;
    if trace.preemptions > 0 {
        // Throttling takes the processor for the whole gap; a much shorter interruption was another
        // thread.
        if ground.quota_used || ground.throttle_gap.is_some_and(|gap| away * 2 >= gap) {
            return Cause::Throttled;
        }
        // A thread that waits is also preempted now and then, but a preempted thread does not wait
        // for that reason.
        if trace.preemptions > trace.waits {
            return Cause::Preempted;
        }
    }
    if trace.waits > 0 {
        return Cause::Blocked;
    }
    if trace.page_faults > 0 {
        return Cause::PageFault;
    }
    if ground.virtual_machine { Cause::Host } else { Cause::Unexplained }
}

/// How many misses a lane tolerates: each adds one to the bucket, and one leaks away after
/// `leak_jobs` jobs without a miss. A full bucket is a storm, which stops the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LeakyBucket {
    /// Misses that fill the bucket.
    pub capacity: u32,
    /// Jobs in a row without a miss that take one out.
    pub leak_jobs: u32,
}

impl Default for LeakyBucket {
    /// Five misses, one forgiven for every 100 good jobs.
    fn default() -> LeakyBucket {
        LeakyBucket { capacity: 5, leak_jobs: 100 }
    }
}

/// Largest capacity and largest number of leak jobs: larger ones would never stop a machine.
const BUCKET_MAX: u32 = 1_000_000;

impl LeakyBucket {
    /// Checks that the bucket is not always full and leaks at all.
    ///
    /// # Errors
    /// The number out of range. The place is relative to the bucket.
    pub fn check(&self) -> Result<(), Invalid> {
        for (place, number) in [("bucket", self.capacity), ("leak_jobs", self.leak_jobs)] {
            if !(1..=BUCKET_MAX).contains(&number) {
                return Err(Invalid::new(
                    place,
                    format!("{number} is out of range"),
                    format!("give 1 to {BUCKET_MAX}; 5 misses and 100 jobs are usual"),
                ));
            }
        }
        Ok(())
    }
}

/// What the schedule tells a job about the jobs before it: an input like any other, so that a
/// record of it replays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Notice {
    /// Faults of the schedule since the job before.
    pub faults: FaultSet,
    /// Jobs that missed their deadline or were left out since the job before.
    pub missed: u32,
    /// Other lanes that stand still, one bit each in the machine's order.
    pub silent: u32,
}

/// What a lane does when it finds itself later than a whole period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LatePolicy {
    /// Goes on with the newest job that is due, unless the late one began after its release; the
    /// ones in between are skipped and counted. Phase is never lost.
    #[default]
    Skip,
    /// Runs up to so many superseded jobs back to back, then skips the rest: for tasks that count
    /// jobs. Unbounded for a simulated world, in which no time may be left out.
    CatchUp {
        /// Superseded jobs in a row that are still run.
        at_most: u32,
    },
    /// As `Skip`, and any miss raises [`crate::FaultCode::DeadlineMissed`]: a controlled stop.
    Fault,
}

/// Handles the lateness of a lane from job to job: applies its policy and fills its bucket.
#[derive(Clone, Debug)]
pub struct OverrunHandler {
    late: LatePolicy,
    bucket: LeakyBucket,
    level: u32,
    jobs_without_miss: u32,
    caught_up: u32,
    storms: u64,
}

/// How far the schedule is ahead of a lane when a job has ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Backlog {
    /// Jobs after it that were superseded by newer ones.
    pub superseded: u64,
    /// The newest one that is due was released before the ended job began: that job, late as it
    /// was, read its inputs inside the period of the newest.
    pub served: bool,
}

impl OverrunHandler {
    /// Nothing has been missed yet.
    #[must_use]
    pub fn new(late: LatePolicy, bucket: LeakyBucket) -> OverrunHandler {
        OverrunHandler { late, bucket, level: 0, jobs_without_miss: 0, caught_up: 0, storms: 0 }
    }

    /// A job has ended, after its deadline or not. Returns how many of the jobs that are due are
    /// left out, and the notice for the next job. One that was served already is left out as well,
    /// so that a late wake makes one late job and not two; where jobs are counted it is run.
    pub fn end_job(&mut self, missed: bool, behind: Backlog) -> (u64, Notice) {
        let Backlog { superseded: behind, served } = behind;
        let left_out = match self.late {
            LatePolicy::Skip | LatePolicy::Fault => behind.saturating_add(served.into()),
            LatePolicy::CatchUp { at_most } if behind > 0 && self.caught_up < at_most => {
                self.caught_up += 1;
                0
            }
            LatePolicy::CatchUp { .. } => {
                self.caught_up = 0;
                behind
            }
        };
        let lost = u32::try_from(left_out).unwrap_or(u32::MAX).saturating_add(u32::from(missed));
        let mut faults = FaultSet::NONE;
        if lost == 0 {
            self.leak();
        } else {
            faults.insert(FaultCode::Overrun);
            if self.late == LatePolicy::Fault {
                faults.insert(FaultCode::DeadlineMissed);
            }
            self.jobs_without_miss = 0;
            self.level = self.level.saturating_add(lost).min(self.bucket.capacity);
            if self.level == self.bucket.capacity {
                faults.insert(FaultCode::OverrunStorm);
                self.storms += 1;
            }
        }
        (left_out, Notice { faults, missed: lost, silent: 0 })
    }

    fn leak(&mut self) {
        self.jobs_without_miss = if self.level == 0 { 0 } else { self.jobs_without_miss + 1 };
        if self.jobs_without_miss >= self.bucket.leak_jobs {
            self.jobs_without_miss = 0;
            self.level -= 1;
        }
    }

    /// Misses that found or made the bucket full.
    #[must_use]
    pub fn storms(&self) -> u64 {
        self.storms
    }
}

#[cfg(test)]
mod tests;
