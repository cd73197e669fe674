//! The kernel: monotonic time, absolute sleeps, scheduling policy, locked memory, fault counters. The only file of the core that
//! names any of them. Refuses to assume: what was asked for is read back.

use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
use nix::sys::mman::{MlockAllFlags, mlockall, munlockall};
use nix::sys::resource::{Resource, UsageWho, getrlimit, getrusage};
use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};
use nix::unistd::Pid;
use taktil_hal::{Clock, Nanos};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id, thread_schedule_policy_param,
};

/// The kernel's monotonic clock, counted from a chosen instant.
#[derive(Clone, Copy, Debug)]
pub struct MonotonicClock {
    origin: Nanos,
}

fn read(clock: ClockId) -> Nanos {
    clock_gettime(clock).map_or(Nanos::ZERO, |t| Nanos(t.tv_sec() * 1_000_000_000 + t.tv_nsec()))
}

/// Nanoseconds since boot, not counting suspend.
#[must_use]
pub fn monotonic() -> Nanos {
    read(ClockId::CLOCK_MONOTONIC)
}

/// Processor time that this thread has used.
#[must_use]
pub fn thread_cpu_time() -> Nanos {
    read(ClockId::CLOCK_THREAD_CPUTIME_ID)
}

impl MonotonicClock {
    /// A clock that shows zero at `lead` from now.
    #[must_use]
    pub fn starting_in(lead: Nanos) -> MonotonicClock {
        MonotonicClock { origin: monotonic() + lead }
    }
}

impl Clock for MonotonicClock {
    fn now(&self) -> Nanos {
        monotonic() - self.origin
    }

    fn sleep_until(&self, instant: Nanos) {
        let at = instant + self.origin;
        let at = TimeSpec::new(at.0.div_euclid(1_000_000_000), at.0.rem_euclid(1_000_000_000));
        // A signal may end the sleep early: sleep again towards the same absolute instant.
        while clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &at)
            == Err(nix::errno::Errno::EINTR)
        {}
    }
}

/// What the kernel counts for the calling thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ThreadCounters {
    /// Page faults, with and without disk.
    pub page_faults: u64,
    /// Times that the processor was taken away.
    pub preemptions: u64,
    /// Times that the thread gave the processor up to wait.
    pub waits: u64,
}

/// Reads the calling thread's counters.
#[must_use]
pub fn thread_counters() -> ThreadCounters {
    let Ok(usage) = getrusage(UsageWho::RUSAGE_THREAD) else { return ThreadCounters::default() };
    let count = |n: i64| u64::try_from(n).unwrap_or(0);
    ThreadCounters {
        page_faults: count(usage.minor_page_faults()) + count(usage.major_page_faults()),
        preemptions: count(usage.involuntary_context_switches()),
        waits: count(usage.voluntary_context_switches()),
    }
}

/// Locks all memory of the process, present and future. `Err` says why not.
///
/// # Errors
/// The kernel's refusal in words, with the way out.
pub fn lock_memory() -> Result<(), String> {
    let (soft, _) = getrlimit(Resource::RLIMIT_MEMLOCK).unwrap_or((0, 0));
    let unlimited = soft == nix::libc::RLIM_INFINITY || nix::unistd::geteuid().is_root();
    // With a finite limit, locking the future would make a later allocation fail: lock only what is there.
    let flags = if unlimited {
        MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE
    } else {
        MlockAllFlags::MCL_CURRENT
    };
    match mlockall(flags) {
        Ok(()) if unlimited => Ok(()),
        Ok(()) => Err(format!("memory locked only up to RLIMIT_MEMLOCK = {} KiB", soft / 1024)),
        Err(error) => {
            Err(format!("mlockall refused ({error}); RLIMIT_MEMLOCK = {} KiB", soft / 1024))
        }
    }
}

/// Undoes [`lock_memory`].
pub fn unlock_memory() {
    let _ = munlockall();
}

/// Asks for `SCHED_FIFO` at `priority` for the calling thread and reads it back.
///
/// # Errors
/// Why it was not granted, in words.
pub fn become_fifo(priority: u8) -> Result<(), String> {
    let value = ThreadPriorityValue::try_from(priority).map_err(|error| error.to_string())?;
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(value),
        policy,
    )
    .map_err(|error| format!("SCHED_FIFO {priority} refused ({error:?})"))?;
    match thread_schedule_policy_param(thread_native_id()) {
        Ok((found, param)) if found == policy && param.sched_priority == i32::from(priority) => {
            Ok(())
        }
        Ok((found, param)) => Err(format!(
            "asked for SCHED_FIFO {priority}, found {found:?} {}",
            param.sched_priority
        )),
        Err(error) => Err(format!("the scheduling policy cannot be read back ({error:?})")),
    }
}

/// Pins the calling thread to one CPU and reads it back.
///
/// # Errors
/// Why it was not granted, in words.
pub fn pin_to(cpu: usize) -> Result<(), String> {
    let mut set = CpuSet::new();
    set.set(cpu).map_err(|error| format!("CPU {cpu}: {error}"))?;
    let me = Pid::from_raw(0);
    sched_setaffinity(me, &set).map_err(|error| format!("CPU {cpu} refused ({error})"))?;
    let found = sched_getaffinity(me).map_err(|error| format!("CPU mask unreadable ({error})"))?;
    let only = (0..CpuSet::count()).all(|n| found.is_set(n).unwrap_or(false) == (n == cpu));
    if only { Ok(()) } else { Err(format!("asked for CPU {cpu} alone, found another mask")) }
}

/// Touches the stack that jobs will use, so that it is there before the first of them.
#[inline(never)]
pub fn touch_stack() {
    let mut block = [0u8; 128 * 1024];
    for at in (0..block.len()).step_by(1024) {
        block[at] = 1;
    }
    std::hint::black_box(&block);
}

/// Whether the running kernel is built with PREEMPT_RT, and whether it runs in a virtual machine.
#[must_use]
pub fn kernel() -> (bool, bool) {
    let version = std::fs::read_to_string("/proc/version").unwrap_or_default();
    let processor = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let flags = processor.lines().find(|line| line.starts_with("flags")).unwrap_or_default();
    (version.contains("PREEMPT_RT"), flags.split_whitespace().any(|flag| flag == "hypervisor"))
}
