//! Decides on release guards that no configuration asked for. A lane keeps its guard where every
//! lane still meets its deadline; elsewhere the guard is halved or taken away, also where a lane
//! that it would delay is not shown to meet its own deadline.

use taktil_hal::Nanos;

use super::{Allowance, Demand, Verdict, analyse, may_share_cpu, preempts};
use crate::release::{Guard, GuardCondition};
use crate::schedule::Policy;

/// Halves the guards of kind [`GuardCondition::WhenSchedulable`] with which the lanes would not be
/// schedulable, and removes those with which they would not be even then. Lanes of shorter periods
/// are considered first; of equal periods, those of higher priority. No lane gets a whole guard at
/// the cost of another lane's half guard.
pub(crate) fn keep_schedulable_guards(lanes: &mut [Demand], allowance: Allowance) {
    let offered =
        |lane: &Demand| lane.spec.guard.filter(|g| g.given == GuardCondition::WhenSchedulable);
    let mut wishes: Vec<_> =
        (0..lanes.len()).filter_map(|i| offered(&lanes[i]).map(|guard| (i, guard))).collect();
    wishes.sort_by_key(|(i, _)| {
        let spec = &lanes[*i].spec;
        (spec.period, core::cmp::Reverse(spec.priority))
    });
    for (index, _) in &wishes {
        lanes[*index].spec.guard = None;
    }
    wishes.retain(|(index, _)| {
        let spec = &lanes[*index].spec;
        spec.cpu.is_some() && spec.policy != Policy::Deadline
    });
    for parts in [2, 1] {
        for (index, whole) in &wishes {
            let had = lanes[*index].spec.guard;
            let spin_max = Nanos(whole.spin_max.0 / parts);
            lanes[*index].spec.guard = Some(Guard { spin_max, ..*whole });
            if !is_schedulable(lanes, *index, allowance) {
                lanes[*index].spec.guard = had;
            }
        }
    }
}

/// Whether lane `index` and all lanes that its spin can delay meet their deadlines.
fn is_schedulable(lanes: &[Demand], index: usize, allowance: Allowance) -> bool {
    let analysis = analyse(lanes, allowance);
    let spinner = &lanes[index].spec;
    lanes.iter().zip(&analysis.lanes).enumerate().all(|(other, (lane, response))| {
        let held_up = may_share_cpu(spinner, &lane.spec) && preempts(spinner, &lane.spec);
        !(other == index || held_up) || response.verdict == Verdict::Meets
    })
}
