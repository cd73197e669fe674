//! The demands of a machine on the kernel, item by item, and the shortfalls: what was found, what
//! was demanded, and a remedy. An item that could not be read counts as missing if it is demanded
//! hard.

use crate::cpus;
use crate::facts::{Facts, LaneGrant, Limit};

/// One requirement of real-time operation on the kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Item {
    /// Every lane's thread has the `SCHED_FIFO` priority, or the reservation, that it asked for.
    Fifo,
    /// Every lane that names a CPU runs there and nowhere else.
    Cpu,
    /// All memory is locked.
    Memory,
    /// The kernel is built with PREEMPT_RT.
    PreemptRt,
    /// Real-time threads are not throttled.
    Throttling,
    /// No limit on processor time without a wait (RLIMIT_RTTIME).
    Rttime,
    /// The control group has a real-time budget, where groups have such a thing.
    Cgroup,
    /// Every CPU with frequency scaling runs the governor `performance`.
    Governor,
    /// Every lane runs on isolated CPUs.
    Isolation,
    /// The clock source can be read without leaving the processor.
    Clocksource,
    /// `/dev/cpu_dma_latency` is held at 0.
    DmaLatency,
}

impl Item {
    /// Every item.
    pub const ALL: [Item; 11] = [
        Item::Fifo,
        Item::Cpu,
        Item::Memory,
        Item::PreemptRt,
        Item::Throttling,
        Item::Rttime,
        Item::Cgroup,
        Item::Governor,
        Item::Isolation,
        Item::Clocksource,
        Item::DmaLatency,
    ];

    /// The name in configurations and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Item::Fifo => "fifo",
            Item::Cpu => "cpu",
            Item::Memory => "memory",
            Item::PreemptRt => "preempt_rt",
            Item::Throttling => "throttling",
            Item::Rttime => "rttime",
            Item::Cgroup => "cgroup",
            Item::Governor => "governor",
            Item::Isolation => "isolation",
            Item::Clocksource => "clocksource",
            Item::DmaLatency => "dma_latency",
        }
    }

    /// Whether the program itself asks for the item. Without these items no timing figure is worth
    /// much.
    #[must_use]
    pub const fn is_core(self) -> bool {
        matches!(self, Item::Fifo | Item::Cpu | Item::Memory)
    }

    const fn wanted(self) -> &'static str {
        match self {
            Item::Fifo => "the policy and priority of each lane",
            Item::Cpu => "the CPU of each lane",
            Item::Memory => "all of it locked",
            Item::PreemptRt => "a kernel built with PREEMPT_RT",
            Item::Throttling => "sched_rt_runtime_us = -1",
            Item::Rttime => "RLIMIT_RTTIME = unlimited",
            Item::Cgroup => "cpu.rt_runtime_us above 0",
            Item::Governor => "performance",
            Item::Isolation => "each lane on isolated CPUs",
            Item::Clocksource => "tsc, kvm-clock or arch_sys_counter",
            Item::DmaLatency => "/dev/cpu_dma_latency held at 0",
        }
    }

    const fn remedy(self) -> &'static str {
        match self {
            Item::Fifo => "raise RLIMIT_RTPRIO (LimitRTPRIO= in the unit) or grant CAP_SYS_NICE",
            Item::Cpu => "name a CPU that is online and in this process's cpuset",
            Item::Memory => "raise RLIMIT_MEMLOCK (LimitMEMLOCK=infinity in the unit)",
            Item::PreemptRt => {
                "boot an RT kernel (linux-image-rt-amd64), or say preempt_rt = \"soft\" aloud"
            }
            Item::Throttling => "sysctl kernel.sched_rt_runtime_us=-1",
            Item::Rttime => "LimitRTTIME=infinity in the unit, or ulimit -R unlimited",
            Item::Cgroup => "give the group cpu.rt_runtime_us, or boot without RT_GROUP_SCHED",
            Item::Governor => "cpupower frequency-set -g performance",
            Item::Isolation => "boot with isolcpus= and name those CPUs in the lanes",
            Item::Clocksource => "boot with clocksource=tsc where the TSC is stable",
            Item::DmaLatency => {
                "let the service read and write /dev/cpu_dma_latency (udev, DeviceAllow=)"
            }
        }
    }
}

/// The consequence of a missing item.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Weight {
    /// The run is refused before any output is armed.
    Hard,
    /// It is reported.
    #[default]
    Soft,
    /// It is not reported.
    None,
}

impl Weight {
    /// The name in configurations and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Weight::Hard => "hard",
            Weight::Soft => "soft",
            Weight::None => "none",
        }
    }
}

/// The weight of every item.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Demands([Weight; Item::ALL.len()]);

impl Demands {
    /// Everything is reported and nothing refused: a simulated robot.
    pub const SOFT: Demands = Demands([Weight::Soft; Item::ALL.len()]);

    /// What a board is driven with unless the configuration says otherwise: priority, CPU, memory
    /// and a kernel built with PREEMPT_RT, or nothing.
    pub const BOARD: Demands = Demands::SOFT
        .with(Item::Fifo, Weight::Hard)
        .with(Item::Cpu, Weight::Hard)
        .with(Item::Memory, Weight::Hard)
        .with(Item::PreemptRt, Weight::Hard);

    /// The same with another weight for one item.
    #[must_use]
    pub const fn with(mut self, item: Item, weight: Weight) -> Demands {
        self.0[item as usize] = weight;
        self
    }

    /// The weight of an item.
    #[must_use]
    pub const fn of(&self, item: Item) -> Weight {
        self.0[item as usize]
    }
}

/// An item that is not as demanded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shortfall {
    /// Which one.
    pub item: Item,
    /// What missing it means.
    pub weight: Weight,
    /// What is there.
    pub found: String,
}

impl Shortfall {
    /// A shortfall without a weight yet.
    #[must_use]
    pub fn new(item: Item, found: impl Into<String>) -> Shortfall {
        Shortfall { item, weight: Weight::Soft, found: found.into() }
    }

    /// What was to be there.
    #[must_use]
    pub fn wanted(&self) -> &'static str {
        self.item.wanted()
    }

    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        self.item.remedy()
    }
}

impl core::fmt::Display for Shortfall {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let (name, found) = (self.item.name(), &self.found);
        write!(f, "{name}: {found}; wanted {}; {}", self.wanted(), self.remedy())
    }
}

/// What the facts fall short of. What could not be read counts only where it is demanded hard.
pub(crate) fn shortfalls(
    facts: &Facts,
    preempt_rt: bool,
    lanes: &[LaneGrant],
    demands: &Demands,
) -> Vec<Shortfall> {
    let mut found = Vec::new();
    for item in Item::ALL.into_iter().filter(|item| !item.is_core()) {
        let words = match item_state(item, facts, preempt_rt, lanes) {
            ItemState::Good => continue,
            ItemState::Unknown if demands.of(item) != Weight::Hard => continue,
            ItemState::Unknown => "cannot be read here".to_owned(),
            ItemState::Bad(words) => words,
        };
        found.push(Shortfall::new(item, words));
    }
    found
}

/// The state of one item.
enum ItemState {
    Good,
    Unknown,
    Bad(String),
}

impl ItemState {
    /// The state that `words` stand for: `None` is unknown, `Some(None)` is good, and words say
    /// what is bad.
    fn of(words: Option<Option<String>>) -> ItemState {
        match words {
            None => ItemState::Unknown,
            Some(None) => ItemState::Good,
            Some(Some(words)) => ItemState::Bad(words),
        }
    }
}

fn item_state(item: Item, facts: &Facts, preempt_rt: bool, lanes: &[LaneGrant]) -> ItemState {
    match item {
        Item::Fifo | Item::Cpu | Item::Memory => ItemState::Good,
        Item::PreemptRt if preempt_rt => ItemState::Good,
        Item::PreemptRt => ItemState::Bad("the kernel is built without PREEMPT_RT".to_owned()),
        Item::Throttling => {
            ItemState::of(facts.rt_runtime_us.zip(facts.rt_period_us).map(|(runtime, period)| {
                (0..period).contains(&runtime).then(|| {
                    format!("real-time threads are throttled to {runtime} us of every {period} us")
                })
            }))
        }
        Item::Rttime => ItemState::of(facts.rttime_us.map(|limit: Limit| {
            limit.map(|us| format!("a lane that computes for {us} us is killed"))
        })),
        // Where groups have no such budget there is nothing to miss.
        Item::Cgroup => match facts.group_rt_runtime_us {
            Some(0) => ItemState::Bad("this control group has no real-time budget".to_owned()),
            _ => ItemState::Good,
        },
        Item::Governor => {
            let mut slow = facts.governors.iter().filter(|name| *name != "performance");
            slow.next().map_or(ItemState::Good, |name| {
                ItemState::Bad(format!("frequency governor {name}: clock speed varies"))
            })
        }
        Item::Isolation => isolation(facts, lanes),
        Item::Clocksource => ItemState::of(facts.clocksource.as_ref().map(|name| {
            let quick = ["tsc", "kvm-clock", "arch_sys_counter"].contains(&name.as_str());
            (!quick).then(|| format!("clock source {name}: slow to read"))
        })),
        Item::DmaLatency if facts.dma_latency_held => ItemState::Good,
        Item::DmaLatency => ItemState::Bad(
            "/dev/cpu_dma_latency is not held: processors may sleep deeply".to_owned(),
        ),
    }
}

fn isolation(facts: &Facts, lanes: &[LaneGrant]) -> ItemState {
    let Some(isolated) = &facts.isolated else { return ItemState::Unknown };
    let Some(list) = cpus::parse(isolated) else { return ItemState::Unknown };
    let outside = |lane: &&LaneGrant| lane.cpus.iter().any(|cpu| !list.contains(cpu));
    let names: Vec<&str> = lanes.iter().filter(outside).map(|lane| lane.lane.as_str()).collect();
    if names.is_empty() {
        return ItemState::Good;
    }
    let shown = if isolated.is_empty() { "none" } else { isolated };
    ItemState::Bad(format!("isolated CPUs: {shown}; not on them: {}", names.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn good() -> Facts {
        Facts {
            rt_runtime_us: Some(-1),
            rt_period_us: Some(1_000_000),
            rttime_us: Some(None),
            clocksource: Some("tsc".into()),
            governors: vec!["performance".into()],
            isolated: Some("2-3".into()),
            dma_latency_held: true,
            ..Facts::default()
        }
    }

    fn lane(cpus: &[usize]) -> LaneGrant {
        LaneGrant { lane: "servo".into(), cpus: cpus.to_vec(), ..LaneGrant::default() }
    }

    fn items(facts: &Facts, rt: bool, lanes: &[LaneGrant], demands: &Demands) -> Vec<Item> {
        shortfalls(facts, rt, lanes, demands).iter().map(|short| short.item).collect()
    }

    #[test]
    fn what_costs_real_time_falls_short_and_what_does_not_does_not() {
        assert_eq!(items(&good(), true, &[lane(&[2])], &Demands::SOFT), []);
        let full = Facts { rt_runtime_us: Some(1_000_000), ..good() };
        assert_eq!(items(&full, true, &[lane(&[3])], &Demands::SOFT), []);
        let bad = Facts {
            rt_runtime_us: Some(950_000),
            rttime_us: Some(Some(200_000)),
            clocksource: Some("hpet".into()),
            governors: vec!["performance".into(), "powersave".into()],
            group_rt_runtime_us: Some(0),
            dma_latency_held: false,
            ..good()
        };
        let all = items(&bad, false, &[lane(&[1, 2])], &Demands::SOFT);
        assert_eq!(all, Item::ALL[3..], "every item that is no matter of asking");
    }

    #[test]
    fn what_cannot_be_read_counts_only_where_it_is_demanded() {
        let blank = Facts { dma_latency_held: true, ..Facts::default() };
        assert_eq!(items(&blank, true, &[], &Demands::SOFT), []);
        let mut demands = Demands::SOFT;
        for item in Item::ALL {
            demands = demands.with(item, Weight::Hard);
        }
        let unknown = [Item::Throttling, Item::Rttime, Item::Isolation, Item::Clocksource];
        assert_eq!(items(&blank, true, &[], &demands), unknown);
    }

    #[test]
    fn lanes_are_isolated_when_all_their_cpus_are() {
        let of = |isolated: &str, cpus: &[usize]| {
            let facts = Facts { isolated: Some(isolated.into()), ..good() };
            items(&facts, true, &[lane(cpus)], &Demands::SOFT).is_empty()
        };
        assert!(of("2-3,7", &[7]) && of("2", &[2]) && of("0-1", &[0, 1]));
        assert!(!of("2-3", &[1]) && !of("2-3", &[2, 4]) && !of("", &[0]));
        assert!(of("3-2", &[1]) && of("x", &[1]) && of("0-99999999", &[1]), "unreadable");
    }

    #[test]
    fn names_are_unique_and_every_shortfall_has_a_remedy() {
        let names: std::collections::BTreeSet<&str> =
            Item::ALL.iter().map(|item| item.name()).collect();
        assert_eq!(names.len(), Item::ALL.len());
        for (index, item) in Item::ALL.into_iter().enumerate() {
            assert_eq!(item as usize, index);
            let text = Shortfall::new(item, "nothing").to_string();
            assert!(text.starts_with(item.name()) && text.contains("nothing; wanted "), "{text}");
        }
        assert_eq!(Demands::BOARD.of(Item::Memory), Weight::Hard);
        assert_eq!(Demands::BOARD.of(Item::PreemptRt), Weight::Hard);
        assert_eq!(Demands::BOARD.of(Item::Governor), Weight::Soft);
    }
}
