//! What one lane learns of the others while it runs: which stand still, whether a watched thread
//! does, and whether there was a storm of misses elsewhere. The same on threads and in virtual
//! time.

use taktil_hal::Nanos;

use super::flags::StormCount;
use super::heartbeat::{HeartbeatMonitor, WatchedHeartbeat};
use super::monitor::ProgressMonitor;
use super::progress::JobProgress;
use crate::fault::FaultCode;
use crate::lane::Lane;
use crate::misses::{Backlog, Notice};

/// How far the schedule is ahead of the lane when a job that began at `begin` has ended at `end`.
pub(super) fn backlog(lane: &Lane, begin: Nanos, end: Nanos) -> Backlog {
    let next = lane.account.next_tick;
    let newest = lane.plan.spec.newest_released(end);
    Backlog {
        superseded: newest.saturating_sub(next),
        served: newest >= next && newest == lane.plan.spec.newest_released(begin),
    }
}

/// The monitor of the other lanes, and of the threads beside them, while a lane runs.
pub(super) struct PeerMonitor<'a> {
    progress: ProgressMonitor,
    heartbeats: HeartbeatMonitor<'a>,
    /// Storms known so far: the lane's own, and those of others that its tasks have been told of.
    storms: u64,
}

impl<'a> PeerMonitor<'a> {
    /// The monitor of lane number `index`, whose jobs are `period` apart.
    pub(super) fn new(
        index: usize,
        period: Nanos,
        progress: &JobProgress,
        heartbeats: &'a [WatchedHeartbeat],
    ) -> PeerMonitor<'a> {
        PeerMonitor {
            progress: progress.peer_monitor(index),
            heartbeats: HeartbeatMonitor::new(heartbeats, period),
            storms: 0,
        }
    }

    /// Tells the other lanes of this lane's `own_storms`, and adds to its notice which lanes stand
    /// still at `now`, whether a watched thread does, and whether there was a storm elsewhere: a
    /// supervised lane hears in this way of a storm in a lane that is not supervised, and the whole
    /// robot stops.
    pub(super) fn add_to_notice(
        &mut self,
        progress: &JobProgress,
        storms: &StormCount,
        now: Nanos,
        own_storms: u64,
        own_notice: Notice,
    ) -> Notice {
        if own_storms > 0 {
            storms.add(own_storms);
            self.storms += own_storms;
        }
        let silent = self.progress.silent_lanes(now, |lane| progress.jobs_done(lane));
        let mut notice = Notice { silent, ..own_notice };
        if silent != 0 {
            notice.faults.insert(FaultCode::LaneSilent);
        }
        if self.heartbeats.is_one_silent(now) {
            notice.faults.insert(FaultCode::MonitorSilent);
        }
        let all = storms.count();
        if core::mem::replace(&mut self.storms, all) != all {
            notice.faults.insert(FaultCode::OverrunStorm);
        }
        notice
    }
}
