//! Guards that nobody asked for: given where every lane still meets its deadline, taken away
//! elsewhere. Refuses to give one where a lane that it would hold up is not shown to meet its own.

use super::{Allowance, Demand, Verdict, analyse, comes_first, meet};
use crate::release::Given;
use crate::schedule::Policy;

/// Takes away the guards of kind [`Given::WhereBorne`] that the schedule does not bear. Lanes of
/// shorter periods are served first; of equal periods, those of higher priority.
pub(crate) fn keep_borne(lanes: &mut [Demand], allowance: Allowance) {
    let offered = |lane: &Demand| lane.spec.guard.filter(|g| g.given == Given::WhereBorne);
    let mut wishes: Vec<_> =
        (0..lanes.len()).filter_map(|i| offered(&lanes[i]).map(|guard| (i, guard))).collect();
    wishes.sort_by_key(|(i, _)| {
        let spec = &lanes[*i].spec;
        (spec.period, core::cmp::Reverse(spec.priority))
    });
    for (index, _) in &wishes {
        lanes[*index].spec.guard = None;
    }
    for (index, guard) in wishes {
        let spec = &lanes[index].spec;
        if spec.cpu.is_none() || spec.policy == Policy::Deadline {
            continue;
        }
        lanes[index].spec.guard = Some(guard);
        if !borne(lanes, index, allowance) {
            lanes[index].spec.guard = None;
        }
    }
}

/// Whether lane `index` and all that its spin can hold up meet their deadlines.
fn borne(lanes: &[Demand], index: usize, allowance: Allowance) -> bool {
    let analysis = analyse(lanes, allowance);
    let spinner = &lanes[index].spec;
    lanes.iter().zip(&analysis.lanes).enumerate().all(|(other, (lane, response))| {
        let held_up = meet(spinner, &lane.spec) && comes_first(spinner, &lane.spec);
        !(other == index || held_up) || response.verdict == Verdict::Meets
    })
}
