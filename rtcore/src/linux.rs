//! The interface to the kernel: monotonic time, absolute sleeps, scheduling policy, locked memory,
//! fault counters, and facts about the host. It is the only part of the core that calls the kernel.
//! Every request is verified by reading the result back.
#![allow(unsafe_code)]

mod clock;
mod runaway;

use std::os::unix::fs::FileExt;
use std::path::Path;

use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
use nix::sys::mman::{MlockAllFlags, mlockall, munlockall};
use nix::sys::resource::{Resource, UsageWho, getrlimit, getrusage};
use nix::time::{ClockId, clock_gettime};
use nix::unistd::Pid;
use taktil_hal::Nanos;
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id, thread_schedule_policy_param,
};

use crate::cpus;
use crate::detection;
use crate::facts::{Facts, LaneGrant, Limit, UNREADABLE, status_kib};
use crate::schedule::Reservation;
pub use clock::{EPOCH_AFTER_TICK, MonotonicClock};
pub(crate) use runaway::{RealTimeLimit, run_bounded};

fn read(clock: ClockId) -> Nanos {
    clock_gettime(clock).map_or(Nanos::ZERO, |t| Nanos(t.tv_sec() * 1_000_000_000 + t.tv_nsec()))
}

/// Nanoseconds since boot, not counting suspend.
#[must_use]
pub fn monotonic() -> Nanos {
    read(ClockId::CLOCK_MONOTONIC)
}

/// Nanoseconds since 1970, for people: a clock that may be set.
#[must_use]
pub fn wall_clock() -> Nanos {
    read(ClockId::CLOCK_REALTIME)
}

/// Whether this process has the rights of the user root.
#[must_use]
pub fn is_root() -> bool {
    nix::unistd::geteuid().is_root()
}

/// Processor time that this thread has used.
#[must_use]
pub fn thread_cpu_time() -> Nanos {
    read(ClockId::CLOCK_THREAD_CPUTIME_ID)
}

/// What the kernel counts for the calling thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ThreadCounters {
    /// Page faults, with and without disk.
    pub page_faults: u64,
    /// Those that waited for a disk.
    pub disk_faults: u64,
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
        disk_faults: count(usage.major_page_faults()),
        preemptions: count(usage.involuntary_context_switches()),
        waits: count(usage.voluntary_context_switches()),
    }
}

/// Locks all memory of the process, present and future.
///
/// # Errors
/// The kernel's refusal in words, with the way out.
pub fn lock_memory() -> Result<(), String> {
    let (soft, _) = getrlimit(Resource::RLIMIT_MEMLOCK).unwrap_or((0, 0));
    let unlimited = soft == libc::RLIM_INFINITY || is_root();
    // With a finite limit, locking the future would make a later allocation fail: lock only what
    // is there.
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
pub fn set_fifo(priority: u8) -> Result<(), String> {
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

/// New threads of a deadline lane are ordinary again.
const RESET_ON_FORK: u64 = 1;

const EMPTY_SCHED_ATTR: libc::sched_attr = libc::sched_attr {
    size: core::mem::size_of::<libc::sched_attr>() as u32,
    sched_policy: 0,
    sched_flags: 0,
    sched_nice: 0,
    sched_priority: 0,
    sched_runtime: 0,
    sched_deadline: 0,
    sched_period: 0,
};

/// Asks for `SCHED_DEADLINE` with this reservation for the calling thread and reads it back.
///
/// # Errors
/// Why it was not granted, in words, with the numbers.
pub fn set_deadline(wanted: &Reservation) -> Result<(), String> {
    let attributes = libc::sched_attr {
        sched_policy: libc::SCHED_DEADLINE.unsigned_abs(),
        sched_flags: RESET_ON_FORK,
        sched_runtime: wanted.runtime.0.unsigned_abs(),
        sched_deadline: wanted.deadline.0.unsigned_abs(),
        sched_period: wanted.period.0.unsigned_abs(),
        ..EMPTY_SCHED_ATTR
    };
    // SAFETY: the kernel reads `size` bytes behind a pointer to a struct of that size that lives on
    // this stack; thread 0 is the calling one; no memory of ours is written.
    let code = unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0) };
    if code != 0 {
        return Err(deadline_refusal(nix::errno::Errno::last(), wanted));
    }
    match scheduling_attributes().as_ref().and_then(reservation_of) {
        Some(found) if found == *wanted => Ok(()),
        Some(found) => Err(format!("asked for {wanted}, SCHED_DEADLINE gives {found}")),
        None => Err("SCHED_DEADLINE was asked for and cannot be read back".to_owned()),
    }
}

fn deadline_refusal(error: nix::errno::Errno, wanted: &Reservation) -> String {
    use nix::errno::Errno;
    let number = |path: &str| read_trimmed(path).and_then(|text| text.parse::<f64>().ok());
    match error {
        Errno::EBUSY => {
            let most = number("/proc/sys/kernel/sched_rt_runtime_us")
                .zip(number("/proc/sys/kernel/sched_rt_period_us"))
                .filter(|(runtime, _)| *runtime >= 0.0)
                .map_or(100.0, |(runtime, period)| 100.0 * runtime / period);
            let share = 100.0 * wanted.runtime.as_secs_f64() / wanted.period.as_secs_f64();
            format!(
                "SCHED_DEADLINE refused: {wanted} ({share:.1} %) do not fit beside what is \
                 reservation_of already; {most:.0} % of each CPU can be (sched_rt_runtime_us)"
            )
        }
        Errno::EPERM if !may_use_every_cpu() => format!(
            "SCHED_DEADLINE refused: {wanted} on CPUs {:?} alone; leave `cpu` out, or start the \
             process in a cpuset of exactly those CPUs that balances no load with others \
             (cpuset.cpus.partition = root)",
            allowed_cpus()
        ),
        error => format!("SCHED_DEADLINE refused ({error}): {wanted}"),
    }
}

/// What the calling thread runs with, as the kernel has it.
fn scheduling_attributes() -> Option<libc::sched_attr> {
    let mut found = EMPTY_SCHED_ATTR;
    // SAFETY: the kernel writes at most `size` bytes behind a pointer to a struct of that size,
    // borrowed for the call; every bit pattern is a value of it.
    let code = unsafe {
        libc::syscall(libc::SYS_sched_getattr, 0, &raw mut found, EMPTY_SCHED_ATTR.size, 0)
    };
    (code == 0).then_some(found)
}

fn reservation_of(attributes: &libc::sched_attr) -> Option<Reservation> {
    let nanos = |ns: u64| i64::try_from(ns).ok().map(Nanos);
    let deadline = attributes.sched_policy == libc::SCHED_DEADLINE.unsigned_abs();
    deadline.then_some(())?;
    Some(Reservation {
        runtime: nanos(attributes.sched_runtime)?,
        deadline: nanos(attributes.sched_deadline)?,
        period: nanos(attributes.sched_period)?,
    })
}

fn allowed_cpus() -> Vec<usize> {
    sched_getaffinity(Pid::from_raw(0)).map_or_else(
        |_| Vec::new(),
        |set| (0..CpuSet::count()).filter(|cpu| set.is_set(*cpu).unwrap_or(false)).collect(),
    )
}

fn may_use_every_cpu() -> bool {
    let online = read_trimmed("/sys/devices/system/cpu/online").unwrap_or_default();
    cpus::parse(&online).is_none_or(|online| online.iter().all(|cpu| allowed_cpus().contains(cpu)))
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

/// Keeps signals to the process from this thread, so that the thread that waits for them gets them
/// whenever it begins to wait.
///
/// # Errors
/// What the kernel says.
pub fn block_signals() -> Result<(), String> {
    let all = nix::sys::signal::SigSet::all();
    all.thread_block().map_err(|error| format!("signals cannot be blocked: {error}"))
}

/// Touches the pages of the stack that jobs will use, so that none of them faults later.
#[inline(never)]
pub fn prefault_stack() {
    let mut block = [0u8; 128 * 1024];
    for at in (0..block.len()).step_by(1024) {
        block[at] = 1;
    }
    std::hint::black_box(&block);
}

/// Whether the running kernel is built with PREEMPT_RT, and whether it runs in a virtual machine.
#[must_use]
pub fn kernel() -> (bool, bool) {
    let read = |path: &str| read_trimmed(&format!("/{path}"));
    (detection::preempt_rt_sign(&read).is_some(), detection::virtual_machine_sign(&read).is_some())
}

/// What the calling thread runs with: policy, priority and CPUs, read back.
#[must_use]
pub fn thread_grant(lane: &str) -> LaneGrant {
    let attributes = scheduling_attributes();
    let (policy, priority) = match &attributes {
        None => ("unknown".to_owned(), 0),
        Some(found) => {
            let code = i32::try_from(found.sched_policy).unwrap_or(-1);
            let names = [
                (libc::SCHED_OTHER, "SCHED_OTHER"),
                (libc::SCHED_FIFO, "SCHED_FIFO"),
                (libc::SCHED_RR, "SCHED_RR"),
                (libc::SCHED_DEADLINE, "SCHED_DEADLINE"),
            ];
            let name = names.iter().find(|name| name.0 == code).map(|name| name.1.to_owned());
            let name = name.unwrap_or_else(|| format!("policy {code}"));
            (name, i32::try_from(found.sched_priority).unwrap_or(0))
        }
    };
    let (cpus, reserved) = (allowed_cpus(), attributes.as_ref().and_then(reservation_of));
    LaneGrant { lane: lane.to_owned(), policy, priority, cpus, reserved }
}

/// Keeps the kernel's power management from deep sleep for as long as it lives.
#[derive(Debug)]
pub struct CpuLatencyRequest {
    _held_open: std::fs::File,
}

impl CpuLatencyRequest {
    /// Writes a latency of 0 us to `/dev/cpu_dma_latency`; the wish ends with the descriptor.
    /// `None` where that cannot be done, or where the kernel does not say 0 afterwards.
    #[must_use]
    pub fn hold() -> Option<CpuLatencyRequest> {
        let path = "/dev/cpu_dma_latency";
        let mut file = std::fs::OpenOptions::new().read(true).write(true).open(path).ok()?;
        std::io::Write::write_all(&mut file, &0i32.to_ne_bytes()).ok()?;
        let mut now = [0xff; 4];
        file.read_exact_at(&mut now, 0).ok()?;
        (i32::from_ne_bytes(now) == 0).then_some(CpuLatencyRequest { _held_open: file })
    }
}

/// The text of a file of the kernel without the white space around it; `None` when it cannot be
/// read.
fn read_trimmed(path: &str) -> Option<String> {
    read_trimmed_at(Path::new(path))
}

fn read_trimmed_at(path: &Path) -> Option<String> {
    std::fs::read_to_string(path).ok().map(|text| text.trim().to_owned())
}

fn limit(resource: Resource) -> Option<Limit> {
    let (soft, _) = getrlimit(resource).ok()?;
    Some((soft != libc::RLIM_INFINITY).then_some(soft))
}

/// The present facts about the machine and this process, without `dma_latency_held`, which the
/// caller sets.
#[must_use]
pub fn facts() -> Facts {
    let status = read_trimmed("/proc/self/status").unwrap_or_default();
    let number = |path: &str| read_trimmed(path).and_then(|text| text.parse().ok());
    let cpus = "/sys/devices/system/cpu";
    Facts {
        kernel: read_trimmed("/proc/sys/kernel/osrelease"),
        locked_kib: status_kib(&status, "VmLck"),
        resident_kib: status_kib(&status, "VmRSS"),
        rtprio: limit(Resource::RLIMIT_RTPRIO),
        memlock_bytes: limit(Resource::RLIMIT_MEMLOCK),
        rttime_us: limit(Resource::RLIMIT_RTTIME),
        rt_runtime_us: number("/proc/sys/kernel/sched_rt_runtime_us"),
        rt_period_us: number("/proc/sys/kernel/sched_rt_period_us"),
        group_rt_runtime_us: group_rt_budget(),
        clocksource: read_trimmed(
            "/sys/devices/system/clocksource/clocksource0/current_clocksource",
        ),
        governors: governors(Path::new(cpus)),
        isolated: read_trimmed(&format!("{cpus}/isolated")),
        dma_latency_held: false,
    }
}

/// The governors under a directory of CPUs, each once.
fn governors(cpus: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(cpus) else { return vec![UNREADABLE.to_owned()] };
    let scaled = entries.flatten().map(|entry| entry.path().join("cpufreq"));
    let mut found: Vec<String> = scaled
        .filter(|path| path.is_dir())
        .map(|path| {
            read_trimmed_at(&path.join("scaling_governor")).unwrap_or_else(|| UNREADABLE.into())
        })
        .collect();
    found.sort();
    found.dedup();
    found
}

/// The real-time budget of this process's control group; none where groups have no such thing.
fn group_rt_budget() -> Option<i64> {
    group_rt("runtime")
}

/// `runtime` or `period` of that budget, us.
fn group_rt(what: &str) -> Option<i64> {
    let cpu = group_of("cpu")?;
    read_trimmed(&format!("/sys/fs/cgroup/cpu{cpu}/cpu.rt_{what}_us"))?.parse().ok()
}

/// The control group of this process under a controller; an empty name stands for the unified tree.
fn group_of(controller: &str) -> Option<String> {
    let groups = read_trimmed("/proc/self/cgroup")?;
    groups.lines().find_map(|line| {
        let mut parts = line.splitn(3, ':').skip(1);
        let found = parts.next()?.split(',').any(|name| name == controller);
        found.then(|| parts.next()).flatten().map(str::to_owned)
    })
}

/// The part of each period for which the kernel takes the processor from real-time threads that
/// use all of it, of all of them or of those of this control group, whichever is shorter; none when
/// it does not throttle, or when the calling thread is not one of them.
#[must_use]
pub fn throttle_gap() -> Option<Nanos> {
    let attributes = scheduling_attributes()?;
    if let Some(reservation_of) = reservation_of(&attributes) {
        // A thread that has used its reservation waits for the next period.
        return Some(reservation_of.period - reservation_of.runtime);
    }
    if ![libc::SCHED_FIFO, libc::SCHED_RR].contains(&attributes.sched_policy.cast_signed()) {
        return None;
    }
    let number = |path: &str| read_trimmed(path).and_then(|text| text.parse::<i64>().ok());
    let all = number("/proc/sys/kernel/sched_rt_runtime_us")
        .zip(number("/proc/sys/kernel/sched_rt_period_us"));
    let group = group_rt_budget().zip(group_rt("period"));
    let gap = |runtime: i64, period: i64| (0..period).contains(&runtime).then(|| period - runtime);
    let budgets = [all, group].into_iter().flatten();
    let gaps = budgets.filter_map(|(runtime, period)| gap(runtime, period));
    gaps.min().map(Nanos::from_micros)
}

/// Whether the control group's processor quota runs out: the kernel counts the times.
#[derive(Debug)]
pub struct Quota {
    stat: std::fs::File,
    seen: u64,
}

impl Quota {
    /// Opens the group's statistics; none where groups have no quota.
    #[must_use]
    pub fn open() -> Option<Quota> {
        let first = group_of("cpu").map(|group| format!("/sys/fs/cgroup/cpu{group}/cpu.stat"));
        let unified = group_of("").map(|group| format!("/sys/fs/cgroup{group}/cpu.stat"));
        let stat = [first, unified].into_iter().flatten();
        let stat = stat.filter_map(|path| std::fs::File::open(path).ok()).next()?;
        let mut quota = Quota { stat, seen: 0 };
        quota.has_run_out();
        Some(quota)
    }

    /// Whether it has run out since the last call. One read into a buffer on the stack.
    pub fn has_run_out(&mut self) -> bool {
        let mut text = [0; 1024];
        let read = std::os::unix::fs::FileExt::read_at(&self.stat, &mut text, 0).unwrap_or(0);
        let Some(times) = stat_number(&text[..read], b"nr_throttled ") else { return false };
        core::mem::replace(&mut self.seen, times) < times
    }
}

/// The number behind a key at the start of a line.
fn stat_number(text: &[u8], key: &[u8]) -> Option<u64> {
    let line = text.split(|byte| *byte == b'\n').find_map(|line| line.strip_prefix(key))?;
    core::str::from_utf8(line).ok()?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_found_by_their_whole_key() {
        let text = b"nr_periods 9\nnr_throttled 12\nthrottled_time 5\n";
        assert_eq!(stat_number(text, b"nr_throttled "), Some(12));
        assert_eq!(stat_number(text, b"throttled "), None);
        assert_eq!(stat_number(b"nr_throttled x", b"nr_throttled "), None);
        assert_eq!(stat_number(b"", b"nr_throttled "), None);
    }
}
