//! What the kernel granted to a run and what its jobs missed, as JSON for logs and reports.

use serde_json::{Value, json};
use taktil_rtcore::Misses;
use taktil_rtcore::contract::Shortfall;
use taktil_rtcore::live::{Attestation, LaneGrant};

/// What was granted and read back; nulls and empty lists in virtual time.
#[must_use]
pub fn attested(attestation: Option<&Attestation>) -> Value {
    let granted = |a: &Attestation| {
        let lane = |lane: &LaneGrant| {
            let (policy, priority) = (&lane.policy, lane.priority);
            let reserved = lane.reserved.map(|r| {
                let (runtime, deadline, period) = (r.runtime.0, r.deadline.0, r.period.0);
                json!({ "runtime_ns": runtime, "deadline_ns": deadline, "period_ns": period })
            });
            json!({
                "lane": lane.lane,
                "policy": policy,
                "priority": priority,
                "cpus": lane.cpus,
                "reserved": reserved,
            })
        };
        a.lanes.iter().map(lane).collect::<Vec<_>>()
    };
    let facts = |a: &Attestation| {
        let row = |(name, value): (&str, String)| (name.to_owned(), Value::from(value));
        Value::Object(a.facts.rows().into_iter().map(row).collect())
    };
    json!({
        "granted": attestation.map(Attestation::is_granted),
        "missing": attestation.map_or(&[][..], |a| &a.missing),
        "shortfalls": attestation.map(shortfalls),
        "notes": attestation.map_or(&[][..], |a| &a.notes),
        "preempt_rt": attestation.map(|a| a.preempt_rt),
        "virtual_machine": attestation.map(|a| a.virtual_machine),
        "lanes": attestation.map(granted),
        "facts": attestation.map(facts),
    })
}

fn shortfalls(attestation: &Attestation) -> Vec<Value> {
    let row = |short: &Shortfall| {
        json!({
            "item": short.item.name(),
            "weight": short.weight.name(),
            "found": short.found,
            "wanted": short.wanted(),
            "remedy": short.remedy(),
        })
    };
    attestation.shortfalls.iter().map(row).collect()
}

/// Counts by cause.
#[must_use]
pub fn misses_json(misses: &Misses) -> Value {
    let row = |(name, count): (&str, u64)| (name.to_owned(), Value::from(count));
    Value::Object(misses.rows().into_iter().map(row).collect())
}
