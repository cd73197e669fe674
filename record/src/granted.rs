//! The grants of the kernel to a run and the missed deadlines of its jobs, in the form in which
//! logs and reports hold them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use taktil_rtcore::Misses;
use taktil_rtcore::contract::Shortfall;
use taktil_rtcore::live::{Attestation, LaneGrant};

/// What was granted and read back. In virtual time nothing is: everything is absent or empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Grants {
    /// Whether everything that was asked for was granted.
    pub granted: Option<bool>,
    /// What was not granted, in words.
    pub missing: Vec<String>,
    /// The items of the contract that were not met.
    pub shortfalls: Option<Vec<UnmetItem>>,
    /// What else is worth knowing, in words.
    pub notes: Vec<String>,
    /// Whether the kernel is a `PREEMPT_RT` one.
    pub preempt_rt: Option<bool>,
    /// Whether the kernel runs in a virtual machine.
    pub virtual_machine: Option<bool>,
    /// What each lane got.
    pub lanes: Option<Vec<LaneGrants>>,
    /// Facts about the host, name by name.
    pub facts: Option<BTreeMap<String, String>>,
}

/// An item of the contract that was not met.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct UnmetItem {
    /// Which item.
    pub item: String,
    /// Whether it refuses a run (`hard`) or not (`soft`).
    pub weight: String,
    /// What was found.
    pub found: String,
    /// What was wanted.
    pub wanted: String,
    /// What a person can do about it.
    pub remedy: String,
}

/// What one lane got.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LaneGrants {
    /// Name of the lane.
    pub lane: String,
    /// Scheduling policy.
    pub policy: String,
    /// Priority.
    pub priority: i32,
    /// CPUs on which it may run.
    pub cpus: Vec<usize>,
    /// What `SCHED_DEADLINE` reserved for it.
    pub reserved: Option<ReservedTime>,
}

/// A reservation of `SCHED_DEADLINE`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ReservedTime {
    /// Processor time of one period (ns).
    pub runtime_ns: i64,
    /// From the release until which it is given (ns).
    pub deadline_ns: i64,
    /// The period (ns).
    pub period_ns: i64,
}

impl Grants {
    /// What an attestation says; nothing without one.
    #[must_use]
    pub fn new(attestation: Option<&Attestation>) -> Grants {
        let Some(attestation) = attestation else { return Grants::default() };
        let facts = attestation.facts.rows().into_iter();
        Grants {
            granted: Some(attestation.is_granted()),
            missing: attestation.missing.clone(),
            shortfalls: Some(attestation.shortfalls.iter().map(UnmetItem::new).collect()),
            notes: attestation.notes.clone(),
            preempt_rt: Some(attestation.preempt_rt),
            virtual_machine: Some(attestation.virtual_machine),
            lanes: Some(attestation.lanes.iter().map(LaneGrants::new).collect()),
            facts: Some(facts.map(|(name, value)| (name.to_owned(), value)).collect()),
        }
    }

    /// The JSON object, whose keys are sorted.
    #[must_use]
    pub fn to_json(&self) -> Value {
        serde_json::to_value(self).unwrap_or_default()
    }
}

impl UnmetItem {
    fn new(shortfall: &Shortfall) -> UnmetItem {
        UnmetItem {
            item: shortfall.item.name().to_owned(),
            weight: shortfall.weight.name().to_owned(),
            found: shortfall.found.clone(),
            wanted: shortfall.wanted().to_owned(),
            remedy: shortfall.remedy().to_owned(),
        }
    }
}

impl LaneGrants {
    fn new(grant: &LaneGrant) -> LaneGrants {
        LaneGrants {
            lane: grant.lane.clone(),
            policy: grant.policy.clone(),
            priority: grant.priority,
            cpus: grant.cpus.clone(),
            reserved: grant.reserved.map(|reserved| ReservedTime {
                runtime_ns: reserved.runtime.0,
                deadline_ns: reserved.deadline.0,
                period_ns: reserved.period.0,
            }),
        }
    }
}

/// Counts of missed deadlines by cause.
#[must_use]
pub fn misses_by_cause(misses: &Misses) -> BTreeMap<String, u64> {
    misses.rows().into_iter().map(|(name, count)| (name.to_owned(), count)).collect()
}
