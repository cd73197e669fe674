//! The side of a bus that commands drives which close a loop themselves: three separate acts and a
//! target each cycle, in place of torques and the one line of a cell.

use taktil_drivers_exchange::Failure;
use taktil_hal::{CHANNELS, DriveActual, DriveCommand, DriveRequest, DriveState, ErrorKind, Nanos};

use super::Bus;
use crate::canopen;
use crate::drive::Acts;

/// What the half for drives has committed, and how the bus takes it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct DriveDemand {
    request: DriveRequest,
    reset: bool,
    /// The lines fell silent while the drives followed: the request has to be given up first.
    is_blocked: bool,
    was_live: bool,
    /// The newest sign of life that this half has sent.
    beaten: Option<Nanos>,
}

/// How a drive has taken the request to follow.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Following {
    since: Option<Nanos>,
    has_begun: bool,
}

impl Following {
    /// Whether the drive is asked to follow and does not: it has stopped to do so, or has not begun
    /// to within `enable_time`.
    fn is_failing(&self, release: Nanos, follows: bool, enable_time: Nanos) -> bool {
        let Some(since) = self.since else { return false };
        (self.has_begun || release - since > enable_time) && !follows
    }
}

impl Bus {
    /// What the drives report.
    pub(crate) fn reports(&mut self, release: Nanos) -> Result<[DriveActual; CHANNELS], Failure> {
        self.exchange(release)?;
        let mut reports = [DriveActual::default(); CHANNELS];
        for (report, member) in reports.iter_mut().zip(&self.members) {
            *report = member.drive.actual();
        }
        Ok(reports)
    }

    /// Commands every drive; the targets are in range.
    pub(crate) fn commit_drives(
        &mut self,
        release: Nanos,
        command: &DriveCommand,
    ) -> Result<(), Failure> {
        let DriveCommand { targets, request, reset } = *command;
        self.torques = Some(release);
        let is_fed = !self.has_lines || (self.lines.is_some() && self.is_fed(release));
        let mut demand = self.demand.unwrap_or_default();
        let wants = request == DriveRequest::Follow;
        demand.is_blocked &= wants;
        demand.is_blocked |= wants && demand.was_live && !is_fed;
        demand.was_live = wants && is_fed;
        (demand.request, demand.reset) = (request, reset);
        // Where the line is at the drives as well, both have to say so.
        let may_follow = is_fed && !demand.is_blocked && (!self.has_lines || self.enables);
        let request = match request {
            DriveRequest::Follow if !may_follow => DriveRequest::QuickStop,
            request => request,
        };
        let mut is_sent = true;
        if self.is_canopen && !self.has_lines {
            is_sent &= self.beat(release, &mut demand);
        }
        self.demand = Some(demand);
        let lifts_brake = if self.has_lines { self.lifts_brake } else { wants && may_follow };
        is_sent &= self.lead(release, Acts { request, reset, lifts_brake }, false);
        for (index, target) in targets.iter().enumerate().take(self.members.len()) {
            if let Some(frame) = self.members[index].drive.target(*target) {
                is_sent &= self.send(&frame);
            }
        }
        self.answer(is_sent)?;
        if demand.is_blocked {
            return Err(Failure::whole(ErrorKind::Transient));
        }
        match self.failing_drive(release, request) {
            Some(channel) => Err(Failure::on_channel(ErrorKind::Transient, channel)),
            None => Ok(()),
        }
    }

    /// The first drive that is asked to follow and does not.
    fn failing_drive(&mut self, release: Nanos, request: DriveRequest) -> Option<usize> {
        let (mut failing, enable_after) = (None, self.enable_after);
        for (channel, member) in self.members.iter_mut().enumerate() {
            let follows = member.drive.actual().state == DriveState::Following;
            let following = &mut member.following;
            if request != DriveRequest::Follow {
                *following = Following::default();
                continue;
            }
            following.since.get_or_insert(release);
            following.has_begun |= follows;
            if failing.is_none() && following.is_failing(release, follows, enable_after) {
                failing = Some(channel);
            }
        }
        failing
    }

    /// Sends the host's sign of life, where no half of the lines does.
    fn beat(&mut self, release: Nanos, demand: &mut DriveDemand) -> bool {
        let is_due = demand.beaten.is_none_or(|beaten| (release - beaten) * 4 >= self.silence);
        if !is_due {
            return true;
        }
        demand.beaten = Some(release);
        self.send(&canopen::heartbeat(self.host))
    }

    /// Sends the control frames that have changed, or all of them, and one more: a frame that was
    /// lost on its way is made up for.
    fn lead(&mut self, release: Nanos, acts: Acts, all: bool) -> bool {
        let mut is_sent = true;
        self.refreshed = (self.refreshed + 1) % self.members.len().max(1);
        for index in 0..self.members.len() {
            let member = &mut self.members[index];
            let Some(frame) = member.drive.lead(release, acts) else {
                member.control = None;
                continue;
            };
            if all || member.control != Some(frame) || self.refreshed == index {
                let is_taken = self.send(&frame);
                self.members[index].control = is_taken.then_some(frame);
                is_sent &= is_taken;
            }
        }
        is_sent
    }

    /// No torque, at once; a new request starts anew.
    pub(super) fn drives_off(&mut self) -> bool {
        if let Some(demand) = &mut self.demand {
            *demand = DriveDemand { beaten: demand.beaten, ..DriveDemand::default() };
        }
        for member in &mut self.members {
            member.following = Following::default();
        }
        let release = self.requested.unwrap_or(Nanos::ZERO);
        let mut is_sent = self.lead(release, Acts::default(), true);
        // A drive that says that it has a fault is led nowhere, or through a reset that is under
        // way; what it says may be wrong.
        for index in 0..self.members.len() {
            let member = &self.members[index];
            let off = member.drive.off().filter(|off| member.control != Some(*off));
            let frame = match member.control {
                None => Some(off.unwrap_or_else(|| member.drive.torque(0))),
                Some(_) => off,
            };
            if let Some(frame) = frame {
                is_sent &= self.send(&frame);
            }
        }
        is_sent
    }

    /// The newest error register of each drive.
    pub(crate) fn error_registers(&self) -> impl Iterator<Item = u8> + '_ {
        self.members.iter().map(|member| member.drive.error_register())
    }
}
