//! The bus of one set of drives: one exchange a cycle, signs of life, and what ends it for good.

mod counts;
mod drives;
mod exchange;

use taktil_drivers_exchange::{Failure, Half};
use taktil_hal::{CHANNELS, Counts, DacCode, ErrorKind, LinesIn, LinesOut, Nanos};

use crate::canopen;
use crate::config::{Config, Protocol};
use crate::drive::{Drive, DriveMessage, Wish};
use crate::frame::{ErrorClass, Frame};
use crate::port::{Port, SendError};
pub use counts::BusCounts;
use drives::{DriveDemand, Following};

/// Frames that one cycle takes at most: more than a bus carries in the longest period.
const FRAMES_MAX: usize = 2_048;
/// Waits, and the time of one, while a half ends on a full queue: a queue of 10 frames is empty
/// after 1.4 ms at 1 Mbit/s, after 11 ms at 125 kbit/s.
const END_WAITS_MAX: usize = 40;
const END_WAIT: Nanos = Nanos::from_millis(1);

/// A drive with what the bus knows of it.
struct Member {
    drive: Box<dyn Drive>,
    position: i32,
    has_answered: bool,
    heard: Option<Nanos>,
    /// Since when it has been wanted without being enabled.
    waiting: Option<Nanos>,
    /// Since when a wish to enable has to do with its fault, and whether the lines have told of it.
    resetting: Option<Nanos>,
    is_told: bool,
    /// The newest frame that leads it towards what is wanted.
    control: Option<Frame>,
    following: Following,
}

/// An output half as the bus sees it: the instant of its newest commit; `None` while it is safe.
type Commit = Option<Nanos>;

/// The bus.
pub(crate) struct Bus {
    port: Box<dyn Port>,
    members: Vec<Member>,
    is_canopen: bool,
    host: u8,
    wait: Nanos,
    lost_after: Nanos,
    silence: Nanos,
    enable_after: Nanos,
    counts: BusCounts,
    /// The failure that ended it for good.
    lost: Option<Failure>,
    requested: Option<Nanos>,
    sampled: Option<(Nanos, Result<(), Failure>)>,
    torques: Commit,
    lines: Commit,
    /// Whether there is a half of the lines, and what it wants: operation, and lifted brakes.
    has_lines: bool,
    enables: bool,
    lifts_brake: bool,
    /// What the half for drives wants, once it has committed.
    demand: Option<DriveDemand>,
    /// The feed line, and when it changed last.
    feed: bool,
    fed: Option<Nanos>,
    /// Whose control frame is repeated next.
    refreshed: usize,
    /// Waits that a full queue may still cost; none but when a half ends.
    waits_left: usize,
}

impl Bus {
    pub(crate) fn new(port: Box<dyn Port>, config: &Config, drives: Vec<Box<dyn Drive>>) -> Bus {
        let ms = |ms: u32| Nanos::from_millis(i64::from(ms));
        let member = |drive| Member {
            drive,
            position: 0,
            has_answered: false,
            heard: None,
            waiting: None,
            resetting: None,
            is_told: false,
            control: None,
            following: Following::default(),
        };
        Bus {
            port,
            members: drives.into_iter().map(member).collect(),
            is_canopen: config.protocol == Protocol::Canopen,
            host: config.host_id,
            wait: config.wait(),
            lost_after: ms(config.lost_ms),
            silence: ms(config.watchdog_ms()),
            enable_after: ms(config.enable_ms),
            counts: BusCounts::default(),
            lost: None,
            requested: None,
            sampled: None,
            torques: None,
            lines: None,
            has_lines: true,
            enables: false,
            lifts_brake: false,
            demand: None,
            feed: false,
            fed: None,
            refreshed: 0,
            waits_left: 0,
        }
    }

    pub(crate) fn counts(&self) -> BusCounts {
        self.counts
    }

    /// The newest error of each drive by its own numbers.
    pub(crate) fn error_codes(&self) -> impl Iterator<Item = u16> + '_ {
        self.members.iter().map(|member| member.drive.error_code())
    }

    /// Hands a frame over; whether it was taken.
    fn send(&mut self, frame: &Frame) -> bool {
        let mut outcome = self.port.send(frame);
        while outcome == Err(SendError::Full) && self.waits_left > 0 {
            self.waits_left -= 1;
            self.pass_time();
            outcome = self.port.send(frame);
        }
        match outcome {
            Ok(()) => true,
            Err(SendError::Full) => {
                self.counts.full += 1;
                false
            }
            Err(SendError::Down) => {
                self.counts.down += 1;
                false
            }
        }
    }

    /// Lets the bus carry frames for a while; what comes meanwhile answers nobody.
    fn pass_time(&mut self) {
        self.port.start_wait(END_WAIT);
        for _ in 0..FRAMES_MAX {
            if self.port.receive().is_none() {
                break;
            }
        }
    }

    /// Takes a frame that came; one that answers nobody's question is late.
    fn take(&mut self, frame: &Frame, release: Nanos, is_asked: bool) {
        if let Some(class) = ErrorClass::of(frame) {
            self.counts.errors += 1;
            self.counts.bus_offs += u64::from(class.is_bus_off());
            self.counts.passive += u64::from(class.is_passive());
            self.counts.unacknowledged += u64::from(class.has_no_acknowledge());
            self.counts.restarts += u64::from(class.is_restart());
            if class.is_bus_off() {
                self.lost.get_or_insert(Failure::LOST);
            }
            return;
        }
        for (channel, member) in self.members.iter_mut().enumerate() {
            let Some(heard) = member.drive.receive(frame) else { continue };
            match heard {
                DriveMessage::Position(_) if !is_asked || member.has_answered => {
                    self.counts.late += 1
                }
                DriveMessage::Position(position) => {
                    (member.position, member.has_answered) = (position, true);
                    member.heard = Some(release);
                    self.counts.answers += 1;
                }
                DriveMessage::Status => {}
                DriveMessage::Emergency => self.counts.emergencies += 1,
                DriveMessage::Restarted | DriveMessage::Left => {
                    let is_restart = heard == DriveMessage::Restarted;
                    self.counts.drive_restarts += u64::from(is_restart);
                    self.counts.departures += u64::from(!is_restart);
                    self.lost.get_or_insert(Failure::on_channel(ErrorKind::Lost, channel));
                }
            }
            return;
        }
    }

    /// Takes what came meanwhile and asks every drive.
    pub(crate) fn request(&mut self, release: Nanos) {
        if self.requested == Some(release) || self.lost.is_some() {
            return;
        }
        self.requested = Some(release);
        self.counts.cycles += 1;
        for _ in 0..FRAMES_MAX {
            let Some(frame) = self.port.receive_now() else { break };
            self.take(&frame, release, false);
        }
        for member in &mut self.members {
            member.has_answered = false;
            member.heard.get_or_insert(release);
        }
        if self.is_canopen {
            self.send(&canopen::sync());
        }
        for index in 0..self.members.len() {
            if let Some(query) = self.members[index].drive.query() {
                self.send(&query);
            }
        }
    }

    /// The exchange of a cycle, once for all halves.
    fn exchange(&mut self, release: Nanos) -> Result<(), Failure> {
        if let Some((_, outcome)) = self.sampled.filter(|(at, _)| *at == release) {
            return outcome;
        }
        self.request(release);
        self.port.start_wait(self.wait);
        for _ in 0..FRAMES_MAX {
            let is_over = self.members.iter().all(|member| member.has_answered);
            if is_over || self.lost.is_some() {
                break;
            }
            let Some(frame) = self.port.receive() else { break };
            self.take(&frame, release, true);
        }
        let outcome = self.judge(release);
        self.sampled = Some((release, outcome));
        outcome
    }

    fn judge(&mut self, release: Nanos) -> Result<(), Failure> {
        if let Some(failure) = self.lost {
            return Err(failure);
        }
        let mut outcome = Ok(());
        for (channel, member) in self.members.iter().enumerate() {
            if member.has_answered {
                continue;
            }
            self.counts.missing += 1;
            let heard = member.heard.unwrap_or(release);
            if release - heard > self.lost_after {
                self.counts.silences += 1;
                let failure =
                    *self.lost.get_or_insert(Failure::on_channel(ErrorKind::Lost, channel));
                return Err(failure);
            }
            if outcome.is_ok() {
                outcome = Err(Failure::on_channel(ErrorKind::Transient, channel));
            }
        }
        outcome
    }

    /// The positions of all drives.
    pub(crate) fn positions(&mut self, release: Nanos) -> Result<[Counts; CHANNELS], Failure> {
        self.exchange(release)?;
        let mut counts = [Counts(0); CHANNELS];
        for (count, member) in counts.iter_mut().zip(&self.members) {
            *count = Counts(member.position);
        }
        Ok(counts)
    }

    /// The lines that the drives' states make up.
    pub(crate) fn lines(&mut self, release: Nanos) -> Result<LinesIn, Failure> {
        self.exchange(release)?;
        let mut lines = LinesIn { drive_power: true, estop_a_closed: true, estop_b_closed: true };
        let (enables, has_demand) = (self.enables, self.demand.is_some());
        for member in &mut self.members {
            let status = member.drive.status();
            let is_over = |since: Option<Nanos>| {
                since.is_none_or(|since| release - since > self.enable_after)
            };
            let is_late = member.waiting.is_some() && is_over(member.waiting);
            lines.drive_power &= status.has_power && !is_late;
            // A line that enables resets the fault first, which takes a while. One that does not
            // has been taken away because of it, or nobody wants the drive.
            let is_shown = has_demand || (enables && is_over(member.resetting));
            member.is_told &= !status.is_enabled;
            member.is_told |= status.has_fault && is_shown;
            lines.estop_a_closed &= !(status.has_fault && is_shown);
            lines.estop_b_closed &= !(status.has_fault && is_shown);
        }
        Ok(lines)
    }

    /// Whether a half that has committed at `commit` is silent at `release`.
    fn is_silent(&self, commit: Commit, release: Nanos) -> bool {
        commit.is_some_and(|at| release - at > self.silence)
    }

    /// Whether the feed line has changed lately.
    fn is_fed(&self, release: Nanos) -> bool {
        self.fed.is_some_and(|fed| release - fed <= self.silence)
    }

    fn answer(&self, is_sent: bool) -> Result<(), Failure> {
        match self.lost {
            Some(failure) => Err(failure),
            None if is_sent => Ok(()),
            None => Err(Failure::whole(ErrorKind::Transient)),
        }
    }

    /// Asks every drive for its torque; the codes are in range.
    pub(crate) fn commit_torques(
        &mut self,
        release: Nanos,
        codes: &[DacCode; CHANNELS],
    ) -> Result<(), Failure> {
        self.torques = Some(release);
        // Lines that no longer live must not be kept alive by torques.
        let is_live = self.lines.is_some() && self.is_fed(release);
        let mut is_sent = true;
        for (index, code) in codes.iter().enumerate().take(self.members.len()) {
            let code = if is_live { code.0 as i16 } else { 0 };
            is_sent &= self.send_torque(index, code, is_live);
        }
        self.answer(is_sent)
    }

    /// A drive whose sign of life is a torque hears none when the lines are dead.
    fn send_torque(&mut self, index: usize, code: i16, is_live: bool) -> bool {
        if !is_live && !self.is_canopen && self.lines.is_some() {
            return true;
        }
        let frame = self.members[index].drive.torque(code);
        self.send(&frame)
    }

    /// Leads every drive towards what the lines want.
    pub(crate) fn commit_lines(&mut self, release: Nanos, lines: &LinesOut) -> Result<(), Failure> {
        let is_changed = lines.watchdog_feed != self.feed;
        self.feed = lines.watchdog_feed;
        if is_changed {
            self.fed = Some(release);
        }
        self.lines = Some(release);
        let mut is_sent = true;
        if is_changed && self.is_canopen && !self.is_silent(self.torques, release) {
            is_sent &= self.send(&canopen::heartbeat(self.host));
        }
        let enable = lines.enable && self.is_fed(release);
        let was_enabling = core::mem::replace(&mut self.enables, enable);
        self.lifts_brake = lines.brake_release;
        if self.demand.is_some() {
            // The half for drives leads them; a line that falls is heard in the next cycle.
            return self.answer(is_sent);
        }
        for member in &mut self.members {
            let status = member.drive.status();
            let is_waiting = enable && !status.is_enabled;
            member.waiting = is_waiting.then(|| member.waiting.unwrap_or(release));
            let has_begun = enable && !was_enabling && status.has_fault;
            let goes_on = enable && status.has_fault && member.resetting.is_some();
            member.resetting = match (has_begun, goes_on) {
                (true, _) => Some(release),
                (false, true) => member.resetting,
                (false, false) => None,
            };
        }
        self.refreshed = (self.refreshed + 1) % self.members.len().max(1);
        let wish = Wish { enable, is_told: false, lifts_brake: lines.brake_release };
        is_sent &= self.control(wish, false);
        self.answer(is_sent)
    }

    /// Sends the control frames that have changed, or all of them, and one more: a frame that was
    /// lost on its way is made up for.
    fn control(&mut self, wish: Wish, all: bool) -> bool {
        let mut is_sent = true;
        for index in 0..self.members.len() {
            let member = &mut self.members[index];
            let wish = Wish { is_told: member.is_told, ..wish };
            let Some(frame) = member.drive.control(wish) else {
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

    fn send_safe_values(&mut self, half: Half) -> bool {
        match half {
            Half::Motors => {
                self.torques = None;
                if self.demand.is_some() {
                    return self.drives_off();
                }
                let mut is_sent = true;
                for index in 0..self.members.len() {
                    let frame = self.members[index].drive.torque(0);
                    is_sent &= self.send(&frame);
                }
                is_sent
            }
            Half::Lines => {
                self.lines = None;
                (self.enables, self.lifts_brake) = (false, false);
                if self.demand.is_some() {
                    return self.drives_off();
                }
                for member in &mut self.members {
                    member.waiting = None;
                }
                self.control(Wish::default(), true)
            }
        }
    }
}
