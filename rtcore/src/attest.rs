//! What the kernel granted, read back and not assumed: per lane its policy, priority and CPUs, and
//! for the process memory, limits, throttling, clock and power. Refuses to judge a robot: what was
//! asked for and is missing stands apart from what is merely so.

use crate::contract::{Demands, Item, Shortfall, Weight, shortfalls};
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

/// What the kernel granted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Attestation {
    /// Everything that is not as demanded, weighed; also what weighs nothing.
    pub shortfalls: Vec<Shortfall>,
    /// What was asked for or demanded and not granted, one sentence each.
    pub missing: Vec<String>,
    /// What was not asked for and costs real time all the same, one sentence each.
    pub notes: Vec<String>,
    /// The kernel is built with PREEMPT_RT.
    pub preempt_rt: bool,
    /// It runs in a virtual machine.
    pub virtual_machine: bool,
    /// Each lane's thread.
    pub lanes: Vec<LaneGrant>,
    /// The machine and the process.
    pub facts: Facts,
}

impl Attestation {
    /// Policy, priority, processor and memory are as asked for, and nothing demanded is missing.
    #[must_use]
    pub fn granted(&self) -> bool {
        self.missing.is_empty()
    }

    /// What was demanded and is missing: a run that drives a board is refused.
    pub fn refused(&self) -> impl Iterator<Item = &Shortfall> {
        self.shortfalls.iter().filter(|short| short.weight == Weight::Hard)
    }

    /// Timing figures of this run say something about the machine's real-time abilities, whatever
    /// was demanded.
    #[must_use]
    pub fn representative(&self) -> bool {
        let core = self.shortfalls.iter().any(|short| short.item.core());
        self.granted() && !core && self.preempt_rt && !self.virtual_machine
    }

    /// Weighs what was asked for and not granted, and what the facts fall short of, once they are
    /// complete.
    pub(crate) fn judge(&mut self, asked: Vec<Shortfall>, demands: &Demands) {
        let facts = &self.facts;
        self.shortfalls = asked;
        let said = self.shortfalls.iter().any(|short| short.item == Item::Memory);
        let hard = demands.of(Item::Memory) == Weight::Hard;
        self.shortfalls.extend(facts.unlocked(hard).filter(|_| !said));
        self.shortfalls.extend(shortfalls(facts, self.preempt_rt, &self.lanes, demands));
        if self.virtual_machine {
            self.notes.push("a virtual machine: its host may take the processor".to_owned());
        }
        for short in &mut self.shortfalls {
            short.weight = demands.of(short.item);
            let asked = short.item.core() || short.weight == Weight::Hard;
            match short.weight {
                Weight::None => {}
                _ if asked => self.missing.push(short.found.clone()),
                _ => self.notes.push(short.found.clone()),
            }
        }
    }
}

/// Resident memory that no lock covers: pages of the kernel's own, mapped into every process.
const UNLOCKED_KIB: u64 = 256;

impl Facts {
    /// A memory lock that was not refused and does not cover the process, or, where it is demanded
    /// `hard`, is not seen to.
    fn unlocked(&self, hard: bool) -> Option<Shortfall> {
        let found = match self.locked_kib.zip(self.resident_kib) {
            Some((locked, resident)) => (locked + UNLOCKED_KIB < resident)
                .then(|| format!("memory: {locked} KiB locked of {resident} KiB resident"))?,
            None if hard => "memory: VmLck or VmRSS cannot be read".to_owned(),
            None => return None,
        };
        Some(Shortfall::new(Item::Memory, found))
    }

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

    #[test]
    fn a_lock_that_does_not_cover_is_missing() {
        let facts = |locked, resident| Facts {
            locked_kib: locked,
            resident_kib: resident,
            ..Facts::default()
        };
        let judged = |facts: Facts, asked, demands: &Demands| {
            let mut attestation = Attestation { facts, ..Attestation::default() };
            attestation.judge(asked, demands);
            attestation
        };
        let missing = |facts: Facts| judged(facts, Vec::new(), &Demands::SOFT).missing;
        assert_eq!(missing(facts(Some(9000), Some(9000))).len(), 0);
        assert_eq!(missing(facts(Some(4000), Some(9000))).len(), 1);
        assert_eq!(missing(facts(Some(0), Some(9000))).len(), 1, "a lock that locked nothing");
        assert_eq!(missing(facts(None, Some(9000))).len(), 0, "unknown is not missing");
        let unseen = judged(facts(None, Some(9000)), Vec::new(), &Demands::BOARD);
        assert_eq!(unseen.refused().count(), 1, "unless it is demanded");
        let refused = vec![Shortfall::new(Item::Memory, "refused")];
        let both = judged(facts(Some(0), Some(9000)), refused, &Demands::BOARD);
        assert_eq!(both.missing, ["refused"], "said once");
    }

    #[test]
    fn the_weight_of_an_item_decides_what_missing_it_means() {
        let judged = |demands: &Demands| {
            let facts = Facts { locked_kib: Some(9), resident_kib: Some(9), ..Facts::default() };
            let mut attestation = Attestation { preempt_rt: true, facts, ..Attestation::default() };
            attestation.judge(vec![Shortfall::new(Item::Fifo, "no priority")], demands);
            attestation
        };
        let soft = judged(&Demands::SOFT);
        assert_eq!(
            (soft.refused().count(), soft.missing.as_slice()),
            (0, &["no priority".into()][..])
        );
        assert_eq!(soft.notes.len(), 1, "dma latency");
        assert!(!soft.granted());
        let board = judged(&Demands::BOARD);
        assert_eq!(board.refused().map(|short| short.item).collect::<Vec<_>>(), [Item::Fifo]);
        let none =
            Demands::SOFT.with(Item::Fifo, Weight::None).with(Item::DmaLatency, Weight::None);
        let silent = judged(&none);
        assert!(silent.granted() && silent.notes.is_empty() && silent.refused().count() == 0);
        assert!(!silent.representative(), "silence grants nothing");
        let strict = judged(&none.with(Item::DmaLatency, Weight::Hard));
        assert_eq!(
            strict.refused().map(|short| short.item).collect::<Vec<_>>(),
            [Item::DmaLatency]
        );
        assert_eq!(strict.missing.len(), 1, "what is demanded and missing is no mere note");
    }
}
