//! Computes the longest response of one lane for known phases, by examining every busy period of
//! one hyperperiod. If the hyperperiod is too long for that, only the bound without phases is
//! known.
//!
//! A busy period that starts with a release of nominal instant `s` is worst when all releases from
//! `s` to `s + J` are late together until `s + J`, and every later one is on time: then all of them
//! meet, and nothing that came before `s` can be counted in their stead. Each nominal release of
//! one hyperperiod is tried as `s`. With J = 0 this is the check of Leung and Merrill (Information
//! Processing Letters 11(3), 1980); the late start is the critical instant of Audsley et al. (1993)
//! applied to the releases that the phases leave.

use taktil_hal::Nanos;

use super::{Bound, Periodic};
use crate::hyperperiod;

/// One release in the pattern.
struct Arrival {
    at: i64,
    cost: i64,
    own: bool,
}

/// The longest response of `own` under the lanes `over`, each release up to `jitter` late; `None`
/// when the pattern has more than [`hyperperiod::RELEASES_MAX`] releases.
///
/// Exact when priorities differ and jitters are independent. A response beyond `own`'s period is a
/// lower bound: one job of `own` is counted in a busy period.
pub(super) fn longest(own: &Periodic, over: &[Periodic], jitter: Nanos) -> Option<Bound> {
    let periods = || over.iter().chain([own]).map(|lane| lane.period);
    let length = hyperperiod::length(periods())?;
    if hyperperiod::release_count(length, periods()) > hyperperiod::RELEASES_MAX {
        return None;
    }
    let pattern = pattern(own, over, length.0);
    let mut worst = 0;
    for start in 0..pattern.len() {
        let (response, ended) = busy_period(&pattern, length.0, jitter.0, start, own.cost.0);
        worst = worst.max(response);
        if !ended {
            return Some(Bound::Beyond(Nanos(worst.max(length.0 + jitter.0))));
        }
    }
    Some(Bound::Within(Nanos(worst)))
}

/// All releases with nominal instants in `[0, length)`, as they are once every lane has started.
fn pattern(own: &Periodic, over: &[Periodic], length: i64) -> Vec<Arrival> {
    let mut all = Vec::new();
    let lanes = over.iter().map(|lane| (lane, false)).chain([(own, true)]);
    for (lane, own) in lanes {
        let first = lane.phase.0.rem_euclid(lane.period.0);
        for job in 0..length / lane.period.0 {
            all.push(Arrival { at: first + job * lane.period.0, cost: lane.cost.0, own });
        }
    }
    all.sort_by_key(|arrival| arrival.at);
    all
}

/// The longest response of an own job inside the busy period from release `start` on, and whether
/// the busy period came to an end.
fn busy_period(
    pattern: &[Arrival],
    length: i64,
    jitter: i64,
    start: usize,
    cost: i64,
) -> (i64, bool) {
    let arrival = |index: usize| {
        let turn = i64::try_from(index / pattern.len()).unwrap_or(i64::MAX / length);
        let arrival = &pattern[index % pattern.len()];
        (arrival.at + turn * length, arrival.cost, arrival.own)
    };
    // A busy period of more than two hyperperiods is longer than any period.
    let turns = 2 * pattern.len() + 1;
    let begin = arrival(start).0 + jitter;
    let (mut end, mut worst) = (begin, 0);
    for index in start..start + turns {
        let (at, other_cost, own) = arrival(index);
        if at > begin && at >= end {
            return (worst, true);
        }
        if !own {
            end += other_cost;
            continue;
        }
        // This job ends when all work that arrived in the meantime has been done.
        let mut done = end + cost;
        let mut settled = false;
        for later in index + 1..index + turns {
            let (at_later, cost_later, own_later) = arrival(later);
            if at_later > begin && at_later >= done {
                settled = true;
                break;
            }
            if !own_later {
                done += cost_later;
            }
        }
        if !settled {
            return (done - at, false);
        }
        worst = worst.max(done - at);
    }
    (worst, false)
}
