//! What the bus asks of a drive, whatever it speaks: frames to send, and what a frame that came
//! tells.

use taktil_drivers_cia402::power::RESET_CYCLES_MAX;
use taktil_hal::{DriveActual, DriveRequest, DriveState, Nanos};

use crate::frame::Frame;

/// What a frame was to the drive that it came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DriveMessage {
    /// The answer of this cycle: the position (counts).
    Position(i32),
    /// Something that changes the drive's status, or nothing of interest.
    Status,
    /// An emergency message.
    Emergency,
    /// The drive has restarted and has forgotten how it was set up.
    Restarted,
    /// The drive no longer takes part in the exchange.
    Left,
}

/// How a drive is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DriveStatus {
    /// The power stage has its voltage.
    pub(crate) has_power: bool,
    /// It follows torques.
    pub(crate) is_enabled: bool,
    /// A fault is under way or waits for its acknowledgement.
    pub(crate) has_fault: bool,
    /// The newest error by the drive's own numbers; 0 for none.
    pub(crate) error_code: u16,
}

/// What the lines want of the drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Wish {
    pub(crate) enable: bool,
    /// The lines from the cell have told of the drive's fault.
    pub(crate) is_told: bool,
    pub(crate) lifts_brake: bool,
}

/// What a half for drives wants of the power sections, as separate acts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Acts {
    pub(crate) request: DriveRequest,
    /// Only its change to true counts.
    pub(crate) reset: bool,
    pub(crate) lifts_brake: bool,
}

/// How long a controller without a ramp of its own brakes before its torque goes off.
pub(crate) const STOP_TIME: Nanos = Nanos::from_millis(500);

/// A drive on the bus.
pub(crate) trait Drive: Send {
    /// What it is, for messages.
    fn name(&self) -> String;

    /// The question of a cycle; `None` for a drive that answers to a SYNC.
    fn query(&self) -> Option<Frame>;

    /// Takes a frame; `None` for one of somebody else's.
    fn receive(&mut self, frame: &Frame) -> Option<DriveMessage>;

    /// How it is, by what it said last.
    fn status(&self) -> DriveStatus;

    /// The frame that asks for a torque of `code`, or for none as long as the drive is not wanted.
    fn torque(&self, code: i16) -> Frame;

    /// The frame that leads one step towards what is wanted.
    fn control(&mut self, wish: Wish) -> Option<Frame>;

    /// The frame that leads one step towards what a half for drives wants at `release`.
    fn lead(&mut self, release: Nanos, acts: Acts) -> Option<Frame>;

    /// The frame that takes the torque away whatever was led to before; `None` where each frame of
    /// `lead` towards no torque does.
    fn off(&self) -> Option<Frame> {
        None
    }

    /// The frame with a target of the mode, or with the safe one as long as the drive does not
    /// follow; `None` where a target would enable.
    fn target(&mut self, target: i32) -> Option<Frame>;

    /// What it reports, by what it said last.
    fn actual(&self) -> DriveActual;

    /// The newest error by the drive's own numbers; 0 for none.
    fn error_code(&self) -> u16 {
        self.status().error_code
    }

    /// The newest error register (object 1001) of an emergency message; 0 without one.
    fn error_register(&self) -> u8 {
        0
    }
}

/// Keeps the three acts of a controller without the states of CiA 402 apart: after a fault it takes
/// a reset and then a new request to follow; one that left operation by itself takes the second.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ActLatch {
    needs_reset: bool,
    is_blocked: bool,
    was_asked: bool,
    has_run: bool,
    /// Cycles for which a reset that was asked for is still repeated.
    clearing: u32,
    /// Since when it stops.
    stopping: Option<Nanos>,
}

/// What an [`ActLatch`] asks of a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Act {
    /// Torque off.
    Off,
    /// Nothing: what would switch torque off would reset the fault.
    Nothing,
    /// The fault is to be reset.
    Clear,
    /// A stop.
    Brake,
    /// It is to follow its target.
    Follow,
}

impl ActLatch {
    pub(crate) fn step(&mut self, release: Nanos, acts: Acts, status: DriveStatus) -> Act {
        let is_asked = acts.reset && !self.was_asked;
        self.was_asked = acts.reset;
        let wants = acts.request == DriveRequest::Follow;
        if status.has_fault {
            (self.needs_reset, self.is_blocked, self.has_run) = (true, true, false);
            self.stopping = None;
            self.clearing = if is_asked { RESET_CYCLES_MAX } else { self.clearing };
            if self.clearing == 0 {
                return Act::Nothing;
            }
            (self.clearing, self.needs_reset) = (self.clearing - 1, false);
            return Act::Clear;
        }
        self.clearing = 0;
        if self.needs_reset {
            // The fault has gone by itself: it is reset all the same before anything follows.
            self.needs_reset = !is_asked;
        }
        if self.has_run && !status.is_enabled {
            (self.is_blocked, self.has_run) = (true, false);
        }
        if !wants {
            self.is_blocked = false;
        }
        if wants && !self.is_blocked && !self.needs_reset {
            self.stopping = None;
            self.has_run |= status.is_enabled;
            return Act::Follow;
        }
        let was_running = core::mem::take(&mut self.has_run);
        if acts.request == DriveRequest::QuickStop && was_running {
            self.stopping = Some(release);
        }
        if acts.request != DriveRequest::QuickStop {
            self.stopping = None;
        }
        match self.stopping {
            Some(since) if release - since < STOP_TIME => Act::Brake,
            _ => {
                self.stopping = None;
                Act::Off
            }
        }
    }

    /// The state of the power section of a controller that shows `status`.
    pub(crate) fn state(&self, status: DriveStatus) -> DriveState {
        match (status.has_fault, status.is_enabled, self.stopping) {
            (true, ..) => DriveState::Fault,
            (_, _, Some(_)) => DriveState::Stopping,
            (_, true, None) => DriveState::Following,
            (_, false, None) => DriveState::Off,
        }
    }
}

/// What a latch asks of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    /// Torque off.
    Off,
    /// Torque off, and the fault acknowledged.
    Clear,
    /// Operation.
    On,
}

/// Keeps a drive without the states of CiA 402 from coming back by itself: after a fault that was
/// told a new wish to enable acknowledges it and enables; after one that nobody was told of it only
/// acknowledges, and the next one enables. A drive that left operation by itself takes a new wish,
/// too.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Latch {
    needs_clear: bool,
    /// Cycles for which the acknowledgement of a fault that was told is still repeated.
    clearing: u32,
    is_blocked: bool,
    was_wanted: bool,
    has_run: bool,
}

impl Latch {
    /// One step with what is wanted and how the drive is.
    pub(crate) fn step(&mut self, wish: Wish, status: DriveStatus) -> Request {
        let Wish { enable, is_told, .. } = wish;
        let is_new = enable && !self.was_wanted;
        self.was_wanted = enable;
        if !enable {
            (self.is_blocked, self.has_run, self.clearing) = (false, false, 0);
        }
        if is_new && self.needs_clear && is_told {
            (self.needs_clear, self.clearing) = (false, RESET_CYCLES_MAX);
        }
        if self.clearing > 0 && status.has_fault {
            self.clearing -= 1;
            return Request::Clear;
        }
        self.clearing = 0;
        // A fault takes a while to go; it counts anew when the wish that cleared it has ended.
        self.needs_clear |= status.has_fault && !self.is_blocked;
        if self.needs_clear {
            self.has_run = false;
            if !is_new {
                return Request::Off;
            }
            // This wish is used up by the acknowledgement, whatever comes of it.
            (self.needs_clear, self.is_blocked) = (false, true);
            return Request::Clear;
        }
        if self.has_run && !status.is_enabled {
            (self.is_blocked, self.has_run) = (true, false);
        }
        if !enable || self.is_blocked {
            return Request::Off;
        }
        self.has_run |= status.is_enabled;
        Request::On
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDLE: DriveStatus =
        DriveStatus { has_power: true, is_enabled: false, has_fault: false, error_code: 0 };
    const RUNNING: DriveStatus = DriveStatus { is_enabled: true, ..IDLE };
    const FAULTY: DriveStatus = DriveStatus { has_fault: true, ..IDLE };
    const WANTED: Wish = Wish { enable: true, is_told: false, lifts_brake: false };

    #[test]
    fn a_fault_takes_an_acknowledgement_and_a_new_wish() {
        let mut latch = Latch::default();
        assert_eq!(latch.step(WANTED, IDLE), Request::On);
        assert_eq!(latch.step(WANTED, RUNNING), Request::On);
        assert_eq!(
            [FAULTY, FAULTY, IDLE].map(|status| latch.step(WANTED, status)),
            [Request::Off; 3]
        );
        assert_eq!(latch.step(Wish::default(), FAULTY), Request::Off);
        assert_eq!(latch.step(WANTED, FAULTY), Request::Clear);
        assert_eq!([FAULTY, IDLE].map(|status| latch.step(WANTED, status)), [Request::Off; 2]);
        assert_eq!(latch.step(Wish::default(), IDLE), Request::Off);
        assert_eq!([IDLE, RUNNING].map(|status| latch.step(WANTED, status)), [Request::On; 2]);
    }

    #[test]
    fn a_fault_that_was_told_takes_one_new_wish() {
        let mut latch = Latch::default();
        let (told, given_up) = (Wish { is_told: true, ..WANTED }, Wish::default());
        assert_eq!([IDLE, RUNNING].map(|status| latch.step(WANTED, status)), [Request::On; 2]);
        assert_eq!([FAULTY, IDLE].map(|status| latch.step(told, status)), [Request::Off; 2]);
        assert_eq!(latch.step(given_up, FAULTY), Request::Off);
        assert_eq!([FAULTY; 2].map(|status| latch.step(told, status)), [Request::Clear; 2]);
        assert_eq!([IDLE, RUNNING].map(|status| latch.step(told, status)), [Request::On; 2]);
        // A cause that stays is not acknowledged for ever.
        assert_eq!(latch.step(told, FAULTY), Request::Off);
        assert_eq!(latch.step(given_up, FAULTY), Request::Off);
        let requests: Vec<_> =
            (0..2 * RESET_CYCLES_MAX).map(|_| latch.step(told, FAULTY)).collect();
        assert_eq!((requests[0], requests[150]), (Request::Clear, Request::Off));
        assert_eq!(latch.step(told, IDLE), Request::Off, "it waits for a new wish");
    }

    #[test]
    fn a_drive_that_stops_by_itself_takes_a_new_wish() {
        let mut latch = Latch::default();
        assert_eq!(
            [IDLE, IDLE, RUNNING].map(|status| latch.step(WANTED, status)),
            [Request::On; 3]
        );
        assert_eq!([IDLE, RUNNING].map(|status| latch.step(WANTED, status)), [Request::Off; 2]);
        assert_eq!(latch.step(Wish::default(), IDLE), Request::Off);
        assert_eq!(latch.step(WANTED, IDLE), Request::On);
    }

    #[test]
    fn a_fault_from_before_the_first_wish_is_acknowledged_first() {
        let mut latch = Latch::default();
        assert_eq!(latch.step(Wish::default(), FAULTY), Request::Off);
        assert_eq!(latch.step(WANTED, FAULTY), Request::Clear);
        assert_eq!(latch.step(WANTED, FAULTY), Request::Off, "the cause is still there");
        assert_eq!(latch.step(Wish::default(), FAULTY), Request::Off);
        assert_eq!(latch.step(WANTED, FAULTY), Request::Clear);
    }
}
