//! Facts about the machine, this process and each lane's thread, as read from the kernel. They are
//! not judged here: [`crate::contract`] compares them with the demands.

use crate::schedule::Reservation;

/// What one lane's thread runs with, read back.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LaneGrant {
    /// Name of the lane.
    pub lane: String,
    /// Scheduling policy, such as `SCHED_FIFO`.
    pub policy: String,
    /// Its priority; 0 for ordinary policies.
    pub priority: i32,
    /// CPUs that it may run on.
    pub cpus: Vec<usize>,
    /// What is kept for it under `SCHED_DEADLINE`.
    pub reserved: Option<Reservation>,
}

/// A limit of the process; `None` is no limit.
pub type Limit = Option<u64>;

/// Stands for the governor of a CPU whose frequency is scaled and does not say by what.
pub const UNREADABLE: &str = "unreadable";

/// What the kernel says of the machine and of this process. A `None` could not be read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Facts {
    /// Release of the running kernel.
    pub kernel: Option<String>,
    /// Locked memory (VmLck), KiB.
    pub locked_kib: Option<u64>,
    /// Resident memory (VmRSS), KiB.
    pub resident_kib: Option<u64>,
    /// RLIMIT_RTPRIO.
    pub rtprio: Option<Limit>,
    /// RLIMIT_MEMLOCK, bytes.
    pub memlock_bytes: Option<Limit>,
    /// RLIMIT_RTTIME, us of processor time without a wait.
    pub rttime_us: Option<Limit>,
    /// sched_rt_runtime_us: real-time threads get this much of each period; -1 is all.
    pub rt_runtime_us: Option<i64>,
    /// sched_rt_period_us.
    pub rt_period_us: Option<i64>,
    /// cpu.rt_runtime_us of the control group, where groups have such a budget.
    pub group_rt_runtime_us: Option<i64>,
    /// Current clock source.
    pub clocksource: Option<String>,
    /// Frequency governors in use, one word each, [`UNREADABLE`] for those that cannot be read;
    /// empty without frequency scaling.
    pub governors: Vec<String>,
    /// Isolated CPUs as the kernel lists them; empty when there are none.
    pub isolated: Option<String>,
    /// `/dev/cpu_dma_latency` is held open at 0 during the run.
    pub dma_latency_held: bool,
}

impl Facts {
    /// Names and values for people.
    #[must_use]
    pub fn rows(&self) -> Vec<(&'static str, String)> {
        let number = |value: Option<u64>| value.map_or("unknown".into(), |n| n.to_string());
        let signed = |value: Option<i64>| value.map_or("unknown".into(), |n| n.to_string());
        let limit = |value: Option<Limit>| match value {
            None => "unknown".to_owned(),
            Some(None) => "unlimited".to_owned(),
            Some(Some(n)) => n.to_string(),
        };
        let word = |value: &Option<String>| value.clone().unwrap_or_else(|| "unknown".into());
        let governors =
            if self.governors.is_empty() { "none".to_owned() } else { self.governors.join(" ") };
        vec![
            ("kernel", word(&self.kernel)),
            ("VmLck KiB", number(self.locked_kib)),
            ("VmRSS KiB", number(self.resident_kib)),
            ("RLIMIT_RTPRIO", limit(self.rtprio)),
            ("RLIMIT_MEMLOCK bytes", limit(self.memlock_bytes)),
            ("RLIMIT_RTTIME us", limit(self.rttime_us)),
            ("sched_rt_runtime_us", signed(self.rt_runtime_us)),
            ("sched_rt_period_us", signed(self.rt_period_us)),
            ("group rt_runtime_us", signed(self.group_rt_runtime_us)),
            ("clocksource", word(&self.clocksource)),
            ("governors", governors),
            ("isolated CPUs", word(&self.isolated)),
            ("cpu_dma_latency held", self.dma_latency_held.to_string()),
        ]
    }
}

/// A number behind a key such as `VmLck:` in `/proc/self/status`.
pub(crate) fn status_kib(status: &str, key: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':'))?;
    line.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn status_lines_are_found_by_their_whole_key() {
        let status = "Name:\tx\nVmPeak:\t  9 kB\nVmLck:\t    1234 kB\nVmRSS:\tgarbage kB\n";
        assert_eq!(status_kib(status, "VmLck"), Some(1234));
        assert_eq!(status_kib(status, "VmRSS"), None);
        assert_eq!(status_kib(status, "Vm"), None);
        assert_eq!(status_kib("", "VmLck"), None);
    }
}
